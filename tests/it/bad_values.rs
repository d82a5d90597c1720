//! Findings of `make fuzz` and of users, each with the message that it gives now.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use flate2::Compression;
use flate2::write::GzEncoder;
use nalgebra::Vector2;
use plenocal::assessment::compare_cameras;
use plenocal::image::Samples;
use plenocal::io::{
    Project, read_camera, read_camera_source, read_centers, read_features, read_image,
    read_internal_parameters, read_poses, read_std_devs, read_true_board,
};
use plenocal::model::{FramePose, Noise};
use plenocal::simulation::{DataSet, Settings};
use plenocal::solver::{distortion_mm, pixel_rays, synthesize};
use predicates::prelude::PredicateBooleanExt;
use predicates::str::contains;
use tempfile::TempDir;

use crate::hostile::{corpus, documents};
use crate::support::{NO_NOISE, board, plenocal, synthetic_folder, true_camera, true_poses};

/// A file with this content.
struct File {
    _folder: TempDir,
    path: PathBuf,
}

fn file(name: &str, content: impl AsRef<[u8]>) -> File {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join(name);
    fs::write(&path, content).unwrap();
    File { _folder: folder, path }
}

/// Asserts that an error contains these words.
fn assert_refused<T>(result: plenocal::Result<T>, words: &[&str]) {
    let Err(error) = result else { panic!("it is accepted, but it should say {words:?}") };
    let message = error.to_string();
    for word in words {
        assert!(message.contains(word), "{word}: {message}");
    }
}

