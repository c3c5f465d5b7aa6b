//! Finds level and hold time of a gesture for one person: they rest for [`REST_S`], then make the expression five times.
//!
//! A repetition is a rise clearly above the person's rest and a return, at least [`LEAST_S`] long. For each repetition and for a series
//! of levels, the longest time at or above the level is stored. These times give the highest level that a repetition kept for the hold
//! time. The new level is the configured one, limited to between [`LOW`] and [`HIGH`] of the way from rest to the second lowest of these
//! five levels, but not below the gesture's `on_min`: speech and glances reach almost as far.
//!
//! Values of a gesture's expression, seconds of capture time. Memory: fixed, about 4.5 kB. Degenerate: without a repetition for
//! [`PATIENCE_S`] nothing is found.

use mien_stages::base::time::Timestamp;

/// Number of repetitions.
pub const REPETITIONS: usize = 5;
/// Time at rest, seconds.
const REST_S: f32 = 3.0;
/// Most values at rest that are stored: enough for [`REST_S`] at 60 Hz.
const RESTS: usize = 256;
/// Least height of a repetition above rest, as a share of the configured level.
const RISE: f32 = 0.35;
/// Least height as a share of the highest repetition: a lower one is another movement, such as a twitch.
const LIKE: f32 = 0.4;
/// Least time of a repetition at half of its height, seconds. Blinks are shorter.
const LEAST_S: f32 = 0.3;
/// Greatest time of a repetition, seconds, or twice the hold time. If it lasts longer, the value before it was not the person's rest,
/// and rest begins again.
const MOST_S: f32 = 8.0;
/// Longest wait for a repetition, seconds.
const PATIENCE_S: f64 = 60.0;
/// A pause between frames that ends a repetition, seconds.
const GAP_S: f32 = 0.5;
/// Lowest new level, between rest (0) and the level that was kept (1). With a lower one, spontaneous expressions switch more often.
const LOW: f32 = 0.25;
/// Highest new level, likewise. Expressions at 60 % of full reach it, although their weights can be as low as 40 % of the full ones.
pub(super) const HIGH: f32 = 0.34;
/// Highest new levels of gazes to the side, and of gazes up or down. Their weights are proportional to the angle; everyday glances reach
/// three quarters of a full gaze to the side, and half of one up or down.
pub(super) const HIGH_OF_GAZE: [f32; 2] = [0.78, 0.55];
/// Least change of the configured level, as a share of it: a smaller one is within the noise of repetitions and is not made.
const LEAST_CHANGE: f32 = 0.05;
/// Longest hold time, as a share of the time for which the expression was kept.
const HOLD: f32 = 0.7;
/// Least hold time that is found, seconds.
const HOLD_MIN_S: f32 = 0.15;
/// Number of levels for which times are stored.
const STEPS: usize = 112;
/// The lowest of them, as a share of the configured level.
const LOWEST: f32 = 0.25;
/// Ratio of neighbouring levels: 16 in a factor of two.
const STEP: f32 = 1.044_273_8;

/// State of a set-up by five repetitions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SetUpState {
    /// None since the start.
    #[default]
    None,
    /// The person shall rest.
    Rest,
    /// The person shall make the expression.
    Act,
    /// New levels were found.
    Found,
    /// The present levels serve as well.
    Kept,
    /// No expression was seen for a minute.
    Failed,
    /// The expressions were too weak: speech and glances reach as far.
    Weak,
}

impl SetUpState {
    /// All states in the order of their numbers.
    pub const ALL: [Self; 7] = {
        use SetUpState::{Act, Failed, Found, Kept, None, Rest, Weak};
        [None, Rest, Act, Found, Kept, Failed, Weak]
    };

    /// The name in JSON.
    pub fn name(self) -> &'static str {
        ["none", "rest", "act", "found", "kept", "failed", "weak"][self as usize]
    }
}

