//! Rigid motions typed by their source and target frames, so that a swapped or inverted one does not compile.
//!
//! | frame | what it is |
//! | --- | --- |
//! | [`Sensor`] | the depth camera's ([`super::geometry`]) |
//! | [`Head`] | the standard head's, as depth aligns it with the cloud |
//! | [`Face`] | the face's own: the head's, turned and shifted to where the picture shows the face. Outputs call this the head |
//!
//! `SensorFromHead * HeadFromFace` is a `SensorFromFace`; nothing else is. A motion dereferences to its plain [`Rigid`] for
//! reading.

use core::borrow::Borrow;
use core::marker::PhantomData;
use core::ops::{Deref, Mul};

use super::geometry::{Point, Rigid, Rotation};
use nalgebra::Translation3;

/// The depth camera's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Sensor {}
/// The standard head's frame, as depth sees the head.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Head {}
/// The face's frame, as the picture shows it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Face {}

/// A rigid motion that takes coordinates in the frame `From` to coordinates in the frame `To`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion<To, From>(Rigid, PhantomData<fn(From) -> To>);

/// Where the head is, as depth sees it.
pub type SensorFromHead = Motion<Sensor, Head>;
/// The same, the other way round.
pub type HeadFromSensor = Motion<Head, Sensor>;
/// Where the face is.
pub type SensorFromFace = Motion<Sensor, Face>;
/// How the face sits in the head: a constant of the person.
pub type HeadFromFace = Motion<Head, Face>;

impl<To, From> Motion<To, From> {
    /// Says between which frames a plain motion leads: the one place where that is claimed and not derived.
    pub const fn of(motion: Rigid) -> Self {
        Self(motion, PhantomData)
    }

    /// From a shift and a turn, the turn first.
    pub fn from_parts(shift: impl Into<Translation3<f32>>, turn: Rotation) -> Self {
        Self::of(Rigid::from_parts(shift.into(), turn))
    }

    /// Both frames lie upon each other.
    pub fn identity() -> Self {
        Self::of(Rigid::identity())
    }

    /// The motion back.
    pub fn inverse(&self) -> Motion<From, To> {
        Motion::of(self.0.inverse())
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
        Motion::of(self.0 * other.0)
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
/// use mien::base::frames::{HeadFromFace, SensorFromFace, SensorFromHead};
/// let (pose, sits) = (SensorFromHead::identity(), HeadFromFace::identity());
/// let face: SensorFromFace = pose * sits.inverse();
/// ```
///
/// ```
/// use mien::base::frames::{HeadFromFace, SensorFromFace, SensorFromHead};
/// let (pose, sits) = (SensorFromHead::identity(), HeadFromFace::identity());
/// let face: SensorFromFace = pose * sits;
/// let back: SensorFromHead = face * sits.inverse();
/// ```
#[cfg(doctest)]
pub struct DoesNotCompile;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::geometry::Vector;

    #[test]
    fn composition_and_inverse_are_those_of_plain_motions() {
        let rigid =
            |x: f32, turn: f32| Rigid::new(Vector::new(x, 0.1, 0.7), Vector::new(0.0, turn, 0.1));
        let (pose, sits) = (
            SensorFromHead::of(rigid(0.2, 0.3)),
            HeadFromFace::of(rigid(0.0, -0.1)),
        );
        let point = Point::new(0.01, 0.02, 0.03);
        assert_eq!(*(pose * sits), rigid(0.2, 0.3) * rigid(0.0, -0.1));
        assert_eq!(pose * point, rigid(0.2, 0.3) * point);
        assert!(((pose * pose.inverse()) * point - point).norm() < 1e-6);
    }
}
