//! Cameras through Video4Linux2: webcams, which give grey images without depth, and depth cameras, which give both from two nodes of
//! one device.
//!
//! ```text
//! ioctl     the kernel's calls and the memory shared with it: a `Device`
//! device    what is asked of a `Device`; why it gives no images
//! format    pixel formats, the choice of a size, images to luma or depth
//! capture   a `Device` that streams
//! streams   one or two of them, paired
//! live      a camera that may come and go: a thread and a ring
//! nodes     the cameras of this machine
//! kind      the rows of the table of sensors
//! ```
//!
//! The lens is assumed, because Video4Linux2 does not tell it ([`crate::reduction`]), unless a file tells that of a depth camera. Only uncompressed formats are read: a decoder of
//! Motion JPEG would allocate in every frame.

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
