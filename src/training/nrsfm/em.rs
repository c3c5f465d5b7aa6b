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
//! Units: the tracks', divided by their spread (the caller does that). Cost of a sweep: F (P K² + K³) + P (3K + 3)³ / 6
//! operations, the last term only with missing points. Memory: 10 F K² + 3 P K numbers.
//! Degenerate: a camera that never turns leaves depth undetermined; the tiny ridge of the basis then keeps it small.

use super::cameras::leading;
use super::solve::{cholesky_root, inverse_and_log_det, restandardise, turned};
use super::tracks::{Tracks, mean_positions};
use nalgebra::{Cholesky, DMatrix, DVector, Matrix2x3, Matrix3, Vector2, Vector3};

/// Parameters and posteriors of the EM. Image units are the tracks'.
#[derive(Clone, Debug)]
pub(crate) struct Model {
    pub(crate) rank: usize,
    /// A column of `3 (K + 1)` for each of `P` points: `basis[(3 k + axis, j)]`, k = 0 the mean shape.
    pub(crate) basis: DMatrix<f64>,
    pub(crate) rotation: Vec<Matrix3<f64>>,
    pub(crate) scale: Vec<f64>,
    pub(crate) shift: Vec<Vector2<f64>>,
    /// Posterior mean and covariance of each frame's coefficients.
    pub(crate) mean: Vec<DVector<f64>>,
    pub(crate) covariance: Vec<DMatrix<f64>>,
    pub(crate) noise_variance: f64,
    pub(crate) alpha: f64,
    /// Per frame: contribution of the coefficients' covariance to the second moments of the seen points about their
    /// mean.
    vague: Vec<Matrix3<f64>>,
    scale_variance: f64,
    /// Prior variance of a mode's entries: depth is taken to deform as much as the image plane shows.
    mode_variance: f64,
    /// Log-likelihood of the tracks at the parameters of the last E-step.
    pub(crate) log_likelihood: f64,
}

/// Relative ridge of every basis block's normal matrix: directions unseen by the cameras stay at zero.
const BASIS_RIDGE: f64 = 1e-7;
/// Weight of the modes' prior in frames, above 1 because residuals of neighbouring frames are correlated. It keeps
/// modes from explaining errors as depth, which helps a little with real faces and costs a little on clean tracks.
/// Error as a share of the rigid mean shape's, with and without it (`tests/it/recovers_shape_from_tracks.rs`): the
/// three windows of real faces over ±25° 0.50, 0.81, 0.54 and 0.53, 0.84, 0.56; face1 0.78 and 0.86; face37 0.54 and
/// 0.52; shark 0.05 and 0.03; yoga and pickup alike.
const MODE_PRIOR: f64 = 3.0;
/// Least standard deviation of the camera scales about 1.
const SCALE_SPREAD_FLOOR: f64 = 1e-4;
/// Largest α, so that the dynamics stay stationary.
const ALPHA_LARGEST: f64 = 0.995;

