//! One frame of a sensor: a depth image and the intensity image paired with it.

use crate::base::capacity::PIXELS;
use crate::base::prelude::*;
use crate::base::time::Timestamp;

/// Raw depth of a pixel without a measurement, whatever the camera.
pub const NO_DEPTH: u16 = u16::MAX;

/// Largest difference of grey levels in a blank image (covered lens).
const BLANK_LEVELS: u8 = 4;

/// One depth image and the grey image paired with it, if any, unregistered.
///
/// Both are row-major with a stride of [`crate::base::capacity::WIDTH`] pixels. A smaller image fills the upper left corner;
/// beyond it depth is [`NO_DEPTH`] and the grey image repeats its border. Large (0.9 MB): owned once, passed by reference.
#[derive(Clone)]
pub struct Frame {
    /// Number of the depth image, from 0: its entry in a recording, or the complete images since the start when live.
    pub index: u64,
    /// Capture time of the depth image, from the first one of the stream.
    pub at: Timestamp,
    /// Whether there is a grey image; if not, `luma` is 0 everywhere.
    pub has_colour: bool,
    /// Raw depth, increasing with distance, in the camera's own unit: [`crate::camera::Camera::depth_m`] converts it to metres. No
    /// measurement is [`NO_DEPTH`], or another value beyond all those that the camera has a distance for.
    pub depth: Box<[u16; PIXELS]>,
    /// Intensity of the colour or infrared image, 0 to 255.
    pub luma: Box<[u8; PIXELS]>,
}

impl Frame {
    /// Whether there is a grey image with contrast; false for a covered lens.
    pub fn has_image(&self) -> bool {
        // 331 pixels spread over the image.
        let (mut least, mut most) = (u8::MAX, 0);
        for &luma in self.luma.iter().step_by(PIXELS / 331) {
            (least, most) = (least.min(luma), most.max(luma));
        }
        self.has_colour && most.saturating_sub(least) > BLANK_LEVELS
    }

    /// Removes the grey image.
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
