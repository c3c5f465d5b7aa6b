//! Scripts of scenes: pose and expression as smooth functions of time and seed.
//!
//! There is no state, so any instant can be drawn by itself. Curves are values hashed per interval and joined by Hermite splines
//! (value noise), smooth in position and speed. Acts and seats are tables; movements are in [`Scene::play_person`].

use super::random::uniform;
use mien_stages::base::geometry::{Point, Rigid, rotation_from_yaw_pitch_roll, smoothstep};

/// A scene.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Scene {
    /// One head turns within ±25° of yaw and ±15° of pitch at 0.6 to 1.0 m; every expression in turn, then mixtures, with blinks and
    /// speech.
    #[default]
    Acted,
    /// As `Acted`, by somebody with hair and clothes in a room ([`super::Appearance::demonstration`]).
    Demo,
    /// A neutral face that faces the sensor at 0.7 m and does not move.
    Still,
    /// A neutral face that turns through the range of `Acted`.
    Turning,
    /// A wall and an empty chair.
    Empty,
    /// As `Acted`, but in every 20 s the person walks away at 6 s, is absent from 8 to 13 s, and is back at 15 s.
    Leaving,
    /// As `Acted`, with yaw to ±45° and pitch to ±30°.
    Wide,
    /// A neutral face that turns from side to side, ±32°, at up to 200°/s.
    Fast,
    /// A neutral face in front of which a hand rises every 5 s, for 0.3, 0.9 and 1.8 s in turn.
    Hand,
    /// Two people who act side by side.
    Two,
    /// Four people who act beside and behind each other.
    Four,
    /// Two people who walk past each other at 0.85 m and 1.3 m every 5 s.
    Crossing,
    /// Two people take turns in every 20 s: one until 6 s and from 14 s, the other from 7 to 13 s.
    Swap,
    /// Three people seen from behind.
    Behind,
    /// Things of a head's size, nobody.
    Furnished,
    /// Movements as in `Acted`, with random expressions mixed freely, so that training cannot learn an order of acts.
    Mixed,
    /// Joy, sorrow, anger and surprise in turn, with rest in between, as in the paper's demonstration.
    #[cfg(feature = "studio")]
    Moods,
}

