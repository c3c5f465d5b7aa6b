//! Steps of the combined 2D+3D fit: alternately over (p, λ) and over (view, q), to lessen
//!
//! ```text
//!   Σ_x [A0(x) + Σ λ_i A_i(x) − I(W(x; p))]² / u              image against the model's picture, equation (2)
//! + |s0 + Σ p_i s_i − P_view(S0 + Σ q_k d_k S_k)|² / ρ²        2D shape, equation (1), against the projected 3D shape
//! + |view − view of the depth pose|² / spread²                 the head pose
//! + Σ (p_i / d_i)² + Σ (λ_i / d_i)² + Σ q_k²                   populations of shape, appearance, 3D shape
//! ```
//!
//! with u the variance of a grey value times [`PIXELS_PER_OBSERVATION`], ρ = [`REPROJECTION_PX`] and spread =
//! [`POSE_SPREAD`]. A step in (p, λ) is simultaneous inverse compositional: the derivative is the template's,
//! `Δ = H⁻¹ Σ SDᵀ [I(W) − A]` with steepest-descent images `SD = [∇(A0 + Σ λ A) ∂W/∂p, A_i]` and `W ← W ∘ W(Δp)⁻¹`; a step in
//! (view, q) is Gauss-Newton. q has fewer numbers than p but is not derived from it: a 2D mode is no 3D mode.
//! One file: both steps share the warp and its derivatives.

use super::model::{MOST_HEAD_MODES, PaperAam};
use super::warp::{STEP, Shape2, compose};
use crate::capacity::LANDMARKS;
use crate::face_model::VIEW_PARAMETERS;
use crate::geometry::Point;
use crate::landmarks::view::{UNITS, View};
use crate::landmarks::window::WINDOW;
#[cfg(not(feature = "std"))]
use crate::prelude::*;
use nalgebra::{Cholesky, DMatrix, DVector};

/// Neighbouring pixels err together: so many count as one observation.
const PIXELS_PER_OBSERVATION: f32 = 12.0;
/// How far the 2D shape may lie from the projected 3D shape, window pixels.
const REPROJECTION_PX: f32 = 1.5;
/// How far the depth pose may be off, in units of the view ([`UNITS`]): scale 7 %, 0.1 rad, 7 window pixels.
const POSE_SPREAD: [f64; VIEW_PARAMETERS] = [1.4, 1.0, 1.0, 1.0, 1.4, 1.4];
/// A step that moves the points less than this, window pixels, ends the fit.
const SETTLED_PX: f32 = 0.05;
/// Most standard deviations of a 2D shape mode.
const MOST_DEVIATIONS: f32 = 3.5;
/// Similarity modes: scale, turn, shift (2).
const SIMILARITY: usize = 4;

/// One fit, and where the next frame starts.
#[derive(Clone, Debug)]
pub struct AamFit {
    /// 2D shape, window pixels.
    pub shape: Shape2,
    /// View of the 3D shape.
    pub view: View,
    /// 3D coefficients, standard deviations.
    pub head: [f32; MOST_HEAD_MODES],
    /// Appearance coefficients λ.
    pub appearance: Vec<f32>,
    /// Root mean square of what the appearance leaves, in standard deviations of grey.
    pub residual: f32,
    /// 0…1.
    pub confidence: f32,
    /// 0…1 per landmark.
    pub point_confidence: [f32; LANDMARKS],
}

/// The model and its scratch.
pub struct Solver {
    model: PaperAam,
    /// Similarity modes, then shape modes; orthonormal.
    basis: Vec<Shape2>,
    values: Vec<f32>,
    template: Vec<f32>,
    descent: DMatrix<f32>,
}

fn dot(a: &Shape2, b: &Shape2) -> f32 {
    a.iter()
        .zip(b)
        .map(|(a, b)| a[0] * b[0] + a[1] * b[1])
        .sum()
}

/// The four orthonormal similarity modes of a shape (Matthews and Baker 2004, section 4.3).
#[must_use]
pub fn similarity_modes(mean: &Shape2) -> [Shape2; SIMILARITY] {
    let centre = [0, 1].map(|axis| mean.iter().map(|p| p[axis]).sum::<f32>() / LANDMARKS as f32);
    let about = mean.map(|p| [p[0] - centre[0], p[1] - centre[1]]);
    let size = dot(&about, &about).sqrt().max(f32::MIN_POSITIVE);
    let one = 1.0 / (LANDMARKS as f32).sqrt();
    [
        about.map(|p| [p[0] / size, p[1] / size]),
        about.map(|p| [-p[1] / size, p[0] / size]),
        [[one, 0.0]; LANDMARKS],
        [[0.0, one]; LANDMARKS],
    ]
}

