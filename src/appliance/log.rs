//! Log lines on standard error, one per event, `message key=value`; under a service manager with the journal's priority in
//! front: `<4>message`.
//!
//! It has its own subscriber because the usual one brings formatting, time zones and regular expressions that the box does not
//! need: journald adds the time, and the configuration holds the level.
//!
//! Logging never blocks: a line for which there is no room is dropped, and the next one says how many were. External text
//! (names of devices and files) cannot end a line or move a terminal's cursor. What happens over and over cannot fill the log:
//! each place in the program writes [`BURST`] lines at once, then one a minute, which says how many like it were left out.

use std::fmt::{Display, Write as _};
use std::io::{IsTerminal, stderr};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use tracing::callsite::Identifier;
use tracing::field::{Field, Visit};
use tracing::span::{Attributes, Id, Record};
use tracing::{Event, Level, Metadata, Subscriber};

use crate::pipe::Pipe;
use crate::terminal::OVER;
use mien_outputs::limits::TokenBucket;

/// Longest line; longer ones are truncated, so that a line's memory is bounded.
const LINE: usize = 512;

/// Lines that one place in the program may write at once.
const BURST: u32 = 8;
/// Time after which it may write one more.
const REFILL: Duration = Duration::from_secs(60);
/// Places that are told apart; the rest are one.
const PLACES: usize = 64;
/// Those that write without bound: a person asked for each line, on a terminal.
const UNBOUNDED: [&str; 1] = ["mien_appliance::send_test"];

/// What each place in the program may still write, and how many of its lines were left out; those that came when it was full
/// share the last one.
struct Limits<Place>(heapless::Vec<(Place, TokenBucket, u32), PLACES>);

impl<Place: PartialEq> Limits<Place> {
    /// Whether the place may write now: `Some` with how many like it were left out.
    fn admit(&mut self, place: Place, now: Instant) -> Option<u32> {
        let found = self.0.iter().position(|known| known.0 == place);
        let found = found.unwrap_or_else(|| {
            let _ = self
                .0
                .push((place, TokenBucket::new(BURST, REFILL, now), 0));
            self.0.len() - 1
        });
        let (_, allowance, left_out) = &mut self.0[found];
        if allowance.take(now) {
            return Some(std::mem::take(left_out));
        }
        *left_out = left_out.saturating_add(1);
        None
    }
}

struct Lines {
    level: Level,
    terminal: bool,
    journal: bool,
    /// `None` if standard error is closed.
    error: Option<Pipe>,
    /// Lines dropped since the last one.
    left_out: AtomicU32,
    limits: Mutex<Limits<Identifier>>,
}

/// Starts logging events of at least `level`. A second call changes nothing.
pub fn start(level: Level) {
    let lines = Lines {
        level,
        terminal: stderr().is_terminal(),
        // systemd.exec(5)
        journal: std::env::var_os("JOURNAL_STREAM").is_some(),
        error: Pipe::of(stderr()).ok(),
        left_out: AtomicU32::new(0),
        limits: Mutex::new(Limits(heapless::Vec::new())),
    };
    // Fails only if logging was started before; the first one stays.
    let _ = tracing::subscriber::set_global_default(lines);
}

/// Prints a program's final message to standard error.
pub fn say(words: impl Display) {
    let mut line = Line::default();
    // A full line is cut.
    let _ = write!(line, "{words}");
    if let Ok(error) = Pipe::of(stderr()) {
        error.insist(line.ended());
    }
}

#[derive(Default)]
struct Line(heapless::String<LINE>);

impl Line {
    /// With its end.
    fn ended(&mut self) -> &[u8] {
        while self.0.push('\n').is_err() {
            self.0.pop();
        }
        self.0.as_bytes()
    }
}

/// A character that neither ends a line nor moves a terminal's cursor.
fn plain(c: char) -> char {
    if c.is_control() { '?' } else { c }
}

