//! The learners of one person's measures, by method.

use super::paper::PaperLearner;
use super::range::Range;
use super::robust::RobustLearner;
use super::settings::{Method, Settings};
use super::units::Units;
use crate::base::capacity::LEARNT_MEASURES;
use crate::base::prelude::*;

/// [`LEARNT_MEASURES`] of one kind, 2 KiB each: by value they would pass over the stack, which keeps what it once grew to.
#[derive(Clone, Debug)]
pub(super) enum Learners {
    Robust(Box<[RobustLearner]>),
    Paper(Box<[PaperLearner]>),
}

impl Learners {
    /// Starts from the population.
    pub(super) fn new(settings: &Settings, units: &Units) -> Self {
        let phase = |m: usize| m as f64 / LEARNT_MEASURES as f64;
        let rows = units.rows.iter().enumerate();
        match settings.method {
            Method::Robust => {
                let robust = settings.robust();
                let learners = rows.map(|(m, row)| RobustLearner::new(robust, row.prior, phase(m)));
                Self::Robust(learners.collect())
            }
            Method::Paper => {
                let learners = rows.map(|(m, row)| {
                    PaperLearner::new(*settings, row.prior, row.kind(true), phase(m))
                });
                Self::Paper(learners.collect())
            }
        }
    }

    /// Ranges in use.
    pub(super) fn ranges(&self) -> [Range; LEARNT_MEASURES] {
        core::array::from_fn(|m| match self {
            Self::Robust(learners) => learners[m].range(),
            Self::Paper(learners) => learners[m].range(),
        })
    }

    /// How well the rest of each measure is known, 0…1.
    pub(super) fn rests(&self) -> [f64; LEARNT_MEASURES] {
        core::array::from_fn(|m| match self {
            Self::Robust(learners) => learners[m].rest_readiness(),
            Self::Paper(learners) => learners[m].readiness(),
        })
    }

    /// Deviation of a measure's noise; 0 with the paper's method.
    pub(super) fn sigma(&self, m: usize) -> f64 {
        match self {
            Self::Robust(learners) => learners[m].sigma(),
            Self::Paper(_) => 0.0,
        }
    }

    /// A frame's value of a measure, or none of which to be certain.
    pub(super) fn observe(&mut self, m: usize, g: Option<f64>, omega: f64, dt: f64) {
        match (self, g) {
            (Self::Robust(learners), Some(g)) => learners[m].observe(g, omega, dt),
            (Self::Robust(learners), None) => learners[m].interrupt(),
            (Self::Paper(learners), Some(g)) => learners[m].observe(g, omega, dt),
            (Self::Paper(_), None) => {}
        }
    }

    /// Forgets the person.
    pub(super) fn reset(&mut self) {
        match self {
            Self::Robust(learners) => learners.iter_mut().for_each(RobustLearner::reset),
            Self::Paper(learners) => learners.iter_mut().for_each(PaperLearner::reset),
        }
    }
}
