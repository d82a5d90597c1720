//! `plenocal run`: processes the images of a project up to a report.
//!
//! The stages hand values to each other. All files are written at the end, together.

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::{Instant, SystemTime};

use clap::Args;
use plenocal::assessment::{
    Assessment, Candidate, Evaluation, EvaluationInput, Folds, Group, PosePairs, Verdict, assess,
};
use plenocal::calibration::{
    Calibration, CalibrationOptions, Method, Mode, Start, calibrate, frame_list, initial_from,
};
use plenocal::detection::{DepthEstimator, DetectedBoards, MicroImages};
use plenocal::io::{
    self, FolderLock, ImagesSection, MANIFEST, Manifest, OutputFolder, Project, StageRecord,
    first_look,
};
use plenocal::model::{Datasheet, FramePose, Observations, Subset};
use plenocal::precalibration::{Precalibration, PrecalibrationOptions};
use plenocal::report::{
    Cell, Certified, Column, Figure, Part, Photograph, Question, Report, Section, Table,
};
use plenocal::{Error, Finding, Issue, Result, Severity, Subject, report};
use rayon::prelude::*;
use serde_json::{Value, json};

use super::boards::{self, Options, Photographs, Shoot, images_of};
use super::calibrate::{compared, stage_results, status, with_method};
use super::evaluate::{calibrated, clouds, evaluated};
use super::messages::{announce_calibration, print_result, say, shown, tables_are_shown, tell};
use super::pictures::{ShownBoards, ShownWhites, pictures_of};
use super::{precalibrate, progress};

/// Process the images of a project up to a report: pre-calibration, detection, calibration, evaluation.
///
/// All results go into one folder, with a subfolder for each stage; they replace the results of an earlier run there.
#[derive(Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// Project file (TOML) with the camera, [board] and [images]; `plenocal init` writes one.
    pub project: PathBuf,

    #[arg(long, value_name = "DIR", help = results_help!("report.html, certificate.html, verdict.json, manifest.json, and a folder for each stage"))]
    pub out: PathBuf,
    /// Estimator of the virtual depth of a corner from the micro-images that show it.
    #[arg(long, default_value = "line")]
    pub estimator: DepthEstimator,
    /// Frames of the calibration to leave out, e.g. 3,7 or 0-4,7; replaces the list of the project.
    #[arg(long, value_name = "LIST", value_parser = frame_list)]
    // With the full path of the type, clap takes the list as one value of the flag.
    pub exclude: Option<::std::vec::Vec<u32>>,
    /// Set of calibration options to begin with; replaces the set of the project.
    #[arg(long)]
    pub method: Option<Method>,
    /// Replace a value of the project, e.g. calibration.loss=cauchy; may be repeated.
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// Also calibrate from corners alone, for comparison.
    #[arg(long)]
    pub corners_only: bool,
    /// Folds of the cross-validation and of the comparison of models; 0 for none.
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
  plenocal init images --preset r12-a --board 8x5x10 --out project.toml
  plenocal run project.toml --out results
  plenocal run project.toml --out results --exclude 3,7
  plenocal run project.toml --out results --set calibration.loss=cauchy --set board.square_mm=10.02
  plenocal run project.toml --out results --folds 0 --method paper";

/// Names of the stages and of their folders.
const PRECALIBRATION: &str = "precalibration";
const CALIBRATION: &str = "calibration";
const CORNERS_ONLY: &str = "corners-only";
const EVALUATION: &str = "evaluation";
/// Names of sections that belong to no stage.
const RESIDUALS: &str = "residuals";
const PICTURES: &str = "pictures";
/// Names of the two methods in tables.
const BLUR_AWARE: &str = "blur aware";
const CORNERS: &str = "corners only";
/// Names of the files beside the folders of the stages.
const REPORT: &str = "report.html";
const CERTIFICATE: &str = "certificate.html";
const VERDICT: &str = "verdict.json";

