//! What the picture shows around the landmarks: patches of gradient orientation histograms.
//!
//! Per window, once: central-difference gradients, each spread over eight orientations by the fourth power of the positive
//! cosine (the sum over orientations is then the magnitude, without an arc tangent), summed into cells of 2×2 pixels and
//! blurred twice: a little (σ 1.2 px) for patches of lids and lips, whose cells stand closer than [`FINE_BELOW_PX`], and on
//! (σ 2.4 px) for the others. Per landmark: 4×4 cells, bilinear, scaled to unit length, square-rooted (the Hellinger map).
//! Histograms of oriented gradients after Dalal and Triggs 2005, used for alignment as in Xiong and De la Torre 2013.
//! Units: window pixels in, values 0…1 out. About 1.7 M operations per window, 35 k look-ups per face; 0.8 MB.
//! Scaling the grey values changes nothing: the small constant of the normalisation follows the window's mean gradient.
//! Degenerate: a flat window gives zero patches. Limits: clipped highlights lose their gradients.

use super::window::WINDOW;
use crate::capacity::LANDMARKS;
use crate::face_model::{FEATURES, ORIENTATIONS, PATCH, PATCH_CELLS};

/// Cells along one side of the maps.
pub const MAP: usize = WINDOW / 2;
/// Patches whose cells stand closer than this, window pixels, look at the finer maps.
pub const FINE_BELOW_PX: f32 = 3.4;
/// Blur of the finer maps: half a Gaussian of σ 0.6 cells (1.2 px).
const FINE: [f32; 2] = [0.6671, 0.1664];
/// What takes them to σ 1.2 cells (2.4 px): half a Gaussian of σ 1.04 cells.
const COARSE: [f32; 4] = [0.3838, 0.2417, 0.0604, 0.0060];
/// Share of a typical patch's length that is added in the normalisation, so that empty patches stay small.
const FLATNESS: f32 = 0.3;

/// Orientation maps of one window: `MAP` × `MAP` cells of eight values, fine and coarse.
#[derive(Clone)]
pub struct OrientationMaps {
    fine: Vec<[f32; ORIENTATIONS]>,
    coarse: Vec<[f32; ORIENTATIONS]>,
    scratch: Vec<[f32; ORIENTATIONS]>,
    floor: f32,
}

impl Default for OrientationMaps {
    fn default() -> Self {
        Self {
            fine: vec![[0.0; ORIENTATIONS]; MAP * MAP],
            coarse: vec![[0.0; ORIENTATIONS]; MAP * MAP],
            scratch: vec![[0.0; ORIENTATIONS]; MAP * MAP],
            floor: 1.0,
        }
    }
}

impl OrientationMaps {
    /// Bytes on the heap.
    pub const BYTES: usize = 3 * MAP * MAP * ORIENTATIONS * 4;

    /// Computes the maps of a window of `WINDOW` × `WINDOW` grey values.
    pub fn compute(&mut self, window: &[f32]) {
        const DIAGONAL: f32 = std::f32::consts::FRAC_1_SQRT_2;
        let mut total = 0.0f32;
        self.coarse.fill([0.0; ORIENTATIONS]);
        for row in 1..WINDOW - 1 {
            let line = &window[row * WINDOW..(row + 1) * WINDOW];
            let above = &window[(row - 1) * WINDOW..row * WINDOW];
            let below = &window[(row + 1) * WINDOW..(row + 2) * WINDOW];
            let cells = &mut self.coarse[row / 2 * MAP..(row / 2 + 1) * MAP];
            let (mut gx, mut gy) = ([0.0f32; WINDOW], [0.0f32; WINDOW]);
            let mut inverse = [0.0f32; WINDOW];
            for column in 1..WINDOW - 1 {
                let (x, y) = (
                    line[column + 1] - line[column - 1],
                    below[column] - above[column],
                );
                let squared = x * x + y * y;
                let magnitude = squared.sqrt();
                total += magnitude;
                // Of the cube: magnitude × cosine⁴ is projection⁴ / magnitude³. The constant only keeps 0 / 0 away.
                inverse[column] = 1.0 / (squared * magnitude + 1e-12);
                (gx[column], gy[column]) = (x, y);
            }
            for column in 1..WINDOW - 1 {
                let (x, y) = (gx[column], gy[column]);
                let (rising, falling) = ((x + y) * DIAGONAL, (y - x) * DIAGONAL);
                let along = [x, rising, y, falling, -x, -rising, -y, -falling];
                let cell = &mut cells[column / 2];
                for k in 0..ORIENTATIONS {
                    let squared = along[k].max(0.0) * along[k].max(0.0);
                    cell[k] += squared * squared * inverse[column];
                }
            }
        }
        blur(&self.coarse, &FINE, &mut self.scratch, &mut self.fine);
        blur(&self.fine, &COARSE, &mut self.scratch, &mut self.coarse);
        // A typical cell holds four mean gradients, spread over about three orientations.
        let cell = 4.0 * total / (WINDOW * WINDOW) as f32;
        self.floor = (FLATNESS * cell * (PATCH_CELLS as f32)).max(1e-3);
    }

