//! How the micro-lens array leans against the sensor.

use nalgebra::Vector2;
use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};

/// The lean of the array as white images show it by themselves: ∇ ln d, the relative growth of the distance
/// between array and sensor along u and v. It is θ_y and −θ_x over d, to first order and with d in pixels.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Lean {
    /// ∇ ln d, px⁻¹.
    pub growth_per_px: [f64; 2],
    /// σ of both, px⁻¹.
    pub std_dev_per_px: [f64; 2],
}

impl Lean {
    /// An error that names a value that no camera has.
    pub(crate) fn validate(&self) -> Result<()> {
        let possible = |std_dev: &f64| std_dev.is_finite() && *std_dev > 0.0;
        if let Some(growth) = self.growth_per_px.iter().find(|x| !x.is_finite()) {
            return Err(Error::invalid(format!(
                "growth_per_px of the lean of the array is {growth}"
            )));
        }
        match self.std_dev_per_px.iter().find(|s| !possible(s)) {
            Some(std_dev) => Err(Error::invalid(format!(
                "std_dev_per_px of the lean of the array is {std_dev}: it has to be above 0"
            ))),
            None => Ok(()),
        }
    }

    /// The mean of this lean and another estimate of ∇ ln d with its σ, each by its weight.
    #[must_use]
    pub fn with(&self, other: &Vector2<f64>, std_dev: &Vector2<f64>) -> Vector2<f64> {
        Vector2::from_fn(|i, _| {
            let (own, others) = (self.std_dev_per_px[i].powi(-2), std_dev[i].powi(-2));
            (self.growth_per_px[i] * own + other[i] * others) / (own + others)
        })
    }
}
