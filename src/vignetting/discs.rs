//! Two discs, and what they have in common.
//!
//! On the sensor the main lens's pupil, seen through the middle of a micro-lens, is a disc, and every
//! point of it is spread by the micro-lens over another one. A pixel sees the pupil through the part of
//! the micro-lens that the two have in common.

use nalgebra::{Matrix2, Vector2};

/// Overlap of discs of radius a and b at distance r, in parts of the smaller one.
pub(crate) fn overlap(r: f64, outer: f64, inner: f64) -> f64 {
    if r <= inner {
        return 1.0;
    }
    if r >= outer {
        return 0.0;
    }
    let (large, small) = (f64::midpoint(outer, inner), (outer - inner) / 2.0);
    let (l2, s2, r2) = (large * large, small * small, r * r);
    let of_large = ((r2 + l2 - s2) / (2.0 * r * large)).clamp(-1.0, 1.0);
    let of_small = ((r2 + s2 - l2) / (2.0 * r * small)).clamp(-1.0, 1.0);
    let kite =
        (-r + large + small) * (r + large - small) * (r - large + small) * (r + large + small);
    let area = s2 * of_small.acos() + l2 * of_large.acos() - 0.5 * kite.max(0.0).sqrt();
    area / (std::f64::consts::PI * s2)
}

/// A part of the unit disc.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct CommonPart {
    /// Centroid, towards the other disc.
    pub mean: f64,
    /// Standard deviations towards it and across, over those of the whole disc.
    pub along: f64,
    pub across: f64,
    /// Area.
    pub area: f64,
}

impl CommonPart {
    /// All of the unit disc.
    pub const WHOLE: Self = Self { mean: 0.0, along: 1.0, across: 1.0, area: std::f64::consts::PI };
}

/// Strips of the integrals.
const STRIPS: u32 = 200;
/// Of a part smaller than this, in parts of the whole, there are no moments.
const LEAST: f64 = 1e-3;

/// The common part of the unit disc and one of another radius at a distance; `None` if it is as good as
/// nothing.
pub(crate) fn common_part(distance: f64, radius: f64) -> Option<CommonPart> {
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
    Some(CommonPart {
        mean,
        along: 2.0 * (second / area - mean * mean).max(0.0).sqrt(),
        across: 2.0 * (across / area).sqrt(),
        area: area * width,
    })
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

/// Light falls off with the angle at which it meets the sensor by this power of the cosine.
const FALL_OFF: f64 = 4.0;

impl Obliquity {
    /// How far the centroid of a part of the micro-lens moves where light comes from it to a pixel at an
    /// offset from the centre: the steeper side counts for less. `from_lens` is the way from the part's
    /// own centroid to the pixel, px, `spread` its standard deviations in units of half a radius;
    /// in radii of the micro-lens.
    ///
    /// To first order: cosⁿ of an angle θ is 1 − n θ²/2, and a weight with the gradient g moves the
    /// centroid of a part with covariance C by C g.
    pub(crate) fn shift(&self, from_lens: &Vector2<f64>, spread: &Matrix2<f64>) -> Vector2<f64> {
        let angle = self.chief + from_lens * self.inverse_distance;
        let gradient = angle * (FALL_OFF * self.lens_px * self.inverse_distance);
        spread * (spread * gradient) / 4.0
    }

    /// Light of a part over what it would be if it came straight. `from_lens` as above, `along` and
    /// `across` the standard deviations in units of half a radius.
    pub(crate) fn light(&self, from_lens: &Vector2<f64>, along: f64, across: f64) -> f64 {
        let angle = self.chief + from_lens * self.inverse_distance;
        let extent = self.lens_px * self.inverse_distance / 2.0;
        let square = angle.norm_squared() + extent.powi(2) * (along.powi(2) + across.powi(2));
        (1.0 + square).powf(-FALL_OFF / 2.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// By hand: equal discs at the distance of their radius share 2π/3 − √3/2 of r².
    #[test]
    fn overlap_of_discs() {
        let equal = (2.0 * std::f64::consts::PI / 3.0 - 0.75_f64.sqrt()) / std::f64::consts::PI;
        assert!((overlap(2.0, 4.0, 0.0) - equal).abs() < 1e-12);
        assert!((overlap(0.5, 4.0, 1.0) - 1.0).abs() < 1e-12);
        assert!(overlap(4.0, 4.0, 1.0).abs() < 1e-12);
        // The integral over the plane is the area of the larger disc.
        let (outer, inner) = (7.0, 2.0);
        let area: f64 = (0..70_000)
            .map(|i| (f64::from(i) + 0.5) * 1e-4)
            .map(|r| std::f64::consts::TAU * r * overlap(r, outer, inner) * 1e-4)
            .sum();
        assert!((area / (std::f64::consts::PI * 4.5 * 4.5) - 1.0).abs() < 1e-6);
    }

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

    /// Against sums over points of the disc; both are to second order in angles of 0.2.
    #[test]
    fn oblique_light() {
        let obliquity = Obliquity {
            chief: Vector2::new(0.1, -0.05),
            inverse_distance: 1.0 / 60.0,
            lens_px: 11.5,
        };
        let pixel = Vector2::new(4.0, 3.0);
        let (mut light, mut first, mut count) = (0.0, Vector2::zeros(), 0.0);
        for (i, j) in (-100..=100).flat_map(|i| (-100..=100).map(move |j| (i, j))) {
            let w = Vector2::new(f64::from(i), f64::from(j)) / 100.0;
            if w.norm() < 1.0 {
                let angle =
                    obliquity.chief + (pixel - w * obliquity.lens_px) * obliquity.inverse_distance;
                let weight = angle.norm().atan().cos().powi(4);
                light += weight;
                first += w * weight;
                count += 1.0;
            }
        }
        let shift = obliquity.shift(&pixel, &Matrix2::identity());
        assert!((shift - first / light).norm() < 0.1 * shift.norm(), "{shift} {}", first / light);
        let seen = obliquity.light(&pixel, 1.0, 1.0);
        assert!((seen - light / count).abs() < 4e-3, "{seen} for {}", light / count);
    }
}