fn boards_stage(subset: Subset) -> &'static str {
    match subset {
        Subset::Calibration => "boards-calibration",
        Subset::Evaluation => "boards-evaluation",
        Subset::Translation => "boards-translation",
    }
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<ExitCode> {
    let path = &arguments.project;
    let project = Project::read_and_set(path, &with_method(&arguments.set, arguments.method))?;
    let shoot = Shoot::of(path, &project)?;
    let mut options = calibration_options(path, &project)?;
    if let Some(frames) = &arguments.exclude {
        options.exclude_frames.clone_from(frames);
    }
    if arguments.folds == 1 {
        return Err(Error::invalid(
            "one fold leaves no frames to calibrate with: give --folds 0 for none, or 2 or more",
        ));
    }
    let of_images = first_look(&shoot.images, &shoot.reader).map_err(|e| e.in_file(path))?;
    // Two runs at once would mix their files.
    let _held = FolderLock::hold(&arguments.out)?;
    let mut run = Run::new(arguments, &project, &shoot, options)?;
    progress::begin(arguments.json, steps_of(&shoot.images, arguments.folds));
    tell(&of_images);
    run.findings.extend(of_images);
    let outcome = run.all_stages();
    progress::end();
    outcome
}

/// Returns the number of steps that progress counts: images, and calibrations without some frames or parameters.
fn steps_of(images: &ImagesSection, folds: usize) -> usize {
    let subsets = [Subset::Calibration, Subset::Evaluation, Subset::Translation];
    let boards: usize = subsets.iter().map(|subset| images_of(*subset, images).len()).sum();
    // Each group of parameters is left out in all folds and once with all frames.
    let models = if folds > 0 { Group::ALL.len() * (folds + 1) } else { 0 };
    images.whites.len() + boards + models + folds
}

/// State of a run: its input, and the results of its stages so far.
struct Run<'a> {
    arguments: &'a Arguments,
    project: &'a Project,
    shoot: &'a Shoot,
    options: CalibrationOptions,
    begun: Instant,
    manifest: Manifest,
    /// Files of all stages, which are renamed to their final names at the end.
    output: OutputFolder,
    /// Sections of the report by stage, in the order of the stages.
    sections: Vec<(&'static str, Section)>,
    /// Figures beside the result.
    figures: Vec<Figure>,
    /// Photographs of boards and white images; empty without pictures.
    boards: Vec<(Subset, Photographs)>,
    whites: Vec<Photograph>,
    /// Findings about the camera: from images, boards of the calibration, and the evaluation.
    findings: Vec<Finding>,
}

/// Returns the arguments of this program.
fn command_line() -> Vec<String> {
    std::env::args_os().skip(1).map(|argument| argument.to_string_lossy().into_owned()).collect()
}

/// Input of the calibration.
struct Observed {
    start: Start,
    observations: Observations,
}

impl<'a> Run<'a> {
    fn new(
        arguments: &'a Arguments,
        project: &'a Project,
        shoot: &'a Shoot,
        options: CalibrationOptions,
    ) -> Result<Self> {
        let truth = project.truth.iter().flat_map(io::TruthSection::files);
        let files = std::iter::once(arguments.project.as_path());
        let files = files.chain(shoot.images.files()).chain(truth);
        Ok(Self {
            arguments,
            project,
            shoot,
            options,
            begun: Instant::now(),
            manifest: Manifest::of(&arguments.project, command_line(), files),
            output: OutputFolder::new(&arguments.out)?,
            sections: Vec::new(),
            figures: Vec::new(),
            boards: Vec::new(),
            whites: Vec::new(),
            findings: Vec::new(),
        })
    }

    fn all_stages(mut self) -> Result<ExitCode> {
        let measured = self.stage(PRECALIBRATION, Self::precalibration)?;
        let micro_images = MicroImages::of_precalibration(&measured, &self.shoot.sheet)?;
        let boards = |subset: Subset, micro_images: &MicroImages| {
            let micro_images = micro_images.clone();
            move |run: &mut Self, output: &mut OutputFolder| {
                run.boards(subset, &micro_images, output)
            }
        };
        let of_calibration = Subset::Calibration;
        let found = self.stage(boards_stage(of_calibration), boards(of_calibration, &micro_images));
        let found = found.map_err(|error| because_of_white_image(error, &self.findings))?;
        self.findings.extend(found.findings.iter().cloned());
        // The other boards were taken by the same camera, so its aperture ratio and aberrations apply to them too.
        let settled = found.known_in(&micro_images);
        let mut others = Vec::new();
        for subset in [Subset::Evaluation, Subset::Translation] {
            // The calibration does not need these boards.
            if !images_of(subset, &self.shoot.images).is_empty() {
                let result = self.stage(boards_stage(subset), boards(subset, &settled));
                let part = format!("boards for {}", subset.name());
                others.extend(self.tolerated(&part, result)?.map(|found| (subset, found)));
            }
        }

        let observed = self.observed(&measured, &found);
        let options = self.options.clone();
        let (calibration, assessment) =
            self.stage(CALIBRATION, |run, output| run.calibration(&observed, &options, output))?;
        self.findings.extend(assessment.findings.iter().cloned());
        let corners = if self.arguments.corners_only && self.has_blur() {
            let result = self.stage(CORNERS_ONLY, |run, output| run.corners(&observed, output));
            self.tolerated(CORNERS, result)?
        } else {
            None
        };
        let cameras: Vec<&Calibration> = [&calibration].into_iter().chain(&corners).collect();
        let result = self
            .stage(EVALUATION, |run, output| run.evaluation(&observed, &cameras, &others, output));
        let evaluation = self.tolerated(EVALUATION, result)?;
        let found: Vec<(Subset, DetectedBoards)> =
            std::iter::once((of_calibration, found)).chain(others).collect();
        self.finish((&measured, &found), (&calibration, &assessment), evaluation)
    }

