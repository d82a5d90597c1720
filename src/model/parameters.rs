//! Parameters shared by all frames, from the table that C++ uses too: `cpp/include/plenocal/parameters.def`.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::board::BoardShape;
use super::camera::PlenopticCamera;
use crate::error::Error;

/// Row of the table.
struct Row {
    name: &'static str,
    unit: &'static str,
    key: &'static str,
    is_positive: bool,
    description: &'static str,
}

const POSITIVE: bool = true;
const FINITE: bool = false;

macro_rules! parameters {
    ($(($id:ident, $name:literal, $unit:literal, $key:literal, $bound:ident, $description:literal);)*) => {
        /// Parameter shared by all frames: an intrinsic one of the camera, or one of the shape of the board. Parameters have
        /// the order of the solver's parameter blocks.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub enum Parameter {
            $(#[doc = $description] $id,)*
        }

        impl Parameter {
            /// Intrinsic parameters of a camera of three lens types, then the parameters of the shape of a board.
            pub const ALL: [Self; [$($name),*].len()] = [$(Self::$id),*];

            const fn row(self) -> Row {
                match self {
                    $(Self::$id => Row {
                        name: $name,
                        unit: $unit,
                        key: $key,
                        is_positive: $bound,
                        description: $description,
                    },)*
                }
            }
        }
    };
}
include!(concat!(env!("OUT_DIR"), "/parameters.rs"));

/// Largest number of lens types.
pub const MAX_LENS_TYPES: usize =
    Parameter::FocalLengthOfType3 as usize - Parameter::FocalLengthOfType1 as usize + 1;
/// Number of intrinsic parameters of a camera of pinholes.
const PINHOLE: usize = Parameter::FocalLengthOfType1 as usize;
/// Number of parameters of a board's shape.
pub const SHAPE: usize = Parameter::ALL.len() - PINHOLE - MAX_LENS_TYPES;

impl Parameter {
    /// Parameters of the shape of a board.
    pub const SHAPE: [Self; SHAPE] = [Self::SagX, Self::SagY, Self::Twist, Self::Aspect];

    /// Parameters that the camera of the paper does not have: growth of distortion, field curvature, a tilted lens, exit pupil,
    /// a second pitch.
    pub const BEYOND_THE_PAPER: [Self; 10] = [
        Self::Radial1Growth,
        Self::FieldCurvature,
        Self::FieldCurvatureGrowth,
        Self::LensRotationX,
        Self::LensRotationY,
        Self::PupilX,
        Self::PupilY,
        Self::PupilZ,
        Self::PupilAberration,
        Self::PitchRatio,
    ];

    /// Returns the intrinsic parameters of a camera with this many lens types.
    ///
    /// # Panics
    /// If there are more than [`MAX_LENS_TYPES`], which no valid camera has.
    #[must_use]
    pub fn intrinsic(lens_types: usize) -> &'static [Self] {
        const ALL: &[Parameter] = &Parameter::ALL;
        assert!(lens_types <= MAX_LENS_TYPES, "{lens_types} lens types");
        &ALL[..PINHOLE + lens_types]
    }

    /// Returns the intrinsic parameters of a camera with this many lens types, then the parameters of the shape of the board.
    /// Indices of shared parameters refer to this order.
    ///
    /// # Panics
    /// Like [`Parameter::intrinsic`].
    #[must_use]
    pub fn shared(lens_types: usize) -> Vec<Self> {
        [Self::intrinsic(lens_types), &Self::SHAPE].concat()
    }

    /// Returns the focal length of a lens type, from 0.
    ///
    /// # Panics
    /// If the lens type is beyond [`MAX_LENS_TYPES`].
    #[must_use]
    pub fn focal_length_of(lens_type: usize) -> Self {
        Self::intrinsic(MAX_LENS_TYPES)[PINHOLE + lens_type]
    }

    /// Returns the symbol of the paper as written in options, tables and files.
    #[must_use]
    pub const fn name(self) -> &'static str {
        self.row().name
    }

    /// Returns the unit of the value.
    #[must_use]
    pub const fn unit(self) -> &'static str {
        self.row().unit
    }

    /// Returns the position in `camera.json`, or in the `board` of `problem.json`, as a JSON pointer (RFC 6901).
    #[must_use]
    pub const fn key(self) -> &'static str {
        self.row().key
    }

    /// Returns true if only positive values are possible.
    #[must_use]
    pub const fn is_positive(self) -> bool {
        self.row().is_positive
    }

    /// Returns the description of the parameter.
    #[must_use]
    pub const fn description(self) -> &'static str {
        self.row().description
    }

    /// Returns true if it is the focal length of a lens type.
    #[must_use]
    pub const fn is_of_micro_lenses(self) -> bool {
        self as usize >= PINHOLE && !self.is_of_board()
    }

    /// Returns true if it is a parameter of the shape of the board rather than of the camera.
    #[must_use]
    pub const fn is_of_board(self) -> bool {
        self as usize >= PINHOLE + MAX_LENS_TYPES
    }
}

impl fmt::Display for Parameter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl FromStr for Parameter {
    type Err = Error;

    /// Finds a parameter by its name.
    fn from_str(name: &str) -> Result<Self, Error> {
        Self::ALL.into_iter().find(|parameter| parameter.name() == name).ok_or_else(|| {
            Error::invalid(format!(
                "there is no parameter '{name}'; the parameters are {}",
                Self::ALL.map(Self::name).join(", ")
            ))
        })
    }
}

