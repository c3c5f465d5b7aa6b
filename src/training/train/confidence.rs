//! The confidence model: distinguishes good fits from all other results of a cascade.
//!
//! Per landmark a linear discriminant (Fisher 1936) of its patch separates visible points within 5 % of the eye
//! distance from points that are covered, beyond 8 % or on no face. Confidences are logistic regressions of "within 5
//! %" (of a landmark: and visible) on these discriminants ([`landmark_inputs`], [`face_inputs`]). The face's is
//! weighted by the frequency of each kind of fit, so that a share c of the faces with confidence c is good as long as
//! failures are about as frequent as here. Fits must be of pictures that the cascade was not trained on. Limits: only
//! failures like these are recognised.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::cascade::Progress;
use super::evaluate::{differences, mean_percent};
use super::samples::{MapBuffer, Sample};
use mien_stages::base::capacity::LANDMARKS;
use mien_stages::face_model::{ConfidenceModel, MEAN_STEPS, PATCH, ShapeModel};
use mien_stages::landmarks::cascade::{Solver, discriminants, face_inputs, landmark_inputs};

/// Largest error of a good point, percent of the eye distance.
const GOOD_PERCENT: f32 = 5.0;
/// Least error of a bad point, percent of the eye distance.
const BAD_PERCENT: f32 = 8.0;
/// Added to the diagonal of a patch's scatter, relative to its mean.
const RIDGE: f64 = 0.3;

/// Weighted logistic regression by Newton's method; the last column of `x` should be 1.
fn logistic_regression(x: &DMatrix<f64>, y: &[f64], weights: &[f64]) -> DVector<f64> {
    let mut w = DVector::zeros(x.ncols());
    for _ in 0..30 {
        // Slightly regularised towards 0: without failures the slopes would diverge.
        let mut slope = -&w * 0.1;
        let mut curvature = DMatrix::identity(x.ncols(), x.ncols()) * 0.1;
        for ((row, &y), weight) in x.row_iter().zip(y).zip(weights) {
            let p = 1.0 / (1.0 + (-row.dot(&w.transpose())).exp());
            slope += row.transpose() * (weight * (y - p));
            curvature += row.transpose() * row * (weight * p * (1.0 - p));
        }
        match curvature.cholesky() {
            Some(c) => w += c.solve(&slope),
            None => break,
        }
    }
    w
}

/// Logistic regression over rows of signs.
fn regressed<const N: usize>(signs: &[[f32; N]], good: &[bool], weights: &[f64]) -> [f32; N] {
    let x = DMatrix::from_fn(signs.len(), N, |row, column| f64::from(signs[row][column]));
    let y: Vec<f64> = good.iter().map(|&g| f64::from(u8::from(g))).collect();
    let w = logistic_regression(&x, &y, weights);
    std::array::from_fn(|k| w[k] as f32)
}

/// Learns from results of fits: their errors define good; `faceless` marks samples without a face, `weight` is the
/// weight of a sample's fit in the face's confidence.
pub fn learn(
    samples: &[Sample],
    ends: &[Progress],
    faceless: &(dyn Fn(usize) -> bool + Sync),
    weight: &dyn Fn(usize) -> f64,
    shape: &ShapeModel,
    cell_px: f32,
) -> ConfidenceModel {
    let (errors, faces) = landmark_errors(samples, ends, faceless, shape);
    let seen = |(solver, buffer): &mut (Solver, MapBuffer), end: &Progress| {
        let maps = buffer.compute_maps(&samples[end.sample]);
        solver.features(shape, maps, &end.fit, cell_px).to_vec()
    };
    let features = ends.par_iter().map_init(Default::default, seen);
    let features: Vec<Vec<f32>> = features.collect();
    let mut model = ConfidenceModel {
        cell_px,
        ..ConfidenceModel::default()
    };
    let landmarks = (0..LANDMARKS).into_par_iter();
    let directions = landmarks.map(|i| discriminant(&features, &errors, i));
    let directions: Vec<_> = directions.collect();
    for (mean, direction) in &directions {
        add_patch(&mut model, mean, direction);
    }
    let values = features.par_iter().map(|own| discriminants(&model, own));
    let values: Vec<[f32; LANDMARKS]> = values.collect();
    let signs: Vec<_> = values.iter().map(landmark_inputs).collect();
    let alike = vec![1.0; ends.len()];
    for i in 0..LANDMARKS {
        let own: Vec<_> = signs.iter().map(|s| s[i]).collect();
        let good: Vec<bool> = errors.iter().map(|e| e[i] <= GOOD_PERCENT).collect();
        model.landmark.extend(regressed(&own, &good, &alike));
    }
    let signs = values.iter().zip(ends);
    let signs: Vec<_> = signs.map(|(own, end)| face_inputs(own, &end.fit)).collect();
    let good: Vec<bool> = faces.iter().map(|e| *e <= GOOD_PERCENT).collect();
    let weights: Vec<f64> = ends.iter().map(|end| weight(end.sample)).collect();
    model.face = regressed(&signs, &good, &weights);
    model
}

