//! `plenocal calibrate`: from observations to a camera.

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

use clap::Args;
use plenocal::assessment::{ModelComparison, assess, compare_models, comparison_steps};
use plenocal::calibration::{Calibration, Mode, Solution, Weights, calibrate, termination_text};
use plenocal::io::{
    self, AnchorsSection, Blur, BoardChoice, CalibrationSection, ExitPupil, FieldCurvature, Method,
    OutputFolder, Pitches, compote,
};
use plenocal::model::{Board, shared_parameters};
use plenocal::solver::{LossKind, Termination};
use plenocal::{Error, Result, report};

use super::choices::{
    ANCHORS, BLURS, BOARD_MODELS, FIELD_CURVATURES, LOSSES, METHODS, MODES, PITCHES, WEIGHTS,
    choice,
};
use super::cost;
use super::evaluate::calibrated;
use super::input::{Files, Input};
use super::progress;
use super::talk::{print_result, say, tell, warn};

/// Calibrate a camera from micro-image centres and BAP features.
///
/// Give a project file, or individual files, or both: individual files take precedence over the
/// project. Files are recognised by their content, so plenocal's own and COMPOTE's can be mixed.
// Parameter names in the help are not code. Every flag is an option of its own.
#[allow(clippy::doc_markdown, clippy::struct_excessive_bools)]
#[derive(Args)]
#[command(after_help = EXAMPLES, allow_negative_numbers = true)]
pub struct Arguments {
    /// Project file (TOML) with the camera, the board, the paths of the observations, and options.
    project: Option<PathBuf>,

    /// Folder for the results: camera.json, calibration.json, poses.json, residuals.csv, solver.txt.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,

