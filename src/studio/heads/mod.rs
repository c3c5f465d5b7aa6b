//! Heads to draw, made from the ICT FaceKit mesh: plain ones, and ones that wear a photograph.

pub mod expressions;

use crate::geometry::Vector;
use crate::sensor::virtual_head::{Expression, HeadAsset, Part, Site, Texture};
use crate::studio::ict::{IctHead, part};

/// Offsets below this are dropped from sparse expressions, metres.
const STILL_M: f32 = 2e-5;

/// Part of a vertex; `None` for lashes and helper surfaces, which are not drawn.
#[must_use]
pub fn part_of(vertex: usize) -> Option<Part> {
    [
        (part::FACE, Part::Skin),
        (part::HEAD_AND_NECK, Part::Skin),
        (part::MOUTH_SOCKET, Part::MouthSocket),
        (part::EYE_SOCKETS, Part::EyeSocket),
        (part::GUMS_AND_TONGUE, Part::Gums),
        (part::TEETH, Part::Teeth),
        (part::EYEBALLS, Part::Eye),
    ]
    .into_iter()
    .find_map(|(range, part)| range.contains(&vertex).then_some(part))
}

/// The generic head in plain skin colour: for depth pictures.
#[must_use]
pub fn plain_head(ict: &IctHead) -> HeadAsset {
    let drawn = part::EYEBALLS.end;
    let (mut triangles, mut parts) = (Vec::new(), Vec::new());
    for &[a, b, c] in &ict.triangles {
        if let Some(part) = part_of(a as usize)
            && [a, b, c].iter().all(|&v| (v as usize) < drawn)
        {
            // The source is counter-clockwise seen from outside.
            triangles.push([a, c, b]);
            parts.push(part);
        }
    }
    let colour = (0..drawn)
        .map(|v| match part_of(v) {
            Some(Part::MouthSocket | Part::EyeSocket) => [90.0, 40.0, 40.0],
            Some(Part::Gums) => [165.0, 85.0, 85.0],
            Some(Part::Teeth) => [215.0, 210.0, 195.0],
            Some(Part::Eye) => [225.0, 220.0, 220.0],
            _ => [205.0, 160.0, 135.0],
        })
        .collect();
    let expressions = ict
        .expressions
        .iter()
        .map(|delta| {
            let moved: Vec<(u32, Vector)> = (0u32..)
                .zip(&delta.offsets[..drawn])
                .filter(|(_, offset)| offset.norm() > STILL_M)
                .map(|(v, offset)| (v, *offset))
                .collect();
            let (vertices, offsets) = moved.into_iter().unzip();
            Expression {
                name: delta.name.clone(),
                vertices,
                offsets,
            }
        })
        .collect();
    HeadAsset {
        neutral: ict.neutral[..drawn].to_vec(),
        triangles,
        parts,
        photo: vec![[0.0; 2]; drawn],
        photo_share: vec![0.0; drawn],
        colour,
        texture: Texture::default(),
        expressions,
        landmarks: ict.landmarks.map(|v| Site::vertex(v as u32)).to_vec(),
    }
}
