//! Bad input gives a message that names it, exit status 1, and no output.

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};

use plenocal::calibration::CalibrationOptions;
use plenocal::model::{FramePose, Noise};
use plenocal::solver::synthesize;
use predicates::prelude::*;
use tempfile::TempDir;

use crate::support::{
    board, codes, datasheet_start, options, plenocal, run, synthetic_folder, true_camera,
};

/// A copy of the shipped feature set that a test may spoil.
struct Spoiled {
    folder: TempDir,
}

impl Spoiled {
    fn new() -> Self {
        let folder = TempDir::new().unwrap();
        for file in ["project.toml", "centers.csv", "features.csv"] {
            fs::copy(synthetic_folder().join(file), folder.path().join(file)).unwrap();
        }
        Self { folder }
    }

    fn path(&self, file: &str) -> PathBuf {
        self.folder.path().join(file)
    }

    fn edit(self, file: &str, edit: impl FnOnce(String) -> String) -> Self {
        let text = fs::read_to_string(self.path(file)).unwrap();
        let edited = edit(text.clone());
        assert_ne!(text, edited, "the edit changes the file");
        fs::write(self.path(file), edited).unwrap();
        self
    }

    fn replace(self, file: &str, from: &str, to: &str) -> Self {
        self.edit(file, |text| text.replacen(from, to, 1))
    }

    fn append(self, file: &str, line: &str) -> Self {
        self.edit(file, |text| text + line + "\n")
    }

    /// Runs the program; its message has to contain all of `words`.
    fn is_rejected(&self, words: &[&str]) {
        self.is_rejected_with(&[], words);
    }

    fn is_rejected_with(&self, arguments: &[&str], words: &[&str]) {
        let out = self.path("out");
        let mut assert = plenocal()
            .arg("calibrate")
            .arg(self.path("project.toml"))
            .arg("--out")
            .arg(&out)
            .args(arguments)
            .assert()
            .code(1)
            .stdout(predicate::str::is_empty())
            .stderr(predicate::str::starts_with("error: "));
        for word in words {
            assert = assert.stderr(predicate::str::contains(*word));
        }
        assert!(!out.exists(), "nothing is written");
    }
}

#[test]
fn missing_files_are_rejected() {
    let spoiled = Spoiled::new();
    spoiled.is_rejected_with(&["--centers", "nowhere.csv"], &["nowhere.csv"]);
    fs::remove_file(spoiled.path("features.csv")).unwrap();
    spoiled.is_rejected(&["features.csv", "cannot read"]);
}

#[test]
fn empty_files_and_binary_files_are_rejected() {
    let spoiled = Spoiled::new();
    fs::write(spoiled.path("features.csv"), [0xff, 0xfe, 0x00, 0x80]).unwrap();
    spoiled.is_rejected(&["features.csv"]);
    fs::write(spoiled.path("features.csv"), "").unwrap();
    spoiled.is_rejected(&["features.csv", "column"]);
    fs::write(spoiled.path("project.toml"), "").unwrap();
    spoiled.is_rejected(&["project.toml", "empty"]);
}

#[test]
fn truncated_csv_files_are_rejected() {
    let half = |text: String| {
        let end = text.len() / 2;
        let line_start = text[..end].rfind('\n').unwrap() + 1;
        text[..line_start + 4].to_owned()
    };
    Spoiled::new().edit("features.csv", half).is_rejected(&["features.csv", "line"]);
    Spoiled::new().edit("centers.csv", half).is_rejected(&["centers.csv", "line"]);
    let header_only = |text: String| text.lines().next().unwrap().to_owned() + "\n";
    Spoiled::new()
        .edit("centers.csv", header_only)
        .is_rejected(&["centers.csv", "no observations"]);
}

#[test]
fn damaged_gzip_files_are_rejected() {
    let gzip = |bytes: &[u8]| {
        use flate2::{Compression, write::GzEncoder};
        use std::io::Write;
        let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
        encoder.write_all(bytes).unwrap();
        encoder.finish().unwrap()
    };
    let spoiled = Spoiled::new();
    let file = spoiled.path("linked.bin.gz");
    let features = ["--features", file.to_str().unwrap()];
    let mut whole = gzip(&[7; 4096]);
    fs::write(&file, &whole).unwrap();
    spoiled.is_rejected_with(&features, &["linked.bin.gz", "centres"]);
    let end = whole.len();
    whole[end - 6] ^= 0xff;
    fs::write(&file, &whole).unwrap();
    spoiled.is_rejected_with(&features, &["linked.bin.gz", "damaged"]);
    let mut two = gzip(&[0; 24]);
    two.extend(gzip(&[0; 24]));
    fs::write(&file, &two).unwrap();
    spoiled.is_rejected_with(&features, &["linked.bin.gz", "24 bytes follow"]);
    fs::write(&file, &gzip(&[0; 4096])[..20]).unwrap();
    spoiled.is_rejected_with(&features, &["linked.bin.gz", "damaged or cut short"]);
    // The header announces one centre, but there are bytes for half of it only.
    let mut short = vec![1, 0, 0, 0, 0, 0, 0, 0];
    short.extend([0; 12]);
    fs::write(&file, gzip(&short)).unwrap();
    spoiled.is_rejected_with(&features, &["linked.bin.gz", "centres"]);
}

