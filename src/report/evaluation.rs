//! The report of an evaluation.

use super::summary::truth_text;
use super::tree::{Cell, Column, Part, Section, Table};
use crate::assessment::{
    Candidate, CrossValidation, Displacements, Evaluation, ParameterError, PoseErrors,
    Reconstruction,
};
use crate::finding::Finding;
use crate::model::{Parameter, PlenopticCamera, Rmse};
use crate::quantity::display_unit;

/// Name of the point clouds of other software in tables.
const CLOUDS: &str = "point clouds";

/// Returns the report of an evaluation: reprojection (Table 4), distances between corners, known displacements (Table 3), and
/// the largest errors against the true camera. On demand it shows `more` tables, single steps, all errors against the true
/// camera and poses, and the cross-validation of the first candidate. It has no parts if nothing was evaluated.
#[must_use]
pub fn evaluation_section(
    evaluation: &Evaluation,
    candidates: &[Candidate],
    more: Vec<Table>,
) -> Section {
    let mut reprojection = Table::new(
        "Boards not used in the calibration; poses refined with the camera fixed (paper, Table 4)",
        [
            Column::text("Camera"),
            Column::number("Frames"),
            Column::number("Features"),
            Column::of("Σ all²", "px²"),
            Column::of("RMSE all", "px"),
            Column::number("(u, v)"),
            Column::number("ρ"),
        ],
    );
    let mut motion = Table::new(
        "A board moved in known steps: error of the displacement along the optical axis (paper, Table 3)",
        [
            Column::text("Camera"),
            Column::number("Steps"),
            Column::of("Mean error", "%"),
            Column::number("± σ"),
            Column::of("Mean error", "mm"),
            Column::number("± σ"),
            Column::of("Overall error", "%"),
        ],
    );
    let mut space = Table::new(
        "Corners of these boards, each reconstructed separately from u and v: error of the \
         distances between them, and RMS distance from the posed board across and along the axis",
        [
            Column::text("Camera"),
            Column::number("Frames"),
            Column::number("Points"),
            Column::of("Distances", "%"),
            Column::number("± σ"),
            Column::of("Across", "mm"),
            Column::of("Along", "mm"),
            Column::number("Left out"),
        ],
    );
    for candidate in &evaluation.candidates {
        if let Some(found) = &candidate.evaluation {
            let rmse = found.reprojection.rmse();
            let sum = Cell::fixed(rmse.all_px.powi(2) * rmse.count as f64, 1);
            let [count, all, uv, rho] = rmse_cells(&rmse);
            let name = candidate.name.as_str().into();
            reprojection.push([name, found.poses.len().into(), count, sum, all, uv, rho]);
        }
        if let Some(found) = &candidate.reconstruction {
            space.push(reconstruction_row(&candidate.name, found));
        }
        if let Some(displacements) = &candidate.translation {
            motion.push(displacement_row(&candidate.name, displacements));
        }
    }
    if let Some(clouds) = &evaluation.clouds {
        motion.push(displacement_row(CLOUDS, clouds));
    }
    let has_steps = !motion.rows.is_empty();
    let tables = [reprojection, space, motion].into_iter().filter(|table| !table.rows.is_empty());
    let mut parts: Vec<Part> = tables.map(Part::Table).collect();
    for candidate in &evaluation.candidates {
        let truth = candidate.truth.as_deref().and_then(truth_text);
        parts.extend(truth.map(|text| Part::Text(format!("{}: {text}", candidate.name))));
    }
    let mut tables = more;
    tables.extend(has_steps.then(|| steps_table(evaluation)).flatten());
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
    let tables: Vec<Part> = tables.into_iter().map(Part::Table).collect();
    if !tables.is_empty() {
        parts.push(Part::details("Parameters, steps, truth and cross-validation", tables));
    }
    let warnings = evaluation.findings.iter().map(Finding::to_string).collect();
    Section { warnings, ..Section::new("Evaluation", parts) }
}

fn number(value: f64) -> Cell {
    Cell::fixed(value, 4)
}

