//! Writes a recording, frame by frame. A picture is added to the index when its file is complete; a file that cannot be completed is
//! removed. Colour is stored demosaiced; the mosaic can be restored exactly, so depth and luma replay bit for bit.

use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};

use super::device;
use crate::kinect::colour;
use crate::kinect::frame::KinectFrame;
use crate::kinect::registration::Registration;
use crate::kinect::unpack::NO_READING;
use crate::picture_file::RecordingError;
use mien_stages::base::capacity::PIXELS;

/// Name of the file that lists a recording's pictures.
pub(super) const INDEX_NAME: &str = "INDEX.txt";
/// Name of the file with the sensor's calibration.
pub(super) const DEVICE_NAME: &str = "device.json";

/// Bytes of a measurement of the accelerometer: libfreenect's tilt state.
pub(super) const ACCELERATION_BYTES: usize = 12;

/// A recording being written.
pub struct Recorder {
    directory: PathBuf,
    index: File,
    started_unix_s: f64,
    /// Time stamp of the last colour picture written, which may belong to two depth pictures.
    last_colour: Option<u32>,
    rgb: Box<[u8]>,
    depth: Box<[u8]>,
    frames: u64,
}

impl Recorder {
    /// Starts a recording in `directory`, which is created if missing. `started_unix_s` is the wall time of frame time 0, seconds; it
    /// is used in file names only.
    ///
    /// # Errors
    /// If there is a recording already, or the directory cannot be written.
    pub fn create(
        directory: &Path,
        registration: &Registration,
        started_unix_s: f64,
    ) -> Result<Self, RecordingError> {
        let failed = |path: &Path, problem| RecordingError::from_io(path, &problem);
        std::fs::create_dir_all(directory).map_err(|problem| failed(directory, problem))?;
        let path = directory.join(INDEX_NAME);
        let index = File::create_new(&path).map_err(|problem| match problem.kind() {
            std::io::ErrorKind::AlreadyExists => {
                let problem =
                    "already contains a recording; choose another directory (nothing was changed)";
                RecordingError(directory.to_path_buf(), problem.into())
            }
            _ => failed(&path, problem),
        })?;
        let path = directory.join(DEVICE_NAME);
        std::fs::write(&path, device::to_json(registration))
            .map_err(|problem| failed(&path, problem))?;
        Ok(Self {
            directory: directory.to_path_buf(),
            index,
            started_unix_s,
            last_colour: None,
            rgb: vec![0; colour::RGB_BYTES].into_boxed_slice(),
            depth: vec![0; 2 * PIXELS].into_boxed_slice(),
            frames: 0,
        })
    }

    /// Number of frames written.
    pub fn frames(&self) -> u64 {
        self.frames
    }

    /// Adds what the sensor's accelerometer measures, so that a turned sensor's recording says so.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn write_acceleration(&mut self, axes: [i16; 3]) -> Result<(), RecordingError> {
        // In the buffer of depth, which the next frame overwrites.
        let state = &mut self.depth[..ACCELERATION_BYTES];
        state.fill(0);
        for (bytes, axis) in state.as_chunks_mut().0.iter_mut().zip(axes) {
            *bytes = axis.to_le_bytes();
        }
        let name = format!("a-{:.6}-0.dump", self.started_unix_s);
        self.add(&name, "", |recorder| &recorder.depth[..ACCELERATION_BYTES])
    }

    /// Appends a frame.
    ///
    /// # Errors
    /// If a file cannot be written; earlier frames stay usable.
    pub fn write(&mut self, frame: &KinectFrame) -> Result<(), RecordingError> {
        let wall = self.started_unix_s + frame.at.as_us() as f64 * 1e-6;
        if frame.has_colour && self.last_colour != Some(frame.original.colour_ticks) {
            colour::rgb_from_bayer(&frame.original.bayer, &mut self.rgb);
            let name = format!("r-{wall:.6}-{}.ppm", frame.original.colour_ticks);
            self.add(&name, "P6 640 480 255\n", |recorder| &recorder.rgb)?;
            self.last_colour = Some(frame.original.colour_ticks);
        }
        let (depth, _) = self.depth.as_chunks_mut();
        for (bytes, &raw) in depth.iter_mut().zip(frame.depth.iter()) {
            // Larger values are no distance.
            *bytes = raw.min(NO_READING).to_le_bytes();
        }
        let name = format!("d-{wall:.6}-{}.pgm", frame.original.ticks);
        self.add(&name, "P5 640 480 65535\n", |recorder| &recorder.depth)?;
        self.frames += 1;
        Ok(())
    }

    /// Writes the file of a picture and adds its name to the index.
    fn add(
        &mut self,
        name: &str,
        header: &str,
        body: impl Fn(&Self) -> &[u8],
    ) -> Result<(), RecordingError> {
        let path = self.directory.join(name);
        let written = File::create(&path).and_then(|mut file| {
            file.write_all(header.as_bytes())?;
            file.write_all(body(self))
        });
        let line = format!("{name}\n");
        let written = written.and_then(|()| self.index.write_all(line.as_bytes()));
        written.map_err(|problem| {
            // A failure to remove it needs no message of its own.
            std::fs::remove_file(&path).ok();
            RecordingError::from_io(&path, &problem)
        })
    }
}
