//! Places brows and jaw of a neutral head from its eyes, nose and lips.
//!
//! Plaster has no brows and a jaw no edge, whereas the face model learned both from hair and shade in photographs.
//! The shape model gives their usual place: it is fitted to the other points in 3D, alternating a similarity (Umeyama
//! 1991) and ridge regression of its modes, regularised by their standard deviations over people.
//!
//! Frames: (right, up, towards the viewer) outside, the model's head frame inside. Units: the mesh's. Cost: below
//! a millisecond. Limits: a cartoon's jaw is put where people's is.

use nalgebra::{DMatrix, DVector, Matrix3};

use super::mesh::Vec3;
use mien_stages::base::capacity::LANDMARKS;
use mien_stages::face_model::ShapeModel;

/// Alternations of similarity and modes.
const ROUNDS: usize = 8;
/// Expected error of the found points, in inner-eye-corner distances: sets how strongly the modes are regularised.
const NOISE: f64 = 0.06;
/// Eyes, nose and lips, which a rendering of any head shows.
const KNOWN: std::ops::Range<usize> = 27..LANDMARKS;

/// Head frame (x to the subject's left, y down, z away from the viewer) to (right, up, towards the viewer).
fn upright(v: [f32; 3]) -> Vec3 {
    let [x, y, z] = v.map(f64::from);
    Vec3::new(x, -y, -z)
}

/// Scale, rotation and shift that bring `from` nearest to `to`.
fn similarity(from: &[Vec3], to: &[Vec3]) -> Option<(f64, Matrix3<f64>, Vec3)> {
    let n = from.len() as f64;
    let (a, b) = (from.iter().sum::<Vec3>() / n, to.iter().sum::<Vec3>() / n);
    let cross = from.iter().zip(to);
    let cross = cross.map(|(p, q)| (q - b) * (p - a).transpose());
    let svd = cross.sum::<Matrix3<f64>>().svd(true, true);
    let (u, v) = (svd.u?, svd.v_t?);
    let mut signs = Vec3::repeat(1.0);
    signs.z = (u.determinant() * v.determinant()).signum();
    let turn = u * Matrix3::from_diagonal(&signs) * v;
    let spread: f64 = from.iter().map(|p| (p - a).norm_squared()).sum();
    let scale = svd.singular_values.dot(&signs) / spread;
    Some((scale, turn, b - turn * a * scale))
}

/// All 68 points of the shape fitted to the eyes, nose and lips of `found`; `None` if those are degenerate.
pub(super) fn completed(
    shape: &ShapeModel,
    found: &[Vec3; LANDMARKS],
) -> Option<[Vec3; LANDMARKS]> {
    let mean = shape.mean.iter().map(|p| upright((*p).into()));
    let mean: Vec<Vec3> = mean.collect();
    // One column per mode, one standard deviation long.
    let mode = |(mode, deviation): (&[f32; 3 * LANDMARKS], &f32)| {
        let along = mode.as_chunks().0.iter();
        along.map(|&v| upright(v) * f64::from(*deviation)).collect()
    };
    let modes = shape.modes.iter().zip(&shape.deviations);
    let modes: Vec<Vec<Vec3>> = modes.map(mode).collect();
    let eyes = (mean[39] - mean[42]).norm();
    let mut now = mean.clone();
    let mut place = (1.0, Matrix3::identity(), Vec3::zeros());
    for _ in 0..ROUNDS {
        place = similarity(&now[KNOWN], &found[KNOWN])?;
        let (scale, turn, shift) = place;
        if !(scale.is_finite() && scale > 0.0) {
            return None;
        }
        // Found points in the model's frame and scale.
        let miss = KNOWN.flat_map(|k| {
            let there = turn.transpose() * (found[k] - shift) / scale - mean[k];
            [there.x, there.y, there.z]
        });
        let miss = DVector::from_iterator(3 * KNOWN.len(), miss);
        let columns = DMatrix::from_fn(3 * KNOWN.len(), modes.len(), |r, c| {
            modes[c][KNOWN.start + r / 3][r % 3]
        });
        let mut square = columns.transpose() * &columns;
        let held = (NOISE * eyes).powi(2);
        for k in 0..modes.len() {
            square[(k, k)] += held;
        }
        let b = square.cholesky()?.solve(&(columns.transpose() * miss));
        for (k, p) in now.iter_mut().enumerate() {
            let parts = modes.iter().zip(b.iter()).map(|(mode, b)| mode[k] * *b);
            *p = parts.fold(mean[k], |sum, part| sum + part);
        }
    }
    let (scale, turn, shift) = place;
    Some(std::array::from_fn(|k| turn * now[k] * scale + shift))
}

#[cfg(test)]
mod tests {
    use super::*;
    use mien_stages::face_model::FaceModel;

    #[test]
    fn brows_and_jaw_of_a_person_follow_from_the_rest() {
        let shape = FaceModel::shipped().shape;
        let mut random = fastrand::Rng::with_seed(8);
        let (mut by_mean, mut by_shape) = (0.0, 0.0);
        for _ in 0..20 {
            let person: Vec<f32> = shape
                .deviations
                .iter()
                .map(|_| random.f32() * 2.4 - 1.2)
                .collect();
            let mut points = [nalgebra::Point3::origin(); LANDMARKS];
            shape.shape(&person, &mut points);
            let turn = nalgebra::Rotation3::from_euler_angles(0.1, -0.2, 0.05);
            let head = |p: &nalgebra::Point3<f32>| {
                turn * upright((*p).into()) * 100.0 + Vec3::new(3.0, -2.0, 7.0)
            };
            let mut found: [Vec3; LANDMARKS] = std::array::from_fn(|k| head(&points[k]));
            let truth = found;
            for p in &mut found[..KNOWN.start] {
                *p = Vec3::repeat(1e3);
            }
            let completed = completed(&shape, &found).unwrap();
            let w = (truth[39] - truth[42]).norm();
            let mean: Vec<Vec3> = shape.mean.iter().map(head).collect();
            for k in 0..KNOWN.start {
                by_mean += (mean[k] - truth[k]).norm() / w;
                by_shape += (completed[k] - truth[k]).norm() / w;
            }
        }
        let count = 20.0 * KNOWN.start as f64;
        println!(
            "mean {:.3}, by shape {:.3}",
            by_mean / count,
            by_shape / count
        );
        assert!(by_shape < 0.7 * by_mean, "{by_shape} {by_mean}");
    }
}
