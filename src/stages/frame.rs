//! What every sensor gives: one depth image and the intensity image that goes with it.

use crate::base::capacity::PIXELS;
use crate::base::prelude::*;
use crate::base::time::Timestamp;

/// Raw depth of a pixel without a measurement.
pub const NO_DEPTH: u16 = 2047;

/// Grey levels that a picture of nothing may differ by.
const BLANK_LEVELS: u8 = 4;

/// One depth picture and the grey picture that goes with it, if any, as the cameras deliver them: registered to nothing.
/// Both stand in the upper left corner of a rectangle of [`PIXELS`]; beyond a smaller one there is no depth, and its border is
/// repeated. Big (0.9 MB): owned once, handed by reference.
#[derive(Clone)]
pub struct Frame {
    /// Number of the depth picture, from 0: in a recording among all its entries, live among all whole ones since the start.
    pub index: u64,
    /// Capture time of the depth picture, counted from the first one of the stream.
    pub at: Timestamp,
    /// Whether a grey picture goes with it; without, `luma` is black.
    pub has_colour: bool,
    /// Raw depth, row by row: grows with the distance, which [`crate::camera::Camera::depth_m`] tells; [`NO_DEPTH`] = none.
    pub depth: Box<[u16; PIXELS]>,
    /// Brightness of the colour or infrared picture.
    pub luma: Box<[u8; PIXELS]>,
}

impl Frame {
    /// Whether there is a picture that could show a face, and not one grey all over as of a covered lens.
    pub fn has_picture(&self) -> bool {
        // A few hundred pixels all over it.
        let (mut least, mut most) = (u8::MAX, 0);
        for &luma in self.luma.iter().step_by(PIXELS / 331) {
            (least, most) = (least.min(luma), most.max(luma));
        }
        self.has_colour && most.saturating_sub(least) > BLANK_LEVELS
    }

    /// Takes the grey picture away.
    pub fn drop_colour(&mut self) {
        if core::mem::take(&mut self.has_colour) {
            self.luma.fill(0);
        }
    }
}

impl Default for Frame {
    fn default() -> Self {
        // Through Vec, because a 600 kB array literal would pass over the stack.
        Self {
            index: 0,
            at: Timestamp::default(),
            has_colour: true,
            depth: vec![NO_DEPTH; PIXELS].try_into().expect("PIXELS long"),
            luma: vec![0; PIXELS].try_into().expect("PIXELS long"),
        }
    }
}