    /// Returns true if the calibration uses blur, so that corners alone can be compared with it.
    fn has_blur(&self) -> bool {
        self.options.mode == Mode::Full && self.shoot.sheet.lens_types > 0
    }

    /// Runs a stage, which stages its files in its own folder.
    fn stage<T>(
        &mut self,
        name: &'static str,
        work: impl FnOnce(&mut Self, &mut OutputFolder) -> Result<T>,
    ) -> Result<T> {
        let begun = Instant::now();
        progress::part(name);
        let folder = self.arguments.out.join(name);
        if folder.is_symlink() {
            return Err(Error::invalid(
                "is a link, but a run writes into its own folder: remove the link",
            )
            .in_file(&folder));
        }
        let mut output = OutputFolder::new(&folder)?;
        let result = work(self, &mut output)?;
        let time_s = begun.elapsed().as_secs_f64();
        let files = output.names();
        self.manifest.stages.push(StageRecord { name: name.to_owned(), time_s, files });
        self.output.take(output);
        if !self.arguments.json && !progress::is_whole_shown() {
            say(&format!("{name}: {time_s:.1} s"));
        }
        Ok(result)
    }

    /// Returns the result of a part that the rest does not need; a failure becomes a finding. A failed write stays an error:
    /// the other files could not be written either.
    fn tolerated<T>(&mut self, part: &str, result: Result<T>) -> Result<Option<T>> {
        match result {
            Ok(result) => Ok(Some(result)),
            Err(error @ Error::Write { .. }) => Err(error),
            Err(error) => {
                // The lines after the first one have tables.
                let reason = error.to_string().lines().next().unwrap_or_default().to_owned();
                let finding = Finding::caution(Issue::PartFailed { reason })
                    .about(Subject::Part(part.to_owned()));
                tell([&finding]);
                self.findings.push(finding);
                Ok(None)
            }
        }
    }

    fn precalibration(&mut self, output: &mut OutputFolder) -> Result<Precalibration> {
        let Shoot { images, sheet, reader, .. } = self.shoot;
        let options = PrecalibrationOptions {
            black_level: reader.black_level(),
            ..PrecalibrationOptions::of_datasheet(sheet)
        };
        let (path, quiet) = (&self.arguments.project, self.arguments.json);
        let (result, whites) = precalibrate::measure(path, images, reader, sheet, &options, quiet)?;
        output.stage_json("precalibration.json", &io::precalibration_document(&result))?;
        let figures = precalibrate::stage(output, &result, sheet, &whites)?;
        if !self.arguments.no_pictures {
            self.whites =
                whites.par_iter().map(|white| Photograph::of(&white.image).small()).collect();
        }
        tell(&result.findings);
        self.findings.extend(result.findings.iter().cloned());
        self.sections.push((PRECALIBRATION, report::precalibration_section(&result, figures)));
        Ok(result)
    }

    fn boards(
        &mut self,
        subset: Subset,
        micro_images: &MicroImages,
        output: &mut OutputFolder,
    ) -> Result<DetectedBoards> {
        let options = Options {
            subset,
            estimator: self.arguments.estimator,
            pictures: !self.arguments.no_pictures,
            quiet: self.arguments.json,
            for_poses: false,
        };
        let path = &self.arguments.project;
        let (found, photographs) =
            boards::detect_subset(path, self.shoot, micro_images, options, output)?;
        self.boards.push((subset, photographs));
        tell(&found.findings);
        let section = report::detection_section(subset.name(), &found);
        self.sections.push((boards_stage(subset), section));
        Ok(found)
    }

