//! Learns one measure's range, robust to outliers, long smiles, one-sided expressions and years of use: the default method.
//!
//! It replaces sections 2.3 to 2.6 of Jiang Na et al., whose end rules give 0.2 to 0.4 on a still face; the sample weight ω
//! (equations (4) and (5)) and the limit ω ≥ 1/3 are the paper's. Each frame: median of three (for learning only, so the
//! output is not delayed) → noise (`noise`) → two weights → store (`nodes`) → twice a second rest (`rest`) and both ends
//! (`ends`) → rate-limited motion of the nodes.
//!
//! Weights: C = ω dt for the ends, W = ω² dt/(1 + τ/3 s) for rest. τ is the time since the measure moved, so an expression held
//! for a minute counts as nine seconds; ω is squared because rest should come from frontal faces.
//! Motion: unlimited for the first 0.3 s (the output is still faded out), then rest moves by at most 2 R/s until 3 s, 0.25 R/s
//! until 20 s, 0.05 R/s after that (R: mean of the sides); ranges by 25 % a second, 5 % after 20 s.
//!
//! Units: those of the measure; seconds of presence. Memory: [`RANGE_NODES`] nodes of 32 bytes. Cost: about a microsecond
//! a frame. Degenerate: without valid samples the prior is used.
//! Limitation: an expression held from the first frame on is taken for rest until it ends.

use super::compensate::LEAST_WEIGHT;
use super::ends::{self, Side};
use super::nodes::Nodes;
use super::noise::Noise;
use super::range::Range;
use super::rest_mode;
use super::units::Prior;
use crate::base::capacity::RANGE_NODES;
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;

/// Initial white noise, in units of w: 0.25 % of the outer eye-corner distance.
const ASSUMED_NOISE: f64 = 0.006;
/// Time constant of a held pose's weight, seconds.
const HOLD_S: f64 = 3.0;
/// Seconds between two estimates.
const ESTIMATE_EVERY_S: f64 = 0.5;
/// Seconds between two estimates during the first two seconds.
const ESTIMATE_EARLY_S: f64 = 0.05;
/// Seconds during which the range jumps to its target.
const FREE_S: f64 = 0.3;

/// Parameters of the learner, besides the prior.
#[derive(Clone, Copy, Debug)]
pub struct RobustSettings {
    /// Half-life of the past, seconds; 0 never forgets.
    pub half_life_s: f64,
    /// κ: weight of the prior range, in half seconds of expression.
    pub range_prior: f64,
}

/// Learner of one measure.
#[derive(Clone, Debug)]
pub struct RobustLearner {
    population: (RobustSettings, Prior),
    settings: RobustSettings,
    prior: Prior,
    phase: f64,
    nodes: Nodes<RANGE_NODES>,
    noise: Noise,
    last: [f64; 2],
    frames: u32,
    held_at: f64,
    held_s: f64,
    seconds: f64,
    next_estimate_s: f64,
    /// Rest in use.
    rest: f64,
    /// Distances in use from rest to the full expression, rising and falling.
    sides: [f64; 2],
    /// Target of `rest`.
    rest_target: f64,
    /// Targets of `sides`.
    targets: [Side; 2],
    rest_seconds: f64,
}

fn median_of_three(a: f64, b: f64, c: f64) -> f64 {
    a.min(b).max(a.max(b).min(c))
}

impl RobustLearner {
    /// Starts from the prior; `phase` (0…1) staggers the estimates of several measures.
    pub fn new(settings: RobustSettings, prior: Prior, phase: f64) -> Self {
        Self {
            population: (settings, prior),
            settings,
            prior,
            phase,
            nodes: Nodes::default(),
            noise: Noise::new(ASSUMED_NOISE),
            last: [0.0; 2],
            frames: 0,
            held_at: prior.rest,
            held_s: 0.0,
            seconds: 0.0,
            next_estimate_s: 0.0,
            rest: prior.rest,
            sides: prior.sides(),
            rest_target: prior.rest,
            targets: prior.sides().map(|range| Side {
                range,
                evidence: 0.0,
            }),
            rest_seconds: 0.0,
        }
    }

    /// Forgets the person.
    pub fn reset(&mut self) {
        *self = Self::new(self.population.0, self.population.1, self.phase);
    }

    /// Marks a gap of missing or uncertain frames, which differences and medians must not span.
    pub fn interrupt(&mut self) {
        self.noise.interrupt();
        self.frames = 0;
    }

