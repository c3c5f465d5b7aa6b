//! Search of faces in a whole grey image, for frames without depth.
//!
//! A sliding window over an image pyramid: cells of gradient orientations, each normalised by its neighbourhood, against one linear
//! template of a face. Histograms of oriented gradients after Dalal and Triggs 2005; the template is a linear discriminant against
//! pictures without faces (Hariharan, Malik and Ramanan 2012), learned by `mien-studio train`. The best windows are candidates only:
//! the landmark fit there confirms a face or not ([`super::LandmarkFitter::search_in_image`]).
//!
//! Each call searches one of the [`PARTS`] of the pyramid, near faces first, which bounds its cost: about 1.5 ms. Image pixels;
//! pixels per metre at the face. Memory: 0.7 MB, allocated at construction. Limitation: frontal upright faces, up to about 30° of
//! yaw and 20° of roll, 40 to 240 pixels wide.

use core::ops::Range;

use crate::base::capacity::{HEIGHT, PIXELS, WIDTH};
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;
use crate::base::vectors::with_avx2;
use crate::face_model::{FaceTemplate, ORIENTATIONS, TEMPLATE_CELLS};

/// Side of a cell, pixels.
pub const CELL: usize = 4;
/// Pixels per metre of the face that the template shows: a face 0.145 m wide has 32 pixels.
pub const TEMPLATE_PIXELS_PER_METRE: f32 = 222.0;
/// Pixel of the template between the inner corners of the eyes, where the head frame has its origin.
pub const TEMPLATE_ORIGIN: [f32; 2] = [20.0, 14.0];
/// Image pixels per pixel of the finest level.
const FINEST: f32 = 1.25;
/// Reduction from level to level.
const STEP: f32 = 1.2;
/// Levels searched together, coarsest first; the finest alone costs as much as all others.
const LEVELS: [Range<i32>; PARTS as usize] = [4..11, 2..4, 1..2, 0..1];
/// Calls that search the whole pyramid.
pub const PARTS: u32 = 4;
/// Most candidates of a call.
pub const CANDIDATES: usize = 3;
/// Energy of a cell's neighbourhood at which its values are damped by half: flat areas have no orientation.
const FLAT: f32 = 600.0;
/// Tangent of 22.5°: half of an orientation.
const HALF_ORIENTATION: f32 = 0.414_213_56;

/// Columns and rows of the finest level, a whole number of cells.
const LARGEST: [usize; 2] = [
    (WIDTH as f32 / FINEST) as usize / CELL * CELL,
    (HEIGHT as f32 / FINEST) as usize / CELL * CELL,
];

/// A place where a face may be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    /// Pixel between the inner corners of the eyes.
    pub pixel: [f32; 2],
    /// Pixels per metre at the face.
    pub pixels_per_metre: f32,
    /// Agreement with the template; above 0 for a candidate.
    pub score: f32,
}

/// Cells of a level and the buffers to compute them.
pub struct Cells {
    /// Columns and rows, in cells.
    pub size: [usize; 2],
    /// Grey values of the level, row by row.
    level: Vec<u8>,
    sums: Vec<[f32; ORIENTATIONS]>,
    energy: Vec<f32>,
    /// Normalised cells, row by row.
    pub values: Vec<[f32; ORIENTATIONS]>,
}

impl Default for Cells {
    fn default() -> Self {
        let [columns, rows] = LARGEST;
        let cells = columns * rows / (CELL * CELL);
        Self {
            size: [0; 2],
            level: vec![0; columns * rows],
            sums: vec![[0.0; ORIENTATIONS]; cells],
            energy: vec![0.0; cells],
            values: vec![[0.0; ORIENTATIONS]; cells],
        }
    }
}

impl Cells {
    /// Computes the cells of a grey image of `columns` × `rows`, reduced by `scale` from the pixel `first` on, at most as large as the
    /// finest level of a search.
    pub fn compute(
        &mut self,
        luma: &[u8],
        [columns, rows]: [usize; 2],
        first: [f32; 2],
        scale: f32,
    ) {
        let cells = |pixels: usize, first: f32, most: usize| {
            let level = ((pixels as f32 - first) / scale).max(0.0) as usize;
            level.min(most) / CELL
        };
        self.size = [
            cells(columns, first[0], LARGEST[0]),
            cells(rows, first[1], LARGEST[1]),
        ];
        self.reduce(luma, [columns, rows], first, scale);
        self.sum_orientations();
        self.normalise();
    }

    /// Means over areas of `scale`² pixels.
    fn reduce(&mut self, luma: &[u8], [columns, rows]: [usize; 2], first: [f32; 2], scale: f32) {
        let width = self.size[0] * CELL;
        let span = |from: f32, at: usize, most: usize| {
            let start = ((from + at as f32 * scale).max(0.0) as usize).min(most - 1);
            let end = (from + (at + 1) as f32 * scale).round().max(0.0) as usize;
            start..end.clamp(start + 1, most)
        };
        for (y, line) in self.level.chunks_exact_mut(width.max(1)).enumerate() {
            if y >= self.size[1] * CELL {
                break;
            }
            let down = span(first[1], y, rows);
            for (x, out) in line.iter_mut().enumerate() {
                let across = span(first[0], x, columns);
                let count = (down.len() * across.len()) as u32;
                let lines = down
                    .clone()
                    .map(|row| &luma[row * columns..][across.clone()]);
                let sum: u32 = lines.flatten().map(|&grey| u32::from(grey)).sum();
                *out = (sum / count) as u8;
            }
        }
    }

