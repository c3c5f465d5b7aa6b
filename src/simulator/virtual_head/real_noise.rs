//! Depth errors of a real Kinect or stereo camera beyond [`DepthReading::read`]. The Kinect's were measured on three public recordings:
//!
//! | quantity | `kinect.webm` of three.js, a man at 0.7 to 1 m | OpenISS `test-recording`, two men at 0.8 to 1 m | PCL `five_people`, 1.8 to 4 m |
//! | --- | --- | --- | --- |
//! | no reading within hair; within 3 px of its outline | 0.9 %; 18 % | dark 2.2 % | brown 2 %, black 10, 11, 30 % with outline |
//! | … on the face; face and beard | 0.25 % | 1.6 % | |
//! | … on cloth | 0 % | jacket 0 %, sweater 1.3 %, black trousers 3.8 % | |
//! | size of such a hole | median 6 px, by area 32 px | | lobes of 5 to 10 px |
//! | outline of face and cloth against a smooth one | 0.6 to 1.4 px | 0.8 to 1.2 px, alike over 2 px | 0.8 to 1.4 px |
//! | … of hair | | 1.9 to 2.5 px | |
//! | … from frame to frame | | 0.9 px | |
//! | readings between both sides of a step | | 5 to 9 in 100 steps | |
//! | change from frame to frame, raw units | | 0.45 to 0.60; correlation 0.58, 0.39, 0.18 after 1, 3, 8 px | |
//! | relief that stands still, raw units | | 0.62, of it columns 0.17 | |
//! | pixels that come and go | | 7.5 % of those with a reading | |
//!
//! The correlation window causes all of this: detail below about 7 px is missing, and outlines follow the dots of the pattern. The
//! first recording is video-compressed; only its holes and outlines are used.

use super::appearance::Material;
use super::noise::{
    DISPARITY_SIGMA, DepthReading, FARTHEST_RAW, GRAZING_SLOPE, GRAZING_SPAN, NEAREST_RAW, SIDE,
    Tiles, blurred, line,
};
use super::random::{hash, uniform};
use mien_sensors::kinect::geometry::BLANK_COLUMNS;
use mien_sensors::kinect::unpack::NO_READING;
use mien_stages::base::capacity::{HEIGHT, PIXELS, WIDTH};

/// Width of the rim in which readings fail more often, pixels.
const RIM_PX: usize = 3;
/// Step between neighbouring pixels that counts as an edge, raw units.
const STEP_RAW: f32 = 18.0;
/// Share of readings beside an edge that are between its two sides.
const BETWEEN: f32 = 0.035;
/// Standard deviation of the constant false relief from the pattern, raw units.
const RELIEF_SIGMA: f32 = 0.34;
/// Standard deviation of constant column offsets, raw units.
const STRIPE_SIGMA: f32 = 0.17;
/// Standard deviation of noise that changes per frame, raw units.
const CHANGE_SIGMA: f32 = 0.42;
/// Standard deviation of a stereo camera's noise in inverse depth, 1/m: 0.08 pixels of disparity, a typical figure for a RealSense D435, at
/// its focal length of 385 pixels (640 × 480) and baseline of 5 cm. 2 mm at 0.7 m, two and a half times a Kinect's.
const STEREO_SIGMA: f32 = 0.08 / (385.0 * 0.05);
/// Strength above which outlines follow the correlation window.
const HALF: f32 = 0.5;
/// Samples of the correlation window, pixels from its middle.
const TAPS: [(isize, isize); 9] = [
    (0, 0),
    (-3, 0),
    (3, 0),
    (0, -3),
    (0, 3),
    (-2, -2),
    (2, 2),
    (-2, 2),
    (2, -2),
];
/// Largest difference within which the correlation window averages, raw units.
const WINDOW_RAW: f32 = 12.0;

/// Simulates all errors of a real depth camera; work space of [`RealReading::read`].
pub(crate) struct RealReading {
    /// Correlated within about five pixels, standard normal.
    lobes: Vec<f32>,
    /// Correlated within about eight pixels, standard normal.
    broad: Vec<f32>,
    /// The same as ranks in 0…1.
    ranks: Vec<f32>,
    /// Whether the noise is a stereo camera's: stronger, and in patches as large as its matching window.
    pub(crate) stereo: bool,
    stripes: Vec<f32>,
    edge: Vec<bool>,
    rim: Vec<bool>,
    dark: Vec<bool>,
}

