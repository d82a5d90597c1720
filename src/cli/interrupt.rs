//! Ctrl-C: removes unfinished output, and prints a message.

use std::process::exit;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use plenocal::io;

use super::messages::say;
use super::progress;

/// Exit status by the convention of shells: 128 plus the number of SIGINT.
const INTERRUPTED: i32 = 130;
/// Time that a second interrupt leaves the first to remove files or finish a commit.
const GRACE: Duration = Duration::from_secs(2);

/// Installs the handler with which SIGINT, SIGTERM and SIGHUP leave no half-written files.
pub fn handle() {
    static AGAIN: AtomicBool = AtomicBool::new(false);
    let handler = || {
        if AGAIN.swap(true, Ordering::SeqCst) {
            thread::sleep(GRACE);
            say("interrupted again: temporary files (.plenocal-….tmp) may be left");
            exit(INTERRUPTED);
        }
        // A separate thread, so that a hanging file system does not block a second interrupt.
        thread::spawn(|| {
            let committed = io::abandon_output();
            progress::clear();
            // Not eprintln!, which panics if nobody reads stderr: the process would never end.
            say(if committed {
                "interrupted: what was written before is complete, and nothing else was written"
            } else {
                "interrupted: nothing was written"
            });
            exit(INTERRUPTED);
        });
    };
    // A signal that is ignored, as under nohup, stays ignored.
    let _ = ctrlc::try_set_handler(handler);
}
