//! Which part of a micro-lens a pixel sees the main lens's pupil through.
//!
//! In units of the micro-lens's radius the pupil is a disc of radius a/|qᵢ| about (p − c)/qᵢ: light
//! reaches pixel p through what that disc and the micro-lens have in common. Its centroid and spread
//! depend on the distance of p from the centre c only.
//!
//! Light falls off with the angle at which it meets the sensor, by cos⁴: the steeper side of the
//! micro-lens counts for more, and the centroid moves there. Points of the micro-lens are counted as in
//! p − ρ w, that is turned by half against where they are.

use nalgebra::{Matrix2, Vector2};

use crate::vignetting::{CommonPart, common_part};

/// The visible part of the micro-lenses of one type, by distance from the centre of the micro-image.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Shade {
    moments: Vec<Moments>,
    sign: f64,
}

/// What is seen at a distance from the centre.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Moments {
    /// Of the micro-lens.
    part: CommonPart,
    /// How much nearer to the centre than its own middle that of a pixel's light is, px.
    inwards: f64,
}

/// Resolution, px.
const STEP_PX: f64 = 0.1;

/// At the very edge light falls to nothing, and its logarithm without end.
const MOST_INWARDS_PX: f64 = 0.3;

impl Shade {
    /// For a pupil of radius a and its blur radius qᵢ, px.
    pub fn new(pupil_px: f64, q_px: f64) -> Self {
        let q = q_px.abs().max(1e-6);
        let outer = pupil_px + q;
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a few pixels
        let count = (outer / STEP_PX).ceil() as usize + 2;
        let mut part = CommonPart::WHOLE;
        let mut moments: Vec<Moments> = (0..count)
            .map(|i| {
                // Where next to nothing is left, what was last seen of it.
                part = common_part(i as f64 * STEP_PX / q, pupil_px / q).unwrap_or(part);
                Moments { part, inwards: 0.0 }
            })
            .collect();
        for i in 2..count.saturating_sub(2) {
            let fall = (moments[i - 2].part.area / moments[i + 2].part.area).ln() / (4.0 * STEP_PX);
            moments[i].inwards = (fall / 12.0).clamp(0.0, MOST_INWARDS_PX);
        }
        Self { moments, sign: q_px.signum() }
    }

    /// Nothing is cut.
    pub fn none() -> Self {
        Self { moments: vec![Moments { part: CommonPart::WHOLE, inwards: 0.0 }], sign: 1.0 }
    }

    /// What the pixel at an offset from the centre sees through.
    pub fn part(&self, offset: &Vector2<f64>) -> Part {
        let r = offset.norm();
        let outwards = if r > 1e-9 { offset / r } else { Vector2::x() };
        let at = r / STEP_PX;
        let last = self.moments.len() - 1;
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // not below 0
        let i = (at as usize).min(last);
        let (m, n) = (&self.moments[i], &self.moments[(i + 1).min(last)]);
        let part = (at - i as f64).min(1.0);
        let mix = |of: fn(&Moments) -> f64| of(m) * (1.0 - part) + of(n) * part;
        let radial = outwards * outwards.transpose();
        Part {
            seen_at: offset - outwards * mix(|m| m.inwards),
            mean: outwards * (self.sign * mix(|m| m.part.mean)),
            squeeze: radial * mix(|m| m.part.along)
                + (Matrix2::identity() - radial) * mix(|m| m.part.across),
        }
    }
}

/// What a pixel sees through.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Part {
    /// Middle of the pixel's light from the centre of the micro-image, px. Light falls towards the
    /// edge, and a pixel has a variance of a twelfth along each axis.
    pub seen_at: Vector2<f64>,
    /// Middle of the visible part of the micro-lens, in its radii.
    pub mean: Vector2<f64>,
    /// Squeezes the disc of the micro-lens into the visible part.
    pub squeeze: Matrix2<f64>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pixel_right_of_the_centre_sees_through_the_side_that_the_blur_says() {
        for (q, side) in [(5.0, 1.0), (-5.0, -1.0)] {
            let shade = Shade::new(6.0, q);
            let part = shade.part(&Vector2::new(9.0, 0.0));
            assert!(part.mean.x * side > 0.5 && part.mean.y.abs() < 1e-9);
            assert!(part.squeeze[(0, 0)] < part.squeeze[(1, 1)] && part.seen_at.x < 9.0);
            let part = shade.part(&Vector2::new(0.5, 0.0));
            assert!(part.mean.norm() < 1e-9 && (part.squeeze[(0, 0)] - 1.0).abs() < 1e-3);
        }
    }
}
