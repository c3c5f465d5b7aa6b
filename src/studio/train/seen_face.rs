//! A face that was followed in a recording, as the paper's model of one person learns from it.

use super::samples::TruePicture;

/// A frame that teaches.
pub(super) struct Seen {
    /// Its surroundings of the face, with the points.
    pub(super) picture: TruePicture,
    /// The points, colour pixels.
    pub(super) points: [[f64; 2]; crate::base::capacity::LANDMARKS],
    /// The points in the head frame.
    pub(super) head: [crate::base::geometry::Point; crate::base::capacity::LANDMARKS],
}
