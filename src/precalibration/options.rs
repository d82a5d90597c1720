//! Input of the pre-calibration: white images, and the stated properties of the camera.

use super::radii::RadiusEstimator;
use crate::image::RawImage;
use crate::model::{Configuration, Datasheet, optics};

/// A white image.
#[derive(Debug, Clone, PartialEq)]
pub struct White {
    /// Name of the image in messages.
    pub name: String,
    /// F-number N, not rounded: √(2^AV).
    pub f_number: f64,
    /// Image as the camera delivered it, linear in light.
    pub image: RawImage,
}

/// Options of the pre-calibration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PrecalibrationOptions {
    /// Edge s of a pixel, mm.
    pub pixel_size_mm: f64,
    /// Configuration, f < d (Keplerian) or f > d (Galilean). It determines the sign of the radii.
    pub configuration: Configuration,
    /// Number of columns and rows of micro-lenses, if stated.
    pub array_size: Option<(i32, i32)>,
    /// Estimator of the radii.
    pub estimator: RadiusEstimator,
    /// Engraved focal length F and focus distance h of the main lens, mm. They give its distance from the array, and so
    /// the angles of the light.
    pub lens_mm: (f64, f64),
    /// Black level of the images, in grey levels of the files; measured if `None`.
    pub black_level: Option<f64>,
    /// Complete datasheet, if there is one. It is an error if the images contradict it.
    pub stated: Option<Datasheet>,
}

impl PrecalibrationOptions {
    /// Creates the options for a camera from its datasheet.
    #[must_use]
    pub fn of_datasheet(sheet: &Datasheet) -> Self {
        Self {
            pixel_size_mm: sheet.sensor.pixel_size_mm,
            configuration: sheet.configuration,
            array_size: sheet.array_size,
            estimator: RadiusEstimator::default(),
            lens_mm: (sheet.focal_length_mm, sheet.focus_distance_mm),
            black_level: None,
            stated: Some(*sheet),
        }
    }

    /// Computes D + d and d for a slope m of the radii, with the pupil in the lens, px.
    pub(super) fn distances_px(&self, m_mm: f64) -> (f64, f64) {
        let (focal_length, focus_distance) = self.lens_mm;
        let (lens_to_mla, mla_to_sensor) =
            optics::initial_distances(focal_length, focus_distance, m_mm, self.configuration, 0.0);
        ((lens_to_mla + mla_to_sensor) / self.pixel_size_mm, mla_to_sensor / self.pixel_size_mm)
    }
}
