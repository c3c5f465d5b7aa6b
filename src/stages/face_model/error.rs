//! What can be wrong with a model file.

use crate::base::prelude::*;

/// Why a file is no usable model.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ModelError {
    /// Not a model at all.
    #[error(
        "expected a face model (first bytes \"MIENFACE\"), found {0:?}; use a file written by `mien-studio train`"
    )]
    NotAModel(Vec<u8>),
    /// Another version of the format: the one this program reads, and the file's.
    #[error(
        "expected a face model of version {0}, found version {1}; train it again with this mien-studio"
    )]
    Version(u32, u32),
    /// Too short or too long: bytes by the header, and bytes there.
    #[error("expected a face model of {0} bytes, found {1}; copy the file again")]
    Length(u64, u64),
    /// A byte is wrong: checksum by the file, and of its bytes.
    #[error(
        "expected face model checksum {0:08x}, found {1:08x}: the file is damaged; copy it again"
    )]
    Damaged(u32, u32),
    /// A section is not there.
    #[error(
        "expected a section {0} in the face model, found none; train it again with this mien-studio"
    )]
    Missing(&'static str),
    /// A section says something impossible: its tag, what should be there, and what is.
    #[error(
        "section {0} of the face model: expected {1}, found {2}; train it again with this mien-studio"
    )]
    Malformed(&'static str, &'static str, f64),
}
