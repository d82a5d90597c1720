//! Whole runs of the program on damaged folders.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use tempfile::TempDir;

use crate::hostile::corpus::{self, true_camera};
use crate::hostile::documents;
use crate::hostile::mutation::damaged;

pub const NAME: &str = "commands";

/// A command, and the files of which one is damaged.
struct Case {
    arguments: &'static [&'static str],
    files: &'static [&'static str],
}

const fn case(arguments: &'static [&'static str], files: &'static [&'static str]) -> Case {
    Case { arguments, files }
}

/// None takes more than a second with valid files.
const CASES: [Case; 18] = [
    case(
        &["calibrate", "project.toml", "--max-iterations", "2", "--threads", "1"],
        &["project.toml", "features.csv", "centers.csv"],
    ),
    case(
        &[
            "calibrate",
            "--camera",
            "camera.js",
            "--params",
            "params.js",
            "--scene",
            "scene.js",
            "--centers",
            "centers.csv",
            "--features",
            "features.csv",
            "--max-iterations",
            "2",
        ],
        &["camera.js", "params.js", "scene.js", "features.csv", "centers.csv"],
    ),
    case(
        &[
            "calibrate",
            "--mode",
            "poses-only",
            "--camera",
            "camera.json",
            "--scene",
            "scene.js",
            "--features",
            "features.csv",
            "--centers",
            "centers.csv",
            "--board-shape",
            "calibration.json",
            "--max-iterations",
            "2",
            "--json",
        ],
        &["camera.json", "scene.js", "calibration.json", "features.csv"],
    ),
    case(&["simulate", "simulation.toml"], &["simulation.toml"]),
    case(&["simulate", "simulation.toml", "--poses", "poses.json"], &["poses.json"]),
    case(&["init", "images", "--preset", "mini", "--board", "8x5x3"], &["images/white-f4.png"]),
    case(&["precalibrate", "images/white-f4.png"], &["images/white-f4.png"]),
    case(&["precalibrate", "calib.xml", "--size", "300x200"], &["calib.xml"]),
    case(&["precalibrate", "images.toml"], &["images.toml", "images/white-f4.png"]),
    case(
        &["detect", "images.toml", "--precalibration", "white", "--no-pictures"],
        &["images.toml", "white/precalibration.json", "white/centers.csv", "images/board-0.png"],
    ),
    case(
        &[
            "extrinsics",
            "images.toml",
            "--subset",
            "calibration",
            "--camera",
            "camera.json",
            "--precalibration",
            "white",
        ],
        &["images.toml", "camera.json", "white/precalibration.json", "images/board-0.png"],
    ),
    case(
        &[
            "evaluate",
            "images.toml",
            "--camera",
            "camera.json",
            "--precalibration",
            "white",
            "--features",
            "features.csv",
            "--folds",
            "2",
        ],
        &["images.toml", "camera.json", "features.csv", "white/centers.csv", "board.toml"],
    ),
    case(&["rays", "small.json"], &["small.json"]),
    case(&["points", "camera.json", "depths.csv"], &["camera.json", "depths.csv"]),
    case(&["points", "camera.json", "depths.npy", "--map", "focused"], &["depths.npy"]),
    case(&["points", "camera.json", "features.csv", "--csv"], &["features.csv"]),
    case(&["compare", "camera.json", "intrinsics.js"], &["camera.json", "intrinsics.js"]),
    case(
        &[
            "calibrate",
            "project.toml",
            "--camera",
            "camera.json",
            "--poses",
            "all-poses.json",
            "--evaluate-only",
        ],
        &["camera.json", "all-poses.json"],
    ),
];

