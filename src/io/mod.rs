//! Files of plenocal and COMPOTE. They are recognised by content, and written all together or not at all.

mod board_shape_file;
mod calibration_file;
mod camera_file;
mod comparison_file;
pub mod compote;
mod data_set_folder;
mod detection_file;
mod evaluation_file;
mod first_look;
mod folder_lock;
mod image_file;
mod image_folder;
mod input;
mod json_file;
mod manifest;
mod npy_file;
mod observations_file;
mod output;
mod ply_file;
mod point_cloud;
mod poses_file;
mod precalibration_file;
mod problem_folder;
mod project_draft;
mod project_file;
mod raytrix;
mod residuals_file;
mod spelling;
mod virtual_depths;

use std::fs::{self, File};
use std::io::{self, Read};
use std::path::Path;
use std::time::Instant;

pub use board_shape_file::{read_board_shape, read_true_board};
pub use calibration_file::{
    calibrated_camera_document, calibration_document, cost_document, models_document,
};
pub use camera_file::{
    CAMERA_FORMAT, CAMERA_VERSION, camera_document, camera_findings, cameras_in,
    read_board_distances, read_camera, read_camera_findings, read_std_devs,
};
pub use comparison_file::comparison_document;
pub use data_set_folder::{image_name, is_data_set, remove_older_data, stage_data_set};
pub use detection_file::{add_detection, detection_document};
pub use evaluation_file::evaluation_document;
pub use first_look::{doubtful_files, first_look, repeated};
pub use folder_lock::FolderLock;
pub use image_file::{
    ImageReader, Packing, Pages, RawLayout, is_raw, read_image, write_jpeg, write_png,
};
pub use image_folder::{CommonFormat, NamedFNumber, SortedImages, sort_images};
pub use input::{
    CameraSource, read_array_size, read_board, read_camera_source, read_internal_parameters,
    read_poses,
};
pub use json_file::read_json;
pub use manifest::{MANIFEST, Manifest, StageRecord};
pub use npy_file::NpyHeader;
pub use observations_file::{line_of, read_centers, read_features, write_centers, write_features};
pub use output::{OutputFolder, StagedFile, abandon_output};
pub use ply_file::{PlyColumn, PlyWriter};
pub use point_cloud::read_point_cloud_distance;
pub use poses_file::{POSES_FORMAT, POSES_VERSION, poses_document};
pub use precalibration_file::{
    PRECALIBRATION_FORMAT, PRECALIBRATION_VERSION, array_document, precalibration_document,
    write_measured_centers,
};
pub use problem_folder::{PROBLEM, PROBLEM_FORMAT, PROBLEM_VERSION, read_problem, stage_problem};
pub use project_draft::{DraftText, ProjectDraft};
pub use project_file::{ImagesSection, Project, TranslationImages, TruthSection, WhiteImage};
pub use raytrix::{RaytrixCalibration, read_raytrix};
pub use residuals_file::write_residuals;
pub use virtual_depths::{DepthMap, VirtualDepths, read_virtual_depths};

use tracing::info;

use crate::error::{Error, Result};

fn read_bytes(path: &Path) -> Result<Vec<u8>> {
    let begun = Instant::now();
    let mut bytes = Vec::new();
    open(path)
        .and_then(|mut file| file.read_to_end(&mut bytes))
        .map_err(|source| Error::Read { path: path.to_owned(), source })?;
    record_read(path, bytes.len() as u64, begun);
    Ok(bytes)
}

/// Files that a shell or a caller has already opened; they may be of any kind.
const OPENED: [&str; 3] = ["/dev/stdin", "/dev/fd", "/proc/self/fd"];

/// Files that commands write or read in folders; messages suggest them if a folder is given.
const IN_FOLDERS: [&str; 3] = ["project.toml", "camera.json", "calibration/camera.json"];

/// Opens a file to read. An error if it is something else: a pipe of the file system may never receive data, and devices have
/// no end.
fn open(path: &Path) -> io::Result<File> {
    let kind = fs::metadata(path)?.file_type();
    if kind.is_file() || OPENED.iter().any(|opened| path.starts_with(opened)) {
        return File::open(path);
    }
    if !kind.is_dir() {
        return Err(io::Error::other("it is a pipe or a device: give a file"));
    }
    let inside: Vec<String> = IN_FOLDERS
        .iter()
        .map(|name| path.join(name))
        .filter(|file| file.is_file())
        .map(|file| file.display().to_string())
        .collect();
    let which = if inside.is_empty() { "a file".to_owned() } else { inside.join(" or ") };
    Err(io::Error::other(format!("it is a folder: give {which}")))
}

fn record_read(path: &Path, bytes: u64, begun: Instant) {
    let time_s = begun.elapsed().as_secs_f64();
    info!("read: {}, {bytes} bytes in {time_s:.3} s", path.display());
}

/// Reads a text file.
pub fn read_text(path: &Path) -> Result<String> {
    String::from_utf8(read_bytes(path)?).map_err(|e| Error::content(path, not_utf8(e.as_bytes())))
}

/// Describes the error in a file that should be UTF-8 text.
fn not_utf8(bytes: &[u8]) -> &'static str {
    const MARKS: [&[u8]; 2] = [b"\xff\xfe", b"\xfe\xff"];
    if MARKS.iter().any(|mark| bytes.starts_with(mark)) {
        "this text is encoded in UTF-16: save it as UTF-8"
    } else if bytes.iter().take(4096).any(|byte| *byte == 0) {
        "this is not a text file"
    } else {
        "this text is not encoded in UTF-8: save it as UTF-8"
    }
}
