//! Readers of a camera, internal parameters, a board or poses from any kind of file that contains them. Kinds are recognised by
//! content.

use std::path::Path;

use serde_json::Value;

use super::json_file::json_from;
use super::{
    PRECALIBRATION_FORMAT, Project, camera_file, compote, poses_file, precalibration_file,
    read_text,
};
use crate::error::{Error, Result};
use crate::model::{Board, Datasheet, FramePose, InternalParameters, PlenopticCamera};

/// Content of a camera file.
#[derive(Debug, Clone, PartialEq)]
pub enum CameraSource {
    /// Datasheet values of a camera that is not calibrated yet.
    Datasheet(Datasheet),
    /// Calibrated camera.
    Camera(Box<PlenopticCamera>),
}

/// Parsed content of a file.
enum Document {
    Project(Box<Project>),
    Json(Value),
}

fn read_document(path: &Path) -> Result<Document> {
    let text = read_text(path)?;
    let text = text.trim_start_matches('\u{feff}'); // the byte order mark of some editors
    if text.trim().is_empty() {
        return Err(Error::content(path, "the file is empty"));
    }
    if let Ok(value @ (Value::Null | Value::Bool(_) | Value::Number(_) | Value::String(_))) =
        serde_json::from_str(text)
    {
        let message = format!("it contains only {value}: give a file with all fields");
        return Err(Error::content(path, message));
    }
    if path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("csv")) {
        return Err(Error::content(path, "it is a CSV table: give a JSON or project file"));
    }
    // A table of a project file also begins with a bracket, but a name follows.
    let inside = text.trim_start().trim_start_matches(['[', ' ']);
    let is_table = text.trim_start().starts_with('[') && inside.starts_with(char::is_alphabetic);
    if text.trim_start().starts_with(['{', '[']) && !is_table {
        return json_from(text).map(Document::Json).map_err(|e| e.in_file(path));
    }
    Ok(Document::Project(Box::new(Project::read(path)?)))
}

fn is_format(value: &Value, format: &str) -> bool {
    value.get("format").and_then(Value::as_str) == Some(format)
}

/// Returns the kind of a JSON document, by its `format` or by a field that only one of COMPOTE's files has.
fn kind_of(value: &Value) -> Option<String> {
    const FIELDS: [(&str, &str); 5] = [
        ("poses", "poses.js of COMPOTE"),
        ("checkerboards", "scene.js of COMPOTE"),
        ("q_prime", "params.js of COMPOTE"),
        ("mla", "intrinsics.js of COMPOTE"),
        ("mia", "camera.js of COMPOTE"),
    ];
    let format = value.get("format").and_then(Value::as_str);
    let of_field = || FIELDS.iter().find(|(field, _)| value.get(field).is_some());
    let named = format.map(|format| format!("a file of the format {format}"));
    named.or_else(|| of_field().map(|(_, file)| (*file).to_owned()))
}

/// Returns the document, unless it is recognised as another file than the wanted ones of COMPOTE.
fn wanted(value: Value, files: &[&str]) -> Result<Value> {
    match kind_of(&value) {
        Some(kind) if !files.iter().any(|file| kind.starts_with(file)) => {
            let ours = match files {
                ["poses.js"] => "poses.json",
                ["params.js"] => "precalibration.json",
                ["scene.js"] => "a project file with [board]",
                _ => "camera.json, a project file",
            };
            Err(Error::invalid(format!(
                "it seems to be {kind}: give {ours} or COMPOTE's {}",
                files.join(" or ")
            )))
        }
        _ => Ok(value),
    }
}

/// Reads a camera: `camera.json`, COMPOTE's `intrinsics.js` or `camera.js`, or the tables of a
/// project file.
pub fn read_camera_source(path: &Path) -> Result<CameraSource> {
    let source = match read_document(path)? {
        Document::Project(project) => project.datasheet().and_then(|sheet| {
            let sheet = sheet.ok_or_else(|| {
                Error::invalid(
                    "this project file has no camera: add [sensor], [main_lens] and \
                     [micro_lens_array]",
                )
            })?;
            sheet.validate().map(|()| CameraSource::Datasheet(sheet))
        }),
        Document::Json(value) if is_format(&value, camera_file::CAMERA_FORMAT) => {
            camera_file::camera_from(value).map(|camera| CameraSource::Camera(Box::new(camera)))
        }
        Document::Json(value) if value.get("mla").is_some() => {
            compote::camera_from(value).map(|camera| CameraSource::Camera(Box::new(camera)))
        }
        Document::Json(value) => wanted(value, &["camera.js", "intrinsics.js"])
            .and_then(compote::datasheet_from)
            .map(CameraSource::Datasheet),
    };
    source.map_err(|e| e.in_file(path))
}

/// Reads internal parameters: `precalibration.json`, COMPOTE's `params.js` or a project file. An error if they were measured
/// with another pixel size, mm, than the given one.
pub fn read_internal_parameters(
    path: &Path,
    pixel_size_mm: Option<f64>,
) -> Result<InternalParameters> {
    let internal = match read_document(path)? {
        Document::Project(project) => project
            .internal_parameters
            .ok_or_else(|| Error::invalid("it has no table [internal_parameters]")),
        Document::Json(value) if is_format(&value, PRECALIBRATION_FORMAT) => {
            precalibration_file::internal_parameters_from(value)
        }
        Document::Json(value) => wanted(value, &["params.js"])
            .and_then(|value| compote::internal_parameters_from(value, pixel_size_mm)),
    };
    internal.map_err(|e| e.in_file(path))
}

/// Reads the number of columns and rows of an array from `precalibration.json`; `None` if a file of internal parameters does
/// not state them.
pub fn read_array_size(path: &Path) -> Result<Option<(i32, i32)>> {
    match read_document(path)? {
        Document::Json(value) if is_format(&value, PRECALIBRATION_FORMAT) => {
            precalibration_file::array_size_from(value).map_err(|e| e.in_file(path))
        }
        Document::Json(_) | Document::Project(_) => Ok(None),
    }
}

/// Reads a board: COMPOTE's `scene.js` or a project file.
pub fn read_board(path: &Path) -> Result<Board> {
    let board = match read_document(path)? {
        Document::Project(project) => {
            project.board.ok_or_else(|| Error::invalid("it has no table [board]"))
        }
        Document::Json(value) => wanted(value, &["scene.js"]).and_then(compote::board_from),
    };
    board.and_then(|board| board.validate().map(|()| board)).map_err(|e| e.in_file(path))
}

/// Reads poses: `poses.json` or COMPOTE's `poses.js`.
pub fn read_poses(path: &Path) -> Result<Vec<FramePose>> {
    let poses = match read_document(path)? {
        Document::Project(_) => Err(Error::invalid("a project file has no poses: give poses.json")),
        Document::Json(value) if is_format(&value, poses_file::POSES_FORMAT) => {
            poses_file::poses_from(value)
        }
        Document::Json(value) => wanted(value, &["poses.js"]).and_then(compote::poses_from),
    };
    let poses = poses.and_then(poses_file::of_different_frames);
    poses.and_then(poses_file::before_the_camera).map_err(|e| e.in_file(path))
}
