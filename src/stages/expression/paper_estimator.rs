//! Sections 2.2 to 2.6 of the paper as an [`Estimator`]: each unit is read from its own measure.

use alloc::sync::Arc;

use super::estimator::{Estimator, FADE_S, Observation, UsedRange, is_warming, without_cross_talk};
use super::measures::{self, Measure};
use super::paper::PaperLearner;
use super::range::Range;
use super::saved::Learned;
use super::settings::{LEAST_CONFIDENCE, Settings};
use super::units::Units;
use super::weights::Weights;
use crate::base::capacity::{INPUTS, LEARNT_MEASURES, UNITS};
use crate::base::prelude::*;

/// The learners of one person's measures.
#[derive(Clone, Debug)]
pub(super) struct PaperEstimator {
    units: Arc<Units>,
    /// One a measure; on the heap, because 40 KiB by value would pass over the stack.
    learners: Box<[PaperLearner]>,
    /// The last frame's measures without cross-talk.
    values: [f64; LEARNT_MEASURES],
}

impl PaperEstimator {
    /// A person nobody has seen yet.
    pub(super) fn new(settings: &Settings, units: Arc<Units>) -> Self {
        let phase = |m: usize| m as f64 / LEARNT_MEASURES as f64;
        let learners = units.rows.iter().enumerate();
        let learners = learners
            .map(|(m, row)| PaperLearner::new(*settings, row.prior, row.kind(true), phase(m)));
        Self {
            learners: learners.collect(),
            values: [0.0; LEARNT_MEASURES],
            units,
        }
    }
}

impl Estimator for PaperEstimator {
    fn observe(&mut self, frame: &Observation<'_>) -> bool {
        // Deviations mean nothing before rest is placed.
        let placed = frame.present_s > FADE_S.start;
        let ranges = self.ranges().map(|range| (range, 0.0));
        // The paper's landmarks hardly show nostrils.
        let counts = |by| placed && !matches!(by, Measure::NostrilL | Measure::NostrilR);
        self.values = without_cross_talk(&frame.measures, &self.units, &ranges, 0.0, counts);
        let learners = self.learners.iter_mut().filter(|_| frame.learns);
        for ((learner, &g), row) in learners.zip(&self.values).zip(&self.units.rows) {
            if measures::confidence(row.measure, frame.landmarks) >= LEAST_CONFIDENCE {
                learner.observe(g, frame.omega, frame.dt);
            }
        }
        false
    }

    fn weigh(&mut self, _: f64, fade: f64, weights: &mut Weights) {
        let mut column = 0;
        let learners = self.learners.iter().zip(&self.values);
        for ((learner, &g), row) in learners.zip(&self.units.rows) {
            let (kind, weight) = (row.kind(true), learner.weight(g));
            let sides = [(kind.rises(), weight), (kind.falls(), -weight)];
            for (_, weight) in sides.into_iter().filter(|(acts, _)| *acts) {
                weights.set(column, (weight, learner.readiness()), fade);
                column += 1;
            }
        }
        weights.warming = is_warming(self.learners.iter().map(PaperLearner::readiness));
    }

    fn ranges(&self) -> [Range; LEARNT_MEASURES] {
        core::array::from_fn(|m| self.learners[m].range())
    }

    fn unit_ranges(&self) -> heapless::Vec<UsedRange, UNITS> {
        let rows = self.units.rows.iter().zip(&self.learners);
        let columns = rows.flat_map(|(row, learner)| {
            let sides = row.kind(true).sides().into_iter().filter(|acts| *acts);
            sides.map(|_| (learner.range(), 0.0))
        });
        columns.collect()
    }

    fn deviations(&self) -> Option<&[f64; INPUTS]> {
        None
    }

    fn take_neutral(&mut self) {}

    fn interrupt(&mut self, _: bool) {}

    fn reset(&mut self) {
        self.learners.iter_mut().for_each(PaperLearner::reset);
    }

    fn save(&self, learned: &mut Learned) {
        learned.ranges = self.ranges();
    }

    fn restore(&mut self, _: &Learned) {}
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::capacity::{LANDMARKS, MEASURES};
    use crate::base::geometry::{Point, Rotation};
    use crate::expression::units::{Explained, Side};
    use crate::landmarks::Landmarks;

    #[test]
    fn cross_talk_is_removed_once_rest_is_placed_and_never_that_of_nostrils() {
        let mut units = Units::shipped().by_measure();
        units.rows.iter_mut().for_each(|row| row.explained.clear());
        let others = [Measure::MouthWidth, Measure::NostrilL, Measure::NostrilR];
        for (row, by) in units.rows.iter_mut().zip(others) {
            row.explained = vec![Explained {
                by,
                when: Side::Rises,
                share: 0.5,
            }];
        }
        let mut estimator = PaperEstimator::new(&Settings::default(), units.into());
        let mut measures = [0.0; MEASURES];
        for (value, range) in measures.iter_mut().zip(estimator.ranges()) {
            *value = range.rest as f32 + 0.5;
        }
        let landmarks = Landmarks::certain([Point::origin(); LANDMARKS]);
        for (present_s, expected) in [(0.1, [0.0; 3]), (5.0, [0.25, 0.0, 0.0])] {
            estimator.observe(&Observation {
                landmarks: &landmarks,
                rotation: &Rotation::identity(),
                distance_m: 1.0,
                divisor: 1.0,
                measures,
                omega: 1.0,
                dt: 0.03,
                present_s,
                learns: false,
            });
            for k in 0..3 {
                let removed = f64::from(measures[k]) - estimator.values[k];
                assert!((removed - expected[k]).abs() < 1e-6, "{k}: {removed}");
            }
        }
    }
}
