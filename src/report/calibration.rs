//! The report of a calibration.

use std::fmt::Write as _;

use super::assessment::{next_text, object_space_table, outliers_text, verdict_parts};
use super::summary::{deviation, summary_parts};
use super::tree::{Cell, Column, Figure, Part, Section, Table, sentence};
use crate::assessment::Assessment;
use crate::calibration::{
    BoardModel, Calibration, Effort, Mode, Trial, termination_text, weakest_directions_text,
};
use crate::model::{Parameter, Rmse};
use crate::quantity::{display_unit, two_digits, with_std_dev};
use crate::solver::{LossKind, Prior, SystematicChange};

/// Returns the result of a calibration: verdict, parameters, errors, convergence, weakest directions; and figures.
#[must_use]
pub fn calibration_section(
    title: &str,
    calibration: &Calibration,
    assessment: &Assessment,
    figures: Vec<Figure>,
) -> Section {
    let is_fixed = calibration.uncertainty.free_intrinsics.is_empty();
    let mut parts = verdict_parts(&assessment.findings, usize::MAX);
    parts.extend(outliers_text(assessment).into_iter().map(Part::Text));
    parts.extend(summary_parts(calibration, assessment, None, [None, None]));
    parts.extend(assessment.next_board.as_ref().map(next_text).map(Part::Text));
    parts.extend(figures.into_iter().map(Part::Figure));
    let main_table =
        if is_fixed { poses_table(calibration) } else { parameters_table(calibration) };
    let tables = [
        Some(main_table),
        priors_table(calibration),
        systematic_errors_table(calibration),
        assessment.object_space.as_ref().map(object_space_table),
        Some(errors_table(calibration)),
    ];
    let mut all: Vec<Part> = tables.into_iter().flatten().map(Part::Table).collect();
    all.extend(Part::paragraphs(&summary(calibration)));
    let what = if is_fixed { "Poses, errors and convergence" } else { ALL_PARAMETERS };
    parts.push(Part::details(what, all));
    Section::new(title, parts)
}

const ALL_PARAMETERS: &str = "All parameters, priors, errors and convergence";

fn parameters_table(calibration: &Calibration) -> Table {
    let lens_types = calibration.camera.lens_types();
    let uncertainty = &calibration.uncertainty;
    let mut columns = vec![
        Column::text("Parameter"),
        Column::text("Unit"),
        Column::number("Initial"),
        Column::number("Optimised"),
        Column::number("± σ"),
    ];
    if uncertainty.shared {
        columns.extend(["if independent", "ratio"].map(Column::number));
    }
    let mut table = Table::new("Parameters", columns);
    let std_devs = uncertainty.intrinsic_std_devs(lens_types);
    let independent = uncertainty.independent_std_devs(lens_types);
    let values = calibration.initial.intrinsics().into_iter().zip(calibration.camera.intrinsics());
    let of_camera = Parameter::intrinsic(lens_types)
        .iter()
        .copied()
        .zip(values)
        .zip(std_devs.into_iter().zip(independent));
    for ((parameter, (initial, optimised)), (std_dev, independent)) in
        of_camera.chain(of_board(calibration))
    {
        let (unit, factor) = display_unit(parameter.name(), parameter.unit());
        let scaled = std_dev.map(|s| s * factor);
        let mut row = vec![
            parameter.name().into(),
            unit.into(),
            Cell::value(initial * factor, None),
            Cell::value(optimised * factor, scaled),
            deviation(scaled),
        ];
        if uncertainty.shared {
            row.extend(match (std_dev, independent) {
                (Some(s), Some(i)) if s.is_finite() && i > 0.0 => {
                    [Cell::std_dev(Some(i * factor)), Cell::fixed(s / i, 1)]
                }
                _ => [Cell::empty(), Cell::empty()],
            });
        }
        table.push(row);
    }
    table
}

/// A parameter, its initial and optimised value, and its σ with shared and with independent errors.
type ParameterRow = ((Parameter, (f64, f64)), (Option<f64>, Option<f64>));

