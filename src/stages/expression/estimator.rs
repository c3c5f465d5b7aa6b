//! What both methods do: a frame's measures become unit weights while the person's ranges are learned.

use super::measures::Measure;
use super::range::Range;
use super::saved::Learned;
use super::units::{Explained, Side, Units};
use super::weights::Weights;
use crate::base::capacity::{INPUTS, LEARNT_MEASURES, MEASURES, UNITS};
use crate::base::geometry::Rotation;
use crate::landmarks::Landmarks;

/// Median readiness of rest at which the ranges are the person's.
const WARM: f64 = 0.5;

/// Fade-in of the weights, seconds of presence.
pub(super) const FADE_S: core::ops::Range<f64> = 0.3..0.6;

/// A frame of one person.
pub(super) struct Observation<'a> {
    pub(super) landmarks: &'a Landmarks,
    /// Rotation of the face in the sensor frame.
    pub(super) rotation: &'a Rotation,
    /// Distance of the face from the sensor, metres.
    pub(super) distance_m: f64,
    /// Length by which measures are divided, metres.
    pub(super) divisor: f32,
    /// Measures divided by it.
    pub(super) measures: [f32; MEASURES],
    /// Sample weight ω.
    pub(super) omega: f64,
    /// Seconds since the frame before.
    pub(super) dt: f64,
    /// Seconds that the person has been present.
    pub(super) present_s: f64,
    /// Whether the frame may be learned from.
    pub(super) learns: bool,
}

/// A range in use, and the deviation of its noise.
pub(super) type UsedRange = (Range, f64);

/// A method of reading units and learning their ranges; see [`super::Method`].
pub(super) trait Estimator {
    /// Reads a frame, and learns from it if it may; whether another person is there.
    fn observe(&mut self, frame: &Observation<'_>) -> bool;

    /// Sets weight and readiness of every column, faded in by `fade` (0 to 1).
    fn weigh(&mut self, dt: f64, fade: f64, weights: &mut Weights);

    /// Range of each learnt measure, in the order of [`Measure::ALL`].
    fn ranges(&self) -> [Range; LEARNT_MEASURES];

    /// The range that each column's weight is computed with.
    fn unit_ranges(&self) -> heapless::Vec<UsedRange, UNITS>;

    /// Deviations of all inputs from rest in the last frame, with drift and the effect of head rotation; `None` if units are not read
    /// from all inputs.
    fn deviations(&self) -> Option<&[f64; INPUTS]>;

    /// Takes the last frame's face as rest, if the method can.
    fn take_neutral(&mut self);

    /// Frames were missing; for seconds if the loss was `long`.
    fn interrupt(&mut self, long: bool);

    /// Forgets the person.
    fn reset(&mut self);

    /// Adds what was learned.
    fn save(&self, learned: &mut Learned);

    /// Starts from what was learned, if the method can.
    fn restore(&mut self, learned: &Learned);
}

/// Whether ranges are still mostly the population's, by how well each measure's rest is known, 0 to 1.
pub(super) fn is_warming(rests: impl Iterator<Item = f64>) -> bool {
    let barely = rests.filter(|rest| *rest < WARM).count();
    2 * barely > LEARNT_MEASURES
}

/// Measures without cross-talk: the part of each that the expression of another one causes. Of each measure: its range in use and
/// the deviation of its noise.
pub(super) fn without_cross_talk(
    measures: &[f32; MEASURES],
    units: &Units,
    ranges: &[UsedRange; LEARNT_MEASURES],
    dead_zone: f64,
    counts: impl Fn(Measure) -> bool,
) -> [f64; LEARNT_MEASURES] {
    let mut corrected = core::array::from_fn(|m| f64::from(measures[m]));
    let deviation = |by: Measure, when: Side| {
        let (range, sigma) = ranges[by as usize];
        let dead_zone = dead_zone * sigma;
        let e = f64::from(measures[by as usize]) - range.rest;
        match when {
            Side::Rises => (e - dead_zone).max(0.0),
            Side::Falls => (e + dead_zone).min(0.0),
        }
    };
    for (value, row) in corrected.iter_mut().zip(&units.rows) {
        for &Explained { by, when, share } in row.explained.iter().filter(|e| counts(e.by)) {
            *value -= share * deviation(by, when);
        }
    }
    corrected
}
