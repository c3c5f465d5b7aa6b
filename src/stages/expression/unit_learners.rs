//! Ranges of the units' readings.
//!
//! Both sides of a unit share one [`RobustLearner`], which learns from the stronger side: a side that always moves little would in
//! time learn a range of its own and read as strong as the other. Absolute readings have none. Memory: 2 KiB for each unit.

use super::range::Range;
use super::readings::Reading;
use super::robust::{RobustLearner, RobustSettings};
use super::units::{UnitName, Units, other_side};
use crate::base::capacity::UNITS;
use crate::base::prelude::*;

/// Phase of a learner among several, 0 to 1, which spreads their estimates over the frames.
pub(super) fn phase(k: usize) -> f64 {
    (k as f64 * 0.618).fract()
}

/// One learner for each unit.
#[derive(Clone, Debug)]
pub(super) struct UnitLearners {
    learners: Box<[RobustLearner]>,
    /// Learner of each reading.
    learner_of: [Option<usize>; UNITS],
}

impl UnitLearners {
    /// Learners of these readings, at most [`UNITS`].
    pub(super) fn new(settings: RobustSettings, readings: &[Reading]) -> Self {
        let mut learner_of = [None; UNITS];
        let mut count = 0;
        for (k, reading) in readings.iter().enumerate().take(UNITS) {
            if !reading.absolute {
                let other = other_side(&reading.unit);
                let mut before = readings[..k].iter();
                let other = before.position(|one| other.as_deref() == Some(one.unit.as_str()));
                let shared = other.and_then(|other| learner_of[other]);
                learner_of[k] = shared.or(Some(count));
                count += usize::from(shared.is_none());
            }
        }
        let learner = |k| RobustLearner::new(settings, Reading::PRIOR, phase(k));
        Self {
            learners: (0..count).map(learner).collect(),
            learner_of,
        }
    }

    /// Learner of a reading; `None` if it is absolute.
    pub(super) fn get(&self, reading: usize) -> Option<&RobustLearner> {
        self.learner_of[reading].map(|learner| &self.learners[learner])
    }

    /// All learners.
    pub(super) fn iter_mut(&mut self) -> impl Iterator<Item = &mut RobustLearner> {
        self.learners.iter_mut()
    }

    /// Adds a frame's readings, `None` for those that are hidden, of weight `omega`, `dt` seconds after the last.
    pub(super) fn observe(
        &mut self,
        readings: impl Iterator<Item = Option<f64>>,
        omega: f64,
        dt: f64,
    ) {
        let mut strongest = [f64::NEG_INFINITY; UNITS];
        for (reading, learner) in readings.zip(self.learner_of) {
            if let (Some(reading), Some(learner)) = (reading, learner) {
                strongest[learner] = strongest[learner].max(reading);
            }
        }
        for (learner, strongest) in self.learners.iter_mut().zip(strongest) {
            // Not finite, and so an interruption, if all of it is hidden.
            learner.observe(strongest, omega, dt);
        }
    }

    /// Starts from saved ranges, of both sides from the wider one.
    pub(super) fn restore<'a>(
        &mut self,
        units: &Units,
        saved: impl Iterator<Item = (&'a UnitName, Range)>,
    ) {
        let mut widest: [Option<Range>; UNITS] = [None; UNITS];
        for (unit, range) in saved {
            let reading = units.reading(Some(unit));
            if let Some(learner) = reading.and_then(|reading| self.learner_of[reading]) {
                let known = widest[learner].filter(|known| known.high > range.high);
                widest[learner] = Some(known.unwrap_or(range));
            }
        }
        for (learner, range) in self.learners.iter_mut().zip(widest) {
            if let Some(range) = range {
                learner.restore(range);
            }
        }
    }
}
