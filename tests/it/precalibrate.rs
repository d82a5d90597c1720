//! `plenocal precalibrate`: from a project, a white image or a maker's calibration.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use assert_cmd::assert::Assert;
use plenocal::io::{CameraSource, read_camera_source, read_centers, read_internal_parameters};
use plenocal::model::{Configuration, optics};
use predicates::prelude::PredicateBooleanExt;
use predicates::str::contains;
use tempfile::TempDir;

use crate::prepared::Files;
use crate::support::{plenocal, preset};

/// Limit for m, relative.
const INTERNAL: f64 = 0.01;

fn simulate(more: &[&str]) -> Files {
    let folder = TempDir::new().unwrap();
    let mut command = plenocal();
    command.args(["simulate", "--set", "rays=8", "--set", "boards.calibration=0"]);
    command.args(["--set", "boards.evaluation=0", "--set", "translation.images=0"]);
    command.args(["--set", "white_images.f_numbers=[4.0, 8.0, 16.0]"]);
    command.args(more).arg("--out").arg(folder.path().join("set")).assert().success();
    Files::read(folder.path())
}

static GREY: LazyLock<Files> = LazyLock::new(|| simulate(&[]));
static MOSAIC: LazyLock<Files> = LazyLock::new(|| simulate(&["--set", "imaging.color=bayer-rggb"]));

fn run(input: &Path, out: &Path) -> Assert {
    plenocal().arg("precalibrate").arg(input).arg("--out").arg(out).assert()
}

/// A copy of a set for one test.
struct Set {
    folder: TempDir,
}

impl Set {
    fn grey() -> Self {
        Self { folder: GREY.copy() }
    }

