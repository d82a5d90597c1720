//! `plenocal extrinsics`: estimates poses of boards with a calibrated camera.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;
use plenocal::assessment::{assess, check_camera};
use plenocal::calibration::{CalibrationOptions, Start, calibrate};
use plenocal::detection::DepthEstimator;
use plenocal::io::{self, OutputFolder, Project};
use plenocal::model::Subset;
use plenocal::{Result, report};

use super::boards::{self, Options, Shoot};
use super::calibrate::{stage_results, status};
use super::evaluate::calibrated;
use super::input::{board_shape, camera_findings};
use super::messages::{announce_calibration, print_result, shown, tell};

/// Find the poses of boards in raw images with a calibrated camera.
///
/// Every frame that shows the board gives camera_from_board with its standard deviations.
// Names in the help are not code.
#[allow(clippy::doc_markdown)]
#[derive(Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// Project file (TOML) with the camera, [board] and [images].
    project: PathBuf,
    #[arg(long, value_name = "DIR", help = results_help!("poses.json, residuals.csv, features.csv, detection.json"))]
    out: PathBuf,
    /// Calibrated camera (camera.json, COMPOTE's intrinsics.js).
    #[arg(long, value_name = "FILE")]
    camera: PathBuf,
    /// Folder written by `plenocal precalibrate`.
    #[arg(long, value_name = "DIR")]
    precalibration: PathBuf,
    /// File calibration.json of the calibration that estimated the shape of the board. By default it is the calibration.json
    /// beside the camera if the board is the same; otherwise the board is flat.
    #[arg(long, value_name = "FILE")]
    board_shape: Option<PathBuf>,
    /// Subset of the images of the project to search.
    #[arg(long, default_value = "evaluation")]
    subset: Subset,
    /// Estimator of the virtual depth of a corner.
    #[arg(long, default_value = "line")]
    estimator: DepthEstimator,
    /// Print the result as one JSON object instead of tables.
    #[arg(long)]
    json: bool,
}

const EXAMPLES: &str = "\
Examples:
  plenocal extrinsics project.toml --camera results/calibration/camera.json \\
      --precalibration results/precalibration --out poses
  plenocal extrinsics project.toml --subset translation --camera camera.json \\
      --precalibration white --out poses

For features that are already detected: plenocal calibrate --mode poses-only";

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<ExitCode> {
    let path = &arguments.project;
    let begun = std::time::Instant::now();
    let mut output = OutputFolder::new(&arguments.out)?;
    let shoot = Shoot::of(path, &Project::read(path)?)?;
    tell(&io::doubtful_files(&shoot.images, &shoot.reader));
    let camera = calibrated(&arguments.camera)?;
    let stated = arguments.board_shape.as_deref();
    let (shape, _) =
        board_shape(stated, Some(&arguments.camera), &shoot.board)?.unwrap_or_default();
    let (micro_images, internal) = shoot.read_precalibration(&arguments.precalibration)?;
    let of_white_images = check_camera(&camera, &shoot.sheet, &micro_images.grid, &internal)
        .map_err(|e| e.in_file(&arguments.camera))?;
    let search = Options {
        subset: arguments.subset,
        estimator: arguments.estimator,
        pictures: false,
        quiet: arguments.json,
        for_poses: true,
    };
    let (found, _) = boards::detect_subset(path, &shoot, &micro_images, search, &mut output)?;
    let observations = found.observations(Vec::new());
    announce_calibration(&observations.features);
    let options = CalibrationOptions::default().of_poses_only(shape);
    let result =
        calibrate(&Start::Camera(camera), &shoot.board, &observations, &options, &mut |_| true)?;
    let mut assessment = assess(&result, &shoot.board)?;
    tell(&of_white_images);
    assessment.add(camera_findings(&arguments.camera)?);
    assessment.add(of_white_images);
    stage_results(&mut output, (&result, &assessment), false)?;
    let paths = output.commit()?;
    tell(&found.findings);
    tell(&result.findings);
    let document = io::calibration_document(&result, &assessment, begun.elapsed().as_secs_f64());
    let section = report::calibration_section("Poses", &result, &assessment, Vec::new());
    print_result(arguments.json, &document, &shown(&section), &paths)?;
    Ok(status(&result, &assessment.findings))
}