#[test]
fn wrong_columns_are_rejected() {
    Spoiled::new()
        .replace("features.csv", "rho", "radius")
        .is_rejected_with(&["--blur", "features"], &["features.csv", "'rho'", "column"]);
    Spoiled::new()
        .replace("centers.csv", "k,l,u,v", "a,b,c,d")
        .is_rejected(&["centers.csv", "'k', 'l'"]);
    Spoiled::new()
        .replace("centers.csv", "k,l,u,v", "u,k,l,u,v")
        .is_rejected(&["centers.csv", "u twice"]);
}

#[test]
fn values_that_are_not_numbers_are_rejected() {
    for (value, word) in
        [("NaN", "a finite number"), ("inf", "a finite number"), ("x", "not a number")]
    {
        let line = format!("5,5,{value},100.0,0.1,3,0");
        Spoiled::new().append("features.csv", &line).is_rejected(&["features.csv", "line", word]);
        let line = format!("5,5,100.0,{value}");
        Spoiled::new().append("centers.csv", &line).is_rejected(&["centers.csv", "line", word]);
    }
    Spoiled::new().append("features.csv", "5.5,5,100.0,100.0,0.1,3,0").is_rejected(&[
        "features.csv",
        "k",
        "'5.5'",
    ]);
}

#[test]
fn indices_out_of_range_are_rejected() {
    Spoiled::new()
        .append("features.csv", "43,5,100.0,100.0,0.1,3,0")
        .is_rejected(&["(43, 5)", "43 x 37"]);
    Spoiled::new().append("centers.csv", "-1,5,100.0,100.0").is_rejected(&["(-1, 5)"]);
    Spoiled::new()
        .append("features.csv", "5,5,100.0,100.0,0.1,45,0")
        .is_rejected(&["corner 45", "9 x 5"]);
    Spoiled::new()
        .append("features.csv", "5,5,100.0,100.0,0.1,3,-2")
        .is_rejected(&["frame", "'-2'"]);
    Spoiled::new().append("centers.csv", "0,0,1e300,100.0").is_rejected(&["outside the image"]);
}

#[test]
fn duplicate_observations_are_rejected() {
    let repeat_last = |text: String| {
        let last = text.lines().last().unwrap().to_owned();
        text + &last + "\n"
    };
    Spoiled::new().edit("features.csv", repeat_last).is_rejected(&["given twice", "frame 7"]);
    Spoiled::new().edit("centers.csv", repeat_last).is_rejected(&["given twice", "centre"]);
}

/// The remedy in the message works.
#[test]
fn a_frame_with_three_corners_is_rejected_until_it_is_excluded() {
    let mut lines = String::new();
    for (corner, l) in [(0, 10), (1, 11), (9, 12)] {
        let _ = writeln!(lines, "20,{l},480.0,{}.0,0.1,{corner},77", 20 * l);
    }
    let spoiled = Spoiled::new().edit("features.csv", |text| text + &lines);
    spoiled.is_rejected(&["board corners, but frame 77 shows 3", "--exclude 77"]);
    plenocal()
        .arg("calibrate")
        .arg(spoiled.path("project.toml"))
        .args(["--exclude", "77", "--out"])
        .arg(spoiled.path("out"))
        .assert()
        .success();
}

#[test]
fn missing_centres_are_rejected() {
    let spoiled = Spoiled::new().replace("project.toml", "centers = \"centers.csv\"\n", "");
    spoiled.is_rejected(&["no micro-image centres", "--centers"]);
}

#[test]
fn frames_are_excluded_by_ranges() {
    let spoiled = Spoiled::new();
    spoiled.is_rejected_with(&["--exclude", "0-3,99"], &["frame 99"]);
    let mut command = plenocal();
    command.arg("calibrate").arg(spoiled.path("project.toml")).args(["--exclude", "7-x", "--out"]);
    let words =
        predicate::str::contains("not a list of frames").and(predicate::str::contains("0-4,7"));
    command.arg(spoiled.path("out")).assert().failure().stderr(words);
}

#[test]
fn excluding_an_unknown_frame_is_rejected() {
    Spoiled::new().is_rejected_with(&["--exclude", "99"], &["frame 99"]);
}

