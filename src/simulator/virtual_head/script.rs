//! What the simulated person does: pose and expression as smooth functions of time, the same for the same seed.
//!
//! Nothing is remembered from frame to frame, so any instant can be drawn without those before it. Curves are values
//! hashed per interval and joined by Hermite splines (value noise): smooth in position and speed.
//! One file: what is acted in all scenes.

use super::random::uniform;
use crate::base::geometry::{Point, Rigid, rotation_from_yaw_pitch_roll};

/// What is played.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Scene {
    /// Head turning within ±25° of yaw and ±15° of pitch at 0.6 to 1.0 m, every expression in turn, then mixed, with
    /// blinks and speech.
    #[default]
    Acted,
    /// As `Acted`, by somebody with hair and clothes in a room ([`super::Look::demonstration`]).
    Demo,
    /// A neutral face that faces the sensor at 0.7 m and does not move.
    Still,
    /// A neutral face that turns through the whole range.
    Turning,
    /// A wall and an empty chair.
    Empty,
    /// As `Acted`, but the person walks away after 6 s, is gone from 8 to 13 s, and is back at 15 s of every 20.
    Leaving,
    /// As `Acted`, with yaw to ±45° and pitch to ±30°.
    Wide,
    /// A neutral face that looks from side to side, ±32°, at up to 200°/s.
    Fast,
    /// A neutral face behind which a hand rises every 5 s, for 0.3, 0.9 and 1.8 s in turn.
    Hand,
    /// Two people who act side by side.
    Two,
    /// Four people who act beside and behind each other.
    Four,
    /// Two people who walk past each other at 0.85 m and 1.3 m every 5 s.
    Crossing,
    /// One person leaves as another comes, and the other way round: one at 0 to 6 s and from 14 s of every 20, the other at
    /// 7 to 13 s.
    Swap,
    /// Three people seen from behind.
    Behind,
    /// Things of a head's size, and nobody.
    Furnished,
    /// Moving as in `Acted`, with expressions drawn at random and mixed freely: what is learnt from it is not the order of
    /// an act.
    Mixed,
    /// Joy, sorrow, anger and surprise in turn, with rest between, as the paper's demonstration has them.
    #[cfg(feature = "studio")]
    Moods,
}

impl Scene {
    /// All, with the names that select them.
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

    /// Scene of a name.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        Self::NAMES
            .iter()
            .find(|(known, _)| *known == name)
            .map(|&(_, scene)| scene)
    }

    /// How many people come up in it.
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
/// Blinks come once in each interval this long, seconds.
const BLINK_EVERY_S: f32 = 3.4;

