//! Pose, identity and expression of the mesh that best explain the 68 points of one portrait.
//!
//! Gauss–Newton on weak perspective (scale, rotation, shift) with 40 identity and all expression weights, each held by a
//! Gaussian prior (identity sigma 1, expression sigma 0.25), points in pixels weighted by how well they are defined.
//! Limitation: portraits are taken from a finite distance, which ends up in the identity as slightly narrower ears.

use nalgebra::{DMatrix, DVector, Point3, Rotation3, Vector3};

use crate::base::capacity::LANDMARKS;
use crate::simulator::virtual_head::Site;
use crate::studio::heads::ict::IctHead;

/// Standard deviation of an annotated point, metres on the face.
const POINT_SIGMA_M: f64 = 0.0015;
/// Prior of identity weights.
const IDENTITY_SIGMA: f64 = 1.0;
/// Prior of expression weights.
const EXPRESSION_SIGMA: f64 = 0.25;
/// Steps; the residual no longer changes after about eight.
const STEPS: usize = 15;

/// The mesh as it stands before one camera.
#[derive(Clone, Debug)]
pub struct PortraitFit {
    /// Pixels per metre.
    pub scale: f32,
    /// Rotation of the head.
    pub rotation: Rotation3<f32>,
    /// Pixel of the head's origin.
    pub shift: [f32; 2],
    /// Weights of the identity modes.
    pub identity: Vec<f32>,
    /// Weights of the expressions, in the order of the head's.
    pub expression: Vec<f32>,
}

impl PortraitFit {
    /// Pixel of a point of the head, and its distance behind the head's origin, metres.
    #[must_use]
    pub fn project(&self, p: &Point3<f32>) -> ([f32; 2], f32) {
        let q = self.rotation * p;
        (
            [
                self.scale * q.x + self.shift[0],
                self.scale * q.y + self.shift[1],
            ],
            q.z,
        )
    }
}

fn weight(landmark: usize) -> f64 {
    match landmark {
        0..17 => 0.3,
        17..27 => 0.6,
        _ => 1.0,
    }
}

/// How identities and expressions move the landmarks, and how far they usually go.
fn modes(ict: &IctHead, sites: &[Site], usable: &[bool]) -> Vec<(Vec<Vector3<f64>>, f64)> {
    let at = |values: &[Vector3<f32>], site: &Site| {
        let mut sum = Vector3::zeros();
        for (&v, &share) in site.vertices.iter().zip(&site.shares) {
            sum += values[v as usize].cast::<f64>() * f64::from(share);
        }
        sum
    };
    ict.identities
        .iter()
        .map(|d| (d, IDENTITY_SIGMA))
        .chain(
            ict.expressions
                .iter()
                .zip(usable)
                .map(|(d, &u)| (d, if u { EXPRESSION_SIGMA } else { 1e-6 })),
        )
        .map(|(d, sigma)| (sites.iter().map(|s| at(&d.offsets, s)).collect(), sigma))
        .collect()
}

/// Fits the mesh with its landmarks at `sites` to 68 points. Derived expressions (those of no use in a portrait) are
/// left at 0 where `usable` says so.
#[must_use]
pub fn fit(
    ict: &IctHead,
    sites: &[Site],
    points: &[[f32; 2]; LANDMARKS],
    usable: &[bool],
) -> PortraitFit {
    let base: Vec<Vector3<f64>> = sites
        .iter()
        .map(|s| s.on(&ict.neutral).coords.cast())
        .collect();
    let modes = modes(ict, sites, usable);
    let m = 6 + modes.len();
    let target = |k: usize| [f64::from(points[k][0]), f64::from(points[k][1])];
    let eyes = |k: usize| target(k);
    let mut scale =
        (eyes(45)[0] - eyes(36)[0]).hypot(eyes(45)[1] - eyes(36)[1]) / (base[45] - base[36]).norm();
    let mut rotation = Rotation3::<f64>::identity();
    let mut shift = [0, 1].map(|c| (eyes(39)[c] + eyes(42)[c]) * 0.5);
    let mut weights = DVector::<f64>::zeros(modes.len());
    for _ in 0..STEPS {
        let mut jacobian = DMatrix::zeros(2 * LANDMARKS, m);
        let mut error = DVector::zeros(2 * LANDMARKS);
        for k in 0..LANDMARKS {
            let mut p = base[k];
            for (j, (mode, _)) in modes.iter().enumerate() {
                p += mode[k] * weights[j];
            }
            let q = rotation * p;
            let w = weight(k) / (POINT_SIGMA_M * scale);
            for c in 0..2 {
                let r = target(k)[c] - (scale * q[c] + shift[c]);
                let row = 2 * k + c;
                error[row] = r * w;
                jacobian[(row, 0)] = scale * q[c] * w;
                for axis in 0..3 {
                    let mut e = Vector3::zeros();
                    e[axis] = 1.0;
                    jacobian[(row, 1 + axis)] = scale * e.cross(&q)[c] * w;
                }
                jacobian[(row, 4 + c)] = w;
                for (j, (mode, _)) in modes.iter().enumerate() {
                    jacobian[(row, 6 + j)] = scale * (rotation * mode[k])[c] * w;
                }
            }
        }
        let mut normal = jacobian.tr_mul(&jacobian);
        let mut gradient = jacobian.tr_mul(&error);
        for j in 0..6 {
            normal[(j, j)] *= 1.0 + 1e-9;
        }
        for (j, (_, sigma)) in modes.iter().enumerate() {
            normal[(6 + j, 6 + j)] += 1.0 / (sigma * sigma);
            gradient[6 + j] -= weights[j] / (sigma * sigma);
        }
        let Some(solver) = normal.cholesky() else {
            break;
        };
        let delta = solver.solve(&gradient);
        scale *= delta[0].clamp(-0.3, 0.3).exp();
        rotation = Rotation3::new(Vector3::new(delta[1], delta[2], delta[3])) * rotation;
        shift[0] += delta[4];
        shift[1] += delta[5];
        weights += delta.rows(6, modes.len());
    }
    let identities = ict.identities.len();
    PortraitFit {
        scale: scale as f32,
        rotation: rotation.cast(),
        shift: shift.map(|v| v as f32),
        identity: weights.iter().take(identities).map(|&w| w as f32).collect(),
        expression: weights.iter().skip(identities).map(|&w| w as f32).collect(),
    }
}
