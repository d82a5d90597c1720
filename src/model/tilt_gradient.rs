//! Tilt of the micro-lens array with respect to the sensor.

use nalgebra::Vector2;
use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};
use crate::quantity::Estimate;

/// Tilt gradient ∇ ln d of the array, measured on white images alone: the relative growth of the distance between array and
/// sensor along u and v. It is θ_y and −θ_x over d, to first order and with d in pixels.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TiltGradient {
    /// Tilt gradient ∇ ln d, px⁻¹.
    pub growth_per_px: [f64; 2],
    /// σ of both components, px⁻¹.
    pub std_dev_per_px: [f64; 2],
    /// Part of σ due to errors shared by both components, px⁻¹, with its signs: the model of the discs, and the law of the
    /// angular response.
    #[serde(default)]
    pub shared_per_px: [f64; 2],
    /// Derivative of both by ln φ, px⁻¹: white images show the growth of the blur discs, the tilt gradient times φq'ᵢ, but of
    /// φq'ᵢ itself only φqᵢ.
    #[serde(default, alias = "by_fill_factor_per_px")]
    pub by_aperture_ratio_per_px: [f64; 2],
    /// Coefficient of (ln φ)² of both, px⁻¹.
    #[serde(default, alias = "by_fill_factor_squared_per_px")]
    pub by_aperture_ratio_squared_per_px: [f64; 2],
}

/// σ of the ratio of D + d to the distance from exit pupil to sensor: 1 with the pupil in the lens, 0 for a lens that is
/// telecentric on the image side.
const PUPIL: f64 = 0.5;
/// Number of σ by which a growth of the discs exceeds noise.
const SURE: f64 = 2.0;
/// Least σ of a growth of d, used if the growth is nearly 0, px⁻¹.
const LEAST_GROWTH: f64 = 1e-7;
/// Rounds of the ratio of distances, whose weights depend on it, and its least value.
const ROUNDS: usize = 4;
const LEAST_RATIO: f64 = 0.1;

/// Estimates ∇ ln d, px⁻¹, before a calibration, from the discs of white images and from the perspective of the centres,
/// t = ∇d/(D + e_z + d). The latter is as uncertain as the distance of the exit pupil from the sensor; `lens_to_sensor` is (D +
/// d)/d.
#[must_use]
pub(crate) fn growth_per_px(
    tilt_gradient: Option<&TiltGradient>,
    perspective_per_px: &Vector2<f64>,
    lens_to_sensor: f64,
) -> Vector2<f64> {
    let by_perspective = perspective_per_px * lens_to_sensor;
    let Some(measured) = tilt_gradient else { return by_perspective };
    Vector2::from_fn(|i, _| {
        let (by_discs, by_perspective) = (measured.growth_per_px[i], by_perspective[i]);
        // The perspective of a telecentric lens is 0 at any tilt, so the larger estimate states the scale, beyond noise.
        let sure = by_discs.abs() - SURE * measured.std_dev_per_px[i];
        let std_dev = (PUPIL * by_perspective.abs().max(sure)).max(LEAST_GROWTH);
        let weights = (measured.std_dev_per_px[i].powi(-2), std_dev.powi(-2));
        (by_discs * weights.0 + by_perspective * weights.1) / (weights.0 + weights.1)
    })
}

/// Estimates (D + d)/(D + e_z + d), the ratio of the distances of main lens and exit pupil from the sensor, from the growth of
/// the discs and the perspective of the centres, of which this is the quotient. Without tilt it is 1 ± 0.5: the pupil may be
/// in the lens or, of a telecentric lens, at infinity.
#[must_use]
pub(crate) fn lens_over_pupil(
    tilt_gradient: Option<&TiltGradient>,
    perspective_per_px: &Vector2<f64>,
    lens_to_sensor: f64,
) -> Estimate {
    let mut found = Estimate::new(1.0, PUPIL);
    let Some(measured) = tilt_gradient.filter(|_| perspective_per_px.norm() > 0.0) else {
        return found;
    };
    for _ in 0..ROUNDS {
        let mut information = PUPIL.powi(-2);
        let mut sum = information;
        for (i, growth) in measured.growth_per_px.iter().enumerate() {
            let weight = (found.value * measured.std_dev_per_px[i]).powi(-2);
            information += weight * growth * growth;
            sum += weight * growth * perspective_per_px[i] * lens_to_sensor;
        }
        found = Estimate::new((sum / information).max(LEAST_RATIO), information.powf(-0.5));
    }
    found
}

