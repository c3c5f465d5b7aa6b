//! Frame-to-frame noise of one measure, estimated while the measure may move.
//!
//! Method: von Neumann et al. 1941, dispersion from successive differences, made robust: for white noise of deviation σ the
//! second difference g0 − 2 g1 + g2 has deviation √6 σ and median size 0.6745 √6 σ, while anything smooth cancels. The
//! median is tracked by steps up or down in proportion to itself. Units of the measure. Memory: three numbers.
//! Limitation: only white noise is estimated; [`Noise::sigma`] is that times 1.5, because the correlated jitter of a face
//! tracker is about as large as its white noise.

use crate::base::defaults;
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;

/// Step of the running median, per frame: half of the way in about 20 frames.
const STEP: f64 = 0.035;
/// Ratio of all noise to its white part.
const WHITE_TO_ALL: f64 = 1.5;
/// 0.6745 √6.
const MEDIAN_OF_SECOND_DIFFERENCE: f64 = 1.652_181;

/// Running noise of one measure.
#[derive(Clone, Debug)]
pub struct Noise {
    white: f64,
    least: f64,
    last: [f64; 2],
    seen: u8,
}

impl Noise {
    /// Starts at a white noise of `assumed`, and never falls below a thirtieth of it.
    pub fn new(assumed: f64) -> Self {
        Self {
            white: assumed,
            least: assumed / 30.0,
            last: [0.0; 2],
            seen: 0,
        }
    }

    /// Adds the next frame's value.
    pub fn observe(&mut self, g: f64) {
        if self.seen >= 2 {
            let target =
                (self.last[1] - 2.0 * self.last[0] + g).abs() / MEDIAN_OF_SECOND_DIFFERENCE;
            let factor = if target > self.white {
                1.0 + STEP
            } else {
                1.0 / (1.0 + STEP)
            };
            self.white = (self.white * factor).max(self.least);
        } else {
            self.seen += 1;
        }
        self.last = [g, self.last[0]];
    }

    /// Marks a gap of frames: resets the differences.
    pub fn interrupt(&mut self) {
        self.seen = 0;
    }

    /// Standard deviation of the measure's noise.
    pub fn sigma(&self) -> f64 {
        WHITE_TO_ALL * self.white
    }
}

defaults! {
    /// Slow drift of a reading at rest, by light, head motion and other expressions.
    ///
    /// Frame-to-frame differences do not show it. Low readings that hardly move count as drift, of which a quantile is tracked
    /// by small steps up and down (stochastic approximation; Tierney 1983). Shares of the unit's range.
    #[derive(Clone, Copy, Debug)]
    pub(super) struct SlowNoise {
        /// The tracked quantile.
        level: f64 = 0.03,
        /// The reading, low-passed.
        slow: f64 = 0.0,
        /// Seconds of readings taken in.
        taken_s: f64 = 0.0,
    }
}

/// Share of time that a resting unit is below its drift level.
const QUANTILE: f64 = 0.85;
/// Ratio of the dead zone to the quantile.
const ABOVE: f64 = 1.2;
/// Largest dead zone, as a share of the range.
const MOST: f64 = 0.3;
/// Step of the level per second.
const STEP_PER_S: f64 = 0.02;
/// Factor on the first steps.
const EARLY_STEPS: f64 = 6.0;
/// Time constant of the decay of that factor, seconds.
const EARLY_S: f64 = 2.0;
/// Largest difference of a still reading from its low-passed value.
const STILL: f64 = 0.04;
/// Time constant of that low-pass, seconds.
const STILL_S: f64 = 0.33;
/// Least reading that is an expression, moving or not.
const EXPRESSED: f64 = 0.5;

