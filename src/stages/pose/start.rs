//! The first pose: a search over rotated starts, for yaw within ±60° and pitch within ±40°.
//!
//! A closest-point alignment finds the nearest minimum only: from a frontal start, a head turned by 40° gets stuck at the
//! cheek. So several starts are tried on a subsampled cloud and the best result is kept. Each start rotates the anchor and puts
//! the centre of its visible half on the centre of the cloud.
//!
//! Sensor and head frame, metres, radians. Cost: 25 starts of four iterations on a fifth of the points, five more for the best
//! twelve, eight on half of the points for the best six: about ten times a tracked frame. Limitation: a head rolled by more than
//! about 30° or seen from behind gives a poor agreement, which the tracker rejects.

use super::anchor::Anchor;
use super::shape::FACING;
use crate::base::frames::{HeadFromSensor, SensorFromHead};
use crate::base::geometry::{Point, Vector, mean, rotation_from_yaw_pitch_roll};

const YAWS_DEG: [f32; 5] = [0.0, -25.0, 25.0, -52.0, 52.0];
const PITCHES_DEG: [f32; 5] = [0.0, -22.0, 22.0, -40.0, 40.0];

/// Start poses for a cloud (sensor frame, metres), frontal first.
pub(crate) fn starts<'a>(
    anchor: &'a Anchor,
    cloud: &[Point],
) -> impl Iterator<Item = HeadFromSensor> + use<'a> {
    let middle = mean(cloud.iter().copied());
    // A cloud within a micrometre of the camera has no viewing direction: straight ahead.
    let ray = middle.coords.try_normalize(1e-6).unwrap_or(Vector::z());
    PITCHES_DEG.into_iter().flat_map(move |pitch| {
        YAWS_DEG.into_iter().map(move |yaw| {
            let turn = rotation_from_yaw_pitch_roll(yaw.to_radians(), pitch.to_radians(), 0.0);
            let seen = mean(
                anchor
                    .points
                    .iter()
                    .zip(&anchor.normals)
                    .filter(|(_, n)| (turn * **n).dot(&ray) < FACING)
                    .map(|(p, _)| *p),
            );
            let shift = middle.coords - turn * seen.coords;
            SensorFromHead::from_parts(shift, turn).inverse()
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pose::anchor::tests::half_egg;

    #[test]
    fn a_cloud_at_the_camera_is_straight_ahead() {
        let anchor = Anchor::new(&half_egg()).expect("a head");
        let first = |x: f32| {
            let start = starts(&anchor, &[Point::new(x, 0.0, 0.0)]).next();
            start.expect("a start").translation.vector
        };
        assert!((first(7.5e-7) - first(0.0)).norm() < 1e-5);
        // From the side half of the head is seen, and its middle is elsewhere.
        assert!((first(1.5e-6) - first(0.0)).norm() > 0.01);
    }
}
