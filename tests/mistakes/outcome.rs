//! What the program made of a set, against the truth.

use std::fmt::{self, Write as _};
use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

use crate::set::{PLENOCAL, Set, Task};

/// A camera is wrong if F, d or fᵢ is more than this off, and more than so many σ.
const WRONG: f64 = 0.01;
const STD_DEVS: f64 = 3.0;
/// A space is wrong if a known displacement is more than this off.
const WRONG_SPACE: f64 = 0.01;

/// What came of a mistake.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    Right,
    RightWarned,
    WrongWarned,
    Refused,
    Silent,
}

impl Kind {
    pub const ALL: [Self; 5] =
        [Self::Right, Self::RightWarned, Self::WrongWarned, Self::Refused, Self::Silent];
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Right => "right",
            Self::RightWarned => "right, warned",
            Self::WrongWarned => "warned",
            Self::Refused => "refused",
            Self::Silent => "SILENT",
        })
    }
}

/// The outcome of one set.
pub struct Outcome {
    pub kind: Kind,
    /// Errors against the truth.
    pub errors: String,
    /// Warnings, and the error of a refusal.
    pub said: String,
}

/// Runs the program on a set and judges the result.
pub fn of(set: &Set) -> Outcome {
    let out = set.path().join("results");
    let (name, arguments, calibration) = match &set.task {
        Task::Run(arguments) => ("run", arguments, out.join("calibration/calibration.json")),
        Task::Calibrate(arguments) => ("calibrate", arguments, out.join("calibration.json")),
    };
    let mut command = Command::new(PLENOCAL);
    command.arg(name).arg(set.project()).args(arguments).arg("--out").arg(&out);
    if name == "run" {
        command.arg("--no-pictures");
    }
    let output = command.current_dir(set.path()).output().expect("the program runs");
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.code().is_some(), "killed by a signal: {stderr}");
    assert!(!stderr.contains("panicked"), "{stderr}");
    let said = said(&stderr);
    let read = read(&calibration).filter(|_| refused(&output).is_none());
    let Some(calibration) = read else {
        let errors = format!("status {}", output.status.code().unwrap_or(-1));
        assert!(!output.status.success(), "no calibration, and status 0: {stderr}");
        return Outcome { kind: Kind::Refused, errors, said };
    };
    let evaluation = self::read(&out.join("evaluation/evaluation.json"));
    let (wrong, errors) = errors(set, &calibration, evaluation.as_ref());
    let reasons = reasons(&calibration);
    let warned = !said.is_empty() || !reasons.is_empty() || !output.status.success();
    let kind = match (wrong, warned) {
        (false, false) => Kind::Right,
        (false, true) => Kind::RightWarned,
        (true, true) => Kind::WrongWarned,
        (true, false) => Kind::Silent,
    };
    Outcome { kind, errors, said: format!("{said}{reasons}") }
}

/// The status of a run without a result; 3 is the status of one that did not converge, 4 of one that is not to be used.
fn refused(output: &Output) -> Option<i32> {
    output.status.code().filter(|code| !matches!(code, 0 | 3 | 4))
}

/// Warnings and errors of the program, with the lines that belong to them.
fn said(stderr: &str) -> String {
    let told = |line: &&str| {
        // A message about TOML shows the line that is meant.
        ["warning: ", "note: ", "error: ", "  "].iter().any(|w| line.starts_with(w))
            || line.contains(" | ")
    };
    stderr.lines().filter(told).flat_map(|line| [line, "\n"]).collect()
}

/// Reasons of the verdict.
fn reasons(calibration: &Value) -> String {
    let reasons = calibration["verdict"]["reasons"].as_array();
    let text = |reason: &Value| {
        format!("verdict: {}\n", reason.as_str().map_or_else(|| reason.to_string(), str::to_owned))
    };
    reasons.into_iter().flatten().map(text).collect()
}

fn read(path: &Path) -> Option<Value> {
    serde_json::from_str(&fs::read_to_string(path).ok()?).ok()
}

/// Whether the camera or its space is wrong, and by how much.
fn errors(set: &Set, calibration: &Value, evaluation: Option<&Value>) -> (bool, String) {
    let truth = read(&set.path().join("truth/camera.json")).expect("a set has its truth");
    let camera = &calibration["camera"];
    let std_devs = &calibration["standard_deviations"]["parameters"];
    let number = |value: &Value| value.as_f64().unwrap_or(f64::NAN);
    let lens = |c: &Value| number(&c["main_lens"]["focal_length_mm"]);
    let distance = |c: &Value| number(&c["micro_lens_array"]["mla_to_sensor_mm"]);
    let mut parameters = vec![
        ("F".to_owned(), lens(camera), lens(&truth)),
        ("d".to_owned(), distance(camera), distance(&truth)),
    ];
    let focal = |c: &Value| {
        c["micro_lens_array"]["focal_lengths_mm"].as_array().cloned().unwrap_or_default()
    };
    // By size: which type is the first is a matter of counting.
    let sorted = |c: &Value| {
        let mut all: Vec<(f64, usize)> = focal(c).iter().map(number).zip(1..).collect();
        all.sort_by(|a, b| a.0.total_cmp(&b.0));
        all
    };
    for ((found, i), (truth, _)) in sorted(camera).into_iter().zip(sorted(&truth)) {
        parameters.push((format!("f_{i}"), found, truth));
    }
    let (mut wrong, mut text) = (false, String::new());
    for (name, found, truth) in parameters {
        let error = found / truth - 1.0;
        let std_dev = std_devs[&name]["used"].as_f64().map(|s| s / truth);
        let off = error.is_nan()
            || error.abs() > WRONG && std_dev.is_none_or(|s| error.abs() > STD_DEVS * s);
        wrong |= off;
        let mark = if off { "!" } else { "" };
        let _ = write!(text, "{name} {:+.1} %{mark} ", 100.0 * error);
    }
    let way = evaluation.map(|e| &e["cameras"][0]["translation"]["whole_way"]);
    if let Some(way) = way.filter(|way| way.is_object() && set.step_mm != 0.0) {
        let steps = number(&way["to"]) - number(&way["from"]);
        // The sign is that of the stated step.
        let error = number(&way["measured_mm"]).abs() / (steps * set.step_mm) - 1.0;
        let off = error.is_nan() || error.abs() > WRONG_SPACE;
        wrong |= off;
        let _ = write!(text, "space {:+.1} %{}", 100.0 * error, if off { "!" } else { "" });
    }
    (wrong, text)
}
