//! Landmarks to measures, samples, ranges and unit weights (paper section 2).
//!
//! Computes, for one person and every frame, the geometric measures of the face and from them the weight of every FACS unit,
//! while learning this person's rest and the range of their expressions. There is no calibration.
//!
//! ```text
//! landmarks ─► measures ─► scaled ─┬─► learner per measure ─► range ─────────────────────┐
//! (head frame)  (metres)   (by w)  │   paper │ robust ─► rest                            ▼
//! pose ─► weight ω ────────────────┘              └─► readings ─► learner per unit ─► one-euro ─► dead zone ─► columns
//! ```
//! Method: Jiang Na et al., *Unsupervised real-time facial animation generation using geometric measurements*,
//! section 2, implemented literally by [`Method::Paper`] in `weight`, `compensate`, `samples`, `one_way`, `two_way`. The
//! default, [`Method::Robust`], keeps the measures and sample weights but replaces the range rules (`robust`), because the
//! literal ones read 0.2 to 0.4 on a still face.
//!
//! Units and frames: landmarks in the head frame, metres; measures in units of the inner-eye-corner distance; weights 0 to
//! 1 and beyond. Memory: fixed, about 40 KiB per person; nothing is allocated after [`Expression::new`]. Cost: a few dozen
//! microseconds a frame. Degenerate: a frame with a non-finite landmark repeats the last weights; frames with low
//! confidence, or with ω < 1/3, give weights but are not learned from. In the first third of a second all weights are 0,
//! then they fade in.

pub mod compensate;
mod covered;
pub mod ends;
pub mod features;
pub mod gaze;
mod learners;
pub mod measures;
pub mod newcomer;
pub mod nodes;
pub mod noise;
pub mod one_way;
pub mod paper;
pub mod prior;
pub mod range;
pub mod readings;
pub mod rest;
mod resting;
pub mod robust;
pub mod samples;
pub mod saved;
mod settings;
pub mod smooth;
mod together;
pub mod two_way;
pub mod unit_words;
pub mod units;
pub mod weight;
mod weights;

pub use measures::{Measure, Scale};
pub use range::Range;
pub use saved::Learned;
pub use settings::{Method, Settings};
pub use units::{UnitName, Units};
pub use weights::{UnitRange, Weights};

use alloc::sync::Arc;

use crate::base::capacity::{INPUTS, LEARNT_MEASURES, UNITS};
use crate::base::frames::SensorFromFace;
use crate::base::time::Timestamp;
use crate::landmarks::Landmarks;
use covered::CoveredMouth;
use learners::Learners;
use measures::EyeDistance;
use newcomer::Newcomer;
use robust::RobustLearner;
use settings::LEAST_CONFIDENCE;
use smooth::MeasureFilter;
use together::Together;
use units::{Explained, Kind, Side};

/// Longest time that one frame stands for, seconds.
const LONGEST_FRAME_S: f64 = 0.1;
/// The frame before the first.
const USUAL_FRAME_S: f64 = 1.0 / 30.0;
/// A loss longer than this may have changed the person, seconds.
const LONG_LOSS_S: f64 = 2.0;

/// Weights fade in between these seconds of presence.
const FADE_S: core::ops::Range<f64> = 0.3..0.6;
/// Seconds of presence after which deviations from rest count as expressions.
const RESTS_KNOWN_S: f64 = 2.0;
/// Median readiness of rest at which the ranges are the person's.
const WARM: f64 = 0.5;
/// Seconds of evidence after which the rest identifies a person.
const KNOWN_REST_S: f64 = 2.0;

/// The expression stage of one person.
#[derive(Clone, Debug)]
pub struct Expression {
    settings: Settings,
    /// The same for everybody.
    units: Arc<Units>,
    names: heapless::Vec<UnitName, UNITS>,
    /// Index of the reading of each measure's rising and falling unit.
    readings: [[Option<usize>; 2]; LEARNT_MEASURES],
    /// See [`Units::further`].
    further: heapless::Vec<usize, UNITS>,
    scale: EyeDistance,
    learners: Learners,
    filters: [MeasureFilter; LEARNT_MEASURES],
    together: Option<Together>,
    newcomer: Newcomer,
    mouth: CoveredMouth,
    /// By column.
    is_mouth: [bool; UNITS],
    last_at: Option<Timestamp>,
    present_s: f64,
    corrected: [f64; LEARNT_MEASURES],
    resets: u64,
    weights: Weights,
}

