//! One person's readings over time: deviations of all inputs from rest, and a learner for each unit's reading.
//!
//! Memory: a [`RobustLearner`] for each feature and each unit, and the rest of each input, about 100 KiB; nothing is allocated
//! after [`Together::new`].

use nalgebra::Vector3;

use super::features::{self, Feature};
use super::measures::{self, Measure};
use super::noise::SlowNoise;
use super::range::Range;
use super::readings::Reading;
use super::resting::{Resting, Turn};
use super::robust::RobustLearner;
use super::saved::Learned;
use super::settings::{LEAST_CONFIDENCE, Settings};
use super::smooth::MeasureFilter;
use super::units::{Kind, UnitName, Units};
use crate::base::capacity::{FEATURES, INPUTS, LEARNT_MEASURES, LENGTHS, MEASURES, UNITS};
use crate::base::geometry::Rotation;
use crate::base::prelude::*;
use crate::landmarks::Landmarks;

/// Units that are easily distinguished from rest and whose small values matter: speech moves the lips all the time and leaves
/// no rest to measure the noise in, and most smiles are slight.
const SLIGHT: [&str; 4] = ["AU12L", "AU12R", "AU25", "AU26"];

/// Least shares of the resting lid gap at which eyes count as open: of the wider eye, and of the other, whose lids come closer
/// together when it looks far towards the nose.
const OPEN: [f64; 2] = [0.55, 0.3];

/// Eyes whose irises seem off the middle at rest turn less visibly to that side and more to the other: a glance's share of
/// change by the gaze at rest, and its limit.
const OFF_MIDDLE: f64 = 0.8;
const MOST_OFF_MIDDLE: f64 = 0.5;

/// Noise of a glance, of the eyes' full range.
const GLANCE_NOISE: f64 = 0.05;

/// Of a reading that is the weight.
const ABSOLUTE: Range = Range {
    low: 0.0,
    rest: 0.0,
    high: 1.0,
};

/// How far somebody looks across, given how much further than at rest they seem to, and the gaze at rest.
fn looked(seems: f64, rest: f64) -> f64 {
    let off = OFF_MIDDLE * rest * seems.signum();
    seems * (1.0 + off.clamp(-MOST_OFF_MIDDLE, MOST_OFF_MIDDLE))
}

/// Readings of one person.
#[derive(Clone, Debug)]
pub(super) struct Together {
    features: Box<[RobustLearner]>,
    /// Of the readings that are not absolute, which come first.
    units: Box<[RobustLearner]>,
    /// `None` for the [`SLIGHT`] ones.
    strays: [Option<SlowNoise>; UNITS],
    filters: [MeasureFilter; UNITS],
    values: [f64; FEATURES],
    turn: Turn,
    /// Of measures and lengths.
    rests: [Resting; LEARNT_MEASURES + LENGTHS],
    half_life_s: f64,
    /// The last frame's: the head's rotation, how far each input is from its rest, and what of that is expression or glance.
    rotation: Vector3<f64>,
    pub(super) raw: [f64; INPUTS],
    departures: [f64; INPUTS],
    read: [f64; UNITS],
    /// Whether the eyes were seen open in the last frame.
    sees: bool,
}

impl Together {
    /// A person nobody has seen yet; none if the table has no readings.
    pub(super) fn new(settings: &Settings, units: &Units) -> Option<Self> {
        let priors = units.features.as_ref()?;
        let robust = settings.robust();
        let phase = |k: usize| (k as f64 * 0.618).fract();
        let learner = |(k, prior)| RobustLearner::new(robust, prior, phase(k));
        let features = priors.iter().copied();
        Some(Self {
            features: features.enumerate().map(learner).collect(),
            units: (0..units.readings.len().min(UNITS))
                .filter(|&k| !units.readings[k].absolute)
                .map(|k| learner((k, Reading::PRIOR)))
                .collect(),
            strays: core::array::from_fn(|k| {
                let reading = units.readings.get(k)?;
                (!SLIGHT.contains(&reading.unit.as_str())).then(SlowNoise::default)
            }),
            filters: core::array::from_fn(|_| MeasureFilter::default()),
            values: [0.0; FEATURES],
            turn: Turn::default(),
            rests: [Resting::default(); LEARNT_MEASURES + LENGTHS],
            half_life_s: settings.half_life_s,
            rotation: Vector3::zeros(),
            raw: [0.0; INPUTS],
            departures: [0.0; INPUTS],
            read: [0.0; UNITS],
            sees: false,
        })
    }

