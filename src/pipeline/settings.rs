//! Settings of the stages.

use crate::{expression, landmarks, pose, segment, users};

/// The settings of every stage, each in its own type.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Settings {
    /// Head segmentation.
    pub segment: segment::Settings,
    /// Head pose.
    pub pose: pose::Settings,
    /// Landmarks.
    pub landmarks: landmarks::StageSettings,
    /// Learning of ranges.
    pub learning: expression::Settings,
    /// Which people are tracked, and what happens when a face is lost.
    pub users: users::Settings,
}
