//! `plenocal demo`: simulates a camera and calibrates it from its images.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;
use plenocal::Result;
use plenocal::detection::DepthEstimator;

use super::run::{self as whole, Arguments as RunArguments};
use super::simulate;

/// Simulate a small camera, calibrate it from its images, and compare the result with the truth.
///
/// The images are the same as from `plenocal simulate --preset mini`; `plenocal run` does the rest.
#[derive(Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// Folder for images, results and the report.
    #[arg(long, value_name = "DIR", default_value = "out/demo")]
    out: PathBuf,
}

const EXAMPLES: &str = "\
Examples:
  plenocal demo
  plenocal demo --out /tmp/demo";

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<ExitCode> {
    simulate::simulate(&simulate::Arguments::preset(&arguments.out))?;
    whole::run(&RunArguments {
        project: arguments.out.join("project.toml"),
        out: arguments.out.join("results"),
        estimator: DepthEstimator::default(),
        exclude: None,
        method: None,
        set: Vec::new(),
        corners_only: true,
        folds: 5,
        no_pictures: false,
        json: false,
    })
}
