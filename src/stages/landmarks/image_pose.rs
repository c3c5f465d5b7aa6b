//! Pose of a face from the image alone: halfway between the view of the landmark fit and the view in which the person's mean shape
//! projects onto the fitted points.
//!
//! The view of the fit changes with the expression, because an opening jaw and a nodding head move the points in similar ways. The
//! shape averaged over time has little expression; its points on bone get the largest weights. On four people of the second world
//! (docs/results.md) the rotation error is 1.05° with the fit alone, 0.94° with the mean shape alone, and 0.92° halfway between.
//! Method: [`STEPS`] Gauss–Newton steps over the six parameters of the view. Unit: window pixels. Memory: the mean coefficients of a
//! person.

use core::ops::Range;

use nalgebra::{SMatrix, SVector};

use super::view::View;
use crate::base::capacity::LANDMARKS;
use crate::base::defaults;
use crate::base::geometry::Point;
use crate::face_model::{MAX_MODES, ShapeModel, VIEW_PARAMETERS};

/// Time over which the shape is averaged, seconds.
const AVERAGED_S: f32 = 60.0;
/// Gauss–Newton steps.
const STEPS: usize = 3;
/// Step of a parameter for its numerical derivative, in units of [`super::view::UNITS`].
const DIFFERENCE: f32 = 0.05;
/// Weight of the view of the mean shape, 0 to 1: its errors and those of the fit's view are partly independent, so a mean is better.
const SHARE: f32 = 0.5;
/// Weight of the points of each part of the face; the mouth is left out because it moves too much.
const WEIGHTS: [(Range<usize>, f32); 4] =
    [(0..17, 0.3), (17..27, 0.4), (27..36, 1.0), (36..48, 0.6)];

defaults! {
    /// Mean shape of one person.
    #[derive(Clone, Debug)]
    pub(super) struct MeanShape {
        coefficients: [f32; MAX_MODES] = [0.0; MAX_MODES],
        /// Time averaged so far, seconds; at most [`AVERAGED_S`].
        seconds: f32 = 0.0,
    }
}

impl MeanShape {
    /// Adds the coefficients of a frame that is `step_s` seconds after the last one.
    pub(super) fn add(&mut self, coefficients: &[f32; MAX_MODES], step_s: f32) {
        self.seconds = (self.seconds + step_s).min(AVERAGED_S);
        let share = (step_s / self.seconds.max(step_s)).clamp(0.0, 1.0);
        for (mean, b) in self.coefficients.iter_mut().zip(coefficients) {
            *mean += (b - *mean) * share;
        }
    }

    /// The view halfway between `start`, the view of a fit to the points `seen` (window pixels), and the one near it in which the mean
    /// shape projects onto these points; `start` if that one is not determined.
    pub(super) fn view(
        &self,
        shape: &ShapeModel,
        start: &View,
        seen: &[[f32; 2]; LANDMARKS],
    ) -> View {
        let mut points = [Point::origin(); LANDMARKS];
        shape.shape(&self.coefficients, &mut points);
        let mut view = *start;
        for _ in 0..STEPS {
            let mut step = [0.0; VIEW_PARAMETERS];
            let moved = core::array::from_fn::<View, VIEW_PARAMETERS, _>(|k| {
                step.fill(0.0);
                step[k] = DIFFERENCE;
                view.moved(&step)
            });
            let mut normal = SMatrix::<f32, VIEW_PARAMETERS, VIEW_PARAMETERS>::zeros();
            let mut right = SVector::<f32, VIEW_PARAMETERS>::zeros();
            for (points_of, weight) in WEIGHTS {
                for i in points_of {
                    let at = view.project(&points[i]);
                    let beside = moved.map(|view| view.project(&points[i]));
                    for axis in 0..2 {
                        let slope = SVector::<f32, VIEW_PARAMETERS>::from_fn(|k, _| {
                            (beside[k][axis] - at[axis]) / DIFFERENCE
                        });
                        normal += slope * slope.transpose() * weight;
                        right += slope * ((seen[i][axis] - at[axis]) * weight);
                    }
                }
            }
            let Some(factor) = normal.cholesky() else {
                return *start;
            };
            view = view.moved(factor.solve(&right).as_slice());
        }
        start.moved(&view.step_from(start).map(|step| step * SHARE))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::geometry::rotation_from_yaw_pitch_roll;
    use crate::face_model::FaceModel;

    #[test]
    fn the_view_is_half_way_between_the_fits_and_the_mean_shapes() {
        let shape = FaceModel::shipped().shape;
        let mut mean = MeanShape::default();
        let mut own = [0.0; MAX_MODES];
        (own[0], own[3]) = (1.0, -0.5);
        mean.add(&own, 0.1);
        let planted = View {
            log_scale: 6.5,
            rotation: rotation_from_yaw_pitch_roll(0.2, -0.1, 0.1),
            shift: [92.0, 64.0],
            inverse_distance: 1.3,
        };
        let mut points = [Point::origin(); LANDMARKS];
        shape.shape(&own, &mut points);
        let mut seen = points.map(|point| planted.project(&point));
        // The mouth has no weight.
        for pixel in &mut seen[48..] {
            pixel[1] += 9.0;
        }
        let step = [0.2, -0.4, 0.3, 0.2, 0.3, -0.2];
        let start = planted.moved(&step);
        let found = mean.view(&shape, &start, &seen);
        let left = found.step_from(&planted);
        for (left, step) in left.iter().zip(step) {
            assert!((left - SHARE * step).abs() < 0.02, "{left} of {step}");
        }
    }

    #[test]
    fn the_shape_is_a_running_mean() {
        let mut mean = MeanShape::default();
        for (frame, value) in [(0, 3.0), (1, 6.0), (2, 0.0)] {
            mean.add(&[value; MAX_MODES], 0.1);
            let expected = [3.0, 4.5, 3.0][frame];
            assert!((mean.coefficients[7] - expected).abs() < 1e-5);
        }
    }
}
