//! Gestures: expressions used as switches, such as a raised brow that presses a key.
//!
//! A gesture evaluates a sum of units, or the smallest of several sums. It goes on when the value has been at the upper level for
//! the hold time, and off below the lower level. It does not go on while the head turns or is turned away, before the face is tracked,
//! before the pause is over, during speech or laughter that moves the mouth, or if less than [`SUDDEN`] of the rise came within `rise_s`:
//! yawns, laughter and the lids of a drowsy person rise more slowly than deliberate expressions. Every on is followed by an off, also
//! when the head turns away, the face is lost, the person leaves, the source stops, the configuration changes or the run ends.
//!
//! Speech and laughter are detected from the mouth's opening: at least [`REVERSALS`] reversals within [`SPEECH_S`], each of at least
//! [`REVERSAL`] and at least a [`SHARE`] of the opening, the last one less than [`QUIET_S`] ago.
//!
//! [`teaching`] finds levels for a person. Weights 0…1, seconds of capture time, degrees. Memory: fixed, about 1.8 kB for each gesture,
//! and 8 kB, of which 4 kB are for a set-up.

pub mod teaching;

use super::command::Command;
use super::every::Every;
use super::osc::packet::Argument;
use super::report::{Report, unit_range};
use super::view::{is_name, is_unit};
use heapless::HistoryBuf;
use mien_stages::base::capacity::{GESTURES, USERS};
use mien_stages::base::geometry::{Vector, face_normal};
use mien_stages::base::prelude::*;
use mien_stages::base::settings::keyed;
use mien_stages::base::time::Timestamp;
use mien_stages::users::TrackingState;
pub use teaching::SetUpState;
use teaching::{Awaits, HIGH, HIGH_OF_GAZE, Lesson, Levels};

/// Whether this build has gestures.
pub const ENABLED: bool = cfg!(any(test, feature = "wires"));
/// Reversals of the mouth's opening that count as speech.
const REVERSALS: usize = 3;
/// Smallest reversal, weight.
const REVERSAL: f32 = 0.15;
/// Smallest reversal as a share of the opening.
const SHARE: f32 = 0.2;
/// Time within which the reversals must occur, seconds.
const SPEECH_S: f64 = 1.2;
/// Speech ends this long after the last reversal, seconds.
const QUIET_S: f64 = 0.4;
/// Least and greatest upper level.
pub const LEVELS: [f32; 2] = [0.01, 8.0];
/// Number of past frames in which a rise and a turn are measured: two seconds at 30 Hz.
const PAST: usize = 64;
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
/// Turn of the head to the side within [`TURN_S`], degrees, above which no gesture goes on. Turns up and down do not count, because
/// opening the mouth changes the measured pitch.
const TURN_DEG: f32 = 8.0;
/// Time within which a turn is measured, seconds.
const TURN_S: f32 = 0.3;
/// Greatest hold time, seconds.
const HOLD_MAX_S: f32 = 60.0;
/// Number of hours, with the present one, over which activations and tracked time are counted.
const HOURS: usize = 24;
/// Interval at which every state is repeated for receivers that missed a change, seconds.
const REPEAT_S: f64 = 2.0;

/// Whose expression counts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Person {
    /// The person that single-person outputs show.
    #[default]
    Shown,
    /// Anybody: the gesture is on while at least one person makes it.
    Any,
    /// Each person separately.
    Each,
}

/// How a key is pressed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Press {
    /// Down and up again at once, because a key held down repeats.
    #[default]
    Tap,
    /// Down while the gesture is on.
    Hold,
}

keyed! {
    /// One gesture.
    pub struct Gesture {
        /// Name of the gesture.
        name: String = String::new() => Text("at most 24 letters, digits and signs such as _ or -", is_topic_part),
        /// Expression that switches it.
        of: String = String::new() => Text(
            "a sum of units, such as \"AU12L + AU12R - AU26\", or sums joined by &, of which the smallest counts",
            is_sum
        ),
        /// Level of that expression at which it goes on.
        on: f32 = 0.7 => number(LEVELS[0], LEVELS[1], ""),
        /// Lowest level that the set-up by five repetitions may find, unless on is lower: speech and glances reach almost as far.
        on_min: f32 = 0.35 => number(0.0, LEVELS[1], ""),
        /// Level below which it goes off.
        off: f32 = 0.4 => number(0.0, 8.0, ""),
        /// How long the level must be kept before it goes on.
        hold_s: f32 = 0.2 => seconds(),
        /// Time within which 45 % of the expression's rise must come; 0 = any.
        rise_s: f32 = 0.0 => seconds(),
        /// Shortest time from going off to going on again.
        pause_s: f32 = 0.3 => seconds(),
        /// Whose expression counts: that of the person in single-person outputs, anybody's, or each person's separately.
        person: Person = Person::default() =>
            choice(&[("shown", Person::Shown), ("any", Person::Any), ("each", Person::Each)]),
        /// Whether it goes on while the person speaks or laughs.
        speaking: bool = false => Bool(),
        /// Largest sideways angle between the face and the line from it to the sensor.
        turned_deg: f32 = 30.0 => number(1.0, 90.0, "degrees"),
        /// Key that it presses; empty = none.
        key: String = String::new() =>
            Text("a key such as \"space\", \"a\", \"page_down\", \"mouse_left\", or empty", is_key),
        /// Whether the key is tapped once, or held down while the gesture is on.
        press: Press = Press::default() => choice(&[("tap", Press::Tap), ("hold", Press::Hold)]),
    }
}

/// Longest sum, bytes; enough for every unit once.
const SUM_MAX: usize = 512;

/// Whether a text is a sum of units, or several joined by `&`.
fn is_sum(text: &str) -> bool {
    text.len() <= SUM_MAX && Gesture::sums(text).flatten().all(|(_, unit)| is_unit(unit))
}

/// Whether the key exists; a build without key output accepts any name.
fn is_key(name: &str) -> bool {
    #[cfg(feature = "wires")]
    let is_known = super::key_codes::is_key;
    #[cfg(not(feature = "wires"))]
    let is_known = is_name;
    name.is_empty() || is_known(name)
}

/// Whether the text is valid as a gesture's name, which is part of topics, addresses and column names.
fn is_topic_part(name: &str) -> bool {
    is_name(name) && !name.contains(['!', '+', '"', '\\'])
}

