//! Where a head was last: its measured poses, what they predict, and the filter over them. What the two methods have in common.
//!
//! A pose is corrected towards the face in the picture: depth and picture determine it together.
//!
//! Under a fringe or beside long hair the depth pose drifts, slowly and confidently, while the 68 points stay on the face. The
//! face has a fixed pose within its head ([`crate::landmarks::LandmarkFitter::image_residual`]), so each frame's points imply a head
//! pose. Both are weighted by their certainty: depth by the normal matrix of its alignment (`known`), the picture by
//! standard deviations about and across the line of sight. Small differences are left to depth, which is accurate to a
//! fraction of a degree on a bare head; pitch has more tolerance, because light and a moving mouth affect the picture's
//! estimate of it.
//!
//! Method: one Gauss–Newton step on the sum of the two quadratic forms about the depth pose, where depth's gradient is zero.
//! Head frame, radians and metres. Degenerate: where depth has no information, the picture alone decides.

use nalgebra::{Matrix3, SMatrix, SVector};

use super::plane::WORTH_M2;
use super::settings::{HeadPose, Settings};
use super::shape::HeadShape;
use super::smoothing::{PoseFilter, Smoothing};
use crate::base::frames::{Head, HeadFromFace, HeadFromSensor, Motion, SensorFromHead};
use crate::base::geometry::{Point, Rigid, Rotation, Vector};
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;
use crate::base::time::Timestamp;
use crate::segment::HeadCloud;

/// Without a pose for this long the prediction is useless, seconds.
pub(super) const COAST_S: f64 = 0.2;
/// A head moves no further than this between two frames, metres.
pub(super) const STEP_M: f32 = 0.1;

/// Information of an alignment about rotation and shift, in the head frame.
pub(super) type Information = SMatrix<f64, 6, 6>;

/// A pose as measured, and when.
type Measured = Option<(SensorFromHead, Timestamp)>;

/// The last poses of one head.
#[derive(Default)]
pub(super) struct Trail {
    /// As measured, before the filter: the last one, and the one before that.
    pub(super) last: Measured,
    pub(super) earlier: Measured,
    filter: PoseFilter,
    /// All this as it was before a pose that has to be confirmed.
    before: Option<(Measured, Measured, PoseFilter)>,
    /// The filter before the last pose, and the information of that pose's alignment, for combining it with the picture.
    unfiltered: PoseFilter,
    known: Information,
}

impl Trail {
    pub(super) fn new(settings: &Settings) -> Self {
        let filter = PoseFilter::new(match settings.smoothing {
            Smoothing::Window(_) => Smoothing::Window(settings.window_frames as usize),
            other => other,
        });
        Self {
            unfiltered: filter.clone(),
            filter,
            ..Self::default()
        }
    }

    /// Stores and smooths a pose that was found.
    pub(super) fn keep(&mut self, found: HeadPose, known: Information, at: Timestamp) -> HeadPose {
        self.before = (!found.proven).then(|| (self.last, self.earlier, self.filter.clone()));
        self.earlier = self.last;
        self.last = Some((found.sensor_from_head, at));
        self.unfiltered.clone_from(&self.filter);
        self.known = known;
        HeadPose {
            sensor_from_head: SensorFromHead::of(self.filter.smooth(*found.sensor_from_head, at)),
            ..found
        }
    }

    /// Undoes the last [`Self::keep`], if its pose was not proven.
    pub(super) fn revert(&mut self) {
        if let Some((last, earlier, filter)) = self.before.take() {
            (self.last, self.earlier, self.filter) = (last, earlier, filter);
        }
    }

    /// The speed is not known any more.
    pub(super) fn lose(&mut self) {
        self.earlier = None;
        self.filter.reset();
    }

    /// The next pose follows from `last`, or from nothing.
    pub(super) fn restart(&mut self, last: Measured) {
        self.lose();
        self.last = last;
    }

    /// The head is where the face sits in it as it should.
    pub(super) fn correct(&mut self, head_from_face: &HeadFromFace) {
        self.filter.reset();
        // The one before was as wrong: the head's speed stays.
        for (pose, _) in self.last.iter_mut().chain(&mut self.earlier) {
            *pose = SensorFromHead::of(*(*pose * *head_from_face));
        }
    }

    /// The last pose combined with the one that the picture gives ([`fuse()`]), smoothed; `None` if it stays as it was.
    pub(super) fn fuse(&mut self, by_picture: &SensorFromHead) -> Option<SensorFromHead> {
        let (depth, at) = self.last?;
        let fused = fuse(&depth, &self.known, by_picture)?;
        self.last = Some((fused, at));
        self.filter.clone_from(&self.unfiltered);
        Some(SensorFromHead::of(self.filter.smooth(*fused, at)))
    }

