//! The interface to a Video4Linux2 device, and the reasons why a camera gives no images.
//!
//! [`Device`] has two implementations: the kernel's (`ioctl`) and, in tests, a scripted one that gives wrong answers, fails and disappears.

use core::time::Duration;
use std::io;
use std::path::{Path, PathBuf};

use mien_stages::base::bounded_read::reason;

/// Code of a pixel format, four characters.
pub(super) type FourCc = [u8; 4];

/// What a device reports about itself.
#[derive(Clone, Debug, Default)]
pub(super) struct About {
    /// Name of its driver.
    pub(super) driver: String,
    /// Its name.
    pub(super) card: String,
    /// Where the device is plugged in; the same for all nodes of a device.
    pub(super) bus: String,
    /// Whether this node gives images; other nodes give metadata or accept images.
    pub(super) captures: bool,
}

/// Image sizes that a device offers, from `least` to `most` in steps of `step`; columns and rows, pixels.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sizes {
    pub(super) least: [u32; 2],
    pub(super) most: [u32; 2],
    pub(super) step: [u32; 2],
}

impl Sizes {
    pub(super) const fn one(size: [u32; 2]) -> Self {
        Self {
            least: size,
            most: size,
            step: [1; 2],
        }
    }
}

/// The format that a driver has set, which need not be the one asked for.
#[derive(Clone, Copy, Debug)]
pub(super) struct Answer {
    pub(super) code: FourCc,
    pub(super) size: [u32; 2],
    /// Bytes from one row to the next; 0 if rows have no gaps.
    pub(super) stride: u32,
    /// Whether an image has all its rows, progressive or interlaced, and not only every second one.
    pub(super) whole: bool,
}

/// A filled buffer.
#[derive(Clone, Copy, Debug)]
pub(super) struct Filled {
    pub(super) index: usize,
    /// Number of bytes that the image fills.
    pub(super) used: usize,
    /// Whether the driver marks them as damaged.
    pub(super) is_damaged: bool,
    /// Capture time on the monotonic clock; `None` if the driver uses another.
    pub(super) taken: Option<Duration>,
}

/// An open device. Every wait is bounded; a [`Filled`] buffer is the caller's until it is queued again.
pub(super) trait Device {
    fn about(&self) -> io::Result<About>;
    /// The format with this index; an error after the last.
    fn format(&self, index: u32) -> io::Result<FourCc>;
    /// The sizes of a format with this index; an error after the last.
    fn sizes(&self, code: FourCc, index: u32) -> io::Result<Sizes>;
    /// Fails if another program uses the device; changes nothing.
    fn check_free(&self) -> io::Result<()>;
    fn set_format(&self, code: FourCc, size: [u32; 2]) -> io::Result<Answer>;
    /// Requests a frame rate; returns the one that the driver set, frames per second.
    fn set_rate(&self, per_s: u32) -> io::Result<f32>;
    /// Maps and queues the buffers and starts the stream; returns the size of the smallest buffer, bytes.
    fn start(&mut self) -> io::Result<usize>;
    /// Waits for a filled buffer; `false` if there is none.
    fn wait(&self, wait: Duration) -> io::Result<bool>;
    /// Takes the oldest filled buffer; `WouldBlock` if there is none.
    fn take(&self) -> io::Result<Filled>;
    /// All bytes of a buffer that was taken; none if there is no such buffer.
    fn bytes(&self, index: usize) -> &[u8];
    /// Gives a buffer back to be filled.
    fn queue(&self, index: usize) -> io::Result<()>;
}

/// Kind of camera.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Kind {
    Webcam,
    Depth,
}

impl Kind {
    /// The name of its source.
    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Webcam => "camera",
            Self::Depth => "depth-camera",
        }
    }

    /// The error if there is no such camera.
    pub(super) const fn absent(self) -> CameraError {
        match self {
            Self::Webcam => CameraError::Absent,
            Self::Depth => CameraError::NoDepth,
        }
    }
}

/// Why a camera gives no images; each message contains the remedy.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub(super) enum CameraError {
    /// No node gives images.
    #[error(
        "no camera (none of /dev/video* gives images); plug in a webcam, or load its driver (`modprobe uvcvideo` for most)"
    )]
    Absent,
    /// No node gives depth.
    #[error(
        "no depth camera (none of /dev/video* that can be opened gives Z16); plug one in that the driver uvcvideo knows"
    )]
    NoDepth,
    /// The calibration cannot be used: file and reason.
    #[error("{}: {why}", .0.display(), why = .1)]
    Calibration(PathBuf, String),
    /// No camera has this name; number of cameras found.
    #[error("no camera {0} among the {1} found; `mien devices` lists them")]
    Other(String, usize),
    /// No permission for the node.
    #[error(
        "no permission to open the camera {}; add the user to the group video and log in again", .0.display()
    )]
    Access(PathBuf),
    /// Another program streams from it.
    #[error("the camera {} is in use; stop the other program that reads it", .0.display())]
    Busy(PathBuf),
    /// It has no supported format: its formats, and the supported ones.
    #[error(
        "the camera {} gives {found}, expected an uncompressed format ({known}); use another camera", .0.display(), found = .1, known = .2
    )]
    Format(PathBuf, String, String),
    /// It has no usable size.
    #[error(
        "the camera {} gives no usable size, expected 320 x 240 to 2560 x 1920; use another camera", .0.display()
    )]
    Size(PathBuf),
    /// It does not have the size of its calibration.
    #[error(
        "the camera {} does not give {} x {} pixels, the size in its calibration; write the numbers of a size that it gives", .0.display(), .1[0], .1[1]
    )]
    OtherSize(PathBuf, [usize; 2]),
    /// The driver contradicts itself.
    #[error("the driver of the camera {} {how}; update the kernel or use another camera", .0.display(), how = .1)]
    Lies(PathBuf, &'static str),
    /// A camera that streams gave no image for half a second.
    #[error("the camera gave no image for half a second; it is starting, or needs more light")]
    Late,
    /// No whole image for three seconds: number of damaged ones.
    #[error(
        "the camera {} gave no whole image for three seconds ({damaged} damaged ones); plug it into a port of the computer itself", .0.display(), damaged = .1
    )]
    Silent(PathBuf, u64),
    /// It is gone.
    #[error("the camera {} was unplugged; plug it in again", .0.display())]
    Gone(PathBuf),
    /// Any other error from the kernel.
    #[error("the camera {} fails ({why}); unplug it and plug it in again", .0.display(), why = .1)]
    Failed(PathBuf, String),
}

impl CameraError {
    /// The error that the kernel returned for a node.
    pub(super) fn at(node: &Path, problem: &io::Error) -> Self {
        let node = node.to_owned();
        match problem.raw_os_error() {
            Some(libc::EACCES | libc::EPERM) => Self::Access(node),
            Some(libc::EBUSY) => Self::Busy(node),
            Some(libc::ENODEV | libc::ENXIO | libc::ENOENT) => Self::Gone(node),
            _ => Self::Failed(node, reason(problem)),
        }
    }
}
