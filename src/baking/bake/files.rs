//! Files in and out: bounded, decoded, and written whole or not at all.

use std::path::Path;

use mien_stages::base::bounded_read;
use mien_workbench::fault::Fault;
use mien_workbench::{atomic_write, text_files};

/// A whole file.
///
/// # Errors
/// If it cannot be read, or is too large.
pub fn read_bytes(path: &Path) -> Result<Vec<u8>, Fault> {
    bounded_read::read(path, text_files::MAX_BYTES).map_err(Fault::cannot("read", path, ""))
}

/// The text of a file, in any of the encodings that text files have.
///
/// # Errors
/// If it cannot be read, or is too large.
pub fn read(path: &Path) -> Result<String, Fault> {
    Ok(text_files::decoded(&read_bytes(path)?))
}

/// Writes a file whole or not at all.
///
/// # Errors
/// If it cannot be written.
pub fn write(path: &Path, bytes: &[u8]) -> Result<(), Fault> {
    atomic_write::write(path, bytes).map_err(Fault::cannot("write", path, ""))
}
