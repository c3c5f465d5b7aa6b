//! The output of segmentation: heads as points and as picture rectangles, and the labels of its mask.

use super::regions::CELL_PX;
use crate::base::capacity::HEAD_POINTS;
use crate::base::geometry::Point;

/// A rectangle of pixels of the depth picture: columns `x0..x1`, rows `y0..y1`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PixelRect {
    /// First column.
    pub x0: u16,
    /// First row.
    pub y0: u16,
    /// One past the last column.
    pub x1: u16,
    /// One past the last row.
    pub y1: u16,
}

impl PixelRect {
    /// Whether it keeps more than a cell's distance to the edges of a picture of this size: what is in it is not cut off.
    #[must_use]
    pub fn is_within(&self, size: [usize; 2]) -> bool {
        let [right, bottom] = size.map(|pixels| (pixels - CELL_PX) as u16);
        self.x0 > CELL_PX as u16 && self.y0 > CELL_PX as u16 && self.x1 < right && self.y1 < bottom
    }
}

/// The depth points of one head, in the sensor frame. Thinned evenly when full.
#[derive(Clone, Debug, Default)]
pub struct HeadCloud {
    /// Points, metres, sensor frame.
    pub points: heapless::Vec<Point, HEAD_POINTS>,
    /// Where the head is in the depth picture.
    pub rect: PixelRect,
    /// Whether no edge of the picture cuts it off.
    pub whole: bool,
    /// Mean of the points.
    pub centre: Point,
    /// Depth pixels that belong to the head, before thinning.
    pub pixels: u32,
}

/// Label of a cell in [`super::Segmenter::mask`]: background or no depth.
pub const BACKGROUND: u8 = 0;

/// Label of a cell in [`super::Segmenter::mask`]: foreground that is no head. Head number k is `FOREGROUND + 1 + k`.
pub const FOREGROUND: u8 = 1;
