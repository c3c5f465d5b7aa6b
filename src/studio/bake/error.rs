//! Why nothing was baked: one sentence each.

use std::path::PathBuf;

use super::benchmark::BenchmarkError;
use super::glb::GlbError;
use super::head::HeadError;
use super::learn::LearnError;
use super::locate::LocateError;
use super::obj::ObjError;
use super::recipe::RecipeError;
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
    /// The sculpted shapes cannot be read.
    #[error(transparent)]
    Sculpted(#[from] BenchmarkError),
    /// Nothing can be learned from them.
    #[error(transparent)]
    Learn(#[from] LearnError),
    /// A file cannot be written.
    #[error("cannot write {path}: {source}")]
    Write {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The mesh text is damaged.
    #[error("{path}: {source}")]
    Obj {
        /// The file.
        path: PathBuf,
        /// Where and what.
        source: ObjError,
    },
    /// The glTF file is damaged or of a kind that cannot be baked onto.
    #[error("{path}: {source}")]
    Glb {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        source: GlbError,
    },
    /// The landmarks are not numbers.
    #[error("{path}: line {line}: expected a vertex number, found {found:?}")]
    Landmarks {
        /// The file.
        path: PathBuf,
        /// Counted from 1.
        line: usize,
        /// The line.
        found: String,
    },
    /// No landmarks on the mesh.
    #[error("{path}: {source}")]
    Locate {
        /// The mesh.
        path: PathBuf,
        /// Why.
        source: LocateError,
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
    /// The recipe is damaged.
    #[error("{path}: {source}")]
    Recipe {
        /// The file.
        path: PathBuf,
        /// Where and what.
        source: RecipeError,
    },
    /// The controls are damaged.
    #[error("{path}: line {line}: expected {expected}, found {found:?}")]
    Controls {
        /// The file.
        path: PathBuf,
        /// Counted from 1.
        line: usize,
        /// What should be there.
        expected: &'static str,
        /// The line.
        found: String,
    },
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
