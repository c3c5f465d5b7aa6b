//! The simulated sensor: heads acting in rooms, as a Kinect would see them, down to USB packets if needed.
//!
//! ```text
//! virtual_head   heads, what they wear, scripts of scenes, drawn as depth and colour with a real sensor's noise
//! virtual_kinect a device that answers as a Kinect on USB does
//! resent         a frame to packets and back, step by step
//! faults         what goes wrong on a bus: packets lost, doubled, damaged
//! simulated      a scene by name, as a source of frames
//! ```

pub mod faults;
#[cfg(feature = "std")]
pub mod resent;
#[cfg(feature = "std")]
pub mod simulated;
#[cfg(feature = "std")]
pub mod virtual_head;
#[cfg(feature = "std")]
pub mod virtual_kinect;
