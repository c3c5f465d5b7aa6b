//! Training of the cascade: each stage by ridge regression on the results of the stages before it, then rounded to two bits a weight.
//!
//! Targets are the remaining differences from the truth in all parameters (view units and standard deviations of
//! shape), features the patches and the prior columns of [`mien_stages::landmarks::cascade`]. After learning, the
//! *rounded* stage moves the samples on, so that the next one is trained on its output. Supervised descent (Xiong
//! and De la Torre 2013); rounding: [`mien_linear::rounding`].

use nalgebra::DMatrix;
use rayon::prelude::*;

use super::ridge::ridge;
use super::samples::{MapBuffer, Sample};
use mien_stages::base::capacity::LANDMARKS;
use mien_stages::face_model::{
    CascadeStage, FEATURES, FaceModel, LEVELS_PER_BYTE, MAX_MODES, MAX_PARAMETERS, MEAN_STEPS,
    PATCH, PATCH_BYTES, ShapeModel, VIEW_PARAMETERS, weight_at,
};
use mien_stages::landmarks::cascade::{FaceFit, Solver, prior_columns, updated};
use mien_stages::landmarks::view::View;

/// Samples of one block.
const BLOCK: usize = 2048;
/// Scale of the prior columns against the features while learning: they vary ten times as much.
const PRIOR_SCALE: f32 = 0.2;

/// Penalty of the regression, relative to the mean eigenvalue.
const PENALTY: f32 = 0.05;

/// State of a sample between stages.
pub struct Progress {
    /// Index of the sample.
    pub sample: usize,
    /// Present fit.
    pub fit: FaceFit,
    /// The view from which differences are measured.
    pub anchor: View,
}

/// Difference from `fit` to the truth in all parameters.
fn way(sample: &Sample, fit: &FaceFit, modes: usize, out: &mut [f32]) {
    out[..VIEW_PARAMETERS].copy_from_slice(&sample.truth.view.step_from(&fit.view));
    for k in 0..modes {
        out[VIEW_PARAMETERS + k] = sample.truth.shape[k] - fit.shape[k];
    }
}

/// Levels of a weight are odd multiples of this share of its patch's root mean square: -3, -1, 1, 3.
const LEVEL: f32 = 0.6;
/// Penalty of the rounding, relative to the mean eigenvalue: too few samples underestimate the scatter.
const ROUNDING_PENALTY: f32 = 0.02;

/// A stage whose weights on the image are `weights` (x − `mean`), rounded to two bits; the blocks' first rows are features less
/// `sample_mean`. `stage` comes with its prior, and with the bias of the unrounded weights, which is corrected.
pub fn rounded(
    mut stage: CascadeStage,
    mut weights: DMatrix<f32>,
    mean: &[f32],
    blocks: &[DMatrix<f32>],
    sample_mean: &[f32],
) -> CascadeStage {
    let before = weights.clone();
    for patch in 0..weights.nrows() * LANDMARKS {
        let (row, landmark) = (patch / LANDMARKS, patch % LANDMARKS);
        let patch = weights.view((row, landmark * PATCH), (1, PATCH));
        let scale = LEVEL * patch.norm() / (PATCH as f32).sqrt();
        stage.scales.push(scale.into());
    }
    // With fewer samples than features the scatter is singular: patches are rounded independently.
    let samples: usize = blocks.iter().map(DMatrix::ncols).sum();
    let group = if samples < FEATURES { PATCH } else { FEATURES };
    let scales: Vec<f32> = stage.scales.iter().map(|scale| f32::from(*scale)).collect();
    let level = |row: usize, k: usize, weight: f32| {
        let scale = scales[row * LANDMARKS + k / PATCH].max(1e-30);
        (2.0 * (weight / (2.0 * scale)).floor() + 1.0).clamp(-3.0, 3.0)
    };
    mien_linear::rounding::round(
        &mut weights,
        blocks,
        group,
        ROUNDING_PENALTY,
        &|row, k, weight| level(row, k, weight) * scales[row * LANDMARKS + k / PATCH],
    );
    let means = sample_mean.iter().map(|m| (m * MEAN_STEPS).round() as u8);
    stage.mean = means.collect();
    for row in 0..weights.nrows() {
        for landmark in 0..LANDMARKS {
            for byte in 0..PATCH_BYTES {
                let at = |part: usize| landmark * PATCH + part * PATCH_BYTES + byte;
                let bits = |part: usize| {
                    let level = level(row, at(part), weights[(row, at(part))]);
                    ((level as i32 + 3) / 2) << (2 * part)
                };
                let byte: i32 = (0..LEVELS_PER_BYTE).map(bits).sum();
                stage.levels.to_mut().push(byte as u8);
            }
        }
        // At the samples' mean the update stays what it was.
        for k in 0..FEATURES {
            let kept = f32::from(stage.mean[k]) / MEAN_STEPS;
            stage.bias[row] += before[(row, k)] * (sample_mean[k] - mean[k])
                - weights[(row, k)] * (sample_mean[k] - kept);
        }
    }
    stage
}

