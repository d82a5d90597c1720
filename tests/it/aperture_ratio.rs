//! Micro-lenses with gaps between them: white images and boards together tell the aperture ratio, and with it the true q'ᵢ,
//! fᵢ and tilt gradient of the array.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use assert_cmd::assert::Assert;
use plenocal::Estimate;
use plenocal::io::{read_camera, read_features, read_internal_parameters, read_std_devs};
use plenocal::model::{Parameter, optics};
use predicates::prelude::PredicateBooleanExt;
use predicates::str::contains;
use serde_json::Value;
use tempfile::TempDir;

use crate::support::plenocal;

const RATIO: f64 = 0.92;
const SIGMAS: f64 = 3.0;
/// What q'ᵢ and fᵢ have to be right to, relative.
const RIGHT: f64 = 5e-3;

/// A simulated camera, its images, and what was found in them.
struct Files {
    folder: TempDir,
}

/// Simulates the camera, with so many rays and boards that move by so much.
fn simulate(rays: u32, motion_px: u32, out: &Path) {
    let settings = [
        format!("rays={rays}"),
        "seed=2101".to_owned(),
        "boards.evaluation=0".to_owned(),
        "translation.images=0".to_owned(),
        format!("imperfections.aperture_ratio={RATIO}"),
        format!("boards.motion_px={motion_px}"),
    ];
    let mut command = plenocal();
    command.arg("simulate").args(settings.iter().flat_map(|set| ["--set", set]));
    command.arg("--out").arg(out).assert().success();
}

static FILES: LazyLock<Files> = LazyLock::new(|| {
    let files = Files { folder: TempDir::new().unwrap() };
    simulate(32, 0, &files.path("set"));
    let mut detect = plenocal();
    detect.arg("detect").arg(files.path("set/project.toml"));
    detect.arg("--out").arg(files.path("found")).assert().success();
    files
});

impl Files {
    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Calibrates from the detected corners, with these features.
    fn calibrate(&self, features: &Path, out: &Path) -> Assert {
        let mut command = plenocal();
        command.arg("calibrate").arg(self.path("set/project.toml"));
        command.arg("--params").arg(self.path("found/precalibration.json"));
        command.arg("--centers").arg(self.path("found/centers.csv"));
        command.arg("--features").arg(features).arg("--tables").arg("--out").arg(out).assert()
    }
}

/// Error and σ, both relative to the truth, of a parameter in the camera of a folder.
fn error(out: &Path, name: &str) -> (f64, f64) {
    let truth = read_camera(&FILES.path("set/truth/camera.json")).unwrap();
    let camera = read_camera(&out.join("camera.json")).unwrap();
    let std_devs = read_std_devs(&out.join("camera.json"), 3).unwrap();
    let i = Parameter::intrinsic(3).iter().position(|p| p.name() == name).unwrap();
    let (value, truth) = (camera.intrinsics()[i], truth.intrinsics()[i]);
    (value / truth - 1.0, std_devs[i].unwrap() / truth)
}

fn json(path: &Path) -> Value {
    serde_json::from_slice(&fs::read(path).unwrap()).unwrap()
}

