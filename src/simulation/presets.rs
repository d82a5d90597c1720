//! The settings of a simulated data set as text (TOML), and the presets.

use std::path::Path;

use nalgebra::{Vector2, Vector3};
use toml::{Table, Value};

use super::settings::Settings;
use crate::error::{Error, Result};
use crate::model::PlenopticCamera;
use crate::table::{finite, replace};

/// A simulation file that comes with plenocal, or one with another lens.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Preset {
    /// Name of the preset.
    pub name: &'static str,
    /// Text of the file.
    pub text: &'static str,
    /// Values that replace values of the file, as `key=value`.
    pub changes: &'static [&'static str],
}

macro_rules! file {
    ($name:literal) => {
        Preset {
            name: $name,
            text: include_str!(concat!("../../data/presets/", $name, ".toml")),
            changes: &[],
        }
    };
}

/// Camera with another lens than the double Gauss: the f-number of boards and of the brightest white image, or other values,
/// as this lens needs them.
macro_rules! with_lens {
    ($camera:literal, $lens:literal, f / $f_number:literal) => {
        with_lens!(
            $camera,
            $lens,
            concat!("camera.main_lens.f_number=", $f_number),
            concat!(
                "white_images.f_numbers=[",
                $f_number,
                ", 5.656854249492381, 8.0, 11.313708498984761, 16.0]"
            )
        )
    };
    ($camera:literal, $lens:literal $(, $change:expr)*) => {
        Preset {
            name: concat!($camera, "-", $lens),
            text: include_str!(concat!("../../data/presets/", $camera, "-double-gauss.toml")),
            changes: &[concat!("prescription=", $lens) $(, $change)*],
        }
    };
}

/// All presets: files in `data/presets`, and the cameras `mini` and `r12` with the other lenses of `data/lenses`.
///
/// The further in front of the lens the exit pupil lies, the wider is the light of an f-number at the array. With the
/// f-numbers below, micro-images touch, as they do at f/4 with an exit pupil in the principal plane. The triplet is
/// corrected for f/4.5 only.
pub const PRESETS: [Preset; 23] = [
    file!("mini"),
    file!("r12-a"),
    file!("r12-b"),
    file!("r12-c"),
    file!("lytro-like"),
    file!("keplerian"),
    file!("mini-double-gauss"),
    with_lens!(
        "mini",
        "telephoto",
        "camera.main_lens.focal_length_mm=15.68",
        "camera.main_lens.focus_distance_mm=123.0",
        "camera.micro_lens_array.lens_to_mla_mm=17.75"
    ),
    file!("r12-double-gauss"),
    with_lens!(
        "r12",
        "telephoto",
        "camera.main_lens.focal_length_mm=49.0",
        "camera.main_lens.focus_distance_mm=428.0",
        "camera.micro_lens_array.lens_to_mla_mm=55.73"
    ),
    file!("real-a"),
    file!("real-b"),
    file!("real-c"),
    with_lens!("mini", "petzval"),
    with_lens!("mini", "triplet", f / 4.5),
    with_lens!("mini", "tessar"),
    with_lens!("mini", "retrofocus", f / 4.25),
    with_lens!("mini", "near-telecentric", f / 4.5),
    with_lens!("r12", "petzval"),
    with_lens!("r12", "triplet", f / 4.5),
    with_lens!("r12", "tessar"),
    with_lens!("r12", "retrofocus", f / 4.25),
    with_lens!("r12", "near-telecentric", f / 4.5),
];

impl Settings {
    /// Returns the settings of a preset with some values replaced, see [`Settings::from_toml`].
    pub fn preset(name: &str, replaced: &[String]) -> Result<Self> {
        Self::preset_and_files(name, replaced, &no_files)
    }

    /// Does the same as [`Settings::preset`]; `read` returns the text of the file that a prescription names.
    pub fn preset_and_files(
        name: &str,
        replaced: &[String],
        read: &dyn Fn(&str) -> Result<String>,
    ) -> Result<Self> {
        let Some(preset) = PRESETS.iter().find(|preset| preset.name == name) else {
            let names = PRESETS.map(|preset| preset.name).join(", ");
            return Err(Error::invalid(format!(
                "there is no preset '{name}': give one of {names}"
            )));
        };
        let changes = preset.changes.iter().map(|&change| change.to_owned());
        let all: Vec<String> = changes.chain(replaced.iter().cloned()).collect();
        Self::from_toml_and_files(preset.text, &all, read)
            .map_err(|e| Error::invalid(format!("preset {name}: {e}")))
    }

    /// Reads settings from the text of a simulation file. The `key=value` pairs in `replaced` take precedence over the file:
    /// keys have dots for tables, values are TOML or plain strings. `axis_px` is the place of the optical axis from the middle of
    /// the sensor: it sets the principal point, and the array keeps its place on the sensor.
    pub fn from_toml(text: &str, replaced: &[String]) -> Result<Self> {
        settings_from(text, replaced, &no_files)
    }

