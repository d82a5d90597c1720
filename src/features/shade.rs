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

/// The visible part of the micro-lenses of one type, by distance from the centre of the micro-image.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Shade {
    moments: Vec<Moments>,
    sign: f64,
}

/// Of the visible part, in radii of the micro-lens.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Moments {
    /// Centroid, outwards.
    mean: f64,
    /// Standard deviation radially and across, over those of the whole micro-lens.
    along: f64,
    across: f64,
    /// Area.
    area: f64,
    /// How much nearer to the centre than its own middle that of a pixel's light is, px.
    inwards: f64,
}

/// The whole micro-lens.
const WHOLE: Moments =
    Moments { mean: 0.0, along: 1.0, across: 1.0, area: std::f64::consts::PI, inwards: 0.0 };
/// Resolution, px.
const STEP_PX: f64 = 0.1;
/// Strips of the integrals.
const STRIPS: u32 = 200;
/// Of a part smaller than this, in parts of the whole, moments are those of the last larger one.
const LEAST: f64 = 1e-3;

/// At the very edge light falls to nothing, and its logarithm without end.
const MOST_INWARDS_PX: f64 = 0.3;

impl Shade {
    /// For a pupil of radius a and its blur radius qᵢ, px.
    pub fn new(pupil_px: f64, q_px: f64) -> Self {
        let q = q_px.abs().max(1e-6);
        let outer = pupil_px + q;
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a few pixels
        let count = (outer / STEP_PX).ceil() as usize + 2;
        let mut last = WHOLE;
        let mut moments: Vec<Moments> = (0..count)
            .map(|i| {
                last = common_part(i as f64 * STEP_PX / q, pupil_px / q).unwrap_or(last);
                last
            })
            .collect();
        for i in 2..count.saturating_sub(2) {
            let fall = (moments[i - 2].area / moments[i + 2].area).ln() / (4.0 * STEP_PX);
            moments[i].inwards = (fall / 12.0).clamp(0.0, MOST_INWARDS_PX);
        }
        Self { moments, sign: q_px.signum() }
    }

    /// Nothing is cut.
    pub fn none() -> Self {
        Self { moments: vec![WHOLE], sign: 1.0 }
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
            mean: outwards * (self.sign * mix(|m| m.mean)),
            squeeze: radial * mix(|m| m.along) + (Matrix2::identity() - radial) * mix(|m| m.across),
        }
    }
}

/// What a pixel sees through.
#[derive(Debug, Clone, Copy)]
pub(super) struct Part {
    /// Middle of the pixel's light from the centre of the micro-image, px. Light falls towards the
    /// edge, and a pixel has a variance of a twelfth along each axis.
    pub seen_at: Vector2<f64>,
    /// Middle of the visible part of the micro-lens, in its radii.
    pub mean: Vector2<f64>,
    /// Squeezes the disc of the micro-lens into the visible part.
    pub squeeze: Matrix2<f64>,
}

/// At which angles light comes to a micro-image.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Obliquity {
    /// Angle of the ray from the middle of the main lens to the centre of the micro-image, rad.
    pub chief: Vector2<f64>,
    /// 1/d, 1/px.
    pub inverse_distance: f64,
    /// Radius of the micro-lens, px.
    pub lens_px: f64,
}

/// Power of the cosine.
const FALL_OFF: f64 = 4.0;

impl Obliquity {
    /// How far the centroid of the visible part moves, in radii of the micro-lens. To first order: cosⁿ
    /// of an angle θ is 1 − n θ²/2, and of a part with covariance C a weight with the gradient g moves
    /// the centroid by C g.
    pub(super) fn shift(&self, offset: &Vector2<f64>, part: &Part) -> Vector2<f64> {
        let angle = self.chief + (offset + part.mean * self.lens_px) * self.inverse_distance;
        let gradient = angle * (-FALL_OFF * self.lens_px * self.inverse_distance);
        // A disc has a standard deviation of half its radius.
        part.squeeze * (part.squeeze * gradient) / 4.0
    }
}

/// Moments of the common part of the unit disc and one of another radius at a distance; `None` if it
/// is as good as nothing.
fn common_part(distance: f64, radius: f64) -> Option<Moments> {
    let (low, high) = ((-1.0_f64).max(distance - radius), 1.0_f64.min(distance + radius));
    if high <= low {
        return None;
    }
    let width = (high - low) / f64::from(STRIPS);
    let (mut area, mut first, mut second, mut across) = (0.0, 0.0, 0.0, 0.0);
    for i in 0..STRIPS {
        let x = low + (f64::from(i) + 0.5) * width;
        let chord = |radius: f64, x: f64| (radius * radius - x * x).max(0.0).sqrt();
        let half = chord(1.0, x).min(chord(radius, x - distance));
        area += 2.0 * half;
        first += 2.0 * half * x;
        second += 2.0 * half * x * x;
        across += 2.0 * half.powi(3) / 3.0;
    }
    if area * width < LEAST * std::f64::consts::PI {
        return None;
    }
    let mean = first / area;
    // A disc has a standard deviation of half its radius.
    Some(Moments {
        mean,
        along: 2.0 * (second / area - mean * mean).max(0.0).sqrt(),
        across: 2.0 * (across / area).sqrt(),
        area: area * width,
        inwards: 0.0,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn common_parts_of_discs() {
        let close = |a: f64, b: f64| (a - b).abs() < 1e-3;
        // The whole micro-lens, the whole pupil, and by hand two half discs: their centroid is
        // 4/3π from the cut.
        let whole = common_part(1.0, 3.0).unwrap();
        assert!(close(whole.mean, 0.0) && close(whole.along, 1.0) && close(whole.across, 1.0));
        let pupil = common_part(0.3, 0.5).unwrap();
        assert!(close(pupil.mean, 0.3) && close(pupil.along, 0.5) && close(pupil.across, 0.5));
        let half = common_part(1000.0, 1000.0).unwrap();
        assert!(close(half.mean, 4.0 / 3.0 / std::f64::consts::PI) && close(half.across, 1.0));
        assert!(common_part(2.0, 0.9).is_none());
    }

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