/// The rounded weights of a stage, one row per parameter.
fn rounded_weights(stage: &CascadeStage) -> DMatrix<f32> {
    let patches = stage.levels.as_chunks::<PATCH_BYTES>().0;
    DMatrix::from_fn(stage.bias.len(), FEATURES, |row, k| {
        let patch = row * LANDMARKS + k / PATCH;
        f32::from(stage.scales[patch]) * weight_at(&patches[patch], k % PATCH) as f32
    })
}

/// Learns one stage from the samples' states and moves them on. `cell_px` is the spacing of its patches' cells,
/// window pixels; only the first shape modes of the given number move.
pub fn learn_stage(
    samples: &[Sample],
    progress: &mut [Progress],
    shape: &ShapeModel,
    (cell_px, modes): (f32, usize),
) -> CascadeStage {
    let modes = modes.min(shape.modes.len());
    let parameters = VIEW_PARAMETERS + modes;
    let inputs = FEATURES + parameters;
    let mut blocks: Vec<DMatrix<f32>> = progress
        .par_chunks(BLOCK)
        .map(|chunk| {
            let (mut solver, mut buffer) = (Solver::default(), MapBuffer::default());
            let mut block = DMatrix::zeros(inputs + parameters, chunk.len());
            let mut columns = [0.0; MAX_PARAMETERS];
            for (p, mut column) in chunk.iter().zip(block.column_iter_mut()) {
                let sample = &samples[p.sample];
                let (known, target) = column.as_mut_slice().split_at_mut(inputs);
                let patches = solver.features(shape, buffer.compute_maps(sample), &p.fit, cell_px);
                known[..FEATURES].copy_from_slice(patches);
                prior_columns(&p.fit, &p.anchor, &mut columns);
                for (to, c) in known[FEATURES..].iter_mut().zip(&columns) {
                    *to = c * PRIOR_SCALE;
                }
                way(sample, &p.fit, modes, target);
            }
            block
        })
        .collect();
    let map = ridge(&mut blocks, parameters, PENALTY);
    let mut stage = CascadeStage {
        cell_px,
        bias: map.bias.as_slice().to_vec(),
        ..CascadeStage::default()
    };
    for row in 0..parameters {
        // Prior columns are not centred at run time: their means go into the bias.
        for k in 0..parameters {
            let w = map.weights[(row, FEATURES + k)];
            stage.bias[row] -= w * map.mean[FEATURES + k];
            stage.prior.push((w * PRIOR_SCALE).into());
        }
    }
    let mean = &map.mean.as_slice()[..FEATURES];
    let image = map.weights.columns(0, FEATURES).into_owned();
    let stage = rounded(stage, image, mean, &blocks, mean);
    // Moves the samples by the rounded weights, on the existing features.
    let mut weights = map.weights.clone();
    weights
        .columns_mut(0, FEATURES)
        .copy_from(&rounded_weights(&stage));
    let chunks = progress.par_chunks_mut(BLOCK).zip(&blocks);
    chunks.for_each(|(chunk, block)| {
        let steps = &weights * block.rows(0, inputs);
        for (p, step) in chunk.iter_mut().zip(steps.column_iter()) {
            p.fit = updated(&p.fit, (step + &map.bias).as_slice());
        }
    });
    stage
}

