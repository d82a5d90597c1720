//! An evaluation as tables.

use super::html::HtmlTable;
use super::table::table;
use crate::assessment::{
    Candidate, CrossValidation, Displacements, Evaluation, ParameterError, PoseErrors,
    Reconstruction,
};
use crate::model::{PlenopticCamera, Rmse, intrinsic_parameters};
use crate::quantity::{display_unit, signed, with_std_dev};

/// What tables call the point clouds of other software.
const CLOUDS: &str = "point clouds";

/// The tables of an evaluation: reprojection (Table 4), known displacements (Table 3), errors
/// against the true camera and poses, and the cross-validation of the first candidate.
#[must_use]
pub fn evaluation_tables(evaluation: &Evaluation, candidates: &[Candidate]) -> Vec<HtmlTable> {
    let mut tables = Vec::new();
    let mut reprojection = table(
        &["Camera", "Frames", "Features", "Σ all², px²", "RMSE all, px", "(u, v)", "ρ"],
        &[0],
    );
    let mut motion = table(
        &["Camera", "Steps", "Mean error, %", "± σ", "Mean error, mm", "± σ", "Overall error, %"],
        &[0],
    );
    let mut space = table(
        &[
            "Camera",
            "Frames",
            "Points",
            "Distances, %",
            "± σ",
            "Across, mm",
            "Along, mm",
            "Left out",
        ],
        &[0],
    );
    let (mut posed, mut moved) = (false, false);
    for candidate in &evaluation.candidates {
        if let Some(found) = &candidate.evaluation {
            let rmse = found.reprojection.rmse();
            posed = true;
            reprojection.add_row(
                [candidate.name.clone(), found.poses.len().to_string()]
                    .into_iter()
                    .chain(rmse_cells(&rmse, true)),
            );
        }
        if let Some(found) = &candidate.reconstruction {
            space.add_row(reconstruction_row(&candidate.name, found));
        }
        if let Some(displacements) = &candidate.translation {
            moved = true;
            motion.add_row(displacement_row(&candidate.name, displacements));
        }
    }
    if let Some(clouds) = &evaluation.clouds {
        motion.add_row(displacement_row(CLOUDS, clouds));
    }
    if posed {
        tables.push(reprojection.captioned(
            "Boards not used in the calibration; poses refined with the camera fixed (paper, Table 4)",
        ));
    }
    if evaluation.candidates.iter().any(|candidate| candidate.reconstruction.is_some()) {
        tables.push(space.captioned(
            "Their corners, each reconstructed alone from u and v: error of the distances between them, and RMS \
             distance from the posed board across and along the axis",
        ));
    }
    if moved {
        tables.push(motion.captioned(
            "A board moved in known steps: error of the displacement along the optical axis (paper, \
             Table 3)",
        ));
        tables.extend(steps_table(evaluation));
    }
    for candidate in &evaluation.candidates {
        if let Some(errors) = &candidate.truth {
            let caption = format!("Against the true camera: {}", candidate.name);
            tables.push(truth_table(errors, &caption));
        }
    }
    if !evaluation.poses.is_empty() {
        tables.push(pose_errors_table(&evaluation.poses));
    }
    if let (Some(folds), Some(candidate)) = (&evaluation.folds, candidates.first()) {
        tables.extend(folds_tables(folds, candidate));
    }
    tables
}

fn number(value: f64) -> String {
    if value.is_finite() { format!("{value:.4}") } else { "-".to_owned() }
}

fn rmse_cells(rmse: &Rmse, with_sum: bool) -> Vec<String> {
    let mut cells = vec![rmse.count.to_string()];
    if with_sum {
        cells.push(format!("{:.1}", rmse.all_px.powi(2) * rmse.count as f64));
    }
    cells.extend([
        number(rmse.all_px),
        number(rmse.uv_px),
        rmse.rho_px.map_or("-".to_owned(), number),
    ]);
    cells
}

fn reconstruction_row(name: &str, found: &Reconstruction) -> Vec<String> {
    vec![
        name.to_owned(),
        found.frames.to_string(),
        found.points.to_string(),
        format!("{:+.3}", 100.0 * found.too_long),
        format!("{:.3}", 100.0 * found.too_long_std_dev),
        number(found.across_mm),
        number(found.along_mm),
        found.left_out.to_string(),
    ]
}

fn displacement_row(name: &str, displacements: &Displacements) -> Vec<String> {
    let percent = |part: f64| format!("{:.3}", 100.0 * part);
    let (relative, absolute) = (displacements.relative(), displacements.absolute_mm());
    vec![
        name.to_owned(),
        displacements.steps.len().to_string(),
        percent(relative.mean),
        relative.std_dev.map_or("-".to_owned(), percent),
        number(absolute.mean),
        absolute.std_dev.map_or("-".to_owned(), number),
        percent(displacements.whole.relative_error()),
    ]
}

fn steps_table(evaluation: &Evaluation) -> Option<HtmlTable> {
    let series: Vec<(&str, &Displacements)> = evaluation
        .candidates
        .iter()
        .filter_map(|c| Some((c.name.as_str(), c.translation.as_ref()?)))
        .chain(evaluation.clouds.iter().map(|clouds| (CLOUDS, clouds)))
        .collect();
    let first = series.first()?.1;
    let mut header = vec!["Frames".to_owned(), "True, mm".to_owned()];
    header.extend(series.iter().map(|(name, _)| format!("{name}, mm")));
    let header: Vec<&str> = header.iter().map(String::as_str).collect();
    let mut table = table(&header, &[0]);
    for step in &first.steps {
        let mut row = vec![format!("{} to {}", step.from, step.to), format!("{:.3}", step.true_mm)];
        // One series may lack frames that another has.
        let same = |displacements: &Displacements| {
            displacements.steps.iter().find(|s| s.from == step.from && s.to == step.to).copied()
        };
        row.extend(series.iter().map(|(_, displacements)| {
            same(displacements).map_or("-".to_owned(), |s| format!("{:.3}", s.measured_mm))
        }));
        table.add_row(row);
    }
    Some(table.captioned("The steps one by one"))
}