impl Scene {
    /// All scenes, with their names.
    pub const NAMES: &[(&'static str, Self)] = &[
        ("acted", Self::Acted),
        ("demo", Self::Demo),
        ("still", Self::Still),
        ("turning", Self::Turning),
        ("empty", Self::Empty),
        ("leaving", Self::Leaving),
        ("wide", Self::Wide),
        ("fast", Self::Fast),
        ("hand", Self::Hand),
        ("two", Self::Two),
        ("four", Self::Four),
        ("crossing", Self::Crossing),
        ("swap", Self::Swap),
        ("behind", Self::Behind),
        ("furnished", Self::Furnished),
        ("mixed", Self::Mixed),
        #[cfg(feature = "studio")]
        ("moods", Self::Moods),
    ];

    /// The scene of this name.
    pub fn named(name: &str) -> Option<Self> {
        let found = Self::NAMES.iter().find(|(known, _)| *known == name);
        found.map(|&(_, scene)| scene)
    }

    /// Number of people in the scene.
    pub(crate) const fn people(self) -> usize {
        match self {
            Self::Two | Self::Crossing | Self::Swap => 2,
            Self::Behind => 3,
            Self::Four => 4,
            _ => 1,
        }
    }
}

/// Duration of one act, seconds.
const ACT_S: f32 = 1.8;
/// Interval with one blink each, seconds.
const BLINK_EVERY_S: f32 = 3.4;

/// Acts, a line each: expressions with their peak weights (default 1). `_LR` means both sides, `speech` moves the jaw as in talking,
/// `rest` nothing.
const ACTS: &str = include_str!("acts.txt");
/// Acts of [`Scene::Moods`]; the head has no expression that lowers the mouth corners.
#[cfg(feature = "studio")]
const MOODS: [&str; 4] = [
    "mouthSmile_LR, cheekRaiser_LR 0.8, mouthUpperUp_LR 0.4, jawOpen 0.15",
    "browInnerUp_LR, mouthShrugLower 0.9, mouthShrugUpper 0.3, eyeBlink_LR 0.3",
    "browDown_LR, eyeSquint_LR 0.7, mouthLowerDown_LR 0.6, mouthUpperUp_LR 0.3, mouthStretch_LR 0.3",
    "browInnerUp_LR, browOuterUp_LR, eyeWide_LR, jawOpen 0.8",
];
/// Expressions of [`Scene::Mixed`]; those with `_LR` are played on one side or both.
const MIXED: &str = "mouthSmile_LR, mouthStretch_LR, mouthUpperUp_LR, mouthLowerDown_LR, noseSneer_LR, browDown_LR, \
    browInnerUp_LR, browOuterUp_LR, eyeSquint_LR, eyeWide_LR, cheekRaiser_LR, cheekPuff_LR, mouthFrown_LR, \
    mouthDimple_LR, mouthPress_LR, cheekSquint_LR, jawOpen, jawLeft, jawRight, jawForward, mouthFunnel, mouthPucker, \
    mouthShrugLower, mouthShrugUpper, mouthRollLower, mouthRollUpper, mouthRoll, mouthLeft, mouthRight";
/// Name in [`MIXED`] for both lips rolled in, and its expressions.
const ROLL: (&str, [&str; 2]) = ("mouthRoll", ["mouthRollLower", "mouthRollUpper"]);
/// Duration of one mood, seconds.
#[cfg(feature = "studio")]
const MOOD_S: f32 = 3.0;
/// Number of mixtures of two acts that are played after all single acts, before the cycle repeats.
const MIXTURES: u64 = 16;

/// Smooth noise of about −1…1 with a new value every `period_s`.
fn smooth_noise(seed: u64, channel: u64, t: f32, period_s: f32) -> f32 {
    let s = t / period_s + 2.0;
    let (k, f) = (s.floor() as u64, s - s.floor());
    let value = |i: u64| uniform(seed ^ channel.wrapping_mul(0xd6e8_feb8_6659_fd93), i);
    let (p, a, b, q) = (value(k - 1), value(k), value(k + 1), value(k + 2));
    // Catmull–Rom.
    let (ma, mb) = ((b - p) * 0.5, (q - a) * 0.5);
    let (f2, f3) = (f * f, f * f * f);
    a * (2.0 * f3 - 3.0 * f2 + 1.0)
        + ma * (f3 - 2.0 * f2 + f)
        + b * (3.0 * f2 - 2.0 * f3)
        + mb * (f3 - f2)
}

/// Weight over an act, 0…1: rise, hold, fall; `t`: seconds since its start.
fn envelope(t: f32) -> f32 {
    smoothstep(0.15, 0.55, t) * (1.0 - smoothstep(1.1, 1.55, t))
}

/// Smooth oscillation: 0 at the start, 1 after a quarter of the period, −1 after three quarters.
fn swing(t: f32, period: f32) -> f32 {
    let f = (t / period + 0.25).fract();
    let triangle = 1.0 - 4.0 * (f - 0.5).abs();
    triangle * (1.5 - 0.5 * triangle * triangle)
}

/// Pose of a head (sensor from head): yaw, pitch and roll in degrees, position in metres.
fn head_pose(angles: [f32; 3], [x, y, z]: [f32; 3]) -> Rigid {
    let [yaw, pitch, roll] = angles.map(f32::to_radians);
    let rotation = rotation_from_yaw_pitch_roll(yaw, pitch, roll);
    Rigid::from_parts(nalgebra::Translation3::new(x, y, z), rotation)
}

/// Pose of a bystander, who looks over the shoulder from behind, turned away by about 40°.
pub(crate) fn bystander(seed: u64, t: f32) -> Rigid {
    let side = 1f32.copysign(uniform(seed, 0x91));
    let sway = |channel, period| smooth_noise(seed, channel, t, period);
    let yaw = side * 40.0 + 12.0 * sway(0x92, 3.3);
    let turn = rotation_from_yaw_pitch_roll(yaw.to_radians(), 0.05, 0.0);
    let x = side * (0.34 + 0.04 * sway(0x93, 4.1));
    let z = 1.35 + 0.1 * sway(0x94, 5.3);
    Rigid::from_parts(nalgebra::Translation3::new(x, -0.12, z), turn)
}

/// Period of the hand in [`Scene::Hand`], seconds.
const HAND_EVERY_S: f32 = 5.0;
/// Durations for which the hand stays up, in turn, seconds.
const HAND_STAYS_S: [f32; 3] = [0.3, 0.9, 1.8];
/// Duration of the hand's way up or down, seconds.
const HAND_MOVES_S: f32 = 0.25;

/// Placement of a person: range of yaw and pitch (degrees), position (metres), range of swaying (metres).
type Placement = ([f32; 2], [f32; 3], [f32; 3]);

impl Scene {
    /// As [`Self::play_person`], for the first person.
    #[cfg(any(test, feature = "studio"))]
    pub fn play(self, seed: u64, t: f32, set: impl FnMut(&str, f32)) -> Option<Rigid> {
        self.play_person(0, seed, t, set)
    }