/// Gestures with built-in settings: name, sums, on, on_min, off, rise and hold time in seconds, largest sideways angle in degrees.
/// Reasons for the values: the gaze stays on its target when the head turns; a mouth seen from the side looks pursed; many real smiles
/// raise the upper lip (AU10) and hardly move the corners, but a wrinkled nose (AU9) raises it too, and pursed lips (AU18) move the
/// corners; in speech the jaw moves; yawns, laughter and drowsy lids rise slowly; the lids follow eyes that look down. The values of
/// `on_min` are just above what speech, glances and the other gestures reached for the hold time.
#[rustfmt::skip]
pub const PRESETS: [(&str, &str, [f32; 6]); 10] = [
    ("smile", "AU12L + AU12R + AU10L + AU10R - AU9L - AU9R - AU18 - AU26", [0.13, 0.1, 0.08, 0.25, 0.5, 40.0]),
    ("brows", "AU1L + AU1R + AU2L + AU2R", [1.3, 0.9, 0.9, 0.0, 0.15, 40.0]),
    ("mouth_open", "AU26", [0.32, 0.28, 0.2, 0.25, 0.7, 40.0]),
    ("wink_left", "AU43L - AU43R", [0.7, 0.32, 0.35, 0.0, 0.2, 30.0]),
    ("wink_right", "AU43R - AU43L", [0.7, 0.32, 0.35, 0.0, 0.2, 30.0]),
    ("blink_long", "AU43L & AU43R", [0.4, 0.3, 0.25, 0.15, 0.5, 40.0]),
    ("look_left", "AU61", [0.7, 0.6, 0.45, 0.0, 0.9, 12.0]),
    ("look_right", "AU62", [0.7, 0.6, 0.45, 0.0, 0.9, 12.0]),
    ("look_up", "AU63", [0.6, 0.36, 0.36, 0.0, 0.4, 12.0]),
    ("kiss", "AU18", [0.6, 0.3, 0.4, 0.0, 0.2, 30.0]),
];
/// Largest angle up or down at which a face makes gestures, degrees.
const PITCH_MAX_DEG: f32 = 30.0;

impl Gesture {
    /// The preset of this name; for any other name a gesture without a sum.
    pub fn named(name: &str) -> Self {
        let mut gesture = Self {
            name: name.into(),
            ..Self::default()
        };
        let preset = PRESETS.iter().find(|preset| preset.0 == name);
        if let Some(&(_, sum, [on, on_min, off, rise_s, hold_s, turned_deg])) = preset {
            gesture.of = sum.into();
            (gesture.on, gesture.off, gesture.turned_deg) = (on, off, turned_deg);
            (gesture.rise_s, gesture.hold_s, gesture.on_min) = (rise_s, hold_s, on_min);
        }
        gesture
    }

    /// Its levels.
    pub fn levels(&self) -> Levels {
        Levels {
            on: self.on,
            off: self.off,
            hold_s: self.hold_s,
            rise_s: self.rise_s,
        }
    }

    fn lesson(&self, configured: Levels) -> Lesson {
        let mut units = Self::sums(&self.of).flatten().map(|(_, unit)| unit);
        let high = units.find_map(|unit| match unit {
            "AU61" | "AU62" => Some(HIGH_OF_GAZE[0]),
            "AU63" | "AU64" => Some(HIGH_OF_GAZE[1]),
            _ => None,
        });
        let high = high.unwrap_or(HIGH);
        Lesson::new(configured, self.on_min, high)
    }

    /// Sign and unit of each term, for each sum; unit names are not checked.
    pub fn sums(text: &str) -> impl Iterator<Item = impl Iterator<Item = (f32, &str)>> {
        text.split('&').map(Self::terms)
    }

    /// Index among `units` and sign of each term, for each sum; units that are not measured are omitted.
    pub fn indexed(&self, units: &[&str]) -> Vec<Vec<(usize, f32)>> {
        let index = |(sign, unit)| Some((units.iter().position(|name| *name == unit)?, sign));
        let sums = Self::sums(&self.of).map(|terms| terms.filter_map(index).collect());
        sums.collect()
    }

    fn terms(sum: &str) -> impl Iterator<Item = (f32, &str)> {
        let signs = sum.matches(['+', '-']);
        let signs = signs.map(|sign| if sign == "-" { -1.0 } else { 1.0 });
        let signs = core::iter::once(1.0).chain(signs);
        signs.zip(sum.split(['+', '-']).map(str::trim))
    }
}

/// Message to outputs: a gesture went on or off, or its state is repeated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Switch<'a> {
    /// Index among the gestures.
    pub index: usize,
    /// The gesture.
    pub gesture: &'a Gesture,
    /// Slot of the user; only with [`Person::Each`].
    pub user: Option<usize>,
    /// Whether it is on.
    pub is_on: bool,
    /// Whether the state changed; otherwise this is a repetition.
    pub is_new: bool,
}

/// The name, with [`Person::Each`] followed by the slot: `smile`, `smile/2`.
impl core::fmt::Display for Switch<'_> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(&self.gesture.name)?;
        self.user.map_or(Ok(()), |user| write!(f, "/{user}"))
    }
}

/// Levels of a gesture, how it is being set up, and how often it went on.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SetUpFacts {
    /// Index among the gestures.
    pub index: usize,
    /// State of the set-up.
    pub state: SetUpState,
    /// Repetitions seen.
    pub seen: usize,
    /// The present levels.
    pub levels: Levels,
    /// Whether there is a change that can be undone.
    pub can_undo: bool,
    /// Activations in the last 24 hours.
    pub count: u32,
    /// Time for which anybody was tracked in the last 24 hours, seconds.
    pub tracked_s: u32,
}

/// Fields of a JSON object.
impl core::fmt::Display for SetUpFacts {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let Levels {
            on,
            off,
            hold_s,
            rise_s,
        } = self.levels;
        let Self {
            index,
            seen,
            can_undo,
            count,
            tracked_s,
            ..
        } = self;
        let state = self.state.name();
        write!(
            f,
            "\"index\":{index},\"state\":\"{state}\",\"seen\":{seen},\"on\":{on:.3}"
        )?;
        write!(
            f,
            ",\"off\":{off:.3},\"hold_s\":{hold_s:.2},\"rise_s\":{rise_s:.2},\"can_undo\":{can_undo}"
        )?;
        write!(f, ",\"count\":{count},\"tracked_s\":{tracked_s}")
    }
}

