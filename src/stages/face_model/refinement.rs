//! Correction of a fit by depth: a linear correction of the shape by measured surface heights.
//!
//! A frontal image hardly shows how far lips and jaw protrude, and a cascade tends to mistake part of one movement for others.
//! Depth measures the first, and the second is the same for all faces. So the shape coefficients are corrected by
//! `Δb = C (x − mean) / deviation`, where `x` contains the fitted coefficients, the head's rotation relative to the line of
//! sight (and its products) and, at each of [`PLACES`], how much nearer the measured surface is than the fit
//! ([`crate::landmarks::relief`]). `C` is learned by ridge regression from tracked sessions of rendered people
//! (`mien-studio train`): the depth term of the paper's 2D+3D cost (section 1.2), with learned weights. Two more rows measure
//! how far the cheeks are puffed out, which no landmark shows.
//!
//! Head frame, metres at the model's size, standard deviations. Memory: one matrix of 30 kB. Cost: some 60 patches of
//! depth and 5000 multiplications. Degenerate: a place without depth counts as the mean; inputs are clamped to ±[`MOST`].

use crate::base::capacity::LANDMARKS;
use crate::base::geometry::Point;
use crate::base::prelude::*;

use super::error::ModelError;
use super::reader::Reader;
use super::sizes::MAX_MODES;

/// Landmarks where depth is looked up: all but the jaw's sides, where it sees past the face.
const FIRST_PLACES: [usize; 3] = [7, 8, 9];
const FROM: usize = 17;
/// Places of the cheeks: landmarks they lie between, and the share of the second.
const CHEEKS: [(usize, usize, f32); 6] = [
    (31, 2, 0.5),
    (35, 14, 0.5),
    (48, 4, 0.5),
    (54, 12, 0.5),
    (48, 3, 0.4),
    (54, 13, 0.4),
];
/// Places where depth is looked up.
pub const PLACES: usize = FIRST_PLACES.len() + (LANDMARKS - FROM) + CHEEKS.len();
/// The head's turn: rotation vector and products of its first two components.
const TURN: usize = 6;
/// Inputs at most.
pub const MAX_INPUTS: usize = MAX_MODES + TURN + PLACES;
/// Outputs beyond the shape: right and left cheek.
pub const PUFFS: usize = 2;
/// Inputs farther from the mean count as this many deviations.
pub const MOST: f32 = 4.0;

/// Largest step of the weights.
const MAX_STEP: f32 = 1e3;

/// Inputs of one frame; `NaN` where depth saw nothing.
pub type Inputs = heapless::Vec<f32, MAX_INPUTS>;

/// The learnt map.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Refinement {
    /// Mean of each input.
    pub mean: Vec<f32>,
    /// Deviation of each input, above 0.
    pub deviation: Vec<f32>,
    /// One row per shape mode, then [`PUFFS`]; one column per input.
    pub weights: Vec<f32>,
}

/// Number of a landmark's place, of 7 to 9 and of 17 on.
pub(crate) const fn place_of(landmark: usize) -> usize {
    if landmark < FROM {
        landmark - FIRST_PLACES[0]
    } else {
        landmark - FROM + FIRST_PLACES.len()
    }
}

/// Where depth is looked up on a head.
pub(crate) fn places(head: &[Point; LANDMARKS]) -> impl Iterator<Item = Point> {
    let at = move |i: usize| head[i];
    let between = move |(a, b, share): (usize, usize, f32)| {
        Point::from(head[a].coords.lerp(&head[b].coords, share))
    };
    let landmarks = FIRST_PLACES.into_iter().chain(FROM..LANDMARKS).map(at);
    landmarks.chain(CHEEKS.into_iter().map(between))
}

impl Refinement {
    /// Inputs of the map.
    pub fn inputs(&self) -> usize {
        self.mean.len()
    }

    /// Standardised inputs, 0 where nothing was seen.
    pub fn standardise(&self, inputs: &mut Inputs) {
        for ((x, mean), deviation) in inputs.iter_mut().zip(&self.mean).zip(&self.deviation) {
            let z = (*x - mean) / deviation;
            *x = if z.is_finite() {
                z.clamp(-MOST, MOST)
            } else {
                0.0
            };
        }
    }

    /// Corrects the coefficients in place and returns how far the cheeks are blown out (right, left; about 0 to 1).
    pub fn refine(&self, inputs: &mut Inputs, shape: &mut [f32]) -> [f32; PUFFS] {
        self.standardise(inputs);
        let row = |k: usize| -> f32 {
            let row = &self.weights[k * self.inputs()..(k + 1) * self.inputs()];
            row.iter().zip(inputs.iter()).map(|(w, x)| w * x).sum()
        };
        let modes = self.weights.len() / self.inputs() - PUFFS;
        for (k, b) in shape.iter_mut().enumerate().take(modes) {
            *b += row(k);
        }
        [row(modes), row(modes + 1)]
    }

