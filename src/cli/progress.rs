//! Whether progress is shown, and how.

use std::io::{IsTerminal, Write};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

static HIDDEN: AtomicBool = AtomicBool::new(false);

/// How often a progress line is redrawn.
const TICK: Duration = Duration::from_millis(100);

/// Number of finished steps, for work with long steps.
const STEPS: &str = "{spinner} {msg}: {pos} of {len}";
/// A bar with the remaining time, for work with many short steps.
const SHARE: &str = "{spinner} {wide_bar} {percent} %, {eta} left: {msg}";
/// For work of unknown length.
const SPINNER: &str = "{spinner} {msg} ({elapsed})";

/// From here on, no progress is shown: log lines would disturb it.
pub fn hide() {
    HIDDEN.store(true, Ordering::Relaxed);
}

fn is_shown() -> bool {
    !HIDDEN.load(Ordering::Relaxed) && std::io::stderr().is_terminal()
}

/// Clears the progress line, for a last message before the end of the process.
pub fn clear() {
    if is_shown() {
        let _ = std::io::stderr().write_all(b"\r\x1b[K");
    }
}

/// The line of work that has several parts.
static WHOLE: OnceLock<ProgressBar> = OnceLock::new();

/// Shows one line for all parts of the work from here on, which has so many steps in all: their share that is done, the time
/// left, and the part that is going on.
pub fn begin(quiet: bool, steps: usize) {
    let bar = shown(quiet, ProgressBar::new(steps as u64), SHARE, "");
    // There is one such work in a process.
    let _ = WHOLE.set(bar);
}

/// Says which part of the whole work is going on.
pub fn part(doing: &str) {
    if let Some(whole) = WHOLE.get() {
        whole.set_message(doing.to_owned());
    }
}

/// Clears the line of the whole work.
pub fn end() {
    if let Some(whole) = WHOLE.get() {
        whole.finish_and_clear();
    }
}

/// Whether the line of the whole work is on the terminal.
pub fn is_whole_shown() -> bool {
    WHOLE.get().is_some_and(|whole| !whole.is_hidden())
}

/// Steps that are counted in a line of their own, or in that of the whole work.
pub struct Steps {
    bar: ProgressBar,
    is_part: bool,
}

impl Steps {
    /// Counts one more.
    pub fn inc(&self) {
        self.bar.inc(1);
    }

    /// Clears a line of its own.
    pub fn finish(&self) {
        if !self.is_part {
            self.bar.finish_and_clear();
        }
    }
}

/// Counts steps.
pub fn steps(quiet: bool, count: usize, doing: &str) -> Steps {
    if let Some(whole) = WHOLE.get() {
        part(doing);
        return Steps { bar: whole.clone(), is_part: true };
    }
    Steps { bar: shown(quiet, ProgressBar::new(count as u64), STEPS, doing), is_part: false }
}

/// Writes a line to stderr, above a line of progress.
pub fn above(write: impl FnOnce()) {
    match WHOLE.get() {
        Some(whole) => whole.suspend(write),
        None => write(),
    }
}

/// Shows the fraction of many short steps that is done.
pub fn share(count: u64) -> ProgressBar {
    shown(false, ProgressBar::new(count), SHARE, "")
}

/// Shows that work is going on.
pub fn spinner(quiet: bool, doing: &str) -> ProgressBar {
    shown(quiet, ProgressBar::new_spinner(), SPINNER, doing)
}

fn shown(quiet: bool, bar: ProgressBar, template: &str, doing: &str) -> ProgressBar {
    if quiet || !is_shown() {
        return ProgressBar::hidden();
    }
    let style = ProgressStyle::with_template(template);
    let bar = bar.with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
    bar.set_draw_target(ProgressDrawTarget::stderr());
    bar.set_message(doing.to_owned());
    bar.enable_steady_tick(TICK);
    bar
}
