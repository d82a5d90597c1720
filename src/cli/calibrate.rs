//! `plenocal calibrate`: estimates a camera from observations.

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

use clap::{Args, ValueEnum};
use plenocal::assessment::{Assessment, ModelComparison, assess, compare_models, comparison_steps};
use plenocal::calibration::{
    Calibration, CalibrationOptions, Method, Mode, Priors, calibrate, termination_text,
};
use plenocal::io::{self, OutputFolder, Project, compote};
use plenocal::model::{Board, Parameter};
use plenocal::solver::Termination;
use plenocal::{Error, Finding, Result, report};

use super::cost;
use super::given::Given;
use super::input::{Files, Input, camera_findings};
use super::messages::{print_result, say, shown, tell, verdict_status, warn};
use super::progress;

/// Calibrate a camera from micro-image centres and BAP features.
///
/// Give a project file, or individual files, or both: individual files take precedence over the
/// project. Files are recognised by their content, so plenocal's own and COMPOTE's can be mixed.
// Parameter names in the help are not code, and every flag is a separate option.
#[allow(clippy::doc_markdown, clippy::struct_excessive_bools)]
#[derive(Args)]
#[command(after_help = EXAMPLES, allow_negative_numbers = true)]
pub struct Arguments {
    /// Project file (TOML) with the camera, the board, the paths of the observations, and options.
    project: Option<PathBuf>,

    #[arg(long, value_name = "DIR", help = results_help!("camera.json, calibration.json, poses.json, residuals.csv, solver.txt"))]
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
    /// Initial poses of the boards (poses.json, COMPOTE's poses.js); poses of other frames are estimated.
    #[arg(long, value_name = "FILE", help_heading = "Input")]
    poses: Option<PathBuf>,
    /// Replace a value of the project, e.g. calibration.extrapolate=false; may be repeated.
    #[arg(long, value_name = "KEY=VALUE", help_heading = "Input")]
    set: Vec<String>,

    /// Set of options to begin with; individual options take precedence [default: full].
    #[arg(long, help_heading = "Estimation")]
    method: Option<Method>,
    #[command(flatten, next_help_heading = "Estimation")]
    options: Given<CalibrationOptions>,
    /// File calibration.json of the calibration that estimated the shape of the board. With --mode poses-only, the file beside
    /// the camera is used by default if the board is the same.
    #[arg(long, value_name = "FILE", conflicts_with = "board", help_heading = "Estimation")]
    board_shape: Option<PathBuf>,
    /// Default priors on the camera [default: default].
    #[arg(long, alias = "anchors", help_heading = "Estimation")]
    priors: Option<DefaultPriors>,
    /// Prior on a parameter or on m, in the units of camera.json: F=50:0.5 for (50 ± 0.5) mm, or F=50:1%. It replaces a default
    /// prior; F=none removes it.
    #[arg(
        long,
        alias = "anchor",
        value_name = "NAME=VALUE:SIGMA",
        value_delimiter = ',',
        help_heading = "Estimation"
    )]
    prior: Vec<String>,

    /// Do not refine: print cost, gradient and residuals at the given --camera and --poses, and the gain of one more step. The
    /// cost is taken from --problem or, without it, from the project and the options given here, priors included.
    #[arg(long, requires_all = ["camera", "poses"], conflicts_with_all = ["compare_models", "compote"], help_heading = "Estimation")]
    evaluate_only: bool,
    /// Folder written by --export-problem. It defines the observations, the board and the cost, so a project or options of the
    /// cost cannot be given as well.
    #[arg(long, value_name = "DIR", requires = "evaluate_only", conflicts_with_all = IN_PROBLEM, help_heading = "Estimation")]
    problem: Option<PathBuf>,

    /// Also write the solved problem to this folder, for a Ceres program of your own: observations with board coordinates and
    /// standard deviations, initial values, priors, loss, fixed parameters.
    #[arg(long, value_name = "DIR", help_heading = "Output")]
    export_problem: Option<PathBuf>,
    /// Compare models without exit pupil, field curvature and distortion: calibrate without each, and evaluate on frames that
    /// were left out.
    #[arg(long, help_heading = "Output")]
    compare_models: bool,
    /// Print the result as one JSON object instead of tables.
    #[arg(long, help_heading = "Output")]
    json: bool,
    /// Also write COMPOTE's intrinsics.js and poses.js, into the folder compote/.
    #[arg(long, help_heading = "Output")]
    compote: bool,
}