#[test]
fn projects_with_an_impossible_camera_are_rejected() {
    for (from, to, words) in [
        ("lens_types = 3", "lens_types = 1", &["I = 1", "q'"][..]),
        ("lens_types = 3", "lens_types = 2", &["2 lens types"]),
        ("q_prime_mm = [0.0361, 0.0414, 0.0377]", "q_prime_mm = [0.0352]", &["I = 3", "1 values"]),
        ("pixel_size_mm = 0.0055", "pixel_size_mm = -0.0055", &["pixel size", "-0.0055"]),
        ("width_px = 1000", "width_px = 0", &["0 x 750"]),
        ("columns = 43", "columns = 0", &["0 x 37"]),
        ("square_mm = 3.0", "square_mm = 0.0", &["squares", "0"]),
        ("rows = 5", "rows = -5", &["9 x -5"]),
        ("m_mm = 0.1432", "m_mm = -0.1432", &["|m|", "-0.1432"]),
        ("focal_length_mm = 16.0", "focal_length_mm = 0.0", &["focal length", "0"]),
        ("focus_distance_mm = 120.0", "focus_distance_mm = 50.0", &["focus distance", "4 F"]),
        ("\"hexagonal-rows\"    #", "\"hexagonal-columns\" #", &["'hexagonal-rows'"]),
        ("lattice = ", "grid = ", &["project.toml", "grid"]),
        ("[board]", "[chessboard]", &["project.toml", "chessboard"]),
    ] {
        Spoiled::new().replace("project.toml", from, to).is_rejected(words);
    }
}

#[test]
fn projects_with_an_absurd_camera_are_rejected() {
    for (from, to, words) in [
        ("lens_types = 3", "lens_types = 2000000000", &["2000000000 lens types"][..]),
        ("columns = 43", "columns = 2000000000", &["2000000000 x 37"]),
        ("columns = 9 ", "columns = 2000000000 ", &["2000000000 x 5"]),
        ("pixel_size_mm = 0.0055", "pixel_size_mm = 5.5", &["pixel_size_mm", "5.5 mm"]),
        ("focal_length_mm = 16.0", "focal_length_mm = 1.6", &["focal_length_mm", "65 degrees"]),
        ("square_mm = 3.0", "square_mm = 0.3", &["nearer to the main lens", "square_mm"]),
        ("lens_types = 3", "lens_types = 3\nmicro_image_pitch_px = 24.0", &["24.0000 px", "23.3"]),
        ("q_prime_mm = [", "micro_image_pitch_mm = 0.1\nq_prime_mm = [", &["18.1818 px", "23.3"]),
    ] {
        Spoiled::new().replace("project.toml", from, to).is_rejected(words);
    }
}

#[test]
fn damaged_camera_files_are_rejected() {
    let spoiled = Spoiled::new();
    let truth = fs::read_to_string(synthetic_folder().join("truth/camera.json")).unwrap();
    let camera = spoiled.path("camera.json");
    for (from, to, words) in [
        ("\"focal_length_mm\": 16.2", "\"focal_length_mm\": -16.2", &["F (mm)", "-16.2"][..]),
        ("\"pitch_mm\": 0.126", "\"pitch_mm\": 0.0", &["dC (mm)"]),
        ("\"version\": 1", "\"version\": 7", &["version 7"]),
        ("\"f_number\": 2.8", "\"f_number\": 0.0", &["f-number"]),
        ("\"shifted\": \"even\"", "\"shifted\": \"both\"", &["camera.json", "both"]),
        ("\"shifted\": \"even\"", "\"shifted\": \"odd\"", &["different cameras"]),
        ("\"sensor\"", "\"censor\"", &["camera.json", "sensor"]),
    ] {
        assert!(truth.contains(from), "{from}");
        fs::write(&camera, truth.replacen(from, to, 1)).unwrap();
        spoiled.is_rejected_with(&["--camera", camera.to_str().unwrap()], words);
    }
}

#[test]
fn a_feature_outside_its_micro_image_is_rejected() {
    Spoiled::new().append("features.csv", "5,5,900.0,700.0,0.1,3,0").is_rejected(&[
        "features.csv",
        "corner 3",
        "frame 0",
        "(5, 5)",
        "0 more",
    ]);
}

#[test]
fn centres_with_offset_row_indices_are_rejected() {
    let shifted = |text: String| {
        let mut lines = text.lines();
        let mut edited = lines.next().unwrap().to_owned() + "\n";
        for line in lines {
            let fields: Vec<&str> = line.split(',').collect();
            let l: i32 = fields[1].parse().unwrap();
            if l < 35 {
                let _ = writeln!(edited, "{},{},{},{}", fields[0], l + 2, fields[2], fields[3]);
            }
        }
        edited
    };
    Spoiled::new().edit("centers.csv", shifted).is_rejected(&["indices and positions"]);
}

