//! The report of the worth of groups of parameters.

use super::tree::{Cell, Column, Figure, Part, Table, sentence};
use crate::assessment::{ModelComparison, WithoutGroup};
use crate::calibration::Calibration;

/// Caption of the table of models.
pub const MODELS: &str = "Contribution of each group of parameters: the calibration without it, and the growth of the squared \
     error of held-out frames";

/// Returns the table of models, with its conclusions. `figures` come from `model_figures`, or are empty.
#[must_use]
pub fn models_parts(
    calibration: &Calibration,
    comparison: &ModelComparison,
    figures: Vec<Vec<Figure>>,
) -> Vec<Part> {
    let mut parts = vec![Part::Table(models_table(calibration, comparison))];
    parts.extend(sentences(calibration, comparison).into_iter().map(Part::Text));
    for (without, figures) in comparison.groups.iter().zip(figures) {
        parts.push(Part::Details {
            summary: format!("Residuals with and without the {}", without.group),
            parts: figures.into_iter().map(Part::Figure).collect(),
        });
    }
    parts
}

fn models_table(calibration: &Calibration, comparison: &ModelComparison) -> Table {
    let mut table = Table::new(
        MODELS,
        [
            Column::text("Without"),
            Column::text("Verdict"),
            Column::of("Error", "%"),
            Column::number("± σ"),
            Column::of("F", "mm"),
            Column::of("F", "%"),
            Column::of("F", "σ"),
            Column::of("Pattern", "%"),
            Column::number("χ² corners"),
            Column::number("centres"),
            Column::number("known"),
        ],
    );
    let percent = |part: f64| Cell::fixed(100.0 * part, 0);
    let focal_length = calibration.camera.main_lens.focal_length_mm;
    let lens_types = calibration.camera.lens_types();
    let std_dev = calibration.uncertainty.intrinsic_std_devs(lens_types)[0];
    let in_mm = |value: f64| Cell::value(value, std_dev);
    let mut all = vec![Cell::from("nothing"), Cell::empty(), Cell::empty(), Cell::empty()];
    all.extend([in_mm(focal_length), Cell::empty(), Cell::empty(), percent(comparison.pattern)]);
    all.extend([const { Cell::Text(String::new()) }; 3]);
    table.push(all);
    for without in &comparison.groups {
        let (mean, std_error) = without.mean_growth();
        let (longer, std_devs) = without.focal_length_change;
        let row = [
            without.group.to_string().into(),
            without.worth().to_string().into(),
            Cell::difference(100.0 * mean),
            Cell::two_digits(100.0 * std_error),
            in_mm(focal_length + longer),
            Cell::signed(100.0 * longer / focal_length, 2),
            Cell::or_missing(std_devs, |std_devs| Cell::signed(std_devs, 1)),
            percent(without.pattern),
        ];
        let growth = without.cost_growth.map(|growth| Cell::signed(growth, 1));
        table.push(row.into_iter().chain(growth));
    }
    table
}

fn sentences(calibration: &Calibration, comparison: &ModelComparison) -> Vec<String> {
    let mut sentences = vec![format!(
        "Error: growth of |r/σ|² of a feature in held-out frames, averaged over the frames, with σ \
         from their scatter; with all groups the mean of |r/σ|² is {:.3} ({} folds of {} frames). \
         A group is needed if the growth exceeds 1 % and 2 σ, and harmful if the error shrinks by \
         as much. χ²: growth of twice the cost, by parts, divided by the weight of the priors.",
        comparison.mean_error(),
        comparison.folds,
        comparison.errors.len()
    )];
    let unasked = comparison.groups.iter().filter(|without| without.moves_unasked());
    sentences.extend(unasked.map(|without| unasked_text(calibration, without)));
    sentences.extend(
        comparison.findings.iter().map(|finding| sentence(&format!("Not compared: {finding}"))),
    );
    sentences
}

/// Returns a text on a focal length that depends on a group that the frames do not determine.
fn unasked_text(calibration: &Calibration, without: &WithoutGroup) -> String {
    let (longer, std_devs) = without.focal_length_change;
    format!(
        "Without the {}, F is {:.3} mm ({:+.2} %, {:+.1} σ), and the held-out frames do not decide \
         which is right: state a prior on F or on {}.",
        without.group,
        without.camera.main_lens.focal_length_mm,
        100.0 * longer / calibration.camera.main_lens.focal_length_mm,
        std_devs.unwrap_or(f64::NAN),
        without.parameters.iter().map(|p| p.name()).collect::<Vec<_>>().join(", ")
    )
}
