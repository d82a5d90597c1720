//! A calibration at a glance.

use nalgebra::Vector2;

use super::tree::{Cell, Column, Figure, Part, Table};
use crate::assessment::{Assessment, Evaluation, ObjectSpace, ParameterError};
use crate::calibration::Calibration;
use crate::model::{Parameter, Rmse};
use crate::quantity::{display_unit, fixed, fixed_signed};

/// Parameters that are shown, in this order, with the focal lengths of the lens types after the third.
const SHOWN: [&str; 4] = ["F", "D", "d", "e_z"];
const TILT: [&str; 2] = ["theta_x", "theta_y"];

/// Returns the main parameters, the errors, σ in space, and the results of an evaluation; with the figures of the scene and of
/// σ in space.
pub(super) fn summary_parts(
    calibration: &Calibration,
    assessment: &Assessment,
    evaluation: Option<&Evaluation>,
    [scene, of_space]: [Option<Figure>; 2],
) -> Vec<Part> {
    let first = evaluation.and_then(|evaluation| evaluation.candidates.first());
    let of_calibration = rmse_text(&calibration.reprojection.rmse());
    let frames = calibration.poses.len();
    let mut parts: Vec<Part> = main_parameters(calibration).map(Part::Table).into_iter().collect();
    parts.extend(scene.map(Part::Figure));
    parts.push(Part::Text(format!(
        "Reprojection errors (RMS): {of_calibration} in {frames} frames."
    )));
    if let Some(posed) = first.and_then(|result| result.evaluation.as_ref()) {
        let (held_out, frames) = (rmse_text(&posed.reprojection.rmse()), posed.poses.len());
        parts.push(Part::Text(format!("Held-out boards: {held_out} in {frames} frames.")));
    }
    let space = assessment.object_space.as_ref();
    parts.extend(space.map(|space| Part::Table(space_table(space))));
    parts.extend(of_space.map(Part::Figure));
    if let Some(displacements) = first.and_then(|result| result.translation.as_ref()) {
        let relative = displacements.relative();
        let std_dev =
            relative.std_dev.map_or(String::new(), |s| format!(" ± {}", fixed(100.0 * s, 3)));
        parts.push(Part::Text(format!(
            "Known steps: the mean error of the displacements is {}{std_dev} % ({} steps).",
            fixed(100.0 * relative.mean, 3),
            displacements.steps.len()
        )));
    }
    let truth = first.and_then(|result| result.truth.as_deref());
    parts.extend(truth.and_then(truth_text).map(Part::Text));
    parts
}

pub(super) fn rmse_text(rmse: &Rmse) -> String {
    let rho = rmse.rho_px.map_or(String::new(), |rho| format!(", ρ {} px", fixed(rho, 4)));
    format!("(u, v) {} px{rho}; {} features", fixed(rmse.uv_px, 4), rmse.count)
}

/// Returns the table of the shown parameters with σ; `None` if all are fixed.
fn main_parameters(calibration: &Calibration) -> Option<Table> {
    if calibration.uncertainty.free_intrinsics.is_empty() {
        return None;
    }
    let lens_types = calibration.camera.lens_types();
    let std_devs = calibration.uncertainty.intrinsic_std_devs(lens_types);
    let columns = [
        Column::text("Parameter"),
        Column::number("Value"),
        Column::number("± σ"),
        Column::text("Unit"),
    ];
    let mut table = Table::new("Main parameters", columns);
    let parameters = Parameter::intrinsic(lens_types);
    let values = calibration.camera.intrinsics().into_iter().zip(std_devs);
    let mut rows: Vec<(usize, [Cell; 4])> = Vec::new();
    for (parameter, (value, std_dev)) in parameters.iter().zip(values) {
        let name = parameter.name();
        // The focal lengths follow d.
        let place = if name.starts_with("f_") { Some(3) } else { place_of(name) };
        let Some(place) = place else { continue };
        rows.push((place, row(name, parameter.unit(), value, std_dev)));
    }
    rows.sort_by_key(|(place, _)| *place);
    for (_, row) in rows.into_iter().chain(tilt(calibration).map(|row| (0, row))) {
        table.push(row);
    }
    Some(table)
}

