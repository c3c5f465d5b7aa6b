//! Files in and out: bounded, decoded, and written whole or not at all.

use std::path::Path;

use crate::base::bounded_read;
use crate::studio::fault::Fault;
use crate::studio::{atomic_write, text_files};

pub(in crate::studio) fn read_bytes(path: &Path) -> Result<Vec<u8>, Fault> {
    bounded_read::read(path, text_files::MOST).map_err(Fault::cannot("read", path, ""))
}

pub(in crate::studio) fn read(path: &Path) -> Result<String, Fault> {
    Ok(text_files::decoded(&read_bytes(path)?))
}

/// Writes a file whole or not at all.
pub(crate) fn write(path: &Path, bytes: &[u8]) -> Result<(), Fault> {
    atomic_write::write(path, bytes).map_err(Fault::cannot("write", path, ""))
}
