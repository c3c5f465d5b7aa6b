//! What the cameras of a Kinect v1 make of a perfect picture: the errors of the depth reading and of the colour sensor.
//!
//! Depth is a disparity in eighths of a pixel, measured by correlation over a small window, so its noise is Gaussian in
//! disparity, alike in neighbouring pixels, and then rounded: total standard deviation about half a raw unit, which is
//! 1.4 mm at 1 m (Khoshelham & Elberink, "Accuracy and resolution of Kinect depth data", 2012). The pattern comes from a
//! projector 7.5 cm to the right (+x): what it does not light has no depth, a band to the left of near things. Edges are
//! ragged by a pixel, surfaces seen at a grazing angle drop out, the last columns are blank.
//!
//! That is [`DepthReading::read`], and what every scene had from the beginning. [`RealReading`] adds what real recordings
//! show beyond it, as measured on three of public origin:
//!
//! | what | `kinect.webm` of three.js, a man at 0.7 to 1 m | OpenISS `test-recording`, two men at 0.8 to 1 m | PCL `five_people`, 1.8 to 4 m |
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
//! The window's size is what makes all of it: detail below some 7 px is not there, an outline is that of the dots that happened
//! to fall there. The first recording went through a video codec; only its holes and outlines are used.
//!
//! One file: what both readings and the colour sensor do, and the tests against the table.
//!
//! All randomness is looked up in one tile of prepared numbers at offsets hashed from seed and time, so a frame costs no
//! random-number generation and is the same on every machine. Limitation: the tile repeats after 256 pixels.

use super::appearance::Stuff;
use super::random::{hash, uniform};
use crate::base::capacity::{HEIGHT, PIXELS, WIDTH};
use crate::sensor::NO_DEPTH;

/// Side of the tile, a power of two.
const SIDE: usize = 256;
/// Standard deviation of the disparity before rounding, raw units.
const DISPARITY_SIGMA: f32 = 0.4;
/// Nearest raw value the optics give: 0.5 m.
const NEAREST_RAW: f32 = 395.0;
/// Farthest raw value that is a measurement: about 13 m.
const FARTHEST_RAW: f32 = 1075.0;
/// Columns at the right without data, because of the correlation window.
const BLANK_COLUMNS: usize = 8;
/// Slope in raw units per pixel from which readings fail: 0.6 tan(angle) / z, so 77° at 0.8 m.
const GRAZING_SLOPE: f32 = 3.2;
/// Slope added until four of five readings fail.
const GRAZING_SPAN: f32 = 5.0;

/// Prepared random numbers.
pub(crate) struct Tiles {
    /// Independent, standard normal.
    white: Vec<f32>,
    /// Alike within about three pixels, standard normal.
    smooth: Vec<f32>,
}

impl Tiles {
    pub(crate) fn new(seed: u64) -> Self {
        let white: Vec<f32> = (0..(SIDE * SIDE) as u64)
            .map(|i| {
                // A sum of uniforms is normal enough, and needs no library function whose last digit may differ.
                let sum: f32 = (0..8).map(|k| uniform(seed, i * 8 + k)).sum();
                sum * (3.0f32 / 8.0).sqrt()
            })
            .collect();
        let smooth = (0..SIDE * SIDE)
            .map(|i| {
                let (row, col) = (i / SIDE, i % SIDE);
                let mut sum = 0.0;
                for (dr, wr) in [(SIDE - 1, 0.5), (0, 1.0), (1, 0.5)] {
                    for (dc, wc) in [(SIDE - 1, 0.5), (0, 1.0), (1, 0.5)] {
                        sum += wr * wc * white[(row + dr) % SIDE * SIDE + (col + dc) % SIDE];
                    }
                }
                // Root of the sum of the squared weights: 1.5.
                sum / 1.5
            })
            .collect();
        Self { white, smooth }
    }

    fn row(tile: &[f32], row: usize) -> &[f32; SIDE] {
        let start = (row % SIDE) * SIDE;
        tile[start..start + SIDE]
            .first_chunk()
            .expect("a row is SIDE long")
    }
}

/// The depth camera's errors.
pub(crate) struct DepthReading {
    /// Raw value = `raw_far` + `raw_per_inverse` / z.
    pub(crate) raw_far: f32,
    pub(crate) raw_per_inverse: f32,
}

