//! The default estimator: one learner of rest and noise for each input, one range for each unit, both sides together.
//!
//! Inputs are the measures, lengths and gaze angles ([`super::readings`]). Their deviations from rest, without what the head's rotation
//! does to them ([`super::head_motion_leak`]), give a reading of each unit, whose range is learned ([`super::unit_learners`]). A measure's
//! learner sees it without cross-talk. Without readings in the table each unit is read from its own measure.
//!
//! Memory: a [`RobustLearner`] of 2 KiB for each input and each unit, about 130 KiB; nothing is allocated after construction.

use alloc::sync::Arc;

use nalgebra::Vector4;

use super::covered::CoveredMouth;
use super::estimator::{Estimator, FADE_S, Observation, UsedRange, is_warming, without_cross_talk};
use super::features::{self, Feature};
use super::gaze::corrected_gaze;
use super::head_motion_leak::{HeadMotion, HeadMotionLeak};
use super::measures::{self, Measure};
use super::newcomer::Newcomer;
use super::noise::SlowNoise;
use super::range::Range;
use super::regions::{self, MOUTH, RegionSet};
use super::robust::RobustLearner;
use super::saved::Learned;
use super::settings::{LEAST_CONFIDENCE, Settings};
use super::smooth::MeasureFilter;
use super::unit_learners::{UnitLearners, phase};
use super::units::{Kind, Unit, Units};
use super::weights::Weights;
use crate::base::capacity::{FEATURES, INPUTS, LEARNT_MEASURES, LENGTHS, REGIONS, UNITS};
use crate::base::prelude::*;

/// Seconds of presence after which deviations from rest count as expressions.
const RESTS_KNOWN_S: f64 = 2.0;
/// Seconds of evidence after which the rest identifies a person.
const KNOWN_REST_S: f64 = 2.0;

/// Units that are easily distinguished from rest and whose small values matter: speech moves the lips all the time and leaves
/// no rest to measure the noise in, and most smiles are slight.
const SLIGHT: [&str; 4] = ["AU12L", "AU12R", "AU25", "AU26"];

/// Least shares of the resting lid gap at which eyes count as open: of the wider eye, and of the other, whose lids come closer
/// together when it looks far towards the nose.
const OPEN: [f64; 2] = [0.55, 0.3];

/// Noise of a glance, of the full range of the eyes.
const GLANCE_NOISE: f64 = 0.05;

/// Range of a reading that is the weight itself.
const ABSOLUTE: Range = Range {
    low: 0.0,
    rest: 0.0,
    high: 1.0,
};

/// What is known of one person.
#[derive(Clone, Debug)]
pub(super) struct RobustEstimator {
    settings: Settings,
    units: Arc<Units>,
    /// Reading of each measure's rising and falling unit.
    side_readings: [[Option<usize>; 2]; LEARNT_MEASURES],
    /// Readings of the other columns, see [`Units::derived_units`].
    derived_units: heapless::Vec<usize, UNITS>,
    /// Of measures, then, if the table has readings, of features.
    inputs: Box<[RobustLearner]>,
    /// What they saw in the last frame: measures without cross-talk, and features.
    values: [f64; INPUTS],
    /// Effect of the head's motion on measures and lengths.
    leaks: [HeadMotionLeak; LEARNT_MEASURES + LENGTHS],
    /// The person's usual rotation and distance.
    usual_motion: HeadMotion,
    /// Rotation and distance of the head in the last frame.
    motion: Vector4<f64>,
    /// Deviations from rest in the last frame, as they were seen.
    raw: [f64; INPUTS],
    /// The part of them that is expression or glance.
    deviations: [f64; INPUTS],
    /// Readings of the last frame.
    readings: [f64; UNITS],
    /// Learners of the readings' ranges.
    learners: UnitLearners,
    /// Drift of the readings; `None` for the [`SLIGHT`] ones.
    drift: [Option<SlowNoise>; UNITS],
    /// Filters of the readings.
    filters: [MeasureFilter; UNITS],
    /// Filters of measures that units are read from.
    measure_filters: [MeasureFilter; LEARNT_MEASURES],
    /// Whether the eyes were seen open in the last frame.
    eyes_open: bool,
    newcomer: Newcomer,
    mouth: CoveredMouth,
    /// How far each region is seen in the last frame.
    seen: [f32; REGIONS],
    /// Regions that each input needs.
    input_regions: [RegionSet; INPUTS],
    /// Regions that each reading needs.
    reading_regions: [RegionSet; UNITS],
    /// Regions that each column needs.
    column_regions: [RegionSet; UNITS],
}