    /// Does the same as [`Settings::from_toml`]; `read` returns the text of the file that a prescription names.
    pub fn from_toml_and_files(
        text: &str,
        replaced: &[String],
        read: &dyn Fn(&str) -> Result<String>,
    ) -> Result<Self> {
        settings_from(text, replaced, read)
    }

    /// Returns the settings as the text of a simulation file.
    pub fn to_toml(&self) -> Result<String> {
        toml::to_string(self)
            .map(|text| format!("{text}{LEFT_OUT}"))
            .map_err(|e| Error::invalid(format!("the settings cannot be written: {e}")))
    }
}

/// Optional settings, which [`Settings::to_toml`] appends as comments.
const LEFT_OUT: &str = "
# Optional:
#
# [imperfections.second_stop]   # cuts oblique rays
# z_mm = -9.0                   # from the main lens, negative towards the array
# diameter_mm = 4.0
#
# white_images.exposure and white_images.gain; default: as in imaging.
# axis_px = [0, 0], the optical axis from the middle of the sensor; default: principal_point_px.
# engraved_f_number; default: as in the main lens. imaging.jpeg_quality; default: PNG.
# Every setting is explained in docs/simulation.md.
";

/// Returns true if a prescription is the name of a file.
fn is_file(name: &str) -> bool {
    Path::new(name).extension().is_some_and(|extension| extension.eq_ignore_ascii_case("toml"))
}

fn no_files(file: &str) -> Result<String> {
    Err(Error::invalid(format!(
        "the prescription {file} is a file: read it, or give its surfaces instead"
    )))
}

fn settings_from(
    text: &str,
    replaced: &[String],
    read: &dyn Fn(&str) -> Result<String>,
) -> Result<Settings> {
    let wrong =
        |e: &dyn std::fmt::Display| Error::invalid(format!("not a valid simulation file: {e}"));
    let mut table: Table = text.parse().map_err(|e: toml::de::Error| wrong(&e))?;
    for pair in replaced {
        replace(&mut table, pair)?;
    }
    let old = table.get("imperfections").and_then(|table| table.get("exit_pupil_mm"));
    if let Some(z) = old {
        return Err(wrong(&format!(
            "imperfections.exit_pupil_mm is not a setting: set the exit pupil of the camera, \
             camera.main_lens.exit_pupil_mm = [0, 0, {z}]"
        )));
    }
    let file = table.get("prescription").and_then(Value::as_str).filter(|name| is_file(name));
    let prescription =
        file.map(|file| read(file).map(|text| (file.to_owned(), text))).transpose()?;
    if let Some((file, text)) = &prescription {
        let surfaces: Table = text.parse().map_err(|e| {
            Error::invalid(format!("{file} is not a valid prescription of a lens: {e}"))
        })?;
        table.insert("prescription".to_owned(), Value::Table(surfaces));
    }
    finite(&table)?;
    let axis: Option<[f64; 2]> = table
        .remove("axis_px")
        .map(Value::try_into)
        .transpose()
        .map_err(|e| wrong(&format!("axis_px, the place of the optical axis: {e}")))?;
    // Errors of a text without replaced values can name the line.
    let mut unknown = Vec::new();
    let mut note = |path: serde_ignored::Path| unknown.push(path.to_string());
    let as_written = replaced.is_empty() && prescription.is_none() && axis.is_none();
    let mut settings: Settings = if as_written {
        let document = toml::Deserializer::parse(text).map_err(|e| wrong(&e))?;
        serde_ignored::deserialize(document, &mut note).map_err(|e| wrong(&e))?
    } else {
        serde_ignored::deserialize(table, &mut note).map_err(|e| wrong(&e))?
    };
    if let Some(key) = unknown.first() {
        return Err(Error::invalid(format!("a simulation file has no setting '{key}'")));
    }
    if let Some(axis) = axis {
        move_axis(&mut settings.camera, axis);
    }
    if let Some(prescription) = &settings.prescription {
        let lens = &mut settings.camera.main_lens;
        if lens.exit_pupil_mm == Vector3::zeros() {
            lens.exit_pupil_mm.z = prescription.exit_pupil_z(lens.focal_length_mm)?;
        }
    }
    settings.validate()?;
    Ok(settings)
}

/// Moves the optical axis to a place from the middle of the sensor. The array keeps its place on the sensor.
fn move_axis(camera: &mut PlenopticCamera, axis_px: [f64; 2]) {
    let of_tilt = camera.axis_px() - camera.mla.principal_point_px;
    let place = camera.sensor.center_px() + Vector2::from(axis_px) - of_tilt;
    let mla = &mut camera.mla;
    mla.offset_mm += (place - mla.principal_point_px) * camera.sensor.pixel_size_mm;
    mla.principal_point_px = place;
}
