//! Ctrl-C leaves nothing half-written.

use std::fs;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use tempfile::TempDir;

use crate::support::plenocal;

const PATIENCE: Duration = Duration::from_secs(60);
const TICK: Duration = Duration::from_millis(10);

/// Number of files in a folder and its subfolders.
fn files(folder: &Path) -> usize {
    let Ok(entries) = fs::read_dir(folder) else { return 0 };
    let count = |path: &Path| if path.is_dir() { files(path) } else { 1 };
    entries.flatten().map(|entry| count(&entry.path())).sum()
}

/// Starts a long simulation and returns once its first image is being written.
fn simulation(out: &Path) -> Child {
    let program = assert_cmd::cargo::cargo_bin("plenocal");
    let mut command = if cfg!(target_os = "linux") {
        // A background process of a script ignores interrupts, and its children inherit that.
        let mut command = Command::new("env");
        command.arg("--default-signal=INT,TERM,HUP").arg(program);
        command
    } else {
        Command::new(program)
    };
    let child = command
        .args(["simulate", "--set", "rays=64", "--out"])
        .arg(out)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let begun = Instant::now();
    while files(&out.join("whites")) == 0 {
        assert!(begun.elapsed() < PATIENCE, "no temporary file appears");
        sleep(TICK);
    }
    child
}

fn send(signal: &str, child: &Child) {
    let status = Command::new("kill").args([signal, &child.id().to_string()]).status().unwrap();
    assert!(status.success());
}

fn assert_interrupted(output: &Output) {
    let words = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(130), "{words}");
    assert_eq!(words, "interrupted: nothing was written\n");
    assert!(output.stdout.is_empty());
}

#[test]
fn an_interrupt_leaves_nothing_behind() {
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("new/set");
    for signal in ["-INT", "-TERM"] {
        let child = simulation(&out);
        send(signal, &child);
        assert_interrupted(&child.wait_with_output().unwrap());
        assert!(!folder.path().join("new").exists(), "{signal}");
    }
    // The folder can be used afterwards.
    let few = ["rays=1", "boards.calibration=0", "boards.evaluation=0", "translation.images=0"];
    let mut command = plenocal();
    command.arg("simulate").args(few.iter().flat_map(|set| ["--set", set]));
    command.arg("--out").arg(&out).assert().success();
    assert!(out.join("project.toml").is_file());
}

#[test]
fn an_interrupt_keeps_older_files() {
    let folder = TempDir::new().unwrap();
    let older = folder.path().join("devignetting.png");
    fs::write(&older, "older").unwrap();
    let child = simulation(folder.path());
    send("-INT", &child);
    // A second interrupt changes nothing.
    let _ = Command::new("kill").args(["-INT", &child.id().to_string()]).output();
    assert_interrupted(&child.wait_with_output().unwrap());
    assert_eq!(fs::read_to_string(&older).unwrap(), "older");
    assert_eq!(files(folder.path()), 1);
}

/// Nobody reads stderr any more when the interrupt arrives.
#[test]
fn an_interrupt_ends_a_program_whose_stderr_is_closed() {
    let folder = TempDir::new().unwrap();
    let mut child = simulation(&folder.path().join("set"));
    drop(child.stderr.take());
    send("-INT", &child);
    let begun = Instant::now();
    let status = loop {
        if let Some(status) = child.try_wait().unwrap() {
            break status;
        }
        if begun.elapsed() > PATIENCE {
            child.kill().unwrap();
            panic!("it does not end");
        }
        sleep(TICK);
    };
    assert_eq!(status.code(), Some(130));
    assert!(!folder.path().join("set").exists());
}