impl TiltGradient {
    /// Returns an error that names an impossible value.
    pub(crate) fn validate(&self) -> Result<()> {
        let possible = |std_dev: &f64| std_dev.is_finite() && *std_dev > 0.0;
        if let Some(growth) = self.growth_per_px.iter().find(|x| !x.is_finite()) {
            return Err(Error::invalid(format!(
                "growth_per_px of the tilt gradient of the array is {growth}, but has to be finite"
            )));
        }
        if let Some(std_dev) = self.std_dev_per_px.iter().find(|s| !possible(s)) {
            return Err(Error::invalid(format!(
                "std_dev_per_px of the tilt gradient of the array is {std_dev}, but has to be \
                 above 0"
            )));
        }
        let within =
            |(shared, std_dev): &(&f64, &f64)| shared.is_finite() && shared.abs() <= **std_dev;
        let mut parts = self.shared_per_px.iter().zip(&self.std_dev_per_px);
        match parts.find(|part| !within(part)) {
            Some((shared, _)) => Err(Error::invalid(format!(
                "shared_per_px of the tilt gradient of the array is {shared}, but must not exceed \
                 std_dev_per_px"
            ))),
            None => Ok(()),
        }
    }

    /// Returns the tilt gradient from the same white images with another aperture ratio; `change` is the change of ln φ.
    #[must_use]
    pub fn with_aperture_ratio(&self, change: f64) -> Self {
        let by_square = self.by_aperture_ratio_squared_per_px.map(|by| by * change);
        let by = [0, 1].map(|i| self.by_aperture_ratio_per_px[i] + by_square[i]);
        Self {
            growth_per_px: [0, 1].map(|i| self.growth_per_px[i] + by[i] * change),
            by_aperture_ratio_per_px: [0, 1].map(|i| by[i] + by_square[i]),
            ..*self
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tilt_and_perspective_locate_the_exit_pupil() {
        let tilt_gradient = |std_dev: f64| TiltGradient {
            growth_per_px: [1e-5, -2e-5],
            std_dev_per_px: [std_dev; 2],
            shared_per_px: [0.0; 2],
            by_aperture_ratio_per_px: [0.0; 2],
            by_aperture_ratio_squared_per_px: [0.0; 2],
        };
        // The perspective is the growth of d over the distance from pupil to sensor, which is 400 d for a lens at 200 d.
        let perspective = Vector2::new(1e-5, -2e-5) / 400.0;
        let known = lens_over_pupil(Some(&tilt_gradient(2e-7)), &perspective, 200.0);
        assert!((known.value - 0.5).abs() < 0.003 && known.std_dev < 0.006, "{known:?}");
        let vague = lens_over_pupil(Some(&tilt_gradient(1e-4)), &perspective, 200.0);
        let nothing = lens_over_pupil(Some(&tilt_gradient(2e-7)), &Vector2::zeros(), 200.0);
        assert!((0.9..=1.0).contains(&vague.value) && vague.std_dev > 0.45, "{vague:?}");
        assert_eq!(nothing, Estimate::new(1.0, PUPIL));
    }

    #[test]
    fn the_tilt_through_a_telecentric_lens_is_that_of_the_discs() {
        let measured = TiltGradient {
            growth_per_px: [1e-5, -2e-5],
            std_dev_per_px: [4e-7; 2],
            shared_per_px: [0.0; 2],
            by_aperture_ratio_per_px: [0.0; 2],
            by_aperture_ratio_squared_per_px: [0.0; 2],
        };
        // The distance from pupil to sensor is D + d, four times this, and infinite.
        for (vergence, tolerance) in [(1.0, 1e-12), (0.25, 0.008), (0.0, 0.012)] {
            let perspective = Vector2::new(1e-5, -2e-5) * vergence / 60.0;
            let growth = growth_per_px(Some(&measured), &perspective, 60.0);
            for (found, truth) in growth.iter().zip([1e-5, -2e-5]) {
                assert!((found / truth - 1.0).abs() < tolerance, "{vergence}: {growth}");
            }
        }
        // Discs of 2 σ may be noise.
        let noisy = TiltGradient { std_dev_per_px: [5e-6, 1e-5], ..measured };
        let growth = growth_per_px(Some(&noisy), &Vector2::zeros(), 60.0);
        assert!(growth.norm() < 1e-7, "{growth}");
        // Poor white images leave the tilt to the perspective.
        let poor = TiltGradient { std_dev_per_px: [1e-4; 2], ..measured };
        let growth = growth_per_px(Some(&poor), &Vector2::new(2e-7, -4e-7), 60.0);
        assert!((growth.x / 1.2e-5 - 1.0).abs() < 0.01, "{growth}");
    }
}
