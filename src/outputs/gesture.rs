//! Gestures: expressions that switch something, as a raised brow that presses a key.
//!
//! A gesture reads a sum of units, or the least of several. It goes on when that has been at its upper level for its hold
//! time, but not while the person has the head turned away or is not known yet, nor before its pause is over, and while they
//! speak only at twice that level; and off below its lower level.
//! Every on has an off: also when the head turns away, the face is lost, the person leaves, the source falls silent, the
//! configuration changes or the run ends.
//!
//! Somebody speaks while their mouth opens and closes again and again: at least [`REVERSALS`] turns of at least [`REVERSAL`]
//! and a [`SHARE`] of the opening within [`SPEECH_S`], the last of them less than [`QUIET_S`] ago.
//!
//! Weights 0…1, seconds of capture time, degrees. Memory: fixed, about 2 kB.

use super::report::{Report, unit_range};
use super::view::{is_name, is_unit};
use mien_stages::base::capacity::{GESTURES, USERS};
use mien_stages::base::geometry::{Vector, face_normal};
use mien_stages::base::prelude::*;
use mien_stages::base::settings::keyed;
use mien_stages::base::time::Timestamp;
use mien_stages::users::TrackingState;

/// Whether this build has gestures.
pub const ENABLED: bool = cfg!(any(test, feature = "wires"));
/// Turns of the mouth that make speech, how far each goes, and within how long.
const REVERSALS: usize = 4;
const REVERSAL: f32 = 0.15;
const SHARE: f32 = 0.2;
const SPEECH_S: f64 = 1.2;
const QUIET_S: f64 = 0.4;
/// Somebody who speaks still makes a gesture at this multiple of its upper level: a broad smile is no speech.
const SPEAKING_FACTOR: f32 = 2.0;
/// Least and greatest upper level.
pub const LEVELS: [f32; 2] = [0.01, 8.0];
/// The state of every gesture is repeated at this interval, for receivers that missed a change.
const REPEAT_S: f64 = 2.0;

/// Whose gesture it is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Person {
    /// Of the person that single-person outputs show.
    #[default]
    Shown,
    /// On while anybody makes it.
    Any,
    /// Of everybody by themselves.
    Each,
}

/// How a key is pressed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Press {
    /// Down and up again at once: a key that stays down repeats.
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
        /// Level below which it goes off.
        off: f32 = 0.4 => number(0.0, 8.0, ""),
        /// How long the level must be kept before it goes on.
        hold_s: f32 = 0.2 => seconds(),
        /// Shortest time from going off to going on again.
        pause_s: f32 = 0.3 => seconds(),
        /// Whose expression counts: that of the person in single-person outputs, anybody's, or each person's separately.
        person: Person = Person::default() =>
            choice(&[("shown", Person::Shown), ("any", Person::Any), ("each", Person::Each)]),
        /// Whether it goes on at its level while the person speaks; if false, only at twice that level.
        speaking: bool = false => Bool(),
        /// Largest sideways angle between the face and the line of sight.
        turned_deg: f32 = 30.0 => number(1.0, 90.0, "degrees"),
        /// Key that it presses; empty = none.
        key: String = String::new() =>
            Text("a key such as \"space\", \"a\", \"page_down\", \"mouse_left\", or empty", is_key),
        /// Whether the key is tapped once, or held down while the gesture is on.
        press: Press = Press::default() => choice(&[("tap", Press::Tap), ("hold", Press::Hold)]),
    }
}

/// Longest sum, bytes: every unit once.
const SUM_MOST: usize = 512;

/// Whether a text is a sum of units, or several joined by `&`.
fn is_sum(text: &str) -> bool {
    text.len() <= SUM_MOST && Gesture::sums(text).flatten().all(|(_, unit)| is_unit(unit))
}

/// Whether there is such a key; a build that presses none believes any.
fn is_key(name: &str) -> bool {
    #[cfg(feature = "wires")]
    let is_known = super::key_codes::is_key;
    #[cfg(not(feature = "wires"))]
    let is_known = is_name;
    name.is_empty() || is_known(name)
}

/// Whether a gesture may be called so: its name is a part of topics and addresses, and a column.
fn is_topic_part(name: &str) -> bool {
    is_name(name) && !name.contains(['!', '+', '"', '\\'])
}

