//! Whether and where progress is shown.

use std::io::{IsTerminal, Write};
use std::sync::atomic::{AtomicBool, Ordering};

static HIDDEN: AtomicBool = AtomicBool::new(false);

/// Progress is not shown from here on: log lines would run into it.
pub fn hide() {
    HIDDEN.store(true, Ordering::Relaxed);
}

/// Whether anybody is there to see it.
pub fn is_shown() -> bool {
    !HIDDEN.load(Ordering::Relaxed) && std::io::stderr().is_terminal()
}

/// Takes the progress line away, for a last word before the end of the process.
pub fn clear() {
    if is_shown() {
        let _ = std::io::stderr().write_all(b"\r\x1b[K");
    }
}
