//! A calibration as text and as JSON.

use std::fmt::Write as _;

use serde_json::{Value, json};

use super::table::{Table, table};
use crate::calibration::Calibration;
use crate::io::{camera_document, poses_document};
use crate::model::{Rmse, intrinsic_parameters};
use crate::solver::{LossKind, Termination, WeakDirection};

/// The distance of the boards is named when a direction explains this share of its variance.
const BOARDS_NAMED_SHARE: f64 = 0.5;

/// The result of a calibration on a terminal: parameters, errors, convergence, weakest direction.
#[must_use]
pub fn calibration_text(calibration: &Calibration) -> String {
    let held = calibration.uncertainty.free_intrinsics.is_empty();
    [
        if held { poses_table(calibration) } else { parameters_table(calibration) }.to_string(),
        errors_table(calibration).to_string(),
        summary(calibration),
    ]
    .join("\n\n")
}

/// Unit in which people read a parameter, and its factor.
pub(super) fn display_unit(name: &str, unit: &'static str) -> (&'static str, f64) {
    match name {
        "d" | "dC" => ("µm", 1e3),
        name if name.starts_with("f_") => ("µm", 1e3),
        name if name.starts_with("theta") => ("mrad", 1e3),
        _ => (unit, 1.0),
    }
}

/// A signed value with three significant digits.
pub(super) fn signed(value: f64) -> String {
    match decade(value) {
        d if (-3..3).contains(&d) => {
            format!("{value:+.precision$}", precision = usize::try_from(2 - d).unwrap_or(0))
        }
        _ => format!("{value:+.2e}"),
    }
}

/// A value with two digits of its standard deviation; six significant digits without one.
pub(super) fn with_std_dev(value: f64, std_dev: Option<f64>) -> (String, String) {
    let digits = |reference: f64, significant: i32| {
        usize::try_from(significant - 1 - decade(reference)).unwrap_or(0)
    };
    match std_dev.filter(|s| *s > 0.0 && s.is_finite()) {
        Some(s) if decade(s) < -6 => {
            let precision = usize::try_from(decade(value) - decade(s) + 1).unwrap_or(0).min(16);
            (format!("{value:.precision$e}"), format!("{s:.1e}"))
        }
        Some(s) => {
            let precision = digits(s, 2);
            (format!("{value:.precision$}"), format!("{s:.precision$}"))
        }
        None if value == 0.0 => ("0".to_owned(), String::new()),
        None if decade(value) < -3 => (format!("{value:.5e}"), String::new()),
        None => (format!("{value:.precision$}", precision = digits(value, 6)), String::new()),
    }
}

/// Power of ten of the first digit.
#[allow(clippy::cast_possible_truncation)]
fn decade(value: f64) -> i32 {
    if value == 0.0 { 0 } else { value.abs().log10().floor() as i32 }
}

pub(super) fn parameters_table(calibration: &Calibration) -> Table {
    let lens_types = calibration.camera.lens_types();
    let mut table = table(&["Parameter", "Unit", "Initial", "Optimised", "± σ"], &[0, 1]);
    let std_devs = calibration.uncertainty.intrinsic_std_devs(lens_types);
    let values = calibration.initial.intrinsics().into_iter().zip(calibration.camera.intrinsics());
    for ((parameter, (initial, optimised)), std_dev) in
        intrinsic_parameters(lens_types).iter().zip(values).zip(std_devs)
    {
        let (unit, factor) = display_unit(parameter.name, parameter.unit);
        let (value, deviation) = with_std_dev(optimised * factor, std_dev.map(|s| s * factor));
        let deviation = match std_dev {
            None => "fixed".to_owned(),
            Some(s) if s.is_infinite() => "undetermined".to_owned(),
            Some(_) => deviation,
        };
        table.add_row([
            parameter.name.to_owned(),
            unit.to_owned(),
            with_std_dev(initial * factor, None).0,
            value,
            deviation,
        ]);
    }
    table
}

fn poses_table(calibration: &Calibration) -> Table {
    let mut table = table(
        &["Frame", "x, mm", "± σ", "y, mm", "± σ", "z, mm", "± σ", "Rotation vector, rad", "± σ"],
        &[],
    );
    for (i, pose) in calibration.poses.iter().enumerate() {
        let std_devs = calibration.uncertainty.pose_std_devs(i);
        let translation = pose.camera_from_board.translation.vector;
        let rotation = pose.camera_from_board.rotation.scaled_axis();
        let mut row = vec![pose.frame.to_string()];
        for (value, std_dev) in translation.iter().zip(&std_devs[3..]) {
            let (value, deviation) = with_std_dev(*value, Some(*std_dev));
            row.extend([value, deviation]);
        }
        let largest = std_devs[..3].iter().copied().fold(0.0, f64::max);
        let parts: Vec<String> =
            rotation.iter().map(|&v| with_std_dev(v, Some(largest)).0).collect();
        row.extend([parts.join(", "), with_std_dev(0.0, Some(largest)).1]);
        table.add_row(row);
    }
    table
}

