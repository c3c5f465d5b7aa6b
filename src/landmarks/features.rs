//! What the picture shows around the landmarks: patches of gradient orientation histograms.
//!
//! Per window, once: central-difference gradients, each spread over eight orientations by the fourth power of the positive
//! cosine (the sum over orientations is then the magnitude, without an arc tangent), summed into cells of 2×2 pixels and
//! blurred (σ 2.4 px). Per landmark: 4×4 cells, bilinear, scaled to unit length, square-rooted (the Hellinger map).
//! Histograms of oriented gradients after Dalal and Triggs 2005, used for alignment as in Xiong and De la Torre 2013.
//! Units: window pixels in, values 0…1 out. About 1.5 M operations per window, 35 k look-ups per face; 0.6 MB.
//! Scaling the grey values changes nothing: the small constant of the normalisation follows the window's mean gradient.
//! Degenerate: a flat window gives zero patches. Limits: clipped highlights lose their gradients.

use super::window::WINDOW;
use crate::capacity::LANDMARKS;
use crate::face_model::{FEATURES, ORIENTATIONS, PATCH, PATCH_CELLS};

/// Cells along one side of the maps.
pub const MAP: usize = WINDOW / 2;
/// Blur of the maps: half a Gaussian of σ 1.2 cells (2.4 px).
const KERNEL: [f32; 4] = [0.3334, 0.2356, 0.0831, 0.0146];
/// Share of a typical patch's length that is added in the normalisation, so that empty patches stay small.
const FLATNESS: f32 = 0.3;

/// Orientation maps of one window: `MAP` × `MAP` cells of eight values.
#[derive(Clone)]
pub struct OrientationMaps {
    cells: Vec<[f32; ORIENTATIONS]>,
    scratch: Vec<[f32; ORIENTATIONS]>,
    floor: f32,
}

impl Default for OrientationMaps {
    fn default() -> Self {
        Self {
            cells: vec![[0.0; ORIENTATIONS]; MAP * MAP],
            scratch: vec![[0.0; ORIENTATIONS]; MAP * MAP],
            floor: 1.0,
        }
    }
}

impl OrientationMaps {
    /// A copy to look up in, without the work space of [`Self::compute`].
    #[must_use]
    pub fn kept(&self) -> Self {
        Self {
            cells: self.cells.clone(),
            scratch: Vec::new(),
            floor: self.floor,
        }
    }

    /// Computes the maps of a window of `WINDOW` × `WINDOW` grey values.
    pub fn compute(&mut self, window: &[f32]) {
        const DIAGONAL: f32 = std::f32::consts::FRAC_1_SQRT_2;
        let mut total = 0.0f32;
        self.scratch.resize(MAP * MAP, [0.0; ORIENTATIONS]);
        self.cells.fill([0.0; ORIENTATIONS]);
        for row in 1..WINDOW - 1 {
            let line = &window[row * WINDOW..(row + 1) * WINDOW];
            let above = &window[(row - 1) * WINDOW..row * WINDOW];
            let below = &window[(row + 1) * WINDOW..(row + 2) * WINDOW];
            let cells = &mut self.cells[row / 2 * MAP..(row / 2 + 1) * MAP];
            for column in 1..WINDOW - 1 {
                let gx = line[column + 1] - line[column - 1];
                let gy = below[column] - above[column];
                let squared = gx * gx + gy * gy;
                if squared < 1e-6 {
                    continue;
                }
                let magnitude = squared.sqrt();
                total += magnitude;
                let inverse = 1.0 / magnitude;
                let (cx, cy) = (gx * inverse, gy * inverse);
                let along = [cx, (cx + cy) * DIAGONAL, cy, (cy - cx) * DIAGONAL];
                let cell = &mut cells[column / 2];
                for (k, c) in along.into_iter().enumerate() {
                    let value = (c * c) * (c * c) * magnitude;
                    cell[if c > 0.0 { k } else { k + 4 }] += value;
                }
            }
        }
        // Rows, then columns; the border repeats.
        let last = MAP - 1;
        for row in 0..MAP {
            let line = &self.cells[row * MAP..(row + 1) * MAP];
            let out = &mut self.scratch[row * MAP..(row + 1) * MAP];
            for column in 0..MAP {
                let mut sum = [0.0; ORIENTATIONS];
                for (distance, weight) in KERNEL.iter().enumerate() {
                    let weight = if distance == 0 { weight * 0.5 } else { *weight };
                    let a = &line[column.saturating_sub(distance)];
                    let b = &line[(column + distance).min(last)];
                    for k in 0..ORIENTATIONS {
                        sum[k] += weight * (a[k] + b[k]);
                    }
                }
                out[column] = sum;
            }
        }
        for row in 0..MAP {
            for column in 0..MAP {
                let mut sum = [0.0; ORIENTATIONS];
                for (distance, weight) in KERNEL.iter().enumerate() {
                    let weight = if distance == 0 { weight * 0.5 } else { *weight };
                    let a = &self.scratch[row.saturating_sub(distance) * MAP + column];
                    let b = &self.scratch[(row + distance).min(last) * MAP + column];
                    for k in 0..ORIENTATIONS {
                        sum[k] += weight * (a[k] + b[k]);
                    }
                }
                self.cells[row * MAP + column] = sum;
            }
        }
        // A typical cell holds four mean gradients, spread over about three orientations.
        let cell = 4.0 * total / (WINDOW * WINDOW) as f32;
        self.floor = (FLATNESS * cell * (PATCH_CELLS as f32)).max(1e-3);
    }

