//! Continuity of the reported distance when depth appears or disappears.
//!
//! The image gives the distance of a face only by the face's size, to a few per cent. When tracking switches from depth to the image, or
//! back, the reported distance starts at its last value, and the difference decays exponentially. Units: metres, seconds. Memory: a few
//! numbers per person.

use crate::base::frames::SensorFromFace;
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;
use crate::base::time::Timestamp;

/// Time constant of the decay, seconds.
const FADES_S: f32 = 0.5;

/// The last reported distance, and what remains of the difference.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct HandOver {
    /// Whether the last pose came from the image, its reported distance in metres, and its time.
    last: Option<(bool, f32, Timestamp)>,
    /// Natural logarithm of the ratio of the reported to the measured distance.
    difference: f32,
}

impl HandOver {
    /// The pose to report for a measured one; `by_image`: whether it was measured without depth. The difference is forgotten after
    /// `longest_gap_s` seconds without a pose.
    pub(super) fn reported(
        &mut self,
        mut pose: SensorFromFace,
        by_image: bool,
        at: Timestamp,
        longest_gap_s: f64,
    ) -> SensorFromFace {
        let distance = pose.translation.vector.norm();
        let last = self
            .last
            .map(|(way, distance, before)| (way, distance, at.seconds_since(before)));
        self.difference = match last.filter(|(.., gap)| (0.0..longest_gap_s).contains(gap)) {
            Some((way, before, _)) if way != by_image => (before / distance).ln(),
            Some((.., gap)) => self.difference * (-gap as f32 / FADES_S).exp(),
            None => 0.0,
        };
        if self.difference != 0.0 {
            let place = pose.translation.vector * self.difference.exp();
            pose = SensorFromFace::from_parts(place, pose.rotation);
        }
        self.last = Some((by_image, pose.translation.vector.norm(), at));
        pose
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::geometry::{Rotation, Vector};

    #[test]
    fn a_difference_of_distance_fades_where_the_way_of_following_changes() {
        let mut hand_over = HandOver::default();
        let mut distance = |frame: u64, measured: f32, by_image: bool| {
            let place = Vector::new(0.0, 0.6, 0.8) * measured;
            let pose = SensorFromFace::from_parts(place, Rotation::identity());
            let at = Timestamp::from_us(frame * 100_000);
            let seen = hand_over
                .reported(pose, by_image, at, 0.2)
                .translation
                .vector;
            assert!((seen.normalize() - Vector::new(0.0, 0.6, 0.8)).norm() < 1e-6);
            seen.norm()
        };
        assert_eq!(distance(0, 0.8, false), 0.8);
        assert_eq!(distance(1, 0.9, false), 0.9);
        // After the switch: the same distance at first; after half a second 1/e of the difference is left.
        assert!((distance(2, 1.0, true) - 0.9).abs() < 1e-6);
        for frame in 3..7 {
            distance(frame, 1.0, true);
        }
        let left = 0.9f32.ln() * (-1f32).exp();
        assert!((distance(7, 1.0, true) - left.exp()).abs() < 1e-5);
        // After a gap a new track begins, without a difference.
        assert_eq!(distance(10, 0.8, false), 0.8);
    }
}
