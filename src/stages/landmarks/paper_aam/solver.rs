//! The fit of the 3D active appearance model: minimises over view, shape parameters p and appearance parameters λ
//!
//! ```text
//!   Σ_x [A0(x) + Σ λ_i A_i(x) − I(W(x; p))]² / u              image against the model's appearance, equation (2)
//! + |view − view expected by depth|² / spread²                 prior from the head pose
//! + Σ (λ_i / d_i)² + Σ p_k²                                    priors of appearance and shape
//! ```
//!
//! with u the variance of a grey value times [`PIXELS_PER_OBSERVATION`] and spread that of [`Expected`]. The 2D shape of the
//! warp W is the projection of the 3D shape, P_view(S0 + Σ p_k d_k S_k): 2D and 3D share their parameters, as in the paper, no
//! unknowns are added, and the reprojection error, the paper's second term, is zero instead of small. (With separate 2D bases,
//! tied to the 3D ones, it cannot be made small: a test below has the figures.)
//!
//! As in expectation maximisation the two kinds of unknowns alternate: λ is Gaussian, so given the shape its expectation is
//! linear in the image (E), and with λ integrated out the shape takes one Gauss–Newton step (M). Brightness and contrast are
//! two more λ without a prior. Sums are over visible pixels: where the face turns away from the camera, the warp would sample
//! other surfaces. The person's mean residual (of the eyes while open) is added to A0. Window pixels, metres, standard
//! deviations. Some scratch is allocated per step.

use super::grey;
use super::model::{MOST_HEAD_MODES, PaperAam};
use super::warp::Shape2;
use crate::base::capacity::LANDMARKS;
use crate::base::geometry::{Point, Vector};
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;
use crate::base::vectors::with_avx2;
use crate::face_model::VIEW_PARAMETERS;
use crate::face_model::scheme::{LOWER_LID_L, LOWER_LID_R, UPPER_LID_L, UPPER_LID_R};
use crate::landmarks::view::{UNITS, View};
use crate::landmarks::window::WINDOW;
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

/// Errors of neighbouring pixels are correlated: this many count as one observation.
const PIXELS_PER_OBSERVATION: f32 = 18.0;
/// Spread of an unknown person's face about its depth pose, in [`UNITS`]: scale 7 %, 0.1 rad, 7 window pixels.
const POSE_SPREAD: [f32; VIEW_PARAMETERS] = [1.4, 1.0, 1.0, 1.0, 1.4, 1.4];
/// A step that moves all points less than this ends the fit, window pixels.
const CONVERGED_PX: f32 = 0.1;
/// Blur of a cold start's first iterations: half the side of the square, window pixels.
const COARSE_BLUR: usize = 3;
/// Limit of a shape parameter, standard deviations.
const MOST_DEVIATIONS: f32 = 3.5;
/// Least foreshortening of a visible triangle, as a share of its frontal area.
const MIN_SEEN_WIDTH: f32 = 0.3;
/// Number of light parameters: brightness and contrast.
const LIGHT: usize = 2;

/// Result of a fit, and start of the next frame's.
#[derive(Clone, Debug)]
pub struct AamFit {
    /// 2D shape, window pixels: the projection of the 3D shape.
    pub shape: Shape2,
    /// View of the 3D shape, window pixels.
    pub view: View,
    /// Shape parameters p, standard deviations.
    pub head: [f32; MOST_HEAD_MODES],
    /// Root mean square residual of the appearance, in standard deviations of grey.
    pub residual: f32,
    /// Confidence of the face, 0…1.
    pub confidence: f32,
    /// Confidence of each landmark, 0…1.
    pub point_confidence: [f32; LANDMARKS],
    /// Visible share of the face's pixels, 0…1.
    pub seen: f32,
}

/// Prior of the view, from depth.
#[derive(Clone, Copy, Debug)]
pub struct Expected {
    /// Expected view.
    pub view: View,
    /// Spread as a share of an unknown person's.
    pub spread: f32,
}

impl From<View> for Expected {
    fn from(view: View) -> Self {
        Self { view, spread: 1.0 }
    }
}

