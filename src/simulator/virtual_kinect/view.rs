//! What a virtual Kinect sees.

use crate::sensor::kinect::frame::KinectFrame;

/// What a virtual Kinect sees. Closures do: `FnMut(&mut KinectFrame) -> bool`.
pub trait View {
    /// Draws depth, Bayer and both stamps of the next frame; false when the scene has ended.
    fn draw(&mut self, frame: &mut KinectFrame) -> bool;
}

impl<F: FnMut(&mut KinectFrame) -> bool> View for F {
    fn draw(&mut self, frame: &mut KinectFrame) -> bool {
        self(frame)
    }
}
