//! A million damaged files: `make fuzz`.
//!
//! Workers read damaged files with every reader, solve damaged sets, use damaged cameras as `rays`, `points`, `compare`,
//! `extrinsics` and `evaluate` do, and run every command on damaged folders. A worker has 1 GB of memory, and 10 s for a case; one
//! that ends, or does not, is a finding. So is a panic, an error that names no file, a number that is not finite, in results
//! or in the files of a command, an exit status beyond 4, and a file left behind or outside the folder for results.
//!
//! Arguments: `--cases N` of the readers (a million); names of targets, to run only those; `--from N`, where the
//! numbers of cases begin; `--show TARGET CASE` prints a case, `--valid` what comes of commands on valid files. The same number gives the same case.

#[path = "../hostile/mod.rs"]
mod hostile;

mod commands;
mod outputs;
mod supervisor;
mod worker;

use std::process::ExitCode;
use std::time::Instant;

use supervisor::Tally;

/// Cases of the readers altogether.
const CASES: u64 = 1_000_000;

/// What is asked for.
struct Arguments {
    cases: u64,
    from: u64,
    names: Vec<String>,
}

fn main() -> ExitCode {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    if let ["--worker", target, from, cases] = words.as_slice() {
        return worker::run(target, number(from), number(cases));
    }
    if let ["--show", target, case] = words.as_slice() {
        return worker::show(target, number(case));
    }
    if words.as_slice() == ["--valid"] {
        return worker::valid();
    }
    run(&arguments(&words))
}

fn number(word: &str) -> u64 {
    word.parse().unwrap_or_else(|_| panic!("'{word}' is not a number"))
}

fn arguments(words: &[&str]) -> Arguments {
    let mut arguments = Arguments { cases: CASES, from: 0, names: Vec::new() };
    let mut words = words.iter();
    while let Some(word) = words.next() {
        match *word {
            "--cases" => arguments.cases = number(words.next().unwrap_or(&"")),
            "--from" => arguments.from = number(words.next().unwrap_or(&"")),
            name => arguments.names.push(name.to_owned()),
        }
    }
    arguments
}

fn run(arguments: &Arguments) -> ExitCode {
    let begun = Instant::now();
    let mut all = Tally::default();
    for (name, cases) in worker::shares(arguments.cases) {
        if !arguments.names.is_empty()
            && !arguments.names.iter().any(|part| name.contains(part.as_str()))
        {
            continue;
        }
        let tally = supervisor::run(name, arguments.from, cases);
        println!("{tally} {name}");
        for finding in &tally.findings {
            println!("  FINDING {finding}");
        }
        all.add(tally);
    }
    println!("{all} in all, {:.0} s", begun.elapsed().as_secs_f64());
    if all.findings.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
