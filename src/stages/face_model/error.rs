//! Errors of reading a model file.

use crate::base::prelude::*;

/// Why a model file is rejected.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ModelError {
    /// Not a model: the first bytes found.
    #[error(
        "expected a face model (first bytes \"MIENFACE\"), found {0:?}; use a file written by `mien-studio train`"
    )]
    NotAModel(Vec<u8>),
    /// Unsupported version: the expected one, and the file's.
    #[error(
        "expected a face model of version {0}, found version {1}; train it again, or convert one of version 3 with `mien-studio train --round FILE`"
    )]
    Version(u32, u32),
    /// Wrong length: bytes by the header, and bytes found.
    #[error("expected a face model of {0} bytes, found {1}; copy the file again")]
    Length(u64, u64),
    /// Wrong checksum: by the file, and of its bytes.
    #[error(
        "expected face model checksum {0:08x}, found {1:08x}: the file is damaged; copy it again"
    )]
    Damaged(u32, u32),
    /// A section is missing: its tag.
    #[error(
        "expected a section {0} in the face model, found none; train it again with this mien-studio"
    )]
    Missing(&'static str),
    /// A section has an invalid value: its tag, the expectation, and the value found.
    #[error(
        "section {0} of the face model: expected {1}, found {2}; train it again with this mien-studio"
    )]
    Malformed(&'static str, &'static str, f64),
}