    /// Camera: datasheet values (COMPOTE's camera.js, a project file), or a calibrated camera to
    /// start from (camera.json, COMPOTE's intrinsics.js).
    #[arg(long, value_name = "FILE", help_heading = "Input")]
    camera: Option<PathBuf>,
    /// Internal parameters m and q' from white images (precalibration.json, COMPOTE's params.js, a project file).
    #[arg(long, value_name = "FILE", help_heading = "Input")]
    params: Option<PathBuf>,
    /// Board (COMPOTE's scene.js, a project file).
    #[arg(long, value_name = "FILE", help_heading = "Input")]
    scene: Option<PathBuf>,
    /// Micro-image centres: CSV k,l,u,v.
    #[arg(long, value_name = "FILE", help_heading = "Input")]
    centers: Option<PathBuf>,
    /// BAP features: CSV k,l,u,v,rho,cluster,frame, or COMPOTE's .bin.gz, which contains the
    /// centres too.
    #[arg(long, value_name = "FILE", help_heading = "Input")]
    features: Option<PathBuf>,
    /// Poses of the boards to start from (poses.json, COMPOTE's poses.js); those of other frames are found.
    #[arg(long, value_name = "FILE", help_heading = "Input")]
    poses: Option<PathBuf>,
    /// Frames to leave out, e.g. 3,7.
    #[arg(
        long,
        alias = "exclude-frames",
        value_name = "LIST",
        value_delimiter = ',',
        help_heading = "Input"
    )]
    exclude: Option<Vec<u32>>,

    /// Set of options to begin with; options beside it take precedence [default: full].
    #[arg(long, value_parser = choice(METHODS), help_heading = "Estimation")]
    method: Option<Method>,
    /// What to estimate [default: full].
    #[arg(long, value_parser = choice(MODES), help_heading = "Estimation")]
    mode: Option<Mode>,
    /// One micro-lens pitch, or one along x and one along y [default: one].
    #[arg(long, value_parser = choice(PITCHES), help_heading = "Estimation")]
    pitches: Option<Pitches>,
    /// Where the exit pupil of the main lens is, on its axis: estimated; at-lens (the paper); or its distance
    /// from the lens in mm, negative towards the array, to keep it there [default: estimated].
    #[arg(long, value_name = "PLACE", help_heading = "Estimation")]
    exit_pupil: Option<ExitPupil>,
    /// How images of a plane are curved [default: estimated].
    #[arg(long, value_parser = choice(FIELD_CURVATURES), help_heading = "Estimation")]
    field_curvature: Option<FieldCurvature>,
    /// What the board is taken for [default: auto].
    #[arg(long, value_parser = choice(BOARD_MODELS), help_heading = "Estimation")]
    board: Option<BoardChoice>,
    /// The board has the shape that a calibration has found: its calibration.json. With --mode poses-only, that
    /// beside the camera counts by itself if the board is the same.
    #[arg(long, value_name = "FILE", conflicts_with = "board", help_heading = "Estimation")]
    board_shape: Option<PathBuf>,
    /// Parameters that keep their initial value, e.g. F,Q3: of F, Q1 to Q3, P1, P2, kappa, kappa_m, e_z, u0, v0, d,
    /// theta_x to theta_z, t_x, t_y, D, dC, f_1 to f_3, and of the board sag_x, sag_y, twist, aspect. (e_x and e_y are 0, and dC_ratio is fixed unless
    /// --pitches two.)
    #[arg(long, value_name = "LIST", value_delimiter = ',', help_heading = "Estimation")]
    fix: Option<Vec<String>>,
    /// What is known of the camera before any board is seen: the focal length of the datasheet to 3 %,
    /// m of the white images to 2 %, the axis in the middle of the sensor to 0.5 mm; or nothing
    /// [default: default].
    #[arg(long, value_parser = choice(ANCHORS), help_heading = "Estimation")]
    anchors: Option<bool>,
    /// What you know of a parameter or of m, in the units of camera.json: F=50:0.5 for 50 mm to 0.5 mm, or
    /// F=50:1%. Takes the place of a default anchor; F=none removes it.
    #[arg(
        long,
        value_name = "NAME=VALUE:SIGMA",
        value_delimiter = ',',
        help_heading = "Estimation"
    )]
    anchor: Option<Vec<String>>,
    /// How much the anchors weigh against observations, whose errors are not independent: a factor on
    /// their squared residuals [default: measured, see calibration.json].
    #[arg(long, value_name = "W", help_heading = "Estimation")]
    anchor_weight: Option<f64>,
    /// Weights of observations [default: own].
    #[arg(long, value_parser = choice(WEIGHTS), help_heading = "Estimation")]
    weights: Option<Weights>,
    /// Where the focal lengths of the micro-lenses come from [default: white-images].
    #[arg(long, value_parser = choice(BLURS), help_heading = "Estimation")]
    blur: Option<Blur>,
    /// Standard deviation of u and v of a feature, px [default: 1]. Where the file states one for
    /// each feature, this multiplies it; so do the next two.
    #[arg(long, value_name = "PX", help_heading = "Estimation")]
    uv_std_dev: Option<f64>,
    /// Standard deviation of rho, px [default: 1].
    #[arg(long, value_name = "PX", help_heading = "Estimation")]
    rho_std_dev: Option<f64>,
    /// Standard deviation of u and v of a micro-image centre, px [default: 1].
    #[arg(long, value_name = "PX", help_heading = "Estimation")]
    centers_std_dev: Option<f64>,
    /// Robust loss on the norm of every observation's residual [default: huber with a scale of 4 if
    /// every feature has a standard deviation of its own, else none].
    #[arg(long, value_parser = choice(LOSSES), help_heading = "Estimation")]
    loss: Option<LossKind>,
    /// Residual beyond which the loss acts, in standard deviations [default: 1].
    #[arg(long, value_name = "N", help_heading = "Estimation")]
    loss_scale: Option<f64>,
    /// Maximum number of iterations [default: 200].
    #[arg(long, value_name = "N", help_heading = "Estimation")]
    max_iterations: Option<usize>,
    /// Threads of the solver; with 1 results repeat to the last bit, with more they differ by
    /// rounding [default: all cores].
    #[arg(long, value_name = "N", help_heading = "Estimation")]
    threads: Option<usize>,

    /// Do not refine: say how large cost, gradient and residuals are at the --camera and the --poses that you have
    /// from elsewhere, and what one more step would gain. The cost is that of the project, anchors included.
    #[arg(long, requires_all = ["camera", "poses"], conflicts_with_all = ["compare_models", "compote"], help_heading = "Estimation")]
    evaluate_only: bool,

    /// Also write the problem that was solved to this folder: observations with board coordinates and standard deviations, start,
    /// anchors, loss, fixed parameters; for a Ceres program of your own.
    #[arg(long, value_name = "DIR", help_heading = "Output")]
    export_problem: Option<PathBuf>,
    /// Say what exit pupil, field curvature and distortion are worth: calibrate without each, and compare by
    /// frames that took no part.
    #[arg(long, help_heading = "Output")]
    compare_models: bool,
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
  plenocal calibrate project.toml --fix Q3,P1,P2 --exclude 3,7 --out results
  plenocal calibrate project.toml --compare-models --out results
  plenocal calibrate project.toml --anchor F=51.6:0.2,u0=none --out results
  plenocal calibrate project.toml --method paper --out paper
  plenocal calibrate project.toml --export-problem problem --out results
  plenocal calibrate project.toml --evaluate-only --camera mine/camera.json \\
      --poses mine/poses.json --out mine/cost
  plenocal calibrate --mode poses-only --camera results/camera.json --scene scene.js \\
      --features evaluation.csv --out poses";

