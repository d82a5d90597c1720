//! `plenocal calibrate`: from observations to a camera.

use std::io::{IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::{Duration, Instant};

use clap::Args;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use plenocal::calibration::{Calibration, Iteration, Mode, Start, calibrate};
use plenocal::camera::{Board, Datasheet, InternalParameters};
use plenocal::io::{
    self, CalibrationSection, CameraSource, LossName, OutputFolder, Pitches, Project, compote,
};
use plenocal::observations::Observations;
use plenocal::{Error, Result, report};

/// Calibrate a camera from micro-image centres and BAP features.
///
/// Give a project file, or the single files, or both: what is given singly goes before the project.
/// Files are told apart by what is in them, so plenocal's own and COMPOTE's can be mixed.
#[derive(Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// Project file (TOML) with the camera, the board, where the observations are, and options.
    project: Option<PathBuf>,

    /// Folder for the results: camera.json, poses.json, residuals.csv, solver.txt.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,

    /// Camera: its datasheet values (COMPOTE's camera.js, a project file), or to start from a
    /// calibrated one (camera.json, COMPOTE's intrinsics.js).
    #[arg(long, value_name = "FILE", help_heading = "Input")]
    camera: Option<PathBuf>,
    /// Internal parameters m and q' from white images (COMPOTE's params.js, a project file).
    #[arg(long, value_name = "FILE", help_heading = "Input")]
    params: Option<PathBuf>,
    /// Board (COMPOTE's scene.js, a project file).
    #[arg(long, value_name = "FILE", help_heading = "Input")]
    scene: Option<PathBuf>,
    /// Micro-image centres: CSV k,l,u,v.
    #[arg(long, value_name = "FILE", help_heading = "Input")]
    centers: Option<PathBuf>,
    /// BAP features: CSV k,l,u,v,rho,cluster,frame, or COMPOTE's .bin.gz, which holds the centres
    /// too.
    #[arg(long, value_name = "FILE", help_heading = "Input")]
    features: Option<PathBuf>,
    /// Frames to leave out, e.g. 3,7.
    #[arg(long, value_name = "LIST", value_delimiter = ',', help_heading = "Input")]
    exclude_frames: Option<Vec<u32>>,

    /// Estimate a pinhole array (I = 0) from (u, v) alone, as Noury et al. 2017.
    #[arg(long, conflicts_with = "poses_only", help_heading = "Estimation")]
    corners_only: bool,
    /// Estimate the poses alone, with the camera (--camera, a calibrated one) held.
    #[arg(long, help_heading = "Estimation")]
    poses_only: bool,
    /// One micro-lens pitch, or one along x and one along y [default: one].
    #[arg(long, value_enum, help_heading = "Estimation")]
    pitches: Option<Pitches>,
    /// Parameters that keep their initial value, e.g. F,Q3: any of F, Q1..Q3, P1, P2, u0, v0, d,
    /// theta_x..theta_z, t_x, t_y, D, dC, f_1..f_3.
    #[arg(long, value_name = "LIST", value_delimiter = ',', help_heading = "Estimation")]
    fix: Option<Vec<String>>,
    /// Standard deviation of u and v of a feature, px [default: 1].
    #[arg(long, value_name = "PX", help_heading = "Estimation")]
    uv_std_dev: Option<f64>,
    /// Standard deviation of rho, px [default: 1].
    #[arg(long, value_name = "PX", help_heading = "Estimation")]
    rho_std_dev: Option<f64>,
    /// Standard deviation of u and v of a micro-image centre, px [default: 1].
    #[arg(long, value_name = "PX", help_heading = "Estimation")]
    centers_std_dev: Option<f64>,
    /// Robust loss on the norm of every observation's residual [default: none].
    #[arg(long, value_enum, help_heading = "Estimation")]
    loss: Option<LossName>,
    /// Where the loss sets in, standard deviations [default: 1].
    #[arg(long, value_name = "N", help_heading = "Estimation")]
    loss_scale: Option<f64>,
    /// Limit of iterations [default: 200].
    #[arg(long, value_name = "N", help_heading = "Estimation")]
    max_iterations: Option<usize>,
    /// Threads of the solver [default: all cores].
    #[arg(long, value_name = "N", help_heading = "Estimation")]
    threads: Option<usize>,

    /// Print the result as one JSON object instead of tables.
    #[arg(long, help_heading = "Output")]
    json: bool,
    /// Also write COMPOTE's intrinsics.js and poses.js, into the folder compote/.
    #[arg(long, help_heading = "Output")]
    compote: bool,
}

