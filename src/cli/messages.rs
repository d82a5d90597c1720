//! What the program says: results on stdout, everything else on stderr.

use std::collections::BTreeSet;
use std::fmt::Display;
use std::io::{ErrorKind, Write};
use std::path::PathBuf;
use std::process::ExitCode;

use plenocal::assessment::Verdict;
use plenocal::error::Input;
use plenocal::model::BapFeature;
use plenocal::{Error, Finding, Issue, Result, Severity};
use serde::Serialize;

/// Writes a line to stderr. It is not an error if nobody reads it.
pub fn say(line: &str) {
    let _ = writeln!(std::io::stderr(), "{line}");
}

/// What takes more than this of memory, or on disk, is announced beforehand.
const ANNOUNCED_BYTES: f64 = 1e9;

/// Says that a file of so many bytes is going to be written, if it is large.
pub fn announce_file(name: &str, bytes: f64) {
    if bytes > ANNOUNCED_BYTES {
        say(&format!("writing {name} of {:.1} GB", bytes / 1e9));
    }
}

/// Says that work is going to take so many bytes of memory, if they are many. Where they are not there, the system ends the
/// program without a word.
pub fn announce_memory(work: &str, bytes: f64) {
    if bytes > ANNOUNCED_BYTES {
        say(&format!("{work} takes some {:.1} GB of memory", bytes / 1e9));
    }
}

/// What a calibration takes for each feature, and for each pair of frames (the covariance of all poses, and what it is made of),
/// bytes: 0.57 GB were measured with 100 000 features in 213 frames, 3.1 GB with 300 000 in 634.
const FEATURE_BYTES: f64 = 3000.0;
const FRAME_PAIR_BYTES: f64 = 5500.0;

/// Announces how much memory a calibration with these features takes.
pub fn announce_calibration(features: &[BapFeature]) {
    let frames: BTreeSet<u32> = features.iter().map(|feature| feature.frame).collect();
    announce_memory(
        &format!("calibrating with {} features in {} frames", features.len(), frames.len()),
        features.len() as f64 * FEATURE_BYTES + (frames.len() as f64).powi(2) * FRAME_PAIR_BYTES,
    );
}

/// Prints warnings.
pub fn warn(warnings: &[impl Display]) {
    for warning in warnings {
        say(&format!("warning: {warning}"));
    }
}

/// Prints findings as warnings, each with its code and the option that helps.
pub fn tell<'a>(findings: impl IntoIterator<Item = &'a Finding>) {
    for finding in findings {
        say(&format!("warning: {}", told(finding)));
    }
}

/// A finding as a warning: its text, the option that helps, and its code.
pub fn told(finding: &Finding) -> String {
    let option = option(&finding.issue).map_or(String::new(), |option| format!(" ({option})"));
    format!("{finding}{option} [{}]", finding.code())
}

/// The option that helps; the library does not know of options.
fn option(issue: &Issue) -> Option<String> {
    match issue {
        Issue::OutlyingCenters { .. } | Issue::OutlyingUnweighted { .. } => Some("--loss".into()),
        Issue::Undetermined { .. } => Some("--fix".into()),
        Issue::PriorContradicted { .. } => Some("--prior".into()),
        Issue::OtherCost { problem, .. } => Some(format!("--problem {problem}")),
        Issue::OutlyingFrame { frame, .. } => Some(format!("--exclude {frame}")),
        _ => None,
    }
}

/// Returns the exit status of findings after which a camera should not be used, and prints their codes; `None` if it may be
/// used.
pub fn verdict_status(findings: &[Finding]) -> Option<ExitCode> {
    if Verdict::of(findings) != Verdict::DoNotUse {
        return None;
    }
    let unusable = findings.iter().filter(|finding| finding.severity == Severity::Unusable);
    let mut reasons: Vec<&str> = Vec::new();
    for code in unusable.map(Finding::code) {
        if !reasons.contains(&code) {
            reasons.push(code);
        }
    }
    say(&format!("error: the verdict is \"do not use\" ({})", reasons.join(", ")));
    Some(ExitCode::from(4))
}

/// Says what went wrong, and what helps.
pub fn say_error(error: &Error) {
    match remedy(error) {
        Some(remedy) => say(&format!("error: {error}: {remedy}")),
        None => say(&format!("error: {error}")),
    }
}

/// The option that helps, for errors of the library, which does not know of options.
fn remedy(error: &Error) -> Option<String> {
    let remedy = match error {
        Error::InFile { error, .. } => return remedy(error),
        Error::NoBlurRadius { .. } => {
            "give it, or calibrate from corners only (--mode corners-only)".to_owned()
        }
        Error::TooFewCorners { frame, .. } => {
            format!("leave the frame out (--exclude {frame})")
        }
        Error::NoCenters => "give them (--centers)".to_owned(),
        Error::Missing { missing } => {
            let option = match missing {
                Input::Camera => "--camera",
                Input::InternalParameters => "--params",
                Input::Board => "--scene",
                Input::Features => "--features",
            };
            format!("give {option}, or a project file with it")
        }
        Error::NotCalibrated => "give a camera.json or an intrinsics.js (--camera)".to_owned(),
        Error::Read { .. }
        | Error::Write { .. }
        | Error::Invalid(_)
        | Error::Observation { .. } => return None,
    };
    Some(remedy)
}

/// Prints the result of a command: one JSON object, or text and the files that were written.
///
/// A reader that has gone away (a closed pipe) is not an error: the files are written. A full disk is: whoever asked for
/// the result does not have it.
pub fn print_result(
    json: bool,
    document: &impl Serialize,
    text: &str,
    paths: &[PathBuf],
) -> Result<()> {
    let text = if json {
        let document = serde_json::to_string(document)
            .map_err(|e| Error::invalid(format!("the result is no JSON: {e}")))?;
        format!("{document}\n")
    } else {
        let files: Vec<String> = paths.iter().map(|p| format!("  {}\n", p.display())).collect();
        let written = if files.is_empty() {
            String::new()
        } else {
            format!("\nWritten:\n{}", files.concat())
        };
        format!("{}\n{written}", text.trim_end())
    };
    print(text.as_bytes())
}

/// Prints the output of a command. A reader that has gone away is not an error.
pub fn print(text: &[u8]) -> Result<()> {
    let mut stdout = std::io::stdout();
    match stdout.write_all(text).and_then(|()| stdout.flush()) {
        Err(source) if source.kind() != ErrorKind::BrokenPipe => {
            Err(Error::Write { path: "standard output".into(), source })
        }
        _ => Ok(()),
    }
}
