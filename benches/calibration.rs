//! Speed of the calibration against a plain Ceres program, in one run.
//!
//! Uses the R12-A observations in the folder `PLENOCAL_R12A`, or else the shipped feature set, and
//! the program `plain_ceres` in the folder `PLENOCAL_EXAMPLES` (`cpp/examples`) as the baseline: one residual
//! block per observation, the same tolerance, otherwise Ceres' defaults. The programs alternate, so
//! that a slow moment of the machine affects both. Medians are printed; their ratio is what counts.

use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use plenocal::calibration::{CalibrationOptions, SolvedProblem, Start, calibrate};
use plenocal::io::{
    CameraSource, OutputFolder, Project, read_board, read_camera_source, read_centers,
    read_features, read_internal_parameters, stage_problem,
};
use plenocal::model::{Board, Observations};
use plenocal::precalibration::fit_grid;
use serde_json::Value;

/// Number of runs: enough for a median; a run of the baseline takes seconds.
const RUNS: usize = 7;

struct Data {
    name: &'static str,
    centers: PathBuf,
    features: PathBuf,
    start: Start,
    board: Board,
}

fn r12a(folder: &Path) -> plenocal::Result<Data> {
    let CameraSource::Datasheet(sheet) = read_camera_source(&folder.join("camera.js"))? else {
        panic!("camera.js is a datasheet");
    };
    let pixel = Some(sheet.sensor.pixel_size_mm);
    let internal = read_internal_parameters(&folder.join("params.js"), pixel)?;
    Ok(Data {
        name: "R12-A",
        centers: folder.join("center-R12-A.csv"),
        features: folder.join("bap-R12-A.csv"),
        start: Start::Datasheet(sheet, internal),
        board: read_board(&folder.join("scene.js"))?,
    })
}

fn shipped() -> plenocal::Result<Data> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/synthetic");
    let project = Project::read(&folder.join("project.toml"))?;
    let sheet = project.datasheet()?.expect("the shipped project has a camera");
    let internal =
        project.internal_parameters.expect("the shipped project has internal parameters");
    Ok(Data {
        name: "the shipped feature set",
        centers: folder.join("centers.csv"),
        features: folder.join("features.csv"),
        start: Start::Datasheet(sheet, internal),
        board: project.board.expect("the shipped project has a board"),
    })
}

fn read(data: &Data) -> plenocal::Result<Observations> {
    let mut observations = read_features(&data.features, true)?;
    observations.centers = read_centers(&data.centers)?;
    Ok(observations)
}