const EXAMPLES: &str = "\
Examples:
  plenocal calibrate project.toml --out results
  plenocal calibrate --camera camera.js --params params.js --scene scene.js \\
      --centers centers.csv --features features.csv --out results
  plenocal calibrate project.toml --fix Q3,P1,P2 --loss huber --out results
  plenocal calibrate --poses-only --camera results/camera.json --scene scene.js \\
      --features evaluation.csv --out poses";

/// Iterations shown on the progress bar's way; most calibrations take fewer than this.
const TICK: Duration = Duration::from_millis(100);

struct Input {
    start: Start,
    board: Board,
    observations: Observations,
    options: CalibrationSection,
}

/// Runs the command.
pub fn run(arguments: Arguments) -> Result<ExitCode> {
    let begun = Instant::now();
    let mut output = OutputFolder::new(&arguments.out)?;
    let (json, with_compote) = (arguments.json, arguments.compote);
    let input = read_input(arguments)?;
    let options = input.options.options();

    let bar = progress_bar(json);
    let calibration = calibrate(
        &input.start,
        &input.board,
        &input.observations,
        &options,
        &mut |iteration: &Iteration| {
            bar.set_message(format!("iteration {}, cost {:.6}", iteration.number, iteration.cost));
            true
        },
    );
    bar.finish_and_clear();
    let calibration = calibration?;

    stage_results(&mut output, &calibration, with_compote)?;
    let paths = output.commit()?;
    for left_out in &calibration.left_out {
        eprintln!("warning: {left_out}");
    }
    for warning in &calibration.warnings {
        eprintln!("warning: {warning}");
    }
    let text = if json {
        format!("{}\n", report::calibration_json(&calibration, begun.elapsed().as_secs_f64()))
    } else {
        let files: Vec<String> = paths.iter().map(|p| format!("  {}\n", p.display())).collect();
        format!("{}\nWritten:\n{}", report::calibration_text(&calibration), files.concat())
    };
    // A reader that has gone away (a closed pipe) is no failure of the calibration.
    let _ = std::io::stdout().write_all(text.as_bytes());
    if calibration.converged {
        return Ok(ExitCode::SUCCESS);
    }
    eprintln!("error: not converged: {}", report::termination_text(&calibration));
    Ok(ExitCode::from(3))
}

fn progress_bar(json: bool) -> ProgressBar {
    if json || !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let bar = ProgressBar::new_spinner().with_style(
        ProgressStyle::with_template("{spinner} refining: {msg} ({elapsed})")
            .unwrap_or_else(|_| ProgressStyle::default_spinner()),
    );
    bar.set_draw_target(ProgressDrawTarget::stderr());
    bar.enable_steady_tick(TICK);
    bar
}

fn stage_results(
    output: &mut OutputFolder,
    calibration: &Calibration,
    with_compote: bool,
) -> Result<()> {
    let uncertainty = Some(&calibration.uncertainty);
    let mut camera = io::camera_document(&calibration.camera, uncertainty);
    camera["converged"] = calibration.converged.into();
    let poses = io::poses_document(&calibration.poses, uncertainty);
    if with_compote {
        let grid = calibration.grid.as_ref().ok_or_else(|| {
            Error::Invalid("COMPOTE's intrinsics.js needs the micro-image centres".to_owned())
        })?;
        let folder = Path::new("compote");
        let intrinsics = compote::intrinsics_document(&calibration.camera, grid)?;
        output.stage_json(folder.join("intrinsics.js"), &intrinsics)?;
        output.stage_json(folder.join("poses.js"), &compote::poses_document(&calibration.poses))?;
    }
    output.stage_json("camera.json", &camera)?;
    output.stage_json("poses.json", &poses)?;
    output.stage("residuals.csv", |out| io::write_residuals(out, &calibration.reprojection))?;
    output.stage("solver.txt", |out| out.write_all(calibration.refinement.report.as_bytes()))
}

