//! `detection.json`: what was found in each frame, and what was dropped and why.

use serde_json::{Value, json};

use crate::detection::DetectedFrame;
use crate::model::Board;

/// The content of `detection.json`.
#[must_use]
pub fn detection_document(frames: &[DetectedFrame], board: &Board) -> Value {
    let of_frame = |frame: &DetectedFrame| {
        let c = &frame.counts;
        json!({
            "frame": frame.frame,
            "image": frame.name,
            "rejected": frame.result.as_ref().err().map(ToString::to_string),
            "features": frame.result.as_ref().map_or(0, |d| d.features.len()),
            "board_corners": c.board_corners,
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
        "format": "plenocal-detection",
        "version": 1,
        "board": { "columns": board.columns, "rows": board.rows, "square_mm": board.square_mm },
        "frames": frames.iter().map(of_frame).collect::<Vec<_>>(),
    })
}
