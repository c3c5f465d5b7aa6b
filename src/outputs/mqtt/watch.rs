//! What is told the broker: the users' states since the start, and messages about them.

use std::fmt::Write as _;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use crate::board::{Board, Shared, Weight, count};
use crate::{TrackingState, View};
use mien_stages::base::capacity::USERS;
use mien_stages::base::json::Quoted;

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
    /// Of the user in a slot.
    State(usize, Standing),
}

/// State of a user, how often it has changed, and the time of the last report of it, µs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Standing {
    state: TrackingState,
    changes: u32,
    at_us: u64,
}

/// A message being written; its strings are allocated once.
pub(super) struct Draft {
    /// What every topic begins with.
    pub(super) base: String,
    pub(super) topic: String,
    pub(super) payload: String,
}

impl Draft {
    /// Starts anew with this topic, below the base. The payload, to be written.
    pub(super) fn about(&mut self, topic: std::fmt::Arguments) -> &mut String {
        self.topic.clear();
        self.payload.clear();
        // A string takes everything.
        let _ = write!(self.topic, "{}/{topic}", self.base);
        &mut self.payload
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
    users: [Standing; USERS],
    faces: usize,
    pub(super) queue: heapless::Deque<Change, QUEUE>,
    /// The newest frame and when it came.
    frame: (u64, Instant),
    /// Frames and time at the last health message.
    told: (u64, Instant),
    start: Instant,
}

impl Watch {
    /// `units` are the names in the order of the weights, `gestures` those of the gestures.
    pub(super) fn new(view: &View, units: &[&str], gestures: &[&str]) -> Self {
        let now = Instant::now();
        let key = |unit: &&str| format!("{}:", Quoted(view.name(unit)));
        Self {
            board: Board::default(),
            units: units.iter().map(key).collect(),
            gestures: gestures.iter().map(|&name| name.to_owned()).collect(),
            on: 0,
            users: Default::default(),
            faces: 0,
            queue: heapless::Deque::new(),
            frame: (0, now),
            told: (0, now),
            start: now,
        }
    }

    /// Writes a change.
    pub(super) fn write(&self, change: Change, draft: &mut Draft) {
        // A string takes everything.
        let _ = match change {
            Change::Faces(faces) => write!(draft.about(format_args!("faces")), "{faces}"),
            Change::Gesture(gesture, is_on) => {
                let name = &self.gestures[gesture];
                let payload = draft.about(format_args!("gesture/{name}"));
                payload.write_str(if is_on { "ON" } else { "OFF" })
            }
            Change::State(slot, standing) => {
                let Standing {
                    state,
                    changes,
                    at_us,
                } = standing;
                write!(
                    draft.about(format_args!("{slot}/state")),
                    "{{\"state\":\"{}\",\"present\":{},\"changes\":{changes},\"time_us\":{at_us}}}",
                    state.name(),
                    state.is_present()
                )
            }
        };
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

    /// Queues everything again for a new connection: what the broker keeps of us may be older than what it missed. The number
    /// of faces comes first.
    pub(super) fn recall(&mut self, shared: &Shared) -> Change {
        for slot in 0..USERS {
            if self.users[slot].changes > 0 && !self.queue.is_full() {
                self.push(Change::State(slot, self.users[slot]), shared);
            }
        }
        for gesture in 0..self.gestures.len() {
            let is_on = self.on >> gesture & 1 == 1;
            self.push(Change::Gesture(gesture, is_on), shared);
        }
        Change::Faces(self.faces)
    }

    /// Processes new reports.
    pub(super) fn update(&mut self, shared: &Shared) {
        shared.take(&mut self.board);
        let shots = self.board.users.iter().chain([&self.board.nobody]);
        let frame = shots.map(|shot| shot.frame).max().unwrap_or(0);
        // Backwards if another source has taken its place.
        if frame != self.frame.0 {
            self.frame = (frame, Instant::now());
        }
        for slot in 0..USERS {
            let (shot, user) = (&self.board.users[slot], &mut self.users[slot]);
            user.at_us = shot.at_us;
            if shot.state != user.state {
                user.state = shot.state;
                user.changes += 1;
                let change = Change::State(slot, *user);
                self.push(change, shared);
            }
        }
        let users = self.board.users.iter();
        let on = users.fold(0, |on, shot| on | shot.gestures);
        let changed = std::mem::replace(&mut self.on, on) ^ on;
        for gesture in (0..self.gestures.len()).filter(|gesture| changed >> gesture & 1 == 1) {
            self.push(Change::Gesture(gesture, on >> gesture & 1 == 1), shared);
        }
        let present = self.users.iter().filter(|user| user.state.is_present());
        let faces = present.count();
        if faces != self.faces {
            self.faces = faces;
            self.push(Change::Faces(faces), shared);
        }
    }

    /// Writes how the box is.
    pub(super) fn health(&mut self, shared: &Shared, draft: &mut Draft) {
        let now = Instant::now();
        let (frames, since) = self.told;
        let passed_s = (now - since).as_secs_f64().max(1e-3);
        self.told = (self.frame.0, now);
        let latencies = self.board.users.iter().map(|shot| shot.latency_us);
        let _ = write!(
            draft.about(format_args!("health")),
            "{{\"sensor\":{},\"rate_hz\":{:.1},\"latency_ms\":{:.1},\"faces\":{},\"frames\":{},\"uptime_s\":{:.1},\"dropped\":{}}}",
            now - self.frame.1 < NO_FRAMES && self.frame.0 > 0,
            self.frame.0.saturating_sub(frames) as f64 / passed_s,
            f64::from(latencies.max().unwrap_or(0)) * 1e-3,
            self.faces,
            self.frame.0,
            (now - self.start).as_secs_f64(),
            shared.dropped.load(Ordering::Relaxed)
        );
    }

    /// Whether there are unread weights of a user, which are read with that: a lost face is told while it fades.
    pub(super) fn has_weights(&mut self, slot: usize) -> bool {
        std::mem::take(&mut self.board.users[slot].fresh)
    }

    /// Writes the weights of a user.
    pub(super) fn weights(&self, slot: usize, draft: &mut Draft) {
        let shot = &self.board.users[slot];
        let payload = draft.about(format_args!("{slot}/weights"));
        let _ = write!(payload, "{{\"time_us\":{}", shot.at_us);
        for (name, weight) in self.units.iter().zip(&shot.weights) {
            let _ = write!(payload, ",{name}{}", Weight(*weight));
        }
        payload.push('}');
    }
}