    /// Bilinear value at a window pixel.
    fn at(&self, x: f32, y: f32) -> [f32; ORIENTATIONS] {
        let most = (MAP - 1) as f32 - 1e-3;
        let x = ((x - 0.5) * 0.5).clamp(0.0, most);
        let y = ((y - 0.5) * 0.5).clamp(0.0, most);
        let (column, row) = (x as usize, y as usize);
        let (fx, fy) = (x - column as f32, y - row as f32);
        let at = row * MAP + column;
        let (a, b) = (&self.cells[at], &self.cells[at + 1]);
        let (c, d) = (&self.cells[at + MAP], &self.cells[at + MAP + 1]);
        let (wa, wb) = ((1.0 - fx) * (1.0 - fy), fx * (1.0 - fy));
        let (wc, wd) = ((1.0 - fx) * fy, fx * fy);
        let mut value = [0.0; ORIENTATIONS];
        for k in 0..ORIENTATIONS {
            value[k] = wa * a[k] + wb * b[k] + wc * c[k] + wd * d[k];
        }
        value
    }

    /// The patches around all landmarks (window pixels): [`FEATURES`] values, landmark by landmark.
    pub fn patches(&self, landmarks: &[[f32; 2]; LANDMARKS], cell_px: f32, out: &mut [f32]) {
        debug_assert_eq!(out.len(), FEATURES);
        let first = -0.5 * (PATCH_CELLS as f32 - 1.0);
        for (landmark, patch) in landmarks.iter().zip(out.chunks_exact_mut(PATCH)) {
            let mut squared = self.floor * self.floor;
            for (cell, values) in patch.chunks_exact_mut(ORIENTATIONS).enumerate() {
                let x = landmark[0] + (first + (cell % PATCH_CELLS) as f32) * cell_px;
                let y = landmark[1] + (first + (cell / PATCH_CELLS) as f32) * cell_px;
                let value = self.at(x, y);
                squared += value.iter().map(|v| v * v).sum::<f32>();
                values.copy_from_slice(&value);
            }
            let inverse = 1.0 / squared.sqrt();
            for value in patch {
                *value = (*value * inverse).max(0.0).sqrt();
            }
        }
    }
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
    fn an_edge_answers_in_its_own_orientation() {
        for k in 0..ORIENTATIONS {
            let mut maps = OrientationMaps::default();
            maps.compute(&edge(k as f32 * std::f32::consts::FRAC_PI_4, 1.0));
            let value = maps.at(92.0, 92.0);
            let strongest = (0..ORIENTATIONS).max_by(|&a, &b| value[a].total_cmp(&value[b]));
            assert_eq!(strongest, Some(k), "{value:?}");
        }
    }

    #[test]
    fn brightness_and_contrast_do_not_matter() {
        let landmarks = [[93.0, 90.0]; LANDMARKS];
        let patches = |gain| {
            let mut maps = OrientationMaps::default();
            maps.compute(&edge(0.4, gain));
            let mut out = vec![0.0; FEATURES];
            maps.patches(&landmarks, 5.0, &mut out);
            out
        };
        for (a, b) in patches(1.0).iter().zip(patches(0.25)) {
            assert!((a - b).abs() < 1e-3);
        }
    }
}
