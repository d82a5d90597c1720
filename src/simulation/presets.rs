//! The settings of a simulated data set as text (TOML), and the presets.

use std::path::Path;

use nalgebra::Vector3;
use toml::{Table, Value};

use super::settings::Settings;
use crate::error::{Error, Result};
use crate::table::{finite, replace};

/// A simulation file that comes with plenocal.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Preset {
    /// Name of the preset.
    pub name: &'static str,
    /// Text of the file.
    pub text: &'static str,
}

macro_rules! presets {
    ($($name:literal),*) => {
        [$(Preset {
            name: $name,
            text: include_str!(concat!("../../data/presets/", $name, ".toml")),
        }),*]
    };
}

/// All presets: files in `data/presets`.
pub const PRESETS: [Preset; 12] = presets![
    "mini",
    "r12-a",
    "r12-b",
    "r12-c",
    "lytro-like",
    "keplerian",
    "mini-double-gauss",
    "mini-telephoto",
    "r12-double-gauss",
    "r12-telephoto",
    "real-a",
    "real-b"
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
        Self::from_toml_and_files(preset.text, replaced, read)
            .map_err(|e| Error::invalid(format!("preset {name}: {e}")))
    }

    /// Reads settings from the text of a simulation file. The `key=value` pairs in `replaced` take precedence over the file:
    /// keys have dots for tables, values are TOML or plain strings.
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
    // Errors of a text without replaced values can name the line.
    let mut unknown = Vec::new();
    let mut note = |path: serde_ignored::Path| unknown.push(path.to_string());
    let mut settings: Settings = if replaced.is_empty() && prescription.is_none() {
        let document = toml::Deserializer::parse(text).map_err(|e| wrong(&e))?;
        serde_ignored::deserialize(document, &mut note).map_err(|e| wrong(&e))?
    } else {
        serde_ignored::deserialize(table, &mut note).map_err(|e| wrong(&e))?
    };
    if let Some(key) = unknown.first() {
        return Err(Error::invalid(format!("a simulation file has no setting '{key}'")));
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
