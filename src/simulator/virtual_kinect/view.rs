//! What a virtual Kinect sees.

use crate::sensor::Frame;

/// What a virtual Kinect sees. Closures do: `FnMut(&mut Frame) -> bool`.
pub trait View {
    /// Draws depth, Bayer and both stamps of the next frame; false when the scene has ended.
    fn draw(&mut self, frame: &mut Frame) -> bool;
}

impl<F: FnMut(&mut Frame) -> bool> View for F {
    fn draw(&mut self, frame: &mut Frame) -> bool {
        self(frame)
    }
}
