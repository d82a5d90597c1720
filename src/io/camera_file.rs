//! `camera.json`: a calibrated camera with the uncertainty of its parameters.
//!
//! The unit of every number is in its name; what the numbers mean is said in the crate's
//! documentation of [`PlenopticCamera`]. A reader has to look at `format` and `version` first.

use std::path::Path;

use nalgebra::{Vector2, Vector3};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};

use super::read_text;
use crate::camera::{
    LensSetting, MainLens, MicroLensArray, Parameter, PlenopticCamera, Sensor, intrinsic_parameters,
};
use crate::error::{Error, Result};
use crate::evaluation::Uncertainty;
use crate::lattice::{Lattice, LatticeKind, Parity};

/// `format` of the file.
pub const CAMERA_FORMAT: &str = "plenocal-camera";
/// `version` of the file.
pub const CAMERA_VERSION: u64 = 1;

#[derive(Serialize, Deserialize)]
struct CameraFile {
    format: String,
    version: u64,
    #[serde(flatten)]
    camera: PlenopticCamera,
}

/// A camera as it stands in files.
#[derive(Serialize, Deserialize)]
pub(crate) struct CameraFields {
    sensor: Sensor,
    main_lens: MainLensFile,
    principal_point_px: [f64; 2],
    micro_lens_array: ArrayFile,
}

#[derive(Serialize, Deserialize)]
struct MainLensFile {
    focal_length_mm: f64,
    q1_per_mm2: f64,
    q2_per_mm4: f64,
    q3_per_mm6: f64,
    p1_per_mm: f64,
    p2_per_mm: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    f_number: Option<f64>,
    /// Left out when the lens was focused at infinity or the setting is not known.
    #[serde(skip_serializing_if = "Option::is_none")]
    focus_distance_mm: Option<f64>,
}

#[derive(Serialize, Deserialize)]
struct ArrayFile {
    lattice: LatticeKind,
    columns: i32,
    rows: i32,
    shifted: Parity,
    lens_to_mla_mm: f64,
    mla_to_sensor_mm: f64,
    rotation_rad: [f64; 3],
    offset_mm: [f64; 2],
    pitch_mm: f64,
    pitch_ratio: f64,
    focal_lengths_mm: Vec<f64>,
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
                p1_per_mm,
                p2_per_mm,
                f_number: lens.setting.map(|s| s.f_number),
                // JSON has no infinity.
                focus_distance_mm: focus.filter(|h| h.is_finite()),
            },
            principal_point_px: mla.principal_point_px.into(),
            micro_lens_array: ArrayFile {
                lattice: camera.lattice.kind,
                columns: camera.lattice.columns,
                rows: camera.lattice.rows,
                shifted: camera.lattice.shifted,
                lens_to_mla_mm: mla.lens_to_mla_mm,
                mla_to_sensor_mm: mla.mla_to_sensor_mm,
                rotation_rad: mla.rotation_rad.into(),
                offset_mm: mla.offset_mm.into(),
                pitch_mm: mla.pitch_mm,
                pitch_ratio: mla.pitch_ratio,
                focal_lengths_mm: camera.mla.focal_lengths_mm,
            },
        }
    }
}

impl From<CameraFields> for PlenopticCamera {
    fn from(fields: CameraFields) -> Self {
        let (lens, array) = (fields.main_lens, fields.micro_lens_array);
        Self {
            sensor: fields.sensor,
            lattice: Lattice {
                kind: array.lattice,
                columns: array.columns,
                rows: array.rows,
                shifted: array.shifted,
            },
            main_lens: MainLens {
                focal_length_mm: lens.focal_length_mm,
                radial: [lens.q1_per_mm2, lens.q2_per_mm4, lens.q3_per_mm6],
                tangential: [lens.p1_per_mm, lens.p2_per_mm],
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
        }
    }
}

/// The content of `camera.json`: the camera, and if known the standard deviation of every free
/// parameter with the correlations between them, by the parameters' names.
#[must_use]
pub fn camera_document(camera: &PlenopticCamera, uncertainty: Option<&Uncertainty>) -> Value {
    let mut document = json!(CameraFile {
        format: CAMERA_FORMAT.to_owned(),
        version: CAMERA_VERSION,
        camera: camera.clone(),
    });
    if let (Some(uncertainty), Some(fields)) = (uncertainty, document.as_object_mut()) {
        fields.insert("uncertainty".to_owned(), uncertainty_document(camera, uncertainty));
    }
    document
}

fn uncertainty_document(camera: &PlenopticCamera, uncertainty: &Uncertainty) -> Value {
    let parameters = intrinsic_parameters(camera.lens_types());
    let std_devs: Map<String, Value> = parameters
        .iter()
        .zip(uncertainty.intrinsic_std_devs(camera.lens_types()))
        .filter_map(|(p, std_dev)| {
            Some((p.name.clone(), json!({ "value": std_dev?, "unit": p.unit })))
        })
        .collect();
    let names: Vec<&str> =
        uncertainty.free_intrinsics.iter().map(|&i| parameters[i].name.as_str()).collect();
    let correlations = uncertainty.intrinsic_correlations();
    let rows: Vec<Vec<f64>> =
        correlations.row_iter().map(|row| row.iter().copied().collect()).collect();
    json!({
        "standard_deviations": std_devs,
        "correlations": { "parameters": names, "matrix": rows },
        "parameters": uncertainty.size(),
        "rank": uncertainty.rank,
    })
}

/// Reads the camera of a `camera.json`.
pub fn read_camera(path: &Path) -> Result<PlenopticCamera> {
    let value: Value = serde_json::from_str(&read_text(path)?)
        .map_err(|e| Error::content(path, format!("this is not valid JSON: {e}")))?;
    camera_from(value).map_err(|e| e.in_file(path))
}

/// Reads the standard deviations in a `camera.json`, in the order of
/// [`PlenopticCamera::intrinsics`]; `None` for parameters that were held, not determined, or where the
/// file has none.
pub fn read_std_devs(path: &Path, lens_types: usize) -> Result<Vec<Option<f64>>> {
    let value: Value = serde_json::from_str(&read_text(path)?)
        .map_err(|e| Error::content(path, format!("this is not valid JSON: {e}")))?;
    let std_devs = &value["uncertainty"]["standard_deviations"];
    let of_parameter = |p: Parameter| std_devs[p.name.as_str()]["value"].as_f64();
    Ok(intrinsic_parameters(lens_types).into_iter().map(of_parameter).collect())
}

/// The camera in a JSON document.
pub(super) fn camera_from(value: Value) -> Result<PlenopticCamera> {
    let version = value.get("version").and_then(Value::as_u64);
    if version != Some(CAMERA_VERSION) {
        return Err(Error::invalid(format!(
            "this is a {CAMERA_FORMAT} file of version {}, but only version {CAMERA_VERSION} is \
             known",
            version.map_or("unknown".to_owned(), |v| v.to_string())
        )));
    }
    let file: CameraFile = serde_json::from_value(value)
        .map_err(|e| Error::invalid(format!("not a valid {CAMERA_FORMAT} file: {e}")))?;
    Ok(file.camera)
}