pub(super) fn errors_table(calibration: &Calibration) -> Table {
    let reprojection = &calibration.reprojection;
    let mut table = table(&["RMSE, px", "Features", "All", "(u, v)", "ρ", "Centres"], &[0]);
    let number = |value: f64| if value.is_nan() { "-".to_owned() } else { format!("{value:.4}") };
    let mut add = |name: String, rmse: &Rmse, centers: Option<f64>| {
        table.add_row([
            name,
            rmse.count.to_string(),
            number(rmse.all_px),
            number(rmse.uv_px),
            rmse.rho_px.map_or("-".to_owned(), number),
            centers.map_or(String::new(), number),
        ]);
    };
    add("All".to_owned(), &reprojection.rmse(), reprojection.centers_rmse_px());
    for lens_type in 0..calibration.camera.lens_types() {
        let rmse = reprojection.lens_type_rmse(lens_type);
        add(format!("Lens type {}", lens_type + 1), &rmse, None);
    }
    for pose in &calibration.poses {
        add(format!("Frame {}", pose.frame), &reprojection.frame_rmse(pose.frame), None);
    }
    table
}

pub(super) fn summary(calibration: &Calibration) -> String {
    let refinement = &calibration.refinement;
    let mut text = String::new();
    // Writing to a String cannot fail.
    let _ = writeln!(text, "{}", termination_text(calibration));
    let _ = writeln!(
        text,
        "Cost {:.6} (at the start {:.6}) after {} iterations in {:.3} s.",
        refinement.cost,
        refinement.initial_cost,
        refinement.iterations.last().map_or(0, |i| i.number),
        refinement.time_s
    );
    let [uv, rho, centers] = calibration.uncertainty.residual_std_dev_px;
    let sigma = |name: &str, value: f64| {
        if value.is_nan() { String::new() } else { format!("{name} {value:.4}") }
    };
    let sigmas: Vec<String> = [sigma("u, v", uv), sigma("ρ", rho), sigma("centres", centers)]
        .into_iter()
        .filter(|s| !s.is_empty())
        .collect();
    let counts = match calibration.initial_centers_rmse_px {
        Some(rmse) => format!(
            "{} features of {} frames; {} centres, missed by {rmse:.3} px RMS at the start.",
            calibration.reprojection.features.len(),
            calibration.poses.len(),
            calibration.reprojection.centers.len()
        ),
        None => format!(
            "{} features of {} frames; no centres.",
            calibration.reprojection.features.len(),
            calibration.poses.len()
        ),
    };
    let _ = writeln!(text, "{counts}");
    let what = if calibration.options.cost.loss.kind == LossKind::None {
        "Measured noise per coordinate"
    } else {
        "Spread per coordinate after weighting by the loss, on which σ rests (below the noise)"
    };
    let _ = writeln!(text, "{what}, px: {}.", sigmas.join("; "));
    if let (Some(m), Some(error)) = (calibration.m_mm, calibration.m_error()) {
        let _ = writeln!(
            text,
            "|m| of the white images is {:.3} µm, of this camera {:.3} µm: error {:.2} %.",
            m * 1e3,
            m / (1.0 - error) * 1e3,
            100.0 * error
        );
    }
    let directions = weakest_directions_text(calibration);
    if !directions.is_empty() {
        let _ = writeln!(text, "Weakest directions:");
    }
    for (i, direction) in directions.iter().enumerate() {
        let _ = writeln!(text, "{}. {direction}.", i + 1);
    }
    text
}

/// How the refinement ended, in a sentence.
#[must_use]
pub fn termination_text(calibration: &Calibration) -> String {
    let decrease = calibration.uncertainty.expected_decrease;
    let refinement = &calibration.refinement;
    match (refinement.termination, calibration.converged) {
        (_, true) => format!(
            "Converged: a further Gauss-Newton step would lower the cost by {decrease:.1e}."
        ),
        (Termination::Converged, false) => format!(
            "The solver stopped ({}), but a further step would still lower the cost by \
             {decrease:.1e}.",
            refinement.message
        ),
        (Termination::IterationLimit, _) => format!(
            "Stopped at the limit of iterations; a further step would still lower the cost by \
             {decrease:.1e}. Raise --max-iterations."
        ),
        (Termination::Stopped, _) => "Stopped by the caller.".to_owned(),
        (Termination::Failed, _) => format!("The solver failed: {}", refinement.message),
    }
}

/// The weakest directions in words, a sentence each; the weakest first.
#[must_use]
pub fn weakest_directions_text(calibration: &Calibration) -> Vec<String> {
    let lens_types = calibration.camera.lens_types();
    let directions = calibration.uncertainty.weakest_directions(lens_types);
    directions.iter().map(direction_text).collect()
}

