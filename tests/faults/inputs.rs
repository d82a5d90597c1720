//! Inputs that are no files.

use std::fs;
use std::process::{Command, Output, Stdio};

use crate::place::{Place, assert_error, ended, said};

/// Makes a pipe in the place of a file, into which nobody writes.
fn pipe(place: &Place, name: &str) {
    let path = place.path(name);
    let _ = fs::remove_file(&path);
    assert!(Command::new("mkfifo").arg(path).status().unwrap().success());
}

fn run(place: &Place, arguments: &[&str]) -> Output {
    let mut command = place.program();
    command.args(arguments).args(["--out", "out"]);
    ended(command)
}

#[test]
fn a_pipe_in_the_place_of_a_file_is_refused() {
    let calibrate: &[&str] = &["calibrate", "set/observed/project.toml"];
    let detect: &[&str] =
        &["detect", "set/project.toml", "--precalibration", "results/precalibration"];
    for (name, arguments) in [
        ("set/observed/project.toml", calibrate),
        ("set/observed/features.csv", calibrate),
        ("set/observed/centers.csv", calibrate),
        ("set/whites/white-1-n-8.00.png", &["precalibrate", "set/project.toml"]),
        ("white.png", &["precalibrate", "white.png"]),
        ("calib.xml", &["precalibrate", "calib.xml"]),
        ("simulation.toml", &["simulate", "simulation.toml"]),
        ("results/precalibration/precalibration.json", detect),
        ("set/devignetting.png", detect),
        ("set/calibration/calibration-00.png", &["run", "set/project.toml"]),
        ("set/whites/white-1-n-8.00.png", &["init", "set"]),
        ("poses.json", &["simulate", "--poses", "poses.json", "--set", "rays=1"]),
    ] {
        let place = Place::done();
        pipe(&place, name);
        let file = name.rsplit('/').next().unwrap();
        assert_error(&run(&place, arguments), &[file, "a pipe or a device"]);
        assert!(!place.path("out").exists(), "{name}");
    }
}

/// One board that cannot be read is left out.
#[test]
fn a_pipe_in_the_place_of_a_board_is_named() {
    let place = Place::done();
    pipe(&place, "set/calibration/calibration-00.png");
    let detect = ["detect", "set/project.toml", "--precalibration", "results/precalibration"];
    let output = run(&place, &detect);
    assert!(said(&output).contains("a pipe or a device"), "{}", said(&output));
}

#[test]
fn devices_and_folders_are_refused() {
    let place = Place::set();
    let calibrate = ["calibrate", "set/observed/project.toml", "--features"];
    for (name, word) in [("/dev/zero", "a device"), ("set", "a folder")] {
        assert_error(&run(&place, &[&calibrate[..], &[name]].concat()), &[name, word]);
    }
}

/// What the shell has opened is read, even if it is a pipe.
#[test]
fn standard_input_is_read() {
    let place = Place::set();
    let features = fs::File::open(place.path("set/observed/features.csv")).unwrap();
    let mut cat = Command::new("cat").stdin(features).stdout(Stdio::piped()).spawn().unwrap();
    let mut command = place.program();
    command.args(["calibrate", "set/observed/project.toml", "--features", "/dev/stdin"]);
    command.args(["--out", "out"]).stdin(cat.stdout.take().unwrap());
    let output = ended(command);
    assert!(output.status.success(), "{}", said(&output));
    cat.wait().unwrap();
}
