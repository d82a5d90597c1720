//! `plenocal run`: from the images of a project to a report.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

use clap::Args;
use plenocal::calibration::{CalibrationOptions, Mode};
use plenocal::detection::DepthEstimator;
use plenocal::io::{self, CalibrationSection, Method, OutputFolder, Project, first_look};
use plenocal::model::Subset;
use plenocal::report::{Cell, Column, Part, Report, Section, Table};
use plenocal::{Error, Result, report};
use serde_json::{Value, json};

use super::boards::{Shoot, images_of};
use super::choices::{DEPTH_ESTIMATORS, METHODS, choice};
use super::ledger::{Ledger, REPORT, SECTION, VERDICT};
use super::stages::{CALIBRATION, CORNERS_ONLY, EVALUATION, IMAGES, Stages};
use super::talk::{print_result, say};
use super::verdict::RunVerdict;

/// From the images of a project to a report: pre-calibration, detection, calibration, evaluation.
///
/// Everything goes into one folder, with a subfolder for each stage. A stage whose input has not
/// changed since the last run is not repeated.
#[derive(Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// Project file (TOML) with the camera, [board] and [images]; `plenocal init` writes one.
    pub project: PathBuf,
    /// Folder for the results: report.html, manifest.json, and a folder for each stage.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Repeat all stages.
    #[arg(long)]
    pub force: bool,
    /// How the virtual depth of a corner is estimated from the micro-images that show it.
    #[arg(long, value_parser = choice(DEPTH_ESTIMATORS), default_value = "line")]
    pub estimator: DepthEstimator,
    /// Frames of the calibration to leave out, e.g. 3,7; in place of those of the project.
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    pub exclude: Option<Vec<u32>>,
    /// Set of calibration options to begin with; in place of that of the project.
    #[arg(long, value_parser = choice(METHODS))]
    pub method: Option<Method>,
    /// Folds of the cross-validation, of models too; 0 for none.
    #[arg(long, value_name = "K", default_value_t = 5)]
    pub folds: usize,
    /// Write no pictures of frames.
    #[arg(long)]
    pub no_pictures: bool,
    /// Print the result as one JSON object instead of tables.
    #[arg(long)]
    pub json: bool,
}

const EXAMPLES: &str = "\
Examples:
  plenocal init images --preset r12-a --board 9x5x10 --out project.toml
  plenocal run project.toml --out results
  plenocal run project.toml --out results --exclude 3,7
  plenocal run project.toml --out results --force --folds 0";

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<ExitCode> {
    let begun = Instant::now();
    let path = &arguments.project;
    let project = Project::read(path)?;
    let shoot = Shoot::of(path, &project)?;
    let mut options = calibration_options(path, &project, arguments.method)?;
    if let Some(frames) = &arguments.exclude {
        options.exclude_frames.clone_from(frames);
    }
    if arguments.folds == 1 {
        return Err(Error::invalid(
            "one fold leaves nothing to calibrate with: give --folds 0 for none, or 2 or more",
        ));
    }
    let doubtful = first_look(&shoot.images).map_err(|e| e.in_file(path))?;
    // A folder that cannot be written is reported before the work, not after it.
    OutputFolder::new(&arguments.out)?;
    let mut ledger = Ledger::open(&arguments.out, path, arguments.force, arguments.json)?;
    let stages = Stages {
        path,
        project: &project,
        shoot: &shoot,
        out: &arguments.out,
        options,
        estimator: arguments.estimator,
        folds: arguments.folds,
        pictures: !arguments.no_pictures,
        quiet: arguments.json,
    };
    ledger.warn(IMAGES, &doubtful.iter().map(super::talk::told).collect::<Vec<_>>());
    stages.precalibration(&mut ledger)?;
    stages.boards(&mut ledger, Subset::Calibration)?;
    for subset in [Subset::Evaluation, Subset::Translation] {
        // Without these there is still a calibration.
        if !images_of(subset, &shoot.images).is_empty() {
            let result = stages.boards(&mut ledger, subset);
            ledger.tolerate(&format!("boards for {}", subset.name()), result)?;
        }
    }
    stages.calibration(&mut ledger, CALIBRATION)?;
    if stages.has_both() {
        let result = stages.calibration(&mut ledger, CORNERS_ONLY);
        ledger.tolerate("corners only", result)?;
    }
    let result = stages.evaluation(&mut ledger);
    ledger.tolerate("evaluation", result)?;
    ledger.finish()?;
    let verdict = verdict(arguments, &ledger)?;
    let report = write_report(arguments, &ledger, &verdict, begun.elapsed().as_secs_f64())?;

    print_results(arguments, &ledger, &verdict, &report)?;
    let camera = read_json(&arguments.out.join(CALIBRATION).join("camera.json"))?;
    let doubts = io::camera_doubts(&camera);
    if doubts.is_empty() {
        return Ok(ExitCode::SUCCESS);
    }
    say(&format!("error: {}; see {}", doubts.join("; "), report.display()));
    Ok(ExitCode::from(3))
}

fn verdict(arguments: &Arguments, ledger: &Ledger) -> Result<RunVerdict> {
    let folder = arguments.out.join(CALIBRATION);
    let calibration = read_json(&folder.join("calibration.json"))?;
    let section = read_json_section(&folder.join(VERDICT))?;
    Ok(RunVerdict::of(&calibration, &section, &ledger.warnings))
}