impl Expression {
    /// A person nobody has seen yet.
    pub fn new(settings: Settings, units: impl Into<Arc<Units>>) -> Self {
        let units = units.into();
        let is_robust = settings.method == Method::Robust;
        let names = units.columns(!is_robust);
        let together = is_robust
            .then(|| Together::new(&settings, &units))
            .flatten();
        Self {
            together,
            readings: core::array::from_fn(|m| {
                let row = &units.rows[m];
                [&row.rises, &row.falls].map(|unit| units.reading(unit.as_ref()))
            }),
            further: units.further().take(UNITS).collect(),
            scale: EyeDistance::new(units.eye_distance_m),
            learners: Learners::new(&settings, &units),
            filters: Default::default(),
            newcomer: Newcomer::default(),
            mouth: CoveredMouth::default(),
            is_mouth: units.of_mouth(),
            last_at: None,
            present_s: 0.0,
            corrected: [0.0; LEARNT_MEASURES],
            resets: 0,
            weights: Weights {
                columns: names.len(),
                ..Weights::default()
            },
            names,
            settings,
            units,
        }
    }

    /// Names of the weights' columns, such as `AU12L`.
    pub fn unit_names(&self) -> &[UnitName] {
        &self.names
    }

    /// The last frame's result.
    pub fn weights(&self) -> &Weights {
        &self.weights
    }

    /// Range in use for each learnt measure, in the order of [`Measure::ALL`].
    pub fn ranges(&self) -> [Range; LEARNT_MEASURES] {
        self.learners.ranges()
    }

    /// Deviations of all inputs of the readings from rest in the last frame, in units of the inner-eye-corner distance, as they
    /// were seen: with what strays and what the head's turn does.
    pub fn departures(&self) -> Option<&[f64; INPUTS]> {
        Some(&self.together.as_ref()?.raw)
    }

    /// The range that each column's weight is computed with, in the order of [`Self::unit_names`].
    pub fn unit_ranges(&self) -> heapless::Vec<UnitRange, UNITS> {
        let paper = matches!(self.learners, Learners::Paper(_));
        let ranges = self.ranges();
        let of_measure = |m: usize| (ranges[m], self.learners.sigma(m));
        let of_reading = |reading: usize| self.together.as_ref().map(|all| all.range(reading));
        let rows = self.units.rows.iter().enumerate();
        let columns = rows.flat_map(|(m, row)| {
            let sides = row.kind(paper).sides().into_iter().zip(self.readings[m]);
            sides.filter(|(acts, _)| *acts).map(move |(_, reading)| {
                reading
                    .and_then(of_reading)
                    .unwrap_or_else(|| of_measure(m))
            })
        });
        let further = self
            .further
            .iter()
            .filter_map(|&reading| of_reading(reading));
        let ranges = columns.chain(further).zip(self.weights.readiness());
        ranges
            .map(|((range, noise), &readiness)| UnitRange {
                low: range.low as f32,
                rest: range.rest as f32,
                high: range.high as f32,
                noise: noise as f32,
                readiness,
            })
            .collect()
    }

    /// How often a change of person was detected here.
    pub fn resets(&self) -> u64 {
        self.resets
    }

    /// Stops or resumes learning; weights go on.
    pub fn freeze(&mut self, frozen: bool) {
        self.weights.frozen = frozen;
    }

    /// Takes the current face as rest (robust; the paper's method has no such notion and continues to learn).
    pub fn take_neutral(&mut self) {
        if let Learners::Robust(learners) = &mut self.learners {
            for (learner, &g) in learners.iter_mut().zip(&self.corrected) {
                learner.set_rest(g);
            }
        }
        if let Some(together) = &mut self.together {
            together.take_neutral();
        }
    }

    /// Forgets the person and starts from the population again.
    pub fn reset(&mut self) {
        self.learners.reset();
        self.filters.iter_mut().for_each(MeasureFilter::reset);
        if let Some(together) = &mut self.together {
            together.reset();
        }
        self.scale.reset();
        self.newcomer = Newcomer::default();
        self.mouth = CoveredMouth::default();
        self.present_s = 0.0;
        self.weights.warming = true;
    }

