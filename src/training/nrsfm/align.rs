//! The error of recovered shapes against the truth, as the literature states it.
//!
//! e = mean over frames of |S_est − S| / |S| (Frobenius norms, each frame's points centred), each frame aligned by its own
//! rotation (Kabsch 1976, by SVD). Scale is not fitted: the tracks fix it. An orthographic camera cannot tell a sequence
//! from its mirror image in depth, so the whole sequence, never a single frame, may be mirrored once; the better wins.

use super::tracks::Shapes;
use nalgebra::{Matrix3, Vector3};

/// Proper rotation R that best maps centred `from` to centred `onto`, least squares: `onto ≈ R from`.
pub(crate) fn rotation_onto(from: &[Vector3<f64>], onto: &[Vector3<f64>]) -> Matrix3<f64> {
    let mut m = Matrix3::zeros();
    for (a, b) in from.iter().zip(onto) {
        m += b * a.transpose();
    }
    let svd = m.svd(true, true);
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else {
        return Matrix3::identity();
    };
    let mut sign = Matrix3::identity();
    // The least certain axis is flipped if needed.
    let least = svd.singular_values.imin();
    sign[(least, least)] = (u * v_t).determinant().signum();
    u * sign * v_t
}

/// The mean of points, and the points relative to it.
pub(crate) fn centred(points: &[[f64; 3]]) -> (Vector3<f64>, Vec<Vector3<f64>>) {
    let all = || points.iter().map(|p| Vector3::<f64>::from(*p));
    let mean = all().sum::<Vector3<f64>>() / points.len().max(1) as f64;
    (mean, all().map(|p| p - mean).collect())
}

/// Mean relative error over the frames, each rigidly aligned, one reflection for all; `None` if the sizes differ.
pub fn shape_error(recovered: &Shapes, truth: &Shapes) -> Option<f64> {
    let same =
        recovered.points == truth.points && recovered.positions.len() == truth.positions.len();
    if !same || truth.points == 0 || truth.positions.is_empty() {
        return None;
    }
    let mean_error = |mirror: f64| {
        let sum: f64 = (0..truth.frames())
            .map(|t| {
                let (_, want) = centred(truth.frame(t));
                let (_, mut have) = centred(recovered.frame(t));
                have.iter_mut().for_each(|p| p.z *= mirror);
                let r = rotation_onto(&have, &want);
                let pairs = have.iter().zip(&want);
                let wrong: f64 = pairs.map(|(h, w)| (r * h - w).norm_squared()).sum();
                let size: f64 = want.iter().map(Vector3::norm_squared).sum();
                let share = wrong / size;
                if size > 0.0 { share.sqrt() } else { 0.0 }
            })
            .sum();
        sum / truth.frames() as f64
    };
    Some(mean_error(1.0).min(mean_error(-1.0)))
}

/// The rigid shape closest to all frames of the true shapes (generalised Procrustes without scale, Gower 1975), in
/// every frame: the baseline without deformation.
pub fn rigid_mean_shape(truth: &Shapes) -> Shapes {
    let frames = (0..truth.frames()).map(|t| centred(truth.frame(t)).1);
    let frames: Vec<_> = frames.collect();
    let mut mean = frames.first().cloned().unwrap_or_default();
    for _ in 0..10 {
        let mut sum = vec![Vector3::zeros(); truth.points];
        for frame in &frames {
            let r = rotation_onto(frame, &mean);
            for (s, p) in sum.iter_mut().zip(frame) {
                *s += r * p;
            }
        }
        mean = sum.into_iter().map(|s| s / frames.len() as f64).collect();
    }
    let one: Vec<[f64; 3]> = mean.iter().map(|p| [p.x, p.y, p.z]).collect();
    Shapes {
        points: truth.points,
        positions: one.repeat(frames.len()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Rotation3;

    fn shapes() -> Shapes {
        let mut rng = fastrand::Rng::with_seed(5);
        let positions = (0..60).map(|_| [rng.f64(), rng.f64(), rng.f64()]).collect();
        Shapes {
            points: 12,
            positions,
        }
    }

    #[test]
    fn motion_and_global_mirror_cost_nothing_but_scale_does() {
        let truth = shapes();
        let mut moved = truth.clone();
        for t in 0..5 {
            let r = Rotation3::from_euler_angles(0.3 * t as f64, 1.0, -0.2);
            for p in &mut moved.positions[t * 12..(t + 1) * 12] {
                let q = r * Vector3::new(p[0], p[1], -p[2]) + Vector3::new(1.0, 2.0, 3.0);
                *p = [q.x, q.y, q.z];
            }
        }
        assert!(shape_error(&moved, &truth).unwrap() < 1e-9);
        moved
            .positions
            .iter_mut()
            .flatten()
            .for_each(|v| *v *= 1.05);
        assert!((shape_error(&moved, &truth).unwrap() - 0.05).abs() < 1e-9);
    }

    #[test]
    fn one_mirrored_frame_is_an_error() {
        let truth = shapes();
        let mut moved = truth.clone();
        moved.positions[..12].iter_mut().for_each(|p| p[2] = -p[2]);
        assert!(shape_error(&moved, &truth).unwrap() > 0.05);
    }
}