/// A tile blurred `times` times and scaled to standard normal.
fn blurred_times(tile: &[f32], times: usize) -> Vec<f32> {
    (0..times).fold(tile.to_vec(), |tile, _| {
        let mut soft = blurred(&tile);
        let power = soft.iter().map(|v| v * v).sum::<f32>() / soft.len() as f32;
        let scale = 1.0 / power.sqrt();
        soft.iter_mut().for_each(|v| *v *= scale);
        soft
    })
}

impl RealReading {
    /// `seed` identifies the sensor, whose pattern is constant.
    pub(crate) fn new(tiles: &Tiles, seed: u64) -> Self {
        let lobes = blurred_times(&tiles.white, 2);
        let broad = blurred_times(&tiles.white, 7);
        let mut order: Vec<usize> = (0..broad.len()).collect();
        order.sort_by(|&a, &b| broad[a].total_cmp(&broad[b]));
        let mut ranks = vec![0.0; broad.len()];
        for (rank, &i) in order.iter().enumerate() {
            ranks[i] = rank as f32 / order.len() as f32;
        }
        let column = |col: usize| {
            let k = |c: usize| uniform(seed ^ 0x57e1, c as u64);
            // Scale: the sum's standard deviation is √(1.5 · ⅓).
            (k(col) + 0.5 * k(col + 1) + 0.5 * k(col + 2)) * std::f32::consts::SQRT_2
        };
        Self {
            lobes,
            broad,
            ranks,
            stereo: false,
            stripes: (0..WIDTH).map(column).collect(),
            edge: vec![false; PIXELS],
            rim: vec![false; PIXELS],
            dark: vec![false; PIXELS],
        }
    }

    /// Converts a perfect image (1/z and material per pixel) to raw depth with errors; `strength`: their scale, 1 = a real Kinect's.
    pub(crate) fn read(
        &mut self,
        reading: &DepthReading,
        strength: f32,
        inverse: &[f32],
        material: &[Material],
        tiles: &Tiles,
        seed: u64,
        depth: &mut [u16; PIXELS],
    ) {
        self.find_edges(reading, inverse);
        let mut seen = PixelReading {
            real: self,
            reading,
            strength,
            inverse,
            material,
            tiles,
            offsets: [1, 2, 3, 4].map(|k| (hash(seed, k) as usize) % SIDE),
            row: 0,
            col: 0,
        };
        for (here, out) in depth.iter_mut().enumerate() {
            (seen.row, seen.col) = (here / WIDTH, here % WIDTH);
            let sees = seen.col < WIDTH - BLANK_COLUMNS;
            *out = sees.then(|| seen.raw()).flatten().unwrap_or(NO_READING);
        }
    }

    /// Finds edges, the rims around them, and pixels that the projector does not light.
    fn find_edges(&mut self, reading: &DepthReading, inverse: &[f32]) {
        let step = STEP_RAW / -reading.raw_per_inverse;
        for row in 0..HEIGHT {
            let start = row * WIDTH;
            let dark = self.dark[start..].first_chunk_mut().expect("a row");
            reading.shade(line(inverse, row), dark);
            for col in 0..WIDTH {
                let here = start + col;
                let right = if col + 1 < WIDTH { here + 1 } else { here };
                let left = if col > 0 { here - 1 } else { here };
                let below = if row + 1 < HEIGHT { here + WIDTH } else { here };
                let above = if row > 0 { here - WIDTH } else { here };
                let is_far = |&k: &usize| (inverse[k] - inverse[here]).abs() > step;
                self.edge[here] = [right, left, below, above].iter().any(is_far);
            }
        }
        // Rims extend along rows and columns.
        self.rim.fill(false);
        for (here, _) in self.edge.iter().enumerate().filter(|(_, edge)| **edge) {
            let (row, col) = (here / WIDTH, here % WIDTH);
            let around =
                |at: usize, size: usize| at.saturating_sub(RIM_PX - 1)..(at + RIM_PX).min(size);
            around(col, WIDTH).for_each(|col| self.rim[row * WIDTH + col] = true);
            around(row, HEIGHT).for_each(|row| self.rim[row * WIDTH + col] = true);
        }
    }
}

/// One pixel being measured, with all inputs.
struct PixelReading<'a> {
    real: &'a RealReading,
    reading: &'a DepthReading,
    strength: f32,
    inverse: &'a [f32],
    material: &'a [Material],
    tiles: &'a Tiles,
    offsets: [usize; 4],
    row: usize,
    col: usize,
}

