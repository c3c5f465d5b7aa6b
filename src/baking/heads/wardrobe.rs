//! Projects a portrait onto the mesh: identity from the fit, texture coordinates of every vertex in the photograph,
//! and vertex colours where it does not show.
//!
//! The fit leaves a residual, so the projected mesh is warped by a thin-plate spline until every landmark falls
//! exactly on its annotated point: the true lip corner is then the lip corner of the image. The photograph counts
//! where a vertex faces the camera, is not hidden and does not show the backdrop; elsewhere colours spread over the
//! mesh (a membrane: the mean of the neighbours, relaxed).

use mien_stages::base::geometry::smoothstep;
use std::collections::HashMap;

use nalgebra::{Point3, Vector2, Vector3};

use super::fit::PortraitFit;
use crate::heads::ict::{Delta, IctHead, part, vertex_part};
use mien_simulator::virtual_head::raster::{Corner, DepthBuffer, sum_normals};
use mien_simulator::virtual_head::{HeadAsset, Part, Points, Texture};
use mien_workbench::thin_plate::ThinPlate;

/// Cosines of facing at which the photograph begins to count and counts fully.
const FACING: [f32; 2] = [0.22, 0.55];
/// A vertex this far behind the front surface is hidden, metres.
const HIDDEN_M: f32 = 0.0025;
/// Difference from the backdrop below which a vertex of the outline shows it, grey levels.
const BACKDROP: f32 = 34.0;
/// Marks the share of such a vertex, before it is set to 0.
const SHOWS_BACKDROP: f32 = f32::NEG_INFINITY;
/// Distance below which landmarks are merged for the warp, metres on the face.
const DISTINCT_M: f32 = 0.003;
/// Rings of vertices around the backdrop that may show its fringe.
const FRINGE: usize = 2;
/// Sweeps of the relaxation: colours travel about as many vertices.
const SWEEPS: usize = 300;

/// Data common to all heads, prepared once.
pub struct Wardrobe {
    plain: HeadAsset,
    /// Vertices connected to each vertex by an edge; those at one position count as one.
    neighbours: Vec<Vec<u32>>,
}

impl Wardrobe {
    /// From the plain head with its final landmark sites.
    pub fn new(plain: HeadAsset) -> Self {
        let n = plain.neutral.len();
        let mut places: HashMap<[u32; 3], Vec<u32>> = HashMap::new();
        for (v, p) in (0..).zip(&plain.neutral) {
            let place = [p.x, p.y, p.z].map(f32::to_bits);
            places.entry(place).or_default().push(v);
        }
        let mut neighbours = vec![Vec::new(); n];
        for t in plain.triangles.iter() {
            for (a, b) in [(0, 1), (1, 2), (2, 0)] {
                neighbours[t[a] as usize].push(t[b]);
                neighbours[t[b] as usize].push(t[a]);
            }
        }
        for same in places.values().filter(|same| same.len() > 1) {
            let all = same.iter().flat_map(|&v| &neighbours[v as usize]);
            let all: Vec<u32> = all.copied().collect();
            for &v in same {
                neighbours[v as usize] = all.clone();
            }
        }
        for list in &mut neighbours {
            list.sort_unstable();
            list.dedup();
        }
        Self { plain, neighbours }
    }

    /// Projects one portrait onto the mesh.
    pub fn dress(
        &self,
        ict: &IctHead,
        fit: &PortraitFit,
        points: &Points,
        photograph: &Texture,
    ) -> HeadAsset {
        let moved = |places: &[Point3<f32>], modes: &[Delta], weights: &[f64]| {
            let mut places = places.to_vec();
            for (mode, &weight) in modes.iter().zip(weights) {
                for (p, offset) in places.iter_mut().zip(&mode.offsets) {
                    *p += offset * weight as f32;
                }
            }
            places
        };
        let (identity, expression) = fit.weights.as_slice().split_at(ict.identities.len());
        let neutral = moved(&self.plain.neutral, &ict.identities, identity);
        let expressed = moved(&neutral, &ict.expressions, expression);
        let projected: Vec<([f32; 2], f32)> = expressed.iter().map(|p| fit.project(p)).collect();
        let from = self.plain.landmarks_on(&expressed);
        let from = from.map(|p| fit.project(&p).0);
        let spline = bend(&from, points, DISTINCT_M * fit.scale as f32);
        let bent = |p: [f32; 2]| {
            let spline = spline.as_ref();
            spline.map_or(p, |spline| {
                let to = spline.warp(&Vector2::from(p).cast());
                [to.x as f32, to.y as f32]
            })
        };
        let bent: Vec<[f32; 2]> = projected.iter().map(|(p, _)| bent(*p)).collect();
        let share = self.share(fit, &expressed, &projected, &bent, photograph);
        let colour = self.colours(&share, &bent, photograph);
        let (photo, texture) = cropped(&bent, &share, photograph);
        let mut asset = HeadAsset {
            neutral,
            photo: photo.into(),
            photo_share: share.into(),
            colour: colour.into(),
            texture: texture.levels().into(),
            ..self.plain.clone()
        };
        asset.centre();
        asset
    }