#[test]
fn centres_of_a_single_row_are_rejected() {
    let one_row = |text: String| {
        let kept = |line: &&str| line.starts_with('k') || line.split(',').nth(1) == Some("5");
        text.lines().filter(kept).collect::<Vec<_>>().join("\n")
    };
    Spoiled::new().edit("centers.csv", one_row).is_rejected(&["one row"]);
}

#[test]
fn a_diverging_refinement_is_an_error() {
    Spoiled::new()
        .replace("project.toml", "square_mm = 3.0", "square_mm = 300.0")
        .is_rejected_with(
            &["--priors", "none", "--blur", "features", "--fix", "D,Q1_m,e_r"],
            &["fit"],
        );
}

#[test]
fn impossible_options_are_rejected() {
    let spoiled = Spoiled::new();
    spoiled.is_rejected_with(
        &["--set", "calibration.fix=[\"focal\"]"],
        &["no parameter 'focal'", "theta_x"],
    );
    spoiled.is_rejected_with(&["--set", "board.edge=3"], &["with board.edge=3", "square_mm"]);
    spoiled.is_rejected_with(&["--uv-std-dev", "0"], &["(u, v)", "0"]);
    spoiled.is_rejected_with(&["--loss", "huber", "--loss-scale=-1"], &["loss", "-1"]);
    spoiled.is_rejected_with(&["--loss-scale", "2"], &["without a loss", "huber"]);
    spoiled.is_rejected_with(&["--rho-std-dev", "0.05"], &["rho is not used", "features"]);
    spoiled.is_rejected_with(&["--uv-std-dev", "-1"], &["(u, v)", "-1"]);
    spoiled.is_rejected_with(&["--mode", "poses-only"], &["--camera"]);
    spoiled.is_rejected_with(&["--threads", "0"], &["threads"]);
}

#[test]
fn damaged_internal_parameters_are_rejected() {
    let spoiled = Spoiled::new();
    let params = spoiled.path("params.js");
    fs::write(&params, r#"{"m": "-0.14", "q_prime": ["0.035", "0.040"], "I": "3"}"#).unwrap();
    spoiled.is_rejected_with(&["--params", params.to_str().unwrap()], &["params.js", "I is 3"]);
    fs::write(&params, r#"{"m": 0.14, "q_prime": [0.035, 0.04, 0.037], "scale": "0.003"}"#)
        .unwrap();
    spoiled.is_rejected_with(&["--params", params.to_str().unwrap()], &["params.js", "0.003"]);
    fs::write(&params, "{").unwrap();
    spoiled.is_rejected_with(&["--params", params.to_str().unwrap()], &["params.js", "JSON"]);
}

/// Calibrates into a folder that cannot be written.
fn assert_cannot_write(spoiled: &Spoiled, out: &Path, words: &str) {
    let mut command = plenocal();
    command.arg("calibrate").arg(spoiled.path("project.toml")).arg("--out").arg(out);
    command.assert().code(1).stderr(predicate::str::contains(words));
}

#[test]
fn an_output_folder_that_is_a_file_is_an_error() {
    let spoiled = Spoiled::new();
    let out = spoiled.path("centers.csv");
    assert_cannot_write(&spoiled, &out, "centers.csv");
    assert!(out.is_file());
}

/// A folder has the name of a result: the other results are not written either.
#[test]
fn a_result_whose_name_is_taken_by_a_folder_is_an_error() {
    let spoiled = Spoiled::new();
    let out = spoiled.path("results");
    fs::create_dir_all(out.join("solver.txt")).unwrap();
    assert_cannot_write(&spoiled, &out, "solver.txt");
    assert_eq!(fs::read_dir(&out).unwrap().count(), 1);
}

#[cfg(target_os = "linux")]
#[test]
fn an_output_folder_that_not_even_root_can_write_is_an_error() {
    assert_cannot_write(&Spoiled::new(), Path::new("/proc/none"), "cannot write");
}

/// With fronto-parallel boards F and distance are hard to separate; the user is warned.
#[test]
fn fronto_parallel_boards_give_a_warning() {
    let noise = Noise { uv_px: 0.2, rho_px: 0.05, centers_px: 0.1 };
    let poses: Vec<FramePose> = (0_u8..5)
        .map(|i| FramePose {
            frame: i.into(),
            camera_from_board: nalgebra::Isometry3::translation(
                -12.0,
                -6.0,
                76.0 + 5.0 * f64::from(i),
            ),
        })
        .collect();
    let observations = synthesize(&true_camera(), &board(), &poses, &noise, 3).unwrap();
    let options: CalibrationOptions = options();
    let calibration = run(&datasheet_start(), &observations, &options);
    assert!(
        codes(&calibration.findings).contains(&"fronto-parallel"),
        "{:?}",
        calibration.findings
    );
}