    fn observed(&self, measured: &Precalibration, found: &DetectedBoards) -> Observed {
        let internal = measured.internal.parameters.clone();
        let lattice = &measured.array.grid.lattice;
        let sheet = Datasheet {
            // Without a stated size, micro-images at the border may have features but no centre.
            array_size: Some((lattice.columns, lattice.rows)),
            ..self.shoot.sheet
        };
        Observed {
            start: Start::Datasheet(sheet, internal),
            observations: found.observations(measured.array.centers.clone()),
        }
    }

    fn calibration(
        &mut self,
        observed: &Observed,
        options: &CalibrationOptions,
        output: &mut OutputFolder,
    ) -> Result<(Calibration, Assessment)> {
        let begun = Instant::now();
        let board = &self.shoot.board;
        let Observed { start, observations } = observed;
        announce_calibration(&observations.features);
        let result = calibrate(start, board, observations, options, &mut |_| true)?;
        let assessment = assess(&result, board)?;
        tell(&result.findings);
        stage_results(output, (&result, &assessment), false)?;
        let time_s = begun.elapsed().as_secs_f64();
        let mut document = io::calibration_document(&result, &assessment, time_s);
        let mut models = Vec::new();
        if self.arguments.folds > 0 {
            (document["models"], models) = self.models(&result, output)?;
        }
        output.stage_json("calibration.json", &document)?;
        let figures = report::calibration_figures(&result, &assessment, board)?;
        stage_figures(output, &figures)?;
        let (of_result, figures) = figures
            .into_iter()
            .partition(|figure| report::OF_RESULT.contains(&figure.name.as_str()));
        self.figures = of_result;
        let (residuals, figures): (Vec<_>, Vec<_>) = figures
            .into_iter()
            .partition(|figure| report::OF_RESIDUALS.contains(&figure.name.as_str()));
        let residuals = residuals.into_iter().map(Part::Figure).collect();
        self.sections.push((RESIDUALS, Section::new("Residuals", residuals)));
        let mut section = report::calibration_section("Calibration", &result, &assessment, figures);
        section.parts.extend(models);
        self.sections.push((CALIBRATION, section));
        Ok((result, assessment))
    }

    /// Calibrates with corners alone, for comparison.
    fn corners(&mut self, observed: &Observed, output: &mut OutputFolder) -> Result<Calibration> {
        let begun = Instant::now();
        let options = self.options.of_corners_only();
        let board = &self.shoot.board;
        let Observed { start, observations } = observed;
        let result = calibrate(start, board, observations, &options, &mut |_| true)?;
        let assessment = assess(&result, board)?;
        stage_results(output, (&result, &assessment), false)?;
        let time_s = begun.elapsed().as_secs_f64();
        let document = io::calibration_document(&result, &assessment, time_s);
        output.stage_json("calibration.json", &document)?;
        let figures = report::calibration_figures(&result, &assessment, board)?;
        stage_figures(output, &figures)?;
        if !result.converged {
            let finding = Finding::note(Issue::NotConverged);
            tell([&finding.about(Subject::Part(CORNERS.to_owned()))]);
        }
        let section = report::calibration_section("Corners only", &result, &assessment, figures);
        self.sections.push((CORNERS_ONLY, section));
        Ok(result)
    }

    /// Compares models without groups of parameters, for the document and the report. With too few frames, the report has a
    /// sentence instead.
    fn models(
        &self,
        calibration: &Calibration,
        output: &mut OutputFolder,
    ) -> Result<(Value, Vec<Part>)> {
        let Arguments { folds, json, .. } = *self.arguments;
        let comparison = match compared(calibration, &self.shoot.board, folds, json) {
            Ok(comparison) => comparison,
            Err(error) => {
                return Ok((Value::Null, vec![Part::Text(report::sentence(&error.to_string()))]));
            }
        };
        let figures = report::model_figures(calibration, &comparison);
        stage_figures(output, &figures.concat())?;
        let parts = report::models_parts(calibration, &comparison, figures);
        Ok((io::models_document(&comparison), parts))
    }

