//! Checks of the values of a camera.

use std::f64::consts::{FRAC_PI_2, TAU};

use super::camera::PlenopticCamera;
use super::checks::positive;
use super::lattice::{check_array_size, check_lens_types};
use super::parameters::Parameter;
use crate::error::{Error, Result};

/// Largest value of a camera in any unit; its reciprocal is the smallest positive one.
const LARGEST: f64 = 1e100;

impl PlenopticCamera {
    /// Checks all values; an error names an impossible one.
    pub fn validate(&self) -> Result<()> {
        self.sensor.validate()?;
        self.edge_spread.validate()?;
        check_array_size(self.lattice.columns, self.lattice.rows)?;
        check_lens_types(self.lens_types(), self.lattice.kind())?;
        if let Some(setting) = self.main_lens.setting {
            positive(setting.f_number, "the f-number of the main lens (f_number)")?;
            if setting.focus_distance_mm.is_nan() || setting.focus_distance_mm <= 0.0 {
                return Err(Error::invalid(format!(
                    "the focus distance of the main lens is {} mm, but has to be positive, or inf",
                    setting.focus_distance_mm
                )));
            }
        }
        for (&parameter, value) in
            Parameter::intrinsic(self.lens_types()).iter().zip(self.intrinsics())
        {
            let unit = if parameter.unit() == "mm" { " (mm)" } else { "" };
            if parameter.is_positive() {
                positive(value, &format!("the camera's {parameter}{unit}"))?;
            }
            // Squares of values far beyond these overflow, or are 0.
            let is_tiny = parameter.is_positive() && value < 1.0 / LARGEST;
            if !value.is_finite() || value.abs() > LARGEST || is_tiny {
                return Err(Error::invalid(format!(
                    "the camera's {parameter}{unit} is {value}, which is outside the range of \
                     cameras: correct it, or calibrate again"
                )));
            }
        }
        if self.mla.rotation_rad.amax() > TAU {
            return Err(Error::invalid(format!(
                "the array is rotated by ({}, {}, {}) rad (rotation_rad), more than a whole turn: \
                 give radians instead of degrees",
                self.mla.rotation_rad.x, self.mla.rotation_rad.y, self.mla.rotation_rad.z
            )));
        }
        let [x, y] = self.main_lens.rotation_rad;
        if x.abs().max(y.abs()) >= FRAC_PI_2 {
            return Err(Error::invalid(format!(
                "the main lens is rotated by ({x}, {y}) rad (rotation_rad), but its axis has to meet \
                 the sensor: give radians instead of degrees"
            )));
        }
        positive(
            self.pupil_to_mla_mm(),
            "the camera's distance D + e_z from exit pupil to array \
                                          (mm)",
        )?;
        positive(self.main_lens.pupil_magnification(), "the camera's pupil magnification 1 + e_z/F")
    }
}
