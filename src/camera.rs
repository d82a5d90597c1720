//! The camera: what a user states of it, what is measured on white images, and the whole model.

use nalgebra::{Point3, Vector2, Vector3};
use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};
use crate::io::CameraFields;
use crate::lattice::{Lattice, LatticeKind};

/// The image sensor.
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

impl Sensor {
    /// Middle of the image, px; pixel (0, 0) is the centre of the top-left pixel.
    #[must_use]
    pub fn center_px(&self) -> Vector2<f64> {
        Vector2::new(f64::from(self.width_px) - 1.0, f64::from(self.height_px) - 1.0) / 2.0
    }

    /// Whether a position lies between the centres of the outermost pixels.
    #[must_use]
    pub fn contains(&self, u_px: f64, v_px: f64) -> bool {
        (0.0..=f64::from(self.width_px) - 1.0).contains(&u_px)
            && (0.0..=f64::from(self.height_px) - 1.0).contains(&v_px)
    }

    /// An error unless the sensor has pixels.
    pub(crate) fn validate(&self) -> Result<()> {
        if self.width_px == 0 || self.height_px == 0 {
            return Err(Error::invalid(format!(
                "a sensor of {} x {} pixels has no area",
                self.width_px, self.height_px
            )));
        }
        positive(self.pixel_size_mm, "the pixel size (mm)")
    }
}

/// Where the main lens focuses with respect to the micro-lens array.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Configuration {
    /// Behind the array (and the sensor): f > d.
    Galilean,
    /// In front of the array: f < d.
    Keplerian,
    /// On the array: f = d.
    Unfocused,
}

/// What the datasheet says of a camera: the start of a calibration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Datasheet {
    /// The image sensor.
    pub sensor: Sensor,
    /// Focal length F of the main lens, mm.
    pub focal_length_mm: f64,
    /// Distance h between the sensor and the plane in focus, mm; infinite is allowed.
    pub focus_distance_mm: f64,
    /// F-number N that the main lens was set to.
    pub f_number: f64,
    /// Galilean, Keplerian or unfocused.
    pub configuration: Configuration,
    /// Packing of the micro-lenses.
    pub lattice_kind: LatticeKind,
    /// Number of micro-lenses along a row.
    pub columns: i32,
    /// Number of micro-lenses along a column.
    pub rows: i32,
    /// Number I of lens types; 0 for an array of pinholes.
    pub lens_types: usize,
    /// Distance of neighbouring micro-image centres, px, where it is stated.
    pub micro_image_pitch_px: Option<f64>,
}

/// Internal parameters Ω = {m, q'₁ … q'_I} (paper, section 3.2), measured on white images.
#[derive(Debug, Clone, PartialEq)]
pub struct InternalParameters {
    /// |m|, mm: growth of the micro-image radius with 1/N.
    pub m_mm: f64,
    /// q'ᵢ, mm, by lens type.
    pub q_prime_mm: Vec<f64>,
    /// Distance Δc of neighbouring micro-image centres, mm, where it was measured along.
    pub micro_image_pitch_mm: Option<f64>,
}

/// The largest number of inner corners along a side of a board.
const MAX_BOARD_CORNERS: i32 = 10_000;

/// A checkerboard, by its inner corners.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Board {
    /// Inner corners along a row.
    pub columns: i32,
    /// Inner corners along a column.
    pub rows: i32,
    /// Edge of a square, mm.
    pub square_mm: f64,
}

impl Board {
    /// Number of inner corners.
    #[must_use]
    pub fn corners(&self) -> i32 {
        self.columns * self.rows
    }

    /// Position of corner `row · columns + column` in the board frame, mm: x along the columns, y
    /// along the rows, z = 0.
    #[must_use]
    pub fn point_mm(&self, corner: i32) -> Point3<f64> {
        let (row, column) = (corner.div_euclid(self.columns), corner.rem_euclid(self.columns));
        Point3::new(f64::from(column) * self.square_mm, f64::from(row) * self.square_mm, 0.0)
    }

    /// An error unless the board has corners and a size.
    pub fn validate(&self) -> Result<()> {
        let possible = 2..=MAX_BOARD_CORNERS;
        if !possible.contains(&self.columns) || !possible.contains(&self.rows) {
            return Err(Error::invalid(format!(
                "a board of {} x {} inner corners cannot be used; each side takes 2 to \
                 {MAX_BOARD_CORNERS}",
                self.columns, self.rows
            )));
        }
        positive(self.square_mm, "the edge of the board's squares (mm)")
    }
}

