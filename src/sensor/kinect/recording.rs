//! Recordings in the layout of libfreenect's fakenect: a directory with `INDEX.txt`, which names one file per picture.
//!
//! | file | holds |
//! | --- | --- |
//! | `d-<wall s>-<ticks>.pgm` | `P5 640 480 65535`, then raw disparity, u16 little endian (fakenect copies memory) |
//! | `r-<wall s>-<ticks>.ppm` | `P6 640 480 255`, then RGB |
//! | `a-<wall s>-<ticks>.dump` | acceleration and tilt; not used |
//! | `device.json` | calibration of the sensor; optional, the nominal one without it |
//!
//! Ticks are the camera's 60 MHz counter and the only clock used here: wall time depends on when the recording computer
//! handled the picture. `index` unwraps them and pairs the pictures, `write` is the other direction, [`device`] the
//! calibration.
//!
//! A depth picture without a colour picture, or whose colour picture is missing, is a frame without colour. Any other
//! damaged or missing file skips its frame with a warning and a count and never ends the run; anything but a regular file
//! (a pipe) is skipped without waiting. Memory: 0.9 MB of reused scratch and about 60 bytes per picture of the index;
//! nothing is allocated per frame. Cost: reading 1.5 MB per frame.

pub mod device;
mod error;
mod files;
mod index;
mod write;

pub use error::RecordingError;
pub use write::Recorder;

use std::fs::File;
use std::io::{ErrorKind, Read};
use std::path::{Path, PathBuf};

use super::colour;
use super::frame::Developed;
use super::picture_clock::timestamp_from_ticks;
use super::registration::Registration;
use crate::base::bounded_read;
use crate::base::capacity::PIXELS;
use crate::sensor::NO_DEPTH;
use crate::sensor::camera::Camera;
use files::{DEVICE_NAME, INDEX_NAME};
use index::{Entry, Index};

/// Bytes and pictures of the longest index: nine hours of both streams at 30 a second, which take a terabyte and a half.
const INDEX_MOST: [usize; 2] = [1 << 26, 1 << 21];
/// Longest header of a picture we look at, bytes.
const HEADER_BYTES: usize = 64;
/// Up to this many skipped frames are logged in full; after that only when their number has doubled.
const WARNINGS_IN_FULL: u64 = 10;

/// Why one frame of a recording was skipped.
#[derive(Debug, thiserror::Error)]
enum Damage {
    #[error("malformed name in the index, expected d-<wall s>-<ticks>.pgm")]
    Name,
    #[error("its time is not after that of the frame before")]
    Order,
    #[error("its time fits neither the frame before nor those after it")]
    Stray,
    #[error("not a regular file")]
    NoFile,
    #[error("cannot be read ({0})")]
    Unreadable(ErrorKind),
    #[error("header is not `{0}`")]
    Header(&'static str),
    #[error("ends after {found} of {expected} bytes")]
    Short { expected: usize, found: usize },
    #[error("holds the depth value {0}, expected raw values up to 2047, little endian")]
    Value(u16),
}

/// A recording that is played.
pub struct Recording {
    registration: Registration,
    camera: Camera,
    index: Index,
    next: usize,
    skipped: u64,
    /// Whether it was logged that a colour picture is missing.
    told_missing: bool,
    directory: PathBuf,
    /// The path being read; kept to reuse its memory.
    path: PathBuf,
    bytes: Box<[u8]>,
}

impl Recording {
    /// Opens the recording in `directory`.
    ///
    /// # Errors
    /// If there is no index, or none that names a depth picture, or `device.json` is there and unusable.
    pub fn open(directory: &Path) -> Result<Self, RecordingError> {
        let path = directory.join(INDEX_NAME);
        let text = bounded_read::open_regular(&path)
            .and_then(|file| bounded_read::all(file, INDEX_MOST[0]))
            .and_then(|text| {
                let text = String::from_utf8_lossy(&text).into_owned();
                let many = index::names(&text).count() > INDEX_MOST[1];
                let text = (!many).then_some(text);
                text.ok_or(ErrorKind::FileTooLarge.into())
            })
            .map_err(|error| match error.kind() {
                ErrorKind::Other | ErrorKind::FileTooLarge => RecordingError::File {
                    path: path.clone(),
                    source: error,
                },
                kind => RecordingError::NoIndex {
                    path: path.clone(),
                    kind,
                },
            })?;
        let index = Index::parse(&text);
        if index.depth.is_empty() {
            return Err(RecordingError::NoDepth { path });
        }
        let registration = device::read(&directory.join(DEVICE_NAME))?.unwrap_or_default();
        Ok(Self {
            camera: registration.camera(),
            registration,
            index,
            next: 0,
            skipped: 0,
            told_missing: false,
            directory: directory.to_path_buf(),
            // Long enough for any name, so that no frame makes it grow.
            path: PathBuf::with_capacity(directory.as_os_str().len() + 256),
            bytes: vec![0; colour::RGB_BYTES].into_boxed_slice(),
        })
    }

    /// Calibration of the sensor that was recorded, or the nominal one.
    #[must_use]
    pub fn registration(&self) -> &Registration {
        &self.registration
    }

    /// The same in the form the stages use.
    #[must_use]
    pub fn camera(&self) -> &Camera {
        &self.camera
    }

    /// Depth pictures the index names, skipped ones included.
    #[must_use]
    pub fn len(&self) -> usize {
        self.index.depth.len()
    }

    /// Never: a recording without depth pictures does not open.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        false
    }

    /// Frames skipped so far because a file of theirs is damaged or missing.
    #[must_use]
    pub fn skipped(&self) -> u64 {
        self.skipped
    }