/// Features of the samples' states, one column each.
pub fn feature_blocks(
    samples: &[Sample],
    progress: &[Progress],
    shape: &ShapeModel,
    cell_px: f32,
) -> Vec<DMatrix<f32>> {
    let block = |chunk: &[Progress]| {
        let (mut solver, mut buffer) = (Solver::default(), MapBuffer::default());
        let mut block = DMatrix::zeros(FEATURES, chunk.len());
        for (p, mut column) in chunk.iter().zip(block.column_iter_mut()) {
            let maps = buffer.compute_maps(&samples[p.sample]);
            column.copy_from_slice(solver.features(shape, maps, &p.fit, cell_px));
        }
        block
    };
    progress.par_chunks(BLOCK).map(block).collect()
}

/// Applies stages to all samples.
pub fn advance(
    samples: &[Sample],
    progress: &mut [Progress],
    shape: &ShapeModel,
    stages: &[CascadeStage],
) {
    progress.par_chunks_mut(64).for_each(|chunk| {
        let (mut solver, mut buffer) = (Solver::default(), MapBuffer::default());
        for p in chunk {
            let maps = buffer.compute_maps(&samples[p.sample]);
            p.fit = solver.run(stages, shape, maps, &p.fit, &p.anchor);
        }
    });
}

/// Cold starts: the mean shape at the depth pose.
pub fn cold_starts(samples: &[Sample]) -> Vec<Progress> {
    let start = |(sample, s): (usize, &Sample)| {
        let (view, shape) = (s.depth, [0.0; MAX_MODES]);
        Progress {
            sample,
            fit: FaceFit { view, shape },
            anchor: view,
        }
    };
    samples.iter().enumerate().map(start).collect()
}

/// Runs a model's cold and warm stages in the order of the appliance.
pub fn fit_cold(samples: &[Sample], model: &FaceModel) -> Vec<Progress> {
    let mut progress = cold_starts(samples);
    advance(samples, &mut progress, &model.shape, &model.cold);
    advance(samples, &mut progress, &model.shape, &model.warm);
    progress
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Features of smooth patches: neighbours are alike, as in pictures.
    fn samples() -> Vec<DMatrix<f32>> {
        let mut random = fastrand::Rng::with_seed(3);
        let mut block = DMatrix::zeros(FEATURES, 600);
        for mut column in block.column_iter_mut() {
            let mut level = 0.0;
            for value in column.iter_mut() {
                level = 0.9 * level + 0.1 * (random.f32() - 0.5);
                *value = level;
            }
        }
        vec![block]
    }

    #[test]
    fn a_rounded_stage_moves_samples_like_the_one_it_stands_for() {
        let mut random = fastrand::Rng::with_seed(5);
        let weights = DMatrix::from_fn(2, FEATURES, |_, _| random.f32() - 0.5);
        let blocks = samples();
        let mean = vec![0.3; FEATURES];
        let start = CascadeStage {
            bias: vec![0.5, -1.0],
            prior: vec![0.0.into(); 4],
            ..CascadeStage::default()
        };
        let stage = rounded(start, weights.clone(), &mean, &blocks, &mean);
        let found = rounded_weights(&stage);
        let plain = weights.map_with_location(|row, k, weight| {
            let scale = f32::from(stage.scales[row * LANDMARKS + k / PATCH]);
            scale * (2.0 * (weight / (2.0 * scale)).floor() + 1.0).clamp(-3.0, 3.0)
        });
        let off = |other: &DMatrix<f32>| ((&weights - other) * &blocks[0]).norm();
        let moved = (&weights * &blocks[0]).norm();
        assert!(off(&found) < 0.2 * moved, "{} of {moved}", off(&found));
        assert!(off(&found) < 0.5 * off(&plain), "{}", off(&plain));
        // What rounding the mean features changes is in the bias.
        let kept = f32::from(stage.mean[0]) / MEAN_STEPS;
        for row in 0..2 {
            let at_mean = stage.bias[row] + found.row(row).sum() * (mean[0] - kept);
            assert!((at_mean - [0.5, -1.0][row]).abs() < 1e-3, "{at_mean}");
        }
    }
}
