//! Cells and regions: the depth image at a quarter of its size, neighbours of similar depth joined; and the types of a head's
//! cloud and rectangle.
//!
//! A cell is 4 × 4 pixels, sampled at four; its depth is the mean of the samples that agree with the nearest one. Neighbours
//! whose depths differ by less than [`STEP_SHARE`] are joined (two-pass labelling with union–find; Rosenfeld & Pfaltz 1966). A
//! gap of one cell without depth (a projector shadow, an eye) does not split a region.
//!
//! Raw depth in, metres out. Memory: 0.2 MB. Cost: linear in pixels read and cells. Degenerate: regions beyond
//! [`MAX_REGIONS`] stay unlabelled, which loses specks, not heads.

use crate::base::capacity::{DEPTH_BINS, HEAD_POINTS, HEIGHT, PIXELS, WIDTH};
use crate::base::defaults;
use crate::base::geometry::Point;
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;
use crate::camera::Camera;

/// Side of a cell, pixels.
pub(super) const CELL_PX: usize = 4;
/// Cells in a row.
pub(super) const COLUMNS: usize = WIDTH / CELL_PX;
/// Rows of cells.
pub(super) const ROWS: usize = HEIGHT / CELL_PX;
/// Most provisional labels of one image.
const MAX_REGIONS: usize = 4096;
/// Largest difference of a cell's samples in 1/z, 1/m: 35 mm at 1 m.
const CELL_SPREAD: f32 = 0.035;
/// Largest depth step between joined cells, as a share of the distance: 28 mm at 0.7 m, where a cell is 5 mm wide, so surfaces
/// tilted up to 80° stay joined and a hand before the face is separate.
const STEP_SHARE: f32 = 0.04;

defaults! {
    /// Result and scratch of the labelling.
    pub(crate) struct Regions {
        /// Distance of each cell, metres; 0 = none or background.
        pub(crate) depth_m: Vec<f32> = vec![0.0; COLUMNS * ROWS],
        /// Region of each cell, 0 = none.
        pub(crate) label: Vec<u16> = vec![0; COLUMNS * ROWS],
        /// Metres per cell at 1 m.
        pub(crate) cell_at_1m: f32 = 0.0,
        parents: Vec<u16> = vec![0; MAX_REGIONS],
    }
}

/// Counts the depth of every second pixel of every second row.
pub(crate) fn count(depth: &[u16; PIXELS], camera: &Camera, histogram: &mut [u32; DEPTH_BINS]) {
    if camera.raw_is_bin() {
        count_bins(depth, usize::from, histogram);
    } else {
        count_bins(depth, |raw| camera.bin(raw), histogram);
    }
}

/// Counts pixels by `bin` of their raw value. Neighbours, mostly of one bin, are counted in four histograms, because incrementing one
/// bin twice in a row stalls.
fn count_bins(
    depth: &[u16; PIXELS],
    bin: impl Fn(u16) -> usize,
    histogram: &mut [u32; DEPTH_BINS],
) {
    // A sixteenth of the pixels fits a u16.
    const { assert!(PIXELS / 16 <= u16::MAX as usize) };
    let mut apart = [[0u16; DEPTH_BINS]; 4];
    for row in (1..HEIGHT).step_by(2) {
        for pixels in depth[row * WIDTH..(row + 1) * WIDTH].chunks_exact(8) {
            for (counts, raw) in apart.iter_mut().zip(pixels.iter().skip(1).step_by(2)) {
                if let Some(bin) = counts.get_mut(bin(*raw)) {
                    *bin += 1;
                }
            }
        }
    }
    for (k, bin) in histogram.iter_mut().enumerate() {
        *bin += apart.iter().map(|counts| u32::from(counts[k])).sum::<u32>();
    }
}

/// Mean distance of the samples that agree with the nearest one, metres; 0 if it is not before `end` or under two agree.
fn cell_depth(samples: [u16; 4], camera: &Camera, spread: usize, end: u16) -> f32 {
    let [a, b, c, d] = samples;
    let nearest = a.min(b).min(c.min(d));
    if nearest >= end {
        return 0.0;
    }
    let behind = camera.raw_from_bin(camera.bin(nearest) + spread);
    let (mut sum, mut n) = (0.0, 0.0);
    for raw in samples {
        if raw < behind {
            sum += camera.depth_m(raw);
            n += 1.0;
        }
    }
    if n >= 2.0 { sum / n } else { 0.0 }
}

/// Root label of the set of `label`.
fn root(parents: &mut [u16], mut label: u16) -> u16 {
    while parents[usize::from(label)] != label {
        let above = parents[usize::from(parents[usize::from(label)])];
        parents[usize::from(label)] = above;
        label = above;
    }
    label
}

