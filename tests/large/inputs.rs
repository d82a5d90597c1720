//! The largest inputs.

use std::fmt::Write as _;
use std::fs::{self, File};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::process::Command;

use plenocal::io::NpyHeader;
use serde_json::Value;
use tempfile::TempDir;

/// Edge of the largest square sensor, px.
const EDGE: usize = 1 << 14;
/// In a map, one pixel of so many has a depth: points of all of them take an hour.
const SPARSE: usize = 64;

/// Makes the files of a case and returns the arguments of the program.
type Make = fn(&Inputs) -> Vec<String>;

/// A command with a large input.
pub struct Case {
    pub name: &'static str,
    pub make: Make,
    /// Whether it has to succeed; otherwise its images show nothing, which is found after they were searched.
    pub works: bool,
}

/// All cases.
#[allow(clippy::too_many_lines)] // a table
pub fn cases() -> Vec<Case> {
    let case = |name, works, make| Case { name, make, works };
    vec![
        case("simulate: a sensor of 16384 x 16384 px", true, |_| {
            let mut all = simulate();
            for value in [
                "camera.sensor.width_px=16384",
                "camera.sensor.height_px=16384",
                "camera.sensor.pixel_size_mm=0.0005",
                "camera.main_lens.q1_per_mm2=0",
                "camera.main_lens.q2_per_mm4=0",
                "camera.main_lens.q3_per_mm6=0",
            ] {
                all.extend(["--set".to_owned(), value.to_owned()]);
            }
            all
        }),
        case("simulate: an array of 1024 x 1024", true, |_| {
            let mut all = simulate();
            for value in
                ["camera.micro_lens_array.columns=1024", "camera.micro_lens_array.rows=1024"]
            {
                all.extend(["--set".to_owned(), value.to_owned()]);
            }
            all
        }),
        case("simulate: poses of 100 000 frames", false, |inputs| {
            let poses = inputs.many_poses();
            let preset = ["simulate", "--preset", "mini", "--set", "rays=1", "--poses", &poses];
            preset.map(str::to_owned).to_vec()
        }),
        case("init: 5000 images", true, |inputs| {
            let folder = inputs.many_images();
            ["init", &folder, "--preset", "mini", "--board", "8x5x3"].map(str::to_owned).to_vec()
        }),
        case("precalibrate: an image of 16384 x 16384 px", true, |inputs| {
            vec!["precalibrate".to_owned(), inputs.white(13.0, "white.pgm")]
        }),
        case("precalibrate: three images of 16384 x 16384 px", false, |inputs| {
            vec!["precalibrate".to_owned(), inputs.large_project()]
        }),
        case("precalibrate: a maker's calibration, 16384 x 16384 px", true, |inputs| {
            let calibration = inputs.raytrix(5.5);
            ["precalibrate", &calibration, "--size", "16384x16384"].map(str::to_owned).to_vec()
        }),
        case("precalibrate: a maker's calibration, 65535 x 65535 px", false, |inputs| {
            let calibration = inputs.raytrix(17.5);
            ["precalibrate", &calibration, "--size", "65535x65535"].map(str::to_owned).to_vec()
        }),
        case("detect: images of 16384 x 16384 px", false, |inputs| {
            vec!["detect".to_owned(), inputs.large_project()]
        }),
        case("run: images of 16384 x 16384 px", false, |inputs| {
            vec!["run".to_owned(), inputs.large_project()]
        }),
        case("calibrate: 200 000 features", true, |inputs| {
            let mut all = inputs.calibrate(&inputs.many_features(200_000));
            all.extend(["--max-iterations".to_owned(), "2".to_owned()]);
            all
        }),
        case("calibrate: poses of 100 000 features", true, |inputs| {
            let features = inputs.many_features(100_000);
            inputs.poses_only(&inputs.project(), &features, &[])
        }),
        case("calibrate: poses of 100 000 frames", true, |inputs| {
            let features = inputs.results("boards-calibration/features.csv");
            inputs.poses_only(&inputs.project(), &features, &["--poses", &inputs.many_poses()])
        }),
        case("calibrate: a board of 1000 x 1000 corners", false, |inputs| {
            let features = inputs.results("boards-calibration/features.csv");
            inputs.poses_only(&inputs.large_board(), &features, &[])
        }),
        case("extrinsics: 200 images", true, |inputs| {
            inputs.with_camera("extrinsics", &inputs.many_frames(200))
        }),
        case("evaluate: a cloud of three million points", true, |inputs| {
            inputs.with_camera("evaluate", &inputs.with_clouds())
        }),
        case("compare: 100 distances, 16384 x 16384 px", true, |inputs| {
            let camera = inputs.camera_of(EDGE, EDGE);
            let at: Vec<String> = (60..160).map(|mm| mm.to_string()).collect();
            ["compare", &camera, &camera, "--at", &at.join(",")].map(str::to_owned).to_vec()
        }),
        case("compare: arrays of 4096 x 4096", true, |inputs| {
            let camera = inputs.camera_of_array();
            ["compare", &camera, &camera].map(str::to_owned).to_vec()
        }),
        case("rays: 16384 x 16384 px", true, |inputs| {
            vec!["rays".to_owned(), inputs.camera_of(EDGE, EDGE)]
        }),
        case("rays: 268435456 x 1 px", false, |inputs| {
            vec!["rays".to_owned(), inputs.camera_of(EDGE * EDGE, 1), "--micro-images".to_owned()]
        }),
        case("points: a million virtual depths", true, |inputs| {
            let depths = inputs.many_depths(1_000_000);
            ["points", &inputs.camera(), &depths, "--csv"].map(str::to_owned).to_vec()
        }),
        case("points: a million features", true, |inputs| {
            let features = inputs.many_features(1_000_000);
            ["points", &inputs.camera(), &features, "--csv"].map(str::to_owned).to_vec()
        }),
        case("points: a map of 16384 x 16384 px", true, |inputs| {
            let camera = inputs.camera_of(EDGE, EDGE);
            ["points", &camera, &inputs.map(), "--csv"].map(str::to_owned).to_vec()
        }),
        case("points: a total-focus map of 16384 x 16384 px", true, |inputs| {
            let arguments = ["points", &inputs.camera(), &inputs.map(), "--map", "focused"];
            arguments.map(str::to_owned).to_vec()
        }),
        case("points: an image of 16384 x 16384 px", true, |inputs| {
            let (camera, image) = (inputs.camera(), inputs.level_map());
            ["points", &camera, &image, "--map", "focused", "--depth-scale", "0,0.03"]
                .map(str::to_owned)
                .to_vec()
        }),
    ]
}

