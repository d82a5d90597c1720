//! Image sensor.

use std::fmt;

use nalgebra::Vector2;
use serde::{Deserialize, Serialize};

use super::checks::positive;
use crate::error::{Error, Result};

/// Limits of the pixel size, mm: half the wavelength of light, and the largest pixels of image sensors.
const SMALLEST_PIXEL_MM: f64 = 2e-4;
const LARGEST_PIXEL_MM: f64 = 0.2;

/// Largest number of pixels: no image sensor has more, and the results for each of them fit into memory.
pub(crate) const MOST_PIXELS: u64 = 1 << 28;

/// Image sensor.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sensor {
    /// Width, px.
    pub width_px: u32,
    /// Height, px.
    pub height_px: u32,
    /// Edge of a pixel s, mm.
    pub pixel_size_mm: f64,
}

/// Standard deviation of the distance of the optical axis from the middle of the sensor due to the mount, mm.
const MOUNT_MM: f64 = 0.5;

impl fmt::Display for Sensor {
    /// Formats the sensor, such as `1000 x 750 px of 0.0055 mm`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} x {} px of {} mm", self.width_px, self.height_px, self.pixel_size_mm)
    }
}

impl Sensor {
    /// Returns the number of pixels.
    #[must_use]
    pub fn pixels(&self) -> u64 {
        u64::from(self.width_px) * u64::from(self.height_px)
    }

    /// Returns the middle of the image, px; pixel (0, 0) is the centre of the top-left pixel.
    #[must_use]
    pub fn center_px(&self) -> Vector2<f64> {
        Vector2::new(f64::from(self.width_px) - 1.0, f64::from(self.height_px) - 1.0) / 2.0
    }

    /// Returns the standard deviation of the distance of the optical axis from the middle of the image, due to the mount of
    /// the lens, along u and along v, px.
    pub(crate) fn mount_px(&self) -> f64 {
        MOUNT_MM / self.pixel_size_mm
    }

    /// Returns true if a position lies between the centres of the outermost pixels.
    #[must_use]
    pub fn contains(&self, u_px: f64, v_px: f64) -> bool {
        (0.0..=f64::from(self.width_px) - 1.0).contains(&u_px)
            && (0.0..=f64::from(self.height_px) - 1.0).contains(&v_px)
    }

    /// Returns an error unless the sensor has pixels of a possible size.
    pub(crate) fn validate(&self) -> Result<()> {
        if self.width_px == 0 || self.height_px == 0 {
            return Err(Error::invalid(format!(
                "a sensor of {} x {} pixels has no area: give width_px and height_px of the images",
                self.width_px, self.height_px
            )));
        }
        let pixels = self.pixels();
        if pixels > MOST_PIXELS {
            return Err(Error::invalid(format!(
                "a sensor of {} x {} pixels has {pixels} pixels, but the limit is {MOST_PIXELS}: \
                 give width_px and height_px of the images",
                self.width_px, self.height_px
            )));
        }
        positive(self.pixel_size_mm, "the pixel size (pixel_size_mm)")?;
        if (SMALLEST_PIXEL_MM..=LARGEST_PIXEL_MM).contains(&self.pixel_size_mm) {
            return Ok(());
        }
        Err(Error::invalid(format!(
            "a pixel size of {} mm is not possible: pixel_size_mm is the distance between \
             neighbouring pixels in mm, 0.0055 for 5.5 µm",
            self.pixel_size_mm
        )))
    }

    /// Returns half the diagonal, mm.
    pub(crate) fn half_diagonal_mm(&self) -> f64 {
        f64::from(self.width_px).hypot(f64::from(self.height_px)) / 2.0 * self.pixel_size_mm
    }
}
