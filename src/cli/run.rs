//! `plenocal run`: from the images of a project to a report.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

use clap::Args;
use plenocal::calibration::{CalibrationOptions, Mode, Start, calibrate};
use plenocal::evaluation::Candidate;
use plenocal::io::{self, ModeName, OutputFolder, Project};
use plenocal::model::Observations;
use plenocal::precalibration::PrecalibrationOptions;
use plenocal::report::{self, Figure, HtmlReport, HtmlTable, Part, Section};
use plenocal::{Error, Result};
use serde_json::{Value, json};

use super::boards::{self, Estimator, Look, Shoot, Subset};
use super::calibrate::stage_results;
use super::evaluate::{Folds, Subjects, calibrated, clouds, read_candidate};
use super::ledger::{Ledger, SECTION};
use super::{precalibrate, tell, warn};

/// From the images of a project to a report: pre-calibration, detection, calibration, evaluation.
///
/// Everything goes into one folder, a folder for each stage. A stage whose images and options have not
/// changed since the last run is not done again.
#[derive(Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// Project file (TOML) with the camera, [board] and [images]; `plenocal init` writes one.
    pub project: PathBuf,
    /// Folder for the results: report.html, manifest.json, and a folder for each stage.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Do all stages again.
    #[arg(long)]
    pub force: bool,
    /// How the virtual depth of a corner is taken from the micro-images that show it.
    #[arg(long, value_enum, default_value = "line")]
    pub estimator: Estimator,
    /// Folds of the cross-validation; 0 for none.
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
  plenocal run project.toml --out results --force --folds 0";

/// Names of the stages, which are those of their folders.
const PRECALIBRATION: &str = "precalibration";
const CALIBRATION: &str = "calibration";
const CORNERS_ONLY: &str = "corners-only";
const EVALUATION: &str = "evaluation";
const REPORT: &str = "report.html";
/// Names of the two methods in tables.
const BLUR_AWARE: &str = "blur aware";
const CORNERS: &str = "corners only";

fn boards_stage(subset: Subset) -> &'static str {
    match subset {
        Subset::Calibration => "boards-calibration",
        Subset::Evaluation => "boards-evaluation",
        Subset::Translation => "boards-translation",
    }
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<ExitCode> {
    let begun = Instant::now();
    let path = &arguments.project;
    let project = Project::read(path)?;
    let shoot = Shoot::of(path, &project)?;
    let options = calibration_options(path, &project)?;
    if arguments.folds == 1 {
        return Err(Error::Invalid(
            "one fold leaves nothing to calibrate with: give --folds 0 for none, or 2 and more"
                .to_owned(),
        ));
    }
    // Whether the folder can be written is better known before the work than after.
    OutputFolder::new(&arguments.out)?;
    let mut ledger = Ledger::open(&arguments.out, path, arguments.force, arguments.json);
    let stages = Stages { arguments, path, project: &project, shoot: &shoot, options };
    stages.precalibration(&mut ledger)?;
    stages.boards(&mut ledger, Subset::Calibration)?;
    for subset in [Subset::Evaluation, Subset::Translation] {
        // Without these there is still a calibration.
        if !subset.images(&shoot.images).is_empty() {
            let result = stages.boards(&mut ledger, subset);
            ledger.tolerate(&format!("boards of {}", subset.name()), result);
        }
    }
    stages.calibration(&mut ledger, CALIBRATION)?;
    if stages.has_both() {
        let result = stages.calibration(&mut ledger, CORNERS_ONLY);
        ledger.tolerate("corners alone", result);
    }
    let result = stages.evaluation(&mut ledger);
    ledger.tolerate("evaluation", result);
    ledger.manifest.write(&arguments.out)?;
    let report = stages.report(&ledger, begun.elapsed().as_secs_f64())?;

    let folder = &arguments.out;
    let camera = read_json(&folder.join(CALIBRATION).join("camera.json"))?;
    let converged = camera["converged"].as_bool().unwrap_or(false);
    let text = if arguments.json {
        let document = json!({
            "report": report.display().to_string(),
            "calibration": read_json(&folder.join(CALIBRATION).join("calibration.json"))?,
            "evaluation": if ledger.has(EVALUATION) {
                read_json(&folder.join(EVALUATION).join("evaluation.json"))?
            } else {
                Value::Null
            },
        });
        format!("{document}\n")
    } else {
        let mut tables = tables_of(&read_section(&folder.join(CALIBRATION))?);
        tables.truncate(1);
        if ledger.has(EVALUATION) {
            tables.extend(tables_of(&read_section(&folder.join(EVALUATION))?));
        }
        let tables: Vec<String> = tables.iter().map(|table| format!("{table}\n\n")).collect();
        format!("{}Written: {}\n", tables.concat(), report.display())
    };
    let _ = std::io::stdout().write_all(text.as_bytes());
    if converged {
        return Ok(ExitCode::SUCCESS);
    }
    tell(&format!("error: the calibration is not converged; see {}", report.display()));
    Ok(ExitCode::from(3))
}

