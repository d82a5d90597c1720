//! A calibration recovers the known truth.

use nalgebra::{Isometry3, Translation3, UnitQuaternion};
use plenocal::Issue;
use plenocal::calibration::{CalibrationOptions, Mode, Pitches, Start, initial_poses};
use plenocal::model::{Datasheet, FramePose, Noise, Parameter};
use plenocal::solver::{LossKind, synthesize};

use crate::support::{
    NO_NOISE, board, codes, datasheet_start, defaults, drawn, options, pairs, run,
    shipped_observations, true_camera, true_poses,
};

/// Noise-free recovery is limited by the rounding errors of the projections (1e-13 px) times the
/// condition of the weakest parameters.
const NOISE_FREE: f64 = 1e-8;
/// A normal variable exceeds this once in 16 000 draws; about 70 are tested.
const FOUR_SIGMA: f64 = 4.0;
/// With 10⁴ observations the measured noise is accurate to one per cent.
const NOISE_AGREEMENT: f64 = 0.1;

const NOISE: Noise = Noise { uv_px: 0.2, rho_px: 0.05, centers_px: 0.1 };

#[test]
fn without_noise_the_truth_is_recovered_from_the_datasheet() {
    let truth = true_camera();
    let calibration = run(&datasheet_start(), &drawn(&truth, &NO_NOISE, 0), &options());
    assert!(calibration.converged);
    for (name, value, truth) in pairs(&calibration.camera, &truth) {
        assert!((value - truth).abs() <= NOISE_FREE * truth.abs(), "{name}: {value} for {truth}");
    }
    for (pose, truth) in calibration.poses.iter().zip(true_poses()) {
        let (a, b) = (pose.camera_from_board, truth.camera_from_board);
        assert!(a.rotation.angle_to(&b.rotation) < NOISE_FREE, "frame {}", pose.frame);
        let (a, b) = (a.translation.vector, b.translation.vector);
        assert!((a - b).norm() < NOISE_FREE * b.norm(), "frame {}", pose.frame);
    }
}

#[test]
fn with_noise_the_truth_lies_within_the_predicted_uncertainty() {
    let truth = true_camera();
    let calibration = run(&datasheet_start(), &shipped_observations(), &options());
    assert!(calibration.converged);
    assert!(calibration.left_out.is_empty() && calibration.findings.is_empty());
    // The shipped project states 0.1432 mm; the true camera has dF/2D.
    let m = truth.mla.mla_to_sensor_mm * truth.main_lens.focal_length_mm
        / (2.0 * truth.mla.lens_to_mla_mm);
    let expected = 1.0 - 0.1432 / m;
    // d is known to 0.24 % here.
    assert!((calibration.m_error().unwrap() - expected).abs() < FOUR_SIGMA * 0.0024);
    let std_devs = calibration.uncertainty.intrinsic_std_devs(3);
    for ((name, value, truth), std_dev) in pairs(&calibration.camera, &truth).iter().zip(std_devs) {
        match std_dev {
            Some(s) => {
                assert!(
                    (value - truth).abs() < FOUR_SIGMA * s,
                    "{name}: {value} ± {s} for {truth}"
                );
            }
            None => {
                assert!(Parameter::BEYOND_THE_PAPER.iter().any(|p| p.name() == *name), "{name}");
            }
        }
    }
    for (i, (pose, truth)) in calibration.poses.iter().zip(true_poses()).enumerate() {
        let std_devs = calibration.uncertainty.pose_std_devs(i);
        let (a, b) = (pose.camera_from_board, truth.camera_from_board);
        let rotation = a.rotation.scaled_axis() - b.rotation.scaled_axis();
        let translation = a.translation.vector - b.translation.vector;
        for (difference, s) in rotation.iter().chain(translation.iter()).zip(std_devs) {
            assert!(difference.abs() < FOUR_SIGMA * s, "frame {}: {difference} ± {s}", pose.frame);
        }
    }
    let measured = calibration.uncertainty.residual_std_dev_px;
    for (measured, truth) in measured.into_iter().zip([NOISE.uv_px, NOISE.rho_px, NOISE.centers_px])
    {
        assert!((measured / truth - 1.0).abs() < NOISE_AGREEMENT, "{measured} px for {truth} px");
    }
}

