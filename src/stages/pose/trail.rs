//! State shared by the two methods: the last measured poses of a head, the prediction from them, their filter, and the fusion
//! of depth and image.
//!
//! Under a fringe or beside long hair the depth pose drifts slowly, although its alignment reports high certainty, while the 68 landmarks
//! stay on the face. The face has a fixed pose within its head ([`super::FaceInHead`]), so each frame's landmarks imply a
//! head pose. The two poses are weighted by their certainty: depth by the normal matrix of its alignment, the image by standard
//! deviations about and across the line of sight. Small differences are ignored, because depth is accurate to a fraction of a
//! degree on a bare head; pitch has more tolerance, because light and a moving mouth affect the image's estimate of it.
//!
//! Method: one Gauss–Newton step on the sum of the two quadratic forms about the depth pose, where depth's gradient is zero.
//! Head frame, radians and metres. Degenerate: where depth has no information, the image alone decides.

use nalgebra::{Matrix3, SMatrix, SVector};

use super::plane::RESIDUAL_VARIANCE_M2;
use super::settings::{HeadPose, Settings};
use super::shape::HeadShape;
use super::smoothing::{PoseFilter, Smoothing};
use crate::base::frames::{Head, HeadFromFace, HeadFromSensor, Motion, SensorFromHead};
use crate::base::geometry::{Point, Rigid, Rotation, Vector};
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;
use crate::base::time::Timestamp;
use crate::segment::HeadCloud;

/// Longest time since the last pose for which a pose is predicted, and for which its speed is extrapolated, seconds.
const COAST_S: f64 = 0.2;
/// Longest gap between poses of a slow camera, frames: two frames for one missed fit, and half a frame for jitter.
const GAP_FRAMES: f64 = 2.5;
/// Longest such gap, seconds: after a longer one the head may be anywhere.
const GAP_MAX_S: f64 = 0.9;
/// Largest motion of a head between two frames, metres.
pub(super) const STEP_M: f32 = 0.1;

/// Information of an alignment about rotation and shift, in the head frame.
pub(super) type Information = SMatrix<f64, 6, 6>;

/// A measured pose and its time.
type Measured = Option<(SensorFromHead, Timestamp)>;

/// The last poses of one head.
#[derive(Default)]
pub(super) struct Trail {
    /// Last measured pose, unfiltered.
    pub(super) last: Measured,
    /// Measured pose before the last, unfiltered; `None` if the speed is unknown.
    pub(super) earlier: Measured,
    filter: PoseFilter,
    /// The three fields above as they were before a pose that is not proven yet.
    before: Option<(Measured, Measured, PoseFilter)>,
    /// The filter before the last pose, to repeat it with the fused pose.
    unfiltered: PoseFilter,
    /// Information of the last pose's alignment.
    information: Information,
    /// Time from the previous frame to this one, seconds.
    pub(super) frame_s: f64,
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

    /// Longest time since the last pose for a prediction, seconds.
    pub(super) fn coast_s(&self) -> f64 {
        self.longest_gap_s(COAST_S)
    }

    /// Longest gap between poses, seconds: `usual_s`, or with a slow camera the longer time of [`GAP_FRAMES`].
    pub(super) fn longest_gap_s(&self, usual_s: f64) -> f64 {
        usual_s.max((GAP_FRAMES * self.frame_s).min(GAP_MAX_S))
    }

    /// Stores a measured pose and returns it smoothed.
    pub(super) fn store(
        &mut self,
        found: HeadPose,
        information: Information,
        at: Timestamp,
    ) -> HeadPose {
        self.before = (!found.proven).then(|| (self.last, self.earlier, self.filter.clone()));
        self.earlier = self.last;
        self.last = Some((found.sensor_from_head, at));
        self.unfiltered.clone_from(&self.filter);
        self.information = information;
        HeadPose {
            sensor_from_head: SensorFromHead::assume_frames(
                self.filter.smooth(*found.sensor_from_head, at),
            ),
            ..found
        }
    }