    /// What was learned, for saving (see [`Learned::write`]).
    pub fn learned(&self) -> Learned {
        let together = self.together.as_ref();
        let (features, readings) = together.map_or_else(Default::default, |together| {
            (together.features(), together.readings(&self.units))
        });
        Learned {
            eye_distance_m: self.scale.get(),
            ranges: self.ranges(),
            features,
            readings,
        }
    }

    /// Starts from what was learned about this person before (robust; the paper's method starts from the population).
    pub fn restore(&mut self, learned: &Learned) {
        self.reset();
        self.scale = EyeDistance::new(learned.eye_distance_m);
        if let Learners::Robust(learners) = &mut self.learners {
            for (learner, range) in learners.iter_mut().zip(learned.ranges) {
                learner.restore(range);
            }
        }
        if let Some(together) = &mut self.together {
            together.restore(&self.units, learned);
        }
    }

    /// Measures a frame, learns from it and computes the weights.
    pub fn observe(
        &mut self,
        landmarks: &Landmarks,
        sensor_from_face: &SensorFromFace,
        at: Timestamp,
    ) -> &Weights {
        let raw = measures::with_cheeks(&landmarks.head, landmarks.cheeks);
        if raw.iter().any(|g| !g.is_finite()) || raw[Measure::EyeDistance as usize] <= 0.0 {
            return &self.weights;
        }
        let since = self
            .last_at
            .map_or(USUAL_FRAME_S, |last| at.seconds_since(last));
        self.last_at = Some(at);
        let dt = since.clamp(0.0, LONGEST_FRAME_S);
        if since > LONGEST_FRAME_S {
            self.interrupt(since > LONG_LOSS_S);
        }
        self.present_s += dt;

        let omega = weight::sample_weight(sensor_from_face, self.settings.best_distance_m);
        let learns = !self.weights.frozen && landmarks.confidence >= LEAST_CONFIDENCE;
        let w = raw[Measure::EyeDistance as usize];
        if learns && measures::confidence(Measure::EyeDistance, landmarks) >= LEAST_CONFIDENCE {
            self.scale.observe(w, omega * dt);
        }
        let divisor = if self.settings.scale() == Scale::Frame {
            w
        } else {
            self.scale.get()
        };
        self.weights.measures = measures::scaled(&raw, divisor);
        self.correct();
        if let (Some(together), Learners::Robust(learners)) = (&mut self.together, &self.learners) {
            together.read(
                landmarks,
                &sensor_from_face.rotation,
                divisor,
                &self.weights.measures,
                learners,
                &self.units,
            );
        }
        let infers = self.settings.infer_covered && self.settings.method == Method::Robust;
        let mouth_seen = !infers || self.mouth.look(landmarks, dt as f32);
        if learns {
            self.learn(landmarks, omega, dt, mouth_seen);
        }
        self.weigh(dt);
        if infers {
            let units = &mut self.weights.units[..self.weights.columns];
            self.mouth.weigh(units, &self.is_mouth, dt as f32);
        }
        &self.weights
    }

    fn interrupt(&mut self, long: bool) {
        if let Learners::Robust(learners) = &mut self.learners {
            learners.iter_mut().for_each(RobustLearner::interrupt);
            if let Some(together) = &mut self.together {
                together.interrupt();
            }
            if long {
                self.newcomer.after_loss();
            }
        }
        self.filters.iter_mut().for_each(MeasureFilter::reset);
        self.mouth.interrupt();
    }

    /// Removes cross-talk: the part of a measure that is caused by another expression.
    fn correct(&mut self) {
        let measures = self.weights.measures;
        self.corrected = core::array::from_fn(|m| f64::from(measures[m]));
        // Departures mean nothing before rest is placed.
        if self.present_s <= FADE_S.start {
            return;
        }
        let robust = self.settings.method == Method::Robust;
        let ranges = self.learners.ranges();
        let departure = |by: Measure, when: Side| {
            let dead_zone = self.settings.dead_zone * self.learners.sigma(by as usize);
            let e = f64::from(measures[by as usize]) - ranges[by as usize].rest;
            match when {
                Side::Rises => (e - dead_zone).max(0.0),
                Side::Falls => (e + dead_zone).min(0.0),
            }
        };
        for (m, row) in self.units.rows.iter().enumerate() {
            for &Explained { by, when, share } in &row.explained {
                // The paper's landmarks hardly show nostrils.
                if !robust && matches!(by, Measure::NostrilL | Measure::NostrilR) {
                    continue;
                }
                self.corrected[m] -= share * departure(by, when);
            }
        }
    }

