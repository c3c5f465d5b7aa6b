//! The files of a recording.

use std::fs::File;
use std::path::Path;

/// Name of the file that lists a recording's pictures.
pub(super) const INDEX_NAME: &str = "INDEX.txt";

/// Name of the file with the sensor's calibration.
pub(super) const DEVICE_NAME: &str = "device.json";

/// The file at `path`, if it is one: what a pipe would give is not waited for.
pub(super) fn open_file(path: &Path) -> std::io::Result<File> {
    if !std::fs::metadata(path)?.is_file() {
        return Err(std::io::Error::other("not a regular file"));
    }
    File::open(path)
}
