//! Log lines on standard error, one per event, with the journal's priority in front: `<4>message key=value`.
//!
//! It has its own subscriber because the usual one brings formatting, time zones and regular expressions that the box does not
//! need: journald adds the time, and the configuration holds the level. On a terminal the priority is omitted.
//!
//! Logging never blocks: a line for which there is no room is dropped, and the next one says how many were. External text
//! (names of devices and files) cannot end a line or move a terminal's cursor.

use std::fmt::{Display, Write as _};
use std::io::{IsTerminal, stderr};
use std::sync::atomic::{AtomicU32, Ordering};

use tracing::field::{Field, Visit};
use tracing::span::{Attributes, Id, Record};
use tracing::{Event, Level, Metadata, Subscriber};

use crate::appliance::pipe::Pipe;
use crate::appliance::terminal::OVER;

/// Longest line; longer ones are truncated, so that a line's memory is bounded.
const LINE: usize = 512;

struct Lines {
    level: Level,
    terminal: bool,
    /// `None` if standard error is closed.
    error: Option<Pipe>,
    /// Lines dropped since the last one.
    left_out: AtomicU32,
}

/// Starts logging events of at least `level`. A second call changes nothing.
pub fn start(level: Level) {
    let lines = Lines {
        level,
        terminal: stderr().is_terminal(),
        error: Pipe::of(stderr()).ok(),
        left_out: AtomicU32::new(0),
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

/// Priority of syslog (RFC 5424) that the journal reads from `<n>`.
fn priority(level: Level) -> u8 {
    match level {
        Level::ERROR => 3,
        Level::WARN => 4,
        Level::INFO => 6,
        _ => 7,
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
        let mut pushed = text.chars().map(|c| self.0.push(plain(c)));
        pushed
            .all(|pushed| pushed.is_ok())
            .then_some(())
            .ok_or(std::fmt::Error)
    }
}

/// Formats anything as a single line.
pub(crate) struct Plain<T>(pub(crate) T);

impl<T: Display> Display for Plain<T> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        struct Through<'a, 'b>(&'a mut std::fmt::Formatter<'b>);
        impl std::fmt::Write for Through<'_, '_> {
            fn write_str(&mut self, text: &str) -> std::fmt::Result {
                text.chars().try_for_each(|c| self.0.write_char(plain(c)))
            }
        }
        write!(Through(f), "{}", self.0)
    }
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
        let mut line = Line::default();
        if self.terminal {
            // Over the live line, which comes back below.
            let _ = line.0.push_str(OVER);
        } else {
            let _ = write!(line, "<{}>", priority(*event.metadata().level()));
        }
        let left_out = self.left_out.load(Ordering::Relaxed);
        if left_out > 0 {
            let _ = write!(line, "({left_out} lines left out) ");
        }
        event.record(&mut line);
        if error.offer(line.ended()) {
            self.left_out.fetch_sub(left_out, Ordering::Relaxed);
        } else {
            self.left_out.fetch_add(1, Ordering::Relaxed);
        }
    }

    fn enter(&self, _: &Id) {}

    fn exit(&self, _: &Id) {}
}
