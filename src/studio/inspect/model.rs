//! A face model as pictures: mean face with its numbers, every mode at ± 2 standard deviations, the standard head, and where
//! the fitting cascade looks.

use image::RgbImage;

use super::album::{Album, Curve, Plot};
use super::canvas::{self, Colour};
use crate::base::capacity::LANDMARKS;
use crate::base::geometry::Point;
use crate::face_model::{FaceModel, MAX_MODES, PATCH, scheme};

const FRONT: fn(&Point) -> [f32; 2] = |p| [p.x, p.y];
/// From the subject's left: the nose points to the left of the picture.
const SIDE: fn(&Point) -> [f32; 2] = |p| [p.z, p.y];

/// Most modes drawn.
const SHOWN_MODES: usize = 12;
/// Metres from the middle of a picture of a face to its edge.
const REACH_M: f32 = 0.11;

/// Pixel of a flat position in a square picture; the face's middle is a bit below the eyes.
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
        canvas::line(
            picture,
            pixel(size, flat(&points[a])),
            pixel(size, flat(&points[b])),
            colour,
        );
    }
    for point in points {
        let [x, y] = pixel(size, flat(point));
        canvas::square(picture, x, y, 1, colour);
    }
}

fn white(size: u32) -> RgbImage {
    RgbImage::from_pixel(size, size, image::Rgb([255; 3]))
}

/// The mean face with its numbers.
fn numbered(mean: &[Point; LANDMARKS]) -> RgbImage {
    let mut numbered = white(640);
    face(&mut numbered, mean, FRONT, [180, 180, 180]);
    for (i, point) in mean.iter().enumerate() {
        let [x, y] = pixel(640, FRONT(point));
        let colour = if scheme::STABLE.contains(&i) {
            [213, 94, 0]
        } else {
            [0, 80, 160]
        };
        canvas::text(
            &mut numbered,
            (x - 4.0).max(0.0) as u32,
            (y - 12.0).max(0.0) as u32,
            1,
            &i.to_string(),
            colour,
        );
    }
    numbered
}

/// The mean face before the standard head, from the side.
fn side(model: &FaceModel, mean: &[Point; LANDMARKS]) -> RgbImage {
    let mut side = white(640);
    let size = side.width();
    for point in model
        .standard_head
        .points
        .iter()
        .filter(|p| p.x.abs() < 0.2)
    {
        let [x, y] = pixel(size, SIDE(point));
        canvas::dot(&mut side, x, y, [170, 190, 210]);
    }
    face(&mut side, mean, SIDE, [40, 40, 40]);
    side
}

/// What a mode does at 2 standard deviations to either side, from the front and from the side.
fn mode(model: &FaceModel, mean: &[Point; LANDMARKS], k: usize) -> RgbImage {
    let mut tile = RgbImage::from_pixel(420, 210, image::Rgb([255; 3]));
    for (half, flat) in [FRONT, SIDE].into_iter().enumerate() {
        let mut part = white(210);
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

/// Draws a model.
#[must_use]
pub(super) fn inspect(name: &str, model: &FaceModel, bytes: usize) -> Album {
    let mut album = Album {
        title: format!("Face model {name}"),
        ..Album::default()
    };
    album.fact("id", format!("{:08x}", model.id));
    album.fact("provenance", model.provenance.clone());
    album.fact("size", format!("{bytes} bytes"));
    album.fact("shape modes", model.shape.modes.len().to_string());
    album.fact(
        "cascade",
        format!(
            "{} stages from a cold start, {} from the last frame, {} values per patch",
            model.cold.len(),
            model.warm.len(),
            PATCH
        ),
    );
    album.fact(
        "standard head",
        format!("{} points", model.standard_head.points.len()),
    );
    album.fact(
        "the paper's active appearance model",
        format!("{} bytes", model.paper_aam.len()),
    );

    let mut mean = [Point::origin(); LANDMARKS];
    model.shape.shape(&[], &mut mean);
    album.pictures.push((
        "mean face; orange: points that define the head frame".into(),
        numbered(&mean),
    ));
    album.pictures.push((
        "mean face and standard head from the side".into(),
        side(model, &mean),
    ));
    for (k, deviation) in model.shape.deviations.iter().enumerate().take(SHOWN_MODES) {
        album.pictures.push((
            format!(
                "mode {k}: -2 blue, +2 orange; deviation {:.1} mm",
                deviation * 1e3
            ),
            mode(model, &mean, k),
        ));
    }
    album.plots.push(Plot {
        title: "Standard deviation of the modes, mm over all 68 points".into(),
        x: (0..model.shape.deviations.len())
            .map(|k| k as f64)
            .collect(),
        x_name: "mode".into(),
        curves: vec![Curve {
            name: "deviation".into(),
            values: model
                .shape
                .deviations
                .iter()
                .map(|d| Some(f64::from(d * 1e3)))
                .collect(),
        }],
        at_least: Some((0.0, 0.0)),
    });
    for (name, stages) in [("cold", &model.cold), ("warm", &model.warm)] {
        for (k, stage) in stages.iter().enumerate() {
            album.pictures.push((
                format!(
                    "{name} stage {k}: mean gradients, cell {:.1} px",
                    stage.cell_px
                ),
                patches(&stage.mean),
            ));
        }
    }
    album
}

/// The mean patches of a stage: 68 tiles, each cell as bright as its gradients are strong.
fn patches(mean: &[f32]) -> RgbImage {
    const CELL: u32 = 6;
    let side = crate::face_model::PATCH_CELLS as u32;
    let (columns, tile) = (17, side * CELL + 2);
    let mut picture = RgbImage::from_pixel(
        columns * tile,
        LANDMARKS as u32 / columns * tile,
        image::Rgb([30; 3]),
    );
    let strength = |l: usize, cell: usize| -> f32 {
        let start = l * PATCH + cell * crate::face_model::ORIENTATIONS;
        mean.get(start..start + crate::face_model::ORIENTATIONS)
            .map_or(0.0, |values| values.iter().sum())
    };
    let cells = (side * side) as usize;
    let most = (0..LANDMARKS)
        .flat_map(|l| (0..cells).map(move |c| (l, c)))
        .map(|(l, c)| strength(l, c))
        .fold(1e-9, f32::max);
    for l in 0..LANDMARKS {
        for cell in 0..cells {
            let grey = (strength(l, cell) / most * 255.0).clamp(0.0, 255.0) as u8;
            let (x, y) = (l as u32 % columns * tile, l as u32 / columns * tile);
            for dy in 0..CELL {
                for dx in 0..CELL {
                    let px = x + cell as u32 % side * CELL + dx + 1;
                    let py = y + cell as u32 / side * CELL + dy + 1;
                    canvas::dot(&mut picture, px as f32, py as f32, [grey; 3]);
                }
            }
        }
    }
    picture
}
