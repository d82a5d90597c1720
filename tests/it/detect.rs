//! `plenocal detect`: from images to features, with bad input too.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use assert_cmd::assert::Assert;
use plenocal::io::{add_detection, read_camera, read_features, read_poses};
use plenocal::model::BapFeature;
use predicates::prelude::PredicateBooleanExt;
use predicates::str::contains;
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::prepared::Files;
use crate::support::plenocal;

/// Runs a command on the project of a data set, with its results in another folder.
fn on_project(command: &str, set: &Path, out: &Path) -> Assert {
    let mut program = plenocal();
    program
        .arg(command)
        .arg(set.join("project.toml"))
        .arg("--tables")
        .arg("--out")
        .arg(out)
        .assert()
}

/// The default data set in `set`, without evaluation and translation images. In `measured`, its
/// pre-calibration and detection.
static WHOLE: LazyLock<Files> = LazyLock::new(|| {
    let folder = TempDir::new().unwrap();
    let (set, measured) = (folder.path().join("set"), folder.path().join("measured"));
    plenocal()
        .args(["simulate", "--set", "rays=32", "--set", "boards.evaluation=0"])
        .args(["--set", "translation.images=0", "--out"])
        .arg(&set)
        .assert()
        .success();
    on_project("detect", &set, &measured)
        .success()
        .stdout(contains("10 of 10 frames").and(contains("frame-09.svg")));
    Files::read(folder.path())
});

/// A small data set in `set`, and its pre-calibration in `measured`.
static SMALL: LazyLock<Files> = LazyLock::new(|| {
    let folder = TempDir::new().unwrap();
    let (set, measured) = (folder.path().join("set"), folder.path().join("measured"));
    plenocal()
        .args(["simulate", "--set", "rays=16", "--set", "boards.calibration=3"])
        .args(["--set", "boards.evaluation=2", "--set", "translation.images=0", "--out"])
        .arg(&set)
        .assert()
        .success();
    on_project("precalibrate", &set, &measured).success();
    Files::read(folder.path())
});

/// A copy of a data set for one test.
struct Set {
    folder: TempDir,
}

impl Set {
    fn whole() -> Self {
        Self { folder: WHOLE.copy() }
    }

