//! How obliquely light reaches a micro-image, and the effect: natural vignetting, cos⁴.

use nalgebra::{Matrix2, Vector2};

/// The angles at which light reaches a micro-image.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Obliquity {
    /// Angle of the ray from the middle of the main lens to the centre of the micro-image, rad.
    pub chief: Vector2<f64>,
    /// 1/d, d being the distance from the array to the sensor, 1/px.
    pub inverse_distance: f64,
    /// Δc/2, half the micro-image pitch, px. It stands for the radius ΔC/2 of the micro-lens, which is
    /// smaller by the factor D/(D + d).
    pub half_pitch_px: f64,
}

/// Light falls off with this power of the cosine of its angle of incidence.
const FALL_OFF: f64 = 4.0;

impl Obliquity {
    /// How far the fall-off moves the centroid of the light that a pixel receives through a part of the
    /// micro-lens, in radii of the micro-lens: more oblique light counts for less. `from_lens` is the
    /// vector from the centroid of that part to the pixel, px; `spread` is its standard deviations in
    /// units of half a radius.
    ///
    /// To first order: cosⁿ of an angle θ is 1 − n θ²/2, and a weight with the gradient g moves the
    /// centroid of a part with covariance C by C g.
    pub(crate) fn shift(&self, from_lens: &Vector2<f64>, spread: &Matrix2<f64>) -> Vector2<f64> {
        let angle = self.chief + from_lens * self.inverse_distance;
        let gradient = angle * (FALL_OFF * self.half_pitch_px * self.inverse_distance);
        spread * (spread * gradient) / 4.0
    }

    /// Light through a part of the micro-lens over that at normal incidence. `from_lens` as above;
    /// `along` and `across` are the standard deviations in units of half a radius.
    pub(crate) fn light(&self, from_lens: &Vector2<f64>, along: f64, across: f64) -> f64 {
        let angle = self.chief + from_lens * self.inverse_distance;
        let extent = self.half_pitch_px * self.inverse_distance / 2.0;
        let square = angle.norm_squared() + extent.powi(2) * (along.powi(2) + across.powi(2));
        (1.0 + square).powf(-FALL_OFF / 2.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Against sums over points of the disc; both are to second order in angles of 0.2.
    #[test]
    fn oblique_light_agrees_with_sums() {
        let obliquity = Obliquity {
            chief: Vector2::new(0.1, -0.05),
            inverse_distance: 1.0 / 60.0,
            half_pitch_px: 11.5,
        };
        let pixel = Vector2::new(4.0, 3.0);
        let (mut light, mut first, mut count) = (0.0, Vector2::zeros(), 0.0);
        for (i, j) in (-100..=100).flat_map(|i| (-100..=100).map(move |j| (i, j))) {
            let w = Vector2::new(f64::from(i), f64::from(j)) / 100.0;
            if w.norm() < 1.0 {
                let angle = obliquity.chief
                    + (pixel - w * obliquity.half_pitch_px) * obliquity.inverse_distance;
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