#[test]
fn keys_of_json_files_are_given_once() {
    let truth = fs::read_to_string(synthetic_folder().join("truth/camera.json")).unwrap();
    let twice =
        truth.replacen("\"pitch_mm\": 0.126", "\"pitch_mm\": 0.126, \"pitch_mm\": 0.127", 1);
    assert_ne!(truth, twice);
    let camera = file("camera.json", twice);
    let words = ["camera.json", "'pitch_mm' is given twice", "line"];
    assert_refused(read_camera(&camera.path), &words);
    assert_refused(read_camera_source(&camera.path), &words);
    let scene = file("scene.js", r#"{"checkerboards": [], "checkerboards": []}"#);
    assert_refused(plenocal::io::read_board(&scene.path), &["scene.js", "'checkerboards'"]);
}

#[test]
fn numbers_that_are_not_finite_are_refused() {
    let project = documents::PROJECT;
    for (from, to, key) in [
        ("f_number = 2.8", "f_number = nan", "f_number"),
        ("m_mm = 0.1432", "m_mm = inf", "m_mm"),
        ("0.0414, 0.0377", "nan, 0.0377", "q_prime_mm"),
        ("loss_scale = 3.0", "loss_scale = inf", "loss_scale"),
        ("focus_distance_mm = inf", "focus_distance_mm = nan", "focus_distance_mm"),
    ] {
        assert!(project.contains(from), "{from}");
        let project = file("project.toml", project.replacen(from, to, 1));
        assert_refused(Project::read(&project.path), &["project.toml", key, "finite"]);
    }
    assert!(Project::read(&file("project.toml", project).path).is_ok());
    let shape = file("board.toml", documents::BOARD_SHAPE.replace("0.05", "nan"));
    assert_refused(read_true_board(&shape.path), &["board.toml", "twist_mm is NaN"]);
    let params = file("params.js", r#"{"m": "inf", "q_prime": ["0.03"]}"#);
    let read = read_internal_parameters(&params.path, None);
    assert_refused(read, &["params.js", "'inf' is not a finite number"]);
}

#[test]
fn poses_that_are_not_finite_are_refused() {
    let pose = |rotation: &str, translation: &str| {
        format!(
            "{{\"format\": \"plenocal-poses\", \"version\": 1, \"poses\": [{{\"frame\": 7, \
             \"camera_from_board\": {{\"rotation_vector_rad\": [{rotation}, 0, 0], \
             \"translation_mm\": [{translation}, 0, 80]}}}}]}}"
        )
    };
    assert!(read_poses(&file("poses.json", pose("0.1", "1")).path).is_ok());
    for (rotation, translation) in [("1e308", "1"), ("0", "1e300")] {
        let poses = file("poses.json", pose(rotation, translation));
        assert_refused(read_poses(&poses.path), &["poses.json", "frame 7", "not finite"]);
    }
}

#[test]
fn binary_observations_are_finite() {
    let packed = |bytes: &[u8]| {
        let mut packed = GzEncoder::new(Vec::new(), Compression::fast());
        packed.write_all(bytes).unwrap();
        file("observations.bin.gz", packed.finish().unwrap())
    };
    let mut bytes = documents::linked();
    assert!(read_centers(&packed(&bytes).path).is_ok());
    // u of the first centre follows the number of centres and k, l.
    bytes[16..24].copy_from_slice(&f64::NAN.to_le_bytes());
    let words = ["observations.bin.gz", "contains NaN"];
    assert_refused(read_centers(&packed(&bytes).path), &words);
    assert_refused(read_features(&packed(&bytes).path, true), &words);
}

/// The table of parameters has three focal lengths: a fourth ended the process.
#[test]
fn a_camera_of_four_lens_types_is_refused() {
    let mut camera = true_camera();
    camera.mla.focal_lengths_mm.push(0.5);
    let words = ["4 lens types"];
    assert_refused(synthesize(&camera, &board(), &true_poses(), &NO_NOISE, 1), &words);
    assert_refused(distortion_mm(&camera, &[]), &words);
    let document = plenocal::io::camera_document(&camera, None).to_string();
    let camera = file("camera.json", document);
    assert_refused(read_camera(&camera.path), &["camera.json", "4 lens types"]);
}

#[test]
fn settings_of_a_simulation_are_finite() {
    let preset = |set: &str| Settings::preset("mini", &[set.to_owned()]);
    let nan = preset("camera.main_lens.focus_distance_mm=nan");
    assert_refused(nan, &["focus_distance_mm", "finite"]);
    let negative = preset("camera.main_lens.focus_distance_mm=-1.0");
    assert_refused(negative, &["focus distance", "-1"]);
    assert_refused(preset("target.square_mm=inf"), &["square_mm", "finite"]);
    let noise = preset("observation_noise.rho_px=1e308");
    assert_refused(noise, &["a noise of 1e308 px", "10000"]);
    let noise = Noise { uv_px: 1e308, ..NO_NOISE };
    assert_refused(synthesize(&true_camera(), &board(), &[], &noise, 1), &["1e308"]);
}

#[test]
fn a_misspelt_column_is_named() {
    let row = "k,l,u,v,roh,cluster,frame\n5,5,100.0,100.0,0.1,3,0\n";
    let features = file("features.csv", row);
    assert_refused(read_features(&features.path, false), &["features.csv", "'roh'", "rho"]);
    let centers = |header: &str| file("centers.csv", format!("{header}\n5,5,100.0,100.0,0.1\n"));
    for header in ["k,l,u,v,std_dv", "k,l,u,v,Std_Dev", "k,l,u,v,stddev"] {
        let wrong = header.rsplit(',').next().unwrap();
        assert_refused(read_centers(&centers(header).path), &["centers.csv", wrong, "std_dev"]);
    }
    // Columns of others are none of these.
    for header in ["k,l,u,v,type", "k,l,u,v,alive", "k,l,u,v,radius", "k,l,u,v,std_u"] {
        assert!(read_centers(&centers(header).path).is_ok(), "{header}");
    }
}

#[test]
fn a_file_of_another_kind_is_recognised() {
    let poses = synthetic_folder().join("truth/poses.json");
    let words = ["poses.json", "seems to be", "plenocal-poses", "camera.json"];
    assert_refused(read_camera_source(&poses), &words);
    let [_, camera, params, of_compote] = documents::compote_documents();
    let camera = file("a.js", camera.to_string());
    assert_refused(read_poses(&camera.path), &["a.js", "camera.js of COMPOTE", "poses.json"]);
    let poses = file("b.js", of_compote.to_string());
    assert_refused(read_internal_parameters(&poses.path, None), &["poses.js of COMPOTE"]);
    let params = file("c.js", params.to_string());
    assert_refused(plenocal::io::read_board(&params.path), &["params.js of COMPOTE", "[board]"]);
}

#[test]
fn an_impossible_observation_is_named_with_its_line() {
    let folder = TempDir::new().unwrap();
    let at = |name: &str| folder.path().join(name);
    for (name, line) in [
        ("features.csv", "5,5,99999,100.0,0.1,3,0"),
        ("features.csv", "500,5,100.0,100.0,0.1,3,0"),
        ("features.csv", "2,5,56.2592,118.5949,-1.766,0,0"),
        ("centers.csv", "500,5,100.0,100.0"),
        ("centers.csv", "29,0,692.5514,11.7328"),
    ] {
        for file in ["project.toml", "features.csv", "centers.csv"] {
            fs::copy(synthetic_folder().join(file), at(file)).unwrap();
        }
        let text = fs::read_to_string(at(name)).unwrap();
        let number = text.lines().count() + 1;
        fs::write(at(name), format!("{text}{line}\n")).unwrap();
        let mut calibrate = plenocal();
        calibrate.arg("calibrate").arg(at("project.toml")).arg("--out").arg(at("out"));
        let place = format!("{name}: line {number}: ");
        calibrate.assert().code(1).stderr(contains(place));
    }
}

/// The truth of the shipped observations with one replacement.
fn edited_truth(from: &str, to: &str) -> File {
    let truth = fs::read_to_string(synthetic_folder().join("truth/camera.json")).unwrap();
    let edited = truth.replacen(from, to, 1);
    assert_ne!(truth, edited, "{from}");
    file("camera.json", edited)
}

#[test]
fn a_camera_has_no_other_keys_and_possible_values() {
    for (from, to, words) in [
        ("\"sensor\"", "\"sensr\"", &["'sensr'", "did you mean 'sensor'?"][..]),
        ("\"version\"", "\"colour\": 1, \"version\"", &["'colour' is not a key", "leave it out"]),
        (
            "\"pitch_mm\"",
            "\"pich_mm\"",
            &["micro_lens_array", "`pich_mm`: did you mean `pitch_mm`?"],
        ),
        ("\"version\": 1", "\"version\": \"1\"", &["has to be a number", "\"version\": 2"]),
        ("\"version\": 1", "\"converged\": true", &["has no version"]),
        ("\"focal_length_mm\": 16.2", "\"focal_length_mm\": 1e308", &["F (mm)", "correct it"]),
        ("\"width_px\": 1000", "\"width_px\": 600000", &["450000000", "268435456"]),
        ("\"width_px\": 1000", "\"width_px\": -1", &["width_px", "a whole number from 0"]),
        (
            "\"version\": 1",
            "\"version\": 1, \"boards\": {\"near_mm\": 90, \"far_mm\": 80}",
            &["near_mm is 90", "far_mm is 80"],
        ),
    ] {
        let camera = edited_truth(from, to);
        assert_refused(read_camera_source(&camera.path), &[&["camera.json"], words].concat());
    }
    let nothing = file("camera.json", "null");
    assert_refused(read_camera_source(&nothing.path), &["camera.json", "it contains only null"]);
    let beside = edited_truth(
        "\"version\": 1",
        "\"version\": 1, \"converged\": true, \"boards\": {\"near_mm\": 80, \"far_mm\": 90}, \
         \"uncertainty\": {}, \"verdict\": {}, \"depth_from_blur\": {}",
    );
    assert!(read_camera_source(&beside.path).is_ok());
}

#[test]
fn the_array_of_a_camera_is_not_turned_by_degrees() {
    let mut camera = true_camera();
    camera.mla.rotation_rad.z = 90.0;
    let document = plenocal::io::camera_document(&camera, None).to_string();
    let camera = file("camera.json", document);
    assert_refused(read_camera(&camera.path), &["camera.json", "rotation_rad", "degrees"]);
    let mut tilted = true_camera();
    tilted.main_lens.rotation_rad[1] = -1.6;
    let document = plenocal::io::camera_document(&tilted, None).to_string();
    let camera = file("camera.json", document);
    assert_refused(
        read_camera(&camera.path),
        &["camera.json", "main lens", "(0, -1.6)", "degrees"],
    );
}

#[test]
fn boards_lie_before_the_camera_once_each() {
    let poses = |of: &[(u32, f64)]| {
        let pose = |&(frame, z): &(u32, f64)| {
            format!(
                "{{\"frame\": {frame}, \"camera_from_board\": {{\"rotation_vector_rad\": [0, 0, 0], \
                 \"translation_mm\": [0, 0, {z}]}}}}"
            )
        };
        let all: Vec<String> = of.iter().map(pose).collect();
        let all = all.join(", ");
        let head = "\"format\": \"plenocal-poses\", \"version\": 1";
        file("poses.json", format!("{{{head}, \"poses\": [{all}]}}"))
    };
    assert!(read_poses(&poses(&[(0, 80.0), (1, 80.0)]).path).is_ok());
    for (of, words) in [
        ([(0, 80.0), (0, 120.0)], ["frame 0", "two poses"]),
        ([(0, 80.0), (1, 0.12)], ["frame 1", "not in m"]),
        ([(0, 80.0), (1, -90.0)], ["frame 1", "behind the camera"]),
    ] {
        assert_refused(read_poses(&poses(&of).path), &[&["poses.json"], &words[..]].concat());
    }
}

#[test]
fn tables_of_other_programs_are_recognised() {
    for (text, words) in [
        (&b"k;l;u;v\n1;2;3,5;4,5\n"[..], &["commas", "points"][..]),
        (b"k\tl\tu\tv\n1\t2\t3.5\t4.5\n", &["not by tabs"]),
        (b"k,l,u,v\n1,2,3,5,4,5\n", &["line 2", "6 columns", "decimal commas"]),
        (b"k,l,u,v\n1,2,\"3,5\",4.5\n", &["line 2", "'3,5'", "write decimals with points"]),
        (b"k,l,u,v,std_dev\n1,2,3,4,1e-300\n", &["line 2", "has to be at least"]),
        (b"\xff\xfek\0,\0l\0", &["UTF-16", "save it as UTF-8"]),
        (b"k,l,u,v\n1,2,3,4\n\xe9,2,3,4\n", &["not encoded in UTF-8"]),
    ] {
        let centers = file("centers.csv", text);
        assert_refused(read_centers(&centers.path), &[&["centers.csv"], words].concat());
    }
    let marked = file("centers.csv", b"\xef\xbb\xbfk,l,u,v\n1,2,3.5,4.5\n");
    assert_eq!(read_centers(&marked.path).unwrap().len(), 1);
}

#[test]
fn a_folder_names_the_file_in_it() {
    let folder = TempDir::new().unwrap();
    let refused = |words: &[&str]| assert_refused(Project::read(folder.path()), words);
    refused(&["it is a folder: give a file"]);
    fs::write(folder.path().join("project.toml"), documents::PROJECT).unwrap();
    refused(&["it is a folder: give", "project.toml"]);
}

/// Where a camera is meant, the cameras in a folder are named, and not its project.
#[test]
fn a_folder_names_the_cameras_in_it() {
    let folder = TempDir::new().unwrap();
    let compared = || {
        let camera = synthetic_folder().join("truth/camera.json");
        plenocal().arg("compare").arg(camera).arg(folder.path()).assert().failure()
    };
    fs::write(folder.path().join("project.toml"), documents::PROJECT).unwrap();
    compared().stderr(contains("it is a folder").and(contains("no calibrated camera")));
    let results = folder.path().join("results/calibration");
    fs::create_dir_all(&results).unwrap();
    let camera = results.join("camera.json");
    fs::write(&camera, "{}").unwrap();
    let named = camera.display().to_string();
    compared().stderr(contains(named).and(contains("project.toml").not()));
}

#[test]
fn a_prior_far_from_the_start_is_named() {
    let folder = TempDir::new().unwrap();
    let mut command = plenocal();
    command.arg("calibrate").arg(synthetic_folder().join("project.toml"));
    command.args(["--prior", "F=1000:0.1", "--out"]).arg(folder.path()).assert().failure().stderr(
        contains("the prior F = 1000.00 ± 0.10 mm is far from the start")
            .and(contains("check its value and its unit")),
    );
}

#[test]
fn corners_numbered_by_columns_are_refused() {
    let folder = TempDir::new().unwrap();
    let features = fs::read_to_string(synthetic_folder().join("features.csv")).unwrap();
    let mut lines = features.lines();
    let header = lines.next().unwrap();
    let column = header.split(',').position(|name| name == "cluster").unwrap();
    let renumbered = lines.map(|line| {
        let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
        let corner: i32 = cells[column].parse().unwrap();
        cells[column] = (corner % 9 * 5 + corner / 9).to_string();
        cells.join(",")
    });
    let lines: Vec<String> = std::iter::once(header.to_owned()).chain(renumbered).collect();
    let file = folder.path().join("features.csv");
    fs::write(&file, lines.join("\n")).unwrap();
    let mut command = plenocal();
    command.arg("calibrate").arg(synthetic_folder().join("project.toml")).arg("--features");
    command
        .arg(&file)
        .arg("--out")
        .arg(folder.path().join("out"))
        .assert()
        .failure()
        .stderr(contains("column by column").and(contains("corner = row · columns + column")));
}

#[test]
fn range_errors_of_a_project_name_its_key() {
    for (from, to, words) in [
        ("f_number = 2.8", "f_number = 0.0", "f_number"),
        ("width_px = 1000", "width_px = 0", "width_px"),
        ("pixel_size_mm = 0.0055", "pixel_size_mm = -1.0", "pixel_size_mm"),
        ("focus_distance_mm = inf", "focus_distance_mm = -120.0", "focus_distance_mm"),
        ("loss_scale = 3.0", "loss_scale = 0.0", "loss_scale"),
        ("threads = 1", "threads = 0", "threads is 0"),
        ("uv_std_dev_px = 0.1", "uv_std_dev_px = 1e-300", "has to be at least"),
        ("columns = 43", "columns = 4.5", "a whole number from"),
    ] {
        let project = documents::PROJECT.replacen(from, to, 1);
        assert_ne!(project, documents::PROJECT, "{from}");
        let project = file("project.toml", project);
        assert_refused(read_camera_source(&project.path), &["project.toml", words]);
    }
}

/// A data set of few images.
fn simulate(folder: &Path, boards: &str, force: &[&str]) -> assert_cmd::assert::Assert {
    let few = ["rays=1", "boards.evaluation=0", "translation.images=0", boards];
    let mut command = plenocal();
    command.arg("simulate").args(few.iter().flat_map(|set| ["--set", set])).args(force);
    command.arg("--out").arg(folder).assert()
}

#[test]
fn a_data_set_is_replaced_only_when_asked_for() {
    let folder = TempDir::new().unwrap();
    let at = |name: &str| folder.path().join(name);
    simulate(folder.path(), "boards.calibration=3", &[]).success();
    fs::write(at("project.toml"), "edited").unwrap();
    fs::write(at("calibration/mine.png"), "mine").unwrap();
    simulate(folder.path(), "boards.calibration=1", &[]).code(1).stderr(contains("--force"));
    assert_eq!(fs::read_to_string(at("project.toml")).unwrap(), "edited");
    simulate(folder.path(), "boards.calibration=1", &["--force"]).success();
    assert!(Project::read(&at("project.toml")).is_ok());
    // The boards of the first set are none of the second.
    assert!(at("calibration/calibration-00.png").exists() && at("calibration/mine.png").exists());
    assert!(!at("calibration/calibration-01.png").exists());
    simulate(folder.path(), "boards.calibration=0", &["--force"]).success();
    assert!(!at("observed").exists() && !at("truth/calibration").exists());
    assert!(at("calibration/mine.png").exists());
}

#[test]
fn a_simulation_has_no_more_given_poses_than_images() {
    let settings = Settings::preset("mini", &[]).unwrap();
    let pose = |frame| FramePose { frame, ..true_poses()[0] };
    let plan = |count: u32| DataSet::plan(&settings, Some((0..count).map(pose).collect()));
    assert!(plan(1000).is_ok());
    assert_refused(plan(1001), &["1001 images of one kind", "at most 1000"]);
}

#[test]
fn standard_deviations_of_a_camera_are_possible() {
    let of = |value: &str| {
        let mut camera = documents::CALIBRATED[0].clone();
        let value: serde_json::Value = serde_json::from_str(value).unwrap();
        camera["uncertainty"]["standard_deviations"]["F"]["value"] = value;
        file("camera.json", camera.to_string())
    };
    assert!(read_std_devs(&of("0.01").path, 3).unwrap()[0].is_some());
    assert_eq!(read_std_devs(&of("null").path, 3).unwrap()[0], None);
    for value in ["0", "-0.01", "5e-324", "1e300"] {
        let words = ["camera.json", "standard_deviations.F is ", "null"];
        assert_refused(read_std_devs(&of(value).path, 3), &words);
    }
}

/// Squares of such lengths are 0: rays had no direction, and blur radii were infinite.
#[test]
fn lengths_of_a_camera_are_not_tiny() {
    let camera = true_camera();
    let pixels = [Vector2::new(500.0, 400.0)];
    assert!(pixel_rays(&camera, &pixels, 90.0).unwrap()[0].is_some());
    let mut short = camera.clone();
    short.main_lens.focal_length_mm = 1e-308;
    assert_refused(pixel_rays(&short, &pixels, 1.01e-308), &["1e-308", "correct it"]);
    let mut strong = camera.clone();
    strong.mla.focal_lengths_mm[1] = 5e-324;
    let compared = compare_cameras((&camera, &[]), (&strong, &[]), &[80.0]);
    assert_refused(compared, &["5e-324", "correct it"]);
}

/// Of a damaged file the decoder takes fewer samples than the image has pixels.
#[test]
fn images_have_as_many_samples_as_pixels() {
    let tiff = corpus::images().swap_remove(1);
    // The tag of the channels is lost, and a strip is said to have 41667 rows.
    let mut damaged = tiff.clone();
    let place = |entry: &[u8]| tiff.windows(entry.len()).rposition(|part| part == entry).unwrap();
    damaged[place(&[0x15, 1, 3, 0])] = 0;
    damaged[place(&[0x15, 1, 3, 0]) + 1] = 0;
    let rows = place(&[0x16, 1, 4, 0]) + 8;
    damaged[rows..rows + 3].copy_from_slice(&[0xc3, 0xa2, 0]);
    for bytes in [tiff, damaged] {
        let file = file("image.tif", bytes);
        if let Ok(image) = read_image(&file.path, None) {
            let Samples::Bits8(samples) = image.samples else { panic!("of 8 bits") };
            assert_eq!(samples.len(), image.width * image.height);
        }
    }
}
