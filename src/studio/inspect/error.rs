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
    /// What is in a file.
    #[error("{path}: {problem}")]
    File {
        /// The path.
        path: PathBuf,
        /// What is wrong.
        problem: Problem,
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
    /// A directory that is no recording.
    #[error(transparent)]
    Recording(#[from] SourceError),
    /// The stages cannot be made of the model and the settings.
    #[error(transparent)]
    Pipeline(#[from] PipelineError),
}

/// What is wrong with a file.
#[derive(Debug, thiserror::Error)]
pub enum Problem {
    /// None of the things that can be shown.
    #[error(
        "cannot show this; expected a recording directory, a run's .csv, a face model, an .obj or .glb mesh, saved people or a status.json"
    )]
    Unknown,
    /// A CSV of something else lacks this column.
    #[error(
        "not a CSV from mien: expected a header with a column {0}, which `mien run --csv` writes"
    )]
    NotARun(&'static str),
    /// A CSV with a header only.
    #[error("a header but no rows; run longer with `mien run --csv`")]
    EmptyRun,
    /// A row of another length.
    #[error(
        "line {line}: expected {expected} cells as in the header, found {found}; is the file cut off?"
    )]
    Row {
        /// Counted from 1.
        line: usize,
        /// Cells of the header.
        expected: usize,
        /// Cells of the row.
        found: usize,
    },
    /// A cell that is no number.
    #[error("line {line}, column {column}: expected a number or nothing, found {found:?}")]
    Cell {
        /// Counted from 1.
        line: usize,
        /// Its name.
        column: String,
        /// As written.
        found: String,
    },
    /// A mesh that is none.
    #[error(transparent)]
    Obj(#[from] ObjError),
    /// A mesh that is none.
    #[error(transparent)]
    Glb(#[from] GlbError),
    /// A face model that is damaged.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// Saved people that are damaged.
    #[error("{0}; mien moves such a file aside and starts over")]
    People(#[from] PeopleError),
    /// JSON of something else.
    #[error("not a status file: expected the file that `mien run` writes to status.path")]
    NotAStatus,
}
