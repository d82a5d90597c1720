//! `plenocal evaluate`: evaluates a camera on boards that were not used in its calibration.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::Args;
use plenocal::assessment::{
    Candidate, DistanceCheck, Evaluation, EvaluationInput, Folds, check_camera, evaluate,
    foldable_frames,
};
use plenocal::detection::DepthEstimator;
use plenocal::io::{self, CameraSource, OutputFolder, Project};
use plenocal::model::{BapFeature, Board, PlenopticCamera, Subset};
use plenocal::{Error, Finding, Result, Subject, report};

use super::boards::{self, Options, Shoot, images_of};
use super::input::{Files, Input, board_shape, camera_findings, camera_source};
use super::messages::{print_result, shown, tell, verdict_status};
use super::progress;

/// Evaluate a camera on boards not used in its calibration, on known displacements, against the truth, and by cross-validation.
///
/// The project supplies the boards of `evaluation` and `translation` (with the steps, and point clouds of the same displacement
/// from other software), and the true camera of [truth]. Parts that it does not list are not evaluated.
#[derive(Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// Project file (TOML) with the camera, [board] and [images].
    project: PathBuf,
    #[arg(long, value_name = "DIR", help = results_help!("evaluation.json, and the features of each subset in its own folder"))]
    out: PathBuf,
    /// Calibrated camera (camera.json, COMPOTE's intrinsics.js); may be repeated to compare cameras.
    #[arg(long, value_name = "FILE", required = true)]
    camera: Vec<PathBuf>,
    /// Folder written by `plenocal precalibrate`.
    #[arg(long, value_name = "DIR")]
    precalibration: PathBuf,
    /// Estimator of the virtual depth of a corner.
    #[arg(long, default_value = "line")]
    estimator: DepthEstimator,
    /// File calibration.json of the calibration that estimated the shape of the boards. By default each camera uses the
    /// calibration.json beside it if the board is the same; otherwise the board is flat.
    #[arg(long, value_name = "FILE")]
    board_shape: Option<PathBuf>,
    /// True camera, instead of the one in [truth].
    #[arg(long, value_name = "FILE")]
    truth: Option<PathBuf>,
    /// Number of folds: calibrate once without the frames of each fold, and reproject these.
    #[arg(long, value_name = "K", requires = "features")]
    folds: Option<usize>,
    /// Features of the calibration boards, for --folds.
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

/// Reads a calibrated camera with its standard deviations, if its file has them, and the shape of the board.
pub fn read_candidate(
    name: &str,
    path: &Path,
    board: &Board,
    shape: Option<&Path>,
) -> Result<Candidate> {
    let camera = calibrated(path)?;
    let std_devs = io::read_std_devs(path, camera.lens_types())?;
    let (board_shape, shape_std_devs) = board_shape(shape, Some(path), board)?.unwrap_or_default();
    Ok(Candidate { name: name.to_owned(), camera, std_devs, board_shape, shape_std_devs })
}

/// Reads a calibrated camera; for a folder, an error names the cameras in it.
pub fn calibrated(path: &Path) -> Result<PlenopticCamera> {
    if path.is_dir() {
        return Err(is_folder(path, &io::cameras_in(path)));
    }
    match camera_source(path)? {
        CameraSource::Camera(camera) => Ok(*camera),
        CameraSource::Datasheet(_) => Err(Error::invalid(
            "this is the datasheet of a camera: give a calibrated one (camera.json or \
             intrinsics.js)",
        )
        .in_file(path)),
    }
}

fn is_folder(path: &Path, cameras: &[PathBuf]) -> Error {
    let cameras: Vec<String> = cameras.iter().map(|path| path.display().to_string()).collect();
    let instead = if cameras.is_empty() {
        "it contains no calibrated camera: give camera.json or intrinsics.js".to_owned()
    } else {
        format!("give a camera: {}", cameras.join(" or "))
    };
    Error::invalid(format!("it is a folder: {instead}")).in_file(path)
}

/// Creates a check that counts points or rays far from the boards of the calibration; `None` if these distances are unknown.
pub fn distance_check(camera: &Path) -> Result<Option<DistanceCheck>> {
    Ok(io::read_board_distances(camera)?.map(DistanceCheck::new))
}