/// The model and its scratch.
pub struct Solver {
    model: PaperAam,
    /// Orthonormal rows: brightness, contrast, then appearance modes.
    appearance: DMatrix<f32>,
    /// Diagonal of their normal matrix with priors, if all pixels are visible.
    full_normal: DVector<f32>,
    /// Factorised normal matrix over the visible pixels.
    normal: Option<Cholesky<f32, Dyn>>,
    /// Normal of the mean face at each pixel, not normalised.
    outward: Vec<Vector>,
    /// 1 for each visible pixel, else 0.
    seen: DVector<f32>,
    /// The person's mean residual per pixel.
    pub usual_residual: DVector<f32>,
    /// Share of `usual_residual` in the last fit, per pixel, 0…1: of an eye's, how far it is open.
    usual_visible: DVector<f32>,
    /// Normalised grey values of the face's pixels.
    values: DVector<f32>,
    /// Residual of `values` after the appearance.
    residual: DVector<f32>,
    /// Derivatives of `values` by view and shape parameters, one column per pixel.
    slopes: DMatrix<f32>,
    /// Locally normalised grey values of the whole window.
    plane: Vec<f32>,
    /// Gradients of `plane` along x and y.
    gradient: Vec<[f32; 2]>,
    spare: [Vec<f32>; 2],
}

/// Index of the upper left pixel, and bilinear shares to the right and down, of a position in the window; clamped to its edge.
#[inline(always)]
fn bilinear_weights([x, y]: [f32; 2]) -> (usize, [f32; 2]) {
    let most = (WINDOW - 1) as f32 - 1e-3;
    let (x, y) = (x.clamp(0.0, most), y.clamp(0.0, most));
    let (column, row) = (x as usize, y as usize);
    (row * WINDOW + column, [x - column as f32, y - row as f32])
}

/// Bilinear value of the window.
#[inline(always)]
fn value_at(window: &[f32], (at, [fx, fy]): (usize, [f32; 2])) -> f32 {
    let top = window[at] * (1.0 - fx) + window[at + 1] * fx;
    let bottom = window[at + WINDOW] * (1.0 - fx) + window[at + WINDOW + 1] * fx;
    top * (1.0 - fy) + bottom * fy
}

/// Bilinear value of the gradients.
#[inline(always)]
fn slope_at(gradient: &[[f32; 2]], (at, [fx, fy]): (usize, [f32; 2])) -> [f32; 2] {
    let [a, b, c, d] = [at, at + 1, at + WINDOW, at + WINDOW + 1].map(|k| gradient[k]);
    [0, 1].map(|axis| {
        let top = a[axis] * (1.0 - fx) + b[axis] * fx;
        let bottom = c[axis] * (1.0 - fx) + d[axis] * fx;
        top * (1.0 - fy) + bottom * fy
    })
}

/// Samples `plane` at the face's pixels into `values`: zero mean, unit variance, times trust. Returns the factor applied to the
/// plane; `None` if the variance is 0.
pub fn sample(model: &PaperAam, plane: &[f32], shape: &Shape2, values: &mut [f32]) -> Option<f32> {
    for (value, pixel) in values.iter_mut().zip(&model.pixels) {
        *value = value_at(plane, bilinear_weights(pixel.position(shape)));
    }
    let n = values.len().max(1) as f32;
    let mean = values.iter().sum::<f32>() / n;
    let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f32>() / n;
    let factor = 1.0 / variance.sqrt().max(1e-3);
    for (value, trust) in values.iter_mut().zip(&model.trust) {
        *value = (*value - mean) * factor * trust;
    }
    (variance > 1e-4).then_some(factor)
}

/// Orthogonalises a row against `rows`, scales it to unit length and appends it.
fn orthonormal(rows: &mut Vec<Vec<f32>>, mut row: Vec<f32>) {
    for other in rows.iter() {
        let along: f32 = row.iter().zip(other).map(|(a, b)| a * b).sum();
        for (v, o) in row.iter_mut().zip(other) {
            *v -= along * o;
        }
    }
    let size = row.iter().map(|v| v * v).sum::<f32>().sqrt();
    row.iter_mut()
        .for_each(|v| *v /= size.max(f32::MIN_POSITIVE));
    rows.push(row);
}

