//! `plenocal detect`: from images of a board to BAP features.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::Args;
use plenocal::camera::{Board, Datasheet};
use plenocal::features::{
    DepthEstimator, DetectedFeature, Detection, FrameCounts, MicroImages, Search, detect_frame,
};
use plenocal::image::RawImage;
use plenocal::io::{self, ImagesSection, OutputFolder, Project};
use plenocal::observations::MIN_CORNERS;
use plenocal::precalibration::{PrecalibrationOptions, fit_grid, precalibrate};
use plenocal::{Error, Result, report};
use serde_json::json;

use super::precalibrate::{progress_bar, read_whites, stage_centers};

/// Detect the corners of a checkerboard in raw images, without a click.
///
/// Every micro-image is looked at; what was found, and what was dropped and why, is told frame by
/// frame. A frame that cannot be tied to the board is left out, and the others go on.
#[derive(Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// Project file (TOML) with the camera, [board] and [images].
    project: PathBuf,
    /// Folder for the results: features.csv, detection.json and a picture of every frame; and, without
    /// --precalibration, centers.csv and precalibration.json.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Folder that `plenocal precalibrate` has written; without it the white images of the project are
    /// measured first.
    #[arg(long, value_name = "DIR")]
    precalibration: Option<PathBuf>,
    /// Images of the project to look at.
    #[arg(long, value_enum, default_value = "calibration")]
    subset: Subset,
    /// How the virtual depth of a corner is taken from the micro-images that show it: by a line through
    /// all of them, or by the paper's median over pairs.
    #[arg(long, value_enum, default_value = "line")]
    estimator: Estimator,
    /// Write no pictures.
    #[arg(long)]
    no_pictures: bool,
    /// Print the result as one JSON object instead of a table.
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum Subset {
    Calibration,
    Evaluation,
    Translation,
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum Estimator {
    Line,
    Median,
}

const EXAMPLES: &str = "\
Examples:
  plenocal detect project.toml --out results
  plenocal calibrate project.toml --params results/precalibration.json \\
      --centers results/centers.csv --features results/features.csv --out results";

/// Boards in fewer positions say little of a camera.
const FEW_FRAMES: usize = 4;

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<ExitCode> {
    let path = &arguments.project;
    let mut output = OutputFolder::new(&arguments.out)?;
    let project = Project::read(path)?;
    let missing = |what: &str| Error::Invalid(what.to_owned()).in_file(path);
    let sheet = project.datasheet()?.ok_or_else(|| {
        missing("there is no camera in it: add [sensor], [main_lens] and [micro_lens_array]")
    })?;
    let board = project.board.ok_or_else(|| missing("there is no board in it: add [board]"))?;
    let images = project
        .images
        .as_ref()
        .ok_or_else(|| missing("it lists no images: add [images] with calibration = [...]"))?;
    sheet.validate().and_then(|()| board.validate()).map_err(|e| e.in_file(path))?;
    let frames = match arguments.subset {
        Subset::Calibration => images.calibration.as_slice(),
        Subset::Evaluation => images.evaluation.as_slice(),
        Subset::Translation => images.translation.as_ref().map_or(&[][..], |t| &t.images),
    };
    if frames.is_empty() {
        return Err(missing("[images] lists no boards of this subset"));
    }
    let white = white_image(images, &sheet).map_err(|e| e.in_file(path))?;
    let white = io::read_image(&white, Some(images.color))?;
    check_size(&white, &sheet).map_err(|e| e.in_file(path))?;
    let micro_images = match &arguments.precalibration {
        Some(folder) => read_precalibration(folder, &sheet)?,
        None => measure(path, images, &sheet, &mut output, arguments.json)?,
    };
    let estimator = match arguments.estimator {
        Estimator::Line => DepthEstimator::Line,
        Estimator::Median => DepthEstimator::Median,
    };
    let search =
        Search { micro_images: &micro_images, board: &board, sensor: &sheet.sensor, estimator };
    let found = detect(arguments, frames, images, &white, &search, &mut output)?;
    let features: Vec<DetectedFeature> = found
        .iter()
        .filter_map(|frame| frame.result.as_ref().ok())
        .flat_map(|detection| detection.features.iter().copied())
        .collect();
    report_rejected(&found, arguments.subset)?;
    warn_of_size(&found, &board);
    output.stage("features.csv", |out| io::write_detected_features(out, &features))?;
    let document = document(&found, &board);
    output.stage_json("detection.json", &document)?;
    let paths = output.commit()?;
    let text = if arguments.json {
        format!("{document}\n")
    } else {
        let rows: Vec<report::FrameRow> = found
            .iter()
            .map(|frame| report::FrameRow {
                frame: frame.number,
                image: name(&frame.path),
                counts: frame.counts,
                features: frame.result.as_ref().map_or(0, |detection| detection.features.len()),
            })
            .collect();
        let files: Vec<String> = paths.iter().map(|p| format!("  {}\n", p.display())).collect();
        format!("{}\n\nWritten:\n{}", report::detection_text(&rows), files.concat())
    };
    let _ = std::io::stdout().write_all(text.as_bytes());
    Ok(ExitCode::SUCCESS)
}

/// What came of an image.
struct Frame {
    number: u32,
    path: PathBuf,
    result: std::result::Result<Detection, String>,
    counts: FrameCounts,
}

fn name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// The white image in the light of the boards, or the one at their f-number.
fn white_image(images: &ImagesSection, sheet: &Datasheet) -> Result<PathBuf> {
    const SAME_STOP: f64 = 0.02;
    if let Some(path) = &images.devignetting {
        return Ok(path.clone());
    }
    for white in &images.whites {
        if (white.f_number()? / sheet.f_number - 1.0).abs() < SAME_STOP {
            return Ok(white.image.clone());
        }
    }
    Err(Error::Invalid(format!(
        "there is no white image at f/{:.2}, the f-number of the boards: add devignetting = \"...\" to \
         [images]",
        sheet.f_number
    )))
}

fn check_size(raw: &RawImage, sheet: &Datasheet) -> Result<()> {
    let (width, height) = (sheet.sensor.width_px as usize, sheet.sensor.height_px as usize);
    if (raw.width, raw.height) == (width, height) {
        return Ok(());
    }
    Err(Error::Invalid(format!(
        "an image has {} x {} px, but the sensor {width} x {height}: correct [sensor], or give the \
         image whole as the camera delivered it",
        raw.width, raw.height
    )))
}

fn read_precalibration(folder: &Path, sheet: &Datasheet) -> Result<MicroImages> {
    let (internal, centers) = (folder.join("precalibration.json"), folder.join("centers.csv"));
    let pixel = Some(sheet.sensor.pixel_size_mm);
    let internal = io::read_internal_parameters(&internal, pixel)?;
    let measured = io::read_centers(&centers)?;
    let grid = fit_grid(&measured, sheet.lattice_kind, sheet.columns, sheet.rows)
        .map_err(|e| e.in_file(&centers))?;
    MicroImages::new(&grid, &measured, &internal, sheet).map_err(|e| e.in_file(folder))
}

fn measure(
    path: &Path,
    images: &ImagesSection,
    sheet: &Datasheet,
    output: &mut OutputFolder,
    json: bool,
) -> Result<MicroImages> {
    let (whites, reference) = read_whites(images, sheet).map_err(|e| e.in_file(path))?;
    let options = PrecalibrationOptions::of_datasheet(sheet);
    let bar = progress_bar(json, whites.len(), "measuring white images");
    let result = precalibrate(&whites, reference.as_ref(), &options, &|| bar.inc(1));
    bar.finish_and_clear();
    let result = result.map_err(|e| e.in_file(path))?;
    result.check_stated(sheet).map_err(|e| e.in_file(path))?;
    for warning in &result.warnings {
        eprintln!("warning: {warning}");
    }
    stage_centers(output, &result)?;
    output.stage_json("precalibration.json", &io::precalibration_document(&result))?;
    MicroImages::of_precalibration(&result, sheet)
}

/// Detects frame by frame: each takes all cores, so that no more than one is in memory.
fn detect(
    arguments: &Arguments,
    paths: &[PathBuf],
    images: &ImagesSection,
    white: &RawImage,
    search: &Search,
    output: &mut OutputFolder,
) -> Result<Vec<Frame>> {
    let bar = progress_bar(arguments.json, paths.len(), "looking at boards");
    let white = white.grey();
    let mut frames = Vec::new();
    for (number, path) in (0..).zip(paths) {
        let (result, counts) = match io::read_image(path, Some(images.color)) {
            Ok(image) => {
                let found = detect_frame(number, &image.grey(), &white, search);
                if let (Ok(detection), false) = (&found.0, arguments.no_pictures) {
                    let figure = report::features_figure(&image, detection, search.board)?;
                    let name = format!("frame-{number:02}.svg");
                    output.stage(name, |out| out.write_all(figure.as_bytes()))?;
                }
                found
            }
            // A damaged image among good ones is told as any frame that is left out.
            Err(error) => (Err(error.to_string()), FrameCounts::default()),
        };
        frames.push(Frame { number, path: path.clone(), result, counts });
        bar.inc(1);
    }
    bar.finish_and_clear();
    Ok(frames)
}

/// Says which frames are left out and why; an error if all are.
fn report_rejected(frames: &[Frame], subset: Subset) -> Result<()> {
    for frame in frames {
        if let Err(why) = &frame.result {
            eprintln!("warning: frame {} ({}) is left out: {why}", frame.number, name(&frame.path));
        }
    }
    let good = frames.iter().filter(|frame| frame.result.is_ok()).count();
    if good == 0 {
        return Err(Error::Invalid(
            "no frame shows the board: check [board], the white image and the images".to_owned(),
        ));
    }
    if good < FEW_FRAMES && matches!(subset, Subset::Calibration) {
        eprintln!(
            "warning: {good} frame(s) are few for a calibration: take ten or more, at several \
             distances and tilts"
        );
    }
    for frame in frames {
        let tied = frame.counts.board_corners;
        if frame.result.is_ok() && tied < MIN_CORNERS {
            eprintln!("warning: frame {} shows {tied} corners only", frame.number);
        }
    }
    Ok(())
}

/// A board that is stated too large fits as well where its other sides are out of view.
fn warn_of_size(frames: &[Frame], board: &Board) {
    let spans = |of: fn(i32, i32) -> i32, last: i32| {
        let all = |detection: &Detection| {
            let seen: Vec<i32> =
                detection.corners.iter().map(|c| of(c.corner, board.columns)).collect();
            seen.contains(&0) && seen.contains(&last)
        };
        frames.iter().filter_map(|frame| frame.result.as_ref().ok()).any(all)
    };
    let whole = spans(|corner, columns| corner % columns, board.columns - 1)
        && spans(|corner, columns| corner / columns, board.rows - 1);
    if !whole {
        eprintln!(
            "warning: no frame shows the board from its first to its last row and column: check that \
             it has {} x {} inner corners",
            board.columns, board.rows
        );
    }
}

fn document(frames: &[Frame], board: &Board) -> serde_json::Value {
    let of_frame = |frame: &Frame| {
        let c = &frame.counts;
        json!({
            "frame": frame.number,
            "image": frame.path.display().to_string(),
            "rejected": frame.result.as_ref().err(),
            "features": frame.result.as_ref().map_or(0, |d| d.features.len()),
            "board_corners": c.board_corners,
            "micro_images": { "looked_at": c.looked_at, "unusable": c.unusable },
            "corners": c.corners,
            "clusters": c.clusters,
            "dropped": {
                "alone": c.alone,
                "off_line": c.off_line,
                "off_board": c.off_board,
                "lost_board_corners": c.lost,
                "unclear": c.unclear,
                "misplaced": c.misplaced,
            },
        })
    };
    json!({
        "format": "plenocal-detection",
        "version": 1,
        "board": { "columns": board.columns, "rows": board.rows, "square_mm": board.square_mm },
        "frames": frames.iter().map(of_frame).collect::<Vec<_>>(),
    })
}
