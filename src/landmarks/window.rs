//! The head window: the face resampled upright and at a fixed scale from the whole colour picture.
//!
//! The depth pose says where the head's origin appears ([`Camera::colour_pixel`]) and how colour pixels move with metres
//! there (2×3 Jacobian by central differences). The Jacobian splits into a camera that looks straight at the head and a 2×2
//! map, so a head at the edge of the picture appears as if it were in the middle. Roll is taken out of the rotation and
//! put into that map. Pixels, metres, radians. One bilinear look-up per window pixel, 34 k in all.
//! Degenerate: a Jacobian without rank (head at the camera) gives no placement. Outside the picture its edge is repeated.

use nalgebra::{Matrix2, Vector2};

use super::view::View;
use crate::capacity::{HEIGHT, WIDTH};
use crate::geometry::{Point, Rigid, Rotation, Vector};
use crate::sensor::camera::Camera;

/// Side of the window, pixels.
pub const WINDOW: usize = 184;
/// Window pixels per metre: a face 0.145 m wide is 100 px.
pub const PIXELS_PER_METRE: f32 = 690.0;
/// Where the head's origin appears, window pixels: brows to chin fit with an open jaw and 20° of pitch.
pub const ORIGIN: [f32; 2] = [91.5, 66.0];
/// Half the base of the central differences, metres: about an eye's distance, so that table steps do not matter.
const DIFFERENCE: f32 = 0.03;

/// A grey picture to cut windows from.
#[derive(Clone, Copy)]
pub struct Picture<'a> {
    /// Luma, row by row.
    pub luma: &'a [u8],
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

impl Picture<'_> {
    /// Bilinear value; beyond the border the border's own.
    #[must_use]
    pub fn at(&self, x: f32, y: f32) -> f32 {
        let x = x.clamp(0.0, (self.width - 1) as f32 - 1e-3);
        let y = y.clamp(0.0, (self.height - 1) as f32 - 1e-3);
        let (column, row) = (x as usize, y as usize);
        let (fx, fy) = (x - column as f32, y - row as f32);
        let at = row * self.width + column;
        let value = |at: usize| f32::from(self.luma[at]);
        let top = value(at) * (1.0 - fx) + value(at + 1) * fx;
        let bottom = value(at + self.width) * (1.0 - fx) + value(at + self.width + 1) * fx;
        top * (1.0 - fy) + bottom * fy
    }
}

/// Where a window lies in a picture.
#[derive(Clone, Copy, Debug)]
pub struct Placement {
    /// Picture pixel of the window's [`ORIGIN`].
    pub centre: Vector2<f32>,
    /// Picture pixels per window pixel.
    pub picture_from_window: Matrix2<f32>,
    /// The view in the window that the depth pose says: upright, at [`PIXELS_PER_METRE`], origin at [`ORIGIN`].
    pub start: View,
}

impl Placement {
    /// From the depth pose; `None` if the head is where the colour camera sees nothing.
    #[must_use]
    pub fn of_pose(camera: &Camera, sensor_from_head: &Rigid) -> Option<Self> {
        let origin = sensor_from_head * Point::origin();
        let slope = |axis: Vector| {
            let [x1, y1] = camera.colour_pixel(&(origin + axis * DIFFERENCE));
            let [x0, y0] = camera.colour_pixel(&(origin - axis * DIFFERENCE));
            Vector2::new(x1 - x0, y1 - y0) / (2.0 * DIFFERENCE)
        };
        let (dx, dy, dz) = (slope(Vector::x()), slope(Vector::y()), slope(Vector::z()));
        let rows = [
            Vector::new(dx.x, dy.x, dz.x),
            Vector::new(dx.y, dy.y, dz.y),
        ];
        let ray = rows[0].cross(&rows[1]).try_normalize(1e-3)?;
        let right = rows[0].try_normalize(1e-3)?;
        let down = ray.cross(&right);
        let picture_from_view = Matrix2::new(
            rows[0].dot(&right),
            rows[0].dot(&down),
            rows[1].dot(&right),
            rows[1].dot(&down),
        );
        let view_from_sensor = Rotation::from_rotation_matrix(
            &nalgebra::Rotation3::from_matrix_unchecked(nalgebra::Matrix3::from_rows(&[
                right.transpose(),
                down.transpose(),
                ray.transpose(),
            ])),
        );
        let [x, y] = camera.colour_pixel(&origin);
        let valid = x.is_finite() && y.is_finite() && picture_from_view.determinant() > 1.0;
        valid.then(|| {
            Self::of_view(
                Vector2::new(x, y),
                picture_from_view,
                view_from_sensor * sensor_from_head.rotation,
                1.0 / origin.coords.norm().max(0.1),
            )
        })
    }

