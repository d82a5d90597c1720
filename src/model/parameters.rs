//! The parameters that all frames share: tables with their names, units and places in a camera and in the
//! shape of a board.
//!
//! The core has its own tables (`for_each_parameter` in `plenocal/camera.hpp`, `shared_names` in
//! `plenocal/board.hpp`); a test sends values across and compares them name by name.

use super::board::BoardShape;
use super::camera::PlenopticCamera;

/// A parameter of a camera, that is an intrinsic one, or of the shape of a board.
#[derive(Debug, Clone, Copy)]
pub struct Parameter<T: 'static = PlenopticCamera> {
    /// The paper's symbol as it is written in options, tables and files.
    pub name: &'static str,
    /// Unit of its value.
    pub unit: &'static str,
    get: fn(&T) -> f64,
    set: fn(&mut T, f64),
}

impl<T> Parameter<T> {
    /// The value in a camera or shape.
    ///
    /// # Panics
    /// If it is the focal length of a lens type that the camera does not have.
    #[must_use]
    pub fn value(&self, of: &T) -> f64 {
        (self.get)(of)
    }

    /// Changes the value in a camera or shape.
    ///
    /// # Panics
    /// Like [`Parameter::value`].
    pub fn set(&self, of: &mut T, value: f64) {
        (self.set)(of, value);
    }
}

macro_rules! parameters {
    ($($name:literal [$unit:literal] $($place:ident).+ $([$index:literal])?;)*) => {
        [$(Parameter {
            name: $name,
            unit: $unit,
            get: |of| of.$($place).+ $([$index])?,
            set: |of, value| of.$($place).+ $([$index])? = value,
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

/// Number of parameters of a board's shape.
pub const SHAPE: usize = 4;

/// The parameters of a board's shape.
pub static SHAPE_PARAMETERS: [Parameter<BoardShape>; SHAPE] = parameters![
    "sag_x" ["mm"] sag_x_mm;
    "sag_y" ["mm"] sag_y_mm;
    "twist" ["mm"] twist_mm;
    "aspect" ["1"] aspect;
];

/// Name and unit of a parameter.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Named {
    /// The name in options, tables and files.
    pub name: &'static str,
    /// Unit of its value.
    pub unit: &'static str,
}

impl<T> Parameter<T> {
    /// Name and unit of it.
    #[must_use]
    pub fn named(&self) -> Named {
        Named { name: self.name, unit: self.unit }
    }
}

/// All parameters that frames share: the intrinsic parameters of a camera with this many lens types, then those of
/// the board's shape.
///
/// # Panics
/// Like [`intrinsic_parameters`].
#[must_use]
pub fn shared_parameters(lens_types: usize) -> Vec<Named> {
    let of_shape = SHAPE_PARAMETERS.iter().map(Parameter::named);
    intrinsic_parameters(lens_types).iter().map(Parameter::named).chain(of_shape).collect()
}

impl PlenopticCamera {
    /// Values of all intrinsic parameters in the order and units of [`intrinsic_parameters`].
    #[must_use]
    pub fn intrinsics(&self) -> Vec<f64> {
        intrinsic_parameters(self.lens_types()).iter().map(|p| p.value(self)).collect()
    }

    /// This camera with other values of its intrinsic parameters.
    ///
    /// # Panics
    /// If the number of values is not that of [`PlenopticCamera::intrinsics`].
    #[must_use]
    pub fn with_intrinsics(&self, values: &[f64]) -> Self {
        let parameters = intrinsic_parameters(self.lens_types());
        assert_eq!(values.len(), parameters.len());
        let mut camera = self.clone();
        for (parameter, &value) in parameters.iter().zip(values) {
            parameter.set(&mut camera, value);
        }
        camera
    }
}
