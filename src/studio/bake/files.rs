//! Files in and out: bounded, decoded, and written whole or not at all.

use std::path::Path;

use super::error::BakeError;
use crate::base::bounded_read;
use crate::studio::{atomic_write, text_files};

pub(super) fn read_bytes(path: &Path) -> Result<Vec<u8>, BakeError> {
    bounded_read::read(path, text_files::MOST).map_err(|source| BakeError::Read {
        path: path.into(),
        source,
    })
}

pub(super) fn read(path: &Path) -> Result<String, BakeError> {
    Ok(text_files::decoded(&read_bytes(path)?))
}

/// Writes a file whole or not at all.
pub(crate) fn write(path: &Path, bytes: &[u8]) -> Result<(), BakeError> {
    atomic_write::write(path, bytes).map_err(|source| BakeError::Write {
        path: path.into(),
        source,
    })
}
