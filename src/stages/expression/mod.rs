//! Landmarks to measures, samples, ranges and unit weights (paper section 2).
//!
//! Computes a person's geometric measures in every frame and from them the weight of every FACS unit, while learning the person's
//! rest and range of expressions. There is no calibration.
//!
//! ```text
//! landmarks ─► measures ─► scaled ─┬─► learner per measure ─► range ─────────────────────┐
//! (head frame)  (metres)   (by w)  │   paper │ robust ─► rest                            ▼
//! pose ─► weight ω ────────────────┘              └─► readings ─► learner per unit ─► one-euro ─► dead zone ─► columns
//! ```
//! Method: Jiang Na et al., *Unsupervised real-time facial animation generation using geometric measurements*,
//! section 2, implemented literally by [`Method::Paper`] in `weight`, `compensate`, `samples`, `one_way`, `two_way`. The
//! default, [`Method::Robust`], keeps the measures and sample weights but replaces the range rules (`robust`), because the
//! paper's give 0.2 to 0.4 on a still face. Both are estimators behind one trait (`estimator`).
//!
//! Units and frames: landmarks in the head frame, metres; measures in units of the inner-eye-corner distance; weights 0 to
//! 1 and beyond. Memory: fixed, about 130 KiB per person; nothing is allocated after [`Expression::new`]. Cost: a few dozen
//! microseconds a frame. Degenerate: a frame with a non-finite landmark repeats the last weights; frames with low confidence,
//! or ω < 1/3, give weights but are not learned from. In the first 0.3 s all weights are 0, then they fade in.

pub mod compensate;
mod covered;
pub mod ends;
mod estimator;
mod far_eye;
pub mod features;
pub mod gaze;
mod head_motion_leak;
pub mod measures;
pub mod newcomer;
pub mod nodes;
pub mod noise;
pub mod one_way;
pub mod paper;
mod paper_estimator;
pub mod prior;
pub mod range;
pub mod readings;
pub mod regions;
pub mod rest_mode;
pub mod robust;
mod robust_estimator;
pub mod samples;
pub mod saved;
mod settings;
pub mod smooth;
pub mod two_way;
mod unit_learners;
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
use crate::base::prelude::*;
use crate::base::time::Timestamp;
use crate::landmarks::Landmarks;
use estimator::{Estimator, FADE_S, Observation};
use far_eye::follow_near_eye;
use measures::EyeDistance;
use paper_estimator::PaperEstimator;
use regions::RegionSet;
use robust_estimator::RobustEstimator;
use settings::LEAST_CONFIDENCE;

/// Longest gap between two frames across which filters and differences continue, seconds.
const LONGEST_FRAME_S: f64 = 0.1;
/// Longest frame time of a slow camera, seconds.
const SLOW_FRAME_MAX_S: f64 = 0.6;
/// Largest ratio of a slow camera's frame time to the one before.
const JITTER: f64 = 1.5;
/// Duration assumed for the first frame, seconds.
const USUAL_FRAME_S: f64 = 1.0 / 30.0;
/// Loss after which the person may have changed, seconds.
const LONG_LOSS_S: f64 = 2.0;

/// The expression stage of one person.
#[derive(Clone, Debug)]
pub struct Expression {
    settings: Settings,
    names: heapless::Vec<UnitName, UNITS>,
    scale: EyeDistance,
    estimator: Estimators,
    last_at: Option<Timestamp>,
    /// Time between the last two frames, at most [`SLOW_FRAME_MAX_S`].
    frame_s: f64,
    present_s: f64,
    resets: u64,
    weights: Weights,
}

/// The estimator of the chosen [`Method`].
#[derive(Clone, Debug)]
enum Estimators {
    Robust(Box<RobustEstimator>),
    Paper(PaperEstimator),
}

impl core::ops::Deref for Estimators {
    type Target = dyn Estimator;

    fn deref(&self) -> &Self::Target {
        match self {
            Self::Robust(estimator) => &**estimator,
            Self::Paper(estimator) => estimator,
        }
    }
}

impl core::ops::DerefMut for Estimators {
    fn deref_mut(&mut self) -> &mut Self::Target {
        match self {
            Self::Robust(estimator) => &mut **estimator,
            Self::Paper(estimator) => estimator,
        }
    }
}