    /// Processes a frame: the face, its rotation, the eye distance to divide by (metres), the measures and the learners of their
    /// rest.
    pub(super) fn read(
        &mut self,
        landmarks: &Landmarks,
        sensor_from_head: &Rotation,
        divisor: f32,
        measures: &[f32; MEASURES],
        learners: &[RobustLearner],
        units: &Units,
    ) {
        for (m, learner) in learners.iter().enumerate() {
            self.raw[m] = f64::from(measures[m]) - learner.range().rest;
        }
        for (value, feature) in self.values.iter_mut().zip(&features::ALL) {
            *value = f64::from(feature.raw(&landmarks.head) / divisor);
        }
        // Behind closed lids eyes look ahead.
        let gap =
            |lid: Measure| f64::from(measures[lid as usize]) / learners[lid as usize].range().rest;
        let (left, right) = (gap(Measure::LidL), gap(Measure::LidR));
        let open = left.max(right) > OPEN[0] && left.min(right) > OPEN[1];
        let eyes = landmarks.eyes.as_ref().filter(|_| open);
        self.sees = false;
        if let (Some(gaze), Some(eyes)) = (&units.gaze, eyes) {
            let looks = gaze.of(eyes, sensor_from_head);
            for (value, looks) in self.values[LENGTHS..].iter_mut().zip(looks) {
                *value = f64::from(looks);
            }
            self.sees = true;
        }
        let departures = self.raw[LEARNT_MEASURES..].iter_mut();
        for ((departure, value), learner) in departures.zip(self.values).zip(&self.features) {
            *departure = value - learner.range().rest;
        }
        let gaze = &mut self.raw[LEARNT_MEASURES + LENGTHS..];
        if self.sees {
            gaze[0] = looked(gaze[0], self.features[LENGTHS].range().rest);
        } else {
            gaze.fill(0.0);
        }
        self.rotation = sensor_from_head.scaled_axis().cast();
        let turn = self.turn.about_mean(&self.rotation);
        self.departures = self.raw;
        for (departure, rest) in self.departures.iter_mut().zip(&self.rests) {
            *departure = rest.expressed(*departure, &turn);
        }
        for (read, reading) in self.read.iter_mut().zip(&units.readings) {
            *read = reading.of(&self.departures);
        }
        let before = self.read;
        for (read, reading) in self.read.iter_mut().zip(&units.readings) {
            *read += reading.correction(&before);
        }
    }

    /// Learns from the last frame read; `expressions`: whether deviations count as expressions yet.
    pub(super) fn learn(&mut self, landmarks: &Landmarks, omega: f64, dt: f64, expressions: bool) {
        let confidence =
            |feature: &Feature| measures::mean_confidence(feature.landmarks(), landmarks);
        let lengths = features::ALL
            .iter()
            .map(|feature| confidence(feature) >= LEAST_CONFIDENCE);
        let seen = lengths.chain([self.sees; FEATURES - LENGTHS]);
        for ((learner, &g), seen) in self.features.iter_mut().zip(&self.values).zip(seen) {
            if seen && g.is_finite() {
                learner.observe(g, omega, dt);
            } else {
                learner.interrupt();
            }
        }
        self.turn.observe(&self.rotation, dt);
        if expressions {
            let turn = self.turn.about_mean(&self.rotation);
            for (rest, &raw) in self.rests.iter_mut().zip(&self.raw) {
                if raw.is_finite() {
                    rest.observe(raw, &turn, dt, self.half_life_s);
                }
            }
            let learners = self.units.iter_mut().zip(&mut self.strays);
            for ((learner, strays), &read) in learners.zip(&self.read) {
                learner.observe(read, omega, dt);
                let range = learner.range();
                if let Some(strays) = strays {
                    strays.observe((read - range.rest) / (range.high - range.rest), dt);
                }
            }
        }
    }

