//! `precalibration.json`: the micro-image array and the internal parameters; `centers.csv`: the centres.

use std::io::{self, Write};

use serde::Deserialize;
use serde_json::{Map, Value, json};

use super::json_file::{check_version, document_of};
use super::observations_file::std_dev_text;
use super::spelling::plain;
use crate::error::{Error, Result};
use crate::model::{InternalParameters, MicroImageCenter};
use crate::precalibration::{ArrayMeasurement, LensTypes, Precalibration};

/// Value of `format` in the file.
pub const PRECALIBRATION_FORMAT: &str = "plenocal-precalibration";
/// Value of `version` in the file.
pub const PRECALIBRATION_VERSION: u64 = 1;

/// Fields of the internal parameters whose σ are grouped in the file.
const WITH_STD_DEV: [&str; 2] = ["m_mm", "q_prime_mm"];
const STD_DEVS: &str = "standard_deviations";
const RMS: &str = "rms_px";

/// Returns the field of [`InternalParameters`] with the σ of another field.
fn std_dev_key(name: &str) -> String {
    name.replace("_mm", "_std_dev_mm")
}

#[derive(Deserialize)]
struct PrecalibrationFile {
    internal_parameters: Option<Value>,
    micro_image_array: Option<ArraySize>,
}

#[derive(Deserialize)]
struct ArraySize {
    columns: i32,
    rows: i32,
}

/// Returns the content of `precalibration.json` if only an array was measured.
#[must_use]
pub fn array_document(array: &ArrayMeasurement) -> Value {
    Value::Object(fields_of_array(array, &array.lens_types))
}

fn fields_of_array(array: &ArrayMeasurement, types: &LensTypes) -> Map<String, Value> {
    let (grid, out) = (&array.grid, &array.left_out);
    let document = json!({
        "format": PRECALIBRATION_FORMAT,
        "version": PRECALIBRATION_VERSION,
        "micro_image_array": {
            "lattice": grid.lattice.kind(),
            "columns": grid.lattice.columns,
            "rows": grid.lattice.rows,
            "shifted": grid.lattice.packing.shifted(),
            "pitch_px": grid.pitch_px,
            "rotation_rad": grid.rotation_rad,
            "center_px": <[f64; 2]>::from(grid.center_px),
            "perspective_per_px": <[f64; 2]>::from(grid.perspective_per_px),
            "rms_px": grid.rms_px,
        },
        "centers": {
            "measured": array.centers.len(),
            "cut": out.cut,
            "dark": out.dark,
            "saturated": out.saturated,
            "misplaced": out.misplaced,
        },
        "lens_types": {
            "count": types.types,
            "separation": types.separation,
            "agreement": types.agreement,
        },
    });
    match document {
        Value::Object(fields) => fields,
        _ => Map::new(),
    }
}

/// Returns the content of `precalibration.json`; lens types count from 1.
#[must_use]
pub fn precalibration_document(result: &Precalibration) -> Value {
    let internal = &result.internal;
    let radii: Vec<Value> = result
        .radii
        .iter()
        .map(|r| {
            json!({
                "f_number": r.f_number,
                "lens_type": r.lens_type + 1,
                "radius_px": r.radius_px,
                "standard_deviation_px": r.std_dev_px,
                "residual_px": r.residual_px,
                "micro_images": r.single_px.len(),
            })
        })
        .collect();
    let mut fields = fields_of_array(&result.array, &result.lens_types);
    let mut parameters = json!(internal.parameters);
    if let Value::Object(fields) = &mut parameters {
        let mut std_devs = Map::new();
        for name in WITH_STD_DEV {
            std_devs.insert(name.to_owned(), json!(fields.remove(&std_dev_key(name))));
        }
        fields.insert(STD_DEVS.to_owned(), std_devs.into());
        fields.insert(RMS.to_owned(), internal.rms_px.into());
    }
    fields.insert("internal_parameters".to_owned(), parameters);
    fields.insert("cell_share".to_owned(), json!(result.cell_share));
    fields.insert("radii".to_owned(), json!(radii));
    fields.insert("pitch_correction".to_owned(), json!(result.pitch_correction));
    Value::Object(fields)
}

