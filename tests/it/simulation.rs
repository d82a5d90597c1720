//! Simulated data sets: from their truth back to the camera, and as files.

use std::fs;
use std::path::Path;

use plenocal::calibration::{Calibration, Start, calibrate};
use plenocal::io::{Project, read_camera, read_centers, read_features};
use plenocal::model::{BapFeature, FramePose, NoiseSource, Observations, optics};
use plenocal::simulation::{DataSet, Imperfections, PRESETS, Settings};
use predicates::prelude::PredicateBooleanExt;
use predicates::str::contains;
use tempfile::TempDir;

use crate::support::{options, pairs, plenocal, preset};

/// A normal variable is further out than this once in 16 000 draws; about a hundred are looked at.
const FOUR_SIGMA: f64 = 4.0;
const NOISE_AGREEMENT: f64 = 0.05;
/// Corners with less light are not looked for.
const HALF_VISIBLE: f64 = 0.5;

fn calibration_poses(settings: &Settings) -> Vec<FramePose> {
    DataSet::plan(settings, None).unwrap().subsets[0].iter().map(|&(pose, _)| pose).collect()
}

/// Calibrates from the traced truth with noise, starting from datasheet and closed-form internal
/// parameters.
fn calibrated(settings: &Settings) -> Calibration {
    let tracer = settings.tracer(settings.board_f_number()).unwrap();
    let mut source = NoiseSource::new(&settings.observation_noise, 5).unwrap();
    let board = settings.target.board();
    let features: Vec<BapFeature> = calibration_poses(settings)
        .iter()
        .flat_map(|pose| tracer.features(pose.frame, &board, &pose.camera_from_board))
        .filter(|f| f.visible >= HALF_VISIBLE)
        .map(|f| source.feature(&f.feature))
        .collect();
    // Centres right at the border may be pushed out of the image.
    let inside = |u: f64, size: u32| (1.0..f64::from(size) - 2.0).contains(&u);
    let sensor = &settings.camera.sensor;
    let centers = tracer
        .centers()
        .into_iter()
        .map(|c| source.center(&c.center))
        .filter(|c| inside(c.u_px, sensor.width_px) && inside(c.v_px, sensor.height_px))
        .collect();
    let observations = Observations { centers, features };
    let start =
        Start::Datasheet(settings.datasheet(), optics::internal_parameters(&settings.camera));
    calibrate(&start, &board, &observations, &options(), &mut |_| true).unwrap()
}

/// The traced observations know nothing of the model that is fitted to them. On the Keplerian
/// camera a board leans the wrong way at the start, and has to be found out.
#[test]
fn the_simulated_camera_comes_back() {
    for name in ["mini", "keplerian", "r12-a", "r12-b", "r12-c"] {
        let settings = preset(name, &[]);
        let calibration = calibrated(&settings);
        assert!(calibration.converged, "{name}");
        assert_eq!(calibration.left_out, [], "{name}");
        let std_devs = calibration.uncertainty.intrinsic_std_devs(3);
        for ((parameter, value, truth), std_dev) in
            pairs(&calibration.camera, &settings.camera).iter().zip(std_devs)
        {
            // The pitch ratio is held.
            let Some(s) = std_dev else { continue };
            let off = (value - truth).abs() / s;
            assert!(off < FOUR_SIGMA, "{name}, {parameter}: {value} ± {s} for {truth}");
        }
        for (i, (pose, truth)) in
            calibration.poses.iter().zip(calibration_poses(&settings)).enumerate()
        {
            let off = pose.camera_from_board.translation.vector
                - truth.camera_from_board.translation.vector;
            let [.., x, y, z] = calibration.uncertainty.pose_std_devs(i);
            for (off, s) in off.iter().zip([x, y, z]) {
                assert!(off.abs() < FOUR_SIGMA * s, "{name}, frame {i}: {off} ± {s} mm");
            }
        }
        let noise = &settings.observation_noise;
        for (measured, truth) in calibration.uncertainty.residual_std_dev_px.into_iter().zip([
            noise.uv_px,
            noise.rho_px,
            noise.centers_px,
        ]) {
            assert!((measured / truth - 1.0).abs() < NOISE_AGREEMENT, "{name}: {measured} px");
        }
    }
}

