//! Log lines on standard error, one per event, `message key=value`; under a service manager with the journal's priority in
//! front: `<4>message`.
//!
//! It has its own subscriber because the usual one brings unneeded formatting, time zones and regular expressions: journald adds
//! the time, and the configuration holds the level.
//!
//! Logging never blocks: a line without room is dropped, and the next one gives the number dropped. Control characters in
//! external text (names of devices and files) are replaced. Each call site writes [`BURST`] lines at once, then one a minute
//! with the number omitted, so that repeated events cannot fill the log.

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
use crate::terminal::CLEAR_LINE;
use mien_outputs::limits::TokenBucket;

/// Longest line, bytes; longer ones are truncated.
const LINE: usize = 512;

/// Lines that a call site may write at once.
const BURST: u32 = 8;
/// Time after which a call site may write one more line.
const REFILL: Duration = Duration::from_secs(60);
/// Call sites limited separately; later ones share the last limit.
const CALL_SITES: usize = 64;
/// Targets without a limit: their lines are the result of a command.
const UNBOUNDED: [&str; 1] = ["mien_appliance::send_test"];

/// Limit and number of omitted lines of each call site; once full, further sites share the last entry.
struct Limits<Site>(heapless::Vec<(Site, TokenBucket, u32), CALL_SITES>);

impl<Site: PartialEq> Limits<Site> {
    /// The number of lines omitted since the site's last one; `None` if it may not write now.
    fn admit(&mut self, site: Site, now: Instant) -> Option<u32> {
        let found = self.0.iter().position(|known| known.0 == site);
        let found = found.unwrap_or_else(|| {
            let _ = self.0.push((site, TokenBucket::new(BURST, REFILL, now), 0));
            self.0.len() - 1
        });
        let (_, allowance, omitted) = &mut self.0[found];
        if allowance.take(now) {
            return Some(std::mem::take(omitted));
        }
        *omitted = omitted.saturating_add(1);
        None
    }
}

struct Lines {
    level: Level,
    terminal: bool,
    journal: bool,
    /// `None` if standard error is closed.
    error: Option<Pipe>,
    /// Lines dropped for lack of room since the last one written.
    omitted: AtomicU32,
    limits: Mutex<Limits<Identifier>>,
}

/// Starts logging events of at least `level`. A second call changes nothing.
pub fn start(level: Level) {
    let lines = Lines {
        level,
        terminal: stderr().is_terminal(),
        // systemd.exec(5)
        journal: std::env::var_os("JOURNAL_STREAM").is_some(),
        error: Pipe::from_stream(stderr()).ok(),
        omitted: AtomicU32::new(0),
        limits: Mutex::new(Limits(heapless::Vec::new())),
    };
    // Fails only if logging was started before.
    let _ = tracing::subscriber::set_global_default(lines);
}

/// Prints a program's final message to standard error.
pub fn say(words: impl Display) {
    let mut line = Line::default();
    // Truncates.
    let _ = write!(line, "{words}");
    if let Ok(error) = Pipe::from_stream(stderr()) {
        error.write_with_timeout(line.ended());
    }
}

#[derive(Default)]
struct Line(heapless::String<LINE>);

impl Line {
    /// The line's bytes with a final newline.
    fn ended(&mut self) -> &[u8] {
        while self.0.push('\n').is_err() {
            self.0.pop();
        }
        self.0.as_bytes()
    }
}

/// Replaces a control character, which could end a line or move a terminal's cursor.
fn plain(c: char) -> char {
    if c.is_control() { '?' } else { c }
}

impl std::fmt::Write for Line {
    fn write_str(&mut self, text: &str) -> std::fmt::Result {
        let mut plain = text.chars().map(plain);
        plain.try_for_each(|c| self.0.push(c).map_err(|_| std::fmt::Error))
    }
}

/// Text as a single line, without control characters.
pub(crate) fn one_line(words: impl Display) -> String {
    words.to_string().chars().map(plain).collect()
}

impl Visit for Line {
    fn record_debug(&mut self, field: &Field, value: &dyn std::fmt::Debug) {
        // Truncates.
        let _ = match field.name() {
            "message" => write!(self, "{value:?}"),
            name => write!(self, " {name}={value:?}"),
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
        let mut alike_omitted = Some(0);
        if !UNBOUNDED.contains(&metadata.target()) {
            // Locked for one search of a short list.
            let mut limits = self.limits.lock().unwrap_or_else(PoisonError::into_inner);
            alike_omitted = limits.admit(metadata.callsite(), Instant::now());
        }
        let Some(alike_omitted) = alike_omitted else {
            return;
        };
        let mut line = Line::default();
        if self.terminal {
            // Overwrites the live line, which is redrawn below.
            let _ = line.0.push_str(CLEAR_LINE);
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
        let omitted = self.omitted.load(Ordering::Relaxed);
        if omitted > 0 {
            let _ = write!(line, "({omitted} lines omitted) ");
        }
        event.record(&mut line);
        if alike_omitted > 0 {
            let _ = write!(line, " ({alike_omitted} more like this omitted)");
        }
        if error.try_write(line.ended()) {
            self.omitted.fetch_sub(omitted, Ordering::Relaxed);
        } else {
            self.omitted.fetch_add(1, Ordering::Relaxed);
        }
    }

    fn enter(&self, _: &Id) {}

    fn exit(&self, _: &Id) {}
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn repeated_events_are_limited() {
        let (start, mut limits) = (Instant::now(), Limits(heapless::Vec::new()));
        // 1 kHz for ten minutes, from one site and from more sites than have a limit.
        for sites in [1, 2 * CALL_SITES] {
            let (mut written, mut omitted) = (0, 0);
            for millisecond in 0..600_000_u64 {
                let site = millisecond as usize % sites;
                if let Some(before) = limits.admit(site, start + Duration::from_millis(millisecond))
                {
                    written += 1;
                    omitted += before;
                }
            }
            let most = sites.min(CALL_SITES) as u32 * (BURST + 10);
            assert!(written <= most && written >= BURST, "{sites}: {written}");
            assert!(omitted + written > 600_000 * 8 / 10, "{omitted}");
        }
    }

    #[test]
    fn a_silent_call_site_regains_its_burst() {
        let (start, mut limits) = (Instant::now(), Limits(heapless::Vec::new()));
        let mut at = |seconds| limits.admit("broker", start + Duration::from_secs(seconds));
        let first: Vec<_> = (0..10).map(&mut at).collect();
        assert_eq!(first[..8], [Some(0); 8]);
        assert_eq!(first[8..], [None, None]);
        assert_eq!((at(70), at(71)), (Some(2), None));
        assert_eq!((at(1000), at(1001), at(1002)), (Some(1), Some(0), Some(0)));
    }
}
