//! Brightness of the squares of the board in a frame, and the check of its exposure.

use rayon::prelude::*;

use super::frame::Frame;
use super::patch::{Patch, Room, Unusable};
use crate::checks::boards::{self as checks, UnusableParts};
use crate::finding::Issue;
use crate::numerics::median;

/// Number of micro-images that suffice for the brightness of the frame, and smallest step between them along rows and columns.
const ENOUGH: usize = 4000;
const LEAST_STEP: i32 = 2;
/// Part of the micro-images, darkest and brightest, that is left out of the levels.
const TAIL: f64 = 0.02;
/// Smallest contrast of a frame with a board, relative to its brightest light, and lower limit of the latter, relative to the
/// white image.
const LEAST_DIFFERENCE: f64 = 0.04;
const LEAST_LEVEL: f64 = 0.1;
/// Part of saturated pixels above which a micro-image counts as saturated: in a board's image, and in the white image, more of
/// which is bright.
const SATURATED: f32 = 0.2;
const SATURATED_WHITE: f32 = 0.5;

/// Part of its usual light below which the white image is covered.
const COVERED: f64 = 0.1;

/// Brightness of a micro-image.
#[derive(Debug, Clone, Copy)]
struct Level {
    /// Mean light, relative to the white image.
    mean: f64,
    /// Brightest light in the white image.
    white: f64,
}

/// Returns half the difference between the bright and the dark squares, relative to the white image.
pub(super) fn contrast(frame: &Frame, nodes: &[(i32, i32)]) -> Result<f64, Issue> {
    #[allow(clippy::cast_possible_truncation, clippy::cast_possible_wrap)] // a few
    let step = ((nodes.len() / ENOUGH).isqrt() as i32).max(LEAST_STEP);
    let sampled = nodes.iter().filter(|(k, l)| k % step == 0 && l % step == 0);
    let mut levels = levels(frame, sampled);
    // Micro-images that the border cuts carry no information about the light.
    levels.retain(|level| !matches!(level, Err(Unusable::Cut)));
    check_exposure(frame, &levels)?;
    let lit: Vec<Level> = levels.into_iter().flatten().collect();
    let Some(usual) = median(lit.iter().map(|level| level.white)) else {
        return Err(Issue::NothingUsable);
    };
    // If something covered the white image, light relative to it carries no information.
    let uncovered = lit.iter().filter(|level| level.white > COVERED * usual);
    let mut means: Vec<f64> = uncovered.map(|level| level.mean).collect();
    means.sort_by(f64::total_cmp);
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a part of the length
    let at = |part: f64| means[(part * (means.len() - 1) as f64) as usize];
    let contrast = (at(1.0 - TAIL) - at(TAIL)) / 2.0;
    if contrast < LEAST_DIFFERENCE * at(1.0 - TAIL).max(LEAST_LEVEL) {
        return Err(Issue::Uniform);
    }
    Ok(contrast)
}

/// Returns the number of micro-images that are unusable.
pub(super) fn count_unusable(frame: &Frame, nodes: &[(i32, i32)]) -> usize {
    levels(frame, nodes.iter()).iter().filter(|level| level.is_err()).count()
}

/// Returns the brightness of micro-images, or the reason why they are unusable.
fn levels<'n>(
    frame: &Frame,
    nodes: impl Iterator<Item = &'n (i32, i32)>,
) -> Vec<Result<Level, Unusable>> {
    let of_node = |(patch, room): &mut (Patch, Room), &node: &(i32, i32)| {
        frame.read(node, patch, room)?;
        if patch.saturated_white > SATURATED_WHITE {
            return Err(Unusable::SaturatedWhite);
        }
        if patch.saturated > SATURATED {
            return Err(Unusable::Saturated);
        }
        Ok(Level { mean: patch.mean(), white: patch.brightest.into() })
    };
    let nodes: Vec<_> = nodes.collect();
    nodes.into_par_iter().map_init(Default::default, of_node).collect()
}

/// Returns an error if too many micro-images are unusable.
fn check_exposure(frame: &Frame, levels: &[Result<Level, Unusable>]) -> Result<(), Issue> {
    if levels.is_empty() {
        return Err(Issue::NoWholeMicroImage);
    }
    let part = |why: Unusable| {
        let unusable = levels.iter().filter_map(|level| level.err());
        let count = unusable.filter(|reason| *reason == why).count();
        count as f64 / levels.len() as f64
    };
    checks::exposure(&UnusableParts {
        saturated_white: part(Unusable::SaturatedWhite),
        saturated: part(Unusable::Saturated),
        too_small: part(Unusable::TooSmall),
        dark: part(Unusable::Dark),
        pitch_px: frame.search.micro_images.grid.pitch_px,
    })
}
