//! `plenocal init`: writes a project file for a folder of images.

use std::ffi::OsStr;
use std::fmt::Write as _;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::Args;
use plenocal::image::Color;
use plenocal::io::{self, CommonFormat, DraftText, OutputFolder, ProjectDraft, SortedImages};
use plenocal::model::{Board, Datasheet};
use plenocal::quantity::counted;
use plenocal::simulation::Settings;
use plenocal::{Error, Result};

use super::simulate::preset_names;

/// Write a project file for a folder of images.
///
/// Images are sorted by the names of folders and files. For values that names, images, options and preset do not give, the file
/// contains a comment that says what to fill in.
#[derive(Args)]
#[command(after_help = HELP, allow_negative_numbers = true)]
pub struct Arguments {
    /// Folder with the images (PNG, TIFF, BMP, PGM, JPEG, or .raw without a header), searched with all its subfolders.
    images: PathBuf,
    /// Project file to write.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Replace the file if it exists.
    #[arg(long)]
    force: bool,

    /// Take the datasheet values (pixel size, main lens, array) from a camera of this kind.
    #[arg(long, value_name = "NAME", value_parser = preset_names(), help_heading = "Camera")]
    preset: Option<String>,
    /// Focal length as engraved on the main lens.
    #[arg(long, value_name = "MM", value_parser = length, help_heading = "Camera")]
    focal_length: Option<f64>,
    /// True f-number of the board images: 5.657 if 5.6 is engraved.
    #[arg(long, value_name = "N", value_parser = length, help_heading = "Camera")]
    f_number: Option<f64>,
    /// Focus distance from the sensor; inf for infinity.
    #[arg(long, value_name = "MM", value_parser = distance, help_heading = "Camera")]
    focus_distance: Option<f64>,
    /// Meaning of the samples of the images [default: found from the images if possible].
    #[arg(long, help_heading = "Camera")]
    color: Option<Color>,

    /// Checkerboard: inner corners along a row and along a column, and edge of a square in mm.
    #[arg(long, value_name = "CxRxMM", value_parser = board, help_heading = "Board")]
    board: Option<Board>,
    /// Motion between the images of a translation, mm; negative towards the camera.
    #[arg(long, value_name = "MM", value_parser = step, help_heading = "Board")]
    step: Option<f64>,
}

const HELP: &str = "\
Names of files and folders:
  white images   white*, or an f-number alone: whites/white-n-4.00.png, flat_f4.0.png, N8.tif
  devignetting   devignetting*, vignetting*
  dark image     dark, darks, darkframe
  calibration    calib*, board*, check*, chess*
  evaluation     eval*
  translation    translation*, step*
  The name of a file takes precedence over the names of its folders. An f-number follows an f or n that stands
  alone: f4, f_5.6, n-11.31. Engraved stops are taken as such (5.6 for 5.657).

Examples:
  plenocal init images --out project.toml
  plenocal init images --preset r12-a --board 8x5x10 --out project.toml
  plenocal init images --preset r12-b --board 8x5x20 --step 10 --color bayer-rggb --out project.toml
  plenocal run project.toml --out results";

fn number(text: &str, allowed: fn(f64) -> bool, what: &str) -> std::result::Result<f64, String> {
    let number = text.parse::<f64>().ok().filter(|&number| allowed(number));
    number.ok_or_else(|| format!("'{text}' is not a {what}"))
}

fn length(text: &str) -> std::result::Result<f64, String> {
    number(text, |number| number > 0.0 && number.is_finite(), "number above 0")
}

fn distance(text: &str) -> std::result::Result<f64, String> {
    number(text, |number| number > 0.0, "distance; give mm, or inf")
}

fn step(text: &str) -> std::result::Result<f64, String> {
    number(text, |number| number.is_finite() && number != 0.0, "motion; give mm")
}

