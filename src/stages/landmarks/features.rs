//! Features around the landmarks: patches of gradient orientation histograms.
//!
//! Once per window: central-difference gradients, each spread over eight orientations by the fourth power of the positive
//! cosine (so the sum over orientations is proportional to the magnitude, without an arc tangent), summed into cells of 2×2
//! pixels and blurred: by σ 1.2 px for patches of lids and lips, whose cells are closer than [`FINE_BELOW_PX`], by σ 2.4 px for
//! the others. Per landmark: 4×4 cells, bilinear, scaled to unit length, square-rooted (the Hellinger map).
//! Histograms of oriented gradients after Dalal and Triggs 2005, used for alignment as in Xiong and De la Torre 2013.
//! Units: window pixels in, values 0…1 out. About 1.7 M operations per window, 35 k look-ups per face; 0.6 MB.
//! Invariant to the scale of the grey values, because the constant of the normalisation is relative to the window's mean
//! gradient. Degenerate: a flat window gives zero patches. Limitation: clipped highlights have no gradients.

use core::hint::black_box;
use core::ops::Range;
use core::sync::atomic::{Ordering, compiler_fence};

use super::window::{LumaImage, Placement, Region, RowSampler, WINDOW};
use crate::base::capacity::LANDMARKS;
use crate::base::defaults;
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;
use crate::base::vectors::{NO_FRACTION, with_avx2};
use crate::face_model::{FEATURES, ORIENTATIONS, PATCH, PATCH_CELLS};

/// Cells along one side of the maps.
pub const MAP: usize = WINDOW / 2;
/// Cells beyond either end of a line, where blurring across repeats the border.
const BORDER: usize = COARSE.len() - 1;
/// Cells in memory from one line of the maps to the next.
const LINE: usize = MAP + 2 * BORDER;
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
    /// Orientation maps of one window: `MAP` lines of [`LINE`] cells of eight values, fine and coarse.
    #[derive(Clone)]
    pub struct OrientationMaps {
        fine: Vec<[f32; ORIENTATIONS]> = vec![[0.0; ORIENTATIONS]; MAP * LINE],
        coarse: Vec<[f32; ORIENTATIONS]> = vec![[0.0; ORIENTATIONS]; MAP * LINE],
        /// Ring buffers of lines blurred across, the input of each map's blur down. A line is stored at its row modulo the number of
        /// lines, which is at least the height of the kernel.
        fine_across: Vec<[f32; ORIENTATIONS]> = vec![[0.0; ORIENTATIONS]; 2 * FINE.len() * LINE],
        coarse_across: Vec<[f32; ORIENTATIONS]> = vec![[0.0; ORIENTATIONS]; 2 * COARSE.len() * LINE],
        floor: f32 = 1.0,
        /// Region covered by the maps, window pixels.
        region: Region = Region::WHOLE,
    }
}

impl OrientationMaps {
    /// Computes the maps of a region of a window of [`WINDOW`]² grey values; patches beyond the region repeat its border.
    pub fn compute(&mut self, window: &[f32], region: &Region) {
        self.compute_rows(region, rows_of(window));
    }

    /// Computes the maps of a region of a window of an image, without storing the window.
    pub fn sample(&mut self, placement: &Placement, image: LumaImage, region: &Region) {
        let mut sampler = RowSampler::new(placement, image);
        self.compute_rows(
            region,
            #[inline(always)]
            |row, line| sampler.sample(row, &region.columns, line),
        );
    }

    #[inline(always)]
    fn compute_rows(&mut self, region: &Region, load: impl FnMut(usize, &mut [f32; WINDOW])) {
        self.region = region.clone();
        let cells = Region {
            rows: region.rows.start / 2..region.rows.end / 2,
            columns: BORDER + region.columns.start / 2..BORDER + region.columns.end / 2,
        };
        let total = with_avx2(
            #[inline(always)]
            || self.fill(region, &cells, load),
        );
        // A typical cell holds four mean gradients, spread over about three orientations.
        let cell = 4.0 * total / (region.rows.len() * region.columns.len()) as f32;
        self.floor = (FLATNESS * cell * (PATCH_CELLS as f32)).max(1e-3);
    }

