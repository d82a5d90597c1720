//! `poses.json`: poses of the boards.

use std::collections::{BTreeSet, HashSet};

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use serde::Deserialize;
use serde_json::{Value, json};

use super::json_file::{check_version, document_of};
use crate::error::{Error, Result};
use crate::model::FramePose;
use crate::solver::Uncertainty;

/// Value of `format` in the file.
pub const POSES_FORMAT: &str = "plenocal-poses";
/// Value of `version` in the file.
pub const POSES_VERSION: u64 = 1;

#[derive(Deserialize)]
struct PosesFile {
    poses: Vec<PoseFile>,
}

#[derive(Deserialize)]
struct PoseFile {
    frame: u32,
    camera_from_board: TransformFile,
}

#[derive(Deserialize)]
struct TransformFile {
    rotation_vector_rad: [f64; 3],
    translation_mm: [f64; 3],
}

/// Returns the content of `poses.json`: `camera_from_board` of every frame as rotation vector (axis times angle), the rotation
/// also as a matrix (row by row), translation and, if known, their standard deviations. Frames in which the board fills
/// the view are marked `shifted`.
#[must_use]
pub fn poses_document(
    poses: &[FramePose],
    uncertainty: Option<&Uncertainty>,
    shifted_frames: &BTreeSet<u32>,
) -> Value {
    let pose = |(i, p): (usize, &FramePose)| {
        let rotation = p.camera_from_board.rotation;
        let matrix = rotation.to_rotation_matrix();
        let rows: Vec<Vec<f64>> =
            matrix.matrix().row_iter().map(|row| row.iter().copied().collect()).collect();
        let mut entry = json!({
            "frame": p.frame,
            "camera_from_board": {
                "rotation_vector_rad": <[f64; 3]>::from(rotation.scaled_axis()),
                "rotation_matrix": rows,
                "translation_mm": <[f64; 3]>::from(p.camera_from_board.translation.vector),
            },
        });
        if let Some([rx, ry, rz, tx, ty, tz]) = uncertainty.map(|u| u.pose_std_devs(i)) {
            entry["standard_deviations"] = json!({
                "rotation_vector_rad": [rx, ry, rz],
                "translation_mm": [tx, ty, tz],
            });
        }
        if shifted_frames.contains(&p.frame) {
            entry["shifted"] = true.into();
        }
        entry
    };
    json!({
        "format": POSES_FORMAT,
        "version": POSES_VERSION,
        "poses": poses.iter().enumerate().map(pose).collect::<Vec<_>>(),
    })
}

/// Returns the poses in a JSON document.
pub(super) fn poses_from(value: Value) -> Result<Vec<FramePose>> {
    check_version(&value, POSES_FORMAT, POSES_VERSION)?;
    let file: PosesFile = document_of(value, POSES_FORMAT)?;
    let pose = |p: PoseFile| {
        let camera_from_board = Isometry3::from_parts(
            Translation3::from(Vector3::from(p.camera_from_board.translation_mm)),
            UnitQuaternion::from_scaled_axis(Vector3::from(
                p.camera_from_board.rotation_vector_rad,
            )),
        );
        possible(FramePose { frame: p.frame, camera_from_board })
    };
    file.poses.into_iter().map(pose).collect()
}

/// Returns the poses unchanged; an error if a frame has two, since the intended one is not known.
pub(super) fn of_different_frames(poses: Vec<FramePose>) -> Result<Vec<FramePose>> {
    let mut seen = HashSet::new();
    match poses.iter().find(|pose| !seen.insert(pose.frame)) {
        Some(pose) => {
            Err(Error::invalid(format!("frame {} has two poses: remove one", pose.frame)))
        }
        None => Ok(poses),
    }
}

/// Least distance of the first corner of a board from the camera: a smaller one is not in mm.
const NEAREST_MM: f64 = 5.0;

/// Returns the poses unchanged; an error if a board lies behind the camera, or in it.
pub(super) fn before_the_camera(poses: Vec<FramePose>) -> Result<Vec<FramePose>> {
    let z = |pose: &FramePose| pose.camera_from_board.translation.z;
    let Some(pose) = poses.iter().find(|pose| z(pose) < NEAREST_MM) else { return Ok(poses) };
    let (frame, z_mm) = (pose.frame, z(pose));
    Err(Error::invalid(if z_mm < 0.0 {
        format!(
            "the board of frame {frame} lies behind the camera, at z = {z_mm} mm: \
             camera_from_board transforms points of the board to the camera frame, whose z axis \
             points towards the scene"
        )
    } else {
        format!(
            "the board of frame {frame} lies only {z_mm} mm in front of the camera: give \
             translations in mm, not in m"
        )
    }))
}

/// Largest coordinate: squares of much larger values overflow.
const FAR_MM: f64 = 1e100;

/// Returns a pose unchanged; an error if it is not finite.
pub(super) fn possible(pose: FramePose) -> Result<FramePose> {
    let (place, turn) = (&pose.camera_from_board.translation, &pose.camera_from_board.rotation);
    let is_near = place.vector.iter().all(|x| x.abs() < FAR_MM);
    if is_near && turn.coords.iter().all(|x| x.is_finite()) {
        return Ok(pose);
    }
    Err(Error::invalid(format!(
        "the pose of frame {} is not finite, or beyond {FAR_MM:e} mm",
        pose.frame
    )))
}
