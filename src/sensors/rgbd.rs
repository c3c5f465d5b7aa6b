//! Recordings of any depth camera, or of colour alone: a folder in the layout of the TUM RGB-D data sets, and its calibration in one
//! small file.
//!
//! | file | holds |
//! | --- | --- |
//! | `depth.txt` | a line per depth picture: seconds, and its file; `#` begins a comment |
//! | `rgb.txt` | the same for colour or infrared pictures; optional beside `depth.txt`; alone, its pictures are the frames |
//! | `camera.json` | size, focal lengths, centre and scale of the cameras, and the pose between them: `rgbd/calibration.rs` |
//!
//! Depth has 16 bits, 0 = none; pictures are grey of 8 or 16 bits or RGB of 8. Files are PGM or PPM, or with the feature `studio`
//! PNG and JPEG (`picture_file`). A depth picture is paired with the other picture nearest in time, at most half a period away; a
//! depth picture without one is a frame without colour. Pictures larger than a frame are reduced by a whole factor:
//! depth is subsampled, so that edges are not blurred; brightness is averaged. A frame holds depth in the recording's own unit. A
//! damaged frame is skipped with a warning and a count.
//!
//! Memory: a file; only PNG and JPEG decoders allocate per frame. Limitation: depth must be undistorted, as most cameras' software
//! delivers it.

pub(crate) mod calibration;
mod index;

use std::path::{Path, PathBuf};

use super::camera::{Camera, RANGE_M};
use super::picture_file::{Damage, PictureFile, Pixels, RecordingError, Skipped, size_of};
use super::reduction::{ASSUMED_VIEW_DEG, Reduction};
use super::{Frame, NO_DEPTH};
use crate::kinect::frame::FrameSink;
use crate::sensor::{Sensor, SensorError, SensorState};
use calibration::{CALIBRATION_MAX, Calibration, Intrinsics};
use index::{Entry, Index, misread_times};
use mien_stages::base::bounded_read::{self, reason};
use mien_stages::base::capacity::PIXELS;
use mien_stages::base::time::Timestamp;

/// The lists of depth pictures and of the others.
const LISTS: [&str; 2] = ["depth.txt", "rgb.txt"];
/// Number of pictures of which one must have a size that can be read.
const SIZE_TRIES: usize = 10;
/// Largest list of pictures, bytes.
const LIST_MAX: usize = 1 << 26;
/// Problem of a list's line without a usable time and file.
const UNLISTED: Damage = Damage::Listed(
    "expected a time in seconds, later than in the line before, and a file in this folder",
);

/// One stream: size of its pictures, and file buffers.
struct Stream {
    reduction: Reduction,
    file: PictureFile,
}

impl Stream {
    fn new(view: &Intrinsics) -> Self {
        let [columns, rows] = view.size();
        Self {
            reduction: view.reduction(),
            file: PictureFile::new(columns * rows * 6),
        }
    }
}

/// The stream of depth.
struct Depth {
    stream: Stream,
    metres_per_unit: f32,
    /// Whether the scale has been checked on a picture.
    scale_checked: bool,
}

impl Depth {
    fn new(view: &Intrinsics) -> Self {
        Self {
            stream: Stream::new(view),
            metres_per_unit: view.metres_per_unit,
            scale_checked: false,
        }
    }

    /// Reads the picture at `path` of a recording in `folder`.
    fn read(
        &mut self,
        [folder, path]: [&Path; 2],
        camera: &Camera,
        into: &mut [u16; PIXELS],
    ) -> Result<(), Damage> {
        let Stream { reduction, file } = &mut self.stream;
        let pixels = file.read(path, reduction.size)?;
        if pixels.channels != 1 || !pixels.is_16_bit {
            return Err(Damage::Kind("a 16-bit grey picture, as depth is"));
        }
        if !std::mem::replace(&mut self.scale_checked, true)
            && let Some(problem) = misread_depth(&pixels, self.metres_per_unit)
        {
            let file = folder.join("camera.json");
            tracing::warn!("{}: {problem}", file.display());
        }
        reduction.pick(into, camera, |col, row| {
            pixels.u16_at(row * reduction.size[0] + col)
        });
        Ok(())
    }
}

/// The calibration in `folder`; `has_depth`: whether there are depth pictures. Without them it may be missing, and the size of the
/// `pictures` is all that is known.
fn calibration(
    folder: &Path,
    has_depth: bool,
    pictures: &[Entry],
) -> Result<Calibration, RecordingError> {
    let path = folder.join("camera.json");
    let fails = |problem| RecordingError(path.clone(), problem);
    if !has_depth && matches!(path.try_exists(), Ok(false)) {
        let timed = pictures.iter().filter(|entry| entry.time_us.is_some());
        let size = timed
            .take(SIZE_TRIES)
            .find_map(|entry| size_of(&folder.join(&entry.name)).ok());
        let size = size.ok_or_else(|| fails("is missing, and the size of the first pictures cannot be read; are they in the folder?".into()))?;
        warn_once(format_args!(
            "{} is missing, so a camera with a field of view of {ASSUMED_VIEW_DEG} degrees is assumed; write the focal lengths of yours to it (docs/recordings.md) for right distances",
            path.display()
        ));
        return Calibration::assumed(None, size).check().map_err(fails);
    }
    let mut calibration = Calibration::parse(&read_text(&path, CALIBRATION_MAX)?).map_err(fails)?;
    match (has_depth, &calibration.depth) {
        (true, None) => {
            return Err(fails("expected `depth`, because there is a depth.txt, found only `colour`; add the numbers of the depth camera, or remove depth.txt".into()));
        }
        (false, Some(_)) => {
            warn_once(format_args!(
                "{} has a depth camera, but there is no depth.txt: playing the pictures without depth",
                path.display()
            ));
            calibration.depth = None;
        }
        _ => {}
    }
    Ok(calibration)
}