impl PixelReading<'_> {
    /// Raw value, or `None` if the reading fails. Errors are applied in the order in which they arise in the sensor.
    fn raw(&self) -> Option<u16> {
        let (offset, mut is_read) = (self.edge_offset(), true);
        let mut value = self.window_value(offset, &mut is_read);
        self.apply_slope_faults(&mut value, &mut is_read);
        let [dr, dc] = offset;
        is_read &= self.is_returned(self.material[self.index_near(dr, dc)], value);
        let reading = self.reading;
        let raw = reading.raw_far + reading.raw_per_inverse * value + self.noise();
        let is_read = is_read && (NEAREST_RAW..FARTHEST_RAW).contains(&raw);
        is_read.then_some((raw + 0.5) as u16)
    }

    fn index_near(&self, rows: isize, columns: isize) -> usize {
        let row = self.row.saturating_add_signed(rows).min(HEIGHT - 1);
        let col = self.col.saturating_add_signed(columns).min(WIDTH - 1);
        row * WIDTH + col
    }

    /// Number of a tile that is constant for this pixel; `by` selects one of several.
    fn fixed_noise(&self, tile: &[f32], by: usize) -> f32 {
        tile[(self.row + 37 * by) % SIDE * SIDE + (self.col + 91 * by) % SIDE]
    }

    /// Number of a tile that changes with every frame; `k` selects one of four.
    fn frame_noise(&self, tile: &[f32], k: usize) -> f32 {
        let by = self.offsets[k];
        tile[(self.row + by) % SIDE * SIDE + (self.col + by / 3) % SIDE]
    }

    fn is_at_rim(&self) -> bool {
        self.real.rim[self.index_near(0, 0)]
    }

    /// Difference of two inverse distances, raw units.
    fn step(&self, one: f32, other: f32) -> f32 {
        (other - one).abs() * -self.reading.raw_per_inverse
    }

    /// Offset of the matched window near an edge, rows and columns; depends on all materials around, since hair also affects its
    /// background.
    fn edge_offset(&self) -> [isize; 2] {
        if !self.is_at_rim() {
            return [0; 2];
        }
        let around = [(0, 0), (0, -3), (0, 3), (-3, 0), (3, 0)];
        let ragged = around.map(|(dr, dc)| self.material[self.index_near(dr, dc)].properties()[4]);
        let reach = ragged.into_iter().fold(0.0, f32::max) * self.strength;
        [0, 1].map(|k| {
            let fixed_noise = self.fixed_noise(&self.real.lobes, k + 1);
            let frame_noise = self.frame_noise(&self.real.lobes, k);
            (reach * (0.72 * fixed_noise + 0.69 * frame_noise)).round() as isize
        })
    }

    /// Inverse distance measured by the window: the median near an edge, then a mean over the same surface.
    fn window_value(&self, [dy, dx]: [isize; 2], is_read: &mut bool) -> f32 {
        let at = self.index_near(dy, dx);
        let mut value = self.inverse[at];
        *is_read = !self.real.dark[at] && value > 0.0;
        let around = TAPS.map(|(dr, dc)| self.index_near(dy + dr, dx + dc));
        let values = around.map(|at| self.inverse[at]);
        if self.is_at_rim() && self.strength > HALF {
            let mut sorted = values;
            mien_stages::base::sorting::sort(&mut sorted);
            value = sorted[TAPS.len() / 2];
            let agrees = |at: &&usize| self.step(value, self.inverse[**at]) < WINDOW_RAW;
            let count =
                |(all, unlit), &at: &usize| (all + 1, unlit + usize::from(self.real.dark[at]));
            let (all, unlit) = around.iter().filter(agrees).fold((0, 0), count);
            *is_read = value > 0.0 && 2 * unlit < all;
        }
        let (mut sum, mut count) = (0.0, 0.0);
        for other in values {
            if self.step(value, other) < WINDOW_RAW {
                sum += other;
                count += 1.0;
            }
        }
        if count > 0.0 {
            value += self.strength * (sum / count - value);
        }
        value
    }

    /// Readings fail at grazing angles; some beside an edge become the mean of its two sides.
    fn apply_slope_faults(&self, value: &mut f32, is_read: &mut bool) {
        let [right, left, below, above] = [(0, 1), (0, -1), (1, 0), (-1, 0)]
            .map(|(dr, dc)| self.inverse[self.index_near(dr, dc)]);
        let steep = (right - left).abs().max((below - above).abs());
        let steep = steep * 0.5 * -self.reading.raw_per_inverse;
        let is_edge = self.real.edge[self.index_near(0, 0)];
        if steep > GRAZING_SLOPE && !is_edge {
            let fails = ((steep - GRAZING_SLOPE) / GRAZING_SPAN).min(1.0) * 0.8;
            *is_read &= self.fixed_noise(&self.real.ranks, 3) > fails;
        } else if is_edge
            && self.fixed_noise(&self.tiles.white, self.offsets[2]).abs()
                < 1.25 * BETWEEN * self.strength
        {
            *value = 0.5 * (right + left);
        }
    }

    /// Whether enough light returns, depending on distance, material and rim.
    fn is_returned(&self, material: Material, value: f32) -> bool {
        let [_, _, within, at_rim, _] = material.properties();
        let far = 1.0 / value.max(0.2);
        let mut fails = within * far * far;
        if self.is_at_rim() {
            fails = fails.max(at_rim * far);
        }
        let fails = (fails * self.strength).min(0.95);
        self.fixed_noise(&self.real.ranks, 4) >= 0.65 * fails
            && self.frame_noise(&self.real.ranks, 3) >= 0.35 * fails / (1.0 - 0.65 * fails)
    }

    fn noise(&self) -> f32 {
        if self.real.stereo {
            let broad = &self.real.broad;
            let patches = 0.6 * self.fixed_noise(broad, 5) + 0.8 * self.frame_noise(broad, 1);
            return STEREO_SIGMA * self.reading.raw_per_inverse * patches;
        }
        let (smooth, lobes) = (&self.tiles.smooth, &self.real.lobes);
        let relief = 0.8 * self.fixed_noise(smooth, 5) + 0.6 * self.fixed_noise(lobes, 6);
        let change = 0.6 * self.frame_noise(smooth, 1) + 0.8 * self.frame_noise(lobes, 2);
        let stripe = self.real.stripes[self.col];
        self.strength * (RELIEF_SIGMA * relief + STRIPE_SIGMA * stripe)
            + (DISPARITY_SIGMA + self.strength * (CHANGE_SIGMA - DISPARITY_SIGMA)) * change
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reading() -> DepthReading {
        DepthReading::from_camera(&mien_sensors::kinect::geometry::nominal())
    }

    fn boxed() -> Box<[u16; PIXELS]> {
        vec![0; PIXELS].try_into().expect("PIXELS long")
    }

    fn kinect() -> RealReading {
        RealReading::new(&Tiles::new(7), 7)
    }

    /// A plane of some stuff as the sensor sees it, frame by frame.
    fn real_plane(
        mut real: RealReading,
        material: Material,
        z: f32,
        frames: u64,
    ) -> Vec<Box<[u16; PIXELS]>> {
        let tiles = Tiles::new(7);
        let (inverse, material) = (vec![1.0 / z; PIXELS], vec![material; PIXELS]);
        (0..frames)
            .map(|k| {
                let mut depth = boxed();
                let seed = hash(3, k);
                real.read(
                    &reading(),
                    1.0,
                    &inverse,
                    &material,
                    &tiles,
                    seed,
                    &mut depth,
                );
                depth
            })
            .collect()
    }

    fn holes(depth: &[u16; PIXELS], keep: impl Fn(usize, usize) -> bool) -> f64 {
        let (mut holes, mut all) = (0, 0);
        for (k, &raw) in depth.iter().enumerate() {
            if keep(k / WIDTH, k % WIDTH) {
                holes += usize::from(raw == NO_READING);
                all += 1;
            }
        }
        f64::from(holes as u32) / f64::from(all as u32)
    }

    #[test]
    fn as_many_readings_fail_as_on_real_hair_faces_and_cloth() {
        for (material, z, [least, most]) in [
            (Material::Skin, 0.85, [0.0015, 0.005]),
            (Material::Hair, 0.85, [0.005, 0.012]),
            (Material::DarkHair, 1.0, [0.015, 0.03]),
            (Material::DarkHair, 1.8, [0.05, 0.12]),
            (Material::Dark, 0.85, [0.0, 0.01]),
            (Material::Cloth, 0.85, [0.0, 0.003]),
        ] {
            let frames = real_plane(kinect(), material, z, 8);
            let blank = |_, col| col < WIDTH - BLANK_COLUMNS;
            let share = frames.iter().map(|depth| holes(depth, blank)).sum::<f64>() / 8.0;
            assert!(
                (least..most).contains(&share),
                "{material:?} at {z} m: {share:.4} fail"
            );
        }
    }

    #[test]
    fn a_real_reading_changes_from_frame_to_frame_and_has_relief_as_measured() {
        let frames = real_plane(kinect(), Material::Skin, 0.9, 30);
        let (mut change, mut relief, mut count) = (0.0, 0.0, 0.0);
        let mut means = vec![0.0f64; PIXELS];
        for (k, mean) in means.iter_mut().enumerate() {
            let values: Vec<f64> = frames.iter().map(|depth| f64::from(depth[k])).collect();
            *mean = values.iter().sum::<f64>() / 30.0;
            if values.iter().all(|&raw| raw < 2000.0) {
                change += values.iter().map(|v| (v - *mean).powi(2)).sum::<f64>() / 29.0;
                count += 1.0;
            } else {
                *mean = f64::NAN;
            }
        }
        let level = means.iter().filter(|m| m.is_finite()).sum::<f64>() / count;
        relief += means
            .iter()
            .filter(|m| m.is_finite())
            .map(|m| (m - level).powi(2))
            .sum::<f64>();
        let (change, relief) = ((change / count).sqrt(), (relief / count).sqrt());
        assert!(
            (0.45..0.60).contains(&change),
            "{change} raw units from frame to frame"
        );
        // The measured 0.62 holds the relief of the things that were seen as well.
        assert!(
            (0.3..0.62).contains(&relief),
            "{relief} raw units of relief"
        );
    }

    #[test]
    fn a_stereo_cameras_noise_is_that_of_eight_hundredths_of_a_pixel() {
        let stereo = RealReading {
            stereo: true,
            ..kinect()
        };
        let frame = real_plane(stereo, Material::Skin, 0.7, 1).remove(0);
        let camera = mien_sensors::kinect::geometry::nominal();
        let read = frame.iter().filter(|raw| **raw != NO_READING);
        let off: Vec<f32> = read.map(|raw| camera.depth_m(*raw) - 0.7).collect();
        let squares: f32 = off.iter().map(|off| off * off).sum();
        let sigma = (squares / off.len() as f32).sqrt();
        assert!((0.0018..0.0024).contains(&sigma), "{sigma} m at 0.7 m");
    }

    /// Standard deviation of a straight upright outline, and the share of failed readings within 3 px inside it.
    fn outline(material: Material) -> (f64, f64) {
        let tiles = Tiles::new(5);
        let mut real = RealReading::new(&tiles, 5);
        let (mut inverse, mut made) = (vec![1.0 / 2.0; PIXELS], vec![Material::Matt; PIXELS]);
        for row in 0..HEIGHT {
            inverse[row * WIDTH + 300..row * WIDTH + 500].fill(1.0 / 0.85);
            made[row * WIDTH + 300..row * WIDTH + 500].fill(material);
        }
        let near = reading().raw_far + reading().raw_per_inverse / 0.85 + 20.0;
        let (mut squares, mut count, mut failed) = (0.0, 0.0, 0.0);
        for k in 0..4 {
            let mut depth = boxed();
            real.read(
                &reading(),
                1.0,
                &inverse,
                &made,
                &tiles,
                hash(9, k),
                &mut depth,
            );
            let edges: Vec<f64> = (10..HEIGHT - 10)
                .map(|row| {
                    let line = &depth[row * WIDTH..(row + 1) * WIDTH];
                    let last = (400..560).rev().find(|&col| f32::from(line[col]) < near);
                    last.unwrap_or(400) as f64
                })
                .collect();
            let mean = edges.iter().sum::<f64>() / edges.len() as f64;
            for edge in &edges {
                squares += (edge - mean).powi(2);
                count += 1.0;
            }
            failed += holes(&depth, |row, col| {
                row > 10 && row < HEIGHT - 10 && (497..500).contains(&col)
            });
        }
        ((squares / count).sqrt(), failed / 4.0)
    }

    #[test]
    fn outlines_are_as_ragged_as_real_ones() {
        let (cloth, cloth_fails) = outline(Material::Cloth);
        let (hair, hair_fails) = outline(Material::DarkHair);
        assert!((0.6..1.5).contains(&cloth), "cloth {cloth:.2} px");
        assert!((1.6..2.8).contains(&hair), "hair {hair:.2} px");
        assert!(
            (0.02..0.10).contains(&cloth_fails),
            "cloth {cloth_fails:.3}"
        );
        assert!((0.12..0.26).contains(&hair_fails), "hair {hair_fails:.3}");
    }
}
