//! Where cheeks and forehead go when only the 68 landmarks are given: ten points of the tool's own.
//!
//! A point goes where the solved skin takes it, plus a weighted sum of the displacements of the five landmarks nearest to it.
//! The 25 weights (the right side mirrors the left) were fitted by ridge regression to the sculpted shapes of ICT FaceKit:
//! they say that a cheek rises more than the lid and the nostril beside it let on. Error over those shapes 0.304 without,
//! 0.294 with them; weights fitted without a shape and its mirror neither help nor harm that shape (0.304 in the mean).
//!
//! Units: displacements in, displacements out; the weights are pure numbers.

use super::head::Head;
use super::mesh::Vec3;
use super::names::{LANDMARKS, mirrored};

/// Landmarks and weights of the five points of the left side, in the order of [`super::names::NAMES`].
const SLIDES: [[(usize, f64); 5]; 5] = [
    [
        (35, 0.134),
        (47, 0.082),
        (42, 0.014),
        (34, 0.008),
        (28, 0.039),
    ],
    [
        (46, 0.106),
        (45, 0.018),
        (47, 0.102),
        (35, 0.109),
        (44, -0.02),
    ],
    [
        (54, 0.062),
        (64, 0.054),
        (10, -0.243),
        (55, 0.039),
        (11, 0.007),
    ],
    [
        (24, -0.016),
        (25, -0.013),
        (23, -0.012),
        (22, -0.003),
        (26, -0.007),
    ],
    [
        (23, -0.052),
        (24, 0.004),
        (22, -0.05),
        (25, 0.015),
        (21, -0.005),
    ],
];

/// Displacements of the derived points, given those of all vertices as solved from the landmarks alone.
#[must_use]
pub fn derived(head: &Head, solved: &[Vec3]) -> Vec<(u32, Vec3)> {
    let at = |point: usize| solved[head.points[point] as usize];
    (0..2 * SLIDES.len())
        .map(|k| {
            let right = k >= SLIDES.len();
            let vertex = head.points[LANDMARKS + k];
            let slides = SLIDES[k % SLIDES.len()].iter();
            let d = slides.fold(solved[vertex as usize], |sum, &(point, weight)| {
                let point = if right { mirrored(point) } else { point };
                sum + at(point) * weight
            });
            (vertex, d)
        })
        .collect()
}
