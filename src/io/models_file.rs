//! `models` of `calibration.json`: what groups of parameters are worth.

use serde_json::{Value, json};

use crate::assessment::{ModelComparison, WithoutGroup};

/// A comparison of models as JSON.
#[must_use]
pub fn models_document(comparison: &ModelComparison) -> Value {
    let of_group = |without: &WithoutGroup| {
        let (mean, std_error) = without.mean_growth();
        let [features, centers, anchors] = without.cost_growth;
        let (longer_mm, std_devs) = without.focal_length_change;
        let frames: Vec<Value> = without
            .growth
            .iter()
            .map(|(frame, growth)| json!({ "frame": frame, "growth": growth }))
            .collect();
        json!({
            "group": without.group.to_string(),
            "parameters": without.parameters,
            "verdict": without.worth().to_string(),
            "error_growth": { "mean": mean, "standard_error": std_error, "frames": frames },
            "chi_square_growth": { "features": features, "centers": centers, "anchors": anchors },
            "focal_length_mm": without.camera.main_lens.focal_length_mm,
            "focal_length_change": { "mm": longer_mm, "std_devs": std_devs },
            "pattern": without.pattern,
            "converged": without.converged,
        })
    };
    let errors: Vec<Value> = comparison
        .errors
        .iter()
        .map(|(frame, error)| json!({ "frame": frame, "error": error }))
        .collect();
    json!({
        "folds": comparison.folds,
        "frames": errors,
        "error": comparison.mean_error(),
        "pattern": comparison.pattern,
        "groups": comparison.groups.iter().map(of_group).collect::<Vec<_>>(),
        "problems": comparison.findings.iter().map(ToString::to_string).collect::<Vec<_>>(),
    })
}
