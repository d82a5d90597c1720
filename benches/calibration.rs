//! Speed of the calibration against a plain Ceres program, in one run.
//!
//! Uses the R12-A observations in the folder `PLENOCAL_R12A`, or else the shipped feature set, and
//! the program `plain_ceres` in the folder `PLENOCAL_EXAMPLES` (`cpp/examples`) as the baseline: one residual
//! block per observation, the same tolerance, otherwise Ceres' defaults. The programs alternate, so
//! that a slow moment of the machine affects both. The table is that of docs/performance.md; ratios are what counts.

use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use plenocal::calibration::{Calibration, CalibrationOptions, SolvedProblem, Start, calibrate};
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

/// Median times with a number of threads, s, with numbers of iterations, and costs at the end.
struct Times {
    plain: (f64, u64, f64),
    refinement: (f64, usize, f64),
    without_extrapolation: (f64, usize),
    whole: f64,
    default_refinement: f64,
    default_whole: f64,
}

fn compare(program: &Path, data: &Data, observations: &Observations, threads: usize) -> Times {
    let options = CalibrationOptions { threads, ..CalibrationOptions::paper() };
    let defaults = CalibrationOptions { threads, ..CalibrationOptions::default() };
    let without = CalibrationOptions { extrapolate: false, ..options.clone() };
    let folder = tempfile::tempdir().expect("there is room for the problem");
    let problem = folder.path().join("problem");
    let run = |options: &CalibrationOptions| {
        let start = Instant::now();
        let result = calibrate(&data.start, &data.board, observations, options, &mut |_| true)
            .expect("the data can be calibrated");
        (start.elapsed().as_secs_f64(), result)
    };
    let (_, solved) = run(&options);
    let mut output = OutputFolder::new(&problem).expect("there is room for the problem");
    stage_problem(&mut output, &SolvedProblem::of(&solved, &data.board)).expect("there is room");
    output.commit().expect("there is room");
    let (mut plain, mut solve, mut whole, mut alone) = (vec![], vec![], vec![], vec![]);
    let (mut prior_solve, mut prior_whole) = (vec![], vec![]);
    let (mut plain_end, mut alone_iterations) = ((0, 0.0), 0);
    let iterations = |result: &Calibration| result.refinement.iterations.len() - 1;
    for _ in 0..RUNS {
        let (time, iterations_of_plain, cost) = baseline(program, &problem, threads);
        plain.push(time);
        plain_end = (iterations_of_plain, cost);
        let (_, result) = run(&without);
        alone.push(result.refinement.time_s);
        alone_iterations = iterations(&result);
        let (time, result) = run(&options);
        assert!(result.converged);
        whole.push(time);
        solve.push(result.refinement.time_s);
        let (time, result) = run(&defaults);
        prior_whole.push(time);
        prior_solve.push(result.refinement.time_s);
    }
    Times {
        plain: (median(plain), plain_end.0, plain_end.1),
        refinement: (median(solve), iterations(&solved), solved.refinement.cost),
        without_extrapolation: (median(alone), alone_iterations),
        whole: median(whole),
        default_refinement: median(prior_solve),
        default_whole: median(prior_whole),
    }
}

/// Prints a row of the table, with a column for each number of threads.
fn row(name: &str, all: &[Times], cell: impl Fn(&Times) -> String) {
    let cells: Vec<String> = all.iter().map(cell).collect();
    println!("| {name} | {} |", cells.join(" | "));
}

fn print_table(all: &[Times]) {
    println!("\n| cold start to convergence, median of {RUNS} runs | 1 thread | 2 threads |");
    println!("|---|---|---|");
    let seconds = |time: f64| format!("{time:.3} s");
    row("plain Ceres program", all, |t| format!("{:.3} s, {} iterations", t.plain.0, t.plain.1));
    row("plenocal, refinement", all, |t| {
        format!("{:.3} s, {} iterations", t.refinement.0, t.refinement.1)
    });
    row("without extrapolation", all, |t| {
        let (time, iterations) = t.without_extrapolation;
        format!("{time:.3} s, {iterations} iterations")
    });
    row("cost by Ceres; by plenocal", all, |t| format!("{:.6}; {:.6}", t.plain.2, t.refinement.2));
    row("with grid, initial values and uncertainty", all, |t| seconds(t.whole));
    row("ratio of the refinements", all, |t| format!("{:.3}", t.refinement.0 / t.plain.0));
    row("ratio with grid, initial values and uncertainty", all, |t| {
        format!("{:.3}", t.whole / t.plain.0)
    });
    row("refinement with priors and board shape (the default)", all, |t| {
        seconds(t.default_refinement)
    });
    row("the default with grid, initial values and uncertainty", all, |t| seconds(t.default_whole));
}

fn main() -> plenocal::Result<()> {
    let data = match std::env::var_os("PLENOCAL_R12A") {
        Some(folder) => r12a(Path::new(&folder))?,
        None => shipped()?,
    };
    let observations = read(&data)?;
    println!(
        "Calibration of {}: {} features, {} centres.",
        data.name,
        observations.features.len(),
        observations.centers.len()
    );
    let reading = median((0..RUNS).map(|_| seconds(|| read(&data))).collect());
    println!("Reading the CSV files takes {reading:.3} s.");
    if let Start::Datasheet(sheet, _) = &data.start {
        let (columns, rows) = sheet.array_size_by(&observations.centers);
        let fit = || fit_grid(&observations.centers, sheet.lattice_kind, columns, rows);
        let fitting = median((0..RUNS).map(|_| seconds(fit)).collect());
        println!("Fitting the grid takes {fitting:.3} s.");
    }
    match std::env::var_os("PLENOCAL_EXAMPLES") {
        Some(folder) => {
            let program = Path::new(&folder).join("plain_ceres");
            print_table(&[1, 2].map(|threads| compare(&program, &data, &observations, threads)));
        }
        None => println!("Set PLENOCAL_EXAMPLES (or run `make bench`) for the comparison."),
    }
    Ok(())
}
