//! One person's state of one gesture: its level, hold time and pause, and how fast the expression came.

use super::definition::Gesture;
use heapless::HistoryBuf;
use mien_stages::base::time::Timestamp;

/// Number of past frames in which a rise and a turn are measured: two seconds at 30 Hz.
pub(super) const PAST: usize = 64;
/// Share of the rise, from the lowest value of these frames to the present one, that must come within `rise_s`.
const SUDDEN: f32 = 0.45;
/// Share of the rise at which its measurement begins; and the least rise, as a share of the present value.
const BEGUN: f32 = 0.3;
/// The measurement begins again after a value of this multiple of the present one, such as a blink during a yawn.
const BLINK: f32 = 1.5;
/// A rise is over when the value was at least this share of the present one [`SETTLED_S`] ago.
const SETTLED: f32 = 0.8;
/// Age of the earlier value for [`SETTLED`], seconds.
const SETTLED_S: f32 = 0.2;

/// Longest wait before the rise is judged, seconds; a shorter hold time is awaited to its end. Later, the rise may have left [`PAST`].
const JUDGED_S: f32 = 0.7;

/// Times of the last frames.
pub(super) type Times = HistoryBuf<Timestamp, PAST>;

/// What a gesture observes in a frame.
#[derive(Clone, Copy)]
pub(super) struct Observation {
    /// Value of its expression; `None` if the face is hidden or lost.
    pub(super) value: Option<f32>,
    /// Whether the gesture may be on: the right person is tracked and faces the sensor.
    pub(super) counts: bool,
    /// Whether it may switch on: the head does not turn, and the person does not speak or the gesture allows speech.
    pub(super) may_start: bool,
}

/// One person's state of one gesture.
#[derive(Default)]
pub(super) struct Activation {
    pub(super) is_on: bool,
    /// Start of the time at the upper level.
    since: Option<Timestamp>,
    /// When it last went off.
    off_at: Option<Timestamp>,
    /// Values of the last frames since the face was last hidden; at most as many as there are times.
    past: HistoryBuf<f32, PAST>,
    /// Whether the value rose within `rise_s`; `None` until that is known, and below the upper level.
    is_fast: Option<bool>,
}

impl Activation {
    /// Takes the value of a frame in which nothing may switch.
    pub(super) fn rest(&mut self, value: Option<f32>) {
        let past = core::mem::take(&mut self.past);
        *self = Self {
            past,
            ..Self::default()
        };
        self.store(value);
    }

    fn store(&mut self, value: Option<f32>) {
        match value {
            Some(value) => self.past.write(value.max(0.0)),
            None => self.past.clear(),
        }
    }

    /// Takes the value of a frame, the last one of `times`.
    pub(super) fn observe(&mut self, gesture: &Gesture, now: Observation, times: &Times) {
        let Some(&at) = times.recent() else { return };
        self.store(now.value);
        let value = now.value.unwrap_or(f32::MIN);
        if value < gesture.on {
            self.is_fast = None;
        }
        if self.is_on {
            if !now.counts || value < gesture.off {
                (self.is_on, self.since, self.off_at) = (false, None, Some(at));
            }
        } else if value < gesture.on || !now.counts || !now.may_start {
            self.since = None;
        } else {
            let since = *self.since.get_or_insert(at);
            let held_s = at.seconds_since(since) as f32;
            let is_due = held_s >= gesture.hold_s.min(JUDGED_S);
            if gesture.rise_s > 0.0 && is_due && self.is_fast.is_none() {
                self.is_fast = self.came_fast(times, gesture.rise_s);
            }
            let is_fast = gesture.rise_s == 0.0 || self.is_fast == Some(true);
            let rested = |off| at.seconds_since(off) as f32 >= gesture.pause_s;
            let is_held = held_s >= gesture.hold_s;
            self.is_on = is_fast && is_held && self.off_at.is_none_or(rested);
        }
    }

    /// Whether the share [`SUDDEN`] of the rise came within `rise_s` (or from one frame to the next), after the value was last below
    /// the share [`BEGUN`] of the rise. `None` while the value still rises.
    pub(super) fn came_fast(&self, times: &Times, rise_s: f32) -> Option<bool> {
        let (at, now) = (times.recent()?, *self.past.recent()?);
        let times = times
            .oldest_ordered()
            .skip(times.len().saturating_sub(self.past.len()));
        let past = times.zip(self.past.oldest_ordered().copied());
        let earlier = past
            .clone()
            .filter(|(then, _)| at.seconds_since(**then) as f32 >= SETTLED_S);
        if earlier.last()?.1 < SETTLED * now {
            return None;
        }
        let base = past.clone().fold(now, |base, (_, sum)| base.min(sum));
        if now - base < BEGUN * now {
            // The expression was there before these frames.
            return Some(false);
        }
        let rises = base + BEGUN * (now - base)..BLINK * now;
        let begun = past.clone().enumerate();
        let begun = begun.filter(|(_, (_, sum))| !rises.contains(sum));
        let rise = past.clone().skip(begun.last().map_or(0, |(k, _)| k));
        Some(rise.clone().enumerate().any(|(k, (later, high))| {
            rise.clone().take(k).enumerate().any(|(j, (earlier, low))| {
                let is_near = j + 1 == k || later.seconds_since(*earlier) as f32 <= rise_s;
                is_near && high.min(now) - low >= SUDDEN * (now - base)
            })
        }))
    }
}
