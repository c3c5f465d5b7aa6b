//! The shape of one user's head, relative to the standard head; [`super::shape_learning`] learns it.
//!
//! A uniform scale, and for every anchor point an offset along its normal. Head frame, metres. Memory: 12 bytes per anchor
//! point.

use super::anchor::Anchor;
use crate::base::geometry::Point;
use crate::base::prelude::*;

/// Heads are 0.85 to 1.15 of the standard size.
pub(crate) const MAX_LOG_SCALE: f64 = 0.15;

/// Weight of the standard head, in frames, so that one noisy frame cannot distort it.
pub(super) const PRIOR_FRAMES: f32 = 4.0;

/// The learned differences.
#[derive(Clone, Debug)]
pub(crate) struct HeadShape {
    /// Natural logarithm of the head's size relative to the standard head.
    pub(crate) log_scale: f64,
    /// Offset of each anchor point along its normal, metres, in the standard head's size.
    pub(crate) offset: Vec<f32>,
    /// Frames from which each offset was learned, capped.
    pub(super) seen: Vec<f32>,
    /// Frames from which the scale was learned.
    pub(super) frames: f64,
    pub(super) sums: Vec<(f32, f32)>,
}

impl HeadShape {
    /// The standard head itself, for an anchor of `points` points.
    pub(crate) fn standard(points: usize) -> Self {
        Self {
            log_scale: 0.0,
            offset: vec![0.0; points],
            seen: vec![0.0; points],
            frames: 0.0,
            sums: vec![(0.0, 0.0); points],
        }
    }

    /// Back to the standard head, in place.
    pub(crate) fn forget(&mut self) {
        self.log_scale = 0.0;
        self.frames = 0.0;
        self.offset.fill(0.0);
        self.seen.fill(0.0);
    }

    /// Measured offset of an anchor point, without the standard head's share in the mean; `None` where nothing was seen.
    pub(crate) fn measured(&self, i: usize) -> Option<f32> {
        let seen = self.seen[i];
        (seen >= 1.0).then(|| self.offset[i] * (seen + PRIOR_FRAMES) / seen)
    }

    /// An anchor point on this head, head frame, metres.
    pub(crate) fn place(&self, anchor: &Anchor, i: usize) -> Point {
        let size = self.log_scale.exp() as f32;
        Point::from((anchor.points[i] + anchor.normals[i] * self.offset[i]).coords * size)
    }

    /// Prior deviation of the scale around its estimate: wide for a newcomer, narrow once known.
    pub(crate) fn scale_sigma(&self) -> f64 {
        (0.06 / (1.0 + self.frames * 0.1).sqrt()).max(0.004)
    }
}
