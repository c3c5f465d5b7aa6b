//! Nobody's head in particular: mean shape and mean photograph of many people, small enough to be built into the appliance.

use std::path::Path;

use nalgebra::Translation3;

use super::reduce::Reduction;
use super::{HeadsError, PersonHead, plain_head, textured_heads};
use crate::base::geometry::{Point, Rigid};
use crate::simulator::virtual_head::draw::{Canvas, HeadPainter};
use crate::simulator::virtual_head::{HeadAsset, Light, Texture};
use crate::studio::heads::ict::IctHead;

/// Size of the mean photograph, pixels.
const SIZE: [usize; 2] = [232, 300];
/// Its scale, pixels per metre.
const SCALE: f32 = 1080.0;
/// Pixel of the head's origin.
const ORIGIN: [f32; 2] = [115.5, 128.0];

/// The average of heads that share one mesh: shapes, colours, and photographs brought onto the mean face.
///
/// `None` without heads.
#[must_use]
pub fn average(heads: &[PersonHead]) -> Option<HeadAsset> {
    let first = &heads.first()?.asset;
    let count = heads.len() as f32;
    let n = first.neutral.len();
    let mut neutral = vec![nalgebra::Vector3::<f32>::zeros(); n];
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
    let neutral: Vec<Point> = neutral.into_iter().map(Point::from).collect();
    let flat = |p: &Point| [p.x * SCALE + ORIGIN[0], p.y * SCALE + ORIGIN[1]];
    // Every photograph is drawn on the mean face, seen from infinitely far, in even light.
    let light = Light {
        ambient: 1.0,
        ..Light::default()
    };
    let mut canvas = Canvas::new(SIZE[0], SIZE[1]);
    let mut painter = HeadPainter::new(first);
    let mut sum = vec![[0.0f32; 4]; SIZE[0] * SIZE[1]];
    for head in heads {
        canvas.depth.inverse.fill(0.0);
        painter.deformed.copy_from_slice(&neutral);
        painter.place_deformed(&Rigid::from_parts(
            Translation3::new(0.0, 0.0, 1.0),
            nalgebra::UnitQuaternion::identity(),
        ));
        painter.light(&head.asset, &light);
        painter.draw_colour(&head.asset, &light, flat, &mut canvas);
        for (sum, (rgb, &inverse)) in sum
            .iter_mut()
            .zip(canvas.rgb.iter().zip(&canvas.depth.inverse))
        {
            if inverse > 0.0 {
                for k in 0..3 {
                    sum[k] += f32::from(rgb[k]);
                }
                sum[3] += 1.0;
            }
        }
    }
    let rgb = sum
        .iter()
        .flat_map(|s| [0, 1, 2].map(|k| (s[k] / s[3].max(1.0) + 0.5) as u8))
        .collect();
    let texture = Texture {
        width: SIZE[0],
        height: SIZE[1],
        rgb,
    };
    let photo: Vec<[f32; 2]> = neutral.iter().map(flat).collect();
    // The mean photograph has the spread colours in it already, so it may count where most photographs did a little.
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

/// Makes the built-in head from all persons that `keep` accepts, and writes it.
///
/// # Errors
/// If the data cannot be read or `out` cannot be written.
pub fn make_simulated_head(
    data: &Path,
    out: &Path,
    keep: impl Fn(usize) -> bool,
) -> Result<usize, HeadsError> {
    let heads = textured_heads(data, keep)?;
    let ict = IctHead::read(&data.join("ict_facekit"))?;
    let plain = plain_head(&ict);
    let head = average(&heads);
    let small = Reduction::of(&plain).apply(head.as_ref().unwrap_or(&plain));
    super::write(&small, out)
}