/// A small data set as the program writes it.
fn simulate(out: &Path, more: &[&str]) -> assert_cmd::Command {
    let mut command = plenocal();
    command.args(["simulate", "--set", "rays=2", "--set", "boards.calibration=4"]);
    command.args(["--set", "boards.evaluation=1", "--set", "translation.images=2"]);
    command.args(["--set", "white_images.f_numbers=[4.0, 8.0]"]);
    command.args(more).arg("--out").arg(out);
    command
}

#[test]
fn a_data_set_is_complete_and_can_be_calibrated() {
    let folder = TempDir::new().unwrap();
    let set = folder.path().join("set");
    simulate(&set, &[]).assert().success().stdout(contains("10 images"));

    let project = Project::read(&set.join("project.toml")).unwrap();
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

    let truth = set.join("truth");
    assert_eq!(read_camera(&truth.join("camera.json")).unwrap(), preset("mini", &[]).camera);
    let centers = fs::read_to_string(truth.join("centers.csv")).unwrap();
    assert!(centers.starts_with("k,l,u,v,type,alive\n0,0,"));
    assert!(read_centers(&truth.join("centers.csv")).unwrap().len() > 1500);
    for (subset, frames) in [("calibration", 4), ("evaluation", 1), ("translation", 2)] {
        let folder = truth.join(subset);
        let features = read_features(&folder.join("features.csv"), true).unwrap();
        assert_eq!(features.frames().len(), frames, "{subset}");
        let poses = plenocal::io::read_poses(&folder.join("poses.json")).unwrap();
        assert_eq!(poses.len(), frames, "{subset}");
        if subset == "translation" {
            let [first, second] = [0, 1].map(|i: usize| poses[i].camera_from_board.translation);
            assert!((second.vector - first.vector - nalgebra::Vector3::z() * 5.0).norm() < 1e-9);
        }
    }
    // The truth as it is, through its own camera, leaves nothing but what tilt does to the blur.
    let poses_only = |features: &str| {
        let mut command = plenocal();
        command.args(["calibrate", "--mode", "poses-only", "--json", "--camera"]);
        command.arg(truth.join("camera.json")).arg("--scene").arg(set.join("project.toml"));
        command.arg("--features").arg(truth.join(features)).arg("--out").arg(folder.path());
        let output = command.output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let result: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        result["rmse"]["all"].as_f64().unwrap()
    };
    assert!(poses_only("calibration/features.csv") < 2e-3);

    let mut command = plenocal();
    command.arg("calibrate").arg(set.join("observed/project.toml"));
    command.arg("--out").arg(folder.path().join("results")).assert().success();
}

fn files(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let mut all = Vec::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            all.extend(files(&path));
        } else {
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            all.push((name, fs::read(&path).unwrap()));
        }
    }
    all.sort();
    all
}

#[test]
fn the_same_seed_gives_the_same_files_whatever_the_threads() {
    let folder = TempDir::new().unwrap();
    let written = |name: &str, more: &[&str]| {
        let out = folder.path().join(name);
        simulate(&out, more).assert().success();
        files(&out)
    };
    let one = written("one", &["--threads", "1"]);
    assert!(one == written("three", &["--threads", "3"]));
    let other = written("other", &["--set", "seed=2"]);
    let differing = one.iter().zip(&other).filter(|(a, b)| a.1 != b.1).count();
    assert!(differing > 10, "only {differing} files differ with another seed");

    // What is printed or written of the settings makes the same data set again.
    let print = simulate(folder.path(), &["--print"]).output().unwrap();
    let mut written = one.iter().filter(|(name, _)| name == "simulation.toml");
    assert_eq!(written.next().unwrap().1, print.stdout);
    let again = folder.path().join("again");
    let mut command = plenocal();
    command.arg("simulate").arg(folder.path().join("one/simulation.toml"));
    command.arg("--out").arg(&again).assert().success();
    assert!(one == files(&again));
}