    fn mosaic() -> Self {
        Self { folder: MOSAIC.copy() }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Pre-calibrates from a file of the set.
    fn run(&self, input: &str) -> Assert {
        run(&self.path("set").join(input), &self.path("results"))
    }

    /// Pre-calibrates the project with a part replaced.
    fn with(&self, from: &str, to: &str) -> Assert {
        let text = fs::read_to_string(self.path("set/project.toml")).unwrap();
        assert!(text.contains(from), "{from}");
        fs::write(self.path("set/other.toml"), text.replace(from, to)).unwrap();
        self.run("other.toml")
    }
}

#[test]
fn a_project_is_precalibrated_and_its_files_serve_the_calibration() {
    let set = Set::grey();
    set.run("project.toml")
        .success()
        .stdout(contains("Lattice hexagonal-rows, 43 x 37").and(contains("q'_3")))
        .stderr("");
    let out = set.path("results");
    let truth = optics::internal_parameters(&preset("mini", &[]).camera);
    for file in ["precalibration.json", "params.js"] {
        let internal = read_internal_parameters(&out.join(file), Some(0.0055)).unwrap();
        assert!((internal.m_mm / truth.m_mm - 1.0).abs() < INTERNAL, "{file}");
    }
    let CameraSource::Datasheet(sheet) = read_camera_source(&out.join("camera.js")).unwrap() else {
        panic!("camera.js is a datasheet");
    };
    assert_eq!((sheet.array_size, sheet.lens_types), (Some((43, 37)), 3));
    assert_eq!(sheet.configuration, Configuration::Galilean);
    for figure in ["radii.svg", "micro-images.svg"] {
        let text = fs::read_to_string(out.join(figure)).unwrap();
        assert!(text.contains("</svg>") && text.contains("<circle"), "{figure}");
    }
    assert!(read_centers(&out.join("centers.csv")).unwrap().len() > 1400);
}

#[test]
fn a_single_image_gives_its_array_alone() {
    let set = Set::grey();
    set.run("devignetting.png").success().stdout(contains("Lattice hexagonal-rows"));
    let single = set.path("results/precalibration.json");
    let error = read_internal_parameters(&single, None).unwrap_err().to_string();
    assert!(error.contains("has no internal parameters"), "{error}");
}

#[test]
fn a_colour_pattern_other_than_stated_gives_a_warning() {
    let set = Set::mosaic();
    set.with("bayer-rggb", "bayer-gbrg").stderr(contains("[wrong-mosaic]"));
    set.with("\"bayer-rggb\"", "\"grey\"").stderr(contains("[color-mosaic]"));
}

#[test]
fn channels_that_an_image_does_not_have_are_rejected() {
    let set = Set::mosaic();
    set.with("\"bayer-rggb\"", "\"rgb\"").code(1).stderr(contains("has 1 channel"));
    assert!(!set.path("results").exists());
}

/// An engraved stop stands for its true f-number.
#[test]
fn stops_stand_for_f_numbers_and_wrong_ones_give_a_warning() {
    let set = Set::grey();
    set.with("f_number = 8\n", "stop = 8\n").success().stderr("");
    set.with("f_number = 8\n", "stop = 5.6\n").success().stderr(contains("check its f-number"));
    set.with("f_number = 8\n", "f_number = 9\n").success().stderr(contains("check its f-number"));
}

#[test]
fn stops_that_make_no_sense_are_rejected() {
    let set = Set::grey();
    set.with("f_number = 8\n", "f_number = 8\nstop = 8\n").code(1).stderr(contains("but not both"));
    set.with("f_number = 8\n", "stop = -8\n").code(1).stderr(contains("a stop of -8"));
    assert!(!set.path("results").exists());
}

#[test]
fn projects_that_contradict_the_images_are_rejected() {
    let set = Set::grey();
    set.with("width_px = 1000", "width_px = 1001")
        .code(1)
        .stderr(contains("but the sensor 1001 x 750"));
    set.with("columns = 43", "columns = 42").code(1).stderr(contains("42 x 37 micro-lenses"));
    set.with("hexagonal-rows", "hexagonal-columns").code(1).stderr(contains("'hexagonal-columns'"));
    assert!(!set.path("results").exists());
}

#[test]
fn projects_without_images_are_rejected_by_name() {
    let set = Set::grey();
    set.with("[images]", "[pictures]").code(1).stderr(contains("other.toml"));
    set.with("devignetting.png", "gone.png").code(1).stderr(contains("gone.png"));
    assert!(!set.path("results").exists());
}

#[test]
fn damaged_images_are_rejected_by_name() {
    let set = Set::grey();
    let image = set.path("set/devignetting.png");
    let bytes = fs::read(&image).unwrap();
    fs::write(&image, &bytes[..bytes.len() / 2]).unwrap();
    set.run("project.toml").code(1).stderr(contains("devignetting.png: this PNG file is cut off"));
    fs::write(&image, "no image").unwrap();
    set.run("devignetting.png").code(1).stderr(contains("not PNG, TIFF"));
    assert!(!set.path("results").exists());
}

#[test]
fn images_that_are_empty_or_of_other_samples_are_rejected_by_name() {
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("results");
    for (name, text) in [("w0.pgm", "P5\n0 5\n255\n"), ("h0.pgm", "P5\n5 0\n255\n")] {
        fs::write(folder.path().join(name), text).unwrap();
        run(&folder.path().join(name), &out).code(1).stderr(contains(name));
    }
    let float = folder.path().join("float.tif");
    image::Rgb32FImage::new(8, 8).save(&float).unwrap();
    run(&float, &out)
        .code(1)
        .stderr(contains("float.tif").and(contains("by 65535 if they go from 0 to 1")));
    assert!(!out.exists());
}

/// Writes a maker's calibration and runs with a size of its images.
fn run_maker(folder: &Path, size: &str) -> Assert {
    let (xml, out) = (folder.join("maker.xml"), folder.join("results"));
    let types = ["0", "1", "-1"]
        .map(|x| format!("<lens_type><offset><x>{x}</x><y>0</y></offset></lens_type>"))
        .concat();
    let text = format!(
        "<RayCalibData><offset><x>0</x><y>0</y></offset><diameter>20</diameter>\
         <lens_base_x><x>1</x><y>0</y></lens_base_x>\
         <lens_base_y><x>-0.5</x><y>0.8660254</y></lens_base_y>{types}</RayCalibData>"
    );
    fs::write(&xml, text).unwrap();
    let mut command = plenocal();
    command.arg("precalibrate").arg(&xml).args(["--size", size]).arg("--out").arg(&out).assert()
}

#[test]
fn sizes_that_do_not_fit_a_makers_calibration_are_rejected() {
    let folder = TempDir::new().unwrap();
    for size in ["4000000000x4000000000", "65536x100", "0x100", "100"] {
        let words = "each edge from 1 to 65535 px";
        run_maker(folder.path(), size).code(2).stderr(contains(words));
    }
    run_maker(folder.path(), "30x25")
        .code(1)
        .stderr(contains("maker.xml").and(contains("Check --size")));
    run_maker(folder.path(), "1x1").code(1).stderr(contains("maker.xml"));
    assert!(!folder.path().join("results").exists());
}

#[test]
fn a_makers_calibration_gives_the_same_columns_without_measurements() {
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("results");
    run_maker(folder.path(), "600x500").success().stdout(contains("3 lens types"));
    let centers = fs::read_to_string(out.join("centers.csv")).unwrap();
    assert!(centers.starts_with("k,l,u,v,std_dev,type\n"));
    assert!(centers.lines().skip(1).all(|line| line.contains(",,")), "{centers}");
    assert!(read_centers(&out.join("centers.csv")).unwrap().len() > 800);
    let text = fs::read_to_string(out.join("precalibration.json")).unwrap();
    let document: serde_json::Value = serde_json::from_str(&text).unwrap();
    let types = serde_json::json!({ "count": 3, "separation": null, "agreement": null });
    assert_eq!(document["lens_types"], types);
}

#[test]
fn options_for_another_kind_of_input_are_rejected() {
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("results");
    for (input, option, value) in [
        ("project.toml", "--size", "100x100"),
        ("white.png", "--size", "100x100"),
        ("white.png", "--estimator", "moments"),
        ("maker.xml", "--estimator", "profile"),
        ("maker.xml", "--color", "grey"),
        ("project.toml", "--color", "grey"),
    ] {
        let mut command = plenocal();
        command.args(["precalibrate", input, option, value, "--out"]).arg(&out);
        command.assert().code(1).stderr(contains(input).and(contains(option)));
    }
    assert!(!out.exists());
}