fn calibration_options(path: &Path, project: &Project) -> Result<CalibrationOptions> {
    if project.calibration.mode == Some(ModeName::PosesOnly) {
        return Err(Error::Invalid(
            "[calibration] says mode = \"poses-only\", but a run calibrates: leave it out, or use \
             `plenocal extrinsics`"
                .to_owned(),
        )
        .in_file(path));
    }
    Ok(project.calibration.options())
}

fn read_json(path: &Path) -> Result<Value> {
    let text =
        fs::read_to_string(path).map_err(|source| Error::Read { path: path.to_owned(), source })?;
    serde_json::from_str(&text).map_err(|e| {
        Error::Invalid(format!("this is not valid JSON: {e}; do the run again with --force"))
            .in_file(path)
    })
}

/// What a stage has for the report, figures included.
fn read_section(folder: &Path) -> Result<Section> {
    let path = folder.join(SECTION);
    let mut section: Section = serde_json::from_value(read_json(&path)?)
        .map_err(|e| Error::Invalid(format!("not a section of a report: {e}")).in_file(&path))?;
    for figure in section.figures_mut() {
        let path = folder.join(&figure.name);
        figure.svg = fs::read_to_string(&path)
            .map_err(|source| Error::Read { path: path.clone(), source })?;
    }
    Ok(section)
}

fn tables_of(section: &Section) -> Vec<HtmlTable> {
    let table = |part: &Part| match part {
        Part::Table(table) => Some(table.clone()),
        _ => None,
    };
    section.parts.iter().filter_map(table).collect()
}

fn stage_figures(output: &mut OutputFolder, figures: &[Figure]) -> Result<()> {
    figures.iter().try_for_each(|figure| {
        output.stage(&figure.name, |out| out.write_all(figure.svg.as_bytes()))
    })
}

/// What results depend on: they are the same to rounding with any number of threads.
fn told(options: &CalibrationOptions) -> String {
    let mut options = options.clone();
    options.solver.threads = 0;
    format!("{options:?}")
}

struct Stages<'a> {
    arguments: &'a Arguments,
    path: &'a Path,
    project: &'a Project,
    shoot: &'a Shoot,
    options: CalibrationOptions,
}