    /// Adds a frame's finite value of weight ω, `dt` seconds after the last.
    pub fn observe(&mut self, g: f64, omega: f64, dt: f64) {
        if omega.is_nan() || omega < LEAST_WEIGHT || !g.is_finite() {
            self.interrupt();
            return;
        }
        self.noise.observe(g);
        let clean = match self.frames {
            0 => g,
            1 => 0.5 * (g + self.last[0]),
            _ => median_of_three(g, self.last[0], self.last[1]),
        };
        self.last = [g, self.last[0]];
        self.frames = self.frames.saturating_add(1);
        self.seconds += dt;

        let span = self.span();
        let sigma = self.noise.sigma();
        if (clean - self.held_at).abs() > (0.12 * span).max(3.0 * sigma) {
            self.held_at = clean;
            self.held_s = 0.0;
        } else {
            self.held_s += dt;
        }
        self.nodes.advance(dt, self.settings.half_life_s);
        let rest_weight = omega * omega * dt / (1.0 + self.held_s / HOLD_S);
        self.nodes.push(clean, rest_weight, omega * dt);

        if self.seconds >= self.next_estimate_s {
            let every = if self.seconds < FREE_S {
                0.0
            } else if self.seconds < 2.0 {
                ESTIMATE_EARLY_S
            } else {
                ESTIMATE_EVERY_S
            };
            // The phase delays once, at the first estimate after the early ones.
            let is_first = self.next_estimate_s < 2.0 + ESTIMATE_EARLY_S;
            let stagger = if every == ESTIMATE_EVERY_S && is_first {
                self.phase * every
            } else {
                0.0
            };
            self.next_estimate_s = self.seconds + every + stagger;
            self.estimate(sigma);
        }
        self.move_nodes(dt);
    }

    fn span(&self) -> f64 {
        self.sides[0] + self.sides[1]
    }

    fn estimate(&mut self, sigma: f64) {
        let (nodes, growth) = (self.nodes.as_slice(), self.nodes.growth());
        let h = (1.5 * sigma).max(0.06 * self.span());
        let mode = rest_mode::mode(nodes, growth, h, &self.prior, self.rest);
        self.rest_target = mode.value;
        self.rest_seconds = mode.seconds;
        let (acts, priors) = (self.prior.kind.sides(), self.prior.sides());
        for k in (0..2).filter(|&k| acts[k]) {
            self.targets[k] = ends::side(
                nodes,
                growth,
                k == 0,
                mode.value,
                sigma,
                priors[k],
                self.sides[k],
                self.settings.range_prior,
            );
        }
    }

    fn move_nodes(&mut self, dt: f64) {
        if self.seconds < FREE_S {
            self.rest = self.rest_target;
            return;
        }
        let sides = self
            .prior
            .kind
            .sides()
            .map(|acts| f64::from(u8::from(acts)));
        let r = self.span() / (sides[0] + sides[1]);
        let (rest_rate, range_rate) = match self.seconds {
            s if s < 3.0 => (2.0, 0.25),
            s if s < 20.0 => (0.25, 0.25),
            _ => (0.05, 0.05),
        };
        let step = rest_rate * r * dt;
        self.rest += (self.rest_target - self.rest).clamp(-step, step);
        let step = range_rate * dt;
        for (range, target) in self.sides.iter_mut().zip(&self.targets) {
            if *range > 0.0 {
                *range *= (target.range / *range).ln().clamp(-step, step).exp();
            }
        }
    }

    /// Range in use.
    pub fn range(&self) -> Range {
        Range {
            low: self.rest - self.sides[1],
            rest: self.rest,
            high: self.rest + self.sides[0],
        }
    }

    /// Standard deviation of the measure's noise.
    pub fn sigma(&self) -> f64 {
        self.noise.sigma()
    }

    /// Seconds of evidence at rest.
    pub fn rest_seconds(&self) -> f64 {
        self.rest_seconds
    }

    /// Readiness of rest, 0…1.
    pub fn rest_readiness(&self) -> f64 {
        1.0 - (-self.rest_seconds / HOLD_S).exp()
    }

    /// Readiness of the rising and the falling side, 0…1: evidence of rest and expression, and size of the range against the noise.
    pub fn readiness(&self) -> [f64; 2] {
        [0, 1].map(|k| {
            let (evidence, range) = (self.targets[k].evidence, self.sides[k]);
            let measurable = (range / (4.0 * self.sigma()).max(f64::MIN_POSITIVE)).min(1.0);
            self.rest_readiness() * evidence / (self.settings.range_prior + evidence) * measurable
        })
    }

    /// Sets rest to `g` at once (the user has set the neutral face).
    pub fn set_rest(&mut self, g: f64) {
        self.prior.rest = g;
        self.prior.rest_sd *= 0.5;
        (self.rest, self.rest_target) = (g, g);
    }

