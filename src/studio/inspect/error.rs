//! Errors of `mien-studio inspect`.

use std::path::PathBuf;

use crate::appliance::source::SourceError;
use crate::face_model::ModelError;
use crate::pipeline::PipelineError;
use crate::studio::bake::glb::GlbError;
use crate::studio::bake::obj::ObjError;
use crate::users::saved::PeopleError;

/// Why nothing could be shown.
#[derive(Debug, thiserror::Error)]
pub enum InspectError {
    /// Not there, or not readable.
    #[error(
        "cannot read {path}: {source}; expected a recording directory, a run's .csv, a face model, an .obj or .glb mesh, saved people or a status.json"
    )]
    Unreadable {
        /// The path.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// None of the things that can be shown.
    #[error(
        "cannot show {path}; expected a recording directory, a run's .csv, a face model, an .obj or .glb mesh, saved people or a status.json"
    )]
    Unknown {
        /// The path.
        path: PathBuf,
    },
    /// The output has no known ending.
    #[error("cannot write {path}: expected a name that ends in .html or .png")]
    Ending {
        /// The path.
        path: PathBuf,
    },
    /// The output cannot be written.
    #[error("cannot write {path}: {source}; choose another place with --out")]
    Unwritable {
        /// The path.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A picture cannot be encoded.
    #[error("cannot encode a picture: {0}")]
    Picture(#[from] image::ImageError),
    /// A CSV of something else.
    #[error(
        "{path} is not a CSV from mien: expected a header with a column {missing}, which `mien run --csv` writes"
    )]
    NotARun {
        /// The path.
        path: PathBuf,
        /// The column.
        missing: &'static str,
    },
    /// A CSV with a header only.
    #[error("{path} has a header but no rows; run longer with `mien run --csv`")]
    EmptyRun {
        /// The path.
        path: PathBuf,
    },
    /// A row of another length.
    #[error(
        "{path}, line {line}: expected {expected} cells as in the header, found {found}; is the file cut off?"
    )]
    Row {
        /// The path.
        path: PathBuf,
        /// Counted from 1.
        line: usize,
        /// Cells of the header.
        expected: usize,
        /// Cells of the row.
        found: usize,
    },
    /// A cell that is no number.
    #[error("{path}, line {line}, column {column}: expected a number or nothing, found {found:?}")]
    Cell {
        /// The path.
        path: PathBuf,
        /// Counted from 1.
        line: usize,
        /// Its name.
        column: String,
        /// As written.
        found: String,
    },
    /// A mesh that is none.
    #[error("{path}: {source}")]
    Mesh {
        /// The path.
        path: PathBuf,
        /// Where and what.
        source: ObjError,
    },
    /// A mesh that is none.
    #[error("{path}: {source}")]
    Glb {
        /// The path.
        path: PathBuf,
        /// What is wrong.
        source: GlbError,
    },
    /// Saved people that are damaged.
    #[error("{path}: {source}; mien moves such a file aside and starts over")]
    People {
        /// The path.
        path: PathBuf,
        /// What is wrong.
        source: PeopleError,
    },
    /// JSON of something else.
    #[error(
        "{path} is not a status file of mien: expected the file that `mien run` writes to status.path"
    )]
    NotAStatus {
        /// The path.
        path: PathBuf,
    },
    /// A directory that is no recording.
    #[error(transparent)]
    Recording(#[from] SourceError),
    /// A model that cannot be read.
    #[error("{path}: {source}")]
    Model {
        /// The path.
        path: PathBuf,
        /// What is wrong with it.
        source: ModelError,
    },
    /// The stages cannot be made of the model and the settings.
    #[error(transparent)]
    Pipeline(#[from] PipelineError),
}