/// Bilinear value of the window; its edge is repeated.
fn value_at(window: &[f32], [x, y]: [f32; 2]) -> f32 {
    let most = (WINDOW - 1) as f32 - 1e-3;
    let (x, y) = (x.clamp(0.0, most), y.clamp(0.0, most));
    let (column, row) = (x as usize, y as usize);
    let (fx, fy) = (x - column as f32, y - row as f32);
    let at = row * WINDOW + column;
    let top = window[at] * (1.0 - fx) + window[at + 1] * fx;
    let bottom = window[at + WINDOW] * (1.0 - fx) + window[at + WINDOW + 1] * fx;
    top * (1.0 - fy) + bottom * fy
}

/// The face's pixels in the window, zero mean and unit variance; false if they are all alike.
pub(crate) fn sample(
    model: &PaperAam,
    window: &[f32],
    shape: &Shape2,
    values: &mut Vec<f32>,
) -> bool {
    values.clear();
    values.extend(
        model
            .pixels
            .iter()
            .map(|pixel| value_at(window, pixel.place(shape))),
    );
    let n = values.len().max(1) as f32;
    let mean = values.iter().sum::<f32>() / n;
    let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f32>() / n;
    let factor = 1.0 / variance.sqrt().max(1e-3);
    values.iter_mut().for_each(|v| *v = (*v - mean) * factor);
    variance > 1.0
}

impl Solver {
    /// A solver of the model.
    #[must_use]
    pub fn new(model: PaperAam) -> Self {
        let mut basis = similarity_modes(&model.mean).to_vec();
        basis.extend(&model.modes);
        let columns = basis.len() + model.appearance_modes.len();
        let pixels = model.pixels.len();
        let descent = DMatrix::zeros(pixels, columns);
        Self {
            basis,
            values: Vec::with_capacity(pixels),
            template: vec![0.0; pixels],
            descent,
            model,
        }
    }

    /// The mean face at the depth pose.
    #[must_use]
    pub fn cold(&self, start: &View) -> AamFit {
        self.at(
            *start,
            [0.0; MOST_HEAD_MODES],
            vec![0.0; self.model.appearance_modes.len()],
        )
    }

    /// The last frame's 3D shape and appearance at the depth pose.
    #[must_use]
    pub fn warm(&self, last: &AamFit, start: &View) -> AamFit {
        self.at(*start, last.head, last.appearance.clone())
    }

    fn at(&self, view: View, head: [f32; MOST_HEAD_MODES], appearance: Vec<f32>) -> AamFit {
        let mut fit = AamFit {
            shape: self.model.mean,
            view,
            head,
            appearance,
            residual: f32::INFINITY,
            confidence: 0.0,
            point_confidence: [0.0; LANDMARKS],
        };
        let seen = self.head(&fit).map(|p| view.project(&p));
        fit.shape = self.of_coefficients(&self.coefficients(&seen));
        fit
    }

    /// The 3D shape of a fit, head frame, metres.
    #[must_use]
    pub fn head(&self, fit: &AamFit) -> [Point; LANDMARKS] {
        core::array::from_fn(|i| {
            let mut p = self.model.head[i];
            for (k, (mode, deviation)) in self
                .model
                .head_modes
                .iter()
                .zip(&self.model.head_deviations)
                .enumerate()
            {
                p += mode[i] * (deviation * fit.head[k]);
            }
            p
        })
    }

    /// Equation 1 backwards, similarity first; shape modes are kept within their range.
    fn coefficients(&self, shape: &Shape2) -> Vec<f32> {
        let about: Shape2 = core::array::from_fn(|i| {
            [
                shape[i][0] - self.model.mean[i][0],
                shape[i][1] - self.model.mean[i][1],
            ]
        });
        let mut p: Vec<f32> = self.basis.iter().map(|mode| dot(mode, &about)).collect();
        for (p, deviation) in p[SIMILARITY..].iter_mut().zip(&self.model.deviations) {
            *p = p.clamp(-MOST_DEVIATIONS * deviation, MOST_DEVIATIONS * deviation);
        }
        p
    }

    /// Equation 1.
    fn of_coefficients(&self, p: &[f32]) -> Shape2 {
        let mut shape = self.model.mean;
        self.add(p, &mut shape);
        shape
    }

    fn add(&self, p: &[f32], shape: &mut Shape2) {
        for (mode, p) in self.basis.iter().zip(p) {
            for (s, m) in shape.iter_mut().zip(mode) {
                s[0] += p * m[0];
                s[1] += p * m[1];
            }
        }
    }

