//! Whole runs of the program on damaged folders.

use std::collections::BTreeMap;
use std::fs;
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus, Stdio};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use tempfile::TempDir;

use crate::hostile::corpus::{self, true_camera};
use crate::hostile::documents;
use crate::hostile::mutation::damaged;
use crate::outputs;

/// A command line, and the files of which one is damaged.
struct Case {
    arguments: &'static [&'static str],
    files: &'static [&'static str],
}

const fn case(arguments: &'static [&'static str], files: &'static [&'static str]) -> Case {
    Case { arguments, files }
}

/// A command, and ways to run it.
pub struct Program {
    /// Name of the target.
    pub name: &'static str,
    cases: &'static [Case],
}

/// None takes more than a second with valid files.
pub static PROGRAMS: [Program; 10] = [
    Program {
        name: "plenocal calibrate",
        cases: &[
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
        ],
    },
    Program {
        name: "plenocal simulate",
        cases: &[
            case(&["simulate", "simulation.toml"], &["simulation.toml"]),
            case(&["simulate", "simulation.toml", "--poses", "poses.json"], &["poses.json"]),
        ],
    },
    Program {
        name: "plenocal init",
        cases: &[case(
            &["init", "images", "--preset", "mini", "--board", "8x5x3"],
            &["images/white-f4.png"],
        )],
    },
    Program {
        name: "plenocal precalibrate",
        cases: &[
            case(&["precalibrate", "images/white-f4.png"], &["images/white-f4.png"]),
            case(&["precalibrate", "calib.xml", "--size", "300x200"], &["calib.xml"]),
            case(&["precalibrate", "images.toml"], &["images.toml", "images/white-f4.png"]),
        ],
    },
    Program {
        name: "plenocal detect",
        cases: &[case(
            &["detect", "images.toml", "--precalibration", "white", "--no-pictures"],
            &[
                "images.toml",
                "white/precalibration.json",
                "white/centers.csv",
                "images/board-0.png",
            ],
        )],
    },
    Program {
        name: "plenocal extrinsics",
        cases: &[
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
                &[
                    "images.toml",
                    "camera.json",
                    "calibration.json",
                    "white/precalibration.json",
                    "white/centers.csv",
                    "images/board-0.png",
                ],
            ),
            // What it does once boards are found.
            case(
                &[
                    "calibrate",
                    "project.toml",
                    "--mode",
                    "poses-only",
                    "--camera",
                    "camera.json",
                    "--features",
                    "few-features.csv",
                    "--json",
                ],
                &["camera.json", "few-features.csv", "calibration.json", "project.toml"],
            ),
        ],
    },
    Program {
        name: "plenocal evaluate",
        // Without boards for evaluation, which would take seconds to find.
        cases: &[case(
            &[
                "evaluate",
                "evaluated.toml",
                "--camera",
                "camera.json",
                "--precalibration",
                "white",
                "--features",
                "features.csv",
                "--folds",
                "2",
            ],
            &["evaluated.toml", "camera.json", "features.csv", "white/centers.csv", "board.toml"],
        )],
    },
    Program {
        name: "plenocal rays",
        cases: &[
            case(&["rays", "small.json"], &["small.json"]),
            case(&["rays", "small.json", "--micro-images", "--at", "90"], &["small.json"]),
            case(&["rays", "small.json", "--double", "--json"], &["small.json"]),
        ],
    },
    Program {
        name: "plenocal points",
        cases: &[
            case(&["points", "camera.json", "depths.csv"], &["camera.json", "depths.csv"]),
            case(
                &["points", "intrinsics.js", "std-devs.csv", "--csv"],
                &["intrinsics.js", "std-devs.csv"],
            ),
            case(&["points", "small.json", "map.npy"], &["small.json", "map.npy"]),
            case(
                &["points", "camera.json", "single.npy", "--map", "focused", "--csv"],
                &["single.npy"],
            ),
            case(
                &[
                    "points",
                    "camera.json",
                    "double.npy",
                    "--map",
                    "focused",
                    "--depth-std-dev",
                    "0.02",
                    "--uv-std-dev",
                    "0.1",
                    "--json",
                ],
                &["double.npy", "camera.json"],
            ),
            case(
                &[
                    "points",
                    "camera.json",
                    "images/white-f4.png",
                    "--map",
                    "focused",
                    "--depth-scale",
                    "0,0.02",
                ],
                &["images/white-f4.png"],
            ),
            case(
                &["points", "camera.json", "few-features.csv", "--csv"],
                &["camera.json", "few-features.csv"],
            ),
        ],
    },
    Program {
        name: "plenocal compare",
        cases: &[
            case(&["compare", "camera.json", "intrinsics.js"], &["camera.json", "intrinsics.js"]),
            case(
                &["compare", "camera.json", "truth.json", "--json"],
                &["camera.json", "truth.json"],
            ),
            case(&["compare", "truth.json", "camera.json", "--at", "60,90"], &["camera.json"]),
        ],
    },
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

