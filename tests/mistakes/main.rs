//! What becomes of users' mistakes: `make test-mistakes`.
//!
//! Each mistake is made in a simulated set, and the program is run on it as a user would. A mistake has
//! to end with the right camera, with a warning that names what is wrong, or with a refusal that does. One
//! that gives a wrong camera in silence fails the suite. Clean sets of other cameras, boards and exposures
//! go the same way, and may not warn.
//!
//! Arguments: names or parts of names, to run only those; `--list` prints the names.

mod clean;
mod edits;
mod features;
mod kinds;
mod listed;
mod outcome;
mod pixels;
mod processed;
mod set;
mod shot;
mod stated;

use std::process::ExitCode;
use std::time::Instant;

use outcome::{Kind, Outcome};
use set::Set;

/// A mistake, what it does to a set, and what has to come of it.
pub struct Mistake {
    /// What it is called.
    pub name: String,
    /// A set in which it is made.
    pub make: Box<dyn Fn() -> Set>,
    /// What has to come of it.
    pub expected: Expected,
}

/// What has to come of a mistake. Warnings and refusals contain one of the given pieces of text.
#[derive(Debug, Clone, Copy)]
pub enum Expected {
    /// The right camera, whether there are warnings or not.
    Right,
    /// The right camera and no warning.
    Clean,
    /// A warning, whether the camera is right or not.
    Warned(&'static [&'static str]),
    /// No result.
    Refused(&'static [&'static str]),
    /// A warning or no result.
    Told(&'static [&'static str]),
}

/// A mistake of a table.
pub fn mistake(
    name: impl Into<String>,
    expected: Expected,
    make: impl Fn() -> Set + 'static,
) -> Mistake {
    Mistake { name: name.into(), make: Box::new(make), expected }
}

impl Expected {
    fn met(&self, outcome: &Outcome) -> bool {
        let named = |pieces: &[&str]| pieces.iter().any(|piece| outcome.said.contains(piece));
        match self {
            Self::Right => matches!(outcome.kind, Kind::Right | Kind::RightWarned),
            Self::Clean => outcome.kind == Kind::Right,
            Self::Warned(pieces) => {
                matches!(outcome.kind, Kind::RightWarned | Kind::WrongWarned) && named(pieces)
            }
            Self::Refused(pieces) => outcome.kind == Kind::Refused && named(pieces),
            Self::Told(pieces) => {
                let told = [Kind::RightWarned, Kind::WrongWarned, Kind::Refused];
                told.contains(&outcome.kind) && named(pieces)
            }
        }
    }
}

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (options, parts): (Vec<_>, Vec<_>) = arguments.iter().partition(|a| a.starts_with("--"));
    let mut mistakes: Vec<Mistake> =
        [stated::mistakes(), listed::mistakes(), processed::mistakes(), shot::mistakes()]
            .into_iter()
            .chain([features::mistakes(), kinds::mistakes(), clean::sets()])
            .flatten()
            .collect();
    let names: Vec<String> = mistakes.iter().map(|m| m.name.clone()).collect();
    let is_meant = |name: &String, part: &String| {
        if names.contains(part) { name == part } else { name.contains(part) }
    };
    mistakes.retain(|m| parts.is_empty() || parts.iter().any(|part| is_meant(&m.name, part)));
    if options.iter().any(|option| *option == "--list") {
        for mistake in &mistakes {
            println!("{}", mistake.name);
        }
        return ExitCode::SUCCESS;
    }
    let (mut counts, mut failed) = ([0; 5], Vec::new());
    for mistake in &mistakes {
        let begun = Instant::now();
        let outcome = outcome::of(&(mistake.make)());
        counts[outcome.kind as usize] += 1;
        let met = mistake.expected.met(&outcome);
        let mark = if met { "" } else { "  <-- NOT AS EXPECTED" };
        let seconds = begun.elapsed().as_secs_f64();
        println!(
            "{:<52} {:<12} {} ({seconds:.1} s){mark}",
            mistake.name, outcome.kind, outcome.errors
        );
        for line in outcome.said.lines().take(6) {
            println!("      {line}");
        }
        if !met {
            failed.push(format!("{}: {}, not {:?}", mistake.name, outcome.kind, mistake.expected));
        }
    }
    println!("\n{} mistakes and clean sets", mistakes.len());
    for (kind, count) in Kind::ALL.into_iter().zip(counts) {
        println!("{count:>5}  {kind}");
    }
    for line in &failed {
        println!("NOT AS EXPECTED: {line}");
    }
    if failed.is_empty() && counts[Kind::Silent as usize] == 0 {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    }
}
