//! Progress of long work: a bar with the time left on a terminal (indicatif), a line now and then where standard error is a file or
//! a pipe. Short work shows neither.
//!
//! Standard output is the command's own. Steps may come from several threads.

use std::io::{IsTerminal, Write};
use std::sync::Mutex;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use rayon::prelude::*;

/// Between two lines where there is no terminal, and before the first.
const TOLD_EVERY: Duration = Duration::from_secs(5);
/// Drawings a second on a terminal.
const DRAWN_HZ: u8 = 10;
/// indicatif cuts what does not fit the terminal's width.
const BAR: &str = "{prefix} {bar:24} {pos}/{len}, {eta} left{wide_msg}";

/// How far one piece of work is.
pub struct Progress {
    what: String,
    bar: ProgressBar,
    /// When the next line is due; none on a terminal.
    next: Option<Mutex<Instant>>,
}

impl Progress {
    /// Work of `total` equal steps.
    pub fn new(what: &str, total: usize) -> Self {
        let total = Some(total.max(1) as u64);
        let (target, next) = if std::io::stderr().is_terminal() {
            (ProgressDrawTarget::stderr_with_hz(DRAWN_HZ), None)
        } else {
            let first = Instant::now() + TOLD_EVERY;
            (ProgressDrawTarget::hidden(), Some(Mutex::new(first)))
        };
        let style = ProgressStyle::with_template(BAR).expect("the template is a valid one");
        let bar = ProgressBar::with_draw_target(total, target)
            .with_style(style.progress_chars("█▉▊▋▌▍▎▏░"))
            .with_prefix(what.to_owned());
        Self {
            what: what.to_owned(),
            bar,
            next,
        }
    }

    /// Works on every item, a step each, on all threads.
    pub fn each<T: Send, R: Send>(
        what: &str,
        items: Vec<T>,
        work: impl Fn(T) -> R + Sync,
    ) -> Vec<R> {
        let progress = Self::new(what, items.len());
        let items = items.into_par_iter().map(&work);
        items.inspect(|_| progress.step()).collect()
    }

    /// One more step is done.
    pub fn step(&self) {
        self.step_with(String::new);
    }

    /// The same, with more to show.
    pub fn step_with(&self, more: impl FnOnce() -> String) {
        self.bar.inc(1);
        let Some(next) = &self.next else {
            let more = more();
            if !more.is_empty() {
                self.bar.set_message(format!(", {more}"));
            }
            return;
        };
        let now = Instant::now();
        // A thread that finds another at it goes on working.
        let Ok(mut next) = next.try_lock() else {
            return;
        };
        if now < *next {
            return;
        }
        *next = now + TOLD_EVERY;
        let steps = [self.bar.position(), self.bar.length().unwrap_or_default()];
        let line = line(&self.what, steps, self.bar.eta(), &more());
        // That nobody reads it must not end the work.
        let _ = std::io::stderr().write_all(line.as_bytes());
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}

/// The line where there is no terminal: `[done, total]` steps and the time left.
fn line(what: &str, [done, total]: [u64; 2], left: Duration, more: &str) -> String {
    let left = left.as_secs();
    let time = if left >= 3600 {
        format!("{} h {:02} min", left / 3600, left / 60 % 60)
    } else if left >= 60 {
        format!("{} min {:02} s", left / 60, left % 60)
    } else {
        format!("{left} s")
    };
    let comma = if more.is_empty() { "" } else { ", " };
    format!("{what}: {done} of {total}, {time} left{comma}{more}\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_piped_is_a_plain_line() {
        let said = |left| line("fit", [10, 40], Duration::from_secs(left), "");
        assert_eq!(said(180), "fit: 10 of 40, 3 min 00 s left\n");
        assert_eq!(said(3720), "fit: 10 of 40, 1 h 02 min left\n");
        let said = line("record", [3, 9], Duration::ZERO, "1.0 MB");
        assert_eq!(said, "record: 3 of 9, 0 s left, 1.0 MB\n");
    }

    #[test]
    fn steps_of_several_threads_are_all_counted() {
        let progress = Progress::new("fit", 400);
        std::thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| (0..100).for_each(|_| progress.step()));
            }
        });
        assert_eq!(progress.bar.position(), 400);
    }
}