impl Expression {
    /// A person nobody has seen yet.
    pub fn new(settings: Settings, units: impl Into<Arc<Units>>) -> Self {
        let units = units.into();
        let names = units.columns(settings.method == Method::Paper);
        Self {
            scale: EyeDistance::new(units.eye_distance_m),
            estimator: match settings.method {
                Method::Robust => {
                    Estimators::Robust(Box::new(RobustEstimator::new(&settings, units)))
                }
                Method::Paper => Estimators::Paper(PaperEstimator::new(&settings, units)),
            },
            last_at: None,
            frame_s: USUAL_FRAME_S,
            present_s: 0.0,
            resets: 0,
            weights: Weights {
                columns: names.len(),
                ..Weights::default()
            },
            names,
            settings,
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
        self.estimator.ranges()
    }

    /// Deviations of all inputs of the readings from rest in the last frame, in units of the inner-eye-corner distance, with drift
    /// and the effect of head rotation; `None` if units are not read from all inputs.
    pub fn deviations(&self) -> Option<&[f64; INPUTS]> {
        self.estimator.deviations()
    }

    /// The range that each column's weight is computed with, in the order of [`Self::unit_names`].
    pub fn unit_ranges(&self) -> heapless::Vec<UnitRange, UNITS> {
        let ranges = self.estimator.unit_ranges();
        let ranges = ranges.iter().zip(self.weights.readiness());
        ranges
            .map(|((range, noise), &readiness)| UnitRange {
                low: range.low as f32,
                rest: range.rest as f32,
                high: range.high as f32,
                noise: *noise as f32,
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
        self.estimator.take_neutral();
    }

    /// Forgets the person and starts from the population again.
    pub fn reset(&mut self) {
        self.estimator.reset();
        self.scale.reset();
        self.present_s = 0.0;
        self.weights.warming = true;
    }

    /// What was learned, for saving (see [`Learned::write`]).
    pub fn learned(&self) -> Learned {
        let mut learned = Learned {
            eye_distance_m: self.scale.get(),
            ..Learned::default()
        };
        self.estimator.save(&mut learned);
        learned
    }

    /// Starts from what was learned about this person before (robust; the paper's method starts from the population).
    pub fn restore(&mut self, learned: &Learned) {
        self.reset();
        self.scale = EyeDistance::new(learned.eye_distance_m);
        self.estimator.restore(learned);
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
        // After a loss at most 0.1 s counts, or one and a half of the previous frame time; so a slow camera's long frames count in full.
        let longest = (JITTER * self.frame_s).clamp(LONGEST_FRAME_S, SLOW_FRAME_MAX_S);
        let dt = since.clamp(0.0, longest);
        self.frame_s = since.clamp(0.0, SLOW_FRAME_MAX_S);
        if since > LONGEST_FRAME_S {
            self.estimator.interrupt(since > LONG_LOSS_S);
        }
        self.present_s += dt;

        let omega = weight::sample_weight(sensor_from_face, self.settings.best_distance_m);
        let learns = !self.weights.frozen && landmarks.confidence >= LEAST_CONFIDENCE;
        let w = raw[Measure::EyeDistance as usize];
        let eyes_seen = RegionSet::of_unit("AU43").seen(&landmarks.seen) == 1.0
            && measures::confidence(Measure::EyeDistance, landmarks) >= LEAST_CONFIDENCE;
        if learns && eyes_seen {
            self.scale.observe(w, omega * dt);
        }
        let divisor = if self.settings.scale() == Scale::Frame {
            w
        } else {
            self.scale.get()
        };
        self.weights.measures = measures::scaled(&raw, divisor);
        let is_another = self.estimator.observe(&Observation {
            landmarks,
            rotation: &sensor_from_face.rotation,
            distance_m: f64::from(sensor_from_face.translation.vector.norm()),
            divisor,
            measures: self.weights.measures,
            omega,
            dt,
            present_s: self.present_s,
            learns,
        });
        if is_another {
            self.reset();
            self.resets += 1;
        }
        let fade = ((self.present_s - FADE_S.start) / (FADE_S.end - FADE_S.start)).clamp(0.0, 1.0);
        self.estimator.weigh(dt, fade, &mut self.weights);
        if self.settings.method == Method::Robust {
            let weights = &mut self.weights.units;
            follow_near_eye(weights, &self.names, sensor_from_face, &landmarks.seen);
        }
        &self.weights
    }
}

#[cfg(test)]
mod tests;
