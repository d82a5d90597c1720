//! Black level, from the places between micro-images that no light reaches.
//!
//! At small apertures micro-images are far apart. Far from all of them the light no longer changes with the distance:
//! there pixels receive no light. Stray light can only add to their samples. The difference between the two largest
//! f-numbers shows how much of it there is.

use nalgebra::Vector2;
use tracing::debug;

use super::centers::{measure_sample, nodes_in, part_with};
use super::centroid::{Blob, pixels_about};
use super::options::White;
use super::pattern::Pattern;
use crate::checks::whites::{self as checks, Darkest};
use crate::error::{Error, Result};
use crate::finding::Finding;
use crate::image::RawImage;
use crate::model::{LatticeKind, full_scale};
use crate::numerics::median;

/// Number of white images that are used: those with the largest f-numbers.
const IMAGES: usize = 2;
/// Distance from the origin of the pattern along each axis up to which micro-images are used, in pitches.
const REACH: f64 = 6.0;
/// Width of the rings about the middles of micro-images, px.
const RING_PX: f64 = 0.5;
/// Fewest pixels that determine the darkest level.
const FEWEST: usize = 200;
/// Change of the light, relative to the light of the micro-images, up to which it counts as constant.
const FLAT: f64 = 2e-3;
/// Least distance over which the light has to be constant, px. Its nearer part is left out for the tail of the light.
const DARK_PX: f64 = 1.5;
const TAIL_PX: f64 = 1.0;
/// Fraction of the light of the micro-images above which the darkest places are not dark.
const BRIGHT: f64 = 0.25;
/// Limit of hot pixels, in median deviations. A deviation is at least one grey level.
const OUTLIERS: f64 = 6.0;
/// Fraction of the samples at 0 above which noise is clipped there.
const CLIPPED: f64 = 0.02;

/// Black level in grey levels of the first white image.
pub(super) struct Black {
    pub level: f64,
    /// Bits of a sample of that image.
    pub bits: u32,
    /// Standard deviation of the level, if it was measured.
    pub std_dev: Option<f64>,
    /// Finding if the level is not known, or if the stated one is not possible.
    pub finding: Option<Finding>,
}

/// Returns the stated black level, or else measures it between the micro-images of a pattern. Returns an error if the
/// stated level is not possible.
pub(super) fn black_level(
    whites: &[White],
    pattern: Option<&Pattern>,
    stated: Option<f64>,
) -> Result<Black> {
    let bits = whites.first().map_or(8, |white| white.image.bits());
    let full = full_scale(bits);
    let mut by_f_number: Vec<&White> = whites.iter().collect();
    by_f_number.sort_by(|a, b| b.f_number.total_cmp(&a.f_number));
    let looked_at = by_f_number.into_iter().take(IMAGES);
    let mut shown: Vec<(&White, Darkest)> =
        looked_at.filter_map(|white| Some((white, shown_by(&white.image, pattern?)?))).collect();
    let mut dark = shown.iter().filter(|(_, darkest)| darkest.is_dark);
    if let (Some((white, first)), Some((_, second))) = (dark.next(), dark.next()) {
        let change = second.level - first.level;
        debug!("{}: black level {:.6}, then {change:+.6} of full scale", white.name, first.level);
        shown[0].1.std_dev = shown[0].1.std_dev.hypot(change);
    }
    let darkest = shown.iter().find(|(_, darkest)| darkest.is_dark);
    if let Some(level) = stated {
        if !(0.0..full).contains(&level) {
            return Err(Error::invalid(format!(
                "a black level of {level} is not possible: give the mean sample of an image without \
                 light, from 0 to {full}"
            )));
        }
        let finding = darkest
            .or(shown.first())
            .and_then(|(white, darkest)| checks::black_level(level, full, darkest, &white.name));
        return Ok(Black { level, bits, std_dev: None, finding });
    }
    if let Some((_, darkest)) = darkest {
        let [level, std_dev] = [darkest.level, darkest.std_dev].map(|part| part * full);
        return Ok(Black { level, bits, std_dev: Some(std_dev), finding: None });
    }
    let finding = checks::black_level_unknown(shown.iter().map(|(_, darkest)| darkest));
    Ok(Black { level: 0.0, bits, std_dev: None, finding })
}

