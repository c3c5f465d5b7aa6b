//! Where a head was last: its measured poses, what they predict, and the filter over them.

use nalgebra::SMatrix;

use super::lean;
use super::settings::{HeadPose, Settings};
use super::smoothing::{PoseFilter, Smoothing};
use crate::base::frames::{HeadFromFace, HeadFromSensor, SensorFromHead};
use crate::base::geometry::{Rotation, Vector};
use crate::base::time::Timestamp;

/// Without a pose for this long the prediction is useless, seconds.
pub(super) const COAST_S: f64 = 0.2;
/// A head moves no further than this between two frames, metres.
pub(super) const STEP_M: f32 = 0.1;

/// Information of an alignment about rotation and shift, in the head frame.
pub(super) type Information = SMatrix<f64, 6, 6>;

/// A pose as measured, and when.
type Measured = Option<(SensorFromHead, Timestamp)>;

/// The last poses of one head.
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
            last: None,
            earlier: None,
            before: None,
            unfiltered: filter.clone(),
            filter,
            known: SMatrix::zeros(),
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

    /// The last pose combined with the one that the picture gives ([`lean`]), smoothed; `None` if it stays as it was.
    pub(super) fn lean(&mut self, by_picture: &SensorFromHead) -> Option<SensorFromHead> {
        let (depth, at) = self.last?;
        let leant = lean::lean(&depth, &self.known, by_picture)?;
        self.last = Some((leant, at));
        self.filter.clone_from(&self.unfiltered);
        Some(SensorFromHead::of(self.filter.smooth(*leant, at)))
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
}