    /// The patches around all landmarks (window pixels): [`FEATURES`] values, landmark by landmark.
    pub fn patches(&self, landmarks: &[[f32; 2]; LANDMARKS], cell_px: f32, out: &mut [f32]) {
        debug_assert_eq!(out.len(), FEATURES);
        let maps = if cell_px < FINE_BELOW_PX {
            &self.fine
        } else {
            &self.coarse
        };
        let first = -0.5 * (PATCH_CELLS as f32 - 1.0);
        for (landmark, patch) in landmarks.iter().zip(out.chunks_exact_mut(PATCH)) {
            let mut squared = self.floor * self.floor;
            for (cell, values) in patch.chunks_exact_mut(ORIENTATIONS).enumerate() {
                let x = landmark[0] + (first + (cell % PATCH_CELLS) as f32) * cell_px;
                let y = landmark[1] + (first + (cell / PATCH_CELLS) as f32) * cell_px;
                let value = at(maps, x, y);
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

/// Blurs rows, then columns, with half a symmetric kernel; the border repeats.
fn blur(
    from: &[[f32; ORIENTATIONS]],
    kernel: &[f32],
    scratch: &mut [[f32; ORIENTATIONS]],
    to: &mut [[f32; ORIENTATIONS]],
) {
    let last = MAP - 1;
    for row in 0..MAP {
        let line = &from[row * MAP..(row + 1) * MAP];
        let out = &mut scratch[row * MAP..(row + 1) * MAP];
        for column in 0..MAP {
            let mut sum = line[column].map(|v| v * kernel[0]);
            for (distance, weight) in kernel.iter().enumerate().skip(1) {
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
            let mut sum = scratch[row * MAP + column].map(|v| v * kernel[0]);
            for (distance, weight) in kernel.iter().enumerate().skip(1) {
                let a = &scratch[row.saturating_sub(distance) * MAP + column];
                let b = &scratch[(row + distance).min(last) * MAP + column];
                for k in 0..ORIENTATIONS {
                    sum[k] += weight * (a[k] + b[k]);
                }
            }
            to[row * MAP + column] = sum;
        }
    }
}

/// Bilinear value of maps at a window pixel.
fn at(maps: &[[f32; ORIENTATIONS]], x: f32, y: f32) -> [f32; ORIENTATIONS] {
    let most = (MAP - 1) as f32 - 1e-3;
    let x = ((x - 0.5) * 0.5).clamp(0.0, most);
    let y = ((y - 0.5) * 0.5).clamp(0.0, most);
    let (column, row) = (x as usize, y as usize);
    let (fx, fy) = (x - column as f32, y - row as f32);
    let here = row * MAP + column;
    let (a, b) = (&maps[here], &maps[here + 1]);
    let (c, d) = (&maps[here + MAP], &maps[here + MAP + 1]);
    let (wa, wb) = ((1.0 - fx) * (1.0 - fy), fx * (1.0 - fy));
    let (wc, wd) = ((1.0 - fx) * fy, fx * fy);
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
    fn an_edge_answers_in_its_own_orientation() {
        for k in 0..ORIENTATIONS {
            let mut maps = OrientationMaps::default();
            maps.compute(&edge(k as f32 * std::f32::consts::FRAC_PI_4, 1.0));
            let value = at(&maps.coarse, 92.0, 92.0);
            let strongest = (0..ORIENTATIONS).max_by(|&a, &b| value[a].total_cmp(&value[b]));
            assert_eq!(strongest, Some(k), "{value:?}");
        }
    }

    #[test]
    fn brightness_and_contrast_do_not_matter() {
        let landmarks = [[93.0, 90.0]; LANDMARKS];
        let patches = |gain, cell_px| {
            let mut maps = OrientationMaps::default();
            maps.compute(&edge(0.4, gain));
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
}
