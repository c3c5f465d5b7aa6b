//! Normal equations of a ridge regression, `min Σ |W x − y|² + penalty |W|²`, solved by a Cholesky factor. Samples come in
//! blocks, one column each, features above targets.
//!
//! Threads share the columns of the scatter. Memory: two and a half scatters, as 32-bit floats. `W` is returned transposed: a
//! row of it has the weights of one feature.

use std::ops::Range;

use faer::linalg::matmul::matmul;
use faer::prelude::Solve;
use faer::{Accum, Mat, MatRef, Par, Side};
use nalgebra::DMatrix;
use rayon::prelude::*;

/// Columns of the scatter that a thread computes at a time.
const COLUMNS: usize = 256;

/// Solves `(symmetric + penalty) x = right`; only the lower triangle is read.
fn solved(mut symmetric: Mat<f32>, penalty: f32, right: Mat<f32>) -> Mat<f32> {
    for k in 0..symmetric.nrows() {
        symmetric[(k, k)] += penalty;
    }
    let factor = symmetric.llt(Side::Lower);
    factor.expect("samples are finite").solve(right)
}

fn view(block: &DMatrix<f32>) -> MatRef<'_, f32> {
    MatRef::from_column_major_slice(block.as_slice(), block.nrows(), block.ncols())
}

fn owned(matrix: &Mat<f32>) -> DMatrix<f32> {
    DMatrix::from_fn(matrix.nrows(), matrix.ncols(), |r, c| matrix[(r, c)])
}

/// Dual form for fewer samples than features, with the same result (Saunders et al. 1998).
///
/// # Panics
/// If a sample is not finite.
pub fn by_samples(block: &DMatrix<f32>, features: usize, penalty: f32) -> DMatrix<f32> {
    let (x, y) = view(block).split_at_row(features);
    owned(&(x * solved(x.transpose() * x, penalty, y.transpose().to_owned())))
}

/// Primal form, one equation per feature.
///
/// # Panics
/// If a sample is not finite.
pub fn by_features(blocks: &[DMatrix<f32>], features: usize, penalty: f32) -> DMatrix<f32> {
    let rows = blocks.first().map_or(0, DMatrix::nrows);
    let (lower, moments) = scatter(blocks, 0..features, rows - features);
    owned(&solved(lower, penalty, moments))
}

/// Lower triangle of the scatter of a range of rows, and their moments with as many rows `below` it.
pub(crate) fn scatter(
    blocks: &[DMatrix<f32>],
    range: Range<usize>,
    below: usize,
) -> (Mat<f32>, Mat<f32>) {
    let features = range.len();
    let rows = features + below;
    // Lower triangle only.
    let part = |first: usize| {
        let mut sum = Mat::zeros(rows - first, COLUMNS.min(features - first));
        for block in blocks {
            let below = view(block).subrows(range.start + first, rows - first);
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
    let moments = Mat::from_fn(features, below, |k, t| scatter(features + t, k));
    (lower, moments)
}
