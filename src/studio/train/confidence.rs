//! What a fitted face looks like, against everything a cascade may end on: the confidence model.
//!
//! Per landmark a linear discriminant (Fisher 1936) of its patch between fits within 5 % of the eye distance and fits
//! beyond 8 % or on no face at all; per landmark a logistic regression on its own and the mean discriminant, for the face
//! one on the mean alone. So 0.5 means: as often within 5 % as not. Limits: it knows only the failures it was shown.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::cascade::Progress;
use super::samples::Sample;
use crate::capacity::LANDMARKS;
use crate::face_model::{ConfidenceModel, FEATURES, PATCH, ShapeModel, scheme};
use crate::landmarks::cascade::{Solver, logistic};

/// Errors up to this are good, per cent of the eye distance.
const GOOD_PERCENT: f32 = 5.0;
/// Errors from this on are bad, per cent of the eye distance.
const BAD_PERCENT: f32 = 8.0;
/// Added to the diagonal of a patch's scatter, relative to its mean.
const RIDGE: f64 = 0.3;

/// Weighted logistic regression by Newton's method; the last column of `x` should be 1.
fn logistic_regression(x: &DMatrix<f64>, y: &[f64]) -> DVector<f64> {
    let positive = y.iter().sum::<f64>().max(1.0);
    let negative = (y.len() as f64 - y.iter().sum::<f64>()).max(1.0);
    let mut w = DVector::zeros(x.ncols());
    for _ in 0..30 {
        let mut slope = -&w * 1e-3;
        let mut curvature = DMatrix::identity(x.ncols(), x.ncols()) * 1e-3;
        for (row, &y) in x.row_iter().zip(y) {
            let weight = if y > 0.5 {
                1.0 / positive
            } else {
                1.0 / negative
            } * 1000.0;
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

/// Learns from the ends of fits: errors decide what is good; `faceless` tells samples that show no face.
#[must_use]
pub fn learn(
    samples: &[Sample],
    ends: &[Progress],
    faceless: &(dyn Fn(usize) -> bool + Sync),
    shape: &ShapeModel,
    cell_px: f32,
) -> ConfidenceModel {
    // Errors per landmark in per cent of the eye distance; infinite where there is no face.
    let errors: Vec<[f32; LANDMARKS]> = ends
        .par_iter()
        .map_init(Solver::default, |solver, end| {
            if faceless(end.sample) {
                return [f32::INFINITY; LANDMARKS];
            }
            solver.project(shape, &end.fit);
            let points = &samples[end.sample].points;
            let eye = scheme::outer_eye_distance(points);
            std::array::from_fn(|i| {
                let (a, b) = (solver.window[i], points[i]);
                100.0 * (a[0] - b[0]).hypot(a[1] - b[1]) / eye
            })
        })
        .collect();
    let features: Vec<Vec<f32>> = ends
        .par_iter()
        .map_init(Solver::default, |solver, end| {
            solver
                .features(shape, &samples[end.sample].maps, &end.fit, cell_px)
                .to_vec()
        })
        .collect();
    let mut model = ConfidenceModel {
        cell_px,
        mean: vec![0.0; FEATURES],
        weights: vec![0.0; FEATURES],
        landmark: vec![0.0; 3 * LANDMARKS],
        face: [0.0; 2],
    };
    let directions: Vec<(Vec<f32>, Vec<f32>)> = (0..LANDMARKS)
        .into_par_iter()
        .map(|i| discriminant(&features, &errors, i))
        .collect();
    for (i, (mean, direction)) in directions.into_iter().enumerate() {
        model.mean[i * PATCH..(i + 1) * PATCH].copy_from_slice(&mean);
        model.weights[i * PATCH..(i + 1) * PATCH].copy_from_slice(&direction);
    }
    let values: Vec<[f32; LANDMARKS]> = ends
        .par_iter()
        .map_init(Solver::default, |solver, end| {
            let mut d = [0.0; LANDMARKS];
            let maps = &samples[end.sample].maps;
            solver.discriminants(&model, shape, maps, &end.fit, &mut d);
            d
        })
        .collect();
    let means: Vec<f32> = values
        .iter()
        .map(|d| d.iter().sum::<f32>() / LANDMARKS as f32)
        .collect();
    for i in 0..LANDMARKS {
        let rows: Vec<usize> = (0..ends.len())
            .filter(|&k| errors[k][i] < GOOD_PERCENT || errors[k][i] > BAD_PERCENT)
            .collect();
        let x = DMatrix::from_fn(rows.len(), 3, |row, column| match column {
            0 => f64::from(values[rows[row]][i]),
            1 => f64::from(means[rows[row]]),
            _ => 1.0,
        });
        let y: Vec<f64> = rows
            .iter()
            .map(|&k| f64::from(u8::from(errors[k][i] < GOOD_PERCENT)))
            .collect();
        let w = logistic_regression(&x, &y);
        for k in 0..3 {
            model.landmark[3 * i + k] = w[k] as f32;
        }
    }
    let face_error = |k: usize| errors[k][17..].iter().sum::<f32>() / 51.0;
    let rows: Vec<usize> = (0..ends.len())
        .filter(|&k| face_error(k) < GOOD_PERCENT || face_error(k) > BAD_PERCENT)
        .collect();
    let x = DMatrix::from_fn(rows.len(), 2, |row, column| {
        if column == 0 {
            f64::from(means[rows[row]])
        } else {
            1.0
        }
    });
    let y: Vec<f64> = rows
        .iter()
        .map(|&k| f64::from(u8::from(face_error(k) < GOOD_PERCENT)))
        .collect();
    let w = logistic_regression(&x, &y);
    model.face = [w[0] as f32, w[1] as f32];
    model
}

/// Share of good ends that are believed and of bad ends that are not, at confidence 0.5.
#[must_use]
pub fn rates(believed: &[(f32, bool)], face: [f32; 2]) -> [f32; 2] {
    let share = |good: bool| {
        let of: Vec<_> = believed.iter().filter(|(_, g)| *g == good).collect();
        let right = of
            .iter()
            .filter(|(d, _)| (logistic(face[0] * d + face[1]) > 0.5) == good)
            .count();
        right as f32 / of.len().max(1) as f32
    };
    [share(true), share(false)]
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
        e if e < GOOD_PERCENT => Some(0),
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
    let means = [
        &sums[0] / f64::max(counts[0], 1.0),
        &sums[1] / f64::max(counts[1], 1.0),
    ];
    let mut scatter = DMatrix::<f64>::zeros(PATCH, PATCH);
    for (class_number, mean) in means.iter().enumerate() {
        let members: Vec<usize> = (0..features.len())
            .filter(|&k| class(k) == Some(class_number))
            .collect();
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
    let direction = scatter
        .cholesky()
        .map_or_else(|| difference.clone(), |c| c.solve(&difference));
    let middle = (&means[0] + &means[1]) * 0.5;
    (
        middle.iter().map(|v| *v as f32).collect(),
        direction.iter().map(|v| *v as f32).collect(),
    )
}