    /// From a camera that looks straight at the head: picture pixel of the head's origin, picture pixels per metre as a
    /// 2×2 map, rotation of the head as that camera sees it, inverse distance in 1/m.
    #[must_use]
    pub fn of_view(
        centre: Vector2<f32>,
        pixels_per_metre: Matrix2<f32>,
        rotation: Rotation,
        inverse_distance: f32,
    ) -> Self {
        let down = rotation * Vector::y();
        let roll = (-down.x).atan2(down.y);
        let (sin, cos) = roll.sin_cos();
        Self {
            centre,
            picture_from_window: pixels_per_metre * Matrix2::new(cos, -sin, sin, cos)
                / PIXELS_PER_METRE,
            start: View {
                log_scale: PIXELS_PER_METRE.ln(),
                rotation: Rotation::from_axis_angle(&Vector::z_axis(), -roll) * rotation,
                shift: ORIGIN,
                inverse_distance,
            },
        }
    }

    /// Window pixel to picture pixel.
    #[must_use]
    pub fn picture_pixel(&self, window: [f32; 2]) -> [f32; 2] {
        let p = self.centre
            + self.picture_from_window
                * Vector2::new(window[0] - ORIGIN[0], window[1] - ORIGIN[1]);
        [p.x, p.y]
    }

    /// Picture pixel to window pixel.
    #[must_use]
    pub fn window_pixel(&self, picture: [f32; 2]) -> [f32; 2] {
        let inverse = self
            .picture_from_window
            .try_inverse()
            .unwrap_or_else(Matrix2::identity);
        let w = inverse * (Vector2::from(picture) - self.centre);
        [w.x + ORIGIN[0], w.y + ORIGIN[1]]
    }

    /// Resamples the window, row by row.
    pub fn resample(&self, picture: &Picture, window: &mut [f32]) {
        for (row, line) in window.chunks_exact_mut(WINDOW).take(WINDOW).enumerate() {
            let [mut x, mut y] = self.picture_pixel([0.0, row as f32]);
            let step = self.picture_from_window.column(0);
            for value in line {
                *value = picture.at(x, y);
                x += step.x;
                y += step.y;
            }
        }
    }
}

/// The whole colour picture of the sensor as a [`Picture`].
#[must_use]
pub fn sensor_picture(luma: &[u8; crate::capacity::PIXELS]) -> Picture<'_> {
    Picture {
        luma,
        width: WIDTH,
        height: HEIGHT,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::rotation_from_yaw_pitch_roll;

    #[test]
    fn the_window_shows_the_points_where_the_camera_does() {
        let camera = Camera::nominal();
        for (x, y, z, yaw, roll) in [
            (0.0, 0.0, 0.8, 0.0, 0.0),
            (0.2, -0.1, 0.9, 0.3, 0.4),
            (-0.25, 0.15, 1.2, -0.3, -0.3),
        ] {
            let pose = Rigid::from_parts(
                nalgebra::Translation3::new(x, y, z),
                rotation_from_yaw_pitch_roll(yaw, 0.1, roll),
            );
            let placement = Placement::of_pose(&camera, &pose).expect("in view");
            for point in [
                Point::new(0.045, 0.0, 0.01),
                Point::new(-0.045, 0.0, 0.01),
                Point::new(0.0, 0.1, 0.0),
                Point::new(0.0, 0.04, -0.03),
            ] {
                let seen = camera.colour_pixel(&(pose * point));
                let said = placement.picture_pixel(placement.start.project(&point));
                let off = (seen[0] - said[0]).hypot(seen[1] - said[1]);
                assert!(off < 0.8, "{seen:?} {said:?} at {x} {y} {z}");
            }
        }
    }

    #[test]
    fn the_window_is_upright() {
        let pose = Rigid::from_parts(
            nalgebra::Translation3::new(0.1, 0.0, 0.8),
            rotation_from_yaw_pitch_roll(0.2, 0.1, 0.5),
        );
        let placement = Placement::of_pose(&Camera::nominal(), &pose).expect("in view");
        let down = placement.start.rotation * Vector::y();
        assert!(down.x.abs() < 1e-5 && down.y > 0.9);
    }
}
