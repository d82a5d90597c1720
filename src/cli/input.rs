//! What a calibration reads: the files named singly, and the project for the rest.

use std::path::Path;

use plenocal::calibration::{CalibrationOptions, Mode, Start};
use plenocal::io::{self, CalibrationSection, CameraSource, Project};
use plenocal::model::{Board, Datasheet, Observations};
use plenocal::solver::LossKind;
use plenocal::{Error, Result};

/// The files named on the command line.
pub struct Files<'a> {
    pub project: Option<&'a Path>,
    pub camera: Option<&'a Path>,
    pub params: Option<&'a Path>,
    pub scene: Option<&'a Path>,
    pub centers: Option<&'a Path>,
    pub features: Option<&'a Path>,
}

/// All that the calibration stage takes.
pub struct Input {
    pub start: Start,
    pub board: Board,
    pub observations: Observations,
    pub options: CalibrationOptions,
}

impl Input {
    /// Reads everything; `options` go before those of the project.
    pub fn read(files: &Files, options: CalibrationSection) -> Result<Self> {
        let project = files.project.map(Project::read).transpose()?;
        let section = match &project {
            Some(project) => options.or(project.calibration.clone()),
            None => options,
        };
        if section.loss_scale.is_some() && matches!(section.loss, None | Some(LossKind::None)) {
            return Err(Error::Invalid(
                "a scale of the loss is given, but no loss: choose one with --loss".to_owned(),
            ));
        }
        let options = section.options();
        let start = start(files, project.as_ref(), options.mode)?;
        let board = match (files.scene, project.as_ref().and_then(|p| p.board)) {
            (Some(path), _) => io::read_board(path)?,
            (None, Some(board)) => board,
            (None, None) => return Err(missing("a board", "--scene")),
        };
        let rho = options.mode != Mode::CornersOnly && start.lens_types() > 0;
        let observations = observations(files, project.as_ref(), rho)?;
        Ok(Self { start, board, observations, options })
    }
}

fn missing(what: &str, option: &str) -> Error {
    Error::Invalid(format!("{what} is missing: give {option}, or a project file that has it"))
}

fn start(files: &Files, project: Option<&Project>, mode: Mode) -> Result<Start> {
    let path = files.camera.or(files.project).ok_or_else(|| missing("a camera", "--camera"))?;
    match io::read_camera_source(path)? {
        CameraSource::Camera(_) if files.params.is_some() => Err(Error::Invalid(
            "--params is for a camera that is not calibrated yet; leave it out".to_owned(),
        )),
        CameraSource::Camera(camera) => Ok(Start::Camera(*camera)),
        CameraSource::Datasheet(_) if mode == Mode::PosesOnly => Err(Error::Invalid(
            "poses alone need a calibrated camera: give its camera.json or intrinsics.js with \
             --camera"
                .to_owned(),
        )),
        CameraSource::Datasheet(sheet) => from_datasheet(sheet, files, project),
    }
}

fn from_datasheet(sheet: Datasheet, files: &Files, project: Option<&Project>) -> Result<Start> {
    let internal = match (files.params, project.and_then(Project::internal)) {
        (Some(path), _) => io::read_internal_parameters(path, Some(sheet.sensor.pixel_size_mm))?,
        (None, Some(internal)) => internal,
        (None, None) => return Err(missing("a table of internal parameters", "--params")),
    };
    Ok(Start::Datasheet(sheet, internal))
}

fn observations(files: &Files, project: Option<&Project>, rho: bool) -> Result<Observations> {
    let section = project.and_then(|p| p.observations.as_ref());
    let features = files
        .features
        .or(section.map(|s| s.features.as_path()))
        .ok_or_else(|| missing("a file of features", "--features"))?;
    let mut observations = io::read_features(features, rho)?;
    // A file of features named singly may hold centres; then the project's are not of them.
    let of_project = || section.and_then(|s| s.centers.as_deref());
    let separate = match files.centers {
        None if files.features.is_none() || observations.centers.is_empty() => of_project(),
        named => named,
    };
    if let Some(path) = separate {
        if !observations.centers.is_empty() {
            return Err(Error::Content {
                path: features.to_owned(),
                message: format!(
                    "this file holds the centres too, and {} gives them again; leave one out",
                    path.display()
                ),
            });
        }
        observations.centers = io::read_centers(path)?;
    }
    Ok(observations)
}
