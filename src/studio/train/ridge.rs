//! Ridge regression of a few targets on many features: `min Σ |W x + bias − y|² + λ |W|²`.
//!
//! Conjugate gradients on the normal equations (CGLS, Björck 1996, 7.4), all rows of `W` side by side, so that the work is
//! two matrix products per step; samples stay in blocks that are shared out over threads. `λ` is given relative to the
//! mean eigenvalue of the features' scatter. Memory: twice the features as 32-bit floats. Degenerate: constant features
//! get weight 0. Limits: [`STEPS`] steps; directions of tiny variance are not reached, which is what the penalty wants too.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

/// Steps of conjugate gradients. Few on purpose: a stage costs as many passes over all features, and stopping early only
/// adds to the penalty on directions of tiny variance.
pub const STEPS: usize = 25;

/// Some samples: features by column, the same transposed, targets by column.
pub struct Block {
    /// Features, one column per sample.
    pub features: DMatrix<f32>,
    transposed: DMatrix<f32>,
    targets: DMatrix<f32>,
}

impl Block {
    /// From features (rows) of samples (columns) and their targets.
    pub fn new(features: DMatrix<f32>, targets: DMatrix<f32>) -> Self {
        Self {
            transposed: DMatrix::zeros(0, 0),
            features,
            targets,
        }
    }
}

/// A linear map and what it is relative to: `y = weights (x − mean) + bias`.
pub struct LinearMap {
    /// One row per target.
    pub weights: DMatrix<f32>,
    /// Mean features.
    pub mean: DVector<f32>,
    /// Mean targets.
    pub bias: DVector<f32>,
}

/// Adds what each number of a matrix comes to up by rows.
fn row_sums<'a>(
    all: impl IntoIterator<Item = &'a DMatrix<f32>>,
    rows: usize,
    of: fn(f64) -> f64,
) -> DVector<f64> {
    let mut sums = DVector::zeros(rows);
    for column in all.into_iter().flat_map(DMatrix::column_iter) {
        for (sum, v) in sums.iter_mut().zip(column.iter()) {
            *sum += of(f64::from(*v));
        }
    }
    sums
}

fn row_squares(m: &DMatrix<f32>) -> DVector<f64> {
    row_sums([m], m.nrows(), |v| v * v)
}

fn add_scaled(to: &mut DMatrix<f32>, by: &DVector<f32>, from: &DMatrix<f32>) {
    for (mut a, b) in to.column_iter_mut().zip(from.column_iter()) {
        for ((a, b), k) in a.iter_mut().zip(b.iter()).zip(by.iter()) {
            *a += k * b;
        }
    }
}

/// Takes the means off the blocks' features and targets, and returns them.
fn centred(
    blocks: &mut [Block],
    dimensions: usize,
    targets: usize,
) -> (DVector<f32>, DVector<f32>) {
    let count: usize = blocks.iter().map(|b| b.features.ncols()).sum();
    let mean_of = |of: fn(&Block) -> &DMatrix<f32>, rows: usize| {
        let sum = row_sums(blocks.iter().map(of), rows, |v| v);
        (sum / count.max(1) as f64).map(|v| v as f32)
    };
    let mean = mean_of(|b| &b.features, dimensions);
    let bias = mean_of(|b| &b.targets, targets);
    blocks.par_iter_mut().for_each(|block| {
        for mut column in block.features.column_iter_mut() {
            column -= &mean;
        }
        for mut column in block.targets.column_iter_mut() {
            column -= &bias;
        }
        block.transposed = block.features.transpose();
    });
    (mean, bias)
}

/// Solves the regression. The blocks' features lose their mean, and their targets become what is left of them.
pub fn ridge(blocks: &mut [Block], relative_penalty: f32) -> LinearMap {
    let dimensions = blocks.first().map_or(0, |b| b.features.nrows());
    let targets = blocks.first().map_or(0, |b| b.targets.nrows());
    let (mean, bias) = centred(blocks, dimensions, targets);
    let trace: f64 = blocks
        .par_iter()
        .map(|b| b.features.iter().map(|v| f64::from(v * v)).sum::<f64>())
        .sum();
    let lambda = (f64::from(relative_penalty) * trace / dimensions.max(1) as f64) as f32;

    let mut weights = DMatrix::<f32>::zeros(targets, dimensions);
    // Residuals live in the blocks' targets.
    let gradient = |blocks: &[Block], weights: &DMatrix<f32>| {
        let mut sum = blocks
            .par_iter()
            .map(|b| &b.targets * &b.transposed)
            .reduce(|| DMatrix::zeros(targets, dimensions), |a, b| a + b);
        sum -= weights * lambda;
        sum
    };
    let mut slope = gradient(blocks, &weights);
    let mut direction = slope.clone();
    let mut gamma = row_squares(&slope);
    for _ in 0..STEPS {
        let images = blocks.par_iter().map(|b| &direction * &b.features);
        let images: Vec<DMatrix<f32>> = images.collect();
        let mut energy = row_squares(&direction) * f64::from(lambda);
        for image in &images {
            energy += row_squares(image);
        }
        let alpha = gamma.zip_map(&energy, |g, e| (g / e.max(1e-30)) as f32);
        add_scaled(&mut weights, &alpha, &direction);
        let back = -&alpha;
        blocks
            .par_iter_mut()
            .zip(&images)
            .for_each(|(block, image)| add_scaled(&mut block.targets, &back, image));
        slope = gradient(blocks, &weights);
        let next = row_squares(&slope);
        let beta = next.zip_map(&gamma, |n, g| (n / g.max(1e-30)) as f32);
        gamma = next;
        for (mut d, s) in direction.column_iter_mut().zip(slope.column_iter()) {
            for ((d, s), b) in d.iter_mut().zip(s.iter()).zip(beta.iter()) {
                *d = s + b * *d;
            }
        }
    }
    LinearMap {
        weights,
        mean,
        bias,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_planted_map_is_found() {
        let mut random = fastrand::Rng::with_seed(4);
        let planted = DMatrix::<f32>::from_fn(3, 20, |_, _| random.f32() - 0.5);
        let mut blocks: Vec<Block> = (0..3)
            .map(|_| {
                let x = DMatrix::<f32>::from_fn(20, 80, |_, _| random.f32() + 2.0);
                let y = (&planted * &x).add_scalar(0.7);
                Block::new(x, y)
            })
            .collect();
        let map = ridge(&mut blocks, 1e-6);
        assert!((&map.weights - &planted).amax() < 1e-3);
        let offset = &map.bias - &map.weights * &map.mean;
        assert!((offset.add_scalar(-0.7)).amax() < 1e-2);
    }
}
