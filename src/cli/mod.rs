//! Commands; one file for each.

/// Help of `--out` for the files that a command writes there. The treatment of existing files is the same for all commands.
macro_rules! results_help {
    ($files:literal) => {
        concat!("Folder for the results: ", $files, ". Files of earlier results are replaced")
    };
}

mod boards;
mod calibrate;
mod compare;
mod completions;
mod cost;
mod demo;
mod detect;
mod evaluate;
mod extrinsics;
mod given;
mod init;
mod input;
mod interrupt;
mod logging;
mod man;
mod messages;
mod pictures;
mod points;
mod precalibrate;
mod progress;
mod rays;
mod run;
mod simulate;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

/// Calibrates multi-focus plenoptic (light-field) cameras.
///
/// Estimates the main lens, the micro-lens array with the focal length of every lens type, and the poses of the boards from
/// white images and images of a checkerboard, all with their uncertainty.
#[derive(Parser)]
#[command(name = "plenocal", version, after_help = AFTER_HELP, max_term_width = 100)]
struct Cli {
    #[command(subcommand)]
    command: Command,

    /// Log to stderr: -v files, stages and their results, -vv also every frame and iteration, -vvv
    /// also every white image. Progress lines are then hidden.
    #[arg(short, long, global = true, action = clap::ArgAction::Count, display_order = 999)]
    verbose: u8,

    /// Print results with all their tables, and all files that were written.
    #[arg(long, global = true, display_order = 998)]
    tables: bool,
}

// The order in which they are used.
#[derive(Subcommand)]
enum Command {
    Init(init::Arguments),
    Run(run::Arguments),
    Demo(demo::Arguments),
    Simulate(simulate::Arguments),
    Precalibrate(precalibrate::Arguments),
    Detect(detect::Arguments),
    Calibrate(Box<calibrate::Arguments>),
    Extrinsics(extrinsics::Arguments),
    Evaluate(evaluate::Arguments),
    Compare(compare::Arguments),
    Rays(rays::Arguments),
    Points(points::Arguments),
    Completions(completions::Arguments),
    Man(man::Arguments),
}

const AFTER_HELP: &str = "\
From images to a report:
  plenocal init images --preset r12-a --board 8x5x10 --out project.toml
  plenocal run project.toml --out results

The same step by step:
  plenocal precalibrate project.toml --out white
  plenocal detect project.toml --precalibration white --out boards
  plenocal calibrate project.toml --params white/precalibration.json \\
      --centers white/centers.csv --features boards/features.csv --out results

Exit status:
  0    success; for a calibration, the verdict is good or usable with care
  1    bad input or a failure: nothing was written
  2    the command line was not understood
  3    not converged, or parameters are not determined: results were written, marked as such
  4    the verdict is: do not use; results were written, marked as such
  130  interrupted (Ctrl-C, SIGTERM, SIGHUP): nothing half-written is left";

/// Runs the command line of this process.
pub fn run() -> ExitCode {
    let arguments = Cli::parse();
    logging::begin(arguments.verbose);
    if arguments.tables {
        messages::show_tables();
    }
    // Ceres warns of trial steps that leave the domain of the model; the solver handles them.
    plenocal::solver::silence_log();
    interrupt::handle();
    let outcome = match arguments.command {
        Command::Init(arguments) => init::run(&arguments),
        Command::Run(arguments) => run::run(&arguments),
        Command::Demo(arguments) => demo::run(&arguments),
        Command::Simulate(arguments) => simulate::run(&arguments),
        Command::Precalibrate(arguments) => precalibrate::run(&arguments),
        Command::Detect(arguments) => detect::run(&arguments),
        Command::Calibrate(arguments) => calibrate::run(&arguments),
        Command::Extrinsics(arguments) => extrinsics::run(&arguments),
        Command::Evaluate(arguments) => evaluate::run(&arguments),
        Command::Compare(arguments) => compare::run(&arguments),
        Command::Rays(arguments) => rays::run(&arguments),
        Command::Points(arguments) => points::run(&arguments),
        Command::Completions(arguments) => completions::run(&arguments),
        Command::Man(arguments) => man::run(&arguments),
    };
    outcome.unwrap_or_else(|error| {
        messages::say_error(&error);
        ExitCode::FAILURE
    })
}
