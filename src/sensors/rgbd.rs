//! Recordings of any depth camera: a folder in the layout of the TUM RGB-D data sets, and its calibration in one small file.
//!
//! | file | holds |
//! | --- | --- |
//! | `depth.txt` | a line per depth picture: seconds, and its file; `#` begins a comment |
//! | `rgb.txt` | the same for colour or infrared pictures; optional |
//! | `camera.json` | size, focal lengths, centre and scale of both cameras, and the pose between them: [`calibration`] |
//!
//! Depth has 16 bits, 0 = none; pictures are grey of 8 or 16 bits or RGB of 8. Files are PGM or PPM, or with the feature `studio`
//! PNG and JPEG (`picture_file`). A depth picture is paired with the other picture nearest in time, at most half a period away; a
//! depth picture without one is a frame without colour. Pictures larger than [`WIDTH`] × [`HEIGHT`] are reduced by a whole factor:
//! depth is subsampled, so that edges are not blurred; brightness is averaged. A frame holds depth in the recording's own unit. A
//! damaged frame is skipped with a warning and a count.
//!
//! Memory: a file; only PNG and JPEG decoders allocate per frame. Limitation: depth must be undistorted, as most cameras' software
//! delivers it.

mod calibration;
mod index;

use std::path::{Path, PathBuf};

use super::camera::{Camera, ColourProjection, DepthScale, Pinhole, RANGE_M};
use super::picture_file::{Damage, PictureFile, Pixels, RecordingError, Skipped};
use super::{Frame, NO_DEPTH};
use crate::kinect::frame::FrameSink;
use crate::sensor::{Sensor, SensorError, SensorState};
use calibration::{Calibration, Intrinsics};
use index::{Index, misread_times};
use mien_stages::base::bounded_read::{self, reason};
use mien_stages::base::capacity::{HEIGHT, WIDTH};
use mien_stages::base::time::Timestamp;

/// Largest list of pictures, bytes.
const LIST_MAX: usize = 1 << 26;
/// Largest calibration file, bytes.
const CALIBRATION_MAX: usize = 1 << 16;
/// Problem of a list's line without a usable time and file.
const UNLISTED: Damage = Damage::Listed(
    "expected a time in seconds, later than in the line before, and a file in this folder",
);

/// One stream: size of its pictures, reduction, and file buffers.
struct Stream {
    size: [usize; 2],
    /// File pixels per frame pixel, along each side.
    reduced: usize,
    file: PictureFile,
}

impl Stream {
    fn new(view: &Intrinsics) -> Self {
        let [columns, rows] = view.size();
        Self {
            size: view.size(),
            reduced: columns.div_ceil(WIDTH).max(rows.div_ceil(HEIGHT)),
            file: PictureFile::new(columns * rows * 6),
        }
    }

    /// Columns and rows in the frame.
    fn frame_size(&self) -> [usize; 2] {
        self.size.map(|pixels| pixels / self.reduced)
    }

    /// Pinhole of the reduced picture; `within`: position of a reduced pixel's centre in its block, file pixels.
    fn pinhole(&self, view: &Intrinsics, within: f32) -> Pinhole {
        let (reduced, whole) = (self.reduced as f32, view.pinhole());
        Pinhole {
            focal: whole.focal.map(|focal| focal / reduced),
            centre: whole.centre.map(|centre| (centre - within) / reduced),
        }
    }
}

fn read_text(path: &Path, most: usize) -> Result<String, RecordingError> {
    let bytes = bounded_read::read_regular(path, most).map_err(|problem| {
        RecordingError(path.to_owned(), format!("cannot be read ({}); a recording of a depth camera has depth.txt and camera.json, see docs/recordings.md", reason(problem)))
    })?;
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}

/// A recording being played.
pub struct Rgbd {
    folder: PathBuf,
    index: Index,
    next: usize,
    skipped: Skipped,
    /// Geometry of both cameras.
    pub camera: Camera,
    depth: Stream,
    picture: Stream,
    metres_per_unit: f32,
    /// Whether the scale has been checked on a picture.
    scale_checked: bool,
    /// Value of a 16-bit picture that becomes 255.
    white: u32,
    path: PathBuf,
}