    /// At most `steps` steps from `fit`; `depth` is the view the depth pose says.
    #[must_use]
    pub fn run(&mut self, window: &[f32], mut fit: AamFit, depth: &View, steps: usize) -> AamFit {
        let mut best = fit.clone();
        for _ in 0..=steps {
            let alive = sample(&self.model, window, &fit.shape, &mut self.values);
            fit.residual = self.render(&fit.appearance);
            if !alive || !fit.residual.is_finite() {
                break;
            }
            if fit.residual < best.residual {
                best = fit.clone();
            }
            self.fit_head(&mut fit, depth);
            let moved = self.step(&mut fit);
            if moved < SETTLED_PX {
                break;
            }
        }
        if best.residual.is_finite() {
            self.fit_head(&mut best, depth);
            self.believe(window, &mut best);
        }
        best
    }

    /// Fills the template with equation 2 and returns the root mean square of values minus template.
    fn render(&mut self, appearance: &[f32]) -> f32 {
        self.template.copy_from_slice(&self.model.appearance);
        for (mode, weight) in self.model.appearance_modes.iter().zip(appearance) {
            for (t, m) in self.template.iter_mut().zip(mode) {
                *t += weight * m;
            }
        }
        let sum: f32 = self
            .values
            .iter()
            .zip(&self.template)
            .map(|(v, t)| (v - t).powi(2))
            .sum();
        (sum / self.values.len().max(1) as f32).sqrt()
    }

    /// Steepest-descent images of the template: derivative by each shape parameter, then the appearance modes.
    fn descend(&mut self) {
        let shapes = self.basis.len();
        for (i, pixel) in self.model.pixels.iter().enumerate() {
            let [left, right, up, down] = pixel.neighbours.map(usize::from);
            let slope = |low: usize, high: usize| {
                // At the face's edge the difference is one-sided.
                let span = if low == i || high == i {
                    STEP
                } else {
                    2.0 * STEP
                };
                (self.template[high] - self.template[low]) / span
            };
            let (gx, gy) = (slope(left, right), slope(up, down));
            for (j, mode) in self.basis.iter().enumerate() {
                let mut sum = 0.0;
                for (corner, weight) in pixel.corners.iter().zip(&pixel.weights) {
                    let m = mode[usize::from(*corner)];
                    sum += weight * (gx * m[0] + gy * m[1]);
                }
                self.descent[(i, j)] = sum;
            }
        }
        for (k, mode) in self.model.appearance_modes.iter().enumerate() {
            self.descent.column_mut(shapes + k).copy_from_slice(mode);
        }
    }

