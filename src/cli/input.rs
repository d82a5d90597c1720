//! Input of a calibration: the files named individually, and the project for the rest.

use std::path::{Path, PathBuf};

use plenocal::calibration::{BoardModel, CalibrationOptions, Mode, Start};
use plenocal::error::{Input as Part, Observed};
use plenocal::io::{self, CameraSource, Project};
use plenocal::model::{Board, BoardShape, Datasheet, Observations, SHAPE};
use plenocal::{Error, Finding, Result};

use super::messages::{announce_calibration, tell};

/// Files named on the command line.
pub struct Files<'a> {
    pub project: Option<&'a Path>,
    pub camera: Option<&'a Path>,
    pub params: Option<&'a Path>,
    pub scene: Option<&'a Path>,
    pub centers: Option<&'a Path>,
    pub features: Option<&'a Path>,
    pub board_shape: Option<&'a Path>,
    /// True if the camera is only evaluated; the project then has the start that defines the cost.
    pub evaluates: bool,
}

/// Input of the calibration stage.
pub struct Input {
    pub start: Start,
    pub board: Board,
    pub observations: Observations,
    pub options: CalibrationOptions,
    /// Paths of the features and the centres.
    sources: [PathBuf; 2],
}

impl Input {
    /// Reads the files that are named, and takes the rest from the project.
    pub fn read(files: &Files, project: &Project, mut options: CalibrationOptions) -> Result<Self> {
        refuse_shape(options.board, files.board_shape, options.mode)?;
        let start = start(files, project, options.mode)?;
        let board = match (files.scene, project.board) {
            (Some(path), _) => io::read_board(path)?,
            (None, Some(board)) => board,
            (None, None) => return Err(missing(Part::Board)),
        };
        let open = options.mode == Mode::PosesOnly && options.board == BoardModel::Auto;
        let of_camera = files.camera.filter(|_| open);
        if let Some((shape, _)) = board_shape(files.board_shape, of_camera, &board)? {
            options.board = BoardModel::Known(shape);
        }
        let rho = options.has_rho() && options.mode != Mode::CornersOnly && start.lens_types() > 0;
        let (mut observations, sources) = observations(files, project, rho)?;
        io::add_detection(&mut observations, &sources[0])?;
        announce_calibration(&observations.features);
        Ok(Self { start, board, observations, options, sources })
    }

    /// Adds the file and the line of an impossible observation to an error.
    pub fn located(&self, error: Error) -> Error {
        located(error, &self.sources)
    }
}

/// Adds the file and the line of an impossible observation to an error, from the files of features and centres.
pub fn located(error: Error, [features, centers]: &[PathBuf; 2]) -> Error {
    let Error::Observation { observation, .. } = &error else { return error };
    let path = match observation {
        Observed::Feature { .. } => features,
        Observed::Center { .. } => centers,
    };
    match io::line_of(path, *observation) {
        Some(line) => Error::invalid(format!("line {line}: {error}")).in_file(path),
        None => error.in_file(path),
    }
}

/// Returns an error if a file states a shape of the board and the options contradict it, or if the options ask for a bent board
/// and only poses are estimated.
fn refuse_shape(stated: BoardModel, shape: Option<&Path>, mode: Mode) -> Result<()> {
    let word = match stated {
        BoardModel::Flat => "flat",
        BoardModel::Bent => "bent",
        BoardModel::Auto | BoardModel::Known(_) => return Ok(()),
    };
    if let Some(shape) = shape {
        return Err(Error::invalid(format!(
            "the project states board = \"{word}\", but --board-shape gives the shape of {}: \
             remove one of the two",
            shape.display()
        )));
    }
    if mode == Mode::PosesOnly && word == "bent" {
        return Err(Error::invalid(
            "the shape of a bent board is only estimated together with a camera, which is fixed \
             here: give --board auto for the shape in the calibration.json beside the camera, or \
             --board-shape instead of a bent board",
        ));
    }
    Ok(())
}

