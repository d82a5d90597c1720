//! Micro-lenses whose openings are the cells of the lattice.

use std::fs;
use std::path::Path;
use std::sync::LazyLock;

use plenocal::io::read_internal_parameters;
use predicates::str::contains;
use serde_json::Value;
use tempfile::TempDir;

use crate::support::plenocal;

static SET: LazyLock<TempDir> = LazyLock::new(|| {
    let folder = TempDir::new().unwrap();
    let settings = [
        "imperfections.opening=hexagon",
        "seed=2111",
        "rays=32",
        "boards.calibration=4",
        "boards.evaluation=0",
        "translation.images=0",
    ];
    let mut command = plenocal();
    command.arg("simulate").args(settings.iter().flat_map(|set| ["--set", set]));
    command.arg("--out").arg(folder.path().join("set")).assert().success();
    folder
});

/// Copies the project, with a line added after the one about the lattice.
fn project(out: &Path, line: &str) -> std::path::PathBuf {
    let set = SET.path().join("set");
    let text = fs::read_to_string(set.join("project.toml")).unwrap();
    let lattice = "lattice = \"hexagonal-rows\"";
    assert!(text.contains(lattice));
    let with_line = text.replace(lattice, &format!("{lattice}\n{line}"));
    let path = set.join(format!("{}.toml", out.file_name().unwrap().display()));
    fs::write(&path, with_line).unwrap();
    path
}

fn json(path: &Path) -> Value {
    serde_json::from_str(&fs::read_to_string(path).unwrap()).unwrap()
}

#[test]
fn hexagons_are_found_in_white_images_and_blur_like_hexagons() {
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("found");
    let mut command = plenocal();
    command.arg("detect").arg(project(&out, "")).arg("--out").arg(&out).assert().success();
    let document = json(&out.join("precalibration.json"));
    let share = document["cell_share"]["value"].as_f64().unwrap();
    assert!((share - 1.0).abs() < 0.1, "{share}");
    assert_eq!(document["internal_parameters"]["opening"], "hexagon");
    let truth = SET.path().join("set/truth/internal_parameters.toml");
    let truth = read_internal_parameters(&truth, None).unwrap();
    let found = read_internal_parameters(&out.join("precalibration.json"), None).unwrap();
    for (found, truth) in found.q_prime_mm.iter().zip(&truth.q_prime_mm) {
        assert!((found / truth - 1.0).abs() < 3e-3, "{found} for {truth}");
    }
    // As discs, they would have 1.05.
    let ratio = json(&out.join("detection.json"))["aperture_ratio"].clone();
    let (ratio, std_dev) = (ratio["value"].as_f64().unwrap(), ratio["std_dev"].as_f64().unwrap());
    assert!((ratio - 1.0).abs() < 3.0 * std_dev && std_dev < 0.01, "{ratio} ± {std_dev}");
}

#[test]
fn a_stated_opening_is_taken_and_contradicted() {
    let folder = TempDir::new().unwrap();
    let precalibrate = |name: &str| {
        let out = folder.path().join(name);
        let path = project(&out, &format!("opening = \"{name}\""));
        let mut command = plenocal();
        (command.arg("precalibrate").arg(path).arg("--out").arg(&out).assert(), out)
    };
    let (run, out) = precalibrate("disc");
    run.success().stderr(contains("[opening-contradicted]"));
    let document = json(&out.join("precalibration.json"));
    assert_eq!(document["internal_parameters"]["opening"], "disc");
    let (run, out) = precalibrate("square");
    run.failure().stderr(contains("an opening cannot be a square in a lattice of kind"));
    assert!(!out.exists());
}
