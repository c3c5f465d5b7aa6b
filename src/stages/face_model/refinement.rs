//! Correction of a fit by depth: a linear map from measured surface heights to shape coefficients.
//!
//! A frontal image hardly shows the protrusion of lips and jaw, and a cascade confuses part of one movement with others. Depth
//! measures the first, and the second is the same for all faces. So the shape coefficients are corrected by
//! `Δb = C (x − mean) / deviation`, where `x` contains the fitted coefficients, the head's rotation relative to the line of
//! sight (and its products) and, at each of [`SITES`], how much nearer the measured surface is than the fit
//! ([`crate::landmarks::relief`]). `C` is learned by ridge regression from tracked sessions of rendered people
//! (`mien-studio train`): the depth term of the paper's 2D+3D cost (section 1.2), with learned weights. Two more rows measure
//! the puff of the cheeks, which no landmark shows.
//!
//! Head frame, metres at the model's size, standard deviations. Memory: one matrix of 30 kB. Cost: some 60 patches of
//! depth and 5000 multiplications. Degenerate: a site without depth counts as the mean; inputs are clamped to ±[`MAX_DEVIATIONS`].

use crate::base::capacity::LANDMARKS;
use crate::base::geometry::Point;
use crate::base::prelude::*;

use super::error::ModelError;
use super::reader::Reader;
use super::scheme::MOUTH_CORNER_R;
use super::sizes::MAX_MODES;

/// First landmarks at which depth is measured. The jaw's sides are omitted, because there depth misses the face.
const CHIN_SITES: [usize; 3] = [7, 8, 9];
/// Depth is measured at this landmark and all after it.
const FIRST_INNER: usize = 17;
/// Sites on the cheeks: two landmarks, and the share of the second.
const CHEEKS: [(usize, usize, f32); 6] = [
    (31, 2, 0.5),
    (35, 14, 0.5),
    (48, 4, 0.5),
    (54, 12, 0.5),
    (48, 3, 0.4),
    (54, 13, 0.4),
];
/// Number of sites at which depth is measured.
pub const SITES: usize = CHIN_SITES.len() + (LANDMARKS - FIRST_INNER) + CHEEKS.len();
/// Number of rotation inputs: rotation vector and products of its first two components.
const TURN: usize = 6;
/// Most inputs.
pub const MAX_INPUTS: usize = MAX_MODES + TURN + SITES;
/// Number of outputs besides the shape: puff of the right and left cheek.
pub const PUFFS: usize = 2;
/// Limit of a standardised input, standard deviations.
pub const MAX_DEVIATIONS: f32 = 4.0;

/// Largest unit of a row of weights.
const MAX_STEP: f32 = 1e3;

/// Inputs of one frame; NaN for sites without depth.
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

/// Index of the site of a landmark, which is 7 to 9 or at least 17.
pub(crate) const fn site_of(landmark: usize) -> usize {
    if landmark < FIRST_INNER {
        landmark - CHIN_SITES[0]
    } else {
        landmark - FIRST_INNER + CHIN_SITES.len()
    }
}

/// Which sites lie on some landmarks, in their order; the cheeks go with the mouth.
pub(crate) fn sites_of(landmarks: &[bool; LANDMARKS]) -> impl Iterator<Item = bool> {
    let own = CHIN_SITES.into_iter().chain(FIRST_INNER..LANDMARKS);
    let own = own.map(|landmark| landmarks[landmark]);
    own.chain(CHEEKS.map(|_| landmarks[MOUTH_CORNER_R]))
}

/// Sites at which depth is measured, in the frame and unit of `head`.
pub(crate) fn sites(head: &[Point; LANDMARKS]) -> impl Iterator<Item = Point> {
    let landmark = move |i: usize| head[i];
    let between = move |(a, b, share): (usize, usize, f32)| {
        Point::from(head[a].coords.lerp(&head[b].coords, share))
    };
    let landmarks = CHIN_SITES
        .into_iter()
        .chain(FIRST_INNER..LANDMARKS)
        .map(landmark);
    landmarks.chain(CHEEKS.into_iter().map(between))
}

impl Refinement {
    /// Number of inputs.
    pub fn inputs(&self) -> usize {
        self.mean.len()
    }

    /// Standardises the inputs in place; 0 for sites without depth.
    pub fn standardise(&self, inputs: &mut Inputs) {
        for ((x, mean), deviation) in inputs.iter_mut().zip(&self.mean).zip(&self.deviation) {
            let z = (*x - mean) / deviation;
            *x = if z.is_finite() {
                z.clamp(-MAX_DEVIATIONS, MAX_DEVIATIONS)
            } else {
                0.0
            };
        }
    }

    /// Corrects the shape coefficients (standard deviations) in place and returns the puff of the cheeks (right, left; about 0 to 1).
    /// Standardises `inputs`.
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

    /// Reads the bytes of [`Self::emit`], for a shape model of `modes` modes.
    ///
    /// # Errors
    /// If there are too few or too many numbers, or one is out of range.
    pub fn parse(bytes: &[u8], modes: usize) -> Result<Self, ModelError> {
        let section = "REFI";
        let mut reader = Reader { section, bytes };
        let (inputs, rows) = (modes + TURN + SITES, modes + PUFFS);
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

    /// Little-endian bytes: means, deviations and one unit per row as 32-bit floats, then the weights as 16-bit multiples of the
    /// unit.
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
    const INPUTS: usize = MODES + TURN + SITES;

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
    fn a_planted_map_is_applied() {
        let mut inputs: Inputs = core::iter::repeat_n(1.0, INPUTS).collect();
        (inputs[0], inputs[INPUTS - 1]) = (4.0, -3.0);
        let mut shape = [0.1, 0.2, 0.3];
        let cheeks = planted().refine(&mut inputs, &mut shape);
        // (4 − 1)/2 · 0.5 and −(−3 − 1)/2.
        assert!((shape[1] - 0.95).abs() < 1e-6 && shape[0] == 0.1 && shape[2] == 0.3);
        assert!(cheeks[0] == 0.0 && (cheeks[1] - 2.0).abs() < 1e-6);
    }

    #[test]
    fn missing_inputs_count_as_the_mean_and_outliers_are_clamped() {
        let mut inputs: Inputs = core::iter::repeat_n(f32::NAN, INPUTS).collect();
        let mut shape = [0.0; MODES];
        planted().refine(&mut inputs, &mut shape);
        assert_eq!(shape, [0.0; MODES]);
        let mut inputs: Inputs = core::iter::repeat_n(1e9, INPUTS).collect();
        planted().refine(&mut inputs, &mut shape);
        assert!((shape[1] - 0.5 * MAX_DEVIATIONS).abs() < 1e-6);
    }

    #[test]
    fn written_bytes_are_read_and_damaged_ones_refused() {
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
