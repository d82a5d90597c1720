//! A calibrated camera in use: rays of its pixels, and metric points.

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};

use nalgebra::{Matrix3, Point3, Vector2, Vector3};
use plenocal::Issue;
use plenocal::assessment::{check_camera, pose_boards};
use plenocal::io::write_features;
use plenocal::model::{Board, Noise, PlenopticCamera, optics};
use plenocal::precalibration::fit_grid;
use plenocal::solver::{MicroPixel, VirtualPoint, metric_points, micro_images_at, object_rays};
use predicates::prelude::PredicateBooleanExt as _;
use predicates::str::contains;
use serde_json::Value;
use tempfile::TempDir;

use crate::support::{
    board, codes, drawn, plenocal, project, shipped_observations, synthetic_folder, true_camera,
    true_poses,
};

/// Noise of u and v in the shipped set, px.
const NOISE_PX: f64 = 0.2;

fn camera_file() -> PathBuf {
    synthetic_folder().join("truth/camera.json")
}

/// The numbers of a `.npy` file of 32 or 64 bits.
fn npy(path: &Path, double: bool) -> Vec<f64> {
    let bytes = fs::read(path).unwrap();
    let begin = 10 + usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
    let data = &bytes[begin..];
    if double {
        data.chunks_exact(8).map(|b| f64::from_le_bytes(b.try_into().unwrap())).collect()
    } else {
        data.chunks_exact(4).map(|b| f64::from(f32::from_le_bytes(b.try_into().unwrap()))).collect()
    }
}

fn write_npy(path: &Path, width: usize, height: usize, values: &[f64]) {
    let header = plenocal::io::NpyHeader::floats(true, &[height, width]);
    let mut bytes = Vec::new();
    header.write(&mut bytes).unwrap();
    bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
    fs::write(path, bytes).unwrap();
}

#[test]
fn every_pixel_of_the_array_has_a_ray() {
    let folder = TempDir::new().unwrap();
    let run = |more: &[&str]| {
        let mut command = plenocal();
        command.arg("rays").arg(camera_file()).args(["--at", "90"]).args(more);
        command.arg("--out").arg(folder.path()).assert().success()
    };
    run(&["--double", "--micro-images", "--json"]);
    let camera = true_camera();
    let (width, height) = (camera.sensor.width_px as usize, camera.sensor.height_px as usize);
    let rays = npy(&folder.path().join("rays.npy"), true);
    assert_eq!(rays.len(), 6 * width * height);
    let document: Value =
        serde_json::from_slice(&fs::read(folder.path().join("rays.json")).unwrap()).unwrap();
    let count = rays.chunks_exact(6).filter(|ray| ray[0].is_finite()).count();
    assert_eq!(document["rays"], count);
    assert!(count > 9 * width * height / 10, "{count}");
    let bytes = fs::read(folder.path().join("micro-images.npy")).unwrap();
    let indices = &bytes[bytes.len() - 8 * width * height..];
    let index = |i: usize| i32::from_le_bytes(indices[4 * i..4 * i + 4].try_into().unwrap());
    for (u, v) in [(300, 200), (512, 400), (777, 555)] {
        let i = v * width + u;
        let (k, l) = (index(2 * i), index(2 * i + 1));
        let pixel = MicroPixel { k, l, u_px: u as f64, v_px: v as f64 };
        let ray = object_rays(&camera, &[pixel], 90.0).unwrap()[0].unwrap();
        assert_eq!(&rays[6 * i..6 * i + 3], ray.origin_mm);
        assert_eq!(&rays[6 * i + 3..6 * i + 6], ray.direction);
        let norm = Vector3::from(ray.direction).norm();
        assert!((norm - 1.0).abs() < 1e-12 && ray.direction[2] > 0.0);
    }
    // Rays hardly bend, least near the axis.
    for bend in document["bend"].as_array().unwrap() {
        assert!(bend["rms_mm"].as_f64().unwrap() < 0.03, "{bend}");
        assert!(bend["largest_mm"].as_f64().unwrap() < 0.3, "{bend}");
    }
    run(&[]);
    let single = npy(&folder.path().join("rays.npy"), false);
    let off = |(a, b): (&f64, &f64)| (a - b).abs();
    let off = rays.iter().zip(&single).map(off).filter(|x| x.is_finite()).fold(0.0, f64::max);
    assert!(off > 0.0 && off < 1e-5, "{off}");
}

