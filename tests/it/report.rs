//! Pictures and the page of a report.

use std::collections::HashSet;

use plenocal::calibration::{Calibration, Mode, Start};
use plenocal::camera::Board;
use plenocal::precalibration::ArrayMeasurement;
use plenocal::report::{
    Figure, HtmlReport, HtmlTable, Part, Section, array_residuals_figure, calibration_figures,
};
use roxmltree::Document;

use crate::support::{
    NO_NOISE, board, datasheet_start, drawn, options, run, shipped_observations, true_camera,
};

/// All pictures of a report stay below this together with room for its tables, bytes each.
const LARGEST_SVG: usize = 300_000;

fn shipped() -> Calibration {
    run(&datasheet_start(), &shipped_observations(), &options())
}

/// Those of the calibration, and of its array.
fn figures_of(calibration: &Calibration, board: &Board) -> Vec<Figure> {
    let mut figures = calibration_figures(calibration, board).unwrap();
    if let Some(grid) = &calibration.grid {
        let centers = calibration.reprojection.centers.iter().map(|c| c.center).collect();
        let array = ArrayMeasurement::of_grid(*grid, centers, 3);
        figures.push(array_residuals_figure(&array).unwrap());
    }
    figures
}

fn names(figures: &[Figure]) -> Vec<&str> {
    figures.iter().map(|figure| figure.name.as_str()).collect()
}

/// Well-formed, with marks, and with numbers only where numbers belong.
fn check(figure: &Figure) {
    let name = &figure.name;
    let document = Document::parse(&figure.svg).unwrap_or_else(|e| panic!("{name}: {e}"));
    let marks = document.descendants().filter(|node| {
        matches!(
            node.tag_name().name(),
            "path" | "rect" | "circle" | "line" | "polyline" | "polygon"
        )
    });
    // Paper and axes are a few themselves.
    assert!(marks.count() > 5, "{name} is empty");
    for node in document.descendants() {
        for attribute in node.attributes() {
            let value = attribute.value();
            assert!(!value.contains("NaN") && !value.contains("inf"), "{name}: {value}");
        }
        let words = node.text().unwrap_or_default();
        assert!(!words.contains("NaN") && !words.contains("inf"), "{name}: {words}");
    }
    assert!(
        !figure.caption.contains("NaN") && !figure.caption.contains("inf"),
        "{}",
        figure.caption
    );
    assert!(figure.caption.ends_with('.'), "{name}: {}", figure.caption);
    assert!(figure.svg.len() < LARGEST_SVG, "{name} has {} bytes", figure.svg.len());
}

fn report(figures: Vec<Figure>) -> HtmlReport {
    let sizes = figures.iter().map(|f| vec![f.name.clone(), f.svg.len().to_string()]).collect();
    let table = HtmlTable {
        caption: "Pictures".into(),
        header: vec!["File".into(), "Bytes".into()],
        rows: sizes,
        text_columns: vec![0],
    };
    let (first, others): (Vec<Figure>, Vec<Figure>) =
        figures.into_iter().partition(|f| f.name.starts_with("residual"));
    let pictures = |figures: Vec<Figure>| figures.into_iter().map(Part::Figure).collect::<Vec<_>>();
    let details = Part::Details { summary: "All others".into(), parts: pictures(others) };
    HtmlReport {
        title: "Calibration".into(),
        subtitle: "The shipped feature set".into(),
        sections: vec![
            Section { title: "Residuals".into(), parts: pictures(first) },
            Section {
                title: "Camera".into(),
                parts: vec![Part::Text("One.\n\nTwo.".into()), Part::Table(table), details],
            },
        ],
    }
}

#[test]
fn a_calibration_gives_all_pictures_and_a_page() {
    let figures = figures_of(&shipped(), &board());
    assert_eq!(
        names(&figures),
        [
            "residual-vectors.svg",
            "residual-histograms.svg",
            "rmse.svg",
            "center-residuals.svg",
            "correlations.svg",
            "convergence.svg",
            "scene.svg",
            "distortion.svg",
            "array-residuals.svg"
        ]
    );
    figures.iter().for_each(check);
    let html = report(figures.clone()).to_html();
    if let Some(folder) = std::env::var_os("PLENOCAL_REPORT_FOLDER").map(std::path::PathBuf::from) {
        for figure in &figures {
            std::fs::write(folder.join(&figure.name), &figure.svg).unwrap();
        }
        std::fs::write(folder.join("report.html"), &html).unwrap();
    }
    assert!(!html.contains("http://") && !html.contains("https://") && !html.contains("<script"));
    let ids: Vec<&str> =
        html.split(" id=\"").skip(1).filter_map(|rest| rest.split('"').next()).collect();
    assert_eq!(ids.iter().collect::<HashSet<_>>().len(), ids.len());
    // Every reference has its target.
    for target in html.split("href=\"#").skip(1).filter_map(|rest| rest.split('"').next()) {
        assert!(ids.contains(&target), "{target}");
    }
    assert_eq!(html.matches("role=\"img\" aria-label=\"").count(), figures.len());
}
