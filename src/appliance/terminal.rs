//! The output of `mien run` on a terminal: destinations at the start, one live line, and a summary at the end.
//!
//! Unsafe code: the ioctl for the terminal's width.
#![expect(
    unsafe_code,
    reason = "TIOCGWINSZ, the query of a terminal's width, is a foreign function"
)]

use core::fmt::Write as _;
use std::io::{self, IsTerminal};
use std::os::fd::AsRawFd;
use std::time::Duration;

use crate::pipe::Pipe;
use mien_outputs::{Report, TrackingState};
use mien_stages::base::capacity::USERS;
use mien_stages::expression::unit_words;
use mien_stages::face_model::scheme::VISIBLE_REGIONS;

/// Moves to the start of the live line and clears it.
pub(crate) const CLEAR_LINE: &str = "\r\x1b[K";
/// Columns of the narrowest line.
const NARROW: usize = 60;
/// Columns of the widest line.
const WIDE: usize = 160;
/// Bytes of the longest line, with its control sequence.
const LINE: usize = WIDE + CLEAR_LINE.len();
/// Columns if the width is unknown.
const DEFAULT_COLUMNS: usize = 80;
/// Weights below this are not shown.
const MIN_WEIGHT: f32 = 0.15;
/// Regions less seen than this are listed as covered.
const SEEN: f32 = 0.5;
/// Default destination of OSC for `mien-studio preview`, as an output describes it.
const PREVIEW_TARGET: &str = "OSC to 127.0.0.1:9130";
/// Maximum number of units shown per person.
const MAX_UNITS: usize = 8;

/// Columns of the terminal behind a stream.
fn width(stream: &impl AsRawFd) -> usize {
    // A `winsize`: rows, columns, and both in pixels.
    let mut size = [0_u16; 4];
    // SAFETY: TIOCGWINSZ writes one `winsize`, four 16-bit numbers, into `size`, which is not aliased.
    let result = unsafe { libc::ioctl(stream.as_raw_fd(), libc::TIOCGWINSZ, &raw mut size) };
    let columns = usize::from(size[1]);
    let is_known = result == 0 && columns > 0;
    if is_known { columns } else { DEFAULT_COLUMNS }
}

/// A line with a limited number of columns: words that do not fit are omitted.
struct Line {
    text: heapless::String<LINE>,
    columns: usize,
}

impl Line {
    fn new(columns: usize) -> Self {
        let mut text = heapless::String::new();
        let _ = text.push_str(CLEAR_LINE);
        // The last column stays free: some terminals wrap as soon as it is written.
        let columns = columns.clamp(NARROW, WIDE) - 1;
        Self { text, columns }
    }

    /// Adds words if they fit, which is returned.
    fn add(&mut self, words: core::fmt::Arguments<'_>) -> bool {
        let mut piece: heapless::String<48> = heapless::String::new();
        let whole = piece.write_fmt(words).is_ok();
        // ASCII only, so bytes are columns.
        let fits = whole && self.text.len() - CLEAR_LINE.len() + piece.len() <= self.columns;
        fits && self.text.push_str(&piece).is_ok()
    }

    /// Adds the regions of a face that are less than half seen.
    fn add_covered(&mut self, report: &Report<'_>) {
        let regions = VISIBLE_REGIONS
            .iter()
            .zip(report.seen().into_iter().flatten());
        let mut covered = regions.filter(|(_, seen)| *seen < SEEN).peekable();
        let some = covered.peek().is_some();
        for ((name, _), _) in covered {
            let (name, side) = name.split_once('_').unwrap_or((name, ""));
            let space = if side.is_empty() { "" } else { " " };
            self.add(format_args!(" {name}{space}{side}"));
        }
        if some {
            self.add(format_args!(" covered |"));
        }
    }

