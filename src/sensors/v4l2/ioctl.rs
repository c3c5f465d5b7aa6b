//! [`Device`] on the kernel's interface: structures and requests of `linux/videodev2.h`, and buffers that driver and program share.
//!
//! Memory: four image buffers that the driver owns, mapped read-only. The type is neither `Send` nor `Sync`.
#![expect(
    unsafe_code,
    reason = "Video4Linux2 has ioctl and mmap as its only interface"
)]

use core::ptr::NonNull;
use core::time::Duration;
use std::fs::File;
use std::io;
use std::os::fd::AsRawFd;
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

use libc::{MAP_SHARED, PROT_READ, mmap};
use nix::poll::{PollFd, PollFlags, poll};

use super::device::{About, Answer, Device, Filled, FourCc, Sizes};
use mien_stages::base::capacity::CAMERA_BUFFERS;

/// Buffer type: single-planar images; memory type: buffers that the driver allocates.
const CAPTURE: u32 = 1;
const MAPPED: u32 = 1;
/// Capability bits: the node captures images; capabilities are reported per node.
const CAP_CAPTURE: u32 = 1;
const CAP_BY_NODE: u32 = 0x8000_0000;
/// Field orders that give whole images: any, progressive, and three interlaced ones.
const WHOLE_FIELDS: [u32; 5] = [0, 1, 4, 8, 9];
/// The list has discrete sizes.
const DISCRETE: u32 = 1;
/// Buffer flags: damaged; the mask of the time's clock; the monotonic clock.
const DAMAGED: u32 = 0x40;
const CLOCK: u32 = 0xe000;
const MONOTONIC: u32 = 0x2000;

/// A structure that the kernel reads and writes.
///
/// # Safety
/// It has the kernel's size and layout, and every value of its bytes is valid.
unsafe trait Plain: Default {}

macro_rules! plain {
    ($(#[doc = $doc:literal] $name:ident { $($field:ident: $type:ty,)* })*) => {$(
        #[doc = $doc]
        #[repr(C)]
        #[derive(Default)]
        #[allow(dead_code, reason = "the layout is the kernel's, of which some fields are not needed")]
        struct $name { $($field: $type,)* }

        // SAFETY: integers and arrays of them in the order of `linux/videodev2.h`; a test compares the sizes.
        unsafe impl Plain for $name {}
    )*};
}

/// Padding before an aligned union.
#[cfg(target_pointer_width = "64")]
type Gap = u32;
#[cfg(not(target_pointer_width = "64"))]
type Gap = [u32; 0];

plain! {
    /// `v4l2_capability`
    Capability { driver: [u8; 16], card: [u8; 32], bus: [u8; 32], version: u32, all: u32, node: u32, reserved: [u32; 3], }
    /// `v4l2_fmtdesc`
    Described { index: u32, kind: u32, flags: u32, text: [u8; 32], code: FourCc, bus: u32, reserved: [u32; 3], }
    /// `v4l2_frmsizeenum`; a discrete size is the first two numbers, else columns from, to, by, and rows from, to, by.
    SizeRow { index: u32, code: FourCc, kind: u32, numbers: [u32; 6], reserved: [u32; 2], }
    /// `v4l2_format` with a `v4l2_pix_format`
    Format { kind: u32, gap: Gap, size: [u32; 2], code: FourCc, field: u32, stride: u32, bytes: u32, rest: [[u32; 11]; 4], }
    /// `v4l2_streamparm` with a `v4l2_captureparm`; `period`: numerator and denominator, seconds.
    Parameters { kind: u32, capability: u32, mode: u32, period: [u32; 2], rest: [[u32; 23]; 2], }
    /// `v4l2_requestbuffers`
    Requested { count: u32, kind: u32, memory: u32, capabilities: u32, flags: u32, }
    /// `v4l2_buffer`
    Buffer {
        index: u32, kind: u32, used: u32, flags: u32, field: u32, time: [libc::time_t; 2], time_code: [u32; 4],
        sequence: u32, memory: u32, offset: u32, gap: Gap, length: u32, reserved: [u32; 2],
    }
}

/// Number of a request, and the type of its structure.
struct Request<T>(libc::Ioctl, core::marker::PhantomData<T>);

impl<T: Plain> Request<T> {
    const fn both(number: u32) -> Self {
        Self(
            libc::_IOWR::<T>(b'V' as u32, number),
            core::marker::PhantomData,
        )
    }

    const fn read(number: u32) -> Self {
        Self(
            libc::_IOR::<T>(b'V' as u32, number),
            core::marker::PhantomData,
        )
    }
}