/// One act: expressions and their weights at its height. `speech` moves the jaw as in talking.
type Act = &'static [(&'static str, f32)];
const ACTS: [Act; 24] = [
    &[],
    &[("mouthSmile_L", 1.0), ("mouthSmile_R", 1.0)],
    &[("jawOpen", 0.8)],
    &[
        ("browInnerUp_L", 1.0),
        ("browInnerUp_R", 1.0),
        ("browOuterUp_L", 1.0),
        ("browOuterUp_R", 1.0),
    ],
    &[("browDown_L", 1.0), ("browDown_R", 1.0)],
    &[("speech", 1.0)],
    &[("mouthFunnel", 1.0)],
    &[("mouthStretch_L", 1.0), ("mouthStretch_R", 1.0)],
    &[("eyeBlink_L", 1.0)],
    &[("eyeBlink_R", 1.0)],
    &[("eyeWide_L", 1.0), ("eyeWide_R", 1.0)],
    &[("noseSneer_L", 1.0), ("noseSneer_R", 1.0)],
    &[("speech", 1.0)],
    &[("jawLeft", 1.0)],
    &[("jawRight", 1.0)],
    &[("jawForward", 1.0)],
    &[("mouthPucker", 1.0)],
    &[("cheekPuff_L", 1.0), ("cheekPuff_R", 1.0)],
    &[
        ("eyeSquint_L", 1.0),
        ("eyeSquint_R", 1.0),
        ("cheekRaiser_L", 0.7),
        ("cheekRaiser_R", 0.7),
    ],
    &[("mouthShrugLower", 0.8), ("mouthShrugUpper", 0.5)],
    &[
        ("mouthUpperUp_L", 0.7),
        ("mouthUpperUp_R", 0.7),
        ("mouthLowerDown_L", 0.8),
        ("mouthLowerDown_R", 0.8),
    ],
    &[("browInnerUp_L", 0.9), ("browOuterUp_L", 1.0)],
    &[("mouthSmile_R", 0.9)],
    &[
        ("jawOpen", 0.5),
        ("mouthSmile_L", 0.6),
        ("mouthSmile_R", 0.6),
    ],
];
/// What each mood of [`Scene::Moods`] looks like, as far as the head's expressions go (its mouth corners do not go down).
#[cfg(feature = "studio")]
const MOODS: [Act; 4] = [
    &[
        ("mouthSmile_L", 1.0),
        ("mouthSmile_R", 1.0),
        ("cheekRaiser_L", 0.8),
        ("cheekRaiser_R", 0.8),
        ("mouthUpperUp_L", 0.4),
        ("mouthUpperUp_R", 0.4),
        ("jawOpen", 0.15),
    ],
    &[
        ("browInnerUp_L", 1.0),
        ("browInnerUp_R", 1.0),
        ("mouthShrugLower", 0.9),
        ("mouthShrugUpper", 0.3),
        ("eyeBlink_L", 0.3),
        ("eyeBlink_R", 0.3),
    ],
    &[
        ("browDown_L", 1.0),
        ("browDown_R", 1.0),
        ("noseSneer_L", 0.8),
        ("noseSneer_R", 0.8),
        ("mouthUpperUp_L", 0.5),
        ("mouthUpperUp_R", 0.5),
        ("mouthStretch_L", 0.4),
        ("mouthStretch_R", 0.4),
    ],
    &[
        ("browInnerUp_L", 1.0),
        ("browInnerUp_R", 1.0),
        ("browOuterUp_L", 1.0),
        ("browOuterUp_R", 1.0),
        ("eyeWide_L", 1.0),
        ("eyeWide_R", 1.0),
        ("jawOpen", 0.8),
    ],
];
/// Duration of one mood, seconds.
#[cfg(feature = "studio")]
const MOOD_S: f32 = 3.0;
/// Acts played in turn before mixtures begin, and mixtures before the turn begins again.
const MIXTURES: u64 = 16;

/// Smooth noise in about −1…1: a new value every `period_s`.
fn wander(seed: u64, channel: u64, t: f32, period_s: f32) -> f32 {
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

/// 0 below `from`, 1 above `to`, smooth between.
fn ramp(t: f32, from: f32, to: f32) -> f32 {
    let f = ((t - from) / (to - from)).clamp(0.0, 1.0);
    f * f * (3.0 - 2.0 * f)
}

/// Up, hold, down within an act.
fn envelope(t: f32) -> f32 {
    ramp(t, 0.15, 0.55) * (1.0 - ramp(t, 1.1, 1.55))
}

/// The person at one instant.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Instant {
    pub(crate) sensor_from_head: Rigid,
}

/// There and back: 0 at the start, 1 after a quarter of the period, −1 after three, smooth at both ends.
fn swing(t: f32, period: f32) -> f32 {
    let f = (t / period + 0.25).fract();
    let triangle = 1.0 - 4.0 * (f - 0.5).abs();
    triangle * (1.5 - 0.5 * triangle * triangle)
}

/// Head turned by degrees of yaw, pitch and roll at a place in metres.
fn placed([yaw, pitch, roll]: [f32; 3], [x, y, z]: [f32; 3]) -> Option<Instant> {
    let rotation =
        rotation_from_yaw_pitch_roll(yaw.to_radians(), pitch.to_radians(), roll.to_radians());
    Some(Instant {
        sensor_from_head: Rigid::from_parts(nalgebra::Translation3::new(x, y, z), rotation),
    })
}

