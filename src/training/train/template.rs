//! The template of a face for the search in whole images. It is a linear discriminant (Fisher 1936) on histograms of oriented gradients,
//! between rendered faces and windows without a face; these come from the same renderings and from the portraits.
//!
//! Faces are rendered as for the cascade, with yaw up to [`YAW_RAD`] and roll up to [`ROLL_RAD`], and shifted by up to half a step of the
//! search grid.

use std::path::Path;

use image::GrayImage;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::args::TrainArgs;
use super::render::{Renderer, TrainingSample};
use super::samples::TruePicture;
use mien_stages::base::geometry::{Point, Rigid, Vector};
use mien_stages::camera::Camera;
use mien_stages::face_model::{FaceModel, FaceTemplate, ORIENTATIONS, ShapeModel, TEMPLATE_CELLS};
use mien_stages::landmarks::face_search::{
    CELL, Cells, TEMPLATE_ORIGIN, TEMPLATE_PIXELS_PER_METRE,
};
use mien_workbench::atomic_write::write_out;
use mien_workbench::dataset::{Entry, read_folder};
use mien_workbench::fault::Fault;
use mien_workbench::people_split::Split;

/// Number of values of a window.
const VALUES: usize = TEMPLATE_CELLS * TEMPLATE_CELLS * ORIENTATIONS;
/// Largest yaw of a face that the search shall find, radians.
const YAW_RAD: f32 = 0.6;
/// Largest roll of a face that the search shall find, radians.
const ROLL_RAD: f32 = 0.3;
/// Largest shift of a face along each axis, pixels of the template: half a step of the search grid.
const DISPLACED_PX: f32 = 2.0;
/// Largest change of a face's size, natural logarithm: half a step of the pyramid.
const DISPLACED_SCALE: f32 = 0.09;
/// Windows without a face taken from each image.
const EMPTY_WINDOWS: usize = 6;
/// Ridge added to the diagonal of the scatter matrix, relative to the mean of that diagonal.
const RIDGE: f64 = 0.02;
/// Share of the training faces that exceed the threshold, 0 to 1.
const PASSED: f64 = 0.92;

/// A window's values.
type Window = Vec<f32>;

/// Pixel of the head's origin, and pixels per metre at it.
fn place(camera: &Camera, sensor_from_head: &Rigid) -> ([f32; 2], f32) {
    let origin = sensor_from_head * Point::origin();
    let at = camera.colour_pixel(&origin);
    let beside = camera.colour_pixel(&(origin + Vector::x() * 0.01));
    (at, (beside[0] - at[0]) / 0.01)
}

/// The values of the window that has the template's origin at `pixel`, reduced by `scale`; `None` if it reaches beyond the image.
fn window(cells: &mut Cells, grey: &GrayImage, pixel: [f32; 2], scale: f32) -> Option<Window> {
    // One more cell on each side, for the normalisation.
    let margin = CELL as f32;
    let size = [grey.width() as usize, grey.height() as usize];
    let first: [f32; 2] = std::array::from_fn(|k| pixel[k] - (TEMPLATE_ORIGIN[k] + margin) * scale);
    if first.iter().any(|at| *at < 0.0) {
        return None;
    }
    cells.compute(grey.as_raw(), size, first, scale);
    if cells.size.iter().any(|cells| *cells < TEMPLATE_CELLS + 2) {
        return None;
    }
    let rows =
        (1..=TEMPLATE_CELLS).map(|row| &cells.values[row * cells.size[0] + 1..][..TEMPLATE_CELLS]);
    Some(rows.flatten().flatten().copied().collect())
}

/// Windows of an image that do not show the face at `pixel`, which has `scale` image pixels per pixel of the template.
fn beside(
    cells: &mut Cells,
    grey: &GrayImage,
    pixel: [f32; 2],
    scale: f32,
    random: &mut fastrand::Rng,
) -> Vec<Window> {
    let mut windows = Vec::new();
    for _ in 0..EMPTY_WINDOWS * 4 {
        let other = scale * (random.f32() * 2.6 - 1.6).exp();
        let at = [grey.width(), grey.height()].map(|pixels| random.f32() * pixels as f32);
        let apart = (at[0] - pixel[0]).hypot(at[1] - pixel[1]) / scale;
        let same_size = (other / scale).ln().abs() < 0.5;
        if (apart > 16.0 || (!same_size && apart > 8.0))
            && let Some(empty) = window(cells, grey, at, other)
        {
            windows.push(empty);
        }
        if windows.len() == EMPTY_WINDOWS {
            break;
        }
    }
    windows
}

/// The window of a rendered face, if the search shall find it, and windows beside it.
fn windows_of(sample: &TrainingSample, camera: &Camera, seed: u64) -> [Vec<Window>; 2] {
    let mut random = fastrand::Rng::with_seed(seed);
    let (at, pixels_per_metre) = place(camera, &sample.sensor_from_head);
    let at = [at[0] - sample.origin[0], at[1] - sample.origin[1]];
    let scale = pixels_per_metre / TEMPLATE_PIXELS_PER_METRE;
    let (yaw, _, roll) =
        mien_stages::base::geometry::yaw_pitch_roll(&sample.sensor_from_head.rotation);
    let mut cells = Cells::default();
    let mut off = || (2.0 * random.f32() - 1.0) * DISPLACED_PX * scale;
    let displaced = [at[0] + off(), at[1] + off()];
    let size = ((2.0 * random.f32() - 1.0) * DISPLACED_SCALE).exp();
    let is_wanted = yaw.abs() < YAW_RAD && roll.abs() < ROLL_RAD && scale >= 1.0;
    let face = is_wanted
        .then(|| window(&mut cells, &sample.grey, displaced, scale * size))
        .flatten();
    let empty = beside(&mut cells, &sample.grey, at, scale, &mut random);
    [face.into_iter().collect(), empty]
}

