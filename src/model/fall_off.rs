//! Angular response: fall-off of light with its angle, over the sensor and inside micro-images.

use nalgebra::Vector2;
use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};

/// Angular response measured on white images, for any law.
///
/// Light that passes the point M of a micro-lens and reaches the point y of its micro-image, both from their middles, changes
/// by exp(−g(c)·(y − M) − H |y − M|²/2), with the gradient g(c) = G (c − c₀) for the micro-image at c. A law cosⁿ of the angle
/// of incidence has G = n/d(D + e_z + d) and H = n/d²: light is more oblique further out on the sensor, and inside a
/// micro-image. It arrives at a right angle at c₀.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FallOff {
    /// Growth G of the gradient over the sensor, px⁻².
    pub growth_per_px2: f64,
    /// σ of G, px⁻²; 0 if the law is assumed.
    pub std_dev_per_px2: f64,
    /// Position c₀ with light at a right angle, px.
    pub middle_px: [f64; 2],
    /// Fall-off H inside a micro-image, px⁻².
    pub within_per_px2: f64,
    /// σ of H, px⁻²; 0 if H is assumed to be G (D + d)/d.
    pub within_std_dev_per_px2: f64,
}

/// Largest |H|, px⁻²: H of cos⁴ with an array only 10 px from the sensor.
const MOST_WITHIN: f64 = 0.04;

impl FallOff {
    /// Returns the cos⁴ law of an ideal sensor, for the distance d from array to sensor and D + e_z + d from pupil to sensor,
    /// px.
    #[must_use]
    pub fn cos4(mla_to_sensor_px: f64, pupil_to_sensor_px: f64, middle_px: Vector2<f64>) -> Self {
        Self {
            growth_per_px2: 4.0 / (mla_to_sensor_px * pupil_to_sensor_px),
            std_dev_per_px2: 0.0,
            middle_px: middle_px.into(),
            within_per_px2: 4.0 / mla_to_sensor_px.powi(2),
            within_std_dev_per_px2: 0.0,
        }
    }

    /// Returns an error that names an impossible value.
    pub(crate) fn validate(&self) -> Result<()> {
        let values = [
            ("growth_per_px2", self.growth_per_px2),
            ("std_dev_per_px2", self.std_dev_per_px2),
            ("middle_px", self.middle_px[0]),
            ("middle_px", self.middle_px[1]),
            ("within_per_px2", self.within_per_px2),
            ("within_std_dev_per_px2", self.within_std_dev_per_px2),
        ];
        match values.iter().find(|(_, value)| !value.is_finite()) {
            Some((name, value)) => Err(Error::invalid(format!(
                "{name} of the fall-off of light is {value}, but has to be finite"
            ))),
            None if self.within_per_px2.abs() > MOST_WITHIN => Err(Error::invalid(format!(
                "within_per_px2 of the fall-off of light is {}, but has to be within ±{MOST_WITHIN}: \
                 for cos⁴ it is about 0.001",
                self.within_per_px2
            ))),
            None => Ok(()),
        }
    }

    /// Returns the gradient g of the micro-image at a position, px⁻¹.
    #[must_use]
    pub fn gradient(&self, place_px: &Vector2<f64>) -> Vector2<f64> {
        (place_px - Vector2::from(self.middle_px)) * self.growth_per_px2
    }
}