/// One board, with a ray for each pixel.
fn simulate() -> Vec<String> {
    let mut all: Vec<String> = ["simulate", "--preset", "mini"].map(str::to_owned).to_vec();
    for value in ["rays=1", "boards.calibration=1", "boards.evaluation=0", "translation.images=0"] {
        all.extend(["--set".to_owned(), value.to_owned()]);
    }
    all
}

fn run(arguments: &[&str]) {
    let output = Command::new(env!("CARGO_BIN_EXE_plenocal")).args(arguments).output();
    let output = output.expect("the program runs");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{arguments:?}: {said}");
}

fn text(path: &Path) -> String {
    path.to_str().expect("the folder of the tests is UTF-8").to_owned()
}

/// A calibrated set, and a folder for the files of a case.
pub struct Inputs {
    folder: TempDir,
}

impl Inputs {
    pub fn new() -> Self {
        let folder = TempDir::new_in(env!("CARGO_TARGET_TMPDIR")).expect("it is writable");
        let inputs = Self { folder };
        let set = text(&inputs.folder.path().join("set"));
        run(&["simulate", "--preset", "mini", "--set", "seed=2207", "--out", &set]);
        let (project, results) = (inputs.project(), format!("{set}/results"));
        run(&["run", &project, "--no-pictures", "--folds", "0", "--out", &results]);
        inputs.clear();
        inputs
    }

    /// Removes the files of a case.
    pub fn clear(&self) {
        let folder = self.folder.path().join("case");
        let _ = fs::remove_dir_all(&folder);
        fs::create_dir_all(&folder).expect("it is writable");
    }