    /// Adds the strongest units of a face by their plain names; the two sides of a unit, if both are active, are averaged.
    fn add_units(&mut self, names: &[impl AsRef<str>], weights: &[f32]) {
        let mut strong: heapless::Vec<(f32, &str, bool), MAX_UNITS> = heapless::Vec::new();
        let all = || {
            let all = names.iter().map(AsRef::as_ref).zip(weights.iter().copied());
            all.filter(|(_, weight)| *weight >= MIN_WEIGHT)
        };
        for (name, weight) in all() {
            let other = |side: char, other: char| {
                let code = name.strip_suffix(side)?;
                let (_, weight) = all().find(|(name, _)| name.strip_suffix(other) == Some(code))?;
                Some(weight)
            };
            // Both sides are listed with the left one.
            if other('R', 'L').is_some() {
                continue;
            }
            let both = other('L', 'R');
            let weight = both.map_or(weight, |other| 0.5 * (weight + other));
            let index = strong.iter().position(|(other, _, _)| weight > *other);
            let index = index.unwrap_or(strong.len());
            if strong.is_full() && index < strong.len() {
                strong.pop();
            }
            // Fails if the list is full of stronger units.
            let _ = strong.insert(index, (weight.min(9.99), name, both.is_some()));
        }
        for (weight, name, both) in strong {
            let written = match unit_words::find(name) {
                Some((words, side)) if !both && !side.is_empty() => {
                    self.add(format_args!(" {} {side} {weight:.2} ", words.plain))
                }
                Some((words, _)) => self.add(format_args!(" {} {weight:.2} ", words.plain)),
                None => self.add(format_args!(" {name} {weight:.2} ")),
            };
            if !written {
                break;
            }
        }
    }
}