/// Gestures that need no more than their name: name, sums, on, off, hold time, largest angle sideways. Eyes stay on what they
/// look at when the head turns; a mouth seen from the side looks pursed. Many real smiles bare teeth and hardly move the
/// corners; in speech the jaw moves.
#[rustfmt::skip]
pub const PRESETS: [(&str, &str, f32, f32, f32, f32); 10] = [
    ("smile", "AU12L + AU12R + AU10L + AU10R - AU26", 0.25, 0.15, 0.5, 40.0),
    ("brows", "AU1L + AU1R + AU2L + AU2R", 1.3, 0.9, 0.15, 40.0),
    ("mouth_open", "AU26", 0.32, 0.2, 0.7, 40.0),
    ("wink_left", "AU43L - AU43R", 0.7, 0.35, 0.2, 30.0),
    ("wink_right", "AU43R - AU43L", 0.7, 0.35, 0.2, 30.0),
    ("blink_long", "AU43L & AU43R", 0.25, 0.15, 0.5, 40.0),
    ("look_left", "AU61", 0.7, 0.45, 0.9, 12.0),
    ("look_right", "AU62", 0.7, 0.45, 0.9, 12.0),
    ("look_up", "AU63", 0.55, 0.33, 0.4, 12.0),
    ("kiss", "AU18", 0.6, 0.4, 0.2, 30.0),
];
/// A face that is turned up or down by more makes no gestures, degrees: the sensor stands above what it looks at.
const NODDED_DEG: f32 = 30.0;

impl Gesture {
    /// A preset, or for another name one that still needs its sum.
    pub fn named(name: &str) -> Self {
        let mut gesture = Self {
            name: name.into(),
            ..Self::default()
        };
        if let Some((_, of, on, off, hold_s, turned_deg)) = PRESETS.iter().find(|p| p.0 == name) {
            gesture.of = (*of).into();
            (gesture.on, gesture.off) = (*on, *off);
            (gesture.hold_s, gesture.turned_deg) = (*hold_s, *turned_deg);
        }
        gesture
    }

    /// Signs and units of each sum; what is no unit stays as it is.
    pub fn sums(of: &str) -> impl Iterator<Item = impl Iterator<Item = (f32, &str)>> {
        of.split('&').map(Self::terms)
    }

    /// Indices of the units among `units`, and signs, of each sum; units that are not measured are left out.
    pub fn indexed(&self, units: &[&str]) -> Vec<Vec<(usize, f32)>> {
        let index = |(sign, unit)| Some((units.iter().position(|name| *name == unit)?, sign));
        let sums = Self::sums(&self.of);
        sums.map(|terms| terms.filter_map(index).collect())
            .collect()
    }

    fn terms(of: &str) -> impl Iterator<Item = (f32, &str)> {
        let signs = of
            .matches(['+', '-'])
            .map(|sign| if sign == "-" { -1.0 } else { 1.0 });
        let signs = core::iter::once(1.0).chain(signs);
        signs.zip(of.split(['+', '-']).map(str::trim))
    }
}

/// What an output is told: a gesture went on or off, or is repeated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Switch<'a> {
    /// Its number among the gestures.
    pub index: usize,
    /// The gesture.
    pub gesture: &'a Gesture,
    /// Slot of the user, of a gesture of each.
    pub user: Option<usize>,
    /// Whether it is on.
    pub is_on: bool,
    /// Whether it was not before; otherwise this is a repetition.
    pub is_new: bool,
}

/// The name, of each with the slot: `smile`, `smile/2`.
impl core::fmt::Display for Switch<'_> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(&self.gesture.name)?;
        self.user.map_or(Ok(()), |user| write!(f, "/{user}"))
    }
}

/// One person's state of one gesture.
#[derive(Clone, Copy, Default)]
struct Activation {
    is_on: bool,
    /// Since when the sum is at its level, and when it went off last.
    since: Option<Timestamp>,
    off_at: Option<Timestamp>,
}

impl Activation {
    fn observe(&mut self, gesture: &Gesture, sum: f32, may_start: bool, at: Timestamp) {
        if self.is_on {
            if sum < gesture.off {
                *self = Self::default();
                self.off_at = Some(at);
            }
        } else if sum >= gesture.on && may_start {
            let since = *self.since.get_or_insert(at);
            let rested = |off| at.seconds_since(off) as f32 >= gesture.pause_s;
            self.is_on =
                at.seconds_since(since) as f32 >= gesture.hold_s && self.off_at.is_none_or(rested);
        } else {
            self.since = None;
        }
    }
}

