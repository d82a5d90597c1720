//! Calibrates the shipped feature set: the example of the README.
//!
//!     cargo run --release --example calibrate

use std::path::Path;

use plenocal::calibration::{CalibrationOptions, Start, calibrate};
use plenocal::io::{Project, read_centers, read_features};

fn main() -> plenocal::Result<()> {
    let project = Project::read(Path::new("data/synthetic/project.toml"))?;
    let start = Start::Datasheet(
        project.datasheet()?.expect("a camera"),
        project.internal_parameters.expect("internal parameters"),
    );
    let mut observations = read_features(Path::new("data/synthetic/features.csv"), true)?;
    observations.centers = read_centers(Path::new("data/synthetic/centers.csv"))?;
    let board = project.board.expect("a board");
    let options = CalibrationOptions::default();
    let calibration = calibrate(&start, &board, &observations, &options, &mut |_| true)?;
    println!("F = {} mm", calibration.camera.main_lens.focal_length_mm);
    Ok(())
}
