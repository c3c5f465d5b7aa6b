//! Result of a frame: weights by column, and their ranges.

use crate::base::capacity::{MEASURES, UNITS};
use crate::base::defaults;

defaults! {
    /// One frame's result. Columns are in the order of [`super::Expression::unit_names`].
    #[derive(Clone, Debug)]
    pub struct Weights {
        /// Measures by [`super::measures::Measure`], in units of the inner-eye-corner distance; the eye distance itself in metres.
        pub measures: [f32; MEASURES] = [0.0; MEASURES],
        pub(super) units: [f32; UNITS] = [0.0; UNITS],
        pub(super) readiness: [f32; UNITS] = [0.0; UNITS],
        pub(super) columns: usize = 0,
        /// Whether most ranges are still the population's.
        pub warming: bool = true,
        /// Whether learning is stopped.
        pub frozen: bool = false,
    }
}

impl Weights {
    /// Sets a column's weight, times `fade`, and readiness.
    pub(super) fn set(&mut self, column: usize, (weight, readiness): (f64, f64), fade: f64) {
        self.units[column] = (weight.max(0.0) * fade) as f32;
        self.readiness[column] = readiness as f32;
    }

    /// Weight of each unit: 0 to 1, above 1 if exaggerated, never below 0 or non-finite.
    pub fn units(&self) -> &[f32] {
        &self.units[..self.columns]
    }

    /// Readiness of each unit, 0…1: share of its range that is the person's own.
    pub fn readiness(&self) -> &[f32] {
        &self.readiness[..self.columns]
    }
}

/// Range of a unit's weight: of its reading, or, without one, of its measure in eye distances.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct UnitRange {
    /// Value at the full falling expression, or at rest if there is none.
    pub low: f32,
    /// Value at rest.
    pub rest: f32,
    /// Value at the full rising expression, or at rest if there is none.
    pub high: f32,
    /// Standard deviation of its noise; 0 with the paper's method.
    pub noise: f32,
    /// Share of the range that is the person's own, 0…1.
    pub readiness: f32,
}
