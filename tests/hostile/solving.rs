//! Past the readers: what is read from damaged files goes into the checks of input, the projection and the solver.

use std::fs;
use std::path::Path;
use std::sync::LazyLock;

use plenocal::calibration::{CalibrationOptions, Mode, Start, calibrate};
use plenocal::io::{
    Project, camera_document, poses_document, read_camera, read_centers, read_features, read_poses,
};
use plenocal::model::{Board, FramePose, Noise, Observations};
use plenocal::solver::{distortion_mm, synthesize};
use plenocal::{Error, Result};
use rand::RngExt;
use rand::rngs::StdRng;

use super::corpus::{self, BOARD};
use super::mutation::damaged;
use super::readers::Target;

/// Files of a small set, one of which is damaged.
const FILES: [&str; 5] =
    ["features.csv", "centers.csv", "camera.json", "poses.json", "project.toml"];
/// Frames and features of each, enough for a solve.
const FRAMES: u32 = 2;
const FEATURES: usize = 60;
/// Micro-lenses of a camera that observations are drawn from: with more it takes minutes.
const MOST_MICRO_LENSES: i64 = 10_000;

static SET: LazyLock<[Vec<u8>; 5]> = LazyLock::new(|| {
    let all = corpus::observations();
    let mut features = Vec::new();
    for frame in 0..FRAMES {
        let of_frame = all.features.iter().filter(|f| f.frame == frame);
        features.extend(of_frame.step_by(4).take(FEATURES).copied());
    }
    let centers: Vec<_> = all.centers.iter().step_by(12).copied().collect();
    let poses: Vec<FramePose> = corpus::true_poses().into_iter().take(2).collect();
    let mut files: [Vec<u8>; 5] = Default::default();
    plenocal::io::write_features(&mut files[0], &features).expect("memory can be written");
    plenocal::io::write_centers(&mut files[1], &centers).expect("memory can be written");
    let text = |document: &serde_json::Value| document.to_string().into_bytes();
    files[2] = text(&camera_document(&corpus::true_camera(), None));
    files[3] = text(&poses_document(&poses, None, &std::collections::BTreeSet::new()));
    files[4] = corpus::projects().swap_remove(0);
    files
});

/// A solve with one damaged file; the case is the number of the file and its bytes.
pub const SOLVING: Target = Target {
    name: "solving",
    file: "case",
    seeds: Vec::new,
    // An error of the checks names a value rather than a file.
    read: |path| solve(path).map_err(|error| error.in_file(path).in_case(path)),
};

trait InCase {
    fn in_case(self, path: &Path) -> Error;
}

impl InCase for Error {
    /// Also names the case, in which a file has another name.
    fn in_case(self, path: &Path) -> Error {
        Error::invalid(format!("{}: {self}", path.display()))
    }
}

/// A damaged case.
pub fn case(random: &mut StdRng) -> Vec<u8> {
    let file = random.random_range(0..FILES.len());
    let mut case = vec![u8::try_from(file).expect("few files")];
    case.extend(damaged(&SET[file], random));
    case
}

fn solve(path: &Path) -> Result<String> {
    let case = fs::read(path).expect("the case is there");
    let folder = path.with_extension("set");
    fs::create_dir_all(&folder).expect("a folder can be made");
    for (i, (name, bytes)) in FILES.iter().zip(SET.iter()).enumerate() {
        let damaged = usize::from(case[0]) == i;
        fs::write(folder.join(name), if damaged { &case[1..] } else { bytes }).expect("written");
    }
    let mut observations = read_features(&folder.join("features.csv"), true)?;
    observations.centers = read_centers(&folder.join("centers.csv"))?;
    let camera = read_camera(&folder.join("camera.json"))?;
    let poses = read_poses(&folder.join("poses.json"))?;
    let project = Project::read(&folder.join("project.toml"))?;
    let board: Board = project.board.unwrap_or(BOARD);
    let lattice = &camera.lattice;
    if i64::from(lattice.columns) * i64::from(lattice.rows) < MOST_MICRO_LENSES
        && i64::from(board.columns) * i64::from(board.rows) < 100
    {
        let noise = Noise { uv_px: 0.0, rho_px: 0.0, centers_px: 0.0 };
        let _ = synthesize(&camera, &board, &poses, &noise, 1);
    }
    let _ = distortion_mm(&camera, &[nalgebra::Vector2::new(1.0, 2.0)]);
    let starts = [Some(Start::Camera(camera)), datasheet(&project)];
    let mut outcome = String::new();
    for (start, mode) in starts.into_iter().zip([Mode::Full, Mode::CornersOnly]) {
        let Some(start) = start else { continue };
        outcome += &solved(&start, mode, &board, &observations)?;
    }
    Ok(outcome)
}

fn datasheet(project: &Project) -> Option<Start> {
    Some(Start::Datasheet(project.datasheet().ok()??, project.internal_parameters.clone()?))
}

/// A few iterations; the camera that comes of them.
fn solved(start: &Start, mode: Mode, board: &Board, observations: &Observations) -> Result<String> {
    let options =
        CalibrationOptions { threads: 1, max_iterations: 3, mode, ..CalibrationOptions::default() };
    let result = calibrate(start, board, observations, &options, &mut |_| true)?;
    Ok(format!("{:?} {:?}", result.camera, result.refinement.cost))
}