    /// Pose of a head at `t` seconds, sensor frame; `None` while absent. Calls `set(name, weight)` for every expression above 0; if it
    /// is called twice for a name, the larger weight counts.
    pub(crate) fn play_person(
        self,
        person: usize,
        seed: u64,
        t: f32,
        mut set: impl FnMut(&str, f32),
    ) -> Option<Rigid> {
        let seed = seed ^ (person as u64).wrapping_mul(0xa076_1d64_78bd_642f);
        let (turned, [x, y, z], sway) = self.placement(person)?;
        let offset = self.side_offset(person, t)?;
        self.express(seed, t, &mut set);
        let calm = smoothstep(1.0, 3.0, t);
        let walk = |channel, period, range: f32| {
            (smooth_noise(seed, channel, t, period) * 1.3 * range).clamp(-range, range) * calm
        };
        let [yaw, pitch] = turned;
        let wandering = [walk(1, 2.3, yaw), walk(2, 2.9, pitch), walk(3, 3.1, 8.0)];
        let angles = match self {
            Self::Still => [0.0; 3],
            // A Lissajous curve through the range.
            Self::Turning => [
                yaw * swing(t, 8.0),
                pitch * swing(t, 5.3),
                6.0 * swing(t, 11.0),
            ],
            Self::Hand => [yaw * swing(t, 7.0), pitch * swing(t, 5.3), 0.0],
            Self::Fast => {
                // 64° in 0.48 s, at most 1.5 times as fast as on average; then a rest.
                let phase = t % 2.4;
                let side =
                    2.0 * (smoothstep(0.6, 1.08, phase) - smoothstep(1.8, 2.28, phase)) - 1.0;
                [yaw * side * smoothstep(0.0, 0.5, t), 0.0, 0.0]
            }
            Self::Behind => [180.0 + wandering[0], wandering[1], wandering[2]],
            _ => wandering,
        };
        let sways = [(4, 3.7, sway[0]), (5, 4.1, sway[1]), (6, 4.7, sway[2])];
        let [dx, dy, dz] = sways.map(|(channel, period, range)| walk(channel, period, range));
        Some(head_pose(angles, [x + dx + offset, y + dy, z + dz]))
    }

    fn placement(self, person: usize) -> Option<Placement> {
        Some(match self {
            Self::Empty | Self::Furnished => return None,
            Self::Still => ([0.0; 2], [0.0, -0.02, 0.7], [0.0; 3]),
            Self::Turning => ([25.0, 15.0], [0.0, -0.02, 0.8], [0.0; 3]),
            Self::Fast => ([32.0, 0.0], [0.0, -0.02, 0.75], [0.0; 3]),
            Self::Hand => ([5.0, 3.0], [0.0, -0.02, 0.8], [0.0; 3]),
            Self::Wide => ([45.0, 30.0], [0.0, -0.02, 0.8], [0.07, 0.04, 0.2]),
            Self::Acted | Self::Demo | Self::Leaving | Self::Mixed => {
                ([25.0, 15.0], [0.0, -0.02, 0.8], [0.07, 0.04, 0.2])
            }
            #[cfg(feature = "studio")]
            Self::Moods => ([12.0, 7.0], [0.0, -0.02, 0.75], [0.0; 3]),
            Self::Two => {
                let places = [[-0.25, -0.02, 0.95 - 0.1], [0.25, -0.02, 0.95 + 0.1]];
                ([20.0, 12.0], places[person % 2], [0.04, 0.03, 0.06])
            }
            Self::Four => {
                let [x, z] = [[-0.51, 1.35], [-0.15, 1.15], [0.16, 1.4], [0.5, 1.2]][person % 4];
                ([15.0, 10.0], [x, -0.03, z], [0.03, 0.02, 0.0])
            }
            Self::Crossing => {
                let [y, z] = [[-0.02, 0.85], [-0.05, 1.3]][person % 2];
                ([15.0, 8.0], [0.0, y, z], [0.0; 3])
            }
            Self::Swap => ([18.0, 10.0], [0.0, -0.02, 0.8], [0.03, 0.0, 0.0]),
            Self::Behind => {
                let places = [[-0.35, -0.03, 1.3], [0.0, -0.1, 1.6], [0.3, 0.02, 1.1]];
                ([25.0, 10.0], places[person % 3], [0.03, 0.0, 0.0])
            }
        })
    }

