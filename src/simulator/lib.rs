//! The simulated sensor: heads acting in rooms, as a Kinect would see them, down to USB packets if needed.
//!
//! ```text
//! virtual_head   heads, what they wear, scripts of scenes, drawn as depth and colour with a real sensor's noise
//! virtual_kinect a device that answers as a Kinect on USB does
//! resent         a frame to packets and back, step by step
//! simulated      a scene by name, as a source of frames
//! ```

pub mod resent;
pub mod simulated;
pub mod virtual_head;
pub mod virtual_kinect;