    /// Undoes the last [`Self::store`], if its pose was not proven.
    pub(super) fn revert(&mut self) {
        if let Some((last, earlier, filter)) = self.before.take() {
            (self.last, self.earlier, self.filter) = (last, earlier, filter);
        }
    }

    /// Forgets the speed and resets the filter.
    pub(super) fn forget_speed(&mut self) {
        self.earlier = None;
        self.filter.reset();
    }

    /// Restarts from `last`, or from nothing.
    pub(super) fn restart(&mut self, last: Measured) {
        self.forget_speed();
        self.last = last;
    }

    /// Moves the last poses by `head_from_face`, so that the head frame coincides with the face's.
    pub(super) fn correct(&mut self, head_from_face: &HeadFromFace) {
        self.filter.reset();
        // The earlier pose has the same error: correcting both keeps the speed.
        for (pose, _) in self.last.iter_mut().chain(&mut self.earlier) {
            *pose = SensorFromHead::assume_frames(*(*pose * *head_from_face));
        }
    }

    /// Fuses the last pose with the image's ([`fuse()`]) and returns it smoothed; `None` if unchanged.
    pub(super) fn fuse(&mut self, image_pose: &SensorFromHead) -> Option<SensorFromHead> {
        let (depth, at) = self.last?;
        let fused = fuse(&depth, &self.information, image_pose)?;
        self.last = Some((fused, at));
        self.filter.clone_from(&self.unfiltered);
        Some(SensorFromHead::assume_frames(
            self.filter.smooth(*fused, at),
        ))
    }

