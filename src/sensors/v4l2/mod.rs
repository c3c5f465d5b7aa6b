//! A webcam through Video4Linux2: grey images without depth, from a lens that is not known.
//!
//! ```text
//! ioctl     the kernel's calls and the memory shared with it: a `Device`
//! device    what is asked of a `Device`; why it gives no images
//! format    pixel formats, the choice of a size, images to luma
//! capture   a `Device` that streams
//! live      a camera that may come and go: a thread and a ring
//! nodes     the cameras of this machine
//! kind      the row of the table of sensors
//! ```
//!
//! The lens is assumed, because Video4Linux2 does not tell it: [`crate::reduction`]. Only uncompressed formats are read: a decoder of
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
