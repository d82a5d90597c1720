//! `plenocal detect`: finds BAP features in images of a board.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;
use plenocal::detection::{DepthEstimator, MicroImages};
use plenocal::io::{self, OutputFolder, Project};
use plenocal::model::Subset;
use plenocal::precalibration::PrecalibrationOptions;
use plenocal::{Result, report};

use super::boards::{self, Options, Shoot};
use super::messages::{print_result, shown, tell};
use super::precalibrate::{measure, stage_centers};

/// Detect the corners of a checkerboard in raw images automatically.
///
/// The output lists for each frame what was found, what was dropped, and why. A frame without a recognised board is left out;
/// the others are still used.
#[derive(Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// Project file (TOML) with the camera, [board] and [images].
    project: PathBuf,
    #[arg(long, value_name = "DIR", help = results_help!("features.csv, detection.json and a picture of every frame; without --precalibration also centers.csv and precalibration.json"))]
    out: PathBuf,
    /// Folder written by `plenocal precalibrate`; without it, the white images of the project are measured first.
    #[arg(long, value_name = "DIR")]
    precalibration: Option<PathBuf>,
    /// Subset of the images of the project to search.
    #[arg(long, default_value = "calibration")]
    subset: Subset,
    /// Estimator of the virtual depth of a corner from the micro-images that show it.
    #[arg(long, default_value = "line")]
    estimator: DepthEstimator,
    /// Write no pictures.
    #[arg(long)]
    no_pictures: bool,
    /// Print the result as one JSON object instead of a table.
    #[arg(long)]
    json: bool,
}

const EXAMPLES: &str = "\
Examples:
  plenocal detect project.toml --out results
  plenocal calibrate project.toml --params results/precalibration.json \\
      --centers results/centers.csv --features results/features.csv --out results";

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<ExitCode> {
    let path = &arguments.project;
    let mut output = OutputFolder::new(&arguments.out)?;
    let shoot = Shoot::of(path, &Project::read(path)?)?;
    tell(&io::doubtful_files(&shoot.images, &shoot.reader));
    let micro_images = if let Some(folder) = &arguments.precalibration {
        shoot.read_precalibration(folder)?.0
    } else {
        let options = PrecalibrationOptions {
            black_level: shoot.reader.black_level(),
            ..PrecalibrationOptions::of_datasheet(&shoot.sheet)
        };
        let (images, reader) = (&shoot.images, &shoot.reader);
        let (measured, _) = measure(path, images, reader, &shoot.sheet, &options, arguments.json)?;
        tell(&measured.findings);
        stage_centers(&mut output, &measured)?;
        output.stage_json("precalibration.json", &io::precalibration_document(&measured))?;
        MicroImages::of_precalibration(&measured, &shoot.sheet)?
    };
    let options = Options {
        subset: arguments.subset,
        estimator: arguments.estimator,
        pictures: !arguments.no_pictures,
        quiet: arguments.json,
        for_poses: false,
    };
    let (found, _) = boards::detect_subset(path, &shoot, &micro_images, options, &mut output)?;
    tell(&found.findings);
    let paths = output.commit()?;
    let document = io::detection_document(&found, &shoot.board);
    let section = report::detection_section(arguments.subset.name(), &found);
    print_result(arguments.json, &document, &shown(&section), &paths)?;
    Ok(ExitCode::SUCCESS)
}
