//! `plenocal init`: a project file from a folder of images.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use plenocal::image::{Color, RawImage, Samples};
use plenocal::io::{ImagesSection, Project, write_png};
use predicates::prelude::*;
use tempfile::TempDir;

use crate::prepared::Files;
use crate::support::plenocal;

/// f-numbers in names have two digits.
const ROUNDED: f64 = 2e-3;

fn init(images: &Path, out: &Path) -> assert_cmd::Command {
    let mut command = plenocal();
    command.arg("init").arg(images).arg("--out").arg(out);
    command
}

fn write_image(path: &Path, width: usize, height: usize) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    let samples = Samples::Bits8(vec![128; width * height]);
    let image = RawImage { width, height, color: Color::Grey, samples };
    write_png(&mut fs::File::create(path).unwrap(), &image).unwrap();
}

/// Small images with these names.
fn folder_of(names: &[&str]) -> TempDir {
    let folder = TempDir::new().unwrap();
    for name in names {
        write_image(&folder.path().join(name), 8, 6);
    }
    folder
}

/// The lists of images of a section, with paths relative to the folder of the images.
fn lists(images: &ImagesSection, folder: &Path) -> Vec<Vec<PathBuf>> {
    let folder = fs::canonicalize(folder).unwrap();
    let below =
        |path: &PathBuf| fs::canonicalize(path).unwrap().strip_prefix(&folder).unwrap().to_owned();
    let whites: Vec<PathBuf> = images.whites.iter().map(|white| white.image.clone()).collect();
    let moved = images.translation.as_ref().map(|t| t.images.clone()).unwrap_or_default();
    let one = images.devignetting.iter().cloned().collect();
    [whites, one, images.calibration.clone(), images.evaluation.clone(), moved]
        .iter()
        .map(|list| list.iter().map(below).collect())
        .collect()
}

/// A small simulated data set in `set`, and in `projects/made.toml` a project made from it.
static SIMULATED: LazyLock<Files> = LazyLock::new(|| {
    let folder = TempDir::new().unwrap();
    let set = folder.path().join("set");
    let mut simulate = plenocal();
    simulate.args(["simulate", "--set", "rays=16", "--set", "boards.calibration=4"]);
    simulate.args(["--set", "boards.evaluation=1", "--set", "translation.images=2", "--out"]);
    simulate.arg(&set).assert().success();
    init(&set, &folder.path().join("projects/made.toml"))
        .args(["--preset", "mini", "--board", "8x5x3", "--step", "5"])
        .assert()
        .success()
        .stdout(predicate::str::contains("plenocal run"))
        .stdout(predicate::str::contains("assumed to be grey"))
        .stdout(predicate::str::contains("fill in").not())
        .stderr(predicate::str::is_empty());
    Files::read(folder.path())
});

#[test]
fn a_simulated_set_gives_its_project() {
    let folder = SIMULATED.copy();
    let set = folder.path().join("set");
    let made = Project::read(&folder.path().join("projects/made.toml")).unwrap();
    let own = Project::read(&set.join("project.toml")).unwrap();
    assert_eq!(made.datasheet().unwrap(), own.datasheet().unwrap());
    assert_eq!(made.board, own.board);
    let (a, b) = (made.images.unwrap(), own.images.unwrap());
    assert_eq!(a.color, b.color);
    assert_eq!(lists(&a, &set), lists(&b, &set));
    assert_eq!(lists(&a, &set)[0].len(), 5);
    assert!((a.translation.unwrap().step_mm - b.translation.unwrap().step_mm).abs() < 1e-12);
    for (a, b) in a.whites.iter().zip(&b.whites) {
        assert!((a.f_number().unwrap() / b.f_number().unwrap() - 1.0).abs() < ROUNDED);
    }
}