impl DepthReading {
    /// Reads a perfect picture (1/z per pixel, 0 = nothing) as the sensor would.
    pub(crate) fn read(
        &self,
        inverse: &[f32],
        tiles: &Tiles,
        seed: u64,
        depth: &mut [u16; PIXELS],
    ) {
        let offset = |k| (hash(seed, k) as usize) % SIDE;
        let (o1, o2, o3, o4) = (offset(1), offset(2), offset(3), offset(4));
        let mut dark = [false; WIDTH];
        for row in 0..HEIGHT {
            let line = |row: usize| {
                inverse[row * WIDTH..]
                    .first_chunk::<WIDTH>()
                    .expect("a row of the picture")
            };
            let (above, here, below) = (
                line(row.saturating_sub(1)),
                line(row),
                line((row + 1).min(HEIGHT - 1)),
            );
            self.shade(here, &mut dark);
            let jitter = Tiles::row(&tiles.white, row + o1);
            let wobble = Tiles::row(&tiles.smooth, row + o2);
            let chance = Tiles::row(&tiles.smooth, row + o4);
            let out = &mut depth[row * WIDTH..(row + 1) * WIDTH];
            for col in 0..WIDTH {
                let (before, after) = (col.saturating_sub(1), (col + 1).min(WIDTH - 1));
                let across = (here[after] - here[before]).abs() * 0.5;
                let along = (below[col] - above[col]).abs() * 0.5;
                let slope = across.max(along) * -self.raw_per_inverse;
                let mut value = here[col];
                let mut lit = !dark[col];
                if slope > GRAZING_SLOPE {
                    // An edge: the window sees one side or the other.
                    let n = jitter[(col + o1) % SIDE];
                    let source = if n > 0.7 {
                        after
                    } else if n < -0.7 {
                        before
                    } else {
                        col
                    };
                    value = here[source];
                    lit &= !dark[source];
                    let fails = ((slope - GRAZING_SLOPE) / GRAZING_SPAN).min(1.0) * 1.7 - 0.85;
                    lit &= chance[(col + o4) % SIDE] > fails;
                }
                let raw = self.raw_far
                    + self.raw_per_inverse * value
                    + DISPARITY_SIGMA * wobble[(col + o3) % SIDE];
                out[col] = if lit && value > 0.0 && (NEAREST_RAW..FARTHEST_RAW).contains(&raw) {
                    (raw + 0.5) as u16
                } else {
                    NO_DEPTH
                };
            }
            out[WIDTH - BLANK_COLUMNS..].fill(NO_DEPTH);
        }
    }

    /// Marks what the projector does not light. Seen from the projector a pixel stands at column + raw / 8 (plus a
    /// constant); going left, that must fall, else something nearer to the right is in the way.
    fn shade(&self, inverse: &[f32; WIDTH], dark: &mut [bool; WIDTH]) {
        let mut nearest = f32::INFINITY;
        for col in (0..WIDTH).rev() {
            let seen = col as f32 + self.raw_per_inverse * inverse[col] * 0.125;
            dark[col] = seen > nearest + 0.5;
            nearest = nearest.min(seen);
        }
    }
}

/// What a real sensor does to a surface: shares of readings that fail at 1 m, within it and within [`RIM_PX`] of its edge,
/// and how far its edge is ragged, pixels (one standard deviation).
struct Answer {
    fails: f32,
    fails_at_rim: f32,
    ragged_px: f32,
}

const fn answer(stuff: Stuff) -> Answer {
    let (fails, fails_at_rim, ragged_px) = match stuff {
        Stuff::Matt => (0.0004, 0.05, 1.0),
        Stuff::Skin => (0.003, 0.05, 1.0),
        Stuff::Cloth => (0.0006, 0.05, 1.0),
        Stuff::Dark => (0.006, 0.07, 1.1),
        Stuff::Hair => (0.009, 0.16, 1.8),
        Stuff::DarkHair => (0.022, 0.20, 2.4),
        Stuff::Glass => (0.12, 0.30, 1.0),
        #[cfg(feature = "studio")]
        Stuff::Gloss => (0.85, 0.95, 1.5),
    };
    Answer {
        fails,
        fails_at_rim,
        ragged_px,
    }
}

/// Width of the rim in which readings fail more often.
const RIM_PX: usize = 3;
/// Step between neighbours that is an edge, raw units.
const STEP_RAW: f32 = 18.0;
/// Share of the readings beside an edge that lie between its two sides.
const BETWEEN: f32 = 0.035;
/// Standard deviations of a surface's relief that is not there, raw units: of the pattern, of the columns; and of the
/// change from frame to frame.
const RELIEF_SIGMA: f32 = 0.34;
const STRIPE_SIGMA: f32 = 0.17;
const CHANGE_SIGMA: f32 = 0.42;
/// Strength from which outlines are those of the window.
const HALF: f32 = 0.5;
/// Where the correlation window is looked into, pixels from its middle.
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
/// Surfaces closer than this are one for the correlation window, raw units.
const WINDOW_RAW: f32 = 12.0;

