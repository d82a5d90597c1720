//! Gaussian noise on observations.

use rand::SeedableRng;
use rand::rngs::StdRng;
use rand_distr::{Distribution, Normal};
use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};
use crate::model::{BapFeature, MicroImageCenter};

/// Standard deviations of the noise per coordinate, px; 0 for none.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Noise {
    /// Noise of u and v of a feature.
    pub uv_px: f64,
    /// Noise of ρ.
    pub rho_px: f64,
    /// Noise of u and v of a centre.
    pub centers_px: f64,
}

impl Default for Noise {
    /// Returns the noise of a good detector; the radius comes from a whole cluster and is therefore better.
    fn default() -> Self {
        Self { uv_px: 0.2, rho_px: 0.05, centers_px: 0.1 }
    }
}

/// Source of noise for one observation after the other; the same seed gives the same noise.
#[derive(Debug)]
pub struct NoiseSource {
    generator: StdRng,
    uv: Normal<f64>,
    rho: Normal<f64>,
    centers: Normal<f64>,
}

/// Largest noise, px: more hides everything, and much more makes infinite numbers.
const MOST_NOISE_PX: f64 = 1e4;

impl Noise {
    /// Returns an error if a standard deviation is negative, not finite, or wider than any image.
    pub fn validate(&self) -> Result<()> {
        let Self { uv_px, rho_px, centers_px } = *self;
        match [uv_px, rho_px, centers_px].iter().find(|s| !(0.0..=MOST_NOISE_PX).contains(*s)) {
            Some(std_dev) => Err(Error::invalid(format!(
                "a noise of {std_dev} px is not possible: give 0 to {MOST_NOISE_PX}"
            ))),
            None => Ok(()),
        }
    }
}

impl NoiseSource {
    /// Creates a source of noise; an error if [`Noise::validate`] returns one.
    pub fn new(noise: &Noise, seed: u64) -> Result<Self> {
        noise.validate()?;
        let normal = |std_dev: f64| {
            Normal::new(0.0, std_dev).map_err(|e| {
                Error::invalid(format!("a noise of {std_dev} px is not possible: {e}"))
            })
        };
        Ok(Self {
            generator: StdRng::seed_from_u64(seed),
            uv: normal(noise.uv_px)?,
            rho: normal(noise.rho_px)?,
            centers: normal(noise.centers_px)?,
        })
    }

    /// Returns a feature with noise.
    pub fn feature(&mut self, feature: &BapFeature) -> BapFeature {
        let random = &mut self.generator;
        BapFeature {
            u_px: feature.u_px + self.uv.sample(random),
            v_px: feature.v_px + self.uv.sample(random),
            rho_px: feature.rho_px.map(|rho_px| rho_px + self.rho.sample(random)),
            ..*feature
        }
    }

    /// Returns a centre with noise.
    pub fn center(&mut self, center: &MicroImageCenter) -> MicroImageCenter {
        let random = &mut self.generator;
        MicroImageCenter {
            u_px: center.u_px + self.centers.sample(random),
            v_px: center.v_px + self.centers.sample(random),
            ..*center
        }
    }
}
