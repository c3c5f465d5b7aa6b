//! The cascade learnt: each stage by ridge regression where the stages before it really end, then quantised to 8 bits.
//!
//! Targets are the remaining differences from the truth in all parameters (view units and standard deviations of
//! shape), features the patches and the prior columns of [`mien_stages::landmarks::cascade`]. After learning, the
//! *quantised* stage moves the samples on, so that the next one is trained on its output. Supervised descent (Xiong
//! and De la Torre 2013).

use nalgebra::DMatrix;
use rayon::prelude::*;

use super::ridge::{LinearMap, ridge};
use super::samples::{MapBuffer, Sample};
use mien_stages::base::capacity::LANDMARKS;
use mien_stages::face_model::{
    CascadeStage, FEATURES, FaceModel, MAX_MODES, MAX_PARAMETERS, PATCH, ShapeModel,
    VIEW_PARAMETERS,
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

fn quantised(map: &LinearMap, cell_px: f32, parameters: usize) -> CascadeStage {
    let mut stage = CascadeStage {
        cell_px,
        mean: map.mean.as_slice()[..FEATURES].to_vec(),
        ..CascadeStage::default()
    };
    for row in 0..parameters {
        for landmark in 0..LANDMARKS {
            let patch = (0..PATCH).map(|k| map.weights[(row, landmark * PATCH + k)]);
            let scale = patch.clone().fold(0.0f32, |m, w| m.max(w.abs())) / 127.0;
            let part = |w: f32| (w / scale.max(1e-30)).round().clamp(-127.0, 127.0) as i8;
            stage.scales.push(scale);
            stage.weights.to_mut().extend(patch.map(part));
        }
        // Prior columns are not centred at run time: their means go into the bias.
        let mut bias = map.bias[row];
        for k in 0..parameters {
            let w = map.weights[(row, FEATURES + k)];
            bias -= w * map.mean[FEATURES + k];
            stage.prior.push(w * PRIOR_SCALE);
        }
        stage.bias.push(bias);
    }
    stage
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
    let stage = quantised(&map, cell_px, parameters);
    // Moves the samples by the quantised weights, on the existing features.
    let mut weights = map.weights.clone();
    for row in 0..parameters {
        for k in 0..FEATURES {
            let scale = stage.scales[row * LANDMARKS + k / PATCH];
            weights[(row, k)] = scale * f32::from(stage.weights[row * FEATURES + k]);
        }
    }
    let chunks = progress.par_chunks_mut(BLOCK).zip(&blocks);
    chunks.for_each(|(chunk, block)| {
        let steps = &weights * block.rows(0, inputs);
        for (p, step) in chunk.iter_mut().zip(steps.column_iter()) {
            p.fit = updated(&p.fit, (step + &map.bias).as_slice());
        }
    });
    stage
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