    /// Pose predicted for `at` at constant velocity, or while none is known by how far its cloud has `moved`; only if the
    /// head was seen recently.
    pub(super) fn predicted(&self, at: Timestamp, moved: &Vector) -> Option<HeadFromSensor> {
        let (last, last_at) = self.last?;
        let since = at.seconds_since(last_at);
        if since > COAST_S {
            return None;
        }
        let Some((earlier, earlier_at)) = self.earlier else {
            let place = last.translation.vector + moved.cap_magnitude(STEP_M);
            return Some(SensorFromHead::from_parts(place, last.rotation).inverse());
        };
        let dt = last_at.seconds_since(earlier_at);
        if dt <= 0.0 {
            return Some(last.inverse());
        }
        // The step about the head's own place, so that a turn does not swing it about the camera.
        let ratio = (since / dt).min(2.0) as f32 * 0.9;
        let turn = (last.rotation * earlier.rotation.inverse()).scaled_axis() * ratio;
        let shift = (last.translation.vector - earlier.translation.vector) * ratio;
        let sensor_from_head = SensorFromHead::from_parts(
            last.translation.vector + shift,
            Rotation::new(turn) * last.rotation,
        );
        Some(sensor_from_head.inverse())
    }
}

/// Standard deviations of the picture's estimate: rotation about and across the line of sight, radians; shift across it,
/// metres.
const ROLL_RAD: f64 = 0.012;
const TURN_RAD: f64 = 0.026;
const SHIFT_M: f64 = 0.002;
/// Up to these differences, combined, depth decides: rotation, radians, and shift, metres.
const FREE_RAD: f32 = 0.020;
const FREE_M: f32 = 0.006;
/// Factor on the tolerance for pitch.
const FREE_PITCH: f32 = 1.5;
/// Information in a direction in which depth has none, per unit of weight.
const NOTHING: f64 = 1e-6;

/// The pose between `depth`, whose alignment has the information `known` (rotation and shift in the head frame, per unit of
/// weight), and the picture's estimate `pictured`.
fn fuse(
    depth: &SensorFromHead,
    known: &Information,
    pictured: &SensorFromHead,
) -> Option<SensorFromHead> {
    let off = pictured.inverse() * *depth;
    let (turn, shift) = (off.rotation.scaled_axis(), off.translation.vector);
    let roomy = Vector::new(turn.x / FREE_PITCH, turn.y, turn.z);
    let far = (roomy.norm() / FREE_RAD).hypot(shift.norm() / FREE_M);
    if far <= 1.0 {
        return None;
    }
    let beyond = f64::from(1.0 - 1.0 / far);
    let sight = depth.inverse_transform_vector(&depth.translation.vector);
    let sight = sight.try_normalize(1e-6)?.cast::<f64>();
    let along = sight * sight.transpose();
    let across = Matrix3::identity() - along;
    let square = |sigma: f64| WORTH_M2 / (sigma * sigma);
    let mut picture = SMatrix::<f64, 6, 6>::zeros();
    let turns = across * square(TURN_RAD) + along * square(ROLL_RAD);
    picture.fixed_view_mut::<3, 3>(0, 0).copy_from(&turns);
    let shifts = across * square(SHIFT_M);
    picture.fixed_view_mut::<3, 3>(3, 3).copy_from(&shifts);
    let wanted = turn.iter().chain(shift.iter());
    let wanted =
        SVector::<f64, 6>::from_iterator(wanted.map(|component| f64::from(*component) * beyond));
    let depths = known + SMatrix::<f64, 6, 6>::identity() * NOTHING;
    let step = (depths + picture).cholesky()?.solve(&(picture * wanted));
    let [a, b, c, x, y, z] = core::array::from_fn(|k| step[k] as f32);
    let step = Rigid::new(Vector::new(x, y, z), Vector::new(a, b, c));
    Some(*depth * Motion::<Head, Head>::of(step).inverse())
}

/// A pose, and its alignment's information.
pub(super) type Found = (HeadPose, Information);

/// A method of finding one head in its clouds. What it does not say it leaves out.
pub(super) trait Tracker: Send {
    /// What was learned of the head's size and shape.
    fn shape(&self) -> &HeadShape;
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::geometry::rotation_from_yaw_pitch_roll;