impl Regions {
    /// Fills the cells from raw depths below `end` and labels the regions.
    pub(crate) fn label(&mut self, depth: &[u16; PIXELS], camera: &Camera, end: u16) {
        self.cell_at_1m = CELL_PX as f32 / camera.depth_focal_px();
        let spread = camera.bin_steps(CELL_SPREAD);
        let cells = self.depth_m.chunks_exact_mut(COLUMNS);
        for (row, cells) in cells.enumerate() {
            let pixels = |row: usize| depth[row * WIDTH..(row + 1) * WIDTH].chunks_exact(CELL_PX);
            let upper = pixels(row * CELL_PX + 1);
            let lower = pixels(row * CELL_PX + 3);
            for ((cell, upper), lower) in cells.iter_mut().zip(upper).zip(lower) {
                let samples = [upper[1], upper[3], lower[1], lower[3]];
                *cell = cell_depth(samples, camera, spread, end);
            }
        }
        self.join();
    }

    fn join(&mut self) {
        let Self {
            depth_m,
            label,
            parents,
            ..
        } = self;
        let mut labels = 1usize;
        // Up and left, one and two cells away.
        const BEFORE: [(i32, i32); 6] = [(-1, 0), (0, -1), (-1, -1), (1, -1), (-2, 0), (0, -2)];
        label.fill(0);
        for (row, line) in (0..).zip(depth_m.chunks_exact(COLUMNS)) {
            for (col, &z) in (0..).zip(line) {
                if z <= 0.0 {
                    continue;
                }
                let at = row * COLUMNS as i32 + col;
                let is_inside = row >= 2 && (2..COLUMNS as i32 - 1).contains(&col);
                // The root, and the label last joined with it, which most neighbours share.
                let (mut mine, mut joined) = (0u16, 0u16);
                for (dx, dy) in BEFORE {
                    let (x, y) = (col + dx, row + dy);
                    if !is_inside && (x < 0 || y < 0 || x >= COLUMNS as i32) {
                        continue;
                    }
                    let there = (at + dy * COLUMNS as i32 + dx) as usize;
                    let other = label[there];
                    if other == joined || other == 0 || (depth_m[there] - z).abs() > STEP_SHARE * z
                    {
                        continue;
                    }
                    joined = other;
                    let other = root(parents, other);
                    if mine == 0 {
                        mine = other;
                    } else if mine != other {
                        let (low, high) = (mine.min(other), mine.max(other));
                        parents[usize::from(high)] = low;
                        mine = low;
                    }
                }
                if mine == 0 && labels < MAX_REGIONS {
                    mine = labels as u16;
                    parents[labels] = mine;
                    labels += 1;
                }
                label[at as usize] = mine;
            }
        }
        // Parents are lower labels, so one step in ascending order reaches the root.
        for joined in 1..labels {
            parents[joined] = parents[usize::from(parents[joined])];
        }
        for label in label {
            *label = parents[usize::from(*label)];
        }
    }
}

/// A rectangle of pixels of the depth image: columns `x0..x1`, rows `y0..y1`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PixelRect {
    /// First column.
    pub x0: u16,
    /// First row.
    pub y0: u16,
    /// One past the last column.
    pub x1: u16,
    /// One past the last row.
    pub y1: u16,
}

impl PixelRect {
    /// Whether it is more than a cell away from the edges of an image of `size` (columns, rows).
    pub fn is_within(&self, size: [usize; 2]) -> bool {
        let [right, bottom] = size.map(|pixels| (pixels - CELL_PX) as u16);
        self.x0 > CELL_PX as u16 && self.y0 > CELL_PX as u16 && self.x1 < right && self.y1 < bottom
    }
}

/// Depth points of one head, sensor frame, thinned evenly to capacity.
#[derive(Clone, Debug, Default)]
pub struct HeadCloud {
    /// Points, metres, sensor frame.
    pub points: heapless::Vec<Point, HEAD_POINTS>,
    /// Bounding rectangle in the depth image.
    pub rect: PixelRect,
    /// Whether the head is entirely inside the image.
    pub whole: bool,
    /// Mean of the points, metres, sensor frame.
    pub centre: Point,
    /// Depth pixels of the head before thinning.
    pub pixels: u32,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cell_is_as_far_as_two_of_its_samples_that_agree() {
        let camera = Camera::default();
        let depth = |samples| cell_depth(samples, &camera, 10, 700);
        let mean = |raws: [u16; 2]| raws.map(|raw| camera.depth_m(raw)).iter().sum::<f32>() / 2.0;
        assert_eq!(depth([640, 600, 604, 660]), mean([600, 604]));
        // One alone is stray, and what is behind the foreground is not counted.
        assert_eq!(depth([600, 640, 650, 660]), 0.0);
        assert_eq!(depth([700, 701, 702, 703]), 0.0);
    }
}