    /// Share of the photograph at each vertex.
    fn share(
        &self,
        fit: &PortraitFit,
        expressed: &[Point3<f32>],
        projected: &[([f32; 2], f32)],
        bent: &[[f32; 2]],
        photograph: &Texture,
    ) -> Vec<f32> {
        let mut normals = vec![Vector3::zeros(); expressed.len()];
        let triangles = self.plain.triangles.iter();
        let triangles = triangles.map(|t| t.map(|k| k as usize));
        sum_normals(triangles.clone(), expressed, &mut normals);
        // Seen from a metre in front of the head's origin.
        let near = |v: usize| 1.0 - projected[v].1;
        let mut front = DepthBuffer::new(photograph.width, photograph.height);
        for [a, b, c] in triangles {
            for corners in [[a, b, c], [a, c, b]] {
                let corners = corners.map(|v| Corner::new(bent[v], near(v)));
                front.triangle(corners, |_, _, _| {});
            }
        }
        let turn = fit.rotation.cast::<f32>();
        let backdrop = backdrop(photograph);
        let [right, bottom] = [photograph.width, photograph.height].map(|size| size as f32 - 4.0);
        let of_vertex = |v: usize| {
            let [x, y] = bent[v];
            let inside = x > 3.0 && y > 3.0 && x < right && y < bottom;
            let Some(part @ (Part::Skin | Part::Eye)) = vertex_part(v).filter(|_| inside) else {
                return 0.0;
            };
            let pixel = y.round() as usize * photograph.width + x.round() as usize;
            if near(v) < front.inverse[pixel] - HIDDEN_M {
                return 0.0;
            }
            if part == Part::Eye {
                return 1.0;
            }
            let facing = -(turn * normals[v].normalize()).z;
            if !part::NARROW_FACE.contains(&v) || facing < 0.7 {
                let c = photograph.colour_at(x, y);
                let off = (0..3).map(|k| (c[k] - backdrop[k]).powi(2));
                if off.sum::<f32>().sqrt() < BACKDROP {
                    return SHOWS_BACKDROP;
                }
            }
            smoothstep(FACING[0], FACING[1], facing)
        };
        let mut share: Vec<f32> = (0..expressed.len()).map(of_vertex).collect();
        self.leave_out_backdrop(&mut share);
        self.soften(&mut share);
        share
    }

    /// Sets the share to 0 where the backdrop shows, and beside it outside the face.
    fn leave_out_backdrop(&self, share: &mut [f32]) {
        for _ in 0..FRINGE {
            let before = share.to_vec();
            for (v, share) in share.iter_mut().enumerate() {
                let beside = |k: &u32| before[*k as usize] == SHOWS_BACKDROP;
                if !part::NARROW_FACE.contains(&v) && self.neighbours[v].iter().any(beside) {
                    *share = SHOWS_BACKDROP;
                }
            }
        }
        share.iter_mut().for_each(|s| *s = s.max(0.0));
    }

    /// Smooths shares without spreading into unknown vertices.
    fn soften(&self, share: &mut [f32]) {
        for _ in 0..3 {
            let before = share.to_vec();
            for (v, share) in share.iter_mut().enumerate() {
                let around = &self.neighbours[v];
                if !around.is_empty() && before[v] > 0.0 && vertex_part(v) == Some(Part::Skin) {
                    let sum = around.iter().map(|&k| before[k as usize]).sum::<f32>();
                    *share = before[v].min(sum / around.len() as f32 + 0.12);
                }
            }
        }
    }