    fn evaluation(
        &mut self,
        observed: &Observed,
        calibrations: &[&Calibration],
        boards: &[(Subset, DetectedBoards)],
        output: &mut OutputFolder,
    ) -> Result<(Value, Evaluation)> {
        let own = if self.has_blur() { BLUR_AWARE } else { CORNERS };
        let names = [own, CORNERS].into_iter();
        let candidates: Vec<Candidate> = names.zip(calibrations).map(candidate).collect();
        let Observed { start, observations } = observed;
        let initial = initial_from(start, &self.shoot.board, observations, &self.options)?;
        let features = |of: Subset| {
            boards.iter().find(|(subset, _)| *subset == of).map(|(_, found)| found.features())
        };
        let step_mm = self.shoot.images.translation.as_ref().map(|t| t.step_mm);
        let mut input = EvaluationInput::new(self.shoot.board);
        input.evaluation = features(Subset::Evaluation).unwrap_or_default();
        input.translation = features(Subset::Translation).zip(step_mm);
        input.clouds_mm = clouds(self.shoot)?;
        if let Some(truth) = &self.project.truth {
            let poses = |path: &Option<PathBuf>| path.as_deref().map(io::read_poses).transpose();
            input.truth = Some(calibrated(&truth.camera)?);
            input.true_board = truth.board.as_deref().map(io::read_true_board).transpose()?;
            let shifted = boards
                .iter()
                .find(|(subset, _)| *subset == Subset::Evaluation)
                .map(|(_, found)| found.shifted_frames())
                .unwrap_or_default();
            let mut known = poses(&truth.evaluation_poses)?;
            if let Some(poses) = &mut known {
                poses.retain(|pose| !shifted.contains(&pose.frame));
            }
            input.evaluation_poses = known;
            if let Some(truth) = poses(&truth.calibration_poses)? {
                // The true numbers of the corners of the others are not known.
                let is_known =
                    |pose: &FramePose| !observations.shifted_frames.contains(&pose.frame);
                let found = calibrations[0].poses.iter().copied().filter(is_known).collect();
                let name = "calibration".to_owned();
                input.poses.push(PosePairs { name, truth, found });
            }
        }
        let excluded = &self.options.exclude_frames;
        let frames = observations.frames().iter().filter(|f| !excluded.contains(f)).count();
        // The first camera is calibrated with these options and observations.
        let options = self.options.with_decision(candidates[0].shape_std_devs);
        let count = self.arguments.folds.min(frames);
        input.folds = (count > 1).then(|| Folds {
            start: start.clone(),
            observations: observations.clone(),
            options,
            count,
        });
        let found = evaluated(&candidates, &input, self.arguments.json);
        let document = json!(io::evaluation_document(&found));
        output.stage_json("evaluation.json", &document)?;
        tell(&found.findings);
        // The verdict concerns the first camera only.
        let of_second = |finding: &Finding| {
            let second = candidates.get(1).map(|candidate| format!("{},", candidate.name));
            matches!((&finding.subject, second), (Subject::Part(part), Some(second)) if part.starts_with(&second))
        };
        self.findings.extend(found.findings.iter().filter(|f| !of_second(f)).cloned());
        let cameras = report::cameras_table(&initial, &candidates);
        let section = report::evaluation_section(&found, &candidates, vec![cameras]);
        self.sections.push((EVALUATION, section));
        Ok((document, found))
    }

