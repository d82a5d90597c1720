//! Features from simulated images.

use std::collections::BTreeSet;
use std::path::Path;

use plenocal::detection::DepthEstimator;
use plenocal::evaluation::DetectionScore;
use plenocal::io::read_features;
use plenocal::model::BapFeature;
use predicates::prelude::PredicateBooleanExt;
use predicates::str::contains;

use crate::support::{plenocal, preset};

/// What detected features are held to: parts of what is to be found, of what is reported, and root mean
/// square errors, px.
const FOUND: f64 = 0.90;
const TRUE: f64 = 0.995;
const SMALL_BLUR_PX: f64 = 0.10;
const ANY_BLUR_PX: f64 = 0.20;
/// Of ρ, without noise and with one of 4 grey levels.
const RHO_PX: f64 = 0.04;
const NOISY_RHO_PX: f64 = 0.12;
/// Of 1/ν, relative. Half a per cent is held without noise; a noise of 4 grey levels adds to it.
const DEPTH: f64 = 0.008;

#[test]
fn simulated_corners_are_found_where_they_are() {
    let square: &[&str] = &[
        "rays=32",
        "camera.micro_lens_array.lattice=orthogonal",
        "camera.micro_lens_array.rows=32",
        "camera.micro_lens_array.focal_lengths_mm=[0.552]",
    ];
    // The sensor goes on beyond the array.
    let small: &[&str] = &[
        "rays=32",
        "camera.micro_lens_array.columns=35",
        "camera.micro_lens_array.rows=31",
        "seed=5",
    ];
    let sets: [(&str, &[&str], usize); 10] = [
        ("mini", &["rays=32"], 6),
        ("mini", &["rays=32", "imaging.bits=16"], 2),
        ("mini", &["rays=32", "imaging.read_noise_electrons=204"], 4),
        ("mini", &["rays=32", "boards.max_tilt_deg=45", "seed=2"], 4),
        ("mini", &["rays=32", "boards.min_in_view=0.65", "seed=3"], 4),
        ("mini", &["rays=32", "imaging.color=bayer-rggb"], 2),
        ("mini", square, 2),
        ("mini", small, 4),
        ("keplerian", &["rays=32", "boards.depth_mm=[200.0, 400.0]", "seed=4"], 3),
        ("r12-a", &["rays=32"], 1),
    ];
    for (name, replaced, frames) in sets {
        let settings = preset(name, replaced);
        let score = DetectionScore::of_simulation(&settings, frames, DepthEstimator::Line).unwrap();
        println!(
            "{name} {replaced:?}: {} of {frames} frames, {:.1} % found, {:.2} % true, {:.3} px, {:.3} \
             px, rho {:.3} px, depth {:.2} %",
            score.tied,
            100.0 * score.recall(),
            100.0 * score.precision(),
            score.small_rms_px(),
            score.rms_px(),
            score.rho_rms_px(),
            100.0 * score.depth_rms()
        );
        // Of a board that is cut by the border one cannot always tell which part shows.
        let is_cut = |r: &&str| r.contains("min_in_view") || r.contains("columns=35");
        let cut = replaced.iter().any(is_cut);
        assert!(score.tied >= if cut { frames / 2 } else { frames }, "{name} {replaced:?}");
        assert!(score.recall() > FOUND && score.precision() > TRUE, "{name} {replaced:?}");
        assert!(score.small_rms_px() < SMALL_BLUR_PX, "{name} {replaced:?}");
        assert!(score.rms_px() < ANY_BLUR_PX, "{name} {replaced:?}");
        let noisy = replaced.iter().any(|r| r.contains("noise"));
        let rho = if noisy { NOISY_RHO_PX } else { RHO_PX };
        assert!(score.rho_rms_px() < rho, "{name} {replaced:?}");
        assert!(score.depth_rms() < DEPTH, "{name} {replaced:?}");
    }
    // The other estimator gives other radii, as good.
    let settings = preset("mini", &["rays=32"]);
    let of = |estimator| DetectionScore::of_simulation(&settings, 1, estimator).unwrap();
    let (line, median) = (of(DepthEstimator::Line), of(DepthEstimator::Median));
    assert!((line.rms_px() - median.rms_px()).abs() < 1e-9);
    assert!((line.rho_rms_px() - median.rho_rms_px()).abs() > 1e-6);
    assert!(median.rho_rms_px() < RHO_PX);
}

