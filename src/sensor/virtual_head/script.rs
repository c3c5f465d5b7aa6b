//! What the simulated person does: pose and expression as smooth functions of time, the same for the same seed.
//!
//! Nothing is remembered from frame to frame, so any instant can be drawn without those before it. Curves are values
//! hashed per interval and joined by Hermite splines (value noise): smooth in position and speed.

use super::noise::uniform;
use crate::geometry::{Rigid, rotation_from_yaw_pitch_roll};

/// What is played.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Scene {
    /// Head turning within ±25° of yaw and ±15° of pitch at 0.6 to 1.0 m, every expression in turn, then mixed, with
    /// blinks and speech.
    #[default]
    Acted,
    /// A neutral face that faces the sensor at 0.7 m and does not move.
    Still,
    /// A neutral face that turns through the whole range.
    Turning,
    /// A wall and an empty chair.
    Empty,
    /// As `Acted`, but the person walks away after 6 s, is gone from 8 to 13 s, and is back at 15 s of every 20.
    Leaving,
}

impl Scene {
    /// All, with the names that select them.
    pub const NAMES: [(&'static str, Self); 5] = [
        ("acted", Self::Acted),
        ("still", Self::Still),
        ("turning", Self::Turning),
        ("empty", Self::Empty),
        ("leaving", Self::Leaving),
    ];

    /// Scene of a name.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        Self::NAMES
            .iter()
            .find(|(known, _)| *known == name)
            .map(|&(_, scene)| scene)
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

impl Scene {
    /// Who is where at `t` seconds; `set(name, weight)` is called for every expression above 0, perhaps twice for one
    /// name: the larger counts. `None`: nobody.
    pub(crate) fn play(self, seed: u64, t: f32, mut set: impl FnMut(&str, f32)) -> Option<Instant> {
        let mut aside = 0.0;
        let (yaw, pitch, roll, place) = match self {
            Self::Empty => return None,
            Self::Still => (0.0, 0.0, 0.0, [0.0, -0.02, 0.7]),
            Self::Turning => {
                // There and back every 8 s, pitch at another pace: a Lissajous walk through the range.
                let swing = |period: f32| {
                    let f = (t / period + 0.25).fract();
                    let triangle = 1.0 - 4.0 * (f - 0.5).abs();
                    triangle * (1.5 - 0.5 * triangle * triangle)
                };
                (
                    25.0 * swing(8.0),
                    15.0 * swing(5.3),
                    6.0 * swing(11.0),
                    [0.0, -0.02, 0.8],
                )
            }
            Self::Acted | Self::Leaving => {
                if self == Self::Leaving {
                    let phase = t % 20.0;
                    if (8.0..13.0).contains(&phase) {
                        return None;
                    }
                    aside = ramp(phase, 6.0, 8.0) - ramp(phase, 13.0, 15.0);
                }
                let calm = ramp(t, 1.0, 3.0);
                let swing = |channel, period, range: f32| {
                    (wander(seed, channel, t, period) * 1.3 * range).clamp(-range, range) * calm
                };
                (
                    swing(1, 2.3, 25.0),
                    swing(2, 2.9, 15.0),
                    swing(3, 3.1, 8.0),
                    [
                        swing(4, 3.7, 0.07),
                        -0.02 + swing(5, 4.1, 0.04),
                        0.8 + swing(6, 4.7, 0.2),
                    ],
                )
            }
        };
        if matches!(self, Self::Acted | Self::Leaving) {
            Self::act(seed, t, &mut set);
        }
        let [x, y, z] = place;
        let rotation =
            rotation_from_yaw_pitch_roll(yaw.to_radians(), pitch.to_radians(), roll.to_radians());
        let translation = nalgebra::Translation3::new(x + aside * 1.1, y, z);
        Some(Instant {
            sensor_from_head: Rigid::from_parts(translation, rotation),
        })
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::yaw_pitch_roll;

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
    fn somebody_leaves_and_returns() {
        let present = |t| Scene::Leaving.play(1, t, |_, _| {}).is_some();
        assert!(present(5.0) && !present(10.0) && present(16.0));
        assert!(Scene::Empty.play(1, 3.0, |_, _| {}).is_none());
        assert_eq!(Scene::named("leaving"), Some(Scene::Leaving));
        assert_eq!(Scene::named("party"), None);
    }
}
