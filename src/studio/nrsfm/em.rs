//! EM for a low-rank Gaussian shape prior under scaled orthographic cameras.
//!
//! Image point j of frame t: `w = c_t R_t (b_j0 + Σ_k z_tk b_jk) + d_t + noise`, R_t two rows of a rotation, noise of
//! variance σ² per coordinate. The coefficients z are Gaussian and are integrated out, not chosen: EM-PPCA of Torresani,
//! Hertzmann and Bregler, *Nonrigid structure-from-motion: estimating shape and motion with hierarchical priors*, PAMI
//! 2008, section 4. In time they follow their linear dynamics (section 5 there) in the simplest stationary form,
//! `z_t = α z_(t−1) + √(1−α²) n`, so that z_t ~ N(0, I) at all t; one α is learned and is 0 for shuffled frames, which is
//! EM-PPCA again. The E-step is then a Kalman filter and Rauch-Tung-Striebel smoother. Missing points are left out of
//! every sum. The scales have a Gaussian prior about 1 with learned variance, so that cameras that do not zoom stay at 1.
//!
//! Additions to the published method: parameter expansion (Liu, Rubin, Wu 1998: the coefficients are brought back to N(0, I)
//! after every E-step and the basis takes the factor), without which the convergence is hundreds of times slower; a Gaussian
//! prior on the modes' entries, worth a few per cent on real faces; and a floor under σ² which the caller lowers step by
//! step (annealing).
//!
//! Units: the tracks', divided by their spread (the caller does that). Cost of a sweep: F (P K + K³) + P (3K + 3)³ / 6
//! operations, the last term only with missing points. Memory: F K² + 9 P K numbers.
//! Degenerate: a camera that never turns leaves depth undetermined; the tiny ridge of the basis then keeps it small.
//! One file: the two steps of one iteration share all their terms.

use super::tracks::Tracks;
use nalgebra::{Cholesky, DMatrix, DVector, Matrix2x3, Matrix3, Rotation3, Vector2, Vector3};

/// Everything the EM estimates. Image units are the tracks' as given.
#[derive(Clone, Debug)]
pub(crate) struct Model {
    pub(crate) rank: usize,
    /// `P` blocks of `3 (K + 1)`: `b[j][3 k + axis]`, k = 0 the mean shape.
    pub(crate) basis: Vec<DVector<f64>>,
    pub(crate) rotation: Vec<Matrix3<f64>>,
    pub(crate) scale: Vec<f64>,
    pub(crate) shift: Vec<Vector2<f64>>,
    /// Posterior mean and covariance of each frame's coefficients.
    pub(crate) mean: Vec<DVector<f64>>,
    pub(crate) covariance: Vec<DMatrix<f64>>,
    pub(crate) noise_variance: f64,
    pub(crate) alpha: f64,
    scale_variance: f64,
    /// Prior variance of a mode's entries: depth is taken to deform as much as the image plane shows.
    mode_variance: f64,
    /// Log-likelihood of the tracks at the parameters the last E-step saw.
    pub(crate) log_likelihood: f64,
}

/// Sums over all points of products of basis rows, per pair of axes: `M_ab[k, l] = Σ_j b_jka b_jlb`, and the plain sums.
struct Products {
    pairs: [[DMatrix<f64>; 3]; 3],
    sums: [DVector<f64>; 3],
    count: f64,
}

/// Added to the normal matrix of every basis block, relative to its size: directions the cameras never saw stay at zero.
const BASIS_RIDGE: f64 = 1e-7;
/// Weight of the modes' prior in frames. Above 1 because neighbouring frames repeat each other's errors: what the modes
/// leave over is no white noise. It keeps modes from taking up errors as depth, which helps a little with real faces and
/// costs a little on clean tracks. Error as a share of the rigid mean shape's, with and without it
/// (`tests/recovers_shape_from_tracks.rs`): the three windows of real faces over ±25° 0.50, 0.81, 0.54 and 0.53, 0.84, 0.56;
/// face1 0.78 and 0.86; face37 0.54 and 0.52; shark 0.05 and 0.03; yoga and pickup alike.
const MODE_PRIOR: f64 = 3.0;
/// Least standard deviation of the camera scales about 1.
const SCALE_SPREAD_FLOOR: f64 = 1e-4;
/// The dynamics stay stationary.
const ALPHA_LARGEST: f64 = 0.995;

