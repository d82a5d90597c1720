//! Boards that were not used in a calibration: their poses for the fixed camera, and checks of the camera.

use nalgebra::Isometry3;

use crate::calibration::{Calibration, CalibrationOptions, LeftOut, Start, calibrate};
use crate::checks::{calibration as fit_checks, camera as checks};
use crate::error::Result;
use crate::finding::Finding;
use crate::model::{
    BapFeature, BentBoard, Board, FeatureResidual, FramePose, Observations, PlenopticCamera,
    Reprojection,
};
use crate::quantity::Estimate;

/// Poses of boards, estimated for a fixed camera.
#[derive(Debug, Clone, PartialEq)]
pub struct Posed {
    /// Poses of the boards.
    pub poses: Vec<FramePose>,
    /// Reprojection errors.
    pub reprojection: Reprojection,
    /// Frames without a pose.
    pub left_out: Vec<LeftOut>,
    /// True if the poses are at a minimum.
    pub converged: bool,
    /// Contradictions between boards and camera: residuals, blur radii, and the best-fitting size of the squares.
    pub findings: Vec<Finding>,
}

/// Estimates the poses of a board of known shape for a fixed camera.
pub fn pose_boards(
    camera: &PlenopticCamera,
    bent: &BentBoard,
    features: &[BapFeature],
) -> Result<Posed> {
    let options = CalibrationOptions::default().of_poses_only(bent.shape);
    let seen = Observations { features: features.to_vec(), ..Observations::default() };
    let start = Start::Camera(camera.clone());
    let result = calibrate(&start, &bent.board, &seen, &options, &mut |_| true)?;
    let of_fit = fit_checks::fit(&result.camera, &result.reprojection);
    let findings = of_fit.into_iter().chain(of_fixed_camera(&result)).collect();
    let Calibration { poses, reprojection, left_out, converged, .. } = result;
    Ok(Posed { poses, reprojection, left_out, converged, findings })
}

/// Returns the contradictions between boards and the fixed camera, except the finding of [`fit_checks::fit`].
pub(super) fn of_fixed_camera(calibration: &Calibration) -> Vec<Finding> {
    let squares = square_scale(calibration);
    scatter(calibration)
        .into_iter()
        .chain(blur_in_std_devs(calibration).and_then(checks::blur))
        .chain(squares.and_then(|s| checks::squares(&s, calibration.board.bent.board.square_mm)))
        .collect()
}

/// Checks the scatter of the residuals over the σ of the detection; `None` if no feature states its σ.
pub(super) fn scatter(calibration: &Calibration) -> Option<Finding> {
    let features = &calibration.reprojection.features;
    let stated = features.iter().any(|r| r.feature.std_dev_px.is_some());
    stated.then_some(calibration.uncertainty.std_dev_factors[0]).and_then(fit_checks::scatter)
}

/// Returns the root mean square difference between the blur radii of features and camera, over its σ; `None` if no σ is stated.
fn blur_in_std_devs(calibration: &Calibration) -> Option<f64> {
    let of = |r: &FeatureResidual| {
        Some((r.drho_px? / r.feature.rho_std_dev_px?).powi(2)).filter(|square| square.is_finite())
    };
    let squares: Vec<f64> = calibration.reprojection.features.iter().filter_map(of).collect();
    (!squares.is_empty()).then(|| (squares.iter().sum::<f64>() / squares.len() as f64).sqrt())
}

/// Step of the scale of the squares, and largest number of fitted parabolas.
const STEP: f64 = 0.01;
const ROUNDS: usize = 6;

/// Fits the factor on the size of the squares for which the boards agree best with the fixed camera.
///
/// Parallax between micro-images gives the distance of a board in mm, its image the distance in squares. The two
/// contradict each other if the squares or the focus differ from the calibration. The factor h is the vertex of
/// the parabola through the costs C₋, C₀, C₊ at sizes h(1 − ε), h, h(1 + ε), and σ = s ε/√(C₋ + C₊ − 2C₀) with the
/// dispersion s of the residuals, since C is half of χ². `None` if a board of another size has no poses, or no minimum is
/// within a few per cent.
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
        // With a robust loss, the cost is no parabola far from the minimum.
        scale *= 1.0 + step.clamp(-STEP, STEP);
    }
    None
}

/// Returns the least cost of the same boards with squares of another size.
fn cost_with_squares(calibration: &Calibration, scale: f64) -> Option<f64> {
    if (scale - 1.0).abs() < f64::EPSILON {
        return Some(calibration.refinement.cost);
    }
    let board = calibration.board.bent.board;
    let board = Board { square_mm: scale * board.square_mm, ..board };
    let features = calibration.reprojection.features.iter().map(|r| r.feature).collect();
    let seen = Observations { features, ..Observations::default() };
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