impl SetUpFacts {
    /// The arguments of the OSC message.
    pub fn to_osc(&self) -> [Argument<'static>; 10] {
        use Argument::{Bool, Float, Int};
        let Levels {
            on,
            off,
            hold_s,
            rise_s,
        } = self.levels;
        let [state, seen] = [self.state as usize, self.seen].map(|n| Int(n as i32));
        let [count, tracked_s] = [self.count, self.tracked_s].map(|n| Int(n as i32));
        let [on, off, hold_s, rise_s] = [on, off, hold_s, rise_s].map(Float);
        let index = Int(self.index as i32);
        [
            index,
            state,
            seen,
            on,
            off,
            hold_s,
            rise_s,
            Bool(self.can_undo),
            count,
            tracked_s,
        ]
    }

    /// From the arguments of an OSC message; `None` if they are not those of [`Self::to_osc`].
    #[cfg(feature = "studio")]
    pub fn from_osc(arguments: &[Argument<'_>]) -> Option<Self> {
        use Argument::{Float, Int};
        let &[
            Int(index),
            Int(state),
            Int(seen),
            Float(on),
            Float(off),
            Float(hold_s),
            Float(rise_s),
            Int(can_undo),
            Int(count),
            Int(tracked_s),
        ] = arguments
        else {
            return None;
        };
        let is_finite = [on, off, hold_s, rise_s].into_iter().all(f32::is_finite);
        let [state, seen, index] = [state, seen, index].map(usize::try_from);
        Some(Self {
            index: index.ok().filter(|&index| index < GESTURES && is_finite)?,
            state: *SetUpState::ALL.get(state.ok()?)?,
            seen: seen.ok()?,
            levels: Levels {
                on,
                off,
                hold_s,
                rise_s,
            },
            can_undo: can_undo != 0,
            count: count.try_into().ok()?,
            tracked_s: tracked_s.try_into().ok()?,
        })
    }
}

/// Message to outputs: the facts of a gesture changed, or are repeated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SetUp<'a> {
    /// Name of the gesture.
    pub name: &'a str,
    /// Its facts.
    pub facts: SetUpFacts,
}

/// Times of the last frames.
type Times = HistoryBuf<Timestamp, PAST>;

