//! The stages by name, and what they share of a frame.

use mien_sensors::Frame;
use mien_stages::camera::Camera;
use mien_stages::landmarks::Scratch;

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

/// A frame on its way through the stages.
pub(super) struct Now<'a> {
    pub(super) frame: &'a Frame,
    pub(super) camera: &'a Camera,
    pub(super) scratch: &'a mut Scratch,
    /// Halves of a search that this frame has time for.
    pub(super) searches: u32,
    /// Called at the end of each stage reached.
    pub(super) after: &'a mut dyn FnMut(Stage),
}
