//! Log lines on standard error, one per event, with the journal's priority in front: `<4>message key=value`.
//!
//! A subscriber of our own because the usual one brings formatting, time zones and regular expressions that the box has
//! no use for: journald adds the time, and the unit's file holds the level. On a terminal the priority is left out.

use std::fmt::Write as _;
use std::io::{IsTerminal, Write as _};

use tracing::field::{Field, Visit};
use tracing::span::{Attributes, Id, Record};
use tracing::{Event, Level, Metadata, Subscriber};

/// Longest line; what is beyond is cut, so that a line never allocates without bound.
const LINE: usize = 512;

struct Lines {
    level: Level,
    terminal: bool,
}

/// Starts logging events of at least `level`. A second call changes nothing.
pub fn start(level: Level) {
    let lines = Lines {
        level,
        terminal: std::io::stderr().is_terminal(),
    };
    // Fails only if logging was started before; the first one stays.
    let _ = tracing::subscriber::set_global_default(lines);
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

struct Line(heapless::String<LINE>);

impl Visit for Line {
    fn record_debug(&mut self, field: &Field, value: &dyn std::fmt::Debug) {
        // A full line is cut; there is nobody to report it to.
        let _ = if field.name() == "message" {
            write!(self.0, "{value:?}")
        } else {
            write!(self.0, " {}={value:?}", field.name())
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
        let mut line = Line(heapless::String::new());
        if !self.terminal {
            let _ = write!(line.0, "<{}>", priority(*event.metadata().level()));
        }
        event.record(&mut line);
        // Standard error may be closed; a log line is not worth ending the run for.
        let _ = writeln!(std::io::stderr().lock(), "{}", line.0);
    }

    fn enter(&self, _: &Id) {}

    fn exit(&self, _: &Id) {}
}