/// The valid files, and the folder with them.
pub struct Prepared {
    files: Files,
    place: PathBuf,
    folder: Option<TempDir>,
}

/// First features of so many lines, which are computed with in no time.
const FEW: usize = 200;

impl Prepared {
    pub fn new(place: &Path) -> Self {
        let mut files = Files::new();
        let mut put = |name: &str, bytes: Vec<u8>| drop(files.insert(name.into(), bytes));
        let text = |document: &serde_json::Value| document.to_string().into_bytes();
        for name in ["project.toml", "features.csv", "centers.csv"] {
            let path = corpus::data("synthetic").join(name);
            put(name, fs::read(path).expect("the shipped set is there"));
        }
        let features = fs::read_to_string(corpus::data("synthetic/features.csv"));
        let features = features.expect("the shipped set is there");
        let few = features.lines().take(FEW).flat_map(|line| [line, "\n"]).collect::<String>();
        put("few-features.csv", few.into_bytes());
        let [intrinsics, camera, params, _] = documents::compote_documents();
        let [calibrated, poses, calibration] = &*documents::CALIBRATED;
        put("intrinsics.js", text(&intrinsics));
        put("camera.js", text(&camera));
        put("params.js", text(&params));
        put("scene.js", documents::SCENE.into());
        put("camera.json", text(calibrated));
        put("truth.json", text(&plenocal::io::camera_document(&true_camera(), None)));
        put("poses.json", text(poses));
        put("calibration.json", text(calibration));
        put("small.json", text(&small_camera()));
        put(
            "all-poses.json",
            fs::read(corpus::data("synthetic/truth/poses.json")).expect("it is shipped"),
        );
        let [csv, std_devs, _, single, double, ..] =
            <[Vec<u8>; 8]>::try_from(corpus::virtual_depths()).expect("8");
        put("depths.csv", csv);
        put("std-devs.csv", std_devs);
        put("single.npy", single);
        put("double.npy", double);
        put("map.npy", small_map());
        put("board.toml", documents::BOARD_SHAPE.into());
        put("calib.xml", documents::raytrix().into_bytes());
        put("simulation.toml", SMALL.into());
        put("white/precalibration.json", text(&documents::precalibration()));
        put(
            "white/centers.csv",
            fs::read(corpus::data("synthetic/centers.csv")).expect("it is shipped"),
        );
        let image = corpus::images().swap_remove(0);
        for name in ["white-f4", "white-f8", "board-0"] {
            put(&format!("images/{name}.png"), image.clone());
        }
        let shipped = corpus::projects().swap_remove(0);
        let shipped = String::from_utf8(shipped).expect("a text");
        let (camera, _) = shipped.split_once("[observations]").expect("the table is there");
        let images = format!("{camera}{IMAGES}");
        let evaluated = images.replace("evaluation = [\"images/board-0.png\"]\n", "");
        put("images.toml", images.into_bytes());
        put("evaluated.toml", evaluated.into_bytes());
        Self { files, place: place.to_owned(), folder: None }
    }

    /// Runs every command on the valid files, and says how it ends: true for success.
    pub fn baseline(&mut self) -> Vec<String> {
        let mut ends = Vec::new();
        for case in PROGRAMS.iter().flat_map(|program| program.cases) {
            let name = Path::new(case.files[0]);
            let bytes = self.files[name].clone();
            ends.push(format!("{:?}: {:?}", case.arguments, self.outcome(case, name, &bytes)));
        }
        ends
    }

    /// Runs the case of a program that has this number.
    pub fn judge(&mut self, program: &Program, number: &[u8]) -> Result<bool, String> {
        let number = u64::from_le_bytes(number.try_into().map_err(|_| "no number")?);
        let mut random = StdRng::seed_from_u64(number);
        let of = usize::try_from(number).unwrap_or_default() % program.cases.len();
        let case = &program.cases[of];
        let name = Path::new(case.files[random.random_range(0..case.files.len())]);
        let bytes = damaged(&self.files[name], &mut random);
        self.outcome(case, name, &bytes)
            .map_err(|e| format!("{:?} {}: {e}", case.arguments, name.display()))
    }

    /// Runs a command with other bytes in a file, which is as before afterwards.
    fn outcome(&mut self, case: &Case, name: &Path, bytes: &[u8]) -> Result<bool, String> {
        // After a finding the folder is not as it was.
        let folder = match self.folder.take() {
            Some(folder) => folder,
            None => new_folder(&self.place, &self.files)?,
        };
        let write = |bytes: &[u8]| fs::write(folder.path().join(name), bytes);
        write(bytes).map_err(|e| e.to_string())?;
        let valid = self.files.insert(name.to_owned(), bytes.to_vec());
        let outcome = run(case, folder.path(), &self.files);
        let valid = valid.ok_or("there is no such file")?;
        write(&valid).map_err(|e| e.to_string())?;
        self.files.insert(name.to_owned(), valid);
        if outcome.is_ok() {
            let out = folder.path().join(OUT);
            let _ = if out.is_dir() { fs::remove_dir_all(out) } else { fs::remove_file(out) };
            self.folder = Some(folder);
        }
        outcome
    }
}