/// χ² of the corners against where they are, by the covariance of what was measured: the camera is the true one.
#[test]
fn corners_are_triangulated_as_well_as_their_covariance_says() {
    let folder = TempDir::new().unwrap();
    let mut features = shipped_observations().features;
    for f in &mut features {
        f.std_dev_px = Some([NOISE_PX; 2]);
    }
    let mut text = Vec::new();
    write_features(&mut text, &features).unwrap();
    let path = folder.path().join("features.csv");
    fs::write(&path, text).unwrap();
    let out = folder.path().join("points");
    let mut command = plenocal();
    command.arg("points").arg(camera_file()).arg(&path).args(["--csv", "--out"]).arg(&out);
    command.assert().success().stdout(contains("points"));
    let poses = true_poses();
    let corner = |frame: u32, corner: i32| -> Point3<f64> {
        let pose = poses.iter().find(|p| p.frame == frame).unwrap();
        pose.camera_from_board * board().point_mm(corner)
    };
    let (mut square, mut chi_square, mut count) = (Vector3::zeros(), 0.0, 0.0);
    for line in fs::read_to_string(out.join("points.csv")).unwrap().lines().skip(1) {
        let numbers: Vec<f64> = line.split(',').map(|n| n.parse().unwrap()).collect();
        let [frame, number, x, y, z, sx, sy, sz, xy, xz, yz] = numbers[..] else {
            panic!("{line}")
        };
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        let truth = corner(frame as u32, number as i32);
        let off = Point3::new(x, y, z) - truth;
        square += Matrix3::from_diagonal(&Vector3::new(sx, sy, sz).map(|s| s.powi(-2)))
            * off.component_mul(&off);
        let information =
            Matrix3::new(sx * sx, xy, xz, xy, sy * sy, yz, xz, yz, sz * sz).try_inverse().unwrap();
        chi_square += off.dot(&(information * off));
        count += 1.0;
    }
    assert!(count > 100.0, "{count}");
    for per_axis in (square / count).iter() {
        assert!((0.8..1.25).contains(per_axis), "{:?}", square / count);
    }
    let per_freedom: f64 = chi_square / (3.0 * count);
    assert!((0.8..1.25).contains(&per_freedom), "{per_freedom}");
    let ply = fs::read(out.join("points.ply")).unwrap();
    assert!(String::from_utf8_lossy(&ply[..200]).contains(&format!("element vertex {count}")));
}

