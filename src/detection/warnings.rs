//! What the user should know of the frames in which boards were searched for.

use super::edge_width::{MOVED, MOVED_PX2, differs};
use super::flat_field::unlike;
use super::{DetectedFrame, Detection, MicroImages};
use crate::model::{Board, FillFactor, Subset};
use crate::numerics::median;

/// Boards in fewer positions say little about a camera.
const FEW_FRAMES: usize = 4;
/// The variance of both axes together of an even motion is a twelfth of its square, that along an axis half of it.
const MOTION: f64 = 24.0;
/// Fill factors that differ by fewer standard deviations may differ by chance.
const CHANCE: f64 = 3.0;

/// About frames that are left out or blurred, and a doubtful board.
pub(super) fn warnings(frames: &[DetectedFrame], board: &Board, subset: Subset) -> Vec<String> {
    let left_out = |frame: &DetectedFrame| {
        let why = frame.result.as_ref().err()?;
        Some(format!("frame {} ({}) is left out: {why}", frame.frame, frame.name))
    };
    // Other light may be why frames are left out.
    let compared =
        frames.iter().filter_map(|f| Some((f.frame, f.name.as_str(), f.likeness.as_ref()?)));
    let mut warnings = unlike(&compared.collect::<Vec<_>>());
    warnings.extend(coarse(frames));
    warnings.extend(frames.iter().filter_map(left_out));
    let found = frames.iter().filter(|frame| frame.result.is_ok()).count();
    if found == 0 {
        return warnings;
    }
    if found < FEW_FRAMES && subset == Subset::Calibration {
        warnings.push(format!(
            "{found} frame(s) are few for a calibration: take ten or more, at several distances and tilts"
        ));
    }
    warnings.extend(blurred(frames));
    if !shows_all_sides(frames, board) {
        warnings.push(format!(
            "no frame shows the board from its first to its last row and column: check that it has {} x \
             {} inner corners",
            board.columns, board.rows
        ));
    }
    warnings
}

/// A warning about images that were rounded to few levels.
fn coarse(frames: &[DetectedFrame]) -> Option<String> {
    let few: Vec<(u32, u32)> =
        frames.iter().filter_map(|frame| Some((frame.frame, frame.few_levels?))).collect();
    let fewest = few.iter().map(|(_, levels)| *levels).min()?;
    let numbers: Vec<String> = few.iter().map(|(frame, _)| frame.to_string()).collect();
    Some(format!(
        "the samples of {} image(s) of boards were rounded to few grey levels, as few as {fewest} (frames {}), so that edges seem to be \
         elsewhere: export images with all bits of the camera",
        few.len(),
        numbers.join(", ")
    ))
}

/// Warnings about frames whose edges are wider than those of the others.
fn blurred(frames: &[DetectedFrame]) -> Vec<String> {
    let edges: Vec<(&DetectedFrame, [f64; 2])> = frames
        .iter()
        .filter_map(|frame| Some((frame, frame.result.as_ref().ok()?.edges?.spread_px2)))
        .collect();
    let Some(usual) = median(edges.iter().map(|(_, [spread, _])| *spread)) else {
        return Vec::new();
    };
    let wider = |(_, [spread, std_dev]): &&(&DetectedFrame, [f64; 2])| {
        edges.len() >= FEW_FRAMES && spread - usual > MOVED_PX2.max(MOVED * std_dev)
    };
    let words = |(frame, [spread, _]): &(&DetectedFrame, [f64; 2])| {
        format!(
            "the edges in frame {} ({}) are wider than those of the others, as if something had moved by {:.1} px in its micro-images: hold \
             board and camera still, or leave the frame out if it does not fit",
            frame.frame,
            frame.name,
            (MOTION * (spread - usual)).sqrt()
        )
    };
    edges.iter().filter(wider).map(words).collect()
}

/// A board that is stated too large fits as well where its other sides are out of view.
fn shows_all_sides(frames: &[DetectedFrame], board: &Board) -> bool {
    let spans = |of: fn(i32, i32) -> i32, last: i32| {
        let all = |detection: &Detection| {
            let seen: Vec<i32> =
                detection.corners.iter().map(|c| of(c.corner, board.columns)).collect();
            seen.contains(&0) && seen.contains(&last)
        };
        frames.iter().filter_map(|frame| frame.result.as_ref().ok()).any(all)
    };
    spans(|corner, columns| corner % columns, board.columns - 1)
        && spans(|corner, columns| corner / columns, board.rows - 1)
}

/// A warning if corners were fitted with another fill factor than all frames show.
pub(super) fn fitted_otherwise(found: &FillFactor, micro_images: &MicroImages) -> Option<String> {
    let fitted_with = micro_images.fill_factor();
    let (shown_by, taken, all, remedy) = match micro_images.settled() {
        // What is taken of those boards is at most 1.
        Some(std_dev) => (
            "the boards for calibration show",
            FillFactor { std_dev: found.std_dev.hypot(std_dev), ..found.taken() },
            "these boards",
            "take all images with the same camera at the same settings",
        ),
        None => (
            "the first frames show",
            *found,
            "all frames",
            "if the first frames are blurred or moved, leave them out; or else state the fill factor that all frames \
             show in the project",
        ),
    };
    if !differs(&taken, fitted_with, CHANCE) {
        return None;
    }
    Some(format!(
        "corners were fitted with the fill factor {fitted_with:.4}, as {shown_by} it, but {all} show {:.4} ± \
         {:.4}: {remedy}",
        found.value, found.std_dev
    ))
}

#[cfg(test)]
mod tests {
    use super::super::micro_images::tests::micro_images;
    use super::*;

    /// What other boards have shown is taken as at most 1, and both σ count.
    #[test]
    fn boards_may_show_another_fill_factor_than_those_for_calibration() {
        let of = |value: f64, std_dev: f64| FillFactor { value, std_dev };
        let told = |known: FillFactor, found: FillFactor| {
            fitted_otherwise(&found, &micro_images(16.0).settled_at(&known))
        };
        let (wide, narrow) = (of(1.04, 0.004), of(0.93, 0.004));
        assert_eq!(told(wide.taken(), wide), None);
        assert_eq!(told(narrow, of(0.945, 0.004)), None);
        let warning = told(narrow, of(0.96, 0.004)).unwrap();
        assert!(warning.contains("the boards for calibration show it"), "{warning}");
        assert!(warning.contains("these boards show 0.9600"), "{warning}");
        let first = fitted_otherwise(&narrow, &micro_images(16.0)).unwrap();
        assert!(first.contains("1.0000, as the first frames show it"), "{first}");
    }
}
