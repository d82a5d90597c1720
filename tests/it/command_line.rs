//! The program as a user runs it.

use std::fs;
use std::path::Path;

use assert_cmd::assert::Assert;
use plenocal::io::{read_camera, read_features, read_poses, write_features};
use predicates::prelude::*;
use serde_json::Value;
use tempfile::TempDir;

use crate::support::{plenocal, synthetic_folder, true_camera};

fn calibrate(out: &Path) -> assert_cmd::Command {
    let mut command = plenocal();
    command.arg("calibrate").arg(synthetic_folder().join("project.toml")).arg("--out").arg(out);
    command
}

#[test]
fn a_project_gives_tables_and_files() {
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("new/results");
    calibrate(&out)
        .arg("--tables")
        .assert()
        .success()
        .stdout(predicate::str::contains("Converged"))
        .stdout(predicate::str::contains("Weakest directions"))
        .stdout(predicate::str::contains("theta_x"))
        .stdout(predicate::str::contains("The board is flat: below sag_x 0.0"))
        .stderr(predicate::str::is_empty());
    let camera = read_camera(&out.join("camera.json")).unwrap();
    assert_eq!(camera.lens_types(), 3);
    assert_eq!(read_poses(&out.join("poses.json")).unwrap().len(), 8);
    assert!(fs::read_to_string(out.join("solver.txt")).unwrap().contains("CONVERGENCE"));
    let residuals = fs::read_to_string(out.join("residuals.csv")).unwrap();
    assert!(residuals.starts_with("kind,frame,cluster,k,l,lens_type,u,v,rho,du,dv,drho\n"));
    // No other files are left behind.
    assert!(out.join("calibration.json").is_file());
    assert_eq!(fs::read_dir(&out).unwrap().count(), 5);
}

#[test]
fn json_is_one_object_with_the_documented_fields() {
    let folder = TempDir::new().unwrap();
    let output = calibrate(folder.path()).arg("--json").output().unwrap();
    assert!(output.status.success());
    let result: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(result["converged"], true);
    for field in ["cost", "time_s"] {
        assert!(result[field].is_f64(), "{field}");
    }
    for field in ["all", "uv", "rho", "centers"] {
        assert!(result["rmse"][field].as_f64().unwrap() > 0.0, "{field}");
    }
    for field in ["features", "centers", "frames", "frames_left_out"] {
        assert!(result["counts"][field].is_u64(), "{field}");
    }
    let written: Value =
        serde_json::from_slice(&fs::read(folder.path().join("camera.json")).unwrap()).unwrap();
    assert_eq!(result["camera"], written);
}

#[test]
fn single_files_and_a_project_give_the_same_result() {
    let (project, folder) = (synthetic_folder().join("project.toml"), TempDir::new().unwrap());
    let cost = |output: std::process::Output| {
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        serde_json::from_slice::<Value>(&output.stdout).unwrap()["cost"].as_f64().unwrap()
    };
    let whole = cost(calibrate(folder.path()).args(["--json", "--threads", "1"]).output().unwrap());
    let mut command = plenocal();
    command.arg("calibrate").args(["--json", "--threads", "1", "--out"]).arg(folder.path());
    for option in ["--camera", "--params", "--scene"] {
        command.arg(option).arg(&project);
    }
    command.arg("--centers").arg(synthetic_folder().join("centers.csv"));
    command.arg("--features").arg(synthetic_folder().join("features.csv"));
    assert_eq!(whole.to_bits(), cost(command.output().unwrap()).to_bits());
}

