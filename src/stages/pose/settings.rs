//! Settings and result of the pose stage.

use super::smoothing::Smoothing;
use crate::base::defaults;
use crate::base::frames::SensorFromHead;

/// A head pose and its confidence.
#[derive(Clone, Copy, Debug)]
pub struct HeadPose {
    /// Head frame to sensor frame, metres.
    pub sensor_from_head: SensorFromHead,
    /// 0…1: share of the evidence that fits.
    pub confidence: f32,
    /// Share of the middle of the face, or of the nose if less, covered by the cloud, 0…1; 1 with the paper's method, which does not
    /// compute it.
    pub coverage: f32,
    /// Whether depth alone confirms it; otherwise it holds only if a face is seen there ([`super::Evidence`]).
    pub proven: bool,
}

/// Pose estimation method.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Method {
    /// The paper's: point-to-point, frame to frame, anchored.
    Paper,
    /// Point-to-plane against the learned head; without depth, by the image.
    #[default]
    Plane,
    /// By the image alone, even if there is depth.
    Image,
}

defaults! {
    /// Settings of the pose stage.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct Settings {
        /// Method.
        pub method: Method = Method::default(),
        /// Temporal filter.
        pub smoothing: Smoothing = Smoothing::default(),
        /// Below this agreement (0…1) the head counts as lost.
        pub min_agreement: f32 = 0.45,
        /// Whether size and shape of the user's head are learned (plane method).
        pub learn_shape: bool = true,
        /// Frames of [`Smoothing::Window`].
        pub window_frames: u32 = WINDOW_FRAMES,
        /// Most iterations of an alignment (paper's method).
        pub rounds: u32 = 400,
    }
}

/// Default length of the window, frames.
pub const WINDOW_FRAMES: u32 = 5;
