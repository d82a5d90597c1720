//! Messages of the program: results on stdout, everything else on stderr.

use std::collections::BTreeSet;
use std::fmt::Display;
use std::io::{ErrorKind, Write};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};

use anstyle::{AnsiColor, Style};
use plenocal::assessment::Verdict;
use plenocal::error::Input;
use plenocal::model::BapFeature;
use plenocal::report::Section;
use plenocal::{Error, Finding, Issue, Result, Severity, Subject};
use serde::Serialize;

use super::progress;

// Colours are omitted if the stream is not a terminal, or if `NO_COLOR` is set.
const GOOD: Style = AnsiColor::Green.on_default().bold();
const CARE: Style = AnsiColor::Yellow.on_default().bold();
const BAD: Style = AnsiColor::Red.on_default().bold();

/// Writes a line to stderr. A closed stderr is not an error.
pub fn say(line: &str) {
    progress::above(|| {
        let _ = writeln!(anstream::stderr(), "{line}");
    });
}

/// Returns a result with its verdict in colour, if it begins with one.
fn coloured(text: &str) -> String {
    let (first, rest) = text.split_at(text.find('\n').unwrap_or(text.len()));
    let style = match first.strip_prefix("Verdict: ") {
        Some(verdict) if verdict.starts_with(&Verdict::Good.to_string()) => GOOD,
        Some(verdict) if verdict.starts_with(&Verdict::DoNotUse.to_string()) => BAD,
        Some(_) => CARE,
        None => return text.to_owned(),
    };
    format!("{style}{first}{style:#}{rest}")
}

/// Size in memory or on disk above which it is announced, bytes.
const ANNOUNCED_BYTES: f64 = 1e9;

/// Announces the size of a file before it is written, if it is large.
pub fn announce_file(name: &str, bytes: f64) {
    if bytes > ANNOUNCED_BYTES {
        say(&format!("writing {name} of {:.1} GB", bytes / 1e9));
    }
}

/// Announces the memory that work needs, if it is large. If it is not available, the system ends the program without a message.
pub fn announce_memory(work: &str, bytes: f64) {
    if bytes > ANNOUNCED_BYTES {
        say(&format!("{work} needs about {:.1} GB of memory", bytes / 1e9));
    }
}

/// Memory of a calibration per feature and per pair of frames (covariance of all poses and its intermediate results), bytes:
/// 0.57 GB were measured with 100 000 features in 213 frames, 3.1 GB with 300 000 in 634.
const FEATURE_BYTES: f64 = 3000.0;
const FRAME_PAIR_BYTES: f64 = 5500.0;

/// Announces the memory of a calibration with these features.
pub fn announce_calibration(features: &[BapFeature]) {
    let frames: BTreeSet<u32> = features.iter().map(|feature| feature.frame).collect();
    announce_memory(
        &format!("calibrating with {} features in {} frames", features.len(), frames.len()),
        features.len() as f64 * FEATURE_BYTES + (frames.len() as f64).powi(2) * FRAME_PAIR_BYTES,
    );
}

fn warn_of(text: &str) {
    say(&format!("{CARE}warning:{CARE:#} {text}"));
}

/// Prints an error.
fn say_failure(text: &str) {
    say(&format!("{BAD}error:{BAD:#} {text}"));
}

/// Prints warnings.
pub fn warn(warnings: &[impl Display]) {
    for warning in warnings {
        warn_of(&warning.to_string());
    }
}

/// Number of findings of one kind from which they are printed as one.
const MANY: usize = 10;

/// Prints findings as warnings, but notes about the whole input that ask for nothing as notes.
///
/// A finding has a line with the code, and one with the remedy. If there are many of one kind, the first is
/// printed and the others are counted.
pub fn tell<'a>(findings: impl IntoIterator<Item = &'a Finding>) {
    let findings: Vec<&Finding> = findings.into_iter().collect();
    let of_kind = |code: &str| findings.iter().filter(|finding| finding.code() == code).count();
    let mut counted = BTreeSet::new();
    for finding in &findings {
        let (code, count) = (finding.code(), of_kind(finding.code()));
        if count < MANY || counted.insert(code) {
            let others = if count < MANY { 0 } else { count - 1 };
            let text = told(finding, others);
            match (finding.severity, &finding.subject) {
                (Severity::Note, Subject::Whole) if finding.remedy().is_empty() => {
                    say(&format!("note: {text}"));
                }
                _ => warn_of(&text),
            }
        }
    }
}