#[test]
fn virtual_depths_become_points() {
    let folder = TempDir::new().unwrap();
    let path = |name: &str| folder.path().join(name);
    let camera = true_camera();
    let at = MicroPixel { k: 20, l: 18, u_px: 500.0, v_px: 400.0 };
    let seen = VirtualPoint { at, virtual_depth: 3.0, std_dev: [0.1, 0.1, 0.02] };
    let expected = metric_points(&camera, &[seen]).unwrap()[0].unwrap();
    let mut csv = "k,l,u,v,nu\n".to_owned();
    // The second has no image at that depth.
    for depth in [3.0, -1e4] {
        writeln!(csv, "20,18,500,400,{depth}").unwrap();
    }
    fs::write(path("nu.csv"), csv).unwrap();
    let (width, height) = (camera.sensor.width_px as usize, camera.sensor.height_px as usize);
    let mut map = vec![f64::NAN; width * height];
    map[400 * width + 500] = 3.0;
    write_npy(&path("map.npy"), width, height, &map);
    let run = |input: &str, more: &[&str]| {
        let mut command = plenocal();
        command.arg("points").arg(camera_file()).arg(path(input)).args(["--csv", "--json"]);
        command.args(["--uv-std-dev", "0.1", "--depth-std-dev", "0.02"]).args(more);
        let output = command.arg("--out").arg(path("out")).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let document: Value = serde_json::from_slice(&output.stdout).unwrap();
        let text = fs::read_to_string(path("out/points.csv")).unwrap();
        let line = text.lines().nth(1).unwrap().to_owned();
        (document, line.split(',').map(|n| n.parse::<f64>().unwrap()).collect::<Vec<f64>>())
    };
    let (document, of_csv) = run("nu.csv", &[]);
    assert_eq!((&document["points"], &document["without_point"]), (&1.into(), &1.into()));
    for (axis, found) in of_csv[2..5].iter().enumerate() {
        assert!((found - expected.point_mm[axis]).abs() < 1e-5);
        let std_dev = expected.std_devs_mm()[axis];
        assert!((of_csv[5 + axis] - std_dev).abs() < 1e-5, "{std_dev}");
    }
    let [_, xy, xz, _, _, yz, ..] = expected.covariance_mm2;
    for (found, expected) in of_csv[8..].iter().zip([xy, xz, yz]) {
        assert!((found - expected).abs() < 1e-3 * expected.abs(), "{found} for {expected}");
    }
    // The map has the micro-image from the pixel, which may be another one.
    let (_, of_map) = run("map.npy", &[]);
    assert_eq!(of_map[..2], [500.0, 400.0]);
    assert!((of_map[4] - of_csv[4]).abs() < 0.1 * of_csv[4], "{of_map:?} {of_csv:?}");
    // Half as many pixels of a total-focus image.
    let mut focused = vec![f64::NAN; width / 2 * (height / 2)];
    focused[200 * (width / 2) + 250] = 3.0;
    write_npy(&path("focused.npy"), width / 2, height / 2, &focused);
    let (_, of_focused) = run("focused.npy", &["--map", "focused"]);
    assert!((of_focused[4] - of_csv[4]).abs() < 0.01 * of_csv[4], "{of_focused:?} {of_csv:?}");
}

/// Points of a map are computed and written in several pieces, as many as its header says in the end.
#[test]
fn points_of_a_map_are_those_of_its_pixels() {
    const SPARSE: usize = 5;
    let folder = TempDir::new().unwrap();
    let path = |name: &str| folder.path().join(name);
    let camera = true_camera();
    let (width, height) = (camera.sensor.width_px as usize, camera.sensor.height_px as usize);
    let nu = |i: usize| 2.5 + (i % width) as f64 / 1e3;
    let depth = |i: usize| if i.is_multiple_of(SPARSE) { nu(i) } else { f64::NAN };
    let map: Vec<f64> = (0..width * height).map(depth).collect();
    write_npy(&path("map.npy"), width, height, &map);
    let mut command = plenocal();
    command.arg("points").arg(camera_file()).arg(path("map.npy")).args(["--csv", "--json"]);
    let output = command.arg("--out").arg(path("out")).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let document: Value = serde_json::from_slice(&output.stdout).unwrap();
    let pixels: Vec<usize> = (0..width * height).step_by(SPARSE).collect();
    let places: Vec<Vector2<f64>> =
        pixels.iter().map(|i| Vector2::new((i % width) as f64, (i / width) as f64)).collect();
    let at = micro_images_at(&camera, &places).unwrap();
    let seen: Vec<VirtualPoint> = pixels
        .iter()
        .zip(&places)
        .zip(at)
        .map(|((i, place), at)| {
            let (k, l) = at.unwrap_or((-1, -1));
            let at = MicroPixel { k, l, u_px: place.x, v_px: place.y };
            VirtualPoint { at, virtual_depth: map[*i], std_dev: [0.0; 3] }
        })
        .collect();
    let expected = metric_points(&camera, &seen).unwrap();
    let with_point =
        places.iter().zip(&expected).filter_map(|(place, point)| Some((place, (*point)?)));
    let csv = fs::read_to_string(path("out/points.csv")).unwrap();
    let mut lines = csv.lines().skip(1);
    let mut count = 0_usize;
    for (place, point) in with_point {
        let [x, y, z] = point.point_mm;
        let line = format!("{},{},{x:.6},{y:.6},{z:.6}", place.x, place.y);
        assert_eq!(lines.next(), Some(line.as_str()));
        count += 1;
    }
    assert_eq!(lines.next(), None);
    assert!(count > 100_000, "{count}");
    assert_eq!(document["points"], count);
    assert_eq!(document["without_point"], places.len() - count);
    let ply = fs::read(path("out/points.ply")).unwrap();
    let header = String::from_utf8_lossy(&ply[..300]).into_owned();
    assert!(header.contains(&format!("\nelement vertex {count}\n")), "{header}");
    let begin = header.find("end_header\n").unwrap() + "end_header\n".len();
    assert_eq!(ply.len() - begin, count * 20);
    let mut depths: Vec<f64> = expected.iter().flatten().map(|point| point.point_mm[2]).collect();
    depths.sort_by(f64::total_cmp);
    assert_eq!(document["distance_mm"]["median"], depths[(count - 1).div_ceil(2)]);
}

