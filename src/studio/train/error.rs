//! Why training cannot be done: one sentence each.

use std::path::PathBuf;

use super::dataset::DatasetError;
use crate::appliance::source::SourceError;
use crate::face_model::ModelError;
use crate::pipeline::PipelineError;
use crate::studio::heads::HeadsError;
use crate::studio::heads::ict::IctError;
use crate::studio::nrsfm;

/// Why training cannot be done.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    /// The pictures.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// The head set.
    #[error(transparent)]
    Head(#[from] IctError),
    /// The drawn heads.
    #[error(transparent)]
    Drawn(#[from] HeadsError),
    /// The 3D shape of the paper's model.
    #[error(transparent)]
    Nrsfm(#[from] nrsfm::Error),
    /// Too little to learn from.
    #[error(
        "expected at least {expected} annotated pictures to train on, found {found}; give more folders with --images"
    )]
    TooFew {
        /// Least number.
        expected: usize,
        /// Number there.
        found: usize,
    },
    /// A recording.
    #[error(transparent)]
    Recording(#[from] SourceError),
    /// The stages that follow it.
    #[error(transparent)]
    Pipeline(#[from] PipelineError),
    /// Too little of a face in it.
    #[error(
        "expected at least {expected} frames with one face tracked confidently, found {found}; record longer, close to the sensor and facing it"
    )]
    TooShort {
        /// Least number.
        expected: usize,
        /// Number there.
        found: usize,
    },
    /// No model.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// A file cannot be read.
    #[error("cannot read {path}: {source}; expected a face model, such as config/face.model")]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A file cannot be written.
    #[error("cannot write {path}: {source}; give another place with --out")]
    Unwritable {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
}
