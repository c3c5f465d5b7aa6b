//! Search for faces in a whole grey image, for frames without depth.
//!
//! A window slides over an image pyramid; its histograms of oriented gradients (Dalal and Triggs 2005), one per cell and normalised by
//! the neighbouring cells, are compared with one linear template of a face. The template is a linear discriminant against windows
//! without faces (Hariharan, Malik and Ramanan 2012), learned by `mien-studio train`. The best windows are only candidates: the
//! landmark fit confirms or rejects each ([`super::LandmarkFitter::search_in_image`]).
//!
//! Each call searches one of the [`PARTS`] of the pyramid, near faces first, which bounds its cost to about 1.5 ms. Units: image
//! pixels, and pixels per metre at the face. Memory: 0.7 MB, allocated at construction. Limitation: only frontal upright faces are
//! found, up to about 30° of yaw and 20° of roll, 40 to 240 pixels wide.

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
/// Image pixels per pixel of the finest pyramid level.
const FINEST: f32 = 1.25;
/// Scale factor from one pyramid level to the next.
const STEP: f32 = 1.2;
/// Levels searched in each call, coarsest first; the finest alone costs as much as all others.
const LEVELS: [Range<i32>; PARTS as usize] = [4..11, 2..4, 1..2, 0..1];
/// Number of calls that search the whole pyramid.
pub const PARTS: u32 = 4;
/// Maximum number of candidates per call.
pub const CANDIDATES: usize = 3;
/// Added to the gradient energy of a cell's neighbourhood, grey levels, so that noise in flat areas is not amplified.
const FLAT: f32 = 600.0;
/// Tangent of 22.5°, half the width of an orientation bin.
const HALF_ORIENTATION: f32 = 0.414_213_56;

/// Columns and rows of the finest level, a whole number of cells.
const LARGEST: [usize; 2] = [
    (WIDTH as f32 / FINEST) as usize / CELL * CELL,
    (HEIGHT as f32 / FINEST) as usize / CELL * CELL,
];

/// Width of the widest image whose cells can be computed, pixels.
const LONGEST_ROW: usize = 4096;

/// A place where a face may be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    /// Pixel between the inner corners of the eyes.
    pub pixel: [f32; 2],
    /// Pixels per metre at the face.
    pub pixels_per_metre: f32,
    /// Response of the template, without unit; above 0 for a candidate.
    pub score: f32,
}

/// Cells of a pyramid level and the buffers to compute them.
pub struct Cells {
    /// Columns and rows, in cells.
    pub size: [usize; 2],
    /// Grey values of the level, row by row.
    level: Vec<u8>,
    /// Sums per image column over the rows that make one row of the level.
    column_sums: Vec<u16>,
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
            column_sums: vec![0; LONGEST_ROW],
            sums: vec![[0.0; ORIENTATIONS]; cells],
            energy: vec![0.0; cells],
            values: vec![[0.0; ORIENTATIONS]; cells],
        }
    }
}