#[test]
fn what_cannot_be_used_is_named() {
    let folder = TempDir::new().unwrap();
    let path = |name: &str| folder.path().join(name);
    let fails = |arguments: &[&str], names: &str| {
        let mut command = plenocal();
        command
            .args(arguments)
            .arg("--out")
            .arg(path("out"))
            .assert()
            .code(1)
            .stderr(contains(names));
        assert!(!path("out").exists());
    };
    let camera = camera_file();
    let camera = camera.to_str().unwrap();
    fails(&["rays", camera, "--at", "10"], "focal length");
    fails(&["rays", camera, "--at", "nan"], "focal length");
    let project = synthetic_folder().join("project.toml");
    fails(&["rays", project.to_str().unwrap()], "calibrated one");
    write_npy(&path("small.npy"), 3, 2, &[3.0; 6]);
    let small = path("small.npy");
    fails(&["points", camera, small.to_str().unwrap()], "--map focused");
    let bytes = fs::read(&small).unwrap();
    fs::write(path("cut.npy"), &bytes[..bytes.len() - 8]).unwrap();
    let more = [&bytes[..], &[0; 8]].concat();
    fs::write(path("long.npy"), more).unwrap();
    for (name, kind) in [("cut.npy", "focused"), ("long.npy", "focused")] {
        let input = path(name);
        fails(&["points", camera, input.to_str().unwrap(), "--map", kind], "as its shape says");
    }
    fs::write(path("short.npy"), &bytes[..9]).unwrap();
    fails(&["points", camera, path("short.npy").to_str().unwrap()], "cut off");
    fs::write(path("nu.csv"), "k,l,u,v,nu\n20,18,500,400,-10000\n").unwrap();
    fails(&["points", camera, path("nu.csv").to_str().unwrap()], "no point");
    fs::write(path("uv.csv"), "k,l,u,v\n20,18,500,400\n").unwrap();
    fails(&["points", camera, path("uv.csv").to_str().unwrap()], "no column nu");
    let table = path("nu.csv");
    fails(&["points", table.to_str().unwrap(), table.to_str().unwrap()], "it is a CSV table");
    fs::write(path("nan.csv"), "k,l,u,v,nu\n20,18,500,400,nan\n").unwrap();
    fails(&["points", camera, path("nan.csv").to_str().unwrap()], "line 2");
    fails(&["points", camera, path("nu.csv").to_str().unwrap(), "--uv-std-dev", "-1"], "deviation");
    image::GrayImage::new(4, 4).save(path("map.png")).unwrap();
    fails(&["points", camera, path("map.png").to_str().unwrap()], "grey levels");
    image::RgbImage::new(4, 4).save(path("colors.png")).unwrap();
    let colors = path("colors.png");
    let colors = ["points", camera, colors.to_str().unwrap(), "--depth-scale", "0,0.1"];
    fails(&[&colors[..], &["--map", "focused"]].concat(), "three channels");
    fails(&["points", camera, path("none.npy").to_str().unwrap()], "none.npy");
}

