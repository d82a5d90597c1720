//! Calibrates the shipped feature set and writes all figures, as files and on one page.
//!
//!     cargo run --release --example report -- out/report

use std::path::Path;

use plenocal::Result;
use plenocal::assessment::assess;
use plenocal::calibration::{CalibrationOptions, Start, calibrate};
use plenocal::io::{OutputFolder, Project, read_centers, read_features};
use plenocal::precalibration::ArrayMeasurement;
use plenocal::report::{Part, Report, Section, array_residuals_figure, calibration_figures};

fn main() -> Result<()> {
    let folder = std::env::args().nth(1).expect("the folder to write to");
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/synthetic");
    let project = Project::read(&data.join("project.toml"))?;
    let start = Start::Datasheet(
        project.datasheet()?.expect("a camera"),
        project.internal_parameters.clone().expect("internal parameters"),
    );
    let board = project.board.expect("a board");
    let mut observations = read_features(&data.join("features.csv"), true)?;
    observations.centers = read_centers(&data.join("centers.csv"))?;
    let options = CalibrationOptions::default();
    let calibration = calibrate(&start, &board, &observations, &options, &mut |_| true)?;

    let mut figures = calibration_figures(&calibration, &assess(&calibration, &board)?, &board)?;
    if let Some(grid) = calibration.grid {
        let types = calibration.camera.lens_types();
        let array = ArrayMeasurement::of_grid(grid, observations.centers, types);
        figures.push(array_residuals_figure(&array));
    }
    let mut output = OutputFolder::new(Path::new(&folder))?;
    for figure in &figures {
        output.stage(&figure.name, |out| out.write_all(figure.svg.as_bytes()))?;
    }
    let mut result = vec![Part::Text(plenocal::calibration::termination_text(&calibration))];
    result.extend(
        plenocal::calibration::weakest_directions_text(&calibration).into_iter().map(Part::Text),
    );
    let figures = figures.into_iter().map(Part::Figure).collect();
    let sections = vec![Section::new("Result", result), Section::new("Figures", figures)];
    let page = Report {
        title: "Calibration report".into(),
        subtitle: "The shipped feature set, data/synthetic".into(),
        sections,
    };
    output.stage("report.html", |out| out.write_all(page.to_html().as_bytes()))?;
    for path in output.commit()? {
        println!("{}", path.display());
    }
    Ok(())
}