const QUERY_CAPABILITY: Request<Capability> = Request::read(0);
const LIST_FORMATS: Request<Described> = Request::both(2);
const SET_FORMAT: Request<Format> = Request::both(5);
const REQUEST_BUFFERS: Request<Requested> = Request::both(8);
const QUERY_BUFFER: Request<Buffer> = Request::both(9);
const QUEUE: Request<Buffer> = Request::both(15);
const TAKE: Request<Buffer> = Request::both(17);
const SET_PARAMETERS: Request<Parameters> = Request::both(22);
const LIST_SIZES: Request<SizeRow> = Request::both(74);
/// Starts streaming; the argument is the buffer type.
const START: libc::Ioctl = libc::_IOW::<libc::c_int>(b'V' as u32, 18);

/// A mapped buffer of the driver.
struct Mapping {
    start: NonNull<u8>,
    length: usize,
}

impl Drop for Mapping {
    fn drop(&mut self) {
        // SAFETY: mapped by `Node::map` with this length, and no slice of it outlives the node that owns it.
        unsafe { libc::munmap(self.start.as_ptr().cast(), self.length) };
    }
}

/// An open `/dev/video*`.
pub(super) struct Node {
    file: File,
    buffers: Vec<Mapping>,
}

fn text(bytes: &[u8]) -> String {
    let bytes = bytes.split(|byte| *byte == 0).next();
    String::from_utf8_lossy(bytes.unwrap_or_default()).into_owned()
}

/// Sets the fields of a request that name the buffer with this index.
fn buffer(index: usize) -> impl FnOnce(&mut Buffer) {
    move |with| (with.index, with.kind, with.memory) = (index as u32, CAPTURE, MAPPED)
}

impl Node {
    /// Opens a node in non-blocking mode.
    pub(super) fn open(path: &Path) -> io::Result<Self> {
        let mut options = File::options();
        let options = options.read(true).write(true);
        let options = options.custom_flags(libc::O_NONBLOCK | libc::O_NOCTTY);
        Ok(Self {
            file: options.open(path)?,
            buffers: Vec::with_capacity(CAMERA_BUFFERS),
        })
    }

    /// Makes a request with a structure that is zero except for what `set` changes; returns what the kernel wrote.
    fn call<T: Plain>(&self, request: &Request<T>, set: impl FnOnce(&mut T)) -> io::Result<T> {
        let mut with = T::default();
        set(&mut with);
        // SAFETY: the request's number has the size of `T`, which has the kernel's layout and is valid whatever is written.
        match unsafe { libc::ioctl(self.file.as_raw_fd(), request.0, &raw mut with) } {
            0.. => Ok(with),
            _ => Err(io::Error::last_os_error()),
        }
    }

    fn request_buffers(&self, count: u32) -> io::Result<u32> {
        let set = |with: &mut Requested| {
            (with.count, with.kind, with.memory) = (count, CAPTURE, MAPPED);
        };
        Ok(self.call(&REQUEST_BUFFERS, set)?.count)
    }

    fn map(&self, index: usize) -> io::Result<Mapping> {
        let found = self.call(&QUERY_BUFFER, buffer(index))?;
        let (length, offset) = (found.length as usize, found.offset as libc::off_t);
        let (any, fd) = (core::ptr::null_mut(), self.file.as_raw_fd());
        // SAFETY: a new mapping at an address of the kernel's choice; the result is checked.
        let start = unsafe { mmap(any, length, PROT_READ, MAP_SHARED, fd, offset) };
        match NonNull::new(start.cast()) {
            Some(first) if start != libc::MAP_FAILED => Ok(Mapping {
                start: first,
                length,
            }),
            _ => Err(io::Error::last_os_error()),
        }
    }
}

impl Device for Node {
    fn about(&self) -> io::Result<About> {
        let found = self.call(&QUERY_CAPABILITY, |_| {})?;
        let by_node = found.all & CAP_BY_NODE != 0;
        let bits = if by_node { found.node } else { found.all };
        Ok(About {
            driver: text(&found.driver),
            card: text(&found.card),
            bus: text(&found.bus),
            captures: bits & CAP_CAPTURE != 0,
        })
    }

    fn format(&self, index: u32) -> io::Result<FourCc> {
        let set = |with: &mut Described| (with.index, with.kind) = (index, CAPTURE);
        Ok(self.call(&LIST_FORMATS, set)?.code)
    }

    fn sizes(&self, code: FourCc, index: u32) -> io::Result<Sizes> {
        let set = |with: &mut SizeRow| (with.index, with.code) = (index, code);
        let SizeRow { kind, numbers, .. } = self.call(&LIST_SIZES, set)?;
        Ok(match kind {
            DISCRETE => Sizes::one([numbers[0], numbers[1]]),
            _ => Sizes {
                least: [numbers[0], numbers[3]],
                most: [numbers[1], numbers[4]],
                step: [numbers[2], numbers[5]],
            },
        })
    }

