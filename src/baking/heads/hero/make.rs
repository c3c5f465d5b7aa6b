//! Makes `config/hero.head` from ICT-FaceKit: the visible part of its neutral mesh, ambient light per vertex, and
//! guide lines of the lashes.
//!
//! The file is a [`HeadAsset`] with special use of vertex colours: red is the share of light (255: open sky); green
//! and blue refine the position within the file's step of 10 µm, in sixteenths ([`exact_place`]), which small
//! triangles at the lids need. The last [`GUIDES`] vertices belong to no triangle: lashes of the left eye, upper lid
//! then lower, [`COLUMNS`] of them with [`ROWS`] points from root to tip. The lips, slightly open in the source, are
//! closed. Cost: about a second.

use std::ops::Range;
use std::path::Path;

use nalgebra::Vector3;
use rayon::prelude::*;

use crate::heads;
use crate::heads::ict::{IctHead, part};
use mien_simulator::virtual_head::raster::{Corner, DepthBuffer, sum_normals};
use mien_simulator::virtual_head::{HeadAsset, Site};
use mien_stages::base::geometry::Point;
use mien_workbench::fault::Fault;

/// Lashes across a lid.
pub const COLUMNS: usize = 19;
/// Points of a lash.
pub const ROWS: usize = 6;
/// Vertices of the guide lines of lashes.
pub const GUIDES: usize = 2 * COLUMNS * ROWS;

/// White of the eyes with the cornea, left and right; the lens behind is dropped.
const EYES: [Range<usize>; 2] = [21451..22221, 23021..23791];
/// First vertices of one card of lashes of the left upper lid and one of the lower.
const CARDS: [usize; 2] = [25351, 25693];
/// Number of directions of light.
const DIRECTIONS: usize = 160;
/// Side of a shadow map, pixels.
const SIDE: usize = 512;
/// Extent of a shadow map, metres.
const EXTENT_M: f32 = 0.42;
/// Depth behind the shadow map's surface up to which a vertex is lit, metres.
const BIAS_M: f32 = 0.0012;

/// Step of positions in the file, metres.
const STEP_M: f32 = 1e-5;
/// Parts of a step, stored in the colours.
const PARTS: f32 = 16.0;
/// Displacement of each lip to close the gap, metres.
const CLOSE_M: f32 = 0.00042;

/// Position of vertex `v`, to a sixteenth of the file's step; head frame, metres.
pub fn exact_place(asset: &HeadAsset, v: usize) -> Point {
    let [_, y, z] = asset.colour[v];
    let x = asset.photo_share[v] * 255.0;
    let fine = Vector3::new(x, y, z).map(|b| (b.round() / PARTS - 0.5) * STEP_M);
    asset.neutral[v] + fine
}

/// Offset of a coordinate within its step, 0…16.
fn within(c: f32) -> f32 {
    let steps = c / STEP_M;
    ((steps - steps.round() + 0.5) * PARTS).round()
}

/// Writes the file; returns its size in bytes.
///
/// # Errors
/// If the mesh under `data` cannot be read or `out` cannot be written.
pub fn make(data: &Path, out: &Path) -> Result<usize, Fault> {
    let ict = IctHead::read(&data.join("ict_facekit"))?;
    heads::write(&lit_head(&ict), out)
}