/// Prints the camera and how good it is, or everything as JSON.
fn print_results(
    arguments: &Arguments,
    ledger: &Ledger,
    verdict: &RunVerdict,
    report: &Path,
) -> Result<()> {
    let folder = &arguments.out;
    let document = json!({
        "report": report.display().to_string(),
        "verdict": verdict.document(),
        "calibration": read_json(&folder.join(CALIBRATION).join("calibration.json"))?,
        "evaluation": if ledger.has(EVALUATION) {
            read_json(&folder.join(EVALUATION).join("evaluation.json"))?
        } else {
            Value::Null
        },
    });
    let mut tables: Vec<Table> =
        read_section(&folder.join(CALIBRATION))?.tables().cloned().collect();
    let mut number = 0;
    tables.retain(|table| {
        number += 1;
        number == 1 || table.caption == report::MODELS
    });
    if ledger.has(EVALUATION) {
        tables.extend(read_section(&folder.join(EVALUATION))?.tables().cloned());
    }
    let mut texts = vec![verdict.lines().join("\n")];
    texts.extend(tables.iter().map(ToString::to_string));
    print_result(arguments.json, &document, &texts.join("\n\n"), &[report.to_owned()])
}

fn read_json(path: &Path) -> Result<Value> {
    let text =
        fs::read_to_string(path).map_err(|source| Error::Read { path: path.to_owned(), source })?;
    serde_json::from_str(&text).map_err(|e| {
        Error::invalid(format!("this is not valid JSON: {e}; repeat the run with --force"))
            .in_file(path)
    })
}

fn read_json_section(path: &Path) -> Result<Section> {
    serde_json::from_value(read_json(path)?)
        .map_err(|e| Error::invalid(format!("not a section of a report: {e}")).in_file(path))
}

/// A stage's section of the report, figures included.
fn read_section(folder: &Path) -> Result<Section> {
    let mut section = read_json_section(&folder.join(SECTION))?;
    for figure in section.figures_mut() {
        let path = folder.join(&figure.name);
        figure.svg = fs::read_to_string(&path)
            .map_err(|source| Error::Read { path: path.clone(), source })?;
    }
    Ok(section)
}

/// Writes report.html from what the stages have written.
fn write_report(
    arguments: &Arguments,
    ledger: &Ledger,
    verdict: &RunVerdict,
    time_s: f64,
) -> Result<PathBuf> {
    let mut sections = vec![verdict.section(), overview(&arguments.project, ledger, time_s)];
    // First the results, then what they came from.
    let is_result = |name: &str| [CALIBRATION, EVALUATION].contains(&name);
    let (results, rest): (Vec<_>, Vec<_>) =
        ledger.stages.iter().map(|(name, _)| name).partition(|name| is_result(name));
    for name in results.into_iter().chain(rest) {
        sections.push(read_section(&arguments.out.join(name))?);
    }
    let camera = arguments.project.parent().and_then(Path::file_name).unwrap_or_default();
    let report = Report {
        title: "Calibration of a plenoptic camera".to_owned(),
        subtitle: format!(
            "{} · plenocal {}",
            if camera.is_empty() {
                arguments.project.display().to_string()
            } else {
                camera.to_string_lossy().into_owned()
            },
            ledger.manifest.plenocal
        ),
        sections,
    };
    let mut output = OutputFolder::new(&arguments.out)?;
    output.stage(REPORT, |out| out.write_all(report.to_html().as_bytes()))?;
    output.stage_json(VERDICT, &verdict.document())?;
    output.commit()?;
    Ok(arguments.out.join(REPORT))
}

fn overview(project: &Path, ledger: &Ledger, time_s: f64) -> Section {
    let mut table = Table::new(
        "Stages",
        [
            Column::text("Stage"),
            Column::text("Done in"),
            Column::of("Time", "s"),
            Column::number("Files"),
        ],
    );
    for (name, done) in &ledger.stages {
        let Some(record) = ledger.manifest.stage(name) else { continue };
        let when = if *done { "this run" } else { "an earlier run" };
        let time = Cell::fixed(record.time_s, 2);
        table.push([name.as_str().into(), when.into(), time, record.files.len().into()]);
    }
    let text = format!(
        "Project {}, {} files read; this run took {time_s:.1} s. manifest.json has \
         their hashes.",
        project.display(),
        ledger.manifest.inputs.len()
    );
    let texts = ledger.missing.iter().cloned().chain([text]).map(Part::Text);
    Section::new("Overview", [Part::Table(table)].into_iter().chain(texts).collect())
}

/// The calibration options of a project; an error if they ask for poses only.
fn calibration_options(
    path: &Path,
    project: &Project,
    method: Option<Method>,
) -> Result<CalibrationOptions> {
    if project.calibration.mode == Some(Mode::PosesOnly) {
        return Err(Error::invalid(
            "[calibration] says mode = \"poses-only\", but a run calibrates: leave it out, or use \
             `plenocal extrinsics`",
        )
        .in_file(path));
    }
    let stated = CalibrationSection { method, ..CalibrationSection::default() };
    Ok(stated.or(project.calibration.clone()).options())
}
