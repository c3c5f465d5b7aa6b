//! Learns one measure's range as in the paper: compensating samples, a bounded merging set, then the end scan or merging to three
//! nodes.
//!
//! Method: Jiang Na et al., sections 2.3 to 2.6; the parts are in `compensate`, `samples`, `one_way`, `two_way`. Added where
//! the paper is silent: rest follows the first estimate at once, but the population's interval fades into the person's during
//! the first seconds of presence and is never narrowed; nodes move to a new estimate with a time constant of a second
//! (consecutive estimates can differ by a whole range), and weights decay with a half-life if one is set.
//! Memory: about 16 bytes per sample. Cost: three pushes a frame; the estimate runs twice a second, which is enough.
//! Degenerate: a set without width, or with fewer than three distinct values, keeps the previous estimate.

use super::compensate::compensation;
use super::one_way;
use super::range::Range;
use super::samples::{Sample, SampleSet};
use super::settings::Settings;
use super::two_way;
use super::units::{Kind, Prior};
use crate::base::capacity::PAPER_SAMPLES;
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;

/// Seconds between two estimates.
const ESTIMATE_EVERY_S: f64 = 0.5;
/// Time of the first estimate, seconds, by phase: before weights fade in.
const FIRST_S: core::ops::Range<f64> = 0.2..0.3;
/// Time constant of the nodes' glide, seconds.
const GLIDE_S: f64 = 1.0;

/// Learner of one measure.
#[derive(Clone, Debug)]
pub struct PaperLearner {
    settings: Settings,
    prior: Prior,
    kind: Kind,
    samples: SampleSet<PAPER_SAMPLES>,
    estimate: Option<Range>,
    range: Range,
    seconds: f64,
    next_estimate_s: f64,
    decayed_s: f64,
}

impl PaperLearner {
    /// Starts from the prior; `phase` (0…1) staggers the estimates of several measures.
    pub fn new(settings: Settings, prior: Prior, kind: Kind, phase: f64) -> Self {
        Self {
            settings,
            prior,
            kind,
            samples: SampleSet::default(),
            estimate: None,
            range: Range::from_prior(&prior, kind),
            seconds: 0.0,
            next_estimate_s: FIRST_S.start + phase * (FIRST_S.end - FIRST_S.start),
            decayed_s: 0.0,
        }
    }

    /// Forgets the person.
    pub fn reset(&mut self) {
        let phase = self.next_estimate_s / ESTIMATE_EVERY_S;
        *self = Self::new(self.settings, self.prior, self.kind, phase.fract());
    }

    /// Adds a frame's value of weight ω, `dt` seconds after the last.
    pub fn observe(&mut self, g: f64, omega: f64, dt: f64) {
        let spread = match self.settings.compensation_scale {
            scale if scale > 0.0 => scale * (self.prior.up + self.prior.down),
            _ => 1.0,
        };
        let Some(added) = compensation(omega, spread).filter(|_| g.is_finite()) else {
            return;
        };
        self.seconds += dt;
        for (value, weight) in [
            (g, omega),
            (g - added.offset, added.weight),
            (g + added.offset, added.weight),
        ] {
            // Samples without weight are ignored.
            self.samples.push(Sample { value, weight });
        }
        let hidden = self.estimate.is_none() && self.seconds < ESTIMATE_EVERY_S;
        let share = if hidden {
            1.0
        } else {
            1.0 - (-dt / GLIDE_S).exp()
        };
        if self.seconds >= self.next_estimate_s {
            if self.settings.half_life_s > 0.0 {
                let past_s = self.seconds - self.decayed_s;
                self.samples
                    .decay((-past_s / self.settings.half_life_s).exp2());
                self.decayed_s = self.seconds;
            }
            self.next_estimate_s = self.seconds + ESTIMATE_EVERY_S;
            self.estimate = self.literal().or(self.estimate);
        }
        let Some(estimate) = self.estimate else {
            return;
        };
        let prior = Prior {
            rest: estimate.rest,
            ..self.prior
        };
        let prior = Range::from_prior(&prior, self.kind);
        let target = prior.towards(estimate.at_least_as_wide_as(&prior), self.readiness());
        self.range = self.range.towards(target, share);
    }

    /// The paper's estimate from the current samples, without prior or glide; `None` if they give no interval.
    pub fn literal(&self) -> Option<Range> {
        if self.kind == Kind::TwoWay {
            return two_way::range(&self.samples, self.settings.scan);
        }
        let (samples, scan) = (self.samples.samples(), self.settings.scan);
        let (mut low, mut high) = one_way::interval(samples, scan)?;
        let rising = self.kind == Kind::Rising;
        let rest = if rising { &mut low } else { &mut high };
        if scan.rest > 0.0 {
            *rest = one_way::rest_end(samples, scan, rising)?;
        }
        let rest = *rest;
        (low < high).then_some(Range { low, rest, high })
    }

    /// Range in use.
    pub fn range(&self) -> Range {
        self.range
    }

