//! `detection.json`: features found in each frame, and what was dropped and why.

use std::collections::BTreeSet;
use std::path::Path;

use nalgebra::Vector2;
use serde::Deserialize;
use serde_json::{Value, json};

use super::json_file::{check_version, document_of, read_json};
use crate::detection::{Aberration, DetectedBoards, DetectedFrame, Edges};
use crate::error::Result;
use crate::model::{Board, Observations};

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
            "shifted": frame.result.as_ref().is_ok_and(|d| d.elsewhere.is_some()),
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
        "axis_px": found.axis_px.map(<[f64; 2]>::from),
        "frames": found.frames.iter().map(of_frame).collect::<Vec<_>>(),
    })
}

#[derive(Deserialize)]
struct DetectionFile {
    #[serde(default)]
    axis_px: Option<[f64; 2]>,
    frames: Vec<FrameFile>,
}

#[derive(Deserialize)]
struct FrameFile {
    frame: u32,
    #[serde(default)]
    shifted: bool,
}

/// Adds to observations what the file `detection.json` beside their features file has: the optical axis, and the frames whose
/// corners are numbered up to a shift. Nothing is added if there is no such file, or if it is of another program.
///
/// Returns an error that names the file if it cannot be read.
pub fn add_detection(observations: &mut Observations, features: &Path) -> Result<()> {
    let Beside { axis_px, shifted_frames } = Beside::read(features)?;
    (observations.axis_px, observations.shifted_frames) = (axis_px, shifted_frames);
    Ok(())
}

/// Content of the file `detection.json` beside a features file that the features do not have.
#[derive(Debug, Default, PartialEq)]
struct Beside {
    axis_px: Option<Vector2<f64>>,
    shifted_frames: BTreeSet<u32>,
}

impl Beside {
    fn read(features: &Path) -> Result<Self> {
        let path = features.with_file_name("detection.json");
        if !path.is_file() {
            return Ok(Self::default());
        }
        let document = read_json(&path)?;
        if document.get("format").and_then(Value::as_str) != Some(FORMAT) {
            return Ok(Self::default());
        }
        let file = check_version(&document, FORMAT, VERSION)
            .and_then(|()| document_of::<DetectionFile>(document, FORMAT))
            .map_err(|error| error.in_file(&path))?;
        let shifted = file.frames.iter().filter(|frame| frame.shifted).map(|frame| frame.frame);
        Ok(Self { axis_px: file.axis_px.map(Vector2::from), shifted_frames: shifted.collect() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axis_and_shifted_frames_are_read_from_the_file_beside_the_features() {
        let folder = tempfile::tempdir().unwrap();
        let features = folder.path().join("features.csv");
        let read = |content: &str| {
            std::fs::write(folder.path().join("detection.json"), content).unwrap();
            Beside::read(&features).map_err(|e| e.to_string())
        };
        assert_eq!(Beside::read(&features).unwrap(), Beside::default());
        let document = |axis: &str| {
            format!(
                r#"{{"format": "{FORMAT}", "version": 1, "axis_px": {axis},
                    "frames": [{{"frame": 3, "shifted": true}}, {{"frame": 4}}]}}"#
            )
        };
        let found = read(&document("[510.5, 370.0]")).unwrap();
        assert_eq!(found.axis_px, Some(Vector2::new(510.5, 370.0)));
        assert_eq!(found.shifted_frames, BTreeSet::from([3]));
        assert_eq!(read(&document("null")).unwrap().axis_px, None);
        assert_eq!(read(r#"{"format": "boxes"}"#), Ok(Beside::default()));
        let error = read(&document("\"middle\"")).unwrap_err();
        assert!(error.contains("detection.json") && error.contains("axis_px"), "{error}");
        let newer = document("null").replace("\"version\": 1", "\"version\": 9");
        assert!(read(&newer).unwrap_err().contains("version 9"));
    }
}