impl Solver {
    /// A solver for a model; allocates its scratch.
    pub fn new(model: PaperAam) -> Self {
        let pixels = model.trust.len();
        let mut rows = Vec::with_capacity(LIGHT + model.appearance_modes.len());
        orthonormal(&mut rows, model.trust.clone());
        orthonormal(&mut rows, model.appearance.clone());
        for mode in &model.appearance_modes {
            orthonormal(&mut rows, mode.clone());
        }
        let unit = model.noise * PIXELS_PER_OBSERVATION;
        let priors = model.appearance_deviations.iter().map(|d| unit / (d * d));
        let priors = core::iter::repeat_n(0.0, LIGHT).chain(priors);
        let outward = model.pixels.iter().map(|pixel| {
            let [a, b, c] = pixel.corners.map(|i| model.head[usize::from(i)]);
            (b - a).cross(&(c - a))
        });
        Self {
            appearance: DMatrix::from_fn(rows.len(), pixels, |i, k| rows[i][k]),
            full_normal: DVector::from_iterator(rows.len(), priors.map(|prior| 1.0 + prior)),
            normal: None,
            outward: outward.collect(),
            seen: DVector::repeat(pixels, 1.0),
            usual_residual: DVector::zeros(pixels),
            usual_visible: DVector::zeros(pixels),
            values: DVector::zeros(pixels),
            residual: DVector::zeros(pixels),
            slopes: DMatrix::zeros(VIEW_PARAMETERS + model.head_modes.len(), pixels),
            plane: vec![0.0; WINDOW * WINDOW],
            gradient: vec![[0.0; 2]; WINDOW * WINDOW],
            spare: [(); 2].map(|()| vec![0.0; WINDOW * WINDOW]),
            model,
        }
    }

    /// Adds a share of the last fit's residual to the person's mean residual.
    pub fn learn(&mut self, share: f32) {
        for (k, left) in self.residual.iter().enumerate() {
            self.usual_residual[k] += self.usual_visible[k] * left * share;
        }
    }

    /// The mean face at the depth pose.
    pub fn cold(&self, start: &View) -> AamFit {
        self.fit_from(*start, [0.0; MOST_HEAD_MODES])
    }

    /// The last frame's shape at the depth pose `start`, with the last fit's displacement from its depth pose (`depth`).
    pub fn warm(&self, last: &AamFit, depth: &View, start: &View) -> AamFit {
        let mut fit = self.fit_from(start.moved(&last.view.step_from(depth)), last.head);
        fit.residual = last.residual;
        fit
    }

    fn fit_from(&self, view: View, head: [f32; MOST_HEAD_MODES]) -> AamFit {
        let mut fit = AamFit {
            shape: self.model.base,
            view,
            head,
            residual: f32::INFINITY,
            confidence: 0.0,
            point_confidence: [0.0; LANDMARKS],
            seen: 1.0,
        };
        fit.shape = self.projected(&fit);
        fit
    }

    /// Shape modes with their standard deviations, metres.
    fn modes(&self) -> impl Iterator<Item = (&Vec<Vector>, &f32)> {
        let deviations = &self.model.head_deviations;
        self.model.head_modes.iter().zip(deviations)
    }

    /// The 3D shape of a fit, head frame, metres.
    pub fn head(&self, fit: &AamFit) -> [Point; LANDMARKS] {
        core::array::from_fn(|i| {
            let mut p = self.model.head[i];
            for ((mode, deviation), along) in self.modes().zip(&fit.head) {
                p += mode[i] * (deviation * along);
            }
            p
        })
    }

    /// Equation (1): the 2D shape, window pixels.
    fn projected(&self, fit: &AamFit) -> Shape2 {
        let project = fit.view.projection();
        self.head(fit).map(|p| project(&p))
    }

    /// At most `steps` iterations from `fit` on a window of [`WINDOW`]² grey values; a cold start first runs on the blurred window.
    pub fn run(
        &mut self,
        window: &[f32],
        mut fit: AamFit,
        expected: impl Into<Expected>,
        steps: usize,
    ) -> AamFit {
        let expected = expected.into();
        let [other, spare] = &mut self.spare;
        grey::normalised(window, &mut self.plane, other, spare);
        if !fit.residual.is_finite() {
            let fine = self.plane.clone();
            grey::blur(&mut self.plane, spare, COARSE_BLUR);
            self.iterate(&mut fit, &expected, steps);
            self.plane = fine;
        }
        self.iterate(&mut fit, &expected, steps);
        if self.sample_residual(&mut fit).is_some() {
            self.set_confidence(&mut fit);
        } else {
            fit.residual = f32::INFINITY;
        }
        fit
    }

    /// Iterates until convergence.
    fn iterate(&mut self, fit: &mut AamFit, expected: &Expected, steps: usize) {
        self.compute_gradient();
        for _ in 0..steps {
            let Some(factor) = self.sample_residual(fit) else {
                return;
            };
            if self.step(factor, fit, expected) < CONVERGED_PX {
                return;
            }
        }
    }

    /// Gradients of `plane` by central differences.
    fn compute_gradient(&mut self) {
        let plane = &self.plane;
        for y in 1..WINDOW - 1 {
            let at = y * WINDOW;
            for x in at + 1..at + WINDOW - 1 {
                self.gradient[x] = [
                    0.5 * (plane[x + 1] - plane[x - 1]),
                    0.5 * (plane[x + WINDOW] - plane[x - WINDOW]),
                ];
            }
        }
    }

