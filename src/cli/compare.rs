//! `plenocal compare`: compares two calibrations of one camera.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::Args;
use plenocal::assessment::compare_cameras;
use plenocal::io::{self, OutputFolder};
use plenocal::model::PlenopticCamera;
use plenocal::{Error, Result, report};

use super::evaluate::calibrated;
use super::messages::{print_result, shown, tell};

/// Compare two calibrated cameras: differences of parameters in standard deviations, and of projected points.
///
/// Two calibrations with different parameters may project alike: parameters compensate each other, and the camera frames may
/// differ by a rigid motion. This motion is fitted and printed. The remaining difference is given in pixels and mm, by
/// distance.
// Names in the help are not code.
#[allow(clippy::doc_markdown)]
#[derive(Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// First camera (camera.json, COMPOTE's intrinsics.js).
    first: PathBuf,
    /// Second camera, in the same formats.
    second: PathBuf,
    #[arg(long, value_name = "DIR", help = results_help!("comparison.json and a picture for each distance, which otherwise are only printed"))]
    out: Option<PathBuf>,
    /// Distances from the main lens of the first camera, mm [default: 0.75, 1 and 1.5 times the distance of the plane in
    /// focus].
    #[arg(long, value_name = "MM", value_delimiter = ',')]
    at: Option<Vec<f64>>,
    /// Print the result as one JSON object instead of tables.
    #[arg(long)]
    json: bool,
}

const EXAMPLES: &str = "\
Examples:
  plenocal compare results/calibration/camera.json truth/camera.json
  plenocal compare camera.json intrinsics.js --at 300,450,900 --out comparison";

/// Default distances in units of the distance of the plane in focus.
const AT: [f64; 3] = [0.75, 1.0, 1.5];

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<ExitCode> {
    let output = arguments.out.as_deref().map(OutputFolder::new).transpose()?;
    let (first, first_std_devs) = with_std_devs(&arguments.first)?;
    let (second, second_std_devs) = with_std_devs(&arguments.second)?;
    let at = arguments
        .at
        .clone()
        .unwrap_or_else(|| AT.map(|part| part * super::rays::default_distance(&first)).to_vec());
    let nearest_mm = first.main_lens.focal_length_mm.max(second.main_lens.focal_length_mm);
    if let Some(near) = at.iter().find(|mm| !(mm.is_finite() && **mm > nearest_mm)) {
        return Err(Error::invalid(format!(
            "cameras cannot be compared at {near} mm: give distances beyond their focal length of \
             {nearest_mm:.3} mm"
        )));
    }
    let comparison = compare_cameras((&first, &first_std_devs), (&second, &second_std_devs), &at)?;
    let document = io::comparison_document(&comparison);
    let mut paths = Vec::new();
    if let Some(mut output) = output {
        output.stage_json("comparison.json", &document)?;
        for figure in report::comparison_figures(&comparison, &first.sensor) {
            output.stage(&figure.name, |out| out.write_all(figure.svg.as_bytes()))?;
        }
        paths = output.commit()?;
    }
    tell(&comparison.findings);
    print_result(
        arguments.json,
        &document,
        &shown(&report::comparison_section(&comparison)),
        &paths,
    )?;
    Ok(ExitCode::SUCCESS)
}

/// Reads a camera with the standard deviations of its parameters; COMPOTE's files have none.
fn with_std_devs(path: &Path) -> Result<(PlenopticCamera, Vec<Option<f64>>)> {
    let camera = calibrated(path)?;
    let std_devs = io::read_std_devs(path, camera.lens_types())?;
    Ok((camera, std_devs))
}
