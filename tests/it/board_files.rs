//! The shape of a board in files, and on the command line.

use std::path::Path;

use plenocal::io::read_board_shape;
use plenocal::model::Board;
use predicates::str::contains;
use serde_json::Value;
use tempfile::TempDir;

use crate::support::{board, plenocal, synthetic_folder};

/// `calibrate` leaves the shape beside the camera, and what poses boards with that camera takes it.
#[test]
fn the_shape_of_a_board_is_read_beside_its_camera() {
    let folder = TempDir::new().unwrap();
    let path = |name: &str| folder.path().join(name);
    let out = path("calibration");
    let project = synthetic_folder().join("project.toml");
    let run = |arguments: &[&str]| {
        let output = plenocal().args(arguments).output().unwrap();
        (output.status.success(), String::from_utf8(output.stderr).unwrap())
    };
    let [project, out_text] = [&project, &out].map(|p| p.to_str().unwrap());
    let (done, stderr) = run(&["calibrate", project, "--board", "bent", "--out", out_text]);
    assert!(done, "{stderr}");
    let file = out.join("calibration.json");
    let written: Value = serde_json::from_str(&std::fs::read_to_string(&file).unwrap()).unwrap();
    let (shape, std_devs) = read_board_shape(&file, &board()).unwrap().unwrap();
    let section = &written["board_shape"];
    assert_eq!(section["shape"]["sag_x_mm"], shape.sag_x_mm);
    assert!(section["standard_deviations"]["aspect"]["value"].as_f64().unwrap() > 0.0);
    assert!(written["camera"]["uncertainty"]["standard_deviations"]["sag_x"].is_null());
    assert_eq!(section["standard_deviations"]["twist"]["value"].as_f64(), std_devs[2]);
    let all = &written["standard_deviations"]["parameters"];
    assert_eq!(all["twist"]["used"].as_f64(), std_devs[2]);
    let of = |board: Board| read_board_shape(&file, &board).unwrap();
    let (other, other_squares) =
        (Board { rows: 6, ..board() }, Board { square_mm: board().square_mm * 1.03, ..board() });
    assert_eq!((of(other), of(other_squares)), (None, None));
    // Measured again, its squares are a little larger.
    assert!(of(Board { square_mm: board().square_mm * 1.002, ..board() }).is_some());

    // The same boards, with this camera and with it alone.
    let camera = out.join("camera.json");
    let pose = |camera: &Path, more: &[&str], to: &str| {
        let (camera, to) = (camera.to_str().unwrap().to_owned(), path(to));
        let mut arguments = vec!["calibrate", project, "--mode", "poses-only", "--camera", &camera];
        let to_text = to.to_str().unwrap().to_owned();
        arguments.extend(["--out", &to_text]);
        arguments.extend(more);
        let (done, stderr) = run(&arguments);
        assert!(done, "{stderr}");
        assert!(!to.join("calibration.json").exists());
        std::fs::read(to.join("poses.json")).unwrap()
    };
    let alone = path("camera.json");
    std::fs::copy(&camera, &alone).unwrap();
    let shape_file = file.to_str().unwrap();
    let beside = pose(&camera, &[], "beside");
    assert_eq!(beside, pose(&alone, &["--board-shape", shape_file], "stated"));
    assert_ne!(beside, pose(&alone, &[], "flat"));
    assert_eq!(pose(&camera, &["--board", "flat"], "asked"), pose(&alone, &[], "flat"));

    assert_contradictions_are_refused(folder.path(), &camera, shape_file);

    let scene = path("project.toml");
    let text = std::fs::read_to_string(project).unwrap().replace("rows = 5\n", "rows = 6\n");
    std::fs::write(
        &scene,
        text.replace("\"features.csv", &format!("\"{}/features.csv", synthetic_folder().display()))
            .replace("\"centers.csv", &format!("\"{}/centers.csv", synthetic_folder().display())),
    )
    .unwrap();
    let scene = scene.to_str().unwrap();
    let (done, stderr) = run(&[
        "calibrate",
        scene,
        "--board-shape",
        shape_file,
        "--out",
        path("x").to_str().unwrap(),
    ]);
    assert!(!done && stderr.contains("it has no board_shape for a board of 9 x 6"), "{stderr}");
}

/// A shape that a file states, or that is to be found without a camera, and what the project says of the board.
fn assert_contradictions_are_refused(folder: &Path, camera: &Path, shape_file: &str) {
    let refused = folder.join("bent.toml");
    let synthetic = synthetic_folder().display().to_string();
    let text = std::fs::read_to_string(synthetic_folder().join("project.toml")).unwrap();
    let text = text.replace("features = \"", &format!("features = \"{synthetic}/"));
    let text = text.replace("centers = \"", &format!("centers = \"{synthetic}/"));
    std::fs::write(&refused, text + "\n[calibration]\nboard = \"bent\"\n").unwrap();
    let calibrate = |arguments: &[&str]| {
        let mut command = plenocal();
        command.arg("calibrate").arg(&refused).args(arguments);
        command.arg("--out").arg(folder.join("refused")).assert()
    };
    let says = contains("the project states board = \"bent\"");
    calibrate(&["--board-shape", shape_file]).code(1).stderr(says);
    let poses_only = ["--mode", "poses-only", "--camera", camera.to_str().unwrap()];
    calibrate(&poses_only).code(1).stderr(contains("give --board auto"));
    calibrate(&[&poses_only[..], &["--board", "auto"]].concat()).success();
}
