//! Where frames come from: a recording, the simulated sensor, the Kinect. All deliver the same [`Frame`].

pub mod calibration;
pub mod camera;
pub mod colour;
pub mod command;
pub mod device;
#[cfg(feature = "std")]
pub mod kinect;
#[cfg(feature = "std")]
pub mod live_kinect;
pub mod motor;
pub mod packet;
pub mod pairing;
pub mod picture_clock;
#[cfg(feature = "std")]
pub mod recording;
pub mod stream;
pub mod unpack;
#[cfg(feature = "std")]
pub mod usb;
#[cfg(feature = "std")]
pub mod usb_devices;

use crate::base::capacity::PIXELS;
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;
use crate::base::time::Timestamp;

/// Raw depth of a pixel without a measurement.
pub const NO_DEPTH: u16 = 2047;

/// Ticks of the 60 MHz counter from picture to picture, at 30 pictures a second.
pub const FRAME_TICKS: i64 = 2_000_000;

/// Grey levels that a picture of nothing may differ by.
const BLANK_LEVELS: u8 = 4;

/// One depth picture and the colour picture that goes with it, if any, as the cameras deliver them: registered to nothing.
/// Big (1.2 MB): owned once, handed by reference.
#[derive(Clone)]
pub struct Frame {
    /// Number of the depth picture, from 0: in a recording among all its entries, live among all whole ones since the start.
    pub index: u64,
    /// Capture time of the depth picture, counted from the first one of the stream.
    pub at: Timestamp,
    /// The depth picture's stamp: the camera's 60 MHz counter, which wraps every 71.6 s.
    pub ticks: u32,
    /// Whether a colour picture goes with it; without, `bayer` and `luma` are black and `colour_ticks` is 0.
    pub has_colour: bool,
    /// The colour picture's stamp, same counter.
    pub colour_ticks: u32,
    /// Raw 11-bit disparity of the depth camera, row by row; [`NO_DEPTH`] = none.
    pub depth: Box<[u16; PIXELS]>,
    /// Bayer mosaic of the colour camera: even rows G R G R…, odd rows B G B G….
    pub bayer: Box<[u8; PIXELS]>,
    /// Luma of the demosaiced colour picture ([`colour`]).
    pub luma: Box<[u8; PIXELS]>,
}

impl Frame {
    /// Whether there is a picture that could show a face: colour, and not one grey all over as of a covered lens.
    #[must_use]
    pub fn has_picture(&self) -> bool {
        // A few hundred pixels all over it.
        let (mut least, mut most) = (u8::MAX, 0);
        for &luma in self.luma.iter().step_by(PIXELS / 331) {
            (least, most) = (least.min(luma), most.max(luma));
        }
        self.has_colour && most.saturating_sub(least) > BLANK_LEVELS
    }
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
            has_colour: true,
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

impl Frame {
    /// Takes the colour picture away.
    pub fn drop_colour(&mut self) {
        if core::mem::take(&mut self.has_colour) {
            self.colour_ticks = 0;
            self.bayer.fill(0);
            self.luma.fill(0);
        }
    }
}

/// Capture time of unwrapped 60 MHz ticks since the first depth picture, rounded down to whole microseconds. Every source
/// goes through here, so that a run and its replay agree to the bit.
#[must_use]
pub fn timestamp_from_ticks(ticks: i64) -> Timestamp {
    Timestamp::from_us(ticks.max(0).unsigned_abs() / 60)
}