/// A map of virtual depths for the small camera.
fn small_map() -> Vec<u8> {
    let (width, height) = SMALL_PX;
    let mut bytes = Vec::new();
    let header = plenocal::io::NpyHeader::floats(false, &[height as usize, width as usize]);
    header.write(&mut bytes).expect("memory can be written");
    let depths = (0..width * height).map(|i| if i % 7 == 0 { f32::NAN } else { 3.0 });
    bytes.extend(depths.flat_map(f32::to_le_bytes));
    bytes
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

const OUT: &str = "out";

/// Longest time for a run, which is less than that for a case.
const PATIENCE: Duration = Duration::from_secs(8);
/// What a run says beforehand that may take longer, such as the rays of a sensor of a hundred million pixels. It is interrupted.
const LARGE: &str = " GB";
/// How often a run is looked at.
const INTERVAL: Duration = Duration::from_millis(1);

/// A run at its end.
struct Ended {
    status: ExitStatus,
    stdout: String,
    said: String,
    /// Whether it was interrupted.
    stopped: bool,
}

fn ended(case: &Case, folder: &Path) -> Result<Ended, String> {
    let cannot = |e: io::Error| format!("the program cannot be started: {e}");
    let begun = Instant::now();
    let mut child = Command::new(env!("CARGO_BIN_EXE_plenocal"))
        .args(case.arguments)
        .args(["--out", OUT])
        .current_dir(folder)
        // Files for a while belong into the folder too.
        .env("TMPDIR", folder)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .map_err(cannot)?;
    let stdout = read_all(child.stdout.take());
    let stderr = read_all(child.stderr.take());
    let mut stopped = false;
    let status = loop {
        if let Some(status) = child.try_wait().map_err(cannot)? {
            break status;
        }
        if !stopped && begun.elapsed() > PATIENCE {
            stopped = true;
            let interrupt = Command::new("kill").arg(child.id().to_string()).status();
            interrupt.map_err(|e| format!("it cannot be interrupted: {e}"))?;
        }
        thread::sleep(INTERVAL);
    };
    let text = |reader: JoinHandle<String>| reader.join().map_err(|_| "a reader panicked");
    Ok(Ended { status, stdout: text(stdout)?, said: text(stderr)?, stopped })
}

/// Reads a pipe to its end.
fn read_all(pipe: Option<impl Read + Send + 'static>) -> JoinHandle<String> {
    thread::spawn(move || {
        let mut bytes = Vec::new();
        if let Some(mut pipe) = pipe {
            let _ = pipe.read_to_end(&mut bytes);
        }
        String::from_utf8_lossy(&bytes).into_owned()
    })
}

fn run(case: &Case, folder: &Path, files: &Files) -> Result<bool, String> {
    let Ended { status, stdout, said, stopped } = ended(case, folder)?;
    let interrupted = stopped && said.contains(LARGE);
    if stopped && !interrupted {
        return Err(format!("it takes more than {} s: {said}", PATIENCE.as_secs()));
    }
    let code = status.code().filter(|code| (0..=4).contains(code) || interrupted && *code == 130);
    let code = code.ok_or_else(|| format!("it ended with {status}: {said}"))?;
    if said.contains("panicked") || said.contains("Check failed") {
        return Err(format!("a panic: {said}"));
    }
    let written = all_files(folder)?;
    for (name, bytes) in &written {
        let out = name.starts_with(OUT);
        if name.to_string_lossy().contains(".tmp") || (!out && files.get(name) != Some(bytes)) {
            return Err(format!("{} was left behind or changed", name.display()));
        }
        if out && ![0, 3, 4].contains(&code) {
            return Err(format!("{} was written in spite of an error: {said}", name.display()));
        }
        if out {
            outputs::check(name, bytes)?;
        }
    }
    if let Some(gone) = files.keys().find(|name| !written.contains_key(*name)) {
        return Err(format!("{} is gone", gone.display()));
    }
    if ![0, 3, 4].contains(&code) && folder.join(OUT).exists() {
        return Err("an empty folder was left behind".to_owned());
    }
    outputs::check_text("stdout", &stdout)?;
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

const SMALL_PX: (u32, u32) = (90, 60);

/// A camera of few pixels.
fn small_camera() -> serde_json::Value {
    let mut camera = true_camera();
    (camera.sensor.width_px, camera.sensor.height_px) = SMALL_PX;
    plenocal::io::camera_document(&camera, None)
}