/// Seconds of the solve, iterations and cost of the baseline on an exported problem.
fn baseline(program: &Path, problem: &Path, threads: usize) -> (f64, u64, f64) {
    let output = Command::new(program)
        .arg(problem)
        .arg("--out")
        .arg(problem.join(".."))
        .args(["--threads", &threads.to_string()])
        .output()
        .expect("the baseline can be run");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let result: Value = serde_json::from_slice(&output.stdout).expect("the baseline prints JSON");
    let number = |name: &str| result[name].as_f64().expect("the baseline prints this number");
    (number("time_s"), result["iterations"].as_u64().unwrap_or(0), number("cost"))
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

fn seconds<T>(work: impl FnOnce() -> T) -> f64 {
    let start = Instant::now();
    black_box(work());
    start.elapsed().as_secs_f64()
}

fn compare(program: &Path, data: &Data, observations: &Observations, threads: usize) {
    let options = CalibrationOptions { threads, ..CalibrationOptions::paper() };
    let defaults = CalibrationOptions { threads, ..CalibrationOptions::default() };
    let mut without = options.clone();
    without.extrapolate = false;
    let (mut plain, mut solve, mut whole) = (Vec::new(), Vec::new(), Vec::new());
    let (mut ceres, mut ceres_iterations) = (Vec::new(), 0);
    let (mut prior_solve, mut prior_whole) = (Vec::new(), Vec::new());
    let (mut plain_end, mut end) = ((0, 0.0), (0, 0.0));
    let folder = tempfile::tempdir().expect("there is room for the problem");
    let problem = folder.path().join("problem");
    let solved = calibrate(&data.start, &data.board, observations, &options, &mut |_| true)
        .expect("the data can be calibrated");
    let mut output = OutputFolder::new(&problem).expect("there is room for the problem");
    stage_problem(&mut output, &SolvedProblem::of(&solved, &data.board)).expect("there is room");
    output.commit().expect("there is room");
    for _ in 0..RUNS {
        let (time, iterations, cost) = baseline(program, &problem, threads);
        plain.push(time);
        plain_end = (iterations, cost);
        let alone = calibrate(&data.start, &data.board, observations, &without, &mut |_| true)
            .expect("the data can be calibrated");
        ceres.push(alone.refinement.time_s);
        ceres_iterations = alone.refinement.iterations.len() - 1;
        let start = Instant::now();
        let calibration =
            calibrate(&data.start, &data.board, observations, &options, &mut |_| true)
                .expect("the data can be calibrated");
        whole.push(start.elapsed().as_secs_f64());
        assert!(calibration.converged);
        let refinement = &calibration.refinement;
        solve.push(refinement.time_s);
        end = (refinement.iterations.len() - 1, refinement.cost);
        let start = Instant::now();
        let calibration =
            calibrate(&data.start, &data.board, observations, &defaults, &mut |_| true)
                .expect("the data can be calibrated");
        prior_whole.push(start.elapsed().as_secs_f64());
        prior_solve.push(calibration.refinement.time_s);
    }
    let (plain, solve, whole) = (median(plain), median(solve), median(whole));
    println!("{threads} thread(s), cold start to convergence, median of {RUNS} runs:");
    println!(
        "  plain Ceres program        {plain:7.3} s  {:3} iterations  cost {:.6}",
        plain_end.0, plain_end.1
    );
    println!(
        "  plenocal, refinement       {solve:7.3} s  {:3} iterations  cost {:.6}",
        end.0, end.1
    );
    println!(
        "  without extrapolation      {:7.3} s  {ceres_iterations:3} iterations",
        median(ceres)
    );
    println!(
        "  plenocal, whole stage      {whole:7.3} s  (grid, initial values, refinement, uncertainty)"
    );
    println!("  with priors, refinement   {:7.3} s", median(prior_solve.clone()));
    println!("  with priors, whole stage  {:7.3} s", median(prior_whole));
    println!("  priors to none             {:7.3}", median(prior_solve) / solve);
    println!("  ratio of the refinements   {:7.3}", solve / plain);
    println!("  ratio of the whole stage   {:7.3}", whole / plain);
}

fn main() -> plenocal::Result<()> {
    let data = match std::env::var_os("PLENOCAL_R12A") {
        Some(folder) => r12a(Path::new(&folder))?,
        None => shipped()?,
    };
    let observations = read(&data)?;
    println!(
        "Calibration of {}: {} features, {} centres",
        data.name,
        observations.features.len(),
        observations.centers.len()
    );
    let reading = median((0..RUNS).map(|_| seconds(|| read(&data))).collect());
    println!("  reading the CSV files      {reading:7.3} s");
    if let Start::Datasheet(sheet, _) = &data.start {
        let (columns, rows) = sheet.array_size_by(&observations.centers);
        let fit = || fit_grid(&observations.centers, sheet.lattice_kind, columns, rows);
        println!(
            "  fitting the grid           {:7.3} s",
            median((0..RUNS).map(|_| seconds(fit)).collect())
        );
    }
    match std::env::var_os("PLENOCAL_EXAMPLES") {
        Some(folder) => {
            for threads in [1, 2] {
                compare(&Path::new(&folder).join("plain_ceres"), &data, &observations, threads);
            }
        }
        None => println!("Set PLENOCAL_EXAMPLES (or run `make bench`) for the comparison."),
    }
    Ok(())
}