/// Images to camera: the simulated one within 0.2 % in F and D, 0.4 % in d and fᵢ.
#[test]
fn detected_features_calibrate_the_simulated_camera() {
    let folder = tempfile::TempDir::new().unwrap();
    let (set, out) = (folder.path().join("set"), folder.path().join("out"));
    let run = |arguments: &[&std::ffi::OsStr]| plenocal().args(arguments).assert();
    let text = |name: &str| std::ffi::OsString::from(name);
    let project = set.join("project.toml");
    run(&[&text("simulate"), &text("--set"), &text("rays=32"), &text("--out"), set.as_os_str()])
        .success();
    run(&[&text("detect"), project.as_os_str(), &text("--out"), out.as_os_str()])
        .success()
        .stdout(contains("10 of 10 frames").and(contains("frame-09.svg")));
    run(&[
        &text("calibrate"),
        project.as_os_str(),
        &text("--params"),
        out.join("precalibration.json").as_os_str(),
        &text("--centers"),
        out.join("centers.csv").as_os_str(),
        &text("--features"),
        out.join("features.csv").as_os_str(),
        &text("--out"),
        out.join("camera").as_os_str(),
    ])
    .success();
    let camera = |path: &Path| plenocal::io::read_camera(path).unwrap();
    let truth = camera(&set.join("truth/camera.json"));
    let found = camera(&out.join("camera/camera.json"));
    let off = |a: f64, b: f64| (a / b - 1.0).abs();
    let (lens, mla) = (&found.main_lens, &found.mla);
    assert!(off(lens.focal_length_mm, truth.main_lens.focal_length_mm) < 0.002);
    assert!(off(mla.lens_to_mla_mm, truth.mla.lens_to_mla_mm) < 0.002);
    assert!(off(mla.mla_to_sensor_mm, truth.mla.mla_to_sensor_mm) < 0.004);
    for (a, b) in mla.focal_lengths_mm.iter().zip(&truth.mla.focal_lengths_mm) {
        assert!(off(*a, *b) < 0.004, "{a} for {b}");
    }

    // What was measured before serves as well, and gives the same.
    let again = folder.path().join("again");
    run(&[
        &text("detect"),
        project.as_os_str(),
        &text("--precalibration"),
        out.as_os_str(),
        &text("--no-pictures"),
        &text("--out"),
        again.as_os_str(),
    ])
    .success();
    let features =
        |folder: &Path| read_features(&folder.join("features.csv"), true).unwrap().features;
    assert_eq!(features(&out).len(), features(&again).len());

    // A frame without a board, one that is not there, another size of board, another aperture.
    let written = std::fs::read_to_string(&project).unwrap();
    let changed = |from: &str, to: &str| {
        assert!(written.contains(from), "{from}");
        let path = set.join("changed.toml");
        std::fs::write(&path, written.replace(from, to)).unwrap();
        let other = folder.path().join("other");
        plenocal().arg("detect").arg(&path).arg("--no-pictures").arg("--out").arg(&other).assert()
    };
    changed("calibration/calibration-03.png", "whites/white-0-n-4.00.png")
        .success()
        .stderr(contains("frame 3 (white-0-n-4.00.png) is left out: there is no board in it"))
        .stdout(contains("9 of 10 frames"));
    changed("calibration/calibration-04.png", "calibration/none.png")
        .success()
        .stderr(contains("frame 4 (none.png) is left out: cannot read"));
    changed("columns = 8\nrows = 5", "columns = 7\nrows = 4")
        .code(1)
        .stderr(contains("beyond the board of 7 x 4 inner corners"));
    changed("\"devignetting.png\"", "\"whites/white-4-n-16.00.png\"")
        .code(1)
        .stderr(contains("taken with another aperture").and(contains("no frame shows the board")));
    // A frame of which much is saturated, and a hand before the board.
    let repainted = |name: &str, paint: &dyn Fn(u32, u32, u8) -> u8| {
        let from = set.join("calibration/calibration-05.png");
        let mut picture = image::open(from).unwrap().into_luma8();
        for (u, v, pixel) in picture.enumerate_pixels_mut() {
            pixel.0[0] = paint(u, v, pixel.0[0]);
        }
        picture.save(set.join("calibration").join(name)).unwrap();
    };
    repainted("bright.png", &|_, _, grey| grey.saturating_mul(4));
    changed("calibration/calibration-05.png", "calibration/bright.png")
        .success()
        .stderr(contains("frame 5 (bright.png) is left out").and(contains("over-exposed")));
    repainted("hidden.png", &|u, v, grey| {
        if (400..600).contains(&u) && v > 300 { grey.min(20) } else { grey }
    });
    changed("calibration/calibration-05.png", "calibration/hidden.png")
        .success()
        .stdout(contains("10 of 10 frames"));
    let hidden = features(&folder.path().join("other"));
    let all = features(&out);
    let of_frame = |f: &&BapFeature| f.frame == 5;
    let key = |f: &BapFeature| (f.corner, f.k, f.l);
    let known: BTreeSet<_> = all.iter().filter(of_frame).map(key).collect();
    let kept: BTreeSet<_> = hidden.iter().filter(of_frame).map(key).collect();
    let strange = kept.difference(&known).count();
    println!("{} of {} features are left, {strange} new", kept.len(), known.len());
    assert!(kept.len() * 2 > known.len() && kept.len() < known.len());
    assert!(strange * 50 <= kept.len(), "{strange} features that the whole board has not");
    changed("[board]", "[bord]").code(1).stderr(contains("bord"));
}