impl Model {
    /// A rigid start: cameras given, mean shape from them by one M-step, no modes.
    pub(crate) fn rigid(tracks: &Tracks, rotation: Vec<Matrix3<f64>>) -> Self {
        let (frames, points) = (tracks.frames(), tracks.points());
        let mut model = Self {
            rank: 0,
            basis: vec![DVector::zeros(3); points],
            rotation,
            scale: vec![1.0; frames],
            shift: mean_positions(tracks),
            mean: vec![DVector::zeros(0); frames],
            covariance: vec![DMatrix::zeros(0, 0); frames],
            noise_variance: 1e-2,
            alpha: 0.0,
            scale_variance: 1e-2,
            mode_variance: 1.0,
            log_likelihood: f64::NEG_INFINITY,
        };
        for _ in 0..3 {
            model.fit_basis(tracks);
            model.fit_shifts(tracks);
        }
        model
    }

    /// Adds modes up to `rank`: the leading directions of what the image still shows against the model, lifted along the
    /// image plane of each frame, plus a little noise so that depth can start to move.
    pub(crate) fn grow(&mut self, tracks: &Tracks, rank: usize, rng: &mut fastrand::Rng) {
        let (frames, points) = (tracks.frames(), tracks.points());
        let more = rank.saturating_sub(self.rank);
        if more == 0 {
            return;
        }
        let mut lifted = DMatrix::zeros(3 * points, frames);
        for t in 0..frames {
            let camera = self.camera(t);
            for j in 0..points {
                let Some(w) = tracks.position(t, j) else {
                    continue;
                };
                let residual = Vector2::from(w) - self.shift[t] - camera * self.point(t, j);
                let lift = camera.transpose() * residual / (self.scale[t] * self.scale[t]);
                lifted.fixed_view_mut::<3, 1>(3 * j, t).copy_from(&lift);
            }
        }
        let gram = lifted.transpose() * &lifted;
        let eigen = gram.symmetric_eigen();
        let mut order: Vec<usize> = (0..frames).collect();
        order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
        let old = self.rank;
        self.mode_variance =
            (lifted.norm_squared() / (2.0 * (points * frames * rank) as f64)).max(1e-12);
        self.rank += more;
        for b in &mut self.basis {
            *b = b.clone().resize_vertically(3 * (old + more + 1), 0.0);
        }
        for (m, column) in order.into_iter().take(more).enumerate() {
            let direction = &lifted * eigen.eigenvectors.column(column);
            let size = 1.0 / (frames as f64).sqrt();
            let jitter = 0.05 * direction.norm() / (3.0 * points as f64).sqrt();
            for j in 0..points {
                for a in 0..3 {
                    self.basis[j][3 * (old + m + 1) + a] =
                        size * (direction[3 * j + a] + jitter * (rng.f64() - 0.5));
                }
            }
        }
        self.mean = vec![DVector::zeros(self.rank); frames];
        self.covariance = vec![DMatrix::identity(self.rank, self.rank); frames];
    }

    /// Camera rows with their scale, `c R`.
    pub(crate) fn camera(&self, t: usize) -> Matrix2x3<f64> {
        self.rotation[t].fixed_rows::<2>(0) * self.scale[t]
    }

    /// Point j of frame t in the object frame, posterior mean.
    pub(crate) fn point(&self, t: usize, j: usize) -> Vector3<f64> {
        let b = &self.basis[j];
        let mut p = Vector3::new(b[0], b[1], b[2]);
        for k in 0..self.rank {
            p += self.mean[t][k] * Vector3::new(b[3 * k + 3], b[3 * k + 4], b[3 * k + 5]);
        }
        p
    }