    /// Samples the face's pixels and subtracts the expected appearance (E); returns the factor of [`sample`].
    fn sample_residual(&mut self, fit: &mut AamFit) -> Option<f32> {
        let values = self.values.as_mut_slice();
        let factor = sample(&self.model, &self.plane, &fit.shape, values)?;
        self.subtract_usual(fit);
        let hidden = self.mask_unseen(&fit.view);
        let seen = (self.seen.len() - hidden).max(1) as f32;
        let along = &self.appearance * &self.values;
        let along = self.normal.as_ref()?.solve(&along);
        self.residual.copy_from(&self.values);
        self.residual.gemv_tr(-1.0, &self.appearance, &along, 1.0);
        self.residual.component_mul_assign(&self.seen);
        fit.residual = self.residual.norm() / seen.sqrt();
        fit.seen = seen / self.seen.len().max(1) as f32;
        fit.residual.is_finite().then_some(factor)
    }

    /// Subtracts the person's mean residual, at an eye in proportion to its opening.
    fn subtract_usual(&mut self, fit: &AamFit) {
        let head = self.head(fit);
        let lids = [(UPPER_LID_R, LOWER_LID_R), (UPPER_LID_L, LOWER_LID_L)];
        let open = lids.map(|([a, b], [c, d])| {
            let gap = |head: &[Point]| head[c].y + head[d].y - head[a].y - head[b].y;
            (2.5 * gap(&head) / gap(&self.model.head) - 1.5).clamp(0.0, 1.0)
        });
        for (k, pixel) in self.model.pixels.iter().enumerate() {
            let eye = pixel.corners.iter().find(|i| (36..48).contains(*i));
            self.usual_visible[k] = eye.map_or(1.0, |i| open[usize::from(*i >= 42)]);
            self.values[k] -= self.usual_visible[k] * self.usual_residual[k];
        }
    }

    /// Masks the pixels invisible from a view and factorises the normal matrix; returns their number.
    fn mask_unseen(&mut self, view: &View) -> usize {
        for (seen, outward) in self.seen.iter_mut().zip(&self.outward) {
            *seen = f32::from(u8::from(
                (view.rotation * outward).z / outward.z >= MIN_SEEN_WIDTH,
            ));
        }
        self.values.component_mul_assign(&self.seen);
        let hidden = (0..self.seen.len()).filter(|k| self.seen[*k] == 0.0);
        let hidden: Vec<usize> = hidden.collect();
        let modes = self.full_normal.len();
        let unseen = DMatrix::from_fn(modes, hidden.len(), |i, k| self.appearance[(i, hidden[k])]);
        let normal = DMatrix::from_diagonal(&self.full_normal) - &unseen * unseen.transpose();
        self.normal = Cholesky::new(normal);
        hidden.len()
    }

    /// Motion of each point per unit of each parameter, window pixels: rows by point, for x and for y.
    fn motions(&self, fit: &AamFit) -> [Vec<f32>; 2] {
        const EPS: f32 = 1e-2;
        let head = self.head(fit);
        let size = self.slopes.nrows();
        let mut motions = [(); 2].map(|()| vec![0.0; LANDMARKS * size]);
        for k in 0..VIEW_PARAMETERS {
            let mut step = [0.0; VIEW_PARAMETERS];
            step[k] = EPS;
            let view = fit.view.moved(&step);
            let project = view.projection();
            for i in 0..LANDMARKS {
                let then = project(&head[i]);
                for axis in 0..2 {
                    motions[axis][i * size + k] = (then[axis] - fit.shape[i][axis]) / EPS;
                }
            }
        }
        let project = fit.view.projection();
        for (k, (mode, deviation)) in self.modes().enumerate() {
            for i in 0..LANDMARKS {
                let then = project(&(head[i] + mode[i] * *deviation));
                for axis in 0..2 {
                    motions[axis][i * size + VIEW_PARAMETERS + k] = then[axis] - fit.shape[i][axis];
                }
            }
        }
        motions
    }

