//! Candidate poses of the face in a head's cloud, to be tested in the colour image: hair beside a face shifts the cloud, so that
//! the pose search may miss the face.
//!
//! The positions are about four centimetres apart within the cloud's extent, the middle first, each with three yaw angles; a fit
//! that starts that far off still converges to the face. Sensor frame, metres. Degenerate: an empty
//! cloud gives none.

use crate::base::frames::SensorFromHead;
use crate::base::geometry::{Point, rotation_from_yaw_pitch_roll};
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;

/// Positions in the extent of the cloud, 0…1 to the right and downwards; heads extend lower than faces.
const POSITIONS: [[f32; 2]; 12] = [
    [0.50, 0.45],
    [0.65, 0.45],
    [0.35, 0.45],
    [0.50, 0.60],
    [0.65, 0.60],
    [0.35, 0.60],
    [0.50, 0.30],
    [0.65, 0.30],
    [0.35, 0.30],
    [0.20, 0.45],
    [0.80, 0.45],
    [0.50, 0.75],
];
const YAWS_RAD: [f32; 3] = [0.0, 0.45, -0.45];

/// Three poses, one per yaw, at position number `count`, cycling through all; `cloud` in the sensor frame, metres. `None` if it is
/// empty.
pub fn guesses(cloud: &[Point], count: usize) -> Option<[SensorFromHead; 3]> {
    let slope = |p: &Point| [p.x / p.z, p.y / p.z];
    let (mut least, mut most) = ([f32::MAX; 2], [f32::MIN; 2]);
    for point in cloud {
        for (k, s) in slope(point).into_iter().enumerate() {
            least[k] = least[k].min(s);
            most[k] = most[k].max(s);
        }
    }
    let position = POSITIONS[count % POSITIONS.len()];
    let ray: [f32; 2] = core::array::from_fn(|k| least[k] + position[k] * (most[k] - least[k]));
    let off = |p: &Point| {
        let [x, y] = slope(p);
        (x - ray[0]).hypot(y - ray[1])
    };
    let near = cloud.iter().min_by(|a, b| off(a).total_cmp(&off(b)))?;
    Some(YAWS_RAD.map(|yaw| {
        let turn = rotation_from_yaw_pitch_roll(yaw, 0.0, 0.0);
        SensorFromHead::from_parts(near.coords, turn)
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_guess_is_in_the_middle_of_the_image_of_the_head() {
        // Seen at -0.1 to 0.1 from the axis, the right side twice as far away.
        let on_ray = |slope: f32, z: f32| Point::new(slope * z, slope * z, z);
        let middle = on_ray(-0.01, 1.0);
        let cloud = [
            on_ray(-0.1, 1.0),
            middle,
            on_ray(0.05, 2.0),
            on_ray(0.1, 2.0),
        ];
        let [guess, ..] = guesses(&cloud, 0).expect("a cloud");
        assert_eq!(guess.translation.vector, middle.coords);
    }

    #[test]
    fn a_face_anywhere_in_a_head_is_within_reach_of_a_guess() {
        // A plane 16 cm wide and 20 cm high at 80 cm.
        let cloud: Vec<Point> = (0..41 * 33)
            .map(|k| {
                let (x, y) = ((k % 33) as f32, (k / 33) as f32);
                Point::new(0.10 + x * 0.005, -0.05 + y * 0.005, 0.8)
            })
            .collect();
        let all: Vec<SensorFromHead> = (0..12)
            .filter_map(|k| guesses(&cloud, k))
            .flatten()
            .collect();
        assert_eq!(all.len(), 36);
        for x in [0.04, 0.06, 0.08, 0.10, 0.12] {
            for y in [0.06, 0.08, 0.10, 0.12] {
                let face = Point::new(0.10 + x, -0.05 + y, 0.8);
                let apart =
                    |guess: &SensorFromHead| (guess.translation.vector - face.coords).norm();
                let nearest = all.iter().map(apart).fold(f32::MAX, f32::min);
                assert!(nearest < 0.025, "{nearest} at {x} {y}");
            }
        }
        let yaws: Vec<f32> = all[..3]
            .iter()
            .map(|guess| crate::base::geometry::yaw_pitch_roll(&guess.rotation).0)
            .collect();
        assert!(yaws.iter().any(|y| *y > 0.4) && yaws.iter().any(|y| *y < -0.4));
        assert_eq!(guesses(&cloud, 0), guesses(&cloud, 12));
        assert!(guesses(&[], 0).is_none());
    }
}