/// Returns the rows of the shape of a board that is not flat.
fn of_board(calibration: &Calibration) -> Vec<ParameterRow> {
    let (uncertainty, board) = (&calibration.uncertainty, &calibration.board);
    let rows = uncertainty.shape_rows(calibration.camera.lens_types());
    let independent = |row: usize| uncertainty.independent_covariance[(row, row)].sqrt();
    let of = |((parameter, row), std_dev): ((Parameter, Option<usize>), Option<f64>)| {
        let value = board.bent.shape.value(parameter);
        Some(((parameter, (0.0, value)), (std_dev, Some(independent(row?)))))
    };
    Parameter::SHAPE.into_iter().zip(rows).zip(board.std_devs).filter_map(of).collect()
}

/// Returns a text on the basis of σ.
fn std_dev_text(calibration: &Calibration) -> String {
    let uncertainty = &calibration.uncertainty;
    if uncertainty.free_intrinsics.is_empty() {
        return "σ allows for errors shared by all features of a corner.".to_owned();
    }
    if !uncertainty.shared {
        return "σ assumes that the errors of all observations are independent, and is too small if \
                they are not: shared errors are measured from six frames on."
            .to_owned();
    }
    let contradiction = uncertainty.contradiction().map_or(String::new(), |(index, std_devs)| {
        format!(
            " Boards and micro-image centres contradict each other by {std_devs:.0} σ, most in {}; \
             σ does not include this.",
            Parameter::shared(calibration.camera.lens_types())[index].name()
        )
    });
    let of_all = uncertainty.std_dev_uncertainties(calibration.camera.lens_types());
    let known = || of_all.iter().flatten().copied().filter(|u| u.is_finite());
    format!(
        "σ is estimated from the scatter between the {} frames and includes errors shared by all \
         corners of a frame. With this number of frames, σ itself is uncertain by {:.0} to {:.0} \
         %.{contradiction}",
        calibration.poses.len(),
        100.0 * known().fold(f64::INFINITY, f64::min),
        100.0 * known().fold(0.0, f64::max)
    )
}

/// Returns a text on the weight of the observations against the priors.
fn prior_weight_text(calibration: &Calibration) -> String {
    let weight = calibration.cost.prior_weight;
    let (changed, factor, known) = if weight < 1.0 {
        ("multiplied", 1.0 / weight, "better")
    } else {
        ("divided", weight, "worse")
    };
    let why = if calibration.uncertainty.shared {
        format!(
            "the frames show that the observations determine the quantities with a prior {known} \
             than their σ predict, by about this factor in variance"
        )
    } else {
        "so few frames do not show how well the observations determine the quantities with a \
         prior, and ten times the variance of independent errors is assumed"
            .to_owned()
    };
    format!(
        "The weight of every observation relative to the priors is {changed} by {factor:.3}: {why}."
    )
}

fn poses_table(calibration: &Calibration) -> Table {
    let mut table = Table::new(
        "Poses",
        [
            Column::number("Frame"),
            Column::of("x", "mm"),
            Column::number("± σ"),
            Column::of("y", "mm"),
            Column::number("± σ"),
            Column::of("z", "mm"),
            Column::number("± σ"),
            Column::of("Rotation vector", "rad"),
            Column::number("± σ"),
        ],
    );
    for (i, pose) in calibration.poses.iter().enumerate() {
        let std_devs = calibration.uncertainty.pose_std_devs(i);
        let translation = pose.camera_from_board.translation.vector;
        let rotation = pose.camera_from_board.rotation.scaled_axis();
        let mut row = vec![pose.frame.into()];
        for (value, std_dev) in translation.iter().zip(&std_devs[3..]) {
            row.extend(Cell::with_std_dev(*value, Some(*std_dev)));
        }
        let largest = std_devs[..3].iter().copied().fold(0.0, f64::max);
        let parts: Vec<String> =
            rotation.iter().map(|&v| with_std_dev(v, Some(largest)).0).collect();
        row.extend([parts.join(", ").into(), Cell::std_dev(Some(largest))]);
        table.push(row);
    }
    table
}