    /// Pose predicted for time `at` at constant velocity, or, without a speed, shifted by the cloud's motion `moved` (metres). `None` if
    /// the last pose is older than [`Self::coast_s`].
    pub(super) fn predicted(&self, at: Timestamp, moved: &Vector) -> Option<HeadFromSensor> {
        let (last, last_at) = self.last?;
        let since = at.seconds_since(last_at);
        if since > self.coast_s() {
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
        // The rotation is about the head's origin, not the camera's. The factor 0.9 damps the speed.
        let ratio = (since.min(COAST_S) / dt).min(2.0) as f32 * 0.9;
        let turn = (last.rotation * earlier.rotation.inverse()).scaled_axis() * ratio;
        let shift = (last.translation.vector - earlier.translation.vector) * ratio;
        let sensor_from_head = SensorFromHead::from_parts(
            last.translation.vector + shift,
            Rotation::new(turn) * last.rotation,
        );
        Some(sensor_from_head.inverse())
    }
}

/// Standard deviation of the image's rotation about the line of sight, radians.
const IMAGE_ROLL_RAD: f64 = 0.012;
/// Standard deviation of the image's rotation across the line of sight, radians.
const IMAGE_TURN_RAD: f64 = 0.026;
/// Standard deviation of the image's shift across the line of sight, metres.
const IMAGE_SHIFT_M: f64 = 0.002;
/// Rotation between depth's and the image's pose below which depth alone decides, radians; combined with [`DEPTH_ONLY_M`].
const DEPTH_ONLY_RAD: f32 = 0.020;
/// Shift between depth's and the image's pose below which depth alone decides, metres.
const DEPTH_ONLY_M: f32 = 0.006;
/// Factor on [`DEPTH_ONLY_RAD`] for pitch.
const PITCH_TOLERANCE: f32 = 1.5;
/// Least information of depth in any direction, per unit of weight.
const MIN_INFORMATION: f64 = 1e-6;

/// Fuses `depth`, whose alignment has `information` (rotation and shift, head frame, per unit of weight), with the image's estimate.
/// `None` if depth alone decides or the system is singular.
fn fuse(
    depth: &SensorFromHead,
    information: &Information,
    image_pose: &SensorFromHead,
) -> Option<SensorFromHead> {
    let off = image_pose.inverse() * *depth;
    let (turn, shift) = (off.rotation.scaled_axis(), off.translation.vector);
    let scaled_turn = Vector::new(turn.x / PITCH_TOLERANCE, turn.y, turn.z);
    let far = (scaled_turn.norm() / DEPTH_ONLY_RAD).hypot(shift.norm() / DEPTH_ONLY_M);
    if far <= 1.0 {
        return None;
    }
    let beyond = f64::from(1.0 - 1.0 / far);
    let sight = depth.inverse_transform_vector(&depth.translation.vector);
    let sight = sight.try_normalize(1e-6)?.cast::<f64>();
    let along = sight * sight.transpose();
    let across = Matrix3::identity() - along;
    let square = |sigma: f64| RESIDUAL_VARIANCE_M2 / (sigma * sigma);
    let mut image = SMatrix::<f64, 6, 6>::zeros();
    let turns = across * square(IMAGE_TURN_RAD) + along * square(IMAGE_ROLL_RAD);
    image.fixed_view_mut::<3, 3>(0, 0).copy_from(&turns);
    let shifts = across * square(IMAGE_SHIFT_M);
    image.fixed_view_mut::<3, 3>(3, 3).copy_from(&shifts);
    let wanted = turn.iter().chain(shift.iter());
    let wanted =
        SVector::<f64, 6>::from_iterator(wanted.map(|component| f64::from(*component) * beyond));
    let depths = information + SMatrix::<f64, 6, 6>::identity() * MIN_INFORMATION;
    let step = (depths + image).cholesky()?.solve(&(image * wanted));
    let [a, b, c, x, y, z] = core::array::from_fn(|k| step[k] as f32);
    let step = Rigid::new(Vector::new(x, y, z), Vector::new(a, b, c));
    Some(*depth * Motion::<Head, Head>::assume_frames(step).inverse())
}

/// A pose and its alignment's information.
pub(super) type Found = (HeadPose, Information);

/// A method of tracking one head in clouds (sensor frame, metres).
pub(super) trait Tracker: Send {
    /// Learned size and shape of the head.
    fn shape(&self) -> &HeadShape;
    /// Whether a search continues in the next frame.
    fn is_searching(&self) -> bool {
        false
    }
    /// Predicted pose; `middle`: centre of the segmented cloud.
    fn expected(
        &mut self,
        _: &Trail,
        _: Timestamp,
        _middle: Option<Point>,
    ) -> Option<SensorFromHead> {
        None
    }
    /// Finds the head near its predicted pose; on `None` the state is unchanged.
    fn follow(&mut self, _: &HeadCloud, _: &Trail, _: Timestamp) -> Option<Found> {
        None
    }
    /// Finds the head anywhere in the cloud. `searches` counts the halves of a search that may still run.
    fn find(
        &mut self,
        cloud: &HeadCloud,
        trail: &Trail,
        at: Timestamp,
        searches: &mut u32,
    ) -> Option<Found>;
    /// Learns the shape from the cloud of the last pose, once.
    fn learn(&mut self, cloud: &HeadCloud);
    /// Drops state that assumes continuous motion from the last frame.
    fn break_continuity(&mut self) {}
    /// Drops the search and the last position, not the shape.
    fn restart(&mut self);
    /// Drops everything: the next cloud is another person's.
    fn forget(&mut self);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::geometry::rotation_from_yaw_pitch_roll;