/// Returns columns and rows of the array, including micro-lenses that the border of the image cuts; `None` if the file lacks
/// them.
pub(super) fn array_size_from(value: Value) -> Result<Option<(i32, i32)>> {
    let file: PrecalibrationFile = document_of(value, PRECALIBRATION_FORMAT)?;
    Ok(file.micro_image_array.map(|array| (array.columns, array.rows)))
}

/// Returns the internal parameters in a JSON document.
pub(super) fn internal_parameters_from(value: Value) -> Result<InternalParameters> {
    check_version(&value, PRECALIBRATION_FORMAT, PRECALIBRATION_VERSION)?;
    let file: PrecalibrationFile = document_of(value, PRECALIBRATION_FORMAT)?;
    let mut internal = file.internal_parameters.ok_or_else(|| {
        Error::invalid(
            "this pre-calibration is from one image and has no internal parameters: repeat it with \
             white images at several f-numbers",
        )
    })?;
    if let Value::Object(fields) = &mut internal {
        fields.remove(RMS);
        if let Some(Value::Object(mut std_devs)) = fields.remove(STD_DEVS) {
            for name in WITH_STD_DEV {
                if let Some(value) = std_devs.remove(name).filter(|value| !value.is_null()) {
                    fields.insert(std_dev_key(name), value);
                }
            }
        }
    }
    serde_path_to_error::deserialize(internal).map_err(|e| {
        let message = plain(&e.inner().to_string());
        Error::invalid(format!("internal_parameters.{}: {message}", e.path()))
    })
}

/// Writes the centres of an array as CSV, with the standard deviation per axis of each if it was measured; lens types count
/// from 0 in `lens_type` and from 1 in the file.
pub fn write_measured_centers(
    out: &mut dyn Write,
    array: &ArrayMeasurement,
    lens_type: impl Fn(&MicroImageCenter) -> usize,
) -> io::Result<()> {
    writeln!(out, "k,l,u,v,std_dev,type")?;
    array.centers.iter().try_for_each(|c| {
        let std_dev = std_dev_text(c.std_dev_px);
        writeln!(out, "{},{},{},{},{std_dev},{}", c.k, c.l, c.u_px, c.v_px, lens_type(c) + 1)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The document has names of fields before 0.1.0, and σ that are not known.
    #[test]
    fn internal_parameters_of_earlier_files_are_read() {
        let document = |internal: Value| {
            json!({
                "format": PRECALIBRATION_FORMAT,
                "version": PRECALIBRATION_VERSION,
                "internal_parameters": internal,
            })
        };
        let read = |internal: Value| internal_parameters_from(document(internal));
        let earlier = read(json!({
            "m_mm": 0.14,
            "q_prime_mm": [0.035],
            "standard_deviations": { "m_mm": 0.001, "q_prime_mm": null },
            "rms_px": 0.01,
            "fill_factor": { "value": 0.9, "std_dev": 0.01 },
            "lean": { "growth_per_px": [1e-6, 2e-6], "std_dev_per_px": [1e-7, 1e-7] },
            "point_spread": { "value": 0.3, "std_dev": 0.1 },
        }))
        .unwrap();
        assert_eq!((earlier.m_std_dev_mm, earlier.q_prime_std_dev_mm), (Some(0.001), vec![]));
        assert_eq!(earlier.aperture_ratio.unwrap().value.to_bits(), 0.9_f64.to_bits());
        assert_eq!(earlier.tilt_gradient.unwrap().growth_per_px[1].to_bits(), 2e-6_f64.to_bits());
        assert_eq!(earlier.point_spread_px2.unwrap().value.to_bits(), 0.3_f64.to_bits());
        let error = read(json!({ "m_mm": "wide", "q_prime_mm": [0.035] })).unwrap_err();
        assert!(error.to_string().starts_with("internal_parameters.m_mm: "), "{error}");
    }
}