#[test]
fn two_pitches_are_recovered() {
    let mut truth = true_camera();
    truth.mla.pitch_ratio = 1.0004;
    let mut options = options();
    options.pitches = Pitches::Two;
    let calibration = run(&datasheet_start(), &drawn(&truth, &NO_NOISE, 0), &options);
    for (name, value, truth) in pairs(&calibration.camera, &truth) {
        assert!((value - truth).abs() <= NOISE_FREE * truth.abs(), "{name}: {value} for {truth}");
    }
}

#[test]
fn a_robust_loss_withstands_gross_errors() {
    let truth = true_camera();
    let mut observations = drawn(&truth, &NOISE, 7);
    // One feature in fifty is off by tens of standard deviations, all to the same side.
    for feature in observations.features.iter_mut().step_by(50) {
        feature.u_px += 12.0;
        feature.v_px -= 6.0;
    }
    // Weights that match the noise, so that the scale of the loss is in standard deviations.
    let weighted = |kind: LossKind| {
        let mut options = options();
        options.uv_std_dev_px = NOISE.uv_px;
        options.rho_std_dev_px = NOISE.rho_px;
        options.centers_std_dev_px = NOISE.centers_px;
        options.loss = Some(kind);
        options.loss_scale = (kind != LossKind::None).then_some(2.0);
        options
    };
    // Distance from the truth relative to the uncertainty with clean data.
    let clean = run(&datasheet_start(), &drawn(&truth, &NOISE, 7), &weighted(LossKind::None));
    let std_devs = clean.uncertainty.intrinsic_std_devs(3);
    let distance = |options: &CalibrationOptions| {
        let calibration = run(&datasheet_start(), &observations, options);
        assert!(calibration.converged);
        pairs(&calibration.camera, &clean.camera)
            .iter()
            .zip(&std_devs)
            .filter_map(|((_, a, b), s)| Some(((a - b) / (*s)?).abs()))
            .fold(0.0, f64::max)
    };
    let plain = distance(&weighted(LossKind::None));
    for kind in [LossKind::Huber, LossKind::Cauchy] {
        let robust = distance(&weighted(kind));
        assert!(robust < 1.0 && robust < plain / 4.0, "{kind:?}: {robust} against {plain}");
    }
}

/// A 50 mm lens sees boards of 24 mm in so narrow a field of view that `solvePnP` mistakes some for
/// their mirror images; parallax and blur have to correct that.
#[test]
fn boards_in_a_narrow_field_of_view_are_not_tilted_the_wrong_way() {
    let mut camera = true_camera();
    camera.main_lens.focal_length_mm = 50.4;
    camera.main_lens.radial = [2.0e-4, -3.0e-6, 4.0e-8];
    camera.main_lens.tangential = [-1.5e-4, 0.8e-4];
    camera.mla.pitch_mm = 0.127_46;
    camera.mla.lens_to_mla_mm = 57.1;
    camera.mla.mla_to_sensor_mm = 0.325;
    let center = Translation3::new(-12.0, -6.0, 0.0);
    let poses: Vec<FramePose> = [
        ([35.0, 0.0, 5.0], [1.0, 0.5, 270.0]),
        ([-30.0, 10.0, -8.0], [-1.0, 1.0, 285.0]),
        ([5.0, 40.0, 20.0], [0.5, -1.0, 265.0]),
        ([25.0, 25.0, -30.0], [-2.0, -1.5, 310.0]),
        ([-20.0, 30.0, 170.0], [1.5, 1.5, 350.0]),
    ]
    .into_iter()
    .zip(0..)
    .map(|((degrees, [x, y, z]), frame)| {
        let [roll, pitch, yaw] = degrees.map(f64::to_radians);
        let turn = UnitQuaternion::from_euler_angles(roll, pitch, yaw);
        let place = Isometry3::from_parts(Translation3::new(x, y, z), turn);
        FramePose { frame, camera_from_board: place * center }
    })
    .collect();
    let observations = synthesize(&camera, &board(), &poses, &NOISE, 5).unwrap();
    let mirrored = poses.iter().filter(|pose| {
        let seen: Vec<_> =
            observations.features.iter().filter(|f| f.frame == pose.frame).copied().collect();
        let first = initial_poses(&camera, &board(), &seen).unwrap()[0];
        first.rotation.angle_to(&pose.camera_from_board.rotation) > 0.3
    });
    assert!(mirrored.count() >= 1, "PnP alone has to be wrong, or this test shows nothing");

    let mut options = options();
    options.mode = Mode::PosesOnly;
    let calibration = run(&Start::Camera(camera), &observations, &options);
    for (found, truth) in calibration.poses.iter().zip(&poses) {
        let angle = found.camera_from_board.rotation.angle_to(&truth.camera_from_board.rotation);
        // Noise alone rotates a board by a milliradian; its mirror image is half a radian off.
        assert!(angle < 0.02, "frame {}: {angle} rad", truth.frame);
    }
}