impl Rgbd {
    /// Whether `folder` has such a recording.
    pub fn is_recording(folder: &Path) -> bool {
        folder.join("depth.txt").exists()
    }

    /// Opens the recording in `folder`.
    ///
    /// # Errors
    /// If there is no list of depth pictures, or the calibration is missing or unusable.
    pub fn open(folder: &Path) -> Result<Self, RecordingError> {
        let text = |name, most| read_text(&folder.join(name), most);
        let calibration = Calibration::parse(&text("camera.json", CALIBRATION_MAX)?);
        let calibration =
            calibration.map_err(|problem| RecordingError(folder.join("camera.json"), problem))?;
        let pictures = match folder.join("rgb.txt").try_exists() {
            Ok(false) => String::new(),
            _ => text("rgb.txt", LIST_MAX)?,
        };
        let depths = text("depth.txt", LIST_MAX)?;
        if let Some(problem) = misread_times(&depths) {
            return Err(RecordingError(folder.join("depth.txt"), problem));
        }
        let index = Index::parse(&depths, &pictures);
        if let Some(problem) = index.pairing_problem() {
            tracing::warn!("{}: {problem}", folder.join("rgb.txt").display());
        }
        if index.depth.is_empty() {
            return Err(RecordingError(folder.join("depth.txt"), "lists no picture, expected lines like 1305031102.160407 depth/1305031102.160407.png; is the recording complete?".into()));
        }
        #[cfg(not(feature = "studio"))]
        if index.depth[0].name.ends_with(".png") {
            return Err(RecordingError(folder.join("depth.txt"), "lists PNG files, which this build cannot read; use a build with --features studio, or convert them to PGM (see docs/recordings.md)".into()));
        }
        let (depth, picture) = (&calibration.depth, &calibration.colour);
        let streams = [depth, picture].map(Stream::new);
        let [depth_stream, picture_stream] = &streams;
        let camera = Camera::new(
            DepthScale::metric(depth.metres_per_unit),
            depth_stream.pinhole(depth, (depth_stream.reduced / 2) as f32),
            depth_stream.frame_size(),
            ColourProjection::Pinhole {
                distortion: picture.distortion,
                view: picture_stream.pinhole(picture, (picture_stream.reduced - 1) as f32 * 0.5),
                colour_from_sensor: calibration.colour_from_depth,
            },
        );
        let metres_per_unit = depth.metres_per_unit;
        let [depth_stream, picture_stream] = streams;
        Ok(Self {
            // Capacity for usual file names, so that frames do not allocate.
            path: PathBuf::with_capacity(folder.as_os_str().len() + 256),
            folder: folder.to_owned(),
            index,
            next: 0,
            skipped: Skipped::default(),
            camera,
            depth: depth_stream,
            white: picture.white,
            picture: picture_stream,
            metres_per_unit,
            scale_checked: false,
        })
    }

    /// File pixels per frame pixel along each side: of depth, of pictures.
    pub fn reduced(&self) -> [usize; 2] {
        [self.depth.reduced, self.picture.reduced]
    }

    /// Number of frames skipped so far because of a damaged or missing file.
    pub fn skipped(&self) -> u64 {
        self.skipped.0
    }

    /// Number of depth pictures in the list, skipped ones included.
    pub fn frames(&self) -> usize {
        self.index.depth.len()
    }

    /// Continues at the depth picture with this [`Frame::index`].
    pub fn seek(&mut self, number: usize) {
        self.next = number.min(self.frames());
    }

    /// Fills `frame` with the next undamaged frame; `false` at the end.
    pub fn next_frame(&mut self, frame: &mut Frame) -> bool {
        while self.next < self.index.depth.len() {
            self.next += 1;
            let Err(damage) = self.read(self.next - 1, frame) else {
                return true;
            };
            self.skipped.add(self.next - 1, &self.path, &damage);
        }
        false
    }

