//! How the time grows with the work: image size, frames, features and threads.
//!
//! The tables are those of docs/performance.md. Each ends with the exponent: the slope of the logarithm of the time over that
//! of the work. Runs are single ones; what counts is how they grow.

use std::hint::black_box;
use std::time::Instant;

use plenocal::calibration::{Calibration, CalibrationOptions, Start, calibrate};
use plenocal::detection::{DepthEstimator, MicroImages, Search, detect_frame};
use plenocal::model::{BapFeature, FramePose, Noise, Observations, optics};
use plenocal::precalibration::{PrecalibrationOptions, White, precalibrate};
use plenocal::simulation::{DataSet, Settings, Shot};
use plenocal::solver::synthesize;

/// Frames of an image size.
const FRAMES: usize = 2;
/// Frames among which features are divided.
const FRAMES_OF_FEATURES: usize = 24;
const NOISE: Noise = Noise { uv_px: 0.05, rho_px: 0.01, centers_px: 0.02 };

fn seconds<T>(work: impl FnOnce() -> T) -> (f64, T) {
    let start = Instant::now();
    let result = black_box(work());
    (start.elapsed().as_secs_f64(), result)
}

fn with_threads<T: Send>(threads: usize, work: impl FnOnce() -> T + Send) -> T {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    pool.expect("threads can be started").install(work)
}

/// The slope of ln y over ln x.
fn exponent(points: &[(f64, f64)]) -> f64 {
    let n = points.len() as f64;
    let logs = || points.iter().map(|(x, y)| (x.ln(), y.ln()));
    let (x, y) = logs().fold((0.0, 0.0), |sum, (x, y)| (sum.0 + x / n, sum.1 + y / n));
    let (up, along) = logs()
        .fold((0.0, 0.0), |sum, (a, b)| (sum.0 + (a - x) * (b - y), sum.1 + (a - x) * (a - x)));
    up / along
}

/// Prints the last row of a table: the exponents of the columns, after so many columns without one.
fn print_exponents(rows: &[Vec<f64>], without: usize) {
    let of =
        |column: usize| exponent(&rows.iter().map(|row| (row[0], row[column])).collect::<Vec<_>>());
    let all: Vec<String> = (1..rows[0].len()).map(|column| format!("{:.2}", of(column))).collect();
    println!("| exponent |{} {} |\n", " |".repeat(without), all.join(" | "));
}

/// Prints the headings of a table.
fn print_headings(columns: &[&str]) {
    println!("| {} |\n{}|", columns.join(" | "), "|---".repeat(columns.len()));
}

/// The preset r12-a with a sensor, an array and a board that are larger in both directions by a part.
fn scaled(part: f64) -> plenocal::Result<Settings> {
    let set = |key: &str, value: f64| format!("{key}={}", (value * part).round());
    let squares = |key: &str, count: f64| format!("{key}={}", (count * part).round() - 1.0);
    let middle = [2042.55, 1556.29].map(|px| px * part);
    Settings::preset(
        "r12-a",
        &[
            "rays=64".to_owned(),
            set("camera.sensor.width_px", 4080.0),
            set("camera.sensor.height_px", 3068.0),
            set("camera.micro_lens_array.columns", 176.0),
            set("camera.micro_lens_array.rows", 152.0),
            format!("camera.principal_point_px={middle:?}"),
            squares("target.columns", 10.0),
            squares("target.rows", 6.0),
        ],
    )
}

fn image_size(part: f64) -> plenocal::Result<Vec<f64>> {
    let settings = scaled(part)?;
    let data_set = DataSet::plan(&settings, None)?;
    let white = |shot: &Shot| {
        let image = shot.take(&settings, &|| ())?;
        Ok(White { name: String::new(), f_number: shot.f_number, image })
    };
    let whites = data_set.whites.iter().map(white).collect::<plenocal::Result<Vec<White>>>()?;
    let reference = white(&data_set.devignetting)?;
    let (sheet, board) = (settings.datasheet(), settings.target.board());
    let options = PrecalibrationOptions::of_datasheet(&sheet);
    let (whites_s, measured) =
        seconds(|| precalibrate(&whites, Some(&reference), &options, &|| ()));
    let micro_images = MicroImages::of_precalibration(&measured?, &sheet)?;
    let estimator = DepthEstimator::Line;
    let search =
        Search { micro_images: &micro_images, board: &board, sensor: &sheet.sensor, estimator };
    let levels = micro_images.levels.as_ref();
    let white = reference.image.grey_between(levels);
    let (mut simulation_s, mut detection_s, mut features) = (0.0, 0.0, 0);
    for (pose, shot) in data_set.subsets[0].iter().take(FRAMES) {
        let (time, image) = seconds(|| shot.take(&settings, &|| ()));
        let image = image?;
        simulation_s += time / FRAMES as f64;
        let (time, (found, _)) =
            seconds(|| detect_frame(pose.frame, &image.grey_between(levels), &white, &search));
        detection_s += time / FRAMES as f64;
        features += found.map_or(0, |found| found.features.len()) / FRAMES;
    }
    let megapixels = f64::from(sheet.sensor.width_px) * f64::from(sheet.sensor.height_px) / 1e6;
    println!(
        "| {megapixels:.1} | {features} | {simulation_s:.2} | {whites_s:.2} | {detection_s:.3} |"
    );
    Ok(vec![megapixels, simulation_s, whites_s, detection_s])
}