fn board(text: &str) -> std::result::Result<Board, String> {
    let parts: Vec<&str> = text.split('x').map(str::trim).collect();
    let parsed = match parts.as_slice() {
        [columns, rows, square] => {
            columns.parse().ok().zip(rows.parse().ok()).zip(square.parse().ok())
        }
        _ => None,
    };
    let ((columns, rows), square_mm) = parsed.ok_or_else(|| {
        format!(
            "'{text}' is not a board: write 8x5x10 for 8 x 5 inner corners and squares of 10 mm"
        )
    })?;
    let board = Board { columns, rows, square_mm };
    board.validate().map(|()| board).map_err(|e| e.to_string())
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<ExitCode> {
    let out = &arguments.out;
    if !arguments.force && out.exists() {
        return Err(Error::invalid(
            "this file already exists: give another name, or --force to replace it",
        )
        .in_file(out));
    }
    let name = out
        .file_name()
        .filter(|_| !out.is_dir())
        .ok_or_else(|| Error::invalid("this is a folder: give the name of a file").in_file(out))?;
    let folder = out.parent().filter(|folder| *folder != OsStr::new("")).unwrap_or(Path::new("."));
    let mut output = OutputFolder::new(folder)?;

    let images = io::sort_images(&arguments.images)?;
    let format = images.common_format().map_err(|e| e.in_file(&arguments.images))?;
    let preset = arguments.preset.as_deref();
    let sheet = preset.map(datasheet).transpose()?;
    let draft = ProjectDraft {
        images: &images,
        format,
        color: match arguments.color {
            Some(color) => Some(color),
            None => found_color(&images, format)?,
        },
        preset: preset.zip(sheet.as_ref()),
        focal_length_mm: arguments.focal_length,
        f_number: arguments.f_number,
        focus_distance_mm: arguments.focus_distance,
        board: arguments.board,
        step_mm: arguments.step,
    };
    let drafted = draft.text(folder)?;
    output.stage(name, |file| file.write_all(drafted.text.as_bytes()))?;
    output.commit()?;
    let text = summary(&draft, &drafted, arguments.color.is_some(), out);
    let _ = std::io::stdout().write_all(text.as_bytes());
    Ok(ExitCode::SUCCESS)
}

fn datasheet(name: &str) -> Result<Datasheet> {
    Ok(Settings::preset(name, &[])?.datasheet())
}

/// Returns the colour format, if it can be found: RGB for three channels, grey for a single channel whose white image shows no
/// mosaic. A white image does not determine the kind of a mosaic for certain.
fn found_color(images: &SortedImages, format: Option<CommonFormat>) -> Result<Option<Color>> {
    match format.and_then(|format| format.channels) {
        Some(Color::Grey) => {}
        known => return Ok(known),
    }
    let whites = images.whites.iter().map(|(path, _)| path);
    for path in images.devignetting.iter().chain(whites).filter(|path| !io::is_raw(path)) {
        if let Some(mosaic) = io::read_image(path, Some(Color::Grey))?.shows_mosaic() {
            return Ok((!mosaic).then_some(Color::Grey));
        }
    }
    Ok(None)
}

fn summary(draft: &ProjectDraft, drafted: &DraftText, color_is_stated: bool, out: &Path) -> String {
    let images = draft.images;
    let mut text = format!("{}:\n", out.display());
    for (count, noun, purpose) in [
        (images.whites.len(), "white image", ""),
        (images.devignetting.len(), "devignetting image", ""),
        (images.dark.len(), "dark image", ""),
        (images.calibration.len(), "board", " for calibration"),
        (images.evaluation.len(), "board", " for evaluation"),
        (images.translation.len(), "image", " of a translation"),
        (images.unsorted.len(), "image", " with an unclear name"),
    ] {
        if count > 0 {
            let _ = writeln!(text, "  {}{purpose}", counted(count, noun));
        }
    }
    if !images.skipped.is_empty() {
        let _ = writeln!(text, "\nSkipped:");
    }
    for (path, reason) in &images.skipped {
        let _ = writeln!(text, "  {}: {reason}", path.display());
    }
    if let Some((name, sheet)) = draft.preset {
        let _ = writeln!(
            text,
            "\nValues marked (preset) in the file are taken from {name}: compare them with your \
             camera,\n\
             above all the focal length, f-number and focus distance of the main lens."
        );
        let (width, height) = (sheet.sensor.width_px, sheet.sensor.height_px);
        if let Some(format) = draft.format
            && (format.width_px, format.height_px) != (width, height)
        {
            let _ = writeln!(
                text,
                "The images have {} x {} px, but the sensor of {name} has {width} x {height}: the \
                 size of\npixels and array is left open.",
                format.width_px, format.height_px
            );
        }
    }
    if let (Some(color), false) = (draft.color, color_is_stated) {
        let _ = writeln!(
            text,
            "\nThe images are assumed to be {}: {}.",
            color.name(),
            match color {
                Color::Grey => "one channel, and a white image shows no mosaic",
                _ => "their files have three channels",
            }
        );
    }
    for (none, what) in [
        (images.whites.is_empty(), "white images, which the pre-calibration needs"),
        (images.calibration.is_empty(), "boards to calibrate with"),
    ] {
        if none {
            let _ =
                writeln!(text, "\nThere are no {what}: add them to the file, or rename images.");
        }
    }
    if !drafted.missing.is_empty() {
        let _ = writeln!(text, "\nTo fill in, where the file says so:");
    }
    for missing in &drafted.missing {
        let _ = writeln!(text, "  {missing}");
    }
    let then = if drafted.missing.is_empty() { "Next" } else { "Then" };
    let _ = writeln!(text, "\n{then}:\n  plenocal run {} --out results", out.display());
    text
}