/// Whether somebody speaks.
#[derive(Clone, Copy, Default)]
struct Speech {
    /// The last extreme of the mouth's opening, and whether it opens since.
    extreme: f32,
    opens: bool,
    /// When the last turns were, newest first.
    turns: [Option<Timestamp>; REVERSALS],
}

impl Speech {
    /// Takes the mouth's opening; returns whether the person speaks.
    fn update(&mut self, opening: f32, at: Timestamp) -> bool {
        let back = if self.opens {
            self.extreme - opening
        } else {
            opening - self.extreme
        };
        // A mouth held wide open trembles more than a closed one.
        let least = REVERSAL.max(SHARE * opening.max(self.extreme));
        if back > least {
            self.opens = !self.opens;
            self.turns.rotate_right(1);
            self.turns[0] = Some(at);
        }
        if !(0.0..=least).contains(&back) {
            self.extreme = opening;
        }
        let within =
            |turn: usize, s| self.turns[turn].is_some_and(|turn| at.seconds_since(turn) < s);
        within(REVERSALS - 1, SPEECH_S) && within(0, QUIET_S)
    }
}

/// A gesture, and who makes it.
struct Watched {
    gesture: Gesture,
    /// [`Gesture::indexed`] among the weights.
    sums: Vec<Vec<(usize, f32)>>,
    activations: [Activation; USERS],
    /// What outputs were told last: of each user, and of anybody.
    last_sent: [bool; USERS + 1],
}

/// The gestures of everybody.
pub struct Gestures {
    all: Vec<Watched>,
    /// Weights that open the mouth.
    mouth: Vec<usize>,
    speech: [Speech; USERS],
    /// When everything was told last.
    repeated: Option<Timestamp>,
    at: Timestamp,
}

impl Gestures {
    /// `units` are the names in the order of the weights. Units that are not measured count as 0.
    pub fn new(all: &[Gesture], units: &[&str]) -> Self {
        let index = |unit: &str| units.iter().position(|name| *name == unit);
        let watched = |gesture: &Gesture| Watched {
            sums: gesture.indexed(units),
            gesture: gesture.clone(),
            activations: Default::default(),
            last_sent: Default::default(),
        };
        let most = if ENABLED { GESTURES } else { 0 };
        Self {
            all: all.iter().take(most).map(watched).collect(),
            mouth: ["AU25", "AU26"].into_iter().filter_map(index).collect(),
            speech: Default::default(),
            repeated: None,
            at: Timestamp::default(),
        }
    }

