//! `plenocal run`: from images to a report, with bad input too.
//!
//! The tests start from copies of one run: a small simulated data set in `set`, its results in
//! `results`.

use std::fs;
use std::path::PathBuf;
use std::sync::LazyLock;

use assert_cmd::assert::Assert;
use plenocal::io::{read_camera, read_std_devs};
use predicates::prelude::PredicateBooleanExt;
use predicates::str::contains;
use serde_json::Value;
use tempfile::TempDir;

use crate::prepared::Files;
use crate::support::plenocal;

/// Largest error of a displacement on ideal images; the paper has 3.33 % on real ones.
const TRANSLATION: f64 = 0.005;
/// Limit for distances between the corners of other boards, relative.
const DISTANCES: f64 = 0.005;
const FOUR_SIGMA: f64 = 4.0;
/// No board is further away.
const FAR_MM: f64 = 100.0;

/// The files of a run with three folds, and what it printed.
struct Prepared {
    files: Files,
    stdout: String,
    stderr: String,
}

static PREPARED: LazyLock<Prepared> = LazyLock::new(|| {
    let folder = TempDir::new().unwrap();
    plenocal()
        .args(["simulate", "--set", "rays=24", "--set", "boards.calibration=6"])
        .args(["--set", "boards.evaluation=2", "--set", "translation.images=4", "--out"])
        .arg(folder.path().join("set"))
        .assert()
        .success();
    let run = Run { folder };
    let assert = run.again(&["--folds", "3", "--corners-only", "--tables"]).success();
    let text = |bytes: &[u8]| String::from_utf8(bytes.to_owned()).unwrap();
    let output = assert.get_output();
    let (stdout, stderr) = (text(&output.stdout), text(&output.stderr));
    Prepared { files: Files::read(run.folder.path()), stdout, stderr }
});

/// A copy of the run for one test.
struct Run {
    folder: TempDir,
}

