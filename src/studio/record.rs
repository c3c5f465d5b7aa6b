//! `mien-studio record`: a recording from the sensor or the simulator.

use std::path::Path;

use crate::appliance::source::{Source, SourceError};
use crate::sensor::Frame;
use crate::sensor::recording::{Recorder, RecordingError};

/// Why nothing was recorded.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// The directory.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// The source.
    #[error(transparent)]
    Source(#[from] SourceError),
}

/// Records `seconds` of a source into a directory; the number of frames. `started_unix_s` goes into the file names.
///
/// # Errors
/// If the directory cannot be written or the source fails.
pub fn record(
    source: &mut Source,
    out: &Path,
    seconds: f64,
    started_unix_s: f64,
) -> Result<u64, RecordError> {
    let mut recorder = Recorder::create(out, source.registration(), started_unix_s)?;
    let mut frame = Frame::default();
    while source.next_frame(&mut frame)? && (frame.at.as_us() as f64) < seconds * 1e6 {
        recorder.write(&frame)?;
    }
    Ok(recorder.frames())
}