    #[test]
    fn a_head_is_expected_where_its_speed_takes_it() {
        let mut trail = Trail::new(&Settings::default());
        let still = Vector::zeros();
        let at = |ms: u64| Timestamp::from_us(1_000_000 + ms * 1000);
        let pose = |x: f32, yaw: f32| {
            let turn = rotation_from_yaw_pitch_roll(yaw, 0.0, 0.0);
            SensorFromHead::from_parts(Vector::new(x, 0.0, 0.8), turn)
        };
        assert!(trail.predicted(at(0), &still).is_none());
        trail.last = Some((pose(0.01, 0.1), at(40)));
        let expected = trail.predicted(at(60), &still).unwrap();
        assert!((expected * pose(0.01, 0.1)).translation.vector.norm() < 1e-6);
        // 0.01 m and 0.1 rad in 40 ms; nine tenths of that speed is believed, for twice the time at most.
        trail.earlier = Some((pose(0.0, 0.0), at(0)));
        for (ms, steps) in [(60, 0.45), (80, 0.9), (120, 1.8), (200, 1.8)] {
            let apart = trail.predicted(at(ms), &still).unwrap()
                * pose(0.01 + 0.01 * steps, 0.1 + 0.1 * steps);
            assert!(apart.translation.vector.norm() < 1e-5, "{ms}");
            assert!(apart.rotation.angle() < 1e-3, "{ms}");
        }
        // After a fifth of a second nothing is; time that stood still tells no speed.
        assert!(trail.predicted(at(241), &still).is_none());
        trail.earlier = Some((pose(0.5, 0.9), at(40)));
        let expected = trail.predicted(at(60), &still).unwrap();
        assert!((expected * pose(0.01, 0.1)).translation.vector.norm() < 1e-6);
    }

    fn depth() -> SensorFromHead {
        SensorFromHead::from_parts(
            Vector::new(0.05, -0.02, 0.8),
            rotation_from_yaw_pitch_roll(0.2, -0.1, 0.05),
        )
    }

    /// In every direction as much as the picture knows of a turn about the line of sight.
    fn equal() -> SMatrix<f64, 6, 6> {
        let mut known = SMatrix::identity() * (WORTH_M2 / (ROLL_RAD * ROLL_RAD));
        for k in 3..6 {
            known[(k, k)] = WORTH_M2 / (SHIFT_M * SHIFT_M);
        }
        known
    }

    #[test]
    fn what_both_know_equally_well_is_met_half_way_beyond_what_is_depths() {
        let depth = depth();
        let sight = depth.translation.vector.normalize();
        let turn = 0.2;
        let pictured = SensorFromHead::from_parts(
            depth.translation,
            Rotation::new(sight * turn) * depth.rotation,
        );
        let fused = fuse(&depth, &equal(), &pictured).expect("far apart");
        let moved = (fused.rotation * depth.rotation.inverse()).scaled_axis();
        let half = 0.5 * (turn - FREE_RAD);
        assert!((moved - sight * half).norm() < 0.004, "{moved} {half}");
        assert!((fused.translation.vector - depth.translation.vector).norm() < 1e-4);
    }

    #[test]
    fn where_depth_knows_nothing_the_picture_decides_and_never_how_far_off_a_head_is() {
        let depth = depth();
        let pictured = SensorFromHead::of(
            *depth * Rigid::new(Vector::new(0.01, 0.0, 0.0), Vector::new(0.0, 0.15, 0.0)),
        );
        let fused = fuse(&depth, &SMatrix::zeros(), &pictured).expect("far apart");
        assert!(fused.rotation.angle_to(&pictured.rotation) < FREE_RAD + 0.005);
        let along = depth.translation.vector.normalize();
        let moved = fused.translation.vector - depth.translation.vector;
        assert!(moved.dot(&along).abs() < 1.5e-3, "{moved}");
        // Where depth knows a hundred times more, the pose stays as it is.
        let fused = fuse(&depth, &(equal() * 100.0), &pictured).expect("far apart");
        assert!(fused.rotation.angle_to(&depth.rotation) < 0.01);
    }

    #[test]
    fn small_differences_are_depths() {
        let depth = depth();
        let near =
            |turn: Vector, shift: Vector| SensorFromHead::of(*depth * Rigid::new(shift, turn));
        let none = Vector::zeros();
        for (turn, shift, is_left) in [
            (Vector::y() * 0.019, none, true),
            (Vector::y() * 0.021, none, false),
            (Vector::x() * 0.029, none, true),
            (Vector::x() * 0.031, none, false),
            (none, Vector::x() * 0.0055, true),
            (none, Vector::x() * 0.0065, false),
            (Vector::y() * 0.018, Vector::x() * 0.005, false),
        ] {
            let fused = fuse(&depth, &equal(), &near(turn, shift));
            assert_eq!(fused.is_none(), is_left, "{turn} {shift}");
        }
    }
}