/// The visible part of the set, with closed lips, light and guide lines of lashes.
fn lit_head(ict: &IctHead) -> HeadAsset {
    let eyes = EYES.into_iter().flatten();
    let kept: Vec<usize> = (0..part::TEETH.end).chain(eyes).collect();
    let mut number = vec![u32::MAX; ict.neutral.len()];
    for (k, &v) in kept.iter().enumerate() {
        number[v] = k as u32;
    }
    let numbered = |v: u32| Some(number[v as usize]).filter(|&k| k != u32::MAX);
    let (triangles, parts) = heads::renumbered_triangles(ict, numbered);
    let mut neutral: Vec<Point> = kept.iter().map(|&v| ict.neutral[v]).collect();
    close(ict, &kept, &mut neutral);
    let light = light(&neutral, &triangles);
    for card in CARDS {
        neutral.extend(lashes(ict, card));
    }
    let shares = light.iter().copied().chain([1.0; GUIDES]);
    let colour = shares.zip(&neutral);
    let colour = colour.map(|(share, p)| [share * 255.0, within(p.y), within(p.z)]);
    let colour = colour.collect();
    let photo_share = neutral.iter().map(|p| within(p.x) / 255.0).collect();
    let landmarks = ict.landmarks.iter().map(|&v| Site::vertex(number[v]));
    let n = neutral.len();
    HeadAsset {
        neutral,
        triangles: triangles.into(),
        parts: parts.into(),
        photo: vec![[0.0; 2]; n].into(),
        photo_share,
        colour,
        landmarks: landmarks.collect(),
        ..HeadAsset::default()
    }
}

/// Closes the lips: skin above the line between them moves down, skin below it up, fading with distance.
fn close(ict: &IctHead, kept: &[usize], neutral: &mut [Point]) {
    const FADE_M: f32 = 0.010;
    let at = |k: usize| ict.neutral[ict.landmarks[k]];
    let (corner, middle) = (at(64), nalgebra::center(&at(62), &at(66)));
    for (p, &v) in neutral.iter_mut().zip(kept) {
        let lip = part::NARROW_FACE.contains(&v) || part::MOUTH_SOCKET.contains(&v);
        let aside = (p.x / corner.x).abs();
        if !lip || aside > 1.0 || p.z > middle.z + 0.02 {
            continue;
        }
        // Both lips bend down towards the corners.
        let line = middle.y + (corner.y - middle.y) * aside.powi(4);
        let far = (p.y - line).abs() / FADE_M;
        let share = (1.0 - far * far).max(0.0).powi(2) * (1.0 - aside.powi(4));
        // y points down.
        p.y += CLOSE_M * share * if p.y < line { 1.0 } else { -1.0 };
    }
}

/// Points of a card of lashes, column by column, outwards from the lid; the card's texture coordinates are its grid.
fn lashes(ict: &IctHead, card: usize) -> Vec<Point> {
    let size = COLUMNS * ROWS;
    let mut uv = vec![[0.0f32; 2]; size];
    for (t, corners) in ict.triangles.iter().zip(&ict.triangle_uv) {
        for (&v, &at) in t.iter().zip(corners) {
            if let Some(slot) = (v as usize).checked_sub(card).and_then(|k| uv.get_mut(k)) {
                *slot = at;
            }
        }
    }
    let mut order: Vec<usize> = (0..size).collect();
    order.sort_by(|&a, &b| uv[a][0].total_cmp(&uv[b][0]));
    let ball = middle(&ict.neutral[EYES[0].clone()]);
    let mut out = Vec::new();
    for column in order.chunks_mut(ROWS) {
        column.sort_by(|&a, &b| uv[a][1].total_cmp(&uv[b][1]));
        let far = |k: usize| (ict.neutral[card + column[k]].coords - ball).norm();
        if far(0) > far(ROWS - 1) {
            column.reverse();
        }
        out.extend(column.iter().map(|&k| ict.neutral[card + k]));
    }
    out
}

fn middle(places: &[Point]) -> Vector3<f32> {
    let sum: Vector3<f32> = places.iter().map(|p| p.coords).sum();
    sum / places.len().max(1) as f32
}