impl Model {
    /// A rigid start: cameras given, mean shape from them by one M-step, no modes.
    pub(crate) fn rigid(tracks: &Tracks, rotation: Vec<Matrix3<f64>>) -> Self {
        let (frames, points) = (tracks.frames(), tracks.points());
        let mut model = Self {
            rank: 0,
            basis: DMatrix::zeros(3, points),
            rotation,
            scale: vec![1.0; frames],
            shift: mean_positions(tracks),
            mean: vec![DVector::zeros(0); frames],
            covariance: vec![DMatrix::zeros(0, 0); frames],
            noise_variance: 1e-2,
            alpha: 0.0,
            vague: vec![Matrix3::zeros(); frames],
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

    /// Adds modes up to `rank`: the leading directions of the image residual, lifted along the image plane of each
    /// frame, plus a little noise so that depth can start to move.
    pub(crate) fn grow(&mut self, tracks: &Tracks, rank: usize, rng: &mut fastrand::Rng) {
        let (frames, points) = (tracks.frames(), tracks.points());
        let more = rank.saturating_sub(self.rank);
        if more == 0 {
            return;
        }
        let mut lifted = DMatrix::zeros(3 * points, frames);
        for t in 0..frames {
            let camera = self.camera(t);
            for (j, w) in tracks.seen_in(t) {
                let residual = w - self.shift[t] - camera * self.point(t, j);
                let lift = camera.transpose() * residual / (self.scale[t] * self.scale[t]);
                lifted.fixed_view_mut::<3, 1>(3 * j, t).copy_from(&lift);
            }
        }
        let directions = leading(&lifted, more, rng);
        let old = self.rank;
        self.mode_variance =
            (lifted.norm_squared() / (2.0 * (points * frames * rank) as f64)).max(1e-12);
        self.rank += more;
        let basis = self.basis.clone();
        self.basis = basis.resize_vertically(3 * (self.rank + 1), 0.0);
        for (m, direction) in directions.column_iter().enumerate() {
            let size = 1.0 / (frames as f64).sqrt();
            let jitter = 0.05 * direction.norm() / (3.0 * points as f64).sqrt();
            for j in 0..points {
                for a in 0..3 {
                    self.basis[(3 * (old + m + 1) + a, j)] =
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
        let (mean, modes) = self.block(j);
        let parts = modes.iter().zip(&self.mean[t]);
        parts.fold(Vector3::from(*mean), |p, (b, z)| p + Vector3::from(*b) * *z)
    }

    /// One EM sweep; `floor` is the least noise variance allowed in it.
    pub(crate) fn sweep(&mut self, tracks: &Tracks, floor: f64) {
        self.estimate_coefficients(tracks);
        restandardise(&mut self.mean, &mut self.covariance, &mut self.basis);
        self.fit_basis(tracks);
        self.fit_cameras(tracks);
        self.fit_shifts(tracks);
        self.fit_noise(tracks, floor);
    }

    /// Mean and modes of one point.
    fn block(&self, j: usize) -> (&[f64; 3], &[[f64; 3]]) {
        let size = self.basis.nrows();
        let (vectors, _) = self.basis.as_slice()[j * size..(j + 1) * size].as_chunks::<3>();
        (&vectors[0], &vectors[1..])
    }

    /// Number of seen points of frame t, and the Gram matrix, about the mean over them, of their residuals against
    /// the mean shape (row and column 0) and of the modes.
    fn image_gram(&self, tracks: &Tracks, t: usize) -> (f64, DMatrix<f64>) {
        let n = self.rank + 1;
        let camera = self.camera(t);
        let [across, down] = [0, 1].map(|row| [0, 1, 2].map(|a| camera[(row, a)]));
        let along =
            |axis: &[f64; 3], b: &[f64; 3]| axis[0] * b[0] + axis[1] * b[1] + axis[2] * b[2];
        let mut gram = DMatrix::zeros(n, n);
        let mut sums = vec![[0.0; 2]; n];
        let mut shown = vec![[0.0; 2]; n];
        let mut count = 0.0;
        for (j, w) in tracks.seen_in(t) {
            let (mean, modes) = self.block(j);
            shown[0] = [w[0] - along(&across, mean), w[1] - along(&down, mean)];
            for (shown, b) in shown[1..].iter_mut().zip(modes) {
                *shown = [along(&across, b), along(&down, b)];
            }
            let columns = gram.as_mut_slice().chunks_exact_mut(n);
            for (k, (sum, column)) in sums.iter_mut().zip(columns).enumerate() {
                let here = shown[k];
                sum[0] += here[0];
                sum[1] += here[1];
                for (g, other) in column[k..].iter_mut().zip(&shown[k..]) {
                    *g += here[0] * other[0] + here[1] * other[1];
                }
            }
            count += 1.0;
        }
        for k in 0..n {
            for l in k..n {
                gram[(l, k)] -=
                    (sums[k][0] * sums[l][0] + sums[k][1] * sums[l][1]) / f64::max(count, 1.0);
                gram[(k, l)] = gram[(l, k)];
            }
        }
        (count, gram)
    }

    /// E-step: filter forwards, smooth backwards, learn α.
    fn estimate_coefficients(&mut self, tracks: &Tracks) {
        let (frames, k) = (tracks.frames(), self.rank);
        let precision = 1.0 / self.noise_variance;
        let mut predicted: Vec<DVector<f64>> = Vec::with_capacity(frames);
        let mut filtered: Vec<(DVector<f64>, DMatrix<f64>)> = Vec::with_capacity(frames);
        let mut inverses: Vec<DMatrix<f64>> = Vec::with_capacity(frames);
        self.log_likelihood = 0.0;
        for t in 0..frames {
            let (count, gram) = self.image_gram(tracks, t);
            let (mean_in, p_in) = match filtered.last() {
                None => (DVector::zeros(k), DMatrix::identity(k, k)),
                Some((m, p)) => {
                    let a2 = self.alpha * self.alpha;
                    let mut carried = p * a2;
                    (0..k).for_each(|i| carried[(i, i)] += 1.0 - a2);
                    (m * self.alpha, carried)
                }
            };
            let (inverse, log_in) = inverse_and_log_det(p_in);
            let information = &inverse + gram.view((1, 1), (k, k)) * precision;
            let (p_out, log_information) = inverse_and_log_det(information);
            let carried = &inverse * &mean_in;
            let information = &carried + gram.view((1, 0), (k, 1)).column(0) * precision;
            let mean_out = &p_out * &information;
            // Two coordinates a frame determine the shift.
            let count = 2.0 * (count - 1.0).max(0.0);
            self.log_likelihood -= 0.5
                * (count * (std::f64::consts::TAU * self.noise_variance).ln()
                    + gram[(0, 0)] * precision
                    + log_information
                    + log_in
                    - mean_out.dot(&information)
                    + mean_in.dot(&carried));
            predicted.push(mean_in);
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
            self.mean[t] = m + &gain * (&self.mean[t + 1] - &predicted[t + 1]);
            // The predicted covariance that the smoother takes off again is gain⁻¹ α p: α p gainᵀ remains of its product.
            self.covariance[t] =
                p + (&gain * &self.covariance[t + 1] - p * self.alpha) * gain.transpose();
            lagged += self.mean[t].dot(&self.mean[t + 1]) + gain.dot(&self.covariance[t + 1]);
            squared += 0.5 * (self.mean[t].norm_squared() + self.covariance[t].trace());
            squared += 0.5 * (self.mean[t + 1].norm_squared() + self.covariance[t + 1].trace());
        }
        if k > 0 && squared > 0.0 {
            self.alpha = (lagged / squared).clamp(0.0, ALPHA_LARGEST);
        }
    }

    /// M-step of mean shape and modes: one linear system per point, shared by all points without gaps.
    fn fit_basis(&mut self, tracks: &Tracks) {
        let (frames, points, n) = (tracks.frames(), tracks.points(), self.rank + 1);
        let size = 3 * n;
        let mut total = DMatrix::zeros(size, size);
        let mut blocks = Vec::with_capacity(frames);
        let mut right = DMatrix::zeros(size, points);
        for t in 0..frames {
            let camera = self.camera(t);
            let gram = camera.transpose() * camera;
            let zeta = self.zeta(t);
            let mut block = DMatrix::zeros(size, size);
            for k in 0..n {
                for l in 0..n {
                    let mut second = zeta[k] * zeta[l];
                    if k > 0 && l > 0 {
                        second += self.covariance[t][(k - 1, l - 1)];
                    }
                    let mut part = block.fixed_view_mut::<3, 3>(3 * k, 3 * l);
                    part.copy_from(&(gram * second));
                }
            }
            total += &block;
            for (j, w) in tracks.seen_in(t) {
                let lifted = camera.tr_mul(&(w - self.shift[t]));
                let column = &mut right.as_mut_slice()[j * size..(j + 1) * size];
                for (r, z) in column.as_chunks_mut::<3>().0.iter_mut().zip(&zeta) {
                    for a in 0..3 {
                        r[a] += z * lifted[a];
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
        for j in 0..points {
            let mut gaps = (0..frames).filter(|t| !tracks.is_seen(*t, j)).peekable();
            let own = gaps.peek().is_some().then(|| {
                let mut normal = total.clone();
                gaps.for_each(|t| normal -= &blocks[t]);
                solve(normal)
            });
            if let Some(factor) = own.as_ref().unwrap_or(&shared) {
                factor.solve_mut(&mut right.column_mut(j));
                self.basis.set_column(j, &right.column(j));
            }
        }
        // The object's origin is not observable; its centroid is used.
        let mean = self.basis.column_mean();
        for mut column in self.basis.column_iter_mut() {
            column -= &mean;
        }
    }

    /// 1, then the coefficients' posterior mean.
    fn zeta(&self, t: usize) -> Vec<f64> {
        let mean = self.mean[t].iter().copied();
        std::iter::once(1.0).chain(mean).collect()
    }

    /// M-step of rotations (Gauss-Newton on SO(3)) and scales (closed form with their prior).
    fn fit_cameras(&mut self, tracks: &Tracks) {
        let mut spread = 0.0;
        let mut sums = vec![Vector3::zeros(); self.rank];
        for t in 0..tracks.frames() {
            // The shape's covariance is that of independent modes: the basis times a root of the coefficients'
            // covariance.
            let factor = cholesky_root(&self.covariance[t]);
            let (mut shape, mut vague) = (Matrix3::zeros(), Matrix3::zeros());
            let (mut mean_x, mut mean_w) = (Vector3::zeros(), Vector2::zeros());
            let mut mixed = Matrix2x3::zeros();
            let mut count = 0.0;
            sums.fill(Vector3::zeros());
            for (j, w) in tracks.seen_in(t) {
                let x = self.point(t, j);
                mean_w += w;
                mean_x += x;
                mixed += w * x.transpose();
                shape += x * x.transpose();
                let (_, modes) = self.block(j);
                for (m, sum) in sums.iter_mut().enumerate() {
                    let lower = modes.iter().enumerate().skip(m);
                    let mode = lower.fold(Vector3::zeros(), |y, (k, b)| {
                        y + Vector3::from(*b) * factor[(k, m)]
                    });
                    *sum += mode;
                    vague += mode * mode.transpose();
                }
                count += 1.0;
            }
            if count < 2.0 {
                continue;
            }
            for sum in &sums {
                vague -= sum * sum.transpose() / count;
            }
            // Mixed moments of image and shape about the seen points' means; centring the shape suffices.
            let b = mixed - mean_w * mean_x.transpose() / count;
            let a = shape - mean_x * mean_x.transpose() / count + vague;
            self.vague[t] = vague;
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
        self.vague.iter_mut().for_each(|v| *v *= mean * mean);
        self.basis *= mean;
    }

    fn fit_shifts(&mut self, tracks: &Tracks) {
        for t in 0..tracks.frames() {
            let camera = self.camera(t);
            let (mut sum, mut count) = (Vector2::zeros(), 0.0);
            for (j, w) in tracks.seen_in(t) {
                sum += w - camera * self.point(t, j);
                count += 1.0;
            }
            if count > 0.0 {
                self.shift[t] = sum / count;
            }
        }
    }

    fn fit_noise(&mut self, tracks: &Tracks, floor: f64) {
        let (mut squares, mut count) = (0.0, 0.0);
        for t in 0..tracks.frames() {
            let camera = self.camera(t);
            for (j, w) in tracks.seen_in(t) {
                squares += (w - self.shift[t] - camera * self.point(t, j)).norm_squared();
                count += 2.0;
            }
            squares += camera.tr_mul(&camera).dot(&self.vague[t]);
        }
        if count > 0.0 {
            self.noise_variance = (squares / count).max(floor);
        }
    }
}