/// The depth camera's errors in full: work space for [`RealReading::read`].
pub(crate) struct RealReading {
    /// Alike within about five pixels, standard normal.
    lobes: Vec<f32>,
    /// Alike within about eight pixels, as ranks in 0…1.
    ranks: Vec<f32>,
    stripes: Vec<f32>,
    edge: Vec<bool>,
    rim: Vec<bool>,
    dark: Vec<bool>,
}

/// A tile blurred with a 3 × 3 binomial, again standard normal.
fn softened(tile: &[f32], times: usize) -> Vec<f32> {
    let mut soft = tile.to_vec();
    for _ in 0..times {
        let before = soft.clone();
        for (i, out) in soft.iter_mut().enumerate() {
            let (row, col) = (i / SIDE, i % SIDE);
            let mut sum = 0.0;
            for (dr, wr) in [(SIDE - 1, 0.5), (0, 1.0), (1, 0.5)] {
                for (dc, wc) in [(SIDE - 1, 0.5), (0, 1.0), (1, 0.5)] {
                    sum += wr * wc * before[(row + dr) % SIDE * SIDE + (col + dc) % SIDE];
                }
            }
            *out = sum;
        }
        let power = soft.iter().map(|v| v * v).sum::<f32>() / soft.len() as f32;
        let scale = 1.0 / power.sqrt();
        soft.iter_mut().for_each(|v| *v *= scale);
    }
    soft
}

impl RealReading {
    /// `seed`: of the one sensor, whose pattern is always the same.
    pub(crate) fn new(tiles: &Tiles, seed: u64) -> Self {
        let lobes = softened(&tiles.white, 2);
        let broad = softened(&tiles.white, 7);
        let mut order: Vec<usize> = (0..broad.len()).collect();
        order.sort_by(|&a, &b| broad[a].total_cmp(&broad[b]));
        let mut ranks = vec![0.0; broad.len()];
        for (rank, &i) in order.iter().enumerate() {
            ranks[i] = rank as f32 / order.len() as f32;
        }
        let column = |col: usize| {
            let k = |c: usize| uniform(seed ^ 0x57e1, c as u64);
            // Root of the mean square of this sum: √(1.5 · ⅓).
            (k(col) + 0.5 * k(col + 1) + 0.5 * k(col + 2)) * std::f32::consts::SQRT_2
        };
        Self {
            lobes,
            ranks,
            stripes: (0..WIDTH).map(column).collect(),
            edge: vec![false; PIXELS],
            rim: vec![false; PIXELS],
            dark: vec![false; PIXELS],
        }
    }