    fn small() -> Self {
        Self { folder: SMALL.copy() }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Detects into a folder, with the pre-calibration made before.
    fn detect_into(&self, out: &str, options: &[&str]) -> Assert {
        let mut program = plenocal();
        program.arg("detect").arg(self.path("set/project.toml")).arg("--no-pictures");
        program.arg("--precalibration").arg(self.path("measured"));
        program.arg("--out").arg(self.path(out)).args(options).assert()
    }

    fn detect(&self, options: &[&str]) -> Assert {
        self.detect_into("out", options)
    }

    fn features(&self, out: &str) -> Vec<BapFeature> {
        read_features(&self.path(out).join("features.csv"), true).unwrap().features
    }

    /// Replaces a part of the project.
    fn replace(&self, from: &str, to: &str) -> &Self {
        let project = self.path("set/project.toml");
        let text = fs::read_to_string(&project).unwrap();
        assert!(text.contains(from), "{from}");
        fs::write(project, text.replace(from, to)).unwrap();
        self
    }

    /// Writes a copy of an image in which `paint` has changed every pixel, given u, v and its value.
    fn repaint(&self, from: &str, to: &str, paint: impl Fn(u32, u32, u8) -> u8) -> &Self {
        let mut picture = image::open(self.path("set").join(from)).unwrap().into_luma8();
        for (u, v, pixel) in picture.enumerate_pixels_mut() {
            pixel.0[0] = paint(u, v, pixel.0[0]);
        }
        picture.save(self.path("set").join(to)).unwrap();
        self
    }

    /// Edits the measured internal parameters.
    fn edit_internal(&self, edit: impl Fn(&mut Value)) {
        let file = self.path("measured/precalibration.json");
        let mut document: Value = serde_json::from_slice(&fs::read(&file).unwrap()).unwrap();
        edit(&mut document["internal_parameters"]);
        fs::write(&file, document.to_string()).unwrap();
    }
}

/// From images to a camera: within 0.2 % of the simulated one in F and D, 0.4 % in d and fᵢ.
#[test]
fn detected_features_calibrate_the_simulated_camera() {
    let set = Set::whole();
    let mut command = plenocal();
    command.arg("calibrate").arg(set.path("set/project.toml")).arg("--out").arg(set.path("out"));
    // With a free exit pupil F is known to half a per cent only, on so few boards.
    command.args(["--exit-pupil", "at-lens"]);
    for (option, file) in [
        ("--params", "precalibration.json"),
        ("--centers", "centers.csv"),
        ("--features", "features.csv"),
    ] {
        command.arg(option).arg(set.path("measured").join(file));
    }
    command.assert().success();
    let camera = |path: &Path| read_camera(path).unwrap();
    let truth = camera(&set.path("set/truth/camera.json"));
    let found = camera(&set.path("out/camera.json"));
    let off = |a: f64, b: f64| (a / b - 1.0).abs();
    let (lens, mla) = (&found.main_lens, &found.mla);
    assert!(off(lens.focal_length_mm, truth.main_lens.focal_length_mm) < 0.002);
    assert!(off(mla.lens_to_mla_mm, truth.mla.lens_to_mla_mm) < 0.002);
    assert!(off(mla.mla_to_sensor_mm, truth.mla.mla_to_sensor_mm) < 0.004);
    for (a, b) in mla.focal_lengths_mm.iter().zip(&truth.mla.focal_lengths_mm) {
        assert!(off(*a, *b) < 0.004, "{a} for {b}");
    }
}

#[test]
fn a_pre_calibration_made_before_gives_the_same_features() {
    let set = Set::whole();
    set.detect(&[]).success();
    assert_eq!(set.features("out").len(), set.features("measured").len());
}

/// A hand in front of the board.
#[test]
fn a_partly_hidden_board_gives_its_visible_features() {
    let set = Set::whole();
    set.repaint("calibration/calibration-05.png", "hidden.png", |u, v, grey| {
        if (400..600).contains(&u) && v > 300 { grey.min(20) } else { grey }
    });
    // The hidden board alone.
    let project = fs::read_to_string(set.path("set/project.toml")).unwrap();
    let list = &project[project.find("\ncalibration = [").unwrap()..];
    let list = &list[..=list.find(']').unwrap()];
    set.replace(list, "\ncalibration = [\"hidden.png\"]");
    set.detect(&[]).success().stdout(contains("1 of 1 frames"));
    let key = |f: &BapFeature| (f.corner, f.k, f.l);
    let whole = set.features("measured");
    let known: BTreeSet<_> = whole.iter().filter(|f| f.frame == 5).map(key).collect();
    let kept: BTreeSet<_> = set.features("out").iter().map(key).collect();
    let strange = kept.difference(&known).count();
    println!("{} of {} features are left, {strange} new", kept.len(), known.len());
    assert!(kept.len() * 2 > known.len() && kept.len() < known.len());
    assert!(strange * 50 <= kept.len(), "{strange} features that the whole board does not have");
}

#[test]
fn json_lists_the_features_and_drops_of_every_frame() {
    let set = Set::small();
    let json = set.detect(&["--json", "--subset", "evaluation"]).success();
    let printed: Value = serde_json::from_slice(&json.get_output().stdout).unwrap();
    assert_eq!(printed["format"], "plenocal-detection");
    let frames = printed["frames"].as_array().unwrap();
    assert_eq!(frames.len(), 2);
    assert!(frames[0]["image"].as_str().unwrap().ends_with("evaluation-00.png"));
    for field in ["alone", "off_line", "texture", "off_board", "unclear", "misplaced", "given_up"] {
        assert!(frames[0]["dropped"][field].is_u64(), "{field}");
    }
    let count: u64 = frames.iter().map(|frame| frame["features"].as_u64().unwrap()).sum();
    assert_eq!(count, set.features("out").len() as u64);
}

#[test]
fn the_estimator_changes_only_the_blur_radii() {
    let set = Set::small();
    let features = |estimator: &str| {
        set.detect_into(estimator, &["--subset", "evaluation", "--estimator", estimator])
            .success()
            .stdout(contains("2 of 2 frames"));
        set.features(estimator)
    };
    let (line, median) = (features("line"), features("median"));
    assert_eq!(line.len(), median.len());
    let pairs = || line.iter().zip(&median);
    let rho = |f: &BapFeature| f.rho_px.unwrap();
    assert!(pairs().all(|(a, b)| (a.u_px - b.u_px).abs() < 1e-9 && (rho(a) - rho(b)).abs() < 0.5));
    assert!(pairs().any(|(a, b)| (rho(a) - rho(b)).abs() > 1e-6));
}

#[test]
fn a_frame_without_a_board_is_left_out_by_name() {
    Set::small()
        .replace("calibration/calibration-01.png", "whites/white-0-n-4.00.png")
        .detect(&[])
        .success()
        .stderr(contains("frame 1 (white-0-n-4.00.png) is left out: the image shows no board"))
        .stdout(contains("2 of 3 frames"));
}

#[test]
fn a_frame_that_cannot_be_read_is_left_out_by_name() {
    Set::small()
        .replace("calibration/calibration-01.png", "calibration/none.png")
        .detect(&[])
        .success()
        .stderr(contains("frame 1 (none.png) is left out: cannot read"));
}

#[test]
fn an_over_exposed_frame_is_left_out_by_name() {
    Set::small()
        .repaint("calibration/calibration-01.png", "bright.png", |_, _, grey| {
            grey.saturating_mul(4)
        })
        .replace("calibration/calibration-01.png", "bright.png")
        .detect(&[])
        .success()
        .stderr(contains("frame 1 (bright.png) is left out").and(contains("[saturated]")));
}

#[test]
fn a_board_of_another_size_is_an_error_and_nothing_is_written() {
    let set = Set::small();
    set.replace("columns = 8\nrows = 5", "columns = 7\nrows = 4")
        .detect(&[])
        .code(1)
        .stderr(contains("beyond the board of 7 x 4 inner corners"))
        .stderr(contains("frame 2 (calibration-02.png) is left out"))
        .stderr(contains("Micro-images").and(contains("0 features in 0 of 3 frames")));
    assert!(!set.path("out").exists());
}

#[test]
fn a_board_of_two_corners_a_side_is_rejected() {
    Set::small()
        .replace("columns = 8\nrows = 5", "columns = 2\nrows = 2")
        .detect(&[])
        .code(1)
        .stderr(contains("2 x 2 inner corners").and(contains("6 to 2500")));
}

#[test]
fn a_white_image_at_another_f_number_is_rejected() {
    let set = Set::small();
    set.replace("\"devignetting.png\"", "\"whites/white-4-n-16.00.png\"");
    on_project("detect", &set.path("set"), &set.path("out"))
        .code(1)
        .stderr(contains("the radius at about f/16").and(contains("no frame shows the board")));
}

/// The message does not blame the frames for over-exposure.
#[test]
fn a_white_image_that_is_saturated_is_rejected() {
    Set::small()
        .repaint("devignetting.png", "clipped.png", |_, _, grey| grey.saturating_mul(8))
        .replace("\"devignetting.png\"", "\"clipped.png\"")
        .detect(&["--subset", "evaluation"])
        .code(1)
        .stderr(contains("saturated in the white image").and(contains("shorter exposure")));
}

/// Stops are engraved in round numbers.
#[test]
fn the_white_image_of_the_nearest_stop_is_used_if_it_is_near_enough() {
    let no_reference = ("devignetting = \"devignetting.png\"\n", "");
    let at = |f_number: &str| {
        let set = Set::small();
        set.replace(no_reference.0, no_reference.1);
        set.replace("f_number = 4\nfocus", &format!("f_number = {f_number}\nfocus"));
        set.detect(&["--subset", "evaluation"])
    };
    at("4.1").success();
    at("5").code(1).stderr(
        contains("at f/5.00").and(contains("the nearest is white-1-n-5.66.png, at f/5.66")),
    );
}

#[test]
fn a_key_that_does_not_exist_is_rejected_by_name() {
    Set::small().replace("[board]", "[bord]").detect(&[]).code(1).stderr(contains("bord"));
}

#[test]
fn centres_of_a_larger_array_than_stated_are_rejected() {
    Set::small()
        .replace("columns = 43\nrows = 37", "columns = 39\nrows = 33")
        .detect(&[])
        .code(1)
        .stderr(contains("outside the array of 39 x 33"));
}

#[test]
fn internal_parameters_of_another_camera_are_rejected_by_folder() {
    for (key, value, words) in [
        ("q_prime_mm", json!([0.05]), "I = 3 lens types"),
        ("m_mm", json!(-0.4), "|m|"),
        ("micro_image_pitch_mm", json!(0.2), "different cameras"),
    ] {
        let set = Set::small();
        set.edit_internal(|internal| internal[key] = value.clone());
        let folder = set.path("measured").display().to_string();
        set.detect(&[]).code(1).stderr(contains(words).and(contains(folder)));
    }
}

/// White images show the point spread, edges of boards the aperture ratio; both with their σ.
#[test]
fn point_spread_and_aperture_ratio_are_measured() {
    let folder = TempDir::new().unwrap();
    let (set, found) = (folder.path().join("set"), folder.path().join("found"));
    let settings = ["rays=32", "seed=31", "boards.calibration=2", "boards.evaluation=0"];
    let imperfect = ["imperfections.point_spread_px=0.4", "imperfections.aperture_ratio=0.9"];
    let mut simulate = plenocal();
    simulate.args(["simulate", "--set", "translation.images=0", "--out"]).arg(&set);
    simulate.args(settings.iter().chain(&imperfect).flat_map(|set| ["--set", set]));
    simulate.assert().success();
    on_project("detect", &set, &found).success();
    let read = |name: &str| -> Value {
        serde_json::from_slice(&fs::read(found.join(name)).unwrap()).unwrap()
    };
    let within = |value: &Value, std_dev: &Value, truth: f64| {
        let (value, std_dev) = (value.as_f64().unwrap(), std_dev.as_f64().unwrap());
        assert!((value - truth).abs() < 3.0 * std_dev, "{value} ± {std_dev} for {truth}");
        assert!(std_dev < 0.02, "{std_dev}");
    };
    let spread = &read("precalibration.json")["internal_parameters"]["point_spread_px2"];
    within(&spread["value"], &spread["std_dev"], 0.16);
    let detection = read("detection.json");
    let ratio = &detection["aperture_ratio"];
    within(&ratio["value"], &ratio["std_dev"], 0.9);
    within(&detection["fitted_with_aperture_ratio"], &json!(0.005), 0.9);
}

/// The camera does not depend on which part of the board fills the view. Poses do.
#[test]
fn a_board_that_fills_the_view_counts_for_the_camera_only() {
    let folder = TempDir::new().unwrap();
    let (set, found) = (folder.path().join("set"), folder.path().join("found"));
    let settings = [
        "seed=505",
        "rays=16",
        "boards.calibration=3",
        "boards.evaluation=0",
        "translation.images=0",
        "boards.min_in_view=0.4",
        "boards.max_tilt_deg=25",
        "target.columns=11",
        "target.rows=8",
    ];
    let mut simulate = plenocal();
    simulate
        .arg("simulate")
        .args(settings.iter().flat_map(|s| ["--set", s]))
        .arg("--out")
        .arg(&set);
    simulate.assert().success();
    on_project("detect", &set, &found)
        .success()
        .stdout(contains("3 of 3 frames"))
        .stderr(contains("the board fills the view (frames 0, 1)"));
    let detection: Value =
        serde_json::from_slice(&fs::read(found.join("detection.json")).unwrap()).unwrap();
    let frames = detection["frames"].as_array().unwrap();
    let shifted: Vec<bool> = frames.iter().map(|frame| frame["shifted"] == true).collect();
    assert_eq!(shifted, [true, true, false]);
    let features = found.join("features.csv");
    let mut observations = read_features(&features, true).unwrap();
    add_detection(&mut observations, &features).unwrap();
    assert_eq!(observations.shifted_frames, BTreeSet::from([0, 1]));
    let mut poses = plenocal();
    poses.arg("extrinsics").arg(set.join("project.toml")).arg("--camera");
    poses.arg(set.join("truth/camera.json")).arg("--precalibration").arg(&found);
    poses.args(["--subset", "calibration", "--out"]).arg(folder.path().join("poses"));
    poses.assert().stderr(contains("match more than one part of the board"));
    let posed = read_poses(&folder.path().join("poses/poses.json")).unwrap();
    assert_eq!(posed.iter().map(|pose| pose.frame).collect::<Vec<u32>>(), [2]);
}
