//! Ctrl-C: removes unfinished output, and says so.

use std::process::exit;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use plenocal::io;

use super::messages::say;
use super::progress;

/// The convention of shells: 128 plus the number of SIGINT.
const INTERRUPTED: i32 = 130;
/// How long a second interrupt lets the first remove files or finish a commit.
const GRACE: Duration = Duration::from_secs(2);

/// From here on, SIGINT, SIGTERM and SIGHUP leave no half-written files.
pub fn handle() {
    static AGAIN: AtomicBool = AtomicBool::new(false);
    let handler = || {
        if AGAIN.swap(true, Ordering::SeqCst) {
            thread::sleep(GRACE);
            say("interrupted again: temporary files (.plenocal-….tmp) may be left");
            exit(INTERRUPTED);
        }
        // A thread of its own, so that a hanging file system does not block a second interrupt.
        thread::spawn(|| {
            let committed = io::abandon_output();
            progress::clear();
            // Not eprintln!: it panics when nobody reads stderr, and the process would never end.
            say(if committed {
                "interrupted: what was written before is complete, and nothing else was written"
            } else {
                "interrupted: nothing was written"
            });
            exit(INTERRUPTED);
        });
    };
    // Where a signal is ignored, as under nohup, it stays ignored.
    let _ = ctrlc::try_set_handler(handler);
}