/// Arguments that an exported problem replaces.
const IN_PROBLEM: [&str; 26] = [
    "project",
    "params",
    "scene",
    "centers",
    "features",
    "set",
    "method",
    "priors",
    "prior",
    "exclude_frames",
    "mode",
    "pitches",
    "exit_pupil",
    "distortion",
    "lens_tilt",
    "field_curvature",
    "board",
    "fix",
    "prior_weight",
    "weights",
    "blur",
    "uv_std_dev_px",
    "rho_std_dev_px",
    "centers_std_dev_px",
    "loss",
    "loss_scale",
];

/// Set of default priors.
#[derive(Clone, Copy, ValueEnum)]
enum DefaultPriors {
    /// Focal length of the datasheet to 3 %, m of the white images to 2 %, principal point in the middle of the sensor to 0.5
    /// mm, main lens parallel to the sensor to 5 mrad.
    Default,
    /// Only the priors given with --prior.
    None,
}

const EXAMPLES: &str = "\
Examples:
  plenocal calibrate project.toml --out results
  plenocal calibrate --camera camera.js --params params.js --scene scene.js \\
      --centers centers.csv --features features.csv --out results
  plenocal calibrate project.toml --fix Q3,P1,P2 --exclude 3,7 --out results
  plenocal calibrate project.toml --compare-models --out results
  plenocal calibrate project.toml --prior F=51.6:0.2,u0=none --out results
  plenocal calibrate project.toml --method paper --out paper
  plenocal calibrate project.toml --export-problem problem --out results
  plenocal calibrate --evaluate-only --problem problem --camera mine/camera.json \\
      --poses mine/poses.json --out mine/cost
  plenocal calibrate --mode poses-only --camera results/camera.json --scene scene.js \\
      --features evaluation.csv --out poses";

/// Number of folds of the comparison of models.
const FOLDS: usize = 5;

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<ExitCode> {
    let begun = Instant::now();
    let mut output = OutputFolder::new(&arguments.out)?;
    let (json, with_compote) = (arguments.json, arguments.compote);
    if arguments.export_problem.as_ref() == Some(&arguments.out) {
        return Err(Error::invalid(
            "--export-problem and --out name the same folder, but both write camera.json and \
             poses.json: give two folders",
        ));
    }
    let export = arguments.export_problem.as_deref().map(OutputFolder::new).transpose()?;
    if let (true, Some(camera), Some(poses)) =
        (arguments.evaluate_only, &arguments.camera, &arguments.poses)
    {
        let output = cost::Output { results: output, export, json };
        return arguments.evaluate((camera, poses), output);
    }
    let mut input = arguments.input()?;
    let poses = arguments.poses.as_deref().map(io::read_poses).transpose()?;
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
    let mut assessment = assess(&calibration, &input.board)?;
    if input.options.mode == Mode::PosesOnly {
        let camera = arguments.camera.as_ref().or(arguments.project.as_ref());
        assessment.add(camera.map_or(Ok(Vec::new()), |path| camera_findings(path))?);
    }
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

    stage_results(&mut output, (&calibration, &assessment), with_compote)?;
    if has_camera(&calibration) {
        output.stage_json("calibration.json", &document)?;
    }
    let mut paths = output.commit()?;
    paths.extend(cost::exported(export, &calibration, &input.board)?);
    tell(&calibration.findings);
    print_result(json, &document, &shown(&section), &paths)?;
    Ok(status(&calibration, &assessment.findings))
}

/// Compares models in at most `folds` folds, with a progress bar.
pub(super) fn compared(
    calibration: &Calibration,
    board: &Board,
    folds: usize,
    quiet: bool,
) -> Result<ModelComparison> {
    let folds = folds.min(calibration.poses.len());
    let bar = progress::steps(quiet, comparison_steps(calibration, folds), "comparing models");
    let comparison = compare_models(calibration, board, folds, &|| bar.inc());
    bar.finish();
    comparison
}

/// Returns the exit status of a calibration with these findings, and prints the reason if its result should not be used.
pub(super) fn status(calibration: &Calibration, findings: &[Finding]) -> ExitCode {
    let names = Parameter::shared(calibration.camera.lens_types());
    let unknown = calibration.uncertainty.undetermined_intrinsics();
    let unknown: Vec<&str> = unknown.into_iter().map(|index| names[index].name()).collect();
    let (status, why) = if !calibration.converged {
        let more = match calibration.refinement.termination {
            Termination::IterationLimit => " Raise --max-iterations.",
            _ => "",
        };
        (3, format!("not converged: {}{more}", termination_text(calibration)))
    } else if !unknown.is_empty() {
        let remedy = "Take frames at other distances and tilts, or fix these parameters (--fix)";
        (3, format!("not determined: {}. {remedy}", unknown.join(", ")))
    } else {
        return verdict_status(findings).unwrap_or(ExitCode::SUCCESS);
    };
    say(&format!("error: {why}"));
    ExitCode::from(status)
}