impl std::fmt::Write for Line {
    fn write_str(&mut self, text: &str) -> std::fmt::Result {
        let mut plain = text.chars().map(plain);
        plain.try_for_each(|c| self.0.push(c).map_err(|_| std::fmt::Error))
    }
}

/// Anything as a single line.
pub(crate) fn one_line(words: impl Display) -> String {
    words.to_string().chars().map(plain).collect()
}

impl Visit for Line {
    fn record_debug(&mut self, field: &Field, value: &dyn std::fmt::Debug) {
        // A full line is cut; there is nobody to report it to.
        let _ = if field.name() == "message" {
            write!(self, "{value:?}")
        } else {
            write!(self, " {}={value:?}", field.name())
        };
    }
}

impl Subscriber for Lines {
    fn enabled(&self, metadata: &Metadata<'_>) -> bool {
        *metadata.level() <= self.level
    }

    fn new_span(&self, _: &Attributes<'_>) -> Id {
        Id::from_u64(1)
    }

    fn record(&self, _: &Id, _: &Record<'_>) {}

    fn record_follows_from(&self, _: &Id, _: &Id) {}

    fn event(&self, event: &Event<'_>) {
        let Some(error) = &self.error else { return };
        let metadata = event.metadata();
        let mut alike = Some(0);
        if !UNBOUNDED.contains(&metadata.target()) {
            // Held for a look at a short list.
            let mut limits = self.limits.lock().unwrap_or_else(PoisonError::into_inner);
            alike = limits.admit(metadata.callsite(), Instant::now());
        }
        let Some(alike) = alike else { return };
        let mut line = Line::default();
        if self.terminal {
            // Over the live line, which comes back below.
            let _ = line.0.push_str(OVER);
        } else if self.journal {
            // Priority of syslog (RFC 5424).
            let priority = match *metadata.level() {
                Level::ERROR => 3,
                Level::WARN => 4,
                Level::INFO => 6,
                _ => 7,
            };
            let _ = write!(line, "<{priority}>");
        }
        let left_out = self.left_out.load(Ordering::Relaxed);
        if left_out > 0 {
            let _ = write!(line, "({left_out} lines omitted) ");
        }
        event.record(&mut line);
        if alike > 0 {
            let _ = write!(line, " ({alike} more like this omitted)");
        }
        if error.offer(line.ended()) {
            self.left_out.fetch_sub(left_out, Ordering::Relaxed);
        } else {
            self.left_out.fetch_add(1, Ordering::Relaxed);
        }
    }

    fn enter(&self, _: &Id) {}

    fn exit(&self, _: &Id) {}
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_happens_over_and_over_fills_no_log() {
        let (start, mut limits) = (Instant::now(), Limits(heapless::Vec::new()));
        // A thousand times a second for ten minutes, from more places than are told apart.
        for places in [1, 2 * PLACES] {
            let (mut written, mut left_out) = (0, 0);
            for millisecond in 0..600_000_u64 {
                let place = millisecond as usize % places;
                if let Some(before) =
                    limits.admit(place, start + Duration::from_millis(millisecond))
                {
                    written += 1;
                    left_out += before;
                }
            }
            let most = places.min(PLACES) as u32 * (BURST + 10);
            assert!(written <= most && written >= BURST, "{places}: {written}");
            assert!(left_out + written > 600_000 * 8 / 10, "{left_out}");
        }
    }

    #[test]
    fn a_place_that_is_silent_for_a_while_may_write_at_once_again() {
        let (start, mut limits) = (Instant::now(), Limits(heapless::Vec::new()));
        let mut at = |seconds| limits.admit("broker", start + Duration::from_secs(seconds));
        let first: Vec<_> = (0..10).map(&mut at).collect();
        assert_eq!(first[..8], [Some(0); 8]);
        assert_eq!(first[8..], [None, None]);
        assert_eq!((at(70), at(71)), (Some(2), None));
        assert_eq!((at(1000), at(1001), at(1002)), (Some(1), Some(0), Some(0)));
    }
}
