//! Errors of a Kinect v1's depth measurement and colour sensor, applied to perfect images.
//!
//! Depth is a disparity in eighths of a pixel, measured by correlation over a small window. Its noise is Gaussian in disparity,
//! correlated between neighbouring pixels, and then rounded: total standard deviation about half a raw unit, 1.4 mm at 1 m
//! (Khoshelham & Elberink, "Accuracy and resolution of Kinect depth data", 2012). The projector is 7.5 cm to the right (+x);
//! surfaces that it does not light have no depth, a band to the left of near things. Edges are ragged by a pixel, surfaces at a
//! grazing angle drop out, the last columns are blank.
//!
//! `real_noise` adds further errors of real recordings.
//!
//! Random numbers are read from one prepared tile at offsets hashed from seed and time, so a frame needs no random-number generator
//! and is the same on every machine. Limitation: the tile repeats after 256 pixels.

use super::random::{hash, uniform};
use mien_sensors::kinect::geometry::BLANK_COLUMNS;
use mien_sensors::kinect::unpack::NO_READING;
use mien_stages::base::capacity::{HEIGHT, PIXELS, WIDTH};
use mien_stages::camera::Camera;

/// Side of the tile, a power of two.
pub(super) const SIDE: usize = 256;
/// Standard deviation of the disparity before rounding, raw units.
pub(super) const DISPARITY_SIGMA: f32 = 0.4;
/// Smallest raw value the optics give: 0.5 m.
pub(super) const NEAREST_RAW: f32 = 395.0;
/// Largest raw value that is a measurement: about 13 m.
pub(super) const FARTHEST_RAW: f32 = 1075.0;
/// Slope from which readings fail, raw units per pixel: 0.6 tan(angle) / z, so 77° at 0.8 m.
pub(super) const GRAZING_SLOPE: f32 = 3.2;
/// Further slope at which four of five readings fail, raw units per pixel.
pub(super) const GRAZING_SPAN: f32 = 5.0;

/// Prepared random numbers.
pub(crate) struct Tiles {
    /// Independent, standard normal.
    pub(super) white: Vec<f32>,
    /// Correlated within about three pixels, standard normal.
    pub(super) smooth: Vec<f32>,
}

impl Tiles {
    pub(crate) fn new(seed: u64) -> Self {
        let white: Vec<f32> = (0..(SIDE * SIDE) as u64)
            .map(|i| {
                // A sum of uniforms is close to normal and needs no library function whose last digit depends on the platform.
                let sum: f32 = (0..8).map(|k| uniform(seed, i * 8 + k)).sum();
                sum * (3.0f32 / 8.0).sqrt()
            })
            .collect();
        // 1.5: root of the sum of the squared weights.
        let smooth = blurred(&white).iter().map(|sum| sum / 1.5).collect();
        Self { white, smooth }
    }

    fn row(tile: &[f32], row: usize) -> &[f32; SIDE] {
        let rest = &tile[(row % SIDE) * SIDE..];
        rest.first_chunk().expect("a row is SIDE long")
    }
}

/// The sums of a 3 × 3 binomial over a tile.
pub(super) fn blurred(tile: &[f32]) -> Vec<f32> {
    let sum = |i: usize| {
        let (row, col) = (i / SIDE, i % SIDE);
        let mut sum = 0.0;
        for (dr, wr) in [(SIDE - 1, 0.5), (0, 1.0), (1, 0.5)] {
            for (dc, wc) in [(SIDE - 1, 0.5), (0, 1.0), (1, 0.5)] {
                sum += wr * wc * tile[(row + dr) % SIDE * SIDE + (col + dc) % SIDE];
            }
        }
        sum
    };
    (0..SIDE * SIDE).map(sum).collect()
}

/// A row of an image.
pub(super) fn line<T>(picture: &[T], row: usize) -> &[T; WIDTH] {
    let rest = &picture[row * WIDTH..];
    rest.first_chunk().expect("a row of the picture")
}

/// Simulates the depth camera's errors.
pub(crate) struct DepthReading {
    /// Raw value = `raw_far` + `raw_per_inverse` / z.
    pub(crate) raw_far: f32,
    pub(crate) raw_per_inverse: f32,
}

