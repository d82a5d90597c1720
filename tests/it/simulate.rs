//! `plenocal simulate`: data sets as files.

use std::fs;
use std::path::Path;
use std::sync::LazyLock;

use plenocal::Estimate;
use plenocal::io::{
    Project, read_camera, read_centers, read_features, read_image, read_poses, read_true_board,
};
use plenocal::model::{BoardShape, EdgeSpread, Opening, PlenopticCamera};
use predicates::prelude::PredicateBooleanExt;
use predicates::str::contains;
use tempfile::TempDir;

use crate::prepared::Files;
use crate::support::{plenocal, preset};

/// A small data set as the program writes it.
fn simulate(out: &Path, more: &[&str]) -> assert_cmd::Command {
    let mut command = plenocal();
    command.args(["simulate", "--set", "rays=2", "--set", "boards.calibration=4"]);
    command.args(["--set", "boards.evaluation=1", "--set", "translation.images=2"]);
    command.args(["--set", "white_images.f_numbers=[4.0, 8.0]"]);
    command.args(more).arg("--out").arg(out);
    command
}

/// Such a data set.
static SET: LazyLock<Files> = LazyLock::new(|| {
    let folder = TempDir::new().unwrap();
    simulate(folder.path(), &[]).assert().success().stdout(contains("10 images"));
    Files::read(folder.path())
});

#[test]
fn a_data_set_has_the_images_that_its_project_lists() {
    let set = SET.copy();
    let project = Project::read(&set.path().join("project.toml")).unwrap();
    assert_eq!(project.datasheet().unwrap().unwrap(), preset("mini", &[]).datasheet());
    let images = project.images.unwrap();
    let translation = images.translation.unwrap();
    assert!((translation.step_mm - 5.0).abs() < 1e-12);
    let all: Vec<_> = images
        .whites
        .iter()
        .map(|white| &white.image)
        .chain(&images.devignetting)
        .chain(&images.calibration)
        .chain(&images.evaluation)
        .chain(&translation.images)
        .collect();
    assert_eq!(all.len(), 10);
    for path in all {
        let image = image::open(path).unwrap();
        assert_eq!((image.width(), image.height()), (1000, 750), "{}", path.display());
        assert_eq!(image.color(), image::ColorType::L8);
    }
}

#[test]
fn a_data_set_has_its_truth() {
    let set = SET.copy();
    let truth = set.path().join("truth");
    let edge_spread = EdgeSpread {
        aperture_ratio: Some(Estimate::exact(1.0)),
        opening: Opening::Disc,
        point_spread_px2: Some(Estimate::exact(0.0)),
    };
    let camera = PlenopticCamera { edge_spread, ..preset("mini", &[]).camera };
    assert_eq!(read_camera(&truth.join("camera.json")).unwrap(), camera);
    let centers = fs::read_to_string(truth.join("centers.csv")).unwrap();
    assert!(centers.starts_with("k,l,u,v,type,alive\n0,0,"));
    assert!(read_centers(&truth.join("centers.csv")).unwrap().len() > 1500);
    for (subset, frames) in [("calibration", 4), ("evaluation", 1), ("translation", 2)] {
        let folder = truth.join(subset);
        let features = read_features(&folder.join("features.csv"), true).unwrap();
        assert_eq!(features.frames().len(), frames, "{subset}");
        let poses = read_poses(&folder.join("poses.json")).unwrap();
        assert_eq!(poses.len(), frames, "{subset}");
        if subset == "translation" {
            let [first, second] = [0, 1].map(|i: usize| poses[i].camera_from_board.translation);
            assert!((second.vector - first.vector - nalgebra::Vector3::z() * 5.0).norm() < 1e-9);
        }
    }
}