/// When a gesture is on.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Levels {
    /// Value at which it goes on.
    pub on: f32,
    /// Value below which it goes off.
    pub off: f32,
    /// Time for which `on` must be kept, seconds.
    pub hold_s: f32,
    /// Time within which 45 % of the expression's rise must come, seconds; 0 = any.
    pub rise_s: f32,
}

/// The four numbers, separated by spaces.
impl core::fmt::Display for Levels {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let Self {
            on,
            off,
            hold_s,
            rise_s,
        } = self;
        write!(f, "{on} {off} {hold_s} {rise_s}")
    }
}

/// What a lesson awaits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Awaits {
    /// Rest.
    Rest,
    /// Repetitions; how many were seen.
    Acts(usize),
    /// Nothing: five repetitions were seen.
    Nothing,
    /// Nothing: no repetition came for a minute.
    Aborted,
}

/// For each level the time since the value came to it (−1: the value is below) and the longest such time, seconds.
#[derive(Clone, Copy)]
struct Times {
    now: [f32; STEPS],
    longest: [f32; STEPS],
}

impl Times {
    const NONE: Self = Self {
        now: [-1.0; STEPS],
        longest: [0.0; STEPS],
    };

    /// Takes a value, `s` seconds after the previous one; `level` is the lowest level.
    fn add(&mut self, mut level: f32, value: f32, s: f32) {
        for (now, longest) in self.now.iter_mut().zip(&mut self.longest) {
            *now = match value >= level {
                true if *now < 0.0 => 0.0,
                true => *now + s,
                false => -1.0,
            };
            *longest = longest.max(*now);
            level *= STEP;
        }
    }
}

/// A set-up in progress.
pub(super) struct Lesson {
    /// The levels of the configuration.
    configured: Levels,
    /// The least new `on`.
    on_min: f32,
    /// [`HIGH`] or [`HIGH_OF_GAZE`].
    high: f32,
    rests: heapless::Vec<f32, RESTS>,
    rested_s: f32,
    /// Value at rest.
    rest: f32,
    /// Value at which a repetition begins.
    start: f32,
    /// Times of the repetition in progress.
    times: Times,
    /// Its greatest value; `None` between repetitions.
    peak: Option<f32>,
    /// Whether it rose within `rise_s`; `None` until that is known.
    came_fast: Option<bool>,
    /// For each repetition: times at the levels, and whether it rose more slowly than `rise_s`.
    seen: heapless::Vec<([f32; STEPS], bool), REPETITIONS>,
    /// Time of the last frame.
    last: Option<Timestamp>,
    /// Start of the wait for a repetition: the first frame, then the end of the last repetition.
    since: Option<Timestamp>,
}

impl Lesson {
    pub(super) fn new(configured: Levels, on_min: f32, high: f32) -> Self {
        Self {
            configured,
            on_min,
            high,
            rests: heapless::Vec::new(),
            rested_s: 0.0,
            rest: 0.0,
            start: f32::MAX,
            times: Times::NONE,
            peak: None,
            came_fast: None,
            seen: heapless::Vec::new(),
            last: None,
            since: None,
        }
    }

    /// What it awaits at a time.
    pub(super) fn awaits(&mut self, at: Timestamp) -> Awaits {
        let since = *self.since.get_or_insert(at);
        if self.seen.is_full() {
            Awaits::Nothing
        } else if at.seconds_since(since) > PATIENCE_S {
            Awaits::Aborted
        } else if self.rested_s < REST_S {
            Awaits::Rest
        } else {
            Awaits::Acts(self.seen.len())
        }
    }

    /// Takes the value of a frame, and whether the value rose within `rise_s`.
    pub(super) fn observe(&mut self, value: f32, came_fast: Option<bool>, at: Timestamp) {
        let s = self.last.replace(at);
        let s = s.map_or(0.0, |last| at.seconds_since(last) as f32);
        if s > GAP_S {
            self.peak = None;
        } else if self.rested_s < REST_S {
            self.rested_s += s;
            let _ = self.rests.push(value);
            if self.rested_s >= REST_S {
                self.end_rest();
            }
        } else if !self.seen.is_full() {
            self.act(value, s, at);
            self.came_fast = self.peak.and(self.came_fast.or(came_fast));
        }
    }