/// Measures the darkest places of a white image, between the micro-images about the origin of a pattern. Returns `None`
/// if there are none.
fn shown_by(raw: &RawImage, found: &Pattern) -> Option<Darkest> {
    let grey = raw.as_they_are();
    let mut nodes = nodes_in(grey.size(), found);
    let reach = REACH * found.pitch();
    nodes.retain(|&(i, j)| (found.place(i, j) - found.origin).amax() < reach);
    let (pattern, blobs) = measure_sample(&grey, found, &nodes)?;
    let places = blobs.iter().map(|blob| blob.center);
    let (part, corner) = part_with(&grey, places, pattern.pitch());
    let pattern = pattern.seen_from(&corner);
    let mut rings: Vec<Vec<f64>> = Vec::new();
    for Blob { node, .. } in &blobs {
        let center = pattern.place(node.0, node.1);
        let neighbours = neighbours(&pattern);
        // Pixels beyond half the way to a neighbour belong to the neighbour.
        pixels_about(&part, &center, pattern.pitch(), |offset, light| {
            if neighbours.iter().all(|step| offset.dot(step) <= step.norm_squared() / 2.0) {
                #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a distance
                let ring = (offset.norm() / RING_PX) as usize;
                if rings.len() <= ring {
                    rings.resize(ring + 1, Vec::new());
                }
                rings[ring].push(light);
            }
        });
    }
    let [_, step] = raw.largest_and_step();
    darkness(&rings, f64::from(step) / raw.full_scale())
}

/// Returns the steps from a node to its nearest nodes.
fn neighbours(pattern: &Pattern) -> Vec<Vector2<f64>> {
    let (a, b) = (pattern.along, pattern.across);
    let other = if pattern.kind == LatticeKind::Orthogonal { a + b } else { b - a };
    [a, b, other, a - b].into_iter().flat_map(|step| [step, -step]).collect()
}

/// Finds the darkest places from the samples in rings about the middles of micro-images.
fn darkness(rings: &[Vec<f64>], grey_level: f64) -> Option<Darkest> {
    let brightest =
        rings.iter().filter_map(|ring| median(ring.iter().copied())).fold(0.0, f64::max);
    // The outermost rings have few pixels.
    let mut first = rings.len();
    let mut furthest: Vec<f64> = Vec::new();
    while furthest.len() < FEWEST {
        first = first.checked_sub(1)?;
        furthest.extend(&rings[first]);
    }
    let (darkest, std_dev, _) = mean(&furthest, grey_level)?;
    let light = brightest - darkest;
    let touching = Some(Darkest { level: darkest, std_dev, light, grey_level, is_dark: false });
    if darkest > BRIGHT * brightest {
        return touching;
    }
    let is_dark = |ring: &Vec<f64>| {
        let allowed = FLAT * light;
        mean(ring, grey_level)
            .is_none_or(|(here, std_dev, _)| here - darkest < allowed + 3.0 * std_dev)
    };
    let dark = rings[..first].iter().rposition(|ring| !is_dark(ring)).map_or(0, |last| last + 1);
    let width = (rings.len() - dark) as f64 * RING_PX;
    if width < DARK_PX {
        return touching;
    }
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a few rings
    let kept: Vec<f64> = rings[dark + (TAIL_PX / RING_PX) as usize..].concat();
    let (mut level, std_dev, scatter) = mean(&kept, grey_level)?;
    let zeros = kept.iter().filter(|&&light| light < 0.5 * grey_level).count() as f64;
    if zeros > CLIPPED * kept.len() as f64 {
        level = grouped_median(&kept, grey_level);
    }
    // The mean of rounded samples is biased unless noise spreads them over several grey levels.
    let noise = ((scatter / grey_level).powi(2) - 1.0 / 12.0).max(0.0);
    let rounding = (1.0_f64 / 12.0).sqrt() * (-2.0 * std::f64::consts::PI.powi(2) * noise).exp();
    let std_dev = std_dev.hypot(rounding * grey_level);
    Some(Darkest { level, std_dev, light, grey_level, is_dark: true })
}

/// Returns the mean of samples without hot pixels, its σ, and their scatter.
fn mean(samples: &[f64], grey_level: f64) -> Option<(f64, f64, f64)> {
    let middle = median(samples.iter().copied())?;
    let typical = median(samples.iter().map(|sample| (sample - middle).abs()))?.max(grey_level);
    let kept = || samples.iter().filter(|&sample| (sample - middle).abs() <= OUTLIERS * typical);
    let count = kept().count() as f64;
    let mean = kept().sum::<f64>() / count;
    let variance = kept().map(|sample| (sample - mean).powi(2)).sum::<f64>() / count;
    Some((mean, (variance / count).sqrt(), variance.sqrt()))
}

/// Returns the median of whole grey levels, each spread over its width. Samples that are clipped at 0 do not affect it
/// while they are fewer than half; otherwise it is 0.
fn grouped_median(samples: &[f64], grey_level: f64) -> f64 {
    let Some(middle) = median(samples.iter().copied()) else { return 0.0 };
    if middle < 0.5 * grey_level {
        return 0.0;
    }
    let part = |keep: &dyn Fn(f64) -> bool| {
        samples.iter().filter(|&&sample| keep(sample)).count() as f64 / samples.len() as f64
    };
    let below = part(&|sample| sample < middle - 0.5 * grey_level);
    let here = part(&|sample| (sample - middle).abs() <= 0.5 * grey_level);
    middle + ((0.5 - below) / here.max(f64::MIN_POSITIVE) - 0.5) * grey_level
}