/// Frames of two calibrations may be a rigid motion apart, which is told and taken out.
#[test]
fn a_calibration_is_compared_with_the_truth() {
    let folder = TempDir::new().unwrap();
    let path = |name: &str| folder.path().join(name);
    let mut command = plenocal();
    command.arg("calibrate").arg(synthetic_folder().join("project.toml"));
    command.arg("--out").arg(path("results")).assert().success();
    let compare = |second: &Path| {
        let mut command = plenocal();
        command.arg("compare").arg(path("results/camera.json")).arg(second);
        command
            .args(["--at", "80,80.1,120"])
            .arg("--out")
            .arg(path("comparison"))
            .assert()
            .success();
        let text = fs::read(path("comparison/comparison.json")).unwrap();
        serde_json::from_slice::<Value>(&text).unwrap()
    };
    let same = compare(&path("results/camera.json"));
    assert!(same["rms_px"].as_f64().unwrap() < 1e-6, "{same}");
    assert!(same["distances"][1]["along_mm"].as_f64().unwrap() < 1e-6, "{same}");
    assert_eq!(same["parameters"][0]["difference_in_std_devs"], 0.0);
    let truth = compare(&camera_file());
    let (with, without) = (&truth["rms_px"], &truth["rms_px_without_motion"]);
    assert!(with.as_f64().unwrap() < 0.3, "{truth}");
    // The boards were here.
    assert!(truth["distances"][0]["rms_px"].as_f64().unwrap() < 0.05, "{truth}");
    assert!(without.as_f64().unwrap() > 2.0 * with.as_f64().unwrap(), "{truth}");
    let parameters = truth["parameters"].as_array().unwrap();
    let apart = |p: &&Value| p["difference_in_std_devs"].as_f64().is_some_and(|d| d.abs() > 4.0);
    assert!(parameters.iter().find(apart).is_none(), "{truth}");
    assert!(path("comparison/shifts-80-mm.svg").is_file());
    assert!(path("comparison/shifts-80.1-mm.svg").is_file());
    // Another focal length is another camera.
    let text = fs::read_to_string(camera_file()).unwrap();
    let mut other: Value = serde_json::from_str(&text).unwrap();
    let longer = 1.02 * other["main_lens"]["focal_length_mm"].as_f64().unwrap();
    other["main_lens"]["focal_length_mm"] = longer.into();
    fs::write(path("other.json"), other.to_string()).unwrap();
    let other = compare(&path("other.json"));
    assert!(other["rms_px"].as_f64().unwrap() > 0.2, "{other}");
}

/// Finds squares that are 2 % too large, with the factor that the boards show, and nothing with the right ones.
#[test]
fn boards_show_the_size_of_their_squares() {
    let features = shipped_observations().features;
    let posed = |scale: f64| {
        let board = Board { square_mm: scale * board().square_mm, ..board() };
        pose_boards(&true_camera(), &board.into(), &features).unwrap().findings
    };
    assert_eq!(codes(&posed(1.0)), Vec::<&str>::new());
    for scale in [1.02, 0.98] {
        let findings = posed(scale);
        let fitted = findings.iter().find_map(|finding| match &finding.issue {
            Issue::SquaresContradicted { fitted_mm, .. } => Some(*fitted_mm),
            _ => None,
        });
        let fitted = fitted.unwrap_or_else(|| panic!("{:?}", codes(&findings)));
        let off = fitted.value - board().square_mm;
        assert!(off.abs() < 5.0 * fitted.std_dev && fitted.std_dev < 0.01, "{fitted}");
    }
}

