//! The independent Ceres program (`cpp/examples/plain_ceres`) reaches the same minimum.

use std::io::Write;
use std::path::Path;
use std::process::Command;

use plenocal::calibration::{Calibration, CalibrationOptions};
use serde_json::Value;

use crate::support::{
    datasheet_start, options, r12a_folder, run, shipped_observations, synthetic_folder, true_poses,
};

/// Relative agreement of the costs.
const COST: f64 = 1e-9;
/// Relative agreement of the parameters ...
const PARAMETER: f64 = 1e-6;
/// ... or, for values not much larger than their uncertainty, this fraction of the uncertainty: where
/// both programs stop, the cost is accurate to 1e-13, and the parameters to about 1e-4 σ.
const PARAMETER_SIGMAS: f64 = 1e-3;

/// Runs the program; `values` are the camera's.
fn plain_ceres(centers: &Path, features: &Path, values: &[(&str, &str)]) -> Value {
    let program = std::env::var_os("PLENOCAL_PLAIN_CERES").expect("PLENOCAL_PLAIN_CERES is set");
    let mut command = Command::new(program);
    command.arg("--centers").arg(centers).arg("--features").arg(features);
    for (name, value) in values {
        command.arg(format!("--{name}"));
        if !value.is_empty() {
            command.arg(value);
        }
    }
    let output = command.output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

/// Its parameters in the order of `PlenopticCamera::intrinsics`.
fn parameters(result: &Value) -> Vec<f64> {
    let p = &result["parameters"];
    let list = |name: &str| -> Vec<f64> {
        match &p[name] {
            Value::Array(values) => values.iter().map(|v| v.as_f64().unwrap()).collect(),
            value => vec![value.as_f64().unwrap_or_else(|| panic!("{name} in {p}"))],
        }
    };
    let pitch = list("micro_lens_pitch_mm");
    let ratio = pitch.get(1).map_or(1.0, |y| y / pitch[0]);
    [
        list("focal_length_mm"),
        list("radial"),
        list("tangential"),
        // It has neither field curvature nor exit pupil.
        vec![0.0; 5],
        list("principal_point_px"),
        list("mla_to_sensor_mm"),
        list("mla_rotation_rad"),
        list("mla_offset_mm"),
        list("lens_to_mla_mm"),
        vec![pitch[0], ratio],
        list("micro_lens_focal_lengths_mm"),
    ]
    .concat()
}

fn assert_same(calibration: &Calibration, plain: &Value) {
    assert_eq!(plain["converged"], true);
    let (cost, other) = (calibration.refinement.cost, plain["cost"].as_f64().unwrap());
    assert!((cost / other - 1.0).abs() < COST, "{cost} and {other}");
    let std_devs = calibration.uncertainty.intrinsic_std_devs(3);
    let values = calibration.camera.intrinsics();
    for ((value, other), std_dev) in values.into_iter().zip(parameters(plain)).zip(std_devs) {
        let tolerance = (PARAMETER * other.abs()).max(PARAMETER_SIGMAS * std_dev.unwrap_or(0.0));
        assert!((value - other).abs() <= tolerance, "{value} and {other}, ± {std_dev:?}");
    }
}

fn two_pitches() -> CalibrationOptions {
    let mut options = options();
    options.cost.fixed.retain(|name| name != "dC_ratio");
    options
}

#[test]
#[cfg_attr(not(plenocal_plain_ceres), ignore = "set PLENOCAL_PLAIN_CERES to the program")]
fn the_minimum_on_the_shipped_features_is_the_same() {
    let folder = synthetic_folder();
    let mut values = vec![
        ("pixel-size-mm", "0.0055"),
        ("width", "1000"),
        ("height", "750"),
        ("columns", "43"),
        ("rows", "37"),
        ("focal-mm", "16"),
        ("focus-mm", "120"),
        ("m-mm", "0.1432"),
        ("q-mm", "0.0361,0.0414,0.0377"),
        ("board-columns", "9"),
        ("square-mm", "3"),
    ];
    // The program cannot recognise mirrored poses, so it starts from the true ones.
    let mut poses = tempfile::NamedTempFile::new().unwrap();
    writeln!(poses, "frame,rx,ry,rz,tx,ty,tz").unwrap();
    for pose in true_poses() {
        let r = pose.camera_from_board.rotation.scaled_axis();
        let t = pose.camera_from_board.translation.vector;
        writeln!(poses, "{},{},{},{},{},{},{}", pose.frame, r.x, r.y, r.z, t.x, t.y, t.z).unwrap();
    }
    values.push(("poses", poses.path().to_str().unwrap()));
    let plain = |values: &[(&str, &str)]| {
        plain_ceres(&folder.join("centers.csv"), &folder.join("features.csv"), values)
    };
    let observations = shipped_observations();
    assert_same(&run(&datasheet_start(), &observations, &options()), &plain(&values));
    values.push(("two-pitches", ""));
    assert_same(&run(&datasheet_start(), &observations, &two_pitches()), &plain(&values));
}

#[test]
#[cfg_attr(
    not(all(plenocal_plain_ceres, plenocal_r12a)),
    ignore = "set PLENOCAL_PLAIN_CERES and PLENOCAL_R12A"
)]
fn the_minimum_on_the_real_features_is_the_same() {
    let folder = r12a_folder();
    let mut values = vec![
        ("pixel-size-mm", "0.0055"),
        ("width", "4080"),
        ("height", "3068"),
        ("columns", "176"),
        ("rows", "152"),
        ("focal-mm", "50"),
        ("focus-mm", "450"),
        ("m-mm", "0.14059554040431976"),
        ("q-mm", "0.035135191355331399,0.040268205527646997,0.036822146226151445"),
        ("board-columns", "9"),
        ("square-mm", "10"),
    ];
    let plain = |values: &[(&str, &str)]| {
        plain_ceres(&folder.join("center-R12-A.csv"), &folder.join("bap-R12-A.csv"), values)
    };
    let data = crate::r12a::csv();
    assert_same(&crate::r12a::run(&data, &options()), &plain(&values));
    values.push(("two-pitches", ""));
    assert_same(&crate::r12a::run(&data, &two_pitches()), &plain(&values));
}
