//! A calibrated camera in use: what `rays`, `points`, `compare`, `extrinsics` and `evaluate` compute of files one of which is
//! damaged.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use nalgebra::Vector2;
use plenocal::assessment::{
    Candidate, EvaluationInput, assess, check_camera, check_corners, check_places,
    check_virtual_points, compare_cameras, evaluate,
};
use plenocal::calibration::{CalibrationOptions, Start, calibrate};
use plenocal::detection::MicroImages;
use plenocal::io::{
    CameraSource, VirtualDepths, read_board, read_board_shape, read_camera_source, read_centers,
    read_features, read_internal_parameters, read_point_cloud_distance, read_poses, read_std_devs,
    read_true_board, read_virtual_depths, write_centers, write_features,
};
use plenocal::model::{Board, Observations, PlenopticCamera};
use plenocal::precalibration::MicroImageArray;
use plenocal::solver::{
    MetricPoint, MicroPixel, Ray, VirtualPoint, corners, focused_points, metric_points,
    micro_images_at, pixel_rays,
};
use plenocal::{Error, Result};
use rand::RngExt;
use rand::rngs::StdRng;
use serde_json::Value;

use super::corpus::{self, BOARD};
use super::documents;
use super::mutation::damaged;
use super::readers::Target;

/// Files that are read together; of a case, one of them is damaged.
pub struct Set {
    /// Reads the files in a folder and computes.
    pub target: Target,
    /// Names and valid content.
    files: fn() -> Vec<(&'static str, Vec<u8>)>,
}

/// All uses of a camera.
pub static SETS: [Set; 5] = [
    Set { target: of("camera: rays", |case| used(case, &RAYS, rays)), files: || RAYS.clone() },
    Set {
        target: of("camera: points", |case| used(case, &POINTS, points)),
        files: || POINTS.clone(),
    },
    Set {
        target: of("camera: compare", |case| used(case, &COMPARE, compare)),
        files: || COMPARE.clone(),
    },
    Set {
        target: of("camera: extrinsics", |case| used(case, &EXTRINSICS, extrinsics)),
        files: || EXTRINSICS.clone(),
    },
    Set {
        target: of("camera: evaluate", |case| used(case, &EVALUATE, evaluation)),
        files: || EVALUATE.clone(),
    },
];

const fn of(name: &'static str, read: fn(&Path) -> Result<String>) -> Target {
    Target { name, file: "case", seeds: Vec::new, read }
}

impl Set {
    /// A damaged case: the number of the file and its bytes.
    pub fn case(&self, random: &mut StdRng) -> Vec<u8> {
        let files = (self.files)();
        let file = random.random_range(0..files.len());
        let mut case = vec![u8::try_from(file).expect("few files")];
        case.extend(damaged(&files[file].1, random));
        case
    }

