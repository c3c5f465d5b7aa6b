//! Features around the landmarks: patches of gradient orientation histograms.
//!
//! Once per window: central-difference gradients, each spread over eight orientations by the fourth power of the positive
//! cosine (so the sum over orientations is proportional to the magnitude, without an arc tangent), summed into cells of 2×2
//! pixels and blurred: by σ 1.2 px for patches of lids and lips, whose cells are closer than [`FINE_BELOW_PX`], by σ 2.4 px for
//! the others. Per landmark: 4×4 cells, bilinear, scaled to unit length, square-rooted (the Hellinger map).
//! Histograms of oriented gradients after Dalal and Triggs 2005, used for alignment as in Xiong and De la Torre 2013.
//! Units: window pixels in, values 0…1 out. About 1.7 M operations per window, 35 k look-ups per face; 0.8 MB.
//! Invariant to the scale of the grey values, because the constant of the normalisation is relative to the window's mean
//! gradient. Degenerate: a flat window gives zero patches. Limitation: clipped highlights have no gradients.

use core::hint::black_box;
use core::ops::Range;
use core::sync::atomic::{Ordering, compiler_fence};

use super::window::{Region, WINDOW};
use crate::base::capacity::LANDMARKS;
use crate::base::defaults;
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;
use crate::base::vectors::with_avx2;
use crate::face_model::{FEATURES, ORIENTATIONS, PATCH, PATCH_CELLS};

/// Cells along one side of the maps.
pub const MAP: usize = WINDOW / 2;
/// Patches with cells closer than this use the finer maps, window pixels.
pub const FINE_BELOW_PX: f32 = 3.4;
/// Blur of the finer maps: half a Gaussian of σ 0.6 cells (1.2 px).
const FINE: [f32; 2] = [0.6671, 0.1664];
/// Additional blur of the coarser maps to σ 1.2 cells (2.4 px): half a Gaussian of σ 1.04 cells.
const COARSE: [f32; 4] = [0.3838, 0.2417, 0.0604, 0.0060];
/// Constant of the normalisation as a share of a typical patch's length: keeps empty patches small.
const FLATNESS: f32 = 0.3;

const DIAGONAL: f32 = core::f32::consts::FRAC_1_SQRT_2;
/// x of each orientation's direction, clockwise from the right (y down).
const ACROSS: [f32; ORIENTATIONS] = [
    1.0, DIAGONAL, 0.0, -DIAGONAL, -1.0, -DIAGONAL, 0.0, DIAGONAL,
];
/// y of each orientation's direction, down.
const DOWN: [f32; ORIENTATIONS] = [
    0.0, DIAGONAL, 1.0, DIAGONAL, 0.0, -DIAGONAL, -1.0, -DIAGONAL,
];

defaults! {
    /// Orientation maps of one window: `MAP` × `MAP` cells of eight values, fine and coarse.
    #[derive(Clone)]
    pub struct OrientationMaps {
        fine: Vec<[f32; ORIENTATIONS]> = vec![[0.0; ORIENTATIONS]; MAP * MAP],
        coarse: Vec<[f32; ORIENTATIONS]> = vec![[0.0; ORIENTATIONS]; MAP * MAP],
        scratch: Vec<[f32; ORIENTATIONS]> = vec![[0.0; ORIENTATIONS]; MAP * MAP],
        floor: f32 = 1.0,
        /// Region covered by the maps, window pixels.
        region: Region = Region::WHOLE,
    }
}

impl OrientationMaps {
    /// Computes the maps of a region of a window of [`WINDOW`]² grey values; patches beyond the region repeat its border.
    pub fn compute(&mut self, window: &[f32], region: &Region) {
        self.region = region.clone();
        let cells = Region {
            rows: region.rows.start / 2..region.rows.end / 2,
            columns: region.columns.start / 2..region.columns.end / 2,
        };
        let Self {
            fine,
            coarse,
            scratch,
            ..
        } = self;
        let total = with_avx2(
            #[inline(always)]
            || spread(window, region, coarse),
        );
        with_avx2(
            #[inline(always)]
            || blur(coarse, &FINE, &cells, scratch, fine),
        );
        with_avx2(
            #[inline(always)]
            || blur(fine, &COARSE, &cells, scratch, coarse),
        );
        // A typical cell holds four mean gradients, spread over about three orientations.
        let cell = 4.0 * total / (region.rows.len() * region.columns.len()) as f32;
        self.floor = (FLATNESS * cell * (PATCH_CELLS as f32)).max(1e-3);
    }