    /// Derivatives of the face's pixels by the parameters, into `slopes`.
    fn compute_derivatives(&mut self, factor: f32, fit: &AamFit) {
        let motions = self.motions(fit);
        let size = self.slopes.nrows();
        let (model, gradient) = (&self.model, &self.gradient);
        let columns = self.slopes.as_mut_slice().chunks_exact_mut(size);
        let columns = columns.zip(self.seen.iter());
        with_avx2(|| {
            for (((column, seen), pixel), trust) in columns.zip(&model.pixels).zip(&model.trust) {
                column.fill(0.0);
                if *seen == 0.0 {
                    continue;
                }
                let slope = slope_at(gradient, bilinear_weights(pixel.position(&fit.shape)));
                for (corner, weight) in pixel.corners.iter().zip(&pixel.weights) {
                    let at = usize::from(*corner) * size;
                    for axis in 0..2 {
                        let share = weight * slope[axis] * factor * trust;
                        let motion = &motions[axis][at..at + size];
                        for (c, m) in column.iter_mut().zip(motion) {
                            *c += share * m;
                        }
                    }
                }
            }
        });
    }

    /// One Gauss–Newton step of view and shape with the appearance integrated out (M); returns the largest motion of a point, window
    /// pixels.
    fn step(&mut self, factor: f32, fit: &mut AamFit, expected: &Expected) -> f32 {
        self.compute_derivatives(factor, fit);
        let by_pixel = self.slopes.transpose();
        let mut normal = &self.slopes * &by_pixel;
        if let Some(appearance_normal) = &self.normal {
            let along = &self.appearance * &by_pixel;
            normal -= along.transpose() * appearance_normal.solve(&along);
        }
        let mut right = -(&self.slopes * &self.residual);
        // A large residual reduces the weight of the image.
        let noise = self.model.noise.max(0.25 * fit.residual * fit.residual);
        let unit = noise * PIXELS_PER_OBSERVATION;
        normal /= unit;
        right /= unit;
        self.move_by(normal, right, fit, expected).unwrap_or(0.0)
    }

    /// Solves for a step, with the priors of pose and shape; returns the largest motion of a point, window pixels.
    fn move_by(
        &self,
        mut normal: DMatrix<f32>,
        mut right: DVector<f32>,
        fit: &mut AamFit,
        expected: &Expected,
    ) -> Option<f32> {
        let off = fit.view.step_from(&expected.view);
        for k in 0..right.len() {
            let (prior, off) = if k < VIEW_PARAMETERS {
                ((POSE_SPREAD[k] * expected.spread).powi(-2), off[k])
            } else {
                (1.0, fit.head[k - VIEW_PARAMETERS])
            };
            normal[(k, k)] += prior;
            right[k] -= prior * off;
        }
        let step = Cholesky::new(normal)?.solve(&right);
        if !step.iter().all(|v| v.is_finite()) {
            return None;
        }
        fit.view = fit.view.moved(&step.as_slice()[..VIEW_PARAMETERS]);
        for (p, step) in fit.head.iter_mut().zip(step.iter().skip(VIEW_PARAMETERS)) {
            *p = (*p + step).clamp(-MOST_DEVIATIONS, MOST_DEVIATIONS);
        }
        let next = self.projected(fit);
        let moved = next
            .iter()
            .zip(&fit.shape)
            .map(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1]))
            .fold(0.0, f32::max);
        fit.shape = next;
        Some(moved)
    }

    /// Confidence of the face from its residual, and of each point from the residual around it.
    fn set_confidence(&self, fit: &mut AamFit) {
        let [middle, width] = self.model.confidence_curve;
        fit.confidence = 1.0 / (1.0 + ((fit.residual - middle) / width).exp());
        let mut sum = [0.0_f32; LANDMARKS];
        let (mut count, mut all) = ([1e-6_f32; LANDMARKS], [1e-6_f32; LANDMARKS]);
        let pixels = self.model.pixels.iter().zip(self.residual.iter());
        for ((pixel, left), seen) in pixels.zip(self.seen.iter()) {
            for (corner, weight) in pixel.corners.iter().zip(&pixel.weights) {
                let i = usize::from(*corner);
                sum[i] += weight * left * left;
                count[i] += weight * seen;
                all[i] += weight;
            }
        }
        fit.point_confidence = core::array::from_fn(|i| {
            // Around one point the residual varies more than over the face.
            let local = (sum[i] / count[i]).sqrt();
            let near = 1.0 / (1.0 + ((local - 2.0 * middle) / (2.0 * width)).exp());
            fit.confidence.min(near) * count[i] / all[i]
        });
    }
}

// POSE_SPREAD assumes these units.
const _: () = assert!(UNITS[0] == 0.05 && UNITS[1] == 0.1 && UNITS[4] == 5.0);

mod annotated;
#[cfg(test)]
mod tests;