    fn file(&self, name: &str) -> PathBuf {
        self.folder.path().join("case").join(name)
    }

    pub fn out(&self) -> PathBuf {
        self.file("out")
    }

    fn of_set(&self, name: &str) -> PathBuf {
        self.folder.path().join("set").join(name)
    }

    fn project(&self) -> String {
        text(&self.of_set("project.toml"))
    }

    fn results(&self, name: &str) -> String {
        text(&self.of_set("results").join(name))
    }

    fn camera(&self) -> String {
        self.results("calibration/camera.json")
    }

    fn read(&self, name: &str) -> String {
        fs::read_to_string(self.of_set(name)).expect("the set has it")
    }

    fn write(
        &self,
        name: &str,
        write: impl FnOnce(&mut dyn Write) -> std::io::Result<()>,
    ) -> String {
        let path = self.file(name);
        let mut out = BufWriter::new(File::create(&path).expect("it is writable"));
        write(&mut out).and_then(|()| out.flush()).expect("the disk has room");
        text(&path)
    }

    fn changed_camera(&self, change: impl FnOnce(&mut Value)) -> String {
        let content = self.read("results/calibration/camera.json");
        let mut camera: Value = serde_json::from_str(&content).expect("it is JSON");
        change(&mut camera);
        self.write("camera.json", |out| out.write_all(camera.to_string().as_bytes()))
    }

    fn camera_of(&self, width: usize, height: usize) -> String {
        self.changed_camera(|camera| {
            camera["sensor"]["width_px"] = width.into();
            camera["sensor"]["height_px"] = height.into();
        })
    }

    fn camera_of_array(&self) -> String {
        self.changed_camera(|camera| {
            camera["micro_lens_array"]["columns"] = 4096.into();
            camera["micro_lens_array"]["rows"] = 4096.into();
        })
    }

    fn calibrate(&self, features: &str) -> Vec<String> {
        let (params, centers) = (
            self.results("precalibration/precalibration.json"),
            self.results("precalibration/centers.csv"),
        );
        let project = self.project();
        let all = ["calibrate", &project, "--params", &params, "--centers", &centers, "--features"];
        all.into_iter().chain([features]).map(str::to_owned).collect()
    }

    fn poses_only(&self, project: &str, features: &str, more: &[&str]) -> Vec<String> {
        let camera = self.camera();
        let all = ["calibrate", project, "--mode", "poses-only", "--camera", &camera, "--features"];
        all.into_iter().chain([features]).chain(more.iter().copied()).map(str::to_owned).collect()
    }

    fn with_camera(&self, command: &str, project: &str) -> Vec<String> {
        let (camera, white) = (self.camera(), self.results("precalibration"));
        [command, project, "--camera", &camera, "--precalibration", &white]
            .map(str::to_owned)
            .to_vec()
    }

    /// The features of the set again and again, in further frames.
    fn many_features(&self, count: usize) -> String {
        let features = self.read("results/boards-calibration/features.csv");
        let (header, rows) = features.split_once('\n').expect("a header");
        let rows: Vec<Vec<&str>> = rows.lines().map(|row| row.split(',').collect()).collect();
        let column = header.split(',').position(|name| name == "frame").expect("a column");
        let frame = |row: &Vec<&str>| row[column].parse::<usize>().expect("a number");
        let frames = rows.iter().map(frame).max().unwrap_or(0) + 1;
        self.write("features.csv", |out| {
            writeln!(out, "{header}")?;
            for (number, row) in rows.iter().cycle().take(count).enumerate() {
                let later = (number / rows.len() * frames + frame(row)).to_string();
                let mut row = row.clone();
                row[column] = &later;
                writeln!(out, "{}", row.join(","))?;
            }
            Ok(())
        })
    }