/// The predicted covariance against the scatter of repeated experiments.
#[test]
#[ignore = "slow: 200 calibrations; run by `make test-slow`"]
fn the_covariance_agrees_with_monte_carlo() {
    const RUNS: u32 = 200;
    /// The standard error of a standard deviation from 200 runs is 1/√(2·200) = 5 %; the limit is four
    /// of them, since 19 are tested.
    const AGREEMENT: f64 = 0.2;

    let truth = true_camera();
    let parameters = Parameter::intrinsic(3);
    let mut sums = vec![(0.0, 0.0); parameters.len()];
    let mut predicted = vec![0.0; parameters.len()];
    for seed in 0..u64::from(RUNS) {
        let observations = drawn(&truth, &NOISE, 1000 + seed);
        let calibration = run(&Start::Camera(truth.clone()), &observations, &options());
        assert!(
            calibration.converged,
            "seed {seed}: {}",
            plenocal::calibration::termination_text(&calibration)
        );
        for (i, (_, value, truth)) in pairs(&calibration.camera, &truth).iter().enumerate() {
            sums[i].0 += value - truth;
            sums[i].1 += (value - truth).powi(2);
        }
        let std_devs = calibration.uncertainty.intrinsic_std_devs(3);
        for (sum, std_dev) in predicted.iter_mut().zip(std_devs) {
            *sum += std_dev.unwrap_or(0.0) / f64::from(RUNS);
        }
    }
    println!(
        "{:10} {:>12} {:>12} {:>8} {:>8}",
        "parameter", "scatter", "predicted", "ratio", "bias/se"
    );
    let mut failures = Vec::new();
    for ((parameter, (sum, square)), predicted) in parameters.iter().zip(sums).zip(predicted) {
        if predicted == 0.0 {
            continue;
        }
        let n = f64::from(RUNS);
        let scatter = ((square - sum * sum / n) / (n - 1.0)).sqrt();
        let bias = sum / n / (scatter / n.sqrt());
        let ratio = scatter / predicted;
        println!(
            "{:10} {scatter:12.4e} {predicted:12.4e} {ratio:8.3} {bias:8.2}",
            parameter.name()
        );
        if (ratio - 1.0).abs() > AGREEMENT {
            failures.push(parameter.name());
        }
    }
    assert!(failures.is_empty(), "{failures:?}");
}

/// The boards say where the lens is focused: with another distance stated, the refinement starts from there.
#[test]
fn a_wrong_focus_distance_is_noticed_and_mended() {
    let observations = shipped_observations();
    let right = run(&datasheet_start(), &observations, &defaults());
    assert!(!codes(&right.findings).contains(&"focus-distance"));
    let Start::Datasheet(sheet, internal) = datasheet_start() else { unreachable!() };
    for wrong in [0.6, 2.0, 5.0, f64::INFINITY] {
        let focus_distance_mm = wrong * sheet.focus_distance_mm;
        let start = Start::Datasheet(Datasheet { focus_distance_mm, ..sheet }, internal.clone());
        let found = run(&start, &observations, &defaults());
        assert!(found.converged, "{wrong}");
        // The weight of the priors is measured on the way, so that the end depends on it a little.
        let std_devs = right.uncertainty.intrinsic_std_devs(3);
        let pairs = pairs(&found.camera, &right.camera);
        for ((name, value, expected), std_dev) in pairs.iter().zip(&std_devs) {
            let off = (value - expected).abs();
            assert!(off <= 0.3 * std_dev.unwrap_or(1e-9), "{wrong}: {name} is {off} off");
        }
        let noticed = found.findings.iter().find_map(|finding| match finding.issue {
            Issue::FocusDistance { by_boards_mm, .. } => Some(by_boards_mm),
            _ => None,
        });
        let by_boards = noticed.expect("it is noticed") / sheet.focus_distance_mm;
        assert!((0.7..1.4).contains(&by_boards), "{wrong}: {by_boards} of the true distance");
    }
    // What is held to a value starts there.
    let mut held = defaults();
    held.fix = vec![Parameter::LensToArray];
    held.priors.default = false;
    let found = run(&datasheet_start(), &observations, &held);
    assert!(!codes(&found.findings).contains(&"focus-distance"));
}
