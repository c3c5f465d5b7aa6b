//! Points, poses and the two coordinate frames. Metres, radians, right-handed.
//!
//! ```text
//! depth-camera frame ("sensor")            head frame
//!   origin: the depth camera                 origin: midway between the inner eye corners
//!   x right in the image                     x to the image right of a frontal face (the subject's left)
//!   y down                                   y down, to the chin
//!   z forward, away from the camera          z into the head
//! ```
//! A frontal, upright face has `sensor_from_head` = identity rotation: the axes of both frames agree.
//! Yaw is the rotation about y, pitch about x, roll about z. Names read `b_from_a`: `p_b = b_from_a * p_a`.

#[cfg(not(feature = "std"))]
use crate::base::prelude::*;
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};

/// A point in metres.
pub type Point = Point3<f32>;
/// A direction or displacement in metres.
pub type Vector = Vector3<f32>;
/// A rigid motion; values are named `b_from_a`.
pub type Rigid = Isometry3<f32>;
/// A rotation.
pub type Rotation = UnitQuaternion<f32>;

/// Rotation of a head turned by yaw (about y), then pitch (about x), then roll (about z), in radians:
/// `R = Ry(yaw) Rx(pitch) Rz(roll)`. Positive yaw turns the nose (which points to −z) to −x, the image left.
pub fn rotation_from_yaw_pitch_roll(yaw: f32, pitch: f32, roll: f32) -> Rotation {
    Rotation::from_axis_angle(&Vector::y_axis(), yaw)
        * Rotation::from_axis_angle(&Vector::x_axis(), pitch)
        * Rotation::from_axis_angle(&Vector::z_axis(), roll)
}

/// Inverse of [`rotation_from_yaw_pitch_roll`], for |pitch| < 90°: `(yaw, pitch, roll)` in radians.
pub fn yaw_pitch_roll(rotation: &Rotation) -> (f32, f32, f32) {
    let m = rotation.to_rotation_matrix();
    let yaw = m[(0, 2)].atan2(m[(2, 2)]);
    let pitch = (-m[(1, 2)]).clamp(-1.0, 1.0).asin();
    let roll = m[(1, 0)].atan2(m[(1, 1)]);
    (yaw, pitch, roll)
}

/// Unit vector from the face outwards, in the sensor frame: the head's −z axis. Facing the sensor it is (0, 0, −1).
pub fn face_normal(sensor_from_head: &Rigid) -> Vector {
    sensor_from_head.rotation * Vector::new(0.0, 0.0, -1.0)
}

/// Mean of points, summed in f64; the origin if there are none.
pub(crate) fn mean(points: impl Iterator<Item = Point>) -> Point {
    let (sum, count) = points.fold((nalgebra::Vector3::<f64>::zeros(), 0.0f64), |(s, n), p| {
        (s + p.coords.cast::<f64>(), n + 1.0)
    });
    Point::from((sum / count.max(1.0)).cast::<f32>())
}

/// Smooth cubic step from 0 at `from` to 1 at `to` (which may be smaller), constant beyond.
pub fn smoothstep<T: nalgebra::RealField + Copy>(from: T, to: T, x: T) -> T {
    let t = ((x - from) / (to - from)).clamp(T::zero(), T::one());
    t * t * (nalgebra::convert::<f64, T>(3.0) - nalgebra::convert::<f64, T>(2.0) * t)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_survive_the_round_trip() {
        for (yaw, pitch, roll) in [(0.3, -0.2, 0.1), (-0.6, 0.4, -0.3), (0.0, 0.0, 0.0)] {
            let (y, p, r) = yaw_pitch_roll(&rotation_from_yaw_pitch_roll(yaw, pitch, roll));
            assert!((y - yaw).abs() < 1e-6 && (p - pitch).abs() < 1e-6 && (r - roll).abs() < 1e-6);
        }
    }

    #[test]
    fn positive_yaw_turns_the_nose_to_image_left() {
        let pose = Rigid::from_parts(
            nalgebra::Translation3::identity(),
            rotation_from_yaw_pitch_roll(0.3, 0.0, 0.0),
        );
        assert!(face_normal(&pose).x < 0.0);
    }
}
