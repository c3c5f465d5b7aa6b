//! The simulated sensor: acting heads in rooms as seen by a Kinect, down to USB packets if needed.
//!
//! ```text
//! virtual_head   heads, clothes, scripts of scenes, drawn as depth and colour with a real sensor's noise
//! virtual_kinect a device that behaves like a Kinect on USB
//! resent         a frame to packets and back, step by step
//! simulated      a scene by name, as a source of frames
//! ```

pub mod round_trip;
pub mod simulated;
pub mod virtual_head;
pub mod virtual_kinect;
