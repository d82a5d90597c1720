//! Figures and the page of a report.

use std::collections::HashSet;
use std::sync::LazyLock;

use plenocal::assessment::{Assessment, assess};
use plenocal::calibration::{Calibration, Mode, Start};
use plenocal::model::{Board, Reprojection};
use plenocal::precalibration::ArrayMeasurement;
use plenocal::report::{
    Cell, Column, Figure, Part, Report, Section, Table, array_residuals_figure, calibration_figures,
};
use roxmltree::Document;

use crate::support::{
    NO_NOISE, board, datasheet_start, drawn, options, run, shipped_observations, true_camera,
};

/// Largest size of a figure, bytes: a page with ten such figures still opens at once.
const LARGEST_SVG: usize = 300_000;

/// The calibration of the shipped feature set.
fn shipped() -> Calibration {
    static SHIPPED: LazyLock<Calibration> =
        LazyLock::new(|| run(&datasheet_start(), &shipped_observations(), &options()));
    SHIPPED.clone()
}

fn assessed(calibration: &Calibration) -> Assessment {
    assess(calibration, &board()).unwrap()
}

/// An assessment without anything to draw.
fn nothing() -> Assessment {
    Assessment { object_space: None, ..assessed(&shipped()) }
}

/// The figures of the calibration, and that of its array.
fn figures_of(calibration: &Calibration, board: &Board) -> Vec<Figure> {
    let mut figures = calibration_figures(calibration, &assessed(calibration), board).unwrap();
    if let Some(grid) = &calibration.grid {
        let centers = calibration.reprojection.centers.iter().map(|c| c.center).collect();
        let array = ArrayMeasurement::of_grid(*grid, centers, 3);
        figures.push(array_residuals_figure(&array));
    }
    figures
}

fn names(figures: &[Figure]) -> Vec<&str> {
    figures.iter().map(|figure| figure.name.as_str()).collect()
}

