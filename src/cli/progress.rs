//! Progress lines on a terminal.

use std::io::{IsTerminal, Write};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

static HIDDEN: AtomicBool = AtomicBool::new(false);

/// Time between redraws of a progress line.
const TICK: Duration = Duration::from_millis(100);

/// Template with the number of finished steps, for work with long steps.
const STEPS: &str = "{spinner} {msg}: {pos} of {len}";
/// Template of a bar with the remaining time, for work with many short steps.
const SHARE: &str = "{spinner} {wide_bar} {percent} %, {eta} left: {msg}";
/// Template for work of unknown length.
const SPINNER: &str = "{spinner} {msg} ({elapsed})";

/// Hides progress from here on, since log lines would disturb it.
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

/// Progress line of work that has several parts.
static WHOLE: OnceLock<ProgressBar> = OnceLock::new();

/// Shows one line for all parts of the work from here on, with `steps` steps in total: the finished share, the remaining time
/// and the current part.
pub fn begin(quiet: bool, steps: usize) {
    let bar = shown(quiet, ProgressBar::new(steps as u64), SHARE, "");
    // Only one such work runs in a process.
    let _ = WHOLE.set(bar);
}

/// Shows which part of the whole work is running.
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

/// Returns true if the line of the whole work is on the terminal.
pub fn is_whole_shown() -> bool {
    WHOLE.get().is_some_and(|whole| !whole.is_hidden())
}

/// Counter of steps with its own line, or in the line of the whole work.
pub struct Steps {
    bar: ProgressBar,
    is_part: bool,
}

impl Steps {
    /// Counts one more step.
    pub fn inc(&self) {
        self.bar.inc(1);
    }

    /// Clears the line, unless it is the line of the whole work.
    pub fn finish(&self) {
        if !self.is_part {
            self.bar.finish_and_clear();
        }
    }
}

/// Starts to count steps.
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

/// Shows the finished fraction of many short steps.
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