    fn many_depths(&self, count: usize) -> String {
        let features = self.read("results/boards-calibration/features.csv");
        let rows: Vec<String> = features
            .lines()
            .skip(1)
            .map(|row| row.split(',').take(4).collect::<Vec<_>>().join(","))
            .collect();
        self.write("depths.csv", |out| {
            writeln!(out, "k,l,u,v,nu,std_nu")?;
            let mut all = rows.iter().cycle().take(count);
            all.try_for_each(|row| writeln!(out, "{row},3.1,0.01"))
        })
    }

    fn many_poses(&self) -> String {
        let poses = self.read("results/calibration/poses.json");
        let mut document: Value = serde_json::from_str(&poses).expect("it is JSON");
        let few = document["poses"].as_array().expect("poses").clone();
        let numbered = few.iter().cycle().take(100_000).enumerate().map(|(frame, pose)| {
            let mut pose = pose.clone();
            pose["frame"] = frame.into();
            pose
        });
        document["poses"] = numbered.collect();
        self.write("poses.json", |out| out.write_all(document.to_string().as_bytes()))
    }

    fn many_images(&self) -> String {
        let folder = self.file("images");
        fs::create_dir_all(&folder).expect("it is writable");
        let link = |from: PathBuf, name: String| {
            fs::hard_link(from, folder.join(name)).expect("the set is on the same disk");
        };
        for entry in fs::read_dir(self.of_set("whites")).expect("the set has it") {
            let path = entry.expect("an entry").path();
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            link(path, name);
        }
        for i in 0..5000 {
            let board = self.of_set("calibration/calibration-00.png");
            link(board, format!("calibration-{i:04}.png"));
        }
        text(&folder)
    }

    /// A project of the set with another text, beside its images.
    fn other_project(&self, name: &str, text_of: impl FnOnce(String) -> String) -> String {
        let path = self.of_set(name);
        fs::write(&path, text_of(self.read("project.toml"))).expect("it is writable");
        text(&path)
    }

    fn large_board(&self) -> String {
        self.other_project("board.toml", |project| {
            project.replace(
                "columns = 8\nrows = 5\nsquare_mm = 3",
                "columns = 1000\nrows = 1000\nsquare_mm = 0.02",
            )
        })
    }

    /// Frames that are not the same file, by a byte behind the end of the image.
    fn many_frames(&self, count: usize) -> String {
        let folder = self.of_set("many");
        fs::create_dir_all(&folder).expect("it is writable");
        let mut list = "evaluation = [".to_owned();
        for i in 0..count {
            let from = self.of_set(&format!("evaluation/evaluation-0{}.png", i % 3));
            let mut image = fs::read(from).expect("the set has it");
            image.extend(i.to_le_bytes());
            fs::write(folder.join(format!("{i}.png")), image).expect("the disk has room");
            let _ = write!(list, "\"many/{i}.png\", ");
        }
        self.other_project("many.toml", |project| {
            let (before, after) = project.split_once("evaluation = [").expect("a list");
            let (_, after) = after.split_once(']').expect("its end");
            format!("{before}{list}]{after}")
        })
    }

    fn with_clouds(&self) -> String {
        let cloud = self.write("cloud.xyz", |out| {
            (0..3_000_000).try_for_each(|i| writeln!(out, "{} {} {}", i % 100, i % 77, 80 + i % 9))
        });
        self.other_project("clouds.toml", |project| {
            let clouds = vec![format!("\"{cloud}\""); 5].join(", ");
            project.replace("step_mm = 5", &format!("step_mm = 5\nclouds = [{clouds}]"))
        })
    }

    fn raytrix(&self, diameter_px: f64) -> String {
        let types = [0, 1, 2]
            .map(|i| format!("<lens_type><offset><x>{i}</x><y>0</y></offset></lens_type>"));
        let calibration = format!(
            "<RayCalibData><offset><x>3.5</x><y>-2.25</y></offset><diameter>{diameter_px}</diameter>\
             <lens_base_x><x>1</x><y>0</y></lens_base_x><lens_base_y><x>0.5</x><y>0.8660254</y></lens_base_y>\
             {}</RayCalibData>",
            types.concat()
        );
        self.write("calib.xml", |out| out.write_all(calibration.as_bytes()))
    }

