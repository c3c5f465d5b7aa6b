//! Rigid motions typed by their source and target frames, so that a swapped or inverted one does not compile.
//!
//! | frame | meaning |
//! | --- | --- |
//! | [`Sensor`] | the depth camera's ([`super::geometry`]) |
//! | [`Head`] | the standard head's, aligned with the cloud by depth |
//! | [`Face`] | the face's, as the image shows it: a rotated and shifted head frame. Outputs call this the head |
//!
//! `SensorFromHead * HeadFromFace` is a `SensorFromFace`. A motion dereferences to its plain [`Rigid`].

use core::borrow::Borrow;
use core::marker::PhantomData;
use core::ops::{Deref, Mul};

use super::geometry::{Point, Rigid, Rotation};
use nalgebra::Translation3;

/// The depth camera's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Sensor {}
/// The standard head's frame, aligned by depth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Head {}
/// The face's frame, aligned by the image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Face {}

/// A rigid motion that takes coordinates in the frame `From` to coordinates in the frame `To`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion<To, From>(Rigid, PhantomData<fn(From) -> To>);

/// Pose of the head by depth.
pub type SensorFromHead = Motion<Sensor, Head>;
/// Inverse of [`SensorFromHead`].
pub type HeadFromSensor = Motion<Head, Sensor>;
/// Pose of the face.
pub type SensorFromFace = Motion<Sensor, Face>;
/// Pose of the face within the head: a constant of the person.
pub type HeadFromFace = Motion<Head, Face>;

impl<To, From> Motion<To, From> {
    /// Declares the frames of a plain motion, unchecked; every other function derives them.
    pub const fn assume_frames(motion: Rigid) -> Self {
        Self(motion, PhantomData)
    }

    /// From a translation (metres) and a rotation, which is applied first.
    pub fn from_parts(shift: impl Into<Translation3<f32>>, turn: Rotation) -> Self {
        Self::assume_frames(Rigid::from_parts(shift.into(), turn))
    }

    /// The identity: both frames coincide.
    pub fn identity() -> Self {
        Self::assume_frames(Rigid::identity())
    }

    /// The inverse motion.
    pub fn inverse(&self) -> Motion<From, To> {
        Motion::assume_frames(self.0.inverse())
    }
}

impl<To, From> Deref for Motion<To, From> {
    type Target = Rigid;

    fn deref(&self) -> &Rigid {
        &self.0
    }
}

impl<A, B, C> Mul<Motion<B, C>> for Motion<A, B> {
    type Output = Motion<A, C>;

    fn mul(self, other: Motion<B, C>) -> Motion<A, C> {
        Motion::assume_frames(self.0 * other.0)
    }
}

impl<To, From, P: Borrow<Point>> Mul<P> for Motion<To, From> {
    type Output = Point;

    fn mul(self, point: P) -> Point {
        self.0 * point.borrow()
    }
}

impl<To, From, P: Borrow<Point>> Mul<P> for &Motion<To, From> {
    type Output = Point;

    fn mul(self, point: P) -> Point {
        self.0 * point.borrow()
    }
}

/// A swapped or inverted motion does not compile:
///
/// ```compile_fail,E0308
/// use mien_stages::base::frames::{HeadFromFace, SensorFromFace, SensorFromHead};
/// let (pose, head_from_face) = (SensorFromHead::identity(), HeadFromFace::identity());
/// let face: SensorFromFace = pose * head_from_face.inverse();
/// ```
///
/// ```
/// use mien_stages::base::frames::{HeadFromFace, SensorFromFace, SensorFromHead};
/// let (pose, head_from_face) = (SensorFromHead::identity(), HeadFromFace::identity());
/// let face: SensorFromFace = pose * head_from_face;
/// let back: SensorFromHead = face * head_from_face.inverse();
/// ```
#[cfg(doctest)]
pub struct DoesNotCompile;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::geometry::Vector;

    #[test]
    fn composition_and_inverse_equal_plain_motions() {
        let rigid =
            |x: f32, turn: f32| Rigid::new(Vector::new(x, 0.1, 0.7), Vector::new(0.0, turn, 0.1));
        let (pose, head_from_face) = (
            SensorFromHead::assume_frames(rigid(0.2, 0.3)),
            HeadFromFace::assume_frames(rigid(0.0, -0.1)),
        );
        let point = Point::new(0.01, 0.02, 0.03);
        assert_eq!(*(pose * head_from_face), rigid(0.2, 0.3) * rigid(0.0, -0.1));
        assert_eq!(pose * point, rigid(0.2, 0.3) * point);
        assert!(((pose * pose.inverse()) * point - point).norm() < 1e-6);
    }
}
