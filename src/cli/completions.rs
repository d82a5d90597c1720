//! `plenocal completions`: scripts that complete command lines in a shell.

use std::process::ExitCode;

use clap::{Args, CommandFactory};
use clap_complete::Shell;
use plenocal::Result;

/// Print a script that completes plenocal's command lines in a shell.
#[derive(Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// Shell for which the script is written.
    shell: Shell,
}

const EXAMPLES: &str = "\
Examples:
  plenocal completions bash > ~/.local/share/bash-completion/completions/plenocal
  plenocal completions zsh > ~/.zfunc/_plenocal        # with ~/.zfunc in fpath
  plenocal completions fish > ~/.config/fish/completions/plenocal.fish";

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<ExitCode> {
    let mut script = Vec::new();
    clap_complete::generate(arguments.shell, &mut super::Cli::command(), "plenocal", &mut script);
    super::messages::print(&script)?;
    Ok(ExitCode::SUCCESS)
}
