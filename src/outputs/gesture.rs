//! Gestures: expressions used as switches, such as a raised brow that presses a key.
//!
//! A gesture evaluates a sum of units, or the smallest of several sums. It goes on when the value has been at the upper level for
//! the hold time, and off below the lower level. It does not go on while the head turns or is turned away, before the face is tracked,
//! before the pause is over, during speech or laughter that moves the mouth, or if less than 45 % of the rise came within `rise_s`:
//! yawns, laughter and the lids of a drowsy person rise more slowly than deliberate expressions. Every on is followed by an off, also
//! when the head turns away, the face is lost, the person leaves, the source stops, the configuration changes or the run ends.
//!
//! [`teaching`] finds levels for a person. Weights 0…1, seconds of capture time, degrees. Memory: fixed, about 1.8 kB for each gesture,
//! and 8 kB, of which 4 kB are for a set-up.

mod activation;
mod definition;
mod facts;
mod last_day;
mod saved_levels;
mod speech;
pub mod teaching;

use super::command::Command;
use super::every::Every;
use super::report::{Report, unit_range};
use activation::{Activation, Observation, PAST, Times};
pub use definition::{Gesture, LEVELS, PRESETS, Person, Press};
pub use facts::{SetUp, SetUpFacts};
use heapless::HistoryBuf;
use last_day::LastDay;
use mien_stages::base::capacity::{GESTURES, USERS};
use mien_stages::base::geometry::{Vector, face_normal};
use mien_stages::base::prelude::*;
use mien_stages::base::time::Timestamp;
use mien_stages::users::TrackingState;
use speech::Speech;
pub use teaching::SetUpState;
use teaching::{Awaits, Lesson, Levels};

/// Whether this build has gestures.
pub const ENABLED: bool = cfg!(any(test, feature = "wires"));
/// Turn of the head to the side within [`TURN_S`], degrees, above which no gesture goes on. Turns up and down do not count, because
/// opening the mouth changes the measured pitch.
const TURN_DEG: f32 = 8.0;
/// Time within which a turn is measured, seconds.
const TURN_S: f32 = 0.3;
/// Greatest hold time, seconds.
const HOLD_MAX_S: f32 = 60.0;
/// Interval at which every state is repeated for receivers that missed a change, seconds.
const REPEAT_S: f64 = 2.0;

