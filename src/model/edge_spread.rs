//! What makes edges less sharp, or blur smaller, than ideal pixels and micro-lenses would.

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};

/// The point spread of micro-lenses and sensor: diffraction, aberrations, light and charge that leave their pixel. It is
/// taken to be normal, the same in all directions and everywhere.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PointSpread {
    /// Its variance along an axis, px².
    pub variance_px2: f64,
    /// σ of that, px².
    pub std_dev_px2: f64,
}

/// The part of the distance between micro-lenses that the diameter of their openings takes. What is left is opaque: blur
/// and micro-images are smaller. Hexagonal openings without gaps have the area of circles with 1.05.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FillFactor {
    /// The fill factor.
    pub value: f64,
    /// Its σ.
    pub std_dev: f64,
}

/// What the widths of a camera's edges say: what depth from blur needs beside the geometry. The projection of points does
/// not depend on it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct EdgeSpread {
    /// The fill factor; `None` where it is not known.
    pub fill_factor: Option<FillFactor>,
    /// The point spread; `None` where it is not known.
    pub point_spread: Option<PointSpread>,
}

/// Point spreads beyond this hide all micro-images, px².
const MOST_PX2: f64 = 100.0;
/// Fill factors that openings can have.
const FILL_FACTORS: std::ops::RangeInclusive<f64> = 0.01..=1.3;

impl PointSpread {
    /// Its standard deviation along an axis with σ, px.
    #[must_use]
    pub fn px(&self) -> [f64; 2] {
        let px = self.variance_px2.max(0.0).sqrt();
        // Of a root; where it is 0 to the order of σ, the σ of the variance says how large it may be.
        let largest = (self.variance_px2.max(0.0) + self.std_dev_px2).sqrt();
        [px, largest - px]
    }

    /// An error that names a value that no camera has.
    pub(crate) fn validate(&self) -> Result<()> {
        if !(0.0..=MOST_PX2).contains(&self.variance_px2) {
            return Err(Error::invalid(format!(
                "variance_px2 of the point spread is {}: it has to be from 0 to {MOST_PX2}",
                self.variance_px2
            )));
        }
        std_dev("std_dev_px2 of the point spread", self.std_dev_px2)
    }
}

impl EdgeSpread {
    /// An error that names a value that no camera has.
    pub(crate) fn validate(&self) -> Result<()> {
        self.fill_factor.map_or(Ok(()), |fill| fill.validate())?;
        self.point_spread.map_or(Ok(()), |spread| spread.validate())
    }
}

impl FillFactor {
    /// Openings as wide as the distance between micro-lenses, which is not questioned.
    pub const FULL: Self = Self { value: 1.0, std_dev: 0.0 };

    /// How well the model of a blurred corner tells the fill factor, relative: the σ of what is found from corners is not
    /// less.
    pub const MODEL: f64 = 3e-3;

    /// The standard deviation of blurred light along an axis over the blur radius ρ of full openings, φ/2, with its σ:
    /// that of a uniform disc is half its radius.
    #[must_use]
    pub fn spread_per_radius(&self) -> [f64; 2] {
        [self.value / 2.0, self.std_dev / 2.0]
    }

    /// That which a camera is taken to have: openings end where their neighbours begin, so it is 1 if more was measured.
    #[must_use]
    pub fn taken(&self) -> Self {
        Self { value: self.value.min(1.0), ..*self }
    }

    /// An error that names a value that no camera has.
    pub(crate) fn validate(&self) -> Result<()> {
        if !FILL_FACTORS.contains(&self.value) {
            return Err(Error::invalid(format!(
                "a fill factor of {} is not possible: it has to be from {} to {}",
                self.value,
                FILL_FACTORS.start(),
                FILL_FACTORS.end()
            )));
        }
        std_dev("std_dev of the fill factor", self.std_dev)
    }
}

fn std_dev(what: &str, value: f64) -> Result<()> {
    if value.is_finite() && value >= 0.0 {
        return Ok(());
    }
    Err(Error::invalid(format!("{what} is {value}: it has to be 0 or more")))
}