    /// Takes the median of the values as rest; if the 90th percentile is far above it, rest begins again.
    fn end_rest(&mut self) {
        self.rests.sort_unstable_by(f32::total_cmp);
        let of = |share: f32| self.rests[(share * (self.rests.len() - 1) as f32) as usize];
        // A value below 0 shows the opposite expression, which does not count as rest.
        let (rest, high) = (of(0.5).max(0.0), of(0.9));
        let least = RISE * self.configured.on;
        if high - rest > least {
            self.rested_s = 0.0;
        }
        (self.rest, self.start) = (rest, rest + least.max(2.0 * (high - rest)));
        self.rests.clear();
    }

    fn act(&mut self, value: f32, s: f32, at: Timestamp) {
        let peak = self.peak.unwrap_or_else(|| {
            self.times = Times::NONE;
            value
        });
        let peak = peak.max(value);
        if value < self.start.max(0.5 * (self.rest + peak)) {
            if self.peak.take().is_some() {
                self.end_act(at);
            }
            return;
        }
        self.peak = Some(peak);
        self.times.add(LOWEST * self.configured.on, value, s);
        if self.times.longest[0] > MOST_S.max(2.0 * self.configured.hold_s) {
            (self.peak, self.rested_s) = (None, 0.0);
        }
    }

    /// Stores the repetition in progress if it is high enough, and drops earlier ones that are too low beside it.
    fn end_act(&mut self, at: Timestamp) {
        let height = |times: &[f32; STEPS]| self.kept(times, LEAST_S) - self.rest;
        let new = height(&self.times.longest);
        if new <= 0.0
            || self
                .seen
                .iter()
                .any(|(other, _)| new < LIKE * height(other))
        {
            return;
        }
        let like = |(other, _): &&_| height(other) >= LIKE * new;
        let like: heapless::Vec<_, REPETITIONS> = self.seen.iter().filter(like).copied().collect();
        self.seen = like;
        let is_slow = self.came_fast == Some(false);
        let _ = self.seen.push((self.times.longest, is_slow));
        self.since = Some(at);
    }

    fn levels(&self) -> impl Iterator<Item = f32> {
        core::iter::successors(Some(LOWEST * self.configured.on), |level| {
            Some(level * STEP)
        })
    }

    /// Longest time at or above a level, taken from the next higher level of the series.
    fn time_at(&self, times: &[f32; STEPS], level: f32) -> f32 {
        let mut levels = self.levels().zip(times);
        levels.find(|(at, _)| *at >= level).map_or(0.0, |(_, s)| *s)
    }

    /// Highest level kept for `s` seconds; the value at rest if none was.
    fn kept(&self, times: &[f32; STEPS], s: f32) -> f32 {
        let kept = self
            .levels()
            .zip(times)
            .filter(|(_, longest)| **longest >= s);
        kept.last().map_or(self.rest, |(level, _)| level)
    }

    /// Second lowest value of a quality of the repetitions, so that one of them may fail.
    fn second(&self, quality: impl Fn(&[f32; STEPS]) -> f32) -> f32 {
        let all = self.seen.iter().map(|(times, _)| quality(times));
        let mut all: heapless::Vec<f32, REPETITIONS> = all.collect();
        all.sort_unstable_by(f32::total_cmp);
        all.get(1).copied().unwrap_or_default()
    }