    /// Reads a perfect picture and what it shows as a real sensor would; `strength`: how much of its faults.
    ///
    /// Long because a pixel goes through all faults in the order of the sensor, each using what those before it have made.
    pub(crate) fn read(
        &mut self,
        reading: &DepthReading,
        strength: f32,
        inverse: &[f32],
        stuff: &[Stuff],
        tiles: &Tiles,
        seed: u64,
        depth: &mut [u16; PIXELS],
    ) {
        self.find_edges(reading, inverse);
        let offset = |k| (hash(seed, k) as usize) % SIDE;
        let (o1, o2, o3, o4) = (offset(1), offset(2), offset(3), offset(4));
        let still = |tile: &[f32], row: usize, col: usize, by: usize| {
            tile[(row + 37 * by) % SIDE * SIDE + (col + 91 * by) % SIDE]
        };
        let moving = |tile: &[f32], row: usize, col: usize, by: usize| {
            tile[(row + by) % SIDE * SIDE + (col + by / 3) % SIDE]
        };
        let raw_per_inverse = -reading.raw_per_inverse;
        for row in 0..HEIGHT {
            for col in 0..WIDTH {
                let here = row * WIDTH + col;
                let near = |dr: isize, dc: isize| {
                    let r = row.saturating_add_signed(dr).min(HEIGHT - 1);
                    let c = col.saturating_add_signed(dc).min(WIDTH - 1);
                    r * WIDTH + c
                };
                // Where the window's best match really lies: hair frays what is beside it, too.
                let mut ragged = 0.0f32;
                if self.rim[here] {
                    for (dr, dc) in [(0, 0), (0, -3), (0, 3), (-3, 0), (3, 0)] {
                        ragged = ragged.max(answer(stuff[near(dr, dc)]).ragged_px);
                    }
                }
                let swing = |by: usize, o: usize| {
                    0.72 * still(&self.lobes, row, col, by)
                        + 0.69 * moving(&self.lobes, row, col, o)
                };
                let reach = ragged * strength;
                let (dy, dx) = if reach > 0.0 {
                    (
                        (reach * swing(1, o1)).round() as isize,
                        (reach * swing(2, o2)).round() as isize,
                    )
                } else {
                    (0, 0)
                };
                let source = near(dy, dx);
                let mut value = inverse[source];
                let made = answer(stuff[source]);
                let mut lit = !self.dark[source] && value > 0.0;
                // The window takes in what is around: near an edge what most of it shows, everywhere a mean of that.
                let around = TAPS.map(|(dr, dc)| inverse[near(dy + dr, dx + dc)]);
                if self.rim[here] && strength > HALF {
                    let mut sorted = around;
                    sorted.sort_unstable_by(f32::total_cmp);
                    value = sorted[TAPS.len() / 2];
                    let same = |other: f32| (other - value).abs() * raw_per_inverse < WINDOW_RAW;
                    let dark = |k: &usize| {
                        let (dr, dc) = TAPS[*k];
                        self.dark[near(dy + dr, dx + dc)]
                    };
                    let agree = (0..TAPS.len()).filter(|&k| same(around[k]));
                    let (all, unlit) =
                        agree.fold((0, 0), |(a, u), k| (a + 1, u + usize::from(dark(&k))));
                    lit = value > 0.0 && 2 * unlit < all;
                }
                let (mut sum, mut count) = (0.0, 0.0);
                for other in around {
                    if (other - value).abs() * raw_per_inverse < WINDOW_RAW {
                        sum += other;
                        count += 1.0;
                    }
                }
                if count > 0.0 {
                    value += strength * (sum / count - value);
                }
                let across = (inverse[near(0, 1)] - inverse[near(0, -1)]).abs();
                let along = (inverse[near(1, 0)] - inverse[near(-1, 0)]).abs();
                let steep = across.max(along) * 0.5 * raw_per_inverse;
                if steep > GRAZING_SLOPE && !self.edge[here] {
                    let fails = ((steep - GRAZING_SLOPE) / GRAZING_SPAN).min(1.0) * 0.8;
                    lit &= still(&self.ranks, row, col, 3) > fails;
                } else if self.edge[here]
                    && still(&tiles.white, row, col, o3).abs() < 1.25 * BETWEEN * strength
                {
                    value = 0.5 * (inverse[near(0, 1)] + inverse[near(0, -1)]);
                }
                // Less light comes back from farther away.
                let far = 1.0 / value.max(0.2);
                let fails = made.fails * far * far;
                let fails = if self.rim[here] {
                    fails.max(made.fails_at_rim * far)
                } else {
                    fails
                };
                let fails = (fails * strength).min(0.95);
                lit &= still(&self.ranks, row, col, 4) >= 0.65 * fails
                    && moving(&self.ranks, row, col, o4) >= 0.35 * fails / (1.0 - 0.65 * fails);
                let relief =
                    0.8 * still(&tiles.smooth, row, col, 5) + 0.6 * still(&self.lobes, row, col, 6);
                let change = 0.6 * moving(&tiles.smooth, row, col, o2)
                    + 0.8 * moving(&self.lobes, row, col, o3);
                let noise = strength * (RELIEF_SIGMA * relief + STRIPE_SIGMA * self.stripes[col])
                    + (DISPARITY_SIGMA + strength * (CHANGE_SIGMA - DISPARITY_SIGMA)) * change;
                let raw = reading.raw_far + reading.raw_per_inverse * value + noise;
                depth[here] = if lit && (NEAREST_RAW..FARTHEST_RAW).contains(&raw) {
                    (raw + 0.5) as u16
                } else {
                    NO_DEPTH
                };
            }
            depth[(row + 1) * WIDTH - BLANK_COLUMNS..(row + 1) * WIDTH].fill(NO_DEPTH);
        }
    }