    /// A map in which a few pixels have a depth.
    fn map(&self) -> String {
        let depth = |u: usize| if u.is_multiple_of(SPARSE) { 3.0 } else { f64::NAN };
        let row: Vec<u8> = (0..EDGE).flat_map(|u| depth(u).to_le_bytes()).collect();
        self.write("map.npy", |out| {
            NpyHeader::floats(true, &[EDGE, EDGE]).write(out)?;
            (0..EDGE).try_for_each(|_| out.write_all(&row))
        })
    }

    fn level_map(&self) -> String {
        let level = |u: usize| if u.is_multiple_of(SPARSE) { 100 } else { 0 };
        let row: Vec<u8> = (0..EDGE).map(level).collect();
        self.image("map.pgm", |_| row.clone())
    }

    fn image(&self, name: &str, row: impl Fn(usize) -> Vec<u8>) -> String {
        self.write(name, |out| {
            writeln!(out, "P5\n{EDGE} {EDGE}\n255")?;
            (0..EDGE).try_for_each(|v| out.write_all(&row(v)))
        })
    }

    /// Bright discs of this radius and a little less, px, on a hexagonal lattice of 30 px.
    fn white(&self, radius_px: f64, name: &str) -> String {
        const PITCH: usize = 30;
        const STEP: usize = 26;
        let light = |u: usize, v: usize| {
            // The rows above and below, and the lenses to the left and right.
            let near = |count: usize| [count, count + 1];
            let all = near(v / STEP).into_iter().flat_map(|l| {
                let shift = if l.is_multiple_of(2) { PITCH / 2 } else { 0 };
                near((u + PITCH - shift) / PITCH).map(|k| (l, k, (k * PITCH + shift) as f64))
            });
            let disc = |(l, k, center): (usize, usize, f64)| {
                let lens_type = (k + if l.is_multiple_of(2) { 0 } else { 2 }) % 3;
                let radius = radius_px * (1.0 - 0.05 * lens_type as f64);
                let off = ((u + PITCH) as f64 - center).hypot(v as f64 - (l * STEP) as f64);
                (radius - off + 0.5).clamp(0.0, 1.0)
            };
            10.0 + 200.0 * all.map(disc).fold(0.0, f64::max)
        };
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // up to 210
        let tile = |v: usize| -> Vec<u8> { (0..3 * PITCH).map(|u| light(u, v) as u8).collect() };
        let rows: Vec<Vec<u8>> =
            (0..2 * STEP).map(|v| tile(v).into_iter().cycle().take(EDGE).collect()).collect();
        self.image(name, |v| rows[v % rows.len()].clone())
    }

    /// Three white images and two frames of the largest size.
    fn large_project(&self) -> String {
        let names = ["0.pgm", "1.pgm", "2.pgm"];
        for (name, radius) in names.into_iter().zip([12.0, 9.6, 7.8]) {
            self.white(radius, name);
        }
        let row = vec![100; EDGE];
        for name in ["frame-0.pgm", "frame-1.pgm"] {
            // They are not the same file.
            let level = if name == "frame-0.pgm" { 100 } else { 101 };
            self.image(name, |v| if v == 0 { vec![level; EDGE] } else { row.clone() });
        }
        let whites = names.iter().zip([4.0, 5.0, 6.15]).map(|(name, f_number)| {
            format!("[[images.whites]]\nimage = \"{name}\"\nf_number = {f_number}\n")
        });
        let project = format!(
            "[sensor]\nwidth_px = {EDGE}\nheight_px = {EDGE}\npixel_size_mm = 0.0055\n\
             [main_lens]\nfocal_length_mm = 100\nf_number = 4\nfocus_distance_mm = 1000\n\
             [micro_lens_array]\nconfiguration = \"galilean\"\nlattice = \"hexagonal-rows\"\nlens_types = 3\n\
             [board]\ncolumns = 8\nrows = 5\nsquare_mm = 3\n\
             [images]\ncolor = \"grey\"\ncalibration = [\"frame-0.pgm\", \"frame-1.pgm\"]\n{}",
            whites.collect::<String>()
        );
        self.write("project.toml", |out| out.write_all(project.as_bytes()))
    }
}
