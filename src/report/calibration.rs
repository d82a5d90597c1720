//! A calibration as tables and text.

use std::fmt::Write as _;

use super::assessment::{
    OBJECT_SPACE, anchors_table, object_space_table, outliers_text, verdict_lines,
};
use super::board::{aside_text, board_text};
use super::common_errors::{COMMON_ERRORS, common_errors_table};
use super::fill_factor::fill_factor_text;
use super::table::{Table, table};
use crate::assessment::Assessment;
use crate::calibration::{Calibration, termination_text, weakest_directions_text};
use crate::model::{
    BoardShape, Named, Parameter, Rmse, SHAPE_PARAMETERS, intrinsic_parameters, shared_parameters,
};
use crate::quantity::{display_unit, with_std_dev};
use crate::solver::LossKind;

/// The result of a calibration on a terminal: parameters, errors, convergence, weakest direction.
#[must_use]
pub fn calibration_text(calibration: &Calibration, assessment: &Assessment) -> String {
    let is_fixed = calibration.uncertainty.free_intrinsics.is_empty();
    let mut verdict = verdict_lines(assessment);
    verdict.extend(outliers_text(assessment));
    let mut parts = vec![
        verdict.join("\n"),
        if is_fixed { poses_table(calibration) } else { parameters_table(calibration) }.to_string(),
    ];
    parts.extend(anchors_table(calibration).map(|table| table.to_string()));
    parts.extend(
        common_errors_table(calibration).map(|table| table.captioned(COMMON_ERRORS).to_string()),
    );
    let space = assessment.object_space.as_ref();
    parts.extend(space.map(|space| object_space_table(space).captioned(OBJECT_SPACE).to_string()));
    parts.extend([errors_table(calibration).to_string(), summary(calibration)]);
    parts.join("\n\n")
}

pub(super) fn parameters_table(calibration: &Calibration) -> Table {
    let lens_types = calibration.camera.lens_types();
    let uncertainty = &calibration.uncertainty;
    let mut header = vec!["Parameter", "Unit", "Initial", "Optimised", "± σ"];
    if uncertainty.shared {
        header.extend(["if independent", "ratio"]);
    }
    let mut table = table(&header, &[0, 1]);
    let std_devs = uncertainty.intrinsic_std_devs(lens_types);
    let independent = uncertainty.independent_std_devs(lens_types);
    let values = calibration.initial.intrinsics().into_iter().zip(calibration.camera.intrinsics());
    let of_camera = intrinsic_parameters(lens_types)
        .iter()
        .map(Parameter::named)
        .zip(values)
        .zip(std_devs.into_iter().zip(independent));
    for ((parameter, (initial, optimised)), (std_dev, independent)) in
        of_camera.chain(of_board(calibration))
    {
        let (unit, factor) = display_unit(parameter.name, parameter.unit);
        let (value, deviation) = with_std_dev(optimised * factor, std_dev.map(|s| s * factor));
        let deviation = match std_dev {
            None => "fixed".to_owned(),
            Some(s) if s.is_infinite() => "undetermined".to_owned(),
            Some(_) => deviation,
        };
        let mut row = vec![
            parameter.name.to_owned(),
            unit.to_owned(),
            with_std_dev(initial * factor, None).0,
            value,
            deviation,
        ];
        if uncertainty.shared {
            row.extend(match (std_dev, independent) {
                (Some(s), Some(i)) if s.is_finite() && i > 0.0 => {
                    [with_std_dev(0.0, Some(i * factor)).1, format!("{:.1}", s / i)]
                }
                _ => [String::new(), String::new()],
            });
        }
        table.add_row(row);
    }
    table
}

/// A parameter, its initial and optimised value, and both σ.
type ParameterRow = ((Named, (f64, f64)), (Option<f64>, Option<f64>));

/// The rows of a board that is not flat.
fn of_board(calibration: &Calibration) -> Vec<ParameterRow> {
    let (uncertainty, board) = (&calibration.uncertainty, &calibration.board);
    let rows = uncertainty.shape_rows(calibration.camera.lens_types());
    let independent = |row: usize| uncertainty.independent_covariance[(row, row)].sqrt();
    let of =
        |((parameter, row), std_dev): ((&Parameter<BoardShape>, Option<usize>), Option<f64>)| {
            let value = parameter.value(&board.bent.shape);
            Some(((parameter.named(), (0.0, value)), (std_dev, Some(independent(row?)))))
        };
    SHAPE_PARAMETERS.iter().zip(rows).zip(board.std_devs).filter_map(of).collect()
}

/// What σ rests on.
fn std_dev_text(calibration: &Calibration) -> String {
    let uncertainty = &calibration.uncertainty;
    if uncertainty.free_intrinsics.is_empty() {
        return "σ lets all features of a corner have errors in common.".to_owned();
    }
    if !uncertainty.shared {
        return "σ takes the errors of all observations as independent: it needs six frames to see \
                what they share, and is too small if they do."
            .to_owned();
    }
    let contradiction = uncertainty.contradiction.map_or(String::new(), |(index, std_devs)| {
        format!(
            " Boards and micro-image centres contradict each other by {std_devs:.0} σ, most in {}; \
             σ does not contain that.",
            shared_parameters(calibration.camera.lens_types())[index].name
        )
    });
    let of_all = uncertainty.std_dev_uncertainties(calibration.camera.lens_types());
    let known = || of_all.iter().flatten().copied().filter(|u| u.is_finite());
    format!(
        "σ comes from how much the {} frames contradict each other, so it holds what all corners of a \
         frame have in common. With so few frames it is itself uncertain by {:.0} to {:.0} \
         %.{contradiction}",
        calibration.poses.len(),
        100.0 * known().fold(f64::INFINITY, f64::min),
        100.0 * known().fold(0.0, f64::max)
    )
}

/// How observations count against anchors.
fn anchor_weight_text(calibration: &Calibration) -> String {
    let weight = calibration.cost.anchor_weight;
    let (changed, factor, known) = if weight < 1.0 {
        ("multiplied", 1.0 / weight, "better")
    } else {
        ("divided", weight, "worse")
    };
    let why = if calibration.uncertainty.shared {
        format!(
            "as the frames show, the observations know the anchored quantities about that much {known} \
             (in variance) than their σ predict"
        )
    } else {
        "so few frames do not show how well the observations know the anchored quantities, and ten \
         times the variance of independent errors is assumed"
            .to_owned()
    };
    format!(
        "Against the anchors, the weight of every observation is {changed} by {factor:.3}: {why}."
    )
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
        "Cost {:.6} (initially {:.6}) after {} iterations in {:.3} s.{}",
        refinement.cost,
        refinement.initial_cost,
        refinement.iterations.last().map_or(0, |i| i.number),
        refinement.time_s,
        aside_text(&calibration.board.aside)
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
            "{} features of {} frames; {} centres, initial RMS residual {rmse:.3} px.",
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
    let _ = writeln!(text, "{}", board_text(calibration));
    if let Some(fill) = fill_factor_text(calibration) {
        let _ = writeln!(text, "{fill}");
    }
    let _ = writeln!(text, "{}", std_dev_text(calibration));
    if !calibration.anchors.is_empty() {
        let _ = writeln!(text, "{}", anchor_weight_text(calibration));
    }
    let what = if calibration.cost.loss.kind == LossKind::None {
        "Measured noise per coordinate"
    } else {
        "Measured noise per coordinate, large residuals weighted down by the loss"
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