    #[test]
    fn predicts_at_constant_velocity() {
        let mut trail = Trail::new(&Settings::default());
        let still = Vector::zeros();
        let time = |ms: u64| Timestamp::from_us(1_000_000 + ms * 1000);
        let pose = |x: f32, yaw: f32| {
            let turn = rotation_from_yaw_pitch_roll(0.3 + yaw, 0.0, 0.0);
            SensorFromHead::from_parts(Vector::new(x, 0.0, 0.8), turn)
        };
        assert!(trail.predicted(time(0), &still).is_none());
        trail.last = Some((pose(0.01, 0.1), time(40)));
        let expected = trail.predicted(time(60), &still).unwrap();
        assert!((expected * pose(0.01, 0.1)).translation.vector.norm() < 1e-6);
        // The speed is 0.01 m and 0.1 rad in 40 ms; nine tenths of it are extrapolated, over at most 80 ms.
        trail.earlier = Some((pose(0.0, 0.0), time(0)));
        for (ms, steps) in [(60, 0.45), (80, 0.9), (120, 1.8), (200, 1.8)] {
            let apart = trail.predicted(time(ms), &still).unwrap()
                * pose(0.01 + 0.01 * steps, 0.1 + 0.1 * steps);
            assert!(apart.translation.vector.norm() < 1e-5, "{ms}");
            assert!(apart.rotation.angle() < 1e-3, "{ms}");
        }
        // No prediction after 0.2 s; equal times give no speed.
        assert!(trail.predicted(time(241), &still).is_none());
        trail.earlier = Some((pose(0.5, 0.9), time(40)));
        let expected = trail.predicted(time(60), &still).unwrap();
        assert!((expected * pose(0.01, 0.1)).translation.vector.norm() < 1e-6);
    }

    fn depth() -> SensorFromHead {
        SensorFromHead::from_parts(
            Vector::new(0.05, -0.02, 0.8),
            rotation_from_yaw_pitch_roll(0.2, -0.1, 0.05),
        )
    }

    /// Information of depth equal to the image's about the line of sight, in every direction.
    fn equal() -> SMatrix<f64, 6, 6> {
        let mut known =
            SMatrix::identity() * (RESIDUAL_VARIANCE_M2 / (IMAGE_ROLL_RAD * IMAGE_ROLL_RAD));
        for k in 3..6 {
            known[(k, k)] = RESIDUAL_VARIANCE_M2 / (IMAGE_SHIFT_M * IMAGE_SHIFT_M);
        }
        known
    }

    #[test]
    fn equal_information_meets_half_way_beyond_the_tolerance() {
        let depth = depth();
        let sight = depth.translation.vector.normalize();
        let turn = 0.2;
        let image_pose = SensorFromHead::from_parts(
            depth.translation,
            Rotation::new(sight * turn) * depth.rotation,
        );
        let fused = fuse(&depth, &equal(), &image_pose).expect("far apart");
        let moved = (fused.rotation * depth.rotation.inverse()).scaled_axis();
        let half = 0.5 * (turn - DEPTH_ONLY_RAD);
        assert!((moved - sight * half).norm() < 0.004, "{moved} {half}");
        assert!((fused.translation.vector - depth.translation.vector).norm() < 1e-4);
    }

    #[test]
    fn without_depth_information_the_image_decides_all_but_distance() {
        let depth = depth();
        let image_pose = SensorFromHead::assume_frames(
            *depth * Rigid::new(Vector::new(0.01, 0.0, 0.0), Vector::new(0.0, 0.15, 0.0)),
        );
        let fused = fuse(&depth, &SMatrix::zeros(), &image_pose).expect("far apart");
        assert!(fused.rotation.angle_to(&image_pose.rotation) < DEPTH_ONLY_RAD + 0.005);
        let along = depth.translation.vector.normalize();
        let moved = fused.translation.vector - depth.translation.vector;
        assert!(moved.dot(&along).abs() < 1.5e-3, "{moved}");
        // With a hundred times the information of the image, depth decides.
        let fused = fuse(&depth, &(equal() * 100.0), &image_pose).expect("far apart");
        assert!(fused.rotation.angle_to(&depth.rotation) < 0.01);
    }

    #[test]
    fn depth_decides_small_differences() {
        let depth = depth();
        let near = |turn: Vector, shift: Vector| {
            SensorFromHead::assume_frames(*depth * Rigid::new(shift, turn))
        };
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
