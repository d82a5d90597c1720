//! Parameters of the camera model as plain values.

use nalgebra::{Rotation3, Vector2, Vector3};

use super::edge_spread::EdgeSpread;
use super::lattice::{Configuration, Lattice};
use super::sensor::Sensor;

/// Main lens: a thin lens with Brown-Conrady distortion of the image point, in mm, and field curvature. The model also
/// describes a thick lens with the origin at its image-side principal point, if all objects are moved along z by the distance
/// between its principal planes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MainLens {
    /// Focal length F, mm, for light that fills the aperture of the images.
    pub focal_length_mm: f64,
    /// Radial distortion Q₁, Q₂, Q₃ in mm⁻², mm⁻⁴, mm⁻⁶.
    pub radial: [f64; 3],
    /// Growth Q₁ₘ of the radial distortion with the magnification, mm⁻²: its first order is Q₁ + Q₁ₘ |m|. Every lens has
    /// some, since rays of nearer objects cross it at other heights.
    pub q1_growth_per_mm2: f64,
    /// Tangential distortion P₁, P₂ in mm⁻¹.
    pub tangential: [f64; 2],
    /// Field curvature κ, mm⁻¹: images at the distance r from the axis are nearer to the lens by (κ + κ_m |m|) r², at the
    /// magnification m.
    pub field_curvature_per_mm: f64,
    /// Growth κ_m of the field curvature with the magnification, mm⁻¹: the astigmatism of a lens, and with it the curvature,
    /// changes with the distance of the object.
    pub field_curvature_growth_per_mm: f64,
    /// Rotation ωx, ωy of the optical axis against the normal of the sensor by Ry·Rx, rad.
    pub rotation_rad: [f64; 2],
    /// Centre P = (e_x, e_y, e_z) of the exit pupil in the lens frame, mm, the origin of the light of every micro-image; e_z
    /// is negative towards the array. In the paper it lies in the lens, at 0.
    pub exit_pupil_mm: Vector3<f64>,
    /// Spherical aberration e_r of the exit pupil, mm⁻¹: seen from a micro-lens at the distance r from the axis, the pupil lies
    /// at e_z + e_r r².
    pub pupil_aberration_per_mm: f64,
    /// Setting of the lens; recorded only, the model does not use it.
    pub setting: Option<LensSetting>,
}

impl MainLens {
    /// Creates the lens of the paper without distortion: thin, with its pupil in the lens and a flat field.
    #[must_use]
    pub fn thin(focal_length_mm: f64) -> Self {
        Self {
            focal_length_mm,
            radial: [0.0; 3],
            q1_growth_per_mm2: 0.0,
            tangential: [0.0; 2],
            field_curvature_per_mm: 0.0,
            field_curvature_growth_per_mm: 0.0,
            rotation_rad: [0.0; 2],
            exit_pupil_mm: Vector3::zeros(),
            pupil_aberration_per_mm: 0.0,
            setting: None,
        }
    }

    /// Returns true if the field is curved: images off the axis are nearer to the lens, or further away.
    #[must_use]
    pub fn has_curved_field(&self) -> bool {
        self.field_curvature_per_mm != 0.0 || self.field_curvature_growth_per_mm != 0.0
    }

    /// Returns the rotation from the lens frame, whose z axis is the optical axis, to the camera frame, whose z axis is
    /// normal to the sensor.
    #[must_use]
    pub fn camera_from_lens(&self) -> Rotation3<f64> {
        let [x, y] = self.rotation_rad;
        Rotation3::from_euler_angles(x, y, 0.0)
    }

    /// Returns the pupil magnification p = 1 + e_z/F, the ratio of the diameters of exit pupil and entrance pupil. One is the
    /// image of the other, so that by Newton's equation the exit pupil lies pF before the rear focal point.
    #[must_use]
    pub fn pupil_magnification(&self) -> f64 {
        1.0 + self.exit_pupil_mm.z / self.focal_length_mm
    }
}

/// Setting of the main lens.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LensSetting {
    /// F-number N.
    pub f_number: f64,
    /// Distance h between the sensor and the plane in focus, mm; may be infinite.
    pub focus_distance_mm: f64,
}