/// A camera of few pixels, whose images take no time.
const SMALL: &str = "rays = 1\nseed = 1\nengraved_focal_length_mm = 16.0\n\
[camera]\nprincipal_point_px = [40.0, 30.0]\n\
[camera.sensor]\nwidth_px = 80\nheight_px = 60\npixel_size_mm = 0.0055\n\
[camera.main_lens]\nfocal_length_mm = 16.2\nq1_per_mm2 = 0.0\nq2_per_mm4 = 0.0\nq3_per_mm6 = 0.0\n\
p1_per_mm = 0.0\np2_per_mm = 0.0\nf_number = 4.0\nfocus_distance_mm = 120.0\n\
[camera.micro_lens_array]\nlattice = \"hexagonal-rows\"\ncolumns = 5\nrows = 4\nshifted = \"even\"\n\
lens_to_mla_mm = 18.5\nmla_to_sensor_mm = 0.33\nrotation_rad = [0.0, 0.0, 0.0]\n\
offset_mm = [0.0, 0.0]\npitch_mm = 0.126\npitch_ratio = 1.0\n\
focal_lengths_mm = [0.578, 0.505, 0.552]\n\
[white_images]\nf_numbers = [4.0, 8.0]\n\
[target]\ncolumns = 8\nrows = 5\nsquare_mm = 0.3\nborder_mm = 0.3\nwhite = 0.9\nblack = 0.05\n\
background = 0.3\n\
[boards]\ncalibration = 1\nevaluation = 0\ndepth_mm = [65.0, 95.0]\nmax_tilt_deg = 35.0\n\
max_turn_deg = 30.0\nmin_in_view = 0.1\n\
[translation]\nimages = 0\nstart_mm = 60.0\nstep_mm = 5.0\n";

/// What follows the tables of the shipped project in one with images.
const IMAGES: &str = "[images]\ncolor = \"grey\"\ndevignetting = \"images/white-f4.png\"\n\
calibration = [\"images/board-0.png\"]\nevaluation = [\"images/board-0.png\"]\n\
[[images.whites]]\nimage = \"images/white-f4.png\"\nf_number = 4.0\n\
[[images.whites]]\nimage = \"images/white-f8.png\"\nf_number = 8.0\n\
[truth]\ncamera = \"camera.json\"\nboard = \"board.toml\"\n";

type Files = BTreeMap<PathBuf, Vec<u8>>;

/// The valid files.
pub struct Prepared {
    files: Files,
}

impl Prepared {
    pub fn new() -> Self {
        let mut files = Files::new();
        let mut put = |name: &str, bytes: Vec<u8>| drop(files.insert(name.into(), bytes));
        let text = |document: &serde_json::Value| document.to_string().into_bytes();
        for name in ["project.toml", "features.csv", "centers.csv"] {
            let path = corpus::data("synthetic").join(name);
            put(name, fs::read(path).expect("the shipped set is there"));
        }
        let [intrinsics, camera, params, _] = documents::compote_documents();
        let [calibrated, poses, calibration] = &*documents::CALIBRATED;
        put("intrinsics.js", text(&intrinsics));
        put("camera.js", text(&camera));
        put("params.js", text(&params));
        put("scene.js", documents::SCENE.into());
        put("camera.json", text(calibrated));
        put("poses.json", text(poses));
        put("calibration.json", text(calibration));
        put("small.json", text(&small_camera()));
        put(
            "all-poses.json",
            fs::read(corpus::data("synthetic/truth/poses.json")).expect("it is shipped"),
        );
        let [csv, .., npy, _, _, _] =
            <[Vec<u8>; 8]>::try_from(corpus::virtual_depths()).expect("8");
        put("depths.csv", csv);
        put("depths.npy", npy);
        put("board.toml", documents::BOARD_SHAPE.into());
        put("calib.xml", documents::raytrix().into_bytes());
        put("simulation.toml", SMALL.into());
        put("white/precalibration.json", text(&documents::precalibration()));
        put("white/centers.csv", corpus::centers().swap_remove(0));
        let image = corpus::images().swap_remove(0);
        for name in ["white-f4", "white-f8", "board-0"] {
            put(&format!("images/{name}.png"), image.clone());
        }
        let shipped = corpus::projects().swap_remove(0);
        let shipped = String::from_utf8(shipped).expect("a text");
        let (camera, _) = shipped.split_once("[observations]").expect("the table is there");
        put("images.toml", format!("{camera}{IMAGES}").into_bytes());
        Self { files }
    }

