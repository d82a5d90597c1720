//! `precalibration.json`: the micro-image array and the internal parameters; and centers.csv beside
//! it.

use std::io::{self, Write};

use serde::Deserialize;
use serde_json::{Map, Value, json};

use super::json_file::document_of;
use super::observations_file::std_dev_text;
use crate::error::{Error, Result};
use crate::model::{FallOff, InternalParameters, Lean, MicroImageCenter, SampleLevels};
use crate::precalibration::{ArrayMeasurement, LensTypes, Precalibration};
use crate::quantity::Estimate;

/// `format` of the file.
pub const PRECALIBRATION_FORMAT: &str = "plenocal-precalibration";
/// `version` of the file.
pub const PRECALIBRATION_VERSION: u64 = 1;

#[derive(Deserialize)]
struct PrecalibrationFile {
    version: u64,
    internal_parameters: Option<InternalFile>,
    micro_image_array: Option<ArraySize>,
}

#[derive(Deserialize)]
struct ArraySize {
    columns: i32,
    rows: i32,
}

#[derive(Deserialize)]
struct InternalFile {
    m_mm: f64,
    q_prime_mm: Vec<f64>,
    micro_image_pitch_mm: Option<f64>,
    standard_deviations: Option<InternalStdDevs>,
    #[serde(default)]
    pupil_growth: f64,
    fall_off: Option<FallOff>,
    lean: Option<Lean>,
    #[serde(alias = "point_spread")]
    point_spread_px2: Option<Estimate>,
    #[serde(alias = "fill_factor")]
    aperture_ratio: Option<Estimate>,
    levels: Option<SampleLevels>,
}

#[derive(Deserialize)]
struct InternalStdDevs {
    m_mm: f64,
    q_prime_mm: Vec<f64>,
}

/// The content of `precalibration.json` where only an array was measured.
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

/// The content of `precalibration.json`; lens types count from 1.
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
    fields.insert(
        "internal_parameters".to_owned(),
        json!({
            "m_mm": internal.parameters.m_mm,
            "q_prime_mm": internal.parameters.q_prime_mm,
            "micro_image_pitch_mm": internal.parameters.micro_image_pitch_mm,
            "standard_deviations": {
                "m_mm": internal.parameters.m_std_dev_mm,
                "q_prime_mm": internal.parameters.q_prime_std_dev_mm,
            },
            "pupil_growth": internal.parameters.pupil_growth,
            "fall_off": internal.parameters.fall_off,
            "lean": internal.parameters.lean,
            "point_spread_px2": internal.parameters.point_spread_px2,
            "aperture_ratio": internal.parameters.aperture_ratio,
            "levels": internal.parameters.levels,
            "rms_px": internal.rms_px,
        }),
    );
    fields.insert("radii".to_owned(), json!(radii));
    fields.insert("pitch_correction".to_owned(), json!(result.pitch_correction));
    Value::Object(fields)
}

/// Columns and rows of the array, counting micro-lenses that the border of the image cuts; `None` in a file without them.
pub(super) fn array_size_from(value: Value) -> Result<Option<(i32, i32)>> {
    let file: PrecalibrationFile = document_of(value, PRECALIBRATION_FORMAT)?;
    Ok(file.micro_image_array.map(|array| (array.columns, array.rows)))
}

/// The internal parameters in a JSON document.
pub(super) fn internal_parameters_from(value: Value) -> Result<InternalParameters> {
    let file: PrecalibrationFile = document_of(value, PRECALIBRATION_FORMAT)?;
    if file.version != PRECALIBRATION_VERSION {
        return Err(Error::invalid(format!(
            "this is a {PRECALIBRATION_FORMAT} file of version {}, but only version \
             {PRECALIBRATION_VERSION} is known",
            file.version
        )));
    }
    let internal = file.internal_parameters.ok_or_else(|| {
        Error::invalid(
            "this pre-calibration is from one image and has no internal parameters; these need \
             white images at several f-numbers",
        )
    })?;
    let std_devs = internal.standard_deviations;
    Ok(InternalParameters {
        m_mm: internal.m_mm,
        q_prime_mm: internal.q_prime_mm,
        micro_image_pitch_mm: internal.micro_image_pitch_mm,
        m_std_dev_mm: std_devs.as_ref().map(|s| s.m_mm),
        q_prime_std_dev_mm: std_devs.map(|s| s.q_prime_mm).unwrap_or_default(),
        pupil_growth: internal.pupil_growth,
        fall_off: internal.fall_off,
        lean: internal.lean,
        point_spread_px2: internal.point_spread_px2,
        aperture_ratio: internal.aperture_ratio,
        levels: internal.levels,
    })
}

/// Writes the centres of an array as CSV, with the standard deviation per axis of each where it was
/// measured; lens types count from 0 in `lens_type` and from 1 in the file.
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
