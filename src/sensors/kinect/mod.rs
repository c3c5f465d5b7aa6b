//! The Kinect v1: USB packets to pictures, pairing, calibration, the live sensor, and recordings in libfreenect's layout. Disparity,
//! the 60 MHz counter and the Bayer mosaic exist only here; the results are a [`super::Frame`] and a [`super::camera::Camera`].

pub mod calibration;
pub mod colour;
pub mod command;
pub mod device;
#[cfg(feature = "std")]
pub mod driver;
pub mod frame;
pub mod geometry;
#[cfg(feature = "std")]
pub(crate) mod kind;
#[cfg(feature = "std")]
pub mod live;
pub mod motor;
pub mod packet;
pub mod pairing;
pub mod picture_clock;
#[cfg(feature = "std")]
pub mod recording;
pub mod registration;
pub mod stream;
pub mod unpack;
#[cfg(feature = "std")]
pub mod usb;
#[cfg(feature = "std")]
pub mod usb_devices;
