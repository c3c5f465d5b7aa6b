//! Between one source and any number of pages: events are kept in order, and each page reads them at its own pace.
//!
//! A live source keeps the newest [`LIVE_LINES`]; a page that reads too slowly misses the oldest. A session (CSV, recording)
//! keeps everything, up to [`SESSION_LINES`], so that a page that connects later gets all of it. State that holds until it is
//! replaced (schema, source, ranges) is sent to every new page.

use std::collections::{BTreeMap, VecDeque};
use std::net::IpAddr;
use std::sync::mpsc::SyncSender;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use serde_json::json;

use super::sample::{Sample, UnitRange, ranges_json};
use mien_stages::expression::unit_words;

/// Events of a live source that wait for pages at most: some ten seconds of four users.
const LIVE_LINES: usize = 1200;
/// Events of a session at most: three hours of one user, about 150 MB.
const SESSION_LINES: usize = 330_000;
/// Events handed to a page at once.
const BATCH: usize = 256;

/// What the sensor saw in a frame.
#[derive(Clone)]
pub struct Seen {
    /// Bayer mosaic of the colour picture, if there is one.
    pub colour: Option<Arc<[u8]>>,
    /// Raw depth.
    pub depth: Arc<[u16]>,
}

/// A picture of the sensor and the number of its frame.
pub type Picture = (u64, Seen);

/// What is passed on to other receivers as it comes.
pub enum Passed {
    /// Names of the units in the order of the weights.
    Units(Vec<String>),
    /// A frame of a user.
    Sample(Sample),
}

#[derive(Default)]
struct State {
    lines: VecDeque<Arc<str>>,
    /// Number of the first line that is kept.
    first: u64,
    facts: BTreeMap<String, Arc<str>>,
    picture: Option<Picture>,
    note: String,
    counts: Counts,
    /// Where a live source is passed on to, beside the pages.
    onward: Option<SyncSender<Passed>>,
    /// Which host sends what is received over a network.
    sender: Option<IpAddr>,
}

/// The exchange.
pub struct Hub {
    state: Mutex<State>,
    changed: Condvar,
    keep: usize,
}

/// What was received and refused so far.
#[derive(Clone, Copy, Default)]
pub struct Counts {
    /// Messages that were understood.
    pub received: u64,
    /// Messages, lines or requests that were not.
    pub refused: u64,
}

impl Hub {
    /// For a session that is kept whole, or a live source.
    pub fn new(session: bool) -> Self {
        Self {
            state: Mutex::default(),
            changed: Condvar::new(),
            keep: if session { SESSION_LINES } else { LIVE_LINES },
        }
    }

    /// Whether everything is kept.
    pub fn is_session(&self) -> bool {
        self.keep == SESSION_LINES
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        // Nothing is left half done by a thread that died.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn push(&self, state: &mut State, line: Arc<str>) {
        if state.lines.len() == self.keep {
            state.lines.pop_front();
            state.first += 1;
        }
        state.lines.push_back(line);
        self.changed.notify_all();
    }

    /// Something that holds until it is told anew under the same key.
    pub fn fact(&self, event: &str, key: &str, json: &str) {
        let line: Arc<str> = format!("event: {event}\ndata: {json}\n\n").into();
        let mut state = self.lock();
        if state.facts.get(key) != Some(&line) {
            state.facts.insert(key.to_owned(), Arc::clone(&line));
            self.push(&mut state, line);
        }
    }

    /// Passes on what comes from now on; of a live source only, as a session is read faster than it happened.
    pub fn pass_on_to(&self, onward: SyncSender<Passed>) {
        if !self.is_session() {
            self.lock().onward = Some(onward);
        }
    }

    /// Which host sends.
    pub fn set_sender(&self, host: IpAddr) {
        self.lock().sender = Some(host);
    }

    /// Which host sends, once something was understood.
    pub fn sender(&self) -> Option<IpAddr> {
        self.lock().sender
    }

    /// How the source is doing, in words; told to pages with the counts.
    pub fn note(&self, note: &str) {
        let mut state = self.lock();
        if state.note != note {
            note.clone_into(&mut state.note);
        }
    }

    /// What was counted so far.
    pub fn counts(&self) -> Counts {
        self.lock().counts
    }

    /// Counts and note as an event.
    pub fn counts_event(&self) -> String {
        let state = self.lock();
        let Counts { received, refused } = state.counts;
        let json = json!({"received": received, "refused": refused, "note": state.note});
        format!("event: count\ndata: {json}\n\n")
    }

    /// The newest picture of the sensor.
    pub fn show(&self, picture: Picture) {
        self.lock().picture = Some(picture);
    }

