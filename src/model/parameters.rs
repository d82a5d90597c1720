//! The intrinsic parameters: one table with their names, units and places in a camera.
//!
//! The core has its own table (`for_each_parameter` in `plenocal/camera.hpp`); a test sends values
//! across and compares them name by name.

use super::camera::PlenopticCamera;

/// An intrinsic parameter.
#[derive(Debug, Clone, Copy)]
pub struct Parameter {
    /// The paper's symbol as it is written in options, tables and files.
    pub name: &'static str,
    /// Unit of its value.
    pub unit: &'static str,
    get: fn(&PlenopticCamera) -> f64,
    set: fn(&mut PlenopticCamera, f64),
}

impl Parameter {
    /// The value in a camera.
    ///
    /// # Panics
    /// If it is the focal length of a lens type that the camera does not have.
    #[must_use]
    pub fn value(&self, camera: &PlenopticCamera) -> f64 {
        (self.get)(camera)
    }

    /// Changes the value in a camera.
    ///
    /// # Panics
    /// Like [`Parameter::value`].
    pub fn set(&self, camera: &mut PlenopticCamera, value: f64) {
        (self.set)(camera, value);
    }
}

macro_rules! parameters {
    ($($name:literal [$unit:literal] $($place:ident).+ $([$index:literal])?;)*) => {
        [$(Parameter {
            name: $name,
            unit: $unit,
            get: |camera| camera.$($place).+ $([$index])?,
            set: |camera, value| camera.$($place).+ $([$index])? = value,
        }),*]
    };
}

/// Number of parameters of a camera without lens types.
const WITHOUT_FOCAL_LENGTHS: usize = 22;
/// The largest number of lens types.
pub const MAX_LENS_TYPES: usize = 3;

static PARAMETERS: [Parameter; WITHOUT_FOCAL_LENGTHS + MAX_LENS_TYPES] = parameters![
    "F" ["mm"] main_lens.focal_length_mm;
    "Q1" ["mm^-2"] main_lens.radial[0];
    "Q2" ["mm^-4"] main_lens.radial[1];
    "Q3" ["mm^-6"] main_lens.radial[2];
    "P1" ["mm^-1"] main_lens.tangential[0];
    "P2" ["mm^-1"] main_lens.tangential[1];
    "kappa" ["mm^-1"] main_lens.field_curvature_per_mm;
    "kappa_m" ["mm^-1"] main_lens.field_curvature_growth_per_mm;
    "e_x" ["mm"] main_lens.exit_pupil_mm[0];
    "e_y" ["mm"] main_lens.exit_pupil_mm[1];
    "e_z" ["mm"] main_lens.exit_pupil_mm[2];
    "u0" ["px"] mla.principal_point_px[0];
    "v0" ["px"] mla.principal_point_px[1];
    "d" ["mm"] mla.mla_to_sensor_mm;
    "theta_x" ["rad"] mla.rotation_rad[0];
    "theta_y" ["rad"] mla.rotation_rad[1];
    "theta_z" ["rad"] mla.rotation_rad[2];
    "t_x" ["mm"] mla.offset_mm[0];
    "t_y" ["mm"] mla.offset_mm[1];
    "D" ["mm"] mla.lens_to_mla_mm;
    "dC" ["mm"] mla.pitch_mm;
    "dC_ratio" ["1"] mla.pitch_ratio;
    "f_1" ["mm"] mla.focal_lengths_mm[0];
    "f_2" ["mm"] mla.focal_lengths_mm[1];
    "f_3" ["mm"] mla.focal_lengths_mm[2];
];

/// The intrinsic parameters of a camera with this many lens types, in the order of
/// [`PlenopticCamera::intrinsics`].
///
/// # Panics
/// With more than [`MAX_LENS_TYPES`], which no valid camera has.
#[must_use]
pub fn intrinsic_parameters(lens_types: usize) -> &'static [Parameter] {
    &PARAMETERS[..WITHOUT_FOCAL_LENGTHS + lens_types]
}