#[test]
fn the_true_camera_is_found_from_images() {
    let out = FILES.path("results");
    let printed = FILES.calibrate(&FILES.path("found/features.csv"), &out).success();
    for name in ["F", "D", "d", "f_1", "f_2", "f_3"] {
        let (error, std_dev) = error(&out, name);
        assert!(error.abs() < SIGMAS * std_dev, "{name}: {error} ± {std_dev}");
        assert!(name == "F" || name == "D" || error.abs() < RIGHT, "{name}: {error}");
    }
    let truth = read_camera(&FILES.path("set/truth/camera.json")).unwrap();
    let camera = read_camera(&out.join("camera.json")).unwrap();
    let q_prime = [&camera, &truth].map(|camera| optics::internal_parameters(camera).q_prime_mm);
    for (found, truth) in q_prime[0].iter().zip(&q_prime[1]) {
        assert!((found / truth - 1.0).abs() < RIGHT, "{found} for {truth}");
    }
    let Estimate { value, std_dev } = camera.edge_spread.aperture_ratio.unwrap();
    let blur = format!("Aperture ratio of the micro-lenses: {value:.4} ± {std_dev:.4}");
    printed.stdout(contains(blur).and(contains("; point spread ")));
    assert!((value - RATIO).abs() < SIGMAS * std_dev && std_dev < 5e-3, "{value} ± {std_dev}");
    let stated = truth.edge_spread.aperture_ratio.unwrap();
    assert_eq!(stated, Estimate::exact(RATIO));
    let document = json(&out.join("camera.json"));
    let spread = document["depth_from_blur"]["spread_per_radius"].as_f64().unwrap();
    assert!((spread - value / 2.0).abs() < 1e-12, "{spread}");
    let calibration = json(&out.join("calibration.json"));
    assert_eq!(calibration["blur"]["lens_types"].as_array().unwrap().len(), 3);
    assert_eq!(calibration["warnings"], Value::Array(Vec::new()));
}

/// The aperture ratio that corners are fitted with is that of the first frames, however many are searched at once.
#[test]
fn features_do_not_depend_on_the_number_of_threads() {
    let features = |threads: &str| {
        let out = FILES.path(&format!("threads-{threads}"));
        let mut detect = plenocal();
        detect.env("RAYON_NUM_THREADS", threads).arg("detect").arg(FILES.path("set/project.toml"));
        detect.arg("--precalibration").arg(FILES.path("found")).arg("--no-pictures");
        detect.arg("--out").arg(&out).assert().success();
        fs::read(out.join("features.csv")).unwrap()
    };
    assert!(features("1") == features("3"));
}

/// White images alone cannot tell how the array is tilted: they show how φq'ᵢ grows.
#[test]
fn the_tilt_gradient_goes_with_the_aperture_ratio() {
    let path = FILES.path("found/precalibration.json");
    let shown = read_internal_parameters(&path, None).unwrap();
    let truth = read_camera(&FILES.path("set/truth/camera.json")).unwrap();
    let pixel_mm = truth.sensor.pixel_size_mm;
    let tilt_gradient = optics::tilt_gradient_per_mm(&truth) * pixel_mm;
    let ratio = Estimate::exact(RATIO);
    let pitch_mm = shown.micro_image_pitch_mm.unwrap();
    let [shown, known] = [shown.clone(), shown.with_aperture_ratio(ratio, pitch_mm)]
        .map(|internal| internal.tilt_gradient.unwrap());
    for axis in 0..2 {
        let [shown, known] =
            [shown, known].map(|found| found.growth_per_px[axis] / tilt_gradient[axis]);
        let std_dev = known * (known / shown) * 0.03;
        assert!((shown - RATIO).abs() < 0.05, "{shown}");
        assert!((known - 1.0).abs() < SIGMAS * std_dev.abs(), "{known}");
        assert!((known - 1.0).abs() < (shown - 1.0).abs(), "{shown} {known}");
    }
}

/// Features by others do not state how wide their edges are.
#[test]
fn without_widths_of_edges_the_aperture_ratio_is_not_questioned() {
    let text = fs::read_to_string(FILES.path("found/features.csv")).unwrap();
    let keep =
        |line: &str| -> String { line.split(',').take(10).collect::<Vec<_>>().join(",") + "\n" };
    let (features, out) = (FILES.path("plain.csv"), FILES.path("plain"));
    fs::write(&features, text.lines().map(keep).collect::<String>()).unwrap();
    assert!(
        fs::read_to_string(&features)
            .unwrap()
            .starts_with("k,l,u,v,rho,cluster,frame,std_u,std_v,std_rho\n")
    );
    FILES.calibrate(&features, &out).code(4).stdout(contains(
        "Aperture ratio of the micro-lenses: 1, assumed, because the features have no measured blur",
    ));
    let (error, std_dev) = error(&out, "f_1");
    assert!(error < -0.05 && error < -10.0 * std_dev, "{error} ± {std_dev}");
    let document = json(&out.join("camera.json"));
    assert_eq!(document["depth_from_blur"], Value::Null);
    assert_eq!(document["micro_lens_array"]["aperture_ratio"], Value::Null);
    assert_eq!(json(&out.join("calibration.json"))["blur"], Value::Null);
}

