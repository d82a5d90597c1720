//! Whether the verdict sees what is wrong.

use plenocal::assessment::{Assessment, Verdict, assess};
use plenocal::calibration::{Blur, Calibration, calibrate};
use plenocal::model::{Noise, Observations};
use plenocal::{Finding, Issue};

use crate::support::{board, codes, datasheet_start, defaults, run, true_camera};
use crate::uncertainty::sixteen_poses;
use plenocal::solver::synthesize;

const NOISE: Noise = Noise { uv_px: 0.1, rho_px: 0.02, centers_px: 0.05 };

/// Observations of sixteen boards that state their σ.
fn observations(seed: u64) -> Observations {
    let mut observations =
        synthesize(&true_camera(), &board(), &sixteen_poses(), &NOISE, seed).unwrap();
    for f in &mut observations.features {
        f.std_dev_px = Some([NOISE.uv_px; 2]);
        f.rho_std_dev_px = Some(NOISE.rho_px);
    }
    for c in &mut observations.centers {
        c.std_dev_px = Some(NOISE.centers_px);
    }
    observations
}

fn assessed(observations: &Observations) -> (Calibration, Assessment) {
    // Here ρ is a measurement of its own.
    let mut options = defaults();
    options.blur = Blur::Features;
    let calibration = run(&datasheet_start(), observations, &options);
    let assessment = assess(&calibration, &board()).unwrap();
    (calibration, assessment)
}

fn texts(assessment: &Assessment) -> Vec<String> {
    assessment.findings.iter().map(ToString::to_string).collect()
}

#[test]
fn a_good_calibration_is_called_good() {
    for seed in 1..4 {
        let (calibration, assessment) = assessed(&observations(seed));
        assert_eq!(assessment.verdict, Verdict::Good, "{:?}", texts(&assessment));
        assert!(assessment.outliers.features.is_empty() && assessment.outliers.frames.is_empty());
        let (error, std_dev) = (calibration.m_error().unwrap(), calibration.m_std_dev());
        println!("m {error:.4} ± {std_dev:.4}");
        assert!(error.abs() < 3.0 * std_dev && std_dev < 0.02, "{error} ± {std_dev}");
    }
}

#[test]
fn a_board_of_another_size_in_one_frame_is_found_and_named() {
    // The poses take up most of it: only what the frame says of the camera contradicts the others.
    let mut observations = observations(4);
    let camera = true_camera();
    let larger = plenocal::model::Board { square_mm: 1.03 * board().square_mm, ..board() };
    let pose: Vec<_> = sixteen_poses().into_iter().filter(|p| p.frame == 5).collect();
    let wrong = synthesize(&camera, &larger, &pose, &NOISE, 9).unwrap();
    let std_devs = observations.features[0];
    observations.features.retain(|f| f.frame != 5);
    observations.features.extend(wrong.features.into_iter().map(|mut f| {
        f.std_dev_px = std_devs.std_dev_px;
        f.rho_std_dev_px = std_devs.rho_std_dev_px;
        f
    }));
    let (_, assessment) = assessed(&observations);
    let frames: Vec<u32> = assessment.outliers.frames.iter().map(|f| f.frame).collect();
    assert_eq!(frames, [5], "{:?}", assessment.outliers.frames);
    assert_eq!(assessment.verdict, Verdict::UsableWithCare);
    assert!(texts(&assessment)[0].contains("frame 5"), "{:?}", texts(&assessment));
}

#[test]
fn a_frame_that_moved_during_the_exposure_is_found_and_named() {
    let mut observations = observations(5);
    // The shutter reads the lower half later.
    let mut rows: Vec<f64> =
        observations.features.iter().filter(|f| f.frame == 11).map(|f| f.v_px).collect();
    rows.sort_by(f64::total_cmp);
    let middle = rows[rows.len() / 2];
    for f in observations.features.iter_mut().filter(|f| f.frame == 11 && f.v_px > middle) {
        f.u_px += 1.0;
    }
    let (_, assessment) = assessed(&observations);
    assert_eq!(assessment.outliers.frames[0].frame, 11, "{:?}", assessment.outliers.frames);
    let is_outlier = |f: &Finding| matches!(f.issue, Issue::OutlyingFrame { frame: 11, .. });
    assert!(assessment.findings.iter().any(is_outlier));
}