/// Where somebody stands who looks over the shoulder from behind, turned away by about 40°.
pub(crate) fn bystander(seed: u64, t: f32) -> Rigid {
    let side = if uniform(seed, 0x91) < 0.0 {
        -1.0f32
    } else {
        1.0
    };
    let sway = |channel, period| wander(seed, channel, t, period);
    let yaw = side * 40.0 + 12.0 * sway(0x92, 3.3);
    let turn = rotation_from_yaw_pitch_roll(yaw.to_radians(), 0.05, 0.0);
    let [x, y, z] = [
        side * (0.34 + 0.04 * sway(0x93, 4.1)),
        -0.12,
        1.35 + 0.1 * sway(0x94, 5.3),
    ];
    Rigid::from_parts(nalgebra::Translation3::new(x, y, z), turn)
}

/// How the hand comes up in [`Scene::Hand`]: every so many seconds, for so long in turn.
const HAND_EVERY_S: f32 = 5.0;
const HAND_STAYS_S: [f32; 3] = [0.3, 0.9, 1.8];
/// Way of the hand up or down, seconds.
const HAND_MOVES_S: f32 = 0.25;

impl Scene {
    /// Where the first person is at `t` seconds, see [`Scene::play_person`].
    #[cfg(any(test, feature = "studio"))]
    pub(crate) fn play(self, seed: u64, t: f32, set: impl FnMut(&str, f32)) -> Option<Instant> {
        self.play_person(0, seed, t, set)
    }