    /// Finds steps, what is near them, and what the projector does not light.
    fn find_edges(&mut self, reading: &DepthReading, inverse: &[f32]) {
        let step = STEP_RAW / -reading.raw_per_inverse;
        for row in 0..HEIGHT {
            let start = row * WIDTH;
            let line = inverse[start..].first_chunk::<WIDTH>().expect("a row");
            let dark = self.dark[start..].first_chunk_mut().expect("a row");
            reading.shade(line, dark);
            for col in 0..WIDTH {
                let here = start + col;
                let right = if col + 1 < WIDTH { here + 1 } else { here };
                let left = if col > 0 { here - 1 } else { here };
                let below = if row + 1 < HEIGHT { here + WIDTH } else { here };
                let above = if row > 0 { here - WIDTH } else { here };
                self.edge[here] = [right, left, below, above]
                    .iter()
                    .any(|&k| (inverse[k] - inverse[here]).abs() > step);
            }
        }
        // Grown along rows, then along columns.
        for row in 0..HEIGHT {
            let mut since = RIM_PX;
            let line = row * WIDTH..(row + 1) * WIDTH;
            for k in line.clone() {
                since = if self.edge[k] { 0 } else { since + 1 };
                self.rim[k] = since < RIM_PX;
            }
            since = RIM_PX;
            for k in line.rev() {
                since = if self.edge[k] { 0 } else { since + 1 };
                self.rim[k] |= since < RIM_PX;
            }
        }
        for col in 0..WIDTH {
            let (mut since, mut until) = (RIM_PX, RIM_PX);
            for row in 0..HEIGHT {
                let k = row * WIDTH + col;
                since = if self.edge[k] { 0 } else { since + 1 };
                self.rim[k] |= since < RIM_PX;
                let k = (HEIGHT - 1 - row) * WIDTH + col;
                until = if self.edge[k] { 0 } else { until + 1 };
                self.rim[k] |= until < RIM_PX;
            }
        }
    }
}

