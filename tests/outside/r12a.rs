//! The real observations of R12-A: the minimum that independent Ceres programs found.

use std::path::Path;

use plenocal::calibration::{Calibration, CalibrationOptions, Mode, Pitches, Start, calibrate};
use plenocal::io::{
    CameraSource, read_board, read_camera_source, read_centers, read_features,
    read_internal_parameters,
};
use plenocal::model::{Board, Observations, Parameter};

use rayon::prelude::*;

use crate::needs::R12A;
use crate::support::{defaults, options, pairs};

/// The minimum with the CSV files, from `cpp/examples/plain_ceres`, and half a unit of its last digit.
const MINIMUM_CSV: f64 = 7_188.390_898;
/// The minimum with one pitch per axis.
const MINIMUM_CSV_TWO_PITCHES: f64 = 7_156.377_169;
/// The binary file has the same observations with more digits, so its minimum differs.
const MINIMUM_BINARY: f64 = 7_188.690_787;
const MINIMUM_BINARY_TWO_PITCHES: f64 = 7_156.690_526;
const HALF_A_DIGIT: f64 = 1e-6;

pub struct Data {
    start: Start,
    pub board: Board,
    observations: Observations,
}

fn start(folder: &Path) -> Start {
    match read_camera_source(&folder.join("camera.js")).unwrap() {
        CameraSource::Datasheet(sheet) => {
            let pixel = Some(sheet.sensor.pixel_size_mm);
            let internal = read_internal_parameters(&folder.join("params.js"), pixel).unwrap();
            Start::Datasheet(sheet, internal)
        }
        CameraSource::Camera(_) => panic!("camera.js is a datasheet"),
    }
}

pub fn csv() -> Data {
    let folder = R12A.folder();
    let mut observations = read_features(&folder.join("bap-R12-A.csv"), true).unwrap();
    observations.centers = read_centers(&folder.join("center-R12-A.csv")).unwrap();
    let board = read_board(&folder.join("scene.js")).unwrap();
    Data { start: start(&folder), board, observations }
}

fn binary() -> Data {
    let folder = R12A.folder();
    let file = folder.join("linked-observations-R12-A.bin.gz");
    Data { observations: read_features(&file, true).unwrap(), ..csv() }
}

pub fn run(data: &Data, options: &CalibrationOptions) -> Calibration {
    calibrate(&data.start, &data.board, &data.observations, options, &mut |_| true).unwrap()
}

fn two_pitches() -> CalibrationOptions {
    let mut options = options();
    options.pitches = Pitches::Two;
    options
}

fn assert_minimum(calibration: &Calibration, minimum: f64) {
    let cost = calibration.refinement.cost;
    assert!(calibration.converged);
    assert!((cost - minimum).abs() < HALF_A_DIGIT, "{cost} for {minimum}");
}

fn assert_published_errors(calibration: &Calibration) {
    let rmse = calibration.reprojection.rmse();
    assert_eq!(format!("{:.4}", rmse.all_px), "0.9137");
    assert_eq!(format!("{:.4}", rmse.uv_px), "0.9119");
    assert_eq!(format!("{:.4}", rmse.rho_px.unwrap()), "0.0579");
    assert_eq!(format!("{:.4}", calibration.reprojection.centers_rmse_px().unwrap()), "0.2881");
    assert_eq!(format!("{:.2}", calibration.camera.main_lens.focal_length_mm), "54.74");
}

pub fn the_csv_files_give_the_known_minimum() {
    let data = csv();
    assert_eq!(
        (data.observations.features.len(), data.observations.centers.len()),
        (14_569, 26_676)
    );
    let calibration = run(&data, &options());
    assert_minimum(&calibration, MINIMUM_CSV);
    assert_published_errors(&calibration);
    assert!(calibration.left_out.is_empty());
    assert_eq!(calibration.uncertainty.rank, 19 + 6 * 16);
    assert_minimum(&run(&data, &two_pitches()), MINIMUM_CSV_TWO_PITCHES);
}

pub fn the_binary_file_gives_the_same_camera() {
    let data = binary();
    assert_eq!(
        (data.observations.features.len(), data.observations.centers.len()),
        (14_569, 26_676)
    );
    let calibration = run(&data, &options());
    assert_minimum(&calibration, MINIMUM_BINARY);
    assert_published_errors(&calibration);
    assert_minimum(&run(&data, &two_pitches()), MINIMUM_BINARY_TWO_PITCHES);
}

pub fn the_initial_values_are_those_of_table_1() {
    let data = csv();
    let calibration = run(&data, &options());
    let mla = &calibration.initial.mla;
    assert_eq!(format!("{:.4}", mla.lens_to_mla_mm), "56.6576");
    assert_eq!(format!("{:.3}", mla.mla_to_sensor_mm * 1e3), "318.632");
    assert_eq!(format!("{:.3}", mla.pitch_mm * 1e3), "127.505");
    let f: Vec<String> = mla.focal_lengths_mm.iter().map(|f| format!("{:.3}", f * 1e3)).collect();
    assert_eq!(f, ["578.154", "504.456", "551.667"]);
    assert!(calibration.initial_centers_rmse_px.unwrap() < 1.0);
    let grid = calibration.grid.unwrap();
    assert_eq!(format!("{:.3}", grid.pitch_px), "23.312");
}

