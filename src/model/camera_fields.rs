//! Camera as stored in files: `camera.json` and simulation files.

use nalgebra::{Vector2, Vector3};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::camera::{LensSetting, MainLens, MicroLensArray, PlenopticCamera};
use super::edge_spread::EdgeSpread;
use super::lattice::{Lattice, LatticeKind, Packing, Parity};
use super::opening::Opening;
use super::sensor::Sensor;
use crate::quantity::Estimate;

/// Camera as stored in files.
#[derive(Serialize, Deserialize)]
struct CameraFields {
    sensor: Sensor,
    main_lens: MainLensFile,
    principal_point_px: [f64; 2],
    micro_lens_array: ArrayFile,
    /// Point spread; omitted if it is not known, like the aperture ratio.
    #[serde(alias = "point_spread", skip_serializing_if = "Option::is_none")]
    point_spread_px2: Option<Estimate>,
}

impl Serialize for PlenopticCamera {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        CameraFields::from(self.clone()).serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for PlenopticCamera {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let fields = CameraFields::deserialize(deserializer)?;
        Self::try_from(fields).map_err(serde::de::Error::custom)
    }
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct MainLensFile {
    focal_length_mm: f64,
    q1_per_mm2: f64,
    q2_per_mm4: f64,
    q3_per_mm6: f64,
    /// Growth of the distortion; 0 in files without it, like field curvature and exit pupil.
    #[serde(default)]
    q1_growth_per_mm2: f64,
    p1_per_mm: f64,
    p2_per_mm: f64,
    #[serde(default)]
    field_curvature_per_mm: f64,
    #[serde(default)]
    field_curvature_growth_per_mm: f64,
    #[serde(default)]
    rotation_rad: [f64; 2],
    #[serde(default)]
    exit_pupil_mm: [f64; 3],
    #[serde(default)]
    pupil_aberration_per_mm: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    f_number: Option<f64>,
    /// Focus distance; omitted if the lens was focused at infinity or the setting is not known.
    #[serde(skip_serializing_if = "Option::is_none")]
    focus_distance_mm: Option<f64>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ArrayFile {
    lattice: LatticeKind,
    columns: i32,
    rows: i32,
    /// Parity of the shifted rows (columns) of a hexagonal lattice.
    #[serde(skip_serializing_if = "Option::is_none")]
    shifted: Option<Parity>,
    lens_to_mla_mm: f64,
    mla_to_sensor_mm: f64,
    rotation_rad: [f64; 3],
    offset_mm: [f64; 2],
    pitch_mm: f64,
    pitch_ratio: f64,
    focal_lengths_mm: Vec<f64>,
    #[serde(alias = "fill_factor", skip_serializing_if = "Option::is_none")]
    aperture_ratio: Option<Estimate>,
    #[serde(default, skip_serializing_if = "Opening::is_disc")]
    opening: Opening,
}

impl From<PlenopticCamera> for CameraFields {
    fn from(camera: PlenopticCamera) -> Self {
        let (lens, mla) = (&camera.main_lens, &camera.mla);
        let [q1_per_mm2, q2_per_mm4, q3_per_mm6] = lens.radial;
        let [p1_per_mm, p2_per_mm] = lens.tangential;
        let focus = lens.setting.map(|s| s.focus_distance_mm);
        Self {
            sensor: camera.sensor,
            main_lens: MainLensFile {
                focal_length_mm: lens.focal_length_mm,
                q1_per_mm2,
                q2_per_mm4,
                q3_per_mm6,
                q1_growth_per_mm2: lens.q1_growth_per_mm2,
                p1_per_mm,
                p2_per_mm,
                field_curvature_per_mm: lens.field_curvature_per_mm,
                field_curvature_growth_per_mm: lens.field_curvature_growth_per_mm,
                rotation_rad: lens.rotation_rad,
                exit_pupil_mm: lens.exit_pupil_mm.into(),
                pupil_aberration_per_mm: lens.pupil_aberration_per_mm,
                f_number: lens.setting.map(|s| s.f_number),
                // JSON has no infinity.
                focus_distance_mm: focus.filter(|h| h.is_finite()),
            },
            principal_point_px: mla.principal_point_px.into(),
            micro_lens_array: ArrayFile {
                lattice: camera.lattice.kind(),
                columns: camera.lattice.columns,
                rows: camera.lattice.rows,
                shifted: camera.lattice.packing.shifted(),
                lens_to_mla_mm: mla.lens_to_mla_mm,
                mla_to_sensor_mm: mla.mla_to_sensor_mm,
                rotation_rad: mla.rotation_rad.into(),
                offset_mm: mla.offset_mm.into(),
                pitch_mm: mla.pitch_mm,
                pitch_ratio: mla.pitch_ratio,
                focal_lengths_mm: camera.mla.focal_lengths_mm,
                aperture_ratio: camera.edge_spread.aperture_ratio,
                opening: camera.edge_spread.opening,
            },
            point_spread_px2: camera.edge_spread.point_spread_px2,
        }
    }
}

impl TryFrom<CameraFields> for PlenopticCamera {
    type Error = &'static str;

    fn try_from(fields: CameraFields) -> Result<Self, Self::Error> {
        let (lens, array) = (fields.main_lens, fields.micro_lens_array);
        let packing = match (array.lattice, array.shifted) {
            (LatticeKind::Orthogonal, _) => Packing::Orthogonal,
            (kind, Some(shifted)) => Packing::new(kind, shifted),
            (_, None) => return Err("a hexagonal lattice needs shifted = \"even\" or \"odd\""),
        };
        Ok(Self {
            sensor: fields.sensor,
            lattice: Lattice { packing, columns: array.columns, rows: array.rows },
            main_lens: MainLens {
                focal_length_mm: lens.focal_length_mm,
                radial: [lens.q1_per_mm2, lens.q2_per_mm4, lens.q3_per_mm6],
                q1_growth_per_mm2: lens.q1_growth_per_mm2,
                tangential: [lens.p1_per_mm, lens.p2_per_mm],
                field_curvature_per_mm: lens.field_curvature_per_mm,
                field_curvature_growth_per_mm: lens.field_curvature_growth_per_mm,
                rotation_rad: lens.rotation_rad,
                exit_pupil_mm: Vector3::from(lens.exit_pupil_mm),
                pupil_aberration_per_mm: lens.pupil_aberration_per_mm,
                setting: lens.f_number.map(|f_number| LensSetting {
                    f_number,
                    focus_distance_mm: lens.focus_distance_mm.unwrap_or(f64::INFINITY),
                }),
            },
            mla: MicroLensArray {
                principal_point_px: Vector2::from(fields.principal_point_px),
                mla_to_sensor_mm: array.mla_to_sensor_mm,
                rotation_rad: Vector3::from(array.rotation_rad),
                offset_mm: Vector2::from(array.offset_mm),
                lens_to_mla_mm: array.lens_to_mla_mm,
                pitch_mm: array.pitch_mm,
                pitch_ratio: array.pitch_ratio,
                focal_lengths_mm: array.focal_lengths_mm,
            },
            edge_spread: EdgeSpread {
                aperture_ratio: array.aperture_ratio,
                opening: array.opening,
                point_spread_px2: fields.point_spread_px2,
            },
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Creates the shipped camera with another lattice.
    fn camera(lattice: &str, shifted: Option<&str>) -> Result<PlenopticCamera, String> {
        let text = include_str!("../../data/synthetic/truth/camera.json");
        let mut value: serde_json::Value = serde_json::from_str(text).unwrap();
        let array = &mut value["micro_lens_array"];
        array["lattice"] = lattice.into();
        array["focal_lengths_mm"] = serde_json::json!([0.5]);
        match shifted {
            Some(parity) => array["shifted"] = parity.into(),
            None => {
                array.as_object_mut().unwrap().remove("shifted");
            }
        }
        serde_json::from_value(value).map_err(|e| e.to_string())
    }

    #[test]
    fn orthogonal_lattices_ignore_which_rows_are_shifted() {
        let camera = |shifted| camera("orthogonal", shifted).unwrap();
        assert_eq!(camera(Some("even")), camera(Some("odd")));
        assert_eq!(camera(Some("even")), camera(None));
        let written = serde_json::to_value(camera(Some("odd"))).unwrap();
        assert!(written["micro_lens_array"].get("shifted").is_none());
    }

    #[test]
    fn hexagonal_lattices_state_which_rows_are_shifted() {
        for lattice in ["hexagonal-rows", "hexagonal-columns"] {
            let camera = |shifted| camera(lattice, shifted);
            assert_ne!(camera(Some("even")).unwrap(), camera(Some("odd")).unwrap());
            assert!(camera(None).unwrap_err().contains("shifted"));
        }
    }
}