    /// Sideways offset from the person's position, metres; `None` while absent.
    fn side_offset(self, person: usize, t: f32) -> Option<f32> {
        let phase = t % 20.0;
        let step = |from: f32, to: f32| smoothstep(from, to, phase);
        Some(match self {
            Self::Leaving if (8.0..13.0).contains(&phase) => return None,
            Self::Leaving => (step(6.0, 8.0) - step(13.0, 15.0)) * 1.1,
            Self::Hand => 0.01 * swing(t, 6.1),
            Self::Crossing => [0.33, -0.40][person % 2] * swing(t, 10.0),
            Self::Swap => {
                let (side, away) = match person {
                    0 => (-1.0, step(4.5, 6.0) - step(14.0, 15.5)),
                    _ => (1.0, 1.0 - step(7.0, 8.5) + step(11.5, 13.0)),
                };
                return (away < 1.0).then_some(side * away);
            }
            _ => 0.0,
        })
    }

    fn express(self, seed: u64, t: f32, set: &mut impl FnMut(&str, f32)) {
        match self {
            Self::Mixed => mix(seed, t, set),
            #[cfg(feature = "studio")]
            Self::Moods => {
                let (mood, within) = ((t / MOOD_S) as usize % MOODS.len(), t % MOOD_S);
                let height = smoothstep(0.3, 0.9, within) * (1.0 - smoothstep(2.2, 2.8, within));
                play_act(MOODS[mood], height, set);
            }
            Self::Acted | Self::Demo | Self::Leaving | Self::Wide => act(seed, t, set),
            Self::Two | Self::Four | Self::Crossing | Self::Swap => act(seed, t, set),
            _ => {}
        }
    }