impl Run {
    fn copy() -> Self {
        Self { folder: PREPARED.files.copy() }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn json(&self, name: &str) -> Value {
        serde_json::from_slice(&fs::read(self.path(name)).unwrap()).unwrap()
    }

    fn report(&self) -> String {
        fs::read_to_string(self.path("results/report.html")).unwrap()
    }

    /// Runs again into the same folder.
    fn again(&self, options: &[&str]) -> Assert {
        let mut program = plenocal();
        program.arg("run").arg(self.path("set/project.toml"));
        program.arg("--out").arg(self.path("results")).args(options).assert()
    }

    /// Runs a single command on the results; its own results go into a folder of its name.
    fn single(&self, command: &str, options: &[&str]) -> Assert {
        let mut program = plenocal();
        program.arg(command).arg(self.path("set/project.toml"));
        program.arg("--precalibration").arg(self.path("results/precalibration"));
        program.arg("--camera").arg(self.path("results/calibration/camera.json"));
        program.arg("--tables").arg("--out").arg(self.path(command)).args(options).assert()
    }

    /// Evaluates with the features of the calibration.
    fn evaluate_with_folds(&self, folds: &str) -> Assert {
        let features = self.path("results/boards-calibration/features.csv");
        self.single("evaluate", &["--folds", folds, "--features", features.to_str().unwrap()])
    }

    fn edit(&self, name: &str, edit: impl FnOnce(&str) -> String) {
        let text = fs::read_to_string(self.path(name)).unwrap();
        let edited = edit(&text);
        assert_ne!(text, edited, "the edit changes the file");
        fs::write(self.path(name), edited).unwrap();
    }

    /// Replaces the images of the evaluation by files that are not images.
    fn spoil_evaluation(&self) {
        for frame in ["00", "01"] {
            let image = self.path(&format!("set/evaluation/evaluation-{frame}.png"));
            assert!(image.is_file());
            fs::write(image, "no image").unwrap();
        }
    }
}

#[test]
fn a_run_prints_the_tables_and_its_stages() {
    let Prepared { stdout, stderr, .. } = &*PREPARED;
    for words in [
        "Table 4",
        "Table 3",
        "Against the true camera: blur aware",
        "Cross-validation",
        "report.html",
    ] {
        assert!(stdout.contains(words), "{words}: {stdout}");
    }
    assert!(stderr.contains("boards-calibration: "), "{stderr}");
}

/// What a user needs to know is on one screen.
#[test]
fn a_run_ends_within_a_screen() {
    let run = Run::copy();
    let output = run.again(&["--folds", "2", "--no-pictures"]).success().get_output().clone();
    let stdout = String::from_utf8(output.stdout).unwrap();
    assert!(stdout.lines().count() <= 26, "{stdout}");
    for words in [
        "Verdict: ",
        "F ",
        "f_3",
        "e_z",
        "Reprojection errors (RMS): (u, v) 0.0",
        "Held-out boards: ",
        "± along",
        "Known steps: ",
        "Against the true camera: the error of F is ",
        "Next board: ",
        "report.html",
    ] {
        assert!(stdout.contains(words), "{words}: {stdout}");
    }
    assert!(!stdout.contains('\u{1b}') && !stdout.contains("Cross-validation"), "{stdout}");
}

#[test]
fn the_evaluation_of_a_run_agrees_with_the_truth() {
    let run = Run::copy();
    let evaluation = run.json("results/evaluation/evaluation.json");
    let cameras = evaluation["cameras"].as_array().unwrap();
    assert_eq!(cameras.len(), 2);
    for camera in cameras {
        let error = camera["translation"]["relative_error"]["mean"].as_f64().unwrap();
        assert!(error < TRANSLATION, "{error}");
        assert_eq!(camera["translation"]["steps"].as_array().unwrap().len(), 3);
        assert!(camera["evaluation"]["uv"].as_f64().unwrap() < 0.15);
        assert_eq!(camera["evaluation"]["frames"], 2);
        let reconstruction = &camera["reconstruction"];
        assert_eq!(reconstruction["frames"], 2);
        let distances = &reconstruction["distances_too_long"];
        let [error, std_dev] =
            ["mean", "standard_deviation"].map(|name| distances[name].as_f64().unwrap());
        assert!(error.abs() < DISTANCES && std_dev < DISTANCES, "{error} ± {std_dev}");
    }
    assert_eq!(evaluation["cross_validation"]["folds"].as_array().unwrap().len(), 3);
    let along = evaluation["poses_against_truth"][0]["along_mm"].as_f64().unwrap();
    // All distances share the relative error of F.
    let (_, std_dev) = error_of_f(&run);
    assert!(along < FOUR_SIGMA * std_dev * FAR_MM, "{along} with {std_dev}");
}

/// Relative error of F, and its σ.
fn error_of_f(run: &Run) -> (f64, f64) {
    let focal_length = |name: &str| {
        let camera = read_camera(&run.path(name)).unwrap();
        camera.main_lens.focal_length_mm
    };
    let found = "results/calibration/camera.json";
    let std_devs = read_std_devs(&run.path(found), 3).unwrap();
    let truth = focal_length("set/truth/camera.json");
    (focal_length(found) / truth - 1.0, std_devs[0].unwrap() / truth)
}

#[test]
fn the_cameras_of_a_run_agree_with_the_truth() {
    let run = Run::copy();
    let (off, std_dev) = error_of_f(&run);
    assert!(std_dev < 0.03 && off.abs() < FOUR_SIGMA * std_dev, "{off} ± {std_dev}");
    let corners_only = read_camera(&run.path("results/corners-only/camera.json")).unwrap();
    assert_eq!(corners_only.lens_types(), 0);
}

#[test]
fn the_report_of_a_run_has_all_stages_and_no_external_references() {
    let report = Run::copy().report();
    for words in ["Pre-calibration", "Boards: calibration", "Boards: translation", "Evaluation"] {
        assert!(report.contains(words), "{words}");
    }
    assert!(report.matches("<svg").count() > 15);
    assert!(!report.contains("src=\"http") && !report.contains("href=\"http"));
}

/// Results of an earlier run are replaced, and the same input gives the same features.
#[test]
fn a_second_run_replaces_the_results_of_the_first() {
    let run = Run::copy();
    run.again(&["--folds", "0", "--no-pictures"]).success();
    assert!(!run.path("results/boards-calibration/frame-00.svg").exists());
    assert!(!run.path("results/corners-only").exists());
    for name in ["boards-calibration/features.csv", "precalibration/centers.csv"] {
        let name = format!("results/{name}");
        assert!(fs::read(run.path(&name)).unwrap() == PREPARED.files.get(&name), "{name}");
    }
    let manifest = run.json("results/manifest.json");
    assert_eq!(manifest["arguments"][0], "run");
    let stages: Vec<&str> = manifest["stages"]
        .as_array()
        .unwrap()
        .iter()
        .map(|s| s["name"].as_str().unwrap())
        .collect();
    let boards = ["boards-calibration", "boards-evaluation", "boards-translation"];
    let expected = [&["precalibration"][..], &boards, &["calibration", "evaluation"]].concat();
    assert_eq!(stages, expected);
}

/// The verdict and its codes come from values, and are the same on the terminal and in files.
#[test]
fn the_verdict_of_a_run_has_codes_and_values() {
    let run = Run::copy();
    let verdict = run.json("results/verdict.json");
    assert!(["good", "usable with care"].contains(&verdict["verdict"].as_str().unwrap()));
    for reason in verdict["reasons"].as_array().unwrap() {
        let code = reason["code"].as_str().unwrap();
        assert!(plenocal::Issue::CODES.contains(&code) && reason["values"].is_object(), "{reason}");
        assert!(PREPARED.stdout.contains(reason["text"].as_str().unwrap()), "{reason}");
    }
    let of_camera = run.json("results/calibration/camera.json")["verdict"].clone();
    assert_eq!(of_camera["verdict"], verdict["verdict"]);
    let codes: Vec<&Value> =
        verdict["reasons"].as_array().unwrap().iter().map(|reason| &reason["code"]).collect();
    assert_eq!(of_camera["reasons"], serde_json::json!(codes));
}

#[test]
fn a_folder_belongs_to_one_run_and_a_damaged_manifest_deletes_nothing_elsewhere() {
    let run = Run::copy();
    let held = fs::File::open(run.path("results")).unwrap();
    held.lock().unwrap();
    run.again(&["--folds", "3"]).failure().stderr(contains("is in use by another run"));
    held.unlock().unwrap();
    let victim = run.path("victim.txt");
    fs::write(&victim, "mine").unwrap();
    let frame = "\"frame-00.svg\"";
    run.edit("results/manifest.json", |text| {
        text.replacen(frame, &format!("\"../../victim.txt\",\n{frame}"), 1)
    });
    run.again(&["--folds", "3", "--no-pictures"]).success();
    assert_eq!(fs::read_to_string(victim).unwrap(), "mine");
}

#[test]
fn a_single_fold_is_rejected() {
    Run::copy().again(&["--folds", "1"]).code(1).stderr(contains("one fold leaves no frames"));
}

/// Options that do not fit the comparison or the folds do not stop the run.
#[test]
fn folds_work_with_fixed_parameters_and_excluded_frames() {
    let run = Run::copy();
    let options = "\n[calibration]\nfix = [\"f_1\"]\nexclude_frames = [5]\nexit_pupil = \"at-lens\"\n\
                   field_curvature = \"flat\"\n";
    run.edit("set/project.toml", |text| format!("{text}{options}"));
    run.again(&["--tables"])
        .success()
        .stdout(contains("fold 5"))
        .stderr(contains("warning: frame 5 is left out"));
}

#[test]
fn the_truth_of_another_camera_gives_a_warning() {
    let run = Run::copy();
    run.edit("set/truth/camera.json", |text| text.replace("hexagonal-rows", "hexagonal-columns"));
    run.again(&["--folds", "0", "--tables"])
        .success()
        .stderr(contains("warning: blur aware, truth: the true camera has"))
        .stdout(contains("Table 3"));
}

#[test]
fn a_damaged_image_is_left_out_by_name() {
    let run = Run::copy();
    let image = run.path("set/calibration/calibration-02.png");
    let whole = fs::read(&image).unwrap();
    fs::write(&image, &whole[..whole.len() / 2]).unwrap();
    run.again(&["--folds", "0"])
        .success()
        .stderr(contains("frame 2 (calibration-02.png) is left out: ").and(contains("cut off")));
    assert!(!run.path("results/boards-calibration/frame-02.svg").exists());
    assert!(run.report().contains("frame 2 (calibration-02.png) is left out"));
}

#[test]
fn a_calibration_does_not_need_the_boards_of_the_evaluation() {
    let run = Run::copy();
    run.spoil_evaluation();
    run.again(&["--folds", "0", "--json"])
        .success()
        .stderr(contains("warning: boards for evaluation: no image could be read"))
        .stdout(contains("\"evaluation\":null"));
    assert!(run.report().contains("boards for evaluation: no image could be read"));
}

/// The message names what is wrong, and not what may be wrong with a board.
#[test]
fn images_of_the_calibration_evaluate_nothing() {
    let run = Run::copy();
    for frame in ["00", "01"] {
        let image = run.path(&format!("set/calibration/calibration-{frame}.png"));
        fs::copy(image, run.path(&format!("set/evaluation/evaluation-{frame}.png"))).unwrap();
    }
    run.single("extrinsics", &[])
        .code(1)
        .stderr(contains("the images for evaluation are also images of the calibration"))
        .stderr(contains("no frame shows the board").not());
}

/// Files have all digits of the values of a run, and threads do not change a result.
#[test]
fn files_of_a_run_give_its_camera_again() {
    let run = Run::copy();
    let of_run = run.json("results/calibration/camera.json");
    for threads in ["1", "3"] {
        let mut program = plenocal();
        program.arg("calibrate").arg(run.path("set/project.toml")).args(["--threads", threads]);
        program.arg("--params").arg(run.path("results/precalibration/precalibration.json"));
        program.arg("--centers").arg(run.path("results/precalibration/centers.csv"));
        program.arg("--features").arg(run.path("results/boards-calibration/features.csv"));
        program.arg("--out").arg(run.path("again")).assert().success();
        let again = run.json("again/camera.json");
        assert_eq!(again["main_lens"], of_run["main_lens"], "{threads} threads");
        assert_eq!(again["uncertainty"], of_run["uncertainty"], "{threads} threads");
    }
}

#[test]
fn single_commands_without_a_board_are_errors() {
    let run = Run::copy();
    run.spoil_evaluation();
    for command in ["extrinsics", "evaluate"] {
        run.single(command, &[]).code(1).stderr(contains("no image could be read"));
    }
}

#[test]
fn extrinsics_finds_the_poses_of_a_subset() {
    let run = Run::copy();
    run.single("extrinsics", &["--subset", "translation"]).success().stdout(contains("poses.json"));
    assert_eq!(run.json("extrinsics/poses.json")["poses"].as_array().unwrap().len(), 4);
}

#[test]
fn more_folds_than_frames_are_rejected() {
    let run = Run::copy();
    run.evaluate_with_folds("100").code(1).stderr(contains("cannot be divided into 100 folds"));
}

#[test]
fn an_unknown_list_of_images_is_rejected_by_name() {
    let run = Run::copy();
    run.edit("set/project.toml", |text| text.replace("evaluation = [", "calibration_unused = ["));
    run.single("evaluate", &[]).code(1).stderr(contains("calibration_unused"));
}

#[test]
fn an_evaluation_does_not_need_its_own_images() {
    let run = Run::copy();
    run.edit("set/project.toml", |text| {
        let list = text.find("evaluation = [").unwrap();
        let end = list + text[list..].find(']').unwrap() + 1;
        format!("{}{}", &text[..list], &text[end..])
    });
    run.evaluate_with_folds("2").success().stdout(
        contains("Table 3").and(contains("Against the true camera")).and(contains("fold 2")),
    );
}

/// Steps of 5 mm, 2 % too long, measured towards the camera.
#[test]
fn the_point_clouds_of_other_software_are_compared() {
    let run = Run::copy();
    let clouds: Vec<String> = (0..4)
        .map(|frame| {
            let name = format!("cloud-{frame}.xyz");
            let z = -60.0 - 5.1 * f64::from(frame);
            let points = format!("x y z\n1 2 {z} 9 9 9\n3 4 {z}\n5 6 {}\n", z - 40.0);
            fs::write(run.path("set").join(&name), points).unwrap();
            format!("\"{name}\"")
        })
        .collect();
    let clouds = format!("[images.translation]\nclouds = [{}]", clouds.join(", "));
    run.edit("set/project.toml", |text| text.replace("[images.translation]", &clouds));
    run.single("evaluate", &[]).success().stdout(contains("point clouds").and(contains("2.000")));
}

#[test]
fn missing_parts_of_a_project_are_reported_before_any_stage() {
    let folder = TempDir::new().unwrap();
    let project = folder.path().join("project.toml");
    let rejected = |text: &str, words: &str| {
        fs::write(&project, text).unwrap();
        let out = folder.path().join("out");
        let mut program = plenocal();
        program.arg("run").arg(&project).arg("--out").arg(&out);
        program.assert().code(1).stderr(contains(words));
        assert!(!out.exists());
    };
    rejected("", "it has no camera");
    let camera = "[sensor]\nwidth_px = 100\nheight_px = 80\npixel_size_mm = 0.005\n\
                  [main_lens]\nfocal_length_mm = 50\nf_number = 4\nfocus_distance_mm = 500\n\
                  [micro_lens_array]\nconfiguration = \"galilean\"\nlattice = \"hexagonal-rows\"\n\
                  columns = 5\nrows = 4\nlens_types = 3\n";
    rejected(camera, "it has no board");
    let board = format!("{camera}[board]\ncolumns = 8\nrows = 5\nsquare_mm = 3\n");
    rejected(&board, "it lists no images");
    let images = format!("{board}[images]\ncolor = \"grey\"\n");
    rejected(&format!("{images}[calibration]\nmode = \"poses-only\"\n"), "plenocal extrinsics");
}

/// The array is counted with the micro-images that the border of the image cuts, in a run and step by step.
#[test]
fn an_array_whose_size_is_not_stated_is_counted() {
    let run = Run::copy();
    run.edit("set/project.toml", |text| {
        let size = |line: &&str| !line.starts_with("columns = 4") && !line.starts_with("rows = 3");
        text.lines().filter(size).collect::<Vec<_>>().join("\n")
    });
    let path = |name: &str| run.folder.path().join(name);
    let size = |camera: &str| {
        let lattice = read_camera(&path(camera)).unwrap().lattice;
        (lattice.columns, lattice.rows)
    };
    let stated = size("results/calibration/camera.json");
    run.again(&["--folds", "0", "--no-pictures"]).success();
    assert_eq!(size("results/calibration/camera.json"), stated);
    let mut calibrate = plenocal();
    calibrate.arg("calibrate").arg(path("set/project.toml")).arg("--out").arg(path("steps"));
    for (option, file) in [
        ("--params", "precalibration/precalibration.json"),
        ("--centers", "precalibration/centers.csv"),
        ("--features", "boards-calibration/features.csv"),
    ] {
        calibrate.arg(option).arg(path("results").join(file));
    }
    calibrate.assert().success();
    assert_eq!(size("steps/camera.json"), stated);
}
