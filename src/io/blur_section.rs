//! What files say of the widths of edges: `blur` of `calibration.json`, `depth_from_blur` of `camera.json`.

use serde_json::{Value, json};

use crate::calibration::{FillMeasurement, TypeBlur};
use crate::model::EdgeSpread;

/// What the widths of edges say, lens types in order; null without measured blur.
pub(super) fn blur_document(measured: Option<&FillMeasurement>) -> Value {
    let of_type = |of: &TypeBlur| {
        let [excess_px, std_dev_px] = of.excess_px;
        json!({
            "fill_factor": of.fill_factor,
            "excess_px": excess_px,
            "excess_std_dev_px": std_dev_px,
            "features": of.features,
        })
    };
    measured.map_or(Value::Null, |measured| {
        let types: Vec<Option<Value>> =
            measured.types.iter().map(|of| of.as_ref().map(of_type)).collect();
        json!({ "fill_factor": measured.fill_factor, "lens_types": types })
    })
}

/// How wide a point is blurred, for depth from blur: σ² = (κρ)² + s²; `None` where the fill factor is not known.
pub(super) fn depth_from_blur_document(edges: &EdgeSpread) -> Option<Value> {
    let [spread_per_radius, std_dev] = edges.fill_factor?.spread_per_radius();
    Some(json!({
        "spread_per_radius": spread_per_radius,
        "spread_per_radius_std_dev": std_dev,
        "point_spread_px2": edges.point_spread.map(|spread| spread.variance_px2),
    }))
}
