//! Samples of pixels without light and of saturated pixels.

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};

/// Levels of a camera between which samples are linear in light, in grey levels of its files.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SampleLevels {
    /// Bits of a sample in these files, 8 or 16. In files with another number, the levels are the same fractions of full scale.
    pub bits: u32,
    /// Black level: the mean sample of a pixel without light; 0 if it is not known.
    pub black_level: f64,
    /// σ of the black level, if measured.
    pub black_level_std_dev: Option<f64>,
    /// Saturation level: pixels with at least this sample are saturated. `None` if it is full scale.
    pub saturation_level: Option<f64>,
}

/// Returns the largest sample of `bits` bits.
pub(crate) fn full_scale(bits: u32) -> f64 {
    f64::from(bits).exp2() - 1.0
}

impl SampleLevels {
    /// Creates levels from 0 to full scale.
    #[must_use]
    pub fn full_range(bits: u32) -> Self {
        Self { bits, black_level: 0.0, black_level_std_dev: None, saturation_level: None }
    }

    /// Returns the black level and, if below full scale, the saturation level as fractions of full scale.
    #[must_use]
    pub fn parts(&self) -> (f64, Option<f64>) {
        let full = full_scale(self.bits);
        (self.black_level / full, self.saturation_level.map(|level| level / full))
    }

    /// Checks all values; an error names an impossible one.
    pub(crate) fn validate(&self) -> Result<()> {
        if self.bits != 8 && self.bits != 16 {
            return Err(Error::invalid(format!(
                "levels of files with {} bits are not supported: files have 8 or 16 bits",
                self.bits
            )));
        }
        let largest = self.saturation_level.unwrap_or_else(|| full_scale(self.bits));
        if !(largest > 0.0 && largest <= full_scale(self.bits)) {
            return Err(Error::invalid(format!(
                "a saturation level of {largest} is not possible in files with {} bits",
                self.bits
            )));
        }
        if !(0.0..largest).contains(&self.black_level) {
            return Err(Error::invalid(format!(
                "a black level of {} grey levels is not possible in files with {} bits and \
                 saturation at {largest}: give the mean sample of an image without light",
                self.black_level, self.bits
            )));
        }
        Ok(())
    }
}
