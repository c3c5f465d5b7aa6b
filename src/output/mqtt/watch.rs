//! What is told the broker: the users' states since the start, and messages about them.

use std::fmt::Write as _;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use crate::base::capacity::USERS;
use crate::base::json::Quoted;
use crate::output::TrackingState;
use crate::output::board::{Board, Shared, Weight, count};

/// Changes that may wait for a broker.
const QUEUE: usize = 64;
/// A sensor without frames for this long is reported as gone.
const NO_FRAMES: Duration = Duration::from_secs(2);

/// A change that must reach the broker.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Change {
    Faces(usize),
    /// Of a gesture, whether it is on.
    Gesture(usize, bool),
    State {
        slot: usize,
        state: TrackingState,
        changes: u32,
        at_us: u64,
    },
}

/// A message being written; both are allocated once.
pub(super) struct Draft {
    pub(super) topic: String,
    pub(super) payload: String,
}

impl Draft {
    /// Starts anew: the topic below `base`.
    pub(super) fn about(&mut self, base: &str, topic: std::fmt::Arguments) {
        self.topic.clear();
        self.payload.clear();
        // A string takes everything.
        let _ = write!(self.topic, "{base}/{topic}");
    }

    /// Adds to the payload.
    pub(super) fn say(&mut self, words: std::fmt::Arguments) {
        let _ = self.payload.write_fmt(words);
    }
}

/// State of the users since the start.
pub(super) struct Watch {
    board: Board,
    /// Names of the units as keys, with a colon.
    units: Box<[String]>,
    gestures: Box<[String]>,
    /// Gestures that are on, a bit each.
    on: u32,
    states: [TrackingState; USERS],
    changes: [u32; USERS],
    faces: usize,
    pub(super) queue: heapless::Deque<Change, QUEUE>,
    /// The newest frame and when it came.
    frame: (u64, Instant),
    /// Frames and time at the last health message.
    told: (u64, Instant),
    start: Instant,
}

impl Watch {
    pub(super) fn new(units: &[String], gestures: &[String]) -> Self {
        let now = Instant::now();
        Self {
            board: Board::default(),
            units: units
                .iter()
                .map(|unit| format!("{}:", Quoted(unit)))
                .collect(),
            gestures: gestures.into(),
            on: 0,
            states: Default::default(),
            changes: [0; USERS],
            faces: 0,
            queue: heapless::Deque::new(),
            frame: (0, now),
            told: (0, now),
            start: now,
        }
    }

    /// Writes a change.
    pub(super) fn write(&self, change: Change, base: &str, draft: &mut Draft) {
        match change {
            Change::Faces(faces) => {
                draft.about(base, format_args!("faces"));
                draft.say(format_args!("{faces}"));
            }
            Change::Gesture(gesture, is_on) => {
                draft.about(base, format_args!("gesture/{}", self.gestures[gesture]));
                draft.say(format_args!("{}", if is_on { "ON" } else { "OFF" }));
            }
            Change::State {
                slot,
                state,
                changes,
                at_us,
            } => {
                draft.about(base, format_args!("{slot}/state"));
                draft.say(format_args!(
                    "{{\"state\":\"{}\",\"present\":{},\"changes\":{changes},\"time_us\":{at_us}}}",
                    state.name(),
                    state.is_present()
                ));
            }
        }
    }

    /// Queues a change; the oldest makes room.
    fn push(&mut self, change: Change, shared: &Shared) {
        if self.queue.is_full() {
            self.queue.pop_front();
            count(&shared.dropped);
        }
        // There is room now.
        let _ = self.queue.push_back(change);
    }

    fn state(&self, slot: usize) -> Change {
        Change::State {
            slot,
            state: self.states[slot],
            changes: self.changes[slot],
            at_us: self.board.users[slot].at_us,
        }
    }

    /// Queues everything again for a new connection: what the broker keeps of us may be older than what it missed. The number
    /// of faces comes first.
    pub(super) fn recall(&mut self, shared: &Shared) -> Change {
        for slot in 0..USERS {
            if self.changes[slot] > 0 && !self.queue.is_full() {
                self.push(self.state(slot), shared);
            }
        }
        for gesture in 0..self.gestures.len() {
            let is_on = self.on >> gesture & 1 == 1;
            self.push(Change::Gesture(gesture, is_on), shared);
        }
        Change::Faces(self.faces)
    }

    /// Processes new reports.
    pub(super) fn look(&mut self, shared: &Shared) {
        shared.take(&mut self.board);
        let shots = self.board.users.iter().chain([&self.board.nobody]);
        let frame = shots.map(|shot| shot.frame).max().unwrap_or(0);
        // Backwards if another source has taken its place.
        if frame != self.frame.0 {
            self.frame = (frame, Instant::now());
        }
        for slot in 0..USERS {
            let state = self.board.users[slot].state;
            if state != self.states[slot] {
                self.states[slot] = state;
                self.changes[slot] += 1;
                self.push(self.state(slot), shared);
            }
        }
        let users = self.board.users.iter();
        let on = users.fold(0, |on, shot| on | shot.gestures);
        let changed = std::mem::replace(&mut self.on, on) ^ on;
        for gesture in (0..self.gestures.len()).filter(|gesture| changed >> gesture & 1 == 1) {
            self.push(Change::Gesture(gesture, on >> gesture & 1 == 1), shared);
        }
        let present = self.states.iter().filter(|state| state.is_present());
        let faces = present.count();
        if faces != self.faces {
            self.faces = faces;
            self.push(Change::Faces(faces), shared);
        }
    }

    /// Writes how the box is.
    pub(super) fn health(&mut self, shared: &Shared, base: &str, draft: &mut Draft) {
        let now = Instant::now();
        let (frames, since) = self.told;
        let passed_s = (now - since).as_secs_f64().max(1e-3);
        self.told = (self.frame.0, now);
        let latencies = self.board.users.iter().map(|shot| shot.latency_us);
        draft.about(base, format_args!("health"));
        draft.say(format_args!(
            "{{\"sensor\":{},\"rate_hz\":{:.1},\"latency_ms\":{:.1},\"faces\":{},\"frames\":{},\"uptime_s\":{:.1},\"dropped\":{}}}",
            now - self.frame.1 < NO_FRAMES && self.frame.0 > 0,
            self.frame.0.saturating_sub(frames) as f64 / passed_s,
            f64::from(latencies.max().unwrap_or(0)) * 1e-3,
            self.faces,
            self.frame.0,
            (now - self.start).as_secs_f64(),
            shared.dropped.load(Ordering::Relaxed)
        ));
    }

    /// Whether there are unread weights of a user, which are read with that: a lost face is told while it fades.
    pub(super) fn has_weights(&mut self, slot: usize) -> bool {
        std::mem::take(&mut self.board.users[slot].fresh)
    }

    /// Writes the weights of a user.
    pub(super) fn weights(&self, slot: usize, base: &str, draft: &mut Draft) {
        let shot = &self.board.users[slot];
        draft.about(base, format_args!("{slot}/weights"));
        draft.say(format_args!("{{\"time_us\":{}", shot.at_us));
        for (name, weight) in self.units.iter().zip(&shot.weights) {
            draft.say(format_args!(",{name}{}", Weight(*weight)));
        }
        draft.say(format_args!("}}"));
    }
}
