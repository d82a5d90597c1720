//! Clean uses of a camera, and arguments that make no sense.

use std::path::Path;

use crate::base::{BASE, arguments, evaluate, extrinsics, own_camera, own_features, poses_only};
use crate::{Case, Expected, case};
use Expected::{Clean, Refused, Right, Told};

fn of_set(name: &str) -> String {
    BASE.set.join(name).to_string_lossy().into_owned()
}

/// A use of the set's own camera.
fn own(name: &str, expected: Expected, make: impl Fn() -> Vec<String> + 'static) -> Case {
    case(name, expected, move |_| make())
}

fn rays(more: &[&str]) -> Vec<String> {
    arguments(&[["rays", &own_camera()].as_slice(), more].concat())
}

fn compare(second: &str, more: &[&str]) -> Vec<String> {
    arguments(&[["compare", &own_camera(), second].as_slice(), more].concat())
}

fn truth() -> String {
    of_set("truth/camera.json")
}

fn clean() -> Vec<Case> {
    let mut all = Vec::new();
    for subset in ["calibration", "evaluation", "translation"] {
        for (whose, camera) in [("own", own_camera as fn() -> String), ("true", truth)] {
            all.push(own(
                &format!("clean: extrinsics of {subset}, {whose} camera"),
                Clean,
                move || extrinsics(&camera(), &["--subset", subset]),
            ));
            for (kind, more) in [
                ("", [].as_slice()),
                (", one thread", &["--threads", "1"]),
                (", blur of features", &["--blur", "features"]),
            ] {
                all.push(own(
                    &format!("clean: poses of {subset}, {whose} camera{kind}"),
                    Clean,
                    move || poses_only(&camera(), &own_features(subset), more),
                ));
            }
        }
    }
    all.extend([
        own("clean: evaluate, own camera", Clean, || evaluate(&own_camera(), &[])),
        own("clean: evaluate, true camera", Clean, || evaluate(&truth(), &[])),
        own("clean: evaluate, both", Clean, || evaluate(&own_camera(), &["--camera", &truth()])),
        own("clean: evaluate, folds", Clean, || {
            evaluate(&own_camera(), &["--folds", "3", "--features", &own_features("calibration")])
        }),
        own("clean: rays", Clean, || rays(&["--at", "80"])),
        own("clean: rays, double", Clean, || rays(&["--at", "80", "--double"])),
        own("clean: rays with micro-images", Clean, || rays(&["--at", "80", "--micro-images"])),
        own("clean: compare with itself", Clean, || compare(&own_camera(), &[])),
        own("clean: compare with the truth", Clean, || compare(&truth(), &["--at", "70,80,90"])),
        own("clean: poses from given ones", Clean, || {
            poses_only(
                &own_camera(),
                &own_features("evaluation"),
                &["--poses", &of_set("truth/evaluation/poses.json")],
            )
        }),
        own("clean: poses of a robust loss", Clean, || {
            poses_only(&own_camera(), &own_features("evaluation"), &["--loss", "cauchy"])
        }),
        own("clean: poses by the true features", Right, || {
            poses_only(&truth(), &of_set("truth/evaluation/features.csv"), &[])
        }),
    ]);
    all
}

fn nonsense() -> Vec<Case> {
    let mut all = Vec::new();
    for (at, piece) in
        [("0", "0 mm"), ("-5", "-5"), ("nan", "nan"), ("10", "focal length"), ("inf", "inf")]
    {
        let pieces: &'static [&'static str] = Box::leak(Box::new([piece, "NaN"]));
        all.push(own(&format!("rays at {at} mm"), Refused(pieces), move || {
            rays(&[&format!("--at={at}")])
        }));
        all.push(own(&format!("compare at {at} mm"), Refused(pieces), move || {
            compare(&truth(), &[&format!("--at={at}")])
        }));
    }
    let not_cameras = [
        ("calibration.json", "results/calibration/calibration.json"),
        ("poses.json", "results/calibration/poses.json"),
        ("a project", "project.toml"),
        ("an image", "devignetting.png"),
        ("a folder", "results/calibration"),
        ("a CSV file", "truth/centers.csv"),
        ("nothing", "no-such-file.json"),
    ];
    for (name, file) in not_cameras {
        let pieces: &'static [&'static str] = Box::leak(Box::new([Path::new(file)
            .file_name()
            .and_then(|n| n.to_str())
            .unwrap_or(file)]));
        all.push(own(&format!("rays of {name}"), Refused(pieces), move || {
            arguments(&["rays", &of_set(file)])
        }));
        all.push(own(&format!("compare with {name}"), Refused(pieces), move || {
            compare(&of_set(file), &[])
        }));
        all.push(own(&format!("extrinsics with {name}"), Refused(pieces), move || {
            extrinsics(&of_set(file), &[])
        }));
    }
    all.extend([
        own("rays at 10 km", Told(&["[beyond-boards]"]), || rays(&["--at", "1e7"])),
        own("compare at 1000 distances", Refused(&["100 distances"]), || {
            let at: Vec<String> = (100..1100).map(|mm| mm.to_string()).collect();
            compare(&truth(), &["--at", &at.join(",")])
        }),
        own("points of an image without a scale", Refused(&["grey levels"]), || {
            arguments(&["points", &own_camera(), &of_set("devignetting.png")])
        }),
        own("points of poses.json", Refused(&["poses.json"]), || {
            arguments(&["points", &own_camera(), &of_set("results/calibration/poses.json")])
        }),
        own("poses-only without a camera", Refused(&["--camera", "calibrated"]), || {
            arguments(&[
                "calibrate",
                &of_set("project.toml"),
                "--mode",
                "poses-only",
                "--features",
                &own_features("evaluation"),
            ])
        }),
        own("poses-only with poses of other frames", Told(&["[poses-of-no-frame]"]), || {
            poses_only(
                &own_camera(),
                &own_features("evaluation"),
                &["--poses", &of_set("results/calibration/poses.json")],
            )
        }),
        own("extrinsics of an unknown subset", Refused(&["holiday"]), || {
            extrinsics(&own_camera(), &["--subset", "holiday"])
        }),
        own("evaluate with more folds than frames", Refused(&["fold"]), || {
            evaluate(&own_camera(), &["--folds", "50", "--features", &own_features("calibration")])
        }),
        own("evaluate with the pre-calibration of a run", Refused(&["precalibration"]), || {
            let mut all = evaluate(&own_camera(), &[]);
            let place = all.iter().position(|a| a == "--precalibration").expect("it is there");
            all[place + 1] = of_set("results");
            all
        }),
    ]);
    all
}

pub fn cases() -> Vec<Case> {
    clean().into_iter().chain(nonsense()).collect()
}
