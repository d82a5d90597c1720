//! `detection.json`: features found in each frame, and what was dropped and why.

use serde_json::{Value, json};

use crate::detection::{DetectedBoards, DetectedFrame, Detection, Edges};
use crate::model::Board;

const FORMAT: &str = "plenocal-detection";

/// Returns the content of `detection.json`.
#[must_use]
pub fn detection_document(found: &DetectedBoards, board: &Board) -> Value {
    let edges = |edges: &Edges| {
        json!({
            "aperture_ratio": edges.aperture_ratio,
            "spread_px2": edges.spread_px2.value,
            "spread_std_dev_px2": edges.spread_px2.std_dev,
        })
    };
    let aberration = |found: &Detection| {
        let a = &found.aberration;
        let [spherical, coma, astigmatism]: [f64; 3] = a.coefficients_per_px2.into();
        json!({
            "spherical_per_px2": spherical,
            "coma_per_px2": coma,
            "astigmatism_per_px2": astigmatism,
            "axis_px": [a.axis_px.x, a.axis_px.y],
            "zone_px": a.zone_px2.sqrt(),
        })
    };
    let of_frame = |frame: &DetectedFrame| {
        let c = &frame.counts;
        json!({
            "frame": frame.frame,
            "image": frame.name,
            "rejected": frame.result.as_ref().err().map(ToString::to_string),
            "features": frame.result.as_ref().map_or(0, |d| d.features.len()),
            "board_corners": c.board_corners,
            "edges": frame.result.as_ref().ok().and_then(|d| d.edges.as_ref()).map(edges),
            "aberration": frame.result.as_ref().ok().map(aberration),
            "micro_images": { "looked_at": c.looked_at, "unusable": c.unusable },
            "corners": c.corners,
            "clusters": c.clusters,
            "dropped": {
                "alone": c.alone,
                "off_line": c.off_line,
                "texture": c.texture,
                "off_board": c.off_board,
                "lost_board_corners": c.lost,
                "unclear": c.unclear,
                "misplaced": c.misplaced,
                "given_up": c.given_up,
            },
        })
    };
    json!({
        "format": FORMAT,
        "version": 1,
        "board": { "columns": board.columns, "rows": board.rows, "square_mm": board.square_mm },
        "aperture_ratio": found.aperture_ratio,
        "fitted_with_aperture_ratio": found.fitted_with,
        "frames": found.frames.iter().map(of_frame).collect::<Vec<_>>(),
    })
}