#[test]
fn images_come_in_colours_and_depths() {
    use image::ColorType;
    let folder = TempDir::new().unwrap();
    for (i, (settings, color)) in [
        (["imaging.bits=16", "imaging.color=bayer-grbg"], ColorType::L16),
        (["imaging.bits=8", "imaging.color=rgb"], ColorType::Rgb8),
        (["imaging.bits=16", "imaging.color=rgb"], ColorType::Rgb16),
    ]
    .into_iter()
    .enumerate()
    {
        let out = folder.path().join(i.to_string());
        let set = settings.map(|s| ["--set", s]).concat();
        simulate(&out, &set).assert().success();
        let image = image::open(out.join("calibration/calibration-00.png")).unwrap();
        assert_eq!(image.color(), color);
        // White reflects 0.9 and is exposed to 0.8; green counts most in luma and responds with 1,
        // red and blue with 0.6 and 0.7. Rays and noise are few.
        let brightest = image.to_luma32f().pixels().map(|p| p.0[0]).fold(0.0, f32::max);
        assert!((0.9 * 0.72 * 0.6..1.1 * 0.72).contains(&brightest), "{color:?}: {brightest}");
        let project = Project::read(&out.join("project.toml")).unwrap();
        let name = serde_json::to_value(project.images.unwrap().color).unwrap();
        assert!(settings[1].ends_with(name.as_str().unwrap()));
    }
}

#[test]
fn presets_are_what_they_say() {
    for preset in PRESETS {
        let settings = Settings::preset(preset.name, &[]).unwrap();
        DataSet::plan(&settings, None).unwrap();
        assert_eq!(settings.imperfections, Imperfections::default(), "{}", preset.name);
    }
    let square = preset("lytro-like", &["camera.micro_lens_array.lattice=orthogonal"]);
    DataSet::plan(&square, None).unwrap();
    // Table 1 of the paper.
    let a = preset("r12-a", &[]).camera;
    assert_eq!((a.sensor.width_px, a.sensor.height_px), (4080, 3068));
    assert_eq!((a.lattice.columns, a.lattice.rows), (176, 152));
    assert_eq!(
        format!("{:.3} {:.3}", a.main_lens.focal_length_mm, a.mla.lens_to_mla_mm),
        "49.720 56.696"
    );
}

