//! Kills that no program can catch, at any moment at which files get their names.

use std::fs;
use std::os::unix::process::ExitStatusExt;

use crate::place::{Fault, NONE, Place, said};

const SIGKILL: i32 = 9;
/// More renames than a run has.
const MANY: u64 = 200;

/// Kills runs at each rename, until the run ends or a folder has got its files; then runs again.
fn kill_at_each_rename(start: impl Fn() -> Place, until: Option<&str>) {
    for at in 1..MANY {
        let place = start();
        let error = if at % 2 == 0 { "KILL" } else { "KILLED" };
        let fault = Fault { call: "rename", at, path: "results/", error, hook: "" };
        let output = place.run(&fault);
        if output.status.success() {
            assert!(at > 5, "a run has more renames");
            return;
        }
        assert_eq!(output.status.signal(), Some(SIGKILL), "{}", said(&output));
        let again = place.run(&NONE);
        assert!(again.status.success(), "{at}: {}", said(&again));
        place.assert_no_left_overs();
        place.assert_undisturbed(&format!("rename {at}"));
        if until.is_some_and(|stage| said(&again).contains(&format!("{stage}: unchanged"))) {
            return;
        }
    }
    panic!("the run has no end");
}

#[test]
fn a_kill_in_the_first_stage_is_made_good() {
    kill_at_each_rename(Place::set, Some("precalibration"));
}

#[test]
fn a_kill_in_the_detection_is_made_good() {
    let stages = ["boards-calibration", "boards-evaluation", "calibration", "corners-only"];
    let start = || Place::without(&[&stages[..], &["evaluation"]].concat());
    kill_at_each_rename(start, Some("boards-calibration"));
}

#[test]
fn a_kill_in_the_calibration_is_made_good() {
    kill_at_each_rename(|| Place::without(&["calibration", "corners-only", "evaluation"]), None);
}

/// What a killed run has left is removed by the next one; files of others stay.
#[test]
fn left_overs_are_removed() {
    let place = Place::done();
    let left = ["results/.plenocal-a1B2c3.tmp", "results/calibration/.plenocal-x.tmp"];
    let others = ["results/.tmpa1B2c3", "results/.plenocal-notes", "results/calibration/my.tmp"];
    for name in left.iter().chain(&others) {
        fs::write(place.path(name), "").unwrap();
    }
    assert!(place.run(&NONE).status.success());
    place.assert_left(&left, &others);
}

impl Place {
    fn assert_left(&self, gone: &[&str], there: &[&str]) {
        for name in gone {
            assert!(!self.path(name).exists(), "{name}");
        }
        for name in there {
            assert!(self.path(name).exists(), "{name}");
        }
    }
}
