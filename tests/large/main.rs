//! How much memory every command takes on the largest input that it accepts: `make test-large`.
//!
//! A command that takes more than a gigabyte has to say so beforehand: a system without that much memory ends it without a word.
//!
//! Arguments: parts of names, to run only those; `--list` prints the names.

mod inputs;
mod memory;

use std::process::ExitCode;

use inputs::{Inputs, cases};
use memory::Measured;

/// Memory that needs no announcement, bytes.
const UNANNOUNCED: u64 = 1_000_000_000;
/// What the program says beforehand.
const ANNOUNCEMENT: &str = "GB of memory";

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (options, parts): (Vec<_>, Vec<_>) = arguments.iter().partition(|a| a.starts_with("--"));
    let mut cases = cases();
    cases.retain(|case| parts.is_empty() || parts.iter().any(|part| case.name.contains(*part)));
    if options.iter().any(|option| *option == "--list") {
        for case in &cases {
            println!("{}", case.name);
        }
        return ExitCode::SUCCESS;
    }
    let inputs = Inputs::new();
    let mut failed = Vec::new();
    for case in &cases {
        let arguments = (case.make)(&inputs);
        let measured = Measured::of(&arguments, &inputs.out());
        let announced = measured.said.contains(ANNOUNCEMENT);
        let crashed = !matches!(measured.status, Some(0 | 1 | 3 | 4));
        let unexpected = case.works && measured.status == Some(1);
        let wrong = crashed || unexpected || (measured.peak_bytes > UNANNOUNCED && !announced);
        println!(
            "{:<60} {:>6} MB {:>6.1} s{}{}",
            case.name,
            measured.peak_bytes / 1_000_000,
            measured.seconds,
            if announced { ", announced" } else { "" },
            if wrong { "  <-- NOT AS EXPECTED" } else { "" },
        );
        measured.said.lines().take(3).for_each(|line| println!("      {line:.160}"));
        if wrong {
            failed.push(case.name);
        }
        inputs.clear();
    }
    for name in &failed {
        println!("NOT AS EXPECTED: {name}");
    }
    if failed.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
