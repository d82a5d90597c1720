//! A small simulated set, its results, and runs with a fault.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::LazyLock;
use std::thread::sleep;
use std::time::{Duration, Instant};

use plenocal::model::PlenopticCamera;
use tempfile::TempDir;

use crate::prepared::Files;

/// A run takes some seconds.
const PATIENCE: Duration = Duration::from_secs(60);
const TICK: Duration = Duration::from_millis(5);
/// The smallest set that is calibrated.
const SETTINGS: [&str; 5] = [
    "rays=12",
    "boards.calibration=4",
    "boards.evaluation=1",
    "translation.images=0",
    "white_images.f_numbers=[4.0, 8.0, 16.0]",
];
/// How names of temporary files begin.
const TEMPORARY: &str = ".plenocal-";

/// The faults, as a library to be loaded before the program.
static SHIM: LazyLock<(TempDir, PathBuf)> = LazyLock::new(|| {
    let folder = TempDir::new().unwrap();
    let library = folder.path().join("shim.so");
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/faults/shim.c");
    let mut compiler = Command::new("cc");
    compiler.args(["-shared", "-fPIC", "-O1", "-o"]).arg(&library).arg(source).arg("-ldl");
    assert!(compiler.status().unwrap().success());
    (folder, library)
});

/// Contain times, or what contains them.
const TIMED: [&str; 2] = ["manifest.json", "report.html"];
/// Stages that refine: the last bits of what comes out are not the same in every process.
const REFINED: [&str; 3] = ["calibration", "evaluation", "verdict.json"];
/// By how much parameters of a camera may differ, of themselves or of 1.
const SAME: f64 = 1e-2;

/// The set, and its results by an undisturbed run.
struct Undisturbed {
    set: Files,
    done: Files,
}

static UNDISTURBED: LazyLock<Undisturbed> = LazyLock::new(|| {
    let place = Place { folder: TempDir::new().unwrap() };
    let mut simulate = place.program();
    simulate.arg("simulate").args(SETTINGS.iter().flat_map(|set| ["--set", set]));
    assert!(simulate.args(["--out", "set"]).output().unwrap().status.success());
    let project = place.path("set/project.toml");
    let text = fs::read_to_string(&project).unwrap() + "\n[calibration]\nthreads = 1\n";
    fs::write(project, text).unwrap();
    let set = Files::read(place.folder.path());
    let output = place.run(&NONE);
    assert!(output.status.success(), "{}", said(&output));
    Undisturbed { set, done: Files::read(place.folder.path()) }
});

/// What goes wrong; see `shim.c`.
#[derive(Debug, Clone, Copy)]
pub struct Fault<'a> {
    pub call: &'a str,
    pub at: u64,
    pub path: &'a str,
    pub error: &'a str,
    pub hook: &'a str,
}

pub const NONE: Fault = Fault { call: "", at: 0, path: "", error: "", hook: "" };

/// A folder with the set, and perhaps with results.
pub struct Place {
    pub folder: TempDir,
}

impl Place {
    /// The set alone.
    pub fn set() -> Self {
        Self { folder: UNDISTURBED.set.copy() }
    }

    /// The set with the results of a run.
    pub fn done() -> Self {
        Self { folder: UNDISTURBED.done.copy() }
    }

    /// The set with the results of the stages that are not named.
    pub fn without(stages: &[&str]) -> Self {
        let place = Self::done();
        for stage in stages {
            fs::remove_dir_all(place.path("results").join(stage)).unwrap();
        }
        place
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// The program in this folder, on one thread.
    pub fn program(&self) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_plenocal"));
        command.current_dir(self.folder.path()).env("RAYON_NUM_THREADS", "1").stdin(Stdio::null());
        command
    }

    /// A whole run.
    pub fn run(&self, fault: &Fault) -> Output {
        ended(self.running(fault))
    }

    /// A whole run, to be started.
    pub fn running(&self, fault: &Fault) -> Command {
        let mut run = self.program();
        run.args(["run", "set/project.toml", "--out", "results", "--folds", "0", "--no-pictures"]);
        with_fault(&mut run, fault);
        run
    }

    /// A calibration from the observations that were drawn.
    pub fn calibrate(&self, fault: &Fault) -> Output {
        let mut calibrate = self.program();
        calibrate.args(["calibrate", "set/observed/project.toml", "--out", "calibrated"]);
        with_fault(&mut calibrate, fault);
        ended(calibrate)
    }

    /// Asserts that the files are those of an undisturbed run, and what is measured in images the same to the last bit;
    /// that the cameras are the same, and that no other file is there.
    pub fn assert_undisturbed(&self, what: &str) {
        let found = Files::read(self.folder.path());
        let mut differing = UNDISTURBED.done.differing(&found);
        differing.retain(|path| !TIMED.iter().any(|name| path.ends_with(name)));
        differing.retain(|path| {
            !REFINED.iter().any(|stage| path.starts_with(Path::new("results").join(stage)))
        });
        assert!(differing.is_empty(), "{what}: {differing:?}");
        let [ours, theirs] = [&found, &UNDISTURBED.done].map(|files| {
            let camera = files.get("results/calibration/camera.json");
            serde_json::from_slice::<PlenopticCamera>(camera).unwrap().intrinsics()
        });
        for (a, b) in ours.into_iter().zip(theirs) {
            assert!((a - b).abs() < SAME * b.abs().max(1.0), "{what}: {a}, not {b}");
        }
    }

    /// Asserts that no temporary file is there.
    pub fn assert_no_left_overs(&self) {
        let mut open = vec![self.folder.path().to_owned()];
        while let Some(folder) = open.pop() {
            for path in fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()) {
                assert!(!path.to_string_lossy().contains(TEMPORARY), "{}", path.display());
                if path.is_dir() {
                    open.push(path);
                }
            }
        }
    }
}

fn with_fault(command: &mut Command, fault: &Fault) {
    if fault.call.is_empty() {
        return;
    }
    command.env("LD_PRELOAD", &SHIM.1).env("FAULT_CALL", fault.call);
    command.env("FAULT_AT", fault.at.to_string()).env("FAULT_PATH", fault.path);
    command.env("FAULT_ERROR", fault.error).env("FAULT_HOOK", fault.hook);
}

/// Waits for the end of a program, which has to come.
pub fn ended(mut command: Command) -> Output {
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let begun = Instant::now();
    // What is printed fits into the pipes.
    while child.try_wait().unwrap().is_none() {
        if begun.elapsed() > PATIENCE {
            child.kill().unwrap();
            panic!("it does not end: {command:?}");
        }
        sleep(TICK);
    }
    child.wait_with_output().unwrap()
}

/// What a program has said.
pub fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Asserts that a program has ended with an error that contains these words.
pub fn assert_error(output: &Output, words: &[&str]) {
    let said = said(output);
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(!said.contains("panicked"), "{said}");
    for word in words {
        assert!(said.contains(word), "{word}: {said}");
    }
}
