//! Rounds the weights of a linear map to few levels so that its outputs change least over given samples.
//!
//! A row of weights with errors `e` changes its output by `e H eᵀ = |e L|²` over samples of the scatter `H = L Lᵀ`. Column k of `L`
//! has no entries above k, so the weights are rounded from the last to the first, and each takes over the errors of those before
//! it, `Σ e_i L_ik / L_kk`, before it is rounded itself. Method: LDLQ (Chee, Cai, Kuleshov, De Sa 2023), which gives the same result
//! as GPTQ (Frantar, Ashkboos, Hoefler, Alistarh 2022).
//!
//! Memory: three scatters, as 32-bit floats. Degenerate: constant features are rounded each for itself.

use faer::Side;
use nalgebra::DMatrix;
use rayon::prelude::*;

use crate::normal_equations::scatter;

/// Rounds `weights`, one row per target, over the first rows of the samples (one column each), in groups of `group` features that do
/// not take over errors of each other; `nearest(row, feature, weight)` is the level nearest to a weight. `relative_penalty` is added
/// to the scatter's diagonal, relative to the mean.
///
/// # Panics
/// If a sample is not finite.
pub fn round(
    weights: &mut DMatrix<f32>,
    blocks: &[DMatrix<f32>],
    group: usize,
    relative_penalty: f32,
    nearest: &(dyn Fn(usize, usize, f32) -> f32 + Sync),
) {
    for first in (0..weights.ncols()).step_by(group.max(1)) {
        let features = group.min(weights.ncols() - first);
        let (mut lower, _) = scatter(blocks, first..first + features, 0);
        let trace: f64 = (0..features).map(|k| f64::from(lower[(k, k)])).sum();
        let penalty = f64::from(relative_penalty) * trace / features as f64;
        for k in 0..features {
            lower[(k, k)] += (penalty as f32).max(f32::MIN_POSITIVE);
        }
        let factor = lower.llt(Side::Lower).expect("samples are finite");
        let factor = factor.L();
        let rows: Vec<Vec<f32>> = (0..weights.nrows())
            .into_par_iter()
            .map(|row| {
                let (mut rounded, mut errors) = (vec![0.0; features], vec![0.0_f32; features]);
                for k in (0..features).rev() {
                    let column = factor.col(k);
                    let passed: f32 = (k + 1..features).map(|i| errors[i] * column[i]).sum();
                    let weight = weights[(row, first + k)];
                    rounded[k] = nearest(row, first + k, weight + passed / column[k]);
                    errors[k] = weight - rounded[k];
                }
                rounded
            })
            .collect();
        for (row, rounded) in rows.into_iter().enumerate() {
            weights
                .view_mut((row, first), (1, features))
                .copy_from_slice(&rounded);
        }
    }
}
