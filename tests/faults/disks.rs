//! Disks that are full or broken, and files that are away for a moment.

use std::fs;
use std::path::Path;

use crate::place::{Fault, NONE, Place, assert_error, ended, said};
use crate::prepared::Files;

/// More calls than any of these programs makes.
const MANY: u64 = 60;

fn files(folder: &Path) -> usize {
    fs::read_dir(folder).map_or(0, Iterator::count)
}

#[test]
fn a_full_disk_is_an_error_and_leaves_nothing() {
    for bytes in [0, 100, 5_000, 100_000] {
        let place = Place::set();
        let fault =
            Fault { call: "space", at: bytes, path: "calibrated", error: "ENOSPC", hook: "" };
        assert_error(&place.calibrate(&fault), &["cannot write", "calibrated", "space"]);
        assert!(!place.path("calibrated").exists(), "{bytes}");
    }
}

/// Stages that were done before the disk was full stay, and the others are done when there is space.
#[test]
fn a_run_on_a_full_disk_goes_on_when_there_is_space() {
    for bytes in [0, 200_000, 500_000, 900_000] {
        let place = Place::set();
        let fault = Fault { call: "space", at: bytes, path: "results/", error: "ENOSPC", hook: "" };
        let output = place.run(&fault);
        if output.status.success() {
            assert!(bytes > 200_000, "a run writes more");
            continue;
        }
        assert_error(&output, &["cannot write", "space"]);
        place.assert_no_left_overs();
        assert!(place.run(&NONE).status.success());
        place.assert_undisturbed(&format!("{bytes} bytes"));
    }
}

/// Either all files are new, or the older ones are there as they were.
#[test]
fn a_broken_disk_keeps_older_results() {
    let place = Place::set();
    assert!(place.calibrate(&NONE).status.success());
    let before = Files::read(&place.path("calibrated"));
    for (call, part) in [("write", "calibrated"), ("sync", "calibrated"), ("rename", "calibrated")]
    {
        let mut failed = 0;
        for at in 1..MANY {
            let fault = Fault { call, at, path: part, error: "EIO", hook: "" };
            let output = place.calibrate(&fault);
            if output.status.success() {
                break;
            }
            assert_error(&output, &["cannot write", "calibrated"]);
            assert!(before == Files::read(&place.path("calibrated")), "{call} {at}");
            failed += 1;
        }
        assert!(failed > 3, "{call} fails several times: {failed}");
        // The last one has succeeded: the times in it are others.
        fs::remove_dir_all(place.path("calibrated")).unwrap();
        fs::create_dir(place.path("calibrated")).unwrap();
        for name in before.names() {
            fs::write(place.path("calibrated").join(name), before.get(&name.to_string_lossy()))
                .unwrap();
        }
    }
}

/// A stage that the rest can do without is no excuse: what cannot be written is missing.
#[test]
fn a_stage_that_cannot_be_written_ends_the_run() {
    for stage in ["calibration", "evaluation"] {
        for call in ["write", "sync", "rename"] {
            let place = Place::without(&[stage]);
            let path = format!("results/{stage}/");
            let fault = Fault { call, at: 1, path: &path, error: "EIO", hook: "" };
            assert_error(&place.run(&fault), &["cannot write", stage]);
            assert_eq!(files(&place.path("results").join(stage)), 0, "{stage} {call}");
            place.assert_no_left_overs();
            assert!(place.run(&NONE).status.success());
            place.assert_undisturbed(stage);
        }
    }
}

/// A failure that passes is made good by the next run, however far the run had come.
#[test]
fn an_image_that_is_away_for_a_moment_is_read_by_the_next_run() {
    for (call, error) in [("open", "ENOENT"), ("read", "EIO")] {
        let mut disturbed = 0;
        for at in 1..MANY {
            let place = Place::set();
            let fault = Fault { call, at, path: "calibration-01.png", error, hook: "" };
            let output = place.run(&fault);
            let is_said = said(&output).contains("calibration-01.png");
            let again = place.run(&NONE);
            assert!(again.status.success(), "{}", said(&again));
            place.assert_undisturbed(&format!("{call} {at}"));
            disturbed += u64::from(is_said);
            if !is_said && at > 8 {
                break;
            }
        }
        assert!(disturbed > 0, "{call} is noticed");
    }
}

/// The results are those of the image that is there in the end.
#[test]
fn an_image_that_is_replaced_while_it_is_read_is_read_again() {
    let other = "set/calibration/other.png";
    let hook = "mv set/calibration/other.png set/calibration/calibration-01.png";
    let replaced = |place: &Place| {
        let path = place.path("set/calibration/calibration-01.png");
        let mut image = image::open(path).unwrap().to_luma8();
        image.pixels_mut().for_each(|pixel| pixel.0[0] = pixel.0[0].saturating_add(1));
        image.save(place.path(other)).unwrap();
    };
    let expected = {
        let place = Place::set();
        replaced(&place);
        let moved = place.path("set/calibration/calibration-01.png");
        fs::rename(place.path(other), moved).unwrap();
        assert!(place.run(&NONE).status.success());
        fs::read(place.path("results/boards-calibration/features.csv")).unwrap()
    };
    let mut noticed = 0;
    for at in 1..=6 {
        let place = Place::set();
        replaced(&place);
        let fault = Fault { call: "open", at, path: "calibration-01.png", error: "", hook };
        let first = place.run(&fault);
        noticed += u64::from(said(&first).contains("the file changed during the run"));
        let again = place.run(&NONE);
        assert!(again.status.success(), "{}", said(&again));
        let found = fs::read(place.path("results/boards-calibration/features.csv")).unwrap();
        assert!(found == expected, "open {at}");
    }
    assert!(noticed > 0, "some changes come between");
}

#[test]
fn a_result_that_nobody_can_receive_is_an_error() {
    let place = Place::done();
    for arguments in [
        &["run", "set/project.toml", "--folds", "0", "--no-pictures"][..],
        &["calibrate", "set/observed/project.toml"],
        &["detect", "set/project.toml", "--precalibration", "results/precalibration"],
        &["precalibrate", "set/project.toml"],
    ] {
        for json in [&["--json"][..], &[]] {
            let full = fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
            let mut command = place.program();
            command.args(arguments).args(json).args(["--out", "out"]);
            let mut child =
                command.stdout(full).stderr(std::process::Stdio::piped()).spawn().unwrap();
            let status = child.wait().unwrap();
            assert_eq!(status.code(), Some(1), "{arguments:?} {json:?}");
        }
    }
}

/// Two runs into one folder would mix their stages.
#[test]
fn a_second_run_into_the_same_folder_is_refused() {
    let place = Place::without(&["evaluation"]);
    let fault =
        Fault { call: "rename", at: 1, path: "results/", error: "", hook: "touch held; sleep 4" };
    let mut first = place.running(&fault);
    let child = first.stdout(std::process::Stdio::null()).stderr(std::process::Stdio::null());
    let mut child = child.spawn().unwrap();
    while !place.path("held").exists() {
        assert!(child.try_wait().unwrap().is_none(), "the first run holds the folder");
        std::thread::sleep(std::time::Duration::from_millis(10));
    }
    let second = ended(place.running(&NONE));
    assert_error(&second, &["results", "in use by another run"]);
    assert!(child.wait().unwrap().success());
    fs::remove_file(place.path("held")).unwrap();
    place.assert_undisturbed("the first run");
}
