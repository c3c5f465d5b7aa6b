//! Initial cameras from tracks.
//!
//! The centred tracks W (2F x P, gaps filled by repeated low-rank projection) factor as W = Π B with Π of 3K columns. Some
//! 3K x 3 matrix Q turns Π into the camera rows: every pair of rows of Π Q must be orthonormal. For K = 1 this is rigid
//! factorisation (Tomasi and Kanade 1992) with the linear metric upgrade; for K > 1 it is the nonlinear orthonormality
//! system of Akhter, Sheikh, Khan and Kanade, *Nonrigid structure from motion in trajectory space*, NIPS 2008: only three
//! columns of the whole corrective matrix are needed, and they are unique up to a rotation (their orthonormality theorem).
//! Solved by Levenberg-Marquardt from the rigid answer and from seeded disturbances of it.
//!
//! Cost: one P x P eigenproblem per fill, (9K)³ per Levenberg-Marquardt step. Degenerate: if the rigid metric matrix is
//! indefinite its eigenvalues are clamped; frames without points take their predecessor's camera.

use super::tracks::{Tracks, mean_positions};
use mien_workbench::strongest::strongest;
use nalgebra::{
    Cholesky, DMatrix, DVector, Matrix3, Matrix3x2, SMatrix, SVector, Vector2, Vector3,
};

/// Passes of "project to the rank, keep the seen entries".
const FILL_PASSES: usize = 40;
const METRIC_STEPS: usize = 60;

/// Centred tracks, 2F x P, with gaps filled by the best matrix of the rank (hard impute); the rank of the filled matrix
/// itself is not limited.
pub(crate) fn filled(tracks: &Tracks, rank: usize) -> DMatrix<f64> {
    let (frames, points) = (tracks.frames(), tracks.points());
    let means = mean_positions(tracks);
    let mut w = DMatrix::zeros(2 * frames, points);
    let mut shift = means;
    let whole = tracks.sightings() == frames * points;
    let mut axes: Option<DMatrix<f64>> = None;
    for pass in 0..if whole { 1 } else { FILL_PASSES } {
        if pass > 0 {
            // The leading axes rotate little from pass to pass: one step of orthogonal iteration suffices.
            let leading = axes.take().map_or_else(
                || strongest(w.tr_mul(&w), rank).1,
                |axes| w.tr_mul(&(&w * axes)).qr().q(),
            );
            axes = Some(leading);
        }
        let guess = axes.as_ref().map(|v| (&w * v) * v.transpose());
        for t in 0..frames {
            let mut correction = Vector2::zeros();
            for j in 0..points {
                for a in 0..2 {
                    w[(2 * t + a, j)] = match (tracks.position(t, j), &guess) {
                        (Some(p), _) => p[a] - shift[t][a],
                        (None, Some(guess)) => guess[(2 * t + a, j)],
                        (None, None) => 0.0,
                    };
                    correction[a] += w[(2 * t + a, j)] / points as f64;
                }
            }
            for j in 0..points {
                for a in 0..2 {
                    w[(2 * t + a, j)] -= correction[a];
                }
            }
            shift[t] += correction;
        }
    }
    w
}

/// Extra columns and steps of [`leading`].
const LEADING: (usize, usize) = (4, 8);

/// W v for the leading right singular vectors v, by orthogonal iteration from a random start (Halko, Martinsson, Tropp
/// 2011): a hundredth of the time of all of them.
pub(crate) fn leading(w: &DMatrix<f64>, count: usize, rng: &mut fastrand::Rng) -> DMatrix<f64> {
    let (extra, steps) = LEADING;
    let width = (count + extra).min(w.ncols()).min(w.nrows());
    let mut axes = DMatrix::from_fn(w.ncols(), width, |_, _| rng.f64() - 0.5);
    for _ in 0..steps {
        axes = w.tr_mul(&(w * axes)).qr().q();
    }
    let seen = w * axes;
    let (_, turn) = strongest(seen.tr_mul(&seen), count);
    seen * turn
}

/// Π: the leading `columns` of W's left factor, scaled to order one.
fn left_factor(w: &DMatrix<f64>, columns: usize) -> DMatrix<f64> {
    let (values, vectors) = strongest(w.tr_mul(w), columns);
    let mut left = w * vectors;
    for (c, value) in values.iter().enumerate() {
        let sigma = value.sqrt();
        if sigma > 0.0 {
            // The square root of the singular value remains as a weight: strong directions dominate.
            let factor = 1.0 / (sigma * values[0].sqrt()).sqrt();
            left.column_mut(c)
                .scale_mut(factor * (w.nrows() as f64 / 2.0).sqrt());
        }
    }
    left
}

/// Cameras by rigid factorisation of the filled tracks.
pub(crate) fn rigid_cameras(w: &DMatrix<f64>) -> Vec<Matrix3<f64>> {
    let left = left_factor(w, 3);
    let q = rigid_upgrade(&left);
    cameras_from(&(left * q))
}