/// With the true camera, the true features have no residuals but the effect of tilt on the blur.
#[test]
fn the_true_features_of_a_data_set_agree_with_its_true_camera() {
    let set = SET.copy();
    let truth = set.path().join("truth");
    let mut command = plenocal();
    command.args(["calibrate", "--mode", "poses-only", "--json", "--camera"]);
    command.arg(truth.join("camera.json")).arg("--scene").arg(set.path().join("project.toml"));
    command.arg("--features").arg(truth.join("calibration/features.csv"));
    let output = command.arg("--out").arg(set.path().join("out")).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let result: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert!(result["rmse"]["all"].as_f64().unwrap() < 2e-3);
}

#[test]
fn the_noisy_features_of_a_data_set_can_be_calibrated() {
    let set = SET.copy();
    let mut command = plenocal();
    command.arg("calibrate").arg(set.path().join("observed/project.toml"));
    command.arg("--out").arg(set.path().join("results")).assert().success();
}

fn simulated(more: &[&str]) -> Files {
    let folder = TempDir::new().unwrap();
    simulate(folder.path(), more).assert().success();
    Files::read(folder.path())
}

#[test]
fn the_number_of_threads_does_not_change_the_files() {
    let one = simulated(&["--threads", "1"]);
    assert!(one == simulated(&["--threads", "3"]));
    assert!(one == *SET);
}

#[test]
fn another_seed_changes_the_files() {
    let differing = simulated(&["--set", "seed=2"]).differing(&SET).len();
    assert!(differing > 10, "only {differing} files differ with another seed");
}

#[test]
fn printed_settings_are_the_same_as_the_written_ones() {
    let print = simulate(Path::new("unused"), &["--print"]).output().unwrap();
    assert_eq!(SET.get("simulation.toml"), print.stdout);
}

#[test]
fn written_settings_make_the_same_data_set_again() {
    let set = SET.copy();
    let again = TempDir::new().unwrap();
    let mut command = plenocal();
    command.arg("simulate").arg(set.path().join("simulation.toml"));
    command.arg("--out").arg(again.path()).assert().success();
    assert!(Files::read(again.path()) == *SET);
}

/// The first board of a data set with other imaging, and the project.
fn assert_imaged(settings: [&str; 2], color: image::ColorType) {
    let folder = TempDir::new().unwrap();
    let few = ["boards.calibration=1", "boards.evaluation=0", "translation.images=0"];
    let set: Vec<&str> = few.iter().chain(&settings).flat_map(|set| ["--set", set]).collect();
    simulate(folder.path(), &set).assert().success();
    let image = image::open(folder.path().join("calibration/calibration-00.png")).unwrap();
    assert_eq!(image.color(), color);
    // White reflects 0.9 and is exposed to 0.8; green has the largest weight in luma and responds with
    // 1, red and blue with 0.6 and 0.7. There are few rays and little noise.
    let brightest = image.to_luma32f().pixels().map(|p| p.0[0]).fold(0.0, f32::max);
    assert!((0.9 * 0.72 * 0.6..1.1 * 0.72).contains(&brightest), "{color:?}: {brightest}");
    let project = Project::read(&folder.path().join("project.toml")).unwrap();
    let name = serde_json::to_value(project.images.unwrap().color).unwrap();
    assert!(settings[1].ends_with(name.as_str().unwrap()));
}

#[test]
fn images_have_a_colour_mosaic() {
    assert_imaged(["imaging.bits=16", "imaging.color=bayer-grbg"], image::ColorType::L16);
}

#[test]
fn images_have_colours_of_8_bits() {
    assert_imaged(["imaging.bits=8", "imaging.color=rgb"], image::ColorType::Rgb8);
}

#[test]
fn images_have_colours_of_16_bits() {
    assert_imaged(["imaging.bits=16", "imaging.color=rgb"], image::ColorType::Rgb16);
}

