//! The fit itself: a short cascade of linear updates of view and shape, and the judgement of its end.
//!
//! Stage: features `f` of the patches around the present landmarks, update `Δ = bias + W (f − mean) + P k` of the view
//! (6 parameters) and the shape coefficients; `W` and `P` learnt where the previous stage really ends (supervised
//! descent, Xiong and De la Torre 2013, here over the parameters of a combined 2D+3D shape model). `k` are the way already
//! gone from the start in the view parameters and the present shape coefficients: since the start is the depth pose, `P`
//! is the learnt weight of the depth pose and of the shape prior against the picture, the second term of the paper's cost
//! (section 1.2). Window pixels, radians, standard deviations. A stage costs one pass over an 8-bit matrix of 0.3 MB.
//! Degenerate: without stages the start is returned. Limits: coefficients are kept within ±[`MOST_DEVIATIONS`].

use super::features::OrientationMaps;
use super::view::View;
use crate::capacity::LANDMARKS;
use crate::face_model::{
    CascadeStage, ConfidenceModel, FEATURES, MAX_MODES, MAX_PARAMETERS, PATCH, ShapeModel,
    VIEW_PARAMETERS,
};
use crate::geometry::Point;

/// Farthest a shape coefficient may go, in standard deviations.
pub const MOST_DEVIATIONS: f32 = 4.0;

/// View and shape of one face.
#[derive(Clone, Copy, Debug)]
pub struct FaceFit {
    /// View in the window.
    pub view: View,
    /// Shape coefficients, standard deviations; those beyond the model's modes are 0.
    pub shape: [f32; MAX_MODES],
}

/// How much a fit is believed.
#[derive(Clone, Copy, Debug)]
pub struct Belief {
    /// 0…1 for each landmark.
    pub landmark: [f32; LANDMARKS],
    /// 0…1 for the face.
    pub face: f32,
    /// The face's log odds: tells two good fits apart where `face` is 1 for both.
    pub log_odds: f32,
}

/// Scratch of the cascade; allocated once.
pub struct Solver {
    features: Vec<f32>,
    head: [Point; LANDMARKS],
    /// Landmarks of the last projection, window pixels.
    pub window: [[f32; 2]; LANDMARKS],
}

impl Default for Solver {
    fn default() -> Self {
        Self {
            features: vec![0.0; FEATURES],
            head: [Point::origin(); LANDMARKS],
            window: [[0.0; 2]; LANDMARKS],
        }
    }
}

/// What a stage knows beside the picture: way from the start and shape coefficients.
pub fn prior_columns(fit: &FaceFit, start: &View, out: &mut [f32; MAX_PARAMETERS]) {
    out[..VIEW_PARAMETERS].copy_from_slice(&fit.view.step_from(start));
    out[VIEW_PARAMETERS..].copy_from_slice(&fit.shape);
}

/// The fit changed by an update of as many parameters as given.
#[must_use]
pub fn updated(fit: &FaceFit, step: &[f32]) -> FaceFit {
    let mut next = FaceFit {
        view: fit.view.moved(step),
        shape: fit.shape,
    };
    for (b, change) in next.shape.iter_mut().zip(&step[VIEW_PARAMETERS..]) {
        *b = (*b + change).clamp(-MOST_DEVIATIONS, MOST_DEVIATIONS);
    }
    next
}

impl Solver {
    /// Projects the fit into [`Self::window`].
    pub fn project(&mut self, shape: &ShapeModel, fit: &FaceFit) {
        shape.shape(&fit.shape, &mut self.head);
        for (pixel, point) in self.window.iter_mut().zip(&self.head) {
            *pixel = fit.view.project(point);
        }
    }

    /// Features around the fit's landmarks; [`Self::window`] is the projection.
    pub fn features(
        &mut self,
        shape: &ShapeModel,
        maps: &OrientationMaps,
        fit: &FaceFit,
        cell_px: f32,
    ) -> &[f32] {
        self.project(shape, fit);
        maps.patches(&self.window, cell_px, &mut self.features);
        &self.features
    }