/// Poses of a board before the camera of r12-a, and what is seen of it.
fn observed(replaced: &[&str], frames: usize) -> plenocal::Result<(Settings, Observations)> {
    let mut all: Vec<String> = replaced.iter().map(|&set| set.to_owned()).collect();
    all.push(format!("boards.calibration={frames}"));
    let settings = Settings::preset("r12-a", &all)?;
    let data_set = DataSet::plan(&settings, None)?;
    let poses: Vec<FramePose> = data_set.subsets[0].iter().map(|(pose, _)| *pose).collect();
    let board = settings.target.board();
    let observations = synthesize(&settings.camera, &board, &poses, &NOISE, 1)?;
    Ok((settings, observations))
}

fn calibrated(
    settings: &Settings,
    observations: &Observations,
    threads: usize,
) -> plenocal::Result<(f64, Calibration)> {
    let internal = optics::internal_parameters(&settings.camera);
    let start = Start::Datasheet(settings.datasheet(), internal);
    let options = CalibrationOptions { threads, ..CalibrationOptions::default() };
    let board = settings.target.board();
    let (time, result) = with_threads(threads, || {
        seconds(|| calibrate(&start, &board, observations, &options, &mut |_| true))
    });
    Ok((time, result?))
}

/// Measures the time of the refinement and of the whole stage with one thread and with two, and prints them after some cells.
fn row(
    cells: &str,
    work: f64,
    settings: &Settings,
    observations: &Observations,
) -> plenocal::Result<Vec<f64>> {
    let mut row = vec![work];
    for threads in [1, 2] {
        let (whole, result) = calibrated(settings, observations, threads)?;
        row.extend([result.refinement.time_s, whole]);
    }
    let [_, one, whole_of_one, two, whole_of_two] = row[..] else { unreachable!("two by two") };
    println!("| {cells} | {one:.3} | {whole_of_one:.2} | {two:.3} | {whole_of_two:.2} |");
    Ok(row)
}

/// Columns of times, in s.
const TIMES: [&str; 4] =
    ["one thread: refinement, s", "whole stage, s", "two threads: refinement, s", "whole stage, s"];

fn main() -> plenocal::Result<()> {
    println!(
        "An R12 with a larger sensor, array and board; simulation and detection of a board, and pre-calibration of five \
         white images, with {} threads:\n",
        rayon::current_num_threads()
    );
    print_headings(&["MP", "features", "simulation, s", "pre-calibration, s", "detection, s"]);
    let rows = [0.5, 1.0, std::f64::consts::SQRT_2, 2.0]
        .into_iter()
        .map(image_size)
        .collect::<plenocal::Result<Vec<_>>>()?;
    print_exponents(&rows, 1);

    println!("Frames of an R12, default calibration:\n");
    print_headings(&[&["frames", "features"][..], &TIMES].concat());
    let mut rows = Vec::new();
    for frames in [5, 10, 20, 50, 100] {
        let (settings, observations) = observed(&[], frames)?;
        let cells = format!("{frames} | {}", observations.features.len());
        rows.push(row(&cells, frames as f64, &settings, &observations)?);
    }
    print_exponents(&rows, 1);

    println!("{FRAMES_OF_FEATURES} frames with more features each:\n");
    print_headings(&[&["features"][..], &TIMES].concat());
    let fine = ["target.columns=39", "target.rows=23", "target.square_mm=2.5"];
    let (settings, all) = observed(&fine, FRAMES_OF_FEATURES)?;
    let mut rows = Vec::new();
    for count in [1_000, 10_000, 100_000, 1_000_000] {
        let step = (all.features.len() / count).max(1);
        let features: Vec<BapFeature> = all.features.iter().step_by(step).copied().collect();
        let some =
            Observations { features, centers: all.centers.clone(), ..Observations::default() };
        let features = some.features.len();
        rows.push(row(&features.to_string(), features as f64, &settings, &some)?);
    }
    print_exponents(&rows, 0);
    Ok(())
}
