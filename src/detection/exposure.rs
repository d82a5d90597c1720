//! How bright the squares of the board are in a frame, and whether its exposure allows for detection.

use rayon::prelude::*;

use super::frame::Frame;
use super::patch::{Patch, Room, Unusable};
use crate::checks::boards::{self as checks, UnusableParts};
use crate::finding::Issue;
use crate::numerics::median;

/// So many micro-images show how bright the frame is, and every second one along both rows and columns at most.
const ENOUGH: usize = 4000;
const LEAST_STEP: i32 = 2;
/// Darkest and brightest part of the micro-images that are left out for the levels.
const TAIL: f64 = 0.02;
/// A frame whose light differs by less than this part shows nothing, nor one that differs by less than a
/// tenth of it relative to the white image.
const LEAST_DIFFERENCE: f64 = 0.04;
const LEAST_LEVEL: f64 = 0.1;
/// Micro-images count as saturated beyond this part of their pixels, in a board's image and in the white
/// image, of which more is bright.
const SATURATED: f32 = 0.2;
const SATURATED_WHITE: f32 = 0.5;

/// The white image is covered where it has less than this part of its usual light.
const COVERED: f64 = 0.1;

/// How bright a micro-image is.
#[derive(Debug, Clone, Copy)]
struct Level {
    /// Mean light, relative to the white image.
    mean: f64,
    /// The brightest light in the white image.
    white: f64,
}

/// Half the difference between the bright and the dark squares, relative to the white image.
pub(super) fn contrast(frame: &Frame, nodes: &[(i32, i32)]) -> Result<f64, Issue> {
    #[allow(clippy::cast_possible_truncation, clippy::cast_possible_wrap)] // a few
    let step = ((nodes.len() / ENOUGH).isqrt() as i32).max(LEAST_STEP);
    let sampled = nodes.iter().filter(|(k, l)| k % step == 0 && l % step == 0);
    let mut levels = levels(frame, sampled);
    // Those at the border say nothing of the light.
    levels.retain(|level| !matches!(level, Err(Unusable::Cut)));
    check_exposure(frame, &levels)?;
    let lit: Vec<Level> = levels.into_iter().flatten().collect();
    let Some(usual) = median(lit.iter().map(|level| level.white)) else {
        return Err(Issue::NothingUsable);
    };
    // Where something covered the white image, light relative to it says nothing.
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

/// Number of micro-images that are unusable.
pub(super) fn count_unusable(frame: &Frame, nodes: &[(i32, i32)]) -> usize {
    levels(frame, nodes.iter()).iter().filter(|level| level.is_err()).count()
}

/// How bright micro-images are, or why they are unusable.
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

/// The reason if too many micro-images are unusable.
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