#[test]
fn false_features_are_withstood_and_named() {
    let clean = observations(6);
    let mut observations = clean.clone();
    let wrong: Vec<usize> = (0..5).map(|i| 100 + 400 * i).collect();
    for &i in &wrong {
        observations.features[i].u_px += 5.0;
        observations.features[i].v_px -= 3.0;
    }
    let (calibration, assessment) = assessed(&observations);
    let (expected, _) = assessed(&clean);
    let mut found: Vec<_> =
        assessment.outliers.features.iter().map(|o| o.residual.feature).collect();
    found.sort_by_key(|f| observations.features.iter().position(|g| g == f));
    let spoiled: Vec<_> = wrong.iter().map(|&i| observations.features[i]).collect();
    assert_eq!(found, spoiled);
    let std_devs = expected.uncertainty.intrinsic_std_devs(3);
    for (i, (a, b)) in
        calibration.camera.intrinsics().iter().zip(expected.camera.intrinsics()).enumerate()
    {
        if let Some(s) = std_devs[i] {
            assert!((a - b).abs() < s, "parameter {i}: {a} and {b} ± {s}");
        }
    }
}

#[test]
fn a_board_of_another_size_in_all_frames_is_not_called_good() {
    let observations = observations(8);
    for factor in [0.88, 1.12] {
        let wrong = plenocal::model::Board { square_mm: factor * board().square_mm, ..board() };
        match calibrate(&datasheet_start(), &wrong, &observations, &defaults(), &mut |_| true) {
            Ok(result) => {
                let assessment = assess(&result, &wrong).unwrap();
                assert_ne!(assessment.verdict, Verdict::Good, "{factor}");
                // The white images know better.
                let told = codes(&assessment.findings);
                let known = ["prior-contradicted", "slope-contradicted", "not-converged"];
                assert!(told.iter().any(|code| known.contains(code)), "{factor}: {told:?}");
            }
            Err(error) => assert!(error.to_string().contains("do not fit"), "{error}"),
        }
    }
}

#[test]
fn fronto_parallel_boards_are_a_reason_only_once() {
    let poses: Vec<_> = (0_u8..5)
        .map(|i| plenocal::model::FramePose {
            frame: i.into(),
            camera_from_board: nalgebra::Isometry3::translation(
                -12.0,
                -6.0,
                76.0 + 5.0 * f64::from(i),
            ),
        })
        .collect();
    let observations = synthesize(&true_camera(), &board(), &poses, &NOISE, 3).unwrap();
    let (_, assessment) = assessed(&observations);
    let told = codes(&assessment.findings);
    assert!(told.contains(&"fronto-parallel") && !told.contains(&"few-tilts"), "{told:?}");
    assert!(told.contains(&"few-frames"), "{told:?}");
}

/// The board that is proposed lowers σ by what is promised.
#[test]
fn the_next_board_keeps_its_promise() {
    let few = |n: usize| -> Vec<_> { sixteen_poses().into_iter().take(n).collect() };
    let noise = Noise { uv_px: 0.1, rho_px: 0.02, centers_px: 0.05 };
    let draw = |poses: &[plenocal::model::FramePose]| {
        let observations = synthesize(&true_camera(), &board(), poses, &noise, 7).unwrap();
        run(&datasheet_start(), &observations, &crate::support::options())
    };
    let poses = few(4);
    let before = draw(&poses);
    let assessment = assess(&before, &board()).unwrap();
    let next = assessment.next_board.clone().expect("four boards can be improved on");
    let [old, new] = next.largest_mm;
    let mut more = poses.clone();
    more.push(plenocal::model::FramePose { frame: 99, camera_from_board: next.pose });
    let largest_at = |assessment: &Assessment, calibration: &Calibration, range: (f64, f64)| {
        let n = calibration.uncertainty.free_intrinsics.len();
        let covariance = nalgebra::DMatrix::from(&calibration.uncertainty.covariance)
            .view((0, 0), (n, n))
            .into_owned();
        let space = assessment.object_space.as_ref().unwrap();
        let there = space.distances.iter().filter(|d| (range.0..=range.1).contains(&d.distance_mm));
        there.flat_map(|d| d.points.iter().map(|p| p.total_mm(&covariance))).fold(0.0, f64::max)
    };
    let boards =
        assessment.object_space.as_ref().unwrap().distances.iter().filter(|d| d.within_boards);
    let distances: Vec<f64> = boards.map(|d| d.distance_mm).collect();
    let range = (distances[0], distances[distances.len() - 1]);
    assert!((largest_at(&assessment, &before, range) / old - 1.0).abs() < 1e-9);
    let calibration = draw(&more);
    let largest = largest_at(&assess(&calibration, &board()).unwrap(), &calibration, range);
    assert!(largest < 0.95 * old, "{old} to {largest}, promised {new}");
    assert!((largest / new - 1.0).abs() < 0.35, "{old} to {largest}, promised {new}");
}
