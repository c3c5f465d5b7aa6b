//! Sensors: each gives a [`Frame`] at a time, and the [`camera::Camera`] that says what its numbers mean.
//!
//! ```text
//! kinect   the Kinect v1: packets to frames over USB, its calibration, its motor, recordings as libfreenect writes them
//! rgbd     recordings of any depth camera, or of colour alone
//! v4l2     cameras through Video4Linux2: webcams, and depth cameras
//! y4m      films without depth, from a file or through a pipe
//! turned   any of them on its side or upside down
//! ```

#![cfg_attr(not(feature = "std"), no_std)]

extern crate alloc;

pub mod kinect;
#[cfg(feature = "std")]
mod live;
#[cfg(feature = "std")]
mod picture_file;
#[cfg(feature = "std")]
mod reduction;
#[cfg(feature = "std")]
pub mod rgbd;
#[cfg(feature = "std")]
pub mod sensor;
#[cfg(feature = "std")]
pub mod table;
#[cfg(feature = "std")]
pub mod turned;
#[cfg(feature = "std")]
mod v4l2;
#[cfg(feature = "std")]
pub mod y4m;

pub use mien_stages::camera;
pub use mien_stages::frame::{Frame, NO_DEPTH};
#[cfg(feature = "std")]
pub use picture_file::RecordingError;
