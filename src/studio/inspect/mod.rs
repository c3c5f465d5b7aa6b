//! `mien-studio inspect`: a recording, a run's CSV, a face model, a mesh, remembered people or a status file, as one HTML
//! page or one PNG sheet.
//!
//! What PATH is, is seen from the path itself: a directory is a recording, a file that starts like a model or like saved
//! people is one, `.csv` is a run, `.obj` and `.glb` a mesh, `.json` the status of a running `mien`. The page needs nothing but a browser. Nothing is written unless all went well.

pub mod album;
pub mod canvas;
mod learning;
mod mesh;
mod model;
mod ranges;
mod recording;
mod run;

pub(in crate::studio) use recording::{colour_picture, depth_picture, draw_axes};

use std::path::{Path, PathBuf};

use super::bake::glb::GlbError;
use crate::appliance::settings::Settings;
use crate::face_model::{FaceModel, ModelError, file::MAGIC};
use crate::pipeline::PipelineError;
use crate::sensor::recording::{Recording, RecordingError};
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
        "{path} is no run of mien: expected a header with a column {missing}, which `mien run --csv` writes"
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
    #[error(
        "{path}, line {line}: expected OBJ lines `v x y z` and `f a b c` with vertices that were given before, found {found:?}"
    )]
    Mesh {
        /// The path.
        path: PathBuf,
        /// Counted from 1.
        line: usize,
        /// As written.
        found: String,
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
    #[error("{path}: {source}; mien sets such a file aside and starts anew")]
    People {
        /// The path.
        path: PathBuf,
        /// What is wrong.
        source: PeopleError,
    },
    /// JSON of something else.
    #[error("{path} is no status of mien: expected the file that `mien run` writes to status.path")]
    NotAStatus {
        /// The path.
        path: PathBuf,
    },
    /// A directory that is no recording.
    #[error(transparent)]
    Recording(#[from] RecordingError),
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

/// Last part of a path.
fn name_of(path: &Path) -> String {
    path.file_name()
        .unwrap_or(path.as_os_str())
        .to_string_lossy()
        .into_owned()
}

/// Pairs of landmarks that a drawing of a face connects.
pub(in crate::studio) fn face_lines() -> impl Iterator<Item = [usize; 2]> {
    let open = [0..17, 17..22, 22..27, 27..31, 31..36]
        .into_iter()
        .flat_map(|run| (run.start..run.end - 1).map(|i| [i, i + 1]));
    let closed = [36..42, 42..48, 48..60, 60..68]
        .into_iter()
        .flat_map(|run| {
            run.clone()
                .map(move |i| [i, if i + 1 == run.end { run.start } else { i + 1 }])
        });
    open.chain(closed)
}

/// Looks at `path` and shows it. `model` and `settings` are for recordings.
///
/// # Errors
/// If it is of an unknown kind, or broken; the text says where and what to do.
pub fn album(
    path: &Path,
    model: &FaceModel,
    settings: &Settings,
) -> Result<album::Album, InspectError> {
    let unreadable = |source| InspectError::Unreadable {
        path: path.into(),
        source,
    };
    if std::fs::metadata(path).map_err(unreadable)?.is_dir() {
        return recording::inspect(&name_of(path), Recording::open(path)?, model, settings);
    }
    let bytes = crate::base::bounded_read::read(path, crate::studio::text_files::MOST)
        .map_err(unreadable)?;
    let ending = path.extension().unwrap_or_default().to_ascii_lowercase();
    if bytes.starts_with(&MAGIC) || ending == "model" {
        let model = FaceModel::read(&bytes).map_err(|source| InspectError::Model {
            path: path.into(),
            source,
        })?;
        return Ok(model::inspect(&name_of(path), &model, bytes.len()));
    }
    if bytes.starts_with(b"glTF") {
        return mesh::inspect_glb(path, &bytes);
    }
    match (ending.to_str(), std::str::from_utf8(&bytes)) {
        (Some("csv"), Ok(text)) => run::inspect(path, text),
        (Some("obj"), Ok(text)) => mesh::inspect(path, text),
        (_, Ok(text)) if text.starts_with("mien-people") => ranges::people(path, text),
        (Some("json"), Ok(text)) => ranges::status(path, text),
        _ => Err(InspectError::Unknown { path: path.into() }),
    }
}

/// Shows `path` in `out`, by default a page beside where one works, named after it. Returns what was written.
///
/// # Errors
/// As [`album()`], or if the output has another ending than `.html` or `.png` or cannot be written.
pub fn inspect(
    path: &Path,
    out: Option<&Path>,
    model: &FaceModel,
    settings: &Settings,
) -> Result<PathBuf, InspectError> {
    let out = out.map_or_else(
        || PathBuf::from(format!("{}.html", name_of(path))),
        PathBuf::from,
    );
    let ending = out.extension().unwrap_or_default().to_ascii_lowercase();
    if ending != "html" && ending != "png" {
        return Err(InspectError::Ending { path: out });
    }
    let album = album(path, model, settings)?;
    let bytes = if ending == "html" {
        album.html()?.into_bytes()
    } else {
        let mut png = std::io::Cursor::new(Vec::new());
        album.sheet().write_to(&mut png, image::ImageFormat::Png)?;
        png.into_inner()
    };
    std::fs::write(&out, bytes).map_err(|source| InspectError::Unwritable {
        path: out.clone(),
        source,
    })?;
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bad_path_is_one_sentence() {
        let model = FaceModel::default();
        let folder = tempfile::tempdir().unwrap();
        let message = |path: &Path, out: &str| {
            inspect(
                path,
                Some(&folder.path().join(out)),
                &model,
                &Settings::default(),
            )
            .unwrap_err()
            .to_string()
        };
        assert!(
            message(Path::new("/nowhere/x.csv"), "a.html")
                .starts_with("cannot read /nowhere/x.csv")
        );
        assert!(message(folder.path(), "a.html").contains("INDEX.txt"));
        let other = folder.path().join("x.bin");
        std::fs::write(&other, [0, 255, 3]).unwrap();
        assert!(message(&other, "a.html").contains("cannot show"));
        assert!(message(&other, "a.gif").contains(".html or .png"));
        assert!(!folder.path().join("a.html").exists(), "no partial output");
    }

    #[test]
    fn a_run_is_written_in_both_forms() {
        let folder = tempfile::tempdir().unwrap();
        let run = folder.path().join("run.csv");
        std::fs::write(
            &run,
            "frame,time_us,user,state,w_AU25\n0,0,0,tracking,0.5\n1,33333,0,tracking,0.7\n",
        )
        .unwrap();
        for out in ["run.html", "run.png"] {
            let out = folder.path().join(out);
            assert_eq!(
                inspect(
                    &run,
                    Some(&out),
                    &FaceModel::default(),
                    &Settings::default()
                )
                .unwrap(),
                out
            );
            assert!(std::fs::metadata(out).unwrap().len() > 200);
        }
    }
}
