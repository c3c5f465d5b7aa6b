//! Why a figure cannot be drawn: one sentence each.

use std::path::PathBuf;

use crate::pipeline::PipelineError;
use crate::studio::bake::error::BakeError;
use crate::studio::bake::head::HeadError;
use crate::studio::bake::sparse::Singular;
use crate::studio::heads::HeadsError;
use crate::studio::nrsfm;

/// Why a figure cannot be drawn.
#[derive(Debug, thiserror::Error)]
pub enum FiguresError {
    /// The people.
    #[error(transparent)]
    Heads(#[from] HeadsError),
    /// The stages.
    #[error(transparent)]
    Pipeline(#[from] PipelineError),
    /// The shapes.
    #[error(transparent)]
    Shapes(#[from] nrsfm::Error),
    /// The sculpted head.
    #[error(transparent)]
    Sculpted(#[from] BakeError),
    /// Its landmarks.
    #[error(transparent)]
    Head(#[from] HeadError),
    /// Its equations.
    #[error(transparent)]
    Equations(#[from] Singular),
    /// Nobody to draw.
    #[error("no held-out people in {0}; expected annotated portraits in faces_frl189")]
    Nobody(String),
    /// A picture cannot be written.
    #[error("cannot write {path}: {source}; give another folder with --figures")]
    Unwritable {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: image::ImageError,
    },
    /// The folder cannot be made.
    #[error("cannot make {path}: {source}; give another folder with --figures")]
    Folder {
        /// The folder.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
}
