//! What can be wrong with a model file.

use crate::base::prelude::*;

/// Why a file is no usable model.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ModelError {
    /// Not a model at all.
    #[error(
        "expected a face model (first bytes \"MIENFACE\"), found {0:?}; give a file written by `mien-studio train`"
    )]
    NotAModel(Vec<u8>),
    /// Another version of the format.
    #[error(
        "expected a face model of version {expected}, found version {found}; train it again with this mien-studio"
    )]
    Version {
        /// What this program reads.
        expected: u32,
        /// What the file says.
        found: u32,
    },
    /// Too short or too long.
    #[error("expected a face model of {expected} bytes, found {found}; copy the file again")]
    Length {
        /// What the header says.
        expected: u64,
        /// What is there.
        found: u64,
    },
    /// A byte is wrong.
    #[error(
        "expected face model checksum {expected:08x}, found {found:08x}: the file is damaged; copy it again"
    )]
    Damaged {
        /// What the file says.
        expected: u32,
        /// What its bytes give.
        found: u32,
    },
    /// A section is not there.
    #[error(
        "expected a section {0} in the face model, found none; train it again with this mien-studio"
    )]
    Missing(&'static str),
    /// A section says something impossible.
    #[error(
        "section {section} of the face model: expected {expected}, found {found}; train it again with this mien-studio"
    )]
    Malformed {
        /// Tag of the section.
        section: &'static str,
        /// What should be there.
        expected: &'static str,
        /// What is there.
        found: f64,
    },
}
