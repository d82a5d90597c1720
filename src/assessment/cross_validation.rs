//! Cross-validation: frames left out of a calibration are reprojected by its camera.

use std::collections::BTreeSet;

use rayon::prelude::*;

use crate::calibration::{BoardModel, Calibration, CalibrationOptions, Start, calibrate};
use crate::error::{Error, Result};
use crate::model::{Board, FeatureResidual, Observations, PlenopticCamera, Rmse};

/// One fold of the frames.
#[derive(Debug, Clone, PartialEq)]
pub struct Fold {
    /// Frames that are left out.
    pub frames: Vec<u32>,
    /// Camera calibrated without these frames.
    pub camera: PlenopticCamera,
    /// True if this calibration converged.
    pub converged: bool,
    /// Number of left-out frames for which no pose was found.
    pub left_out: usize,
    /// Reprojection errors of the other left-out frames, with poses refined for the fixed camera.
    pub rmse: Rmse,
}

/// All folds, and the errors of all frames when left out.
#[derive(Debug, Clone, PartialEq)]
pub struct CrossValidation {
    /// Results of the folds.
    pub folds: Vec<Fold>,
    /// Reprojection errors over all frames.
    pub rmse: Rmse,
}

impl CrossValidation {
    /// Returns the standard deviation of every intrinsic parameter of the full calibration, by the jackknife over the
    /// folds: √((k − 1)/k Σ (θᵢ − θ̄)²), in the order of [`PlenopticCamera::intrinsics`]. It assumes that frames, not
    /// observations, are independent.
    #[must_use]
    pub fn jackknife_std_devs(&self) -> Vec<f64> {
        let values: Vec<Vec<f64>> = self.folds.iter().map(|f| f.camera.intrinsics()).collect();
        let folds = values.len() as f64;
        let of_parameter = |i: usize| {
            let mean = values.iter().map(|v| v[i]).sum::<f64>() / folds;
            let square: f64 = values.iter().map(|v| (v[i] - mean).powi(2)).sum();
            ((folds - 1.0) / folds * square).sqrt()
        };
        (0..values.first().map_or(0, Vec::len)).map(of_parameter).collect()
    }
}

/// Calibrates once for every fold without the frames of that fold, and reprojects those frames.
///
/// Fold i of n has frames i, i + n, i + 2n and so on. All frames together decide whether the board is flat or bent.
/// `progress` is called after every fold. Fails
/// if there are fewer frames than folds, fewer than two folds, or if a calibration fails.
pub fn cross_validate(
    start: &Start,
    board: &Board,
    observations: &Observations,
    options: &CalibrationOptions,
    folds: usize,
    progress: &(dyn Fn() + Sync),
) -> Result<CrossValidation> {
    let frames = foldable_frames(observations, options, folds)?;
    // The folds must agree on whether the board is flat.
    let mut options = match options.board {
        BoardModel::Auto => {
            let all = calibrate(start, board, observations, options, &mut |_| true)?;
            options.with_decision(all.board.std_devs)
        }
        _ => options.clone(),
    };
    // Every fold has its own thread.
    options.threads = 1;
    let options = &options;
    let fold = |number: usize| -> Result<(Fold, Vec<FeatureResidual>)> {
        let held_out = frames_of_fold(&frames, number, folds);
        let mut without = options.clone();
        without.exclude_frames.extend(&held_out);
        let calibration = calibrate(start, board, observations, &without, &mut |_| true)?;
        let Calibration { camera, board: found, converged, .. } = calibration;
        let seen = Observations {
            features: observations
                .features
                .iter()
                .filter(|f| held_out.contains(&f.frame))
                .copied()
                .collect(),
            ..Observations::default()
        };
        let poses_only = CalibrationOptions {
            exclude_frames: Vec::new(),
            ..options.of_poses_only(found.bent.shape)
        };
        let known = Start::Camera(camera.clone());
        let posed = calibrate(&known, board, &seen, &poses_only, &mut |_| true)?;
        let residuals = posed.reprojection.features;
        progress();
        let left_out = posed.left_out.len();
        let rmse = Rmse::of(&residuals);
        Ok((Fold { frames: held_out, camera, converged, left_out, rmse }, residuals))
    };
    let named = |number: usize| {
        fold(number).map_err(|e| Error::invalid(format!("fold {} of {folds}: {e}", number + 1)))
    };
    let done = (0..folds).into_par_iter().map(named).collect::<Result<Vec<_>>>()?;
    let rmse = Rmse::of(done.iter().flat_map(|(_, residuals)| residuals));
    Ok(CrossValidation { folds: done.into_iter().map(|(fold, _)| fold).collect(), rmse })
}

/// Returns the frames that a fold leaves out.
pub(super) fn frames_of_fold(frames: &[u32], number: usize, folds: usize) -> Vec<u32> {
    frames.iter().copied().skip(number).step_by(folds).collect()
}

/// Returns the frames to be divided into folds. Fails if there are fewer frames than folds, or fewer than
/// two folds.
pub fn foldable_frames(
    observations: &Observations,
    options: &CalibrationOptions,
    folds: usize,
) -> Result<Vec<u32>> {
    let excluded: BTreeSet<u32> = options.exclude_frames.iter().copied().collect();
    let frames: Vec<u32> =
        observations.frames().into_iter().filter(|f| !excluded.contains(f)).collect();
    if folds < 2 || frames.len() < folds {
        return Err(indivisible(frames.len(), folds));
    }
    Ok(frames)
}

/// Returns the error for fewer than two folds, or for more folds than frames.
pub(super) fn indivisible(frames: usize, folds: usize) -> Error {
    Error::invalid(format!(
        "{frames} frames cannot be divided into {folds} folds: use at least two folds, and at most \
         one for each frame"
    ))
}