/// Options of detection, what is held against the project, and what is told of frames that fail.
#[test]
fn detection_does_what_it_is_told_or_says_why_not() {
    let folder = tempfile::TempDir::new().unwrap();
    let (set, out) = (folder.path().join("set"), folder.path().join("out"));
    let project = set.join("project.toml");
    plenocal().args(["simulate", "--set", "rays=16", "--out"]).arg(&set).assert().success();
    plenocal().arg("precalibrate").arg(&project).arg("--out").arg(&out).assert().success();
    let detect = |project: &Path, measured: &Path, to: &str, options: &[&str]| {
        let mut command = plenocal();
        command.arg("detect").arg(project).arg("--precalibration").arg(measured).arg("--out");
        command.arg(folder.path().join(to)).arg("--no-pictures").args(options).assert()
    };
    let features = |of: &str| {
        let path = folder.path().join(of).join("features.csv");
        read_features(&path, true).unwrap().features
    };

    let json = detect(&project, &out, "line", &["--json", "--subset", "evaluation"]).success();
    let told: serde_json::Value = serde_json::from_slice(&json.get_output().stdout).unwrap();
    assert_eq!(told["format"], "plenocal-detection");
    let frames = told["frames"].as_array().unwrap();
    assert_eq!(frames.len(), 3);
    assert!(frames[0]["image"].as_str().unwrap().ends_with("evaluation-00.png"));
    for field in ["alone", "off_line", "texture", "off_board", "unclear", "misplaced", "given_up"] {
        assert!(frames[0]["dropped"][field].is_u64(), "{field}");
    }
    let line = features("line");
    let count: u64 = frames.iter().map(|frame| frame["features"].as_u64().unwrap()).sum();
    assert_eq!(count, line.len() as u64);
    detect(&project, &out, "median", &["--subset", "evaluation", "--estimator", "median"])
        .success()
        .stdout(contains("3 of 3 frames"));
    let median = features("median");
    assert_eq!(line.len(), median.len());
    let pairs = || line.iter().zip(&median);
    assert!(
        pairs().all(|(a, b)| (a.u_px - b.u_px).abs() < 1e-9 && (a.rho_px - b.rho_px).abs() < 0.5)
    );
    assert!(pairs().any(|(a, b)| (a.rho_px - b.rho_px).abs() > 1e-6));

    // A project with something replaced in it.
    let written = std::fs::read_to_string(&project).unwrap();
    let changed = |pairs: &[(&str, &str)]| {
        let replace = |text: String, (from, to): &(&str, &str)| {
            assert!(text.contains(from), "{from}");
            text.replace(from, to)
        };
        let path = set.join("changed.toml");
        std::fs::write(&path, pairs.iter().fold(written.clone(), replace)).unwrap();
        path
    };
    let other = |pairs: &[(&str, &str)]| {
        detect(&changed(pairs), &out, "other", &["--subset", "evaluation"])
    };
    other(&[("columns = 8\nrows = 5", "columns = 2\nrows = 2")])
        .code(1)
        .stderr(contains("2 x 2 inner corners").and(contains("6 to 2500")));
    other(&[("columns = 43\nrows = 37", "columns = 39\nrows = 33")])
        .code(1)
        .stderr(contains("outside the array of 39 x 33"));
    // Stops are engraved in round numbers.
    let no_reference = ("devignetting = \"devignetting.png\"\n", "");
    other(&[no_reference, ("f_number = 4\nfocus", "f_number = 4.1\nfocus")]).success();
    other(&[no_reference, ("f_number = 4\nfocus", "f_number = 5\nfocus")]).code(1).stderr(
        contains("at f/5.00").and(contains("the nearest is white-1-n-5.66.png, at f/5.66")),
    );
    // What another camera's folder states.
    let file = out.join("precalibration.json");
    let stated = std::fs::read_to_string(&file).unwrap();
    let replaced = |edit: &dyn Fn(&mut serde_json::Value)| {
        let mut value: serde_json::Value = serde_json::from_str(&stated).unwrap();
        edit(&mut value["internal_parameters"]);
        std::fs::write(&file, value.to_string()).unwrap();
        detect(&project, &out, "other", &[])
    };
    let place = out.display().to_string();
    replaced(&|internal| internal["q_prime_mm"] = serde_json::json!([0.05]))
        .code(1)
        .stderr(contains("I = 3 lens types").and(contains(&place)));
    replaced(&|internal| internal["m_mm"] = serde_json::json!(-0.4))
        .code(1)
        .stderr(contains("|m|").and(contains(&place)));
    replaced(&|internal| internal["micro_image_pitch_mm"] = serde_json::json!(0.2))
        .code(1)
        .stderr(contains("different cameras").and(contains(&place)));
    std::fs::write(&file, &stated).unwrap();

    // Where all frames fail the counts come with the reasons, and nothing is written.
    let smaller = changed(&[("columns = 8\nrows = 5", "columns = 7\nrows = 4")]);
    detect(&smaller, &out, "failed", &["--subset", "evaluation"])
        .code(1)
        .stderr(contains("frame 2 (evaluation-02.png) is left out"))
        .stderr(contains("Micro-images").and(contains("0 features in 0 of 3 frames")));
    assert!(!folder.path().join("failed").exists());
    // A white image that is clipped is not an over-exposed frame.
    let mut white = image::open(set.join("devignetting.png")).unwrap().into_luma8();
    for pixel in white.pixels_mut() {
        pixel.0[0] = pixel.0[0].saturating_mul(8);
    }
    white.save(set.join("clipped.png")).unwrap();
    other(&[("\"devignetting.png\"", "\"clipped.png\"")])
        .code(1)
        .stderr(contains("saturated in the white image").and(contains("shorter exposure")));
}