#[test]
fn the_project_of_a_simulated_set_works_for_precalibration_and_detection() {
    let folder = SIMULATED.copy();
    let (project, white) = (folder.path().join("projects/made.toml"), folder.path().join("white"));
    let mut command = plenocal();
    command.arg("precalibrate").arg(&project).arg("--out").arg(&white);
    command.assert().success().stderr(predicate::str::is_empty());
    let mut command = plenocal();
    command.arg("detect").arg(&project).arg("--precalibration").arg(&white).arg("--no-pictures");
    command.arg("--out").arg(folder.path().join("boards")).assert().success();
}

#[test]
fn an_image_called_dark_becomes_the_dark_image() {
    let folder = folder_of(&["white-n-8.png", "white-dark.png", "calib-1.png"]);
    let out = folder.path().join("project.toml");
    init(folder.path(), &out).args(["--preset", "mini", "--board", "8x5x3"]).assert().success();
    let text = fs::read_to_string(&out).unwrap();
    assert!(text.contains("\ndark = \"white-dark.png\""), "{text}");
    assert_eq!(text.matches("[[images.whites]]").count(), 1);
    write_image(&folder.path().join("darks/1.png"), 8, 6);
    init(folder.path(), &out)
        .arg("--force")
        .assert()
        .success()
        .stdout(predicate::str::contains("[images] dark: which of the 2 images"));
    assert!(!fs::read_to_string(&out).unwrap().contains("\ndark = "));
}

/// Images whose names say all kinds of things, and one file that is not an image.
fn named_images() -> TempDir {
    let folder = folder_of(&[
        "N8.png",
        "n_5.6.png",
        "Whites/IMG_3.png",
        "vignetting a.png",
        "vignetting b.png",
        "Board 10.png",
        "Board 2.png",
        "eval/calib-1.png",
        "img_0007.png",
        "steps/2.png",
        "steps/10.png",
    ]);
    fs::write(folder.path().join("notes.txt"), "no image").unwrap();
    folder
}

#[test]
fn unknown_values_are_comments() {
    let folder = named_images();
    let out = folder.path().join("project.toml");
    init(folder.path(), &out)
        .assert()
        .success()
        .stdout(predicate::str::contains("To fill in"))
        .stdout(predicate::str::contains("[main_lens] focal_length_mm"))
        .stdout(predicate::str::contains("Whites/IMG_3.png"))
        .stdout(predicate::str::contains("which of the 2 images"))
        .stdout(predicate::str::contains("[images.translation] step_mm"));
    let text = fs::read_to_string(&out).unwrap();
    assert!(text.contains("width_px = 8 ") && text.contains("height_px = 6 "), "{text}");
    assert!(text.contains("# focal_length_mm = ?"), "{text}");
    assert!(text.contains("stop = 5.6\n") && text.contains("stop = 8\n"), "{text}");
    assert!(text.contains("calibration = [\n  \"Board 2.png\",\n  \"Board 10.png\",\n]"), "{text}");
    for name in ["img_0007.png", "eval/calib-1.png"] {
        assert!(text.contains(&format!("\n#   \"{name}\",")), "{text}");
    }
    assert!(text.contains("#   \"steps/2.png\",\n#   \"steps/10.png\",\n"), "{text}");
}

#[test]
fn the_comments_when_filled_in_make_a_project() {
    let folder = named_images();
    let out = folder.path().join("project.toml");
    init(folder.path(), &out).assert().success();
    let mut filled = fs::read_to_string(&out).unwrap();
    for (key, value) in [
        ("pixel_size_mm", "0.0055"),
        ("focal_length_mm", "50"),
        ("f_number", "4"),
        ("focus_distance_mm", "inf"),
        ("configuration", "\"galilean\""),
        ("lattice", "\"orthogonal\""),
        ("columns", "9"),
        ("rows", "5"),
        ("lens_types", "1"),
        ("square_mm", "10"),
        ("stop", "4"),
        ("step_mm", "2"),
    ] {
        filled = filled.replace(&format!("# {key} = ?"), &format!("{key} = {value}"));
    }
    let filled = filled.replace("# [images.tr", "[images.tr").replace("# images = [", "images = [");
    let filled = filled.replace("#   \"steps", "  \"steps").replace("\n# ]", "\n]");
    fs::write(&out, &filled).unwrap();
    // A constant grey shows no mosaic.
    let images = Project::read(&out).unwrap_or_else(|e| panic!("{e}\n{filled}")).images.unwrap();
    assert_eq!(images.color, Color::Grey);
    assert_eq!(images.whites.len(), 3);
    assert_eq!(images.translation.unwrap().images.len(), 2);
}

