//! Problems that are exported for programs of users, and solutions that come back.

use std::path::{Path, PathBuf};

use plenocal::Issue;
use plenocal::calibration::{
    BoardModel, CalibrationOptions, Solution, SolvedProblem, Start, cost_at,
};
use plenocal::io::{OutputFolder, read_poses, read_problem, stage_problem};
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
    assert_eq!(of_problem["priors"].as_array().unwrap().len(), 9);

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
    evaluate(&other, "moved").success().stdout(contains("This is not a minimum of this cost"));
    let moved = json(&at("moved/cost.json"));
    let step = moved["evaluation"]["next_step"]["F"].as_f64().unwrap();
    assert!((step + 0.001).abs() < 1e-4, "{step}");

    // The two folders differ.
    let same = at("twice");
    calibrate(&["--export-problem", same.to_str().unwrap()], "twice")
        .failure()
        .stderr(contains("name the same folder"));
    assert!(!same.join("camera.json").exists());

    // What is missing is named.
    let mut command = plenocal();
    command.arg("calibrate").arg(project()).arg("--evaluate-only").arg("--out").arg(at("none"));
    command.assert().failure().stderr(contains("--camera").and(contains("--poses")));
}

/// Calibrates the shipped observations into `results`, and exports the problem to `problem`; both in a folder.
fn exported(options: &[&str]) -> TempDir {
    let folder = TempDir::new().unwrap();
    let mut command = plenocal();
    command.arg("calibrate").arg(project()).args(options);
    command.arg("--export-problem").arg(folder.path().join("problem"));
    command.arg("--out").arg(folder.path().join("results")).assert().success();
    folder
}

/// Evaluates the solution in `results`.
fn evaluated(folder: &Path, options: &[&str]) -> assert_cmd::assert::Assert {
    let mut command = plenocal();
    command.current_dir(folder).args(["calibrate", "--evaluate-only", "--out", "cost"]);
    command.args(["--camera", "results/camera.json", "--poses", "results/poses.json"]);
    command.args(options).assert()
}

/// The cost of a problem needs neither a project nor the options that it was made with.
#[test]
fn a_solution_is_evaluated_by_the_cost_of_a_problem() {
    for options in [
        &["--method", "paper"][..],
        &["--loss", "cauchy", "--loss-scale", "3"],
        &["--mode", "corners-only", "--priors", "none"],
    ] {
        let folder = exported(options);
        let problem = ["--problem", "problem"];
        evaluated(folder.path(), &problem).success().stdout(contains("This is a minimum."));
        let cost = json(&folder.path().join("cost/cost.json"));
        let result = json(&folder.path().join("results/calibration.json"));
        let [at, ended] =
            [&cost["evaluation"]["cost"], &result["cost"]].map(|v| v.as_f64().unwrap());
        assert!((at / ended - 1.0).abs() < 1e-9, "{options:?}: {at} {ended}");
        assert_eq!(cost["counts"], result["counts"], "{options:?}");
        assert_eq!(cost["priors"]["weight"], result["priors"]["weight"], "{options:?}");

        // A problem is read as it was written.
        let read = read_problem(&folder.path().join("problem")).unwrap();
        let mut output = OutputFolder::new(&folder.path().join("again")).unwrap();
        stage_problem(&mut output, &read).unwrap();
        output.commit().unwrap();
        for name in ["problem.json", "camera.json", "features.csv", "centers.csv"] {
            let text =
                |of: &str| std::fs::read_to_string(folder.path().join(of).join(name)).unwrap();
            assert!(text("problem") == text("again"), "{name} of {options:?}");
        }
        assert_eq!(read.differences(&read), []);
    }
}

/// A shape that is free is a part of the solution.
#[test]
fn a_bent_board_is_evaluated_with_its_shape() {
    let folder = exported(&["--board", "bent"]);
    let problem = ["--problem", "problem"];
    evaluated(folder.path(), &problem).failure().stderr(contains("--board-shape"));
    let with_shape = [&problem[..], &["--board-shape", "results/calibration.json"]].concat();
    evaluated(folder.path(), &with_shape).success().stdout(contains("This is a minimum."));
    let cost = json(&folder.path().join("cost/cost.json"));
    assert!(cost["evaluation"]["next_step"]["sag_x"].is_f64());
}

/// Where options are forgotten, these are told, and not that the solution is wrong.
#[test]
fn an_evaluation_by_another_cost_says_in_what_it_differs() {
    let options = [
        "--method",
        "paper",
        "--fix",
        "Q3",
        "--loss",
        "cauchy",
        "--loss-scale",
        "3",
        "--uv-std-dev",
        "0.5",
    ];
    let folder = exported(&options);
    let project = project();
    let forgotten = evaluated(folder.path(), &[project.to_str().unwrap()]).success();
    let output = String::from_utf8(forgotten.get_output().stdout.clone()).unwrap();
    let told = output.find("The cost differs from the problem in problem").expect(&output);
    assert!(told < output.find("This is not a minimum of this cost").unwrap(), "{output}");
    for term in [
        "loss cauchy 3 in the problem, loss none here",
        "residuals of ρ in the problem, no residuals of ρ here",
        "kappa_m, omega_x, omega_y, e_z, e_r held in the problem, Q3, Q1_m, kappa, kappa_m, omega_x, omega_y",
        "no priors on F, m",
        "mean σ of (u, v) 0.5000 px in the problem, mean σ of (u, v) 1.0000 px here",
    ] {
        assert!(output.contains(term), "{term}: {output}");
    }
    forgotten.stderr(contains("--problem problem").and(contains("[other-cost]")));
    let found = json(&folder.path().join("cost/cost.json"));
    assert_eq!(found["findings"][0]["code"], "other-cost");
    assert_eq!(found["findings"][0]["values"]["differences"][0]["option"], "loss");

    // With the same cost there is nothing to tell.
    let same = [&[project.to_str().unwrap()][..], &options].concat();
    evaluated(folder.path(), &same)
        .success()
        .stdout(contains("This is a minimum.").and(contains("differs from the problem").not()));
}

