//! Boards that were not used in a calibration: their poses, with the camera fixed.

use crate::calibration::{Calibration, CalibrationOptions, LeftOut, Start, calibrate};
use crate::error::Result;
use crate::model::{BapFeature, BentBoard, FramePose, Observations, PlenopticCamera, Reprojection};

/// Poses of boards, estimated with a fixed camera.
#[derive(Debug, Clone, PartialEq)]
pub struct Posed {
    /// Their poses.
    pub poses: Vec<FramePose>,
    /// Reprojection errors.
    pub reprojection: Reprojection,
    /// Frames without a pose.
    pub left_out: Vec<LeftOut>,
    /// Whether the poses are at a minimum.
    pub converged: bool,
}

/// Estimates the poses of a board of known shape with a fixed camera.
pub fn pose_boards(
    camera: &PlenopticCamera,
    bent: &BentBoard,
    features: &[BapFeature],
) -> Result<Posed> {
    let options = CalibrationOptions::default().of_poses_only(bent.shape);
    let seen = Observations { centers: Vec::new(), features: features.to_vec() };
    let start = Start::Camera(camera.clone());
    let result = calibrate(&start, &bent.board, &seen, &options, &mut |_| true)?;
    let Calibration { poses, reprojection, left_out, converged, .. } = result;
    Ok(Posed { poses, reprojection, left_out, converged })
}