    /// Runs every command on the valid files, and says how it ends: true for success.
    pub fn baseline(&self, place: &Path) -> Vec<String> {
        let ends = |case: &Case| {
            let folder = new_folder(place, &self.files).expect("files can be written");
            format!("{:?}: {:?}", case.arguments, run(case, folder.path(), &self.files))
        };
        CASES.iter().map(ends).collect()
    }

    /// Runs the case of this number in a new folder.
    pub fn judge(&self, number: &[u8], place: &Path) -> Result<bool, String> {
        let number = u64::from_le_bytes(number.try_into().map_err(|_| "no number")?);
        let mut random = StdRng::seed_from_u64(number);
        let case = &CASES[usize::try_from(number).unwrap_or_default() % CASES.len()];
        let name = Path::new(case.files[random.random_range(0..case.files.len())]);
        let mut files = self.files.clone();
        let bytes = damaged(&files[name], &mut random);
        files.insert(name.to_owned(), bytes);
        let folder = new_folder(place, &files)?;
        run(case, folder.path(), &files)
            .map_err(|e| format!("{:?} {}: {e}", case.arguments, name.display()))
    }
}

/// A new folder with files.
fn new_folder(place: &Path, files: &Files) -> Result<TempDir, String> {
    let folder = TempDir::new_in(place).map_err(|e| e.to_string())?;
    for (name, bytes) in files {
        let path = folder.path().join(name);
        fs::create_dir_all(path.parent().unwrap_or(&path)).map_err(|e| e.to_string())?;
        fs::write(path, bytes).map_err(|e| e.to_string())?;
    }
    Ok(folder)
}

fn run(case: &Case, folder: &Path, files: &Files) -> Result<bool, String> {
    let output = Command::new(env!("CARGO_BIN_EXE_plenocal"))
        .args(case.arguments)
        .args(["--out", "out"])
        .current_dir(folder)
        .stdin(Stdio::null())
        .output()
        .map_err(|e| format!("the program cannot be started: {e}"))?;
    let said = String::from_utf8_lossy(&output.stderr);
    let code = output.status.code().filter(|code| (0..=3).contains(code));
    let code = code.ok_or_else(|| format!("it ended with {}: {said}", output.status))?;
    if said.contains("panicked") || said.contains("Check failed") {
        return Err(format!("a panic: {said}"));
    }
    let written = all_files(folder)?;
    for (name, bytes) in &written {
        let out = name.starts_with("out");
        if name.to_string_lossy().contains(".tmp") || (!out && files.get(name) != Some(bytes)) {
            return Err(format!("{} was left behind or changed", name.display()));
        }
        if out && code == 1 {
            return Err(format!("{} was written in spite of an error: {said}", name.display()));
        }
    }
    if let Some(gone) = files.keys().find(|name| !written.contains_key(*name)) {
        return Err(format!("{} is gone", gone.display()));
    }
    if code == 1 && folder.join("out").exists() {
        return Err("an empty folder was left behind".to_owned());
    }
    Ok(code == 0)
}

fn all_files(folder: &Path) -> Result<Files, String> {
    let mut found = Files::new();
    let mut open = vec![folder.to_owned()];
    while let Some(next) = open.pop() {
        for entry in fs::read_dir(next).map_err(|e| e.to_string())? {
            let path = entry.map_err(|e| e.to_string())?.path();
            if path.is_dir() {
                open.push(path);
            } else {
                let bytes = fs::read(&path).map_err(|e| e.to_string())?;
                let name = path.strip_prefix(folder).map_err(|e| e.to_string())?;
                found.insert(name.to_owned(), bytes);
            }
        }
    }
    Ok(found)
}

/// A camera of few pixels.
fn small_camera() -> serde_json::Value {
    let mut camera = true_camera();
    camera.sensor.width_px = 90;
    camera.sensor.height_px = 60;
    plenocal::io::camera_document(&camera, None)
}