    /// Position of the raised hand's palm at `t` seconds, sensor frame, metres; `None` without one.
    pub(crate) fn hand(self, t: f32) -> Option<Point> {
        if self != Self::Hand {
            return None;
        }
        let (turn, phase) = ((t / HAND_EVERY_S) as usize, t % HAND_EVERY_S);
        let comes = 2.0 - HAND_MOVES_S;
        let goes = 2.0 + HAND_STAYS_S[turn % HAND_STAYS_S.len()];
        let up = smoothstep(comes, comes + HAND_MOVES_S, phase)
            - smoothstep(goes, goes + HAND_MOVES_S, phase);
        (up > 0.0).then(|| Point::new(0.0, 0.02 + 0.5 * (1.0 - up), 0.66))
    }
}

/// Sets an expression; with the suffix `_LR` both sides, left and right.
fn set_sides(name: &str, [left, right]: [f32; 2], set: &mut impl FnMut(&str, f32)) {
    let Some(stem) = name.strip_suffix("_LR") else {
        return set(name, left);
    };
    for (side, weight) in [("_L", left), ("_R", right)] {
        let mut name = heapless::String::<24>::new();
        // Names of the tables fit.
        if name.push_str(stem).is_ok() && name.push_str(side).is_ok() {
            set(&name, weight);
        }
    }
}

/// Plays an act of a table; not `speech`.
fn play_act(act: &str, strength: f32, set: &mut impl FnMut(&str, f32)) {
    for part in act.split(", ").filter(|part| *part != "rest") {
        let (name, weight) = part.split_once(' ').unwrap_or((part, "1"));
        let weight = weight.parse().unwrap_or(1.0) * strength;
        set_sides(name, [weight; 2], set);
    }
}

fn act(seed: u64, t: f32, set: &mut impl FnMut(&str, f32)) {
    let (slot, within) = ((t / ACT_S) as u64, t % ACT_S);
    let acts = ACTS.lines().count();
    let turn = acts as u64 + MIXTURES;
    let height = 0.85 + 0.15 * uniform(seed ^ 0x51, slot);
    let mut perform = |act: &str, strength: f32| {
        if act == "speech" {
            let loud = smoothstep(0.0, 0.25, within) * (1.0 - smoothstep(1.5, 1.8, within));
            let talk = |channel, period| {
                (0.5 + 0.6 * smooth_noise(seed, channel, t, period)).clamp(0.0, 1.0)
            };
            set("jawOpen", 0.4 * loud * talk(11, 0.13));
            set("mouthFunnel", 0.5 * loud * talk(12, 0.23));
            set_sides("mouthLowerDown_LR", [0.4 * loud * talk(13, 0.19); 2], set);
        } else {
            play_act(act, strength, set);
        }
    };
    let pick = |channel| (uniform(seed ^ channel, slot) * 0.5 + 0.5) * (acts as f32 - 0.01);
    let act = |number: usize| ACTS.lines().nth(number).unwrap_or_default();
    if slot % turn < acts as u64 {
        perform(act((slot % turn) as usize), height * envelope(within));
    } else {
        perform(act(pick(0x52) as usize), height * envelope(within));
        perform(act(pick(0x53) as usize), 0.8 * envelope(within + 0.2));
    }
    let (blink, since) = ((t / BLINK_EVERY_S) as u64, t % BLINK_EVERY_S);
    let closed = lid_closure(since - 1.4 - uniform(seed ^ 0x54, blink));
    if closed > 0.0 {
        set_sides("eyeBlink_LR", [closed; 2], set);
    }
}

/// Closure of the lids, 0…1, `since` seconds after a blink began.
fn lid_closure(since: f32) -> f32 {
    smoothstep(0.0, 0.1, since) * (1.0 - smoothstep(0.14, 0.32, since))
}

/// Number of voices of [`mix`], which play expressions independently.
const VOICES: u64 = 3;
/// Duration of an expression of a voice, seconds.
const VOICE_S: f32 = 1.7;

/// Random expressions, gaze and blinks. Odd seeds have [`VOICES`] voices, even seeds one, which pauses half of the time.
fn mix(seed: u64, t: f32, set: &mut impl FnMut(&str, f32)) {
    let (voices, silence) = if seed % 2 == 1 {
        (VOICES, 0.25)
    } else {
        (1, 0.5)
    };
    let share = |channel: u64, index: u64| uniform(seed ^ channel, index) * 0.5 + 0.5;
    let count = MIXED.split(", ").count();
    for voice in 0..voices {
        let t = t + VOICE_S * voice as f32 / VOICES as f32;
        let slot = (t / VOICE_S) as u64 * VOICES + voice;
        let weight = envelope(t % VOICE_S) * (0.15 + 0.85 * share(0x61, slot));
        if weight <= 0.0 || share(0x62, slot) < silence {
            continue;
        }
        let pick = (share(0x63, slot) * count as f32) as usize;
        let Some(name) = MIXED.split(", ").nth(pick) else {
            continue;
        };
        let sides = match uniform(seed ^ 0x64, slot) {
            _ if !name.ends_with("_LR") => [1.0; 2],
            l if l > 0.6 => [1.0, 0.0],
            l if l < -0.6 => [0.0, 1.0],
            l => [1.0 + 0.3 * l.min(0.0), 1.0 - 0.3 * l.max(0.0)],
        };
        if name == ROLL.0 {
            ROLL.1.iter().for_each(|part| set(part, weight));
        } else {
            set_sides(name, sides.map(|side| weight * side), set);
        }
    }
    gaze(seed, t, set);
    let blink = (t / 1.9) as u64;
    let closed = lid_closure(t % 1.9 - 0.3 - 1.2 * share(0x65, blink));
    let lean = uniform(seed ^ 0x66, blink);
    if closed > 0.0 {
        let left = if lean < -0.5 { 0.0 } else { closed };
        let right = if lean > 0.5 { 0.0 } else { closed };
        set_sides("eyeBlink_LR", [left, right], set);
    }
}

/// Random gaze: rests for a second, then jumps to the next target.
fn gaze(seed: u64, t: f32, set: &mut impl FnMut(&str, f32)) {
    /// Duration of a glance, seconds.
    const GLANCE_S: f32 = 1.1;
    /// Duration of a jump, seconds.
    const JUMP_S: f32 = 0.06;
    /// Largest weights sideways and up or down.
    const FAR: [f32; 2] = [0.95, 0.35];
    let glance = (t / GLANCE_S) as u64;
    let there = smoothstep(0.0, JUMP_S, t % GLANCE_S);
    let [left, up] = [(0x67, FAR[0]), (0x68, FAR[1])].map(|(channel, far)| {
        let [from, to] = [glance, glance + 1].map(|k| far * uniform(seed ^ channel, k));
        from + (to - from) * there
    });
    let [to_left, to_right] = [left.max(0.0), (-left).max(0.0)];
    set_sides("eyeLookOut_LR", [to_left, to_right], set);
    set_sides("eyeLookIn_LR", [to_right, to_left], set);
    set_sides("eyeLookUp_LR", [up.max(0.0); 2], set);
    set_sides("eyeLookDown_LR", [(-up).max(0.0); 2], set);
}

#[cfg(test)]
mod tests {
    use super::*;
    use mien_stages::base::geometry::yaw_pitch_roll;