    fn colours(&self, share: &[f32], bent: &[[f32; 2]], photograph: &Texture) -> Vec<[f32; 3]> {
        let known = bent.iter().map(|&[x, y]| photograph.colour_at(x, y));
        let known: Vec<[f32; 3]> = known.collect();
        let seen: Vec<usize> = part::NARROW_FACE.filter(|&v| share[v] > 0.9).collect();
        let skin = [0, 1, 2].map(|k| {
            let sum = seen.iter().map(|&v| known[v][k]).fold(0.0, |a, b| a + b);
            sum / (seen.len() as f32).max(1.0)
        });
        let is_spread = |v: usize| matches!(vertex_part(v), Some(Part::Skin | Part::Eye));
        let all = 0..share.len();
        let first = |v: usize| match is_spread(v) {
            true => [0, 1, 2].map(|k| skin[k] + share[v] * (known[v][k] - skin[k])),
            false => self.plain.colour[v],
        };
        let mut colour: Vec<[f32; 3]> = all.clone().map(first).collect();
        let mut spread: Vec<usize> = all.filter(|&v| share[v] < 0.98 && is_spread(v)).collect();
        for _ in 0..SWEEPS {
            for &v in &spread {
                let around = &self.neighbours[v];
                let mut sum = [0.0; 3];
                for &k in around {
                    for c in 0..3 {
                        sum[c] += colour[k as usize][c];
                    }
                }
                let s = share[v];
                let count = around.len().max(1) as f32;
                colour[v] = [0, 1, 2].map(|c| s * known[v][c] + (1.0 - s) * sum[c] / count);
            }
            // In both orders, so that colours spread equally fast either way through the numbering.
            spread.reverse();
        }
        colour
    }
}

/// The spline from the landmarks `from` to their `points`. Those closer than `distinct` are merged to their means, as
/// different targets (closed lips) would fold the plane.
fn bend(from: &Points, points: &Points, distinct: f32) -> Option<ThinPlate<2>> {
    let mut groups: Vec<(Vector2<f32>, Vector2<f32>, f32)> = Vec::new();
    for (f, t) in from.iter().zip(points) {
        let (f, t) = (Vector2::from(*f), Vector2::from(*t));
        let mut all = groups.iter_mut();
        match all.find(|(from, _, n)| (*from / *n - f).norm() < distinct) {
            Some((from, to, n)) => (*from, *to, *n) = (*from + f, *to + t, *n + 1.0),
            None => groups.push((f, t, 1.0)),
        }
    }
    let mean = |(f, t, n): &(Vector2<f32>, Vector2<f32>, f32)| ((f / *n).cast(), (t / *n).cast());
    let (from, to): (Vec<_>, Vec<_>) = groups.iter().map(mean).unzip();
    ThinPlate::new(&from, &to, 1e-6)
}

/// Median colour of the upper corners: the studio's backdrop.
fn backdrop(photograph: &Texture) -> [f32; 3] {
    [0, 1, 2].map(|k| {
        let corner = (4..24).flat_map(|y| (4..24).map(move |i| (y, i)));
        let corners = corner.flat_map(|(y, i)| [(y, i), (y, photograph.width - 1 - i)]);
        let value = |(y, x)| photograph.rgb[(y * photograph.width + x) * 3 + k];
        let mut values: Vec<u8> = corners.map(value).collect();
        values.sort_unstable();
        f32::from(values[values.len() / 2])
    })
}

/// The used part of the photograph, and texture coordinates in it.
fn cropped(bent: &[[f32; 2]], share: &[f32], photograph: &Texture) -> (Vec<[f32; 2]>, Texture) {
    let mut low = [photograph.width as f32, photograph.height as f32];
    let mut high = [0.0f32; 2];
    for (p, _) in bent.iter().zip(share).filter(|(_, s)| **s > 0.0) {
        for k in 0..2 {
            low[k] = low[k].min(p[k]);
            high[k] = high[k].max(p[k]);
        }
    }
    // With a margin for coarser mip levels, and a multiple of four for exact halving.
    let start = low.map(|v| (v.max(12.0) as usize - 12).min(100_000));
    let limit = [photograph.width, photograph.height];
    let size = [0, 1].map(|k| {
        let end = (high[k] as usize + 12).min(limit[k]);
        end.saturating_sub(start[k]).max(4) / 4 * 4
    });
    let mut rgb = Vec::with_capacity(size[0] * size[1] * 3);
    for row in start[1]..start[1] + size[1] {
        let at = (row * photograph.width + start[0]) * 3;
        rgb.extend_from_slice(&photograph.rgb[at..at + size[0] * 3]);
    }
    let [width, height] = size;
    let moved = bent.iter().map(|p| [0, 1].map(|k| p[k] - start[k] as f32));
    (moved.collect(), Texture { width, height, rgb })
}
