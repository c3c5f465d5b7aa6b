//! Ridge regression of a few targets on many features: `min Σ |W x + bias − y|² + λ |W|²`.
//!
//! Normal equations, solved by a Cholesky factor (`faer`). Samples come in blocks, one column each, features above
//! targets; threads share the columns of the scatter. `λ` is relative to the mean eigenvalue of the features'
//! scatter. Memory: the samples, and two and a half scatters, as 32-bit floats. Degenerate: constant features get
//! weight 0; a single block with fewer samples than features is solved in the dual form.

use faer::linalg::matmul::matmul;
use faer::prelude::Solve;
use faer::{Accum, Mat, MatRef, Par, Side};
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

/// Columns of the scatter that a thread computes at a time.
const COLUMNS: usize = 256;

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
fn centred(blocks: &mut [DMatrix<f32>]) -> DVector<f32> {
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

/// Solves `(symmetric + penalty) x = right`; only the lower triangle is read.
fn solved(mut symmetric: Mat<f32>, penalty: f32, right: Mat<f32>) -> Mat<f32> {
    for k in 0..symmetric.nrows() {
        symmetric[(k, k)] += penalty;
    }
    let factor = symmetric.llt(Side::Lower);
    factor.expect("samples are finite").solve(right)
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
        weights: DMatrix::from_fn(targets, features, |target, k| weights[(k, target)]),
        mean: mean.rows(0, features).into_owned(),
        bias: mean.rows(features, targets).into_owned(),
    }
}

fn view(block: &DMatrix<f32>) -> MatRef<'_, f32> {
    MatRef::from_column_major_slice(block.as_slice(), block.nrows(), block.ncols())
}

/// Dual form for fewer samples than features, with the same result (Saunders et al. 1998).
fn by_samples(block: &DMatrix<f32>, features: usize, penalty: f32) -> Mat<f32> {
    let (x, y) = view(block).split_at_row(features);
    x * solved(x.transpose() * x, penalty, y.transpose().to_owned())
}

/// Primal form, one equation per feature.
fn by_features(blocks: &[DMatrix<f32>], features: usize, penalty: f32) -> Mat<f32> {
    let rows = blocks.first().map_or(0, DMatrix::nrows);
    // Lower triangle only.
    let part = |first: usize| {
        let mut sum = Mat::zeros(rows - first, COLUMNS.min(features - first));
        for block in blocks {
            let below = view(block).subrows(first, rows - first);
            let own = below.subrows(0, sum.ncols()).transpose();
            matmul(&mut sum, Accum::Add, below, own, 1.0, Par::Seq);
        }
        sum
    };
    let parts = (0..features.div_ceil(COLUMNS)).into_par_iter();
    let parts: Vec<Mat<f32>> = parts.map(|k| part(k * COLUMNS)).collect();
    let scatter = |row: usize, column: usize| {
        let part = &parts[column / COLUMNS];
        part[(row - column / COLUMNS * COLUMNS, column % COLUMNS)]
    };
    let lower = Mat::from_fn(features, features, |row, column| {
        if row < column {
            0.0
        } else {
            scatter(row, column)
        }
    });
    let moments = Mat::from_fn(features, rows - features, |k, t| scatter(features + t, k));
    drop(parts);
    solved(lower, penalty, moments)
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