fn place_of(name: &str) -> Option<usize> {
    SHOWN.iter().position(|shown| *shown == name).map(|i| if i < 3 { i } else { i + 1 })
}

fn row(name: &str, unit: &'static str, value: f64, std_dev: Option<f64>) -> [Cell; 4] {
    let (unit, factor) = display_unit(name, unit);
    let scaled = std_dev.map(|s| s * factor);
    [name.into(), Cell::value(value * factor, scaled), deviation(scaled), unit.into()]
}

/// Returns the cell of the σ of a parameter, in the unit of its row; a fixed parameter has none.
pub(super) fn deviation(std_dev: Option<f64>) -> Cell {
    match std_dev {
        None => "fixed".into(),
        Some(s) if s.is_infinite() => "undetermined".into(),
        Some(_) => Cell::std_dev(std_dev),
    }
}

/// Returns the angle between array and sensor, √(θx² + θy²); `None` if it is fixed.
fn tilt(calibration: &Calibration) -> Option<[Cell; 4]> {
    let uncertainty = &calibration.uncertainty;
    let parameters = Parameter::shared(calibration.camera.lens_types());
    let free = &uncertainty.free_intrinsics;
    let row_of = |name: &str| free.iter().position(|&i| parameters[i].name() == name);
    let (x, y) = (row_of(TILT[0])?, row_of(TILT[1])?);
    let angles = calibration.camera.mla.rotation_rad.xy();
    let angle = angles.norm();
    // An angle of 0 has no direction.
    let by = if angle > 0.0 { angles / angle } else { Vector2::x() };
    let covariance = |a: usize, b: usize| uncertainty.covariance[(a, b)];
    let variance = by.x * by.x * covariance(x, x)
        + 2.0 * by.x * by.y * covariance(x, y)
        + by.y * by.y * covariance(y, y);
    let known = covariance(x, x).is_finite() && covariance(y, y).is_finite();
    let std_dev = if known { variance.max(0.0).sqrt() } else { f64::INFINITY };
    let mut row = row("theta", "rad", angle, Some(std_dev));
    row[0] = "tilt".into();
    Some(row)
}

/// Returns the table of σ of points at the nearest, a middle and the furthest distance of the boards.
fn space_table(space: &ObjectSpace) -> Table {
    let mut table = Table::new(
        "σ of a point in space, median over the image: from the calibration, and from the noise of \
         one corner",
        [
            Column::of("Distance", "mm"),
            Column::of("± across", "mm"),
            Column::of("± along", "mm"),
            Column::of("Noise across", "mm"),
            Column::of("along", "mm"),
        ],
    );
    for distance in space.spread_distances() {
        let [[across, along], _] = distance.summary_mm();
        let [noise_across, noise_along] = distance.noise_mm();
        let numbers = [across, along, noise_across, noise_along];
        let distance = Cell::fixed(distance.distance_mm, 1);
        table.push([distance].into_iter().chain(numbers.map(Cell::two_digits)));
    }
    table
}

/// Returns a text on the errors of the parameters against the true ones; `None` if there is no σ, or no F.
pub(super) fn truth_text(errors: &[ParameterError]) -> Option<String> {
    let of = |error: &&ParameterError| error.standardised().map(f64::abs);
    let known = errors.iter().filter(|error| of(error).is_some());
    let worst = known.max_by(|a, b| of(a).unwrap_or(0.0).total_cmp(&of(b).unwrap_or(0.0)))?;
    let focal = errors.iter().find(|error| error.name == "F")?;
    Some(format!(
        "Against the true camera: the error of F is {} %; the largest error is {} σ, of {}.",
        fixed_signed(100.0 * focal.error() / focal.truth, 3),
        fixed_signed(worst.standardised()?, 1),
        worst.name
    ))
}
