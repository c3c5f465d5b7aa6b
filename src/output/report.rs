//! The input of every output: one user at one frame.

use crate::base::geometry::Rigid;
use crate::base::time::Timestamp;
use crate::expression::UnitRange;
use crate::landmarks::Landmarks;
use crate::segment::PixelRect;
use crate::users::TrackingState;

/// Version of the order and meaning of units on the wires; rises when an index changes its meaning.
pub const SCHEMA_VERSION: i32 = 1;

/// All that is known of one user at one frame. Lent to the outputs.
#[derive(Clone, Copy, Debug, Default)]
pub struct Report<'a> {
    /// Number of the frame ([`crate::sensor::Frame::index`]).
    pub frame: u64,
    /// Capture time of the frame.
    pub at: Timestamp,
    /// Slot of the user, below [`crate::base::capacity::USERS`]; `None` if nobody is there.
    pub user: Option<usize>,
    /// What is known of the user; [`TrackingState::Absent`] with a slot once, when they are forgotten.
    pub state: TrackingState,
    /// Nobody else is reported of this frame, and this user is gone: a frame without anybody.
    pub alone: bool,
    /// Whether another user is the one whom wires show that have room for one.
    pub aside: bool,
    /// 0…1, the whole face; of the pose where there is no face.
    pub confidence: f32,
    /// Whether the user's ranges are kept from learning.
    pub frozen: bool,
    /// Pose of the head; `None` when lost or absent.
    pub sensor_from_head: Option<&'a Rigid>,
    /// Where the head is in the depth picture; `None` when lost or absent, and where a held head is not seen.
    pub head_box: Option<PixelRect>,
    /// The 68 points; `None` when posed, lost or absent.
    pub landmarks: Option<&'a Landmarks>,
    /// In the order of the measures' names; empty when posed, lost or absent.
    pub measures: &'a [f32],
    /// In the order of the units' names; empty when posed, lost or absent.
    pub weights: &'a [f32],
    /// Learned low, rest and high of the measure behind each unit, in the order of the units' names; empty when posed, lost
    /// or absent.
    pub ranges: &'a [UnitRange],
    /// From the frame's arrival to its being sent, µs; 0 if not known.
    pub latency_us: u32,
}

/// Into 0…1; what is not a finite number becomes 0.
pub(super) fn unit_range(value: f32) -> f32 {
    if value.is_finite() {
        value.clamp(0.0, 1.0)
    } else {
        0.0
    }
}
