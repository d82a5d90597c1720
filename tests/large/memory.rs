//! The largest amount of memory that a run of the program takes.

use std::fs;
use std::io::Read;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

/// How often the system is asked for the largest amount until then.
const INTERVAL: Duration = Duration::from_millis(5);
/// Longest time for a run.
const PATIENCE: Duration = Duration::from_secs(1200);

/// What a run took.
pub struct Measured {
    /// `None` after a signal.
    pub status: Option<i32>,
    pub peak_bytes: u64,
    pub seconds: f64,
    pub said: String,
}

impl Measured {
    /// Runs the program with these arguments.
    pub fn of(arguments: &[String], out: &Path) -> Self {
        let begun = Instant::now();
        let mut child = Command::new(env!("CARGO_BIN_EXE_plenocal"))
            .args(arguments)
            .arg("--out")
            .arg(out)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the program runs");
        let mut stderr = child.stderr.take().expect("a pipe");
        let listener = thread::spawn(move || {
            let mut said = Vec::new();
            let _ = stderr.read_to_end(&mut said);
            String::from_utf8_lossy(&said).into_owned()
        });
        let mut peak_bytes = 0;
        let mut is_too_long = false;
        let status = loop {
            peak_bytes = peak_bytes.max(high_water(&child).unwrap_or(0));
            if let Some(status) = child.try_wait().expect("a child can be waited for") {
                break status;
            }
            if begun.elapsed() > PATIENCE {
                is_too_long = true;
                let _ = child.kill();
            }
            thread::sleep(INTERVAL);
        };
        let seconds = begun.elapsed().as_secs_f64();
        let mut said = listener.join().expect("the listener does not panic");
        if is_too_long {
            said.insert_str(0, "ended: it takes too long\n");
        }
        Self { status: status.code(), peak_bytes, seconds, said }
    }
}

/// The largest amount of memory until now, as Linux counts it.
fn high_water(child: &Child) -> Option<u64> {
    let status = fs::read_to_string(format!("/proc/{}/status", child.id())).ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok().map(|kib| kib * 1024)
}
