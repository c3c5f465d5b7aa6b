//! A frame with what only a Kinect's drivers and recordings know of it.

use core::ops::{Deref, DerefMut};

use crate::Frame;
use mien_stages::base::capacity::PIXELS;
use mien_stages::base::defaults;
use mien_stages::base::prelude::*;

defaults! {
    /// What a frame was made from and no stage reads: recorders and people who look at the picture do.
    #[derive(Clone)]
    pub struct Original {
        /// The depth picture's stamp: the camera's 60 MHz counter, which wraps every 71.6 s.
        pub ticks: u32 = 0,
        /// The colour picture's stamp, same counter; 0 without one.
        pub colour_ticks: u32 = 0,
        /// Bayer mosaic of the colour camera: even rows G R G R…, odd rows B G B G…; black without a picture.
        pub bayer: Box<[u8; PIXELS]> = vec![0; PIXELS].try_into().expect("PIXELS long"),
    }

    /// A frame of a Kinect and what it was made from.
    #[derive(Clone)]
    pub struct KinectFrame {
        /// What the stages see.
        pub frame: Frame = Frame::default(),
        /// What it was made from.
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

/// What a Kinect's pictures are developed into: a frame, with or without what it was made from.
pub trait Developed {
    /// The frame, and where to put what it was made from.
    fn parts(&mut self) -> (&mut Frame, Option<&mut Original>);
}

impl Developed for Frame {
    fn parts(&mut self) -> (&mut Frame, Option<&mut Original>) {
        (self, None)
    }
}

impl Developed for KinectFrame {
    fn parts(&mut self) -> (&mut Frame, Option<&mut Original>) {
        (&mut self.frame, Some(&mut self.original))
    }
}

impl Original {
    /// Shows the picture of a frame that no Kinect made, in grey.
    pub fn show(&mut self, frame: &Frame) {
        self.bayer.copy_from_slice(&*frame.luma);
    }

    /// Takes the colour picture away.
    pub fn drop_colour(&mut self) {
        self.colour_ticks = 0;
        self.bayer.fill(0);
    }
}