    /// Renames all files to their final names, prints the result, and returns the exit status.
    fn finish(
        mut self,
        (measured, found): (&Precalibration, &[(Subset, DetectedBoards)]),
        (calibration, assessment): (&Calibration, &Assessment),
        evaluation: Option<(Value, Evaluation)>,
    ) -> Result<ExitCode> {
        let changed = self
            .manifest
            .changed_inputs()
            .into_iter()
            .map(|path| Finding::caution(Issue::FileChanged).about(Subject::File(path)));
        let changed: Vec<Finding> = changed.collect();
        tell(&changed);
        self.findings.extend(changed);
        plenocal::finding::sort(&mut self.findings);
        let (document_of_evaluation, evaluation) = evaluation.unzip();
        let section = report::result_section(
            calibration,
            assessment,
            &self.findings,
            evaluation.as_ref(),
            &self.figures,
        );
        let of_findings = Verdict::of(&self.findings);
        let document = json!({
            "verdict": of_findings.to_string(),
            "reasons": self.findings.iter().filter(|f| f.severity > Severity::Note).collect::<Vec<_>>(),
            "notes": self.findings.iter().filter(|f| f.severity == Severity::Note).collect::<Vec<_>>(),
        });
        let text = self.printed(&section);
        if !self.arguments.no_pictures {
            let pictures =
                self.pictures(measured, found, (calibration, assessment), evaluation.as_ref())?;
            self.sections.insert(0, (PICTURES, Section::new("Images", vec![pictures])));
        }
        let time_s = self.begun.elapsed().as_secs_f64();
        let report = self.report(section, time_s);
        self.output.stage(REPORT, |out| out.write_all(report.to_html().as_bytes()))?;
        let certificate = self.certificate(calibration, assessment);
        self.output.stage(CERTIFICATE, |out| out.write_all(certificate.to_html().as_bytes()))?;
        self.output.stage_json(VERDICT, &document)?;
        // Replaces the file of the calibration stage, whose verdict does not include the other stages.
        let judged = Assessment {
            verdict: of_findings,
            findings: self.findings.clone(),
            ..assessment.clone()
        };
        let camera = io::calibrated_camera_document(calibration, &judged);
        self.output.stage_json(Path::new(CALIBRATION).join("camera.json"), &camera)?;
        self.output.stage_json(MANIFEST, &self.manifest)?;
        let out = &self.arguments.out;
        let before = Manifest::read(out);
        let written = self.output.commit()?;
        if let Some(before) = before {
            before.remove_stale(out, &written);
        }
        progress::end();
        let path = out.join(REPORT);
        let result = json!({
            "report": path.display().to_string(),
            "verdict": document,
            "calibration": io::calibration_document(calibration, assessment, time_s),
            "evaluation": document_of_evaluation,
        });
        print_result(self.arguments.json, &result, &text, &[path])?;
        Ok(status(calibration, &self.findings))
    }

    /// Formats the printed result, with all tables of calibration and evaluation if they are requested.
    fn printed(&self, result: &Section) -> String {
        let of_stage = |(stage, section): &(&str, Section)| {
            (tables_are_shown() && [CALIBRATION, EVALUATION].contains(stage))
                .then(|| section.to_text())
        };
        let tables = self.sections.iter().filter_map(of_stage);
        std::iter::once(shown(result)).chain(tables).collect::<Vec<_>>().join("\n\n")
    }

    /// Returns the images of the run with what was found in them.
    fn pictures(
        &self,
        measured: &Precalibration,
        found: &[(Subset, DetectedBoards)],
        (calibration, assessment): (&Calibration, &Assessment),
        evaluation: Option<&Evaluation>,
    ) -> Result<Part> {
        let of_evaluation = evaluation
            .and_then(|evaluation| evaluation.candidates.first()?.evaluation.as_ref())
            .map_or(&[][..], |posed| &posed.reprojection.features);
        let shown = found.iter().zip(&self.boards).map(|((subset, found), (_, photographs))| {
            let is_calibration = *subset == Subset::Calibration;
            let mut findings = found.findings.clone();
            if is_calibration {
                findings.extend(assessment.findings.iter().cloned());
            }
            ShownBoards {
                subset: *subset,
                found,
                photographs,
                residuals: match subset {
                    Subset::Calibration => &calibration.reprojection.features,
                    Subset::Evaluation => of_evaluation,
                    Subset::Translation => &[],
                },
                findings,
                outlying: if is_calibration { &assessment.outliers.features } else { &[] },
            }
        });
        let whites = ShownWhites { result: measured, photographs: &self.whites };
        pictures_of(self.shoot, &shown.collect::<Vec<_>>(), &whites, &self.arguments.out)
    }

    /// Returns the name of the camera: that of the folder of the project.
    fn camera(&self) -> String {
        let project = &self.arguments.project;
        let camera = project.parent().and_then(Path::file_name).unwrap_or_default();
        if camera.is_empty() {
            project.display().to_string()
        } else {
            camera.to_string_lossy().into_owned()
        }
    }

    /// Returns date and version.
    fn subtitle(&self) -> String {
        let date = httpdate::fmt_http_date(SystemTime::now());
        format!("{date} · plenocal {}", self.manifest.plenocal)
    }