    fn read(&mut self, at: usize, frame: &mut Frame) -> Result<(), Damage> {
        let (index, path, camera) = (&self.index, &mut self.path, &self.camera);
        let entry = &index.depth[at];
        let set_path = |path: &mut PathBuf, name: &str| {
            path.clone_from(&self.folder);
            path.push(name);
        };
        set_path(path, &entry.name);
        let time_us = entry.time_us.ok_or(UNLISTED)?;
        let ([columns, rows], reduced) = (self.depth.frame_size(), self.depth.reduced);
        let width = self.depth.size[0];
        let pixels = self.depth.file.read(path, self.depth.size)?;
        if pixels.channels != 1 || !pixels.is_16_bit {
            return Err(Damage::Kind("a 16-bit grey picture, as depth is"));
        }
        if !std::mem::replace(&mut self.scale_checked, true)
            && let Some(problem) = misread_depth(&pixels, self.metres_per_unit)
        {
            let file = self.folder.join("camera.json");
            tracing::warn!("{}: {problem}", file.display());
        }
        frame.depth.fill(NO_DEPTH);
        for row in 0..rows {
            let from = (row * reduced + reduced / 2) * width + reduced / 2;
            let values = pixels.body.as_chunks().0[from..].iter().step_by(reduced);
            let out = &mut frame.depth[row * WIDTH..][..columns];
            for (out, value) in out.iter_mut().zip(values) {
                let raw = u16::from_be_bytes(*value);
                let is_measured = camera.depth_m(raw) > 0.0;
                *out = if is_measured { raw } else { NO_DEPTH };
            }
        }
        match entry.picture {
            Some(other) => {
                set_path(path, &index.pictures[other].name);
                let (frame_size, reduced) = (self.picture.frame_size(), self.picture.reduced);
                let pixels = self.picture.file.read(path, self.picture.size)?;
                pixels.brightness(reduced, frame_size, self.white, &mut frame.luma);
                frame.has_colour = true;
            }
            None => frame.drop_colour(),
        }
        // Never negative: times start at 0 with the first depth picture and rise.
        (frame.index, frame.at) = (at as u64, Timestamp::from_us(time_us.unsigned_abs()));
        Ok(())
    }
}

/// Smallest share of depth values that must be in the range of depth cameras.
const IN_RANGE_SHARE: f32 = 0.2;

/// The problem with the scale of depth, if most values of a picture are out of range.
fn misread_depth(pixels: &Pixels<'_>, metres_per_unit: f32) -> Option<String> {
    let values = pixels
        .body
        .as_chunks::<2>()
        .0
        .iter()
        .map(|two| u16::from_be_bytes(*two));
    let mut values: Vec<u16> = values.filter(|&value| value > 0).collect();
    let metres = |value: u16| f32::from(value) * metres_per_unit;
    let inside = values
        .iter()
        .filter(|&&value| (RANGE_M[0]..=RANGE_M[1]).contains(&metres(value)));
    let inside = inside.count() as f32 / values.len().max(1) as f32;
    if inside >= IN_RANGE_SHARE || values.is_empty() {
        return None;
    }
    values.sort_unstable();
    let (median, percent) = (values[values.len() / 2], inside * 100.0);
    Some(format!(
        "with metres_per_unit = {metres_per_unit} the median of the first depth picture is {:.2} m, and only {percent:.0} % of it is within {} to {} m; should it be 0.001 (millimetres) or 0.0002 (TUM)?",
        metres(median),
        RANGE_M[0],
        RANGE_M[1]
    ))
}

impl Sensor for Rgbd {
    fn next_frame(&mut self, into: &mut dyn FrameSink) -> Result<bool, SensorError> {
        let (frame, original) = into.parts();
        let more = Rgbd::next_frame(self, frame);
        if let Some(original) = original {
            original.set_grey(frame);
        }
        Ok(more)
    }

    fn camera(&self) -> &Camera {
        &self.camera
    }

    fn luma_size(&self) -> [usize; 2] {
        self.picture.frame_size()
    }

    fn state(&self) -> SensorState {
        SensorState {
            frames: self.frames(),
            skipped: self.skipped(),
            reduced: self.reduced(),
            ..SensorState::default()
        }
    }

    fn seek(&mut self, number: usize) {
        Rgbd::seek(self, number);
    }
}
