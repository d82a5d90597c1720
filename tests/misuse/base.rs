//! A set, its calibrated camera, and files of them to be misused.

use std::fmt::{Display, Write as _};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::LazyLock;

use serde_json::Value;
use tempfile::TempDir;

/// The program.
pub const PLENOCAL: &str = env!("CARGO_BIN_EXE_plenocal");

/// A calibrated set.
pub struct Base {
    folder: TempDir,
    /// The folder of the set.
    pub set: PathBuf,
    /// Virtual depths, as CSV.
    pub depths: String,
    /// Near, median and far distance of their points, mm.
    pub points_mm: [f64; 3],
}

/// The set that all cases use.
pub static BASE: LazyLock<Base> = LazyLock::new(Base::new);

fn plenocal(arguments: &[&str]) -> String {
    let output = Command::new(PLENOCAL).args(arguments).output().expect("the program runs");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{arguments:?}: {said}");
    String::from_utf8_lossy(&output.stdout).into_owned()
}

fn text(path: &Path) -> &str {
    path.to_str().expect("the folder of the tests is UTF-8")
}

impl Base {
    fn new() -> Self {
        let folder = TempDir::new_in(env!("CARGO_TARGET_TMPDIR")).expect("it is writable");
        let set = folder.path().join("set");
        plenocal(&["simulate", "--preset", "mini", "--set", "seed=2207", "--out", text(&set)]);
        let results = set.join("results");
        let project = set.join("project.toml");
        plenocal(&["run", text(&project), "--no-pictures", "--out", text(&results)]);
        let mut base = Self { folder, set, depths: String::new(), points_mm: [0.0; 3] };
        base.depths = base.virtual_depths();
        let input = base.folder.path().join("depths.csv");
        fs::write(&input, &base.depths).expect("it is writable");
        let out = base.folder.path().join("points");
        let camera = base.camera();
        let done =
            plenocal(&["points", text(&camera), text(&input), "--json", "--out", text(&out)]);
        let document: Value = serde_json::from_str(&done).expect("it is JSON");
        base.points_mm = ["near", "median", "far"]
            .map(|part| document["distance_mm"][part].as_f64().expect("there are points"));
        base
    }

    /// The calibrated camera.
    pub fn camera(&self) -> PathBuf {
        self.set.join("results/calibration/camera.json")
    }

    /// The pre-calibration.
    pub fn precalibration(&self) -> PathBuf {
        self.set.join("results/precalibration")
    }

    /// The measured features of a subset.
    pub fn features(&self, subset: &str) -> PathBuf {
        self.set.join(format!("results/boards-{subset}/features.csv"))
    }

    /// Whether a file is a table of these virtual depths, changed or not.
    pub fn has_depths_of(&self, input: &str) -> bool {
        let lines = |text: &str| text.lines().count();
        fs::read_to_string(input)
            .is_ok_and(|text| text.contains("nu") && lines(&text).abs_diff(lines(&self.depths)) < 5)
    }

    /// Virtual depths at the features of the evaluation, all near 3: CSV `k,l,u,v,nu,std_nu`.
    fn virtual_depths(&self) -> String {
        let features = fs::read_to_string(self.features("evaluation")).expect("there are features");
        let mut lines = features.lines();
        let names: Vec<&str> = lines.next().unwrap_or_default().split(',').collect();
        let column = |name: &str| names.iter().position(|n| *n == name).expect("a column");
        let at = ["k", "l", "u", "v"].map(column);
        let mut csv = "k,l,u,v,nu,std_nu\n".to_owned();
        for (number, line) in lines.enumerate() {
            let fields: Vec<&str> = line.split(',').collect();
            let nu = 3.0 + 0.001 * f64::from(u32::try_from(number % 500).unwrap_or(0));
            let place = at.map(|i| fields[i]).join(",");
            let _ = writeln!(csv, "{place},{nu},0.01");
        }
        csv
    }
}

/// A folder of one case.
pub struct Scratch(TempDir);

impl Scratch {
    pub fn new() -> Self {
        Self(TempDir::new_in(BASE.folder.path()).expect("the folder of the tests is writable"))
    }

    pub fn folder(&self) -> &Path {
        self.0.path()
    }

    /// The path of a file in it.
    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// Writes a file.
    pub fn write(&self, name: &str, content: impl AsRef<[u8]>) -> String {
        let path = self.path(name);
        fs::write(&path, content).expect("the folder of the tests is writable");
        text(&path).to_owned()
    }

    /// Writes the calibrated camera with some change.
    pub fn camera(&self, change: impl Fn(&mut Value)) -> String {
        let content = fs::read_to_string(BASE.camera()).expect("there is a camera");
        let mut camera: Value = serde_json::from_str(&content).expect("it is JSON");
        change(&mut camera);
        self.write("camera.json", camera.to_string())
    }

    /// Writes a CSV file with some change of its rows; columns by name.
    pub fn table(&self, content: &str, change: impl Fn(usize, &mut Row)) -> String {
        let mut lines = content.lines();
        let names: Vec<String> =
            lines.next().unwrap_or_default().split(',').map(str::to_owned).collect();
        let mut changed = vec![names.join(",")];
        for (number, line) in lines.enumerate() {
            let fields = line.split(',').map(str::to_owned).collect();
            let mut row = Row { names: &names, fields };
            change(number, &mut row);
            changed.push(row.fields.join(","));
        }
        self.write("table.csv", changed.join("\n") + "\n")
    }
}

/// A row of a CSV file.
pub struct Row<'a> {
    names: &'a [String],
    fields: Vec<String>,
}

impl Row<'_> {
    fn column(&self, name: &str) -> usize {
        self.names.iter().position(|n| n == name).unwrap_or_else(|| panic!("no column {name}"))
    }

    pub fn get(&self, name: &str) -> f64 {
        self.fields[self.column(name)].parse().unwrap_or(f64::NAN)
    }

    pub fn set(&mut self, name: &str, value: impl Display) {
        let column = self.column(name);
        self.fields[column] = value.to_string();
    }

    pub fn swap(&mut self, a: &str, b: &str) {
        let (a, b) = (self.column(a), self.column(b));
        self.fields.swap(a, b);
    }
}

/// Arguments as owned texts.
pub fn arguments(all: &[&str]) -> Vec<String> {
    all.iter().map(ToString::to_string).collect()
}

/// `extrinsics` with a camera.
pub fn extrinsics(camera: &str, more: &[&str]) -> Vec<String> {
    let (project, white) = (BASE.set.join("project.toml"), BASE.precalibration());
    let begin =
        ["extrinsics", text(&project), "--camera", camera, "--precalibration", text(&white)];
    arguments(&[&begin, more].concat())
}

/// `evaluate` with a camera.
pub fn evaluate(camera: &str, more: &[&str]) -> Vec<String> {
    let mut all = extrinsics(camera, more);
    "evaluate".clone_into(&mut all[0]);
    all
}

/// `calibrate --mode poses-only` with a camera and features.
pub fn poses_only(camera: &str, features: &str, more: &[&str]) -> Vec<String> {
    let project = BASE.set.join("project.toml");
    let begin = ["calibrate", text(&project), "--mode", "poses-only", "--camera", camera];
    arguments(&[&begin, ["--features", features].as_slice(), more].concat())
}

/// The calibrated camera, as an argument.
pub fn own_camera() -> String {
    text(&BASE.camera()).to_owned()
}

/// The measured features of a subset, as an argument.
pub fn own_features(subset: &str) -> String {
    text(&BASE.features(subset)).to_owned()
}