/// The main lens: thin, with Brown-Conrady distortion of the image point, in mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MainLens {
    /// F, mm.
    pub focal_length_mm: f64,
    /// Q₁, Q₂, Q₃ in mm⁻², mm⁻⁴, mm⁻⁶.
    pub radial: [f64; 3],
    /// P₁, P₂ in mm⁻¹.
    pub tangential: [f64; 2],
    /// What the lens was set to; for the record, the model does not use it.
    pub setting: Option<LensSetting>,
}

/// Setting of the main lens.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LensSetting {
    /// F-number N.
    pub f_number: f64,
    /// Distance h between the sensor and the plane in focus, mm; may be infinite.
    pub focus_distance_mm: f64,
}

/// The micro-lens array and the sensor behind it. Distances run along the optical axis and hold at
/// the centre of the array.
#[derive(Debug, Clone, PartialEq)]
pub struct MicroLensArray {
    /// (u₀, v₀), px: where the optical axis meets the sensor.
    pub principal_point_px: Vector2<f64>,
    /// d: array to sensor, mm.
    pub mla_to_sensor_mm: f64,
    /// θx, θy, θz, rad: the array is turned by Rz·Ry·Rx.
    pub rotation_rad: Vector3<f64>,
    /// t_x, t_y, mm: centre of the array in the camera frame.
    pub offset_mm: Vector2<f64>,
    /// D: main lens to array, mm.
    pub lens_to_mla_mm: f64,
    /// ΔC: distance of neighbouring micro-lenses along x, mm.
    pub pitch_mm: f64,
    /// Pitch along y over pitch along x; 1 for a regular lattice.
    pub pitch_ratio: f64,
    /// f₁ … f_I, mm; empty for an array of pinholes.
    pub focal_lengths_mm: Vec<f64>,
}

/// A calibrated (or to be refined) camera: the 16 + I parameters of the paper and the ratio of the
/// two pitches.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(from = "CameraFields", into = "CameraFields")]
pub struct PlenopticCamera {
    /// The image sensor.
    pub sensor: Sensor,
    /// Indices and packing of the micro-lenses.
    pub lattice: Lattice,
    /// The main lens.
    pub main_lens: MainLens,
    /// The micro-lens array.
    pub mla: MicroLensArray,
}

/// An intrinsic parameter.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Parameter {
    /// The paper's symbol as it is written in options, tables and files.
    pub name: String,
    /// Unit of [`PlenopticCamera::intrinsics`].
    pub unit: &'static str,
}

/// Number of parameters of the main lens, the first in [`PlenopticCamera::intrinsics`].
pub const MAIN_LENS_PARAMETERS: usize = 6;
/// Number of parameters of the array, which follow; the focal lengths come last.
pub const ARRAY_PARAMETERS: usize = 11;

const PARAMETERS: [(&str, &str); MAIN_LENS_PARAMETERS + ARRAY_PARAMETERS] = [
    ("F", "mm"),
    ("Q1", "mm^-2"),
    ("Q2", "mm^-4"),
    ("Q3", "mm^-6"),
    ("P1", "mm^-1"),
    ("P2", "mm^-1"),
    ("u0", "px"),
    ("v0", "px"),
    ("d", "mm"),
    ("theta_x", "rad"),
    ("theta_y", "rad"),
    ("theta_z", "rad"),
    ("t_x", "mm"),
    ("t_y", "mm"),
    ("D", "mm"),
    ("dC", "mm"),
    ("dC_ratio", "1"),
];

/// The intrinsic parameters of a camera with so many lens types, in the order of
/// [`PlenopticCamera::intrinsics`].
#[must_use]
pub fn intrinsic_parameters(lens_types: usize) -> Vec<Parameter> {
    let fixed = PARAMETERS.iter().map(|&(name, unit)| Parameter { name: name.to_owned(), unit });
    let focal = (1..=lens_types).map(|i| Parameter { name: format!("f_{i}"), unit: "mm" });
    fixed.chain(focal).collect()
}

