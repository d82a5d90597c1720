//! The independent Ceres program (`cpp/examples/plain_ceres`) reaches the same minimum of an exported problem.

use std::path::Path;
use std::process::Command;

use plenocal::calibration::{
    BoardModel, Calibration, CalibrationOptions, Pitches, Solution, SolvedProblem, cost_at,
};
use plenocal::io::{OutputFolder, read_camera, read_poses, stage_problem};
use plenocal::model::{Board, Observations};
use plenocal::solver::LossKind;
use serde_json::Value;

use crate::needs::EXAMPLES;
use crate::support::{board, datasheet_start, defaults, options, pairs, run, shipped_observations};

/// Relative agreement of the costs.
const COST: f64 = 1e-9;
/// Relative agreement of the parameters ...
const PARAMETER: f64 = 1e-6;
/// ... or, for values not much larger than their uncertainty, this fraction of the uncertainty: where
/// both programs stop, the cost is accurate to 1e-13, and the parameters to about 1e-4 σ.
const PARAMETER_SIGMAS: f64 = 1e-3;

/// Exports the problem that a calibration has solved, lets the program solve it, and reads its result.
fn plain_ceres(calibration: &Calibration, board: &Board) -> (Value, Solution) {
    let folder = tempfile::tempdir().unwrap();
    let problem = folder.path().join("problem");
    export(calibration, board, &problem);
    let output = Command::new(EXAMPLES.folder().join("plain_ceres"))
        .arg(&problem)
        .arg("--out")
        .arg(folder.path())
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let solution = Solution {
        camera: read_camera(&folder.path().join("camera.json")).unwrap(),
        poses: read_poses(&folder.path().join("poses.json")).unwrap(),
    };
    (serde_json::from_slice(&output.stdout).unwrap(), solution)
}

fn export(calibration: &Calibration, board: &Board, folder: &Path) {
    let mut output = OutputFolder::new(folder).unwrap();
    stage_problem(&mut output, &SolvedProblem::of(calibration, board)).unwrap();
    output.commit().unwrap();
}

/// Both programs agree. `cost` is that of the calibration, which counts a camera with priors by another weight at its
/// start.
fn assert_same(calibration: &Calibration, (result, solution): &(Value, Solution)) {
    assert_eq!(result["converged"], true);
    let (cost, other) = (calibration.refinement.cost, result["cost"].as_f64().unwrap());
    assert!((cost / other - 1.0).abs() < COST, "{cost} and {other}");
    let std_devs = calibration.uncertainty.intrinsic_std_devs(3);
    for ((name, value, other), std_dev) in
        pairs(&calibration.camera, &solution.camera).into_iter().zip(std_devs)
    {
        let tolerance = (PARAMETER * other.abs()).max(PARAMETER_SIGMAS * std_dev.unwrap_or(0.0));
        assert!((value - other).abs() <= tolerance, "{name}: {value} and {other}, ± {std_dev:?}");
    }
    for (ours, theirs) in calibration.poses.iter().zip(&solution.poses) {
        assert_eq!(ours.frame, theirs.frame);
        let [a, b] = [ours, theirs].map(|p| p.camera_from_board);
        let apart = (a.translation.vector - b.translation.vector).norm();
        assert!(apart < 1e-4 && a.rotation.angle_to(&b.rotation) < 1e-6, "{apart}");
    }
}

fn two_pitches() -> CalibrationOptions {
    let mut options = options();
    options.pitches = Pitches::Two;
    options
}

pub fn the_minimum_on_the_shipped_features_is_the_same() {
    let observations = shipped_observations();
    for options in [options(), two_pitches()] {
        let calibration = run(&datasheet_start(), &observations, &options);
        assert_same(&calibration, &plain_ceres(&calibration, &board()));
    }
}

/// The default cost: own σ, priors with their weight, a loss, the exit pupil and a curved field.
pub fn the_minimum_of_the_default_cost_is_the_same() {
    let mut observations = shipped_observations();
    for (i, feature) in observations.features.iter_mut().enumerate() {
        let std_dev = 0.05 + 0.001 * (i % 100) as f64;
        feature.std_dev_px = Some([std_dev, 1.1 * std_dev]);
    }
    for (i, center) in observations.centers.iter_mut().enumerate() {
        center.std_dev_px = Some(0.02 + 0.001 * (i % 10) as f64);
    }
    for kind in [LossKind::Huber, LossKind::Cauchy] {
        let mut options = CalibrationOptions { board: BoardModel::Flat, ..defaults() };
        (options.loss, options.loss_scale) = (Some(kind), Some(1.5));
        let calibration = run(&datasheet_start(), &observations, &options);
        assert!(calibration.priors.len() > 5 && calibration.cost.prior_weight > 0.0);
        let solved = plain_ceres(&calibration, &board());
        assert_same(&calibration, &solved);
        evaluated_is_the_minimum(&calibration, &solved.1, &observations, &options);
    }
}

/// The cost of the program's solution is that of the calibration, and so is its σ; off it, what one more step would gain is
/// roughly what it costs to be there, since Gauss-Newton is not Newton with a loss and noise.
fn evaluated_is_the_minimum(
    calibration: &Calibration,
    solution: &Solution,
    observations: &Observations,
    options: &CalibrationOptions,
) {
    let weight = Some(calibration.cost.prior_weight);
    let options = CalibrationOptions { prior_weight: weight, ..options.clone() };
    let evaluate = |solution: &Solution| {
        cost_at(solution, &datasheet_start(), &board(), observations, &options).unwrap()
    };
    let at = evaluate(solution);
    let (cost, other) = (calibration.refinement.cost, at.refinement.cost);
    assert!((cost / other - 1.0).abs() < COST, "{cost} and {other}");
    assert!(at.converged);
    let [a, b] = [calibration, &at].map(|c| c.uncertainty.covariance[(0, 0)]);
    assert!((a / b - 1.0).abs() < 0.05, "{a} and {b}");
    let mut moved = solution.clone();
    let std_dev = calibration.uncertainty.independent_covariance[(0, 0)].sqrt();
    moved.camera.main_lens.focal_length_mm += 0.003 * std_dev;
    let off = evaluate(&moved);
    assert!(!off.converged);
    let (gain, lost) = (off.uncertainty.expected_decrease, off.refinement.cost - other);
    assert!((0.2..5.0).contains(&(gain / lost)), "{gain} and {lost}");
}

pub fn the_minimum_on_the_real_features_is_the_same() {
    let data = crate::r12a::csv();
    for options in [options(), two_pitches()] {
        let calibration = crate::r12a::run(&data, &options);
        assert_same(&calibration, &plain_ceres(&calibration, &data.board));
    }
}
