//! Layout of COMPOTE's JSON files, and the parts that several of them share.

use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion};
use serde::Deserialize;

use super::json::{Distance, Integer, Number, Vector};
use crate::error::{Error, Result};
use crate::model::{LatticeKind, Sensor};

#[derive(Deserialize)]
pub(super) struct MeshFile {
    pub(super) geometry: Integer,
    pub(super) width: Integer,
    pub(super) height: Integer,
    pub(super) pitch: Option<Vector>,
}

#[derive(Deserialize)]
pub(super) struct MiaFile {
    pub(super) mesh: MeshFile,
}

#[derive(Deserialize)]
pub(super) struct PoseFile {
    pub(super) rotation: Vec<Vec<Number>>,
    pub(super) translation: Vector,
}

#[derive(Deserialize)]
pub(super) struct LensFile {
    pub(super) aperture: Number,
    pub(super) f: Number,
}

#[derive(Deserialize)]
pub(super) struct CameraFile {
    pub(super) mia: MiaFile,
    pub(super) sensor: SensorFile,
    pub(super) main_lens: LensFile,
    pub(super) dist_focus: Distance,
    #[serde(rename = "I")]
    pub(super) lens_types: Integer,
    pub(super) mode: Integer,
}

#[derive(Deserialize)]
pub(super) struct SensorFile {
    pub(super) scale: Number,
    pub(super) width: Integer,
    pub(super) height: Integer,
}

#[derive(Deserialize)]
pub(super) struct IntrinsicsFile {
    #[serde(rename = "I")]
    pub(super) lens_types: Integer,
    pub(super) dist_focus: Distance,
    pub(super) distortions: DistortionsFile,
    pub(super) main_lens: LensFile,
    pub(super) mla: MlaFile,
    pub(super) sensor: PosedSensorFile,
}

#[derive(Deserialize)]
pub(super) struct DistortionsFile {
    pub(super) radial: Vector,
    pub(super) tangential: Vector,
}

#[derive(Deserialize)]
pub(super) struct MlaFile {
    #[serde(default)]
    pub(super) focal_lengths: Vec<Number>,
    pub(super) mesh: PosedMeshFile,
}

#[derive(Deserialize)]
pub(super) struct PosedMeshFile {
    #[serde(flatten)]
    pub(super) mesh: MeshFile,
    pub(super) pose: PoseFile,
}

#[derive(Deserialize)]
pub(super) struct PosedSensorFile {
    #[serde(flatten)]
    pub(super) sensor: SensorFile,
    pub(super) pose: PoseFile,
}

#[derive(Deserialize)]
pub(super) struct ParametersFile {
    pub(super) m: Number,
    pub(super) q_prime: Vec<Number>,
    pub(super) dc: Option<Number>,
    pub(super) scale: Option<Number>,
    #[serde(rename = "I")]
    pub(super) lens_types: Option<Integer>,
}

#[derive(Deserialize)]
pub(super) struct SceneFile {
    pub(super) checkerboards: Vec<CheckerboardFile>,
}

#[derive(Deserialize)]
pub(super) struct CheckerboardFile {
    pub(super) lph: Number,
    pub(super) x_grid: Integer,
    pub(super) y_grid: Integer,
}

#[derive(Deserialize)]
pub(super) struct PosesFile {
    pub(super) poses: Vec<FrameFile>,
}

#[derive(Deserialize)]
pub(super) struct FrameFile {
    pub(super) frame: Integer,
    pub(super) pose: PoseFile,
}

impl MeshFile {
    pub(super) fn lattice_kind(&self) -> Result<LatticeKind> {
        match self.geometry.0 {
            0 => Ok(LatticeKind::Orthogonal),
            1 => Ok(LatticeKind::HexagonalRows),
            2 => Ok(LatticeKind::HexagonalColumns),
            other => Err(Error::invalid(format!(
                "mesh geometry {other} is not known; it is 0 (orthogonal), 1 (hexagonal rows) or 2 \
                 (hexagonal columns)"
            ))),
        }
    }

    pub(super) fn size(&self) -> Result<(i32, i32)> {
        Ok((self.width.positive("mesh width")?, self.height.positive("mesh height")?))
    }
}

impl SensorFile {
    pub(super) fn sensor(&self) -> Result<Sensor> {
        let size = |value: &Integer, name| {
            value.positive(name).map(|n| u32::try_from(n).unwrap_or(u32::MAX))
        };
        Ok(Sensor {
            width_px: size(&self.width, "sensor width")?,
            height_px: size(&self.height, "sensor height")?,
            pixel_size_mm: self.scale.0,
        })
    }
}

impl PoseFile {
    /// Returns the transformation from this frame to the parent frame.
    pub(super) fn parent_from_own(&self) -> Result<Isometry3<f64>> {
        let rows = &self.rotation;
        if rows.len() != 3 || rows.iter().any(|row| row.len() != 3) {
            return Err(Error::invalid("a pose's rotation is not a 3 x 3 matrix"));
        }
        let matrix = Matrix3::from_fn(|i, j| rows[j][i].0);
        // Numbers have about 16 digits; a larger error is not rounding.
        if (matrix * matrix.transpose() - Matrix3::identity()).norm() > 1e-6
            || matrix.determinant() < 0.0
        {
            return Err(Error::invalid("a pose's rotation is not a rotation matrix"));
        }
        let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_eps(
            &matrix,
            f64::EPSILON,
            100,
            Rotation3::from_matrix_unchecked(matrix),
        ));
        let [x, y, z] = self.translation.fixed("a pose's translation")?;
        Ok(Isometry3::from_parts(Translation3::new(x, y, z), rotation))
    }
}