impl Cells {
    /// Computes the cells of a grey image of `columns` × `rows`, reduced by `scale` from the pixel `first` on. What exceeds the size of
    /// the finest level is cut off.
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
        with_avx2(
            #[inline(always)]
            || {
                self.reduce(luma, [columns, rows], first, scale);
                self.sum_orientations();
                self.normalise();
            },
        );
    }

    /// Reduces the image to means over areas of `scale`² pixels.
    #[inline(always)]
    fn reduce(&mut self, luma: &[u8], [columns, rows]: [usize; 2], first: [f32; 2], scale: f32) {
        let width = self.size[0] * CELL;
        let span = |from: f32, at: usize, most: usize| {
            let start = ((from + at as f32 * scale).max(0.0) as usize).min(most - 1);
            let end = (from + (at + 1) as f32 * scale + 0.5).max(0.0) as usize;
            start..end.clamp(start + 1, most)
        };
        let lines = self.level.chunks_exact_mut(width.max(1));
        for (y, line) in lines.take(self.size[1] * CELL).enumerate() {
            let down = span(first[1], y, rows);
            let sums = &mut self.column_sums[..columns];
            sums.fill(0);
            for row in down.clone() {
                let greys = &luma[row * columns..][..columns];
                for (sum, grey) in sums.iter_mut().zip(greys) {
                    *sum += u16::from(*grey);
                }
            }
            for (x, out) in line.iter_mut().enumerate() {
                let across = span(first[0], x, columns);
                let count = (down.len() * across.len()) as f32;
                let sum: u32 = sums[across].iter().map(|sum| u32::from(*sum)).sum();
                *out = (sum as f32 / count) as u8;
            }
        }
    }

    /// Sums the gradient magnitudes of each cell per orientation bin.
    #[inline(always)]
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
                let magnitude = (across * across + down * down).sqrt();
                sums[x / CELL][orientation(across, down)] += magnitude;
            }
        }
    }

    /// Divides each cell by the mean energy of its 3 × 3 neighbourhood, and takes square roots (the Hellinger map).
    #[inline(always)]
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

    /// Dot product of the template and the window whose first cell is given.
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

/// Orientation bin by sign of x (1), sign of y (2), and whether the gradient is near horizontal (0), diagonal (4) or near vertical (8).
const ORIENTATION: [u8; 12] = [4, 0, 4, 0, 5, 7, 3, 1, 6, 6, 2, 2];

/// Orientation bin of a gradient, 0 to 7 clockwise from the right; branch-free, because noise makes branches unpredictable.
#[inline(always)]
fn orientation(across: f32, down: f32) -> usize {
    let (x, y) = (across.abs(), down.abs());
    let steepness = usize::from(y >= x * HALF_ORIENTATION) + usize::from(x < y * HALF_ORIENTATION);
    let signs = usize::from(across > 0.0) + 2 * usize::from(down > 0.0);
    ORIENTATION[signs + 4 * steepness].into()
}

/// Searches whole images, one part of the pyramid per call.
pub struct FaceSearch {
    template: FaceTemplate,
    cells: Cells,
    part: usize,
}

impl FaceSearch {
    /// Creates a search for a template; all memory is allocated here.
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
            with_avx2(
                #[inline(always)]
                || self.add_best(scale, &mut best),
            );
        }
        best
    }

    #[inline(always)]
    fn add_best(&self, scale: f32, best: &mut heapless::Vec<Candidate, CANDIDATES>) {
        let [columns, rows] = self
            .cells
            .size
            .map(|cells| (cells + 1).saturating_sub(TEMPLATE_CELLS));
        for (row, column) in (0..rows).flat_map(|row| (0..columns).map(move |column| (row, column)))
        {
            let score = self.template.bias + self.cells.product(&self.template, column, row);
            if score <= 0.0 {
                continue;
            }
            let [x, y] = [column, row].map(|cell| (cell * CELL) as f32);
            let new = Candidate {
                pixel: [
                    (x + TEMPLATE_ORIGIN[0]) * scale,
                    (y + TEMPLATE_ORIGIN[1]) * scale,
                ],
                pixels_per_metre: TEMPLATE_PIXELS_PER_METRE * scale,
                score,
            };
            add(best, new);
        }
    }
}

/// Adds a candidate, unless a better one shows the same face or the list is full of better ones. The list stays sorted, best first.
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

#[cfg(test)]
mod tests {
    use super::*;

    /// An image of random blocks of `side` pixels.
    fn blocks(seed: u64, side: usize) -> Vec<u8> {
        let mut random = fastrand::Rng::with_seed(seed);
        let columns = WIDTH.div_ceil(side);
        let greys: Vec<u8> = (0..columns * HEIGHT.div_ceil(side))
            .map(|_| random.u8(..))
            .collect();
        let pixels = (0..WIDTH * HEIGHT).map(|k| (k % WIDTH / side, k / WIDTH / side));
        pixels.map(|(x, y)| greys[y * columns + x]).collect()
    }