    /// Reads what [`Self::emit`] wrote, for a shape model of so many modes.
    ///
    /// # Errors
    /// If the numbers are too few, too many or not finite.
    pub fn parse(bytes: &[u8], modes: usize) -> Result<Self, ModelError> {
        let section = "REFI";
        let mut reader = Reader { section, bytes };
        let (inputs, rows) = (modes + TURN + PLACES, modes + PUFFS);
        let mean = reader.floats(inputs)?;
        let deviation = reader.positive(inputs, "deviations above 0")?;
        let scales = reader.floats_within(rows, MAX_STEP, "steps within a thousand")?;
        let steps = reader.take(2 * rows * inputs)?.as_chunks().0.iter();
        reader.end()?;
        let steps = steps.map(|step| f32::from(i16::from_le_bytes(*step)));
        let scaled = steps.enumerate().map(|(i, step)| step * scales[i / inputs]);
        Ok(Self {
            mean,
            deviation,
            weights: scaled.collect(),
        })
    }

    /// As little-endian bytes: means, deviations, the size of a step for each row, all 32-bit floats; then the weights in
    /// steps of 16 bits.
    pub fn emit(&self) -> Vec<u8> {
        let rows = self.weights.chunks_exact(self.inputs());
        let scales: Vec<f32> = rows
            .clone()
            .map(|row| row.iter().fold(0.0f32, |most, w| most.max(w.abs())) / f32::from(i16::MAX))
            .collect();
        let floats = self.mean.iter().chain(&self.deviation).chain(&scales);
        let mut bytes: Vec<u8> = floats.flat_map(|v| v.to_le_bytes()).collect();
        for (row, scale) in rows.zip(&scales) {
            let step = |w: &f32| (w / scale.max(f32::MIN_POSITIVE)).round() as i16;
            bytes.extend(row.iter().flat_map(|w| step(w).to_le_bytes()));
        }
        bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MODES: usize = 3;
    const INPUTS: usize = MODES + TURN + PLACES;

    /// The second coefficient follows the first input, the left cheek the last; all means 1, all deviations 2.
    fn planted() -> Refinement {
        let mut map = Refinement {
            mean: vec![1.0; INPUTS],
            deviation: vec![2.0; INPUTS],
            weights: vec![0.0; (MODES + PUFFS) * INPUTS],
        };
        map.weights[INPUTS] = 0.5;
        map.weights[(MODES + 2) * INPUTS - 1] = -1.0;
        map
    }

    #[test]
    fn a_planted_map_corrects_what_it_says() {
        let mut inputs: Inputs = core::iter::repeat_n(1.0, INPUTS).collect();
        (inputs[0], inputs[INPUTS - 1]) = (4.0, -3.0);
        let mut shape = [0.1, 0.2, 0.3];
        let cheeks = planted().refine(&mut inputs, &mut shape);
        // (4 − 1)/2 · 0.5 and −(−3 − 1)/2.
        assert!((shape[1] - 0.95).abs() < 1e-6 && shape[0] == 0.1 && shape[2] == 0.3);
        assert!(cheeks[0] == 0.0 && (cheeks[1] - 2.0).abs() < 1e-6);
    }

    #[test]
    fn what_was_not_seen_says_nothing_and_outliers_little() {
        let mut inputs: Inputs = core::iter::repeat_n(f32::NAN, INPUTS).collect();
        let mut shape = [0.0; MODES];
        planted().refine(&mut inputs, &mut shape);
        assert_eq!(shape, [0.0; MODES]);
        let mut inputs: Inputs = core::iter::repeat_n(1e9, INPUTS).collect();
        planted().refine(&mut inputs, &mut shape);
        assert!((shape[1] - 0.5 * MOST).abs() < 1e-6);
    }

    #[test]
    fn what_is_written_is_read_and_what_is_wrong_is_refused() {
        let bytes = planted().emit();
        let read = Refinement::parse(&bytes, MODES).expect("valid");
        assert_eq!(read.emit(), bytes);
        let (found, true_) = (read.weights.iter(), planted().weights);
        assert!(found.zip(&true_).all(|(a, b)| (a - b).abs() < 1e-6));
        assert!(Refinement::parse(&bytes, MODES + 1).is_err());
        assert!(Refinement::parse(&bytes[4..], MODES).is_err());
        let mut bad = bytes.clone();
        bad[..4].copy_from_slice(&f32::NAN.to_le_bytes());
        assert!(Refinement::parse(&bad, MODES).is_err());
        let mut bad = bytes;
        bad[4 * INPUTS..4 * INPUTS + 4].copy_from_slice(&0.0f32.to_le_bytes());
        assert!(Refinement::parse(&bad, MODES).is_err());
    }
}
