//! The fit: a short cascade of linear updates of view and shape, and its confidence.
//!
//! Each stage computes features `f` of the patches around the current landmarks and updates the view (6 parameters) and the
//! shape coefficients by `Δ = bias + W (f − mean) + P k`. `W` and `P` are trained on the results of the previous stage
//! (supervised descent, Xiong and De la Torre 2013, here over the parameters of a combined 2D+3D shape model). `k` contains
//! the displacement of the view from the start and the current shape coefficients: as the start is the depth pose, `P` is the
//! learned weight of depth pose and shape prior against the image, the second term of the paper's cost (section 1.2).
//! Window pixels, radians, standard deviations. A stage costs one pass over a matrix of up to 0.11 MB, two bits a weight; early
//! stages do not change the higher shape modes. Degenerate: without stages the start is returned. Coefficients are clamped to ±[`MOST_DEVIATIONS`].

use super::features::OrientationMaps;
use super::view::View;
use crate::base::capacity::LANDMARKS;
use crate::base::defaults;
use crate::base::geometry::Point;
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;
use crate::base::vectors::{NO_FRACTION, arrange_for_dots, two_bit_dots, with_avx2};
use crate::face_model::{
    CascadeStage, ConfidenceModel, FACE_INPUTS, FEATURES, LANDMARK_INPUTS, MAX_MODES,
    MAX_PARAMETERS, MEAN_STEPS, PATCH, PATCH_BYTES, ShapeModel, VIEW_PARAMETERS,
};

/// Limit of a shape coefficient, standard deviations.
pub const MOST_DEVIATIONS: f32 = 4.0;

/// Quantisation steps per unit of a feature.
const STEPS: f32 = 16_384.0;

/// View and shape of one face.
#[derive(Clone, Copy, Debug)]
pub struct FaceFit {
    /// View in the window, window pixels.
    pub view: View,
    /// Shape coefficients, standard deviations; 0 beyond the model's modes.
    pub shape: [f32; MAX_MODES],
}

/// Confidence in a fit.
#[derive(Clone, Copy, Debug)]
pub struct FitConfidence {
    /// Confidence of each landmark, 0…1.
    pub landmark: [f32; LANDMARKS],
    /// Confidence of the face, 0…1.
    pub face: f32,
    /// Log odds of `face`, which distinguish fits whose confidence is 1.
    pub log_odds: f32,
    /// Linear discriminant of each landmark's patch, without its neighbours: positive on a face.
    pub discriminants: [f32; LANDMARKS],
}

defaults! {
    /// Scratch of the cascade, allocated once.
    pub struct Solver {
        features: Vec<f32> = vec![0.0; FEATURES],
        /// Features minus their mean, quantised to 1 / [`STEPS`].
        quantised: Vec<[i16; PATCH]> = vec![[0; PATCH]; LANDMARKS],
        head: [Point; LANDMARKS] = [Point::origin(); LANDMARKS],
        /// Landmarks whose patches do not count, because something hides them.
        pub hidden: [bool; LANDMARKS] = [false; LANDMARKS],
        /// Landmarks of the last projection, window pixels.
        pub window: [[f32; 2]; LANDMARKS] = [[0.0; 2]; LANDMARKS],
    }
}

/// Writes a stage's inputs besides the image: displacement from the start, then shape coefficients.
pub fn prior_columns(fit: &FaceFit, start: &View, out: &mut [f32; MAX_PARAMETERS]) {
    out[..VIEW_PARAMETERS].copy_from_slice(&fit.view.step_from(start));
    out[VIEW_PARAMETERS..].copy_from_slice(&fit.shape);
}