#[test]
fn options_of_the_command_line_take_precedence_over_the_project() {
    let folder = TempDir::new().unwrap();
    let project = folder.path().join("project.toml");
    let mut text = fs::read_to_string(synthetic_folder().join("project.toml")).unwrap();
    for file in ["centers.csv", "features.csv"] {
        fs::copy(synthetic_folder().join(file), folder.path().join(file)).unwrap();
    }
    text.push_str("\n[calibration]\nfix = [\"Q3\"]\nloss = \"cauchy\"\nexclude_frames = [2]\n");
    fs::write(&project, text).unwrap();
    let run = |extra: &[&str]| -> Value {
        let out = folder.path().join("out");
        let mut command = plenocal();
        command.arg("calibrate").arg(&project).arg("--out").arg(out).arg("--json").args(extra);
        serde_json::from_slice(&command.output().unwrap().stdout).unwrap()
    };
    let deviations = |result: &Value| {
        result["camera"]["uncertainty"]["standard_deviations"].as_object().unwrap().clone()
    };
    let result = run(&[]);
    assert_eq!(result["counts"]["frames"], 7);
    assert!(!deviations(&result).contains_key("Q3"));
    let result = run(&["--fix", "P1,P2", "--exclude-frames", "0,1"]);
    assert_eq!(result["counts"]["frames"], 6);
    assert!(deviations(&result).contains_key("Q3"));
    assert!(!deviations(&result).contains_key("P1"));
    // A value of the project is replaced, and a flag beats that.
    let set = ["--set", "calibration.fix=[\"P1\"]", "--set", "calibration.exclude_frames=[]"];
    let result = run(&set);
    assert_eq!(result["counts"]["frames"], 8);
    assert!(deviations(&result).contains_key("Q3") && !deviations(&result).contains_key("P1"));
    let result = run(&[&set[..], &["--fix", "Q3"]].concat());
    assert!(!deviations(&result).contains_key("Q3") && deviations(&result).contains_key("P1"));
    let mut wrong = plenocal();
    wrong.arg("calibrate").arg(&project).args(["--set", "calibration.los=huber", "--out"]);
    wrong.arg(folder.path().join("wrong")).assert().code(1).stderr(predicate::str::contains("los"));
    let mut run = plenocal();
    run.arg("run").arg(&project).args(["--set", "calibration.los=huber", "--out"]);
    run.arg(folder.path().join("wrong")).assert().code(1).stderr(predicate::str::contains("los"));
    assert!(!folder.path().join("wrong").exists());
    // Errors in the file name the option too.
    for (line, words) in [
        ("exitpupil = 1", "in [calibration]: exitpupil: unknown field"),
        ("priors.F = 3", "in [calibration]: priors: a prior is"),
    ] {
        fs::write(&project, format!("[calibration]\n{line}\n")).unwrap();
        let mut wrong = plenocal();
        wrong.arg("calibrate").arg(&project).arg("--out").arg(folder.path().join("wrong"));
        wrong.assert().code(1).stderr(predicate::str::contains(words));
    }
}

#[test]
fn a_calibration_that_is_not_converged_is_written_and_exits_with_3() {
    let folder = TempDir::new().unwrap();
    calibrate(folder.path())
        .args(["--max-iterations", "2"])
        .assert()
        .code(3)
        .stderr(predicate::str::contains("--max-iterations"));
    let camera = fs::read_to_string(folder.path().join("camera.json")).unwrap();
    assert!(camera.contains("\"converged\": false"));
}

/// Two of the three lens types are never seen.
#[test]
fn a_camera_that_is_not_determined_is_written_and_exits_with_3() {
    let folder = TempDir::new().unwrap();
    let (features, out) = (folder.path().join("features.csv"), folder.path().join("out"));
    let mut seen = read_features(&synthetic_folder().join("features.csv"), true).unwrap().features;
    let lattice = true_camera().lattice;
    seen.retain(|f| lattice.lens_type(f.k, f.l, 3) == 0);
    let mut text = Vec::new();
    write_features(&mut text, &seen).unwrap();
    fs::write(&features, text).unwrap();
    calibrate(&out)
        .arg("--features")
        .arg(&features)
        .args(["--blur", "features", "--priors", "none"])
        .assert()
        .code(3)
        .stderr(predicate::str::contains("error: not determined: f_2, f_3"));
    let camera = fs::read_to_string(out.join("camera.json")).unwrap();
    assert!(camera.contains("\"converged\": true"), "{camera}");
}

#[test]
fn whoever_reads_a_doubtful_camera_says_so() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("camera.json");
    let truth = synthetic_folder().join("truth/camera.json");
    let mut camera: Value = serde_json::from_slice(&fs::read(truth).unwrap()).unwrap();
    camera["converged"] = false.into();
    camera["uncertainty"]["standard_deviations"] = serde_json::json!({
        "F": { "value": 0.1, "unit": "mm" }, "D": { "value": null, "unit": "mm" },
    });
    fs::write(&path, camera.to_string()).unwrap();
    poses_only(&path, &folder.path().join("poses"))
        .code(4)
        .stderr(predicate::str::contains(
            "camera.json: the calibration of this camera has not converged",
        ))
        .stderr(predicate::str::contains("has not determined D ["))
        .stdout(predicate::str::contains("Verdict: do not use"));
}

fn poses_only(camera: &Path, out: &Path) -> Assert {
    let mut command = plenocal();
    command.args(["calibrate", "--mode", "poses-only", "--camera"]).arg(camera);
    command.arg("--scene").arg(synthetic_folder().join("project.toml"));
    command.arg("--features").arg(synthetic_folder().join("features.csv"));
    command.arg("--out").arg(out).assert()
}

/// The squares are stated too large, so that m of the white images is contradicted.
#[test]
fn a_verdict_of_not_to_be_used_is_an_exit_status_and_follows_the_camera() {
    let folder = TempDir::new().unwrap();
    let (out, poses) = (folder.path().join("out"), folder.path().join("poses"));
    calibrate(&out)
        .args(["--set", "board.square_mm=4"])
        .assert()
        .code(4)
        .stdout(predicate::str::contains("Verdict: do not use"))
        .stderr(predicate::str::contains(
            "error: the verdict is \"do not use\" (prior-contradicted",
        ));
    let path = out.join("camera.json");
    let camera: Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
    assert_eq!(camera["verdict"]["verdict"], "do not use");
    assert_eq!(camera["verdict"]["reasons"][0], "prior-contradicted");
    let told = "[camera-not-to-be-used]";
    poses_only(&path, &poses).code(4).stderr(predicate::str::contains(told));
    let mut rays = plenocal();
    rays.arg("rays").arg(&path).arg("--out").arg(folder.path().join("rays"));
    rays.assert().success().stderr(predicate::str::contains(told));
}