/// Bayer mosaic of an RGB picture with exposure of each channel and sensor noise (`sigma` grey levels). Green, red / blue, green.
pub(crate) fn expose(
    rgb: &[[u8; 3]],
    exposure: [f32; 3],
    sigma: f32,
    tiles: &Tiles,
    seed: u64,
    bayer: &mut [u8; PIXELS],
) {
    let offset = |k| (hash(seed, k) as usize) % SIDE;
    let (o5, o6) = (offset(5), offset(6));
    for row in 0..HEIGHT {
        let noise = Tiles::row(&tiles.white, row + o5);
        let colours = rgb[row * WIDTH..(row + 1) * WIDTH]
            .first_chunk::<WIDTH>()
            .expect("a row");
        let out = &mut bayer[row * WIDTH..(row + 1) * WIDTH];
        let (even, odd) = if row % 2 == 0 { (1, 0) } else { (2, 1) };
        for (pair, col) in out.chunks_exact_mut(2).zip((0..WIDTH).step_by(2)) {
            let level = |col: usize, channel: usize| {
                let value = f32::from(colours[col][channel]) * exposure[channel]
                    + sigma * noise[(col + o6) % SIDE]
                    + 0.5;
                // The conversion itself stops at 0 and 255.
                value as u8
            };
            pair[0] = level(col, even);
            pair[1] = level(col + 1, odd);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reading() -> DepthReading {
        super::super::depth_reading(&crate::sensor::kinect::geometry::nominal())
    }

    fn boxed() -> Box<[u16; PIXELS]> {
        vec![0; PIXELS].try_into().expect("PIXELS long")
    }

    #[test]
    fn the_noise_of_a_wall_is_half_a_raw_unit_and_unbiased() {
        let (camera, tiles) = (crate::sensor::kinect::geometry::nominal(), Tiles::new(7));
        let mut depth = boxed();
        let (mut sum, mut squares, mut n) = (0.0f64, 0.0f64, 0.0f64);
        for k in 0..20 {
            let z = 1.0 + 0.0007 * k as f32;
            let truth = f64::from(camera.raw_from_m(z));
            reading().read(&vec![1.0 / z; PIXELS], &tiles, k, &mut depth);
            for row in 0..HEIGHT {
                for &raw in &depth[row * WIDTH..row * WIDTH + WIDTH - BLANK_COLUMNS] {
                    let error = f64::from(raw) - truth;
                    sum += error;
                    squares += error * error;
                    n += 1.0;
                }
            }
        }
        let (mean, deviation) = (sum / n, (squares / n).sqrt());
        assert!(mean.abs() < 0.03, "bias {mean} raw units");
        assert!(
            (deviation - 0.5).abs() < 0.03,
            "deviation {deviation} raw units"
        );
        assert!(depth[WIDTH - 1] == NO_DEPTH && depth[WIDTH - 9] != NO_DEPTH);
    }

    /// A plane of some stuff as the real sensor sees it, frame by frame.
    fn real_plane(stuff: Stuff, z: f32, frames: u64) -> Vec<Box<[u16; PIXELS]>> {
        let tiles = Tiles::new(7);
        let mut real = RealReading::new(&tiles, 7);
        let (inverse, stuff) = (vec![1.0 / z; PIXELS], vec![stuff; PIXELS]);
        (0..frames)
            .map(|k| {
                let mut depth = boxed();
                let seed = hash(3, k);
                real.read(&reading(), 1.0, &inverse, &stuff, &tiles, seed, &mut depth);
                depth
            })
            .collect()
    }

    fn holes(depth: &[u16; PIXELS], keep: impl Fn(usize, usize) -> bool) -> f64 {
        let (mut holes, mut all) = (0, 0);
        for (k, &raw) in depth.iter().enumerate() {
            if keep(k / WIDTH, k % WIDTH) {
                holes += usize::from(raw == NO_DEPTH);
                all += 1;
            }
        }
        f64::from(holes as u32) / f64::from(all as u32)
    }

    #[test]
    fn as_many_readings_fail_as_on_real_hair_faces_and_cloth() {
        for (stuff, z, [least, most]) in [
            (Stuff::Skin, 0.85, [0.0015, 0.005]),
            (Stuff::Hair, 0.85, [0.005, 0.012]),
            (Stuff::DarkHair, 1.0, [0.015, 0.03]),
            (Stuff::DarkHair, 1.8, [0.05, 0.12]),
            (Stuff::Dark, 0.85, [0.0, 0.01]),
            (Stuff::Cloth, 0.85, [0.0, 0.003]),
        ] {
            let frames = real_plane(stuff, z, 8);
            let blank = |_, col| col < WIDTH - BLANK_COLUMNS;
            let share = frames.iter().map(|depth| holes(depth, blank)).sum::<f64>() / 8.0;
            assert!(
                (least..most).contains(&share),
                "{stuff:?} at {z} m: {share:.4} fail"
            );
        }
    }

    #[test]
    fn a_real_reading_changes_from_frame_to_frame_and_has_relief_as_measured() {
        let frames = real_plane(Stuff::Skin, 0.9, 30);
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

    /// Standard deviation of a straight upright outline, and the share of failed readings within 3 px inside it.
    fn outline(stuff: Stuff) -> (f64, f64) {
        let tiles = Tiles::new(5);
        let mut real = RealReading::new(&tiles, 5);
        let (mut inverse, mut made) = (vec![1.0 / 2.0; PIXELS], vec![Stuff::Matt; PIXELS]);
        for row in 0..HEIGHT {
            inverse[row * WIDTH + 300..row * WIDTH + 500].fill(1.0 / 0.85);
            made[row * WIDTH + 300..row * WIDTH + 500].fill(stuff);
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
        let (cloth, cloth_fails) = outline(Stuff::Cloth);
        let (hair, hair_fails) = outline(Stuff::DarkHair);
        assert!((0.6..1.5).contains(&cloth), "cloth {cloth:.2} px");
        assert!((1.6..2.8).contains(&hair), "hair {hair:.2} px");
        assert!(
            (0.02..0.10).contains(&cloth_fails),
            "cloth {cloth_fails:.3}"
        );
        assert!((0.12..0.26).contains(&hair_fails), "hair {hair_fails:.3}");
    }

    #[test]
    fn the_shadow_is_to_the_left_and_as_wide_as_the_disparities_differ() {
        let (near, far) = (0.8, 1.6);
        let mut inverse = vec![1.0 / far; PIXELS];
        for row in 100..300 {
            inverse[row * WIDTH + 300..row * WIDTH + 400].fill(1.0 / near);
        }
        let mut depth = boxed();
        reading().read(&inverse, &Tiles::new(1), 1, &mut depth);
        let row = &depth[200 * WIDTH..201 * WIDTH];
        // Disparity is f b / z: 575.8 px × 0.075 m × (1/0.8 − 1/1.6) = 27 px.
        let dark = row[250..300].iter().filter(|&&raw| raw == NO_DEPTH).count();
        assert!((25..=29).contains(&dark), "{dark} pixels");
        assert!(row[402..500].iter().all(|&raw| raw != NO_DEPTH));
    }
}
