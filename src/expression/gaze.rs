//! Gaze from the image of the eyes (FACS AU61 to AU64), and how far the upper lids are lifted, more finely than landmarks show.
//!
//! Linear maps of the two eye patches cut by [`crate::landmarks::eyes`], learned by ridge regression from rendered eyes
//! (`mien-studio units`). Both eyes look at the same point and the face is symmetric: horizontal gaze is in the difference of the
//! mirrored eyes, vertical gaze and lids in their sum, so each needs the weights of one eye only. One more weight compensates for
//! head rotation, which shows the eyes from the side. The person's own offset is removed by a learner, as with distances.
//! Memory: 435 weights. Degenerate: closed eyes give nothing.

use serde::Deserialize;

use crate::base::geometry::Rotation;
use crate::base::geometry::Vector;
use crate::base::prelude::*;
use crate::landmarks::eyes::{CELLS, Eyes};

/// Maps, as in `config/units.toml`: weights by cell, rows from above, temple to nose, then the head's turn. 1 is the eyes' full
/// range, about 30°, or lids opened wide (AU5).
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Gaze {
    left: Vec<f32>,
    up: Vec<f32>,
    lids: Vec<f32>,
}

impl Gaze {
    /// To the subject's left and up, and how far lids are lifted, plus constants of the person.
    pub fn of(&self, [right, left]: &Eyes, sensor_from_head: &Rotation) -> [f32; 3] {
        let ahead = sensor_from_head * Vector::z();
        let sum = |weights: &[f32], sign: f32, turn: f32| {
            let eyes = left.iter().zip(right).zip(weights);
            let cells: f32 = eyes.map(|((l, r), w)| w * (l + sign * r)).sum();
            cells + weights[CELLS] * turn
        };
        let [up, lids] = [&self.up, &self.lids].map(|weights| sum(weights, 1.0, ahead.y));
        [sum(&self.left, -1.0, ahead.x), up, lids]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::geometry::rotation_from_yaw_pitch_roll;

    fn planted() -> Gaze {
        let weights = |turn: f32, sign: f32| {
            let mut weights: Vec<f32> = (0..CELLS).map(|k| sign * (k % 7) as f32 * 0.01).collect();
            weights.push(turn);
            weights
        };
        Gaze {
            left: weights(2.0, 1.0),
            up: weights(3.0, -1.0),
            lids: weights(1.0, 1.0),
        }
    }

    #[test]
    fn the_shipped_maps_have_as_many_finite_weights_as_an_eye_has_cells_and_one() {
        let gaze = crate::expression::Units::shipped().gaze.expect("maps");
        for map in [&gaze.left, &gaze.up, &gaze.lids] {
            assert!(map.len() == CELLS + 1 && map.iter().all(|w| w.is_finite()));
        }
    }

    #[test]
    fn a_mirrored_face_looks_the_other_way_and_as_far_up() {
        let gaze = planted();
        let eye = |seed: f32| core::array::from_fn(|k| (k as f32 * seed).sin());
        let (a, b) = (eye(0.37), eye(0.91));
        let straight = Rotation::identity();
        let [left, up, lids] = gaze.of(&[a, b], &straight);
        let [mirrored, same, as_open] = gaze.of(&[b, a], &straight);
        assert!(left.abs() > 0.01 && (left + mirrored).abs() < 1e-5);
        assert!((up - same).abs() < 1e-5 && (lids - as_open).abs() < 1e-5);
        assert!((up + lids).abs() < 1e-5);
    }

    #[test]
    fn the_heads_own_turn_counts_by_its_sine() {
        let gaze = planted();
        let eyes = [[0.0; CELLS]; 2];
        let turned = rotation_from_yaw_pitch_roll(0.3, 0.0, 0.0);
        let ahead = turned * Vector::z();
        let [left, up, _] = gaze.of(&eyes, &turned);
        assert!((left - 2.0 * ahead.x).abs() < 1e-6 && up.abs() < 1e-6);
        assert!((left.abs() - 2.0 * 0.3f32.sin()).abs() < 1e-5);
    }
}
