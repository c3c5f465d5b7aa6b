//! The messages to the broker: records changes of state and writes payloads.

use std::fmt::Write as _;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use crate::mailbox::{Mailbox, Shared, Weight, count};
use crate::{TrackingState, View};
use mien_stages::base::capacity::USERS;
use mien_stages::base::json::Quoted;

/// Capacity of the queue of changes.
const QUEUE: usize = 64;
/// A sensor without frames for this long is reported as gone.
const SENSOR_TIMEOUT: Duration = Duration::from_secs(2);

/// A change that must reach the broker.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Change {
    Faces(usize),
    /// Index of a gesture, and whether it is on.
    Gesture(usize, bool),
    /// Slot of a user, and their state.
    State(usize, UserState),
}

impl Change {
    /// Whether the broker keeps the message for clients that connect later. It must not keep that a gesture is on: after a box was
    /// killed, Home Assistant would start the gesture's automations at each restart.
    pub(super) fn is_retained(self) -> bool {
        !matches!(self, Self::Gesture(_, true))
    }
}

/// State of a user, number of its changes, and time of the last report, µs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct UserState {
    state: TrackingState,
    changes: u32,
    at_us: u64,
}

/// A message being written, in reused strings.
pub(super) struct Draft {
    /// Start of every topic.
    pub(super) base: String,
    pub(super) topic: String,
    pub(super) payload: String,
}

impl Draft {
    /// Starts a message with this topic below the base; returns the empty payload.
    pub(super) fn begin(&mut self, topic: std::fmt::Arguments) -> &mut String {
        self.topic.clear();
        self.payload.clear();
        // A string takes everything.
        let _ = write!(self.topic, "{}/{topic}", self.base);
        &mut self.payload
    }

    /// Writes whether the box is online.
    pub(super) fn presence(&mut self, presence: &str) {
        self.begin(format_args!("presence")).push_str(presence);
    }
}

/// States sent so far, and the changes still to be sent.
pub(super) struct Messages {
    mailbox: Mailbox,
    /// Names of the units as JSON keys with a colon.
    units: Box<[String]>,
    gestures: Box<[String]>,
    /// Gestures that are on, one bit each.
    on: u32,
    users: [UserState; USERS],
    faces: usize,
    pub(super) queue: heapless::Deque<Change, QUEUE>,
    /// Number and arrival of the newest frame.
    frame: (u64, Instant),
    /// Frames and time at the last health message.
    last_health: (u64, Instant),
    start: Instant,
}

impl Messages {
    /// `units` are the names in the order of the weights, `gestures` the names of the gestures.
    pub(super) fn new(view: &View, units: &[&str], gestures: &[&str]) -> Self {
        let now = Instant::now();
        let key = |unit: &&str| format!("{}:", Quoted(view.name(unit)));
        Self {
            mailbox: Mailbox::default(),
            units: units.iter().map(key).collect(),
            gestures: gestures.iter().map(|&name| name.to_owned()).collect(),
            on: 0,
            users: Default::default(),
            faces: 0,
            queue: heapless::Deque::new(),
            frame: (0, now),
            last_health: (0, now),
            start: now,
        }
    }

    /// Writes the message of a change.
    pub(super) fn write(&self, change: Change, draft: &mut Draft) {
        // A string takes everything.
        let _ = match change {
            Change::Faces(faces) => write!(draft.begin(format_args!("faces")), "{faces}"),
            Change::Gesture(gesture, is_on) => {
                let name = &self.gestures[gesture];
                let payload = draft.begin(format_args!("gesture/{name}"));
                payload.write_str(if is_on { "ON" } else { "OFF" })
            }
            Change::State(slot, user) => {
                let (state, present) = (user.state.name(), user.state.is_present());
                write!(
                    draft.begin(format_args!("{slot}/state")),
                    "{{\"state\":\"{state}\",\"present\":{present},\"changes\":{},\"time_us\":{}}}",
                    user.changes,
                    user.at_us
                )
            }
        };
    }

    /// Queues a change; if the queue is full, drops the oldest and counts it.
    fn push(&mut self, change: Change, shared: &Shared) {
        if self.queue.is_full() {
            self.queue.pop_front();
            count(&shared.dropped);
        }
        // There is room now.
        let _ = self.queue.push_back(change);
    }

    /// Queues all states for a new connection, because the broker's retained messages may be outdated; returns the number of faces,
    /// which is sent first.
    pub(super) fn requeue_all(&mut self, shared: &Shared) -> Change {
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

    /// Reads new reports and queues their changes.
    pub(super) fn update(&mut self, shared: &Shared) {
        shared.fetch(&mut self.mailbox);
        let snapshots = self.mailbox.users.iter().chain([&self.mailbox.nobody]);
        let frame = snapshots.map(|snapshot| snapshot.frame).max().unwrap_or(0);
        // Lower if the source has changed.
        if frame != self.frame.0 {
            self.frame = (frame, Instant::now());
        }
        for slot in 0..USERS {
            let (snapshot, user) = (&self.mailbox.users[slot], &mut self.users[slot]);
            user.at_us = snapshot.at_us;
            if snapshot.state != user.state {
                user.state = snapshot.state;
                user.changes += 1;
                let change = Change::State(slot, *user);
                self.push(change, shared);
            }
        }
        let users = self.mailbox.users.iter();
        let on = users.fold(0, |on, snapshot| on | snapshot.gestures);
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

    /// Writes the health message.
    pub(super) fn health(&mut self, shared: &Shared, draft: &mut Draft) {
        let now = Instant::now();
        let (frames, since) = self.last_health;
        let passed_s = (now - since).as_secs_f64().max(1e-3);
        self.last_health = (self.frame.0, now);
        let users = self.mailbox.users.iter();
        let latencies = users.map(|snapshot| snapshot.latency_us);
        let _ = write!(
            draft.begin(format_args!("health")),
            "{{\"sensor\":{},\"rate_hz\":{:.1},\"latency_ms\":{:.1},\"faces\":{},\"frames\":{},\"uptime_s\":{:.1},\"dropped\":{}}}",
            now - self.frame.1 < SENSOR_TIMEOUT && self.frame.0 > 0,
            self.frame.0.saturating_sub(frames) as f64 / passed_s,
            f64::from(latencies.max().unwrap_or(0)) * 1e-3,
            self.faces,
            self.frame.0,
            (now - self.start).as_secs_f64(),
            shared.dropped.load(Ordering::Relaxed)
        );
    }

    /// Whether a user has unread weights; marks them as read. Includes a lost face while it fades.
    pub(super) fn has_weights(&mut self, slot: usize) -> bool {
        std::mem::take(&mut self.mailbox.users[slot].fresh)
    }

    /// Writes the message with the weights of a user.
    pub(super) fn weights(&self, slot: usize, draft: &mut Draft) {
        let snapshot = &self.mailbox.users[slot];
        let payload = draft.begin(format_args!("{slot}/weights"));
        let _ = write!(payload, "{{\"time_us\":{}", snapshot.at_us);
        for (name, weight) in self.units.iter().zip(&snapshot.weights) {
            let _ = write!(payload, ",{name}{}", Weight(*weight));
        }
        payload.push('}');
    }
}
