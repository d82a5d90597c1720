//! The part of a micro-lens through which a pixel sees the main lens's pupil: mechanical vignetting.
//!
//! In units of the micro-lens's radius the pupil is a disc of radius a/|qᵢ| about (p − c)/qᵢ: light
//! reaches pixel p through the part of the micro-lens that this disc overlaps. Its centroid and spread
//! depend on the distance of p from the centre c only.
//!
//! Points of the micro-lens have the sign that they have in p − ρ w: they are rotated by half a turn
//! from their true positions.

// Only what is inlined into a dispatched function is compiled for its registers.
#![allow(clippy::inline_always)]

use nalgebra::Vector2;

use super::pixel::Pixel;
use super::points::{POINTS, ROOM, in_overlap, in_room, of_disc};
use crate::vignetting::{Overlap, overlap};

/// Vignetting of the micro-lenses of one type as a function of the distance from the centre of the
/// micro-image.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Vignetting {
    moments: Vec<Moments>,
    points: Vec<PartPoints>,
    sign: f64,
    /// Variance of a pixel along an axis, px².
    pixel: f32,
}

/// What a pixel at some distance from the centre sees: by how much the centroid of its light is nearer to the centre
/// than the pixel's middle, px; the centroid of the visible part of the micro-lens, weighted with the light over the
/// pixel; and the standard deviations of that part, from the centre and across, over those of the whole disc.
type Moments = [f64; 4];

/// Points that stand for cells of the visible part, all cells having equal area.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct PartPoints {
    /// Their places w less the centroid of the part, in radii of the micro-lens, along the direction from the centre
    /// and across it.
    pub along: [f32; ROOM],
    pub across: [f32; ROOM],
    /// How they move with the pixel: the trace of ∂w/∂p, px⁻¹, and that of its product with its transpose, px⁻².
    trace: [f32; ROOM],
    squares: [f32; ROOM],
}

impl PartPoints {
    /// Variance along an axis, the mean of both, of where the light that comes through point `j` comes from
    /// because of the extent of the pixel, for the blur radius ρ, over that of the pixel. Across a pixel the visible part
    /// moves, and what is seen, p − ρ w, changes by 1 − ρ ∂w/∂p as p does.
    #[inline(always)]
    pub fn pixel(&self, j: usize, rho: f32) -> f32 {
        1.0 - rho * self.trace[j] + rho * rho * self.squares[j] / 2.0
    }
}

/// Resolution, px.
const STEP_PX: f64 = 0.1;
/// Steps to either side that slopes are taken from.
const REACH: usize = 2;

/// Points are looked for where the discs overlap by at least this, in radii of the micro-lens.
const LEAST: f64 = 0.02;

impl Vignetting {
    /// Vignetting for a pupil of radius a and the intercept qᵢ, px, as pixels see it.
    pub fn new(pupil_px: f64, q_px: f64, pixel: &Pixel) -> Self {
        let q = q_px.abs().max(1e-6);
        let outer = pupil_px + q;
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a few pixels
        let count = (outer / STEP_PX).ceil() as usize + 2;
        let mut part = Overlap::WHOLE;
        let parts: Vec<Overlap> = (0..count)
            .map(|i| {
                // Where almost nothing is visible, use the last part that was.
                part = overlap(i as f64 * STEP_PX / q, pupil_px / q).unwrap_or(part);
                part
            })
            .collect();
        let moments = (0..count).map(|i| moments_at(&parts, i, pixel)).collect();
        let disc = of_disc();
        let places: Vec<[Vector2<f64>; POINTS]> = (0..count)
            .map(|i| {
                let (distance, radius) = (i as f64 * STEP_PX / q, pupil_px / q);
                in_overlap(&disc, distance.min(1.0 + radius - LEAST), radius, &parts[i])
            })
            .collect();
        let sign = q_px.signum();
        let points = (0..count).map(|i| part_points(&places, &parts[i], &disc, i, sign)).collect();
        #[allow(clippy::cast_possible_truncation)] // as the light
        let pixel = pixel.variance as f32;
        Self { moments, points, sign, pixel }
    }

    /// Variance along an axis of what a pixel collects, px².
    pub fn pixel_variance(&self) -> f32 {
        self.pixel
    }

    /// The part of the micro-lens through which the pixel at an offset from the centre, px, sees.
    #[inline(always)]
    pub fn at(&self, offset: &Vector2<f64>) -> VisiblePart<'_> {
        let r = offset.norm();
        let outwards = if r > 1e-9 { offset / r } else { Vector2::x() };
        let (below, above, part) = between(r, self.moments.len());
        let (below, above) = (&self.moments[below], &self.moments[above]);
        let mut mixed = [0.0; 4];
        for of in 0..4 {
            mixed[of] = below[of] * (1.0 - part) + above[of] * part;
        }
        let [inwards, mean, along, across] = mixed;
        // What is seen changes across a pixel; the centroid of its light stands for all of it.
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // not below 0
        let nearest =
            (((r - inwards).max(0.0) / STEP_PX + 0.5) as usize).min(self.points.len() - 1);
        VisiblePart {
            outwards,
            sign: self.sign,
            pixel: self.pixel,
            points: &self.points[nearest],
            seen_at: offset - outwards * inwards,
            mean: outwards * (self.sign * mean),
            spread: [along, across],
        }
    }
}

