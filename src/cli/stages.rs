//! The stages of a run: each reads what earlier ones have written, calls the library, and writes
//! its results.

use std::path::{Path, PathBuf};
use std::time::Instant;

use plenocal::assessment::{Candidate, EvaluationInput, Folds, PosePairs, assess};
use plenocal::calibration::{
    Calibration, CalibrationOptions, Mode, Start, calibrate, initial_from,
};
use plenocal::detection::DepthEstimator;
use plenocal::image::Color;
use plenocal::io::{self, OutputFolder, Project, TruthSection, WhiteImage};
use plenocal::model::{BapFeature, Board, Datasheet, FillFactor, Observations, Subset};
use plenocal::precalibration::PrecalibrationOptions;
use plenocal::report::{Figure, Part, Section};
use plenocal::{Result, report};
use serde::Serialize;
use serde_json::{Value, json};

use super::boards::{self, Options, Shoot, images_of};
use super::calibrate::{compared, stage_results};
use super::evaluate::{calibrated, clouds, evaluated, read_candidate};
use super::ledger::{InputFile, Ledger, VERDICT, Work};
use super::precalibrate;
use super::talk;

/// The images that the project lists, before anything is done with them.
pub const IMAGES: &str = "images";
/// Names of the stages and of their folders.
pub const PRECALIBRATION: &str = "precalibration";
pub const CALIBRATION: &str = "calibration";
pub const CORNERS_ONLY: &str = "corners-only";
pub const EVALUATION: &str = "evaluation";
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

/// A project, and the options of its run.
pub struct Stages<'a> {
    pub path: &'a Path,
    pub project: &'a Project,
    pub shoot: &'a Shoot,
    pub out: &'a Path,
    pub options: CalibrationOptions,
    pub estimator: DepthEstimator,
    pub folds: usize,
    pub pictures: bool,
    /// No progress bars.
    pub quiet: bool,
}

/// What every stage depends on besides files.
#[derive(Clone, Copy, Serialize)]
struct CameraInput<'a> {
    datasheet: &'a Datasheet,
    board: &'a Board,
    color: Color,
}

#[derive(Serialize)]
struct PrecalibrationInput<'a> {
    camera: CameraInput<'a>,
    whites: Vec<InputFile>,
    /// Their f-numbers as stated.
    f_numbers: Vec<(Option<f64>, Option<f64>)>,
    devignetting: Option<InputFile>,
    black_level: Option<f64>,
}

#[derive(Serialize)]
struct BoardsInput<'a> {
    camera: CameraInput<'a>,
    images: Vec<InputFile>,
    /// Images that are the same as earlier ones.
    repeated: Vec<Option<String>>,
    white: InputFile,
    precalibration: Vec<InputFile>,
    estimator: DepthEstimator,
    pictures: bool,
    /// That which the boards for calibration have shown, for the others.
    fill_factor: Option<FillFactor>,
}

#[derive(Serialize)]
struct CalibrationInput<'a> {
    camera: CameraInput<'a>,
    precalibration: Vec<InputFile>,
    features: InputFile,
    options: CalibrationOptions,
    /// Folds in which models are compared; 0 for no comparison.
    model_folds: usize,
}

#[derive(Serialize)]
struct EvaluationStageInput<'a> {
    calibration: CalibrationInput<'a>,
    cameras: Vec<InputFile>,
    /// Beside them, for the shape of the board.
    calibrations: Vec<InputFile>,
    poses: InputFile,
    evaluation: Option<InputFile>,
    translation: Option<InputFile>,
    clouds: Vec<InputFile>,
    step_mm: Option<f64>,
    truth: Option<TruthInput>,
    folds: usize,
}

#[derive(Serialize)]
struct TruthInput {
    camera: InputFile,
    board: Option<InputFile>,
    calibration_poses: Option<InputFile>,
    evaluation_poses: Option<InputFile>,
}

