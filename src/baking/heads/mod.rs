//! Heads for rendering, made from the ICT FaceKit mesh: plain ones, and ones with photographs of people.
//!
//! ```text
//! ict                  the source mesh
//! fit                  the mesh fitted to the points of a portrait
//! reshape              another shape for a person's head
//! wardrobe             the photograph projected onto the mesh, warped to its points; eyes: synthetic ones instead
//! average, reduce      the average head, small enough for the appliance
//! hero                 the default head: hair, lashes, eyes, colours; default_head: the same baked, as a file
//! ```
//!
//! Head frames: metres, origin between the inner eye corners, rotated so that the stable points of the neutral face
//! match those of the mean head (least squares).

pub mod average;
pub mod default_head;
pub mod eyes;
pub mod fit;
pub mod hero;
pub mod ict;
pub mod reduce;
pub mod reshape;
pub mod wardrobe;

use std::path::{Path, PathBuf};

use rayon::prelude::*;

use crate::heads::ict::{IctHead, part, vertex_part};
use mien_simulator::virtual_head::{Expression, HeadAsset, Part, Points, Site, Texture};
use mien_stages::base::geometry::Rotation;
use mien_workbench::atomic_write::write_out;
use mien_workbench::dataset::read_folder;
use mien_workbench::fault::Fault;
use mien_workbench::people_split::numbered;
use mien_workbench::similarity::Similarity;

/// Offsets below this are dropped from sparse expressions, metres.
const STILL_M: f32 = 2e-5;

/// Writes a head; returns the size of the file, bytes.
fn write(asset: &HeadAsset, out: &Path) -> Result<usize, Fault> {
    let bytes = asset.emit();
    write_out(out, &bytes)?;
    Ok(bytes.len())
}

/// A head with a person's photograph.
#[derive(Clone)]
pub struct PersonHead {
    /// Index of the person among all of the collection, which decides the split.
    pub person: usize,
    /// The head.
    pub asset: HeadAsset,
}

/// Heads of the annotated portraits under `data` (the folder of the data sets) whose person number `keep` accepts, in the
/// order of the table, `most` at most.
///
/// # Errors
/// If mesh or portraits cannot be read.
pub fn textured_heads(
    data: &Path,
    keep: impl Fn(usize) -> bool,
    most: usize,
) -> Result<Vec<PersonHead>, Fault> {
    let ict = IctHead::read(&data.join("ict_facekit"))?;
    let mut portraits = portraits(data)?;
    portraits.retain(|&(person, ..)| keep(person));
    portraits.truncate(most);
    let plain = plain_head(&ict);
    let wardrobe = wardrobe::Wardrobe::new(plain.clone());
    let head = |(person, path, points): (usize, PathBuf, _)| {
        let unreadable = Fault::cannot("decode", &path, "; expected a JPEG or PNG photograph");
        let photograph = image::open(&path).map_err(unreadable)?.to_rgb8();
        let photograph = Texture {
            width: photograph.width() as usize,
            height: photograph.height() as usize,
            rgb: photograph.into_raw(),
        };
        let fit = fit::fit(&ict, &plain.landmarks, &points);
        let mut asset = wardrobe.dress(&ict, &fit, &points, &photograph);
        set_upright(&mut asset, &plain);
        Ok(PersonHead { person, asset })
    };
    portraits.into_par_iter().map(head).collect()
}

/// An annotated photograph: index of the person, file, the 68 points.
type Portrait = (usize, PathBuf, Points);

fn portraits(data: &Path) -> Result<Vec<Portrait>, Fault> {
    let entries = read_folder(&data.join("faces_frl189"))?;
    let persons: Vec<_> = entries.iter().map(|e| (&*e.set, &*e.person)).collect();
    let portraits = numbered(&persons).into_iter().zip(entries);
    let annotated = portraits.filter_map(|(person, e)| Some((person, e.path, e.points?)));
    Ok(annotated.collect())
}

/// Sets the head into its frame as the shape model does: the stable points of the neutral face match those of the
/// mean head. The mesh's identity modes leave the frame open (up to 5° of pitch between people), and with it the
/// pose. Expressions keep their directions.
fn set_upright(asset: &mut HeadAsset, mean: &HeadAsset) {
    let [own, target] = [&*asset, mean].map(|head| head.landmarks_on(&head.neutral));
    let rotation = Similarity::between(&own, &target).rotation;
    let rotation = Rotation::from_rotation_matrix(&rotation);
    asset.neutral.iter_mut().for_each(|p| *p = rotation * *p);
    asset.centre();
}

/// Triangles of the vertices that `number` renumbers, and their parts; clockwise seen from outside, unlike the
/// source's.
fn renumbered_triangles(
    ict: &IctHead,
    number: impl Fn(u32) -> Option<u32>,
) -> (Vec<[u32; 3]>, Vec<Part>) {
    let one = |&[a, b, c]: &[u32; 3]| {
        let corners = [number(a)?, number(c)?, number(b)?];
        Some((corners, vertex_part(a as usize)?))
    };
    ict.triangles.iter().filter_map(one).unzip()
}

/// The generic head in plain skin colour: for depth pictures.
pub fn plain_head(ict: &IctHead) -> HeadAsset {
    let drawn = part::EYEBALLS.end;
    let (triangles, parts) =
        renumbered_triangles(ict, |v| Some(v).filter(|&v| (v as usize) < drawn));
    // Little light reaches the back of a mouth: colours darken behind the lips.
    let lips = ict.neutral[ict.landmarks[62]].z;
    let colour = (0..drawn).map(|v| {
        let lit = (1.15 - (ict.neutral[v].z - lips) / 0.030).clamp(0.12, 1.0);
        match vertex_part(v) {
            Some(Part::MouthSocket) => [110.0, 50.0, 50.0].map(|c| c * lit),
            Some(Part::EyeSocket) => [90.0, 50.0, 45.0],
            Some(Part::Gums) => [160.0, 85.0, 85.0].map(|c| c * lit),
            Some(Part::Teeth) => [215.0, 210.0, 195.0].map(|c| c * lit),
            Some(Part::Eye) => [225.0, 220.0, 220.0],
            _ => [205.0, 160.0, 135.0],
        }
    });
    let expressions = ict.expressions.iter().map(|delta| {
        let moved = (0u32..).zip(delta.offsets[..drawn].iter().copied());
        let (vertices, offsets) = moved.filter(|(_, offset)| offset.norm() > STILL_M).unzip();
        Expression {
            name: delta.name.clone(),
            vertices,
            offsets,
        }
    });
    let landmarks = ict.landmarks.iter().map(|&v| Site::vertex(v as u32));
    HeadAsset {
        neutral: ict.neutral[..drawn].to_vec(),
        triangles: triangles.into(),
        parts: parts.into(),
        photo: vec![[0.0; 2]; drawn].into(),
        photo_share: vec![0.0; drawn].into(),
        colour: colour.collect(),
        expressions: expressions.collect(),
        landmarks: landmarks.collect(),
        ..HeadAsset::default()
    }
}

#[cfg(test)]
mod tests;
