//! Checks of images of boards, and of the boards found in them.

use crate::finding::{CornerNumbering, Finding, Issue};
use crate::model::{Board, Subset};
use crate::numerics::median;
use crate::quantity::Estimate;

/// Number of positions below which boards carry little information on a camera.
const FEW_FRAMES: usize = 4;
/// Square of an even motion over the excess edge variance along an axis. The variance of both axes together is a twelfth of the
/// square, along an axis half of it.
const MOTION: f64 = 24.0;

/// Part of the micro-images, unusable for the same reason, above which a frame is rejected.
const UNUSABLE: f64 = 0.25;
/// Difference of aperture ratios, in σ, below which it may be chance.
const RATIO_STD_DEVS: f64 = 3.0;

/// Relative difference below which aperture ratios are the same.
const SAME_RATIO: f64 = 0.002;

/// Misfit of the features, as a part of their spread, above which corners are numbered otherwise. The perspective of tilted
/// boards moves features by 3 to 5 % from affine images of their corners, another numbering by 54 % and more.
const NUMBERED_OTHERWISE: f64 = 0.3;
/// Ratio of misfits below which another numbering fits better; chance does not reach it.
const FITS_BETTER: f64 = 0.33;

/// Checks the numbering of corners by the misfit of the board to the features with each numbering. Returns an error if another
/// one than row by row fits.
pub(crate) fn numbering(misfits: &[(CornerNumbering, f64)], board: &Board) -> Result<(), Issue> {
    let stated = misfits.iter().find(|(numbering, _)| *numbering == CornerNumbering::RowByRow);
    let best = misfits.iter().min_by(|a, b| a.1.total_cmp(&b.1));
    match (stated, best) {
        (Some(&(_, row_by_row)), Some(&(numbering, misfit)))
            if row_by_row > NUMBERED_OTHERWISE && misfit < FITS_BETTER * row_by_row =>
        {
            let (columns, rows) = (board.columns, board.rows);
            Err(Issue::NumberedOtherwise { numbering, misfit, row_by_row, columns, rows })
        }
        _ => Ok(()),
    }
}

/// Parts of the micro-images of a frame that are unusable, by reason.
pub(crate) struct UnusableParts {
    pub saturated_white: f64,
    pub saturated: f64,
    pub too_small: f64,
    pub dark: f64,
    /// Pitch of the micro-images.
    pub pitch_px: f64,
}

/// Checks the exposure of a frame. Returns an error if it allows for no detection.
pub(crate) fn exposure(unusable: &UnusableParts) -> Result<(), Issue> {
    let UnusableParts { saturated_white, saturated, too_small, dark, pitch_px } = *unusable;
    if saturated_white > UNUSABLE {
        return Err(Issue::SaturatedWhite { part: saturated_white });
    }
    if saturated > UNUSABLE {
        return Err(Issue::Saturated { part: saturated });
    }
    if too_small > UNUSABLE {
        return Err(Issue::MicroImagesTooSmall { part: too_small, pitch_px });
    }
    if dark > UNUSABLE {
        return Err(Issue::DarkWhite { part: dark });
    }
    Ok(())
}

/// Finds boards whose edges show another aperture ratio than the boards of the calibration. Corners were fitted with the
/// latter, which has the given σ.
pub(crate) fn aperture_ratio(
    fitted_with: f64,
    std_dev: f64,
    estimated: Estimate,
) -> Option<Finding> {
    // No opening is wider than its lens. Estimates above 1 are errors, so they are compared as 1.
    let change = (estimated.value.min(1.0) - fitted_with.min(1.0)).abs();
    let std_dev = estimated.std_dev.hypot(std_dev);
    let differs = change > SAME_RATIO * estimated.value && change > RATIO_STD_DEVS * std_dev;
    differs.then(|| Finding::caution(Issue::ApertureRatioOfOtherBoards { fitted_with, estimated }))
}

/// Finds images whose samples were rounded to few levels, from the frames with their number of levels.
pub(crate) fn few_levels(frames: &[(u32, u32)]) -> Option<Finding> {
    let fewest = frames.iter().map(|(_, levels)| *levels).min()?;
    let (images, frames) = (frames.len(), frames.iter().map(|(frame, _)| *frame).collect());
    Some(Finding::caution(Issue::FewLevels { images, fewest, frames }))
}

/// Finds too few frames with a board.
pub(crate) fn enough(frames: usize, subset: Subset) -> Option<Finding> {
    (frames < FEW_FRAMES && subset == Subset::Calibration)
        .then(|| Finding::note(Issue::FewBoards { frames }))
}

/// Finds frames whose edges are wider than the others'. Each frame has the excess edge variance, px². A finding needs more than
/// `least_px2` and so many `std_devs`.
pub(crate) fn motion_blur(
    frames: &[(u32, &str, Estimate)],
    (least_px2, std_devs): (f64, f64),
) -> Vec<Finding> {
    let Some(usual) = median(frames.iter().map(|(.., spread)| spread.value)) else {
        return Vec::new();
    };
    let wider = |(.., spread): &&(u32, &str, Estimate)| {
        frames.len() >= FEW_FRAMES
            && spread.value - usual > least_px2.max(std_devs * spread.std_dev)
    };
    let finding = |(frame, name, spread): &(u32, &str, Estimate)| {
        let motion_px = (MOTION * (spread.value - usual)).sqrt();
        Finding::note(Issue::MotionBlur { motion_px }).about_frame(*frame, Some(name))
    };
    frames.iter().filter(wider).map(finding).collect()
}

/// Finds a board that no frame shows from side to side: if it is stated too large, it fits as well with its other sides out of
/// view. `corners` are the numbers of the corners found in each frame.
pub(crate) fn all_sides(corners: &[Vec<i32>], board: &Board) -> Option<Finding> {
    let Board { columns, rows, .. } = *board;
    let spans = |of: fn(i32, i32) -> i32, last: i32| {
        corners.iter().any(|frame| {
            let at = |side: i32| frame.iter().any(|corner| of(*corner, columns) == side);
            at(0) && at(last)
        })
    };
    let whole = spans(|corner, columns| corner % columns, columns - 1)
        && spans(|corner, columns| corner / columns, rows - 1);
    (!whole).then(|| Finding::caution(Issue::BoardNeverWhole { columns, rows }))
}