impl Serialize for Parameter {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.name())
    }
}

impl<'de> Deserialize<'de> for Parameter {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        String::deserialize(deserializer)?.parse().map_err(serde::de::Error::custom)
    }
}

macro_rules! places {
    ($of:ty { $($id:ident => $($place:ident).+ $([$index:literal])?;)* }) => {
        impl $of {
            /// Returns the value of a parameter, in its unit.
            ///
            /// # Panics
            /// If this has no such parameter: a parameter of the board in a camera or the reverse, or the focal length of a
            /// lens type that the camera does not have.
            #[must_use]
            pub fn value(&self, parameter: Parameter) -> f64 {
                match parameter {
                    $(Parameter::$id => self.$($place).+ $([$index])?,)*
                    _ => panic!("{parameter} is not a parameter of this"),
                }
            }

            /// Changes the value of a parameter.
            ///
            /// # Panics
            /// If this has no such parameter, as in `value`.
            pub fn set(&mut self, parameter: Parameter, value: f64) {
                match parameter {
                    $(Parameter::$id => self.$($place).+ $([$index])? = value,)*
                    _ => panic!("{parameter} is not a parameter of this"),
                }
            }
        }
    };
}

places!(PlenopticCamera {
    FocalLength => main_lens.focal_length_mm;
    Radial1 => main_lens.radial[0];
    Radial2 => main_lens.radial[1];
    Radial3 => main_lens.radial[2];
    Radial1Growth => main_lens.q1_growth_per_mm2;
    Tangential1 => main_lens.tangential[0];
    Tangential2 => main_lens.tangential[1];
    FieldCurvature => main_lens.field_curvature_per_mm;
    FieldCurvatureGrowth => main_lens.field_curvature_growth_per_mm;
    LensRotationX => main_lens.rotation_rad[0];
    LensRotationY => main_lens.rotation_rad[1];
    PupilX => main_lens.exit_pupil_mm[0];
    PupilY => main_lens.exit_pupil_mm[1];
    PupilZ => main_lens.exit_pupil_mm[2];
    PupilAberration => main_lens.pupil_aberration_per_mm;
    PrincipalPointU => mla.principal_point_px[0];
    PrincipalPointV => mla.principal_point_px[1];
    ArrayToSensor => mla.mla_to_sensor_mm;
    RotationX => mla.rotation_rad[0];
    RotationY => mla.rotation_rad[1];
    RotationZ => mla.rotation_rad[2];
    OffsetX => mla.offset_mm[0];
    OffsetY => mla.offset_mm[1];
    LensToArray => mla.lens_to_mla_mm;
    Pitch => mla.pitch_mm;
    PitchRatio => mla.pitch_ratio;
    FocalLengthOfType1 => mla.focal_lengths_mm[0];
    FocalLengthOfType2 => mla.focal_lengths_mm[1];
    FocalLengthOfType3 => mla.focal_lengths_mm[2];
});

places!(BoardShape {
    SagX => sag_x_mm;
    SagY => sag_y_mm;
    Twist => twist_mm;
    Aspect => aspect;
});

impl PlenopticCamera {
    /// Returns the values of all intrinsic parameters, in the order and units of [`Parameter::intrinsic`].
    #[must_use]
    pub fn intrinsics(&self) -> Vec<f64> {
        Parameter::intrinsic(self.lens_types()).iter().map(|&p| self.value(p)).collect()
    }

    /// Returns this camera with other values of its intrinsic parameters.
    ///
    /// # Panics
    /// If the number of values differs from [`PlenopticCamera::intrinsics`].
    #[must_use]
    pub fn with_intrinsics(&self, values: &[f64]) -> Self {
        let parameters = Parameter::intrinsic(self.lens_types());
        assert_eq!(values.len(), parameters.len());
        let mut camera = self.clone();
        for (&parameter, &value) in parameters.iter().zip(values) {
            camera.set(parameter, value);
        }
        camera
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use serde_json::Value;

    use super::*;
    use crate::model::camera::small_camera;

    /// The key of each parameter is the position of its value in `camera.json`.
    #[test]
    fn keys_are_places_in_the_files() {
        let mut camera = small_camera();
        let mut shape = BoardShape::default();
        for (i, parameter) in Parameter::ALL.into_iter().enumerate() {
            let value = 1.0 + i as f64;
            if parameter.is_of_board() {
                shape.set(parameter, value);
                assert!((shape.value(parameter) - value).abs() < 1e-12);
            } else {
                camera.set(parameter, value);
                assert!((camera.value(parameter) - value).abs() < 1e-12);
            }
        }
        let document: Value = serde_json::to_value(&camera).unwrap();
        for (&parameter, value) in Parameter::intrinsic(3).iter().zip(camera.intrinsics()) {
            assert_eq!(document.pointer(parameter.key()), Some(&value.into()), "{parameter}");
        }
    }

    #[test]
    fn names_identify_parameters() {
        let names: BTreeSet<&str> = Parameter::ALL.iter().map(|p| p.name()).collect();
        assert_eq!(names.len(), Parameter::ALL.len());
        for parameter in Parameter::ALL {
            assert_eq!(parameter.name().parse::<Parameter>().unwrap(), parameter);
        }
        assert!("D_".parse::<Parameter>().unwrap_err().to_string().contains("theta_x"));
    }
}