impl RobustEstimator {
    /// A person nobody has seen yet.
    pub(super) fn new(settings: &Settings, units: Arc<Units>) -> Self {
        let robust = settings.robust();
        let measures = units.rows.iter().enumerate().map(|(m, row)| {
            RobustLearner::new(robust, row.prior, m as f64 / LEARNT_MEASURES as f64)
        });
        let features = units.features.iter().flatten().enumerate();
        let features = features.map(|(k, prior)| RobustLearner::new(robust, *prior, phase(k)));
        Self {
            settings: *settings,
            side_readings: core::array::from_fn(|m| {
                let row = &units.rows[m];
                [&row.rises, &row.falls].map(|unit| units.reading(unit.as_ref()))
            }),
            derived_units: units.derived_units().take(UNITS).collect(),
            inputs: measures.chain(features).collect(),
            values: [0.0; INPUTS],
            leaks: [HeadMotionLeak::default(); LEARNT_MEASURES + LENGTHS],
            usual_motion: HeadMotion::default(),
            motion: Vector4::zeros(),
            raw: [0.0; INPUTS],
            deviations: [0.0; INPUTS],
            readings: [0.0; UNITS],
            learners: UnitLearners::new(robust, &units.readings),
            drift: core::array::from_fn(|k| {
                let reading = units.readings.get(k)?;
                (!SLIGHT.contains(&reading.unit.as_str())).then(SlowNoise::default)
            }),
            filters: core::array::from_fn(|_| MeasureFilter::default()),
            measure_filters: Default::default(),
            eyes_open: false,
            newcomer: Newcomer::default(),
            mouth: CoveredMouth::default(),
            seen: [1.0; REGIONS],
            input_regions: RegionSet::of_inputs(),
            reading_regions: regions::of_units(units.readings.iter().map(|reading| &reading.unit)),
            column_regions: regions::of_units(units.columns(false).iter()),
            units,
        }
    }

    fn features(&self) -> &[RobustLearner] {
        &self.inputs[LEARNT_MEASURES..]
    }

    /// Whether both eyes are open; behind closed lids eyes look ahead.
    fn eyes_are_open(&self, frame: &Observation<'_>) -> bool {
        let gap = |lid: Measure| {
            f64::from(frame.measures[lid as usize]) / self.inputs[lid as usize].range().rest
        };
        let (left, right) = (gap(Measure::LidL), gap(Measure::LidR));
        left.max(right) > OPEN[0] && left.min(right) > OPEN[1]
    }

    /// Values of all inputs, and their deviations from rest.
    fn measure(&mut self, frame: &Observation<'_>) {
        let measures = frame.measures.iter().zip(&self.inputs[..LEARNT_MEASURES]);
        for (raw, (&value, learner)) in self.raw.iter_mut().zip(measures) {
            *raw = f64::from(value) - learner.range().rest;
        }
        let corrected = if frame.present_s > FADE_S.start {
            let ranges = core::array::from_fn(|m| {
                let learner = &self.inputs[m];
                (learner.range(), learner.sigma())
            });
            let dead_zone = self.settings.dead_zone;
            without_cross_talk(&frame.measures, &self.units, &ranges, dead_zone, |_| true)
        } else {
            // Deviations mean nothing before rest is placed.
            core::array::from_fn(|m| f64::from(frame.measures[m]))
        };
        self.values[..LEARNT_MEASURES].copy_from_slice(&corrected);
        if self.features().is_empty() {
            return;
        }
        let lengths = self.values[LEARNT_MEASURES..].iter_mut();
        for (value, feature) in lengths.zip(&features::ALL) {
            *value = f64::from(feature.raw(&frame.landmarks.head) / frame.divisor);
        }
        let open = self.eyes_are_open(frame);
        let eyes = frame.landmarks.eyes.as_ref().filter(|_| open);
        self.eyes_open = false;
        if let (Some(gaze), Some(eyes)) = (&self.units.gaze, eyes) {
            let angles = gaze.estimate(eyes, frame.rotation);
            for (value, angle) in self.values[LEARNT_MEASURES + LENGTHS..]
                .iter_mut()
                .zip(angles)
            {
                *value = f64::from(angle);
            }
            self.eyes_open = true;
        }
        for i in LEARNT_MEASURES..INPUTS {
            self.raw[i] = self.values[i] - self.inputs[i].range().rest;
        }
        let gaze = LEARNT_MEASURES + LENGTHS;
        if self.eyes_open {
            self.raw[gaze] = corrected_gaze(self.raw[gaze], self.inputs[gaze].range().rest);
        } else {
            self.raw[gaze..].fill(0.0);
        }
        // What is hidden is taken for rest.
        for (raw, regions) in self.raw.iter_mut().zip(&self.input_regions) {
            *raw *= f64::from(regions.seen(&self.seen));
        }
    }