/// Share of uniform ambient light that reaches each vertex, 0…1, with Lambertian weights.
fn light(places: &[Point], triangles: &[[u32; 3]]) -> Vec<f32> {
    let mut normals = vec![Vector3::<f32>::zeros(); places.len()];
    let corners = triangles.iter().map(|t| t.map(|v| v as usize));
    sum_normals(corners, places, &mut normals);
    // 1 if the normals point out of the head, else -1.
    let volumes = places.iter().zip(&normals).map(|(p, n)| p.coords.dot(n));
    let outward = volumes.sum::<f32>().signum();
    for n in &mut normals {
        *n = n.try_normalize(1e-12).unwrap_or_default() * outward;
    }
    let middle = middle(places);
    let from = |k: usize| {
        // Directions on a spiral over the sphere.
        let z = 1.0 - 2.0 * (k as f32 + 0.5) / DIRECTIONS as f32;
        let (sin, cos) = (2.399_963 * k as f32).sin_cos();
        let r = (1.0 - z * z).sqrt();
        let towards = Vector3::new(r * cos, r * sin, z);
        let seen = visible(places, triangles, &middle, &towards);
        let lit = |(n, seen): (&Vector3<f32>, bool)| {
            let facing = n.dot(&towards).max(0.0);
            [facing, if seen { facing } else { 0.0 }]
        };
        normals.iter().zip(seen).map(lit).collect()
    };
    let sum = |mut all: Vec<[f32; 2]>, one: Vec<[f32; 2]>| {
        for (a, b) in all.iter_mut().zip(one) {
            *a = [a[0] + b[0], a[1] + b[1]];
        }
        all
    };
    let directions = (0..DIRECTIONS).into_par_iter().map(from);
    let sums = directions.reduce(|| vec![[0.0; 2]; places.len()], sum);
    let share = |[all, seen]: &[f32; 2]| seen / all.max(1e-6);
    sums.iter().map(share).collect()
}

/// Whether each vertex is unoccluded from a distant light.
fn visible(
    places: &[Point],
    triangles: &[[u32; 3]],
    middle: &Vector3<f32>,
    towards: &Vector3<f32>,
) -> Vec<bool> {
    let aside = match towards.x.abs() < 0.7 {
        true => Vector3::x(),
        false => Vector3::y(),
    };
    let u = towards.cross(&aside).normalize();
    let v = towards.cross(&u);
    let scale = SIDE as f32 / EXTENT_M;
    let half = SIDE as f32 / 2.0;
    let on_screen = |p: &Point| {
        let d = p.coords - middle;
        // Inverse depth grows towards the light; all of the head is within a metre.
        let inverse = 1.0 + d.dot(towards);
        Corner::new([u, v].map(|axis| d.dot(&axis) * scale + half), inverse)
    };
    let screen: Vec<Corner> = places.iter().map(on_screen).collect();
    let mut depth = DepthBuffer::new(SIDE, SIDE);
    for &[a, b, c] in triangles {
        for corners in [[a, b, c], [a, c, b]] {
            depth.triangle(corners.map(|v| screen[v as usize]), |_, _, _| {});
        }
    }
    let is_lit = |corner: &Corner| {
        let (x, y) = (corner.x.round(), corner.y.round());
        let inside = (0.0..SIDE as f32).contains(&x) && (0.0..SIDE as f32).contains(&y);
        !inside || corner.inverse > depth.inverse[y as usize * SIDE + x as usize] - BIAS_M
    };
    screen.iter().map(is_lit).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plate_under_a_lid_is_dark_and_one_in_the_open_is_not() {
        let plate = |y: f32, side: f32| {
            [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]
                .map(|(x, z)| Point::new(x * side, y, z * side))
        };
        // y points down: the lid at -5 mm is above; the upward-facing plate lies at the bottom.
        let mut places = plate(0.0, 0.01).to_vec();
        places.extend(plate(-0.005, 0.04));
        let faces = |first: u32| [[first, first + 2, first + 1], [first, first + 3, first + 2]];
        let triangles = [faces(0), faces(4)].concat();
        let sky = light(&places, &triangles);
        let flipped: Vec<_> = triangles.iter().map(|t| [t[0], t[2], t[1]]).collect();
        let ground = light(&places, &flipped);
        let [open, hidden] = [4, 0].map(|v| sky[v].max(ground[v]));
        assert!(
            open > 0.95 && sky[0].min(ground[0]) < 0.35,
            "{open} {hidden}"
        );
    }
}