/// The fit after an update of its first `step.len()` parameters: view, then shape.
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
    /// Projects the fit's landmarks into [`Self::window`].
    pub fn project(&mut self, shape: &ShapeModel, fit: &FaceFit) {
        shape.shape(&fit.shape, &mut self.head);
        let project = fit.view.projection();
        for (pixel, point) in self.window.iter_mut().zip(&self.head) {
            *pixel = project(point);
        }
    }

    /// Features around the fit's landmarks, [`FEATURES`] values; updates [`Self::window`].
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

    /// Runs the stages from `start`; `anchor` is the view of the depth pose.
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
            prior_columns(&fit, anchor, &mut columns);
            with_avx2(
                #[inline(always)]
                || self.update(stage, &columns, &mut step),
            );
            fit = updated(&fit, &step[..stage.bias.len()]);
        }
        self.project(shape, &fit);
        fit
    }

    /// A stage's update from the features and its other inputs `columns`.
    #[inline(always)]
    fn update(&mut self, stage: &CascadeStage, columns: &[f32], step: &mut [f32; MAX_PARAMETERS]) {
        for ((quantised, f), mean) in self
            .quantised
            .as_flattened_mut()
            .iter_mut()
            .zip(&self.features)
            .zip(&*stage.mean)
        {
            *quantised = rounded(f * STEPS - f32::from(*mean) * (STEPS / MEAN_STEPS));
        }
        // A hidden patch is an average one.
        for (patch, _) in self
            .quantised
            .iter_mut()
            .zip(self.hidden)
            .filter(|(_, hidden)| *hidden)
        {
            patch.fill(0);
        }
        let mut sums = [0; LANDMARKS];
        for (sum, patch) in sums.iter_mut().zip(&self.quantised) {
            *sum = patch.iter().map(|f| i32::from(*f)).sum();
        }
        arrange_for_dots(&mut self.quantised);
        let patches = stage.levels.as_chunks::<PATCH_BYTES>().0;
        let rows = patches
            .chunks_exact(LANDMARKS)
            .zip(stage.scales.chunks_exact(LANDMARKS))
            .zip(stage.prior.chunks_exact(stage.bias.len()));
        for ((step, bias), ((levels, scales), prior)) in step.iter_mut().zip(&stage.bias).zip(rows)
        {
            let mut dots = [0; LANDMARKS];
            two_bit_dots(levels, &self.quantised, &mut dots);
            // The products are computed before they are added, so that this loop vectorises. A weight is 2 × level - 3.
            let mut products = [0.0; LANDMARKS];
            let terms = dots.iter().zip(&sums).zip(scales);
            for (product, ((dot, f_sum), scale)) in products.iter_mut().zip(terms) {
                *product = f32::from(*scale) * (2 * dot - 3 * f_sum) as f32;
            }
            let sum: f32 = products.iter().sum();
            let known: f32 = prior
                .iter()
                .zip(columns)
                .map(|(p, c)| f32::from(*p) * c)
                .sum();
            *step = bias + sum / STEPS + known;
        }
    }

    /// Confidence of a fit, from the image around its landmarks.
    pub fn confidence(
        &mut self,
        model: &ConfidenceModel,
        shape: &ShapeModel,
        maps: &OrientationMaps,
        fit: &FaceFit,
    ) -> FitConfidence {
        self.features(shape, maps, fit, model.cell_px);
        let own = discriminants(model, &self.features);
        let mut landmark = [0.0; LANDMARKS];
        let inputs = landmark_inputs(&own);
        for ((confidence, inputs), slopes) in landmark
            .iter_mut()
            .zip(&inputs)
            .zip(model.landmark.chunks_exact(LANDMARK_INPUTS))
        {
            *confidence = logistic(inputs.iter().zip(slopes).map(|(x, c)| x * c).sum());
        }
        let inputs = face_inputs(&own, fit);
        let log_odds = inputs.iter().zip(&model.face).map(|(x, c)| x * c).sum();
        FitConfidence {
            landmark,
            face: logistic(log_odds),
            log_odds,
            discriminants: own,
        }
    }
}

