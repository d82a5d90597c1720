//! What the program made of a use, against the same use of the right camera.

use std::fmt;
use std::path::Path;
use std::process::Command;

use serde_json::Value;

use crate::Case;
use crate::base::{BASE, PLENOCAL, Scratch};

/// Distances are wrong if they are more than this off, relative.
const WRONG: f64 = 0.005;

/// What came of a use.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    Right,
    RightTold,
    Told,
    Refused,
    Silent,
    Crashed,
}

impl Kind {
    pub const ALL: [Self; 6] =
        [Self::Right, Self::RightTold, Self::Told, Self::Refused, Self::Silent, Self::Crashed];
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Right => "right",
            Self::RightTold => "right, told",
            Self::Told => "told",
            Self::Refused => "refused",
            Self::Silent => "SILENT",
            Self::Crashed => "CRASHED",
        })
    }
}

/// The outcome of a use.
pub struct Outcome {
    pub kind: Kind,
    /// Warnings, reasons of a verdict, and the message of a refusal.
    pub said: String,
}

/// Runs the program on a use and judges what comes of it.
pub fn of(case: &Case) -> Outcome {
    let scratch = Scratch::new();
    let arguments = (case.make)(&scratch);
    let output = Command::new(PLENOCAL)
        .args(&arguments)
        .args(["--json", "--out"])
        .arg(scratch.path("out"))
        .current_dir(scratch.folder())
        .output()
        .expect("the program runs");
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    let Some(status) = output.status.code().filter(|_| !stderr.contains("panicked")) else {
        return Outcome { kind: Kind::Crashed, said: stderr };
    };
    let document: Value = serde_json::from_slice(&output.stdout).unwrap_or(Value::Null);
    let said = format!("{}{}", told(&stderr), reasons(&document));
    if !matches!(status, 0 | 3 | 4) {
        let left = std::fs::read_dir(scratch.path("out")).map_or(0, Iterator::count);
        let kind = if left == 0 { Kind::Refused } else { Kind::Crashed };
        return Outcome { kind, said: format!("{said}{left} files left\n") };
    }
    let right = is_right(&arguments, &document, &scratch.path("out"));
    let kind = match (right, said.is_empty() && status == 0) {
        (true, true) => Kind::Right,
        (true, false) => Kind::RightTold,
        (false, false) => Kind::Told,
        (false, true) => Kind::Silent,
    };
    Outcome { kind, said }
}

fn told(stderr: &str) -> String {
    let is_told = |line: &&str| {
        ["warning: ", "note: ", "error: ", "  "].iter().any(|begins| line.starts_with(begins))
    };
    stderr.lines().filter(is_told).flat_map(|line| [line, "\n"]).collect()
}

/// Codes of the reasons of a verdict.
fn reasons(document: &Value) -> String {
    let all = document["verdict"]["reasons"].as_array().into_iter().flatten();
    let code = |reason: &Value| reason["code"].as_str().unwrap_or_default().to_owned();
    all.flat_map(|reason| ["verdict: [".to_owned(), code(reason), "]\n".to_owned()]).collect()
}

/// Whether the distances of an answer are those of the clean use.
fn is_right(arguments: &[String], document: &Value, out: &Path) -> bool {
    let number = |value: &Value| value.as_f64().unwrap_or(f64::NAN);
    let close = |found: f64, right: f64| (found / right - 1.0).abs() < WRONG;
    match arguments[0].as_str() {
        "extrinsics" | "calibrate" => {
            let poses = |path: &Path| -> Vec<f64> {
                let poses: Value = std::fs::read_to_string(path)
                    .ok()
                    .and_then(|text| serde_json::from_str(&text).ok())
                    .unwrap_or(Value::Null);
                let all = poses["poses"].as_array().cloned().unwrap_or_default();
                all.iter().map(|p| number(&p["camera_from_board"]["translation_mm"][2])).collect()
            };
            let found = poses(&out.join("poses.json"));
            let named = |subset: &&&str| {
                let of_boards = format!("boards-{subset}");
                arguments.iter().any(|a| a == **subset || a.contains(&of_boards))
            };
            let subset = ["calibration", "translation"].iter().find(named).unwrap_or(&"evaluation");
            let right = poses(&BASE.set.join("truth").join(subset).join("poses.json"));
            // Frames that are left out shift the rest: then the nearest true distance counts.
            !found.is_empty() && found.iter().all(|z| right.iter().any(|right| close(*z, *right)))
        }
        // Corners and maps have distances of their own.
        "points" if !BASE.has_depths_of(&arguments[2]) => true,
        "points" => {
            let distance = &document["distance_mm"];
            ["near", "median", "far"]
                .iter()
                .zip(BASE.points_mm)
                .all(|(part, right)| close(number(&distance[part]), right))
        }
        "evaluate" => document["cameras"].as_array().is_some_and(|all| {
            all.iter().all(|camera| {
                let way = &camera["translation"]["whole_way"];
                let steps = number(&way["to"]) - number(&way["from"]);
                close(number(&way["measured_mm"]) / steps, 5.0)
            })
        }),
        "compare" => number(&document["rms_px"]) < 0.1,
        "rays" => number(&document["rays"]) > 0.5 * number(&document["pixels"]),
        _ => true,
    }
}
