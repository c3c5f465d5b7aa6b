//! Exchange between one source and any number of pages: events are kept in order, and each page reads them at its own
//! pace.
//!
//! A live source keeps the newest [`LIVE_LINES`]; a page that reads too slowly misses the oldest. A session (CSV,
//! recording) keeps up to [`SESSION_LINES`], so that a page that connects later gets all of it. Persistent state
//! (schema, source, ranges) is sent to every new page.

use std::collections::{BTreeMap, VecDeque};
use std::net::IpAddr;
use std::sync::mpsc::SyncSender;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use serde_json::json;

use super::sample::{ranges_json, sample_json};
use mien_outputs::gesture::SetUpFacts;
use mien_outputs::received::{Receive, Sample, UnitRange};
use mien_stages::camera::Camera;
use mien_stages::expression::unit_words;

/// Most kept events of a live source: some ten seconds of four users.
const LIVE_LINES: usize = 1200;
/// Most kept events of a session: three hours of one user, about 150 MB.
const SESSION_LINES: usize = 330_000;
/// Most events handed to a page at once.
const BATCH: usize = 256;

/// Images of one frame.
#[derive(Clone)]
pub struct Seen {
    /// Bayer mosaic of the colour image, if there is one.
    pub colour: Option<Arc<[u8]>>,
    /// Raw depth.
    pub depth: Arc<[u16]>,
    /// Its camera.
    pub camera: Arc<Camera>,
}

/// Number and images of a frame.
pub type Picture = (u64, Seen);

/// Data forwarded to other receivers.
pub enum Passed {
    /// Names of the units in the order of the weights.
    Units(Vec<String>),
    /// A frame of a user.
    Sample(Sample),
}

#[derive(Default)]
struct State {
    lines: VecDeque<Arc<str>>,
    /// Number of the first kept line.
    first: u64,
    facts: BTreeMap<String, Arc<str>>,
    picture: Option<Picture>,
    note: String,
    counts: Counts,
    /// Channel for forwarding a live source.
    onward: Option<SyncSender<Passed>>,
    /// Host that streams over the network.
    sender: Option<IpAddr>,
}

/// The exchange.
pub struct Hub {
    state: Mutex<State>,
    changed: Condvar,
    keep: usize,
}

/// Counts of received and refused messages.
#[derive(Clone, Copy, Default)]
pub struct Counts {
    /// Valid messages.
    pub received: u64,
    /// Invalid messages, lines or requests.
    pub refused: u64,
}

impl Hub {
    /// For a session, which is kept whole, or a live source.
    pub fn new(session: bool) -> Self {
        Self {
            state: Mutex::default(),
            changed: Condvar::new(),
            keep: if session { SESSION_LINES } else { LIVE_LINES },
        }
    }

    /// Whether it is a session, kept whole.
    pub fn is_session(&self) -> bool {
        self.keep == SESSION_LINES
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        // State is consistent even if a thread panicked.
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

    /// An event that stays valid until replaced under the same key.
    pub fn fact(&self, event: &str, key: &str, json: &str) {
        let line: Arc<str> = format!("event: {event}\ndata: {json}\n\n").into();
        let mut state = self.lock();
        if state.facts.get(key) != Some(&line) {
            state.facts.insert(key.to_owned(), Arc::clone(&line));
            self.push(&mut state, line);
        }
    }

    /// Forwards future data; only of a live source, as a session is read faster than real time.
    pub fn pass_on_to(&self, onward: SyncSender<Passed>) {
        if !self.is_session() {
            self.lock().onward = Some(onward);
        }
    }

    /// Sets the streaming host.
    pub fn set_sender(&self, host: IpAddr) {
        self.lock().sender = Some(host);
    }

    /// The streaming host, once a valid message arrived.
    pub fn sender(&self) -> Option<IpAddr> {
        self.lock().sender
    }

    /// Sets the state of the source, in words, which is sent with the counts.
    pub fn note(&self, note: &str) {
        note.clone_into(&mut self.lock().note);
    }

    /// The counts so far.
    pub fn counts(&self) -> Counts {
        self.lock().counts
    }

    /// Counts and state as an event.
    pub fn counts_event(&self) -> String {
        let state = self.lock();
        let Counts { received, refused } = state.counts;
        let json = json!({"received": received, "refused": refused, "note": state.note});
        format!("event: count\ndata: {json}\n\n")
    }

    /// Sets the newest images.
    pub fn show(&self, picture: Picture) {
        self.lock().picture = Some(picture);
    }

    /// The newest images, if any.
    pub fn picture(&self) -> Option<Picture> {
        self.lock().picture.clone()
    }

    /// Initial events of a new page, and the number to continue from: a session from its start, a live source from
    /// now.
    pub fn start(&self) -> (Vec<Arc<str>>, u64) {
        let state = self.lock();
        let (session, count) = (self.is_session(), state.lines.len() as u64);
        let next = state.first + if session { 0 } else { count };
        (state.facts.values().cloned().collect(), next)
    }

    /// Events from number `next` on, and the number after them; waits at most `time` for the first.
    pub fn read(&self, next: u64, time: Duration) -> (Vec<Arc<str>>, u64) {
        let has = |state: &State| next < state.first + state.lines.len() as u64;
        let (lock, changed) = (self.lock(), &self.changed);
        let waited = changed.wait_timeout_while(lock, time, |state| !has(state));
        let state = waited.unwrap_or_else(PoisonError::into_inner).0;
        // Older events were dropped.
        let next = next.max(state.first);
        let from = (next - state.first) as usize;
        let lines: Vec<_> = state.lines.iter().skip(from).take(BATCH).cloned().collect();
        let after = next + lines.len() as u64;
        (lines, after)
    }
}

impl Receive for Hub {
    /// Also announces a change.
    fn schema(&self, names: &[String]) {
        if let Some(onward) = &self.lock().onward {
            let _ = onward.try_send(Passed::Units(names.to_vec()));
        }
        self.fact("schema", "schema", &json!(names).to_string());
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        let regions = unit_words::regions_json(&names).to_string();
        // Keyed to follow the schema for later pages as well.
        self.fact("regions", "schema regions", &regions);
    }

    fn sample(&self, sample: &Sample) {
        let line = format!("data: {}\n\n", sample_json(sample));
        let mut state = self.lock();
        if let Some(onward) = &state.onward {
            // A slow receiver misses frames; nothing waits for it.
            let _ = onward.try_send(Passed::Sample(sample.clone()));
        }
        self.push(&mut state, line.into());
    }

    fn ranges(&self, slot: usize, ranges: &[Option<UnitRange>]) {
        let json = ranges_json(slot, ranges);
        self.fact("ranges", &format!("ranges {slot}"), &json);
    }

    fn gesture(&self, name: &str, slot: Option<usize>, is_on: bool) {
        let json = json!({"name": name, "u": slot, "on": is_on}).to_string();
        self.fact("gesture", &format!("gesture {name} {slot:?}"), &json);
    }

    fn set_up(&self, name: &str, facts: &SetUpFacts) {
        let json = format!("{{\"name\":{},{facts}}}", json!(name));
        self.fact("setup", &format!("setup {name}"), &json);
    }

    fn count(&self, taken: u64, refused: u64) {
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
    fn slow_readers_continue_with_the_kept_events() {
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