/// Appends the discriminant of one landmark's patch, rounded to 8 bits.
pub fn add_patch(model: &mut ConfidenceModel, mean: &[f32], direction: &[f32]) {
    let steps = mean.iter().map(|m| (m * MEAN_STEPS).round() as u8);
    model.mean.extend(steps);
    let scale = direction
        .iter()
        .fold(1e-30_f32, |most, w| most.max(w.abs()))
        / 127.0;
    let steps = direction.iter().map(|w| (w / scale).round() as i8);
    model.weights.extend(steps);
    model.scales.push(scale);
}

/// Errors per landmark in percent of the eye distance, infinite without a face and for covered points, and their
/// means over a face, covered points included.
fn landmark_errors(
    samples: &[Sample],
    ends: &[Progress],
    faceless: &(dyn Fn(usize) -> bool + Sync),
    shape: &ShapeModel,
) -> (Vec<[f32; LANDMARKS]>, Vec<f32>) {
    ends.par_iter()
        .map_init(Solver::default, |solver, end| {
            if faceless(end.sample) {
                return ([f32::INFINITY; LANDMARKS], f32::INFINITY);
            }
            solver.project(shape, &end.fit);
            let points = &samples[end.sample].points;
            let differences = differences(&solver.window, points);
            let mut errors = differences.map(|d| mean_percent(&[d]));
            let face = errors.iter().sum::<f32>() / LANDMARKS as f32;
            for (error, visible) in errors.iter_mut().zip(samples[end.sample].visible) {
                if !visible {
                    *error = f32::INFINITY;
                }
            }
            (errors, face)
        })
        .unzip()
}

/// Mean and direction of the discriminant of one landmark's patch.
fn discriminant(
    features: &[Vec<f32>],
    errors: &[[f32; LANDMARKS]],
    landmark: usize,
) -> (Vec<f32>, Vec<f32>) {
    let patch = landmark * PATCH..(landmark + 1) * PATCH;
    let mut sums = [DVector::<f64>::zeros(PATCH), DVector::<f64>::zeros(PATCH)];
    let mut counts = [0.0f64; 2];
    let class = |k: usize| match errors[k][landmark] {
        e if e <= GOOD_PERCENT => Some(0),
        e if e > BAD_PERCENT => Some(1),
        _ => None,
    };
    for (k, f) in features.iter().enumerate() {
        if let Some(class) = class(k) {
            counts[class] += 1.0;
            for (s, v) in sums[class].iter_mut().zip(&f[patch.clone()]) {
                *s += f64::from(*v);
            }
        }
    }
    let means = [0, 1].map(|class: usize| &sums[class] / f64::max(counts[class], 1.0));
    let mut scatter = DMatrix::<f64>::zeros(PATCH, PATCH);
    for (class_number, mean) in means.iter().enumerate() {
        let members = (0..features.len()).filter(|&k| class(k) == Some(class_number));
        let members: Vec<usize> = members.collect();
        let centred = DMatrix::<f32>::from_fn(PATCH, members.len(), |row, column| {
            features[members[column]][patch.start + row] - mean[row] as f32
        });
        let own = &centred * centred.transpose();
        scatter += own.cast::<f64>() / f64::max(counts[class_number], 1.0);
    }
    let ridge = RIDGE * scatter.trace() / PATCH as f64 + 1e-9;
    for k in 0..PATCH {
        scatter[(k, k)] += ridge;
    }
    let difference = &means[0] - &means[1];
    let solved = scatter.cholesky().map(|c| c.solve(&difference));
    let middle = (&means[0] + &means[1]) * 0.5;
    let single = |v: DVector<f64>| v.iter().map(|v| *v as f32).collect();
    (single(middle), single(solved.unwrap_or(difference)))
}