fn percent(part: f64) -> Cell {
    Cell::fixed(100.0 * part, 3)
}

/// Returns cells: number of features, and errors of all coordinates, of u and v, and of ρ.
fn rmse_cells(rmse: &Rmse) -> [Cell; 4] {
    let rho = Cell::or_missing(rmse.rho_px, number);
    [rmse.count.into(), number(rmse.all_px), number(rmse.uv_px), rho]
}

fn reconstruction_row(name: &str, found: &Reconstruction) -> [Cell; 8] {
    [
        name.into(),
        found.frames.into(),
        found.points.into(),
        Cell::signed(100.0 * found.too_long.value, 3),
        percent(found.too_long.std_dev),
        number(found.across_mm),
        number(found.along_mm),
        found.left_out.into(),
    ]
}

fn displacement_row(name: &str, displacements: &Displacements) -> [Cell; 7] {
    let (relative, absolute) = (displacements.relative(), displacements.absolute_mm());
    [
        name.into(),
        displacements.steps.len().into(),
        percent(relative.mean),
        Cell::or_missing(relative.std_dev, percent),
        number(absolute.mean),
        Cell::or_missing(absolute.std_dev, number),
        percent(displacements.whole.relative_error()),
    ]
}

fn steps_table(evaluation: &Evaluation) -> Option<Table> {
    let series: Vec<(&str, &Displacements)> = evaluation
        .candidates
        .iter()
        .filter_map(|c| Some((c.name.as_str(), c.translation.as_ref()?)))
        .chain(evaluation.clouds.iter().map(|clouds| (CLOUDS, clouds)))
        .collect();
    let first = series.first()?.1;
    let columns = series.iter().map(|(name, _)| Column::of(name, "mm"));
    let mut table = Table::new(
        "Single steps",
        [Column::text("Frames"), Column::of("True", "mm")].into_iter().chain(columns),
    );
    for step in &first.steps {
        // One series may lack frames that another has.
        let measured = |displacements: &Displacements| {
            let same = displacements.steps.iter().find(|s| s.from == step.from && s.to == step.to);
            Cell::or_missing(same.map(|s| s.measured_mm), |mm| Cell::fixed(mm, 3))
        };
        let frames = format!("{} to {}", step.from, step.to).into();
        table.push(
            [frames, Cell::fixed(step.true_mm, 3)]
                .into_iter()
                .chain(series.iter().map(|(_, displacements)| measured(displacements))),
        );
    }
    Some(table)
}

/// Returns the table of parameters against their true values.
#[must_use]
pub fn truth_table(errors: &[ParameterError], caption: &str) -> Table {
    let mut table = Table::new(
        caption,
        [
            Column::text("Parameter"),
            Column::text("Unit"),
            Column::number("Truth"),
            Column::number("Estimate"),
            Column::number("± σ"),
            Column::number("Error"),
            Column::of("Error", "%"),
            Column::number("Error/σ"),
        ],
    );
    for e in errors {
        let (unit, factor) = display_unit(&e.name, e.unit);
        let [estimate, std_dev] =
            Cell::with_std_dev(e.estimate * factor, e.std_dev.map(|s| s * factor));
        table.push([
            e.name.as_str().into(),
            unit.into(),
            Cell::value(e.truth * factor, None),
            estimate,
            std_dev,
            Cell::difference(e.error() * factor),
            Cell::signed(100.0 * e.error() / e.truth.abs(), 3),
            Cell::or_missing(e.standardised(), |s| Cell::signed(s, 1)),
        ]);
    }
    table
}

/// Returns the table of errors of poses, by subset of the boards.
fn pose_errors_table(subsets: &[(String, PoseErrors)]) -> Table {
    let mut table = Table::new(
        "Errors of the poses relative to the truth, root mean square",
        [
            Column::text("Boards"),
            Column::number("Frames"),
            Column::of("Across", "mm"),
            Column::of("Along the axis", "mm"),
            Column::of("Rotation", "mrad"),
        ],
    );
    for (name, errors) in subsets {
        table.push([
            name.as_str().into(),
            errors.frames.into(),
            number(errors.across_mm),
            number(errors.along_mm),
            number(errors.rotation_rad * 1e3),
        ]);
    }
    table
}

