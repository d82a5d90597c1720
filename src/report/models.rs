//! What groups of parameters are worth, as a table and text.

use super::assessment::two_digits;
use super::html::{Figure, Part};
use super::table::{Table, table};
use crate::assessment::{ModelComparison, WithoutGroup};
use crate::calibration::Calibration;
use crate::quantity::{signed, with_std_dev};

/// Caption of the table of models.
pub const MODELS: &str = "What each group of parameters is worth: the calibration without it, and how much \
     larger the squared error of frames then is that took no part";

/// The table of models, with what follows from it.
#[must_use]
pub fn models_text(calibration: &Calibration, comparison: &ModelComparison) -> String {
    let table = models_table(calibration, comparison).captioned(MODELS).to_string();
    [table].into_iter().chain(sentences(calibration, comparison)).collect::<Vec<_>>().join("\n")
}

/// The same for a report; `figures` are those of `model_figures`.
#[must_use]
pub fn models_parts(
    calibration: &Calibration,
    comparison: &ModelComparison,
    figures: Vec<Vec<Figure>>,
) -> Vec<Part> {
    let mut parts = vec![Part::Table(models_table(calibration, comparison).captioned(MODELS))];
    parts.extend(sentences(calibration, comparison).into_iter().map(Part::Text));
    for (without, figures) in comparison.groups.iter().zip(figures) {
        parts.push(Part::Details {
            summary: format!("Residuals with the {} and without", without.group),
            parts: figures.into_iter().map(Part::Figure).collect(),
        });
    }
    parts
}

fn models_table(calibration: &Calibration, comparison: &ModelComparison) -> Table {
    let mut table = table(
        &[
            "Without",
            "Verdict",
            "Error, %",
            "± σ",
            "F, mm",
            "F, %",
            "F, σ",
            "Pattern, %",
            "χ² corners",
            "centres",
            "known",
        ],
        &[0, 1],
    );
    let percent = |part: f64| format!("{:.0}", 100.0 * part);
    let focal_length = calibration.camera.main_lens.focal_length_mm;
    let lens_types = calibration.camera.lens_types();
    let std_dev = calibration.uncertainty.intrinsic_std_devs(lens_types)[0];
    let in_mm = |value: f64| with_std_dev(value, std_dev).0;
    let mut all = vec!["nothing".to_owned(), String::new(), String::new(), String::new()];
    all.extend([in_mm(focal_length), String::new(), String::new(), percent(comparison.pattern)]);
    all.extend([const { String::new() }; 3]);
    table.add_row(all);
    for without in &comparison.groups {
        let (mean, std_error) = without.mean_growth();
        let (longer, std_devs) = without.focal_length_change;
        let mut row = vec![
            without.group.to_string(),
            without.worth().to_string(),
            signed(100.0 * mean),
            two_digits(100.0 * std_error),
            in_mm(focal_length + longer),
            format!("{:+.2}", 100.0 * longer / focal_length),
            std_devs.map_or("-".to_owned(), |std_devs| format!("{std_devs:+.1}")),
            percent(without.pattern),
        ];
        row.extend(without.cost_growth.map(|growth| format!("{growth:+.1}")));
        table.add_row(row);
    }
    table
}

fn sentences(calibration: &Calibration, comparison: &ModelComparison) -> Vec<String> {
    let mut sentences = vec![format!(
        "Error: |r/σ|² of a feature in a frame that took no part in the calibration; with everything its mean is \
         {:.3} ({} folds of {} frames). Given is by how much it grows, in the mean over the frames, with σ from \
         their scatter. A group earns its keep if that is more than 1 % and more than 2 σ, and harms if it is as \
         much less. χ²: by how much twice the cost grows, in its parts, divided by the weight of the anchors.",
        comparison.mean_error(),
        comparison.folds,
        comparison.errors.len()
    )];
    let unasked = comparison.groups.iter().filter(|without| without.moves_unasked());
    sentences.extend(unasked.map(|without| unasked_text(calibration, without)));
    sentences.extend(comparison.findings.iter().map(|finding| format!("Not compared: {finding}.")));
    sentences
}

/// For a focal length that depends on what the frames do not decide.
fn unasked_text(calibration: &Calibration, without: &WithoutGroup) -> String {
    let (longer, std_devs) = without.focal_length_change;
    format!(
        "Without the {} F would be {:.3} mm ({:+.2} %, {:+.1} σ), and the left-out frames do not say which is \
         right: state what you know of F or of {}.",
        without.group,
        without.camera.main_lens.focal_length_mm,
        100.0 * longer / calibration.camera.main_lens.focal_length_mm,
        std_devs.unwrap_or(f64::NAN),
        without.parameters.join(", ")
    )
}