/// A data set as JPEG: the project lists its images by their names, and they are those of the set as PNG but
/// for what JPEG loses.
#[test]
fn images_can_be_jpeg_files() {
    let folder = TempDir::new().unwrap();
    let set = ["--set", "imaging.jpeg_quality=95", "--set", "imaging.read_noise_electrons=0"];
    simulate(folder.path(), &set).assert().success().stdout(contains("devignetting.jpg"));
    let images = Project::read(&folder.path().join("project.toml")).unwrap().images.unwrap();
    assert_eq!((images.whites.len(), images.calibration.len(), images.evaluation.len()), (2, 4, 1));
    let jpeg = read_image(&images.calibration[0], None).unwrap();
    assert_eq!((jpeg.width, jpeg.height, jpeg.bits()), (1000, 750, 8));
    let png = simulated(&["--set", "imaging.read_noise_electrons=0"]).copy();
    let png = read_image(&png.path().join("calibration/calibration-00.png"), None).unwrap();
    let [jpeg, png] = [jpeg, png].map(|image| image.to_grey().pixels);
    let squares: f32 = jpeg.iter().zip(&png).map(|(a, b)| (a - b).powi(2)).sum();
    #[allow(clippy::cast_precision_loss)] // a mean
    let differing = (squares / jpeg.len() as f32).sqrt();
    assert!((1e-4..0.02).contains(&differing), "{differing}");
    for path in images.whites.iter().map(|white| &white.image).chain(&images.devignetting) {
        let color = image::open(path).unwrap().color();
        assert_eq!(color, image::ColorType::L8, "{}", path.display());
    }
}

/// A project states what is engraved; the truth is what the images were taken with.
#[test]
fn a_data_set_states_what_is_engraved_and_keeps_its_truth() {
    let with = |more: &[&str]| {
        let few = ["engraved_f_number=4.2", "target.sag_mm=[0.1, 0]", "target.aspect=-0.001"];
        let set: Vec<&str> = few.iter().chain(more).flat_map(|set| ["--set", *set]).collect();
        simulated(&set).copy()
    };
    let set = with(&["white_images.stop_errors=[0.02, -0.03]"]);
    let file = set.path().join("project.toml");
    let project = Project::read(&file).unwrap();
    assert!((project.main_lens.unwrap().f_number - 4.2).abs() < 1e-12);
    let stated: Vec<_> =
        project.images.unwrap().whites.iter().map(|white| white.f_number.unwrap()).collect();
    assert_eq!(stated, [4.0, 8.0]);
    let truth = set.path().join("truth");
    let camera = read_camera(&truth.join("camera.json")).unwrap();
    assert!((camera.main_lens.setting.unwrap().f_number - 4.0).abs() < 1e-12);
    let board = read_true_board(&truth.join("board.toml")).unwrap();
    let shape = BoardShape { sag_x_mm: 0.1, aspect: -0.001, ..BoardShape::default() };
    assert_eq!(board, shape);
    let flat = read_true_board(&SET.copy().path().join("truth/board.toml")).unwrap();
    assert_eq!(flat, BoardShape::default());
    // Micro-images are smaller at a larger f-number.
    let exact = with(&[]);
    let lit = |set: &TempDir, name: &str| {
        let image = read_image(&set.path().join(name), None).unwrap();
        image.to_grey().pixels.iter().filter(|&&p| p > 0.1).count() as f64
    };
    let part = |name: &str| lit(&set, name) / lit(&exact, name);
    assert!(part("whites/white-0-n-4.00.png") < 0.99);
    assert!(part("whites/white-1-n-8.00.png") > 1.01);
    assert!((part("devignetting.png") - 1.0).abs() < 1e-6);
}

/// A preset with this setting is rejected in these words, and nothing is written.
fn assert_rejected(set: &str, words: &str) {
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("set");
    let mut command = plenocal();
    command.args(["simulate", "--set", set, "--out"]).arg(&out);
    command.assert().code(1).stdout("").stderr(contains(words));
    assert!(!out.exists(), "{set} left something behind");
}

