//! Why nothing was baked: one sentence each.

use std::path::{Path, PathBuf};

use super::head::HeadError;
use super::sparse::Singular;

/// Why nothing was baked.
#[derive(Debug, thiserror::Error)]
pub enum BakeError {
    /// A file cannot be read.
    #[error("cannot read {path}: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A file cannot be written.
    #[error("cannot write {path}: {source}")]
    Write {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A mesh or a recipe is damaged, or of a kind that cannot be baked.
    #[error("{path}: {source}")]
    Content {
        /// The file.
        path: PathBuf,
        /// Where and what.
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    /// A line of the landmarks or of the controls.
    #[error("{path}: line {line}: expected {expected}, found {found:?}")]
    Line {
        /// The file.
        path: PathBuf,
        /// Counted from 1.
        line: usize,
        /// What should be there.
        expected: &'static str,
        /// The line, or its beginning.
        found: String,
    },
    /// A sculpted shape of one side without the other side's.
    #[error("expected every one-sided shape with its other side, found {found} alone")]
    Alone {
        /// The shape.
        found: String,
    },
    /// Nothing like a face is seen.
    #[error(
        "{mesh}: expected a face, found none with more than {confidence:.2} confidence ({picture} shows what was seen); place the points with: mien-studio place --mesh {mesh}"
    )]
    Unseen {
        /// The mesh.
        mesh: PathBuf,
        /// The best there was.
        confidence: f32,
        /// What that looked like.
        picture: PathBuf,
    },
    /// The head does not fit its landmarks.
    #[error(transparent)]
    Head(#[from] HeadError),
    /// The unit cannot be told.
    #[error(
        "the inner eye corners are {found} units apart, which is no head in mm, cm or m (2 to 6 cm); say which with --unit mm|cm|m or scale the mesh"
    )]
    Scale {
        /// Distance in mesh units.
        found: f64,
    },
    /// More than this program makes room for.
    #[error(
        "{shapes} shapes of {vertices} vertices would take {bytes} bytes, expected at most {most}; bake fewer shapes or a coarser mesh"
    )]
    Large {
        /// How many shapes.
        shapes: usize,
        /// Vertices of the mesh.
        vertices: usize,
        /// Bytes they take.
        bytes: usize,
        /// Bytes there may be.
        most: usize,
    },
    /// A system could not be solved.
    #[error(transparent)]
    Singular(#[from] Singular),
}

impl BakeError {
    /// What is wrong with the contents of a file.
    pub(in crate::studio) fn of<E>(path: impl AsRef<Path>) -> impl Fn(E) -> Self
    where
        E: Into<Box<dyn std::error::Error + Send + Sync>>,
    {
        let path = path.as_ref().to_owned();
        move |source| Self::Content {
            path: path.clone(),
            source: source.into(),
        }
    }
}
