//! Where frames come from: a recording, the simulated sensor, the Kinect. All deliver the same [`Frame`].

pub mod camera;
pub mod colour;
pub mod recording;
pub mod virtual_head;

use crate::capacity::PIXELS;
use crate::time::Timestamp;

/// Raw depth of a pixel without a measurement.
pub const NO_DEPTH: u16 = 2047;

/// One depth picture and the colour picture that goes with it, as the cameras deliver them: registered to nothing.
/// Big (1.2 MB): owned once, handed by reference.
#[derive(Clone)]
pub struct Frame {
    /// Number of the depth picture within its stream, from 0, counting skipped ones.
    pub index: u64,
    /// Capture time of the depth picture, counted from the first one of the stream.
    pub at: Timestamp,
    /// The depth picture's stamp: the camera's 60 MHz counter, which wraps every 71.6 s.
    pub ticks: u32,
    /// The colour picture's stamp, same counter.
    pub colour_ticks: u32,
    /// Raw 11-bit disparity of the depth camera, row by row; [`NO_DEPTH`] = none.
    pub depth: Box<[u16; PIXELS]>,
    /// Bayer mosaic of the colour camera: even rows G R G R…, odd rows B G B G….
    pub bayer: Box<[u8; PIXELS]>,
    /// Luma of the demosaiced colour picture ([`colour`]).
    pub luma: Box<[u8; PIXELS]>,
}

impl Default for Frame {
    fn default() -> Self {
        // Through Vec, because a 600 kB array literal would pass over the stack.
        let bytes = || {
            vec![0u8; PIXELS]
                .into_boxed_slice()
                .try_into()
                .expect("PIXELS long")
        };
        Self {
            index: 0,
            at: Timestamp::default(),
            ticks: 0,
            colour_ticks: 0,
            depth: vec![NO_DEPTH; PIXELS]
                .into_boxed_slice()
                .try_into()
                .expect("PIXELS long"),
            bayer: bytes(),
            luma: bytes(),
        }
    }
}
