//! Ridge regression of a few targets on many features: `min Σ |W x + bias − y|² + λ |W|²`.
//!
//! Normal equations, solved by a Cholesky factor (`faer`). Samples come in blocks: one column each, its features above its
//! targets; threads share out the columns of the scatter. `λ` is given relative to the mean eigenvalue of the features'
//! scatter. Memory: the samples, and two and a half scatters, as 32-bit floats. Degenerate: constant features get weight 0.

use std::cmp::Ordering;

use faer::linalg::matmul::matmul;
use faer::prelude::Solve;
use faer::{Accum, Mat, MatRef, Par, Side};
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

/// Columns of the scatter that a thread sums at a time.
const COLUMNS: usize = 256;

/// A linear map and what it is relative to: `y = weights (x − mean) + bias`.
pub struct LinearMap {
    /// One row per target.
    pub weights: DMatrix<f32>,
    /// Mean features.
    pub mean: DVector<f32>,
    /// Mean targets.
    pub bias: DVector<f32>,
}

/// Takes the mean of all columns off them, and returns it.
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

/// Solves the regression of the blocks' last `targets` rows on the others. The blocks lose their mean.
///
/// # Panics
/// If a sample is not finite.
pub fn ridge(blocks: &mut [DMatrix<f32>], targets: usize, relative_penalty: f32) -> LinearMap {
    let mean = centred(blocks);
    let rows = mean.len();
    let features = rows - targets;
    // From the diagonal down.
    let part = |first: usize| {
        let mut sum = Mat::zeros(rows - first, COLUMNS.min(features - first));
        for block in &*blocks {
            let all = MatRef::from_column_major_slice(block.as_slice(), rows, block.ncols());
            let own = all.subrows(first, sum.ncols()).transpose();
            let below = all.subrows(first, rows - first);
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
    let trace: f32 = (0..features).map(|k| scatter(k, k)).sum();
    let penalty = (relative_penalty * trace / features.max(1) as f32).max(f32::MIN_POSITIVE);
    let lower = Mat::from_fn(features, features, |row, column| match row.cmp(&column) {
        Ordering::Less => 0.0,
        Ordering::Equal => scatter(row, row) + penalty,
        Ordering::Greater => scatter(row, column),
    });
    let moments = Mat::from_fn(features, targets, |k, target| scatter(features + target, k));
    drop(parts);
    let factor = lower.llt(Side::Lower).expect("samples are finite");
    let solved = factor.solve(moments);
    LinearMap {
        weights: DMatrix::from_fn(targets, features, |target, k| solved[(k, target)]),
        mean: mean.rows(0, features).into_owned(),
        bias: mean.rows(features, targets).into_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_planted_map_is_found() {
        let mut random = fastrand::Rng::with_seed(4);
        let planted = DMatrix::<f32>::from_fn(3, 300, |_, _| random.f32() - 0.5);
        let mut blocks: Vec<_> = (0..3)
            .map(|_| {
                let mut block = DMatrix::<f32>::from_fn(303, 400, |_, _| random.f32() + 2.0);
                let y = (&planted * block.rows(0, 300)).add_scalar(0.7);
                block.rows_mut(300, 3).copy_from(&y);
                block
            })
            .collect();
        let map = ridge(&mut blocks, 3, 1e-6);
        assert!((&map.weights - &planted).amax() < 1e-3);
        let offset = &map.bias - &map.weights * &map.mean;
        assert!((offset.add_scalar(-0.7)).amax() < 1e-2);
    }
}
