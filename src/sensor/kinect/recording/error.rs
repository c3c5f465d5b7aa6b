//! What reading and writing a recording share: the names of its files, and why one cannot be opened or written.

use std::path::PathBuf;

/// Name of the file that lists a recording's pictures.
pub(super) const INDEX_NAME: &str = "INDEX.txt";
/// Name of the file with the sensor's calibration.
pub(super) const DEVICE_NAME: &str = "device.json";

/// Why a recording cannot be opened or written.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// No directory, or no index in it: what was looked for.
    #[error("{}: no recording there ({}); a recording is a directory with INDEX.txt and the files it names", .0.display(), .1)]
    NoIndex(PathBuf, std::io::ErrorKind),
    /// An index without depth pictures.
    #[error("{}: names no depth picture, expected lines like d-1700000000.033333-2000000.pgm; is the recording complete?", .0.display())]
    NoDepth(PathBuf),
    /// The calibration is there but unusable: what is wrong with it, and where.
    #[error("{}: {}; correct it, or remove the file to use the nominal calibration", .0.display(), .1)]
    Device(PathBuf, String),
    /// The place to record to is taken.
    #[error("{}: holds a recording already; choose another directory, nothing was changed", .0.display())]
    Exists(PathBuf),
    /// A file cannot be read or written.
    #[error("{}: {}; check the path, its permissions and the space left", .0.display(), .1)]
    File(PathBuf, std::io::Error),
}