/// Formats a finding as a warning: its message, the number of similar findings, its code, and on another line the remedy with
/// the option that helps.
fn told(finding: &Finding, others: usize) -> String {
    let like_it = if others > 0 { format!(" (and {others} more like it)") } else { String::new() };
    let remedy = finding.remedy();
    let help = match option(&finding.issue) {
        Some(option) if remedy.is_empty() => option,
        Some(option) => format!("{remedy} ({option})"),
        None => remedy,
    };
    let help = if help.is_empty() { help } else { format!("\n    {help}") };
    format!("{}{like_it} [{}]{help}", finding.message(), finding.code())
}

static TABLES: AtomicBool = AtomicBool::new(false);

/// Enables all tables of results from here on.
pub fn show_tables() {
    TABLES.store(true, Ordering::Relaxed);
}

/// Returns true if results are printed with all their tables.
pub fn tables_are_shown() -> bool {
    TABLES.load(Ordering::Relaxed)
}

/// Formats a section for printing: in brief, unless all tables are requested.
pub fn shown(section: &Section) -> String {
    if tables_are_shown() { section.to_text() } else { section.to_brief_text() }
}

/// Returns the option that helps; the library does not know the options.
fn option(issue: &Issue) -> Option<String> {
    match issue {
        Issue::OutlyingCenters { .. } | Issue::OutlyingUnweighted { .. } => Some("--loss".into()),
        Issue::Undetermined { .. } => Some("--fix".into()),
        Issue::SeveralPages { .. } => Some("for a single image: --pages".into()),
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
    let reasons = reasons.join(", ");
    say_failure(&format!("the verdict is \"do not use\" ({reasons})"));
    Some(ExitCode::from(4))
}

/// Prints an error, and the remedy if there is one.
pub fn say_error(error: &Error) {
    match remedy(error) {
        Some(remedy) => say_failure(&format!("{error}: {remedy}")),
        None => say_failure(&error.to_string()),
    }
}

/// Returns the option that helps for an error of the library, which does not know the options.
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
/// A reader that has gone away (a closed pipe) is not an error, since the files are written. A full disk is an error, since the
/// result is lost.
pub fn print_result(
    json: bool,
    document: &impl Serialize,
    text: &str,
    paths: &[PathBuf],
) -> Result<()> {
    if json {
        let document = serde_json::to_string(document)
            .map_err(|e| Error::invalid(format!("the result cannot be written as JSON: {e}")))?;
        return print(format!("{document}\n").as_bytes());
    }
    let text = format!("{}\n{}", coloured(text.trim_end()), written(paths));
    print_to(&mut anstream::stdout(), text.as_bytes())
}

/// Number of written files that are listed.
const MOST_FILES: usize = 8;

/// Lists the written files; if there are many, the first ones.
fn written(paths: &[PathBuf]) -> String {
    if paths.is_empty() {
        return String::new();
    }
    if let [path] = paths {
        return format!("Written: {}\n", path.display());
    }
    let most = if tables_are_shown() { paths.len() } else { MOST_FILES };
    let listed = if paths.len() > most { most - 1 } else { paths.len() };
    let names = paths[..listed].iter().map(|path| path.display().to_string());
    let more = (listed < paths.len()).then(|| format!("and {} more", paths.len() - listed));
    let lines: Vec<String> = names.chain(more).map(|line| format!("  {line}\n")).collect();
    format!("\nWritten:\n{}", lines.concat())
}

/// Prints the output of a command. A reader that has gone away is not an error.
pub fn print(text: &[u8]) -> Result<()> {
    print_to(&mut std::io::stdout(), text)
}

fn print_to(stdout: &mut impl Write, text: &[u8]) -> Result<()> {
    match stdout.write_all(text).and_then(|()| stdout.flush()) {
        Err(source) if source.kind() != ErrorKind::BrokenPipe => {
            Err(Error::Write { path: "standard output".into(), source })
        }
        _ => Ok(()),
    }
}
