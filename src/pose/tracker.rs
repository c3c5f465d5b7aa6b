//! What the two methods have in common.

use super::settings::HeadPose;
use super::shape::HeadShape;
use super::trail::{Information, Trail};
use crate::base::frames::SensorFromHead;
use crate::base::geometry::Point;
use crate::base::time::Timestamp;
use crate::segment::HeadCloud;

/// The first [`LEARN_ALL`] frames that teach the shape all do, later ones every [`LEARN_STEP`]-th: neighbours are redundant.
pub(super) const LEARN_ALL: u64 = 60;
pub(super) const LEARN_STEP: u64 = 3;

/// A pose, and its alignment's information.
pub(super) type Found = (HeadPose, Information);

/// A method of finding one head in its clouds. What it does not say it leaves out.
pub(super) trait Tracker: Send {
    /// What was learned of the head's size and shape.
    fn shape(&self) -> &HeadShape;
    /// Frames from which the shape was learned.
    fn learned_frames(&self) -> u64 {
        0
    }
    /// Whether a search continues in the next frame.
    fn is_searching(&self) -> bool {
        false
    }
    /// Where the head is expected, whose cut-out is centred on `middle`.
    fn expected(
        &mut self,
        _: &Trail,
        _: Timestamp,
        _middle: Option<Point>,
    ) -> Option<SensorFromHead> {
        None
    }
    /// The head where it is expected; all stays as it was if it is not there.
    fn follow(&mut self, _: &HeadCloud, _: &Trail, _: Timestamp) -> Option<Found> {
        None
    }
    /// The head anywhere in the cloud, with as many halves of a search as are left.
    fn find(
        &mut self,
        cloud: &HeadCloud,
        trail: &Trail,
        at: Timestamp,
        searches: &mut u32,
    ) -> Option<Found>;
    /// Learns from the cloud of the pose found last, once.
    fn learn(&mut self, cloud: &HeadCloud);
    /// The head did not move on from where it was found last.
    fn lose(&mut self) {}
    /// Nothing found so far is of use any more.
    fn restart(&mut self);
    /// The next cloud is another person's.
    fn forget(&mut self);
}
