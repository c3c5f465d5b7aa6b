//! Ridge regression of a few targets on many features: `min Σ |W x + bias − y|² + λ |W|²`.
//!
//! Normal equations, solved by a Cholesky factor (`mien_linear`). Samples come in blocks, one column each, features
//! above targets. `λ` is relative to the mean eigenvalue of the features' scatter. Memory: the samples, and two and a
//! half scatters, as 32-bit floats. Degenerate: constant features get weight 0; a single block with fewer samples than
//! features is solved in the dual form.

use mien_linear::normal_equations::{by_features, by_samples};
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

/// An affine map: `y = weights (x − mean) + bias`.
pub struct LinearMap {
    /// One row per target.
    pub weights: DMatrix<f32>,
    /// Mean features.
    pub mean: DVector<f32>,
    /// Mean targets.
    pub bias: DVector<f32>,
}

/// Subtracts the mean of all columns, and returns it.
pub fn centred(blocks: &mut [DMatrix<f32>]) -> DVector<f32> {
    let mut sum = DVector::<f64>::zeros(blocks.first().map_or(0, DMatrix::nrows));
    for column in blocks.iter().flat_map(DMatrix::column_iter) {
        sum.zip_apply(&column, |sum, v| *sum += f64::from(v));
    }
    let count: usize = blocks.iter().map(DMatrix::ncols).sum();
    let mean = (sum / count.max(1) as f64).map(|v| v as f32);
    blocks.par_iter_mut().for_each(|block| {
        for mut column in block.column_iter_mut() {
            column -= &mean;
        }
    });
    mean
}

/// Solves the regression of the blocks' last `targets` rows on the others. The blocks lose their mean.
///
/// # Panics
/// If a sample is not finite.
pub fn ridge(blocks: &mut [DMatrix<f32>], targets: usize, relative_penalty: f32) -> LinearMap {
    let mean = centred(blocks);
    let features = mean.len() - targets;
    let squares = |block: &DMatrix<f32>| f64::from(block.rows(0, features).norm_squared());
    let trace: f64 = blocks.par_iter().map(squares).sum();
    let penalty = f64::from(relative_penalty) * trace / features.max(1) as f64;
    let penalty = (penalty as f32).max(f32::MIN_POSITIVE);
    let weights = match blocks {
        [few] if few.ncols() < features => by_samples(few, features, penalty),
        _ => by_features(blocks, features, penalty),
    };
    LinearMap {
        weights: weights.transpose(),
        mean: mean.rows(0, features).into_owned(),
        bias: mean.rows(features, targets).into_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn planted(features: usize) -> (DMatrix<f32>, Vec<DMatrix<f32>>) {
        let mut random = fastrand::Rng::with_seed(4);
        let map = DMatrix::<f32>::from_fn(3, features, |_, _| random.f32() - 0.5);
        let block = |_| {
            let mut block = DMatrix::<f32>::from_fn(features + 3, 400, |_, _| random.f32() + 2.0);
            let y = (&map * block.rows(0, features)).add_scalar(0.7);
            block.rows_mut(features, 3).copy_from(&y);
            block
        };
        let blocks = (0..3).map(block).collect();
        (map, blocks)
    }

    #[test]
    fn a_planted_map_is_found() {
        let (planted, mut blocks) = planted(300);
        let map = ridge(&mut blocks, 3, 1e-6);
        assert!((&map.weights - &planted).amax() < 1e-3);
        let offset = &map.bias - &map.weights * &map.mean;
        assert!((offset.add_scalar(-0.7)).amax() < 1e-2);
    }

    #[test]
    fn equations_of_samples_and_of_features_give_one_map() {
        let (_, mut blocks) = planted(500);
        let few = ridge(&mut blocks[..1], 3, 0.05).weights;
        let penalty = 0.05 * blocks[0].rows(0, 500).norm_squared() / 500.0;
        let features = by_features(&blocks[..1], 500, penalty);
        let most = few.amax();
        let apart = (0..500).map(|k| (few[(0, k)] - features[(k, 0)]).abs());
        assert!(apart.fold(0.0, f32::max) < 1e-3 * most);
    }
}