    /// Runs the stages from `start`; `anchor` is the view that the depth pose says.
    pub fn run(
        &mut self,
        stages: &[CascadeStage],
        shape: &ShapeModel,
        maps: &OrientationMaps,
        start: &FaceFit,
        anchor: &View,
    ) -> FaceFit {
        let mut fit = *start;
        let mut columns = [0.0; MAX_PARAMETERS];
        let mut step = [0.0; MAX_PARAMETERS];
        for stage in stages {
            self.features(shape, maps, &fit, stage.cell_px);
            for (f, mean) in self.features.iter_mut().zip(&stage.mean) {
                *f -= mean;
            }
            prior_columns(&fit, anchor, &mut columns);
            let parameters = stage.bias.len();
            for row in 0..parameters {
                let weights = &stage.weights[row * FEATURES..(row + 1) * FEATURES];
                let scales = &stage.scales[row * LANDMARKS..(row + 1) * LANDMARKS];
                let mut sum = stage.bias[row];
                for ((w, f), scale) in weights
                    .chunks_exact(PATCH)
                    .zip(self.features.chunks_exact(PATCH))
                    .zip(scales)
                {
                    sum += scale * dot_i8(w, f);
                }
                let prior = &stage.prior[row * parameters..(row + 1) * parameters];
                sum += prior.iter().zip(&columns).map(|(p, c)| p * c).sum::<f32>();
                step[row] = sum;
            }
            fit = updated(&fit, &step[..parameters]);
        }
        self.project(shape, &fit);
        fit
    }

    /// How well the picture around the fit's landmarks looks like a fitted face.
    pub fn belief(
        &mut self,
        model: &ConfidenceModel,
        shape: &ShapeModel,
        maps: &OrientationMaps,
        fit: &FaceFit,
    ) -> Belief {
        let mut own = [0.0; LANDMARKS];
        self.discriminants(model, shape, maps, fit, &mut own);
        let mean = own.iter().sum::<f32>() / LANDMARKS as f32;
        let mut landmark = [0.0; LANDMARKS];
        for ((confidence, d), c) in landmark
            .iter_mut()
            .zip(own)
            .zip(model.landmark.chunks_exact(3))
        {
            *confidence = logistic(c[0] * d + c[1] * mean + c[2]);
        }
        let log_odds = model.face[0] * mean + model.face[1];
        Belief {
            landmark,
            face: logistic(log_odds),
            log_odds,
        }
    }

    /// The linear discriminant of each landmark's patch.
    pub fn discriminants(
        &mut self,
        model: &ConfidenceModel,
        shape: &ShapeModel,
        maps: &OrientationMaps,
        fit: &FaceFit,
        out: &mut [f32; LANDMARKS],
    ) {
        self.features(shape, maps, fit, model.cell_px);
        for (k, d) in out.iter_mut().enumerate() {
            let patch = k * PATCH..(k + 1) * PATCH;
            *d = self.features[patch.clone()]
                .iter()
                .zip(&model.mean[patch.clone()])
                .zip(&model.weights[patch])
                .map(|((f, mean), w)| (f - mean) * w)
                .sum();
        }
    }
}

/// 1 / (1 + e^-x).
#[must_use]
pub fn logistic(x: f32) -> f32 {
    1.0 / (1.0 + (-x).exp())
}

/// Dot product over one patch; eight sums, so that the compiler can use vector registers.
fn dot_i8(weights: &[i8], features: &[f32]) -> f32 {
    let mut sums = [0.0f32; 8];
    for (w, f) in weights.chunks_exact(8).zip(features.chunks_exact(8)) {
        for k in 0..8 {
            sums[k] += f32::from(w[k]) * f[k];
        }
    }
    sums.iter().sum()
}
