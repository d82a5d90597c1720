//! The process in which cases are tried.

use std::io::Write;
use std::path::Path;
use std::process::ExitCode;

use rand::SeedableRng;
use rand::rngs::StdRng;
use tempfile::TempDir;

use crate::commands::{PROGRAMS, Prepared};
use crate::hostile::in_use::SETS;
use crate::hostile::mutation::damaged;
use crate::hostile::readers::{TARGETS, Target};
use crate::hostile::solving::{self, SOLVING};
use crate::hostile::verdict::judge;

/// One solve, one use of a camera, and one run of each command, for so many damaged files.
const SOLVED_PER: u64 = 50;
const USED_PER: u64 = 20;
const RUN_PER: u64 = 500;

static READERS: [Target; TARGETS.len()] = TARGETS;
static SOLVES: Target = SOLVING;

/// Names of the targets, and how many cases each of them gets.
pub fn shares(cases: u64) -> Vec<(&'static str, u64)> {
    let each = cases.div_ceil(TARGETS.len() as u64);
    let readers = TARGETS.iter().map(|target| (target.name, each));
    readers
        .chain([(SOLVING.name, cases / SOLVED_PER)])
        .chain(SETS.iter().map(|set| (set.target.name, cases / USED_PER)))
        .chain(PROGRAMS.iter().map(|program| (program.name, cases / RUN_PER)))
        .collect()
}

/// Whether a case was accepted, or what is wrong with what came of it.
type Judge = dyn FnMut(&[u8]) -> Result<bool, String>;

/// A way to make a case of a number, and to judge it.
struct Trial {
    case: Box<dyn Fn(u64) -> Vec<u8>>,
    judge: Box<Judge>,
}

fn trial(name: &str, folder: &Path) -> Trial {
    let folder = folder.to_owned();
    if let Some(program) = PROGRAMS.iter().find(|program| program.name == name) {
        let mut prepared = Prepared::new(&folder);
        return Trial {
            case: Box::new(|number| number.to_le_bytes().to_vec()),
            judge: Box::new(move |case| prepared.judge(program, case)),
        };
    }
    let of_target = |target: &'static Target| {
        let path = folder.join(target.file);
        Box::new(move |case: &[u8]| judge(target, &path, case))
    };
    if name == SOLVING.name {
        return Trial {
            case: Box::new(|number| solving::case(&mut StdRng::seed_from_u64(number))),
            judge: of_target(&SOLVES),
        };
    }
    if let Some(set) = SETS.iter().find(|set| set.target.name == name) {
        // The valid files, which take longer than a case, are made once.
        drop(set.valid());
        return Trial {
            case: Box::new(|number| set.case(&mut StdRng::seed_from_u64(number))),
            judge: of_target(&set.target),
        };
    }
    let target = READERS.iter().find(|target| target.name == name);
    let target = target.unwrap_or_else(|| panic!("there is no target '{name}'"));
    let seeds = (target.seeds)();
    Trial {
        case: Box::new(move |number| {
            let seed = usize::try_from(number).unwrap_or_default() % seeds.len();
            damaged(&seeds[seed], &mut StdRng::seed_from_u64(number))
        }),
        judge: of_target(target),
    }
}

/// Where files are written a thousand times a second.
fn place() -> TempDir {
    let memory = Path::new("/dev/shm");
    let folder = if memory.is_dir() { TempDir::new_in(memory) } else { TempDir::new() };
    folder.expect("a folder can be made")
}

/// Tries cases, and says on stdout which one, what is found, and that it is done.
pub fn run(name: &str, from: u64, cases: u64) -> ExitCode {
    // A panic is reported as a finding.
    std::panic::set_hook(Box::new(|_| {}));
    plenocal::solver::silence_log();
    let folder = place();
    let mut trial = trial(name, folder.path());
    let mut accepted = 0;
    for number in from..from + cases {
        say(&format!("case {number}"));
        match (trial.judge)(&(trial.case)(number)) {
            Ok(read) => accepted += u64::from(read),
            Err(finding) => say(&format!("finding {}", finding.replace('\n', " | "))),
        }
    }
    say(&format!("done {accepted}"));
    ExitCode::SUCCESS
}

fn say(line: &str) {
    let mut stdout = std::io::stdout();
    writeln!(stdout, "{line}").and_then(|()| stdout.flush()).expect("somebody listens");
}

/// Prints how uses of a camera and commands end on valid files.
pub fn valid() -> ExitCode {
    let folder = place();
    for set in &SETS {
        let path = folder.path().join(set.target.file);
        for case in set.valid() {
            let ends = judge(&set.target, &path, &case);
            let reason = (set.target.read)(&path).err().map(|e| e.to_string());
            println!("{}: {ends:?} {}", set.target.name, reason.unwrap_or_default());
        }
    }
    for line in Prepared::new(folder.path()).baseline() {
        println!("{line}");
    }
    ExitCode::SUCCESS
}

/// Prints a case, and on stderr what comes of it.
pub fn show(name: &str, number: u64) -> ExitCode {
    let folder = place();
    let mut trial = trial(name, folder.path());
    let case = (trial.case)(number);
    std::io::stdout().write_all(&case).expect("somebody listens");
    eprintln!("\n{:?}", (trial.judge)(&case));
    ExitCode::SUCCESS
}