/// Reads the distances of the point clouds of a project, by frame.
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
    tell(&io::doubtful_files(&shoot.images, &shoot.reader));
    let shape = arguments.board_shape.as_deref();
    let candidates = candidates(&arguments.camera, &shoot.board, shape)?;
    let (micro_images, internal) = shoot.read_precalibration(&arguments.precalibration)?;
    let mut of_cameras = Vec::new();
    for (candidate, path) in candidates.iter().zip(&arguments.camera) {
        let found = check_camera(&candidate.camera, &shoot.sheet, &micro_images.grid, &internal)
            .map_err(|e| e.in_file(path))?;
        let about = |finding: Finding| finding.about(Subject::File(path.clone()));
        let found: Vec<Finding> = found.into_iter().map(about).collect();
        tell(&found);
        of_cameras.extend(found);
        // Already reported when the camera was read.
        of_cameras.extend(camera_findings(path)?);
    }
    let folds = match (arguments.folds, &arguments.features) {
        (Some(count), Some(features)) => {
            let files = Files {
                project: Some(path),
                camera: None,
                params: Some(&arguments.precalibration.join("precalibration.json")),
                scene: None,
                centers: Some(&arguments.precalibration.join("centers.csv")),
                features: Some(features),
                board_shape: None,
                evaluates: false,
            };
            let Input { start, observations, options, .. } =
                Input::read(&files, &project, project.calibration.clone())?;
            // Impossible folds are reported before the work, not after it.
            foldable_frames(&observations, &options, count)?;
            Some(Folds { start, observations, options, count })
        }
        _ => None,
    };
    let mut found = |subset: Subset| -> Result<(Vec<BapFeature>, BTreeSet<u32>)> {
        if images_of(subset, &shoot.images).is_empty() {
            return Ok((Vec::new(), BTreeSet::new()));
        }
        let options = Options {
            subset,
            estimator: arguments.estimator,
            pictures: false,
            quiet: arguments.json,
            for_poses: false,
        };
        let mut of_subset = OutputFolder::new(&arguments.out.join(subset.name()))?;
        let (found, _) =
            boards::detect_subset(path, &shoot, &micro_images, options, &mut of_subset)?;
        tell(&found.findings);
        output.take(of_subset);
        Ok((found.features(), found.shifted_frames()))
    };
    let (evaluation, shifted) = found(Subset::Evaluation)?;
    let (translation, _) = found(Subset::Translation)?;
    let step_mm = shoot.images.translation.as_ref().map(|t| t.step_mm);
    let true_camera = arguments.truth.as_deref();
    let true_camera = true_camera.or(project.truth.as_ref().map(|t| t.camera.as_path()));
    let true_board = project.truth.as_ref().and_then(|t| t.board.as_deref());
    let true_poses = project.truth.as_ref().and_then(|t| t.evaluation_poses.as_deref());
    let mut true_poses = true_poses.map(io::read_poses).transpose()?;
    // The true numbers of their corners are not known.
    if let Some(poses) = &mut true_poses {
        poses.retain(|pose| !shifted.contains(&pose.frame));
    }
    let input = EvaluationInput {
        board: shoot.board,
        evaluation,
        translation: step_mm.filter(|_| !translation.is_empty()).map(|step| (translation, step)),
        clouds_mm: clouds(&shoot)?,
        truth: true_camera.map(calibrated).transpose()?,
        true_board: true_board.map(io::read_true_board).transpose()?,
        poses: Vec::new(),
        evaluation_poses: true_poses,
        folds,
    };
    let mut evaluation = evaluated(&candidates, &input, arguments.json);
    let section = report::evaluation_section(&evaluation, &candidates, Vec::new());
    if section.parts.is_empty() {
        let failed: Vec<String> = evaluation.findings.iter().map(ToString::to_string).collect();
        let reason = if failed.is_empty() {
            "there is nothing to evaluate: list boards under evaluation or [images.translation], \
             give a true camera, or --folds"
                .to_owned()
        } else {
            format!("nothing could be evaluated:\n  {}", failed.join("\n  "))
        };
        return Err(Error::invalid(reason).in_file(path));
    }
    tell(&evaluation.findings);
    evaluation.findings.splice(0..0, of_cameras);
    let document = io::evaluation_document(&evaluation);
    output.stage_json("evaluation.json", &document)?;
    let paths = output.commit()?;
    print_result(arguments.json, &document, &shown(&section), &paths)?;
    Ok(verdict_status(&evaluation.findings).unwrap_or(ExitCode::SUCCESS))
}

/// Evaluates cameras, with a progress bar for the folds.
pub fn evaluated(candidates: &[Candidate], input: &EvaluationInput, quiet: bool) -> Evaluation {
    let folds = input.folds.as_ref().map_or(0, |folds| folds.count);
    let bar = progress::steps(quiet || folds == 0, folds, "calibrating without some frames");
    let evaluation = evaluate(candidates, input, &|| bar.inc());
    bar.finish();
    evaluation
}

/// Reads cameras, named after their files or, if the file names are equal, after their folders.
fn candidates(paths: &[PathBuf], board: &Board, shape: Option<&Path>) -> Result<Vec<Candidate>> {
    let stem = |path: &Path| path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let alike = |path: &Path| paths.iter().filter(|other| stem(other) == stem(path)).count() > 1;
    let name = |path: &Path| match path.parent() {
        Some(folder) if alike(path) && !folder.as_os_str().is_empty() => stem(folder),
        _ => stem(path),
    };
    paths.iter().map(|path| read_candidate(&name(path), path, board, shape)).collect()
}
