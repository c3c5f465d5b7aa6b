//! Files in and out: bounded, decoded, and written whole or not at all.

use std::path::Path;

use super::error::BakeError;
use crate::base::bounded_read;
use crate::studio::text_files;

pub(super) fn read_bytes(path: &Path) -> Result<Vec<u8>, BakeError> {
    bounded_read::read(path, text_files::MOST).map_err(|source| BakeError::Read {
        path: path.into(),
        source,
    })
}

pub(super) fn read(path: &Path) -> Result<String, BakeError> {
    Ok(text_files::decoded(&read_bytes(path)?))
}

/// Writes through a temporary neighbour, so that no half file is left behind.
pub(crate) fn write(path: &Path, bytes: &[u8]) -> Result<(), BakeError> {
    let failed = |source| BakeError::Write {
        path: path.into(),
        source,
    };
    let mut name = path.file_name().unwrap_or_default().to_os_string();
    name.push(".part");
    let part = path.with_file_name(name);
    std::fs::write(&part, bytes)
        .and_then(|()| std::fs::rename(&part, path))
        .inspect_err(|_| {
            let _ = std::fs::remove_file(&part);
        })
        .map_err(failed)
}
