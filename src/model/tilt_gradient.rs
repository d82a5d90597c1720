//! How the micro-lens array is tilted against the sensor.

use nalgebra::Vector2;
use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};

/// The tilt gradient of the array as white images show it by themselves: ∇ ln d, the relative growth of the distance
/// between array and sensor along u and v. It is θ_y and −θ_x over d, to first order and with d in pixels.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TiltGradient {
    /// ∇ ln d, px⁻¹.
    pub growth_per_px: [f64; 2],
    /// σ of both, px⁻¹.
    pub std_dev_per_px: [f64; 2],
    /// What of σ is one and the same error along both, px⁻¹, with its signs: the model of the discs, and the law of the
    /// fall-off.
    #[serde(default)]
    pub shared_per_px: [f64; 2],
    /// How much both grow with ln φ, px⁻¹: white images show how the discs of blur grow, which is the tilt gradient times φq'ᵢ, and of
    /// that only φqᵢ.
    #[serde(default, alias = "by_fill_factor_per_px")]
    pub by_aperture_ratio_per_px: [f64; 2],
    /// How much both grow with (ln φ)², px⁻¹.
    #[serde(default, alias = "by_fill_factor_squared_per_px")]
    pub by_aperture_ratio_squared_per_px: [f64; 2],
}

/// σ of the distance of the exit pupil from the sensor before it is known, relative.
const PUPIL: f64 = 0.25;
/// σ of a growth of d that is nearly 0, px⁻¹.
const LEAST_GROWTH: f64 = 1e-7;

/// ∇ ln d, px⁻¹, as far as it is known before a calibration: by the discs of white images, and by the perspective of the centres, t =
/// ∇d/(D + e_z + d), which tells it as well as it is known how far the exit pupil is from the sensor;
/// `lens_to_sensor` is (D + d)/d.
#[must_use]
pub(crate) fn growth_per_px(
    tilt_gradient: Option<&TiltGradient>,
    perspective_per_px: &Vector2<f64>,
    lens_to_sensor: f64,
) -> Vector2<f64> {
    let by_perspective = perspective_per_px * lens_to_sensor;
    let std_dev = by_perspective.abs().map(|x| (x * PUPIL).max(LEAST_GROWTH));
    tilt_gradient
        .map_or(by_perspective, |tilt_gradient| tilt_gradient.with(&by_perspective, &std_dev))
}

impl TiltGradient {
    /// An error that names a value that no camera has.
    pub(crate) fn validate(&self) -> Result<()> {
        let possible = |std_dev: &f64| std_dev.is_finite() && *std_dev > 0.0;
        if let Some(growth) = self.growth_per_px.iter().find(|x| !x.is_finite()) {
            return Err(Error::invalid(format!(
                "growth_per_px of the tilt gradient of the array is {growth}"
            )));
        }
        if let Some(std_dev) = self.std_dev_per_px.iter().find(|s| !possible(s)) {
            return Err(Error::invalid(format!(
                "std_dev_per_px of the tilt gradient of the array is {std_dev}: it has to be above 0"
            )));
        }
        let within =
            |(shared, std_dev): &(&f64, &f64)| shared.is_finite() && shared.abs() <= **std_dev;
        let mut parts = self.shared_per_px.iter().zip(&self.std_dev_per_px);
        match parts.find(|part| !within(part)) {
            Some((shared, _)) => Err(Error::invalid(format!(
                "shared_per_px of the tilt gradient of the array is {shared}: it has to be within its σ"
            ))),
            None => Ok(()),
        }
    }

    /// The tilt gradient by the same white images with another aperture ratio; `change` is that of ln φ.
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

    /// The mean of this tilt gradient and another estimate of ∇ ln d with its σ, each by its weight.
    #[must_use]
    pub fn with(&self, other: &Vector2<f64>, std_dev: &Vector2<f64>) -> Vector2<f64> {
        Vector2::from_fn(|i, _| {
            let (own, others) = (self.std_dev_per_px[i].powi(-2), std_dev[i].powi(-2));
            (self.growth_per_px[i] * own + other[i] * others) / (own + others)
        })
    }
}
