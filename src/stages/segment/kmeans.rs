//! K-means of depth: splits a depth image into layers of distance.
//!
//! Method: Lloyd's algorithm (Lloyd 1982; paper section 1.1, step 1) on the histogram of depth ([`DEPTH_BINS`]). Pixels of
//! one bin share a centre, so the result equals Lloyd's algorithm on the pixels at a few comparisons per iteration: a cluster
//! is an interval of bins, and its mean one division of running totals. Centres start from the last frame's, the first ones
//! evenly over the range in use. Ties go to the nearer layer. Deterministic.
//!
//! Units: bins (linear in 1/z, finest near the sensor). Memory: 32 kB of running totals. Cost: one pass over the histogram and K searches per iteration. Degenerate: a cluster without pixels
//! keeps its centre, and with too few distinct bins several stay empty; no pixels at all leave everything unchanged.
//! Limitation: a local optimum, as always with Lloyd; restarting when a layer runs empty keeps it useful.

use crate::base::capacity::DEPTH_BINS;
use crate::base::defaults;
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;

/// Number of layers.
pub const LAYERS: usize = 4;

/// A cluster: the interval of bins nearest to one centre.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Layer {
    /// Mean bin.
    pub centre: f64,
    /// One past the last bin of the layer; the first is the previous layer's `end`, or 0.
    pub end: usize,
    /// Pixels in it.
    pub count: u64,
}

defaults! {
    /// K-means over frames.
    pub struct DepthKMeans {
        layers: [Layer; LAYERS] = [Layer::default(); LAYERS],
        warm: bool = false,
        counts: Box<[u64]> = vec![0; DEPTH_BINS + 1].into_boxed_slice(),
        sums: Box<[u64]> = vec![0; DEPTH_BINS + 1].into_boxed_slice(),
    }
}

impl DepthKMeans {
    /// Forgets the last frame's centres.
    pub fn reset(&mut self) {
        self.warm = false;
    }

    /// Clusters the bins of `histogram` in at most `iterations` rounds. Returns the layers of the last assignment, nearest first.
    pub fn cluster(&mut self, histogram: &[u32; DEPTH_BINS], iterations: u32) -> &[Layer; LAYERS] {
        for (value, &count) in histogram.iter().enumerate() {
            self.counts[value + 1] = self.counts[value] + u64::from(count);
            self.sums[value + 1] = self.sums[value] + u64::from(count) * value as u64;
        }
        let total = self.counts[DEPTH_BINS];
        if total == 0 {
            return &self.layers;
        }
        if !self.warm {
            self.spread_centres(total);
        }
        self.lloyd(iterations);
        // A layer of under 0.1 % of the pixels is wasted: restart once.
        if self.warm && self.layers.iter().any(|l| l.count * 1000 < total) {
            self.spread_centres(total);
            self.lloyd(iterations);
        }
        self.warm = true;
        &self.layers
    }

    /// Spreads the centres evenly over the bins in use, without 1 % at each end.
    fn spread_centres(&mut self, total: u64) {
        let value_at = |rank: u64| {
            self.counts
                .partition_point(|&c| c <= rank)
                .saturating_sub(1)
        };
        let low = value_at(total / 100) as f64;
        let high = value_at(total - 1 - total / 100) as f64;
        for (k, layer) in self.layers.iter_mut().enumerate() {
            layer.centre = low + (high - low) * (k as f64 + 0.5) / LAYERS as f64;
        }
    }

    fn lloyd(&mut self, iterations: u32) {
        for _ in 0..iterations.max(1) {
            let mut begin = 0;
            let mut moved = false;
            for k in 0..LAYERS {
                // Up to the midpoint of two centres, which itself belongs to the nearer layer.
                let next = self.layers.get(k + 1).map(|next| next.centre);
                let layer = &mut self.layers[k];
                layer.end = next.map_or(DEPTH_BINS, |next| {
                    let middle = (layer.centre + next) * 0.5;
                    (middle.floor() as usize + 1).clamp(begin, DEPTH_BINS)
                });
                layer.count = self.counts[layer.end] - self.counts[begin];
                if layer.count > 0 {
                    let sum = self.sums[layer.end] - self.sums[begin];
                    let mean = sum as f64 / layer.count as f64;
                    moved |= mean != layer.centre;
                    layer.centre = mean;
                }
                begin = layer.end;
            }
            if !moved {
                break;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Lloyd on single pixels, without any cleverness.
    fn brute_force(pixels: &[u16], mut centres: [f64; LAYERS], iterations: u32) -> [f64; LAYERS] {
        for _ in 0..iterations {
            let mut sums = [(0.0, 0.0); LAYERS];
            for &pixel in pixels {
                let mut best = 0;
                for k in 1..LAYERS {
                    if (f64::from(pixel) - centres[k]).abs()
                        < (f64::from(pixel) - centres[best]).abs()
                    {
                        best = k;
                    }
                }
                sums[best].0 += f64::from(pixel);
                sums[best].1 += 1.0;
            }
            for k in 0..LAYERS {
                if sums[k].1 > 0.0 {
                    centres[k] = sums[k].0 / sums[k].1;
                }
            }
        }
        centres
    }

    #[test]
    fn the_histogram_gives_exactly_what_the_pixels_give() {
        let mut rng = fastrand::Rng::with_seed(11);
        for round in 0..30 {
            let modes: Vec<(u16, u16, usize)> = (0..rng.usize(1..6))
                .map(|_| (rng.u16(380..1000), rng.u16(2..60), rng.usize(100..4000)))
                .collect();
            let mut pixels = Vec::new();
            for (at, width, n) in modes {
                pixels.extend((0..n).map(|_| at + rng.u16(..width)));
            }
            let mut histogram = [0u32; DEPTH_BINS];
            pixels.iter().for_each(|&p| histogram[usize::from(p)] += 1);
            let mut kmeans = DepthKMeans::default();
            kmeans.cluster(&histogram, 1);
            let start = kmeans.layers.map(|l| l.centre);
            kmeans.lloyd(7);
            let expected = brute_force(&pixels, start, 7);
            for (layer, centre) in kmeans.layers.iter().zip(expected) {
                assert!((layer.centre - centre).abs() < 1e-9, "round {round}");
            }
        }
    }

    #[test]
    fn separates_layers_and_is_stable() {
        let mut histogram = [0u32; DEPTH_BINS];
        for (at, n) in [(600, 8000u32), (640, 5000), (760, 900), (860, 60_000)] {
            for k in 0..10 {
                histogram[at + k] = n / 10;
            }
        }
        let mut kmeans = DepthKMeans::default();
        let first = *kmeans.cluster(&histogram, 30);
        let again = *kmeans.cluster(&histogram, 30);
        assert_eq!(first, again);
        let ends = first.map(|l| l.end);
        assert!(ends[2] > 769 && ends[2] <= 860, "{ends:?}");
        assert_eq!(first.iter().map(|l| l.count).sum::<u64>(), 73_900);
    }

    #[test]
    fn handles_no_pixels_and_one_value() {
        let mut kmeans = DepthKMeans::default();
        let mut histogram = [0u32; DEPTH_BINS];
        kmeans.cluster(&histogram, 10);
        histogram[700] = 5;
        let layers = kmeans.cluster(&histogram, 10);
        assert_eq!(layers.iter().map(|l| l.count).sum::<u64>(), 5);
    }
}