/// Parameters against their true values.
#[must_use]
pub fn truth_table(errors: &[ParameterError], caption: &str) -> HtmlTable {
    let mut table = table(
        &["Parameter", "Unit", "Truth", "Estimate", "± σ", "Error", "Error, %", "Error/σ"],
        &[0, 1],
    );
    for e in errors {
        let (unit, factor) = display_unit(&e.name, e.unit);
        let (value, deviation) = with_std_dev(e.estimate * factor, e.std_dev.map(|s| s * factor));
        let percent = 100.0 * e.error() / e.truth.abs();
        table.add_row([
            e.name.clone(),
            unit.to_owned(),
            with_std_dev(e.truth * factor, None).0,
            value,
            deviation,
            signed(e.error() * factor),
            if e.truth == 0.0 { "-".to_owned() } else { format!("{percent:+.3}") },
            e.standardised().map_or("-".to_owned(), |s| format!("{s:+.1}")),
        ]);
    }
    table.captioned(caption)
}

/// Errors of poses by subset of the boards.
fn pose_errors_table(subsets: &[(String, PoseErrors)]) -> HtmlTable {
    let mut table =
        table(&["Boards", "Frames", "Across, mm", "Along the axis, mm", "Rotation, mrad"], &[0]);
    for (name, errors) in subsets {
        table.add_row([
            name.clone(),
            errors.frames.to_string(),
            number(errors.across_mm),
            number(errors.along_mm),
            number(errors.rotation_rad * 1e3),
        ]);
    }
    table.captioned("Errors of the poses against the true ones, root mean square")
}

/// Cameras side by side (paper, Table 1); the first is the one before the refinement.
#[must_use]
pub fn cameras_table(initial: &PlenopticCamera, candidates: &[Candidate]) -> HtmlTable {
    let mut header = vec!["Parameter".to_owned(), "Unit".to_owned(), "Initial".to_owned()];
    header.extend(candidates.iter().flat_map(|c| [c.name.clone(), "± σ".to_owned()]));
    let header: Vec<&str> = header.iter().map(String::as_str).collect();
    let mut table = table(&header, &[0, 1]);
    let parameters = intrinsic_parameters(initial.lens_types());
    for (i, (parameter, value)) in parameters.iter().zip(initial.intrinsics()).enumerate() {
        let (unit, factor) = display_unit(parameter.name, parameter.unit);
        let mut row =
            vec![parameter.name.to_owned(), unit.to_owned(), with_std_dev(value * factor, None).0];
        for candidate in candidates {
            let std_dev = candidate.std_devs.get(i).copied().flatten().map(|s| s * factor);
            match candidate.camera.intrinsics().get(i) {
                Some(value) => {
                    row.extend(<[String; 2]>::from(with_std_dev(value * factor, std_dev)));
                }
                None => row.extend(["-".to_owned(), String::new()]),
            }
        }
        table.add_row(row);
    }
    table.captioned("Parameters before and after the refinement (paper, Table 1)")
}

/// The folds, and the standard deviations by the jackknife beside those of the covariance.
fn folds_tables(folds: &CrossValidation, candidate: &Candidate) -> Vec<HtmlTable> {
    let mut of_folds = table(
        &[
            "Left out",
            "Frames",
            "Without pose",
            "Features",
            "RMSE all, px",
            "(u, v)",
            "ρ",
            "Converged",
        ],
        &[0, 1, 7],
    );
    for (i, fold) in folds.folds.iter().enumerate() {
        let frames: Vec<String> = fold.frames.iter().map(ToString::to_string).collect();
        let converged = if fold.converged { "yes" } else { "no" };
        of_folds.add_row(
            [format!("fold {}", i + 1), frames.join(", "), fold.left_out.to_string()]
                .into_iter()
                .chain(rmse_cells(&fold.rmse, false))
                .chain([converged.to_owned()]),
        );
    }
    of_folds.add_row(
        ["all".to_owned(), String::new(), String::new()]
            .into_iter()
            .chain(rmse_cells(&folds.rmse, false))
            .chain([String::new()]),
    );
    let mut spread = table(&["Parameter", "Unit", "± σ", "± σ, jackknife", "Ratio"], &[0, 1]);
    let parameters = intrinsic_parameters(candidate.camera.lens_types());
    for ((parameter, std_dev), jackknife) in
        parameters.iter().zip(&candidate.std_devs).zip(folds.jackknife_std_devs())
    {
        let Some(std_dev) = std_dev.filter(|s| s.is_finite() && *s > 0.0) else { continue };
        let (unit, factor) = display_unit(parameter.name, parameter.unit);
        let two_digits = |s: f64| with_std_dev(0.0, Some(s * factor)).1;
        spread.add_row([
            parameter.name.to_owned(),
            unit.to_owned(),
            two_digits(std_dev),
            two_digits(jackknife),
            format!("{:.2}", jackknife / std_dev),
        ]);
    }
    let mut tables = vec![
        of_folds
            .captioned("Cross-validation: frames reprojected by a camera calibrated without them"),
    ];
    let spread = spread.captioned(
        "Standard deviations: from the covariance, and from calibrations without the frames of a fold",
    );
    // Cameras of other programs come without standard deviations.
    tables.extend((!spread.rows.is_empty()).then_some(spread));
    tables
}