/// Returns true if the calibration estimated a camera; with poses only, the camera is unchanged.
fn has_camera(calibration: &Calibration) -> bool {
    !calibration.uncertainty.free_intrinsics.is_empty()
}

/// Stages the results of a calibration.
pub(super) fn stage_results(
    output: &mut OutputFolder,
    (calibration, assessment): (&Calibration, &Assessment),
    with_compote: bool,
) -> Result<()> {
    let uncertainty = Some(&calibration.uncertainty);
    let poses = io::poses_document(&calibration.poses, uncertainty, &calibration.shifted_frames);
    if with_compote {
        let grid = calibration.grid.as_ref().ok_or_else(|| {
            Error::invalid("COMPOTE's intrinsics.js needs the micro-image centres")
        })?;
        let lens = &calibration.camera.main_lens;
        let has_pupil = lens.exit_pupil_mm.norm() > 0.0 || lens.pupil_aberration_per_mm != 0.0;
        let is_tilted = lens.rotation_rad.iter().any(|angle| *angle != 0.0);
        if has_pupil || is_tilted || lens.has_curved_field() || lens.q1_growth_per_mm2 != 0.0 {
            say(
                "warning: intrinsics.js has no exit pupil, no field curvature, no tilt of the lens \
                 and the same distortion at all distances, so intrinsics.js describes another \
                 camera: calibrate with --exit-pupil at-lens --field-curvature flat --distortion \
                 constant --lens-tilt none",
            );
        }
        let folder = Path::new("compote");
        let intrinsics = compote::intrinsics_document(&calibration.camera, grid)?;
        output.stage_json(folder.join("intrinsics.js"), &intrinsics)?;
        output.stage_json(folder.join("poses.js"), &compote::poses_document(&calibration.poses))?;
    }
    if has_camera(calibration) {
        output
            .stage_json("camera.json", &io::calibrated_camera_document(calibration, assessment))?;
    }
    output.stage_json("poses.json", &poses)?;
    output.stage("residuals.csv", |out| io::write_residuals(out, &calibration.reprojection))?;
    output.stage("solver.txt", |out| out.write_all(calibration.refinement.report.as_bytes()))
}

/// Returns the values of `--set`, with `--method` as the last of them.
pub(super) fn with_method(set: &[String], method: Option<Method>) -> Vec<String> {
    let name = method.and_then(|method| method.to_possible_value());
    let method = name.map(|name| format!("calibration.method={}", name.get_name()));
    set.iter().cloned().chain(method).collect()
}

impl Arguments {
    /// Reads the project, with `--set` and `--method` applied.
    fn project(&self) -> Result<Project> {
        let set = with_method(&self.set, self.method);
        match &self.project {
            Some(path) => Project::read_and_set(path, &set),
            None => Project::of_values(&set),
        }
    }

    /// Reads all inputs of a calibration, from the project and the flags.
    fn input(&self) -> Result<Input> {
        let project = self.project()?;
        let options = self.options_over(project.calibration.clone())?;
        Input::read(&self.files(), &project, options)
    }

    /// Evaluates the cost at the camera and the poses in the given files.
    fn evaluate(&self, (camera, poses): (&Path, &Path), output: cost::Output) -> Result<ExitCode> {
        let solution = cost::solution(camera, poses)?;
        if let Some(problem) = &self.problem {
            let threads = self.options_over(CalibrationOptions::default())?.threads;
            return cost::of_problem(
                &solution,
                problem,
                self.board_shape.as_deref(),
                threads,
                output,
            );
        }
        let input = self.input()?;
        let folders = [camera, poses].map(|path| path.parent().unwrap_or(Path::new("")));
        cost::of_project(&solution, &folders, &input, output)
    }

    /// Returns the options, overridden by the flags.
    fn options_over(&self, mut options: CalibrationOptions) -> Result<CalibrationOptions> {
        self.options.apply(&mut options)?;
        match self.priors {
            Some(DefaultPriors::None) => {
                options.priors = Priors { default: false, ..Priors::default() };
            }
            Some(DefaultPriors::Default) => options.priors.default = true,
            None => {}
        }
        options.priors.state_all(&self.prior)?;
        Ok(options)
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