#[test]
fn a_preset_of_another_sensor_leaves_its_size_open() {
    let folder = folder_of(&["white_f4.png"]);
    let out = folder.path().join("project.toml");
    init(folder.path(), &out)
        .args(["--preset", "mini"])
        .assert()
        .success()
        .stdout(predicate::str::contains("8 x 6 px"))
        .stdout(predicate::str::contains("no boards"));
    let text = fs::read_to_string(&out).unwrap();
    for key in ["# pixel_size_mm = ?", "# columns = ?", "lens_types = 3", "focal_length_mm = 16"] {
        assert!(text.contains(key), "{text}");
    }
}

/// No project is made from a folder, and the message contains all of `words`.
fn is_rejected(images: &Path, words: &[&str]) {
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("out/project.toml");
    let mut assert = init(images, &out).assert().code(1).stdout(predicate::str::is_empty());
    for word in words {
        assert = assert.stderr(predicate::str::contains(*word));
    }
    assert!(!out.parent().unwrap().exists());
}

#[test]
fn folders_without_images_are_rejected() {
    let folder = TempDir::new().unwrap();
    fs::write(folder.path().join("a.txt"), "").unwrap();
    is_rejected(folder.path(), &["no images"]);
    is_rejected(&folder.path().join("nowhere"), &["nowhere", "cannot read"]);
}

#[test]
fn images_of_two_sizes_are_rejected() {
    let two = folder_of(&["white_f4.png", "white_f8.png", "board_1.png"]);
    write_image(&two.path().join("board_2.png"), 6, 8);
    is_rejected(two.path(), &["board_2.png: 6 x 8", "3 of 4", "8 x 6"]);
}

#[test]
fn an_image_that_cannot_be_read_is_rejected() {
    let broken = folder_of(&["white_f4.png"]);
    fs::write(broken.path().join("white_f8.png"), "no image").unwrap();
    is_rejected(broken.path(), &["white_f8.png"]);
}

#[test]
fn an_existing_file_is_kept() {
    let folder = folder_of(&["white_f4.png"]);
    let out = folder.path().join("project.toml");
    fs::write(&out, "mine").unwrap();
    init(folder.path(), &out).assert().code(1).stderr(predicate::str::contains("--force"));
    assert_eq!(fs::read_to_string(&out).unwrap(), "mine");
    init(folder.path(), &out).arg("--force").assert().success();
    assert!(fs::read_to_string(&out).unwrap().contains("[[images.whites]]"));
    init(folder.path(), folder.path()).arg("--force").assert().code(1);
}

/// One file that cannot be used does not keep the others from it.
#[cfg(target_os = "linux")]
#[test]
fn what_cannot_be_read_is_listed_and_skipped() {
    use std::os::unix::ffi::OsStrExt;
    let folder = folder_of(&["white_f4.png", "board_1.png"]);
    let at = |name: &[u8]| folder.path().join(std::ffi::OsStr::from_bytes(name));
    std::os::unix::fs::symlink("nowhere.png", at(b"board_2.png")).unwrap();
    fs::copy(at(b"board_1.png"), at(b"board_\xff.png")).unwrap();
    let pipe = std::process::Command::new("mkfifo").arg(at(b"board_3.png")).status();
    assert!(pipe.unwrap().success());
    let out = folder.path().join("project.toml");
    let mut assert = init(folder.path(), &out).assert().success();
    for words in [
        "board_2.png: the target of the link does not exist",
        "board_3.png: it is a pipe",
        "not UTF-8",
    ] {
        assert = assert.stdout(predicate::str::contains(words));
    }
    assert!(fs::read_to_string(&out).unwrap().contains("board_1.png"));
}
