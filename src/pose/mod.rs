//! Head cloud to `sensor_from_head`: rigid ICP, anchored, smoothed (paper section 1.1, steps 2 and 3).

use crate::geometry::Rigid;

/// Where a head is, and how sure that is.
#[derive(Clone, Copy, Debug)]
pub struct HeadPose {
    /// Maps head coordinates to the depth camera's.
    pub sensor_from_head: Rigid,
    /// 0…1: share of the evidence that agrees.
    pub confidence: f32,
    /// Root mean square distance of the accepted pairs, metres.
    pub residual: f32,
}
