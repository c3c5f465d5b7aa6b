//! How far long work is: a bar with the time left on a terminal, a line now and then where standard error is a file or a pipe.
//!
//! Standard output is the command's own. Counts may come from several threads; what is written is written by whichever of them
//! finds it due. Seconds of the wall.

use std::io::{IsTerminal, Write};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Between two drawings on a terminal.
const DRAWN_EVERY: Duration = Duration::from_millis(100);
/// Between two lines elsewhere, so that short work writes none.
const TOLD_EVERY: Duration = Duration::from_secs(5);
/// Cells of the bar.
const CELLS: usize = 24;

/// How far one piece of work is.
pub struct Progress {
    what: String,
    total: u64,
    done: AtomicU64,
    start: Instant,
    next: Mutex<Instant>,
    terminal: bool,
    drawn: AtomicBool,
}

impl Progress {
    /// Work of `total` equal steps.
    #[must_use]
    pub fn new(what: &str, total: usize) -> Self {
        let start = Instant::now();
        let terminal = std::io::stderr().is_terminal();
        Self {
            what: what.to_owned(),
            total: total.max(1) as u64,
            done: AtomicU64::new(0),
            start,
            next: Mutex::new(start + if terminal { DRAWN_EVERY } else { TOLD_EVERY }),
            terminal,
            drawn: AtomicBool::new(false),
        }
    }

    /// One more step is done.
    pub fn step(&self) {
        self.step_with(String::new);
    }

    /// The same, with what else is to be known.
    pub fn step_with(&self, more: impl FnOnce() -> String) {
        let done = self.done.fetch_add(1, Ordering::Relaxed) + 1;
        let now = Instant::now();
        // Who finds another at it goes on working.
        let Ok(mut next) = self.next.try_lock() else {
            return;
        };
        if now < *next {
            return;
        }
        *next = now
            + if self.terminal {
                DRAWN_EVERY
            } else {
                TOLD_EVERY
            };
        let line = line(
            &self.what,
            [done, self.total],
            self.start.elapsed(),
            &more(),
            self.terminal,
        );
        self.drawn.store(self.terminal, Ordering::Relaxed);
        // That nobody reads it must not end the work.
        let _ = std::io::stderr().write_all(line.as_bytes());
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        let _next = self.next.lock().unwrap_or_else(PoisonError::into_inner);
        if self.drawn.load(Ordering::Relaxed) {
            let _ = std::io::stderr().write_all(b"\r\x1b[K");
        }
    }
}

/// `[done, total]` of the work, with the time left as it has gone so far.
fn line(
    what: &str,
    [done, total]: [u64; 2],
    passed: Duration,
    more: &str,
    terminal: bool,
) -> String {
    let done = done.min(total);
    let left = passed.as_secs_f64() * (total - done) as f64 / done.max(1) as f64;
    let left = left.ceil() as u64;
    let time = if left >= 3600 {
        format!("{} h {:02} min", left / 3600, left / 60 % 60)
    } else if left >= 60 {
        format!("{} min {:02} s", left / 60, left % 60)
    } else {
        format!("{left} s")
    };
    let comma = if more.is_empty() { "" } else { ", " };
    if terminal {
        let full = (done as usize * CELLS) / total as usize;
        let bar = format!("{}{}", "█".repeat(full), "░".repeat(CELLS - full));
        format!("\r\x1b[K{what} {bar} {done}/{total}, {time} left{comma}{more}")
    } else {
        format!("{what}: {done} of {total}, {time} left{comma}{more}\n")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_time_left_is_that_of_the_steps_to_come() {
        let said = |done, terminal| line("fit", [done, 40], Duration::from_secs(60), "", terminal);
        assert_eq!(said(10, false), "fit: 10 of 40, 3 min 00 s left\n");
        assert_eq!(said(40, false), "fit: 40 of 40, 0 s left\n");
        assert_eq!(said(1, false), "fit: 1 of 40, 39 min 00 s left\n");
        let bar = said(20, true);
        assert_eq!(bar.matches('█').count(), CELLS / 2, "{bar}");
    }

    #[test]
    fn what_is_piped_has_no_control_characters_but_its_line_end() {
        let said = line("record", [3, 9], Duration::from_secs(2), "1.0 MB", false);
        assert!(
            said.trim_end_matches('\n').chars().all(|c| !c.is_control()),
            "{said:?}"
        );
        assert!(said.ends_with("1.0 MB\n"));
    }
}
