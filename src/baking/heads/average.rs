//! The average head: mean shape and mean photograph of many people, small enough for the appliance.

use std::path::Path;

use super::reduce::Reduction;
use super::{PersonHead, plain_head, textured_heads};
use crate::heads::ict::IctHead;
use mien_simulator::virtual_head::draw::{Canvas, HeadPainter};
use mien_simulator::virtual_head::{HeadAsset, Light, Texture};
use mien_stages::base::geometry::{Point, Rigid};
use mien_workbench::fault::Fault;

/// Size of the mean photograph, pixels.
const SIZE: [usize; 2] = [232, 300];
/// Its scale, pixels per metre.
const SCALE: f32 = 1080.0;
/// Pixel of the head's origin.
const ORIGIN: [f32; 2] = [115.5, 128.0];

/// The average of heads that share one mesh: shapes, colours, and photographs brought onto the mean face.
///
/// `None` without heads.
pub fn average(heads: &[PersonHead]) -> Option<HeadAsset> {
    let first = &heads.first()?.asset;
    let count = heads.len() as f32;
    let n = first.neutral.len();
    let mut neutral = vec![Point::origin(); n];
    let mut colour = vec![[0.0f32; 3]; n];
    let mut share = vec![0.0f32; n];
    for head in heads {
        for v in 0..n {
            neutral[v] += head.asset.neutral[v].coords / count;
            share[v] += head.asset.photo_share[v] / count;
            for k in 0..3 {
                colour[v][k] += head.asset.colour[v][k] / count;
            }
        }
    }
    let texture = mean_photograph(heads, &neutral);
    let photo: Vec<[f32; 2]> = neutral.iter().map(flat).collect();
    // The mean photograph already contains the spread colours, so that little visibility suffices.
    let share: Vec<f32> = share.iter().map(|s| (s * 1.5).min(1.0)).collect();
    let mut asset = HeadAsset {
        neutral,
        photo: photo.into(),
        photo_share: share.into(),
        colour: colour.into(),
        texture: texture.levels().into(),
        ..first.clone()
    };
    asset.centre();
    Some(asset)
}

/// Texture coordinates in the mean photograph, pixels.
fn flat(p: &Point) -> [f32; 2] {
    [p.x * SCALE + ORIGIN[0], p.y * SCALE + ORIGIN[1]]
}

/// Mean of all photographs rendered on the mean face, orthographically, in even light.
fn mean_photograph(heads: &[PersonHead], mean: &[Point]) -> Texture {
    let light = Light {
        ambient: 1.0,
        ..Light::default()
    };
    let [width, height] = SIZE;
    let mut canvas = Canvas::new(width, height);
    let mut painter = HeadPainter::new(&heads[0].asset);
    painter.deformed.copy_from_slice(mean);
    let mut sum = vec![[0.0f32; 4]; width * height];
    for head in heads {
        canvas.depth.inverse.fill(0.0);
        painter.place_deformed(&Rigid::translation(0.0, 0.0, 1.0));
        painter.light(&head.asset, &light);
        painter.draw_colour(&head.asset, &light, flat, &mut canvas);
        let drawn = canvas.rgb.iter().zip(&canvas.depth.inverse);
        for (sum, ([r, g, b], _)) in sum.iter_mut().zip(drawn).filter(|one| *one.1.1 > 0.0) {
            for (sum, more) in sum.iter_mut().zip([*r, *g, *b, 1]) {
                *sum += f32::from(more);
            }
        }
    }
    let mean = |s: &[f32; 4]| [0, 1, 2].map(|k| (s[k] / s[3].max(1.0) + 0.5) as u8);
    Texture {
        width,
        height,
        rgb: sum.iter().flat_map(mean).collect(),
    }
}

/// Makes the built-in head from all persons that `keep` accepts, and writes it.
///
/// # Errors
/// If the data cannot be read or `out` cannot be written.
pub fn make_simulated_head(
    data: &Path,
    out: &Path,
    keep: impl Fn(usize) -> bool,
) -> Result<usize, Fault> {
    let heads = textured_heads(data, keep, usize::MAX)?;
    let ict = IctHead::read(&data.join("ict_facekit"))?;
    let plain = plain_head(&ict);
    let head = average(&heads);
    let small = Reduction::new(&plain).apply(head.as_ref().unwrap_or(&plain));
    super::write(&small, out)
}
