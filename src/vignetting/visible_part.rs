//! The part of a micro-lens through which a pixel sees the main lens's pupil: mechanical vignetting.
//!
//! In units of the micro-lens's radius the pupil is a disc of radius a/|qᵢ| about (p − c)/qᵢ: light
//! reaches pixel p through the part of the micro-lens that this disc overlaps. Its centroid and spread
//! depend on the distance of p from the centre c only.
//!
//! Points of the micro-lens have the sign that they have in p − ρ w: they are rotated by half a turn
//! from their true positions.

use nalgebra::{Matrix2, Vector2};

use super::points::{POINTS, in_overlap, of_disc};
use crate::vignetting::{Overlap, overlap};

/// Vignetting of the micro-lenses of one type as a function of the distance from the centre of the
/// micro-image.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Vignetting {
    moments: Vec<Moments>,
    /// Points of the visible part, less its mean, along and across the direction from the centre.
    points: Vec<[Vector2<f32>; POINTS]>,
    sign: f64,
}

/// What a pixel at some distance from the centre sees.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Moments {
    /// The visible part of the micro-lens.
    part: Overlap,
    /// Distance by which the centroid of a pixel's light is nearer to the centre than the pixel's
    /// middle, px.
    inwards: f64,
}

/// Resolution, px.
const STEP_PX: f64 = 0.1;

/// Points are looked for where the discs overlap by at least this, in radii of the micro-lens.
const LEAST: f64 = 0.02;

/// At the very edge the light falls to zero and its logarithm is unbounded, so the shift is limited
/// to this.
const MOST_INWARDS_PX: f64 = 0.3;

impl Vignetting {
    /// Vignetting for a pupil of radius a and the intercept qᵢ, px.
    pub fn new(pupil_px: f64, q_px: f64) -> Self {
        let q = q_px.abs().max(1e-6);
        let outer = pupil_px + q;
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a few pixels
        let count = (outer / STEP_PX).ceil() as usize + 2;
        let mut part = Overlap::WHOLE;
        let mut moments: Vec<Moments> = (0..count)
            .map(|i| {
                // Where almost nothing is visible, use the last part that was.
                part = overlap(i as f64 * STEP_PX / q, pupil_px / q).unwrap_or(part);
                Moments { part, inwards: 0.0 }
            })
            .collect();
        for i in 2..count.saturating_sub(2) {
            let fall = (moments[i - 2].part.area / moments[i + 2].part.area).ln() / (4.0 * STEP_PX);
            moments[i].inwards = (fall / 12.0).clamp(0.0, MOST_INWARDS_PX);
        }
        let disc = of_disc();
        let sign = q_px.signum();
        #[allow(clippy::cast_possible_truncation)] // single precision, as the light
        let points_at = |(i, m): (usize, &Moments)| {
            let (distance, radius) = (i as f64 * STEP_PX / q, pupil_px / q);
            let points = in_overlap(&disc, distance.min(1.0 + radius - LEAST), radius, &m.part);
            points.map(|p| Vector2::new((sign * (p.x - m.part.mean)) as f32, p.y as f32))
        };
        let points = moments.iter().enumerate().map(points_at).collect();
        Self { moments, points, sign }
    }

    /// No vignetting: the whole micro-lens is visible.
    pub fn none() -> Self {
        #[allow(clippy::cast_possible_truncation)] // as above
        let points = vec![of_disc().map(|p| p.map(|x| x as f32))];
        Self { moments: vec![Moments { part: Overlap::WHOLE, inwards: 0.0 }], points, sign: 1.0 }
    }

    /// The part of the micro-lens through which the pixel at an offset from the centre, px, sees.
    pub fn at(&self, offset: &Vector2<f64>) -> VisiblePart<'_> {
        let r = offset.norm();
        let outwards = if r > 1e-9 { offset / r } else { Vector2::x() };
        let steps = r / STEP_PX;
        let last = self.moments.len() - 1;
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // not below 0
        let i = (steps as usize).min(last);
        let (m, n) = (&self.moments[i], &self.moments[(i + 1).min(last)]);
        let part = (steps - i as f64).min(1.0);
        let mix = |of: fn(&Moments) -> f64| of(m) * (1.0 - part) + of(n) * part;
        let radial = outwards * outwards.transpose();
        VisiblePart {
            outwards,
            points: &self.points[if part < 0.5 { i } else { (i + 1).min(last) }],
            seen_at: offset - outwards * mix(|m| m.inwards),
            mean: outwards * (self.sign * mix(|m| m.part.mean)),
            squeeze: radial * mix(|m| m.part.along)
                + (Matrix2::identity() - radial) * mix(|m| m.part.across),
        }
    }
}

/// The visible part of a micro-lens.
#[derive(Debug, Clone, Copy)]
pub(crate) struct VisiblePart<'a> {
    /// Away from the centre of the micro-image.
    pub outwards: Vector2<f64>,
    /// Points that stand for equal shares of it, less its centroid, in radii of the micro-lens: along
    /// `outwards` and across it.
    pub points: &'a [Vector2<f32>; POINTS],
    /// Centroid of the pixel's light relative to the centre of the micro-image, px. The light falls off
    /// towards the edge, and a pixel has a variance of 1/12 px² along each axis.
    pub seen_at: Vector2<f64>,
    /// Centroid of the visible part, in radii of the micro-lens.
    pub mean: Vector2<f64>,
    /// Maps the disc of the micro-lens to one of the size of the visible part.
    pub squeeze: Matrix2<f64>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pixel_right_of_the_centre_sees_the_side_given_by_the_sign_of_the_blur() {
        for (q, side) in [(5.0, 1.0), (-5.0, -1.0)] {
            let vignetting = Vignetting::new(6.0, q);
            let part = vignetting.at(&Vector2::new(9.0, 0.0));
            assert!(part.mean.x * side > 0.5 && part.mean.y.abs() < 1e-9);
            assert!(part.squeeze[(0, 0)] < part.squeeze[(1, 1)] && part.seen_at.x < 9.0);
            let part = vignetting.at(&Vector2::new(0.5, 0.0));
            assert!(part.mean.norm() < 1e-9 && (part.squeeze[(0, 0)] - 1.0).abs() < 1e-3);
        }
    }
}