    /// Where a person is at `t` seconds; `set(name, weight)` is called for every expression above 0, perhaps twice for one
    /// name: the larger counts. `None`: they are not there.
    ///
    /// Long because it is the table of the scenes: an arm for each, in numbers.
    pub(crate) fn play_person(
        self,
        person: usize,
        seed: u64,
        t: f32,
        mut set: impl FnMut(&str, f32),
    ) -> Option<Instant> {
        let seed = seed ^ (person as u64).wrapping_mul(0xa076_1d64_78bd_642f);
        let calm = ramp(t, 1.0, 3.0);
        let walk = |channel, period, range: f32| {
            (wander(seed, channel, t, period) * 1.3 * range).clamp(-range, range) * calm
        };
        let turned = |yaw, pitch| [walk(1, 2.3, yaw), walk(2, 2.9, pitch), walk(3, 3.1, 8.0)];
        match self {
            Self::Empty | Self::Furnished => None,
            Self::Still => placed([0.0; 3], [0.0, -0.02, 0.7]),
            // A Lissajous walk through the range.
            Self::Turning => placed(
                [
                    25.0 * swing(t, 8.0),
                    15.0 * swing(t, 5.3),
                    6.0 * swing(t, 11.0),
                ],
                [0.0, -0.02, 0.8],
            ),
            Self::Acted | Self::Demo | Self::Leaving | Self::Wide | Self::Mixed => {
                let mut aside = 0.0;
                if self == Self::Leaving {
                    let phase = t % 20.0;
                    if (8.0..13.0).contains(&phase) {
                        return None;
                    }
                    aside = ramp(phase, 6.0, 8.0) - ramp(phase, 13.0, 15.0);
                }
                if self == Self::Mixed {
                    mix(seed, t, &mut set);
                } else {
                    Self::act(seed, t, &mut set);
                }
                let angles = if self == Self::Wide {
                    turned(45.0, 30.0)
                } else {
                    turned(25.0, 15.0)
                };
                let x = walk(4, 3.7, 0.07) + aside * 1.1;
                placed(
                    angles,
                    [x, -0.02 + walk(5, 4.1, 0.04), 0.8 + walk(6, 4.7, 0.2)],
                )
            }
            #[cfg(feature = "studio")]
            Self::Moods => {
                let (mood, within) = ((t / MOOD_S) as usize % MOODS.len(), t % MOOD_S);
                let height = ramp(within, 0.3, 0.9) * (1.0 - ramp(within, 2.2, 2.8));
                for (name, weight) in MOODS[mood] {
                    set(name, weight * height);
                }
                placed(turned(12.0, 7.0), [0.0, -0.02, 0.75])
            }
            Self::Fast => {
                // 64° in 0.48 s, at most half as fast again as on average; then a rest.
                let phase = t % 2.4;
                let yaw = 32.0 * (2.0 * (ramp(phase, 0.6, 1.08) - ramp(phase, 1.8, 2.28)) - 1.0);
                placed([yaw * ramp(t, 0.0, 0.5), 0.0, 0.0], [0.0, -0.02, 0.75])
            }
            Self::Hand => placed(
                [5.0 * swing(t, 7.0), 3.0 * swing(t, 5.3), 0.0],
                [0.01 * swing(t, 6.1), -0.02, 0.8],
            ),
            Self::Two => {
                Self::act(seed, t, &mut set);
                let side = if person == 0 { -1.0 } else { 1.0 };
                placed(
                    turned(20.0, 12.0),
                    [
                        side * 0.25 + walk(4, 3.7, 0.04),
                        -0.02 + walk(5, 4.1, 0.03),
                        0.95 + 0.1 * side + walk(6, 4.7, 0.06),
                    ],
                )
            }
            Self::Four => {
                Self::act(seed, t, &mut set);
                let [x, z] = [[-0.51, 1.35], [-0.15, 1.15], [0.16, 1.4], [0.5, 1.2]][person % 4];
                placed(
                    turned(15.0, 10.0),
                    [x + walk(4, 3.7, 0.03), -0.03 + walk(5, 4.1, 0.02), z],
                )
            }
            Self::Crossing => {
                Self::act(seed, t, &mut set);
                let [x, y, z] = [[0.33, -0.02, 0.85], [-0.40, -0.05, 1.3]][person % 2];
                placed(turned(15.0, 8.0), [x * swing(t, 10.0), y, z])
            }
            Self::Swap => {
                let phase = t % 20.0;
                let away = if person == 0 {
                    ramp(phase, 4.5, 6.0) - ramp(phase, 14.0, 15.5)
                } else {
                    1.0 - ramp(phase, 7.0, 8.5) + ramp(phase, 11.5, 13.0)
                };
                if away >= 1.0 {
                    return None;
                }
                Self::act(seed, t, &mut set);
                let side = if person == 0 { -1.0 } else { 1.0 };
                let angles = turned(18.0, 10.0);
                placed(angles, [side * away * 1.0 + walk(4, 3.7, 0.03), -0.02, 0.8])
            }
            Self::Behind => {
                let [x, y, z] =
                    [[-0.35, -0.03, 1.3], [0.0, -0.1, 1.6], [0.3, 0.02, 1.1]][person % 3];
                let [yaw, pitch, roll] = turned(25.0, 10.0);
                placed([180.0 + yaw, pitch, roll], [x + walk(4, 3.7, 0.03), y, z])
            }
        }
    }

    /// Where a hand is held up at `t` seconds, if the scene has one: the middle of its palm, metres.
    pub(crate) fn hand(self, t: f32) -> Option<Point> {
        if self != Self::Hand {
            return None;
        }
        let (turn, phase) = ((t / HAND_EVERY_S) as usize, t % HAND_EVERY_S);
        let comes = 2.0 - HAND_MOVES_S;
        let goes = 2.0 + HAND_STAYS_S[turn % HAND_STAYS_S.len()];
        let up = ramp(phase, comes, comes + HAND_MOVES_S) - ramp(phase, goes, goes + HAND_MOVES_S);
        (up > 0.0).then(|| Point::new(0.0, 0.02 + 0.5 * (1.0 - up), 0.66))
    }