impl MainLens {
    /// By how much distortion moves an ideal image point, both in mm of the camera frame
    /// (Brown-Conrady; paper, section 2.1).
    #[inline]
    #[must_use]
    pub fn distortion_mm(&self, x: Vector2<f64>) -> Vector2<f64> {
        let [q1, q2, q3] = self.radial;
        let [p1, p2] = self.tangential;
        let r2 = x.norm_squared();
        let radial = ((q3 * r2 + q2) * r2 + q1) * r2;
        let across = p1 * x.x + p2 * x.y;
        // P1 (r² + 2x²) + 2 P2 x y = P1 r² + 2x (P1 x + P2 y), and the same along y.
        x * (radial + 2.0 * across) + Vector2::new(p1, p2) * r2
    }
}

impl PlenopticCamera {
    /// Number I of lens types.
    #[must_use]
    pub fn lens_types(&self) -> usize {
        self.mla.focal_lengths_mm.len()
    }

    /// Index of the lens type of micro-lens (k, l), from 0.
    #[must_use]
    pub fn lens_type(&self, k: i32, l: i32) -> usize {
        self.lattice.lens_type(k, l, self.lens_types())
    }

    /// Galilean or Keplerian, by comparing the micro-lenses' focal lengths with d; `None` for a
    /// pinhole array.
    #[must_use]
    pub fn configuration(&self) -> Option<Configuration> {
        let f = self.mla.focal_lengths_mm.iter().copied().reduce(f64::max)?;
        Some(if f > self.mla.mla_to_sensor_mm {
            Configuration::Galilean
        } else if f < self.mla.mla_to_sensor_mm {
            Configuration::Keplerian
        } else {
            Configuration::Unfocused
        })
    }

    /// δc: distance of neighbouring micro-image centres, px, Eq. (mlinterdist).
    #[must_use]
    pub fn micro_image_pitch_px(&self) -> f64 {
        let mla = &self.mla;
        mla.pitch_mm * (mla.lens_to_mla_mm + mla.mla_to_sensor_mm)
            / (mla.lens_to_mla_mm * self.sensor.pixel_size_mm)
    }

    /// An error naming the value that cannot be.
    pub fn validate(&self) -> Result<()> {
        self.sensor.validate()?;
        check_array_size(self.lattice.columns, self.lattice.rows)?;
        check_lens_types(self.lens_types(), self.lattice.kind)?;
        if let Some(setting) = self.main_lens.setting {
            positive(setting.f_number, "the f-number of the main lens")?;
        }
        let mla = &self.mla;
        positive(self.main_lens.focal_length_mm, "the camera's F (mm)")?;
        positive(mla.lens_to_mla_mm, "the camera's D (mm)")?;
        positive(mla.mla_to_sensor_mm, "the camera's d (mm)")?;
        positive(mla.pitch_mm, "the camera's dC (mm)")?;
        positive(mla.pitch_ratio, "the camera's dC_ratio")?;
        for (i, &f) in mla.focal_lengths_mm.iter().enumerate() {
            positive(f, &format!("the camera's f_{} (mm)", i + 1))?;
        }
        for (parameter, value) in
            intrinsic_parameters(self.lens_types()).iter().zip(self.intrinsics())
        {
            // Far beyond this squares overflow.
            if !value.is_finite() || value.abs() > 1e100 {
                return Err(Error::invalid(format!("the camera's {} is {value}", parameter.name)));
            }
        }
        Ok(())
    }

    /// Values of all intrinsic parameters in the order and units of [`intrinsic_parameters`].
    #[must_use]
    pub fn intrinsics(&self) -> Vec<f64> {
        let (lens, mla) = (&self.main_lens, &self.mla);
        let mut values = vec![lens.focal_length_mm];
        values.extend(lens.radial);
        values.extend(lens.tangential);
        values.extend(mla.principal_point_px.iter());
        values.push(mla.mla_to_sensor_mm);
        values.extend(mla.rotation_rad.iter());
        values.extend(mla.offset_mm.iter());
        values.extend([mla.lens_to_mla_mm, mla.pitch_mm, mla.pitch_ratio]);
        values.extend(&mla.focal_lengths_mm);
        values
    }

