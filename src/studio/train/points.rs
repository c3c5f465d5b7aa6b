//! The shape model fitted to points placed by hand: view and coefficients of an annotated picture.
//!
//! Gauss-Newton on the reprojection error in units of 1 % of the eye distance, coefficients with a prior N(0, 1) of
//! weight [`PRIOR`], jaw points at a third. Pixels, metres. Degenerate: fewer than two distinct points leave the start.

use nalgebra::{DMatrix, DVector};

use crate::base::capacity::LANDMARKS;
use crate::base::geometry::{Point, Rotation};
use crate::face_model::{MAX_MODES, ShapeModel, VIEW_PARAMETERS, scheme};
use crate::landmarks::cascade::{FaceFit, updated};
use crate::landmarks::view::View;

/// Weight of one standard deviation of shape against 1 % of the eye distance at one point, squared.
const PRIOR: f64 = 0.3;
/// Weight of a jaw point.
const JAW_WEIGHT: f64 = 0.1;

fn project(shape: &ShapeModel, fit: &FaceFit) -> [[f32; 2]; LANDMARKS] {
    let mut head = [Point::origin(); LANDMARKS];
    shape.shape(&fit.shape, &mut head);
    head.map(|p| fit.view.project(&p))
}

/// View (in picture pixels) and shape that explain the points; `inverse_distance` of the camera in 1/m.
#[must_use]
pub fn fit_points(
    shape: &ShapeModel,
    points: &[[f32; 2]; LANDMARKS],
    inverse_distance: f32,
) -> FaceFit {
    let eye = scheme::outer_eye_distance(points).max(1.0);
    let [r, l] = scheme::OUTER_EYE_CORNERS;
    let model_eye = (shape.mean[r] - shape.mean[l]).norm();
    let roll = (points[l][1] - points[r][1]).atan2(points[l][0] - points[r][0]);
    let mut fit = FaceFit {
        view: View {
            log_scale: (eye / model_eye).ln(),
            rotation: Rotation::from_axis_angle(&crate::base::geometry::Vector::z_axis(), roll),
            shift: [
                (points[39][0] + points[42][0]) * 0.5,
                (points[39][1] + points[42][1]) * 0.5,
            ],
            inverse_distance,
        },
        shape: [0.0; MAX_MODES],
    };
    let parameters = VIEW_PARAMETERS + shape.modes.len();
    let unit = 100.0 / eye;
    for iteration in 0..14 {
        // The view alone first: shape must not explain a turned head.
        let active = if iteration < 4 {
            VIEW_PARAMETERS
        } else {
            parameters
        };
        let now = project(shape, &fit);
        let mut jacobian = DMatrix::<f64>::zeros(2 * LANDMARKS, active);
        let mut residual = DVector::<f64>::zeros(2 * LANDMARKS);
        let weight = |i: usize| {
            if scheme::JAW.contains(&i) {
                JAW_WEIGHT
            } else {
                1.0
            }
        };
        for i in 0..LANDMARKS {
            for axis in 0..2 {
                residual[2 * i + axis] =
                    f64::from((points[i][axis] - now[i][axis]) * unit) * weight(i).sqrt();
            }
        }
        let mut step = vec![0.0f32; parameters];
        for k in 0..active {
            step[k] = 0.01;
            let moved = project(shape, &updated(&fit, &step));
            step[k] = 0.0;
            for i in 0..LANDMARKS {
                for axis in 0..2 {
                    jacobian[(2 * i + axis, k)] =
                        f64::from((moved[i][axis] - now[i][axis]) * unit / 0.01) * weight(i).sqrt();
                }
            }
        }
        let mut normal = jacobian.transpose() * &jacobian;
        let mut right = jacobian.transpose() * residual;
        for k in VIEW_PARAMETERS..active {
            normal[(k, k)] += PRIOR;
            right[k] -= PRIOR * f64::from(fit.shape[k - VIEW_PARAMETERS]);
        }
        for k in 0..active {
            normal[(k, k)] += 1e-3;
        }
        let Some(factor) = normal.cholesky() else {
            break;
        };
        let solved = factor.solve(&right);
        for k in 0..active {
            step[k] = solved[k] as f32;
        }
        fit = updated(&fit, &step);
    }
    fit
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::geometry::rotation_from_yaw_pitch_roll;
    use crate::face_model::FaceModel;

    #[test]
    fn planted_view_and_shape_are_found() {
        let shape = FaceModel::shipped().shape;
        let mut planted = FaceFit {
            view: View {
                log_scale: 1500f32.ln(),
                rotation: rotation_from_yaw_pitch_roll(0.3, -0.1, 0.2),
                shift: [300.0, 320.0],
                inverse_distance: 0.7,
            },
            shape: [0.0; MAX_MODES],
        };
        planted.shape[1] = 1.0;
        planted.shape[4] = -0.8;
        let points = project(&shape, &planted);
        let found = project(&shape, &fit_points(&shape, &points, 0.7));
        let eye = scheme::outer_eye_distance(&points);
        for (a, b) in points.iter().zip(&found).skip(17) {
            assert!((a[0] - b[0]).hypot(a[1] - b[1]) < 0.006 * eye);
        }
    }
}