/// The window of a portrait's face, and windows beside it.
fn portrait_windows(entry: &Entry, shape: &ShapeModel) -> Result<[Vec<Window>; 2], Fault> {
    let Some(picture) = TruePicture::portrait(entry, shape)? else {
        return Ok(Default::default());
    };
    let mut random = fastrand::Rng::with_seed(entry.file.len() as u64);
    let (at, view) = (picture.truth.view.shift, picture.truth.view);
    let scale = view.log_scale.exp() / TEMPLATE_PIXELS_PER_METRE;
    let mut cells = Cells::default();
    let face = window(&mut cells, &picture.grey, at, scale);
    let empty = beside(&mut cells, &picture.grey, at, scale, &mut random);
    Ok([face.into_iter().collect(), empty])
}

/// Mean of windows.
fn mean(windows: &[Window]) -> DVector<f64> {
    let mut sum = DVector::zeros(VALUES);
    for window in windows {
        sum += DVector::from_iterator(VALUES, window.iter().map(|v| f64::from(*v)));
    }
    sum / windows.len().max(1) as f64
}

/// Scatter matrix: the mean outer product of the deviations from the mean.
fn scatter(windows: &[Window], mean: &DVector<f64>) -> DMatrix<f64> {
    let parts = windows.par_chunks(512).map(|part| {
        let deviations = DMatrix::from_fn(VALUES, part.len(), |row, k| {
            f64::from(part[k][row]) - mean[row]
        });
        &deviations * deviations.transpose()
    });
    let sum = parts.reduce(|| DMatrix::zeros(VALUES, VALUES), |a, b| a + b);
    sum / windows.len().max(1) as f64
}

/// The linear discriminant between faces and windows without a face, with the threshold that [`PASSED`] sets.
fn discriminant(faces: &[Window], empty: &[Window]) -> FaceTemplate {
    let means = [mean(faces), mean(empty)];
    let mut within = scatter(faces, &means[0]) * 0.5 + scatter(empty, &means[1]) * 0.5;
    let ridge = within.trace() / VALUES as f64 * RIDGE;
    within += DMatrix::identity(VALUES, VALUES) * ridge;
    let factor = within
        .cholesky()
        .expect("a ridge makes it positive definite");
    let weights = factor.solve(&(&means[0] - &means[1]));
    let weights = weights.iter().map(|w| *w as f32);
    let mut template = FaceTemplate::from_floats([0.0].into_iter().chain(weights));
    let mut scores: Vec<f32> = faces.iter().map(|face| score(&template, face)).collect();
    scores.sort_unstable_by(f32::total_cmp);
    template.bias = -scores[((1.0 - PASSED) * scores.len() as f64) as usize];
    template
}

fn score(template: &FaceTemplate, window: &Window) -> f32 {
    let weights = template.weights.iter().flatten();
    template.bias + weights.zip(window).map(|(w, v)| w * v).sum::<f32>()
}

/// Learns the template and writes it to `args.out`.
///
/// # Errors
/// If the data cannot be read or the template cannot be written.
pub(super) fn learn(args: &TrainArgs, out: &Path, say: &mut dyn FnMut(&str)) -> Result<(), Fault> {
    let learns = |person| Split::from_index(person) != Split::Test;
    let renderer = Renderer::new(&args.data.data, learns, 200, &[])?;
    let camera = mien_sensors::kinect::geometry::nominal();
    let shape = FaceModel::shipped().shape;
    let numbers = 0..args.drawn.min(20_000) as u64;
    let drawn = renderer.each_sample(numbers, args.seed, |sample| {
        let seed = sample.points[0][0].to_bits();
        windows_of(&sample, &camera, seed.into())
    });
    let (mut faces, mut empty): (Vec<Window>, Vec<Window>) = Default::default();
    for [face, beside] in drawn {
        faces.extend(face);
        empty.extend(beside);
    }
    for folder in &args.images {
        let entries = read_folder(folder)?;
        let persons: Vec<_> = entries.iter().map(|e| (&*e.set, &*e.person)).collect();
        let splits = Split::from_persons(&persons);
        let used = entries
            .iter()
            .zip(splits)
            .filter(|(_, split)| *split != Split::Test);
        let used: Vec<_> = used.map(|(entry, _)| entry).collect();
        let windows = used.par_iter().map(|entry| portrait_windows(entry, &shape));
        for [face, beside] in windows.collect::<Result<Vec<_>, Fault>>()? {
            faces.extend(face);
            empty.extend(beside);
        }
    }
    let template = discriminant(&faces, &empty);
    let passed = empty
        .iter()
        .filter(|window| score(&template, window) > 0.0)
        .count();
    say(&format!(
        "template: {} faces, {} empty windows, of which {:.2} % pass",
        faces.len(),
        empty.len(),
        100.0 * passed as f64 / empty.len().max(1) as f64
    ));
    write_out(out, template.bytes())?;
    Ok(())
}