    /// This camera with other values of its intrinsic parameters.
    ///
    /// # Panics
    /// If the number of values is not that of [`PlenopticCamera::intrinsics`].
    #[must_use]
    pub fn with_intrinsics(&self, values: &[f64]) -> Self {
        assert_eq!(values.len(), MAIN_LENS_PARAMETERS + ARRAY_PARAMETERS + self.lens_types());
        let (lens, rest) = values.split_at(MAIN_LENS_PARAMETERS);
        let (array, focal_lengths) = rest.split_at(ARRAY_PARAMETERS);
        Self {
            sensor: self.sensor,
            lattice: self.lattice,
            main_lens: MainLens {
                focal_length_mm: lens[0],
                radial: [lens[1], lens[2], lens[3]],
                tangential: [lens[4], lens[5]],
                setting: self.main_lens.setting,
            },
            mla: MicroLensArray {
                principal_point_px: Vector2::new(array[0], array[1]),
                mla_to_sensor_mm: array[2],
                rotation_rad: Vector3::new(array[3], array[4], array[5]),
                offset_mm: Vector2::new(array[6], array[7]),
                lens_to_mla_mm: array[8],
                pitch_mm: array[9],
                pitch_ratio: array[10],
                focal_lengths_mm: focal_lengths.to_vec(),
            },
        }
    }
}

/// An error naming the value unless it is positive and finite.
pub(crate) fn positive(value: f64, name: &str) -> Result<()> {
    if value.is_finite() && value > 0.0 {
        Ok(())
    } else {
        Err(Error::invalid(format!("{name} is {value}; it has to be positive and finite")))
    }
}

/// The largest number of micro-lenses along a side; beyond what any sensor has pixels for.
pub const MAX_MICRO_LENSES: i32 = 1 << 16;

/// An error unless an array can have these numbers of micro-lenses.
pub(crate) fn check_array_size(columns: i32, rows: i32) -> Result<()> {
    let possible = 1..=MAX_MICRO_LENSES;
    if possible.contains(&columns) && possible.contains(&rows) {
        return Ok(());
    }
    Err(Error::invalid(format!(
        "a micro-lens array of {columns} x {rows} is not possible: each side takes 1 to \
         {MAX_MICRO_LENSES}"
    )))
}

/// An error unless the number of lens types is one the lattice can carry.
pub(crate) fn check_lens_types(types: usize, kind: LatticeKind) -> Result<()> {
    match (types, kind) {
        (0 | 1, _) | (3, LatticeKind::HexagonalRows | LatticeKind::HexagonalColumns) => Ok(()),
        _ => Err(Error::invalid(format!(
            "{types} lens types on the lattice '{}' are not known: give 0 (pinholes) or 1, or 3 on a \
             hexagonal lattice",
            kind.name()
        ))),
    }
}

impl Datasheet {
    /// An error naming the value that cannot be.
    pub fn validate(&self) -> Result<()> {
        self.sensor.validate()?;
        check_array_size(self.columns, self.rows)?;
        if let Some(pitch) = self.micro_image_pitch_px {
            positive(pitch, "the micro-image pitch (px)")?;
        }
        positive(self.focal_length_mm, "the focal length of the main lens (mm)")?;
        positive(self.f_number, "the f-number of the main lens")?;
        check_lens_types(self.lens_types, self.lattice_kind)?;
        // The sum of object and image distance of a thin lens is at least 4F.
        if self.focus_distance_mm.is_nan() || self.focus_distance_mm < 4.0 * self.focal_length_mm {
            return Err(Error::invalid(format!(
                "a focus distance of {} mm is not possible with F = {} mm: it is measured from the \
                 sensor and is at least 4 F",
                self.focus_distance_mm, self.focal_length_mm
            )));
        }
        Ok(())
    }
}

impl InternalParameters {
    /// An error naming the value that cannot be, or the number of q' that does not match.
    pub fn validate(&self, lens_types: usize) -> Result<()> {
        positive(self.m_mm, "the internal parameter |m| (mm)")?;
        for (i, &q) in self.q_prime_mm.iter().enumerate() {
            positive(q, &format!("the internal parameter q'_{} (mm)", i + 1))?;
        }
        if let Some(pitch) = self.micro_image_pitch_mm {
            positive(pitch, "the micro-image pitch (mm)")?;
        }
        if lens_types != 0 && self.q_prime_mm.len() != lens_types {
            return Err(Error::invalid(format!(
                "the camera has I = {lens_types} lens types, but the internal parameters hold {} \
                 values of q'; both have to be of the same camera",
                self.q_prime_mm.len()
            )));
        }
        Ok(())
    }
}
