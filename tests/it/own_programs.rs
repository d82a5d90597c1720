//! Problems that are exported for programs of users, and solutions that come back.

use std::path::{Path, PathBuf};

use plenocal::Issue;
use plenocal::calibration::{
    BoardModel, CalibrationOptions, Solution, SolvedProblem, Start, cost_at,
};
use plenocal::io::read_poses;
use plenocal::model::Noise;
use predicates::prelude::PredicateBooleanExt;
use predicates::str::contains;
use serde_json::Value;
use tempfile::TempDir;

use crate::support::{
    board, datasheet_start, defaults, drawn, no_priors, options, plenocal, run,
    shipped_observations, synthetic_folder, true_camera, true_poses,
};

fn project() -> PathBuf {
    synthetic_folder().join("project.toml")
}

fn json(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

/// The way of a user who compares: export, solve elsewhere (here: take plenocal's own result), evaluate.
#[test]
fn a_solution_from_elsewhere_is_evaluated() {
    let folder = TempDir::new().unwrap();
    let at = |name: &str| folder.path().join(name);
    let calibrate = |more: &[&str], out: &str| {
        let mut command = plenocal();
        command.arg("calibrate").arg(project()).args(more).arg("--out").arg(at(out)).assert()
    };
    let problem = at("problem");
    let export = ["--export-problem", problem.to_str().unwrap(), "--board", "flat"];
    calibrate(&export, "results").success();
    for name in ["problem.json", "camera.json", "poses.json", "features.csv", "centers.csv"] {
        assert!(problem.join(name).is_file(), "{name}");
    }
    let of_problem = json(&problem.join("problem.json"));
    let result = json(&at("results/calibration.json"));
    assert_eq!(of_problem["cost_of_plenocal"], result["cost"]);
    assert_eq!(of_problem["prior_weight"], result["priors"]["weight"]);
    assert_eq!(of_problem["priors"].as_array().unwrap().len(), 7);

    let (camera, poses) = (at("results/camera.json"), at("results/poses.json"));
    let weight = of_problem["prior_weight"].to_string();
    let evaluate = |camera: &Path, out: &str| {
        let (camera, poses) = (camera.to_str().unwrap(), poses.to_str().unwrap());
        let more = ["--evaluate-only", "--board", "flat", "--prior-weight", &weight];
        calibrate(&[&more[..], &["--camera", camera, "--poses", poses]].concat(), out)
    };
    evaluate(&camera, "same").success().stdout(contains("This is a minimum."));
    let same = json(&at("same/cost.json"));
    let [cost, at_result] =
        [&same["evaluation"]["cost"], &result["cost"]].map(|v| v.as_f64().unwrap());
    assert!((cost / at_result - 1.0).abs() < 1e-9, "{cost} {at_result}");
    assert!(at("same/residuals.csv").is_file() && !at("same/camera.json").exists());

    // Another F is no minimum, and one more step says by how much.
    let mut moved = json(&camera);
    let f = moved["main_lens"]["focal_length_mm"].as_f64().unwrap();
    moved["main_lens"]["focal_length_mm"] = (f + 0.001).into();
    let other = at("other.json");
    std::fs::write(&other, moved.to_string()).unwrap();
    evaluate(&other, "moved").success().stdout(contains("This is no minimum of this cost"));
    let moved = json(&at("moved/cost.json"));
    let step = moved["evaluation"]["next_step"]["F"].as_f64().unwrap();
    assert!((step + 0.001).abs() < 1e-4, "{step}");

    // The two folders differ.
    let same = at("twice");
    calibrate(&["--export-problem", same.to_str().unwrap()], "twice")
        .failure()
        .stderr(contains("name one folder"));
    assert!(!same.join("camera.json").exists());

    // What is missing is named.
    let mut command = plenocal();
    command.arg("calibrate").arg(project()).arg("--evaluate-only").arg("--out").arg(at("none"));
    command.assert().failure().stderr(contains("--camera").and(contains("--poses")));
}

#[test]
fn poses_of_other_frames_are_named() {
    let folder = TempDir::new().unwrap();
    let poses = synthetic_folder().join("truth/poses.json");
    let mut document = json(&poses);
    document["poses"][0]["frame"] = 99.into();
    let file = folder.path().join("poses.json");
    std::fs::write(&file, document.to_string()).unwrap();
    assert_eq!(read_poses(&file).unwrap()[0].frame, 99);
    let mut command = plenocal();
    command.arg("calibrate").arg(project()).arg("--poses").arg(&file);
    command
        .arg("--out")
        .arg(folder.path().join("out"))
        .assert()
        .success()
        .stderr(contains("poses are given of frames without features, which are not used: 99"));
}

/// A problem whose board is bent says its shape as a start, and leaves it free.
#[test]
fn a_bent_board_is_exported_as_free() {
    let poses = true_poses();
    let observations =
        drawn(&true_camera(), &Noise { uv_px: 0.05, rho_px: 0.02, centers_px: 0.02 }, 4);
    let bent = CalibrationOptions { board: BoardModel::Bent, priors: no_priors(), ..defaults() };
    let calibration = run(&Start::Camera(true_camera()), &observations, &bent);
    let problem = SolvedProblem::of(&calibration, &board());
    assert_eq!(problem.poses.len(), poses.len());
    assert!(!problem.cost.fixed.iter().any(|name| name == "sag_x"), "{:?}", problem.cost.fixed);
    assert_eq!(problem.board.shape, plenocal::model::BoardShape::default());
}

/// Poses that are given are where the boards start; those of other frames are found.
#[test]
fn poses_may_be_given() {
    let observations = shipped_observations();
    let reference = run(&datasheet_start(), &observations, &options());
    let mut given = true_poses();
    given.truncate(3);
    given[0].frame = 77;
    let options = CalibrationOptions { poses: given.clone(), ..options() };
    let calibration = run(&datasheet_start(), &observations, &options);
    assert!((calibration.refinement.cost / reference.refinement.cost - 1.0).abs() < 1e-9);
    assert_eq!(calibration.initial_poses[1], given[1]);
    assert_ne!(calibration.initial_poses[0].camera_from_board, given[0].camera_from_board);
    let frames = vec![77];
    let expected = Issue::PosesOfNoFrame { frames };
    assert!(calibration.findings.iter().any(|finding| finding.issue == expected));

    let solution = Solution { camera: reference.camera.clone(), poses: given };
    let at = cost_at(&solution, &datasheet_start(), &board(), &observations, &options).unwrap();
    assert_eq!(at.poses.len(), 2);
    assert!(at.left_out.iter().any(|left| left.reason == Issue::PoseNotGiven));
}