/// Folds in which models are compared.
const FOLDS: usize = 5;

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<ExitCode> {
    let begun = Instant::now();
    let mut output = OutputFolder::new(&arguments.out)?;
    let (json, with_compote) = (arguments.json, arguments.compote);
    if arguments.export_problem.as_ref() == Some(&arguments.out) {
        return Err(Error::invalid(
            "--export-problem and --out name one folder, but both write camera.json and poses.json: give two",
        ));
    }
    let export = arguments.export_problem.as_deref().map(OutputFolder::new).transpose()?;
    let mut input = Input::read(&arguments.files(), arguments.options()?)?;
    let poses = arguments.poses.as_deref().map(io::read_poses).transpose()?;
    if let (true, Some(camera), Some(poses)) = (arguments.evaluate_only, &arguments.camera, &poses)
    {
        let solution = Solution { camera: calibrated(camera)?, poses: poses.clone() };
        return cost::run(&solution, &input, (output, export), json);
    }
    input.options.poses = poses.unwrap_or_default();

    let bar = progress::spinner(json, "refining");
    let calibration = calibrate(
        &input.start,
        &input.board,
        &input.observations,
        &input.options,
        &mut |iteration| {
            bar.set_message(format!(
                "refining: iteration {}, cost {:.6}",
                iteration.number, iteration.cost
            ));
            true
        },
    );
    bar.finish_and_clear();
    let calibration = calibration.map_err(|error| input.located(error))?;
    let assessment = assess(&calibration, &input.board)?;
    let compared =
        arguments.compare_models.then(|| compared(&calibration, &input.board, FOLDS, json));

    let time_s = begun.elapsed().as_secs_f64();
    let mut document = io::calibration_document(&calibration, &assessment, time_s);
    let mut section =
        report::calibration_section("Calibration", &calibration, &assessment, Vec::new());
    match compared {
        Some(Ok(comparison)) => {
            document["models"] = io::models_document(&comparison);
            section.parts.extend(report::models_parts(&calibration, &comparison, Vec::new()));
        }
        Some(Err(error)) => warn(&[error]),
        None => {}
    }

    stage_results(&mut output, &calibration, with_compote)?;
    if has_camera(&calibration) {
        output.stage_json("calibration.json", &document)?;
    }
    let mut paths = output.commit()?;
    paths.extend(cost::exported(export, &calibration, &input.board)?);
    tell(&calibration.findings);
    print_result(json, &document, &section.to_text(), &paths)?;
    Ok(status(&calibration))
}

/// Compares models in at most so many folds, with a progress bar.
pub(super) fn compared(
    calibration: &Calibration,
    board: &Board,
    folds: usize,
    quiet: bool,
) -> Result<ModelComparison> {
    let folds = folds.min(calibration.poses.len());
    let bar = progress::steps(quiet, comparison_steps(calibration, folds), "comparing models");
    let comparison = compare_models(calibration, board, folds, &|| bar.inc(1));
    bar.finish_and_clear();
    comparison
}