    /// Fills both maps line by line, so that each step finds its input in the cache; returns the sum of the gradients' magnitudes.
    /// `load` writes the grey values of a row of pixels.
    #[inline(always)]
    fn fill(
        &mut self,
        region: &Region,
        cells: &Region,
        mut load: impl FnMut(usize, &mut [f32; WINDOW]),
    ) -> f32 {
        // The last rows of pixels, the row number modulo 4.
        let mut grey = [[0.0; WINDOW]; 4];
        let mut gradients = <[Gradients; 2]>::default();
        let mut totals = [0.0; ORIENTATIONS];
        let mut line = [[0.0; ORIENTATIONS]; LINE];
        let [fine, coarse, fine_across, coarse_across] = [
            &mut self.fine,
            &mut self.coarse,
            &mut self.fine_across,
            &mut self.coarse_across,
        ]
        .map(|cells| cells.as_chunks_mut::<LINE>().0);
        let Region { rows, columns } = cells;
        let pixels = &region.rows;
        load(pixels.start, &mut grey[pixels.start % 4]);
        for row in rows.start..rows.end + FINE.len() + COARSE.len() - 2 {
            if row < rows.end {
                let upper = 2 * row;
                for next in upper + 1..(upper + 3).min(pixels.end) {
                    load(next, &mut grey[next % 4]);
                }
                for (pixel_row, gradients) in (upper..).zip(&mut gradients) {
                    // The first and the last row have no neighbours on one side, and no gradients.
                    if pixel_row == pixels.start || pixel_row + 1 == pixels.end {
                        *gradients = Gradients::default();
                        continue;
                    }
                    let around = [3, 4, 5].map(|ahead| &grey[(pixel_row + ahead) % 4]);
                    gradients.compute(around, &region.columns, &mut totals);
                }
                spread(&gradients, &region.columns, &mut line);
                let slot = row % (2 * FINE.len());
                blur_across(&mut line, &FINE, columns, &mut fine_across[slot]);
            }
            let row = row.wrapping_sub(FINE.len() - 1);
            if rows.contains(&row) {
                blur_down(fine_across, &FINE, cells, row, &mut fine[row]);
                let slot = row % (2 * COARSE.len());
                blur_across(&mut fine[row], &COARSE, columns, &mut coarse_across[slot]);
            }
            let row = row.wrapping_sub(COARSE.len() - 1);
            if rows.contains(&row) {
                blur_down(coarse_across, &COARSE, cells, row, &mut coarse[row]);
            }
        }
        totals.iter().sum()
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
        let (columns, across) = cell_positions(landmark[0], cell_px, &self.region.columns);
        let (rows, down) = cell_positions(landmark[1], cell_px, &self.region.rows);
        let mut squares = [0.0f32; ORIENTATIONS];
        let cells = patch.as_chunks_mut::<ORIENTATIONS>().0;
        let lines = cells.as_chunks_mut::<PATCH_CELLS>().0;
        for (j, line) in lines.iter_mut().enumerate() {
            for (i, values) in line.iter_mut().enumerate() {
                // One slice of both rows: one bounds check.
                let cell = BORDER + (rows[j] * LINE as u32 + columns[i]) as usize;
                let square = &maps[cell..cell + LINE + 2];
                *values = between(square, across[i], down[j]);
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

/// Reads the rows of a whole window.
#[inline(always)]
fn rows_of(window: &[f32]) -> impl FnMut(usize, &mut [f32; WINDOW]) {
    let rows = window.as_chunks::<WINDOW>().0;
    #[inline(always)]
    |row, line| *line = rows[row]
}

defaults! {
    /// Gradients of a row of pixels.
    struct Gradients {
        gx: [f32; WINDOW] = [0.0; WINDOW],
        gy: [f32; WINDOW] = [0.0; WINDOW],
        magnitude: [f32; WINDOW] = [0.0; WINDOW],
        inverse: [f32; WINDOW] = [0.0; WINDOW],
    }
}

impl Gradients {
    /// From a row of pixels and those above and below, between the first and the last of `columns`; adds the magnitudes to `totals`.
    #[inline(always)]
    fn compute(
        &mut self,
        [above, line, below]: [&[f32; WINDOW]; 3],
        columns: &Range<usize>,
        totals: &mut [f32; ORIENTATIONS],
    ) {
        for column in columns.start + 1..columns.end.min(WINDOW) - 1 {
            let x = line[column + 1] - line[column - 1];
            let y = below[column] - above[column];
            let squared = x * x + y * y;
            self.magnitude[column] = squared.sqrt();
            // Inverse cube, because magnitude × cosine⁴ is projection⁴ / magnitude³. The constant avoids 0 / 0.
            self.inverse[column] = 1.0 / (squared * self.magnitude[column] + 1e-12);
            (self.gx[column], self.gy[column]) = (x, y);
        }
        for part in self.magnitude.as_chunks::<ORIENTATIONS>().0 {
            for k in 0..ORIENTATIONS {
                totals[k] += part[k];
            }
        }
    }
}

/// Spreads the gradients of the two rows of pixels in a line of cells over orientations.
#[inline(always)]
fn spread(
    gradients: &[Gradients; 2],
    columns: &Range<usize>,
    cells: &mut [[f32; ORIENTATIONS]; LINE],
) {
    // Hidden from constant folding: special cases of ones and zeros cost more than they save.
    let (across, down) = black_box((ACROSS, DOWN));
    let within = columns.start / 2..columns.end / 2;
    let cells = &mut cells[BORDER..][within.clone()];
    let [upper, lower] = gradients.each_ref().map(|row| {
        let [gx, gy, inverse] = [&row.gx, &row.gy, &row.inverse]
            .map(|values| &values.as_chunks::<2>().0[within.clone()]);
        gx.iter().zip(gy).zip(inverse)
    });
    for (cell, (upper, lower)) in cells.iter_mut().zip(upper.zip(lower)) {
        // Makes the compiler vectorise over orientations, not cells, which is slower.
        compiler_fence(Ordering::Release);
        let mut sums = [0.0; ORIENTATIONS];
        // Not in a loop, which would not be unrolled.
        add_gradients(&mut sums, upper, &across, &down);
        add_gradients(&mut sums, lower, &across, &down);
        *cell = sums;
    }
}

/// Adds two pixels, given as x and y of their gradients and the inverse cubes of the magnitudes.
#[inline(always)]
fn add_gradients(
    sums: &mut [f32; ORIENTATIONS],
    ((gx, gy), inverse): ((&[f32; 2], &[f32; 2]), &[f32; 2]),
    across: &[f32; ORIENTATIONS],
    down: &[f32; ORIENTATIONS],
) {
    for pixel in 0..2 {
        for k in 0..ORIENTATIONS {
            let along = gx[pixel] * across[k] + gy[pixel] * down[k];
            let squared = along.max(0.0) * along.max(0.0);
            sums[k] += squared * squared * inverse[pixel];
        }
    }
}

/// Blurs the cells of a line in `columns` by a symmetric kernel, given as its half; the border is repeated.
#[inline(always)]
fn blur_across<const TAPS: usize>(
    line: &mut [[f32; ORIENTATIONS]; LINE],
    kernel: &[f32; TAPS],
    columns: &Range<usize>,
    out: &mut [[f32; ORIENTATIONS]; LINE],
) {
    for distance in 1..TAPS {
        line[columns.start - distance] = line[columns.start];
        line[columns.end - 1 + distance] = line[columns.end - 1];
    }
    for column in columns.clone() {
        let mut sum = scaled(&line[column], kernel[0]);
        for distance in 1..TAPS {
            let (left, right) = (&line[column - distance], &line[column + distance]);
            add_pair(&mut sum, left, right, kernel[distance]);
        }
        out[column] = sum;
    }
}

/// Blurs `lines` vertically into row `row`, as [`blur_across`] does horizontally. Each line is stored at its row modulo 2 × `TAPS`.
#[inline(always)]
fn blur_down<const TAPS: usize>(
    lines: &[[[f32; ORIENTATIONS]; LINE]],
    kernel: &[f32; TAPS],
    cells: &Region,
    row: usize,
    out: &mut [[f32; ORIENTATIONS]; LINE],
) {
    let line = |row: usize| &lines[row % (2 * TAPS)];
    let mut above = [line(row); TAPS];
    let mut below = above;
    for distance in 1..TAPS {
        above[distance] = line(row.saturating_sub(distance).max(cells.rows.start));
        below[distance] = line((row + distance).min(cells.rows.end - 1));
    }
    for column in cells.columns.clone() {
        let mut sum = scaled(&above[0][column], kernel[0]);
        for distance in 1..TAPS {
            let (a, b) = (&above[distance][column], &below[distance][column]);
            add_pair(&mut sum, a, b, kernel[distance]);
        }
        out[column] = sum;
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
fn cell_positions(
    middle: f32,
    cell_px: f32,
    along: &Range<usize>,
) -> ([u32; PATCH_CELLS], [f32; PATCH_CELLS]) {
    let (least, most) = ((along.start / 2) as f32, (along.end / 2 - 1) as f32 - 1e-3);
    let first = -0.5 * (PATCH_CELLS as f32 - 1.0);
    let cells: [f32; PATCH_CELLS] = core::array::from_fn(|k| {
        let pixel = middle + (first + k as f32) * cell_px;
        ((pixel - 0.5) * 0.5).max(least).min(most)
    });
    let whole = cells.map(f32::floor);
    (
        whole.map(|whole| (whole + NO_FRACTION).to_bits() - NO_FRACTION.to_bits()),
        core::array::from_fn(|k| cells[k] - whole[k]),
    )
}

/// Bilinear value in a map that begins with the upper left one of four cells, at shares `across` to the next column and `down` to the
/// lower row.
#[inline(always)]
fn between(map: &[[f32; ORIENTATIONS]], across: f32, down: f32) -> [f32; ORIENTATIONS] {
    let (a, b, c, d) = (&map[0], &map[1], &map[LINE], &map[LINE + 1]);
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

    /// The cells of a whole window.
    const CELLS: Region = Region {
        rows: 0..MAP,
        columns: BORDER..BORDER + MAP,
    };

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
            let value = maps.coarse[46 * LINE + BORDER + 46];
            let strongest = (0..ORIENTATIONS).max_by(|&a, &b| value[a].total_cmp(&value[b]));
            assert_eq!(strongest, Some(k), "{value:?}");
        }
    }

    #[test]
    fn the_gradients_of_a_slope_add_up_over_all_but_the_border() {
        let slope = |i: usize| 0.3 * (i % WINDOW) as f32 + 0.4 * (i / WINDOW) as f32;
        let window: Vec<f32> = (0..WINDOW * WINDOW).map(slope).collect();
        let total = OrientationMaps::default().fill(&Region::WHOLE, &CELLS, rows_of(&window));
        // Differences over two pixels.
        let expected = (WINDOW - 2).pow(2) as f32 * 2.0 * 0.5;
        assert!((total / expected - 1.0).abs() < 1e-3, "{total} {expected}");
    }

    #[test]
    fn patches_are_interpolated_and_repeat_the_border() {
        let mut map = [[0.0; ORIENTATIONS]; LINE + 2];
        for (cell, value) in [(0, 1.0), (1, 2.0), (LINE, 5.0), (LINE + 1, 6.0)] {
            map[cell] = [value; ORIENTATIONS];
        }
        let value = between(&map, 0.25, 0.5);
        assert_eq!(value, [3.25; ORIENTATIONS]);
        // Cells are two pixels wide, and the last but one is the last that has a next.
        for (middle, cell) in [(-900.0, 10), (900.0, 48)] {
            let cells = cell_positions(middle, 5.0, &(20..100));
            assert_eq!(cells.0, [cell; PATCH_CELLS]);
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
        let (mut narrow, mut broad) = <(OrientationMaps, OrientationMaps)>::default();
        let total = narrow.fill(&Region::WHOLE, &CELLS, rows_of(&window));
        let same = with_avx2(
            #[inline(always)]
            || broad.fill(&Region::WHOLE, &CELLS, rows_of(&window)),
        );
        assert_eq!(total.to_bits(), same.to_bits());
        assert!(narrow.fine == broad.fine && narrow.coarse == broad.coarse);
    }
}
