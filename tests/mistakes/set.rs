//! Copies of simulated sets, to make mistakes in.

use std::fs;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::LazyLock;

use tempfile::TempDir;

/// The program.
pub const PLENOCAL: &str = env!("CARGO_BIN_EXE_plenocal");

/// Copies of sets, and the simulated ones if no other folder is given for them.
static FOLDER: LazyLock<TempDir> = LazyLock::new(|| {
    TempDir::new_in(env!("CARGO_TARGET_TMPDIR")).expect("the folder of the tests is writable")
});
/// A folder that keeps simulated sets for later runs. It has to be emptied after a change of the simulation.
const SETS: &str = "PLENOCAL_SETS";

/// What the program is asked to do with a set.
#[derive(Debug, Clone)]
pub enum Task {
    /// `run`, with these arguments besides.
    Run(Vec<String>),
    /// `calibrate` from the features of the truth, with these arguments besides.
    Calibrate(Vec<String>),
}

/// A copy of a simulated set. Files are links until they are written.
pub struct Set {
    folder: TempDir,
    pub task: Task,
    /// The true step of the translation, mm; 0 where nothing is known of it.
    pub step_mm: f64,
}

/// The project of the sets, in their folder.
const PROJECT: &str = "project.toml";
/// The step of `mini`.
const STEP_MM: f64 = 5.0;

/// The folder of a simulated set: preset and settings, or a settings file. `mini` if nothing is said.
pub fn simulated(arguments: &[&str]) -> PathBuf {
    let sets = std::env::var_os(SETS).map_or_else(|| FOLDER.path().to_owned(), PathBuf::from);
    let mut hash = DefaultHasher::new();
    arguments.hash(&mut hash);
    let (folder, begun) = (sets.join(format!("{:016x}", hash.finish())), sets.join("begun"));
    if folder.exists() {
        return folder;
    }
    let mut command = Command::new(PLENOCAL);
    command.arg("simulate");
    if !arguments.contains(&"--preset") {
        command.args(["--preset", "mini"]);
    }
    if begun.exists() {
        fs::remove_dir_all(&begun).expect("an unfinished set can be removed");
    }
    let output = command.args(arguments).arg("--out").arg(&begun).output().expect("it runs");
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    fs::rename(&begun, &folder).expect("the set is kept");
    folder
}

impl Set {
    /// A copy of `mini`, to be run.
    pub fn mini() -> Self {
        Self::of(&[])
    }

    /// A copy of a set simulated with these arguments.
    pub fn of(arguments: &[&str]) -> Self {
        let folder = TempDir::new_in(FOLDER.path()).expect("the folder of the tests is writable");
        link(&simulated(arguments), folder.path());
        Self { folder, task: Task::Run(Vec::new()), step_mm: STEP_MM }
    }

    pub fn path(&self) -> &Path {
        self.folder.path()
    }

    /// The same, with more arguments for the program.
    pub fn with(mut self, arguments: &[&str]) -> Self {
        let (Task::Run(all) | Task::Calibrate(all)) = &mut self.task;
        all.extend(arguments.iter().map(ToString::to_string));
        self
    }

    /// The same, to be calibrated from its files of observations.
    pub fn calibrated(mut self, arguments: &[&str]) -> Self {
        self.task = Task::Calibrate(Vec::new());
        self.with(arguments)
    }

    /// The same, where nothing is known of the step of the translation.
    pub fn without_step(mut self) -> Self {
        self.step_mm = 0.0;
        self
    }

    pub fn project(&self) -> PathBuf {
        self.path().join(PROJECT)
    }

    pub fn project_text(&self) -> String {
        fs::read_to_string(self.project()).expect("there is a project")
    }

    /// Writes a file of the set, in place of a link.
    pub fn write(&self, name: &str, content: impl AsRef<[u8]>) {
        let path = self.path().join(name);
        if path.symlink_metadata().is_ok() {
            fs::remove_file(&path).expect("it can be replaced");
        }
        fs::write(path, content).expect("it can be written");
    }

    /// Puts a file of the set into the place of another, or one of another set.
    pub fn replace(&self, name: &str, by: &Path) {
        let content = fs::read(by).unwrap_or_else(|e| panic!("{}: {e}", by.display()));
        self.write(name, content);
    }

    /// The project with a piece of its text replaced everywhere.
    pub fn text(self, from: &str, to: &str) -> Self {
        let text = self.project_text();
        assert!(text.contains(from), "the project has no {from:?}:\n{text}");
        self.write(PROJECT, text.replace(from, to));
        self
    }

    /// The project with another value of the first key of this name.
    pub fn value(self, key: &str, value: &str) -> Self {
        let text = self.project_text();
        let begins = format!("{key} = ");
        let old = text.lines().find(|l| l.starts_with(&begins));
        let old = old.unwrap_or_else(|| panic!("the project has no {key}:\n{text}")).to_owned();
        let new = format!("{begins}{value}");
        self.write(PROJECT, text.replacen(&old, &new, 1));
        self
    }

    /// The project with more text at its end.
    pub fn more(self, lines: &str) -> Self {
        self.write(PROJECT, format!("{}\n{lines}\n", self.project_text()));
        self
    }

    /// Names of the images of a role, by the folder they are in.
    pub fn images(&self, role: &str) -> Vec<String> {
        let folder = self.path().join(role);
        let entries = fs::read_dir(&folder).unwrap_or_else(|e| panic!("{}: {e}", folder.display()));
        let mut names: Vec<String> = entries
            .map(|entry| {
                format!("{role}/{}", entry.expect("it is read").file_name().to_string_lossy())
            })
            .collect();
        names.sort();
        names
    }
}

/// Links all files of a folder into another; the project is copied.
fn link(from: &Path, to: &Path) {
    for entry in fs::read_dir(from).expect("the set is read") {
        let entry = entry.expect("the set is read");
        let (source, target) = (entry.path(), to.join(entry.file_name()));
        if source.is_dir() {
            fs::create_dir(&target).expect("the copy is written");
            link(&source, &target);
        } else if entry.file_name() == PROJECT {
            fs::copy(&source, &target).expect("the copy is written");
        } else {
            std::os::unix::fs::symlink(&source, &target).expect("the copy is written");
        }
    }
}