/// The linear metric upgrade of rigid factorisation: 3x3 Q with rows of Π Q near orthonormal.
fn rigid_upgrade(left: &DMatrix<f64>) -> DMatrix<f64> {
    let row = |r: usize| Vector3::new(left[(r, 0)], left[(r, 1)], left[(r, 2)]);
    let terms = |a: Vector3<f64>, b: Vector3<f64>| {
        SVector::<f64, 6>::new(
            a.x * b.x,
            a.x * b.y + a.y * b.x,
            a.x * b.z + a.z * b.x,
            a.y * b.y,
            a.y * b.z + a.z * b.y,
            a.z * b.z,
        )
    };
    let mut normal = SMatrix::<f64, 6, 6>::identity() * 1e-9;
    let mut right = SVector::<f64, 6>::zeros();
    for t in 0..left.nrows() / 2 {
        let (a, b) = (row(2 * t), row(2 * t + 1));
        for (g, want) in [(terms(a, a), 1.0), (terms(b, b), 1.0), (terms(a, b), 0.0)] {
            normal += g * g.transpose();
            right += g * want;
        }
    }
    let l = Cholesky::new(normal).map_or_else(SVector::zeros, |c| c.solve(&right));
    let metric = Matrix3::new(l[0], l[1], l[2], l[1], l[3], l[4], l[2], l[4], l[5]);
    let eigen = metric.symmetric_eigen();
    let largest = eigen.eigenvalues.max().max(f64::MIN_POSITIVE);
    let root = eigen.eigenvalues.map(|v| v.max(1e-3 * largest).sqrt());
    let q = eigen.eigenvectors * Matrix3::from_diagonal(&root);
    DMatrix::from_fn(3, 3, |r, c| q[(r, c)])
}

/// Cameras from a factor of `3 k` columns, starting from the rigid solution plus a `disturbance` of its entries.
pub(crate) fn trajectory_cameras(
    w: &DMatrix<f64>,
    k: usize,
    disturbance: f64,
    rng: &mut fastrand::Rng,
) -> Vec<Matrix3<f64>> {
    let left = left_factor(w, 3 * k);
    let columns = left.ncols();
    let frames = left.nrows() / 2;
    let upgrade = rigid_upgrade(&left);
    let mut q = DMatrix::from_fn(columns, 3, |r, c| {
        let start = if r < 3 { upgrade[(r, c)] } else { 0.0 };
        start + disturbance * (2.0 * rng.f64() - 1.0)
    });
    let residual = |q: &DMatrix<f64>| {
        let rows = &left * q;
        DVector::from_fn(3 * frames, |i, _| {
            let (a, b) = (rows.row(2 * (i / 3)), rows.row(2 * (i / 3) + 1));
            match i % 3 {
                0 => a.norm_squared() - 1.0,
                1 => b.norm_squared() - 1.0,
                _ => 2.0 * a.dot(&b),
            }
        })
    };
    let mut now = residual(&q);
    let mut damping = 1e-3;
    for _ in 0..METRIC_STEPS {
        let rows = &left * &q;
        let jacobian = slopes(&left, &rows);
        let normal = jacobian.tr_mul(&jacobian);
        let slope = jacobian.tr_mul(&now);
        let mean = normal.trace() / normal.nrows() as f64;
        let before = now.norm_squared();
        let mut better = false;
        for _ in 0..6 {
            let mut damped = normal.clone();
            for i in 0..damped.nrows() {
                damped[(i, i)] += damping * mean + 1e-12;
            }
            let Some(factor) = Cholesky::new(damped) else {
                break;
            };
            let step = factor.solve(&slope);
            let candidate = DMatrix::from_fn(columns, 3, |r, c| q[(r, c)] - step[3 * r + c]);
            let then = residual(&candidate);
            if then.norm_squared() < before {
                (q, now, better) = (candidate, then, true);
                damping = (damping * 0.2).max(1e-9);
                break;
            }
            damping *= 5.0;
        }
        if !better || before - now.norm_squared() < 1e-7 * before {
            break;
        }
    }
    cameras_from(&(left * q))
}

/// Jacobian of the rows' lengths and products by the entries of Q, row by row; `rows` is Π Q.
fn slopes(left: &DMatrix<f64>, rows: &DMatrix<f64>) -> DMatrix<f64> {
    let (frames, columns) = (left.nrows() / 2, left.ncols());
    let mut jacobian = DMatrix::zeros(3 * frames, 3 * columns);
    for t in 0..frames {
        for c in 0..3 {
            let (a, b) = (rows[(2 * t, c)], rows[(2 * t + 1, c)]);
            for r in 0..columns {
                let (pa, pb) = (left[(2 * t, r)], left[(2 * t + 1, r)]);
                jacobian[(3 * t, 3 * r + c)] = 2.0 * a * pa;
                jacobian[(3 * t + 1, 3 * r + c)] = 2.0 * b * pb;
                jacobian[(3 * t + 2, 3 * r + c)] = 2.0 * (a * pb + b * pa);
            }
        }
    }
    jacobian
}

/// For each pair of rows, the rotation whose first two rows are nearest.
fn cameras_from(rows: &DMatrix<f64>) -> Vec<Matrix3<f64>> {
    let mut cameras: Vec<Matrix3<f64>> = Vec::with_capacity(rows.nrows() / 2);
    for t in 0..rows.nrows() / 2 {
        let pair = Matrix3x2::from_fn(|c, r| rows[(2 * t + r, c)]);
        let svd = pair.svd(true, true);
        let camera = match (svd.u, svd.v_t) {
            (Some(u), Some(v_t)) if svd.singular_values.min() > 1e-9 => {
                let near = u * v_t;
                let (x, y) = (near.column(0).into_owned(), near.column(1).into_owned());
                Matrix3::from_rows(&[x.transpose(), y.transpose(), x.cross(&y).transpose()])
            }
            _ => cameras.last().copied().unwrap_or_else(Matrix3::identity),
        };
        cameras.push(camera);
    }
    cameras
}