fn direction_text(direction: &WeakDirection) -> String {
    let mut names: Vec<&str> = direction.components.iter().map(|c| c.name.as_str()).collect();
    let mut changes: Vec<String> = direction
        .components
        .iter()
        .map(|c| {
            let (unit, factor) = display_unit(&c.name, c.unit);
            format!("{} {} {unit} ({:.0} %)", c.name, signed(c.change * factor), 100.0 * c.share)
        })
        .collect();
    let boards = direction.board_distance_share >= BOARDS_NAMED_SHARE;
    if boards {
        changes.push(format!(
            "board distance {} mm ({:.0} %)",
            signed(direction.board_distance_mm),
            100.0 * direction.board_distance_share
        ));
    }
    let last = names.pop().unwrap_or_default();
    let subject = match (names.is_empty(), boards) {
        (true, true) => format!("{last} trades off against board distance"),
        (true, false) => format!("{last} is the least certain"),
        (false, true) => {
            format!("{} and {last} trade off against board distance", names.join(", "))
        }
        (false, false) => format!("{} and {last} trade off against each other", names.join(", ")),
    };
    let along = if direction.determined {
        "along one σ, with the share of each variance"
    } else {
        "NOT DETERMINED by these observations; along it, with the share of each"
    };
    format!("{subject}; {along}: {}", changes.join(", "))
}

/// The content of `camera.json` for a calibration, `converged` among it.
#[must_use]
pub fn calibrated_camera(calibration: &Calibration) -> Value {
    let mut camera = camera_document(&calibration.camera, Some(&calibration.uncertainty));
    camera["converged"] = calibration.converged.into();
    camera
}

pub(super) fn rmse_json(rmse: &Rmse) -> Value {
    json!({ "features": rmse.count, "all": rmse.all_px, "uv": rmse.uv_px, "rho": rmse.rho_px })
}

/// The result of a calibration as one JSON object. `time_s` is the wall time of the whole command.
#[must_use]
pub fn calibration_json(calibration: &Calibration, time_s: f64) -> Value {
    let (refinement, reprojection) = (&calibration.refinement, &calibration.reprojection);
    let mut rmse = rmse_json(&reprojection.rmse());
    rmse["centers"] = json!(reprojection.centers_rmse_px());
    let frames: Vec<Value> = calibration
        .poses
        .iter()
        .map(|p| {
            let mut entry = rmse_json(&reprojection.frame_rmse(p.frame));
            entry["frame"] = json!(p.frame);
            entry
        })
        .collect();
    let types: Vec<Value> = (0..calibration.camera.lens_types())
        .map(|i| rmse_json(&reprojection.lens_type_rmse(i)))
        .collect();
    let left_out: Vec<Value> = calibration
        .left_out
        .iter()
        .map(|l| json!({ "frame": l.frame, "features": l.features, "reason": l.reason }))
        .collect();
    let [uv, rho, centers] = calibration.uncertainty.residual_std_dev_px;
    let uncertainty = Some(&calibration.uncertainty);
    json!({
        "converged": calibration.converged,
        "termination": termination_text(calibration),
        "cost": refinement.cost,
        "initial_cost": refinement.initial_cost,
        "expected_decrease": calibration.uncertainty.expected_decrease,
        "iterations": refinement.iterations.last().map_or(0, |i| i.number),
        "rmse": rmse,
        "rmse_by_frame": frames,
        "rmse_by_lens_type": types,
        "m_error": calibration.m_error(),
        "initial_centers_rmse": calibration.initial_centers_rmse_px,
        "noise": {
            "uv": uv,
            "rho": rho,
            "centers": centers,
            "weighted_by_loss": calibration.options.cost.loss.kind != LossKind::None,
        },
        "counts": {
            "features": reprojection.features.len(),
            "centers": reprojection.centers.len(),
            "frames": calibration.poses.len(),
            "frames_left_out": calibration.left_out.len(),
            "features_left_out":
                calibration.left_out.iter().map(|l| l.features).sum::<usize>(),
            "parameters": calibration.uncertainty.size(),
        },
        "frames_left_out": left_out,
        "time_s": time_s,
        "solver_time_s": refinement.time_s,
        "weakest_directions": weakest_directions_text(calibration),
        "warnings": calibration.warnings,
        "initial_camera": camera_document(&calibration.initial, None),
        "camera": calibrated_camera(calibration),
        "poses": poses_document(&calibration.poses, uncertainty)["poses"],
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_carry_two_digits_of_their_uncertainty() {
        let text = |value, std_dev| with_std_dev(value, std_dev);
        assert_eq!(text(54.741_46, Some(0.108)), ("54.74".into(), "0.11".into()));
        assert_eq!(text(2559.25, Some(19.3)), ("2559".into(), "19".into()));
        assert_eq!(text(-0.000_281_004, Some(9.6e-6)), ("-0.0002810".into(), "0.0000096".into()));
        assert_eq!(text(-3.3352e-8, Some(6.9e-8)), ("-3.3e-8".into(), "6.9e-8".into()));
        assert_eq!(text(0.0, None), ("0".into(), String::new()));
        assert_eq!(text(318.632_4, None), ("318.632".into(), String::new()));
    }

    #[test]
    fn signed_values_have_three_digits() {
        assert_eq!(signed(6.7551), "+6.76");
        assert_eq!(signed(-0.036_46), "-0.0365");
        assert_eq!(signed(123.4), "+123");
        assert_eq!(signed(-5.17e-5), "-5.17e-5");
    }
}
