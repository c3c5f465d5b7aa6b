//! The output of segmentation: heads as points and as picture rectangles, and the labels of its mask.

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

/// The depth points of one head, in the sensor frame. Thinned evenly when full.
#[derive(Clone, Debug, Default)]
pub struct HeadCloud {
    /// Points, metres, sensor frame.
    pub points: heapless::Vec<Point, HEAD_POINTS>,
    /// Where the head is in the depth picture.
    pub rect: PixelRect,
    /// Mean of the points.
    pub centre: Point,
    /// Depth pixels that belong to the head, before thinning.
    pub pixels: u32,
}

/// Label of a cell in [`super::Segmenter::mask`]: background or no depth.
pub const BACKGROUND: u8 = 0;

/// Label of a cell in [`super::Segmenter::mask`]: foreground that is no head. Head number k is `FOREGROUND + 1 + k`.
pub const FOREGROUND: u8 = 1;
