//! `camera.json`: calibrated camera with the uncertainty of its parameters.
//!
//! The unit of every number is in its name. The meaning of the numbers is documented at
//! [`PlenopticCamera`]. A reader has to check `format` and `version` first.

use std::fs;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use serde::Serialize;
use serde_json::{Map, Value, json};

use super::json_file::{check_version, document_of, read_json};
use super::spelling::meant;
use crate::assessment::Verdict;
use crate::error::{Error, Result};
use crate::finding::{Finding, Issue, Subject};
use crate::model::{EdgeSpread, Parameter, PlenopticCamera};
use crate::quantity::Estimate;
use crate::solver::Uncertainty;

/// Value of `format` in the file.
pub const CAMERA_FORMAT: &str = "plenocal-camera";
/// Value of `version` in the file. Files of version 1 have neither an exit pupil nor a field curvature: both are 0.
pub const CAMERA_VERSION: u64 = 2;

#[derive(Serialize)]
struct CameraFile {
    format: String,
    version: u64,
    #[serde(flatten)]
    camera: PlenopticCamera,
}

/// Returns the content of `camera.json`: the camera and, if known, the standard deviation of every free parameter with the
/// correlations between them, by the names of the parameters.
#[must_use]
pub fn camera_document(camera: &PlenopticCamera, uncertainty: Option<&Uncertainty>) -> Value {
    let mut document = json!(CameraFile {
        format: CAMERA_FORMAT.to_owned(),
        version: CAMERA_VERSION,
        camera: camera.clone(),
    });
    if let Some(depth_from_blur) = depth_from_blur_document(&camera.edge_spread) {
        document["depth_from_blur"] = depth_from_blur;
    }
    if let (Some(uncertainty), Some(fields)) = (uncertainty, document.as_object_mut()) {
        fields.insert("uncertainty".to_owned(), uncertainty_document(camera, uncertainty));
    }
    document
}

/// Returns the blur of a point, for depth from blur: σ² = (κρ)² + s²; `None` if the aperture ratio is not known.
fn depth_from_blur_document(edges: &EdgeSpread) -> Option<Value> {
    let Estimate { value, std_dev } = edges.spread_per_radius()?;
    Some(json!({
        "spread_per_radius": value,
        "spread_per_radius_std_dev": std_dev,
        "point_spread_px2": edges.point_spread_px2.map(|spread| spread.value),
    }))
}

fn uncertainty_document(camera: &PlenopticCamera, uncertainty: &Uncertainty) -> Value {
    let parameters = Parameter::intrinsic(camera.lens_types());
    let std_devs: Map<String, Value> = parameters
        .iter()
        .zip(uncertainty.intrinsic_std_devs(camera.lens_types()))
        .filter_map(|(p, std_dev)| {
            Some((p.name().to_owned(), json!({ "value": std_dev?, "unit": p.unit() })))
        })
        .collect();
    // The indices after the parameters of the camera belong to the board.
    let free = uncertainty.free_intrinsics.iter();
    let names: Vec<&str> = free.map_while(|&i| Some(parameters.get(i)?.name())).collect();
    let correlations = uncertainty.intrinsic_correlations();
    let of_camera = correlations.view((0, 0), (names.len(), names.len()));
    let rows: Vec<Vec<f64>> =
        of_camera.row_iter().map(|row| row.iter().copied().collect()).collect();
    json!({
        "standard_deviations": std_devs,
        "correlations": { "parameters": names, "matrix": rows },
        "errors": errors_text(uncertainty),
        "parameters": uncertainty.size(),
        "rank": uncertainty.rank,
    })
}

/// Describes which observations are assumed to share errors.
pub(super) fn errors_text(uncertainty: &Uncertainty) -> &'static str {
    match (uncertainty.shared, uncertainty.free_intrinsics.is_empty()) {
        (_, true) => "shared by corners",
        (true, false) => "shared by frames",
        (false, false) => "independent",
    }
}

/// Name of the file written by commands.
const NAME: &str = "camera.json";
/// Depth of the search for cameras in folders, as for `results/calibration` in the folder of a project.
const DEPTH: usize = 2;
/// Largest number of cameras that are named.
const MOST_CAMERAS: usize = 4;

/// Returns the camera files in a folder and its subfolders, by their names; files in fewer folders come first.
#[must_use]
pub fn cameras_in(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut folders = vec![folder.to_owned()];
    for _ in 0..=DEPTH {
        folders.sort();
        found.extend(folders.iter().map(|folder| folder.join(NAME)).filter(|file| file.is_file()));
        let inside = folders.iter().filter_map(|folder| fs::read_dir(folder).ok());
        let inside = inside.flat_map(|entries| entries.flatten().map(|entry| entry.path()));
        folders = inside.filter(|path| path.is_dir() && !path.is_symlink()).collect();
    }
    found.truncate(MOST_CAMERAS);
    found
}

/// Reads the camera of a `camera.json`.
pub fn read_camera(path: &Path) -> Result<PlenopticCamera> {
    let value = read_json(path)?;
    camera_from(value).map_err(|e| e.in_file(path))
}