/// The linear discriminant of each landmark's patch.
pub fn discriminants(model: &ConfidenceModel, features: &[f32]) -> [f32; LANDMARKS] {
    let mut found = [0.0; LANDMARKS];
    let patches = features.as_chunks::<PATCH>().0.iter();
    let means = model.mean.as_chunks::<PATCH>().0;
    let weights = model.weights.as_chunks::<PATCH>().0;
    let patches = patches.zip(means).zip(weights).zip(&model.scales);
    with_avx2(
        #[inline(always)]
        || {
            for (found, (((features, means), weights), scale)) in found.iter_mut().zip(patches) {
                // The products are computed before they are added, so that this loop vectorises.
                let mut products = [0.0; PATCH];
                let terms = features.iter().zip(means).zip(weights);
                for (product, ((f, mean), w)) in products.iter_mut().zip(terms) {
                    *product = (f - f32::from(*mean) / MEAN_STEPS) * f32::from(*w);
                }
                *found = scale * products.iter().sum::<f32>();
            }
        },
    );
    found
}

/// Inputs of each landmark's confidence: its discriminant, the mean of its neighbours' in the numbering (on the same contour, so
/// covered together), the mean of all, and 1.
pub fn landmark_inputs(own: &[f32; LANDMARKS]) -> [[f32; LANDMARK_INPUTS]; LANDMARKS] {
    let mean = own.iter().sum::<f32>() / LANDMARKS as f32;
    core::array::from_fn(|i| {
        let beside = own[i.saturating_sub(1)] + own[(i + 1).min(LANDMARKS - 1)];
        [own[i], 0.5 * beside, mean, 1.0]
    })
}

/// Inputs of the face's confidence: the mean discriminant, the mean of the lower quarter (a covered or missed part), the mean
/// square shape coefficient, and 1; then, for faces partly covered by hair, a beard or a cap, the means of the better half, of
/// nose, eyes and mouth, and of the nose with the better of eyes and mouth.
pub fn face_inputs(own: &[f32; LANDMARKS], fit: &FaceFit) -> [f32; FACE_INPUTS] {
    let mut sorted = *own;
    crate::base::sorting::sort(&mut sorted);
    let lower = LANDMARKS / 4;
    let sum = |values: &[f32]| values.iter().sum::<f32>();
    let mean = |values: &[f32]| sum(values) / values.len() as f32;
    let unlikely = fit.shape.iter().map(|b| b * b).sum::<f32>() / MAX_MODES as f32;
    let (nose, eyes, mouth) = (sum(&own[27..36]), sum(&own[36..48]), sum(&own[48..]));
    let better = ((nose + eyes) / 21.0).max((nose + mouth) / 29.0);
    [
        mean(&sorted),
        mean(&sorted[..lower]),
        unlikely,
        1.0,
        mean(&sorted[LANDMARKS / 2..]),
        (nose + eyes + mouth) / 41.0,
        better,
    ]
}

/// Logistic function 1 / (1 + e^-x).
pub fn logistic(x: f32) -> f32 {
    1.0 / (1.0 + (-x).exp())
}

