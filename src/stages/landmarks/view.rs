//! Projection of a 3D shape into the head window: a scaled perspective view with six parameters.
//!
//! `w = shift + e^log_scale (R X)_xy / (1 + q (R X)_z)` with `X` in metres (head frame), `w` in window pixels and `q` the
//! inverse distance of the head in 1/m: unlike weak perspective (`q = 0`) it keeps the effect of distance, because at half a
//! metre the nose is a fifth nearer than the ears. `q` is known from depth and not fitted.
//! Degenerate: points behind the camera (`1 + q z <= 0.2`) are projected as if at that limit.

use crate::base::geometry::{Point, Rotation, Vector};
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;
use crate::face_model::VIEW_PARAMETERS;

/// Unit of each view parameter: log scale, rotation (3, radians), shift (2, window pixels).
pub const UNITS: [f32; VIEW_PARAMETERS] = [0.05, 0.1, 0.1, 0.1, 5.0, 5.0];

/// A view of a shape in window pixels.
#[derive(Clone, Copy, Debug)]
pub struct View {
    /// Natural logarithm of window pixels per metre.
    pub log_scale: f32,
    /// Head frame to window axes (x right, y down, z away).
    pub rotation: Rotation,
    /// Projection of the head's origin, window pixels.
    pub shift: [f32; 2],
    /// Inverse of the head's distance, 1/m.
    pub inverse_distance: f32,
}

impl View {
    /// Window pixel of a point in the head frame, metres.
    pub fn project(&self, point: &Point) -> [f32; 2] {
        self.projection()(point)
    }

    /// [`Self::project`] as a function, for many points.
    pub fn projection(&self) -> impl Fn(&Point) -> [f32; 2] {
        let (turn, scale) = (self.rotation.to_rotation_matrix(), self.log_scale.exp());
        let (shift, inverse_distance) = (self.shift, self.inverse_distance);
        move |point| {
            let turned = turn * point;
            let scale = scale / (1.0 + inverse_distance * turned.z).max(0.2);
            [shift[0] + scale * turned.x, shift[1] + scale * turned.y]
        }
    }

    /// The view changed by `step` in [`UNITS`]; the rotation is applied after the present one.
    pub fn moved(&self, step: &[f32]) -> Self {
        Self {
            log_scale: self.log_scale + step[0] * UNITS[0],
            rotation: Rotation::from_scaled_axis(Vector::new(
                step[1] * UNITS[1],
                step[2] * UNITS[2],
                step[3] * UNITS[3],
            )) * self.rotation,
            shift: [
                self.shift[0] + step[4] * UNITS[4],
                self.shift[1] + step[5] * UNITS[5],
            ],
            inverse_distance: self.inverse_distance,
        }
    }

    /// The step that takes `from` to `self`, in [`UNITS`].
    pub fn step_from(&self, from: &Self) -> [f32; VIEW_PARAMETERS] {
        let turn = (self.rotation * from.rotation.inverse()).scaled_axis();
        [
            (self.log_scale - from.log_scale) / UNITS[0],
            turn.x / UNITS[1],
            turn.y / UNITS[2],
            turn.z / UNITS[3],
            (self.shift[0] - from.shift[0]) / UNITS[4],
            (self.shift[1] - from.shift[1]) / UNITS[5],
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn step_from_inverts_moved() {
        let view = View {
            log_scale: 6.5,
            rotation: crate::base::geometry::rotation_from_yaw_pitch_roll(0.3, -0.2, 0.05),
            shift: [90.0, 70.0],
            inverse_distance: 1.4,
        };
        let step = [0.5, -0.3, 1.1, 0.4, 2.0, -1.5];
        for (a, b) in view.moved(&step).step_from(&view).iter().zip(step) {
            assert!((a - b).abs() < 1e-4, "{a} {b}");
        }
    }
}
