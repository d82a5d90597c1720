//! Commands; one file for each.

mod boards;
mod calibrate;
mod demo;
mod detect;
mod evaluate;
mod extrinsics;
mod input;
mod precalibrate;
mod run;
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
    Run(run::Arguments),
    Demo(demo::Arguments),
    Precalibrate(precalibrate::Arguments),
    Detect(detect::Arguments),
    Calibrate(Box<calibrate::Arguments>),
    Extrinsics(extrinsics::Arguments),
    Evaluate(evaluate::Arguments),
    Simulate(simulate::Arguments),
}

const EXIT_STATUS: &str = "\
Exit status:
  0  done, and the result is converged and finite
  1  bad input or a failure: nothing was written
  2  the command line was not understood
  3  not converged: results were written, marked as such";

/// Runs the command line of this process.
pub fn run() -> ExitCode {
    let outcome = match Cli::parse().command {
        Command::Run(arguments) => run::run(&arguments),
        Command::Demo(arguments) => demo::run(&arguments),
        Command::Precalibrate(arguments) => precalibrate::run(&arguments),
        Command::Detect(arguments) => detect::run(&arguments),
        Command::Calibrate(arguments) => calibrate::run(&arguments),
        Command::Extrinsics(arguments) => extrinsics::run(&arguments),
        Command::Evaluate(arguments) => evaluate::run(&arguments),
        Command::Simulate(arguments) => simulate::run(&arguments),
    };
    outcome.unwrap_or_else(|error| {
        eprintln!("error: {error}");
        ExitCode::FAILURE
    })
}

/// Tells what the user should know.
fn warn(warnings: &[impl std::fmt::Display]) {
    for warning in warnings {
        eprintln!("warning: {warning}");
    }
}
