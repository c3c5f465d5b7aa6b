//! Pose, identity and expression of the mesh that best explain the 68 points of one portrait.
//!
//! Gauss–Newton on weak perspective (scale, rotation, shift) with 40 identity and all expression weights, each held by a
//! Gaussian prior (identity sigma 1, expression sigma 0.25), points in pixels weighted by how well they are defined.
//! Limitation: portraits are taken from a finite distance, which ends up in the identity as slightly narrower ears.

use nalgebra::{DMatrix, DVector, Point3, Rotation3, Vector3};

use crate::heads::ict::IctHead;
use mien_simulator::virtual_head::{Points, Site};
use mien_stages::base::capacity::LANDMARKS;

/// Standard deviation of an annotated point, metres on the face.
const POINT_SIGMA_M: f64 = 0.0015;
/// Prior of identity weights.
const IDENTITY_SIGMA: f64 = 1.0;
/// Prior of expression weights.
const EXPRESSION_SIGMA: f64 = 0.25;
/// Steps; the residual no longer changes after about eight.
const STEPS: usize = 15;

/// Pose and weights of the mesh in one portrait.
pub struct PortraitFit {
    /// Pixels per metre.
    pub scale: f64,
    /// Rotation of the head.
    pub rotation: Rotation3<f64>,
    /// Pixel of the head's origin.
    shift: [f64; 2],
    /// Weights of the identity modes, then of the expressions.
    pub weights: DVector<f64>,
}

fn weight(landmark: usize) -> f64 {
    match landmark {
        0..17 => 0.3,
        17..27 => 0.6,
        _ => 1.0,
    }
}

/// Displacement of each landmark by a mode, and the mode's standard deviation.
type Mode = (Vec<Vector3<f64>>, f64);

/// Modes of identity, then of expression.
fn modes(ict: &IctHead, sites: &[Site]) -> Vec<Mode> {
    let at = |offsets: &[Vector3<f32>], site: &Site| site.mix(|v| offsets[v as usize]).cast();
    let identities = ict.identities.iter().map(|d| (d, IDENTITY_SIGMA));
    let expressions = ict.expressions.iter().map(|d| (d, EXPRESSION_SIGMA));
    let all = identities.chain(expressions);
    all.map(|(d, sigma)| (sites.iter().map(|s| at(&d.offsets, s)).collect(), sigma))
        .collect()
}

impl PortraitFit {
    /// Pixel of a point of the head, and its distance behind the head's origin, metres.
    pub fn project(&self, p: &Point3<f32>) -> ([f32; 2], f32) {
        let q = self.rotation.cast::<f32>() * p;
        let pixel = [0, 1].map(|k| self.scale as f32 * q[k] + self.shift[k] as f32);
        (pixel, q.z)
    }

    /// Frontal start with the eye corners aligned.
    fn upright(base: &[Vector3<f64>], points: &[[f64; 2]; LANDMARKS], modes: usize) -> Self {
        let [a, b] = [points[36], points[45]];
        Self {
            scale: (b[0] - a[0]).hypot(b[1] - a[1]) / (base[45] - base[36]).norm(),
            rotation: Rotation3::identity(),
            shift: [0, 1].map(|c| (points[39][c] + points[42][c]) * 0.5),
            weights: DVector::zeros(modes),
        }
    }

    /// Jacobian of the projected points by log scale, rotation, shift and weights, and the residuals, in standard
    /// deviations.
    fn linearised(
        &self,
        base: &[Vector3<f64>],
        points: &[[f64; 2]; LANDMARKS],
        modes: &[Mode],
    ) -> (DMatrix<f64>, DVector<f64>) {
        let (scale, rotation) = (self.scale, self.rotation);
        let mut jacobian = DMatrix::zeros(2 * LANDMARKS, 6 + modes.len());
        let mut error = DVector::zeros(2 * LANDMARKS);
        for k in 0..LANDMARKS {
            let mut p = base[k];
            for (j, (mode, _)) in modes.iter().enumerate() {
                p += mode[k] * self.weights[j];
            }
            let q = rotation * p;
            let w = weight(k) / (POINT_SIGMA_M * scale);
            for c in 0..2 {
                let row = 2 * k + c;
                error[row] = (points[k][c] - (scale * q[c] + self.shift[c])) * w;
                jacobian[(row, 0)] = scale * q[c] * w;
                for axis in 0..3 {
                    let e = Vector3::ith(axis, 1.0);
                    jacobian[(row, 1 + axis)] = scale * e.cross(&q)[c] * w;
                }
                jacobian[(row, 4 + c)] = w;
                for (j, (mode, _)) in modes.iter().enumerate() {
                    jacobian[(row, 6 + j)] = scale * (rotation * mode[k])[c] * w;
                }
            }
        }
        (jacobian, error)
    }
}

/// Fits the mesh with its landmarks at `sites` to 68 points.
pub fn fit(ict: &IctHead, sites: &[Site], points: &Points) -> PortraitFit {
    let base = sites.iter().map(|s| s.position(&ict.neutral).coords.cast());
    let base: Vec<Vector3<f64>> = base.collect();
    let modes = modes(ict, sites);
    let points = points.map(|p| p.map(f64::from));
    let mut fit = PortraitFit::upright(&base, &points, modes.len());
    for _ in 0..STEPS {
        let (jacobian, error) = fit.linearised(&base, &points, &modes);
        let mut normal = jacobian.tr_mul(&jacobian);
        let mut gradient = jacobian.tr_mul(&error);
        for j in 0..6 {
            normal[(j, j)] *= 1.0 + 1e-9;
        }
        for (j, (_, sigma)) in modes.iter().enumerate() {
            normal[(6 + j, 6 + j)] += 1.0 / (sigma * sigma);
            gradient[6 + j] -= fit.weights[j] / (sigma * sigma);
        }
        let Some(solver) = normal.cholesky() else {
            break;
        };
        let delta = solver.solve(&gradient);
        fit.scale *= delta[0].clamp(-0.3, 0.3).exp();
        let turn = Rotation3::new(Vector3::new(delta[1], delta[2], delta[3]));
        fit.rotation = turn * fit.rotation;
        fit.shift[0] += delta[4];
        fit.shift[1] += delta[5];
        fit.weights += delta.rows(6, modes.len());
    }
    fit
}