    /// Readings of all units from the deviations.
    fn read(&mut self, frame: &Observation<'_>) {
        self.motion = HeadMotion::at(&frame.rotation.scaled_axis().cast(), frame.distance_m);
        let motion = self.usual_motion.about_mean(&self.motion);
        self.deviations = self.raw;
        for (deviation, leak) in self.deviations.iter_mut().zip(&self.leaks) {
            *deviation = leak.expression_part(*deviation, &motion, frame.distance_m);
        }
        for (value, reading) in self.readings.iter_mut().zip(&self.units.readings) {
            *value = reading.value(&self.deviations);
        }
        let before = self.readings;
        for (value, reading) in self.readings.iter_mut().zip(&self.units.readings) {
            *value += reading.correction(&before);
        }
    }

    /// Learns the rest of each input.
    fn learn_rests(&mut self, frame: &Observation<'_>, mouth_seen: bool) {
        let landmarks = frame.landmarks;
        let certain = |row: &Unit| {
            measures::confidence(row.measure, landmarks) >= LEAST_CONFIDENCE
                && (mouth_seen || !self.input_regions[row.measure as usize].intersects(MOUTH))
        };
        let confidence =
            |feature: &Feature| measures::mean_confidence(feature.landmarks(), landmarks);
        let lengths = features::ALL
            .iter()
            .map(|feature| confidence(feature) >= LEAST_CONFIDENCE);
        let measures = self.units.rows.iter().map(certain);
        let certain = (measures.chain(lengths)).chain([self.eyes_open; FEATURES - LENGTHS]);
        let inputs = self.inputs.iter_mut().zip(&self.values);
        for ((learner, &value), (certain, regions)) in inputs.zip(certain.zip(&self.input_regions))
        {
            if certain && value.is_finite() && regions.seen(&self.seen) == 1.0 {
                learner.observe(value, frame.omega, frame.dt);
            } else {
                learner.interrupt();
            }
        }
    }

    /// Learns the head's effect on the inputs, and the range of each reading.
    fn learn_ranges(&mut self, frame: &Observation<'_>) {
        self.usual_motion.observe(&self.motion, frame.dt);
        if frame.present_s <= RESTS_KNOWN_S {
            return;
        }
        let motion = self.usual_motion.about_mean(&self.motion);
        let inputs = self.raw.iter().zip(&self.input_regions);
        for (leak, (&raw, regions)) in self.leaks.iter_mut().zip(inputs) {
            if raw.is_finite() && regions.seen(&self.seen) == 1.0 {
                leak.observe(raw, &motion, frame.dt, self.settings.half_life_s);
            }
        }
        let readings = self.readings.iter().zip(&self.reading_regions);
        let readings = readings
            .map(|(&reading, regions)| (regions.seen(&self.seen) == 1.0).then_some(reading));
        self.learners
            .observe(readings.clone(), frame.omega, frame.dt);
        for (k, (reading, drift)) in readings.zip(&mut self.drift).enumerate() {
            if let (Some(reading), Some(drift), Some(learner)) =
                (reading, drift, self.learners.get(k))
            {
                let range = learner.range();
                drift.observe((reading - range.rest) / (range.high - range.rest), frame.dt);
            }
        }
    }