    /// Plays on from the depth picture of this number, as [`crate::sensor::Frame::index`] counts.
    pub fn go_to(&mut self, number: usize) {
        let mut numbers = self.index.depth.iter().map(|depth| depth.number);
        let at = numbers.position(|known| known == number);
        self.next = at.unwrap_or(self.index.depth.len());
    }

    /// Fills `frame` with the next whole frame; `false` at the end.
    pub fn next_frame(&mut self, frame: &mut impl Developed) -> bool {
        while self.next < self.index.depth.len() {
            let at = self.next;
            self.next += 1;
            match self.read(at, frame) {
                Ok(()) => return true,
                Err(damage) => self.skip(at, &damage),
            }
        }
        false
    }

    fn skip(&mut self, at: usize, damage: &Damage) {
        self.skipped += 1;
        let number = self.index.depth[at].number;
        if self.skipped <= WARNINGS_IN_FULL || self.skipped.is_power_of_two() {
            let name = self.index.name(&self.index.depth[at]);
            let skipped = self.skipped;
            // A fault found while reading concerns the file last touched, depth or colour.
            match damage {
                Damage::Name | Damage::Order | Damage::Stray => {
                    tracing::warn!(
                        "frame {number} skipped: {name}: {damage} ({skipped} skipped so far)"
                    );
                }
                _ => {
                    let file = self.path.display();
                    tracing::warn!(
                        "frame {number} skipped: {file}: {damage} ({skipped} skipped so far)"
                    );
                }
            }
        }
    }

    fn read(&mut self, at: usize, into: &mut impl Developed) -> Result<(), Damage> {
        let (frame, mut original) = into.parts();
        let depth = self.index.depth[at];
        let time = depth.time.ok_or(match depth.ticks {
            Some(_) if depth.stray => Damage::Stray,
            Some(_) => Damage::Order,
            None => Damage::Name,
        })?;
        self.path.clone_from(&self.directory);
        self.path.push(self.index.name(&depth));
        read_picture(
            &self.path,
            "P5 640 480 65535",
            &mut self.bytes[..2 * PIXELS],
        )?;
        let mut largest = 0;
        for (raw, bytes) in frame.depth.iter_mut().zip(self.bytes.chunks_exact(2)) {
            *raw = u16::from_le_bytes([bytes[0], bytes[1]]);
            largest = largest.max(*raw);
        }
        if largest > NO_DEPTH {
            return Err(Damage::Value(largest));
        }
        let colour = depth.colour.map(|colour| self.index.colour[colour]);
        match colour {
            Some(colour) if self.read_colour(&colour)? => {
                colour::luma_from_rgb(&self.bytes, &mut frame.luma);
                frame.has_colour = true;
                if let Some(original) = &mut original {
                    colour::bayer_from_rgb(&self.bytes, &mut original.bayer);
                    original.colour_ticks = colour.ticks.unwrap_or_default();
                }
            }
            _ => {
                frame.drop_colour();
                if let Some(original) = &mut original {
                    original.drop_colour();
                }
            }
        }
        frame.index = depth.number as u64;
        frame.at = timestamp_from_ticks(time);
        if let Some(original) = original {
            original.ticks = depth.ticks.unwrap_or_default();
        }
        Ok(())
    }

    /// Reads a colour picture into `bytes`; `false` if there is no such file, as in a recording of which only depth was
    /// kept: that is logged once.
    fn read_colour(&mut self, colour: &Entry) -> Result<bool, Damage> {
        self.path.clone_from(&self.directory);
        self.path.push(self.index.name(colour));
        match read_picture(&self.path, "P6 640 480 255", &mut self.bytes) {
            Err(Damage::Unreadable(ErrorKind::NotFound)) => {
                if !core::mem::replace(&mut self.told_missing, true) {
                    let file = self.path.display();
                    tracing::warn!(
                        "{file} is missing; frames whose colour picture is missing play without colour"
                    );
                }
                Ok(false)
            }
            read => read.map(|()| true),
        }
    }
}

/// Reads the body of a PGM or PPM file whose first line is `header`. What follows the body is ignored, as fakenect does.
fn read_picture(path: &Path, header: &'static str, body: &mut [u8]) -> Result<(), Damage> {
    let unreadable = |error: std::io::Error| match error.kind() {
        ErrorKind::Other => Damage::NoFile,
        kind => Damage::Unreadable(kind),
    };
    let mut file = bounded_read::open_regular(path).map_err(unreadable)?;
    // Header and the start of the body come in one small read; the rest goes straight to its place.
    let mut head = [0; HEADER_BYTES];
    let got = read_fully(&mut file, &mut head).map_err(unreadable)?;
    let line = head[..got]
        .split(|&byte| byte == b'\n')
        .next()
        .unwrap_or_default();
    let words = || {
        line.split(u8::is_ascii_whitespace)
            .filter(|word| !word.is_empty())
    };
    if line.len() == got || !words().eq(header.split(' ').map(str::as_bytes)) {
        return Err(Damage::Header(header));
    }
    let start = &head[line.len() + 1..got];
    body[..start.len()].copy_from_slice(start);
    let found =
        start.len() + read_fully(&mut file, &mut body[start.len()..]).map_err(unreadable)?;
    if found < body.len() {
        return Err(Damage::Short {
            expected: body.len(),
            found,
        });
    }
    Ok(())
}

/// Reads until `to` is full or the file ends; the number of bytes read.
fn read_fully(file: &mut File, to: &mut [u8]) -> std::io::Result<usize> {
    let mut got = 0;
    while got < to.len() {
        match file.read(&mut to[got..]) {
            Ok(0) => break,
            Ok(more) => got += more,
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(got)
}
