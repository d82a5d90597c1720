//! Commands; one file for each.

mod calibrate;
mod detect;
mod input;
mod interrupt;
mod precalibrate;
mod progress;
mod simulate;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

/// Calibrates multi-focus plenoptic (light-field) cameras.
#[derive(Parser)]
#[command(version, after_help = EXIT_STATUS, max_term_width = 100)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Calibrate(Box<calibrate::Arguments>),
    Detect(detect::Arguments),
    Precalibrate(precalibrate::Arguments),
    Simulate(simulate::Arguments),
}

const EXIT_STATUS: &str = "\
Exit status:
  0  done, and the result is converged and finite
  1  bad input or a failure: nothing was written
  2  the command line was not understood
  3  not converged: results were written, marked as such
  130  interrupted (Ctrl-C, SIGTERM, SIGHUP): nothing half-written is left";

/// Runs the command line of this process.
pub fn run() -> ExitCode {
    let command = Cli::parse().command;
    interrupt::handle();
    let outcome = match command {
        Command::Calibrate(arguments) => calibrate::run(&arguments),
        Command::Detect(arguments) => detect::run(&arguments),
        Command::Precalibrate(arguments) => precalibrate::run(&arguments),
        Command::Simulate(arguments) => simulate::run(&arguments),
    };
    outcome.unwrap_or_else(|error| {
        eprintln!("error: {error}");
        ExitCode::FAILURE
    })
}