#[test]
fn pixels_and_boards_that_cannot_be_are_rejected_by_name() {
    for (set, words) in [
        ("imperfections.point_spread_px=-0.1", "a point spread of -0.1 px"),
        ("imperfections.point_spread_px=11", "a point spread of 11 px"),
        ("imaging.crosstalk=0.3", "a crosstalk of 0.3"),
        ("imaging.black_level=-0.1", "a black level of -0.1"),
        ("imaging.black_level=1.1", "a black level of 1.1"),
        ("imaging.gamma=0", "a gamma of 0"),
        ("imaging.saturation=1.1", "samples cannot saturate at 1.1"),
        ("imaging.hot_pixels=750001", "750001 hot pixels are more than the 750000"),
        ("imaging.jpeg_quality=0", "a JPEG quality of 0"),
        ("imaging={bits=16, jpeg_quality=90}", "JPEG files have 8 bits"),
        ("imaging={color=\"bayer-rggb\", jpeg_quality=90}", "and are 'bayer-rggb'"),
        ("boards.motion_px=-1", "boards that move by -1 px"),
        ("target.sag_mm=[7.0, 0.0]", "a sag along x of the target of 7 mm"),
        ("target.sag_mm=[0.0, nan]", "sag_mm is NaN"),
        ("target.twist_mm=-7", "a twist of the target of -7 mm"),
        ("target.aspect=0.5", "an aspect of the target of 0.5"),
        ("target.uneven_light=[0.0, 2.0]", "uneven light of 2"),
        ("white_images.stop_errors=[0.1]", "1 stop errors for 5 white images"),
        ("white_images.stop_errors=[0, 0, 0, 0.5, 0]", "a stop error of 0.5"),
        ("engraved_f_number=0", "the f-number 0 that is engraved"),
    ] {
        assert_rejected(set, words);
    }
}

#[test]
fn settings_that_cannot_be_simulated_are_rejected_by_name() {
    for (set, words) in [
        ("rays=0", "0 rays per pixel cannot be traced"),
        ("rays=100000", "100000 rays per pixel cannot be traced"),
        ("camera.sensor.width_px=0", "has no area"),
        ("camera.sensor.width_px=4000000000", "the limit is 268435456"),
        ("camera.micro_lens_array.columns=60000", "micro-lenses are too many"),
        ("boards.calibration=1000000000000", "images of one kind are too many"),
        ("camera.main_lens.q1_per_mm2=-0.1", "the distortion folds the image"),
        ("camera.main_lens.p1_per_mm=1e10", "the distortion folds the image"),
        ("camera.micro_lens_array.mla_to_sensor_mm=0", "the camera's d (mm) is 0"),
        ("camera.micro_lens_array.mla_to_sensor_mm=-0.3", "the camera's d (mm) is -0.3"),
        ("camera.micro_lens_array.rotation_rad=[0.5, 0.0, 0.0]", "behind the sensor"),
        ("camera.micro_lens_array.focal_lengths_mm=[]", "needs the focal lengths"),
        ("camera.main_lens.f_number=0.5", "at f/0.5 micro-images have a radius of"),
        ("camera.main_lens.f_number=0", "the f-number"),
        ("white_images.f_numbers=[4.0, -8.0]", "the f-number -8 of a white image"),
        ("boards.depth_mm=[-90.0, -70.0]", "give positive depths"),
        ("boards.depth_mm=[10.0, 60.0]", "within the focal length of 16.2 mm"),
        ("boards.depth_mm=[20.0, 25.0]", "no pose between 20 and 25 mm shows"),
        ("translation.start_mm=10", "translation frame 0: a part of the board is at"),
        (
            "translation.step_mm=-50",
            "translation frame 2: a part of the board is behind the camera",
        ),
        ("boards.max_tilt_deg=90", "a tilt of up to 90 degrees"),
        ("target.square_mm=0", "squares of the board (square_mm) is 0"),
        ("target.black=2", "black (2) is not darker than its white"),
        ("imaging.bits=12", "images with 12 bits cannot be written"),
        ("imaging.exposure=nan", "exposure is NaN"),
        ("imaging.gain=1e18", "the gain is 1000000000000000000, but has to be above 0"),
        ("imaging.full_well_electrons=1e20", "a full well of 100000000000000000000 electrons"),
        ("imaging.full_well_electrons=0", "a full well of 0 electrons"),
        ("imperfections.aperture_ratio=1.5", "an aperture ratio of 1.5"),
        ("imperfections.exit_pupil_mm=-5", "camera.main_lens.exit_pupil_mm = [0, 0, -5]"),
        ("camera.main_lens.exit_pupil_mm=[0, 0, -30]", "D + e_z from exit pupil to array (mm) is"),
        ("camera.main_lens.exit_pupil_mm=[0, 0, -17]", "pupil magnification 1 + e_z/F"),
        ("camera.main_lens.exit_pupil_mm=[0, 0, 2e6]", "has to lie within 1000000 mm"),
        ("imperfections.fall_off=cos5", "unknown variant `cos5`"),
        ("imperfections.fall_off={half_response_deg=95}", "a half response at 95 degrees"),
        ("imperfections.second_stop={z_mm=-20, diameter_mm=3}", "a second stop at z = -20 mm"),
        ("imperfections.dead_micro_lenses=2000", "more than the 1591 micro-lenses of the array"),
        ("imperfections.dust_specks=1000000000", "specks of dust are too many"),
        ("observation_noise.uv_px=-1", "a noise of -1 px"),
        ("rayz=3", "unknown field `rayz`"),
        ("camera.main_lens.focal_lenth_mm=3", "unknown field `focal_lenth_mm`"),
        ("seed", "'seed' is not a setting: write KEY=VALUE"),
        ("seed.x=3", "seed is not a table"),
        ("seed=many", "invalid type: string \"many\", expected u64"),
        ("seed=1\nrays = 1", "the value of 'seed' has more than one line"),
    ] {
        assert_rejected(set, words);
    }
}

