//! The closure of the eye on the far side of a turned face follows that of the near eye.
//!
//! The far eye's lids are foreshortened, and the bridge of the nose covers a part of them: in a face turned by 25°, open eyes read up
//! to 0.8 shut, and blinks as little as 0.3. People blink with both eyes, so the near one tells. (Fading the far eye's units to rest
//! instead loses the blinks.) Radians, weights 0 to 1 and beyond. Memory: none. Cost: negligible. Degenerate: an eye that is hidden
//! neither follows nor leads. Limitation: once a face is turned by the end of [`FOLLOWS`], a wink counts as a blink or not at all.

use super::regions::RegionSet;
use super::units::UnitName;
use crate::base::capacity::REGIONS;
use crate::base::frames::SensorFromFace;
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;

/// Angles between the face and the line of sight, about its vertical, at which the far eye begins to follow, and follows entirely: 19°
/// and 30°.
const FOLLOWS: core::ops::Range<f32> = 0.33..0.52;

/// Blends the closure of the far eye with that of the near one. `names`: of the columns of `weights`; `seen`: how far each region is
/// seen, 0 to 1.
pub(super) fn follow_near_eye(
    weights: &mut [f32],
    names: &[UnitName],
    sensor_from_face: &SensorFromFace,
    seen: &[f32; REGIONS],
) {
    let column = |unit| names.iter().position(|name| name == unit);
    let (Some(left), Some(right)) = (column("AU43L"), column("AU43R")) else {
        return;
    };
    let to_sensor = sensor_from_face.inverse().translation.vector;
    // The face's own left side is at +x.
    let turned = to_sensor.x.atan2(-to_sensor.z);
    let (near, far) = if turned > 0.0 {
        (left, right)
    } else {
        (right, left)
    };
    let share = (turned.abs() - FOLLOWS.start) / (FOLLOWS.end - FOLLOWS.start);
    let share = share.clamp(0.0, 1.0) * RegionSet::of_unit("AU43").seen(seen);
    weights[far] += (weights[near] - weights[far]) * share;
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::geometry::{Vector, rotation_from_yaw_pitch_roll};

    /// Closures of the left and the right eye, 0.25 and 0.75 before, of a face with this yaw at `x` metres to the right in the image.
    fn closures(yaw: f32, x: f32, seen: &[f32; REGIONS]) -> [f32; 2] {
        let names = ["AU26", "AU43L", "AU43R"].map(|name| UnitName::try_from(name).unwrap());
        let rotation = rotation_from_yaw_pitch_roll(yaw, 0.1, 0.0);
        let pose = SensorFromFace::from_parts(Vector::new(x, 0.0, 1.0), rotation);
        let mut weights = [0.5, 0.25, 0.75];
        follow_near_eye(&mut weights, &names, &pose, seen);
        assert_eq!(weights[0], 0.5);
        [weights[1], weights[2]]
    }

    #[test]
    fn the_far_eye_of_a_turned_head_does_not_read_as_shut() {
        let all = [1.0; REGIONS];
        // A positive yaw turns the nose to the image left and shows the face's left side.
        assert_eq!(closures(0.6, 0.0, &all), [0.25, 0.25]);
        assert_eq!(closures(-0.6, 0.0, &all), [0.75, 0.75]);
        // What counts is the angle to the line of sight: ahead, and looking at the sensor from the side.
        assert_eq!(closures(0.0, 0.0, &all), [0.25, 0.75]);
        let aside = (0.6f32).tan();
        assert_eq!(closures(0.0, -aside, &all), [0.25, 0.25]);
        assert_eq!(closures(-0.6, -aside, &all), [0.25, 0.75]);
    }

    #[test]
    fn a_hidden_eye_neither_leads_nor_follows() {
        for eye in [2, 3] {
            let mut seen = [1.0; REGIONS];
            seen[eye] = 0.0;
            assert_eq!(closures(0.6, 0.0, &seen), [0.25, 0.75]);
            assert_eq!(closures(-0.6, 0.0, &seen), [0.25, 0.75]);
        }
    }
}