impl SlowNoise {
    /// Adds a reading's distance from rest, as a share of the range.
    pub(super) fn observe(&mut self, share: f64, dt: f64) {
        self.slow += (share - self.slow) * (dt / STILL_S).min(1.0);
        if (share - self.slow).abs() >= STILL || share >= EXPRESSED {
            return;
        }
        let early = EARLY_STEPS * (-self.taken_s / EARLY_S).exp();
        self.taken_s += dt;
        let step = STEP_PER_S * dt * early.max(1.0);
        let up = if share > self.level {
            QUANTILE
        } else {
            QUANTILE - 1.0
        };
        self.level = (self.level + step * up).max(0.0);
    }

    /// Dead zone against the drift, as a share of the range.
    pub(super) fn dead_share(&self) -> f64 {
        (ABOVE * self.level).min(MOST)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn normal(random: &mut fastrand::Rng) -> f64 {
        (-2.0 * (1.0 - random.f64()).ln()).sqrt() * (core::f64::consts::TAU * random.f64()).cos()
    }

    #[test]
    fn finds_the_noise_under_a_moving_signal() {
        let mut random = fastrand::Rng::with_seed(11);
        let mut noise = Noise::new(0.006);
        let mut mean = 0.0;
        for frame in 0..6000 {
            let signal = (f64::from(frame) * 0.05).sin();
            noise.observe(signal + 0.02 * normal(&mut random));
            if frame >= 1000 {
                mean += noise.sigma() / 5000.0;
            }
        }
        assert!((mean / (1.5 * 0.02) - 1.0).abs() < 0.06, "{mean}");
    }

    #[test]
    fn a_constant_measure_ends_at_the_floor() {
        let mut noise = Noise::new(0.006);
        for _ in 0..1000 {
            noise.observe(0.4);
        }
        assert!((noise.sigma() - 0.0003).abs() < 1e-9);
    }

    #[test]
    fn the_estimate_rises_only_for_larger_differences() {
        // A difference equal to the median counts as below it.
        for (jump, rises) in [(0.99, false), (1.0, false), (1.01, true)] {
            let mut noise = Noise::new(1.0 / MEDIAN_OF_SECOND_DIFFERENCE);
            let before = noise.sigma();
            for g in [0.0, 0.0, jump] {
                noise.observe(g);
            }
            assert_eq!(noise.sigma() > before, rises, "{jump}");
            assert!((noise.sigma() / before - 1.0).abs() > 1e-3);
        }
    }

    #[test]
    fn drift_is_tracked_and_an_expression_is_not() {
        let mut random = fastrand::Rng::with_seed(3);
        let dt = 1.0 / 30.0;
        let mut noise = SlowNoise::default();
        let act =
            |noise: &mut SlowNoise, random: &mut fastrand::Rng, seconds: u32, amplitude: f64| {
                for frame in 0..seconds * 30 {
                    // Strays evenly between 0 and 0.2; a full expression for one second in five.
                    let t = f64::from(frame) * dt;
                    let stray = (t * 0.1).fract() * 2.0;
                    let stray = 0.2 * stray.min(2.0 - stray);
                    let acted = if t % 5.0 > 4.0 { amplitude } else { 0.0 };
                    noise.observe(stray + acted + 0.004 * normal(random), dt);
                }
            };
        act(&mut noise, &mut random, 120, 0.0);
        let quiet = noise.dead_share();
        assert!((quiet - 1.2 * 0.85 * 0.2).abs() < 0.03, "{quiet}");
        act(&mut noise, &mut random, 120, 0.8);
        let acted = noise.dead_share();
        assert!((acted - quiet).abs() < 0.05, "{quiet} {acted}");
        // Once it is steady again, it is soon heard again.
        for _ in 0..60 * 30 {
            noise.observe(0.01 * normal(&mut random), dt);
        }
        assert!(noise.dead_share() < 0.04, "{}", noise.dead_share());
    }

    #[test]
    fn the_dead_zone_against_drift_is_bounded() {
        let mut noise = SlowNoise::default();
        for _ in 0..30 * 60 {
            noise.observe(0.45, 1.0 / 30.0);
        }
        assert!((noise.dead_share() - 0.3).abs() < 1e-12);
    }
}