    #[test]
    fn each_direction_has_its_orientation() {
        for k in 0..64 {
            // Angles on the border of two bins are avoided: either bin is right.
            let angle = (k as f32 + 0.5) / 64.0 * core::f32::consts::TAU;
            let expected = ((angle / core::f32::consts::FRAC_PI_4).round() as usize) % ORIENTATIONS;
            let (down, across) = angle.sin_cos();
            assert_eq!(orientation(across, down), expected, "{angle}");
        }
    }

    #[test]
    fn a_ramp_has_one_orientation_and_a_flat_picture_none() {
        let mut cells = Cells::default();
        // The image rises by two grey levels per pixel, the level by five per pixel: the central difference is 10.
        let ramp: Vec<u8> = (0..100 * 80).map(|k| (k % 100 * 2) as u8).collect();
        cells.compute(&ramp, [100, 80], [0.0; 2], 2.5);
        assert_eq!(cells.size, [10, 8]);
        let cell = cells.values[4 * 10 + 4];
        let sum = 16.0 * 10.0;
        let expected: f32 = (sum * 9.0 / (9.0 * sum + FLAT)).sqrt();
        assert!((cell[0] - expected).abs() < 1e-3, "{cell:?} {expected}");
        assert_eq!(cell[1..], [0.0; ORIENTATIONS - 1]);
        cells.compute(&[90; 100 * 80], [100, 80], [0.0; 2], 2.5);
        assert!(
            cells.values[..80]
                .iter()
                .flatten()
                .all(|value| *value == 0.0)
        );
    }

    #[test]
    fn a_planted_window_is_found_where_it_is_at_its_size() {
        for (level, block) in [(0, 5), (3, 9), (8, 22)] {
            let scale = FINEST * STEP.powi(level);
            let picture = blocks(level as u64, block);
            let mut cells = Cells::default();
            cells.compute(&picture, [WIDTH, HEIGHT], [0.0; 2], scale);
            let [column, row] = [3, 2];
            let window = (0..TEMPLATE_CELLS).flat_map(|y| {
                let first = (row + y) * cells.size[0] + column;
                cells.values[first..first + TEMPLATE_CELLS].to_vec()
            });
            let window: Vec<f32> = window.flatten().collect();
            let mean = window.iter().sum::<f32>() / window.len() as f32;
            let weights = window.iter().map(|value| value - mean);
            let own: f32 = weights.clone().zip(&window).map(|(w, v)| w * v).sum();
            let floats = [-0.8 * own].into_iter().chain(weights);
            let mut search = FaceSearch::new(FaceTemplate::from_floats(floats));
            let luma = picture.try_into().expect("PIXELS long");
            let found: Vec<Candidate> = (0..PARTS).flat_map(|_| search.search(&luma)).collect();
            let [found] = found[..] else {
                panic!("{level}: {found:?}");
            };
            for (k, cell) in [column, row].into_iter().enumerate() {
                let expected = ((cell * CELL) as f32 + TEMPLATE_ORIGIN[k]) * scale;
                assert!((found.pixel[k] - expected).abs() < 1e-3);
            }
            let size = found.pixels_per_metre / (TEMPLATE_PIXELS_PER_METRE * scale);
            assert!((size - 1.0).abs() < 1e-4, "{size}");
        }
    }

    #[test]
    fn the_best_candidates_of_different_faces_are_kept() {
        let candidate = |x: f32, score: f32| Candidate {
            pixel: [x, 100.0],
            pixels_per_metre: 500.0,
            score,
        };
        let mut best = heapless::Vec::new();
        // Less than 8 cm apart is the same face.
        for (x, score) in [
            (100.0, 1.0),
            (130.0, 3.0),
            (120.0, 2.0),
            (300.0, 0.5),
            (400.0, 4.0),
            (500.0, 1.5),
        ] {
            add(&mut best, candidate(x, score));
        }
        let kept: Vec<f32> = best.iter().map(|candidate| candidate.pixel[0]).collect();
        assert_eq!(kept, [400.0, 130.0, 500.0]);
    }
}
