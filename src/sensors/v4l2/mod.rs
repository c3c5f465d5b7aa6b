//! Cameras through Video4Linux2: webcams, which give grey images without depth, and depth cameras, which give both, from two nodes of
//! one device.
//!
//! ```text
//! ioctl     the kernel's calls and the memory shared with it: a `Device`
//! device    the interface of a `Device`; the reasons why it gives no images
//! format    pixel formats, the choice of a size, conversion to luma or depth
//! capture   a `Device` that streams
//! streams   one capture, or two that are paired in time
//! live      a camera that may come and go: a thread and a ring
//! nodes     the cameras of this machine
//! kind      the entries of the table of sensors
//! ```
//!
//! The intrinsics are assumed ([`crate::reduction`]), because Video4Linux2 does not report them; for a depth camera a file can give them.
//! Only uncompressed formats are read, because a decoder of Motion JPEG would allocate in every frame.

mod capture;
mod device;
mod format;
mod ioctl;
pub(crate) mod kind;
mod live;
mod nodes;
#[cfg(test)]
mod scripted;
mod streams;
