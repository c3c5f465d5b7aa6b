//! What a frame gives: weights by column, and the ranges they are shares of.

use crate::base::capacity::{MEASURES, UNITS};
use crate::base::defaults;

defaults! {
    /// One frame's result. Columns are in the order of [`super::Expression::unit_names`].
    #[derive(Clone, Debug)]
    pub struct Weights {
        /// By [`super::measures::Measure`], in units of the inner-eye-corner distance; the eye distance itself in metres.
        pub measures: [f32; MEASURES] = [0.0; MEASURES],
        pub(super) units: [f32; UNITS] = [0.0; UNITS],
        pub(super) readiness: [f32; UNITS] = [0.0; UNITS],
        pub(super) columns: usize = 0,
        /// Ranges are still mostly the population's.
        pub warming: bool = true,
        /// Learning is frozen.
        pub frozen: bool = false,
    }
}

impl Weights {
    /// Sets a column's weight, faded in so far, and readiness.
    pub(super) fn set(&mut self, column: usize, (weight, readiness): (f64, f64), fade: f64) {
        self.units[column] = (weight.max(0.0) * fade) as f32;
        self.readiness[column] = readiness as f32;
    }

    /// Weight of each unit: 0 to 1, above 1 if exaggerated, never below 0 or non-finite.
    pub fn units(&self) -> &[f32] {
        &self.units[..self.columns]
    }

    /// 0…1 for each unit: how much of its range is this person's own.
    pub fn readiness(&self) -> &[f32] {
        &self.readiness[..self.columns]
    }
}

/// The range that a unit's weight is computed with: of its reading, or in eye distances of its measure if it has none.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct UnitRange {
    /// Value at the full falling expression; rest, if there is none.
    pub low: f32,
    /// Value at rest.
    pub rest: f32,
    /// Value at the full rising expression; rest, if there is none.
    pub high: f32,
    /// Standard deviation of its noise; 0 with the paper's method, which does not estimate it.
    pub noise: f32,
    /// 0…1: how much of it is the person's own.
    pub readiness: f32,
}