/// One person's state of one gesture.
#[derive(Default)]
struct Activation {
    is_on: bool,
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
    /// Takes the value of a frame, the last one of `times`.
    fn observe(&mut self, gesture: &Gesture, sum: f32, may_start: bool, times: &Times) {
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
    fn came_fast(&self, times: &Times, rise_s: f32) -> Option<bool> {
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

/// Speech detector of one person.
#[derive(Clone, Copy, Default)]
struct Speech {
    /// Extreme of the mouth's opening since the last reversal; `None` before the first frame.
    extreme: Option<f32>,
    /// Whether the mouth opens since then.
    is_opening: bool,
    /// Times of the last reversals, newest first.
    turns: [Option<Timestamp>; REVERSALS],
}

impl Speech {
    /// Takes the mouth's opening; returns whether the person speaks.
    fn update(&mut self, opening: f32, at: Timestamp) -> bool {
        let extreme = self.extreme.unwrap_or(opening);
        let direction = if self.is_opening { 1.0 } else { -1.0 };
        let back = direction * (extreme - opening);
        // Noise grows with the opening.
        let least = REVERSAL.max(SHARE * opening.max(extreme));
        if back > least {
            self.is_opening = !self.is_opening;
            self.turns.rotate_right(1);
            self.turns[0] = Some(at);
        }
        let is_between = (0.0..=least).contains(&back);
        self.extreme = Some(if is_between { extreme } else { opening });
        let within =
            |turn: usize, s| self.turns[turn].is_some_and(|turn| at.seconds_since(turn) < s);
        within(REVERSALS - 1, SPEECH_S) && within(0, QUIET_S)
    }
}

/// A gesture and its state for every user.
struct Watched {
    gesture: Gesture,
    /// [`Gesture::indexed`] among the weights.
    sums: Vec<Vec<(usize, f32)>>,
    activations: [Activation; USERS],
    /// State sent last: of each user, then of anybody.
    last_sent: [bool; USERS + 1],
    /// Levels of the configuration.
    configured: Levels,
    /// Levels before the last change, for undoing it.
    before: Option<Levels>,
    /// Activations in each of the last hours.
    counts: [u16; HOURS],
    /// The present facts, and those sent last.
    facts: [SetUpFacts; 2],
}

impl Watched {
    fn can_undo(&self) -> bool {
        self.before.is_some() || self.gesture.levels() != self.configured
    }

    fn set(&mut self, levels: Levels) {
        (self.gesture.on, self.gesture.off) = (levels.on, levels.off);
        (self.gesture.hold_s, self.gesture.rise_s) = (levels.hold_s, levels.rise_s);
    }

    /// Writes the configured levels, the name and the expression: saved levels are valid only while these are the same.
    fn write_identity(&self, text: &mut String) -> core::fmt::Result {
        use core::fmt::Write as _;
        let Gesture { name, of, .. } = &self.gesture;
        write!(text, "configured {} {name} = {of}", self.configured)
    }
}

/// Evaluates all gestures of all users.
pub struct Gestures {
    all: Vec<Watched>,
    /// Indices of the weights that open the mouth.
    mouth: Vec<usize>,
    speech: [Speech; USERS],
    times: [Times; USERS],
    /// Angle sideways between face and line of sight at these times, degrees.
    angles: [HistoryBuf<f32, PAST>; USERS],
    /// Schedules the repetition of all states.
    repetition: Every,
    /// Schedules the repetition of all facts.
    facts_repetition: Every,
    at: Timestamp,
    /// The gesture that is being set up, and the slot of the person.
    lesson: Option<(usize, Option<usize>, Lesson)>,
    /// Time for which anybody was tracked in each of the last hours, seconds.
    tracked_s: [f32; HOURS],
    /// Number of the present hour of capture time.
    hour: u64,
    /// Whether levels were changed since [`Self::take_change`].
    is_changed: bool,
}

impl Gestures {
    /// Gestures in the order of the configuration; `units` are the names in the order of the weights. Units that are not measured
    /// count as 0.
    pub fn new(all: &[Gesture], units: &[&str]) -> Self {
        let index = |unit: &str| units.iter().position(|name| *name == unit);
        let watched = |gesture: &Gesture| Watched {
            sums: gesture.indexed(units),
            configured: gesture.levels(),
            gesture: gesture.clone(),
            activations: Default::default(),
            last_sent: Default::default(),
            before: None,
            counts: Default::default(),
            facts: Default::default(),
        };
        let limit = if ENABLED { GESTURES } else { 0 };
        Self {
            all: all.iter().take(limit).map(watched).collect(),
            mouth: ["AU25", "AU26"].into_iter().filter_map(index).collect(),
            speech: Default::default(),
            times: Default::default(),
            angles: Default::default(),
            repetition: Every::default(),
            facts_repetition: Every::default(),
            at: Timestamp::default(),
            lesson: None,
            tracked_s: Default::default(),
            hour: 0,
            is_changed: false,
        }
    }

    /// Evaluates the reports of one frame and sets their [`Report::gestures`].
    pub fn observe(&mut self, reports: &mut [Report<'_>]) {
        if !ENABLED {
            return;
        }
        let mut is_reported = [false; USERS];
        let first = reports.first().map_or(self.at, |report| report.at);
        self.pass_time(first, reports.iter().any(|one| one.state.has_face()));
        for report in reports {
            // The source changed; earlier times are meaningless.
            if report.at < self.at {
                self.release();
            }
            self.at = report.at;
            if let Some(slot) = report.user.filter(|&slot| slot < USERS) {
                is_reported[slot] = true;
                // A face missed for a frame keeps its state.
                if report.state != TrackingState::Held {
                    self.follow(slot, report);
                }
                let all = self.all.iter().rev();
                let on = all.map(|watched| u32::from(watched.activations[slot].is_on));
                report.gestures = on.fold(0, |bits, on| bits << 1 | on);
            }
        }
        for slot in (0..USERS).filter(|&slot| !is_reported[slot]) {
            self.times[slot].clear();
            self.angles[slot].clear();
            for watched in &mut self.all {
                watched.activations[slot] = Activation::default();
            }
        }
        self.end_lesson();
    }

    fn gather_facts(&mut self) {
        for (index, watched) in self.all.iter_mut().enumerate() {
            let is_taught = self.lesson.as_mut().filter(|(of, ..)| *of == index);
            let facts = &mut watched.facts[0];
            if let Some((.., lesson)) = is_taught {
                (facts.state, facts.seen) = match lesson.awaits(self.at) {
                    Awaits::Acts(seen) => (SetUpState::Act, seen),
                    _ => (SetUpState::Rest, facts.seen),
                };
            }
            let counts = watched.counts.iter().copied().map(u32::from);
            facts.count = counts.sum();
            facts.tracked_s = self.tracked_s.iter().sum::<f32>() as u32;
            (facts.index, facts.levels) = (index, watched.gesture.levels());
            watched.facts[0].can_undo = watched.can_undo();
        }
    }

    /// Adds the time since the last frame to the tracked time, if it is less than a second, and clears the hours older than a day.
    fn pass_time(&mut self, at: Timestamp, is_tracked: bool) {
        let hour = at.as_us() / 3_600_000_000;
        let passed = hour.saturating_sub(self.hour).min(HOURS as u64);
        for ago in 0..passed {
            let old = ((hour - ago) % HOURS as u64) as usize;
            self.tracked_s[old] = 0.0;
            self.all.iter_mut().for_each(|one| one.counts[old] = 0);
        }
        self.hour = hour;
        let s = at.seconds_since(self.at) as f32;
        if is_tracked && (0.0..1.0).contains(&s) {
            self.tracked_s[(hour % HOURS as u64) as usize] += s;
        }
    }

    /// Ends a set-up that is complete, or that waited too long for a repetition.
    fn end_lesson(&mut self) {
        let Some((index, slot, mut lesson)) = self.lesson.take() else {
            return;
        };
        let now = self.all[index].gesture.levels();
        let state = match lesson.awaits(self.at) {
            Awaits::Aborted => SetUpState::Failed,
            Awaits::Nothing => match lesson.found(now) {
                Ok(found) => {
                    self.change(index, found);
                    SetUpState::Found
                }
                Err(state) => state,
            },
            _ => {
                self.lesson = Some((index, slot, lesson));
                return;
            }
        };
        let facts = &mut self.all[index].facts[0];
        (facts.state, facts.seen) = (state, teaching::REPETITIONS);
    }

    fn follow(&mut self, slot: usize, report: &Report<'_>) {
        let weight = |&unit: &usize| unit_range(report.weights.get(unit).copied().unwrap_or(0.0));
        let is_tracked = report.state == TrackingState::Tracking;
        let opening = self.mouth.iter().map(weight).sum();
        let is_speaking = is_tracked && self.speech[slot].update(opening, report.at);
        let angles = report.sensor_from_face.map_or([0.0; 2], |pose| {
            let (face, sight) = (-face_normal(pose), pose.translation.vector);
            let angles = |v: &Vector| [v.x.atan2(v.z), v.y.atan2(v.x.hypot(v.z))];
            let (face, sight) = (angles(&face), angles(&sight));
            [0, 1].map(|k| (face[k] - sight[k]).to_degrees())
        });
        self.angles[slot].write(angles[0]);
        self.times[slot].write(report.at);
        let is_turning = self.turned_deg(slot) > TURN_DEG;
        let [sideways, up] = angles.map(f32::abs);
        for (index, watched) in self.all.iter_mut().enumerate() {
            let gesture = &watched.gesture;
            let is_theirs = gesture.person != Person::Shown || !report.other_is_shown;
            let is_facing = sideways <= gesture.turned_deg && up <= PITCH_MAX_DEG;
            let sum = |terms: &Vec<_>| terms.iter().map(|(unit, sign)| sign * weight(unit)).sum();
            let least = watched.sums.iter().map(sum).fold(f32::MAX, f32::min);
            let counts = is_tracked && is_theirs && is_facing;
            // Otherwise the value is below any level.
            let sum = if counts { least } else { f32::MIN };
            let may_start = !is_turning && (gesture.speaking || !is_speaking);
            let taught = self.lesson.as_mut().filter(|(of, ..)| *of == index);
            if let Some((_, of, lesson)) = taught {
                // During its set-up a gesture switches nothing.
                let past = core::mem::take(&mut watched.activations[slot].past);
                watched.activations[slot] = Activation {
                    past,
                    ..Activation::default()
                };
                let state = &mut watched.activations[slot];
                state.past.write(sum.max(0.0));
                if counts && may_start && !report.other_is_shown {
                    let is_theirs = *of.get_or_insert(slot) == slot;
                    let came_fast = state.came_fast(&self.times[slot], watched.configured.rise_s);
                    is_theirs.then(|| lesson.observe(sum, came_fast, report.at));
                }
                continue;
            }
            watched.activations[slot].observe(gesture, sum, may_start, &self.times[slot]);
        }
    }

    /// Range of the sideways angle of a user's face within the last [`TURN_S`], degrees.
    fn turned_deg(&self, slot: usize) -> f32 {
        let (times, angles) = (&self.times[slot], &self.angles[slot]);
        let Some(at) = times.recent() else { return 0.0 };
        let all = times.oldest_ordered().zip(angles.oldest_ordered());
        let last = all.filter(|(then, _)| at.seconds_since(**then) as f32 <= TURN_S);
        let angles = last.map(|(_, angle)| *angle);
        angles.clone().fold(f32::MIN, f32::max) - angles.fold(f32::MAX, f32::min)
    }

    /// Calls `each` with every change since the last call, and every `REPEAT_S` with all states.
    pub fn for_each_switch(&mut self, mut each: impl FnMut(&Switch<'_>)) {
        if !ENABLED {
            return;
        }
        let repeat = self.repetition.due(self.at, REPEAT_S);
        for (index, watched) in self.all.iter_mut().enumerate() {
            let (gesture, activations) = (&watched.gesture, &watched.activations);
            for (slot, last_sent) in watched.last_sent.iter_mut().enumerate() {
                // The last entry stands for anybody.
                if (gesture.person == Person::Each) != (slot < USERS) {
                    continue;
                }
                let user = Some(slot).filter(|&slot| slot < USERS);
                let is_on = match user {
                    Some(user) => activations[user].is_on,
                    None => activations.iter().any(|one| one.is_on),
                };
                let is_new = core::mem::replace(last_sent, is_on) != is_on;
                if is_new && is_on {
                    let hour = (self.hour % HOURS as u64) as usize;
                    watched.counts[hour] = watched.counts[hour].saturating_add(1);
                }
                if is_new || repeat {
                    each(&Switch {
                        index,
                        gesture,
                        user,
                        is_on,
                        is_new,
                    });
                }
            }
        }
    }

    /// Switches everything off.
    pub fn release(&mut self) {
        for watched in &mut self.all {
            watched.activations = Default::default();
        }
        self.times = Default::default();
        self.angles = Default::default();
        self.speech = Default::default();
    }

    /// Calls `each` with the facts that changed since the last call, and every `REPEAT_S` with all. A longer tracked time alone is not
    /// a change.
    pub fn for_each_set_up(&mut self, mut each: impl FnMut(&SetUp<'_>)) {
        if !ENABLED {
            return;
        }
        self.gather_facts();
        let repeat = self.facts_repetition.due(self.at, REPEAT_S);
        for watched in &mut self.all {
            let [mut facts, last] = watched.facts;
            let (name, tracked_s) = (&watched.gesture.name, facts.tracked_s);
            facts.tracked_s = last.tracked_s;
            if repeat || facts != last {
                facts.tracked_s = tracked_s;
                watched.facts[1] = facts;
                each(&SetUp { name, facts });
            }
        }
    }

    /// Executes a command that changes a gesture; other commands, and those for unknown gestures, are ignored.
    pub fn execute(&mut self, command: Command) {
        let (_, index, number) = command.parts();
        if !ENABLED || index >= self.all.len() || !command.is_of_gesture() {
            return;
        }
        let watched = &mut self.all[index];
        let now = watched.gesture.levels();
        let number = f32::from(number.unwrap_or_default()) / 100.0;
        match command {
            Command::Level(..) if number > 0.0 => {
                let level = number.clamp(LEVELS[0], LEVELS[1]);
                let (on, off) = (level, now.off * level / now.on);
                self.change(index, Levels { on, off, ..now });
            }
            Command::Hold(..) => {
                let hold_s = number.min(HOLD_MAX_S);
                self.change(index, Levels { hold_s, ..now });
            }
            Command::Teach(_, true) => {
                watched.facts[0].seen = 0;
                let lesson = watched.gesture.lesson(watched.configured);
                let stopped = self.lesson.replace((index, None, lesson));
                self.stop_lesson(stopped.map(|(of, ..)| of).filter(|of| *of != index));
            }
            Command::Teach(_, false) => {
                let stopped = self.lesson.take_if(|(of, ..)| *of == index);
                self.stop_lesson(stopped.map(|(of, ..)| of));
            }
            Command::Undo(_) if watched.can_undo() => {
                let levels = watched.before.take().unwrap_or(watched.configured);
                watched.set(levels);
                watched.facts[0].state = SetUpState::None;
                self.is_changed = true;
            }
            _ => {}
        }
    }

    fn stop_lesson(&mut self, index: Option<usize>) {
        if let Some(index) = index {
            self.all[index].facts[0].state = SetUpState::None;
        }
    }

    fn change(&mut self, index: usize, levels: Levels) {
        let watched = &mut self.all[index];
        watched.before = Some(watched.gesture.levels());
        watched.set(levels);
        self.is_changed = true;
    }

    /// The present levels of a gesture.
    ///
    /// # Panics
    /// If there is no gesture with this index.
    pub fn levels(&self, index: usize) -> Levels {
        self.all[index].gesture.levels()
    }

    /// Whether levels were changed since the last call.
    pub fn take_change(&mut self) -> bool {
        core::mem::take(&mut self.is_changed)
    }

    /// Writes the levels that differ from the configured ones, a line each.
    ///
    /// # Errors
    /// If the writer fails.
    pub fn write_levels(&self, text: &mut String) -> core::fmt::Result {
        use core::fmt::Write as _;
        for watched in &self.all {
            let now = watched.gesture.levels();
            if now != watched.configured {
                write!(text, "{now} ")?;
                watched.write_identity(text)?;
                writeln!(text)?;
            }
        }
        Ok(())
    }

    /// Restores the levels that [`Self::write_levels`] wrote, except those of gestures whose configuration has changed since.
    /// Returns the number of unreadable lines.
    pub fn read_levels(&mut self, text: &str) -> usize {
        let mut own = String::new();
        let mut unreadable = 0;
        for line in text.lines() {
            let mut words = line.splitn(5, ' ');
            let mut number = || words.next()?.parse().ok().filter(|n: &f32| n.is_finite());
            let numbers = [(); 4].map(|()| number());
            let ([Some(on), Some(off), Some(hold_s), Some(rise_s)], Some(identity)) =
                (numbers, words.next())
            else {
                unreadable += 1;
                continue;
            };
            for watched in &mut self.all {
                own.clear();
                // Writing to a string does not fail.
                let _ = watched.write_identity(&mut own);
                if own == identity && (0.0..on).contains(&off) && hold_s.min(rise_s) >= 0.0 {
                    watched.set(Levels {
                        on,
                        off,
                        hold_s,
                        rise_s,
                    });
                }
            }
        }
        unreadable
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mien_stages::base::geometry::{Rigid, rotation_from_yaw_pitch_roll};

    const UNITS: [&str; 4] = ["AU12L", "AU12R", "AU25", "AU26"];

    fn milliseconds(ms: u64) -> Timestamp {
        Timestamp::from_us(1_000_000 + 1000 * ms)
    }

    fn user(slot: usize, ms: u64, weights: &[f32]) -> Report<'_> {
        Report {
            user: Some(slot),
            state: TrackingState::Tracking,
            at: milliseconds(ms),
            weights,
            ..Report::default()
        }
    }

    /// The switches since the last call, without repetitions: name, user, on or off.
    fn switches(gestures: &mut Gestures) -> Vec<(String, Option<usize>, bool)> {
        let mut all = Vec::new();
        gestures.for_each_switch(|switch| {
            if switch.is_new {
                let name = switch.gesture.name.clone();
                all.push((name, switch.user, switch.is_on));
            }
        });
        all
    }

    #[test]
    fn a_level_that_is_moved_takes_the_lower_one_along() {
        let mut gestures = Gestures::new(&[smile(Person::Shown)], &UNITS);
        gestures.execute(Command::Level(0, 55));
        gestures.execute(Command::Level(0, 0));
        gestures.execute(Command::Level(7, 100));
        let Gesture { on, off, .. } = gestures.all[0].gesture;
        assert_eq!((on, off), (0.55, 0.35));
        gestures.execute(Command::Level(0, u16::MAX));
        assert_eq!(gestures.all[0].gesture.on, 8.0);
    }

    fn smile(person: Person) -> Gesture {
        Gesture {
            person,
            of: "AU12L + AU12R".into(),
            on: 1.1,
            off: 0.7,
            hold_s: 0.2,
            rise_s: 0.0,
            ..Gesture::named("smile")
        }
    }

    #[test]
    fn a_smile_is_on_after_its_hold_time_until_it_falls_below_its_lower_level_and_not_again_before_its_pause()
     {
        let mut gestures = Gestures::new(&[smile(Person::Shown)], &UNITS);
        let mut changes = Vec::new();
        // Its levels are 1.1 and 0.7, its hold time is 0.2 s and its pause 0.3 s.
        for ms in (0..2000).step_by(20) {
            let sum = match ms {
                100..400 | 420..600 | 700..1400 => 1.2,
                400..420 | 600..700 => 0.6,
                1400..1500 => 0.8,
                _ => 0.0,
            };
            let weights = [sum / 2.0, sum / 2.0, 0.0, 0.0];
            let mut reports = [user(0, ms, &weights)];
            gestures.observe(&mut reports);
            for (_, _, is_on) in switches(&mut gestures) {
                changes.push((ms, is_on));
                assert_eq!(reports[0].gestures, u32::from(is_on));
            }
        }
        // The smile from 420 to 600 ms is shorter than the hold time and within the pause; that from 700 ms counts.
        assert_eq!(
            changes,
            [(300, true), (400, false), (900, true), (1500, false)]
        );
    }

    #[test]
    fn of_several_sums_the_least_counts() {
        let both = Gesture {
            of: "AU12L & AU12R - AU26".into(),
            ..smile(Person::Shown)
        };
        for (weights, expected) in [
            ([0.9, 0.2, 0.0, 0.0], 0),
            ([0.2, 0.9, 0.0, 0.0], 0),
            ([0.6, 0.9, 0.0, 0.5], 0),
            ([0.6, 0.9, 0.0, 0.3], 1),
        ] {
            let mut gestures = Gestures::new(std::slice::from_ref(&both), &UNITS);
            gestures.execute(Command::Level(0, 50));
            for ms in (0..500).step_by(50) {
                let mut reports = [user(0, ms, &weights)];
                gestures.observe(&mut reports);
                let since = if ms < 200 { 0 } else { expected };
                assert_eq!(reports[0].gestures, since, "{weights:?}");
            }
        }
    }

    #[test]
    fn every_end_of_a_face_is_an_off() {
        let faces = [0.9, 0.9, 0.0, 0.0];
        for end in [
            "lost", "absent", "gone", "clock", "end", "turned", "nodded", "aside",
        ] {
            let mut gestures = Gestures::new(&[smile(Person::Shown)], &UNITS);
            for ms in [0, 100, 200] {
                gestures.observe(&mut [user(1, ms, &faces)]);
            }
            let on = [("smile".to_owned(), None, true)];
            assert_eq!(switches(&mut gestures), on, "{end}");
            // If the face is missed for a frame, the gesture stays on.
            gestures.observe(&mut [Report {
                state: TrackingState::Held,
                ..user(1, 233, &faces)
            }]);
            assert_eq!(switches(&mut gestures), [], "{end}");
            let [turned, nodded] = [[0.8, 0.0], [0.0, 0.6]].map(|[yaw, pitch]| {
                let turn = rotation_from_yaw_pitch_roll(yaw, pitch, 0.0);
                Rigid::from_parts(Vector::new(0.0, 0.0, 0.8).into(), turn)
            });
            let mut now = user(1, 266, &faces);
            match end {
                "lost" => now.state = TrackingState::Lost,
                "absent" => now.state = TrackingState::Absent,
                "gone" => now.user = None,
                "turned" => now.sensor_from_face = Some(&turned),
                "nodded" => now.sensor_from_face = Some(&nodded),
                "clock" => now = user(1, 0, &faces),
                "aside" => now.other_is_shown = true,
                _ => {}
            }
            match end {
                "end" => gestures.release(),
                _ => gestures.observe(&mut [now]),
            }
            let off = [("smile".to_owned(), None, false)];
            assert_eq!(switches(&mut gestures), off, "{end}");
        }
    }

    #[test]
    fn whose_gesture_it_is_decides_who_is_told_of() {
        let (smiles, rests) = ([0.9, 0.9, 0.0, 0.0], [0.0; 4]);
        let all = [
            smile(Person::Shown),
            Gesture {
                name: "any".into(),
                ..smile(Person::Any)
            },
            Gesture {
                name: "each".into(),
                ..smile(Person::Each)
            },
        ];
        let mut gestures = Gestures::new(&all, &UNITS);
        for ms in [0, 100, 200] {
            let other = Report {
                other_is_shown: true,
                ..user(2, ms, &smiles)
            };
            gestures.observe(&mut [user(0, ms, &rests), other]);
        }
        let on = [
            ("any".to_owned(), None, true),
            ("each".to_owned(), Some(2), true),
        ];
        assert_eq!(switches(&mut gestures), on);
    }

    #[test]
    fn who_speaks_does_not_smile_unless_the_gesture_says_so() {
        let speaking = Gesture {
            name: "speaking".into(),
            speaking: true,
            ..smile(Person::Shown)
        };
        let mut gestures = Gestures::new(&[smile(Person::Shown), speaking], &UNITS);
        let mut on = Vec::new();
        for frame in 0..300_u64 {
            let s = frame as f32 / 30.0;
            // Four syllables a second until 6 s, then silence; a smile from 3 s on.
            let opening = if s < 6.0 {
                0.15 + 0.12 * (s * 8.0 * core::f32::consts::PI).sin()
            } else {
                0.05
            };
            let smiles = if s > 3.0 { 0.9 } else { 0.1 };
            let weights = [smiles, smiles, opening, opening];
            gestures.observe(&mut [user(0, frame * 1000 / 30, &weights)]);
            let switches = switches(&mut gestures).into_iter();
            on.extend(switches.map(|(name, _, _)| (name, s)));
        }
        let names: Vec<&str> = on.iter().map(|(name, _)| name.as_str()).collect();
        assert_eq!(names, ["speaking", "smile"]);
        assert!(
            (3.2..3.4).contains(&on[0].1) && (6.4..7.0).contains(&on[1].1),
            "{on:?}"
        );
    }

    #[test]
    fn eyes_that_fall_shut_a_yawn_and_a_laugh_do_not_switch_unless_the_gesture_says_so() {
        for (name, units) in [
            ("blink_long", ["AU43L", "AU43R"]),
            ("mouth_open", ["AU26", "AU6L"]),
            ("smile", ["AU12L", "AU12R"]),
        ] {
            let any = Gesture {
                name: "any".into(),
                rise_s: 0.0,
                ..Gesture::named(name)
            };
            let made_within = |seconds: f32| {
                let mut gestures = Gestures::new(&[Gesture::named(name), any.clone()], &units);
                let mut on = Vec::new();
                for frame in 0..150_u64 {
                    let height = ((frame as f32 / 30.0 - 1.0) / seconds).clamp(0.0, 1.0);
                    gestures.observe(&mut [user(0, frame * 1000 / 30, &[height, height])]);
                    on.extend(switches(&mut gestures).into_iter().map(|(name, ..)| name));
                }
                on
            };
            assert_eq!(made_within(0.25), [name, "any"]);
            assert_eq!(made_within(1.6), ["any"], "{name}");
        }
    }

    #[test]
    fn a_head_that_turns_does_not_switch_until_it_rests() {
        let mut gestures = Gestures::new(&[smile(Person::Shown)], &UNITS);
        let mut on = Vec::new();
        for frame in 0..90_u64 {
            // The head turns by 40° between 1 and 2 s; the smile begins at 1.1 s.
            let s = frame as f32 / 30.0;
            let yaw = (40.0 * (s - 1.0).clamp(0.0, 1.0) - 20.0).to_radians();
            let turn = rotation_from_yaw_pitch_roll(yaw, 0.0, 0.0);
            let pose = Rigid::from_parts(Vector::new(0.0, 0.0, 0.8).into(), turn);
            let smiles = if s < 1.1 { 0.0 } else { 0.9 };
            let weights = [smiles, smiles, 0.0, 0.0];
            gestures.observe(&mut [Report {
                sensor_from_face: Some(&pose),
                ..user(0, frame * 1000 / 30, &weights)
            }]);
            on.extend(switches(&mut gestures).into_iter().map(|_| s));
        }
        assert!(on.len() == 1 && (2.2..2.6).contains(&on[0]), "{on:?}");
    }

    #[test]
    fn a_mouth_held_open_may_tremble_without_speaking() {
        let mut speech = Speech::default();
        for frame in 0..90_u64 {
            let s = frame as f32 / 30.0;
            let opening = 1.2 + 0.1 * (s * 8.0 * core::f32::consts::PI).sin();
            assert!(!speech.update(opening, Timestamp::from_us(frame * 33_333)));
        }
    }

    #[test]
    fn presets_read_units_that_are_measured() {
        let known = mien_stages::expression::Units::shipped();
        let names = known.columns(false);
        for (name, text, [on, on_min, off, ..]) in PRESETS {
            for terms in Gesture::sums(text) {
                let terms: Vec<(f32, &str)> = terms.collect();
                for (_, unit) in &terms {
                    let is_known = names.iter().any(|known| known.as_str() == *unit);
                    assert!(is_known, "{name}: {unit}");
                }
                assert!(off < on && on_min <= on && on < terms.len() as f32);
            }
        }
        for (text, expected) in [
            ("AU1L", "+AU1L"),
            ("AU1L -AU1R+AU26", "+AU1L -AU1R +AU26"),
            ("AU1L +", "+AU1L +"),
            ("", "+"),
            ("AU1L AU1R", "+AU1L AU1R"),
            ("AU1L - AU4L&AU1R", "+AU1L -AU4L & +AU1R"),
            ("AU1L &", "+AU1L & +"),
        ] {
            let sums = Gesture::sums(text).map(|terms| {
                let sign = |sign| if sign < 0.0 { '-' } else { '+' };
                let terms = terms.map(|(s, unit)| format!("{}{unit}", sign(s)));
                terms.collect::<Vec<_>>().join(" ")
            });
            assert_eq!(sums.collect::<Vec<_>>().join(" & "), expected, "{text}");
        }
    }

    /// Plays a rest of four seconds and five smiles of a weight, with a second of rest after each, by the person in a slot.
    fn five_smiles(gestures: &mut Gestures, start_ms: u64, slot: usize, weight: f32) -> u64 {
        let mut ms = start_ms;
        while ms < start_ms + 14_000 {
            let within = (ms - start_ms).saturating_sub(4000) % 2000;
            let is_smiling = ms > start_ms + 4000 && within < 1000;
            let smile = if is_smiling { weight } else { 0.02 };
            let rest = user(1 - slot, ms, &[0.02, 0.02, 0.0, 0.0]);
            let smiles = [smile, smile, 0.0, 0.0];
            let other_is_shown = slot == 1;
            let smiler = user(slot, ms, &smiles);
            gestures.observe(&mut [
                Report {
                    other_is_shown,
                    ..smiler
                },
                Report {
                    other_is_shown: !other_is_shown,
                    ..rest
                },
            ]);
            ms += 33;
        }
        ms
    }

    fn facts(gestures: &mut Gestures) -> SetUpFacts {
        let mut last = SetUpFacts::default();
        gestures.at = Timestamp::from_us(gestures.at.as_us() + 2_000_000);
        gestures.for_each_set_up(|set_up| last = set_up.facts);
        last
    }

    #[test]
    fn a_smile_made_five_times_is_found_switches_nothing_meanwhile_and_can_be_undone() {
        let mut gestures = Gestures::new(&[smile(Person::Any)], &UNITS);
        let before = gestures.levels(0);
        gestures.execute(Command::Teach(0, true));
        // Expressions of a person who is not shown do not count.
        let ms = five_smiles(&mut gestures, 0, 1, 0.9);
        let told = facts(&mut gestures);
        assert_eq!((told.state, told.seen), (SetUpState::Act, 0));
        gestures.execute(Command::Teach(0, false));
        assert_eq!(facts(&mut gestures).state, SetUpState::None);

        gestures.execute(Command::Teach(0, true));
        let ms = five_smiles(&mut gestures, ms, 0, 0.9);
        assert_eq!(switches(&mut gestures), []);
        let told = facts(&mut gestures);
        assert_eq!((told.state, told.seen), (SetUpState::Found, 5));
        // 34 % of the way from 0.04 to 1.8, in steps of 4 %.
        assert!((0.6..0.65).contains(&told.levels.on), "{told:?}");
        assert!(told.can_undo && gestures.take_change());

        // Weaker smiles: their sum of 1.0 is below the old level of 1.1.
        five_smiles(&mut gestures, ms, 0, 0.5);
        let told = facts(&mut gestures);
        assert!(told.count == 0 && told.tracked_s > 30);
        gestures.execute(Command::Undo(0));
        let told = facts(&mut gestures);
        assert!(told.levels == before && !told.can_undo);
    }

    #[test]
    fn somebody_who_smiles_slowly_five_times_has_no_limit_to_the_rise_afterwards() {
        let mut gestures = Gestures::new(&[Gesture::named("smile")], &["AU12L", "AU12R"]);
        let mut frame = 0_u64;
        // Five seconds, with a smile from the first to the fourth; returns how often it switched.
        let mut smile = |gestures: &mut Gestures, weight: f32, rise_s: f32| {
            let mut count = 0;
            for k in 0..150 {
                let s = k as f32 / 30.0;
                let share = ((s - 1.0) / rise_s).min((4.0 - s) / rise_s);
                let weights = [weight * share.clamp(0.0, 1.0); 2];
                gestures.observe(&mut [user(0, frame * 1000 / 30, &weights)]);
                count += switches(gestures).len();
                frame += 1;
            }
            count
        };
        assert_eq!(smile(&mut gestures, 0.9, 1.2), 0);
        for (rise_s, limit_s) in [(1.2, 0.0), (0.2, 0.25)] {
            gestures.execute(Command::Teach(0, true));
            smile(&mut gestures, 0.0, 1.0);
            for _ in 0..5 {
                assert_eq!(smile(&mut gestures, 0.9, rise_s), 0);
            }
            assert_eq!(facts(&mut gestures).state, SetUpState::Found);
            assert_eq!(gestures.levels(0).rise_s, limit_s);
            assert_eq!(smile(&mut gestures, 0.9, rise_s), 2);
        }
    }

    #[test]
    fn activations_of_the_last_day_are_counted() {
        let mut gestures = Gestures::new(&[smile(Person::Shown)], &UNITS);
        let hour_ms = 3_600_000;
        for hour in 0..30 {
            for ms in (0..1500).step_by(100) {
                let smile = if ms < 1000 { 0.9 } else { 0.0 };
                let weights = [smile, smile, 0.0, 0.0];
                gestures.observe(&mut [user(0, hour * hour_ms + ms, &weights)]);
                gestures.for_each_switch(|_| ());
            }
        }
        let told = facts(&mut gestures);
        assert_eq!((told.count, told.tracked_s), (24, 33));
    }

    #[test]
    fn receivers_are_told_again() {
        let mut gestures = Gestures::new(&[smile(Person::Shown)], &UNITS);
        let mut times = Vec::new();
        for ms in (0..5000).step_by(100) {
            gestures.observe(&mut [user(0, ms, &[0.0; 4])]);
            gestures.for_each_switch(|switch| times.push((ms, switch.is_on)));
        }
        assert_eq!(times, [(0, false), (2000, false), (4000, false)]);
    }
}