    fn learn(&mut self, landmarks: &Landmarks, omega: f64, dt: f64, mouth_seen: bool) {
        for (m, row) in self.units.rows.iter().enumerate() {
            let certain = measures::confidence(row.measure, landmarks) >= LEAST_CONFIDENCE
                && (mouth_seen || !covered::is_of_mouth(row.measure));
            let g = certain.then_some(self.corrected[m]);
            self.learners.observe(m, g, omega, dt);
        }
        let Learners::Robust(learners) = &self.learners else {
            return;
        };
        if let Some(together) = &mut self.together {
            together.learn(landmarks, omega, dt, self.present_s > RESTS_KNOWN_S);
        }
        let rest = |m: usize| {
            let learner = &learners[m];
            (learner.rest_seconds() > KNOWN_REST_S).then(|| learner.range().rest)
        };
        let sd = |m: usize| self.units.rows[m].prior.rest_sd;
        if self.newcomer.observe(&self.corrected, omega, dt, rest, sd) {
            self.reset();
            self.resets += 1;
        }
    }

    fn weigh(&mut self, dt: f64) {
        let fade = ((self.present_s - FADE_S.start) / (FADE_S.end - FADE_S.start)).clamp(0.0, 1.0);
        if fade == 0.0 {
            // Rest is still being placed; the filters must not carry that into what is shown.
            self.filters.iter_mut().for_each(MeasureFilter::reset);
            if let Some(together) = &mut self.together {
                together.interrupt();
            }
        }
        let mut column = 0;
        for m in 0..LEARNT_MEASURES {
            for (_, weight, readiness) in self.sides(m, dt).into_iter().filter(|side| side.0) {
                self.weights.set(column, (weight, readiness), fade);
                column += 1;
            }
        }
        if let Some(together) = &mut self.together {
            let columns = column..self.weights.columns;
            for (column, &reading) in columns.zip(&self.further) {
                let read = together.weigh(reading, &self.settings, dt);
                self.weights.set(column, read, fade);
            }
        }
        self.weights.warming = is_warming(self.learners.rests());
    }

    /// Of the rising and of the falling unit of a measure: whether there is one, its weight and its readiness.
    fn sides(&mut self, m: usize, dt: f64) -> [(bool, f64, f64); 2] {
        let (row, g) = (&self.units.rows[m], self.corrected[m]);
        let (kind, signed, readiness) = match &self.learners {
            Learners::Robust(learners) => {
                let learner = &learners[m];
                let (range, kind) = (learner.range(), row.prior.kind);
                let sigma = learner.sigma();
                let g = self.filters[m].filter(g, sigma, self.settings.smoothing_hz, dt);
                let dead_zone = self.settings.dead_zone * sigma;
                (kind, range.weight(g, kind, dead_zone), learner.readiness())
            }
            Learners::Paper(learners) => {
                let learner = &learners[m];
                (row.kind(true), learner.weight(g), [learner.readiness(); 2])
            }
        };
        let mut sides = [
            (kind.rises(), signed, readiness[0]),
            (kind.falls(), -signed, readiness[1]),
        ];
        if let Some(together) = &mut self.together {
            for (side, reading) in sides.iter_mut().zip(self.readings[m]) {
                if let Some(reading) = reading {
                    (side.1, side.2) = together.weigh(reading, &self.settings, dt);
                }
            }
            // Of the two the larger one; the other would be its own cross-talk.
            let weaker = usize::from(sides[0].1 > sides[1].1);
            if kind == Kind::TwoWay {
                sides[weaker].1 = 0.0;
            }
        }
        sides
    }
}

/// Whether ranges are still mostly the population's, by how well each measure's rest is known, 0…1.
fn is_warming(rests: [f64; LEARNT_MEASURES]) -> bool {
    let barely = rests.iter().filter(|rest| **rest < WARM).count();
    2 * barely > LEARNT_MEASURES
}

#[cfg(test)]
mod tests;
