//! Names of the stages, and the data of a frame that they share.

use mien_sensors::Frame;
use mien_stages::camera::Camera;
use mien_stages::landmarks::Scratch;

/// Stages of [`super::Pipeline::follow`], in order; all but the first run once for each tracked head.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Segmentation of heads in the depth image.
    Segment,
    /// Head pose.
    Pose,
    /// 68 landmarks.
    Landmarks,
    /// Measures, their ranges, and unit weights.
    Expression,
}

/// A frame and the resources for processing it.
pub(super) struct FrameContext<'a> {
    pub(super) frame: &'a Frame,
    pub(super) camera: &'a Camera,
    pub(super) scratch: &'a mut Scratch,
    /// Halves of an initial pose search that this frame may still run.
    pub(super) search_budget: u32,
    /// Called after each stage.
    pub(super) stage_done: &'a mut dyn FnMut(Stage),
}