/// Warns about a recording; once, because some programs open it again for every picture that they show.
fn warn_once(problem: std::fmt::Arguments<'_>) {
    static WARNED: std::sync::Once = std::sync::Once::new();
    WARNED.call_once(|| tracing::warn!("{problem}"));
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
    /// Geometry of the cameras.
    pub camera: Camera,
    /// `None` for a recording of colour alone.
    depth: Option<Depth>,
    picture: Stream,
    /// Value of a 16-bit picture that becomes 255.
    white: u32,
    path: PathBuf,
}

impl Rgbd {
    /// Whether `folder` has such a recording.
    pub fn is_recording(folder: &Path) -> bool {
        LISTS.iter().any(|list| folder.join(list).exists())
    }

    /// Opens the recording in `folder`.
    ///
    /// # Errors
    /// If there is no list of pictures, or the calibration is missing beside depth or unusable.
    pub fn open(folder: &Path) -> Result<Self, RecordingError> {
        let [depths, pictures] = LISTS;
        let has = |name: &str| !matches!(folder.join(name).try_exists(), Ok(false));
        let text = |name| match has(name) {
            true => read_text(&folder.join(name), LIST_MAX),
            false => Ok(String::new()),
        };
        let list = if has(depths) { depths } else { pictures };
        let problem = |problem: String| Err(RecordingError(folder.join(list), problem));
        let frames = text(list)?;
        if let Some(misread) = misread_times(&frames) {
            return problem(misread);
        }
        let index = Index::parse(&frames, &text(pictures)?);
        if let Some(problem) = index.pairing_problem() {
            tracing::warn!("{}: {problem}", folder.join(pictures).display());
        }
        if index.frames.is_empty() {
            let example = format!("1305031102.160407 {0}/0001.png", list.replace(".txt", ""));
            return problem(format!(
                "lists no picture, expected lines like {example}; is the recording complete?"
            ));
        }
        #[cfg(not(feature = "studio"))]
        if let Some((_, kind)) = index.frames[0].name.rsplit_once('.')
            && ["png", "jpg", "jpeg"].contains(&kind)
        {
            return problem("lists PNG or JPEG files, which this build cannot read; use a build with --features studio, or convert them to PGM (see docs/recordings.md)".into());
        }
        let calibration = calibration(folder, list == depths, &index.frames)?;
        let picture = &calibration.colour;
        let depth = calibration.depth.as_ref().map(Depth::new);
        let picture_stream = Stream::new(picture);
        Ok(Self {
            // Capacity for usual file names, so that frames do not allocate.
            path: PathBuf::with_capacity(folder.as_os_str().len() + 256),
            folder: folder.to_owned(),
            index,
            next: 0,
            skipped: Skipped::default(),
            camera: calibration.camera(),
            depth,
            white: picture.white,
            picture: picture_stream,
        })
    }

    /// File pixels per frame pixel along each side: of depth, of pictures.
    pub fn reduced(&self) -> [usize; 2] {
        let picture = self.picture.reduction.factor;
        // Without depth, the picture's pixels stand for both.
        let depth = self.depth.as_ref();
        [
            depth.map_or(picture, |depth| depth.stream.reduction.factor),
            picture,
        ]
    }

    /// Number of frames skipped so far because of a damaged or missing file.
    pub fn skipped(&self) -> u64 {
        self.skipped.0
    }

    /// Number of frames in the list, skipped ones included.
    pub fn frames(&self) -> usize {
        self.index.frames.len()
    }

    /// Continues at the frame with this [`Frame::index`].
    pub fn seek(&mut self, number: usize) {
        self.next = number.min(self.frames());
    }

    /// Fills `frame` with the next undamaged frame; `false` at the end.
    pub fn next_frame(&mut self, frame: &mut Frame) -> bool {
        while self.next < self.index.frames.len() {
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
        let entry = &index.frames[at];
        let set_path = |path: &mut PathBuf, name: &str| {
            path.clone_from(&self.folder);
            path.push(name);
        };
        set_path(path, &entry.name);
        let time_us = entry.time_us.ok_or(UNLISTED)?;
        match &mut self.depth {
            Some(depth) => depth.read([&self.folder, path], camera, &mut frame.depth)?,
            None => frame.depth.fill(NO_DEPTH),
        }
        match entry.picture {
            Some(other) => {
                set_path(path, &index.pictures[other].name);
                let Stream { reduction, file } = &mut self.picture;
                let pixels = file.read(path, reduction.size)?;
                pixels.brightness(reduction, self.white, &mut frame.luma);
                frame.has_colour = true;
            }
            None => frame.drop_colour(),
        }
        // Never negative: times start at 0 with the first one in the list and rise.
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
        .map(|two| u16::from_be_bytes(*two).into());
    let mut values: Vec<f32> = values.filter(|&value| value > 0.0).collect();
    let metres = |value: f32| value * metres_per_unit;
    let inside = values
        .iter()
        .filter(|&&value| (RANGE_M[0]..=RANGE_M[1]).contains(&metres(value)));
    let inside = inside.count() as f32 / values.len().max(1) as f32;
    if inside >= IN_RANGE_SHARE || values.is_empty() {
        return None;
    }
    mien_stages::base::sorting::sort(&mut values);
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
        self.picture.reduction.frame_size()
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
