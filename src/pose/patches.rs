//! The patches of forehead, nose and cheeks that tell heads apart ([`super::signature`]), on the anchor's points.
//!
//! Head frame, metres. Memory: one byte per anchor point.

use crate::base::geometry::Point;
use crate::base::prelude::*;

/// Columns and rows of patches over the face.
const GRID: [usize; 2] = [6, 6];

/// Patches.
pub const PLACES: usize = GRID[0] * GRID[1];

/// The patches' area: left, top, right, bottom, metres: forehead to the upper lip, temple to temple.
const AREA_M: [f32; 4] = [-0.066, -0.060, 0.066, 0.052];

/// The patch of a place on the anchor.
fn patch(p: &Point) -> Option<usize> {
    let [left, top, right, bottom] = AREA_M;
    let (x, y) = ((p.x - left) / (right - left), (p.y - top) / (bottom - top));
    let inside = (0.0..1.0).contains(&x) && (0.0..1.0).contains(&y);
    inside.then(|| (y * GRID[1] as f32) as usize * GRID[0] + (x * GRID[0] as f32) as usize)
}

/// The patches of an anchor, and the effect of a motion on each.
#[derive(Clone, Debug)]
pub(crate) struct Patches {
    /// Effect of each of the seven motions on each patch.
    pub(super) rows: [[f64; 7]; PLACES],
    /// Patch of each anchor point, [`PLACES`] for none.
    pub(super) of: Vec<u8>,
}

impl Patches {
    /// Patches from the anchor's points and the effect of motions on them.
    pub(crate) fn new(points: &[Point], motions: &[[f32; 7]]) -> Self {
        let of: Vec<u8> = points
            .iter()
            .map(|p| patch(p).unwrap_or(PLACES) as u8)
            .collect();
        let mut rows = [[0.0; 7]; PLACES];
        let mut counts = [0.0f64; PLACES];
        for (motion, &k) in motions.iter().zip(&of) {
            let k = usize::from(k);
            if k < PLACES {
                for (sum, value) in rows[k].iter_mut().zip(motion) {
                    *sum += f64::from(*value);
                }
                counts[k] += 1.0;
            }
        }
        for (row, count) in rows.iter_mut().zip(counts) {
            for value in row {
                *value /= count.max(1.0);
            }
        }
        Self { rows, of }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patches_are_numbered_as_one_reads_and_end_with_the_area() {
        let [left, top, right, bottom] = AREA_M;
        let at = |column: f32, row: f32| {
            let (x, y) = (
                left + (right - left) * column / 6.0,
                top + (bottom - top) * row / 6.0,
            );
            patch(&Point::new(x, y, 0.0))
        };
        let mut number = 0;
        for row in 0..6 {
            for column in 0..6 {
                let middle = at(column as f32 + 0.5, row as f32 + 0.5);
                assert_eq!(middle, Some(number), "row {row}, column {column}");
                number += 1;
            }
        }
        for (column, row) in [(-0.1, 3.0), (6.1, 3.0), (3.0, -0.1), (3.0, 6.1)] {
            assert_eq!(at(column, row), None);
        }
    }
}