fn read_input(arguments: Arguments) -> Result<Input> {
    let options = arguments.calibration_options();
    let project = match &arguments.project {
        Some(path) => Some((Project::read(path)?, path)),
        None => None,
    };
    let options = match &project {
        Some((project, _)) => options.or(project.calibration.clone()),
        None => options,
    };
    let mode = options.options().mode;

    let start = match &arguments.camera {
        Some(path) => match io::read_camera_source(path)? {
            CameraSource::Camera(camera) => Start::Camera(*camera),
            CameraSource::Datasheet(sheet) => {
                with_internal_parameters(sheet, &arguments, project.as_ref(), mode)?
            }
        },
        None => {
            let (project, path) =
                project.as_ref().ok_or_else(|| missing("a camera", "--camera"))?;
            let sheet = project.datasheet().map_err(|e| in_file(e, path))?;
            let sheet = sheet.ok_or_else(|| missing("a camera", "--camera"))?;
            with_internal_parameters(sheet, &arguments, Some(&(project.clone(), path)), mode)?
        }
    };
    let board = match (&arguments.scene, project.as_ref().and_then(|(p, _)| p.board)) {
        (Some(path), _) => io::read_board(path)?,
        (None, Some(board)) => board,
        (None, None) => return Err(missing("a board", "--scene")),
    };
    let observations = read_observations(&arguments, project.as_ref().map(|(p, _)| p), mode)?;
    let observations = without_frames(observations, options.exclude_frames.as_deref())?;
    Ok(Input { start, board, observations, options })
}

fn missing(what: &str, option: &str) -> Error {
    Error::Invalid(format!("{what} is missing: give {option}, or a project file that has it"))
}

fn in_file(error: Error, path: &Path) -> Error {
    match error {
        Error::Invalid(message) => Error::Content { path: path.to_owned(), message },
        other => other,
    }
}

fn with_internal_parameters(
    sheet: Datasheet,
    arguments: &Arguments,
    project: Option<&(Project, &PathBuf)>,
    mode: Mode,
) -> Result<Start> {
    let internal: InternalParameters =
        match (&arguments.params, project.and_then(|(project, _)| project.internal())) {
            (Some(path), _) => {
                io::read_internal_parameters(path, Some(sheet.sensor.pixel_size_mm))?
            }
            (None, Some(internal)) => internal,
            (None, None) => return Err(missing("the internal parameters", "--params")),
        };
    if mode == Mode::PosesOnly {
        return Err(Error::Invalid(
            "--poses-only needs a calibrated camera: give its camera.json or intrinsics.js with \
             --camera"
                .to_owned(),
        ));
    }
    Ok(Start::Datasheet(sheet, internal))
}

fn read_observations(
    arguments: &Arguments,
    project: Option<&Project>,
    mode: Mode,
) -> Result<Observations> {
    let section = project.and_then(|p| p.observations.as_ref());
    let features = arguments
        .features
        .as_ref()
        .or(section.map(|s| &s.features))
        .ok_or_else(|| missing("the features", "--features"))?;
    let mut observations = io::read_features(features, mode != Mode::CornersOnly)?;
    let centers = match &arguments.centers {
        Some(path) => Some(path),
        // The project's centres belong to the project's features.
        None if arguments.features.is_none() || observations.centers.is_empty() => {
            section.and_then(|s| s.centers.as_ref())
        }
        None => None,
    };
    if let Some(path) = centers {
        if !observations.centers.is_empty() {
            return Err(Error::Content {
                path: features.clone(),
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

fn without_frames(mut observations: Observations, exclude: Option<&[u32]>) -> Result<Observations> {
    let frames = observations.frames();
    for frame in exclude.unwrap_or_default() {
        if !frames.contains(frame) {
            return Err(Error::Invalid(format!(
                "frame {frame} is to be left out, but there is none; the frames are {frames:?}"
            )));
        }
        observations.features.retain(|f| f.frame != *frame);
    }
    Ok(observations)
}

impl Arguments {
    fn calibration_options(&self) -> CalibrationSection {
        use plenocal::io::ModeName;
        let mode = match (self.corners_only, self.poses_only) {
            (true, _) => Some(ModeName::CornersOnly),
            (_, true) => Some(ModeName::PosesOnly),
            _ => None,
        };
        CalibrationSection {
            mode,
            pitches: self.pitches,
            fix: self.fix.clone(),
            exclude_frames: self.exclude_frames.clone(),
            uv_std_dev_px: self.uv_std_dev,
            rho_std_dev_px: self.rho_std_dev,
            centers_std_dev_px: self.centers_std_dev,
            loss: self.loss,
            loss_scale: self.loss_scale,
            max_iterations: self.max_iterations,
            threads: self.threads,
        }
    }
}
