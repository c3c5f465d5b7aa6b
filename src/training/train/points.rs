//! Fit of the shape model to annotated points: view and coefficients.
//!
//! Gauss-Newton on the reprojection error in units of 1 % of the eye distance, coefficients with a prior N(0, 1) of
//! weight [`PRIOR`], jaw points at a third. Pixels, metres. Degenerate: fewer than two distinct points leave the start.

use nalgebra::{DMatrix, DVector};

use mien_simulator::virtual_head::Points;
use mien_stages::base::capacity::LANDMARKS;
use mien_stages::base::geometry::{Point, Rotation, Vector};
use mien_stages::face_model::{MAX_MODES, ShapeModel, VIEW_PARAMETERS, scheme};
use mien_stages::landmarks::cascade::{FaceFit, updated};
use mien_stages::landmarks::view::View;

/// Weight of one standard deviation of shape against 1 % of the eye distance at one point, squared.
const PRIOR: f64 = 0.3;
/// Weight of a jaw point.
const JAW_WEIGHT: f64 = 0.1;

fn project(shape: &ShapeModel, fit: &FaceFit) -> Points {
    let mut head = [Point::origin(); LANDMARKS];
    shape.shape(&fit.shape, &mut head);
    head.map(|p| fit.view.project(&p))
}

/// View (in picture pixels) and shape that explain the points; `inverse_distance` of the camera in 1/m.
pub fn fit_points(shape: &ShapeModel, points: &Points, inverse_distance: f32) -> FaceFit {
    let eye = scheme::outer_eye_distance(points).max(1.0);
    let mut fit = upright(shape, points, eye, inverse_distance);
    for iteration in 0..14 {
        // The view alone first: shape must not explain a turned head.
        let modes = if iteration < 4 { 0 } else { shape.modes.len() };
        let Some(nearer) = stepped(shape, points, 100.0 / eye, &fit, VIEW_PARAMETERS + modes)
        else {
            break;
        };
        fit = nearer;
    }
    fit
}

/// The mean face, seen from the front, with the eyes in place.
fn upright(shape: &ShapeModel, points: &Points, eye: f32, inverse_distance: f32) -> FaceFit {
    let [r, l] = scheme::OUTER_EYE_CORNERS;
    let model_eye = (shape.mean[r] - shape.mean[l]).norm();
    let roll = (points[l][1] - points[r][1]).atan2(points[l][0] - points[r][0]);
    FaceFit {
        view: View {
            log_scale: (eye / model_eye).ln(),
            rotation: Rotation::from_axis_angle(&Vector::z_axis(), roll),
            shift: [0, 1].map(|k| (points[39][k] + points[42][k]) * 0.5),
            inverse_distance,
        },
        shape: [0.0; MAX_MODES],
    }
}

/// One step of Gauss-Newton in the first `active` parameters; errors count in pixels times `unit`.
fn stepped(
    shape: &ShapeModel,
    points: &Points,
    unit: f32,
    fit: &FaceFit,
    active: usize,
) -> Option<FaceFit> {
    let now = project(shape, fit);
    let weight = |i: usize| {
        let jaw = scheme::JAW.contains(&i);
        (if jaw { JAW_WEIGHT } else { 1.0 }).sqrt()
    };
    let residual = DVector::from_fn(2 * LANDMARKS, |row, _| {
        let (i, axis) = (row / 2, row % 2);
        f64::from((points[i][axis] - now[i][axis]) * unit) * weight(i)
    });
    let mut jacobian = DMatrix::<f64>::zeros(2 * LANDMARKS, active);
    let mut step = vec![0.0f32; VIEW_PARAMETERS + shape.modes.len()];
    for k in 0..active {
        step[k] = 0.01;
        let moved = project(shape, &updated(fit, &step));
        step[k] = 0.0;
        for (row, slot) in jacobian.column_mut(k).iter_mut().enumerate() {
            let (i, axis) = (row / 2, row % 2);
            *slot = f64::from((moved[i][axis] - now[i][axis]) * unit / 0.01) * weight(i);
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
    let solved = normal.cholesky()?.solve(&right);
    for (step, solved) in step.iter_mut().zip(solved.iter()) {
        *step = *solved as f32;
    }
    Some(updated(fit, &step))
}

#[cfg(test)]
mod tests {
    use super::*;
    use mien_stages::base::geometry::rotation_from_yaw_pitch_roll;
    use mien_stages::face_model::FaceModel;

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
