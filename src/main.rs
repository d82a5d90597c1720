//! The command line: parse, run, report errors.

mod cli;

use std::process::ExitCode;

fn main() -> ExitCode {
    cli::run()
}