/// Reads the shape of a board with its σ: from the stated file, or from the calibration.json beside a camera. `None` if there
/// is no shape.
pub fn board_shape(
    stated: Option<&Path>,
    camera: Option<&Path>,
    board: &Board,
) -> Result<Option<(BoardShape, [Option<f64>; SHAPE])>> {
    if let Some(path) = stated {
        let shape = io::read_board_shape(path, board)?;
        return shape.map(Some).ok_or_else(|| {
            Error::invalid(format!(
                "it has no board_shape for a board of {} x {} inner corners with squares of {} mm",
                board.columns, board.rows, board.square_mm
            ))
            .in_file(path)
        });
    }
    let beside = camera.map(|camera| camera.with_file_name("calibration.json"));
    match beside.filter(|path| path.is_file()) {
        Some(path) => io::read_board_shape(&path, board),
        None => Ok(None),
    }
}

fn missing(missing: Part) -> Error {
    Error::Missing { missing }
}

fn start(files: &Files, project: &Project, mode: Mode) -> Result<Start> {
    let of_project = files.project.filter(|_| files.evaluates && mode != Mode::PosesOnly);
    let path =
        of_project.or(files.camera).or(files.project).ok_or_else(|| missing(Part::Camera))?;
    match camera_source(path)? {
        CameraSource::Camera(_) if files.params.is_some() => Err(Error::Invalid(
            "--params is for a camera that is not calibrated yet: leave it out".to_owned(),
        )),
        CameraSource::Camera(camera) => Ok(Start::Camera(*camera)),
        CameraSource::Datasheet(_) if mode == Mode::PosesOnly => {
            Err(Error::NotCalibrated.in_file(path))
        }
        CameraSource::Datasheet(sheet) => from_datasheet(sheet, files, project),
    }
}

/// Reads a camera or a datasheet, and warns about a camera that should not be used.
pub fn camera_source(path: &Path) -> Result<CameraSource> {
    let source = io::read_camera_source(path)?;
    if matches!(source, CameraSource::Camera(_)) {
        tell(&camera_findings(path)?);
    }
    Ok(source)
}

/// Returns the findings about the camera in a file; a project file has none.
pub fn camera_findings(path: &Path) -> Result<Vec<Finding>> {
    if path.extension().is_some_and(|extension| extension == "toml") {
        return Ok(Vec::new());
    }
    io::read_camera_findings(path)
}

fn from_datasheet(mut sheet: Datasheet, files: &Files, project: &Project) -> Result<Start> {
    let internal = match (files.params, project.internal_parameters.clone()) {
        (Some(path), _) => {
            if sheet.array_size.is_none() {
                sheet.array_size = io::read_array_size(path)?;
            }
            io::read_internal_parameters(path, Some(sheet.sensor.pixel_size_mm))?
        }
        (None, Some(internal)) => internal,
        (None, None) => return Err(missing(Part::InternalParameters)),
    };
    Ok(Start::Datasheet(sheet, internal))
}

/// Reads the observations, and returns them with the files of features and centres.
fn observations(
    files: &Files,
    project: &Project,
    rho: bool,
) -> Result<(Observations, [PathBuf; 2])> {
    let section = project.observations.as_ref();
    let features = files
        .features
        .or(section.map(|s| s.features.as_path()))
        .ok_or_else(|| missing(Part::Features))?;
    let mut observations = io::read_features(features, rho)?;
    // A features file given on the command line may contain centres; the centres of the project then belong to other features.
    let of_project = || section.and_then(|s| s.centers.as_deref());
    let separate = match files.centers {
        None if files.features.is_none() || observations.centers.is_empty() => of_project(),
        named => named,
    };
    if let Some(path) = separate {
        if !observations.centers.is_empty() {
            return Err(Error::invalid(format!(
                "this file contains the centres, and {} gives them again: leave one out",
                path.display()
            ))
            .in_file(features));
        }
        observations.centers = io::read_centers(path)?;
    }
    // Centres without a file of their own are in the features file.
    let sources = [features, separate.unwrap_or(features)];
    Ok((observations, sources.map(Path::to_owned)))
}
