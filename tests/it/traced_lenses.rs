//! Whole runs through traced main lenses.

use std::fs;

use serde_json::Value;
use tempfile::TempDir;

use crate::support::plenocal;

/// Checks a lens whose axis is 150 px beside the middle of the sensor: coma and astigmatism have to be taken about the axis.
#[test]
#[ignore = "slow: images through a traced lens; run by `make test-slow`"]
fn the_optical_axis_may_lie_beside_the_middle() {
    const THREE_SIGMA: f64 = 3.0;
    let folder = TempDir::new().unwrap();
    let (set, out) = (folder.path().join("set"), folder.path().join("out"));
    plenocal()
        .args(["simulate", "--preset", "mini-retrofocus", "--set", "axis_px=[150, 0]"])
        .args(["--set", "rays=16", "--set", "seed=8101", "--out"])
        .arg(&set)
        .assert()
        .success();
    plenocal().arg("run").arg(set.join("project.toml")).arg("--out").arg(&out).assert().success();
    let read = |file: &str| -> Value {
        serde_json::from_str(&fs::read_to_string(out.join(file)).unwrap()).unwrap()
    };
    let detection = read("boards-calibration/detection.json");
    let aberration = &detection["aberration"];
    let of_evaluation = read("boards-evaluation/detection.json");
    assert_eq!(&of_evaluation["aberration"], aberration, "one camera, one lens");
    let axis_u = detection["axis_px"][0].as_f64().unwrap();
    println!("axis at {axis_u} px");
    // The middle of the sensor is at 499.5 px.
    assert!((axis_u - 649.5).abs() < 15.0, "{axis_u}");
    let evaluation = read("evaluation/evaluation.json");
    let parameters = evaluation["cameras"][0]["truth"].as_array().unwrap();
    for name in ["F", "D", "d", "u0", "v0", "P1", "P2", "theta_x", "theta_y", "f_1", "f_2", "f_3"] {
        let of = |key: &str| {
            let parameter = parameters.iter().find(|p| p["parameter"] == name).unwrap();
            parameter[key].as_f64().unwrap()
        };
        let off = (of("estimate") - of("truth")) / of("standard_deviation");
        println!("{name}: {off:.1} σ");
        assert!(off.abs() < THREE_SIGMA, "{name}: {off} σ");
    }
}