#[test]
fn poses_only_starts_from_a_calibrated_camera() {
    let folder = TempDir::new().unwrap();
    let (first, second) = (folder.path().join("first"), folder.path().join("second"));
    calibrate(&first).assert().success();
    let mut command = plenocal();
    command
        .args(["calibrate", "--mode", "poses-only", "--camera"])
        .arg(first.join("camera.json"))
        .arg("--scene")
        .arg(synthetic_folder().join("project.toml"))
        .arg("--features")
        .arg(synthetic_folder().join("features.csv"))
        .arg("--out")
        .arg(&second);
    command.assert().success();
    let (a, b) = (
        read_poses(&first.join("poses.json")).unwrap(),
        read_poses(&second.join("poses.json")).unwrap(),
    );
    for (a, b) in a.iter().zip(&b) {
        let motion = a.camera_from_board.inv_mul(&b.camera_from_board);
        assert!(motion.rotation.angle() < 1e-6, "frame {}: {motion}", a.frame);
    }
}

#[test]
fn the_help_of_a_command_has_examples_and_its_modes() {
    plenocal()
        .args(["calibrate", "--help"])
        .assert()
        .success()
        .stdout(predicate::str::contains("Examples:"))
        .stdout(predicate::str::contains("corners-only"));
}

#[test]
fn an_unknown_option_exits_with_2() {
    plenocal().args(["calibrate", "--no-such-option"]).assert().code(2);
    let unknown = plenocal().args(["calibrate", "project.toml", "--fix", "focal"]).assert();
    unknown.code(2).stderr(predicate::str::contains("theta_x"));
}

/// The shipped features without their blur radii.
fn pinhole_features(file: &Path) {
    let text = fs::read_to_string(synthetic_folder().join("features.csv")).unwrap();
    let without_rho = |line: &str| {
        let fields: Vec<&str> = line.split(',').collect();
        [&fields[..4], &fields[5..]].concat().join(",")
    };
    let lines: Vec<String> = text.lines().map(without_rho).collect();
    fs::write(file, lines.join("\n")).unwrap();
}

#[test]
fn a_camera_of_pinholes_needs_no_blur_radii() {
    let folder = TempDir::new().unwrap();
    let (first, second) = (folder.path().join("first"), folder.path().join("second"));
    let features = folder.path().join("features.csv");
    pinhole_features(&features);
    calibrate(&first)
        .args(["--mode", "corners-only", "--features"])
        .arg(&features)
        .assert()
        .success();
    let mut command = calibrate(&second);
    command.args(["--mode", "poses-only", "--camera"]).arg(first.join("camera.json"));
    command.arg("--features").arg(&features).arg("--tables");
    command.assert().success().stdout(predicate::str::contains("Rotation vector"));
    // The camera is fixed, so none is written.
    assert!(second.join("poses.json").exists() && !second.join("camera.json").exists());
}

#[test]
fn the_help_says_what_becomes_of_files_that_exist() {
    for command in [
        "precalibrate",
        "detect",
        "calibrate",
        "extrinsics",
        "evaluate",
        "compare",
        "rays",
        "points",
        "run",
    ] {
        let help = plenocal().args([command, "--help"]).output().unwrap();
        let help = String::from_utf8(help.stdout).unwrap();
        let words: Vec<&str> = help.split_whitespace().collect();
        assert!(words.join(" ").contains("Files of earlier results are replaced"), "{command}");
    }
}

/// The cost of poses has no blur radius, but residuals state it.
#[test]
fn a_blur_radius_wider_than_the_image_is_refused_where_it_does_not_count_too() {
    let folder = TempDir::new().unwrap();
    let features = fs::read_to_string(synthetic_folder().join("features.csv")).unwrap();
    let mut lines: Vec<String> = features.lines().map(str::to_owned).collect();
    let at = lines[0].split(',').position(|name| name == "rho").unwrap();
    let mut values: Vec<&str> = lines[1].split(',').collect();
    values[at] = "1e308";
    lines[1] = values.join(",");
    let path = folder.path().join("features.csv");
    fs::write(&path, lines.join("\n")).unwrap();
    let mut command = plenocal();
    command.args(["calibrate", "--mode", "poses-only", "--camera"]);
    command.arg(synthetic_folder().join("truth/camera.json"));
    command.arg("--scene").arg(synthetic_folder().join("project.toml"));
    command.arg("--features").arg(&path).arg("--out").arg(folder.path().join("out"));
    command.assert().code(1).stderr(predicate::str::contains("wider than the image"));
}
