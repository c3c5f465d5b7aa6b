//! What reading and writing a recording share: the names of its files, and why one cannot be opened or written.

use std::path::PathBuf;

/// Name of the file that lists a recording's pictures.
pub(super) const INDEX_NAME: &str = "INDEX.txt";
/// Name of the file with the sensor's calibration.
pub(super) const DEVICE_NAME: &str = "device.json";

/// Why a recording cannot be opened or written.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// No directory, or no index in it.
    #[error("{}: no recording there ({kind}); a recording is a directory with INDEX.txt and the files it names", path.display())]
    NoIndex {
        /// The index looked for.
        path: PathBuf,
        /// What the system said.
        kind: std::io::ErrorKind,
    },
    /// An index without depth pictures.
    #[error("{}: names no depth picture, expected lines like d-1700000000.033333-2000000.pgm; is the recording complete?", path.display())]
    NoDepth {
        /// The index.
        path: PathBuf,
    },
    /// The calibration is there but unusable.
    #[error("{}: {problem}; correct it, or remove the file to use the nominal calibration", path.display())]
    Device {
        /// The file.
        path: PathBuf,
        /// What is wrong, and where.
        problem: String,
    },
    /// The place to record to is taken.
    #[error("{}: holds a recording already; choose another directory, nothing was changed", path.display())]
    Exists {
        /// The directory.
        path: PathBuf,
    },
    /// A file cannot be read or written.
    #[error("{}: {source}; check the path, its permissions and the space left", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
}