    /// Signed weight by equation (8) or (9); an invalid one-way weight (below 0) is 0.
    pub fn weight(&self, g: f64) -> f64 {
        self.range.weight(g, self.kind, 0.0)
    }

    /// Share of the estimate that is the person's own, 0…1.
    pub fn readiness(&self) -> f64 {
        (self.seconds / self.settings.prior_s.max(1e-3)).min(1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PRIOR: Prior = Prior {
        kind: Kind::TwoWay,
        rest: 1.0,
        rest_sd: 0.1,
        up: 0.5,
        down: 0.2,
    };
    fn literal() -> Settings {
        Settings {
            half_life_s: 0.0,
            ..Settings::default()
        }
    }

    #[test]
    fn first_estimates_are_spread_over_a_tenth_of_a_second() {
        for (phase, first) in [(0.0, 20), (0.5, 25), (1.0, 30)] {
            let mut learner = PaperLearner::new(literal(), PRIOR, Kind::TwoWay, phase);
            let mut frames = 0;
            while learner.estimate.is_none() && frames < 100 {
                learner.observe(1.0 + 0.01 * f64::from(frames % 5), 1.0, 0.01);
                frames += 1;
            }
            assert!((first..=first + 1).contains(&frames), "{phase}: {frames}");
        }
    }

    #[test]
    fn starts_from_the_prior_and_ends_literal() {
        let mut learner = PaperLearner::new(literal(), PRIOR, Kind::TwoWay, 0.0);
        assert_eq!(
            learner.range(),
            Range {
                low: 0.8,
                rest: 1.0,
                high: 1.5
            }
        );
        let mut last = learner.range();
        for frame in 0..3000 {
            // Mostly rest at 1.2, some smiles to 1.9, some pouts to 0.9.
            let g = match frame % 100 {
                0..10 => 1.9,
                10..15 => 0.9,
                _ => 1.2,
            };
            learner.observe(g, 1.0, 1.0 / 30.0);
            let range = learner.range();
            assert!(
                (range.rest - last.rest).abs() < 0.03,
                "no jump: {range:?} after {last:?}"
            );
            last = range;
        }
        let literal = learner.literal().unwrap();
        for (found, expected) in [(literal.low, 0.9), (literal.rest, 1.2), (literal.high, 1.9)] {
            assert!((found - expected).abs() < 1e-9);
        }
        assert!((last.rest - 1.2).abs() < 1e-3 && (learner.weight(1.9) - 1.0).abs() < 1e-2);
    }

    #[test]
    fn the_first_range_is_the_populations_about_the_persons_rest() {
        let mut learner = PaperLearner::new(literal(), PRIOR, Kind::TwoWay, 1.0);
        for frame in 0..10 {
            learner.observe(1.3 + 0.01 * f64::from(frame % 3), 1.0, 1.0 / 30.0);
        }
        assert!(learner.weight(1.31).abs() < 0.1, "{:?}", learner.range());
        assert!((learner.weight(1.31 + 0.5) - 1.0).abs() < 0.1);
        assert!((learner.weight(1.31 - 0.2) + 1.0).abs() < 0.1);
    }

    #[test]
    fn invalid_samples_are_dropped() {
        let mut learner = PaperLearner::new(literal(), PRIOR, Kind::Rising, 0.0);
        for _ in 0..300 {
            learner.observe(9.0, 0.33, 1.0 / 30.0);
            learner.observe(f64::NAN, 1.0, 1.0 / 30.0);
        }
        assert!(learner.samples.samples().is_empty() && learner.readiness() == 0.0);
    }

    #[test]
    fn an_uncertain_sample_adds_two_compensating_ones() {
        let mut learner = PaperLearner::new(literal(), PRIOR, Kind::Rising, 0.0);
        learner.observe(1.0, 0.5, 1.0 / 30.0);
        let samples = learner.samples.samples();
        assert_eq!(samples.len(), 3);
        assert!((learner.samples.total_weight() - 1.0).abs() < 1e-12);
        assert!((samples[2].value - 1.816).abs() < 1e-3 && (samples[0].value - 0.184).abs() < 1e-3);
    }

    #[test]
    fn with_a_half_life_a_new_person_is_learned_after_a_year() {
        let settings = Settings {
            compensation_scale: 0.25,
            ..Settings::default()
        };
        let mut learner = PaperLearner::new(settings, PRIOR, Kind::TwoWay, 0.0);
        let act = |learner: &mut PaperLearner, shift: f64, frames: u32, dt: f64| {
            for frame in 0..frames {
                let g = match frame % 100 {
                    0..10 => 1.9,
                    10..15 => 0.9,
                    _ => 1.2,
                };
                learner.observe(g + shift, 1.0, dt);
            }
        };
        // A year in steps of 10 minutes, then an hour of somebody else at 30 Hz.
        act(&mut learner, 0.0, 52_560, 600.0);
        act(&mut learner, 3.0, 108_000, 1.0 / 30.0);
        assert!(
            (learner.range().rest - 4.2).abs() < 0.05,
            "{:?}",
            learner.range()
        );
    }
}
