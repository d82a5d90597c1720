//! What the pre-calibration is given: white images, and what is stated of the camera.

use super::radii::RadiusEstimator;
use crate::image::RawImage;
use crate::model::{Configuration, Datasheet, optics};

/// A white image.
#[derive(Debug, Clone, PartialEq)]
pub struct White {
    /// What messages call it.
    pub name: String,
    /// F-number N, as it is: √(2^AV).
    pub f_number: f64,
    /// The image as the camera delivered it, linear in light.
    pub image: RawImage,
}

/// Options of the pre-calibration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PrecalibrationOptions {
    /// Edge of a pixel s, mm.
    pub pixel_size_mm: f64,
    /// Whether f < d (Keplerian) or f > d (Galilean), which gives the radii their sign.
    pub configuration: Configuration,
    /// Number of columns and rows of micro-lenses, where it is stated.
    pub array_size: Option<(i32, i32)>,
    /// How radii are measured.
    pub estimator: RadiusEstimator,
    /// Focal length F and focus distance h of the main lens as engraved, mm: they give its distance from
    /// the array, and so the angles of the light.
    pub lens_mm: (f64, f64),
    /// Black level of the images, grey levels of the files; measured if it is not stated.
    pub black_level: Option<f64>,
    /// The whole datasheet, where there is one: what the images contradict in it is an error.
    pub stated: Option<Datasheet>,
}

impl PrecalibrationOptions {
    /// Options for a camera by its data sheet.
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

    /// D + d and d for a slope m of the radii, with the pupil in the lens, px.
    pub(super) fn distances_px(&self, m_mm: f64) -> (f64, f64) {
        let (focal_length, focus_distance) = self.lens_mm;
        let (lens_to_mla, mla_to_sensor) =
            optics::initial_distances(focal_length, focus_distance, m_mm, self.configuration, 0.0);
        ((lens_to_mla + mla_to_sensor) / self.pixel_size_mm, mla_to_sensor / self.pixel_size_mm)
    }
}