#[test]
fn imperfections_do_what_they_say() {
    use plenocal::simulation::{Scene, SecondStop};
    let mut settings = preset("mini", &["rays=16"]);
    let white = |settings: &Settings| {
        settings.tracer(4.0).unwrap().render(&Scene::White, 16, 1, &|| ()).unwrap()
    };
    let sum = |image: &plenocal::image::Image| image.pixels.iter().map(|&p| f64::from(p)).sum();
    let ideal = white(&settings);
    let all: f64 = sum(&ideal);

    settings.imperfections = Imperfections { dead_micro_lenses: 159, ..Imperfections::default() };
    let part: f64 = sum(&white(&settings)) / all;
    assert!((part - 0.9).abs() < 0.01, "a tenth of the micro-lenses is dead: {part}");

    // All light goes through the stop of some micro-lens; the reference goes with its area too
    // where the stop is the smaller one, as at f/4.
    settings.imperfections = Imperfections { fill_factor: 0.8, ..Imperfections::default() };
    let reference = |s: &Settings| s.tracer(4.0).unwrap().reference_irradiance();
    let light: f64 =
        sum(&white(&settings)) * reference(&settings) / (all * reference(&preset("mini", &[])));
    assert!((light / 0.64 - 1.0).abs() < 0.02, "0.8² of the light: {light}");

    settings.imperfections = Imperfections { dust_specks: 40, ..Imperfections::default() };
    let dusty = white(&settings);
    // Specks of a radius from 1.25 to 5 px cover 34 px on the average, some of them dark before.
    let dark = dusty.pixels.iter().zip(&ideal.pixels).filter(|(d, i)| **d < 0.5 * **i).count();
    assert!((400..3000).contains(&dark), "{dark} pixels are covered");
    assert!(dusty.pixels.iter().zip(&ideal.pixels).all(|(d, i)| d <= &(i + 1e-6)));

    // A rim half way to the array, three quarters of the pupil, leaves the middle and darkens the border.
    let rim = SecondStop { z_mm: -9.0, diameter_mm: 3.0 };
    settings.imperfections = Imperfections { second_stop: Some(rim), ..Imperfections::default() };
    let vignetted = white(&settings);
    let near = |image: &plenocal::image::Image, u: usize, v: usize| -> f32 {
        (v - 20..v + 20)
            .flat_map(|v| (u - 20..u + 20).map(move |u| (u, v)))
            .map(|(u, v)| image.at(u, v))
            .sum()
    };
    assert!(near(&vignetted, 520, 362) > 0.95 * near(&ideal, 520, 362));
    assert!(near(&vignetted, 30, 30) < 0.6 * near(&ideal, 30, 30));

    // Micro-image centres spread from the exit pupil: half way to the array, about the axis and
    // seen from there, the pitch grows by d (1/(D/2) − 1/D).
    let camera = &settings.camera;
    settings.imperfections = Imperfections {
        exit_pupil_mm: -camera.mla.lens_to_mla_mm / 2.0,
        ..Imperfections::default()
    };
    let at = |s: &Settings, k| {
        let centers = s.tracer(4.0).unwrap().centers();
        let found = centers.iter().find(|c| (c.center.k, c.center.l) == (k, 18)).unwrap();
        found.center.u_px
    };
    let ideal = preset("mini", &[]);
    let growth = (at(&settings, 40) - at(&settings, 2)) / (at(&ideal, 40) - at(&ideal, 2));
    let (d, lens) = (camera.mla.mla_to_sensor_mm, camera.mla.lens_to_mla_mm);
    let expected = (1.0 + 2.0 * d / lens) / (1.0 + d / lens);
    // The array is tilted by a milliradian.
    assert!((growth - expected).abs() < 1e-4, "{growth} for {expected}");
}

