//! `plenocal evaluate`: a camera on boards that it was not calibrated with.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::Args;
use indicatif::ProgressBar;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use plenocal::calibration::{CalibrationOptions, Start};
use plenocal::evaluation::{
    Candidate, EvaluationInput, PoseErrors, cross_validate, evaluate, foldable_frames, pose_errors,
};
use plenocal::io::{self, CameraSource, OutputFolder, Project};
use plenocal::model::{BapFeature, Board, FramePose, Observations, PlenopticCamera};
use plenocal::report::{self, HtmlTable};
use plenocal::{Error, Result};
use serde_json::Value;

use super::boards::{self, Estimator, Look, Shoot, Subset};
use super::input::{Files, Input};
use super::precalibrate::progress_bar;
use super::warn;

/// Evaluate a camera: on boards that it was not calibrated with, on known motions, against the truth, and
/// by leaving frames out.
///
/// Of a project it takes the boards of `evaluation` and `translation` (with the steps, and point clouds
/// of the same motion by other software), and the true camera of [truth]. What the project does not have
/// is not evaluated.
#[derive(Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// Project file (TOML) with the camera, [board] and [images].
    project: PathBuf,
    /// Folder for the results: evaluation.json, and the features of the boards in folders of their own.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Calibrated camera (camera.json, COMPOTE's intrinsics.js); several are set side by side.
    #[arg(long, value_name = "FILE", required = true)]
    camera: Vec<PathBuf>,
    /// Folder that `plenocal precalibrate` has written.
    #[arg(long, value_name = "DIR")]
    precalibration: PathBuf,
    /// How the virtual depth of a corner is taken.
    #[arg(long, value_enum, default_value = "line")]
    estimator: Estimator,
    /// The true camera, instead of that of [truth].
    #[arg(long, value_name = "FILE")]
    truth: Option<PathBuf>,
    /// Calibrate again as often as this, each time without some frames, and reproject these.
    #[arg(long, value_name = "K", requires = "features")]
    folds: Option<usize>,
    /// Features of the boards to calibrate with, for --folds.
    #[arg(long, value_name = "FILE", requires = "folds")]
    features: Option<PathBuf>,
    /// Print the result as one JSON object instead of tables.
    #[arg(long)]
    json: bool,
}

const EXAMPLES: &str = "\
Examples:
  plenocal evaluate project.toml --camera results/camera.json \\
      --precalibration results --out evaluation
  plenocal evaluate project.toml --camera results/camera.json --precalibration results \\
      --folds 5 --features results/features.csv --out evaluation";

/// What is evaluated, read.
pub struct Subjects {
    pub board: Board,
    pub candidates: Vec<Candidate>,
    pub evaluation: Vec<BapFeature>,
    pub translation: Option<(Vec<BapFeature>, f64)>,
    pub clouds_mm: Vec<(u32, f64)>,
    pub truth: Option<PlenopticCamera>,
    /// By subset: true poses and those found.
    pub poses: Vec<(String, Vec<FramePose>, Vec<FramePose>)>,
    /// Of the poses of the boards of `evaluation`.
    pub evaluation_poses: Option<Vec<FramePose>>,
    pub folds: Option<Folds>,
}

/// A cross-validation.
pub struct Folds {
    pub start: Start,
    pub observations: Observations,
    pub options: CalibrationOptions,
    pub count: usize,
}

/// What was found, for people and for machines.
pub struct Assessment {
    pub tables: Vec<HtmlTable>,
    pub document: Value,
    /// What could not be evaluated.
    pub problems: Vec<String>,
}

impl Subjects {
    /// Evaluates all there is.
    pub fn assess(&self, quiet: bool) -> Assessment {
        let input = EvaluationInput {
            board: &self.board,
            evaluation: &self.evaluation,
            translation: self.translation.as_ref().map(|(features, step)| (&features[..], *step)),
            clouds_mm: &self.clouds_mm,
            truth: self.truth.as_ref(),
        };
        let mut evaluation = evaluate(&self.candidates, &input);
        let mut tables = report::evaluation_tables(&evaluation);
        let turned = half_turn(&self.board);
        let mut poses: Vec<(String, PoseErrors)> = self
            .poses
            .iter()
            .filter_map(|(name, truth, found)| {
                Some((name.clone(), pose_errors(truth, found, &turned)?))
            })
            .collect();
        let first = evaluation.candidates.first().and_then(|c| c.evaluation.as_ref());
        if let (Some(truth), Some(found)) = (&self.evaluation_poses, first) {
            let errors = pose_errors(truth, &found.poses, &turned);
            poses.extend(errors.map(|errors| ("evaluation".to_owned(), errors)));
        }
        if !poses.is_empty() {
            tables.push(report::pose_errors_table(&poses));
        }
        let folds = self.folds.as_ref().map(|folds| {
            let bar = progress_bar(quiet, folds.count, "calibrating without some frames");
            let result = folds.validate(&self.board, &bar);
            bar.finish_and_clear();
            result.map_err(|error| evaluation.problems.push(format!("cross-validation: {error}")))
        });
        let folds = folds.and_then(std::result::Result::ok);
        if let (Some(folds), Some(candidate)) = (&folds, self.candidates.first()) {
            tables.extend(report::folds_tables(folds, candidate));
        }
        let document = report::evaluation_json(&evaluation, &poses, folds.as_ref());
        Assessment { tables, document, problems: evaluation.problems }
    }
}