    /// Whether the rests are those of another person.
    fn is_another_person(&mut self, frame: &Observation<'_>) -> bool {
        let rest = |m: usize| {
            let learner = &self.inputs[m];
            let is_seen = self.input_regions[m].seen(&self.seen) == 1.0;
            (is_seen && learner.rest_seconds() > KNOWN_REST_S).then(|| learner.range().rest)
        };
        let sd = |m: usize| self.units.rows[m].prior.rest_sd;
        let values = core::array::from_fn(|m| self.values[m]);
        (self.newcomer).observe(&values, frame.omega, frame.dt, rest, sd)
    }

    /// Weight and readiness of a reading.
    fn weigh_reading(&mut self, reading: usize, dt: f64) -> (f64, f64) {
        let (range, sigma) = self.reading_range(reading);
        let filter = &mut self.filters[reading];
        let value = filter.filter(
            self.readings[reading],
            sigma,
            self.settings.smoothing_hz,
            dt,
        );
        let Some(learner) = self.learners.get(reading) else {
            let gaze = &self.inputs[LEARNT_MEASURES + LENGTHS..];
            let ready = gaze.iter().map(RobustLearner::rest_readiness);
            return (value, ready.fold(1.0, f64::min));
        };
        let drift = self.drift[reading].map_or(0.0, |drift| drift.dead_share());
        let drift = drift * (range.high - range.rest);
        let dead_zone = (self.settings.dead_zone * sigma).max(drift);
        (
            range.weight(value, Kind::Rising, dead_zone),
            learner.readiness()[0],
        )
    }

    /// Range of a reading, and the deviation of its noise.
    fn reading_range(&self, reading: usize) -> UsedRange {
        let learner = self.learners.get(reading);
        learner.map_or((ABSOLUTE, GLANCE_NOISE), |learner| {
            (learner.range(), learner.sigma())
        })
    }

    /// Weight and readiness of the rising and of the falling unit of a measure.
    fn weigh_sides(&mut self, m: usize, dt: f64) -> [(f64, f64); 2] {
        let kind = self.units.rows[m].prior.kind;
        let learner = &self.inputs[m];
        let sigma = learner.sigma();
        let filter = &mut self.measure_filters[m];
        let value = filter.filter(self.values[m], sigma, self.settings.smoothing_hz, dt);
        let dead_zone = self.settings.dead_zone * sigma;
        let signed = learner.range().weight(value, kind, dead_zone);
        let readiness = learner.readiness();
        let mut sides = [(signed, readiness[0]), (-signed, readiness[1])];
        for (side, reading) in sides.iter_mut().zip(self.side_readings[m]) {
            if let Some(reading) = reading {
                *side = self.weigh_reading(reading, dt);
            }
        }
        // Of the two the larger one; the other would be its own cross-talk.
        let weaker = usize::from(sides[0].0 > sides[1].0);
        if kind == Kind::TwoWay && !self.features().is_empty() {
            sides[weaker].0 = 0.0;
        }
        sides
    }

    /// Frames were missing, or rest is still being placed.
    fn interrupt_readings(&mut self) {
        let features = self.inputs[LEARNT_MEASURES..].iter_mut();
        features
            .chain(self.learners.iter_mut())
            .for_each(RobustLearner::interrupt);
        let filters = self.filters.iter_mut().chain(&mut self.measure_filters);
        filters.for_each(MeasureFilter::reset);
    }
}

impl Estimator for RobustEstimator {
    fn observe(&mut self, frame: &Observation<'_>) -> bool {
        self.seen = frame.landmarks.seen;
        self.measure(frame);
        self.read(frame);
        let infers = self.settings.infer_covered;
        let mouth_seen = !infers
            || self
                .mouth
                .update_visibility(frame.landmarks, frame.dt as f32);
        if !frame.learns {
            return false;
        }
        self.learn_rests(frame, mouth_seen);
        self.learn_ranges(frame);
        self.is_another_person(frame)
    }

