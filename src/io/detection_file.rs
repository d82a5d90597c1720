//! `detection.json`: features found in each frame, and what was dropped and why.

use std::path::Path;

use nalgebra::Vector2;
use serde::Deserialize;
use serde_json::{Value, json};

use super::json_file::{check_version, document_of, read_json};
use crate::detection::{Aberration, DetectedBoards, DetectedFrame, Edges};
use crate::error::Result;
use crate::model::Board;

const FORMAT: &str = "plenocal-detection";
const VERSION: u64 = 1;

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
    let aberration = |a: Aberration| {
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
        "version": VERSION,
        "board": { "columns": board.columns, "rows": board.rows, "square_mm": board.square_mm },
        "aperture_ratio": found.aperture_ratio,
        "fitted_with_aperture_ratio": found.fitted_with,
        "aberration": found.aberration().map(aberration),
        "frames": found.frames.iter().map(of_frame).collect::<Vec<_>>(),
    })
}

#[derive(Deserialize)]
struct DetectionFile {
    #[serde(default)]
    aberration: Option<AberrationFile>,
}

#[derive(Deserialize)]
struct AberrationFile {
    axis_px: [f64; 2],
}

/// Reads the optical axis from the file `detection.json` beside a features file, px; `None` if there is no such file, if it is of another
/// program, or if the detection found no aberrations.
///
/// Returns an error that names the file if it cannot be read.
pub fn read_axis_beside(features: &Path) -> Result<Option<Vector2<f64>>> {
    let path = features.with_file_name("detection.json");
    if !path.is_file() {
        return Ok(None);
    }
    let document = read_json(&path)?;
    if document.get("format").and_then(Value::as_str) != Some(FORMAT) {
        return Ok(None);
    }
    let file = check_version(&document, FORMAT, VERSION)
        .and_then(|()| document_of::<DetectionFile>(document, FORMAT))
        .map_err(|error| error.in_file(&path))?;
    Ok(file.aberration.map(|aberration| aberration.axis_px.into()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_axis_is_read_from_the_file_beside_the_features() {
        let folder = tempfile::tempdir().unwrap();
        let axis = |content: &str| {
            std::fs::write(folder.path().join("detection.json"), content).unwrap();
            read_axis_beside(&folder.path().join("features.csv")).map_err(|e| e.to_string())
        };
        let none = read_axis_beside(&folder.path().join("features.csv"));
        assert_eq!(none.unwrap(), None);
        let document = |aberration: &str| {
            format!(r#"{{"format": "{FORMAT}", "version": 1, "aberration": {aberration}}}"#)
        };
        let found = axis(&document(r#"{"axis_px": [510.5, 370.0]}"#));
        assert_eq!(found, Ok(Some(Vector2::new(510.5, 370.0))));
        assert_eq!(axis(&document("null")), Ok(None));
        assert_eq!(axis(r#"{"format": "boxes"}"#), Ok(None));
        let error = axis(&document(r#"{"axis_px": "middle"}"#)).unwrap_err();
        assert!(error.contains("detection.json") && error.contains("axis_px"), "{error}");
        let newer = document("null").replace("\"version\": 1", "\"version\": 9");
        assert!(axis(&newer).unwrap_err().contains("version 9"));
    }
}