    /// Starts from a saved range of this person, ordered and finite. Its sides weigh more than the population's; rest may have shifted
    /// since the last session.
    pub fn restore(&mut self, range: Range) {
        let (settings, prior) = self.population;
        // A side without a unit stays 0.
        let within =
            |own: f64, usual: f64| own.clamp(LEAST_RESTORED * usual, usual / LEAST_RESTORED);
        let own = Prior {
            rest: range.rest,
            rest_sd: 0.5 * prior.rest_sd,
            up: within(range.high - range.rest, prior.up),
            down: within(range.rest - range.low, prior.down),
            ..prior
        };
        let settings = RobustSettings {
            range_prior: RESTORED_PRIOR * settings.range_prior,
            ..settings
        };
        *self = Self {
            population: self.population,
            ..Self::new(settings, own, self.phase)
        };
    }
}

/// Restored sides are limited to between this share of the population's and its inverse.
const LEAST_RESTORED: f64 = 0.3;
/// Factor on the prior's weight for a person's saved range.
const RESTORED_PRIOR: f64 = 2.0;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::expression::units::Kind;

    const PRIOR: Prior = Prior {
        kind: Kind::TwoWay,
        rest: 1.38,
        rest_sd: 0.13,
        up: 0.47,
        down: 0.25,
    };
    const SETTINGS: RobustSettings = RobustSettings {
        half_life_s: 300.0,
        range_prior: 8.0,
    };
    const DT: f64 = 1.0 / 30.0;

    fn jitter(random: &mut fastrand::Rng) -> f64 {
        0.01 * (random.f64() + random.f64() + random.f64() - 1.5)
    }

    /// Rest at 1.5; every 5 s a second of smile of `smile`.
    fn act(learner: &mut RobustLearner, seconds: f64, smile: f64, random: &mut fastrand::Rng) {
        for frame in 0..(seconds / DT) as usize {
            let t = frame as f64 * DT % 5.0;
            let e = if (2.0..3.0).contains(&t) {
                (core::f64::consts::PI * (t - 2.0)).sin().sqrt()
            } else {
                0.0
            };
            learner.observe(1.5 + smile * e + jitter(random), 0.95, DT);
        }
    }

    #[test]
    fn rest_is_found_within_a_second_and_stays() {
        let mut random = fastrand::Rng::with_seed(1);
        let mut learner = RobustLearner::new(SETTINGS, PRIOR, 0.0);
        act(&mut learner, 1.0, 0.5, &mut random);
        assert!(
            (learner.range().rest - 1.5).abs() < 0.02,
            "{:?}",
            learner.range()
        );
        act(&mut learner, 600.0, 0.5, &mut random);
        assert!(
            (learner.range().rest - 1.5).abs() < 0.01,
            "{:?}",
            learner.range()
        );
    }

    #[test]
    fn the_range_follows_the_person_and_an_unseen_side_keeps_the_prior() {
        let mut random = fastrand::Rng::with_seed(2);
        let mut learner = RobustLearner::new(SETTINGS, PRIOR, 0.0);
        act(&mut learner, 120.0, 0.35, &mut random);
        let range = learner.range();
        assert!((range.high - range.rest - 0.35).abs() < 0.05, "{range:?}");
        assert!((range.rest - range.low - 0.25).abs() < 0.01, "{range:?}");
        let [up, down] = learner.readiness();
        assert!(up > 0.5 && down < 0.05, "{up} {down}");
    }

    #[test]
    fn a_rest_that_drifts_by_less_than_a_window_is_its_mean() {
        // Half a second each at 1.49 and 1.51, without noise: a window is 6 % of the range, 0.04.
        let mut learner = RobustLearner::new(SETTINGS, PRIOR, 0.0);
        for frame in 0..900 {
            learner.observe(if frame / 15 % 3 == 0 { 1.51 } else { 1.49 }, 0.95, DT);
        }
        let rest = learner.range().rest;
        assert!((rest - 1.4967).abs() < 0.002, "{rest}");
    }

    #[test]
    fn a_smile_held_for_a_minute_does_not_become_rest() {
        let mut random = fastrand::Rng::with_seed(3);
        let mut learner = RobustLearner::new(SETTINGS, PRIOR, 0.0);
        act(&mut learner, 60.0, 0.45, &mut random);
        for _ in 0..1800 {
            learner.observe(1.95 + jitter(&mut random), 0.95, DT);
        }
        assert!(
            (learner.range().rest - 1.5).abs() < 0.02,
            "{:?}",
            learner.range()
        );
    }

    #[test]
    fn outliers_do_not_stretch_the_range() {
        let mut random = fastrand::Rng::with_seed(4);
        let mut learner = RobustLearner::new(SETTINGS, PRIOR, 0.0);
        for _ in 0..8 {
            act(&mut learner, 20.0, 0.45, &mut random);
            learner.observe(1.5 + 0.8, 0.95, DT);
            act(&mut learner, 20.0, 0.45, &mut random);
            for _ in 0..3 {
                learner.observe(1.5 - 0.8, 0.95, DT);
            }
        }
        let range = learner.range();
        assert!((range.high - range.rest - 0.45).abs() < 0.05, "{range:?}");
        assert!(range.rest - range.low < 1.3 * 0.25, "{range:?}");
        assert!((range.rest - 1.5).abs() < 0.01);
    }

    #[test]
    fn nodes_never_jump() {
        let mut random = fastrand::Rng::with_seed(5);
        let mut learner = RobustLearner::new(SETTINGS, PRIOR, 0.0);
        act(&mut learner, 0.3, 0.0, &mut random);
        let mut last = learner.range();
        for frame in 0..9000 {
            let g = if (frame / 300) % 2 == 0 { 1.2 } else { 1.9 };
            learner.observe(g + jitter(&mut random), 0.95, DT);
            let range = learner.range();
            // 2 R/s with R the mean of two sides, each at most doubled.
            let most = 2.0 * DT * (range.high - range.low);
            assert!(
                (range.rest - last.rest).abs() <= most,
                "{range:?} after {last:?}"
            );
            last = range;
        }
    }

    #[test]
    fn invalid_samples_are_not_learned() {
        let mut learner = RobustLearner::new(SETTINGS, PRIOR, 0.0);
        for _ in 0..300 {
            learner.observe(2.0, 0.33, DT);
            learner.observe(f64::NAN, 1.0, DT);
            learner.observe(2.0, f64::NAN, DT);
        }
        assert_eq!(
            learner.range(),
            Range {
                low: 1.38 - 0.25,
                rest: 1.38,
                high: 1.38 + 0.47
            }
        );
    }

    #[test]
    fn a_saved_person_starts_where_they_were() {
        let mut learner = RobustLearner::new(SETTINGS, PRIOR, 0.0);
        learner.restore(Range {
            low: 1.3,
            rest: 1.5,
            high: 1.9,
        });
        let range = learner.range();
        assert!((range.low - 1.3).abs() < 1e-12 && (range.high - 1.9).abs() < 1e-12);
        learner.restore(Range {
            low: 1.5,
            rest: 1.5,
            high: 90.0,
        });
        let range = learner.range();
        assert!(
            range.high - range.rest < 2.0 && range.rest - range.low > 0.05,
            "held to people: {range:?}"
        );
    }

    #[test]
    fn differences_do_not_span_an_uncertain_frame() {
        let mut learner = RobustLearner::new(SETTINGS, PRIOR, 0.0);
        for (g, omega) in [(1.0, 1.0), (1.0, 1.0), (1.0, 0.1), (2.0, 1.0)] {
            learner.observe(g, omega, DT);
        }
        // Of three the median would still be 1.
        let last = learner.nodes.as_slice().last().map(|node| node.value);
        assert!(last.is_some_and(|value| value > 1.9), "{last:?}");
        assert_eq!(learner.frames, 1);
    }

    #[test]
    fn every_frame_of_the_start_is_estimated() {
        for (first_s, brings) in [(0.29, true), (0.3, false)] {
            let mut learner = RobustLearner::new(SETTINGS, PRIOR, 0.0);
            learner.observe(1.5, 1.0, first_s);
            let before = learner.rest_seconds();
            learner.observe(1.5, 1.0, 0.005);
            assert_eq!(learner.rest_seconds() != before, brings, "{first_s} s");
            // A twentieth of a second after the last there is one in any case.
            learner.observe(1.5, 1.0, 0.05);
            assert!(learner.rest_seconds() != before);
        }
    }

    #[test]
    fn a_phase_delays_later_estimates() {
        // Frames of a quarter of a second: exact in binary. Half of half a second is one of them.
        for (phase, expected) in [(0.0, [2.0, 2.5, 3.0]), (0.5, [2.0, 2.75, 3.25])] {
            let mut learner = RobustLearner::new(SETTINGS, PRIOR, phase);
            let mut estimates = Vec::new();
            for frame in 1..=13 {
                let before = learner.rest_seconds();
                learner.observe(1.5, 1.0, 0.25);
                if frame >= 8 && learner.rest_seconds() != before {
                    estimates.push(0.25 * f64::from(frame));
                }
            }
            assert_eq!(estimates, expected, "phase {phase}");
        }
    }
}