    /// Patches around all landmarks (window pixels), with cells `cell_px` apart: [`FEATURES`] values, landmark by landmark.
    pub fn patches(&self, landmarks: &[[f32; 2]; LANDMARKS], cell_px: f32, out: &mut [f32]) {
        debug_assert_eq!(out.len(), FEATURES);
        let maps = if cell_px < FINE_BELOW_PX {
            &self.fine
        } else {
            &self.coarse
        };
        with_avx2(
            #[inline(always)]
            || {
                for (landmark, patch) in landmarks.iter().zip(out.as_chunks_mut::<PATCH>().0) {
                    self.patch(maps, *landmark, cell_px, patch);
                }
            },
        );
    }

    #[inline(always)]
    fn patch(
        &self,
        maps: &[[f32; ORIENTATIONS]],
        landmark: [f32; 2],
        cell_px: f32,
        patch: &mut [f32; PATCH],
    ) {
        let columns = cell_positions(landmark[0], cell_px, &self.region.columns);
        let rows = cell_positions(landmark[1], cell_px, &self.region.rows);
        let mut squares = [0.0f32; ORIENTATIONS];
        let cells = patch.as_chunks_mut::<ORIENTATIONS>().0;
        let lines = cells.as_chunks_mut::<PATCH_CELLS>().0;
        for (line, (row, down)) in lines.iter_mut().zip(rows) {
            // One slice of both rows: one bounds check.
            let (upper, lower) = maps[row * MAP..][..2 * MAP].split_at(MAP);
            for (values, (column, across)) in line.iter_mut().zip(columns) {
                *values = between(upper, lower, column, across, down);
                for k in 0..ORIENTATIONS {
                    squares[k] += values[k] * values[k];
                }
            }
        }
        let squared = self.floor * self.floor + squares.iter().sum::<f32>();
        let inverse = 1.0 / squared.sqrt();
        for value in patch {
            *value = (*value * inverse).max(0.0).sqrt();
        }
    }
}

/// Spreads the gradients of a region over orientations into cells; returns the sum of their magnitudes.
#[inline(always)]
fn spread(window: &[f32], region: &Region, cells: &mut [[f32; ORIENTATIONS]]) -> f32 {
    let pixels = window.as_chunks::<WINDOW>().0;
    // Hidden from constant folding: special cases of ones and zeros cost more than they save.
    let (across, down) = black_box((ACROSS, DOWN));
    let (mut gx, mut gy) = ([0.0f32; WINDOW], [0.0f32; WINDOW]);
    let (mut magnitude, mut inverse) = ([0.0f32; WINDOW], [0.0f32; WINDOW]);
    let mut totals = [0.0f32; ORIENTATIONS];
    let columns = region.columns.start..region.columns.end.min(WINDOW);
    for row in region.rows.clone() {
        let cells =
            &mut cells.as_chunks_mut::<MAP>().0[row / 2][columns.start / 2..columns.end / 2];
        if row % 2 == 0 {
            cells.fill([0.0; ORIENTATIONS]);
        }
        if row == region.rows.start || row + 1 == region.rows.end {
            continue;
        }
        let (line, above, below) = (&pixels[row], &pixels[row - 1], &pixels[row + 1]);
        for column in columns.start + 1..columns.end - 1 {
            let x = line[column + 1] - line[column - 1];
            let y = below[column] - above[column];
            let squared = x * x + y * y;
            magnitude[column] = squared.sqrt();
            // Inverse cube, because magnitude × cosine⁴ is projection⁴ / magnitude³. The constant avoids 0 / 0.
            inverse[column] = 1.0 / (squared * magnitude[column] + 1e-12);
            (gx[column], gy[column]) = (x, y);
        }
        for part in magnitude.as_chunks::<ORIENTATIONS>().0 {
            for k in 0..ORIENTATIONS {
                totals[k] += part[k];
            }
        }
        let within = columns.start / 2..columns.end / 2;
        let [gx, gy, inverse] =
            [&gx, &gy, &inverse].map(|values| &values.as_chunks::<2>().0[within.clone()]);
        for (((cell, gx), gy), inverse) in cells.iter_mut().zip(gx).zip(gy).zip(inverse) {
            // Makes the compiler vectorise over orientations, not cells, which is slower.
            compiler_fence(Ordering::Release);
            for pixel in 0..2 {
                for k in 0..ORIENTATIONS {
                    let along = gx[pixel] * across[k] + gy[pixel] * down[k];
                    let squared = along.max(0.0) * along.max(0.0);
                    cell[k] += squared * squared * inverse[pixel];
                }
            }
        }
    }
    totals.iter().sum()
}