    /// One EM sweep; `floor` is the least noise variance allowed in it.
    pub(crate) fn sweep(&mut self, tracks: &Tracks, floor: f64) {
        self.estimate_coefficients(tracks);
        self.restandardise();
        self.fit_basis(tracks);
        self.fit_cameras(tracks);
        self.fit_shifts(tracks);
        self.fit_noise(tracks, floor);
    }

    fn products(&self) -> Products {
        let n = self.rank + 1;
        let points = self.basis.len();
        let axis: [DMatrix<f64>; 3] =
            std::array::from_fn(|a| DMatrix::from_fn(points, n, |j, k| self.basis[j][3 * k + a]));
        Products {
            pairs: std::array::from_fn(|a| std::array::from_fn(|b| axis[a].tr_mul(&axis[b]))),
            sums: std::array::from_fn(|a| axis[a].row_sum_tr()),
            count: points as f64,
        }
    }

    /// The products over the points seen in one frame, about their mean there (which removes the unknown shift).
    fn products_seen(&self, all: &Products, tracks: &Tracks, t: usize) -> Products {
        let n = self.rank + 1;
        let mut seen = Products {
            pairs: all.pairs.clone(),
            sums: all.sums.clone(),
            count: all.count,
        };
        for j in (0..tracks.points()).filter(|j| !tracks.is_seen(t, *j)) {
            let b = &self.basis[j];
            seen.count -= 1.0;
            for a in 0..3 {
                for k in 0..n {
                    seen.sums[a][k] -= b[3 * k + a];
                    for c in 0..3 {
                        for l in 0..n {
                            seen.pairs[a][c][(k, l)] -= b[3 * k + a] * b[3 * l + c];
                        }
                    }
                }
            }
        }
        if seen.count > 0.0 {
            for a in 0..3 {
                for c in 0..3 {
                    seen.pairs[a][c].ger(-1.0 / seen.count, &seen.sums[a], &seen.sums[c], 1.0);
                }
            }
        }
        seen
    }

