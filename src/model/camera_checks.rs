//! Whether a camera is possible.

use super::camera::PlenopticCamera;
use super::checks::positive;
use super::lattice::{check_array_size, check_lens_types};
use super::parameters::Parameter;
use crate::error::{Error, Result};

impl PlenopticCamera {
    /// Checks all values; an error names the one that is not possible.
    pub fn validate(&self) -> Result<()> {
        self.sensor.validate()?;
        self.edge_spread.validate()?;
        check_array_size(self.lattice.columns, self.lattice.rows)?;
        check_lens_types(self.lens_types(), self.lattice.kind())?;
        if let Some(setting) = self.main_lens.setting {
            positive(setting.f_number, "the f-number of the main lens")?;
            if setting.focus_distance_mm.is_nan() || setting.focus_distance_mm <= 0.0 {
                return Err(Error::invalid(format!(
                    "the focus distance of the main lens (mm) is {}: it has to be positive, or inf",
                    setting.focus_distance_mm
                )));
            }
        }
        let mla = &self.mla;
        positive(self.main_lens.focal_length_mm, "the camera's F (mm)")?;
        positive(mla.lens_to_mla_mm, "the camera's D (mm)")?;
        positive(self.pupil_to_mla_mm(), "the camera's D + e_z, exit pupil to array (mm),")?;
        positive(
            self.main_lens.pupil_magnification(),
            "the camera's 1 + e_z/F, the magnification of its pupil,",
        )?;
        positive(mla.mla_to_sensor_mm, "the camera's d (mm)")?;
        positive(mla.pitch_mm, "the camera's dC (mm)")?;
        positive(mla.pitch_ratio, "the camera's dC_ratio")?;
        for (i, &f) in mla.focal_lengths_mm.iter().enumerate() {
            positive(f, &format!("the camera's f_{} (mm)", i + 1))?;
        }
        for (parameter, value) in
            Parameter::intrinsic(self.lens_types()).iter().zip(self.intrinsics())
        {
            // Squares of values far beyond this overflow.
            if !value.is_finite() || value.abs() > 1e100 {
                return Err(Error::invalid(format!(
                    "the camera's {} is {value}",
                    parameter.name()
                )));
            }
        }
        Ok(())
    }
}
