//! Writing a recording, frame by frame. A picture is added to the index only once it is complete; one that cannot be written
//! is removed again. Colour is stored demosaiced, from which the mosaic comes back exactly, so that depth and luma replay
//! bit for bit.

use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};

use super::device;
use crate::NO_DEPTH;
use crate::kinect::colour;
use crate::kinect::frame::KinectFrame;
use crate::kinect::registration::Registration;
use crate::picture_file::RecordingError;
use mien_stages::base::capacity::PIXELS;

/// Name of the file that lists a recording's pictures.
pub(super) const INDEX_NAME: &str = "INDEX.txt";
/// Name of the file with the sensor's calibration.
pub(super) const DEVICE_NAME: &str = "device.json";

/// A recording that is being made.
pub struct Recorder {
    directory: PathBuf,
    index: File,
    started_unix_s: f64,
    /// Colour pictures may serve two depth pictures: the last one written.
    last_colour: Option<u32>,
    rgb: Box<[u8]>,
    depth: Box<[u8]>,
    frames: u64,
}

impl Recorder {
    /// Starts a recording in `directory`, which is made if it is not there. `started_unix_s` is the wall time of frame
    /// time 0, in seconds; it goes into the names of the files and nowhere else.
    ///
    /// # Errors
    /// If there is a recording already, or the directory cannot be written.
    pub fn create(
        directory: &Path,
        registration: &Registration,
        started_unix_s: f64,
    ) -> Result<Self, RecordingError> {
        let failed = |path: &Path, problem| RecordingError::of_file(path, &problem);
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

    /// Frames written.
    pub fn frames(&self) -> u64 {
        self.frames
    }

    /// Appends a frame.
    ///
    /// # Errors
    /// If a file cannot be written; what was recorded before stays usable.
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
            // Whatever else has no distance either.
            *bytes = raw.min(NO_DEPTH).to_le_bytes();
        }
        let name = format!("d-{wall:.6}-{}.pgm", frame.original.ticks);
        self.add(&name, "P5 640 480 65535\n", |recorder| &recorder.depth)?;
        self.frames += 1;
        Ok(())
    }

    /// Writes a picture, and its name into the index.
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
            // Not being able to remove it adds nothing to what the user must already do.
            std::fs::remove_file(&path).ok();
            RecordingError::of_file(&path, &problem)
        })
    }
}