    fn act(seed: u64, t: f32, set: &mut impl FnMut(&str, f32)) {
        let (slot, within) = ((t / ACT_S) as u64, t % ACT_S);
        let turn = ACTS.len() as u64 + MIXTURES;
        let height = 0.85 + 0.15 * uniform(seed ^ 0x51, slot);
        let mut play = |act: Act, strength: f32| {
            for &(name, weight) in act {
                if name == "speech" {
                    let loud = ramp(within, 0.0, 0.25) * (1.0 - ramp(within, 1.5, 1.8));
                    let talk = |channel, period| {
                        (0.5 + 0.6 * wander(seed, channel, t, period)).clamp(0.0, 1.0)
                    };
                    set("jawOpen", 0.4 * loud * talk(11, 0.13));
                    set("mouthFunnel", 0.5 * loud * talk(12, 0.23));
                    set("mouthLowerDown_L", 0.4 * loud * talk(13, 0.19));
                    set("mouthLowerDown_R", 0.4 * loud * talk(13, 0.19));
                } else {
                    set(name, weight * strength);
                }
            }
        };
        let pick =
            |channel| (uniform(seed ^ channel, slot) * 0.5 + 0.5) * (ACTS.len() as f32 - 0.01);
        if slot % turn < ACTS.len() as u64 {
            play(ACTS[(slot % turn) as usize], height * envelope(within));
        } else {
            play(ACTS[pick(0x52) as usize], height * envelope(within));
            play(ACTS[pick(0x53) as usize], 0.8 * envelope(within + 0.2));
        }
        let (blink, since) = ((t / BLINK_EVERY_S) as u64, t % BLINK_EVERY_S);
        let since = since - 1.4 - uniform(seed ^ 0x54, blink);
        let closed = ramp(since, 0.0, 0.1) * (1.0 - ramp(since, 0.14, 0.32));
        if closed > 0.0 {
            set("eyeBlink_L", closed);
            set("eyeBlink_R", closed);
        }
    }
}

/// Expressions that [`Scene::Mixed`] draws from; those with sides are played on one or both.
const SIDED: [&str; 16] = [
    "mouthSmile",
    "mouthStretch",
    "mouthUpperUp",
    "mouthLowerDown",
    "noseSneer",
    "browDown",
    "browInnerUp",
    "browOuterUp",
    "eyeSquint",
    "eyeWide",
    "cheekRaiser",
    "cheekPuff",
    "mouthFrown",
    "mouthDimple",
    "mouthPress",
    "cheekSquint",
];
const WHOLE: [&str; 13] = [
    "jawOpen",
    "jawLeft",
    "jawRight",
    "jawForward",
    "mouthFunnel",
    "mouthPucker",
    "mouthShrugLower",
    "mouthShrugUpper",
    "mouthRollLower",
    "mouthRollUpper",
    "mouthRoll",
    "mouthLeft",
    "mouthRight",
];
/// Both lips rolled in at once, which is no expression of the head's own.
const ROLL: (&str, [&str; 2]) = ("mouthRoll", ["mouthRollLower", "mouthRollUpper"]);
/// Voices of [`mix`] that come and go by themselves, and how long each holds an expression, seconds.
const VOICES: u64 = 3;
const VOICE_S: f32 = 1.7;

