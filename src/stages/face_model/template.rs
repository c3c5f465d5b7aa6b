//! The template of a face for the search in whole images ([`crate::landmarks::face_search`]): `config/face.template`, written by
//! `mien-studio train --template`. Little-endian 32-bit floats: the bias, then the weights, row by row. It does not depend on the
//! rest of a face model.

use super::sizes::{ORIENTATIONS, TEMPLATE_CELLS};
use crate::base::prelude::*;

/// Number of cells.
const CELLS: usize = TEMPLATE_CELLS * TEMPLATE_CELLS;

/// A linear template of a face.
#[derive(Clone, Debug, PartialEq)]
pub struct FaceTemplate {
    /// Added to the product with the weights; a sum above 0 is a candidate.
    pub bias: f32,
    /// Weights of the orientations in [`TEMPLATE_CELLS`]² cells, row by row.
    pub weights: Vec<[f32; ORIENTATIONS]>,
}

impl FaceTemplate {
    /// The built-in template.
    pub fn shipped() -> Self {
        let bytes = include_bytes!("../../../config/face.template");
        let (floats, _) = bytes.as_chunks();
        Self::from_floats(floats.iter().map(|float| f32::from_le_bytes(*float)))
    }

    /// From the bias and the weights, in the order of the file; missing ones are 0.
    pub fn from_floats(mut floats: impl Iterator<Item = f32>) -> Self {
        let bias = floats.next().unwrap_or(0.0);
        let mut next = || floats.next().unwrap_or(0.0);
        let weights = (0..CELLS).map(|_| core::array::from_fn(|_| next()));
        Self {
            bias,
            weights: weights.collect(),
        }
    }

    /// The bytes of the file.
    pub fn bytes(&self) -> Vec<u8> {
        let floats = [self.bias]
            .into_iter()
            .chain(self.weights.iter().flatten().copied());
        floats.flat_map(f32::to_le_bytes).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shipped_template_is_whole() {
        let template = FaceTemplate::shipped();
        assert_eq!(
            template.bytes(),
            include_bytes!("../../../config/face.template")
        );
        assert_eq!(template.bytes().len(), 4 * (1 + CELLS * ORIENTATIONS));
        assert!(template.bias < 0.0 && template.weights.iter().flatten().all(|w| w.is_finite()));
    }
}