#[test]
fn no_option_of_the_cost_is_given_beside_a_problem() {
    let folder = exported(&["--method", "paper"]);
    let project = project();
    let with = |options: &[&str]| {
        evaluated(folder.path(), &[&["--problem", "problem"][..], options].concat())
    };
    for (options, name) in [
        (&["--loss", "cauchy"][..], "--loss"),
        (&["--loss", "none"], "--loss"),
        (&["--loss-scale", "2"], "--loss-scale"),
        (&["--blur", "white-images"], "--blur"),
        (&["--fix", "F"], "--fix"),
        (&["--mode", "full"], "--mode"),
        (&["--pitches", "two"], "--pitches"),
        (&["--exit-pupil", "estimated"], "--exit-pupil"),
        (&["--distortion", "constant"], "--distortion"),
        (&["--lens-tilt", "none"], "--lens-tilt"),
        (&["--field-curvature", "constant"], "--field-curvature"),
        (&["--board", "bent"], "--board"),
        (&["--prior", "F=16:1"], "--prior"),
        (&["--priors", "default"], "--priors"),
        (&["--prior-weight", "0.1"], "--prior-weight"),
        (&["--weights", "own"], "--weights"),
        (&["--uv-std-dev", "0.1"], "--uv-std-dev"),
        (&["--rho-std-dev", "0.1"], "--rho-std-dev"),
        (&["--centers-std-dev", "0.1"], "--centers-std-dev"),
        (&["--exclude", "3"], "--exclude"),
        (&["--method", "paper"], "--method"),
        (&["--set", "calibration.threads=1"], "--set"),
        (&[project.to_str().unwrap()], "[PROJECT]"),
    ] {
        let both = contains("cannot be used with").and(contains("--problem")).and(contains(name));
        with(options).code(2).stderr(both);
        assert!(!folder.path().join("cost").exists(), "{options:?}");
    }
    // A board that is held keeps its shape.
    let bent = folder.path().join("bent.json");
    let board = &json(&folder.path().join("problem/problem.json"))["board"];
    let shape = serde_json::json!({"board_shape": {
        "board": {
            "columns": board["columns"], "rows": board["rows"], "square_mm": board["square_mm"],
        },
        "shape": {"sag_x_mm": 0.1, "sag_y_mm": 0.0, "twist_mm": 0.0, "aspect": 0.0},
    }});
    std::fs::write(&bent, shape.to_string()).unwrap();
    let told = contains("fixes another shape of the board");
    with(&["--board-shape", "bent.json"]).failure().stderr(told);
    with(&["--threads", "1"]).success();
    let mut command = plenocal();
    command.args(["calibrate", "--problem", "problem", "--out", "cost"]);
    command.assert().failure().stderr(contains("--evaluate-only"));
}

#[test]
fn a_damaged_problem_is_named() {
    let folder = exported(&["--method", "paper"]);
    let path = |name: &str| folder.path().join("problem").join(name);
    let spoil = |name: &str, edit: &dyn Fn(&str) -> String, words: &str| {
        let text = std::fs::read_to_string(path(name)).unwrap();
        let edited = edit(&text);
        assert_ne!(text, edited, "{words}");
        std::fs::write(path(name), edited).unwrap();
        let problem = ["--problem", "problem"];
        evaluated(folder.path(), &problem).failure().stderr(contains(name).and(contains(words)));
        std::fs::write(path(name), text).unwrap();
    };
    let replaced =
        |from: &'static str, to: &'static str| move |text: &str| text.replacen(from, to, 1);
    spoil("problem.json", &replaced("\"none\"", "\"tukey\""), "loss.kind");
    spoil("problem.json", &replaced("\"kappa\"", "\"kapa\""), "kapa");
    spoil("problem.json", &replaced("plenocal-problem", "plenocal-camera"), "plenocal-camera");
    spoil("problem.json", &replaced("\"scale\"", "\"scales\""), "scale");
    spoil("poses.json", &replaced("\"frame\": 0", "\"frame\": 90"), "frame 0 has no pose");
    let moved = |text: &str| text.replacen("\n0,", "\n0,7", 1);
    spoil("features.csv", &moved, "which is not its position on the board");
    std::fs::remove_file(path("problem.json")).unwrap();
    evaluated(folder.path(), &["--problem", "problem"])
        .failure()
        .stderr(contains("problem/problem.json"));
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
        .stderr(contains("the input has poses of frames without features, which are not used: 99"));
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