/// Random expressions, and blinks: people of odd seeds have [`VOICES`] that mix them freely, those of even seeds one, which
/// pauses as long as it acts.
fn mix(seed: u64, t: f32, set: &mut impl FnMut(&str, f32)) {
    let (voices, silence) = if seed % 2 == 1 {
        (VOICES, 0.25)
    } else {
        (1, 0.5)
    };
    let share = |channel: u64, index: u64| uniform(seed ^ channel, index) * 0.5 + 0.5;
    let mut name = heapless::String::<24>::new();
    let mut sided = |stem: &str, side: &str, weight: f32, set: &mut dyn FnMut(&str, f32)| {
        name.clear();
        // Names of the list fit.
        if name
            .push_str(stem)
            .and_then(|()| name.push_str(side))
            .is_ok()
        {
            set(&name, weight);
        }
    };
    for voice in 0..voices {
        let t = t + VOICE_S * voice as f32 / VOICES as f32;
        let slot = (t / VOICE_S) as u64 * VOICES + voice;
        let weight = envelope(t % VOICE_S) * (0.15 + 0.85 * share(0x61, slot));
        if weight <= 0.0 || share(0x62, slot) < silence {
            continue;
        }
        let pick = (share(0x63, slot) * (SIDED.len() + WHOLE.len()) as f32) as usize;
        if let Some(stem) = SIDED.get(pick) {
            let lean = uniform(seed ^ 0x64, slot);
            let (left, right) = match lean {
                l if l > 0.6 => (1.0, 0.0),
                l if l < -0.6 => (0.0, 1.0),
                l => (1.0 + 0.3 * l.min(0.0), 1.0 - 0.3 * l.max(0.0)),
            };
            sided(stem, "_L", weight * left, set);
            sided(stem, "_R", weight * right, set);
        } else if let Some(stem) = WHOLE.get(pick - SIDED.len()) {
            if *stem == ROLL.0 {
                ROLL.1.iter().for_each(|part| set(part, weight));
            } else {
                set(stem, weight);
            }
        }
    }
    gaze(seed, t, set);
    let blink = (t / 1.9) as u64;
    let since = t % 1.9 - 0.3 - 1.2 * share(0x65, blink);
    let closed = ramp(since, 0.0, 0.1) * (1.0 - ramp(since, 0.14, 0.32));
    let lean = uniform(seed ^ 0x66, blink);
    if closed > 0.0 {
        set("eyeBlink_L", if lean < -0.5 { 0.0 } else { closed });
        set("eyeBlink_R", if lean > 0.5 { 0.0 } else { closed });
    }
}

/// Looks about: eyes rest on a place for a second and jump to the next.
fn gaze(seed: u64, t: f32, set: &mut impl FnMut(&str, f32)) {
    /// Seconds a glance, and of the jump to it; how far it goes, of the full expression, across and up or down.
    const GLANCE_S: f32 = 1.1;
    const JUMP_S: f32 = 0.06;
    const FAR: [f32; 2] = [0.5, 0.35];
    let glance = (t / GLANCE_S) as u64;
    let there = ramp(t % GLANCE_S, 0.0, JUMP_S);
    let [left, up] = [(0x67, FAR[0]), (0x68, FAR[1])].map(|(channel, far)| {
        let [from, to] = [glance, glance + 1].map(|k| far * uniform(seed ^ channel, k));
        from + (to - from) * there
    });
    set("eyeLookOut_L", left.max(0.0));
    set("eyeLookIn_R", left.max(0.0));
    set("eyeLookOut_R", (-left).max(0.0));
    set("eyeLookIn_L", (-left).max(0.0));
    for side in ["eyeLookUp_L", "eyeLookUp_R"] {
        set(side, up.max(0.0));
    }
    for side in ["eyeLookDown_L", "eyeLookDown_R"] {
        set(side, (-up).max(0.0));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::geometry::yaw_pitch_roll;

    #[test]
    fn an_acted_minute_covers_the_range_smoothly() {
        let mut before: Option<Instant> = None;
        let (mut widest, mut near, mut far) = (0.0f32, 9.0f32, 0.0f32);
        for frame in 0..3600 {
            let t = frame as f32 / 60.0;
            let mut largest = 0.0f32;
            let now = Scene::Acted
                .play(5, t, |_, w| largest = largest.max(w))
                .expect("somebody");
            assert!(largest <= 1.0);
            let (yaw, pitch, _) = yaw_pitch_roll(&now.sensor_from_head.rotation);
            assert!(yaw.abs() <= 25.01f32.to_radians() && pitch.abs() <= 15.01f32.to_radians());
            widest = widest.max(yaw.abs());
            let z = now.sensor_from_head.translation.z;
            (near, far) = (near.min(z), far.max(z));
            if let Some(before) = before {
                let turned = before
                    .sensor_from_head
                    .rotation
                    .angle_to(&now.sensor_from_head.rotation);
                let moved = before.sensor_from_head.translation.vector
                    - now.sensor_from_head.translation.vector;
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
        assert_eq!(most.len(), 2 * SIDED.len() + WHOLE.len() + 2 + 8 - 1);
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