/// Blurs a region of cells by a separable symmetric kernel, given as its half; the border is repeated.
#[inline(always)]
fn blur<const TAPS: usize>(
    from: &[[f32; ORIENTATIONS]],
    kernel: &[f32; TAPS],
    cells: &Region,
    scratch: &mut [[f32; ORIENTATIONS]],
    to: &mut [[f32; ORIENTATIONS]],
) {
    let columns = cells.columns.clone();
    let inside = columns.start + TAPS..columns.end - TAPS;
    for row in cells.rows.clone() {
        let line = &from.as_chunks::<MAP>().0[row];
        let out = &mut scratch.as_chunks_mut::<MAP>().0[row];
        for column in (columns.start..inside.start).chain(inside.end..columns.end) {
            let mut sum = scaled(&line[column], kernel[0]);
            for distance in 1..TAPS {
                let left = column.saturating_sub(distance).max(columns.start);
                let right = (column + distance).min(columns.end - 1);
                add_pair(&mut sum, &line[left], &line[right], kernel[distance]);
            }
            out[column] = sum;
        }
        for column in inside.clone() {
            let mut sum = scaled(&line[column], kernel[0]);
            for distance in 1..TAPS {
                let (left, right) = (column - distance, column + distance);
                add_pair(&mut sum, &line[left], &line[right], kernel[distance]);
            }
            out[column] = sum;
        }
    }
    let lines = scratch.as_chunks::<MAP>().0;
    for row in cells.rows.clone() {
        let mut above = [&lines[row]; TAPS];
        let mut below = above;
        for distance in 1..TAPS {
            above[distance] = &lines[row.saturating_sub(distance).max(cells.rows.start)];
            below[distance] = &lines[(row + distance).min(cells.rows.end - 1)];
        }
        let out = &mut to.as_chunks_mut::<MAP>().0[row];
        for column in columns.clone() {
            let mut sum = scaled(&lines[row][column], kernel[0]);
            for distance in 1..TAPS {
                let (a, b) = (&above[distance][column], &below[distance][column]);
                add_pair(&mut sum, a, b, kernel[distance]);
            }
            out[column] = sum;
        }
    }
}

#[inline(always)]
fn scaled(values: &[f32; ORIENTATIONS], by: f32) -> [f32; ORIENTATIONS] {
    let mut out = *values;
    for value in &mut out {
        *value *= by;
    }
    out
}

#[inline(always)]
fn add_pair(
    sum: &mut [f32; ORIENTATIONS],
    a: &[f32; ORIENTATIONS],
    b: &[f32; ORIENTATIONS],
    weight: f32,
) {
    for k in 0..ORIENTATIONS {
        sum[k] += weight * (a[k] + b[k]);
    }
}

/// Along one axis of a patch: the map cell before each patch cell, and the share of the way to the next; clamped to the region.
#[inline(always)]
fn cell_positions(middle: f32, cell_px: f32, along: &Range<usize>) -> [(usize, f32); PATCH_CELLS] {
    let (least, most) = ((along.start / 2) as f32, (along.end / 2 - 1) as f32 - 1e-3);
    let first = -0.5 * (PATCH_CELLS as f32 - 1.0);
    core::array::from_fn(|k| {
        let pixel = middle + (first + k as f32) * cell_px;
        let cell = ((pixel - 0.5) * 0.5).max(least).min(most);
        let whole = cell as i32;
        (whole as usize, cell - whole as f32)
    })
}