fn rejected(folder: &Path, arguments: &[&str]) -> assert_cmd::assert::Assert {
    let mut command = plenocal();
    command.arg("simulate").args(arguments).arg("--out").arg(folder.join("out"));
    command.assert().code(1).stdout("")
}

#[test]
fn bad_simulation_files_are_rejected() {
    let folder = TempDir::new().unwrap();
    let file = folder.path().join("a.toml");
    let run = || rejected(folder.path(), &[file.to_str().unwrap()]);
    run().stderr(contains("cannot read").and(contains("a.toml")));
    fs::write(&file, "rays = 3\nseed = ").unwrap();
    run().stderr(contains("a.toml: not a valid simulation file").and(contains("line 2")));
    fs::write(&file, "rays = 3").unwrap();
    run().stderr(contains("missing field `seed`"));
}

#[test]
fn bad_files_of_poses_are_rejected() {
    let folder = TempDir::new().unwrap();
    let file = folder.path().join("poses.json");
    let run = || rejected(folder.path(), &["--poses", file.to_str().unwrap()]);
    fs::write(&file, "").unwrap();
    run().stderr(contains("poses.json: the file is empty"));
    // A board turned by 180 degrees shows its back.
    let pose = r#"{"frame": 3, "camera_from_board": {"rotation_vector_rad": [0, 3.14159, 0],
        "translation_mm": [0, 0, 80]}}"#;
    for (poses, words) in [
        (pose.to_owned(), "calibration frame 3: the camera sees the back of the board"),
        (format!("{pose}, {pose}"), "frame 3 has two poses"),
        (String::new(), "there are no poses"),
    ] {
        let document = r#"{"format": "plenocal-poses", "version": 1, "poses": ["#;
        fs::write(&file, format!("{document}{poses}]}}")).unwrap();
        run().stderr(contains(words));
    }
}

#[test]
fn an_output_folder_that_is_a_file_is_rejected() {
    let folder = TempDir::new().unwrap();
    fs::write(folder.path().join("out"), "in the way").unwrap();
    rejected(folder.path(), &[]).stderr(contains("is a file, but results need a folder"));
}

#[test]
fn a_simulation_without_a_folder_or_with_an_unknown_preset_is_rejected() {
    plenocal().args(["simulate"]).assert().code(2).stderr(contains("--out <DIR>"));
    plenocal()
        .args(["simulate", "--preset", "r13", "--out", "x"])
        .assert()
        .code(2)
        .stderr(contains("keplerian"));
}