    fn weigh(&mut self, dt: f64, fade: f64, weights: &mut Weights) {
        if fade == 0.0 {
            // Rest is still being placed; the filters must not carry that into what is shown.
            self.interrupt_readings();
        }
        let mut column = 0;
        for m in 0..LEARNT_MEASURES {
            let acts = self.units.rows[m].prior.kind.sides();
            let sides = self.weigh_sides(m, dt);
            for (side, _) in sides.into_iter().zip(acts).filter(|(_, acts)| *acts) {
                weights.set(column, side, fade);
                column += 1;
            }
        }
        for k in 0..self.derived_units.len() {
            let side = self.weigh_reading(self.derived_units[k], dt);
            weights.set(column + k, side, fade);
        }
        let rests = self.inputs[..LEARNT_MEASURES].iter();
        weights.warming = is_warming(rests.map(RobustLearner::rest_readiness));
        if self.settings.infer_covered {
            let columns = &mut weights.units[..weights.columns];
            self.mouth
                .infer_weights(columns, &self.column_regions, dt as f32);
        }
        for (weight, regions) in weights.units.iter_mut().zip(&self.column_regions) {
            // The mouth's weights decay as this person's do.
            if !(self.settings.infer_covered && regions.intersects(MOUTH)) {
                *weight *= regions.seen(&self.seen);
            }
        }
    }

    fn ranges(&self) -> [Range; LEARNT_MEASURES] {
        core::array::from_fn(|m| self.inputs[m].range())
    }

    fn unit_ranges(&self) -> heapless::Vec<UsedRange, UNITS> {
        let rows = self.units.rows.iter().zip(&self.side_readings).enumerate();
        let columns = rows.flat_map(|(m, (row, readings))| {
            let sides = row.prior.kind.sides().into_iter().zip(readings);
            sides.filter(|(acts, _)| *acts).map(move |(_, reading)| {
                let of_measure = || (self.inputs[m].range(), self.inputs[m].sigma());
                reading.map_or_else(of_measure, |reading| self.reading_range(reading))
            })
        });
        let derived = self.derived_units.iter();
        let derived = derived.map(|&reading| self.reading_range(reading));
        columns.chain(derived).collect()
    }

    fn deviations(&self) -> Option<&[f64; INPUTS]> {
        (!self.features().is_empty()).then_some(&self.raw)
    }

    fn take_neutral(&mut self) {
        for (learner, &value) in self.inputs.iter_mut().zip(&self.values) {
            learner.set_rest(value);
        }
        for learner in self.learners.iter_mut() {
            learner.set_rest(0.0);
        }
    }

    fn interrupt(&mut self, long: bool) {
        let (measures, _) = self.inputs.split_at_mut(LEARNT_MEASURES);
        measures.iter_mut().for_each(RobustLearner::interrupt);
        self.interrupt_readings();
        if long {
            self.newcomer.after_loss();
        }
        self.mouth.interrupt();
    }

    fn reset(&mut self) {
        self.inputs.iter_mut().for_each(RobustLearner::reset);
        self.learners.iter_mut().for_each(RobustLearner::reset);
        for drift in self.drift.iter_mut().flatten() {
            *drift = SlowNoise::default();
        }
        self.usual_motion = HeadMotion::default();
        self.leaks.fill(HeadMotionLeak::default());
        let filters = self.filters.iter_mut().chain(&mut self.measure_filters);
        filters.for_each(MeasureFilter::reset);
        self.newcomer = Newcomer::default();
        self.mouth = CoveredMouth::default();
    }

    fn save(&self, learned: &mut Learned) {
        learned.ranges = self.ranges();
        learned.features = self.features().iter().map(RobustLearner::range).collect();
        let readings = self.units.readings.iter().enumerate();
        learned.readings = readings
            .filter_map(|(k, reading)| Some((reading.unit.clone(), self.learners.get(k)?.range())))
            .collect();
    }

    fn restore(&mut self, learned: &Learned) {
        let ranges = learned.ranges.iter().chain(&learned.features);
        for (learner, range) in self.inputs.iter_mut().zip(ranges) {
            learner.restore(*range);
        }
        let units = &self.units;
        if learned.readings.is_empty() {
            self.learners
                .restore(units, learned.implied_readings(units));
        } else {
            let saved = learned.readings.iter();
            self.learners
                .restore(units, saved.map(|(unit, range)| (unit, *range)));
        }
    }
}
