//! Numerics of one EM step: rotation of a camera, inverses and roots of covariances.

use nalgebra::{Cholesky, DMatrix, DVector, Matrix2x3, Matrix3, Rotation3, Vector3};

/// Rotation that lowers `|c R L − …|²` for second moments `a` (3x3) of the shape and mixed moments `b` (2x3): a few
/// Gauss-Newton steps from `start`, each kept only if the cost falls.
pub(super) fn turned(
    start: Matrix3<f64>,
    scale: f64,
    a: &Matrix3<f64>,
    b: &Matrix2x3<f64>,
) -> Matrix3<f64> {
    let cost = |r: &Matrix3<f64>| {
        let rows = r.fixed_rows::<2>(0);
        scale * (rows * a * rows.transpose()).trace() - 2.0 * (rows * b.transpose()).trace()
    };
    let (mut rotation, mut best) = (start, cost(&start));
    for _ in 0..3 {
        let rows = rotation.fixed_rows::<2>(0).into_owned();
        // d(R) = R [ω]×; derivative of the cost along each axis, and the Gauss-Newton matrix.
        let along: [Matrix2x3<f64>; 3] =
            std::array::from_fn(|i| rows * Vector3::ith(i, 1.0).cross_matrix());
        let slope_at = rows * a * scale - b;
        let gradient = Vector3::from_fn(|i, _| along[i].dot(&slope_at));
        let mut hessian = Matrix3::from_fn(|i, k| scale * (along[i] * a).dot(&along[k]));
        let damping = 1e-9 * hessian.trace().max(f64::MIN_POSITIVE);
        hessian += Matrix3::identity() * damping;
        let Some(factor) = Cholesky::new(hessian) else {
            break;
        };
        let mut step = -factor.solve(&gradient);
        let mut improved = false;
        for _ in 0..5 {
            let candidate = rotation * Rotation3::new(step).matrix();
            let value = cost(&candidate);
            if value < best {
                (rotation, best, improved) = (candidate, value, true);
                break;
            }
            step *= 0.3;
        }
        if !improved || step.norm() < 1e-9 {
            break;
        }
    }
    // Products of many rotations drift off SO(3) by rounding only; one renormalisation is enough.
    let mut rotation = Rotation3::from_matrix_unchecked(rotation);
    rotation.renormalize();
    rotation.into_inner()
}

/// Inverse of a symmetric positive definite matrix and the logarithm of its determinant; the identity's if rounding
/// made it indefinite.
pub(super) fn inverse_and_log_det(m: DMatrix<f64>) -> (DMatrix<f64>, f64) {
    let size = m.nrows();
    Cholesky::new(m).map_or_else(
        || (DMatrix::identity(size, size), 0.0),
        |c| {
            let log = 2.0 * c.l_dirty().diagonal().map(f64::ln).sum();
            (c.inverse(), log)
        },
    )
}

/// Lower triangle L with L Lᵀ = m; zero if rounding made it indefinite.
pub(super) fn cholesky_root(m: &DMatrix<f64>) -> DMatrix<f64> {
    Cholesky::new(m.clone()).map_or_else(|| DMatrix::zeros(m.nrows(), m.ncols()), |c| c.l())
}

/// Parameter expansion: standardises the coefficients to zero mean and unit covariance, and scales the basis
/// inversely.
pub(super) fn restandardise(
    means: &mut [DVector<f64>],
    covariances: &mut [DMatrix<f64>],
    basis: &mut DMatrix<f64>,
) {
    let (frames, k) = (means.len(), basis.nrows() / 3 - 1);
    if k == 0 {
        return;
    }
    let mean = means.iter().fold(DVector::zeros(k), |s, m| s + m) / frames as f64;
    let mut second = DMatrix::zeros(k, k);
    for (m, c) in means.iter_mut().zip(&*covariances) {
        *m -= &mean;
        second += c;
        second.ger(1.0, m, m, 1.0);
    }
    second /= frames as f64;
    for i in 0..k {
        second[(i, i)] += 1e-12;
    }
    let Some(factor) = Cholesky::new(second) else {
        return;
    };
    let l = factor.l();
    let Some(l_inverse) = l.clone().try_inverse() else {
        return;
    };
    let mut taken = vec![Vector3::zeros(); k + 1];
    for mut column in basis.column_iter_mut() {
        let (block, _) = column.as_mut_slice().as_chunks_mut::<3>();
        taken.fill(Vector3::zeros());
        taken[0] += Vector3::from(block[0]);
        for (m, b) in block[1..].iter().enumerate() {
            let b = Vector3::from(*b);
            taken[0] += b * mean[m];
            for (c, taken) in taken[1..=m + 1].iter_mut().enumerate() {
                *taken += b * l[(m, c)];
            }
        }
        for (b, taken) in block.iter_mut().zip(&taken) {
            *b = (*taken).into();
        }
    }
    for (m, c) in means.iter_mut().zip(covariances) {
        *m = &l_inverse * &*m;
        *c = &l_inverse * &*c * l_inverse.transpose();
    }
}