    /// Sums the gradient's magnitude in each cell by orientation.
    fn sum_orientations(&mut self) {
        let [columns, rows] = self.size.map(|cells| cells * CELL);
        self.sums[..self.size[0] * self.size[1]].fill([0.0; ORIENTATIONS]);
        for y in 1..rows.max(1) - 1 {
            let line = |row: usize| &self.level[row * columns..][..columns];
            let (above, here, below) = (line(y - 1), line(y), line(y + 1));
            let sums = &mut self.sums[y / CELL * self.size[0]..][..self.size[0]];
            for x in 1..columns.max(1) - 1 {
                let across = f32::from(here[x + 1]) - f32::from(here[x - 1]);
                let down = f32::from(below[x]) - f32::from(above[x]);
                sums[x / CELL][orientation(across, down)] += across.hypot(down);
            }
        }
    }

    /// Divides each cell by its neighbourhood of 3 × 3 cells, and takes square roots (the Hellinger map).
    fn normalise(&mut self) {
        let [columns, rows] = self.size;
        for (energy, sums) in self.energy.iter_mut().zip(&self.sums).take(columns * rows) {
            *energy = sums.iter().sum();
        }
        for y in 0..rows {
            let down = y.saturating_sub(1)..(y + 2).min(rows);
            for x in 0..columns {
                let across = x.saturating_sub(1)..(x + 2).min(columns);
                let lines = down
                    .clone()
                    .map(|row| &self.energy[row * columns..][across.clone()]);
                let energy: f32 = lines.flatten().sum();
                let scale = 9.0 / (energy + FLAT);
                self.values[y * columns + x] =
                    self.sums[y * columns + x].map(|sum| (sum * scale).sqrt());
            }
        }
    }

    /// Sum of products of the template with the window whose first cell is given.
    #[inline(always)]
    fn product(&self, template: &FaceTemplate, column: usize, row: usize) -> f32 {
        let mut sums = [0.0f32; ORIENTATIONS];
        for (y, weights) in template.weights.chunks_exact(TEMPLATE_CELLS).enumerate() {
            let cells = &self.values[(row + y) * self.size[0] + column..][..TEMPLATE_CELLS];
            for (cell, weights) in cells.iter().zip(weights) {
                for ((sum, value), weight) in sums.iter_mut().zip(cell).zip(weights) {
                    *sum += value * weight;
                }
            }
        }
        sums.iter().sum()
    }
}

/// Which of eight orientations a gradient has, clockwise from the right.
fn orientation(across: f32, down: f32) -> usize {
    let (x, y) = (across.abs(), down.abs());
    if y < x * HALF_ORIENTATION {
        if across > 0.0 { 0 } else { 4 }
    } else if x < y * HALF_ORIENTATION {
        if down > 0.0 { 2 } else { 6 }
    } else {
        match (across > 0.0, down > 0.0) {
            (true, true) => 1,
            (false, true) => 3,
            (false, false) => 5,
            (true, false) => 7,
        }
    }
}

/// Searches whole images, one part of the pyramid a call.
pub struct FaceSearch {
    template: FaceTemplate,
    cells: Cells,
    part: usize,
}

impl FaceSearch {
    /// A search with a template; all memory is allocated here.
    pub fn new(template: FaceTemplate) -> Self {
        Self {
            template,
            cells: Cells::default(),
            part: 0,
        }
    }

    /// The best candidates in the next part of the pyramid, best first.
    pub fn search(&mut self, luma: &[u8; PIXELS]) -> heapless::Vec<Candidate, CANDIDATES> {
        let levels = LEVELS[self.part].clone();
        self.part = (self.part + 1) % LEVELS.len();
        let mut best = heapless::Vec::new();
        for level in levels {
            let scale = FINEST * STEP.powi(level);
            self.cells.compute(luma, [WIDTH, HEIGHT], [0.0; 2], scale);
            self.add_best(scale, &mut best);
        }
        best
    }

    fn add_best(&self, scale: f32, best: &mut heapless::Vec<Candidate, CANDIDATES>) {
        let [columns, rows] = self
            .cells
            .size
            .map(|cells| (cells + 1).saturating_sub(TEMPLATE_CELLS));
        for row in 0..rows {
            for column in 0..columns {
                let score = self.template.bias
                    + with_avx2(
                        #[inline(always)]
                        || self.cells.product(&self.template, column, row),
                    );
                if score <= 0.0 {
                    continue;
                }
                let [x, y] = [column, row].map(|cell| (cell * CELL) as f32);
                let [across, down] = TEMPLATE_ORIGIN;
                add(
                    best,
                    Candidate {
                        pixel: [(x + across) * scale, (y + down) * scale],
                        pixels_per_metre: TEMPLATE_PIXELS_PER_METRE * scale,
                        score,
                    },
                );
            }
        }
    }
}

/// Adds a candidate, unless a better one shows the same face or there are enough better ones; best first.
fn add(best: &mut heapless::Vec<Candidate, CANDIDATES>, new: Candidate) {
    let same = |other: &Candidate| {
        let apart = (other.pixel[0] - new.pixel[0]).hypot(other.pixel[1] - new.pixel[1]);
        apart < 0.08 * new.pixels_per_metre.max(other.pixels_per_metre)
    };
    if let Some(index) = best.iter().position(same) {
        if best[index].score >= new.score {
            return;
        }
        best.remove(index);
    }
    let at = best
        .iter()
        .take_while(|other| other.score > new.score)
        .count();
    if best.is_full() {
        best.truncate(CANDIDATES - 1);
    }
    if at <= best.len() {
        // There is room now.
        let _ = best.insert(at, new);
    }
}
