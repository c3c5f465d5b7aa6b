//! The similarity between two sets of 68 points (Umeyama 1991).

use mien_stages::base::capacity::LANDMARKS;
use mien_stages::base::geometry::{Point, Vector};
use mien_stages::face_model::scheme;
use nalgebra::{Matrix3, Rotation3};

/// A similarity: `p -> translation + scale * rotation * p`.
pub struct Similarity {
    /// Size ratio.
    pub scale: f32,
    /// Rotation.
    pub rotation: Rotation3<f32>,
    /// Translation, metres.
    pub translation: Vector,
}

impl Similarity {
    /// The similarity that best maps the stable points of `from` to those of `to`, least squares.
    pub fn between(from: &[Point; LANDMARKS], to: &[Point; LANDMARKS]) -> Self {
        let mean = |f: &[Point; LANDMARKS]| {
            let stable = scheme::STABLE.iter();
            stable.fold(Vector::zeros(), |sum, &i| sum + f[i].coords) / scheme::STABLE.len() as f32
        };
        let (a_mean, b_mean) = (mean(from), mean(to));
        let mut covariance = Matrix3::zeros();
        let mut spread = 1e-12;
        for &i in &scheme::STABLE {
            let (a, b) = (from[i].coords - a_mean, to[i].coords - b_mean);
            covariance += b * a.transpose();
            spread += a.norm_squared();
        }
        let svd = covariance.svd(true, true);
        let [u, v_t] = [svd.u, svd.v_t].map(|turn| turn.unwrap_or_else(Matrix3::identity));
        let sign = (u.determinant() * v_t.determinant()).signum();
        let flip = Matrix3::from_diagonal(&Vector::new(1.0, 1.0, sign));
        let rotation = Rotation3::from_matrix_unchecked(u * flip * v_t);
        let scale = (Matrix3::from_diagonal(&svd.singular_values) * flip).trace() / spread;
        Self {
            scale,
            rotation,
            translation: b_mean - rotation * a_mean * scale,
        }
    }

    /// The transformed point.
    pub fn applied(&self, p: &Point) -> Point {
        Point::from(self.rotation * p.coords * self.scale + self.translation)
    }
}