    /// One simultaneous inverse compositional step with the priors and the reprojection term; returns the largest motion
    /// of a point.
    fn step(&mut self, fit: &mut AamFit) -> f32 {
        self.descend();
        let shapes = self.basis.len();
        let difference = DVector::from_iterator(
            self.values.len(),
            self.values.iter().zip(&self.template).map(|(v, t)| v - t),
        );
        let mut normal = self.descent.tr_mul(&self.descent);
        let mut right = self.descent.tr_mul(&difference);
        // Everything below is in units of the appearance noise, times the pixels that count as one.
        let unit =
            self.model.noise.max(0.25 * fit.residual * fit.residual) * PIXELS_PER_OBSERVATION;
        let p = self.coefficients(&fit.shape);
        let seen = self.head(fit).map(|point| fit.view.project(&point));
        let apart: Shape2 =
            core::array::from_fn(|i| [fit.shape[i][0] - seen[i][0], fit.shape[i][1] - seen[i][1]]);
        let pull = unit / (REPROJECTION_PX * REPROJECTION_PX);
        for j in 0..shapes {
            // The inverse step is subtracted: s(p - Δp) should meet the projected 3D shape.
            normal[(j, j)] += pull;
            right[j] += pull * dot(&self.basis[j], &apart);
            if j >= SIMILARITY {
                let prior = unit / self.model.deviations[j - SIMILARITY].powi(2);
                normal[(j, j)] += prior;
                right[j] += prior * p[j];
            }
        }
        for (k, deviation) in self.model.appearance_deviations.iter().enumerate() {
            let prior = unit / (deviation * deviation);
            normal[(shapes + k, shapes + k)] += prior;
            right[shapes + k] -= prior * fit.appearance[k];
        }
        let Some(factor) = Cholesky::new(normal) else {
            return 0.0;
        };
        let solution = factor.solve(&right);
        for (k, weight) in fit.appearance.iter_mut().enumerate() {
            *weight += solution[shapes + k];
        }
        let mut change = [[0.0; 2]; LANDMARKS];
        let inverse: Vec<f32> = solution.rows(0, shapes).iter().map(|v| -v).collect();
        self.add(&inverse, &mut change);
        let composed = compose(&self.model.mean, &fit.shape, &change, &self.model.triangles);
        let next = self.of_coefficients(&self.coefficients(&composed));
        let moved = next
            .iter()
            .zip(&fit.shape)
            .map(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1]))
            .fold(0.0, f32::max);
        if moved.is_finite() && moved < WINDOW as f32 {
            fit.shape = next;
            moved
        } else {
            0.0
        }
    }

    /// One Gauss-Newton step of view and 3D coefficients towards the 2D shape, held near the depth pose.
    fn fit_head(&self, fit: &mut AamFit, depth: &View) {
        let modes = self.model.head_modes.len();
        let size = VIEW_PARAMETERS + modes;
        let head = self.head(fit);
        let mut normal = DMatrix::<f64>::zeros(size, size);
        let mut right = DVector::<f64>::zeros(size);
        let weight = 1.0 / f64::from(REPROJECTION_PX).powi(2);
        const EPS: f32 = 1e-2;
        let views: [View; VIEW_PARAMETERS] = core::array::from_fn(|k| {
            let mut step = [0.0; VIEW_PARAMETERS];
            step[k] = EPS;
            fit.view.moved(&step)
        });
        for i in 0..LANDMARKS {
            let now = fit.view.project(&head[i]);
            let mut slopes = vec![[0.0_f64; 2]; size];
            for (k, view) in views.iter().enumerate() {
                let then = view.project(&head[i]);
                slopes[k] = [0, 1].map(|a| f64::from((then[a] - now[a]) / EPS));
            }
            for k in 0..modes {
                let then = fit.view.project(
                    &(head[i] + self.model.head_modes[k][i] * self.model.head_deviations[k]),
                );
                slopes[VIEW_PARAMETERS + k] = [0, 1].map(|a| f64::from(then[a] - now[a]));
            }
            for a in 0..2 {
                let wrong = f64::from(fit.shape[i][a] - now[a]);
                for k in 0..size {
                    right[k] += weight * slopes[k][a] * wrong;
                    for l in 0..=k {
                        normal[(k, l)] += weight * slopes[k][a] * slopes[l][a];
                    }
                }
            }
        }
        let off = fit.view.step_from(depth);
        for k in 0..VIEW_PARAMETERS {
            let prior = 1.0 / POSE_SPREAD[k].powi(2);
            normal[(k, k)] += prior;
            right[k] -= prior * f64::from(off[k]);
        }
        for k in 0..modes {
            normal[(VIEW_PARAMETERS + k, VIEW_PARAMETERS + k)] += 1.0;
            right[VIEW_PARAMETERS + k] -= f64::from(fit.head[k]);
        }
        let Some(factor) = Cholesky::new(normal) else {
            return;
        };
        let step: Vec<f32> = factor.solve(&right).iter().map(|v| *v as f32).collect();
        if step.iter().all(|v| v.is_finite()) {
            fit.view = fit.view.moved(&step[..VIEW_PARAMETERS]);
            for k in 0..modes {
                fit.head[k] = (fit.head[k] + step[VIEW_PARAMETERS + k])
                    .clamp(-MOST_DEVIATIONS, MOST_DEVIATIONS);
            }
        }
    }

    /// Confidence of the face from its residual, of each point from the residual around it.
    fn believe(&mut self, window: &[f32], fit: &mut AamFit) {
        sample(&self.model, window, &fit.shape, &mut self.values);
        fit.residual = self.render(&fit.appearance);
        let [middle, width] = self.model.belief;
        let logistic = |residual: f32| 1.0 / (1.0 + ((residual - middle) / width).exp());
        fit.confidence = if self.folded(&fit.shape) {
            0.0
        } else {
            logistic(fit.residual)
        };
        let (mut sum, mut count) = ([0.0_f32; LANDMARKS], [1e-6_f32; LANDMARKS]);
        for (pixel, (v, t)) in self
            .model
            .pixels
            .iter()
            .zip(self.values.iter().zip(&self.template))
        {
            for (corner, weight) in pixel.corners.iter().zip(&pixel.weights) {
                sum[usize::from(*corner)] += weight * (v - t).powi(2);
                count[usize::from(*corner)] += weight;
            }
        }
        fit.point_confidence = core::array::from_fn(|i| {
            // Around one point the residual varies more than over the face.
            let local = (sum[i] / count[i]).sqrt();
            fit.confidence
                .min(1.0 / (1.0 + ((local - 1.5 * middle) / (2.0 * width)).exp()))
        });
    }

    /// Whether more than a few triangles have turned over.
    fn folded(&self, shape: &Shape2) -> bool {
        let area = |s: &Shape2, t: &[u8; 3]| {
            let [a, b, c] = t.map(|v| s[usize::from(v)]);
            (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        };
        let over = self
            .model
            .triangles
            .iter()
            .filter(|t| area(shape, t) * area(&self.model.mean, t) < 0.0)
            .count();
        4 * over > self.model.triangles.len()
    }
}

/// View parameters are in these units; kept here so that [`POSE_SPREAD`] stays true if they change.
const _: () = assert!(UNITS[0] == 0.05 && UNITS[1] == 0.1 && UNITS[4] == 5.0);

#[cfg(test)]
mod tests;
