//! Depth frame to head cloud: K-means foreground, head cut from body (paper section 1.1, step 1).
//!
//! 1. [`kmeans`] splits the depth of every second pixel into layers; layers not separated by a gap in the histogram are
//!    joined, and the farthest layer is background, as is everything beyond [`Settings::max_distance_m`].
//! 2. [`regions`] labels the foreground in cells of 4 × 4 pixels, joining neighbours of similar depth.
//! 3. [`cut`] searches for a head downwards from every local top of a region: as wide as a head, rounded, ending at a neck or
//!    shoulders.
//! 4. [`cloud`] converts its pixels to at most [`crate::base::capacity::HEAD_POINTS`] points by averaging blocks.
//!
//! A tracked head needs no cut: its points are those around its predicted position ([`gather_at_pose`]).
//!
//! Sensor frame, metres. Memory: 0.3 MB, at construction. Cost: one pass over a quarter of the pixels, one over 19,200 cells,
//! one over the head's pixels. Degenerate: no depth, or nothing like a head, gives no cloud. Limitations: a head touching
//! a wall or the upper edge of the image is found poorly; a ball the size of a head is taken for one.

mod cloud;
mod cut;
pub mod kmeans;
mod regions;

use crate::base::capacity::{DEPTH_BINS, HEADS};
use crate::base::defaults;
use crate::base::geometry::Point;
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;
use crate::camera::Camera;
use crate::frame::Frame;
pub use cloud::gather_at_pose;
use kmeans::DepthKMeans;
use regions::Regions;
pub use regions::{HeadCloud, PixelRect};

defaults! {
    /// Settings of the segment stage.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct Settings {
        /// Farthest distance of a head, metres.
        pub max_distance_m: f32 = 1.8,
        /// Most rounds of K-means per frame.
        pub iterations: u32 = 12,
    }
}

/// Largest motion of a head between frames, metres.
const STEP_M: f32 = 0.25;

/// Finds the heads in a depth image.
pub struct Segmenter {
    settings: Settings,
    kmeans: DepthKMeans,
    histogram: Box<[u32; DEPTH_BINS]>,
    regions: Regions,
    /// Clouds allocated at construction; the first `count` are this frame's.
    heads: Vec<HeadCloud>,
    count: usize,
    /// Rectangle and centre of each head of the last frame, in order.
    last: heapless::Vec<(PixelRect, Point), HEADS>,
}

impl Segmenter {
    /// Allocates all buffers.
    pub fn new(settings: Settings) -> Self {
        Self {
            settings,
            kmeans: DepthKMeans::default(),
            histogram: Box::new([0; DEPTH_BINS]),
            regions: Regions::default(),
            heads: vec![HeadCloud::default(); HEADS],
            count: 0,
            last: heapless::Vec::new(),
        }
    }

    /// Replaces the settings from the next frame on.
    pub fn set(&mut self, settings: Settings) {
        self.settings = settings;
    }

    /// Forgets the last frame.
    pub fn reset(&mut self) {
        self.kmeans.reset();
        self.count = 0;
        self.last.clear();
    }

    /// Finds the heads and returns the first of [`Self::heads`]: the first one of the last frame, else the nearest.
    pub fn segment(&mut self, frame: &Frame, camera: &Camera) -> Option<&HeadCloud> {
        let farthest = self.foreground_end(frame, camera);
        self.regions.label(&frame.depth, camera, farthest);
        self.count = 0;
        for head in &cut::heads(&self.regions, &self.last) {
            let into = &mut self.heads[self.count];
            if cloud::gather(&frame.depth, camera, &self.regions, head, into) {
                self.count += 1;
            }
        }
        // Heads of the last frame keep their order; new ones follow by distance.
        let rank = |head: &HeadCloud| {
            let apart = self
                .last
                .iter()
                .map(|(_, last)| (head.centre - last).norm());
            let nearest = apart.enumerate().min_by(|a, b| a.1.total_cmp(&b.1));
            match nearest {
                Some((place, apart)) if apart < STEP_M => place as f32 + apart,
                _ => HEADS as f32 + head.centre.z,
            }
        };
        let heads = &mut self.heads[..self.count];
        // Insertion sort: there are few heads, mostly in order, and the library's sort of this large type would add 5 kB of code.
        for mut k in 1..heads.len() {
            while k > 0 && rank(&heads[k]) < rank(&heads[k - 1]) {
                heads.swap(k, k - 1);
                k -= 1;
            }
        }
        let heads = &self.heads[..self.count];
        self.last = heads.iter().map(|head| (head.rect, head.centre)).collect();
        heads.first()
    }

    /// Clouds of the last frame's heads (sensor frame, metres): heads seen before in their order, then new ones by distance.
    pub fn heads(&self) -> &[HeadCloud] {
        &self.heads[..self.count]
    }

    /// One past the last raw value of the foreground.
    fn foreground_end(&mut self, frame: &Frame, camera: &Camera) -> u16 {
        self.histogram.fill(0);
        regions::count(&frame.depth, camera, &mut self.histogram);
        let reach = camera.bin_from_m(self.settings.max_distance_m);
        let reach = (reach.max(0.0) as usize).min(DEPTH_BINS);
        let layers = self
            .kmeans
            .cluster(&self.histogram, self.settings.iterations);
        // Nearest first.
        let [nearer @ .., _] = layers;
        let filled = nearer.iter().filter(|layer| layer.count > 0);
        let foreground = filled.take_while(|layer| layer.centre <= reach as f64);
        let mut end = foreground.last().map_or(0, |layer| layer.end);
        let gap = camera.bin_steps(GAP);
        let stray = camera.pixels_in_solid_angle(GAP_PIXELS);
        // A layer's border may cross a person: move it to the next gap of the histogram.
        while end < reach
            && self.histogram[end..(end + gap).min(DEPTH_BINS)]
                .iter()
                .sum::<u32>()
                > stray
        {
            end += 1;
        }
        camera.raw_from_bin(end.min(reach))
    }
}

/// Least width of a gap between layers, in 1/z, 1/m: 17 mm at 1 m.
const GAP: f32 = 0.0175;
/// Most pixels (of the quarter counted) in a gap, as a solid angle, steradians: stray readings at edges.
const GAP_PIXELS: f32 = 7.24e-5;

#[cfg(test)]
mod tests;