    fn check_free(&self) -> io::Result<()> {
        // Freeing buffers changes nothing, because this handle has none, but fails if another handle has some.
        self.request_buffers(0).map(drop)
    }

    fn set_format(&self, code: FourCc, size: [u32; 2]) -> io::Result<Answer> {
        let found = self.call(&SET_FORMAT, |with| {
            (with.kind, with.size, with.code) = (CAPTURE, size, code);
            with.field = WHOLE_FIELDS[1];
        })?;
        Ok(Answer {
            code: found.code,
            size: found.size,
            stride: found.stride,
            whole: WHOLE_FIELDS.contains(&found.field),
        })
    }

    fn set_rate(&self, per_s: u32) -> io::Result<f32> {
        let set = |with: &mut Parameters| (with.kind, with.period) = (CAPTURE, [1, per_s]);
        let [numerator, denominator] = self.call(&SET_PARAMETERS, set)?.period;
        Ok(denominator as f32 / numerator as f32)
    }

    fn start(&mut self) -> io::Result<usize> {
        let count = self.request_buffers(CAMERA_BUFFERS as u32)? as usize;
        for index in 0..count.min(CAMERA_BUFFERS) {
            let mapping = self.map(index)?;
            self.buffers.push(mapping);
            self.queue(index)?;
        }
        let kind = CAPTURE.cast_signed();
        // SAFETY: the request reads an integer through the pointer.
        if unsafe { libc::ioctl(self.file.as_raw_fd(), START, &raw const kind) } < 0 {
            return Err(io::Error::last_os_error());
        }
        let lengths = self.buffers.iter().map(|buffer| buffer.length);
        Ok(lengths.min().unwrap_or(0))
    }

    fn wait(&self, wait: Duration) -> io::Result<bool> {
        let mut polled = [PollFd::new(self.file.as_raw_fd(), PollFlags::POLLIN)];
        match poll(&mut polled, wait.as_millis() as i32) {
            Ok(0) | Err(nix::errno::Errno::EINTR) => return Ok(false),
            Ok(_) => {}
            Err(problem) => return Err(problem.into()),
        }
        // Any other event ends the stream; another wait would return at once.
        match polled[0].revents() {
            Some(events) if events.contains(PollFlags::POLLIN) => Ok(true),
            _ => Err(io::Error::from_raw_os_error(libc::ENODEV)),
        }
    }

    fn take(&self) -> io::Result<Filled> {
        let found = self.call(&TAKE, buffer(0))?;
        let is_monotonic = found.flags & CLOCK == MONOTONIC;
        let time = found.time.map(|part| u64::try_from(part).unwrap_or(0));
        Ok(Filled {
            index: found.index as usize,
            used: found.used as usize,
            is_damaged: found.flags & DAMAGED != 0,
            taken: is_monotonic.then(|| {
                Duration::from_secs(time[0]).saturating_add(Duration::from_micros(time[1]))
            }),
        })
    }

    fn bytes(&self, index: usize) -> &[u8] {
        self.buffers.get(index).map_or(&[], |buffer| {
            // SAFETY: mapped for reading with this length until the node is dropped. The driver does not write to a buffer
            // between `take` and `queue`; if it did, pixels of another image would be read, and every value of a byte is valid.
            unsafe { core::slice::from_raw_parts(buffer.start.as_ptr(), buffer.length) }
        })
    }

    fn queue(&self, index: usize) -> io::Result<()> {
        self.call(&QUEUE, buffer(index)).map(drop)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Request numbers contain the sizes of the structures; these are from a C compiler for x86-64 and hold for every 64-bit processor.
    #[test]
    #[cfg(all(
        target_pointer_width = "64",
        not(any(target_arch = "mips64", target_arch = "powerpc64"))
    ))]
    fn requests_are_those_of_the_kernel() {
        let numbers = [
            (QUERY_CAPABILITY.0, 0x8068_5600),
            (LIST_FORMATS.0, 0xc040_5602),
            (SET_FORMAT.0, 0xc0d0_5605),
            (REQUEST_BUFFERS.0, 0xc014_5608),
            (QUERY_BUFFER.0, 0xc058_5609),
            (QUEUE.0, 0xc058_560f),
            (TAKE.0, 0xc058_5611),
            (START, 0x4004_5612),
            (SET_PARAMETERS.0, 0xc0cc_5616),
            (LIST_SIZES.0, 0xc02c_564a),
        ];
        for (request, expected) in numbers {
            assert_eq!(request, expected, "{request:#x}, expected {expected:#x}");
        }
    }

    #[test]
    fn what_is_no_camera_answers_with_an_error() {
        assert!(Node::open(Path::new("/nonexistent")).is_err());
        let null = Node::open(Path::new("/dev/null")).unwrap();
        assert!(null.about().is_err() && null.take().is_err() && null.check_free().is_err());
        assert!(null.bytes(0).is_empty());
    }
}