/// Returns the table of cameras side by side (paper, Table 1). The first camera is the one before the refinement.
#[must_use]
pub fn cameras_table(initial: &PlenopticCamera, candidates: &[Candidate]) -> Table {
    let first = [Column::text("Parameter"), Column::text("Unit"), Column::number("Initial")];
    let of_candidate = |c: &Candidate| [Column::number(&c.name), Column::number("± σ")];
    let mut table = Table::new(
        "Parameters before and after the refinement (paper, Table 1)",
        first.into_iter().chain(candidates.iter().flat_map(of_candidate)),
    );
    let parameters = Parameter::intrinsic(initial.lens_types());
    for (i, (parameter, value)) in parameters.iter().zip(initial.intrinsics()).enumerate() {
        let (unit, factor) = display_unit(parameter.name(), parameter.unit());
        let cells = |candidate: &Candidate| {
            let std_dev = candidate.std_devs.get(i).copied().flatten().map(|s| s * factor);
            candidate.camera.intrinsics().get(i).map_or([Cell::Missing, Cell::empty()], |value| {
                Cell::with_std_dev(value * factor, std_dev)
            })
        };
        table.push(
            [parameter.name().into(), unit.into(), Cell::value(value * factor, None)]
                .into_iter()
                .chain(candidates.iter().flat_map(cells)),
        );
    }
    table
}

/// Returns the table of the folds, and the table of standard deviations from jackknife and covariance.
fn folds_tables(folds: &CrossValidation, candidate: &Candidate) -> Vec<Table> {
    let mut of_folds = Table::new(
        "Cross-validation: frames reprojected by a camera calibrated without them",
        [
            Column::text("Left out"),
            Column::text("Frames"),
            Column::number("Without pose"),
            Column::number("Features"),
            Column::of("RMSE all", "px"),
            Column::number("(u, v)"),
            Column::number("ρ"),
            Column::text("Converged"),
        ],
    );
    for (i, fold) in folds.folds.iter().enumerate() {
        let frames: Vec<String> = fold.frames.iter().map(ToString::to_string).collect();
        let converged = if fold.converged { "yes" } else { "no" };
        of_folds.push(
            [format!("fold {}", i + 1).into(), frames.join(", ").into(), fold.left_out.into()]
                .into_iter()
                .chain(rmse_cells(&fold.rmse))
                .chain([converged.into()]),
        );
    }
    of_folds.push(
        ["all".into(), Cell::empty(), Cell::empty()]
            .into_iter()
            .chain(rmse_cells(&folds.rmse))
            .chain([Cell::empty()]),
    );
    let mut spread = Table::new(
        "Standard deviations: from the covariance, and from calibrations without the frames of a fold",
        [
            Column::text("Parameter"),
            Column::text("Unit"),
            Column::number("± σ"),
            Column::number("± σ, jackknife"),
            Column::number("Ratio"),
        ],
    );
    let parameters = Parameter::intrinsic(candidate.camera.lens_types());
    for ((parameter, std_dev), jackknife) in
        parameters.iter().zip(&candidate.std_devs).zip(folds.jackknife_std_devs())
    {
        let Some(std_dev) = std_dev.filter(|s| s.is_finite() && *s > 0.0) else { continue };
        let (unit, factor) = display_unit(parameter.name(), parameter.unit());
        spread.push([
            parameter.name().into(),
            unit.into(),
            Cell::std_dev(Some(std_dev * factor)),
            Cell::std_dev(Some(jackknife * factor)),
            Cell::fixed(jackknife / std_dev, 2),
        ]);
    }
    // Cameras of other programs come without standard deviations.
    [of_folds, spread].into_iter().filter(|table| !table.rows.is_empty()).collect()
}