/// The truth of the simulation states the true q'ᵢ and ρ, and the aperture ratio that they go with.
#[test]
fn a_stated_aperture_ratio_is_kept() {
    let out = FILES.path("stated");
    let mut command = plenocal();
    command.arg("calibrate").arg(FILES.path("set/observed/project.toml"));
    command.args(["--blur", "features", "--tables", "--out"]).arg(&out);
    command
        .assert()
        .success()
        .stdout(contains("Aperture ratio of the micro-lenses: 0.920000, assumed."));
    for name in ["f_1", "f_2", "f_3"] {
        let (error, std_dev) = error(&out, name);
        assert!(error.abs() < SIGMAS * std_dev && error.abs() < RIGHT, "{name}: {error}");
    }
}

/// Earlier files have the aperture ratio as fill factor, and the point spread as `point_spread`.
#[test]
fn earlier_names_are_read() {
    let out = FILES.path("earlier");
    fs::create_dir(&out).unwrap();
    let earlier = |name: &str, names: &[(&str, &str)]| {
        let mut text = fs::read_to_string(FILES.path("found").join(name)).unwrap();
        for (name, earlier) in names {
            assert!(text.contains(name), "{name}");
            text = text.replace(name, earlier);
        }
        let path = out.join(name);
        fs::write(&path, text).unwrap();
        path
    };
    let ratio = ("aperture_ratio", "fill_factor");
    let features = earlier("features.csv", &[ratio]);
    let read = |path: &Path| read_features(path, true).unwrap().features;
    assert!(read(&features)[0].blur.is_some() && read(&features)[0].sensitivities_px.is_some());
    assert_eq!(read(&features), read(&FILES.path("found/features.csv")));

    let spread = ("\"point_spread_px2\"", "\"point_spread\"");
    let document = earlier("precalibration.json", &[ratio, spread]);
    let read = |path: &Path| read_internal_parameters(path, None).unwrap();
    assert!(read(&document).point_spread_px2.is_some());
    assert_eq!(read(&document), read(&FILES.path("found/precalibration.json")));
}

#[test]
fn columns_of_blur_go_together() {
    let text = fs::read_to_string(FILES.path("found/features.csv")).unwrap();
    let features = FILES.path("broken.csv");
    for (from, to, words) in [
        ("shared_blur,aperture_ratio", "shared_blur,other", "needed together"),
        (
            "blur,std_blur,shared_blur,aperture_ratio",
            "aperture_ratio,std_blur,shared_blur,blur",
            "an aperture ratio of",
        ),
    ] {
        assert!(text.contains(from));
        fs::write(&features, text.replacen(from, to, 1)).unwrap();
        FILES.calibrate(&features, &FILES.path("broken")).code(1).stderr(contains(words));
    }
}

#[test]
#[ignore = "slow: simulates large images; run by `make test-slow`"]
fn a_frame_that_moved_is_named() {
    let (moving, out) = (FILES.path("moving"), FILES.path("with-one-moving"));
    // At eight moments.
    simulate(8, 6, &moving);
    for i in (0..10).filter(|i| *i != 3) {
        let image = format!("calibration/calibration-{i:02}.png");
        fs::copy(FILES.path("set").join(&image), moving.join(&image)).unwrap();
    }
    let mut detect = plenocal();
    detect.arg("detect").arg(moving.join("project.toml")).arg("--out").arg(&out);
    let one =
        contains("frame 3 (calibration-03.png): its edges are wider than in the other frames");
    detect.assert().success().stderr(one.and(contains("are wider than").count(1)));
}