impl DepthReading {
    /// Reads both constants from the camera: its raw depth is linear in 1/z.
    pub(crate) fn from_camera(camera: &Camera) -> Self {
        let (near, far) = (0.5, 4.0);
        let (a, b) = (camera.raw_from_m(near), camera.raw_from_m(far));
        let raw_per_inverse = (a - b) / (1.0 / near - 1.0 / far);
        Self {
            raw_far: b - raw_per_inverse / far,
            raw_per_inverse,
        }
    }

    /// Converts a perfect image (1/z per pixel, 0 = empty) to raw depth with errors.
    pub(crate) fn read(
        &self,
        inverse: &[f32],
        tiles: &Tiles,
        seed: u64,
        depth: &mut [u16; PIXELS],
    ) {
        let [o1, o2, o3, o4] = [1, 2, 3, 4].map(|k| (hash(seed, k) as usize) % SIDE);
        let mut dark = [false; WIDTH];
        for row in 0..HEIGHT {
            let rows = [row.saturating_sub(1), row, (row + 1).min(HEIGHT - 1)];
            let [above, here, below] = rows.map(|row| line(inverse, row));
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
                    // At an edge the window measures one side or the other.
                    let n = jitter[(col + o1) % SIDE];
                    let source = match n {
                        n if n > 0.7 => after,
                        n if n < -0.7 => before,
                        _ => col,
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
                    NO_READING
                };
            }
            out[WIDTH - BLANK_COLUMNS..].fill(NO_READING);
        }
    }

    /// Marks pixels that the projector does not light. Seen from the projector, a pixel is at column + raw / 8 (plus a constant); a
    /// pixel is lit only if it is left of all pixels to its right.
    pub(super) fn shade(&self, inverse: &[f32; WIDTH], dark: &mut [bool; WIDTH]) {
        let mut nearest = f32::INFINITY;
        for col in (0..WIDTH).rev() {
            let seen = col as f32 + self.raw_per_inverse * inverse[col] * 0.125;
            dark[col] = seen > nearest + 0.5;
            nearest = nearest.min(seen);
        }
    }
}

/// Bayer mosaic (green, red / blue, green) of an RGB image, with an exposure per channel and sensor noise of `sigma` grey levels.
pub(crate) fn expose(
    rgb: &[[u8; 3]],
    exposure: [f32; 3],
    sigma: f32,
    tiles: &Tiles,
    seed: u64,
    bayer: &mut [u8; PIXELS],
) {
    let [o5, o6] = [5, 6].map(|k| (hash(seed, k) as usize) % SIDE);
    for row in 0..HEIGHT {
        let noise = Tiles::row(&tiles.white, row + o5);
        let colours = line(rgb, row);
        let out = &mut bayer[row * WIDTH..(row + 1) * WIDTH];
        let (even, odd) = if row % 2 == 0 { (1, 0) } else { (2, 1) };
        for (pair, col) in out.chunks_exact_mut(2).zip((0..WIDTH).step_by(2)) {
            let level = |col: usize, channel: usize| {
                let value = f32::from(colours[col][channel]) * exposure[channel]
                    + sigma * noise[(col + o6) % SIDE]
                    + 0.5;
                // The cast saturates at 0 and 255.
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
        DepthReading::from_camera(&mien_sensors::kinect::geometry::nominal())
    }

    fn boxed() -> Box<[u16; PIXELS]> {
        vec![0; PIXELS].try_into().expect("PIXELS long")
    }

    #[test]
    fn the_noise_of_a_wall_is_half_a_raw_unit_and_unbiased() {
        let (camera, tiles) = (mien_sensors::kinect::geometry::nominal(), Tiles::new(7));
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
        assert!(depth[WIDTH - 1] == NO_READING && depth[WIDTH - 9] != NO_READING);
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
        let dark = row[250..300]
            .iter()
            .filter(|&&raw| raw == NO_READING)
            .count();
        assert!((25..=29).contains(&dark), "{dark} pixels");
        assert!(row[402..500].iter().all(|&raw| raw != NO_READING));
    }
}
