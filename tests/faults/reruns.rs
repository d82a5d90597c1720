//! Runs into a folder with the results of another project.

use std::fs;

use crate::place::{NONE, Place, assert_error};

/// Nothing is replaced before everything is there to replace it.
#[test]
fn a_failed_run_keeps_the_earlier_results() {
    let place = Place::done();
    let project = place.path("set/project.toml");
    let text = fs::read_to_string(&project).unwrap();
    // A board that is not found.
    let other = text.replace("columns = 8", "columns = 25");
    assert_ne!(text, other);
    fs::write(&project, other).unwrap();
    assert_error(&place.run(&NONE), &["no frame shows the board"]);
    fs::write(&project, text).unwrap();
    place.assert_undisturbed("the results of the first run");
}
