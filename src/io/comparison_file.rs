//! `comparison.json`: comparison of two cameras.

use serde_json::{Value, json};

use crate::assessment::{CameraComparison, DistanceDifference, ParameterPair};

/// Returns a comparison as JSON.
#[must_use]
pub fn comparison_document(comparison: &CameraComparison) -> Value {
    let parameter = |pair: &ParameterPair| {
        json!({
            "parameter": pair.name,
            "unit": pair.unit,
            "values": pair.values,
            "standard_deviations": pair.std_devs,
            "difference_in_std_devs": pair.difference_in_std_devs(),
        })
    };
    let distance = |difference: &DistanceDifference| {
        json!({
            "at_mm": difference.at_mm,
            "points": difference.shifts_px.len(),
            "rms_px": difference.rms_px,
            "largest_px": difference.largest_px,
            "across_mm": difference.rms_mm.map(|[across, _]| across),
            "along_mm": difference.rms_mm.map(|[_, along]| along),
            "further_mm": difference.further_mm,
            "blur_rms_px": difference.blur_rms_px,
        })
    };
    let motion = &comparison.second_from_first;
    json!({
        "format": "plenocal-comparison",
        "version": 1,
        "parameters": comparison.parameters.iter().map(parameter).collect::<Vec<Value>>(),
        "second_from_first": {
            "rotation_vector_rad": <[f64; 3]>::from(motion.rotation.scaled_axis()),
            "translation_mm": <[f64; 3]>::from(motion.translation.vector),
        },
        "rms_px_without_motion": comparison.raw_rms_px,
        "rms_px": comparison.rms_px(),
        "blur_rms_px": comparison.blur_rms_px(),
        "findings": comparison.findings,
        "distances": comparison.distances.iter().map(distance).collect::<Vec<Value>>(),
    })
}