    /// Creates the report: the result first, then the answers of the stages to each question.
    fn report(&self, result: Section, time_s: f64) -> Report {
        let answering = |question: Question| {
            let of_question = move |(stage, _): &&(&str, Section)| question_of(stage) == question;
            let sections = self.sections.iter().filter(of_question);
            sections.map(move |(_, section)| section.clone().answering(question))
        };
        let result = Section { question: Some(Question::Trust), ..result };
        let rest = Question::ALL.into_iter().flat_map(answering);
        let overview = self.overview(time_s).answering(Question::Parameters);
        Report {
            title: format!("Calibration of {}", self.camera()),
            subtitle: self.subtitle(),
            sections: std::iter::once(result).chain(rest).chain([overview]).collect(),
        }
    }

    /// Creates the certificate.
    fn certificate(&self, calibration: &Calibration, assessment: &Assessment) -> Report {
        let images = &self.shoot.images;
        let of = |name: &str, files: Vec<&Path>| {
            (name.to_owned(), files.len(), self.manifest.hash_of(files.iter().copied()))
        };
        let whites = images.whites.iter().map(|white| white.image.as_path()).collect();
        let boards = images.calibration.iter().map(PathBuf::as_path).collect();
        let section = report::certificate_section(&Certified {
            camera: &self.camera(),
            sheet: &self.shoot.sheet,
            board: &self.shoot.board,
            images: &[of("White images", whites), of("Images of the board", boards)],
            calibration,
            assessment,
            findings: &self.findings,
        });
        Report {
            title: format!("Certificate of calibration of {}", self.camera()),
            subtitle: self.subtitle(),
            sections: vec![section],
        }
    }

    fn overview(&self, time_s: f64) -> Section {
        let columns = [Column::text("Stage"), Column::of("Time", "s"), Column::number("Files")];
        let mut table = Table::new("Stages", columns);
        for StageRecord { name, time_s, files } in &self.manifest.stages {
            table.push([name.as_str().into(), Cell::fixed(*time_s, 2), files.len().into()]);
        }
        let text = format!(
            "Project {}, {} files read; this run took {time_s:.1} s. manifest.json has their hashes.",
            self.arguments.project.display(),
            self.manifest.inputs.len()
        );
        Section::new("Overview", vec![Part::Table(table), Part::Text(text)])
    }
}

/// Returns the question that the section of a stage answers.
fn question_of(stage: &str) -> Question {
    match stage {
        EVALUATION => Question::Trust,
        RESIDUALS => Question::Where,
        CALIBRATION | CORNERS_ONLY => Question::Parameters,
        _ => Question::Images,
    }
}

/// Puts a finding about a white image before an error of the boards: with a wrong white image, no board is found.
fn because_of_white_image(error: Error, findings: &[Finding]) -> Error {
    let not_white = |finding: &&Finding| {
        matches!(finding.issue, Issue::NotWhite { .. } | Issue::IrregularArray { .. })
    };
    match (findings.iter().find(not_white), &error) {
        (_, Error::Write { .. }) | (None, _) => error,
        (Some(finding), _) => {
            Error::invalid(format!("{finding}. With this white image there is no result: {error}"))
        }
    }
}

/// Creates a candidate of the evaluation from a calibration.
fn candidate((name, calibration): (&str, &&Calibration)) -> Candidate {
    let Calibration { camera, uncertainty, board, .. } = *calibration;
    Candidate {
        name: name.to_owned(),
        std_devs: uncertainty.intrinsic_std_devs(camera.lens_types()),
        board_shape: board.bent.shape,
        shape_std_devs: board.std_devs,
        camera: camera.clone(),
    }
}

fn stage_figures(output: &mut OutputFolder, figures: &[Figure]) -> Result<()> {
    figures.iter().try_for_each(|figure| {
        output.stage(&figure.name, |out| out.write_all(figure.svg.as_bytes()))
    })
}

/// Returns the calibration options of a project; an error if they ask for poses only.
fn calibration_options(path: &Path, project: &Project) -> Result<CalibrationOptions> {
    if project.calibration.mode == Mode::PosesOnly {
        return Err(Error::invalid(
            "[calibration] states mode = \"poses-only\", but a run calibrates: leave it out, or \
             use `plenocal extrinsics`",
        )
        .in_file(path));
    }
    Ok(project.calibration.clone())
}