/// Checks the true camera, and cameras that differ in one thing, against white images of the true one.
#[test]
fn white_images_show_another_camera() {
    let (truth, sheet) = (true_camera(), project().datasheet().unwrap().unwrap());
    let (columns, rows) = (truth.lattice.columns, truth.lattice.rows);
    let seen = drawn(&truth, &Noise::default(), 1);
    let grid = fit_grid(&seen.centers, truth.lattice.kind(), columns, rows).unwrap();
    let internal = optics::internal_parameters(&truth);
    let checked = |change: &dyn Fn(&mut PlenopticCamera)| {
        let mut camera = truth.clone();
        change(&mut camera);
        check_camera(&camera, &sheet, &grid, &internal)
    };
    let found = |change: &dyn Fn(&mut PlenopticCamera)| codes(&checked(change).unwrap());
    assert_eq!(found(&|_| {}), Vec::<&str>::new());
    assert_eq!(found(&|c| c.mla.focal_lengths_mm.swap(0, 2)), ["lens-types-contradicted"]);
    assert_eq!(found(&|c| c.mla.offset_mm.x += 0.02), ["centers-contradicted"]);
    assert_eq!(found(&|c| c.main_lens.focal_length_mm *= 1.03), ["slope-contradicted"]);
    // What is wrong with the centres does not hide the order of the lens types.
    let both = found(&|c| {
        c.mla.offset_mm.x += 0.02;
        c.mla.focal_lengths_mm.swap(0, 2);
    });
    assert_eq!(both, ["centers-contradicted", "lens-types-contradicted"]);
    for refused in [
        checked(&|c| c.lattice.columns += 1),
        checked(&|c| c.sensor.width_px += 1),
        checked(&|c| c.mla.focal_lengths_mm.truncate(1)),
    ] {
        let error = refused.unwrap_err().to_string();
        assert!(error.contains("belong to different cameras"), "{error}");
    }
}

#[test]
fn points_without_a_sigma_of_depths_have_none_and_impossible_ones_are_told() {
    let folder = TempDir::new().unwrap();
    let input = folder.path().join("depths.csv");
    let points = |rows: &str| {
        fs::write(&input, format!("k,l,u,v,nu\n{rows}")).unwrap();
        let mut command = plenocal();
        command.arg("points").arg(camera_file()).arg(&input).args(["--csv", "--out"]);
        command.arg(folder.path().join("points")).assert()
    };
    let center = center_of(20, 18);
    let good = format!("20,18,{},{},3\n", center[0], center[1]);
    points(&good).success().stderr(contains("[points-without-sigma]"));
    let csv = fs::read_to_string(folder.path().join("points/points.csv")).unwrap();
    assert!(csv.starts_with("k,l,x_mm,y_mm,z_mm\n"), "{csv}");
    let outside = format!("{good}-1,18,{0},{1},3\n", center[0], center[1]);
    points(&outside).success().stderr(contains("[outside-array]").and(contains("point 2")));
    let far = format!("{good}20,18,9,9,3\n");
    points(&far).success().stderr(contains("[far-from-micro-image]"));
    let sign = format!("{good}20,18,{0},{1},-3\n", center[0], center[1]);
    points(&sign).success().stderr(contains("[depths-of-other-sign]"));
    points("-1,18,9,9,3\n").code(1).stderr(contains("outside the array"));
    fs::write(&input, "k;l;u;v;nu\n").unwrap();
    let mut command = plenocal();
    command.arg("points").arg(camera_file()).arg(&input).arg("--out").arg(folder.path());
    command.assert().code(1).stderr(contains("separate the columns by commas"));
}

/// Centre of a micro-image of the true camera, px.
fn center_of(k: i32, l: i32) -> [f64; 2] {
    let seen = drawn(&true_camera(), &Noise::default(), 1);
    let center = seen.centers.iter().find(|c| (c.k, c.l) == (k, l)).unwrap();
    [center.u_px, center.v_px]
}

#[test]
fn cameras_with_other_micro_lenses_blur_differently() {
    let folder = TempDir::new().unwrap();
    let text = fs::read_to_string(camera_file()).unwrap();
    let mut other: Value = serde_json::from_str(&text).unwrap();
    other["micro_lens_array"]["focal_lengths_mm"].as_array_mut().unwrap().swap(0, 2);
    let path = folder.path().join("other.json");
    fs::write(&path, other.to_string()).unwrap();
    let mut command = plenocal();
    command.arg("compare").arg(camera_file()).arg(&path).assert().success().stdout(contains(
        "The two cameras project points alike, but blur them differently: pixels differ by 0.000 px RMS",
    ));
}
