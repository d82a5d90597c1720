//! Ctrl-C: what is not finished goes, and the user is told.

use std::process::exit;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use plenocal::io;

use super::progress;
use super::talk::say;

/// As shells have it: 128 and the number of SIGINT.
const INTERRUPTED: i32 = 130;
/// A second interrupt gives the first so long to remove files and to finish a commit.
const GRACE: Duration = Duration::from_secs(2);

/// From here on SIGINT, SIGTERM and SIGHUP leave no half-written files.
pub fn handle() {
    static AGAIN: AtomicBool = AtomicBool::new(false);
    let handler = || {
        if AGAIN.swap(true, Ordering::SeqCst) {
            thread::sleep(GRACE);
            say("interrupted again: temporary files (.tmp…) may be left");
            exit(INTERRUPTED);
        }
        // A thread of its own, so that a file system that hangs does not keep off a second interrupt.
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
    // Where a signal is ignored, as under nohup, all stays as the user has it.
    let _ = ctrlc::try_set_handler(handler);
}