/// Largest angle up or down at which a face makes gestures, degrees.
const PITCH_MAX_DEG: f32 = 30.0;

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
    /// Activations since the start, and in the last day.
    total: u64,
    day: LastDay,
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
    /// Time for which anybody was tracked, microseconds.
    tracked_us: LastDay,
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
            total: 0,
            day: LastDay::default(),
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
            tracked_us: LastDay::default(),
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
                self.abort_lesson();
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
            facts.count = watched.day.sum() as u32;
            facts.tracked_s = (self.tracked_us.sum() / 1_000_000) as u32;
            (facts.index, facts.levels) = (index, watched.gesture.levels());
            watched.facts[0].can_undo = watched.can_undo();
        }
    }

    /// Adds the time since the last frame to the tracked time, if it is less than a second.
    fn pass_time(&mut self, at: Timestamp, is_tracked: bool) {
        let us = at.as_us().saturating_sub(self.at.as_us());
        let counts = is_tracked && us < 1_000_000;
        self.tracked_us.add(if counts { us } else { 0 }, at);
        self.all.iter_mut().for_each(|one| one.day.add(0, at));
    }

    /// Activations of each gesture since the start, and in the last 24 hours.
    pub fn activations(&self) -> impl Iterator<Item = [u64; 2]> {
        self.all.iter().map(|one| [one.total, one.day.sum()])
    }

    /// Takes over the counts of gestures of the same name, and also their levels and undo if the configured levels and the expression
    /// are unchanged.
    pub fn continue_from(&mut self, before: &Self) {
        self.tracked_us = before.tracked_us;
        self.at = before.at;
        for one in &mut self.all {
            let mut all = before.all.iter();
            if let Some(same) = all.find(|other| other.gesture.name == one.gesture.name) {
                (one.total, one.day) = (same.total, same.day);
                if one.gesture.of == same.gesture.of && one.configured == same.configured {
                    one.before = same.before;
                    one.set(same.gesture.levels());
                }
            }
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
            Awaits::Nothing => {
                self.all[index].facts[0].seen = teaching::REPETITIONS;
                match lesson.found(now) {
                    Ok(found) => {
                        self.change(index, found);
                        SetUpState::Found
                    }
                    Err(state) => state,
                }
            }
            _ => {
                self.lesson = Some((index, slot, lesson));
                return;
            }
        };
        self.all[index].facts[0].state = state;
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
            let now = Observation {
                value: (!report.weights.is_empty()).then_some(least),
                counts: is_tracked && is_theirs && is_facing,
                may_start: !is_turning && (gesture.speaking || !is_speaking),
            };
            let taught = self.lesson.as_mut().filter(|(of, ..)| *of == index);
            if let Some((_, of, lesson)) = taught {
                // During its set-up a gesture switches nothing.
                let state = &mut watched.activations[slot];
                state.rest(now.value);
                if now.counts && now.may_start && !report.other_is_shown {
                    let is_theirs = *of.get_or_insert(slot) == slot;
                    let came_fast = state.came_fast(&self.times[slot], watched.configured.rise_s);
                    is_theirs.then(|| lesson.observe(least, came_fast, report.at));
                }
                continue;
            }
            watched.activations[slot].observe(gesture, now, &self.times[slot]);
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
                    watched.total += 1;
                    watched.day.add(1, self.at);
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
                self.abort_lesson();
                self.lesson = Some((index, None, lesson));
            }
            Command::Teach(_, false)
                if self.lesson.as_ref().is_some_and(|(of, ..)| *of == index) =>
            {
                self.abort_lesson();
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

    fn abort_lesson(&mut self) {
        if let Some((index, ..)) = self.lesson.take() {
            self.all[index].facts[0].state = SetUpState::None;
        }
    }

    fn change(&mut self, index: usize, levels: Levels) {
        let watched = &mut self.all[index];
        let now = watched.gesture.levels();
        if levels != now {
            watched.before = Some(now);
            watched.set(levels);
            self.is_changed = true;
        }
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
            let dwell = Gesture {
                name: "dwell".into(),
                hold_s: 3.0,
                ..Gesture::named(name)
            };
            let made_within = |seconds: f32| {
                let all = [Gesture::named(name), any.clone(), dwell.clone()];
                let mut gestures = Gestures::new(&all, &units);
                let mut on = Vec::new();
                for frame in 0..150_u64 {
                    let height = ((frame as f32 / 30.0 - 1.0) / seconds).clamp(0.0, 1.0);
                    gestures.observe(&mut [user(0, frame * 1000 / 30, &[height, height])]);
                    on.extend(switches(&mut gestures).into_iter().map(|(name, ..)| name));
                }
                on
            };
            assert_eq!(made_within(0.25), [name, "any", "dwell"]);
            assert_eq!(made_within(1.6), ["any"], "{name}");
        }
    }

    #[test]
    fn a_smile_that_began_hidden_turned_away_or_on_a_new_face_does_not_switch() {
        let pose = |yaw: f32| {
            let turn = rotation_from_yaw_pitch_roll(yaw, 0.0, 0.0);
            Rigid::from_parts(Vector::new(0.0, 0.0, 0.8).into(), turn)
        };
        let (aside, ahead) = (pose(0.9), pose(0.0));
        for case in ["fast", "new", "hidden", "turned"] {
            let mut gestures = Gestures::new(&[Gesture::named("smile")], &["AU12L", "AU12R"]);
            let mut on = 0;
            for frame in 0..150_u64 {
                // The slow smiles rise from 1 to 2.6 s, the fast one at 3.5 s; the face is seen well from 3 s on.
                let s = frame as f32 / 30.0;
                let is_seen = s > 3.0;
                let rise_s = if case == "fast" { 0.2 } else { 1.6 };
                let begins = if case == "fast" { 3.5 } else { 1.0 };
                let smiles = 0.9 * ((s - begins) / rise_s).clamp(0.0, 1.0);
                let weights = [smiles; 2];
                let mut now = Report {
                    sensor_from_face: Some(&ahead),
                    ..user(0, frame * 1000 / 30, &weights)
                };
                match case {
                    "new" if !is_seen => now.state = TrackingState::Warming,
                    "hidden" if !is_seen => (now.state, now.weights) = (TrackingState::Posed, &[]),
                    "turned" if !is_seen => now.sensor_from_face = Some(&aside),
                    _ => {}
                }
                gestures.observe(&mut [now]);
                on += switches(&mut gestures).len();
            }
            assert_eq!(on, usize::from(case == "fast"), "{case}");
        }
    }

    #[test]
    fn a_reload_keeps_levels_and_undo_if_the_gesture_is_the_same() {
        let mut gestures = Gestures::new(&[Gesture::named("brows"), smile(Person::Shown)], &UNITS);
        gestures.execute(Command::Level(1, 50));
        gestures.execute(Command::Level(1, 40));
        // The same level again is no change that could be undone.
        gestures.execute(Command::Level(1, 40));
        let mut after = Gestures::new(&[smile(Person::Shown)], &UNITS);
        after.continue_from(&gestures);
        assert_eq!(after.levels(0).on, 0.4);
        after.execute(Command::Undo(0));
        assert_eq!(after.levels(0).on, 0.5);
        let changed = Gesture {
            on: 1.0,
            ..smile(Person::Shown)
        };
        let mut after = Gestures::new(&[changed], &UNITS);
        after.continue_from(&gestures);
        assert_eq!(after.levels(0).on, 1.0);
    }

    #[test]
    fn levels_of_an_expression_of_several_lines_are_read_back() {
        let lines = Gesture {
            of: "AU12L +\n  AU12R".into(),
            ..smile(Person::Shown)
        };
        let mut gestures = Gestures::new(std::slice::from_ref(&lines), &UNITS);
        gestures.execute(Command::Level(0, 50));
        let mut text = String::new();
        gestures.write_levels(&mut text).unwrap();
        let mut after = Gestures::new(&[lines], &UNITS);
        assert_eq!(after.read_levels(&text), 0);
        assert_eq!(after.levels(0).on, 0.5);
    }

    #[test]
    fn a_clock_that_goes_back_ends_a_set_up() {
        let mut gestures = Gestures::new(&[smile(Person::Shown)], &UNITS);
        gestures.execute(Command::Teach(0, true));
        five_smiles(&mut gestures, 60_000, 0, 0.0);
        assert_eq!(facts(&mut gestures).state, SetUpState::Act);
        five_smiles(&mut gestures, 0, 0, 0.9);
        assert_eq!(facts(&mut gestures).state, SetUpState::None);
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
            gestures.for_each_switch(|_| ());
            ms += 33;
        }
        ms
    }

    fn facts(gestures: &mut Gestures) -> SetUpFacts {
        let mut last = SetUpFacts::default();
        let at = gestures.at;
        gestures.at = Timestamp::from_us(at.as_us() + 2_000_000);
        gestures.for_each_set_up(|set_up| last = set_up.facts);
        gestures.at = at;
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
        let told = facts(&mut gestures);
        assert_eq!(
            (told.state, told.seen, told.count),
            (SetUpState::Found, 5, 0)
        );
        // 34 % of the way from 0.04 to 1.8, in steps of 4 %.
        assert!((0.6..0.65).contains(&told.levels.on), "{told:?}");
        assert!(told.can_undo && gestures.take_change());

        // Weaker smiles: their sum of 1.0 is below the old level of 1.1.
        five_smiles(&mut gestures, ms, 0, 0.5);
        let told = facts(&mut gestures);
        assert!(told.count == 5 && told.tracked_s > 30, "{told:?}");
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
        // A configuration that is read again, with the gesture in another place.
        let all = [Gesture::named("kiss"), smile(Person::Shown)];
        let mut after = Gestures::new(&all, &UNITS);
        after.continue_from(&gestures);
        let counts: Vec<[u64; 2]> = after.activations().collect();
        assert_eq!(counts, [[0, 0], [30, 24]]);
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
