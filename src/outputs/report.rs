//! The input of every output: one user at one frame.

use mien_stages::base::capacity::REGIONS;
use mien_stages::base::geometry::Rigid;
use mien_stages::base::time::Timestamp;
use mien_stages::expression::UnitRange;
use mien_stages::landmarks::Landmarks;
use mien_stages::segment::PixelRect;
use mien_stages::users::TrackingState;

/// Version of the order and meaning of units in outputs; incremented when an index changes its meaning.
pub const SCHEMA_VERSION: i32 = 1;

/// Everything known about one user at one frame, borrowed by the outputs.
#[derive(Clone, Copy, Debug, Default)]
pub struct Report<'a> {
    /// Number of the frame ([`mien_stages::frame::Frame::index`]).
    pub frame: u64,
    /// Capture time of the frame.
    pub at: Timestamp,
    /// Slot of the user, below [`mien_stages::base::capacity::USERS`]; `None` if nobody is there.
    pub user: Option<usize>,
    /// State of the user; [`TrackingState::Absent`] with a slot is reported once, when the user is forgotten.
    pub state: TrackingState,
    /// Whether this user is gone and nobody else is reported for this frame.
    pub none_left: bool,
    /// Whether single-person outputs show another user.
    pub other_is_shown: bool,
    /// Confidence of the face, or of the pose if there is no face; 0…1.
    pub confidence: f32,
    /// Whether learning is frozen for this user.
    pub frozen: bool,
    /// Pose of the face; `None` when lost or absent.
    pub sensor_from_face: Option<&'a Rigid>,
    /// The head's box in the depth picture; `None` when lost or absent, and when a held head is not seen.
    pub head_box: Option<PixelRect>,
    /// The 68 points; `None` when posed, lost or absent.
    pub landmarks: Option<&'a Landmarks>,
    /// Measures in the order of their names; empty when posed, lost or absent.
    pub measures: &'a [f32],
    /// Weights in the order of the units' names; empty when posed, lost or absent.
    pub weights: &'a [f32],
    /// Range from which each weight is computed, in the order of the units' names; empty when posed, lost or absent.
    pub ranges: &'a [UnitRange],
    /// Gestures of the user that are on, one bit each in the order of the configuration.
    pub gestures: u32,
    /// Time from the frame's arrival to its being sent, µs; 0 if unknown.
    pub latency_us: u32,
}

impl Report<'_> {
    /// The pose, unless the state is lost or absent.
    pub(super) fn pose(&self) -> Option<&Rigid> {
        let present = self.state.is_present();
        self.sensor_from_face.filter(|_| present)
    }

    /// How far each of [`mien_stages::face_model::scheme::VISIBLE_REGIONS`] can be seen, 0…1; `None` without a face.
    pub fn seen(&self) -> Option<[f32; REGIONS]> {
        let landmarks = self.landmarks.filter(|_| self.state.has_face())?;
        Some(landmarks.seen.map(unit_range))
    }
}

/// Replaces NaN and infinities by 0.
pub fn finite(value: f32) -> f32 {
    if value.is_finite() { value } else { 0.0 }
}

/// Clamps to 0…1; non-finite values become 0.
pub(super) fn unit_range(value: f32) -> f32 {
    finite(value).clamp(0.0, 1.0)
}
