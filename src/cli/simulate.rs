//! `plenocal simulate`: writes raw images of a simulated camera, with the truth.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::{Duration, Instant};

use clap::Args;
use clap::builder::PossibleValuesParser;
use indicatif::ProgressBar;
use plenocal::io::{self, OutputFolder};
use plenocal::model::Subset;
use plenocal::simulation::{Content, DataSet, PRESETS, Progress, Settings};
use plenocal::{Error, Result};

use super::messages::announce_memory;
use super::progress;

/// Simulate a plenoptic camera: raw images by ray tracing, with the truth.
///
/// Writes white images, boards to calibrate and to evaluate with, a board moved in known steps, a
/// project file for them, and the truth: camera, poses, micro-image centres and BAP features.
#[derive(Args)]
#[command(after_help = EXAMPLES, allow_negative_numbers = true)]
pub struct Arguments {
    /// Simulation file (TOML), instead of --preset; --print shows what it can contain.
    #[arg(conflicts_with = "preset")]
    file: Option<PathBuf>,
    /// Preset camera of plenocal [default: mini].
    #[arg(long, value_name = "NAME", value_parser = preset_names())]
    preset: Option<String>,
    /// Folder for the data set.
    #[arg(long, value_name = "DIR", required_unless_present = "print")]
    out: Option<PathBuf>,
    /// Replace a data set in the folder, its project file too.
    #[arg(long)]
    force: bool,
    /// Replace a setting, e.g. imaging.bits=16; may be repeated.
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Poses of the calibration boards (poses.json), instead of random ones.
    #[arg(long, value_name = "FILE")]
    poses: Option<PathBuf>,
    /// Print the complete simulation file and stop.
    #[arg(long)]
    print: bool,
    /// Threads; the images are the same with any number [default: all cores].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
}

impl Arguments {
    /// Returns the arguments for the first preset without changes; it replaces an earlier data set.
    pub fn preset(out: &Path) -> Self {
        Self {
            file: None,
            preset: None,
            out: Some(out.to_owned()),
            force: true,
            set: Vec::new(),
            poses: None,
            print: false,
            threads: None,
        }
    }
}

pub(super) fn preset_names() -> PossibleValuesParser {
    PRESETS.map(|preset| preset.name).into()
}

const EXAMPLES: &str = "\
Examples:
  plenocal simulate --out data
  plenocal simulate --preset r12-a --set rays=32 --out data
  plenocal simulate --set white_images.gain=4 --set imaging.color=bayer-rggb --out data
  plenocal simulate --preset mini-tessar --set axis_px=[150,0] --out data
  plenocal simulate --preset mini --print > my-camera.toml
  plenocal simulate my-camera.toml --out data
  plenocal calibrate data/observed/project.toml --out results";

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<ExitCode> {
    let text = simulate(arguments)?;
    let printed = super::messages::print(text.as_bytes());
    // A closed stdout is not an error once the data set is written.
    if arguments.print {
        printed?;
    }
    Ok(ExitCode::SUCCESS)
}

/// Writes the data set, and returns the text to print.
pub fn simulate(arguments: &Arguments) -> Result<String> {
    let begun = Instant::now();
    let settings = settings(arguments)?;
    if arguments.print {
        return settings.to_toml();
    }
    let Some(out) = &arguments.out else {
        return Err(Error::invalid("--out is missing"));
    };
    if let Some(threads) = arguments.threads {
        rayon::ThreadPoolBuilder::new()
            .num_threads(usize::from(threads))
            .build_global()
            .map_err(|e| Error::Invalid(format!("cannot start {threads} threads: {e}")))?;
    }
    let mut output = OutputFolder::new(out)?;
    if !arguments.force && io::is_data_set(out) {
        return Err(Error::invalid(
            "there is a data set in this folder, and its project file may have been edited: choose another folder, or \
             replace it (--force)",
        )
        .in_file(out));
    }
    let poses = arguments.poses.as_deref().map(io::read_poses).transpose()?;
    let plan = DataSet::plan(&settings, poses.clone())?;
    announce(&settings, &plan);
    let progress = Bar::new(&settings, &plan);
    let simulated = io::stage_data_set(&mut output, &settings, poses, &progress)?;
    progress.0.finish_and_clear();
    let written = output.commit()?;
    io::remove_older_data(out, &written);
    Ok(summary(&simulated.data_set, &out.display().to_string(), begun.elapsed()))
}

/// Memory of an image while it is simulated, bytes per pixel and per sample: 7 were measured on grey images.
const PIXEL_BYTES: f64 = 4.0;
const SAMPLE_BYTES: f64 = 3.0;
/// Memory of the true features of a corner, bytes: 3080 were measured.
const CORNER_BYTES: f64 = 3e3;

/// Announces the memory for large images and for boards with many corners.
fn announce(settings: &Settings, plan: &DataSet) {
    let pixels = settings.camera.sensor.pixels() as f64;
    let samples = settings.imaging.color.samples() as f64;
    announce_memory("an image of this size", pixels * (PIXEL_BYTES + SAMPLE_BYTES * samples));
    let boards: usize = plan.subsets.iter().map(Vec::len).sum();
    let board = settings.target.board();
    let corners = f64::from(board.columns) * f64::from(board.rows) * boards as f64;
    announce_memory("finding the true features of all corners", corners * CORNER_BYTES);
}

fn settings(arguments: &Arguments) -> Result<Settings> {
    let Some(path) = &arguments.file else {
        let name = arguments.preset.as_deref().unwrap_or(PRESETS[0].name);
        return Settings::preset_and_files(name, &arguments.set, &|file| {
            io::read_text(Path::new(file))
        });
    };
    // The path of a prescription is relative to the simulation file.
    let folder = path.parent().unwrap_or(Path::new(""));
    let read = |file: &str| io::read_text(&folder.join(file));
    Settings::from_toml_and_files(&io::read_text(path)?, &arguments.set, &read)
        .map_err(|e| e.in_file(path))
}

fn summary(data_set: &DataSet, folder: &str, time: Duration) -> String {
    let mut text = format!(
        "{} images in {:.1} s:\n  {folder}/whites/: {} white images for the pre-calibration\n  \
         {folder}/{}: a white image in the light of the boards\n",
        data_set.shots().count(),
        time.as_secs_f64(),
        data_set.whites.len(),
        io::image_name(Content::Devignetting, &data_set.devignetting)
    );
    for (subset, boards) in Subset::ALL.into_iter().zip(&data_set.subsets) {
        if !boards.is_empty() {
            let _ = writeln!(text, "  {folder}/{}/: {} boards", subset.name(), boards.len());
        }
    }
    let _ = writeln!(text, "  {folder}/project.toml: the project; truth/: the truth");
    if data_set.subsets[0].is_empty() {
        return text;
    }
    let _ = writeln!(
        text,
        "Calibrate from observations drawn from the truth, with noise:\n  plenocal calibrate \
         {folder}/observed/project.toml --out {folder}/results"
    );
    text
}

struct Bar(ProgressBar);

impl Bar {
    fn new(settings: &Settings, data_set: &DataSet) -> Self {
        let rows = data_set.shots().count() as u64 * u64::from(settings.camera.sensor.height_px);
        Self(progress::share(rows))
    }
}

impl Progress for Bar {
    fn image(&self, content: Content) {
        self.0.set_message(match content {
            Content::White(i) => format!("white image {}", i + 1),
            Content::Devignetting => "devignetting image".to_owned(),
            Content::Board(subset, frame) => format!("{}, frame {frame}", subset.name()),
        });
    }

    fn row(&self) {
        self.0.inc(1);
    }
}
