//! Gaze (FACS AU61 to AU64) and lift of the upper lids from the eye patches, more precisely than from landmarks.
//!
//! Linear maps of the two eye patches cut by [`crate::landmarks::eyes`], learned by ridge regression from rendered eyes
//! (`mien-studio units`). Both eyes look at the same point and the face is symmetric: horizontal gaze is in the difference of the
//! mirrored eyes, vertical gaze and lids in their sum, so each needs the weights of one eye only. One more weight compensates for
//! head rotation. The person's own offset is removed by a learner, as with lengths. Memory: 435 weights. Degenerate: the result
//! is meaningless for closed eyes.

use core::ops::Range;

use serde::Deserialize;

use crate::base::geometry::Rotation;
use crate::base::geometry::Vector;
use crate::base::prelude::*;
use crate::landmarks::eyes::{ACROSS, CELLS, DOWN, Eyes};

/// Rows and columns that normalise each map's patch: the change by a moving iris depends on its contrast to the white, not on that
/// of brows and lids.
const AROUND: [[Range<usize>; 2]; 3] = [[3..6, 3..13], [2..7, 2..14], [0..DOWN, 0..ACROSS]];
/// Least standard deviation of the normalisation.
const LEAST_DEVIATION: f32 = 0.15;

/// Linear maps of `config/units.toml`: weights by cell (rows from above, temple to nose), then of the head's rotation. An output of
/// 1 is the eyes' full range, about 30°, or lids opened wide (AU5).
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Gaze {
    left: Vec<f32>,
    up: Vec<f32>,
    lids: Vec<f32>,
}

impl Gaze {
    /// Gaze to the subject's left and up, and lid lift, each plus a constant of the person.
    pub fn estimate(&self, eyes: &Eyes, sensor_from_head: &Rotation) -> [f32; 3] {
        let ahead = sensor_from_head * Vector::z();
        let read = |axis, weights: &[f32]| -> f32 {
            let row = row(eyes, [ahead.x, ahead.y], axis);
            row.iter().zip(weights).map(|(value, w)| value * w).sum()
        };
        [read(0, &self.left), read(1, &self.up), read(2, &self.lids)]
    }
}

/// Input of map `axis`: left (0), up (1) or lids (2). `ahead`: x and y of the head's forward axis in the sensor frame.
pub fn row([right, left]: &Eyes, ahead: [f32; 2], axis: usize) -> [f32; CELLS + 1] {
    let mut row = [0.0; CELLS + 1];
    for (eye, sign) in [(left, 1.0), (right, if axis == 0 { -1.0 } else { 1.0 })] {
        let [rows, columns] = &AROUND[axis];
        let cells = |y: usize| &eye[y * ACROSS..][columns.clone()];
        let around = || rows.clone().flat_map(cells);
        let n = (rows.len() * columns.len()) as f32;
        let mean = around().sum::<f32>() / n;
        let variance = around().map(|v| (v - mean) * (v - mean)).sum::<f32>() / n;
        let scale = sign / variance.sqrt().max(LEAST_DEVIATION);
        for (sum, cell) in row.iter_mut().zip(eye) {
            *sum += scale * (cell - mean);
        }
    }
    row[CELLS] = ahead[axis.min(1)];
    row
}

/// An eye whose iris seems off the middle at rest turns less visibly to that side and more to the other: a glance changes by this
/// share of the gaze at rest.
const OFF_CENTRE: f64 = 0.8;
/// Largest such change.
const MAX_OFF_CENTRE: f64 = 0.5;

/// How far somebody looks across, given how much further than at rest they seem to, and the gaze at rest.
pub(super) fn corrected_gaze(seems: f64, rest: f64) -> f64 {
    let off = OFF_CENTRE * rest * seems.signum();
    seems * (1.0 + off.clamp(-MAX_OFF_CENTRE, MAX_OFF_CENTRE))
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
        let [left, up, lids] = gaze.estimate(&[a, b], &straight);
        let [mirrored, same, as_open] = gaze.estimate(&[b, a], &straight);
        assert!(left.abs() > 0.01 && (left + mirrored).abs() < 1e-5);
        assert!((up - same).abs() < 1e-5 && (lids - as_open).abs() < 1e-5);
    }

    #[test]
    fn gaze_is_independent_of_dark_brows_and_lids() {
        let eye = |dark: f32, contrast: f32, seed: f32| -> [f32; CELLS] {
            core::array::from_fn(|k| match k / ACROSS {
                0..2 | 7.. => dark * (k % 3) as f32,
                _ => contrast * (k as f32 * seed).sin(),
            })
        };
        for axis in 0..2 {
            let [bright, dark] = [(0.0, 1.0), (-4.0, 0.4)].map(|(dark, contrast)| {
                let eyes = [0.37, 0.91].map(|seed| eye(dark, contrast, seed));
                row(&eyes, [0.0; 2], axis)
            });
            let between = 2 * ACROSS..7 * ACROSS;
            let apart = between.map(|k| (bright[k] - dark[k]).abs());
            assert!(apart.fold(0.0, f32::max) < 1e-4);
        }
    }

    #[test]
    fn the_heads_own_turn_counts_by_its_sine() {
        let gaze = planted();
        let eyes = [[0.0; CELLS]; 2];
        let turned = rotation_from_yaw_pitch_roll(0.3, 0.0, 0.0);
        let ahead = turned * Vector::z();
        let [left, up, _] = gaze.estimate(&eyes, &turned);
        assert!((left - 2.0 * ahead.x).abs() < 1e-6 && up.abs() < 1e-6);
        assert!((left.abs() - 2.0 * 0.3f32.sin()).abs() < 1e-5);
    }

    #[test]
    fn eyes_that_rest_to_the_left_look_further_there_than_they_seem_to() {
        for (seems, rest, gaze) in [
            (0.5, 0.0, 0.5),
            (0.5, 0.25, 0.6),
            (-0.5, 0.25, -0.4),
            (0.5, -0.25, 0.4),
            (0.5, 2.0, 0.75),
            (-0.5, 2.0, -0.25),
        ] {
            assert!(
                (corrected_gaze(seems, rest) - gaze).abs() < 1e-12,
                "{seems} {rest}"
            );
        }
    }
}
