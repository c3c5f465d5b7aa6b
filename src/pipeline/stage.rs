//! The stages by name.

/// Stages of [`super::Pipeline::follow`], in order; all but the first run once for each tracked head.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Segments heads in the depth picture.
    Segment,
    /// Head pose.
    Pose,
    /// The 68 points.
    Landmarks,
    /// Measures, ranges, weights.
    Expression,
}