impl TruthInput {
    fn of(truth: &TruthSection, ledger: &mut Ledger) -> Self {
        Self {
            camera: ledger.file(&truth.camera),
            board: truth.board.as_ref().map(|path| ledger.file(path)),
            calibration_poses: truth.calibration_poses.as_ref().map(|path| ledger.file(path)),
            evaluation_poses: truth.evaluation_poses.as_ref().map(|path| ledger.file(path)),
        }
    }
}

impl Stages<'_> {
    fn folder(&self, stage: &str) -> PathBuf {
        self.out.join(stage)
    }

    /// Whether there is a calibration with blur, to which corners only can be compared.
    pub fn has_both(&self) -> bool {
        self.options.mode == Mode::Full && self.shoot.sheet.lens_types > 0
    }

    fn camera(&self) -> CameraInput<'_> {
        let Shoot { sheet, board, images } = self.shoot;
        CameraInput { datasheet: sheet, board, color: images.color }
    }

    pub fn precalibration(&self, ledger: &mut Ledger) -> Result<()> {
        let images = &self.shoot.images;
        let input = PrecalibrationInput {
            camera: self.camera(),
            whites: ledger.files(images.whites.iter().map(|white| &white.image)),
            f_numbers: images.whites.iter().map(|w: &WhiteImage| (w.f_number, w.stop)).collect(),
            devignetting: images.devignetting.as_ref().map(|path| ledger.file(path)),
            black_level: images.black_level,
        };
        ledger.stage(PRECALIBRATION, &input, |input, Work { output, .. }| {
            let sheet = input.camera.datasheet;
            let options = PrecalibrationOptions {
                black_level: input.black_level,
                ..PrecalibrationOptions::of_datasheet(sheet)
            };
            let (result, whites) =
                precalibrate::measure(self.path, images, sheet, &options, self.quiet)?;
            let document = io::precalibration_document(&result);
            output.stage_json("precalibration.json", &document)?;
            let figures = precalibrate::stage(output, &result, sheet, &whites)?;
            Ok(report::precalibration_section(&result, figures))
        })
    }

    /// What later stages take from the pre-calibration.
    fn measured(&self, ledger: &mut Ledger) -> Vec<InputFile> {
        let folder = self.folder(PRECALIBRATION);
        ledger.files([folder.join("precalibration.json"), folder.join("centers.csv")])
    }

    pub fn boards(&self, ledger: &mut Ledger, subset: Subset) -> Result<()> {
        let white = self.shoot.white_image().map_err(|e| e.in_file(self.path))?;
        let input = BoardsInput {
            camera: self.camera(),
            images: ledger.files(images_of(subset, &self.shoot.images)),
            repeated: self.shoot.repeated(subset),
            white: ledger.file(white),
            precalibration: self.measured(ledger),
            estimator: self.estimator,
            pictures: self.pictures,
            fill_factor: boards::known_fill_factor(
                subset,
                &self.folder(boards_stage(Subset::Calibration)),
            )?,
        };
        ledger.stage(boards_stage(subset), &input, |input, Work { output, again }| {
            let mut micro_images = self.shoot.read_precalibration(&self.folder(PRECALIBRATION))?;
            if let Some(fill_factor) = &input.fill_factor {
                micro_images = micro_images.settled_at(fill_factor);
            }
            let options = Options {
                subset,
                estimator: input.estimator,
                pictures: input.pictures,
                quiet: self.quiet,
            };
            let found =
                boards::detect_subset(self.path, self.shoot, &micro_images, options, output)?;
            *again = found.frames.iter().any(boards::may_be_readable);
            let figures = boards::figures(&found, options);
            Ok(report::detection_section(subset.name(), &found, figures))
        })
    }

    fn calibration_input(
        &self,
        ledger: &mut Ledger,
        options: CalibrationOptions,
    ) -> CalibrationInput<'_> {
        let mut options = options;
        // Results agree to rounding with any number of threads.
        options.solver.threads = 0;
        CalibrationInput {
            camera: self.camera(),
            precalibration: self.measured(ledger),
            features: ledger.file(self.features(Subset::Calibration)),
            options,
            model_folds: 0,
        }
    }

    fn features(&self, subset: Subset) -> PathBuf {
        self.folder(boards_stage(subset)).join("features.csv")
    }

    fn start(&self) -> Result<Start> {
        let sheet = &self.shoot.sheet;
        let internal = io::read_internal_parameters(
            &self.folder(PRECALIBRATION).join("precalibration.json"),
            Some(sheet.sensor.pixel_size_mm),
        )?;
        Ok(Start::Datasheet(*sheet, internal))
    }

    fn observations(&self) -> Result<Observations> {
        let mut observations = io::read_features(&self.features(Subset::Calibration), true)?;
        observations.centers = io::read_centers(&self.folder(PRECALIBRATION).join("centers.csv"))?;
        Ok(observations)
    }

    /// Calibrates in the mode of the project, or for comparison with corners only.
    pub fn calibration(&self, ledger: &mut Ledger, stage: &'static str) -> Result<()> {
        let mut options = self.options.clone();
        let title = if stage == CALIBRATION { "Calibration" } else { "Corners only" };
        if stage == CORNERS_ONLY {
            options.mode = Mode::CornersOnly;
            let known = |name: &String| !name.starts_with("f_");
            options.cost.fixed.retain(known);
            options.cost.anchors.retain(|anchor| known(&anchor.quantity));
            options.not_anchored.retain(known);
        }
        let mut input = self.calibration_input(ledger, options);
        input.model_folds = if stage == CALIBRATION { self.folds } else { 0 };
        ledger.stage(stage, &input, |input, Work { output, .. }| {
            let begun = Instant::now();
            let (start, observations) = (self.start()?, self.observations()?);
            let mut options = input.options.clone();
            options.solver.threads = self.options.solver.threads;
            let board = input.camera.board;
            let result = calibrate(&start, board, &observations, &options, &mut |_| true)?;
            let assessment = assess(&result, board)?;
            let warnings = if stage == CALIBRATION {
                result.findings.iter().map(talk::told).collect()
            } else if result.converged {
                Vec::new()
            } else {
                vec!["the calibration with corners only has not converged".to_owned()]
            };
            stage_results(output, &result, false)?;
            let time_s = begun.elapsed().as_secs_f64();
            let mut document = io::calibration_document(&result, &assessment, time_s);
            let mut models = Vec::new();
            if input.model_folds > 0 {
                (document["models"], models) =
                    self.models(&result, board, input.model_folds, output)?;
            }
            output.stage_json("calibration.json", &document)?;
            let figures = report::calibration_figures(&result, &assessment, board)?;
            stage_figures(output, &figures)?;
            output.stage_json(VERDICT, &json!(report::verdict_section(&assessment)))?;
            let mut section = report::calibration_section(title, &result, &assessment, figures);
            section.parts.extend(models);
            section.warnings = warnings;
            Ok(section)
        })
    }

    /// What groups of parameters are worth, for the document and for the report. With too few frames there is
    /// a sentence instead.
    fn models(
        &self,
        calibration: &Calibration,
        board: &Board,
        folds: usize,
        output: &mut OutputFolder,
    ) -> Result<(Value, Vec<Part>)> {
        let comparison = match compared(calibration, board, folds, self.quiet) {
            Ok(comparison) => comparison,
            Err(error) => return Ok((Value::Null, vec![Part::Text(format!("{error}."))])),
        };
        let figures = report::model_figures(calibration, &comparison);
        stage_figures(output, &figures.concat())?;
        let parts = report::models_parts(calibration, &comparison, figures);
        Ok((io::models_document(&comparison), parts))
    }

    /// Cameras of this run and their names.
    fn candidates(&self, input: &EvaluationStageInput) -> Result<Vec<Candidate>> {
        let own = if self.has_both() { BLUR_AWARE } else { CORNERS };
        let board = &self.shoot.board;
        let named =
            |(name, file): (&str, &InputFile)| read_candidate(name, &file.path, board, None);
        [own, CORNERS].into_iter().zip(&input.cameras).map(named).collect()
    }

    pub fn evaluation(&self, ledger: &mut Ledger) -> Result<()> {
        let has_corners = ledger.has(CORNERS_ONLY);
        let own = |name: &'static str| {
            let folders = [CALIBRATION, CORNERS_ONLY].map(|stage| self.folder(stage).join(name));
            folders.into_iter().take(1 + usize::from(has_corners))
        };
        let features = [Subset::Evaluation, Subset::Translation]
            .map(|subset| ledger.has(boards_stage(subset)).then(|| self.features(subset)));
        let [evaluation, translation] = features.map(|path| path.map(|path| ledger.file(path)));
        let stage = self.shoot.images.translation.as_ref();
        let input = EvaluationStageInput {
            calibration: self.calibration_input(ledger, self.options.clone()),
            cameras: ledger.files(own("camera.json")),
            calibrations: ledger.files(own("calibration.json")),
            poses: ledger.file(self.folder(CALIBRATION).join("poses.json")),
            evaluation,
            translation,
            clouds: ledger.files(stage.iter().flat_map(|t| &t.clouds)),
            step_mm: stage.map(|t| t.step_mm),
            truth: self.project.truth.as_ref().map(|truth| TruthInput::of(truth, ledger)),
            folds: self.folds,
        };
        ledger.stage(EVALUATION, &input, |input, work| self.evaluate(input, &mut work.output))
    }

    fn evaluate(&self, input: &EvaluationStageInput, output: &mut OutputFolder) -> Result<Section> {
        let features = |file: &Option<InputFile>| -> Result<Vec<BapFeature>> {
            let read = |file: &InputFile| Ok(io::read_features(&file.path, true)?.features);
            file.as_ref().map_or(Ok(Vec::new()), read)
        };
        let poses =
            |file: &Option<InputFile>| file.as_ref().map(|f| io::read_poses(&f.path)).transpose();
        let candidates = self.candidates(input)?;
        let (start, observations) = (self.start()?, self.observations()?);
        let initial = initial_from(&start, &self.shoot.board, &observations, &self.options)?;
        let translation = features(&input.translation)?;
        let mut subjects = EvaluationInput::new(self.shoot.board);
        subjects.evaluation = features(&input.evaluation)?;
        subjects.translation =
            input.step_mm.filter(|_| !translation.is_empty()).map(|step_mm| (translation, step_mm));
        subjects.clouds_mm = clouds(self.shoot)?;
        if let Some(truth) = &input.truth {
            subjects.truth = Some(calibrated(&truth.camera.path)?);
            let board = truth.board.as_ref().map(|file| io::read_true_board(&file.path));
            subjects.true_board = board.transpose()?;
            subjects.evaluation_poses = poses(&truth.evaluation_poses)?;
            if let Some(truth) = poses(&truth.calibration_poses)? {
                let (name, found) = ("calibration".to_owned(), io::read_poses(&input.poses.path)?);
                subjects.poses.push(PosePairs { name, truth, found });
            }
        }
        let excluded = &self.options.exclude_frames;
        let frames = observations.frames().iter().filter(|f| !excluded.contains(f)).count();
        // The first camera is calibrated with these options and observations.
        let options = self.options.with_decision(candidates[0].shape_std_devs);
        let count = input.folds.min(frames);
        subjects.folds = (count > 1).then_some(Folds { start, observations, options, count });
        let found = evaluated(&candidates, &subjects, self.quiet);
        output.stage_json("evaluation.json", &io::evaluation_document(&found))?;
        let mut tables = vec![report::cameras_table(&initial, &candidates)];
        tables.extend(report::evaluation_tables(&found, &candidates));
        let section = report::evaluation_section(tables);
        Ok(Section { warnings: found.findings.iter().map(talk::told).collect(), ..section })
    }
}

fn stage_figures(output: &mut OutputFolder, figures: &[Figure]) -> Result<()> {
    figures.iter().try_for_each(|figure| {
        output.stage(&figure.name, |out| out.write_all(figure.svg.as_bytes()))
    })
}
