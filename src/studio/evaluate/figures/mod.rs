//! The paper's figures and tables, drawn again: its own system beside the default, on people and heads whose licences allow pictures.
//!
//! | figure | of the paper | what it shows |
//! | --- | --- | --- |
//! | `shapes` | Fig. 2 | 2D tracks with noise and gaps, and the 3D shapes that structure from motion makes of 150 of them |
//! | `hand` | Fig. 14 | points under a hand over the mouth |
//! | `time` | Table 1, Figs. 15, 16 | time of each of 1000 frames in which two users swap |
//! | `influence` | Fig. 17 | a sculpted shape, plain Laplacian, Procedure 1 as printed, and what `bake` makes |
//! | `poses` | Fig. 18 | points and axes at the ends of ±25° and ±15° |
//! | `weights` | | weights over time against what is acted |
//! | `errors` | | the weights' error by light, covered share, yaw and pitch |
//!
//! People are of the test split. Times are of the thread's processor, so that what else the machine does hardly shows.
//!
//! ```text
//! subjects          people, the two systems, and where pictures go
//! curves            time, weights, errors: numbers over time and conditions
//! meshes            shapes, influence: structure from motion, and baking
//! views             hand, poses: what the sensor sees
//! pictures          parts of pictures that several figures have
//! error             why a figure cannot be drawn
//! ```

mod curves;
mod error;
mod meshes;
mod pictures;
mod subjects;
mod views;

pub use error::FiguresError;

use std::path::Path;

use crate::appliance::settings::Settings;
use crate::face_model::FaceModel;
use crate::studio::heads::textured_heads;
use crate::studio::people_split::Split;
use subjects::Studio;

/// Names of the figures.
pub const FIGURES: [&str; 7] = [
    "shapes",
    "hand",
    "time",
    "influence",
    "poses",
    "weights",
    "errors",
];

/// Draws the figures named in `only`, all if empty, as PNG into the folder `out`; `say` gets what was written and measured.
/// `settings` are the paper's, `seconds` is the length of a session.
///
/// # Errors
/// If data is missing or a picture cannot be written.
pub fn draw(
    data: &Path,
    model: &FaceModel,
    settings: &Settings,
    (people, seconds): (usize, f64),
    out: &Path,
    only: &[String],
    say: &mut dyn FnMut(&str),
) -> Result<(), FiguresError> {
    std::fs::create_dir_all(out).map_err(|source| FiguresError::Folder {
        path: out.into(),
        source,
    })?;
    let wanted = |name: &str| only.is_empty() || only.iter().any(|one| one == name);
    let mut studio = Studio {
        data,
        out,
        heads: Vec::new(),
        model,
        settings: [
            ("paper", settings.clone()),
            ("default", Settings::default()),
        ],
        seconds,
    };
    if FIGURES
        .iter()
        .any(|name| *name != "influence" && wanted(name))
    {
        let mut heads = textured_heads(data, |person| Split::of(person) == Split::Test)?;
        heads.truncate(people.max(1));
        if heads.is_empty() {
            return Err(FiguresError::Nobody(data.display().to_string()));
        }
        studio.heads = heads;
    }
    type Figure = fn(&Studio<'_>, &mut dyn FnMut(&str)) -> Result<(), FiguresError>;
    let figures: [Figure; FIGURES.len()] = [
        meshes::shapes,
        views::hand,
        curves::time,
        meshes::influence,
        views::poses,
        curves::weights,
        curves::errors,
    ];
    for (name, figure) in FIGURES.iter().zip(figures) {
        if wanted(name) {
            figure(&studio, say)?;
        }
    }
    Ok(())
}
