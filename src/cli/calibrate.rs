//! `plenocal calibrate`: from observations to a camera.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::{Duration, Instant};

use clap::Args;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use plenocal::calibration::{Calibration, calibrate};
use plenocal::io::{self, CalibrationSection, ModeName, OutputFolder, Pitches, compote};
use plenocal::solver::{Iteration, LossKind};
use plenocal::{Error, Result, report};

use super::input::{Files, Input};
use super::{progress, tell, warn};

/// Calibrate a camera from micro-image centres and BAP features.
///
/// Give a project file, or the single files, or both: what is given singly goes before the project.
/// Files are told apart by what is in them, so plenocal's own and COMPOTE's can be mixed.
// Parameter names in the help are no code.
#[allow(clippy::doc_markdown)]
#[derive(Args)]
#[command(after_help = EXAMPLES, allow_negative_numbers = true)]
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

    /// What to estimate [default: full].
    #[arg(long, value_enum, help_heading = "Estimation")]
    mode: Option<ModeName>,
    /// One micro-lens pitch, or one along x and one along y [default: one].
    #[arg(long, value_enum, help_heading = "Estimation")]
    pitches: Option<Pitches>,
    /// Parameters that keep their initial value, e.g. F,Q3: of F, Q1 to Q3, P1, P2, u0, v0, d,
    /// theta_x to theta_z, t_x, t_y, D, dC, f_1 to f_3. (dC_ratio is held unless --pitches two.)
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
    loss: Option<LossKind>,
    /// Where the loss sets in, standard deviations [default: 1].
    #[arg(long, value_name = "N", help_heading = "Estimation")]
    loss_scale: Option<f64>,
    /// Limit of iterations [default: 200].
    #[arg(long, value_name = "N", help_heading = "Estimation")]
    max_iterations: Option<usize>,
    /// Threads of the solver; with 1 the results are the same to the last bit, with more they
    /// differ by rounding [default: all cores].
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
  plenocal calibrate --mode poses-only --camera results/camera.json --scene scene.js \\
      --features evaluation.csv --out poses";

/// How often the progress line moves.
const TICK: Duration = Duration::from_millis(100);

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<ExitCode> {
    let begun = Instant::now();
    let mut output = OutputFolder::new(&arguments.out)?;
    let (json, with_compote) = (arguments.json, arguments.compote);
    let input = Input::read(&arguments.files(), arguments.options())?;

    let bar = progress_bar(json);
    let calibration = calibrate(
        &input.start,
        &input.board,
        &input.observations,
        &input.options,
        &mut |iteration: &Iteration| {
            bar.set_message(format!("iteration {}, cost {:.6}", iteration.number, iteration.cost));
            true
        },
    );
    bar.finish_and_clear();
    let calibration = calibration?;

    stage_results(&mut output, &calibration, with_compote)?;
    let paths = output.commit()?;
    warn(&calibration.left_out);
    warn(&calibration.warnings);
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
    tell(&format!("error: not converged: {}", report::termination_text(&calibration)));
    Ok(ExitCode::from(3))
}

fn progress_bar(json: bool) -> ProgressBar {
    if json || !progress::is_shown() {
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

/// Writes the results of a calibration.
pub(super) fn stage_results(
    output: &mut OutputFolder,
    calibration: &Calibration,
    with_compote: bool,
) -> Result<()> {
    let uncertainty = Some(&calibration.uncertainty);
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
    // With the camera held there is no new one.
    if !calibration.uncertainty.free_intrinsics.is_empty() {
        output.stage_json("camera.json", &report::calibrated_camera(calibration))?;
    }
    output.stage_json("poses.json", &poses)?;
    output.stage("residuals.csv", |out| io::write_residuals(out, &calibration.reprojection))?;
    output.stage("solver.txt", |out| out.write_all(calibration.refinement.report.as_bytes()))
}

impl Arguments {
    fn options(&self) -> CalibrationSection {
        CalibrationSection {
            mode: self.mode,
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

    fn files(&self) -> Files<'_> {
        Files {
            project: self.project.as_deref(),
            camera: self.camera.as_deref(),
            params: self.params.as_deref(),
            scene: self.scene.as_deref(),
            centers: self.centers.as_deref(),
            features: self.features.as_deref(),
        }
    }
}
