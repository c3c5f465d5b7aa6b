//! Cells and regions: the depth picture at a quarter of its size, neighbours of like depth joined.
//!
//! A cell is 4 × 4 pixels, read at four of them; its depth is the mean of those that agree with the nearest one. Cells
//! whose depths differ by less than their distance explains are joined (two-pass labelling with union–find; Rosenfeld &
//! Pfaltz 1966). A gap of one cell without depth (a shadow of the projector, an eye) does not part a region.
//!
//! Raw depth in, metres inside. Memory: 0.2 MB. Cost: linear in pixels read and cells. Degenerate: more regions than
//! [`MAX_REGIONS`] in one picture: later ones stay unlabelled, which costs specks, not heads.

use crate::capacity::{HEIGHT, PIXELS, RAW_DEPTH_VALUES, WIDTH};
#[cfg(not(feature = "std"))]
use crate::prelude::*;
use crate::sensor::NO_DEPTH;
use crate::sensor::camera::Camera;

/// Side of a cell, pixels.
pub const CELL_PX: usize = 4;
/// Cells in a row.
pub const COLUMNS: usize = WIDTH / CELL_PX;
/// Rows of cells.
pub const ROWS: usize = HEIGHT / CELL_PX;
/// Provisional labels one picture may use.
const MAX_REGIONS: usize = 4096;
/// Raw values by which samples of one cell may differ.
const CELL_SPREAD: u16 = 12;
/// Depth step of neighbouring cells that still hangs together, as a share of the distance: 28 mm at 0.7 m, where a cell
/// is 5 mm wide, so surfaces tilted up to 80° hold together and a hand before the face does not.
const STEP_SHARE: f32 = 0.04;

/// Work space and outcome of the labelling.
pub(crate) struct Regions {
    /// Distance of each cell, metres; 0 = none or background.
    pub(crate) depth_m: Vec<f32>,
    /// Region of each cell, 0 = none.
    pub(crate) label: Vec<u16>,
    /// For pictures, see `Segmenter::mask`.
    pub(crate) mask: Vec<u8>,
    /// Metres per cell at 1 m.
    pub(crate) cell_at_1m: f32,
    parents: Vec<u16>,
}

impl Regions {
    /// Bytes on the heap.
    pub(crate) const BYTES: usize = COLUMNS * ROWS * (4 + 2 + 1) + MAX_REGIONS * 2;
}

impl Default for Regions {
    fn default() -> Self {
        Self {
            depth_m: vec![0.0; COLUMNS * ROWS],
            label: vec![0; COLUMNS * ROWS],
            mask: vec![0; COLUMNS * ROWS],
            cell_at_1m: 0.0,
            parents: vec![0; MAX_REGIONS],
        }
    }
}

/// Counts the raw values of every second pixel of every second row.
pub(crate) fn count(depth: &[u16; PIXELS], histogram: &mut [u32; RAW_DEPTH_VALUES]) {
    for row in (1..HEIGHT).step_by(2) {
        for raw in depth[row * WIDTH..(row + 1) * WIDTH]
            .iter()
            .skip(1)
            .step_by(2)
        {
            if let Some(bin) = histogram.get_mut(usize::from(*raw)) {
                *bin += 1;
            }
        }
    }
    histogram[usize::from(NO_DEPTH)] = 0;
}

impl Regions {
    fn root(&mut self, mut label: u16) -> u16 {
        while self.parents[usize::from(label)] != label {
            let above = self.parents[usize::from(self.parents[usize::from(label)])];
            self.parents[usize::from(label)] = above;
            label = above;
        }
        label
    }

    /// Fills cells from the raw depth below `end` and labels the regions.
    pub(crate) fn label(&mut self, depth: &[u16; PIXELS], camera: &Camera, end: usize) {
        self.cell_at_1m = CELL_PX as f32 / camera.depth_focal_px();
        for row in 0..ROWS {
            for col in 0..COLUMNS {
                let corner = (row * CELL_PX + 1) * WIDTH + col * CELL_PX + 1;
                let samples = [
                    corner,
                    corner + 2,
                    corner + 2 * WIDTH,
                    corner + 2 * WIDTH + 2,
                ]
                .map(|at| depth[at]);
                let nearest = samples.iter().copied().min().unwrap_or(NO_DEPTH);
                let mut metres = 0.0;
                if usize::from(nearest) < end && nearest < NO_DEPTH {
                    let (mut sum, mut n) = (0.0, 0.0);
                    for raw in samples {
                        if raw < nearest + CELL_SPREAD {
                            sum += camera.depth_m(raw);
                            n += 1.0;
                        }
                    }
                    if n >= 2.0 {
                        metres = sum / n;
                    }
                }
                self.depth_m[row * COLUMNS + col] = metres;
                self.mask[row * COLUMNS + col] = u8::from(metres > 0.0);
            }
        }
        self.join();
    }

    fn join(&mut self) {
        let mut labels = 1usize;
        // Up and left, one and two cells away.
        const BEFORE: [(i32, i32); 6] = [(-1, 0), (0, -1), (-1, -1), (1, -1), (-2, 0), (0, -2)];
        for row in 0..ROWS as i32 {
            for col in 0..COLUMNS as i32 {
                let at = row as usize * COLUMNS + col as usize;
                let z = self.depth_m[at];
                self.label[at] = 0;
                if z <= 0.0 {
                    continue;
                }
                let mut mine = 0u16;
                for (dx, dy) in BEFORE {
                    let (x, y) = (col + dx, row + dy);
                    if x < 0 || y < 0 || x >= COLUMNS as i32 {
                        continue;
                    }
                    let there = y as usize * COLUMNS + x as usize;
                    let other = self.label[there];
                    if other == 0 || (self.depth_m[there] - z).abs() > STEP_SHARE * z {
                        continue;
                    }
                    let other = self.root(other);
                    if mine == 0 {
                        mine = other;
                    } else if mine != other {
                        let (low, high) = (mine.min(other), mine.max(other));
                        self.parents[usize::from(high)] = low;
                        mine = low;
                    }
                }
                if mine == 0 && labels < MAX_REGIONS {
                    mine = labels as u16;
                    self.parents[labels] = mine;
                    labels += 1;
                }
                self.label[at] = mine;
            }
        }
        for at in 0..self.label.len() {
            if self.label[at] != 0 {
                self.label[at] = self.root(self.label[at]);
            }
        }
    }
}