    /// The newest picture of the sensor, if it shows any.
    pub fn picture(&self) -> Option<Picture> {
        self.lock().picture.clone()
    }

    /// What a page that comes now is told first, and where it then reads on: a session from its start, a live source from now.
    pub fn start(&self) -> (Vec<Arc<str>>, u64) {
        let state = self.lock();
        let next = if self.is_session() {
            state.first
        } else {
            state.first + state.lines.len() as u64
        };
        (state.facts.values().cloned().collect(), next)
    }

    /// Events from number `next` on, and the number after them; waits at most `time` for the first.
    pub fn read(&self, next: u64, time: Duration) -> (Vec<Arc<str>>, u64) {
        let has = |state: &State| next < state.first + state.lines.len() as u64;
        let waited = self
            .changed
            .wait_timeout_while(self.lock(), time, |state| !has(state));
        let state = waited.unwrap_or_else(PoisonError::into_inner).0;
        // What is older is gone.
        let next = next.max(state.first);
        let from = (next - state.first) as usize;
        let lines: Vec<_> = state.lines.iter().skip(from).take(BATCH).cloned().collect();
        let after = next + lines.len() as u64;
        (lines, after)
    }

    /// The names of the units, in the order of the weights, when they change.
    pub fn schema(&self, names: &[String]) {
        if let Some(onward) = &self.lock().onward {
            let _ = onward.try_send(Passed::Units(names.to_vec()));
        }
        self.fact("schema", "schema", &json!(names).to_string());
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        let regions = unit_words::regions_json(&names).to_string();
        // Behind the schema for pages that come later, too.
        self.fact("regions", "schema regions", &regions);
    }

    /// A user at a frame.
    pub fn sample(&self, sample: &Sample) {
        let line = format!("data: {}\n\n", sample.json());
        let mut state = self.lock();
        if let Some(onward) = &state.onward {
            // A receiver that is too slow misses frames; nothing waits for it.
            let _ = onward.try_send(Passed::Sample(sample.clone()));
        }
        self.push(&mut state, line.into());
    }

    /// A user's ranges, in schema order; `None` where nothing was received.
    pub fn ranges(&self, slot: usize, ranges: &[Option<UnitRange>]) {
        let json = ranges_json(slot, ranges);
        self.fact("ranges", &format!("ranges {slot}"), &json);
    }

    /// A gesture is on or off, of a person or of whoever counts; told again and again.
    pub fn gesture(&self, name: &str, slot: Option<usize>, is_on: bool) {
        let json = json!({"name": name, "u": slot, "on": is_on}).to_string();
        self.fact("gesture", &format!("gesture {name} {slot:?}"), &json);
    }

    /// Counts messages, lines or frames accepted and refused.
    pub fn count(&self, taken: u64, refused: u64) {
        let counts = &mut self.lock().counts;
        counts.received += taken;
        counts.refused += refused;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(number: u64) -> Sample {
        Sample {
            number,
            ..Sample::default()
        }
    }

    #[test]
    fn a_session_is_whole_for_whoever_comes_late_and_a_live_source_is_not() {
        for session in [true, false] {
            let hub = Hub::new(session);
            hub.schema(&["AU26".into()]);
            (0..5).for_each(|n| hub.sample(&sample(n)));
            let (facts, next) = hub.start();
            assert_eq!(&*facts[0], "event: schema\ndata: [\"AU26\"]\n\n");
            let (lines, after) = hub.read(next, Duration::ZERO);
            // The schema brings its regions.
            assert_eq!(lines.len(), if session { 7 } else { 0 });
            hub.sample(&sample(9));
            let (lines, _) = hub.read(after, Duration::ZERO);
            assert!(lines.len() == 1 && lines[0].contains("\"n\":9"));
        }
    }

    #[test]
    fn who_reads_too_slowly_goes_on_with_what_is_left() {
        let hub = Hub::new(false);
        (0..2 * LIVE_LINES as u64).for_each(|n| hub.sample(&sample(n)));
        let (lines, after) = hub.read(3, Duration::ZERO);
        assert!(lines[0].contains(&format!("\"n\":{LIVE_LINES},")));
        assert_eq!((lines.len(), after), (BATCH, (LIVE_LINES + BATCH) as u64));
    }

    #[test]
    fn facts_are_told_once_and_then_only_when_they_change() {
        let hub = Hub::new(false);
        let next = hub.start().1;
        for low in [0.1, 0.1, 0.2] {
            hub.ranges(0, &[Some(([low, 0.5, 0.9], None))]);
        }
        assert_eq!(hub.read(next, Duration::ZERO).0.len(), 2);
        assert_eq!(hub.start().0.len(), 1);
    }
}
