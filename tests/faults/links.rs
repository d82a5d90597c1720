//! Damaged manifests and links that lead out of the folder of a run.

use std::fs;
use std::os::unix::fs::symlink;

use serde_json::{Value, json};

use crate::place::{NONE, Place, assert_error, said};

/// Changes the manifest of a run.
fn edit(place: &Place, edit: impl FnOnce(&mut Value)) {
    let path = place.path("results/manifest.json");
    let mut manifest = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
    edit(&mut manifest);
    fs::write(path, manifest.to_string()).unwrap();
}

/// Files that a manifest claims to be of a stage are removed only within its folder.
#[test]
fn a_damaged_manifest_removes_nothing_elsewhere() {
    for stage in [0, 2, 4] {
        let place = Place::done();
        fs::write(place.path("victim.txt"), "mine").unwrap();
        let absolute = place.path("victim.txt").display().to_string();
        edit(&place, |manifest| {
            let record = &mut manifest["stages"][stage];
            for name in ["../../victim.txt", "../report.html", &absolute, "a/../../../victim.txt"] {
                record["files"].as_array_mut().unwrap().push(json!(name));
            }
        });
        let output = place.run(&NONE);
        assert!(output.status.success(), "{}", said(&output));
        assert_eq!(fs::read_to_string(place.path("victim.txt")).unwrap(), "mine");
        fs::remove_file(place.path("victim.txt")).unwrap();
        place.assert_undisturbed("the manifest was damaged");
    }
}

#[test]
fn a_manifest_that_is_none_starts_anew() {
    for text in ["", "{}", "[", "null", "{\"format\": \"plenocal-run\", \"version\": 2}"] {
        let place = Place::done();
        fs::write(place.path("results/manifest.json"), text).unwrap();
        let output = place.run(&NONE);
        assert!(output.status.success(), "{}", said(&output));
        place.assert_undisturbed(text);
    }
}

/// Through a linked folder, files elsewhere would be replaced.
#[test]
fn a_linked_folder_of_a_stage_is_refused() {
    for stage in ["precalibration", "boards-calibration", "calibration"] {
        let place = Place::done();
        fs::create_dir(place.path("elsewhere")).unwrap();
        let mine = ["camera.json", "calibration.json", "features.csv", "old.svg"];
        for name in mine {
            fs::write(place.path("elsewhere").join(name), "mine").unwrap();
        }
        let folder = place.path("results").join(stage);
        fs::remove_dir_all(&folder).unwrap();
        symlink(place.path("elsewhere"), &folder).unwrap();
        assert_error(&place.run(&NONE), &[stage, "is a link", "remove"]);
        for name in mine {
            assert_eq!(fs::read_to_string(place.path("elsewhere").join(name)).unwrap(), "mine");
        }
        assert_eq!(fs::read_dir(place.path("elsewhere")).unwrap().count(), mine.len());
    }
}

/// A result that is a link is replaced, and what it leads to stays.
#[test]
fn a_linked_result_is_replaced() {
    let place = Place::done();
    fs::write(place.path("victim.txt"), "mine").unwrap();
    for name in ["results/report.html", "results/calibration/camera.json"] {
        fs::remove_file(place.path(name)).unwrap();
        symlink(place.path("victim.txt"), place.path(name)).unwrap();
    }
    assert!(place.run(&NONE).status.success());
    assert_eq!(fs::read_to_string(place.path("victim.txt")).unwrap(), "mine");
    assert!(!place.path("results/calibration/camera.json").is_symlink());
}