/// Checks that a figure is well-formed, has marks, and has only numbers where numbers belong.
pub fn check(figure: &Figure) {
    let name = &figure.name;
    let document = Document::parse(&figure.svg).unwrap_or_else(|e| panic!("{name}: {e}"));
    let marks = document.descendants().filter(|node| {
        matches!(
            node.tag_name().name(),
            "path" | "rect" | "circle" | "line" | "polyline" | "polygon"
        )
    });
    // Background and axes are a few marks themselves.
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

fn report(figures: Vec<Figure>) -> Report {
    let mut table = Table::new("Pictures", [Column::text("File"), Column::number("Bytes")]);
    for figure in &figures {
        table.push([figure.name.as_str().into(), Cell::from(figure.svg.len())]);
    }
    let (first, others): (Vec<Figure>, Vec<Figure>) =
        figures.into_iter().partition(|f| f.name.starts_with("residual"));
    let pictures = |figures: Vec<Figure>| figures.into_iter().map(Part::Figure).collect::<Vec<_>>();
    let details = Part::Details { summary: "All others".into(), parts: pictures(others) };
    Report {
        title: "Calibration".into(),
        subtitle: "The shipped feature set".into(),
        sections: vec![
            Section::new("Residuals", pictures(first)),
            Section::new(
                "Camera",
                vec![Part::Text("One.\n\nTwo.".into()), Part::Table(table), details],
            ),
        ],
    }
}

#[test]
fn a_calibration_gives_all_figures() {
    let figures = figures_of(&shipped(), &board());
    assert_eq!(
        names(&figures),
        [
            "object-space.svg",
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
}

#[test]
fn the_page_has_all_figures_and_its_references_have_targets() {
    let figures = figures_of(&shipped(), &board());
    let count = figures.len();
    let html = report(figures).to_html();
    assert!(
        !html.contains("http://") && !html.contains("https://") && !html.contains("<script src")
    );
    let ids: Vec<&str> =
        html.split(" id=\"").skip(1).filter_map(|rest| rest.split('"').next()).collect();
    assert_eq!(ids.iter().collect::<HashSet<_>>().len(), ids.len());
    for target in html.split("href=\"#").skip(1).filter_map(|rest| rest.split('"').next()) {
        assert!(ids.contains(&target), "{target}");
    }
    assert_eq!(html.matches("role=\"img\" aria-label=\"").count(), count);
}

#[test]
fn corners_alone_have_no_lens_types_and_no_blur() {
    let mut options = options();
    options.mode = Mode::CornersOnly;
    let calibration = run(&datasheet_start(), &shipped_observations(), &options);
    let figures = figures_of(&calibration, &board());
    figures.iter().for_each(check);
    let by_name = |name: &str| figures.iter().find(|f| f.name == name).unwrap();
    assert!(!by_name("rmse.svg").svg.contains("lens type"));
    assert!(!by_name("rmse.svg").caption.contains("type"));
    for name in ["rmse.svg", "residual-histograms.svg"] {
        assert!(!by_name(name).svg.contains('ρ'), "{name}");
    }
}

#[test]
fn figures_with_nothing_to_show_are_left_out() {
    let mut truth = true_camera();
    truth.main_lens.radial = [0.0; 3];
    truth.main_lens.tangential = [0.0; 2];
    let mut observations = drawn(&truth, &NO_NOISE, 0);
    observations.centers.clear();
    let mut options = options();
    options.mode = Mode::PosesOnly;
    let calibration = run(&Start::Camera(truth), &observations, &options);
    let figures = figures_of(&calibration, &board());
    // Without centres, free intrinsics and distortion; residuals are rounding errors only.
    assert_eq!(
        names(&figures),
        [
            "residual-vectors.svg",
            "residual-histograms.svg",
            "rmse.svg",
            "convergence.svg",
            "scene.svg"
        ]
    );
    figures.iter().for_each(check);
}

#[test]
fn a_single_residual_of_any_size_can_be_shown() {
    let mut calibration = shipped();
    calibration.poses.truncate(1);
    calibration.refinement.iterations.truncate(1);
    calibration.uncertainty.residual_std_dev_px = [0.0, f64::NAN, 0.0];
    let reprojection = &mut calibration.reprojection;
    reprojection.features.truncate(1);
    reprojection.centers.truncate(1);
    for size in [0.0, 1e-300, 0.3, 1e6] {
        let reprojection = &mut calibration.reprojection;
        reprojection.features[0].du_px = size;
        reprojection.features[0].dv_px = -size;
        reprojection.features[0].drho_px = Some(size);
        reprojection.centers[0].du_px = size;
        reprojection.centers[0].dv_px = size;
        let figures = calibration_figures(&calibration, &nothing(), &board()).unwrap();
        assert_eq!(figures.len(), 8, "{:?}", names(&figures));
        figures.iter().for_each(check);
    }
}

#[test]
fn without_observations_only_the_distortion_is_shown() {
    let mut calibration = shipped();
    calibration.reprojection = Reprojection::default();
    calibration.refinement.iterations.clear();
    calibration.uncertainty.free_intrinsics.clear();
    calibration.poses.clear();
    let figures = calibration_figures(&calibration, &nothing(), &board()).unwrap();
    assert_eq!(names(&figures), ["distortion.svg"]);
}

#[test]
fn many_features_are_shown_by_their_means() {
    let mut calibration = shipped();
    let features = &mut calibration.reprojection.features;
    for _ in 0..3 {
        features.extend_from_within(..);
    }
    let (count, board) = (features.len(), board());
    // More frames than numbers that fit.
    let poses = calibration.poses.clone();
    calibration.poses.extend((100..200).map(|frame| {
        let mut pose = poses[frame as usize % poses.len()];
        pose.frame = frame;
        pose
    }));
    let figures = calibration_figures(&calibration, &nothing(), &board).unwrap();
    figures.iter().for_each(check);
    assert!(figures[0].caption.contains(&format!("{count} features: means over cells")));
    assert!(figures[0].svg.len() < LARGEST_SVG / 3);
}
