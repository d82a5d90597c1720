//! What becomes of calibrated cameras that are misused: `make test-misuse`.
//!
//! A simulated set is calibrated once. Each case uses its camera in a wrong way (another camera, damaged values, features, depths
//! or images of something else) or in a right one, and names what has to come of it. A use that gives other distances in
//! silence fails the suite, and so does a crash.
//!
//! Arguments: names or parts of names, to run only those; `--list` prints the names.

mod base;
mod cameras;
mod depths;
mod features;
mod outcome;
mod uses;

use std::process::ExitCode;
use std::time::Instant;

use base::Scratch;
use outcome::{Kind, Outcome};

/// Makes the files of a use and returns the arguments of the program.
type Make = Box<dyn Fn(&Scratch) -> Vec<String>>;

/// A use of a camera, and what has to come of it.
pub struct Case {
    /// What it is called.
    pub name: String,
    /// Makes the files in a folder of its own and returns the arguments of the program.
    pub make: Make,
    /// What has to come of it.
    pub expected: Expected,
}

/// What has to come of a use.
#[derive(Debug, Clone, Copy)]
pub enum Expected {
    /// The right answer, and nothing told.
    Clean,
    /// The right answer, whatever is told.
    Right,
    /// Something told that contains one of these pieces of text; a code in brackets, as a rule.
    Told(&'static [&'static str]),
    /// No answer, and a message that contains one of these pieces of text.
    Refused(&'static [&'static str]),
    /// Something told or no answer, as a command reads camera and images in one order or another.
    ToldOrRefused(&'static [&'static str]),
}

impl Expected {
    fn met(self, outcome: &Outcome) -> bool {
        let named = |pieces: &[&str]| pieces.iter().any(|piece| outcome.said.contains(piece));
        match self {
            Self::Clean => outcome.kind == Kind::Right,
            Self::Right => matches!(outcome.kind, Kind::Right | Kind::RightTold),
            Self::Told(pieces) => {
                matches!(outcome.kind, Kind::RightTold | Kind::Told) && named(pieces)
            }
            Self::Refused(pieces) => outcome.kind == Kind::Refused && named(pieces),
            Self::ToldOrRefused(pieces) => {
                let kinds = [Kind::RightTold, Kind::Told, Kind::Refused];
                kinds.contains(&outcome.kind) && named(pieces)
            }
        }
    }
}

/// A case of a table.
pub fn case(
    name: impl Into<String>,
    expected: Expected,
    make: impl Fn(&Scratch) -> Vec<String> + 'static,
) -> Case {
    Case { name: name.into(), make: Box::new(make), expected }
}

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (options, parts): (Vec<_>, Vec<_>) = arguments.iter().partition(|a| a.starts_with("--"));
    let mut cases: Vec<Case> =
        [cameras::cases(), features::cases(), depths::cases(), uses::cases()]
            .into_iter()
            .flatten()
            .collect();
    cases.retain(|case| parts.is_empty() || parts.iter().any(|part| case.name.contains(*part)));
    if options.iter().any(|option| *option == "--list") {
        for case in &cases {
            println!("{}", case.name);
        }
        return ExitCode::SUCCESS;
    }
    let (mut counts, mut failed) = ([0; Kind::ALL.len()], Vec::new());
    for case in &cases {
        let begun = Instant::now();
        let outcome = outcome::of(case);
        counts[outcome.kind as usize] += 1;
        let met = case.expected.met(&outcome) && outcome.kind != Kind::Crashed;
        let mark = if met { "" } else { "  <-- NOT AS EXPECTED" };
        let seconds = begun.elapsed().as_secs_f64();
        println!("{:<60} {:<12} ({seconds:.1} s){mark}", case.name, outcome.kind);
        outcome.said.lines().take(4).for_each(|line| println!("      {line}"));
        if !met {
            failed.push(format!("{}: {}, not {:?}", case.name, outcome.kind, case.expected));
        }
    }
    println!("\n{} uses of cameras", cases.len());
    Kind::ALL.into_iter().zip(counts).for_each(|(kind, count)| println!("{count:>5}  {kind}"));
    for line in &failed {
        println!("NOT AS EXPECTED: {line}");
    }
    if failed.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
