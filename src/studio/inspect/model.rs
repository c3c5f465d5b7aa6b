//! Images of a face model: numbered mean face, every mode at ± 2 standard deviations, and the standard head.

use image::RgbImage;

use super::album::Album;
use crate::chart::{self, Curve, Plot};
use mien_stages::base::capacity::LANDMARKS;
use mien_stages::base::geometry::Point;
use mien_stages::face_model::{FaceModel, MAX_MODES, scheme};
use mien_workbench::canvas::{self, Colour};

const FRONT: fn(&Point) -> [f32; 2] = |p| [p.x, p.y];
/// From the subject's left: the nose points to the left of the picture.
const SIDE: fn(&Point) -> [f32; 2] = |p| [p.z, p.y];

/// Most modes drawn.
const SHOWN_MODES: usize = 12;
/// Metres from the middle of an image of a face to its edge.
const REACH_M: f32 = 0.11;

/// Pixel of a 2D position in a square image; the face's middle is slightly below the eyes.
fn pixel(size: u32, [x, y]: [f32; 2]) -> [f32; 2] {
    let scale = size as f32 / (2.0 * REACH_M);
    [(x + REACH_M) * scale, (y + REACH_M - 0.03) * scale]
}

/// Draws the lines of a face.
fn face(
    picture: &mut RgbImage,
    points: &[Point; LANDMARKS],
    flat: fn(&Point) -> [f32; 2],
    colour: Colour,
) {
    let size = picture.width();
    for [a, b] in canvas::face_lines() {
        let [a, b] = [a, b].map(|k| pixel(size, flat(&points[k])));
        canvas::line(picture, a, b, colour);
    }
    for point in points {
        let [x, y] = pixel(size, flat(point));
        canvas::square(picture, x, y, 1, colour);
    }
}

fn white(wide: u32, high: u32) -> RgbImage {
    RgbImage::from_pixel(wide, high, image::Rgb([255; 3]))
}

/// The mean face with its landmark numbers.
fn numbered(mean: &[Point; LANDMARKS]) -> RgbImage {
    let mut numbered = white(640, 640);
    face(&mut numbered, mean, FRONT, [180, 180, 180]);
    for (i, point) in mean.iter().enumerate() {
        let [x, y] = pixel(640, FRONT(point));
        let colour = match scheme::STABLE.contains(&i) {
            true => [213, 94, 0],
            false => [0, 80, 160],
        };
        let above = [x - 5.0, y - 14.0].map(|at| at.max(0.0) as u32);
        chart::text(&mut numbered, above, 10, &i.to_string(), colour);
    }
    numbered
}

/// The mean face in front of the standard head, from the side.
fn side(model: &FaceModel, mean: &[Point; LANDMARKS]) -> RgbImage {
    let mut side = white(640, 640);
    let points = model.standard_head.iter().map(|(point, _)| point);
    for point in points.filter(|p| p.x.abs() < 0.2) {
        let [x, y] = pixel(640, SIDE(point));
        canvas::dot(&mut side, x, y, [170, 190, 210]);
    }
    face(&mut side, mean, SIDE, [40, 40, 40]);
    side
}

/// A mode at 2 standard deviations to either side, from the front and from the side.
fn mode(model: &FaceModel, mean: &[Point; LANDMARKS], k: usize) -> RgbImage {
    let mut tile = white(420, 210);
    for (half, flat) in [FRONT, SIDE].into_iter().enumerate() {
        let mut part = white(210, 210);
        face(&mut part, mean, flat, [215, 215, 215]);
        for (b, colour) in [(-2.0, [0, 114, 178]), (2.0, [213, 94, 0])] {
            let mut coefficients = [0.0; MAX_MODES];
            coefficients[k] = b;
            let mut shape = *mean;
            model.shape.shape(&coefficients, &mut shape);
            face(&mut part, &shape, flat, colour);
        }
        image::imageops::replace(&mut tile, &part, 210 * half as i64, 0);
    }
    tile
}

/// The album of a model.
pub(super) fn inspect(name: &str, model: &FaceModel, bytes: usize) -> Album {
    let mut album = Album::new(format!("Face model {name}"));
    let (cold, warm) = (model.cold.len(), model.warm.len());
    let stages = format!("{cold} stages from a cold start, {warm} from the last frame");
    let head = format!("{} points", model.standard_head.len());
    let paper = format!("{} bytes", model.paper_aam.len());
    for (name, value) in [
        ("id", format!("{:08x}", model.id)),
        ("provenance", model.provenance.clone()),
        ("size", format!("{bytes} bytes")),
        ("shape modes", model.shape.modes.len().to_string()),
        ("cascade", stages),
        ("standard head", head),
        ("the paper's active appearance model", paper),
    ] {
        album.fact(name, value);
    }
    let mut mean = [Point::origin(); LANDMARKS];
    model.shape.shape(&[], &mut mean);
    let caption = "mean face; orange: points that define the head frame";
    album.pictures.push((caption.into(), numbered(&mean)));
    let caption = "mean face and standard head from the side";
    album.pictures.push((caption.into(), side(model, &mean)));
    let deviations_mm = model.shape.deviations.iter().map(|d| f64::from(d * 1e3));
    let deviations_mm: Vec<f64> = deviations_mm.collect();
    for (k, deviation) in deviations_mm.iter().enumerate().take(SHOWN_MODES) {
        let caption = format!("mode {k}: -2 blue, +2 orange; deviation {deviation:.1} mm");
        album.pictures.push((caption, mode(model, &mean, k)));
    }
    album.plots.push(Plot {
        title: "Standard deviation of the modes, mm over all 68 points".into(),
        x: (0..deviations_mm.len()).map(|k| k as f64).collect(),
        x_name: "mode".into(),
        curves: vec![Curve {
            name: "deviation".into(),
            values: deviations_mm.into_iter().map(Some).collect(),
        }],
        at_least: Some((0.0, 0.0)),
    });
    album
}