    /// Weight and readiness of a reading.
    pub(super) fn weigh(&mut self, reading: usize, settings: &Settings, dt: f64) -> (f64, f64) {
        let Some(learner) = self.units.get(reading) else {
            let read = self.read[reading];
            let weight =
                self.filters[reading].filter(read, GLANCE_NOISE, settings.smoothing_hz, dt);
            let gaze = &self.features[LENGTHS..];
            let ready = gaze.iter().map(RobustLearner::rest_readiness);
            return (weight, ready.fold(1.0, f64::min));
        };
        let range = learner.range();
        let read = self.filters[reading].filter(
            self.read[reading],
            learner.sigma(),
            settings.smoothing_hz,
            dt,
        );
        let strays = self.strays[reading].map_or(0.0, |strays| strays.dead_share());
        let strays = strays * (range.high - range.rest);
        let dead_zone = (settings.dead_zone * learner.sigma()).max(strays);
        (
            range.weight(read, Kind::Rising, dead_zone),
            learner.readiness()[0],
        )
    }

    /// Range of a reading that its weight is computed with, and the deviation of its noise.
    pub(super) fn range(&self, reading: usize) -> (Range, f64) {
        let learner = self.units.get(reading);
        learner.map_or((ABSOLUTE, GLANCE_NOISE), |learner| {
            (learner.range(), learner.sigma())
        })
    }

    /// What was learned of the features, to be saved.
    pub(super) fn features(&self) -> heapless::Vec<Range, FEATURES> {
        self.features.iter().map(RobustLearner::range).collect()
    }

    /// What was learned of the readings, to be saved.
    pub(super) fn readings(&self, units: &Units) -> heapless::Vec<(UnitName, Range), UNITS> {
        let readings = units.readings.iter().zip(&self.units);
        readings
            .map(|(reading, learner)| (reading.unit.clone(), learner.range()))
            .collect()
    }

    /// Takes the last frame's face as rest.
    pub(super) fn take_neutral(&mut self) {
        for (learner, &g) in self.features.iter_mut().zip(&self.values) {
            learner.set_rest(g);
        }
        for learner in &mut self.units {
            learner.set_rest(0.0);
        }
    }

    /// Frames were missing.
    pub(super) fn interrupt(&mut self) {
        self.features.iter_mut().for_each(RobustLearner::interrupt);
        self.units.iter_mut().for_each(RobustLearner::interrupt);
        self.filters.iter_mut().for_each(MeasureFilter::reset);
    }

    /// Forgets the person.
    pub(super) fn reset(&mut self) {
        self.features.iter_mut().for_each(RobustLearner::reset);
        self.units.iter_mut().for_each(RobustLearner::reset);
        for strays in self.strays.iter_mut().flatten() {
            *strays = SlowNoise::default();
        }
        self.turn = Turn::default();
        self.rests.fill(Resting::default());
        self.filters.iter_mut().for_each(MeasureFilter::reset);
    }

    /// Starts from what was saved of this person. Version 1 knows the measures only: there large movements of a measure imply
    /// high readings of its units.
    pub(super) fn restore(&mut self, units: &Units, learned: &Learned) {
        for (learner, range) in self.features.iter_mut().zip(&learned.features) {
            learner.restore(*range);
        }
        let mut restore = |unit: &UnitName, range| {
            let reading = units.reading(Some(unit));
            if let Some(learner) = reading.and_then(|reading| self.units.get_mut(reading)) {
                learner.restore(range);
            }
        };
        for (unit, range) in &learned.readings {
            restore(unit, *range);
        }
        if !learned.readings.is_empty() {
            return;
        }
        for (row, range) in units.rows.iter().zip(&learned.ranges) {
            let sides = [
                (&row.rises, range.high - range.rest, row.prior.up),
                (&row.falls, range.rest - range.low, row.prior.down),
            ];
            for (unit, own, usual) in sides {
                if let Some(unit) = unit.as_ref().filter(|_| usual > 0.0) {
                    let high = own / usual;
                    restore(
                        unit,
                        Range {
                            high,
                            ..Range::default()
                        },
                    );
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn eyes_that_rest_to_the_left_look_further_there_than_they_seem_to() {
        for (seems, rest, looks) in [
            (0.5, 0.0, 0.5),
            (0.5, 0.25, 0.6),
            (-0.5, 0.25, -0.4),
            (0.5, -0.25, 0.4),
            (0.5, 2.0, 0.75),
            (-0.5, 2.0, -0.25),
        ] {
            assert!(
                (looked(seems, rest) - looks).abs() < 1e-12,
                "{seems} {rest}"
            );
        }
    }
}
