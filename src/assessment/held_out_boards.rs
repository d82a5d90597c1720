//! Boards that were not used in a calibration: their poses with the camera fixed, and what they say of the camera.

use nalgebra::Isometry3;

use crate::calibration::{Calibration, CalibrationOptions, LeftOut, Start, calibrate};
use crate::checks::{calibration as fit_checks, camera as checks};
use crate::error::Result;
use crate::finding::Finding;
use crate::model::{
    BapFeature, BentBoard, Board, FramePose, Observations, PlenopticCamera, Reprojection,
};
use crate::quantity::Estimate;

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
    /// What the boards say against the camera: residuals, blur radii, and the size of the squares that fits best.
    pub findings: Vec<Finding>,
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
    let of_fit = fit_checks::fit(&result.camera, &result.reprojection);
    let findings = of_fit.into_iter().chain(of_fixed_camera(&result)).collect();
    let Calibration { poses, reprojection, left_out, converged, .. } = result;
    Ok(Posed { poses, reprojection, left_out, converged, findings })
}

/// What boards say against the fixed camera of their poses, besides residuals that noise cannot explain.
pub(super) fn of_fixed_camera(calibration: &Calibration) -> Vec<Finding> {
    let residuals = &calibration.reprojection.features;
    let stated = residuals.iter().any(|r| r.feature.std_dev_px.is_some());
    let scatter = stated.then_some(calibration.uncertainty.std_dev_factors[0]);
    let squares = square_scale(calibration);
    scatter
        .and_then(fit_checks::scatter)
        .into_iter()
        .chain(blur_in_std_devs(calibration).and_then(checks::blur))
        .chain(squares.and_then(|s| checks::squares(&s, calibration.board.bent.board.square_mm)))
        .collect()
}

/// Root mean square of the differences of blur radii from those of the camera, over their σ; `None` where no σ is stated.
fn blur_in_std_devs(calibration: &Calibration) -> Option<f64> {
    let of = |r: &crate::model::FeatureResidual| {
        Some((r.drho_px? / r.feature.rho_std_dev_px?).powi(2)).filter(|square| square.is_finite())
    };
    let squares: Vec<f64> = calibration.reprojection.features.iter().filter_map(of).collect();
    (!squares.is_empty()).then(|| (squares.iter().sum::<f64>() / squares.len() as f64).sqrt())
}

/// Step of the scale of the squares, and how often it is looked for anew.
const STEP: f64 = 0.01;
const ROUNDS: usize = 6;

/// By which factor the squares of the board would have to be larger for the boards to fit the fixed camera of their poses
/// best. Parallax between micro-images tells the distance of a board in mm, its image that over the size of the squares;
/// so the two contradict each other if squares or focus are others than in the calibration. The minimum of the parabola
/// through the costs at three sizes, by the dispersion of the residuals; `None` where a board of another size has no poses or the
/// costs no minimum.
fn square_scale(calibration: &Calibration) -> Option<Estimate> {
    let dispersion = calibration.uncertainty.std_dev_factors[0];
    let mut scale = 1.0;
    for _ in 0..ROUNDS {
        let cost = |step: f64| cost_with_squares(calibration, scale * (1.0 + step));
        let (below, middle, above) = (cost(-STEP)?, cost(0.0)?, cost(STEP)?);
        let curvature = below + above - 2.0 * middle;
        if curvature <= 0.0 {
            return None;
        }
        let step = STEP * (below - above) / (2.0 * curvature);
        if step.abs() < STEP / 2.0 {
            let scale = scale * (1.0 + step);
            return Some(Estimate::new(scale, dispersion * STEP / curvature.sqrt()));
        }
        // Far from the minimum a robust loss makes the cost no parabola.
        scale *= 1.0 + step.clamp(-STEP, STEP);
    }
    None
}

/// The least cost of the same boards with squares of another size.
fn cost_with_squares(calibration: &Calibration, scale: f64) -> Option<f64> {
    if scale == 1.0 {
        return Some(calibration.refinement.cost);
    }
    let board = calibration.board.bent.board;
    let board = Board { square_mm: scale * board.square_mm, ..board };
    let features = calibration.reprojection.features.iter().map(|r| r.feature).collect();
    let seen = Observations { centers: Vec::new(), features };
    let farther = |pose: &FramePose| {
        let Isometry3 { rotation, mut translation } = pose.camera_from_board;
        translation.vector *= scale;
        FramePose { camera_from_board: Isometry3::from_parts(translation, rotation), ..*pose }
    };
    let options = CalibrationOptions {
        poses: calibration.poses.iter().map(farther).collect(),
        exclude_frames: Vec::new(),
        ..calibration.options.clone()
    };
    let start = Start::Camera(calibration.camera.clone());
    Some(calibrate(&start, &board, &seen, &options, &mut |_| true).ok()?.refinement.cost)
}
