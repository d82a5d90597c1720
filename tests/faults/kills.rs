//! Kills that no program can catch, at any moment at which files get their names.

use std::fs;
use std::os::unix::process::ExitStatusExt;

use crate::place::{Fault, NONE, Place, said};

const SIGKILL: i32 = 9;
/// More renames than a run has.
const MANY: u64 = 200;

/// Of the renames with which a run ends, so many apart.
const STEP: usize = 3;

/// Files that have got their names before the kill are those of the run; the next run completes them.
#[test]
fn a_kill_at_a_rename_is_made_good_by_the_next_run() {
    for at in (1..MANY).step_by(STEP) {
        let place = Place::set();
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
    }
    panic!("the run has no end");
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
