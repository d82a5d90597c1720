//! `plenocal man`: writes manual pages.

use std::io::{self, Write};
use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Args, Command, CommandFactory};
use clap_mangen::Man;
use clap_mangen::roff::Roff;
use plenocal::Result;
use plenocal::io::OutputFolder;

/// Write manual pages: plenocal.1 and one for each command.
#[derive(Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// Folder for the pages.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

const EXAMPLES: &str = "\
Examples:
  plenocal man --out ~/.local/share/man/man1
  man plenocal-calibrate";

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<ExitCode> {
    let mut output = OutputFolder::new(&arguments.out)?;
    let mut program = super::Cli::command().disable_help_subcommand(true);
    program.build();
    let commands: Vec<Command> = program.get_subcommands().cloned().collect();
    for command in std::iter::once(program).chain(commands) {
        let name = Man::new(command.clone()).get_filename();
        output.stage(name, |out| page(command, out))?;
    }
    let paths = output.commit()?;
    let files: Vec<String> = paths.iter().map(|p| format!("  {}\n", p.display())).collect();
    let _ = io::stdout().write_all(format!("Written:\n{}", files.concat()).as_bytes());
    Ok(ExitCode::SUCCESS)
}

fn page(command: Command, out: &mut dyn Write) -> io::Result<()> {
    let after_help = command.get_after_help().map(ToString::to_string);
    let has_commands = command.has_subcommands();
    let source = concat!(env!("CARGO_PKG_NAME"), " ", env!("CARGO_PKG_VERSION"));
    let man = Man::new(command).source(source);
    man.render_title(out)?;
    man.render_name_section(out)?;
    man.render_synopsis_section(out)?;
    man.render_description_section(out)?;
    man.render_options_section(out)?;
    if has_commands {
        man.render_subcommands_section(out)?;
    }
    after_help.map_or(Ok(()), |text| sections(&text, out))
}

/// Writes the text after the help line by line. Each paragraph is a section; its first line is the heading.
fn sections(text: &str, out: &mut dyn Write) -> io::Result<()> {
    let mut roff = Roff::new();
    for paragraph in text.split("\n\n") {
        let (heading, lines) = paragraph.split_once('\n').unwrap_or((paragraph, ""));
        roff.control("SH", [heading.trim_end_matches(':').to_uppercase().as_str()]);
        roff.control("nf", []);
        for line in lines.lines() {
            roff.text([clap_mangen::roff::roman(line)]);
        }
        roff.control("fi", []);
    }
    roff.to_writer(out)
}
