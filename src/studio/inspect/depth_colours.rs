//! Depth colours by histogram equalisation: a depth range gets colours in proportion to its surface, weighted towards
//! the sensor.
//!
//! The histogram is over 1/z, in which the sensor's steps are about even, each pixel weighted by 1/z², so that a
//! person in front of a wall gets more colours than the wall; its cumulative share is the colour. A fifth of each
//! colour is linear in 1/z, so that a gap in depth stays a step. Memory: [`BINS`] numbers.

use image::RgbImage;

use mien_stages::base::capacity::{HEIGHT, PIXELS, WIDTH};
use mien_stages::camera::Camera;
use mien_workbench::canvas;

/// Bins from 1/[`FAR_M`] to 1/[`NEAR_M`].
const BINS: usize = 1024;
const NEAR_M: f32 = 0.3;
const FAR_M: f32 = 8.0;
/// Part of a colour that is linear in 1/z.
const LINEAR: f64 = 0.2;

/// Histogram of depth, and the colour of each bin.
pub(crate) struct DepthColours {
    seen: Vec<f64>,
    share: Vec<f32>,
}

impl Default for DepthColours {
    fn default() -> Self {
        Self {
            seen: vec![0.0; BINS],
            share: vec![0.0; BINS],
        }
    }
}

fn bin(z: f32) -> usize {
    let share = (1.0 / z - 1.0 / FAR_M) / (1.0 / NEAR_M - 1.0 / FAR_M);
    (share.clamp(0.0, 1.0) * (BINS - 1) as f32) as usize
}

fn depth_m(raw: u16, camera: &Camera) -> Option<f32> {
    let z = camera.depth_m(raw);
    (z > 0.0).then_some(z)
}

impl DepthColours {
    /// Adds a frame to the histogram.
    pub(crate) fn add(&mut self, depth: &[u16; PIXELS], camera: &Camera) {
        for z in depth.iter().filter_map(|&raw| depth_m(raw, camera)) {
            self.seen[bin(z)] += f64::from(1.0 / (z * z));
        }
    }

    /// Computes the colours from the added frames.
    pub(crate) fn fitted(mut self) -> Self {
        let all: f64 = self.seen.iter().sum();
        let is_seen = |seen: &f64| *seen > 0.0;
        let first = self.seen.iter().position(is_seen).unwrap_or(0);
        let last = self.seen.iter().rposition(is_seen).unwrap_or(0);
        let mut before = 0.0;
        for (k, seen) in self.seen.iter().enumerate() {
            let even = k.saturating_sub(first) as f64 / (last - first).max(1) as f64;
            let share = (before + 0.5 * seen) / all.max(f64::MIN_POSITIVE);
            self.share[k] = (LINEAR * even.min(1.0) + (1.0 - LINEAR) * share) as f32;
            before += seen;
        }
        self
    }

    /// Renders depth in these colours: near is light, far is dark, no measurement is black.
    pub(crate) fn picture(&self, depth: &[u16; PIXELS], camera: &Camera) -> RgbImage {
        RgbImage::from_fn(WIDTH as u32, HEIGHT as u32, |x, y| {
            let z = depth_m(depth[y as usize * WIDTH + x as usize], camera);
            image::Rgb(z.map_or([0; 3], |z| canvas::false_colour(self.share[bin(z)])))
        })
    }

    /// Depths at which the colours are 0, 1/4, 2/4, 3/4 and 1 of the way from far to near, metres.
    pub(crate) fn key_m(&self) -> [f32; 5] {
        let is_seen = |&k: &usize| self.seen[k] > 0.0;
        [0.0, 0.25, 0.5, 0.75, 1.0].map(|share: f32| {
            let bins = (0..BINS).filter(is_seen);
            let off = |k: &usize| (self.share[*k] - share).abs();
            let k = bins.min_by(|a, b| off(a).total_cmp(&off(b))).unwrap_or(0);
            let along = k as f32 / (BINS - 1) as f32;
            1.0 / (1.0 / FAR_M + along * (1.0 / NEAR_M - 1.0 / FAR_M))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mien_sensors::kinect::geometry;
    use mien_sensors::kinect::unpack::NO_READING;

    /// A wall at 2.5 m, and before it over a fifth of the picture a head and shoulders from 0.9 to 1.1 m.
    #[test]
    fn a_person_before_a_wall_takes_most_of_the_colours() {
        let camera = geometry::nominal();
        let raw_of = |z: f32| {
            let off = |raw: &u16| depth_m(*raw, &camera).map_or(f32::MAX, |at| (at - z).abs());
            (0..NO_READING).min_by(|a, b| off(a).total_cmp(&off(b)))
        };
        let (wall, near, far) = (raw_of(2.5), raw_of(0.9), raw_of(1.1));
        let [wall, near, far] = [wall, near, far].map(Option::unwrap);
        let mut depth = vec![wall; PIXELS];
        let person = PIXELS / 5;
        for (k, raw) in depth[..person].iter_mut().enumerate() {
            *raw = near + (k * usize::from(far - near) / person) as u16;
        }
        let mut colours = DepthColours::default();
        colours.add(depth.as_slice().try_into().unwrap(), &camera);
        let colours = colours.fitted();
        let share = |raw| colours.share[bin(depth_m(raw, &camera).unwrap())];
        let of_person = share(near) - share(far);
        assert!(of_person > 0.45, "{of_person}");
        assert!(share(far) > share(wall) + 0.2, "the wall is apart");
        let [farthest, .., nearest] = colours.key_m();
        assert!((2.3..2.7).contains(&farthest) && (0.85..0.95).contains(&nearest));
    }
}
