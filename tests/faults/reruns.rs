//! Runs into a folder with the results of another project.

use std::fs;

use crate::place::{NONE, Place, assert_error};

/// The manifest is that of the new project; the report of the old one would seem to be its.
#[test]
fn a_failed_run_of_another_project_leaves_no_report_of_the_first() {
    let place = Place::done();
    let project = place.path("set/project.toml");
    let text = fs::read_to_string(&project).unwrap();
    // Other white images, which are measured, and a board that is not found.
    let other =
        text.replace("f_number = 16\n", "f_number = 16.1\n").replace("columns = 8", "columns = 25");
    assert_ne!(text, other);
    fs::write(&project, other).unwrap();
    assert_error(&place.run(&NONE), &["no frame shows the board"]);
    for name in ["results/report.html", "results/verdict.json"] {
        assert!(!place.path(name).exists(), "{name}");
    }
    fs::write(&project, text).unwrap();
    assert!(place.run(&NONE).status.success());
    place.assert_undisturbed("the first project again");
}

/// Nothing was replaced: the report is still that of the manifest.
#[test]
fn a_run_that_fails_at_once_keeps_the_report() {
    let place = Place::done();
    fs::remove_file(place.path("set/whites/white-1-n-8.00.png")).unwrap();
    assert_error(&place.run(&NONE), &["white-1-n-8.00.png"]);
    assert!(place.path("results/report.html").exists());
}