pub(super) fn errors_table(calibration: &Calibration) -> Table {
    let reprojection = &calibration.reprojection;
    let mut table = Table::new(
        "Reprojection errors, px, root mean square",
        [
            Column::text("RMSE of"),
            Column::number("Features"),
            Column::number("All"),
            Column::number("(u, v)"),
            Column::number("ρ"),
            Column::number("Centres"),
        ],
    );
    let number = |value: f64| Cell::fixed(value, 4);
    let mut add = |name: String, rmse: &Rmse, centers: Option<f64>| {
        table.push([
            name.into(),
            rmse.count.into(),
            number(rmse.all_px),
            number(rmse.uv_px),
            Cell::or_missing(rmse.rho_px, number),
            centers.map_or(Cell::empty(), number),
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

/// Returns the table of priors with their residuals; `None` without priors.
fn priors_table(calibration: &Calibration) -> Option<Table> {
    let mut table = Table::new(
        "Priors, results, and their residuals",
        [
            Column::text("Prior"),
            Column::text("Unit"),
            Column::number("Known"),
            Column::number("± σ"),
            Column::number("Result"),
            Column::of("Residual", "σ"),
            Column::text("From"),
        ],
    );
    for prior in &calibration.priors {
        let quantity = &prior.prior.quantity;
        let (unit, factor) = display_unit(quantity, prior.unit());
        let Prior { value, std_dev, .. } = prior.prior;
        let std_dev = Some(std_dev * factor);
        let [known, of_known] = Cell::with_std_dev(value * factor, std_dev);
        table.push([
            if quantity == "m" { "|m|" } else { quantity }.into(),
            unit.into(),
            known,
            of_known,
            Cell::value(prior.result * factor, std_dev),
            Cell::signed(prior.normalised_residual(), 2),
            prior.source.to_string().into(),
        ]);
    }
    (!calibration.priors.is_empty()).then_some(table)
}

/// Parameters in the table of systematic errors, if they are free.
const SHOWN: [&str; 6] = ["F", "D", "d", "e_z", "theta_x", "theta_y"];

/// Returns the table of systematic errors: the change of each parameter, in its σ, for one σ of each quantity from the white
/// images; `None` if these changes are not known.
fn systematic_errors_table(calibration: &Calibration) -> Option<Table> {
    let uncertainty = &calibration.uncertainty;
    let lens_types = calibration.camera.lens_types();
    let names = Parameter::shared(lens_types);
    let std_devs = uncertainty.intrinsic_std_devs(lens_types);
    let shown: Vec<usize> = (0..uncertainty.free_intrinsics.len())
        .filter(|&row| SHOWN.contains(&names[uncertainty.free_intrinsics[row]].name()))
        .collect();
    let of_parameter =
        |&row: &usize| Column::number(names[uncertainty.free_intrinsics[row]].name());
    let mut table = Table::new(
        "Quantities from the white images, and the change of parameters by one σ of each, in σ of \
         the parameter",
        std::iter::once(Column::text("One σ of")).chain(shown.iter().map(of_parameter)),
    );
    for SystematicChange { source, changes } in &uncertainty.systematic_changes {
        let share = |&row: &usize| {
            let std_dev = std_devs[uncertainty.free_intrinsics[row]].unwrap_or(f64::INFINITY);
            Cell::signed(changes[row] / std_dev, 2)
        };
        table.push(std::iter::once(source.as_str().into()).chain(shown.iter().map(share)));
    }
    (!shown.is_empty() && !uncertainty.systematic_changes.is_empty()).then_some(table)
}

fn summary(calibration: &Calibration) -> String {
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
    if let Some(ratio) = aperture_ratio_text(calibration) {
        let _ = writeln!(text, "{ratio}");
    }
    let _ = writeln!(text, "{}", std_dev_text(calibration));
    if !calibration.priors.is_empty() {
        let _ = writeln!(text, "{}", prior_weight_text(calibration));
    }
    let what = if calibration.cost.loss.kind == LossKind::None {
        "Measured noise per coordinate"
    } else {
        "Measured noise per coordinate, with large residuals weighted down by the loss"
    };
    let _ = writeln!(text, "{what}, px: {}.", sigmas.join("; "));
    if let (Some(m), Some(error)) = (calibration.m_mm, calibration.m_error()) {
        let _ = writeln!(
            text,
            "|m| is {:.3} µm in the white images and {:.3} µm in this camera: error {:.2} %.",
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

/// Returns a sentence on the shape of the board.
fn board_text(calibration: &Calibration) -> String {
    let board = &calibration.board;
    let of = |name: &str, value: &str, unit: &str| match unit {
        "1" => format!("{name} {value}"),
        unit => format!("{name} {value} {unit}"),
    };
    let found: Vec<String> = Parameter::SHAPE
        .into_iter()
        .zip(board.std_devs)
        .filter_map(|(parameter, std_dev)| {
            let (value, std_dev) = with_std_dev(board.bent.shape.value(parameter), Some(std_dev?));
            Some(of(parameter.name(), &format!("{value} ± {std_dev}"), parameter.unit()))
        })
        .collect();
    let limits: Vec<String> = Parameter::SHAPE
        .iter()
        .zip(board.limits())
        .filter_map(|(parameter, limit)| {
            Some(of(parameter.name(), &two_digits(limit?), parameter.unit()))
        })
        .collect();
    let limits = (!limits.is_empty()).then(|| format!("below {} (2 σ)", limits.join(", ")));
    let flat = found.is_empty();
    let found: Vec<String> = (!flat).then(|| found.join(", ")).into_iter().chain(limits).collect();
    let found = found.join("; ");
    match (&board.trial, calibration.options.board) {
        (Trial::NotTried, _) if !flat => format!("The shape of the board: {found}."),
        (Trial::NotTried, BoardModel::Known(_)) => {
            "The shape of the board is assumed to be known.".to_owned()
        }
        (Trial::NotTried, _) => "The board is assumed to be flat.".to_owned(),
        (Trial::TooFewFrames, _) => {
            "The board is assumed to be flat: the frames are too few to test it.".to_owned()
        }
        (Trial::Failed(reason), _) => {
            sentence(&format!("The board is assumed to be flat, because the test failed: {reason}"))
        }
        (Trial::Tried { std_devs_from_zero, .. }, _) => format!(
            "The board is {}flat: {found}. {}",
            if flat { "" } else { "not " },
            why(std_devs_from_zero)
        ),
    }
}

/// Returns the reason why a board is assumed to be flat, or not.
fn why(std_devs_from_zero: &[Option<f64>; 2]) -> String {
    let known = ["bend", "aspect"].into_iter().zip(std_devs_from_zero);
    let parts: Vec<String> = known
        .filter_map(|(name, std_devs)| Some(format!("{name} {:.1} σ", (*std_devs)?)))
        .collect();
    if parts.is_empty() {
        return "The frames do not determine its shape.".to_owned();
    }
    format!("Differences from 0: {}; the limit is 3 σ.", parts.join(", "))
}

/// Returns the effort of the refinements that only tested whether the board is flat; empty if there were none.
fn aside_text(aside: &Effort) -> String {
    match aside.iterations {
        0 => String::new(),
        iterations => format!(
            " The test for a flat board took {iterations} more iterations and {:.3} s.",
            aside.time_s
        ),
    }
}

/// Returns a sentence on the aperture ratio and the point spread; `None` if blur is not used, or if neither is known of a
/// camera that was calibrated before.
fn aperture_ratio_text(calibration: &Calibration) -> Option<String> {
    if calibration.options.mode == Mode::CornersOnly || calibration.camera.lens_types() == 0 {
        return None;
    }
    let edges = &calibration.camera.edge_spread;
    let ratio = match (edges.aperture_ratio, &calibration.blur) {
        (Some(ratio), Some(_)) => ratio.to_string(),
        (Some(ratio), None) => format!("{ratio}, assumed"),
        (None, _) if calibration.m_mm.is_some() => {
            "1, assumed, because the features have no measured blur".to_owned()
        }
        (None, _) => return None,
    };
    let spread = edges.point_spread_px2.filter(|spread| spread.std_dev > 0.0);
    let spread = spread.map(|s| format!("; point spread {} px", s.square_root()));
    Some(format!("Aperture ratio of the micro-lenses: {ratio}{}.", spread.unwrap_or_default()))
}