    /// The valid files, as cases.
    pub fn valid(&self) -> Vec<Vec<u8>> {
        let numbered = (0..).zip((self.files)());
        numbered.map(|(number, (_, bytes))| [vec![number], bytes].concat()).collect()
    }
}

type Files = LazyLock<Vec<(&'static str, Vec<u8>)>>;

/// Writes the files of a case and uses them. An error of the checks names values rather than files, and gets the name of the
/// case.
fn used(case: &Path, files: &Files, use_of: impl Fn(&Folder) -> Result<String>) -> Result<String> {
    let bytes = fs::read(case).expect("the case is there");
    let folder = case.with_extension("set");
    fs::create_dir_all(&folder).expect("a folder can be made");
    let damaged = usize::from(bytes[0]);
    for (i, (name, valid)) in files.iter().enumerate() {
        let content = if i == damaged { &bytes[1..] } else { valid };
        fs::write(folder.join(name), content).expect("a file can be written");
    }
    let folder = Folder { path: folder, damaged: files[damaged].0 };
    use_of(&folder).map_err(|e| Error::invalid(format!("{}: {e}", case.display())))
}

/// The files of a case.
struct Folder {
    path: PathBuf,
    damaged: &'static str,
}

impl Folder {
    fn file(&self, name: &str) -> PathBuf {
        self.path.join(name)
    }

    /// The damaged file if it is one of several kinds that take turns, otherwise the first of these.
    fn one_of(&self, names: &[&str]) -> PathBuf {
        let damaged = names.iter().find(|name| **name == self.damaged);
        self.file(damaged.unwrap_or(&names[0]))
    }

    fn camera(&self) -> Result<PlenopticCamera> {
        calibrated(&self.one_of(&CAMERAS))
    }
}

/// Reads a camera as the commands do.
fn calibrated(path: &Path) -> Result<PlenopticCamera> {
    match read_camera_source(path)? {
        CameraSource::Camera(camera) => Ok(*camera),
        CameraSource::Datasheet(_) => Err(Error::invalid("a datasheet").in_file(path)),
    }
}

/// Kinds of camera files.
const CAMERAS: [&str; 3] = ["camera.json", "calibrated.json", "intrinsics.js"];

fn cameras() -> Vec<(&'static str, Vec<u8>)> {
    let [shipped, calibrated, intrinsics, ..] =
        <[Vec<u8>; 6]>::try_from(corpus::cameras()).expect("six");
    CAMERAS.into_iter().zip([shipped, calibrated, intrinsics]).collect()
}

static RAYS: Files = LazyLock::new(cameras);

/// Pixels all over a sensor, and beside it.
fn pixels(camera: &PlenopticCamera) -> Vec<Vector2<f64>> {
    let along = |size: u32| (-1..8).map(move |i| f64::from(size) * f64::from(i) / 6.0);
    let sensor = &camera.sensor;
    along(sensor.height_px)
        .flat_map(|v| along(sensor.width_px).map(move |u| Vector2::new(u, v)))
        .collect()
}

/// Distances that a camera is asked for, mm.
fn distances(camera: &PlenopticCamera) -> [f64; 3] {
    [1.01, 6.0, 1e4].map(|lengths| lengths * camera.main_lens.focal_length_mm)
}

fn rays(folder: &Folder) -> Result<String> {
    let camera = folder.camera()?;
    let pixels = pixels(&camera);
    let found = micro_images_at(&camera, &pixels)?;
    let lattice = &camera.lattice;
    for (k, l) in found.iter().flatten() {
        assert!((0..lattice.columns).contains(k) && (0..lattice.rows).contains(l), "{k}, {l}");
    }
    let mut all = Vec::new();
    for at_mm in distances(&camera) {
        let rays = pixel_rays(&camera, &pixels, at_mm)?;
        rays.iter().flatten().for_each(check_ray);
        all.extend(rays);
    }
    Ok(format!("{all:?}"))
}

/// What is read as single-precision numbers has to be a ray too.
fn check_ray(ray: &Ray) {
    let length = ray.direction.iter().map(|x| x * x).sum::<f64>().sqrt();
    assert!((length - 1.0).abs() < 1e-9 && ray.direction[2] > 0.0, "no direction: {ray:?}");
    assert!(ray.origin_mm.iter().all(|x| x.abs() < f64::from(f32::MAX)), "beyond f32: {ray:?}");
}

/// Kinds of files of virtual depths, and features.
const DEPTHS: [&str; 8] = [
    "depths.csv",
    "std-devs.csv",
    "features.csv",
    "single.npy",
    "double.npy",
    "depths.png",
    "depths.tif",
    "depths.bmp",
];

static POINTS: Files = LazyLock::new(|| {
    let depths = DEPTHS.into_iter().zip(corpus::virtual_depths());
    cameras().into_iter().chain(depths).collect()
});

fn points(folder: &Folder) -> Result<String> {
    let camera = folder.camera()?;
    let path = folder.one_of(&DEPTHS);
    let std_dev = [0.1, 0.1, 0.02];
    let mut found: Vec<Option<MetricPoint>> = Vec::new();
    let mut findings = Vec::new();
    match read_virtual_depths(&path, Some([0.0, 0.01]), std_dev)? {
        VirtualDepths::Points(seen) => {
            findings.extend(check_virtual_points(&camera, &seen)?);
            found.extend(metric_points(&camera, &seen)?);
        }
        VirtualDepths::Features => {
            let features = read_features(&path, false)?.features;
            let of_boards = corners(&camera, &features)?;
            let at = |f: &plenocal::model::BapFeature| MicroPixel {
                k: f.k,
                l: f.l,
                u_px: f.u_px,
                v_px: f.v_px,
            };
            findings.extend(check_places(&camera, features.iter().map(at))?);
            findings.extend(check_corners(&of_boards, &features));
            found.extend(of_boards.points);
        }
        VirtualDepths::Map(mut map) => {
            // In a map, NaN stands for none.
            let depths = map.next(1000)?;
            let seen: Vec<VirtualPoint> = (0..)
                .zip(depths.into_iter().filter(|depth| depth.is_finite()))
                .map(|(i, virtual_depth)| VirtualPoint {
                    at: MicroPixel { k: -1, l: -1, u_px: f64::from(i), v_px: f64::from(i) },
                    virtual_depth,
                    std_dev,
                })
                .collect();
            found.extend(focused_points(&camera, &seen)?);
            found.extend(metric_points(&camera, &seen)?);
        }
    }
    for point in found.iter().flatten() {
        let std_devs = point.std_devs_mm();
        assert!(std_devs.iter().all(|s| s.is_finite()), "no σ: {point:?}");
        let numbers = point.point_mm.iter().chain(&std_devs);
        assert!(
            numbers.into_iter().all(|x| x.abs() < f64::from(f32::MAX)),
            "beyond f32: {point:?}"
        );
    }
    Ok(format!("{found:?} {findings:?}"))
}

/// The camera that others are compared with.
const TRUTH: &str = "truth.json";

fn with_truth() -> Vec<(&'static str, Vec<u8>)> {
    let mut files = cameras();
    files.push((TRUTH, files[0].1.clone()));
    files
}

static COMPARE: Files = LazyLock::new(with_truth);

fn compare(folder: &Folder) -> Result<String> {
    let path = folder.one_of(&CAMERAS);
    let (camera, truth) = (calibrated(&path)?, calibrated(&folder.file(TRUTH))?);
    let std_devs = read_std_devs(&path, camera.lens_types())?;
    let at = distances(&truth);
    let there = compare_cameras((&truth, &[]), (&camera, &std_devs), &at)?;
    let back = compare_cameras((&camera, &std_devs), (&truth, &[]), &at);
    Ok(format!("{there:?} {:?}", back.ok()))
}

/// Frames and features of each, enough for poses.
const FRAMES: u32 = 2;
const FEATURES: usize = 40;

/// A camera with what belongs to it: white images and few features.
fn of_boards() -> Vec<(&'static str, Vec<u8>)> {
    let all = corpus::observations();
    let mut features = Vec::new();
    for frame in 0..FRAMES {
        let of_frame = all.features.iter().filter(|f| f.frame == frame);
        features.extend(of_frame.step_by(6).take(FEATURES).copied());
    }
    let centers: Vec<_> = all.centers.iter().step_by(12).copied().collect();
    let [mut features_csv, mut centers_csv] = [Vec::new(), Vec::new()];
    write_features(&mut features_csv, &features).expect("memory can be written");
    write_centers(&mut centers_csv, &centers).expect("memory can be written");
    let text = |document: &Value| document.to_string().into_bytes();
    let [_, poses, calibration] = &*documents::CALIBRATED;
    let mut files = with_truth();
    files.extend([
        ("features.csv", features_csv),
        ("centers.csv", centers_csv),
        ("precalibration.json", text(&documents::precalibration())),
        ("calibration.json", text(calibration)),
        ("scene.js", documents::SCENE.into()),
        ("poses.json", text(poses)),
    ]);
    files
}

static EXTRINSICS: Files = LazyLock::new(of_boards);

/// Larger boards take long, and are of `solving`.
fn board(folder: &Folder) -> Result<Board> {
    let board = read_board(&folder.file("scene.js"))?;
    Ok(if board.columns.max(board.rows) > 100 { BOARD } else { board })
}

fn extrinsics(folder: &Folder) -> Result<String> {
    let camera = folder.camera()?;
    let sheet = corpus::datasheet();
    let internal = read_internal_parameters(
        &folder.file("precalibration.json"),
        Some(sheet.sensor.pixel_size_mm),
    )?;
    let centers = read_centers(&folder.file("centers.csv"))?;
    let micro_images = MicroImages::of_measurements(&centers, &internal, &sheet)?;
    let grid: &MicroImageArray = &micro_images.grid;
    let findings = check_camera(&camera, &sheet, grid, &internal)?;
    let board = board(folder)?;
    let shape = read_board_shape(&folder.file("calibration.json"), &board)?;
    let features = read_features(&folder.file("features.csv"), false)?.features;
    let observations = Observations { features, ..Observations::default() };
    let options = CalibrationOptions { threads: 1, max_iterations: 3, ..Default::default() }
        .of_poses_only(shape.unwrap_or_default().0);
    let result = calibrate(&Start::Camera(camera), &board, &observations, &options, &mut |_| true)?;
    let assessment = assess(&result, &board)?;
    let poses = &result.poses;
    let of_pose = |i| result.uncertainty.pose_std_devs(i);
    let std_devs: Vec<[f64; 6]> = (0..poses.len()).map(of_pose).collect();
    Ok(format!("{findings:?} {poses:?} {std_devs:?} {:?}", assessment.findings))
}

static EVALUATE: Files = LazyLock::new(|| {
    let mut files = of_boards();
    files.retain(|(name, _)| !["centers.csv", "precalibration.json"].contains(name));
    files.push(("board.toml", documents::BOARD_SHAPE.into()));
    files.push(("cloud.xyz", corpus::clouds().swap_remove(0)));
    files
});

fn evaluation(folder: &Folder) -> Result<String> {
    let path = folder.one_of(&CAMERAS);
    let camera = calibrated(&path)?;
    let std_devs = read_std_devs(&path, camera.lens_types())?;
    let board = board(folder)?;
    let shape = read_board_shape(&folder.file("calibration.json"), &board)?;
    let (board_shape, shape_std_devs) = shape.unwrap_or_default();
    let name = "camera".to_owned();
    let candidate = Candidate { name, camera, std_devs, board_shape, shape_std_devs };
    let features = read_features(&folder.file("features.csv"), false)?.features;
    let cloud_mm = read_point_cloud_distance(&folder.file("cloud.xyz"))?;
    let input = EvaluationInput {
        evaluation: features.clone(),
        translation: Some((features, 5.0)),
        clouds_mm: vec![(0, cloud_mm), (1, 4.0)],
        truth: Some(calibrated(&folder.file(TRUTH))?),
        true_board: Some(read_true_board(&folder.file("board.toml"))?),
        evaluation_poses: Some(read_poses(&folder.file("poses.json"))?),
        ..EvaluationInput::new(board)
    };
    let evaluation = evaluate(&[candidate], &input, &|| ());
    Ok(format!("{evaluation:?}"))
}
