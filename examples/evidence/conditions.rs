//! The conditions under which evidence is made: date, version and machine.

use std::fs;
use std::process::Command;
use std::time::Duration;

/// Date, version and machine.
pub struct Conditions {
    date: String,
    version: String,
    machine: String,
}

impl Conditions {
    /// Reads them. The version is taken before the first part changes a page.
    pub fn now() -> Self {
        let commit = output("git", &["describe", "--always", "--tags"]);
        // Pages change while the evidence is made.
        let changed = output("git", &["status", "--porcelain", "--", ".", ":!docs"]);
        let ceres = output("dpkg-query", &["-W", "-f", "${Version}", "libceres-dev"]);
        let ceres = ceres.split(['+', '-']).next().unwrap_or_default().to_owned();
        let system = field("/etc/os-release", "PRETTY_NAME=", "an unknown system");
        let processor = field("/proc/cpuinfo", "model name", "an unknown processor");
        let cores = std::thread::available_parallelism().map_or(0, usize::from);
        Self {
            date: output("date", &["+%F"]),
            version: format!(
                "plenocal {} ({commit}{})",
                env!("CARGO_PKG_VERSION"),
                if changed.is_empty() { "" } else { ", changed" }
            ),
            machine: format!("Ceres {ceres}, {system}, {cores} cores of {processor}"),
        }
    }

    /// Formats them, with the command that makes a part and the time that it took.
    pub fn text(&self, part: &str, took: Duration) -> String {
        let Self { date, version, machine } = self;
        let took = match took.as_secs() {
            seconds @ ..120 => format!("{seconds} s"),
            seconds => format!("{} min", seconds.div_ceil(60)),
        };
        format!("*By `make evidence PART={part}`, {date}, {took}: {version}, {machine}.*")
    }
}

/// Returns what a program prints; nothing if it fails.
fn output(program: &str, arguments: &[&str]) -> String {
    let output = Command::new(program)
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .args(arguments)
        .output()
        .ok()
        .filter(|output| output.status.success());
    output.map_or(String::new(), |o| String::from_utf8_lossy(&o.stdout).trim().to_owned())
}

/// Returns the value of the first line of a file that begins with a key.
fn field(path: &str, key: &str, unknown: &str) -> String {
    let text = fs::read_to_string(path).unwrap_or_default();
    let value = text.lines().find_map(|line| line.strip_prefix(key));
    let value = value.map(|v| v.trim_matches([' ', '\t', ':', '"']));
    value.unwrap_or(unknown).to_owned()
}