impl Stages<'_> {
    fn folder(&self, stage: &str) -> PathBuf {
        self.arguments.out.join(stage)
    }

    /// Corners alone are a comparison where there is blur to be aware of.
    fn has_both(&self) -> bool {
        self.options.mode == Mode::Full && self.shoot.sheet.lens_types > 0
    }

    /// What results depend on besides files.
    fn camera(&self) -> Value {
        let Shoot { sheet, board, images } = self.shoot;
        json!({
            "camera": format!("{sheet:?}"),
            "board": format!("{board:?}"),
            "color": images.color.name(),
        })
    }

    fn precalibration(&self, ledger: &mut Ledger) -> Result<()> {
        let images = &self.shoot.images;
        let sheet = &self.shoot.sheet;
        let mut inputs: Vec<PathBuf> = images.whites.iter().map(|w| w.image.clone()).collect();
        inputs.extend(images.devignetting.clone());
        let f_numbers: Vec<String> =
            images.whites.iter().map(|w| format!("{:?} {:?}", w.f_number, w.stop)).collect();
        let options = json!({ "camera": self.camera(), "f_numbers": f_numbers });
        ledger.stage(PRECALIBRATION, &inputs, options, |output| {
            let options = PrecalibrationOptions::of_datasheet(sheet);
            let (result, whites) =
                precalibrate::measure(self.path, images, sheet, &options, self.arguments.json)?;
            warn(&result.warnings);
            let document = io::precalibration_document(&result);
            output.stage_json("precalibration.json", &document)?;
            let figures = precalibrate::stage(output, &result, sheet, &whites)?;
            Ok(report::precalibration_section(&result, figures))
        })
    }

    /// What detection takes from the pre-calibration.
    fn measured(&self) -> [PathBuf; 2] {
        let folder = self.folder(PRECALIBRATION);
        [folder.join("precalibration.json"), folder.join("centers.csv")]
    }

    fn boards(&self, ledger: &mut Ledger, subset: Subset) -> Result<()> {
        let shoot = self.shoot;
        let white = shoot.white_image().map_err(|e| e.in_file(self.path))?;
        let inputs: Vec<PathBuf> = subset
            .images(&shoot.images)
            .iter()
            .cloned()
            .chain([white])
            .chain(self.measured())
            .collect();
        let look = Look {
            subset,
            estimator: self.arguments.estimator,
            pictures: !self.arguments.no_pictures,
            quiet: self.arguments.json,
        };
        let estimator = plenocal::detection::DepthEstimator::from(look.estimator);
        let options = json!({
            "camera": self.camera(),
            "estimator": estimator,
            "pictures": look.pictures,
        });
        ledger.stage(boards_stage(subset), &inputs, options, |output| {
            let micro_images = shoot.read_precalibration(&self.folder(PRECALIBRATION))?;
            let found = boards::detect(self.path, shoot, &micro_images, look, output)?;
            warn(&found.warnings);
            let figures = found.figures(look.pictures);
            let rows = found.rows();
            Ok(report::detection_section(subset.name(), &rows, &found.warnings, figures))
        })
    }

    fn features(&self, subset: Subset) -> PathBuf {
        self.folder(boards_stage(subset)).join("features.csv")
    }

    fn start(&self) -> Result<Start> {
        let sheet = &self.shoot.sheet;
        let [internal, _] = self.measured();
        let pixel = Some(sheet.sensor.pixel_size_mm);
        Ok(Start::Datasheet(*sheet, io::read_internal_parameters(&internal, pixel)?))
    }

    fn observations(&self) -> Result<Observations> {
        let [_, centers] = self.measured();
        let mut observations = io::read_features(&self.features(Subset::Calibration), true)?;
        observations.centers = io::read_centers(&centers)?;
        Ok(observations)
    }

    fn calibration(&self, ledger: &mut Ledger, stage: &str) -> Result<()> {
        let mut options = self.options.clone();
        let mut title = "Calibration";
        if stage == CORNERS_ONLY {
            options.mode = Mode::CornersOnly;
            // Pinholes have no focal lengths that could be held.
            options.cost.fixed.retain(|name| !name.starts_with("f_"));
            title = "Calibration from corners alone, for comparison";
        }
        let inputs: Vec<PathBuf> =
            self.measured().into_iter().chain([self.features(Subset::Calibration)]).collect();
        let told = json!({ "camera": self.camera(), "options": told(&options) });
        ledger.stage(stage, &inputs, told, |output| {
            let begun = Instant::now();
            let (start, observations) = (self.start()?, self.observations()?);
            let board = &self.shoot.board;
            let result = calibrate(&start, board, &observations, &options, &mut |_| true)?;
            if stage == CALIBRATION {
                warn(&result.left_out);
                warn(&result.warnings);
            } else if !result.converged {
                warn(&["the calibration from corners alone is not converged"]);
            }
            stage_results(output, &result, false)?;
            let document = report::calibration_json(&result, begun.elapsed().as_secs_f64());
            output.stage_json("calibration.json", &document)?;
            let figures = report::calibration_figures(&result, board)?;
            stage_figures(output, &figures)?;
            Ok(report::calibration_section(title, &result, figures))
        })
    }

    fn candidates(&self, has_corners: bool) -> Result<Vec<Candidate>> {
        let named =
            |name: &str, stage: &str| read_candidate(name, &self.folder(stage).join("camera.json"));
        let is_blur_aware = self.options.mode == Mode::Full && self.shoot.sheet.lens_types > 0;
        let own = if is_blur_aware { BLUR_AWARE } else { CORNERS };
        let mut candidates = vec![named(own, CALIBRATION)?];
        if has_corners {
            candidates.push(named(CORNERS, CORNERS_ONLY)?);
        }
        Ok(candidates)
    }

    fn evaluation(&self, ledger: &mut Ledger) -> Result<()> {
        let shoot = self.shoot;
        let truth = self.project.truth.as_ref();
        let has_corners = ledger.has(CORNERS_ONLY);
        let [has_evaluation, has_translation] = [Subset::Evaluation, Subset::Translation]
            .map(|subset| ledger.has(boards_stage(subset)));
        let mut inputs: Vec<PathBuf> = self.measured().to_vec();
        inputs.push(self.features(Subset::Calibration));
        inputs.extend(["camera.json", "poses.json"].map(|f| self.folder(CALIBRATION).join(f)));
        if has_corners {
            inputs.push(self.folder(CORNERS_ONLY).join("camera.json"));
        }
        inputs.extend(has_evaluation.then(|| self.features(Subset::Evaluation)));
        inputs.extend(has_translation.then(|| self.features(Subset::Translation)));
        inputs.extend(shoot.images.translation.iter().flat_map(|t| t.clouds.clone()));
        if let Some(truth) = truth {
            inputs.push(truth.camera.clone());
            inputs.extend(truth.calibration_poses.clone());
            inputs.extend(truth.evaluation_poses.clone());
        }
        let step_mm = shoot.images.translation.as_ref().map(|t| t.step_mm);
        let told = json!({
            "camera": self.camera(),
            "options": told(&self.options),
            // Which file is which.
            "evaluation": has_evaluation,
            "translation": has_translation,
            "clouds": shoot.images.translation.as_ref().map(|t| t.clouds.len()),
            "true_poses": truth
                .map(|t| [t.calibration_poses.is_some(), t.evaluation_poses.is_some()]),
            "step_mm": step_mm,
            "folds": self.arguments.folds,
        });
        ledger.stage(EVALUATION, &inputs, told, |output| {
            let features = |wanted: bool, subset: Subset| {
                if wanted {
                    Ok(io::read_features(&self.features(subset), true)?.features)
                } else {
                    Ok(Vec::new())
                }
            };
            let evaluation = features(has_evaluation, Subset::Evaluation)?;
            let translation = features(has_translation, Subset::Translation)?;
            let candidates = self.candidates(has_corners)?;
            let found = io::read_poses(&self.folder(CALIBRATION).join("poses.json"))?;
            let poses = truth.and_then(|t| t.calibration_poses.as_deref());
            let poses = poses.map(io::read_poses).transpose()?;
            let observations = self.observations()?;
            let excluded = &self.options.exclude_frames;
            let frames = observations.frames();
            let frames = frames.iter().filter(|frame| !excluded.contains(frame)).count();
            let count = self.arguments.folds.min(frames);
            let start = self.start()?;
            let initial = plenocal::calibration::initial_from(&start, &observations)?;
            let folds = (count > 1).then(|| Folds {
                start,
                observations,
                options: self.options.clone(),
                count,
            });
            let subjects = Subjects {
                board: shoot.board,
                candidates,
                evaluation,
                translation: step_mm
                    .filter(|_| !translation.is_empty())
                    .map(|step| (translation, step)),
                clouds_mm: clouds(shoot)?,
                truth: truth.map(|t| calibrated(&t.camera)).transpose()?,
                poses: poses
                    .map(|truth| ("calibration".to_owned(), truth, found))
                    .into_iter()
                    .collect(),
                evaluation_poses: truth
                    .and_then(|t| t.evaluation_poses.as_deref())
                    .map(io::read_poses)
                    .transpose()?,
                folds,
            };
            let assessment = subjects.assess(self.arguments.json);
            warn(&assessment.problems);
            output.stage_json("evaluation.json", &assessment.document)?;
            let mut tables = vec![report::cameras_table(&initial, &subjects.candidates)];
            tables.extend(assessment.tables);
            Ok(report::tables_section("Evaluation", tables, &assessment.problems))
        })
    }

    /// Writes report.html from what the stages have left.
    fn report(&self, ledger: &Ledger, time_s: f64) -> Result<PathBuf> {
        let mut sections = vec![self.overview(ledger, time_s)];
        // What people look for first, then where it came from.
        let is_result = |name: &str| [CALIBRATION, EVALUATION].contains(&name);
        let (results, rest): (Vec<_>, Vec<_>) =
            ledger.stages.iter().map(|(name, _)| name).partition(|name| is_result(name));
        for name in results.into_iter().chain(rest) {
            sections.push(read_section(&self.folder(name))?);
        }
        let camera = self.path.parent().and_then(Path::file_name).unwrap_or_default();
        let report = HtmlReport {
            title: "Calibration of a plenoptic camera".to_owned(),
            subtitle: format!(
                "{} · plenocal {}",
                if camera.is_empty() {
                    self.path.display().to_string()
                } else {
                    camera.to_string_lossy().into_owned()
                },
                ledger.manifest.plenocal
            ),
            sections,
        };
        let mut output = OutputFolder::new(&self.arguments.out)?;
        output.stage(REPORT, |out| out.write_all(report.to_html().as_bytes()))?;
        output.commit()?;
        Ok(self.arguments.out.join(REPORT))
    }

    fn overview(&self, ledger: &Ledger, time_s: f64) -> Section {
        let rows = ledger
            .stages
            .iter()
            .filter_map(|(name, done)| {
                let record = ledger.manifest.stage(name)?;
                let when = if *done { "this run" } else { "an earlier run" };
                Some(vec![
                    name.clone(),
                    when.to_owned(),
                    format!("{:.2}", record.time_s),
                    record.files.len().to_string(),
                ])
            })
            .collect();
        let table = HtmlTable {
            caption: "Stages".to_owned(),
            header: ["Stage", "Done in", "Time, s", "Files"].map(str::to_owned).to_vec(),
            rows,
            text_columns: vec![0, 1],
        };
        let text = format!(
            "Project {}, {} files read; this run took {time_s:.1} s. manifest.json has \
             their hashes.",
            self.path.display(),
            ledger.manifest.inputs.len()
        );
        let texts: Vec<String> = ledger.missing.iter().cloned().chain([text]).collect();
        report::tables_section("Overview", vec![table], &texts)
    }
}