/// What the pixel at step `i` sees, from the parts that are visible from points at all steps.
fn moments_at(parts: &[Overlap], i: usize, pixel: &Pixel) -> Moments {
    let r = i as f64 * STEP_PX;
    let (inwards, mean) = mean_over_pixel(parts, r, pixel).unwrap_or((0.0, parts[i].mean));
    // The centroid of its light stands for all of it.
    let (below, above, share) = between(r - inwards, parts.len());
    let mixed =
        |of: fn(&Overlap) -> f64| of(&parts[below]) * (1.0 - share) + of(&parts[above]) * share;
    [inwards, mean, mixed(|p| p.along), mixed(|p| p.across)]
}

/// The steps below and above a distance from the centre, px, among so many, and its part of the way from the one to the
/// other.
#[inline(always)]
fn between(distance: f64, count: usize) -> (usize, usize, f64) {
    let (steps, last) = ((distance / STEP_PX).max(0.0), count - 1);
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // not below 0
    let below = (steps as usize).min(last);
    (below, (below + 1).min(last), (steps - below as f64).min(1.0))
}

/// By how much the centroid of the light of a pixel is nearer to the centre than its middle, which is r from it, px, and the
/// mean of the centroids of the parts that it sees, by their light; `None` without light.
fn mean_over_pixel(parts: &[Overlap], r: f64, pixel: &Pixel) -> Option<(f64, f64)> {
    let (mut inwards, mut first, mut light) = (0.0, 0.0, 0.0);
    for &(x, along) in &pixel.along {
        for &(y2, across) in &pixel.across {
            let distance = ((r + x).powi(2) + y2).sqrt();
            let (below, above, share) = between(distance, parts.len());
            let mixed = |of: fn(&Overlap) -> f64| {
                of(&parts[below]) * (1.0 - share) + of(&parts[above]) * share
            };
            let beyond = distance > (parts.len() - 1) as f64 * STEP_PX;
            let weight = if beyond { 0.0 } else { along * across * mixed(|p| p.area) };
            light += weight;
            inwards -= weight * x;
            first += weight * mixed(|p| p.mean) * (r + x) / distance.max(1e-9);
        }
    }
    (light > 0.0).then(|| (inwards / light, first / light))
}

/// The points of the part at step `i`, from those at all steps, less centroids, and with how they move.
///
/// A point w of the disc is seen at m + S w, with the mean m of the part and its spread S along and across the
/// direction from the centre. Both change along that direction, and turn with it; the w themselves do not.
fn part_points(
    places: &[[Vector2<f64>; POINTS]],
    part: &Overlap,
    disc: &[Vector2<f64>; POINTS],
    i: usize,
    sign: f64,
) -> PartPoints {
    let (before, after) = (i.saturating_sub(REACH), (i + REACH).min(places.len() - 1));
    let distance = ((after - before) as f64 * STEP_PX).max(STEP_PX);
    let r = i.max(1) as f64 * STEP_PX;
    let shear = (part.along - part.across) / r;
    // The columns of ∂w/∂p.
    let drift = |j: usize| {
        let radial = (places[after][j] - places[before][j]) / distance;
        (radial, Vector2::new(shear * disc[j].y, part.mean / r + shear * disc[j].x))
    };
    PartPoints {
        along: in_room(|j| sign * (places[i][j].x - part.mean)),
        across: in_room(|j| places[i][j].y),
        trace: in_room(|j| {
            let (radial, across) = drift(j);
            sign * (radial.x + across.y)
        }),
        squares: in_room(|j| {
            let (radial, across) = drift(j);
            radial.norm_squared() + across.norm_squared()
        }),
    }
}

/// The visible part of a micro-lens.
#[derive(Debug, Clone, Copy)]
pub(crate) struct VisiblePart<'a> {
    /// Away from the centre of the micro-image.
    pub outwards: Vector2<f64>,
    /// That of qᵢ: the side from which x counts in the points of the disc that `points` come from.
    pub sign: f64,
    /// Variance of the pixel along an axis, px².
    pub pixel: f32,
    /// The points that stand for it.
    pub points: &'a PartPoints,
    /// Centroid of the pixel's light relative to the centre of the micro-image, px. The light falls off
    /// towards the edge.
    pub seen_at: Vector2<f64>,
    /// Centroid of the visible part, in radii of the micro-lens.
    pub mean: Vector2<f64>,
    /// Standard deviations of the part over those of the whole disc, along `outwards` and across it.
    pub spread: [f64; 2],
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pixel_right_of_the_centre_sees_the_side_given_by_the_sign_of_the_blur() {
        for (q, side) in [(5.0, 1.0), (-5.0, -1.0)] {
            let vignetting = Vignetting::new(6.0, q, &Pixel::default());
            let part = vignetting.at(&Vector2::new(9.0, 0.0));
            assert!(part.mean.x * side > 0.5 && part.mean.y.abs() < 1e-9);
            assert!(part.spread[0] < part.spread[1] && part.seen_at.x < 9.0);
            let part = vignetting.at(&Vector2::new(0.5, 0.0));
            assert!(
                part.mean.norm() < 1e-3 && (part.spread[0] - 1.0).abs() < 1e-3,
                "{:?} {:?}",
                part.mean,
                part.spread
            );
            assert!((0..POINTS).all(|j| (part.points.pixel(j, 3.0) - 1.0).abs() < 2e-3));
        }
    }
}