    #[test]
    fn an_acted_minute_covers_the_range_smoothly() {
        let mut before: Option<Rigid> = None;
        let (mut widest, mut near, mut far) = (0.0f32, 9.0f32, 0.0f32);
        for frame in 0..3600 {
            let t = frame as f32 / 60.0;
            let mut largest = 0.0f32;
            let now = Scene::Acted
                .play(5, t, |_, w| largest = largest.max(w))
                .expect("somebody");
            assert!(largest <= 1.0);
            let (yaw, pitch, _) = yaw_pitch_roll(&now.rotation);
            assert!(yaw.abs() <= 25.01f32.to_radians() && pitch.abs() <= 15.01f32.to_radians());
            widest = widest.max(yaw.abs());
            let z = now.translation.z;
            (near, far) = (near.min(z), far.max(z));
            if let Some(before) = before {
                let turned = before.rotation.angle_to(&now.rotation);
                let moved = before.translation.vector - now.translation.vector;
                assert!(turned < 0.04 && moved.norm() < 0.01, "at {t} s");
            }
            before = Some(now);
        }
        assert!(
            widest > 0.4 && near < 0.67 && far > 0.95,
            "{widest} {near} {far}"
        );
    }

    #[test]
    fn mixed_expressions_come_in_all_kinds_and_not_in_one_order() {
        let mut most = std::collections::BTreeMap::<String, f32>::new();
        let mut both = 0;
        for frame in 0..9000 {
            let mut on = 0;
            Scene::Mixed.play(3, frame as f32 / 15.0, |name, w| {
                assert!((0.0..=1.0).contains(&w), "{name} {w}");
                on += usize::from(w > 0.3 && !name.starts_with("eyeLook"));
                let seen = most.entry(name.to_owned()).or_default();
                *seen = seen.max(w);
            });
            both += usize::from(on > 2);
        }
        // Both lids more, four directions of each eye, and the rolled lips are two others of the list.
        assert_eq!(
            most.len(),
            MIXED.split(", ").count() + MIXED.matches("_LR").count() + 2 + 8 - 1
        );
        let far = |(name, w): (&String, &f32)| {
            *w > if name.starts_with("eyeLook") {
                0.3
            } else {
                0.5
            }
        };
        assert!(most.iter().all(far), "{most:?}");
        assert!(both > 900, "{both} frames with more than one");
    }

    #[test]
    fn somebody_leaves_and_returns() {
        let present = |t| Scene::Leaving.play(1, t, |_, _| {}).is_some();
        assert!(present(5.0) && !present(10.0) && present(16.0));
        assert!(Scene::Empty.play(1, 3.0, |_, _| {}).is_none());
        assert_eq!(Scene::named("leaving"), Some(Scene::Leaving));
        assert_eq!(Scene::named("party"), None);
    }
}