/// The valley is long and flat; the same minimum has to be reached from any start nearby.
pub fn a_disturbed_start_ends_at_the_same_minimum() {
    let data = csv();
    let reference = run(&data, &options());
    // Up and down by 2 to 4 per cent; parameters that start at zero are shifted.
    for factors in [[1.03, 0.97, 1.04, 0.98], [0.97, 1.03, 0.96, 1.02]] {
        let mut camera = reference.initial.clone();
        let [f, d, focal, shift] = factors;
        camera.main_lens.focal_length_mm *= f;
        camera.mla.mla_to_sensor_mm *= d;
        camera.mla.lens_to_mla_mm *= f;
        camera.mla.focal_lengths_mm.iter_mut().for_each(|v| *v *= focal);
        camera.mla.principal_point_px *= shift;
        camera.mla.rotation_rad.x += 2e-3;
        let disturbed = Data {
            start: Start::Camera(camera),
            board: data.board,
            observations: data.observations.clone(),
        };
        let calibration = run(&disturbed, &options());
        assert_minimum(&calibration, MINIMUM_CSV);
        let std_devs = calibration.uncertainty.intrinsic_std_devs(3);
        for ((name, a, b), s) in pairs(&calibration.camera, &reference.camera).iter().zip(std_devs)
        {
            // A thousandth of the uncertainty.
            assert!((a - b).abs() <= 1e-3 * s.unwrap_or(0.0), "{name}: {a} and {b}");
        }
    }
}

/// The published camera, with the poses refined. It reprojects the centres nearly as well as the
/// optimum (0.288 px), which shows that the conventions are interpreted correctly. Its blur radii
/// are off because COMPOTE computes them with d at one corner of its tilted array.
pub fn the_published_camera_reprojects_centres_and_corners() {
    let folder = R12A.folder();
    let CameraSource::Camera(camera) = read_camera_source(&folder.join("intrinsics.js")).unwrap()
    else {
        panic!("intrinsics.js is a camera");
    };
    let options = CalibrationOptions { mode: Mode::PosesOnly, ..options() };
    let data = Data { start: Start::Camera(*camera.clone()), ..csv() };
    let calibration = run(&data, &options);
    assert!(calibration.converged);
    assert_eq!(calibration.camera, *camera);
    let rmse = calibration.reprojection.rmse();
    assert!(calibration.reprojection.centers_rmse_px().unwrap() < 0.30);
    assert!(rmse.uv_px < 0.98, "{}", rmse.uv_px);

    let published = plenocal::io::read_poses(&folder.join("poses.js")).unwrap();
    assert_eq!(published.len(), calibration.poses.len());
    for pose in &calibration.poses {
        let other = published.iter().find(|p| p.frame == pose.frame).unwrap();
        let motion = pose.camera_from_board.inv_mul(&other.camera_from_board);
        assert!(motion.rotation.angle() < 5e-3, "frame {}: {motion}", pose.frame);
        let shift =
            pose.camera_from_board.translation.vector - other.camera_from_board.translation.vector;
        assert!(shift.norm() < 0.5, "frame {}: {shift}", pose.frame);
    }
}

/// Noury et al. 2017: no blur radii and no focal lengths of micro-lenses.
pub fn corners_only_gives_a_camera_near_the_full_one() {
    let data = csv();
    let options = CalibrationOptions { mode: Mode::CornersOnly, ..options() };
    let calibration = run(&data, &options);
    assert!(calibration.converged);
    assert_eq!(calibration.camera.lens_types(), 0);
    // Table 1 has F = 54.888 mm for this method.
    let f = calibration.camera.main_lens.focal_length_mm;
    assert!((54.0..56.0).contains(&f), "{f}");
    assert!(calibration.reprojection.rmse().rho_px.is_none());
}

/// Two estimates of the same thing: sixteen calibrations, and one small solve for each frame.
pub fn left_out_frames_agree_with_sixteen_calibrations() {
    const AGREEMENT: f64 = 0.25;
    let data = csv();
    let full = run(&data, &options());
    let frames: Vec<u32> = full.poses.iter().map(|p| p.frame).collect();
    let without: Vec<Vec<f64>> = frames
        .par_iter()
        .map(|&frame| {
            let mut options = options();
            options.exclude_frames.push(frame);
            run(&data, &options).camera.intrinsics()
        })
        .collect();
    let n = frames.len() as f64;
    let u = &full.uncertainty;
    let (used, independent) = (u.intrinsic_std_devs(3), u.independent_std_devs(3));
    let predicted = u.jackknife_std_devs(3);
    for (i, p) in Parameter::intrinsic(3).iter().enumerate() {
        let mean = without.iter().map(|v| v[i]).sum::<f64>() / n;
        let sum = without.iter().map(|v| (v[i] - mean).powi(2)).sum::<f64>();
        let real = ((n - 1.0) / n * sum).sqrt();
        let (Some(used), Some(independent), Some(predicted)) =
            (used[i], independent[i], predicted[i])
        else {
            continue;
        };
        println!(
            "{:8} jackknife {real:9.3e}: without calibrating {:.2}, σ {:.2}, independent {:.2}",
            p.name(),
            predicted / real,
            used / real,
            independent / real
        );
        assert!((predicted / real - 1.0).abs() < AGREEMENT, "{}: {predicted}, {real}", p.name());
        // σ contains errors of the centres as well, which frames do not show: they make the tilt.
        let by_centers = p.name().starts_with("theta");
        assert!(used / real > 1.0 - AGREEMENT, "{}: {used}, {real}", p.name());
        assert!(by_centers || used / real < 1.0 + AGREEMENT, "{}: {used}, {real}", p.name());
    }
}

pub fn the_default_priors_bring_the_camera_to_its_datasheet() {
    let data = csv();
    let result = run(&data, &defaults());
    for prior in &result.priors {
        println!(
            "{}: {} ({:+.2} σ)",
            prior.prior.quantity,
            prior.result,
            prior.normalised_residual()
        );
        assert!(prior.normalised_residual().abs() < 3.0);
    }
}
