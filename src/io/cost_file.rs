//! `cost.json`: the cost at a solution from elsewhere.

use serde_json::{Map, Value, json};

use crate::calibration::Calibration;
use crate::model::shared_parameters;

/// The parts of a cost (features, centres, anchors), its gradient, and what one more step would gain, by the names of the
/// free parameters and in their units.
#[must_use]
pub fn cost_document(evaluated: &Calibration, [features, centers, anchors]: [f64; 3]) -> Value {
    let uncertainty = &evaluated.uncertainty;
    let names = shared_parameters(evaluated.camera.lens_types());
    let by_name = |values: &[f64]| -> Map<String, Value> {
        let free = uncertainty.free_intrinsics.iter().zip(values);
        free.map(|(&index, value)| (names[index].name.to_owned(), json!(value))).collect()
    };
    json!({
        "cost": evaluated.refinement.cost,
        "of_features": features,
        "of_centers": centers,
        "of_anchors": anchors,
        "anchor_weight": (!evaluated.anchors.is_empty()).then_some(evaluated.cost.anchor_weight),
        "is_minimum": evaluated.converged,
        "gradient_max_norm": uncertainty.gradient.iter().fold(0.0_f64, |most, g| most.max(g.abs())),
        "gradient": by_name(&uncertainty.gradient),
        "expected_decrease": uncertainty.expected_decrease,
        "next_step": by_name(&uncertainty.next_step),
    })
}
