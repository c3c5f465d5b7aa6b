//! A frame with the Kinect's original data.

use core::ops::{Deref, DerefMut};

use crate::Frame;
use mien_stages::base::capacity::PIXELS;
use mien_stages::base::defaults;
use mien_stages::base::prelude::*;

defaults! {
    /// Original data of a frame, for recorders and displays; no stage reads it.
    #[derive(Clone)]
    pub struct Original {
        /// Time stamp of the depth picture: the camera's 60 MHz counter, which wraps every 71.6 s.
        pub ticks: u32 = 0,
        /// Time stamp of the colour picture, same counter; 0 without one.
        pub colour_ticks: u32 = 0,
        /// Bayer mosaic of the colour camera: even rows G R G R…, odd rows B G B G…; black without a picture.
        pub bayer: Box<[u8; PIXELS]> = vec![0; PIXELS].try_into().expect("PIXELS long"),
    }

    /// A frame of a Kinect with its original data.
    #[derive(Clone)]
    pub struct KinectFrame {
        /// The frame that the stages read.
        pub frame: Frame = Frame::default(),
        /// Its original data.
        pub original: Original = Original::default(),
    }
}

impl Deref for KinectFrame {
    type Target = Frame;

    fn deref(&self) -> &Frame {
        &self.frame
    }
}

impl DerefMut for KinectFrame {
    fn deref_mut(&mut self) -> &mut Frame {
        &mut self.frame
    }
}

/// Destination of a Kinect's pictures: a frame with or without original data.
pub trait FrameSink {
    /// The frame, and the destination of the original data, if any.
    fn parts(&mut self) -> (&mut Frame, Option<&mut Original>);
}

impl<S: FrameSink + ?Sized> FrameSink for &mut S {
    fn parts(&mut self) -> (&mut Frame, Option<&mut Original>) {
        (**self).parts()
    }
}

impl FrameSink for Frame {
    fn parts(&mut self) -> (&mut Frame, Option<&mut Original>) {
        (self, None)
    }
}

impl FrameSink for KinectFrame {
    fn parts(&mut self) -> (&mut Frame, Option<&mut Original>) {
        (&mut self.frame, Some(&mut self.original))
    }
}

impl Original {
    /// Sets the mosaic to the luma of a frame from another sensor, which displays as grey.
    pub fn set_grey(&mut self, frame: &Frame) {
        self.bayer.copy_from_slice(&*frame.luma);
    }

    /// Clears the colour picture.
    pub fn drop_colour(&mut self) {
        self.colour_ticks = 0;
        self.bayer.fill(0);
    }
}
