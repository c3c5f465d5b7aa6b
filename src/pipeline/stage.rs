//! The stages by name.

/// Stages of [`super::Pipeline::follow`], in order; all but the first once for each head that is followed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Heads out of the depth picture.
    Segment,
    /// Where the head is.
    Pose,
    /// The 68 points.
    Landmarks,
    /// Measures, ranges, weights.
    Expression,
}