/// Nearest integer of a number of magnitude up to 2¹⁴.
#[inline(always)]
fn rounded(x: f32) -> i16 {
    (x + NO_FRACTION).to_bits() as i16
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::face_model::{LEVELS_PER_BYTE, Short, weight_at};

    #[test]
    fn rounds_to_the_nearest_integer() {
        for (x, whole) in [
            (0.0, 0),
            (0.4, 0),
            (-0.6, -1),
            (-1.4, -1),
            (16_383.6, 16_384),
            (-16_384.0, -16_384),
        ] {
            assert_eq!(rounded(x), whole, "{x}");
        }
    }

    #[test]
    fn a_landmark_is_judged_with_its_neighbours_on_both_sides() {
        let own: [f32; LANDMARKS] = core::array::from_fn(|i| (i * i) as f32);
        let inputs = landmark_inputs(&own);
        for i in 1..LANDMARKS - 1 {
            // The mean of (i - 1)² and (i + 1)².
            assert_eq!(inputs[i][..2], [own[i], own[i] + 1.0], "{i}");
        }
        let last = LANDMARKS - 1;
        assert_eq!(inputs[0][1], 0.5 * own[1]);
        assert_eq!(inputs[last][1], 0.5 * (own[last - 1] + own[last]));
        let mean = own.iter().sum::<f32>() / LANDMARKS as f32;
        assert!(inputs.iter().all(|one| one[2..] == [mean, 1.0]));
    }

    #[test]
    fn a_face_is_judged_as_a_whole_by_its_parts_and_by_their_better_half() {
        let own: [f32; LANDMARKS] = core::array::from_fn(|i| match i {
            27..36 => 3.0,
            36..48 => 1.0,
            48.. => -1.0,
            _ => -2.0,
        });
        let mut fit = FaceFit {
            view: View {
                log_scale: 6.5,
                rotation: Default::default(),
                shift: [0.0; 2],
                inverse_distance: 1.4,
            },
            shape: [0.0; MAX_MODES],
        };
        fit.shape[..2].copy_from_slice(&[2.0, -4.0]);
        let unlikely = 20.0 / MAX_MODES as f32;
        let mean = (27.0 + 12.0 - 20.0 - 54.0) / 68.0;
        let upper = (27.0 + 12.0 - 13.0) / 34.0;
        let (parts, better) = (19.0 / 41.0, 39.0 / 21.0);
        let expected = [mean, -2.0, unlikely, 1.0, upper, parts, better];
        for (found, expected) in face_inputs(&own, &fit).into_iter().zip(expected) {
            assert!((found - expected).abs() < 1e-5, "{found} {expected}");
        }
        assert!((logistic(2.0) - 0.880_797).abs() < 1e-6 && logistic(0.0) == 0.5);
    }

    #[test]
    fn each_landmark_is_judged_by_its_own_patch() {
        let mut model = ConfidenceModel {
            mean: vec![255; FEATURES],
            weights: vec![0; FEATURES],
            scales: vec![1.0; LANDMARKS],
            ..ConfidenceModel::default()
        };
        for k in 0..LANDMARKS {
            model.weights[k * PATCH + k] = k as i8;
        }
        let found = discriminants(&model, &vec![3.0; FEATURES]);
        assert_eq!(found, core::array::from_fn(|k| 2.0 * k as f32));
    }

    #[test]
    fn a_stages_step_is_its_bias_and_what_image_and_start_say() {
        let (rows, patch) = (2, 5);
        let mut stage = CascadeStage {
            cell_px: 5.0,
            mean: vec![51; FEATURES].into(),
            // Of every four weights, one is -3, -1, 1 and 3.
            levels: vec![0b11_10_01_00; rows * FEATURES / LEVELS_PER_BYTE].into(),
            scales: vec![0.0.into(); rows * LANDMARKS],
            prior: [0.0, 0.5, 0.0, 0.0].map(Short::from).into(),
            bias: vec![0.1, 0.2],
        };
        stage.scales[LANDMARKS + patch] = (1.0 / 128.0).into();
        let mut solver = Solver::default();
        solver.features.fill(0.2);
        solver.features[patch * PATCH + PATCH_BYTES * 3 + 7] = 0.95;
        let (mut columns, mut step) = ([0.0; MAX_PARAMETERS], [0.0; MAX_PARAMETERS]);
        columns[1] = 3.0;
        solver.update(&stage, &columns, &mut step);
        // 0.1 + 0.5 · 3, and 0.2 + 3 / 128 · (0.95 - 51 / 255).
        assert!((step[0] - 1.6).abs() < 1e-5 && (step[1] - 0.217_578).abs() < 1e-5);
    }

    #[test]
    fn a_dot_product_is_the_sum_of_the_products() {
        let mut random = fastrand::Rng::with_seed(1);
        let levels: [u8; PATCH_BYTES] = core::array::from_fn(|_| random.u8(..));
        let mut features = [[(); PATCH].map(|()| random.i16(-16_384..=16_384))];
        let twice = |k: usize| i64::from(weight_at(&levels, k) + 3) * i64::from(features[0][k]);
        let sum: i64 = (0..PATCH).map(twice).sum();
        let mut dots = [0];
        arrange_for_dots(&mut features);
        two_bit_dots(&[levels], &features, &mut dots);
        assert_eq!(2 * i64::from(dots[0]), sum);
    }
}