    /// The levels for this person, or why those of `now` stay: they are the same, or the new ones do not catch most repetitions.
    pub(super) fn found(&self, now: Levels) -> Result<Levels, SetUpState> {
        let Levels {
            on,
            off,
            hold_s,
            rise_s,
        } = self.configured;
        // One slow repetition does not remove the limit.
        let slow = self.seen.iter().filter(|(_, is_slow)| *is_slow).count();
        let rise_s = if slow > 1 { 0.0 } else { rise_s };
        let lasted = self.second(|times| {
            let half = 0.5 * (self.rest + self.kept(times, LEAST_S));
            self.time_at(times, half)
        });
        let hold_s = hold_s.min((HOLD * lasted).max(HOLD_MIN_S));
        let kept = self.second(|times| self.kept(times, hold_s));
        let [low, high] = [LOW, self.high].map(|share| self.rest + share * (kept - self.rest));
        let level = on.clamp(low, high).max(self.on_min.min(on));
        let level = if (level / on - 1.0).abs() < LEAST_CHANGE {
            on
        } else {
            level
        };
        let new = Levels {
            on: level,
            // The same share of the way from rest to `on` as configured.
            off: self.rest.min(level) + (level - self.rest).max(0.0) * off / on,
            hold_s,
            rise_s,
        };
        let catches = |(times, _): &&_| self.time_at(times, new.on) >= new.hold_s;
        let caught = self.seen.iter().filter(catches).count();
        match new {
            _ if caught < REPETITIONS / 2 + 1 => Err(SetUpState::Weak),
            // With a rest above the lower level the gesture would stay on.
            _ if Levels {
                off: now.off,
                ..new
            } == now
                && now.off > self.rest =>
            {
                Err(SetUpState::Kept)
            }
            new => Ok(new),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WINK: Levels = Levels {
        on: 0.7,
        off: 0.35,
        hold_s: 0.2,
        rise_s: 0.0,
    };

    /// A rest of four seconds, then acts of a height and a duration, each with a second of rest after it; 30 frames a second.
    fn taught(configured: Levels, rest: f32, acts: &[(f32, f32)]) -> (Lesson, Timestamp) {
        taught_with_speed(configured, rest, acts, |_| Some(true))
    }

    /// As [`taught`], but `came_fast` is computed from each value.
    fn taught_with_speed(
        configured: Levels,
        rest: f32,
        acts: &[(f32, f32)],
        came_fast: impl Fn(f32) -> Option<bool>,
    ) -> (Lesson, Timestamp) {
        let mut lesson = Lesson::new(configured, 0.3, HIGH);
        let mut frame = 0;
        let mut play = |value: f32, s: f32| {
            for _ in 0..(30.0 * s).round() as u64 {
                frame += 1;
                let noise = 0.01 * (frame % 3) as f32;
                lesson.observe(
                    value + noise,
                    came_fast(value),
                    Timestamp::from_us(frame * 33_333),
                );
            }
        };
        play(rest, 4.0);
        for &(height, s) in acts {
            play(height, s);
            play(rest, 1.0);
        }
        (lesson, Timestamp::from_us(frame * 33_333))
    }

    fn is_near(found: f32, expected: f32) -> bool {
        (expected / STEP - 0.02..expected * STEP + 0.02).contains(&found)
    }

    #[test]
    fn the_level_lies_below_the_weaker_repetitions_and_the_weakest_does_not_count() {
        for (heights, rest, expected) in [
            ([0.9, 1.0, 0.92, 0.95, 0.94], 0.0, 0.34 * 0.92),
            ([0.9, 1.0, 0.5, 0.95, 0.94], 0.0, 0.34 * 0.9),
            // So weak that speech and glances would reach 34 %: the least level.
            ([0.6, 0.6, 0.6, 0.6, 0.6], 0.0, 0.3),
            // A person whose eye is never fully open.
            ([0.9, 0.9, 0.9, 0.9, 0.9], 0.3, 0.3 + 0.34 * 0.6),
        ] {
            let (mut lesson, at) = taught(WINK, rest, &heights.map(|height| (height, 1.0)));
            assert_eq!(lesson.awaits(at), Awaits::Nothing);
            let found = lesson.found(WINK).unwrap();
            assert!(is_near(found.on, expected), "{heights:?}: {found:?}");
            assert!(found.off > rest && found.off < found.on && found.hold_s == 0.2);
        }
    }

    #[test]
    fn a_gaze_to_the_side_is_lowered_only_for_somebody_who_does_not_look_far() {
        let look = Levels { on: 0.7, ..WINK };
        let found = |height| {
            let mut lesson = taught(look, 0.0, &[(height, 1.2); 5]).0;
            lesson.high = HIGH_OF_GAZE[0];
            lesson.found(look).map(|found| found.on)
        };
        assert_eq!(found(1.0), Err(SetUpState::Kept));
        assert!(is_near(found(0.75).unwrap(), 0.78 * 0.75));
    }

    #[test]
    fn short_repetitions_shorten_the_hold_time() {
        let smile = Levels {
            on: 0.4,
            off: 0.25,
            hold_s: 0.7,
            rise_s: 0.0,
        };
        let hold = |s| {
            taught(smile, 0.0, &[(2.0, s); 5])
                .0
                .found(smile)
                .unwrap()
                .hold_s
        };
        assert_eq!(hold(1.2), 0.7);
        assert!((0.25..0.3).contains(&hold(0.4)), "{}", hold(0.4));
    }

    #[test]
    fn slow_twitches_before_the_repetitions_do_not_remove_the_limit_of_the_rise() {
        let limited = Levels {
            rise_s: 0.25,
            ..WINK
        };
        for (heights, expected) in [
            (vec![0.3, 0.3, 0.9, 0.9, 0.9, 0.9, 0.9], 0.25),
            (vec![0.8, 0.8, 0.9, 0.9, 0.9], 0.0),
        ] {
            let acts: Vec<_> = heights.iter().map(|&height| (height, 1.0)).collect();
            let (lesson, _) = taught_with_speed(limited, 0.0, &acts, |value| Some(value > 0.85));
            assert_eq!(lesson.found(limited).unwrap().rise_s, expected);
        }
    }

    #[test]
    fn a_level_that_suits_already_stays() {
        let present = Levels {
            on: 0.3,
            off: 0.15,
            ..WINK
        };
        let (lesson, _) = taught(present, 0.0, &[(0.9, 1.0); 5]);
        assert_eq!(lesson.found(present), Err(SetUpState::Kept));
        // A lower level that was found before rises to the configured one.
        let low = Levels { on: 0.2, ..present };
        assert_eq!(lesson.found(low).map(|found| found.on), Ok(0.3));
    }

    #[test]
    fn blinks_and_twitches_are_no_repetitions() {
        let blinks = [(1.0, 0.2), (0.9, 1.0)].repeat(4);
        let (mut lesson, at) = taught(WINK, 0.0, &blinks);
        assert_eq!(lesson.awaits(at), Awaits::Acts(4));
        // A twitch before the first repetition counts until that repetition comes.
        let twitches = [(0.3, 0.6), (0.9, 1.0), (0.3, 0.6), (0.95, 1.0)];
        let (mut lesson, at) = taught(WINK, 0.0, &twitches);
        assert_eq!(lesson.awaits(at), Awaits::Acts(2));
    }

    #[test]
    fn without_an_expression_nothing_is_found() {
        let (mut lesson, at) = taught(WINK, 0.1, &[(0.15, 1.0); 25]);
        assert_eq!(lesson.awaits(at), Awaits::Acts(0));
        let later = Timestamp::from_us(at.as_us() + 61_000_000);
        assert_eq!(lesson.awaits(later), Awaits::Aborted);
        // Clear repetitions, but so weak that glances reach as far.
        let (lesson, _) = taught(WINK, 0.0, &[(0.27, 1.0); 5]);
        assert_eq!(lesson.found(WINK), Err(SetUpState::Weak));
    }

    #[test]
    fn an_expression_that_began_during_the_rest_is_not_taken_for_one() {
        let acts = [&[(0.9, 1.0)][..], &[(0.9, 12.0)], &[(0.9, 1.0); 4]].concat();
        let (mut lesson, at) = taught(WINK, 0.0, &acts);
        // A repetition of twelve seconds is too long, so rest begins again.
        assert_ne!(lesson.awaits(at), Awaits::Nothing);
    }
}