/// The live line: time, then state and strongest units of each person present.
fn line(
    columns: usize,
    reports: &[Report<'_>],
    names: &[impl AsRef<str>],
) -> heapless::String<LINE> {
    let mut line = Line::new(columns);
    let at_us = reports.first().map_or(0, |report| report.at.as_us());
    let (minutes, seconds) = (at_us / 60_000_000, (at_us % 60_000_000) as f64 * 1e-6);
    line.add(format_args!("{minutes:3}:{seconds:04.1} "));
    let known = reports.iter().filter(|report| report.user.is_some());
    let there = known.filter(|report| report.state != TrackingState::Absent);
    let many = there.clone().count();
    if many == 0 {
        line.add(format_args!("nobody in view"));
    }
    let (all, start) = (line.columns, line.text.len() - CLEAR_LINE.len());
    for (k, report) in there.enumerate() {
        // Each person has the same share of the line.
        line.columns = start + (all - start) * (k + 1) / many;
        let state = report.state.name();
        if many == 1 {
            let sure = report.confidence * 100.0;
            line.add(format_args!("{state:8} {sure:3.0}% |"));
        } else {
            let user = report.user.unwrap_or_default() + 1;
            line.add(format_args!("| {user} {state:8}"));
        }
        line.add_covered(report);
        line.add_units(names, report.weights);
    }
    line.text
}

/// Totals of a run, for the summary.
#[derive(Clone, Copy, Debug, Default)]
struct Tally {
    frames: u64,
    people: u64,
    latency_us: u64,
    slowest_us: u32,
    there: [bool; USERS],
}

impl Tally {
    fn count(&mut self, reports: &[Report<'_>]) {
        self.frames += 1;
        let latencies = reports.iter().map(|report| report.latency_us);
        let latency = latencies.max().unwrap_or(0);
        self.latency_us += u64::from(latency);
        self.slowest_us = self.slowest_us.max(latency);
        for report in reports {
            let Some(there) = report.user.and_then(|user| self.there.get_mut(user)) else {
                continue;
            };
            let is_there = report.state != TrackingState::Absent;
            self.people += u64::from(is_there && !*there);
            *there = is_there;
        }
    }

    fn summary(&self, took: Duration) -> String {
        let (frames, seconds) = (self.frames, took.as_secs_f64().max(1e-3));
        let rate = frames as f64 / seconds;
        let latency = self.latency_us as f64 * 1e-3 / frames.max(1) as f64;
        let slowest = f64::from(self.slowest_us) * 1e-3;
        let people = match self.people {
            0 => "nobody".to_owned(),
            1 => "1 person".to_owned(),
            many => format!("{many} people"),
        };
        format!(
            "{frames} frames in {seconds:.1} s ({rate:.1} per second), {people}, latency {latency:.1} ms, at most {slowest:.1} ms"
        )
    }
}

/// The terminal of a run.
pub(super) struct Live {
    out: Pipe,
    shown: bool,
    tally: Tally,
}

impl Live {
    /// The live line, if standard output is a terminal.
    pub(super) fn on_terminal() -> Option<Self> {
        let terminal = Some(io::stdout()).filter(IsTerminal::is_terminal);
        Some(Self {
            out: Pipe::from_stream(terminal?).ok()?,
            shown: false,
            tally: Tally::default(),
        })
    }

    /// Prints the source, the destinations, and what to do next.
    pub(super) fn print_header(&self, source: &str, outputs: &str) {
        let version = env!("CARGO_PKG_VERSION");
        let to = Some(outputs).filter(|all| !all.is_empty());
        let to = to.unwrap_or("nowhere");
        let next = if outputs.is_empty() {
            "enable an output in the configuration (see `mien print-config`), or add --csv FILE; Ctrl-C stops"
        } else if outputs.contains(PREVIEW_TARGET) {
            "`mien-studio preview` shows the face at http://127.0.0.1:9180, `mien send-test` tests a receiver; Ctrl-C stops"
        } else {
            "`mien send-test` moves every shape once to test a receiver; Ctrl-C stops"
        };
        let words = format!("mien {version}: {source}\nsends to: {to}\nnext: {next}\n");
        self.out.try_write(words.as_bytes());
    }

    /// Replaces the line by a frame's reports; never waits for a blocked terminal.
    pub(super) fn update(&mut self, reports: &[Report<'_>], names: &[impl AsRef<str>]) {
        self.tally.count(reports);
        let line = line(width(&io::stdout()), reports, names);
        self.shown |= self.out.try_write(line.as_bytes());
    }

    /// Ends the live line and prints the summary.
    pub(super) fn finish(self, took: Duration) {
        if self.shown {
            self.out.try_write(b"\n");
        }
        let summary = self.tally.summary(took);
        self.out.try_write(format!("{summary}\n").as_bytes());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mien_stages::base::time::Timestamp;
    use mien_stages::landmarks::Landmarks;

    const NAMES: [&str; 4] = ["AU26", "AU12L", "AU12R", "AU2L"];

    fn report(user: usize, weights: &[f32]) -> Report<'_> {
        Report {
            at: Timestamp::from_us(63_250_000),
            user: Some(user),
            state: TrackingState::Tracking,
            confidence: 0.93,
            weights,
            ..Report::default()
        }
    }

    #[test]
    fn the_line_lists_the_strongest_units_first() {
        let weights = [0.5, 0.1, 0.16, 0.8];
        assert_eq!(
            line(80, &[report(0, &weights)], &NAMES).as_str(),
            "\r\x1b[K  1:03.2 tracking  93% | outer brow up L 0.80  jaw drop 0.50  smile R 0.16 "
        );
        let nobody = Report::default();
        assert_eq!(
            line(80, &[nobody], &NAMES).as_str(),
            "\r\x1b[K  0:00.0 nobody in view"
        );
    }

    #[test]
    fn the_line_names_what_is_covered() {
        let landmarks = Landmarks {
            seen: [1.0, 0.3, 1.0, 0.6, 1.0, 0.0],
            ..Landmarks::default()
        };
        let covered = Report {
            landmarks: Some(&landmarks),
            ..report(0, &[0.0, 0.0, 0.0, 0.8])
        };
        assert_eq!(
            line(80, &[covered], &NAMES).as_str(),
            "\r\x1b[K  1:03.2 tracking  93% | brow R mouth covered | outer brow up L 0.80 "
        );
    }

    #[test]
    fn the_line_shows_everybody_and_never_wraps() {
        let names: Vec<String> = (0..40).map(|_| "AU43L".to_owned()).collect();
        let weights = [1.0; 40];
        for columns in [60, 80, 100, 300] {
            for people in 0..=USERS {
                let reports: Vec<Report> = (0..people).map(|user| report(user, &weights)).collect();
                let line = line(columns, &reports, &names);
                assert!(
                    line.len() - CLEAR_LINE.len() < columns,
                    "{columns}: {line:?}"
                );
                for user in (0..people).filter(|_| people > 1) {
                    let part = format!("| {} tracking", user + 1);
                    assert!(columns < 80 || line.contains(&part), "{columns}: {line:?}");
                }
            }
        }
    }

    #[test]
    fn the_summary_counts_people_and_time() {
        let weights = [0.0; 4];
        let mut tally = Tally::default();
        for latency_us in [2000, 6000] {
            let there = Report {
                latency_us,
                ..report(1, &weights)
            };
            tally.count(&[there]);
        }
        tally.count(&[Report::default()]);
        assert_eq!(
            tally.summary(Duration::from_secs(2)),
            "3 frames in 2.0 s (1.5 per second), 1 person, latency 2.7 ms, at most 6.0 ms"
        );
    }
}