    /// Follows everybody of a frame; [`Report::gestures`] then says which of theirs are on.
    pub fn observe(&mut self, reports: &mut [Report<'_>]) {
        if !ENABLED {
            return;
        }
        let mut seen = [false; USERS];
        for report in reports {
            // Another clock; times before it mean nothing.
            if report.at < self.at {
                self.release();
            }
            self.at = report.at;
            if let Some(slot) = report.user.filter(|&slot| slot < USERS) {
                seen[slot] = true;
                // A face that is missed in a frame keeps what it does.
                if report.state != TrackingState::Held {
                    self.follow(slot, report);
                }
                let all = self.all.iter().rev();
                let on = all.map(|watched| u32::from(watched.activations[slot].is_on));
                report.gestures = on.fold(0, |bits, on| bits << 1 | on);
            }
        }
        for slot in (0..USERS).filter(|&slot| !seen[slot]) {
            for watched in &mut self.all {
                watched.activations[slot] = Activation::default();
            }
        }
    }

    fn follow(&mut self, slot: usize, report: &Report<'_>) {
        let weight = |&unit: &usize| unit_range(report.weights.get(unit).copied().unwrap_or(0.0));
        let sees = report.state == TrackingState::Tracking;
        let opening = self.mouth.iter().map(weight).sum();
        let speaks = sees && self.speech[slot].update(opening, report.at);
        let [sideways, up] = report.sensor_from_face.map_or([0.0; 2], |pose| {
            let (face, sight) = (-face_normal(pose), pose.translation.vector);
            let angles = |v: &Vector| [v.x.atan2(v.z), v.y.atan2(v.x.hypot(v.z))];
            let (face, sight) = (angles(&face), angles(&sight));
            [0, 1].map(|k| (face[k] - sight[k]).abs().to_degrees())
        });
        for watched in &mut self.all {
            let gesture = &watched.gesture;
            let theirs = gesture.person != Person::Shown || !report.other_is_shown;
            let counts = sees && theirs && sideways <= gesture.turned_deg && up <= NODDED_DEG;
            let sum = |terms: &Vec<_>| terms.iter().map(|(unit, sign)| sign * weight(unit)).sum();
            let least = watched.sums.iter().map(sum).fold(f32::MAX, f32::min);
            // Less than any level.
            let sum = if counts { least } else { f32::MIN };
            let may_start = gesture.speaking || !speaks || sum >= SPEAKING_FACTOR * gesture.on;
            watched.activations[slot].observe(gesture, sum, may_start, report.at);
        }
    }

    /// Calls `each` with what has changed since the last call, and from time to time with everything.
    pub fn for_each_switch(&mut self, mut each: impl FnMut(&Switch<'_>)) {
        if !ENABLED {
            return;
        }
        let last = self.repeated.map(|last| self.at.seconds_since(last));
        // Before the last time only by another clock.
        let again = last.is_none_or(|last| !(0.0..REPEAT_S).contains(&last));
        if again {
            self.repeated = Some(self.at);
        }
        for (index, watched) in self.all.iter_mut().enumerate() {
            let (gesture, activations) = (&watched.gesture, &watched.activations);
            for (slot, last_sent) in watched.last_sent.iter_mut().enumerate() {
                // Behind the users, anybody.
                if (gesture.person == Person::Each) != (slot < USERS) {
                    continue;
                }
                let user = Some(slot).filter(|&slot| slot < USERS);
                let is_on = match user {
                    Some(user) => activations[user].is_on,
                    None => activations.iter().any(|one| one.is_on),
                };
                let is_new = core::mem::replace(last_sent, is_on) != is_on;
                if is_new || again {
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

    /// Everything off, as if nobody had ever been there.
    pub fn release(&mut self) {
        for watched in &mut self.all {
            watched.activations = Default::default();
        }
        self.speech = Default::default();
    }

    /// Moves the levels of a gesture, until the configuration is read again; within what a configuration may say.
    pub fn set_level(&mut self, index: usize, on: f32) {
        if let Some(Watched { gesture, .. }) = self.all.get_mut(index).filter(|_| on > 0.0) {
            let on = on.clamp(LEVELS[0], LEVELS[1]);
            gesture.off *= on / gesture.on;
            gesture.on = on;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mien_stages::base::geometry::{Rigid, rotation_from_yaw_pitch_roll};

    const UNITS: [&str; 4] = ["AU12L", "AU12R", "AU25", "AU26"];

    fn at(ms: u64) -> Timestamp {
        Timestamp::from_us(1_000_000 + 1000 * ms)
    }

    fn user(slot: usize, ms: u64, weights: &[f32]) -> Report<'_> {
        Report {
            user: Some(slot),
            state: TrackingState::Tracking,
            at: at(ms),
            weights,
            ..Report::default()
        }
    }

    /// What outputs are told, repetitions left out: name, user, on or off.
    fn told(gestures: &mut Gestures) -> Vec<(String, Option<usize>, bool)> {
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
        gestures.set_level(0, 0.55);
        gestures.set_level(0, 0.0);
        gestures.set_level(7, 1.0);
        let Gesture { on, off, .. } = gestures.all[0].gesture;
        assert_eq!((on, off), (0.55, 0.35));
        gestures.set_level(0, 655.35);
        assert_eq!(gestures.all[0].gesture.on, 8.0);
    }

    fn smile(person: Person) -> Gesture {
        Gesture {
            person,
            of: "AU12L + AU12R".into(),
            on: 1.1,
            off: 0.7,
            hold_s: 0.2,
            ..Gesture::named("smile")
        }
    }

    #[test]
    fn a_smile_is_on_after_its_hold_time_until_it_falls_below_its_lower_level_and_not_again_before_its_pause()
     {
        let mut gestures = Gestures::new(&[smile(Person::Shown)], &UNITS);
        let mut changes = Vec::new();
        // 1.1 and 0.7 are its levels, 0.2 s and 0.3 s its times.
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
            for (_, _, is_on) in told(&mut gestures) {
                changes.push((ms, is_on));
                assert_eq!(reports[0].gestures, u32::from(is_on));
            }
        }
        // Held since 420 ms it was too soon: off until 600; held since 700, long enough after.
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
            gestures.set_level(0, 0.5);
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
            assert_eq!(
                told(&mut gestures),
                [("smile".to_owned(), None, true)],
                "{end}"
            );
            // Missed for a frame, it stays.
            gestures.observe(&mut [Report {
                state: TrackingState::Held,
                ..user(1, 233, &faces)
            }]);
            assert_eq!(told(&mut gestures), [], "{end}");
            let [turned, nodded] = [[0.8, 0.0], [0.0, 0.6]].map(|[yaw, pitch]| {
                Rigid::from_parts(
                    Vector::new(0.0, 0.0, 0.8).into(),
                    rotation_from_yaw_pitch_roll(yaw, pitch, 0.0),
                )
            });
            let now = user(1, 266, &faces);
            match end {
                "lost" => gestures.observe(&mut [Report {
                    state: TrackingState::Lost,
                    ..now
                }]),
                "absent" => gestures.observe(&mut [Report {
                    state: TrackingState::Absent,
                    ..now
                }]),
                "gone" => gestures.observe(&mut [Report { user: None, ..now }]),
                "turned" | "nodded" => gestures.observe(&mut [Report {
                    sensor_from_face: Some(if end == "turned" { &turned } else { &nodded }),
                    ..now
                }]),
                "clock" => gestures.observe(&mut [user(1, 0, &faces)]),
                "aside" => gestures.observe(&mut [Report {
                    other_is_shown: true,
                    ..now
                }]),
                _ => gestures.release(),
            }
            assert_eq!(
                told(&mut gestures),
                [("smile".to_owned(), None, false)],
                "{end}"
            );
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
        assert_eq!(told(&mut gestures), on);
    }

    #[test]
    fn who_speaks_does_not_smile_unless_broadly_or_the_gesture_says_so() {
        let speaking = Gesture {
            name: "speaking".into(),
            speaking: true,
            ..smile(Person::Shown)
        };
        // 1.8 is acted, twice the level.
        let broad = Gesture {
            name: "broad".into(),
            on: 0.9,
            ..smile(Person::Shown)
        };
        let mut gestures = Gestures::new(&[smile(Person::Shown), speaking, broad], &UNITS);
        let mut on = Vec::new();
        for frame in 0..300_u64 {
            let s = frame as f32 / 30.0;
            // Syllables, four a second, and a smile from the third second on; then silence.
            let opening = if s < 6.0 {
                0.15 + 0.12 * (s * 8.0 * core::f32::consts::PI).sin()
            } else {
                0.05
            };
            let smiles = if s > 3.0 { 0.9 } else { 0.1 };
            gestures.observe(&mut [user(
                0,
                frame * 1000 / 30,
                &[smiles, smiles, opening, opening],
            )]);
            on.extend(
                told(&mut gestures)
                    .into_iter()
                    .map(|(name, _, _)| (name, s)),
            );
        }
        let names: Vec<&str> = on.iter().map(|(name, _)| name.as_str()).collect();
        assert_eq!(names, ["speaking", "broad", "smile"]);
        let soon = on[..2].iter().all(|(_, s)| (3.2..3.4).contains(s));
        assert!(soon && (6.4..7.0).contains(&on[2].1), "{on:?}");
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
        for (name, of, on, off, ..) in PRESETS {
            for terms in Gesture::sums(of) {
                let terms: Vec<(f32, &str)> = terms.collect();
                for (_, unit) in &terms {
                    assert!(
                        names.iter().any(|known| known.as_str() == *unit),
                        "{name}: {unit}"
                    );
                }
                assert!(off < on && on < terms.len() as f32);
            }
        }
        for (of, expected) in [
            ("AU1L", "+AU1L"),
            ("AU1L -AU1R+AU26", "+AU1L -AU1R +AU26"),
            ("AU1L +", "+AU1L +"),
            ("", "+"),
            ("AU1L AU1R", "+AU1L AU1R"),
            ("AU1L - AU4L&AU1R", "+AU1L -AU4L & +AU1R"),
            ("AU1L &", "+AU1L & +"),
        ] {
            let sums = Gesture::sums(of).map(|terms| {
                let sign = |sign| if sign < 0.0 { '-' } else { '+' };
                let terms = terms.map(|(s, unit)| format!("{}{unit}", sign(s)));
                terms.collect::<Vec<_>>().join(" ")
            });
            assert_eq!(sums.collect::<Vec<_>>().join(" & "), expected, "{of}");
        }
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
