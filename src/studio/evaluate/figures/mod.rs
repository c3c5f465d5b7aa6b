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

mod curves;
mod meshes;
mod views;

use std::path::{Path, PathBuf};

use image::RgbImage;

use crate::appliance::settings::Settings;
use crate::face_model::FaceModel;
use crate::landmarks::Landmarks;
use crate::pipeline::{Pipeline, PipelineError};
use crate::sensor::Frame;
use crate::simulator::virtual_head::Simulator;
use crate::studio::bake::benchmark::BenchmarkError;
use crate::studio::bake::head::HeadError;
use crate::studio::bake::sparse::Singular;
use crate::studio::heads::{HeadsError, PersonHead, textured_heads};
use crate::studio::inspect::canvas;
use crate::studio::nrsfm;
use crate::studio::people_split::Split;

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
    Sculpted(#[from] BenchmarkError),
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

/// What figures are drawn of.
struct Studio<'a> {
    data: &'a Path,
    out: &'a Path,
    heads: Vec<PersonHead>,
    model: &'a FaceModel,
    /// The paper's system and the default.
    settings: [(&'static str, Settings); 2],
    seconds: f64,
}

impl Studio<'_> {
    /// The system of the paper and the default before the same sensor.
    fn pipelines(
        &self,
        simulator: &Simulator,
    ) -> Result<Vec<(&'static str, Pipeline)>, FiguresError> {
        let of = |(name, settings): &(&'static str, Settings)| {
            let registration = simulator.camera().registration();
            Ok((
                *name,
                Pipeline::new(&settings.stages(), registration, self.model)?,
            ))
        };
        self.settings.iter().map(of).collect()
    }

    /// Writes a picture, as small as PNG gets where noise is nothing to keep: the two lowest bits go.
    fn save(&self, name: &str, picture: &RgbImage) -> Result<String, FiguresError> {
        use image::codecs::png::{CompressionType, FilterType, PngEncoder};
        let path = self.out.join(name).with_extension("png");
        let unwritable = |source| FiguresError::Unwritable {
            path: path.clone(),
            source,
        };
        let mut picture = picture.clone();
        picture.iter_mut().for_each(|v| *v = *v & 0xfc | *v >> 6);
        let file = std::fs::File::create(&path).map_err(|error| unwritable(error.into()))?;
        let encoder =
            PngEncoder::new_with_quality(file, CompressionType::Best, FilterType::Adaptive);
        picture.write_with_encoder(encoder).map_err(unwritable)?;
        Ok(format!("wrote {}", path.display()))
    }
}

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

/// The colour picture around a place (pixels), half as large again, with what is drawn on it.
fn crop(
    frame: &Frame,
    middle: [f32; 2],
    half: [u32; 2],
    draw: impl Fn(&mut RgbImage, &dyn Fn([f32; 2]) -> [f32; 2]),
) -> RgbImage {
    const TIMES: f32 = 1.5;
    let whole = crate::studio::inspect::colour_picture(frame);
    let corner = [0, 1].map(|k| {
        let most = [whole.width(), whole.height()][k].saturating_sub(2 * half[k]);
        (middle[k].max(0.0) as u32)
            .saturating_sub(half[k])
            .min(most)
    });
    let part = image::imageops::crop_imm(&whole, corner[0], corner[1], 2 * half[0], 2 * half[1]);
    let filter = image::imageops::FilterType::Triangle;
    let [width, height] = half.map(|h| (2.0 * TIMES * h as f32) as u32);
    let mut picture = image::imageops::resize(&part.to_image(), width, height, filter);
    let place = |[x, y]: [f32; 2]| {
        [x - corner[0] as f32, y - corner[1] as f32].map(|v| (v + 0.5) * TIMES - 0.5)
    };
    draw(&mut picture, &place);
    picture
}

/// The lines of a face and its points, red where they are doubted.
fn draw_points(picture: &mut RgbImage, found: &Landmarks, place: &dyn Fn([f32; 2]) -> [f32; 2]) {
    let points = found.pixels.map(place);
    for [a, b] in crate::studio::inspect::face_lines() {
        canvas::line(picture, points[a], points[b], [0, 190, 255]);
    }
    for ([x, y], confidence) in points.iter().zip(found.point_confidence) {
        let strong = (confidence.clamp(0.0, 1.0) * 255.0) as u8;
        canvas::square(picture, *x, *y, 1, [255 - strong, strong, 0]);
    }
}

/// Words on a dark strip at the top of a picture.
fn title(picture: &mut RgbImage, words: &str) {
    for y in 0..18.min(picture.height()) {
        for x in 0..picture.width() {
            picture.put_pixel(x, y, image::Rgb([30; 3]));
        }
    }
    canvas::text(picture, 6, 4, 2, words, [255; 3]);
}
