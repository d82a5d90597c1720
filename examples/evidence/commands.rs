//! Times of commands.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Instant;

use plenocal::io::{MANIFEST, Manifest};
use plenocal::model::Sensor;
use plenocal::simulation::{DataSet, Settings};
use plenocal::{Error, Result};

use crate::sets::{Extent, step};
use crate::text::Table;

/// Measures the times of the commands that take longest.
pub fn times(extent: &Extent) -> Result<Vec<String>> {
    let folder = tempfile::tempdir().map_err(|error| Error::invalid(error.to_string()))?;
    let at = |name: &str| folder.path().join(name);
    let mut table = Table::new(&["work", "time"]);
    let mut row = |work: &str, time: String| table.row([work.to_owned(), time]);
    let (preset, rays) = if extent.quick { ("mini", "rays=16") } else { ("r12-a", "rays=64") };
    let settings = Settings::preset(preset, &[rays.to_owned()])?;
    let images = DataSet::plan(&settings, None)?.shots().count();
    let Sensor { width_px, height_px, .. } = settings.camera.sensor;
    let size = format!("{:.1} MP", f64::from(width_px) * f64::from(height_px) / 1e6);

    let time = command(&["demo", "--out"], &[at("demo")])?;
    row("`plenocal demo`: 24 images of 0.75 MP at 64 rays per pixel, then `run`", seconds(time));
    let time = command(&["simulate", "--preset", preset, "--set", rays, "--out"], &[at("set")])?;
    let work = format!("simulation of an image of {size} at {} rays per pixel", settings.rays);
    row(&work, seconds(time / images as f64));

    let results = at("results");
    let project = at("set").join("project.toml");
    let time = command(&["run", "--no-pictures", "--out"], &[results.clone(), project])?;
    let work = format!("`plenocal run --no-pictures`: {images} images of {size} of `{preset}`");
    row(&work, seconds(time));
    for (stage, time) in stages(&results)? {
        row(&format!("its stage {stage}"), seconds(time));
    }
    let camera = results.join("calibration").join("camera.json");
    let time = command(&["rays", "--out"], &[at("rays"), camera])?;
    row("`plenocal rays` for this camera", seconds(time));
    Ok(vec![table.text()])
}

/// Runs the program, and returns the time that it took, s.
fn command(arguments: &[&str], paths: &[PathBuf]) -> Result<f64> {
    step(&format!("plenocal {}", arguments.join(" ")));
    let begun = Instant::now();
    let status = Command::new(program()?)
        .args(arguments)
        .args(paths)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status()
        .map_err(|error| Error::invalid(format!("plenocal: {error}")))?;
    if status.success() {
        return Ok(begun.elapsed().as_secs_f64());
    }
    Err(Error::invalid(format!("plenocal {} ended with {status}", arguments.join(" "))))
}

/// Returns the path of the program, which is built beside the folder of the examples.
fn program() -> Result<PathBuf> {
    let own = std::env::current_exe().map_err(|error| Error::invalid(error.to_string()))?;
    let folder = own.parent().and_then(Path::parent).unwrap_or(Path::new("."));
    Ok(folder.join("plenocal"))
}

/// Returns the stages of a run with their times, s.
fn stages(results: &Path) -> Result<Vec<(String, f64)>> {
    let manifest = Manifest::read(results)
        .ok_or_else(|| Error::invalid(format!("there is no {MANIFEST}")).in_file(results))?;
    Ok(manifest.stages.into_iter().map(|stage| (stage.name, stage.time_s)).collect())
}

fn seconds(time_s: f64) -> String {
    format!("{} s", plenocal::quantity::significant(time_s, 2))
}
