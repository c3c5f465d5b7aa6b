//! Recordings in the layout of libfreenect's fakenect: a directory with `INDEX.txt`, which names one file per picture.
//!
//! | file | holds |
//! | --- | --- |
//! | `d-<wall s>-<ticks>.pgm` | `P5 640 480 65535`, then raw disparity, u16 little endian (fakenect copies memory) |
//! | `r-<wall s>-<ticks>.ppm` | `P6 640 480 255`, then RGB |
//! | `a-<wall s>-<ticks>.dump` | x, y, z of the accelerometer, i16 little endian, and six bytes about the tilt; the first file is used |
//! | `device.json` | calibration of the sensor; optional, the nominal one without it |
//!
//! Ticks are the camera's 60 MHz counter and the only clock used, because wall time depends on when the recording computer handled
//! the picture. `index` unwraps them and pairs the pictures, `write` records, [`device`] reads the calibration.
//!
//! A depth picture without a colour picture is a frame without colour. Any other damaged or missing file skips its frame with a
//! warning and a count and never ends the run; files that are not regular (a pipe) are skipped without waiting. Memory: 0.9 MB of
//! reused scratch and about 60 bytes per picture of the index; nothing is allocated per frame. Cost: reading 1.5 MB per frame.

pub mod device;
mod index;
mod write;

pub use write::Recorder;

use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use super::colour;
use super::frame::{FrameSink, Original};
use super::picture_clock::timestamp_from_ticks;
use super::registration::Registration;
use super::unpack::NO_READING;
use crate::picture_file::{Damage, PictureFile, RecordingError, Skipped};
use index::{Entry, Index};
use mien_stages::base::bounded_read::{self, reason};
use mien_stages::base::capacity::{HEIGHT, WIDTH};
use mien_stages::base::vectors::with_avx2;
use mien_stages::camera::Camera;
use write::{ACCELERATION_BYTES, DEVICE_NAME, INDEX_NAME};

/// Limits on the index, bytes and pictures: nine hours of both streams at 30 Hz, 1.5 TB.
const INDEX_MAX: [usize; 2] = [1 << 26, 1 << 21];

/// The first measurement of the accelerometer that the text of an index names, if it can be read: a recording plays without.
fn acceleration(directory: &Path, text: &str) -> Option<[i16; 3]> {
    let path = directory.join(index::first_acceleration(text)?);
    let bytes = bounded_read::read_regular(&path, ACCELERATION_BYTES);
    let bytes = bytes.inspect_err(|problem| tracing::debug!("{}: {problem}", path.display()));
    let axes: [u8; 6] = *bytes.ok()?.first_chunk()?;
    Some([0, 2, 4].map(|at| i16::from_le_bytes([axes[at], axes[at + 1]])))
}

/// A recording being played.
pub struct Recording {
    /// Calibration of the recorded sensor, or the nominal one.
    pub registration: Registration,
    /// Geometry by this calibration, for the stages.
    pub camera: Camera,
    /// What the accelerometer of the recorded sensor measured at first, as [`super::motor::acceleration`].
    pub acceleration: Option<[i16; 3]>,
    index: Index,
    next: usize,
    skipped: Skipped,
    /// Whether a missing colour picture has been logged.
    missing_logged: bool,
    directory: PathBuf,
    /// The path being read; kept to reuse its memory.
    path: PathBuf,
    file: PictureFile,
}

impl Recording {
    /// Opens the recording in `directory`.
    ///
    /// # Errors
    /// If the index is missing or names no depth picture, or `device.json` exists and is unusable.
    pub fn open(directory: &Path) -> Result<Self, RecordingError> {
        let path = directory.join(INDEX_NAME);
        let text = bounded_read::read_regular(&path, INDEX_MAX[0]).and_then(|text| {
            let text = String::from_utf8_lossy(&text).into_owned();
            let fits = index::names(&text).count() <= INDEX_MAX[1];
            fits.then_some(text).ok_or(ErrorKind::FileTooLarge.into())
        });
        let text = text.map_err(|problem| match problem.kind() {
            ErrorKind::Other | ErrorKind::FileTooLarge => RecordingError::from_io(&path, &problem),
            _ => RecordingError(path.clone(), format!("cannot be read ({}); a recording is a directory with INDEX.txt and the files that it lists", reason(&problem))),
        })?;
        let index = Index::parse(&text);
        if index.depth.is_empty() {
            return Err(RecordingError(path, "lists no depth picture, expected lines like d-1700000000.033333-2000000.pgm; is the recording complete?".into()));
        }
        let registration = device::read(&directory.join(DEVICE_NAME))?.unwrap_or_default();
        Ok(Self {
            camera: registration.camera(),
            registration,
            acceleration: acceleration(directory, &text),
            index,
            next: 0,
            skipped: Skipped::default(),
            missing_logged: false,
            directory: directory.to_path_buf(),
            // Capacity for the longest file name, so that no frame allocates.
            path: PathBuf::with_capacity(directory.as_os_str().len() + 256),
            file: PictureFile::new(colour::RGB_BYTES),
        })
    }