/// The exit status of a calibration, which says why if its result should not be used.
pub(super) fn status(calibration: &Calibration) -> ExitCode {
    let camera = &calibration.camera;
    let names = shared_parameters(camera.lens_types());
    let unknown = calibration.uncertainty.undetermined_intrinsics();
    let unknown: Vec<&str> = unknown.into_iter().map(|index| names[index].name).collect();
    let why = match calibration.refinement.termination {
        _ if calibration.converged && unknown.is_empty() => return ExitCode::SUCCESS,
        _ if calibration.converged => format!(
            "not determined: {}. Take frames at other distances and tilts, or hold them (--fix)",
            unknown.join(", ")
        ),
        Termination::IterationLimit => {
            format!("not converged: {} Raise --max-iterations.", termination_text(calibration))
        }
        _ => format!("not converged: {}", termination_text(calibration)),
    };
    say(&format!("error: {why}"));
    ExitCode::from(3)
}

/// Whether a calibration has estimated a camera; with poses only, it is unchanged.
fn has_camera(calibration: &Calibration) -> bool {
    !calibration.uncertainty.free_intrinsics.is_empty()
}

/// Stages the results of a calibration.
pub(super) fn stage_results(
    output: &mut OutputFolder,
    calibration: &Calibration,
    with_compote: bool,
) -> Result<()> {
    let uncertainty = Some(&calibration.uncertainty);
    let poses = io::poses_document(&calibration.poses, uncertainty);
    if with_compote {
        let grid = calibration.grid.as_ref().ok_or_else(|| {
            Error::invalid("COMPOTE's intrinsics.js needs the micro-image centres")
        })?;
        let lens = &calibration.camera.main_lens;
        if lens.exit_pupil_mm.norm() > 0.0 || lens.has_curved_field() {
            say(
                "warning: COMPOTE's files have neither an exit pupil nor a field curvature: what reads \
                 intrinsics.js gets another camera (--exit-pupil at-lens --field-curvature flat)",
            );
        }
        let folder = Path::new("compote");
        let intrinsics = compote::intrinsics_document(&calibration.camera, grid)?;
        output.stage_json(folder.join("intrinsics.js"), &intrinsics)?;
        output.stage_json(folder.join("poses.js"), &compote::poses_document(&calibration.poses))?;
    }
    if has_camera(calibration) {
        output.stage_json("camera.json", &io::calibrated_camera_document(calibration))?;
    }
    output.stage_json("poses.json", &poses)?;
    output.stage("residuals.csv", |out| io::write_residuals(out, &calibration.reprojection))?;
    output.stage("solver.txt", |out| out.write_all(calibration.refinement.report.as_bytes()))
}

/// `--anchors` and `--anchor`; `None` if neither is given.
pub(super) fn anchors_section(
    default: Option<bool>,
    stated: Option<&[String]>,
) -> Result<Option<AnchorsSection>> {
    let mut section = AnchorsSection { default, ..AnchorsSection::default() };
    for text in stated.into_iter().flatten() {
        section.add_text(text)?;
    }
    Ok((section != AnchorsSection::default()).then_some(section))
}

impl Arguments {
    fn options(&self) -> Result<CalibrationSection> {
        Ok(CalibrationSection {
            method: self.method,
            mode: self.mode,
            pitches: self.pitches,
            exit_pupil: self.exit_pupil,
            field_curvature: self.field_curvature,
            board: self.board,
            blur: self.blur,
            fix: self.fix.clone(),
            exclude_frames: self.exclude.clone(),
            anchors: anchors_section(self.anchors, self.anchor.as_deref())?,
            anchor_weight: self.anchor_weight,
            weights: self.weights,
            uv_std_dev_px: self.uv_std_dev,
            rho_std_dev_px: self.rho_std_dev,
            centers_std_dev_px: self.centers_std_dev,
            loss: self.loss,
            loss_scale: self.loss_scale,
            max_iterations: self.max_iterations,
            threads: self.threads,
        })
    }

    fn files(&self) -> Files<'_> {
        Files {
            project: self.project.as_deref(),
            camera: self.camera.as_deref(),
            params: self.params.as_deref(),
            scene: self.scene.as_deref(),
            centers: self.centers.as_deref(),
            features: self.features.as_deref(),
            board_shape: self.board_shape.as_deref(),
            evaluates: self.evaluate_only,
        }
    }
}
