//! Why shapes cannot be recovered: one sentence each.

use std::path::{Path, PathBuf};

/// Why shapes cannot be recovered.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A file cannot be read.
    #[error("cannot read {}: {source}; give a CSV file of tracks", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// A field is no finite number.
    #[error(
        "line {line}, column {column}: expected a number, found `{found}`; leave a missing point empty or write nan"
    )]
    NotANumber {
        /// From 1.
        line: usize,
        /// From 1.
        column: usize,
        /// The start of the field.
        found: String,
    },
    /// A row of another length.
    #[error(
        "line {line}: expected {expected} columns as in the first line, found {found}; write one column per point"
    )]
    Uneven {
        /// From 1.
        line: usize,
        /// Columns of the first row.
        expected: usize,
        /// Columns of this row.
        found: usize,
    },
    /// Rows that make no whole frames.
    #[error(
        "expected a multiple of {multiple} rows, found {rows} rows; write {multiple} rows per frame, without a header"
    )]
    RowCount {
        /// Rows found.
        rows: usize,
        /// 2 for tracks, 3 for shapes.
        multiple: usize,
    },
    /// Not enough to recover anything from.
    #[error(
        "expected at least 4 frames of at least 4 points, found {frames} frames of {points} points; track longer"
    )]
    TooSmall {
        /// Frames found.
        frames: usize,
        /// Points found.
        points: usize,
    },
    /// A point without enough sightings.
    #[error(
        "column {column}: expected the point in at least 3 frames, found it in {sightings}; leave the column out"
    )]
    Unseen {
        /// From 1.
        column: usize,
        /// Frames in which it is seen.
        sightings: usize,
    },
    /// A file cannot be written.
    #[error("cannot write {}: {source}; choose another --out", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// Truth of another size than the tracks.
    #[error(
        "expected truth of {frames} frames and {points} points as in the tracks, found {found_frames} of {found_points}; give the shapes of the same sequence"
    )]
    TruthSize {
        /// Frames of the tracks.
        frames: usize,
        /// Points of the tracks.
        points: usize,
        /// Frames of the truth.
        found_frames: usize,
        /// Points of the truth.
        found_points: usize,
    },
    /// A reference of another number of points than the tracks.
    #[error(
        "expected tracks of the reference's {expected} points, found {found}; track the same landmarks"
    )]
    PointCount {
        /// Points of the reference.
        expected: usize,
        /// Points of the tracks.
        found: usize,
    },
    /// What went wrong, and in which file.
    #[error("{}: {error}", path.display())]
    Within {
        /// The file.
        path: PathBuf,
        /// What is wrong in it.
        error: Box<Error>,
    },
}

impl Error {
    pub(super) fn within(self, path: &Path) -> Self {
        Self::Within {
            path: path.to_owned(),
            error: Box::new(self),
        }
    }
}
