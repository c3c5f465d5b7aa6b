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

/// Times of the last frames.
pub(super) type Times = HistoryBuf<Timestamp, PAST>;

/// One person's state of one gesture.
#[derive(Default)]
pub(super) struct Activation {
    pub(super) is_on: bool,
    /// Start of the time at the upper level.
    since: Option<Timestamp>,
    /// When it last went off.
    off_at: Option<Timestamp>,
    /// Values of the last frames.
    past: HistoryBuf<f32, PAST>,
    /// Whether the value rose too slowly since it was last below the upper level.
    is_slow: bool,
}

impl Activation {
    /// Takes the value of a frame in which nothing may switch.
    pub(super) fn rest(&mut self, sum: f32) {
        let past = core::mem::take(&mut self.past);
        *self = Self {
            past,
            ..Self::default()
        };
        self.past.write(sum.max(0.0));
    }

    /// Takes the value of a frame, the last one of `times`.
    pub(super) fn observe(&mut self, gesture: &Gesture, sum: f32, may_start: bool, times: &Times) {
        let Some(&at) = times.recent() else { return };
        self.past.write(sum.max(0.0));
        if self.is_on {
            if sum < gesture.off {
                (self.is_on, self.since, self.off_at) = (false, None, Some(at));
            }
        } else if sum < gesture.on {
            (self.since, self.is_slow) = (None, false);
        } else if may_start && !self.is_slow {
            let since = *self.since.get_or_insert(at);
            let rested = |off| at.seconds_since(off) as f32 >= gesture.pause_s;
            if at.seconds_since(since) as f32 >= gesture.hold_s && self.off_at.is_none_or(rested) {
                let came_fast = match gesture.rise_s {
                    0.0 => Some(true),
                    rise_s => self.came_fast(times, rise_s),
                };
                if let Some(came_fast) = came_fast {
                    (self.is_on, self.is_slow) = (came_fast, !came_fast);
                }
            }
        } else {
            self.since = None;
        }
    }

    /// Whether the share [`SUDDEN`] of the rise came within `rise_s` (or from one frame to the next), after the value was last below
    /// the share [`BEGUN`] of the rise. `None` while the value still rises.
    pub(super) fn came_fast(&self, times: &Times, rise_s: f32) -> Option<bool> {
        let (at, now) = (times.recent()?, *self.past.recent()?);
        // Times may go back further than this gesture's values.
        let times = times.oldest_ordered().skip(times.len() - self.past.len());
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