#[test]
fn impossible_simulations_are_refused_in_words() {
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("set");
    for (set, words) in [
        ("rays=0", "0 rays per pixel cannot be traced"),
        ("rays=100000", "100000 rays per pixel cannot be traced"),
        ("camera.sensor.width_px=0", "has no area"),
        ("camera.sensor.width_px=4000000000", "pixels are more than can be simulated"),
        ("camera.micro_lens_array.columns=60000", "micro-lenses are more than can be simulated"),
        ("boards.calibration=1000000000000", "images of a kind are more than can be simulated"),
        ("camera.main_lens.q1_per_mm2=-0.1", "the distortion folds the image"),
        ("camera.main_lens.p1_per_mm=1e10", "the distortion folds the image"),
        ("camera.micro_lens_array.mla_to_sensor_mm=0", "the camera's d (mm) is 0"),
        ("camera.micro_lens_array.mla_to_sensor_mm=-0.3", "the camera's d (mm) is -0.3"),
        ("camera.micro_lens_array.rotation_rad=[0.5, 0.0, 0.0]", "behind the sensor"),
        ("camera.micro_lens_array.focal_lengths_mm=[]", "needs the focal lengths"),
        ("camera.main_lens.f_number=0.5", "at f/0.5 micro-images have a radius of"),
        ("camera.main_lens.f_number=0", "the f-number"),
        ("white_images.f_numbers=[4.0, -8.0]", "the f-number -8 of a white image"),
        ("boards.depth_mm=[-90.0, -70.0]", "behind the camera"),
        ("boards.depth_mm=[10.0, 60.0]", "within the focal length of 16.2 mm"),
        ("boards.depth_mm=[20.0, 25.0]", "no pose between 20 and 25 mm was found"),
        ("translation.start_mm=10", "translation frame 0: the board comes as near as"),
        ("translation.step_mm=-50", "translation frame 2: the board reaches behind the camera"),
        ("boards.max_tilt_deg=90", "a tilt of up to 90 degrees"),
        ("target.square_mm=0", "squares (mm) is 0"),
        ("target.black=2", "black (2) is not darker than its white"),
        ("imaging.bits=12", "images of 12 bits cannot be written"),
        ("imaging.exposure=nan", "the exposure is NaN"),
        ("imaging.gain=1e18", "the gain is 1000000000000000000; it has to be above 0"),
        ("imaging.full_well_electrons=1e20", "a full well of 100000000000000000000 electrons"),
        ("imaging.full_well_electrons=0", "a full well of 0 electrons"),
        ("imperfections.fill_factor=1.5", "a fill factor of 1.5"),
        ("imperfections.exit_pupil_mm=-30", "an exit pupil at z = -30 mm is not possible"),
        ("imperfections.exit_pupil_mm=1e300", "mm in front of the main lens"),
        ("imperfections.second_stop={z_mm=-20, diameter_mm=3}", "a second stop at z = -20 mm"),
        ("imperfections.dead_micro_lenses=2000", "more than the 1591 of the array"),
        ("imperfections.dust_specks=1000000000", "specks of dust are too many"),
        ("observation_noise.uv_px=-1", "a noise of -1 px"),
        ("rayz=3", "unknown field `rayz`"),
        (
            "camera.main_lens.focal_lenth_mm=3",
            "there is no setting 'camera.main_lens.focal_lenth_mm'",
        ),
        ("seed", "'seed' sets nothing; write KEY=VALUE"),
        ("seed.x=3", "seed is no table"),
        ("seed=many", "invalid type: string \"many\", expected u64"),
        ("seed=1\nrays = 1", "the value of 'seed' has more than one line"),
    ] {
        plenocal()
            .args(["simulate", "--set", set, "--out"])
            .arg(&out)
            .assert()
            .code(1)
            .stdout("")
            .stderr(contains(words));
        assert!(!out.exists(), "{set} left something behind");
    }
}

#[test]
fn bad_files_and_places_are_refused_in_words() {
    let folder = TempDir::new().unwrap();
    let (file, out) = (folder.path().join("a.toml"), folder.path().join("out"));
    let run = |more: &[&str]| {
        let mut command = plenocal();
        command.arg("simulate").args(more).arg("--out").arg(&out);
        command.assert().code(1).stdout("")
    };
    let path = file.to_str().unwrap();
    run(&[path]).stderr(contains("cannot read").and(contains("a.toml")));
    fs::write(&file, "rays = 3\nseed = ").unwrap();
    run(&[path]).stderr(contains("a.toml: not a valid simulation file").and(contains("line 2")));
    fs::write(&file, "rays = 3").unwrap();
    run(&[path]).stderr(contains("missing field `seed`"));
    fs::write(&file, "").unwrap();
    run(&["--poses", path]).stderr(contains("a.toml: the file is empty"));

    // A board turned round shows its back.
    let pose = r#"{"frame": 3, "camera_from_board": {"rotation_vector_rad": [0, 3.14159, 0],
        "translation_mm": [0, 0, 80]}}"#;
    for (poses, words) in [
        (pose.to_owned(), "calibration frame 3: the board shows its back"),
        (format!("{pose}, {pose}"), "frame 3 has two poses"),
        (String::new(), "there are no poses"),
    ] {
        let document = r#"{"format": "plenocal-poses", "version": 1, "poses": ["#;
        fs::write(&file, format!("{document}{poses}]}}")).unwrap();
        run(&["--poses", path]).stderr(contains(words));
    }

    fs::write(&out, "in the way").unwrap();
    run(&[]).stderr(contains("is a file, but results go into a folder"));
    plenocal().args(["simulate"]).assert().code(2).stderr(contains("--out <DIR>"));
    plenocal()
        .args(["simulate", "--preset", "r13", "--out", "x"])
        .assert()
        .code(2)
        .stderr(contains("keplerian"));
}
