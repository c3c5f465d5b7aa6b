//! Progress of long work: a bar with the remaining time on a terminal (indicatif), otherwise a line every few seconds
//! on standard error. Short work shows neither.
//!
//! Steps may come from several threads.

use std::io::{IsTerminal, Write};
use std::sync::Mutex;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use rayon::prelude::*;

/// Interval of lines without a terminal, and time to the first.
const LINE_EVERY: Duration = Duration::from_secs(5);
/// Updates a second on a terminal.
const DRAWN_HZ: u8 = 10;
/// indicatif cuts it to the terminal's width.
const BAR: &str = "{prefix} {bar:24} {pos}/{len}, {eta} left{wide_msg}";

/// Progress of one piece of work.
pub struct Progress {
    what: String,
    bar: ProgressBar,
    /// Due time of the next line; `None` on a terminal.
    next: Option<Mutex<Instant>>,
}

impl Progress {
    /// Work of `total` equal steps.
    pub fn new(what: &str, total: usize) -> Self {
        let total = Some(total.max(1) as u64);
        let (target, next) = if std::io::stderr().is_terminal() {
            (ProgressDrawTarget::stderr_with_hz(DRAWN_HZ), None)
        } else {
            let first = Instant::now() + LINE_EVERY;
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

    /// Processes every item, one step each, on all threads.
    pub fn each<T: Send, R: Send>(
        what: &str,
        items: Vec<T>,
        work: impl Fn(T) -> R + Sync,
    ) -> Vec<R> {
        let progress = Self::new(what, items.len());
        let items = items.into_par_iter().map(&work);
        items.inspect(|_| progress.step()).collect()
    }

    /// Reports one finished step.
    pub fn step(&self) {
        self.step_with(String::new);
    }

    /// Reports one finished step with additional text.
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
        // A line is already being written by another thread.
        let Ok(mut next) = next.try_lock() else {
            return;
        };
        if now < *next {
            return;
        }
        *next = now + LINE_EVERY;
        let steps = [self.bar.position(), self.bar.length().unwrap_or_default()];
        let line = line(&self.what, steps, self.bar.eta(), &more());
        // A closed standard error must not end the work.
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
    fn piped_progress_is_plain_lines() {
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