/// Returns findings about the calibration of the camera in a `camera.json`: that it did not converge, did not determine some
/// parameters, or ended in the verdict "do not use". Empty without such problems, or if the file has no information about a
/// calibration.
#[must_use]
pub fn camera_findings(document: &Value) -> Vec<Finding> {
    let mut issues = Vec::new();
    if document["converged"] == Value::Bool(false) {
        issues.push(Issue::CameraNotConverged);
    }
    let std_devs = document["uncertainty"]["standard_deviations"].as_object();
    let unknown = |(name, entry): (&String, &Value)| {
        entry.get("value").is_some_and(Value::is_null).then(|| name.clone())
    };
    let names: Vec<String> = std_devs.into_iter().flatten().filter_map(unknown).collect();
    if !names.is_empty() {
        issues.push(Issue::CameraUndetermined { names });
    }
    let verdict = &document["verdict"];
    if issues.is_empty() && verdict["verdict"] == Verdict::DoNotUse.to_string() {
        let reasons = verdict["reasons"].as_array().into_iter().flatten();
        let reasons = reasons.filter_map(Value::as_str).map(str::to_owned).collect();
        issues.push(Issue::CameraNotToBeUsed { reasons });
    }
    issues.into_iter().map(Finding::unusable).collect()
}

/// Reads the findings of [`camera_findings`] about the camera in a file; COMPOTE's files have none.
pub fn read_camera_findings(path: &Path) -> Result<Vec<Finding>> {
    let about = |finding: Finding| finding.about(Subject::File(path.to_owned()));
    Ok(camera_findings(&read_json(path)?).into_iter().map(about).collect())
}

/// Reads the nearest and furthest distance (mm) of the boards of the calibration, at their corner 0, from a `camera.json`;
/// `None` if the file does not state them.
pub fn read_board_distances(path: &Path) -> Result<Option<[f64; 2]>> {
    let boards = &read_json(path)?["boards"];
    let [near, far] = ["near_mm", "far_mm"].map(|name| boards[name].as_f64());
    Ok(near.zip(far).map(|(near, far)| [near, far]))
}

/// Reads the standard deviations in a `camera.json`, in the order of [`PlenopticCamera::intrinsics`]; `None` for parameters
/// that were fixed or not determined, and if the file has none.
///
/// An error names an impossible standard deviation.
pub fn read_std_devs(path: &Path, lens_types: usize) -> Result<Vec<Option<f64>>> {
    let value = read_json(path)?;
    let std_devs = &value["uncertainty"]["standard_deviations"];
    let of_parameter = |p: &Parameter| match std_devs[p.name()]["value"].as_f64() {
        Some(std_dev) if !POSSIBLE_STD_DEVS.contains(&std_dev) => Err(Error::content(
            path,
            format!(
                "uncertainty.standard_deviations.{} is {std_dev:e}, but has to be from {:e} to \
                 {:e}: write null if it is not known",
                p.name(),
                POSSIBLE_STD_DEVS.start(),
                POSSIBLE_STD_DEVS.end()
            ),
        )),
        std_dev => Ok(std_dev),
    };
    Parameter::intrinsic(lens_types).iter().map(of_parameter).collect()
}

/// Possible standard deviations, in the units of the parameters. Differences over a smaller one, and squares of a larger one,
/// are not finite; for real cameras they are between 1e-12 and 1e3.
const POSSIBLE_STD_DEVS: RangeInclusive<f64> = 1e-30..=1e30;

/// Keys of the file beside the keys of the camera.
const BESIDE: [&str; 7] =
    ["format", "version", "uncertainty", "boards", "verdict", "converged", "depth_from_blur"];
/// Keys of the camera itself; the last one is an earlier name of the key before it.
const OF_CAMERA: [&str; 6] = [
    "sensor",
    "main_lens",
    "principal_point_px",
    "micro_lens_array",
    "point_spread_px2",
    "point_spread",
];

/// Returns the camera in a JSON document.
pub(super) fn camera_from(mut value: Value) -> Result<PlenopticCamera> {
    check_version(&value, CAMERA_FORMAT, CAMERA_VERSION)?;
    if let Some(fields) = value.as_object_mut() {
        let known = BESIDE.into_iter().chain(OF_CAMERA);
        if let Some(key) = fields.keys().find(|key| !known.clone().any(|known| known == *key)) {
            let instead = meant(key, known).map_or_else(
                || "leave it out".to_owned(),
                |meant| format!("did you mean '{meant}'?"),
            );
            return Err(Error::invalid(format!(
                "'{key}' is not a key of a {CAMERA_FORMAT} file: {instead}"
            )));
        }
        check_boards(&fields.get("boards").cloned().unwrap_or_default())?;
        fields.retain(|key, _| OF_CAMERA.contains(&key.as_str()));
    }
    let camera: PlenopticCamera = document_of(value, CAMERA_FORMAT)?;
    camera.validate()?;
    Ok(camera)
}

fn check_boards(boards: &Value) -> Result<()> {
    let [near, far] = ["near_mm", "far_mm"].map(|name| boards[name].as_f64());
    match near.zip(far) {
        Some((near, far)) if !(0.0 < near && near <= far) => Err(Error::invalid(format!(
            "in boards: near_mm is {near} and far_mm is {far}, but 0 < near_mm ≤ far_mm is needed: \
             correct them, or leave boards out"
        ))),
        _ => Ok(()),
    }
}