/// Bilinear value in two rows of a map, at shares `across` to the next column and `down` to the lower row.
#[inline(always)]
fn between(
    upper: &[[f32; ORIENTATIONS]],
    lower: &[[f32; ORIENTATIONS]],
    column: usize,
    across: f32,
    down: f32,
) -> [f32; ORIENTATIONS] {
    let (a, b) = (&upper[column], &upper[column + 1]);
    let (c, d) = (&lower[column], &lower[column + 1]);
    let (wa, wb) = ((1.0 - across) * (1.0 - down), across * (1.0 - down));
    let (wc, wd) = ((1.0 - across) * down, across * down);
    let mut value = [0.0; ORIENTATIONS];
    for k in 0..ORIENTATIONS {
        value[k] = wa * a[k] + wb * b[k] + wc * c[k] + wd * d[k];
    }
    value
}

#[cfg(test)]
mod tests {
    use super::*;

    fn edge(angle: f32, gain: f32) -> Vec<f32> {
        let (sin, cos) = angle.sin_cos();
        (0..WINDOW * WINDOW)
            .map(|i| {
                let (x, y) = ((i % WINDOW) as f32 - 92.0, (i / WINDOW) as f32 - 92.0);
                gain * (100.0 + 50.0 * ((x * cos + y * sin) * 0.5).tanh())
            })
            .collect()
    }

    #[test]
    fn an_edge_fills_its_own_orientation() {
        for k in 0..ORIENTATIONS {
            let mut maps = OrientationMaps::default();
            maps.compute(
                &edge(k as f32 * core::f32::consts::FRAC_PI_4, 1.0),
                &Region::WHOLE,
            );
            let value = maps.coarse[46 * MAP + 46];
            let strongest = (0..ORIENTATIONS).max_by(|&a, &b| value[a].total_cmp(&value[b]));
            assert_eq!(strongest, Some(k), "{value:?}");
        }
    }

    #[test]
    fn the_gradients_of_a_slope_add_up_over_all_but_the_border() {
        let slope = |i: usize| 0.3 * (i % WINDOW) as f32 + 0.4 * (i / WINDOW) as f32;
        let window: Vec<f32> = (0..WINDOW * WINDOW).map(slope).collect();
        let mut cells = vec![[0.0; ORIENTATIONS]; MAP * MAP];
        let total = spread(&window, &Region::WHOLE, &mut cells);
        // Differences over two pixels.
        let expected = (WINDOW - 2).pow(2) as f32 * 2.0 * 0.5;
        assert!((total / expected - 1.0).abs() < 1e-3, "{total} {expected}");
    }

    #[test]
    fn patches_are_interpolated_and_repeat_the_border() {
        let row = |from: f32| [from, from + 1.0].map(|value| [value; ORIENTATIONS]);
        let value = between(&row(1.0), &row(5.0), 0, 0.25, 0.5);
        assert_eq!(value, [3.25; ORIENTATIONS]);
        // Cells are two pixels wide, and the last but one is the last that has a next.
        for (middle, cell) in [(-900.0, 10), (900.0, 48)] {
            let cells = cell_positions(middle, 5.0, &(20..100));
            assert!(cells.iter().all(|(found, _)| *found == cell), "{cells:?}");
        }
    }

    #[test]
    fn brightness_and_contrast_do_not_matter() {
        let landmarks = [[93.0, 90.0]; LANDMARKS];
        let patches = |gain, cell_px| {
            let mut maps = OrientationMaps::default();
            maps.compute(&edge(0.4, gain), &Region::WHOLE);
            let mut out = vec![0.0; FEATURES];
            maps.patches(&landmarks, cell_px, &mut out);
            out
        };
        for cell_px in [5.0, 2.5] {
            for (a, b) in patches(1.0, cell_px).iter().zip(patches(0.25, cell_px)) {
                assert!((a - b).abs() < 1e-3);
            }
        }
    }

    #[test]
    fn wider_vectors_change_nothing() {
        let window = edge(0.4, 0.7);
        let mut narrow = vec![[0.0; ORIENTATIONS]; MAP * MAP];
        let mut broad = narrow.clone();
        let total = spread(&window, &Region::WHOLE, &mut narrow);
        let same = with_avx2(
            #[inline(always)]
            || spread(&window, &Region::WHOLE, &mut broad),
        );
        assert_eq!(total.to_bits(), same.to_bits());
        assert!(narrow == broad);
    }
}
