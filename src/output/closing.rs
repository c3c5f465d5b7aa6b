//! Closes an output that has a thread: it may still send the messages that report nobody to the receiver, but no more.

use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Time limit.
const CLOSING: Duration = Duration::from_millis(500);

/// Waits for a thread that was told to stop; a hanging one is abandoned.
pub(super) fn wait_for(thread: JoinHandle<()>) {
    let start = Instant::now();
    while !thread.is_finished() && start.elapsed() < CLOSING {
        std::thread::sleep(Duration::from_millis(2));
    }
    if thread.is_finished() {
        // A panic of the thread has been reported by itself.
        thread.join().ok();
    }
}