impl Folds {
    fn validate(
        &self,
        board: &Board,
        bar: &ProgressBar,
    ) -> Result<plenocal::evaluation::CrossValidation> {
        let Self { start, observations, options, count } = self;
        cross_validate(start, board, observations, options, *count, &|| bar.inc(1))
    }
}

/// From the frame of a board to that of the same board turned by half.
fn half_turn(board: &Board) -> Isometry3<f64> {
    let last = board.point_mm(board.corners() - 1);
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::PI);
    Isometry3::from_parts(Translation3::new(last.x, last.y, 0.0), turn)
}

/// Reads a calibrated camera with its standard deviations, if its file has them.
pub fn read_candidate(name: &str, path: &Path) -> Result<Candidate> {
    let camera = calibrated(path)?;
    // COMPOTE's files have none.
    let std_devs = io::read_std_devs(path, camera.lens_types()).unwrap_or_default();
    Ok(Candidate { name: name.to_owned(), camera, std_devs })
}

/// Reads a calibrated camera.
pub fn calibrated(path: &Path) -> Result<PlenopticCamera> {
    match io::read_camera_source(path)? {
        CameraSource::Camera(camera) => Ok(*camera),
        CameraSource::Datasheet(_) => Err(Error::Invalid(
            "this is the data sheet of a camera: give a calibrated one (camera.json or \
             intrinsics.js)"
                .to_owned(),
        )
        .in_file(path)),
    }
}

/// Distances of the point clouds of a project, by frame.
pub fn clouds(shoot: &Shoot) -> Result<Vec<(u32, f64)>> {
    let clouds = shoot.images.translation.iter().flat_map(|t| &t.clouds);
    (0..).zip(clouds).map(|(i, path)| Ok((i, io::read_point_cloud_distance(path)?))).collect()
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<ExitCode> {
    let path = &arguments.project;
    let mut output = OutputFolder::new(&arguments.out)?;
    let project = Project::read(path)?;
    let shoot = Shoot::of(path, &project)?;
    let candidates = candidates(&arguments.camera)?;
    let micro_images = shoot.read_precalibration(&arguments.precalibration)?;
    let folds = match (arguments.folds, &arguments.features) {
        (Some(count), Some(features)) => {
            let files = Files {
                project: Some(path),
                camera: None,
                params: Some(&arguments.precalibration.join("precalibration.json")),
                scene: None,
                centers: Some(&arguments.precalibration.join("centers.csv")),
                features: Some(features),
            };
            let Input { start, observations, options, .. } =
                Input::read(&files, io::CalibrationSection::default())?;
            // What is asked for and cannot be is told before the work.
            foldable_frames(&observations, &options, count)?;
            Some(Folds { start, observations, options, count })
        }
        _ => None,
    };
    let mut found = |subset: Subset| -> Result<Vec<BapFeature>> {
        if subset.images(&shoot.images).is_empty() {
            return Ok(Vec::new());
        }
        let look =
            Look { subset, estimator: arguments.estimator, pictures: false, quiet: arguments.json };
        let mut of_subset = OutputFolder::new(&arguments.out.join(subset.name()))?;
        let found = boards::detect(path, &shoot, &micro_images, look, &mut of_subset)?;
        warn(&found.warnings);
        output.take(of_subset);
        Ok(found.bap_features())
    };
    let evaluation = found(Subset::Evaluation)?;
    let translation = found(Subset::Translation)?;
    let step_mm = shoot.images.translation.as_ref().map(|t| t.step_mm);
    let true_camera = arguments.truth.as_deref();
    let true_camera = true_camera.or(project.truth.as_ref().map(|t| t.camera.as_path()));
    let true_poses = project.truth.as_ref().and_then(|t| t.evaluation_poses.as_deref());
    let subjects = Subjects {
        board: shoot.board,
        candidates,
        evaluation,
        translation: step_mm.filter(|_| !translation.is_empty()).map(|step| (translation, step)),
        clouds_mm: clouds(&shoot)?,
        truth: true_camera.map(calibrated).transpose()?,
        poses: Vec::new(),
        evaluation_poses: true_poses.map(io::read_poses).transpose()?,
        folds,
    };
    let assessment = subjects.assess(arguments.json);
    warn(&assessment.problems);
    if assessment.tables.is_empty() {
        return Err(Error::Invalid(
            "there is nothing to evaluate with: list boards under evaluation or \
             [images.translation], give a true camera, or --folds"
                .to_owned(),
        )
        .in_file(path));
    }
    output.stage_json("evaluation.json", &assessment.document)?;
    let paths = output.commit()?;
    let text = if arguments.json {
        format!("{}\n", assessment.document)
    } else {
        let tables: Vec<String> =
            assessment.tables.iter().map(|table| format!("{table}\n\n")).collect();
        let files: Vec<String> = paths.iter().map(|p| format!("  {}\n", p.display())).collect();
        format!("{}Written:\n{}", tables.concat(), files.concat())
    };
    let _ = std::io::stdout().write_all(text.as_bytes());
    Ok(ExitCode::SUCCESS)
}

/// Cameras by the names of their files, or where these are alike of their folders.
fn candidates(paths: &[PathBuf]) -> Result<Vec<Candidate>> {
    let stem = |path: &Path| path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let alike = |path: &Path| paths.iter().filter(|other| stem(other) == stem(path)).count() > 1;
    let name = |path: &Path| match path.parent() {
        Some(folder) if alike(path) && !folder.as_os_str().is_empty() => stem(folder),
        _ => stem(path),
    };
    paths.iter().map(|path| read_candidate(&name(path), path)).collect()
}