    /// E-step: filter forwards, smooth backwards, learn α.
    fn estimate_coefficients(&mut self, tracks: &Tracks) {
        let (frames, k) = (tracks.frames(), self.rank);
        let precision = 1.0 / self.noise_variance;
        let all = self.products();
        let identity = DMatrix::<f64>::identity(k, k);
        let mut predicted: Vec<(DVector<f64>, DMatrix<f64>)> = Vec::with_capacity(frames);
        let mut filtered: Vec<(DVector<f64>, DMatrix<f64>)> = Vec::with_capacity(frames);
        let mut inverses: Vec<DMatrix<f64>> = Vec::with_capacity(frames);
        self.log_likelihood = 0.0;
        for t in 0..frames {
            let camera = self.camera(t);
            let gram = camera.transpose() * camera;
            let seen = self.products_seen(&all, tracks, t);
            let mut information = DMatrix::zeros(k, k);
            for a in 0..3 {
                for c in 0..3 {
                    information +=
                        seen.pairs[a][c].view((1, 1), (k, k)) * (gram[(a, c)] * precision);
                }
            }
            // Residual against the mean shape, about its mean over the seen points.
            let (mut mean_w, mut mean_b) = (Vector2::zeros(), Vector3::zeros());
            for (j, b) in self.basis.iter().enumerate() {
                if let Some(w) = tracks.position(t, j) {
                    mean_w += Vector2::from(w);
                    mean_b += Vector3::new(b[0], b[1], b[2]);
                }
            }
            let offset = if seen.count > 0.0 {
                (mean_w - camera * mean_b) / seen.count
            } else {
                Vector2::zeros()
            };
            let mut vector = DVector::zeros(k);
            let mut squares = 0.0;
            for (j, b) in self.basis.iter().enumerate() {
                let Some(w) = tracks.position(t, j) else {
                    continue;
                };
                let residual = Vector2::from(w) - camera * Vector3::new(b[0], b[1], b[2]) - offset;
                squares += residual.norm_squared();
                let lifted = camera.transpose() * residual * precision;
                for m in 0..k {
                    let m3 = 3 * m + 3;
                    vector[m] += b[m3] * lifted.x + b[m3 + 1] * lifted.y + b[m3 + 2] * lifted.z;
                }
            }
            // The residuals are about the seen points' mean already, so the sum of b over the seen points cancels in it.
            let (mean_in, p_in) = match filtered.last() {
                None => (DVector::zeros(k), identity.clone()),
                Some((m, p)) => {
                    let a2 = self.alpha * self.alpha;
                    (m * self.alpha, p * a2 + &identity * (1.0 - a2))
                }
            };
            let inverse = inverse_of(&p_in);
            let p_out = inverse_of(&(&inverse + information));
            let carried = &inverse * &mean_in;
            let mean_out = &p_out * (&carried + vector);
            // Two coordinates a frame are spent on the shift.
            let count = 2.0 * (seen.count - 1.0).max(0.0);
            self.log_likelihood -= 0.5
                * (count * (std::f64::consts::TAU * self.noise_variance).ln()
                    + squares * precision);
            if k > 0 {
                let out = inverse_of(&p_out);
                self.log_likelihood += 0.5
                    * (log_determinant(&p_out) - log_determinant(&p_in)
                        + mean_out.dot(&(&out * &mean_out))
                        - mean_in.dot(&carried));
            }
            predicted.push((mean_in, p_in));
            inverses.push(inverse);
            filtered.push((mean_out, p_out));
        }
        let (mut lagged, mut squared) = (0.0, 0.0);
        let Some((last_mean, last_covariance)) = filtered.last() else {
            return;
        };
        self.mean[frames - 1] = last_mean.clone();
        self.covariance[frames - 1] = last_covariance.clone();
        for t in (0..frames - 1).rev() {
            let (m, p) = &filtered[t];
            let gain = p * &inverses[t + 1] * self.alpha;
            self.mean[t] = m + &gain * (&self.mean[t + 1] - &predicted[t + 1].0);
            self.covariance[t] =
                p + &gain * (&self.covariance[t + 1] - &predicted[t + 1].1) * gain.transpose();
            lagged += self.mean[t].dot(&self.mean[t + 1])
                + (&self.covariance[t + 1] * gain.transpose()).trace();
            squared += 0.5 * (self.mean[t].norm_squared() + self.covariance[t].trace());
            squared += 0.5 * (self.mean[t + 1].norm_squared() + self.covariance[t + 1].trace());
        }
        if k > 0 && squared > 0.0 {
            self.alpha = (lagged / squared).clamp(0.0, ALPHA_LARGEST);
        }
    }