    /// Number of depth pictures in the index, skipped ones included.
    pub fn frames(&self) -> usize {
        self.index.depth.len()
    }

    /// Number of frames skipped so far because of a damaged or missing file.
    pub fn skipped(&self) -> u64 {
        self.skipped.0
    }

    /// Continues at the depth picture with this [`crate::Frame::index`].
    pub fn seek(&mut self, number: usize) {
        let mut numbers = self.index.depth.iter().map(|depth| depth.number);
        let at = numbers.position(|known| known == number);
        self.next = at.unwrap_or(self.index.depth.len());
    }

    /// Fills `frame` with the next undamaged frame; `false` at the end.
    pub fn next_frame(&mut self, frame: &mut impl FrameSink) -> bool {
        while self.next < self.index.depth.len() {
            let at = self.next;
            self.next += 1;
            match self.read(at, frame) {
                Ok(()) => return true,
                Err(damage) => {
                    let number = self.index.depth[at].number;
                    self.skipped.add(number, &self.path, &damage);
                }
            }
        }
        false
    }

    fn read(&mut self, at: usize, into: &mut impl FrameSink) -> Result<(), Damage> {
        let (frame, mut original) = into.parts();
        let depth = self.index.depth[at];
        self.path.clone_from(&self.directory);
        self.path.push(self.index.name(&depth));
        let time = depth.time.ok_or(Damage::Listed(match depth.ticks {
            Some(_) if depth.stray => {
                "its time stamp matches neither the previous frame nor the following ones"
            }
            Some(_) => "its time stamp is not later than that of the previous frame",
            None => "its name is malformed, expected d-<wall s>-<ticks>.pgm",
        }))?;
        let pixels = self.file.read(&self.path, [WIDTH, HEIGHT])?;
        if pixels.channels != 1 || !pixels.is_16_bit {
            return Err(Damage::Kind("a 16-bit grey picture, as raw depth is"));
        }
        // Little endian, unlike the format: fakenect copies memory.
        let largest = with_avx2(|| {
            let mut largest = 0;
            for (raw, bytes) in frame.depth.iter_mut().zip(pixels.body.as_chunks().0) {
                *raw = u16::from_le_bytes(*bytes);
                largest = largest.max(*raw);
            }
            largest
        });
        if largest > NO_READING {
            return Err(Damage::Value(largest));
        }
        if let Some(original) = &mut original {
            original.ticks = depth.ticks.unwrap_or_default();
        }
        let colour = depth.colour.map(|colour| self.index.colour[colour]);
        let rgb = colour.map(|colour| self.read_colour(&colour)).transpose()?;
        if let Some(rgb) = rgb.flatten() {
            colour::luma_from_rgb(rgb, &mut frame.luma);
            frame.has_colour = true;
            if let Some(original) = original {
                colour::bayer_from_rgb(rgb, &mut original.bayer);
                original.colour_ticks = colour.and_then(|it| it.ticks).unwrap_or_default();
            }
        } else {
            frame.drop_colour();
            original.map(Original::drop_colour);
        }
        frame.index = depth.number as u64;
        frame.at = timestamp_from_ticks(time);
        Ok(())
    }

    /// Reads a colour picture as RGB; `None` if the file is missing, which is logged once: some recordings keep only depth.
    ///
    /// # Errors
    /// If the file is damaged.
    fn read_colour(&mut self, colour: &Entry) -> Result<Option<&[u8]>, Damage> {
        self.path.clone_from(&self.directory);
        self.path.push(self.index.name(colour));
        match self.file.read(&self.path, [WIDTH, HEIGHT]) {
            Err(Damage::Unreadable(error)) if error.kind() == ErrorKind::NotFound => {
                if !core::mem::replace(&mut self.missing_logged, true) {
                    let file = self.path.display();
                    tracing::warn!(
                        "{file} is missing; frames whose colour picture is missing play without colour"
                    );
                }
                Ok(None)
            }
            Ok(pixels) if pixels.channels != 3 || pixels.is_16_bit => {
                Err(Damage::Kind("an 8-bit colour picture"))
            }
            read => Ok(Some(read?.body)),
        }
    }
}
