//! Starts workers, and watches them: memory, time, and how they end.

use std::fmt;
use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};
use std::sync::Mutex;
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::thread;
use std::time::{Duration, Instant};

/// Longest time for a case.
const PATIENCE: Duration = Duration::from_secs(10);
/// Longest time until a worker has its valid files.
const START: Duration = Duration::from_secs(60);
/// Address space of a worker, KiB.
const MEMORY_KIB: u64 = 1 << 20;
/// Cases of one worker.
const SHARE: u64 = 20_000;
/// A target with more findings is given up.
const ENOUGH: usize = 20;

/// What came of the cases of a target.
#[derive(Default)]
pub struct Tally {
    cases: u64,
    accepted: u64,
    seconds: f64,
    pub findings: Vec<String>,
}

impl Tally {
    pub fn add(&mut self, other: Self) {
        self.cases += other.cases;
        self.accepted += other.accepted;
        self.seconds += other.seconds;
        self.findings.extend(other.findings);
    }
}

impl fmt::Display for Tally {
    fn fmt(&self, out: &mut fmt::Formatter) -> fmt::Result {
        let Self { cases, accepted, seconds, findings } = self;
        write!(
            out,
            "{cases:>8} cases {accepted:>8} accepted {seconds:>7.1} s {:>3} findings:",
            findings.len()
        )
    }
}

/// Runs cases of a target in as many workers as there are cores.
pub fn run(name: &str, from: u64, cases: u64) -> Tally {
    let begun = Instant::now();
    let next = Mutex::new(from);
    let all = Mutex::new(Tally::default());
    let work = || {
        loop {
            let (begin, end) = {
                let mut next = next.lock().expect("no worker panics");
                let begin = *next;
                *next = (begin + SHARE.min(cases.div_ceil(2).max(1))).min(from + cases);
                (begin, *next)
            };
            if begin == end || all.lock().expect("no worker panics").findings.len() >= ENOUGH {
                return;
            }
            let tally = share(name, begin, end);
            all.lock().expect("no worker panics").add(tally);
        }
    };
    thread::scope(|scope| {
        for _ in 0..thread::available_parallelism().map_or(1, usize::from) {
            scope.spawn(work);
        }
    });
    let mut all = all.into_inner().expect("no worker panics");
    all.seconds = begun.elapsed().as_secs_f64();
    all
}

/// Cases from `begin` to `end`; after a case that ends the worker, another goes on.
fn share(name: &str, begin: u64, end: u64) -> Tally {
    let mut tally = Tally::default();
    let mut begin = begin;
    while begin < end && tally.findings.len() < ENOUGH {
        let (mut child, lines) = start(name, begin, end);
        let (case, done) = follow(&lines, begin, &mut tally);
        if done.is_none() {
            let _ = child.kill();
        }
        let status = child.wait().expect("a child can be waited for");
        tally.cases += case + 1 - begin;
        begin = case + 1;
        match done {
            Some(true) if status.success() => {}
            Some(_) => tally.findings.push(format!("case {case}: the worker ended: {status}")),
            None => tally.findings.push(format!("case {case}: it takes more than 10 s")),
        }
    }
    tally
}

fn start(name: &str, begin: u64, end: u64) -> (Child, Receiver<String>) {
    let program = std::env::current_exe().expect("the program has a path");
    let limited = format!("ulimit -v {MEMORY_KIB}; ulimit -c 0; exec \"$0\" \"$@\"");
    let mut child = Command::new("sh")
        .args(["-c", &limited])
        .arg(program)
        .args(["--worker", name, &begin.to_string(), &(end - begin).to_string()])
        .stdout(Stdio::piped())
        .spawn()
        .expect("a worker can be started");
    let lines = BufReader::new(child.stdout.take().expect("a pipe")).lines();
    let (send, receive) = channel();
    thread::spawn(move || {
        for line in lines.map_while(Result::ok) {
            if send.send(line).is_err() {
                return;
            }
        }
    });
    (child, receive)
}

/// The last case that was begun; and whether the worker said that it is done, or `None` if it says nothing more.
fn follow(lines: &Receiver<String>, begin: u64, tally: &mut Tally) -> (u64, Option<bool>) {
    let mut case = begin;
    let mut patience = START;
    loop {
        match lines.recv_timeout(patience) {
            Ok(line) => match line.split_once(' ').unwrap_or((&line, "")) {
                ("case", number) => case = number.parse().unwrap_or(case),
                ("finding", text) => tally.findings.push(format!("case {case}: {text}")),
                ("done", accepted) => {
                    tally.accepted += accepted.parse().unwrap_or(0);
                    return (case, Some(true));
                }
                _ => {}
            },
            Err(RecvTimeoutError::Timeout) => return (case, None),
            Err(RecvTimeoutError::Disconnected) => return (case, Some(false)),
        }
        patience = PATIENCE;
    }
}