    /// Parameter expansion: coefficients back to zero mean and unit covariance, the basis takes the factor.
    fn restandardise(&mut self) {
        let (frames, k) = (self.mean.len(), self.rank);
        if k == 0 {
            return;
        }
        let mean = self.mean.iter().fold(DVector::zeros(k), |s, m| s + m) / frames as f64;
        let mut second = DMatrix::zeros(k, k);
        for (m, c) in self.mean.iter_mut().zip(&self.covariance) {
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
        for b in &mut self.basis {
            let modes = DMatrix::from_fn(3, k, |a, m| b[3 * (m + 1) + a]);
            let shifted = &modes * &mean;
            let scaled = modes * &l;
            for a in 0..3 {
                b[a] += shifted[a];
                for m in 0..k {
                    b[3 * (m + 1) + a] = scaled[(a, m)];
                }
            }
        }
        for (m, c) in self.mean.iter_mut().zip(&mut self.covariance) {
            *m = &l_inverse * &*m;
            *c = &l_inverse * &*c * l_inverse.transpose();
        }
    }

    /// M-step of mean shape and modes: one linear system per point, shared by all points without gaps.
    fn fit_basis(&mut self, tracks: &Tracks) {
        let (frames, points, n) = (tracks.frames(), tracks.points(), self.rank + 1);
        let size = 3 * n;
        let mut total = DMatrix::zeros(size, size);
        let mut blocks = Vec::with_capacity(frames);
        let mut right = vec![DVector::zeros(size); points];
        for t in 0..frames {
            let camera = self.camera(t);
            let gram = camera.transpose() * camera;
            let zeta = |k: usize| if k == 0 { 1.0 } else { self.mean[t][k - 1] };
            let mut block = DMatrix::zeros(size, size);
            for k in 0..n {
                for l in 0..n {
                    let mut second = zeta(k) * zeta(l);
                    if k > 0 && l > 0 {
                        second += self.covariance[t][(k - 1, l - 1)];
                    }
                    block
                        .fixed_view_mut::<3, 3>(3 * k, 3 * l)
                        .copy_from(&(gram * second));
                }
            }
            total += &block;
            for (j, r) in right.iter_mut().enumerate() {
                let Some(w) = tracks.position(t, j) else {
                    continue;
                };
                let lifted = camera.transpose() * (Vector2::from(w) - self.shift[t]);
                for k in 0..n {
                    for a in 0..3 {
                        r[3 * k + a] += zeta(k) * lifted[a];
                    }
                }
            }
            blocks.push(block);
        }
        let ridge = BASIS_RIDGE * (total.trace() / size as f64).max(f64::MIN_POSITIVE);
        let prior = MODE_PRIOR * self.noise_variance / self.mode_variance;
        let solve = |mut normal: DMatrix<f64>| {
            for i in 0..size {
                normal[(i, i)] += if i < 3 { ridge } else { ridge + prior };
            }
            Cholesky::new(normal)
        };
        let shared = solve(total.clone());
        for (j, r) in right.iter().enumerate() {
            let gaps: Vec<usize> = (0..frames).filter(|t| !tracks.is_seen(*t, j)).collect();
            let solution = if gaps.is_empty() {
                shared.as_ref().map(|c| c.solve(r))
            } else {
                let mut normal = total.clone();
                gaps.iter().for_each(|t| normal -= &blocks[*t]);
                solve(normal).map(|c| c.solve(r))
            };
            if let Some(solution) = solution {
                self.basis[j] = solution;
            }
        }
        // Where the object's origin lies is not observable: its centroid.
        let mean = self.basis.iter().fold(DVector::zeros(size), |s, b| s + b) / points as f64;
        self.basis.iter_mut().for_each(|b| *b -= &mean);
    }

    /// M-step of rotations (Gauss-Newton on SO(3)) and scales (closed form with their prior).
    fn fit_cameras(&mut self, tracks: &Tracks) {
        let all = self.products();
        let mut spread = 0.0;
        for t in 0..tracks.frames() {
            let seen = self.products_seen(&all, tracks, t);
            if seen.count < 2.0 {
                continue;
            }
            let zeta = DVector::from_fn(self.rank + 1, |k, _| {
                if k == 0 { 1.0 } else { self.mean[t][k - 1] }
            });
            let mut second = &zeta * zeta.transpose();
            let mut modes = second.view_mut((1, 1), (self.rank, self.rank));
            modes += &self.covariance[t];
            let spread_of = |a: usize, c: usize| seen.pairs[a][c].dot(&second);
            let a = Matrix3::from_fn(spread_of);
            // Mixed moments of image and shape about the seen points' means; those of the shape suffice.
            let mean_x = Vector3::from_fn(|axis, _| seen.sums[axis].dot(&zeta)) / seen.count;
            let mut b = Matrix2x3::zeros();
            for j in 0..tracks.points() {
                if let Some(w) = tracks.position(t, j) {
                    b += Vector2::from(w) * (self.point(t, j) - mean_x).transpose();
                }
            }
            self.rotation[t] = turned(self.rotation[t], self.scale[t], &a, &b);
            let rows = self.rotation[t].fixed_rows::<2>(0).into_owned();
            let quadratic = (rows * a * rows.transpose()).trace();
            let linear = (rows * b.transpose()).trace();
            let pull = self.noise_variance / self.scale_variance;
            let weight = quadratic + pull;
            if weight > 0.0 {
                self.scale[t] = ((linear + pull) / weight).clamp(0.2, 5.0);
                spread += (self.scale[t] - 1.0).powi(2) + self.noise_variance / weight;
            }
        }
        let frames = tracks.frames() as f64;
        self.scale_variance = (spread / frames).max(SCALE_SPREAD_FLOOR * SCALE_SPREAD_FLOOR);
        // The scales' mean is 1; the basis takes the factor.
        let mean = self.scale.iter().sum::<f64>() / frames;
        self.scale.iter_mut().for_each(|c| *c /= mean);
        self.basis.iter_mut().for_each(|b| *b *= mean);
    }

    fn fit_shifts(&mut self, tracks: &Tracks) {
        for t in 0..tracks.frames() {
            let camera = self.camera(t);
            let (mut sum, mut count) = (Vector2::zeros(), 0.0);
            for j in 0..tracks.points() {
                if let Some(w) = tracks.position(t, j) {
                    sum += Vector2::from(w) - camera * self.point(t, j);
                    count += 1.0;
                }
            }
            if count > 0.0 {
                self.shift[t] = sum / count;
            }
        }
    }

    fn fit_noise(&mut self, tracks: &Tracks, floor: f64) {
        let all = self.products();
        let (mut squares, mut count) = (0.0, 0.0);
        for t in 0..tracks.frames() {
            let camera = self.camera(t);
            for j in 0..tracks.points() {
                if let Some(w) = tracks.position(t, j) {
                    squares += (Vector2::from(w) - self.shift[t] - camera * self.point(t, j))
                        .norm_squared();
                    count += 2.0;
                }
            }
            let gram = camera.transpose() * camera;
            let seen = self.products_seen(&all, tracks, t);
            for a in 0..3 {
                for c in 0..3 {
                    let modes = seen.pairs[a][c].view((1, 1), (self.rank, self.rank));
                    squares += gram[(a, c)] * modes.dot(&self.covariance[t]);
                }
            }
        }
        if count > 0.0 {
            self.noise_variance = (squares / count).max(floor);
        }
    }
}

/// Rotation that lowers `|c R L − …|²` for second moments `a` (3x3) of the shape and mixed moments `b` (2x3): a few
/// Gauss-Newton steps from `start`, each kept only if the cost falls.
fn turned(start: Matrix3<f64>, scale: f64, a: &Matrix3<f64>, b: &Matrix2x3<f64>) -> Matrix3<f64> {
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

/// Mean of the seen points of each frame; zero where nothing is seen.
pub(crate) fn mean_positions(tracks: &Tracks) -> Vec<Vector2<f64>> {
    (0..tracks.frames())
        .map(|t| {
            let seen: Vec<_> = (0..tracks.points())
                .filter_map(|j| tracks.position(t, j))
                .collect();
            seen.iter()
                .fold(Vector2::zeros(), |s, w| s + Vector2::from(*w))
                / seen.len().max(1) as f64
        })
        .collect()
}

/// Inverse of a symmetric positive definite matrix; the identity if rounding made it indefinite.
fn inverse_of(m: &DMatrix<f64>) -> DMatrix<f64> {
    Cholesky::new(m.clone())
        .map_or_else(|| DMatrix::identity(m.nrows(), m.ncols()), |c| c.inverse())
}

fn log_determinant(m: &DMatrix<f64>) -> f64 {
    Cholesky::new(m.clone()).map_or(0.0, |c| 2.0 * c.l_dirty().diagonal().map(f64::ln).sum())
}