/// Micro-lens array and the sensor behind it. Distances are measured along the normal of the sensor, at the centre of the array.
#[derive(Debug, Clone, PartialEq)]
pub struct MicroLensArray {
    /// Principal point (u₀, v₀), px: the centre O of the main lens projected onto the sensor.
    pub principal_point_px: Vector2<f64>,
    /// Distance d from array to sensor, mm.
    pub mla_to_sensor_mm: f64,
    /// Rotation θx, θy, θz of the array by Rz·Ry·Rx, rad.
    pub rotation_rad: Vector3<f64>,
    /// Centre t_x, t_y of the array in the camera frame, mm.
    pub offset_mm: Vector2<f64>,
    /// Distance D from main lens to array, mm.
    pub lens_to_mla_mm: f64,
    /// Distance ΔC between neighbouring micro-lenses along x, mm.
    pub pitch_mm: f64,
    /// Pitch along y over pitch along x; 1 for a regular lattice.
    pub pitch_ratio: f64,
    /// Focal lengths f₁ … f_I, mm; empty for an array of pinholes.
    pub focal_lengths_mm: Vec<f64>,
}

/// Calibrated or initial camera: the 16 + I parameters of the paper, the field curvature, the exit pupil, and the ratio of the
/// two pitches.
#[derive(Debug, Clone, PartialEq)]
pub struct PlenopticCamera {
    /// Image sensor.
    pub sensor: Sensor,
    /// Indices and packing of the micro-lenses.
    pub lattice: Lattice,
    /// Main lens.
    pub main_lens: MainLens,
    /// Micro-lens array.
    pub mla: MicroLensArray,
    /// Aperture ratio and point spread, as far as they are known.
    pub edge_spread: EdgeSpread,
}

impl PlenopticCamera {
    /// Returns the pixel position where the optical axis meets the sensor.
    #[must_use]
    pub fn axis_px(&self) -> Vector2<f64> {
        let axis = self.main_lens.camera_from_lens() * Vector3::z();
        let to_sensor = self.mla.lens_to_mla_mm + self.mla.mla_to_sensor_mm;
        self.mla.principal_point_px + axis.xy() * (to_sensor / (axis.z * self.sensor.pixel_size_mm))
    }

    /// Returns the number I of lens types.
    #[must_use]
    pub fn lens_types(&self) -> usize {
        self.mla.focal_lengths_mm.len()
    }

    /// Returns the index of the lens type of micro-lens (k, l), from 0.
    #[must_use]
    pub fn lens_type(&self, k: i32, l: i32) -> usize {
        self.lattice.lens_type(k, l, self.lens_types())
    }

    /// Returns Galilean or Keplerian, from the focal lengths of the micro-lenses and d; `None` for a pinhole array.
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

    /// Returns the distance D + e_z from exit pupil to array, mm.
    #[must_use]
    pub fn pupil_to_mla_mm(&self) -> f64 {
        self.mla.lens_to_mla_mm + self.main_lens.exit_pupil_mm.z
    }

    /// Returns the distance Δc between neighbouring micro-image centres, px, as the geometric mean of both axes:
    /// Eq. (mlinterdist) with distances from the exit pupil, ΔC √(pitch ratio) (D + e_z + d)/(D + e_z).
    #[must_use]
    pub fn micro_image_pitch_px(&self) -> f64 {
        let (mla, to_pupil) = (&self.mla, self.pupil_to_mla_mm());
        let pitch_mm = mla.pitch_mm * mla.pitch_ratio.sqrt();
        pitch_mm * (to_pupil + mla.mla_to_sensor_mm) / (to_pupil * self.sensor.pixel_size_mm)
    }
}

/// Creates a small camera of three lens types, for tests.
#[cfg(test)]
pub(crate) fn small_camera() -> PlenopticCamera {
    use super::lattice::{Packing, Parity};

    PlenopticCamera {
        sensor: Sensor { width_px: 1000, height_px: 750, pixel_size_mm: 0.0055 },
        lattice: Lattice { packing: Packing::HexagonalRows(Parity::Even), columns: 43, rows: 37 },
        main_lens: MainLens::thin(16.2),
        mla: MicroLensArray {
            principal_point_px: Vector2::new(499.5, 374.5),
            mla_to_sensor_mm: 0.33,
            rotation_rad: Vector3::zeros(),
            offset_mm: Vector2::zeros(),
            lens_to_mla_mm: 18.5,
            pitch_mm: 0.126,
            pitch_ratio: 1.0,
            focal_lengths_mm: vec![0.578, 0.505, 0.552],
        },
        edge_spread: EdgeSpread::default(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tilted_axis_leaves_the_principal_point() {
        let mut camera = small_camera();
        assert_eq!(camera.axis_px(), camera.mla.principal_point_px);
        camera.main_lens.rotation_rad = [0.02, 0.01];
        let to_sensor_px = (18.5 + 0.33) / 0.0055;
        let (x, y) = (0.02_f64, 0.01_f64);
        let off = Vector2::new(y.tan(), -x.tan() / y.cos()) * to_sensor_px;
        assert!((camera.axis_px() - camera.mla.principal_point_px - off).norm() < 1e-9);
    }
}
