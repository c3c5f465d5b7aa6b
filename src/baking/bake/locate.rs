//! `--landmarks auto`: finds the 68 landmark vertices of a head.
//!
//! Up may be y or z, and the face may look along any level axis. From each direction every part that may be skin
//! is rendered alone with the eyeballs, and the face model is run once on squares around the eyeballs, or at all
//! sizes below the top of the part. The points must be plausible in 3D ([`by_shape`]). The best candidates are fitted
//! in several boxes, and each point is cast back to the visible vertex under it. Points of openings (lids, inner
//! lips) go to the nearest rim vertex: visible, with a hidden neighbour. A symmetric face gets symmetric points.
//! Brows and jaw, which plaster does not show, are placed by the shape model.
//!
//! Units: the mesh's; images in pixels. Cost: 0.2 to 0.4 s where the first direction succeeds, 4 s on a core to
//! rule out a face. Limits: the model learned photographs of people, not plaster or cartoons; an inclined head is not
//! found.

mod search;
mod seen;

use std::collections::HashSet;

use image::RgbImage;
use nalgebra::Matrix3;

use self::search::{DEEP, FRAME, Face, Search, distance_penalty};
use self::seen::{PIXELS, Parts, distance};
use super::by_shape;
use super::looks::{Looks, Surfaces};
use super::mesh::{Mesh, Rings, Vec3, bounding_box};
use mien_stages::base::capacity::LANDMARKS;
use mien_stages::face_model::FaceModel;
use mien_stages::face_model::scheme::MIRROR;
use mien_workbench::canvas;

/// Enlargement of the picture for the user.
const ENLARGED: u32 = 3;
/// Least confidence of a face.
const MIN_FACE_CONFIDENCE: f32 = 0.6;
/// Confidence below which a point needs a check: `bake` names it, `place` marks it.
pub const LOW_CONFIDENCE: f32 = 0.4;
/// Points 0 to 16 are the jaw's, up to 26 the brows'.
const UNMARKED: usize = 27;
/// Distance from the position that the others predict at which a point is hardly trusted, in inner-eye-corner
/// distances.
const DOUBTFUL: f64 = 0.1;
/// Largest distance of a rim vertex from its fitted point, in head widths: beyond is another opening.
const RIM: f64 = 0.03;
/// Largest distance of the lids' meeting point beyond the fitted inner corner, in eye widths.
const CORNER: f64 = 0.25;
/// Largest distance of the lids' meeting point above or below the fitted inner corner, in eye widths.
const LEVEL: f64 = 0.1;
/// Sine of the largest slope of lids.
const STEEP: f64 = 0.3;
/// Width of the head in the picture, pixels.
const WIDTH: f64 = PIXELS as f64 / FRAME;

/// The landmarks found on a mesh.
pub struct Located {
    /// The 68 vertices.
    pub vertices: Vec<u64>,
    /// Confidence that this is a face, 0 to 1.
    pub confidence: f32,
    /// Confidence of each point, 0 to 1: the face's, lowered by disagreement with other boxes, the nearest vertex or
    /// the shape model.
    pub point_confidence: [f32; LANDMARKS],
    /// Axis of the mesh that points up.
    pub up: &'static str,
    /// Axis of the mesh that the face looks along.
    pub facing: &'static str,
    /// A rendering of the head with the points.
    pub picture: RgbImage,
}

impl Located {
    /// Whether the confidence suffices for a face.
    pub fn is_face(&self) -> bool {
        self.confidence >= MIN_FACE_CONFIDENCE
    }

    /// Points less confident than [`LOW_CONFIDENCE`], the least first.
    pub fn unsure(&self) -> Vec<usize> {
        let sure = &self.point_confidence;
        let mut unsure: Vec<usize> = (0..LANDMARKS)
            .filter(|&k| sure[k] < LOW_CONFIDENCE)
            .collect();
        unsure.sort_by(|&a, &b| sure[a].total_cmp(&sure[b]));
        unsure
    }
}

/// Finds the landmarks, however low their confidence, for the user to correct: on the plain surface first, then with
/// colours. `front`, the rotation from the file's axes, is tried first, all directions only if it shows no face.
/// `None` for a mesh without a surface.
pub fn guess(
    mesh: &Mesh,
    looks: &Looks,
    front: Option<Matrix3<f64>>,
    model: &FaceModel,
) -> Option<Located> {
    let rings = mesh.rings();
    let mut search = Search::new(mesh, Parts::new(mesh, &rings), model);
    let surfaces = || Some(Surfaces::new(mesh, looks)).filter(Surfaces::any);
    for only in front.map(Some).into_iter().chain([None]) {
        search.parts.surfaces = None;
        search.all_around(only.as_ref());
        if !search.is_sure() {
            search.parts.surfaces = surfaces();
            if search.parts.surfaces.is_some() {
                search.all_around(only.as_ref());
            }
        }
        if search.is_sure() {
            break;
        }
    }
    let face = search.best?;
    let seen = &face.seen;
    let on_skin = search.parts.of.iter().map(|&part| part == face.skin);
    let placing = Placing {
        model,
        mesh,
        rings: &rings,
        face: &face,
        screen: mesh.positions.iter().map(|p| seen.screen(p)).collect(),
        skin: on_skin.collect(),
    };
    let (vertices, point_confidence) = placing.placed();
    Some(Located {
        picture: placing.picture(&vertices),
        vertices: vertices.into_iter().map(u64::from).collect(),
        confidence: face.confidence,
        point_confidence,
        up: axis(&seen.to_view, 1),
        facing: axis(&seen.to_view, 2),
    })
}

/// The mesh axis of a row of a view.
fn axis(to_view: &Matrix3<f64>, row: usize) -> &'static str {
    let along = to_view.row(row);
    let k = along.iamax_full().1;
    let names = [["-x", "+x"], ["-y", "+y"], ["-z", "+z"]];
    names[k][usize::from(along[k] > 0.0)]
}

/// A face and the mesh on which it was found.
struct Placing<'a> {
    model: &'a FaceModel,
    mesh: &'a Mesh,
    rings: &'a Rings,
    face: &'a Face,
    /// Each vertex projected: pixels, and depth in pixels.
    screen: Vec<Vec3>,
    skin: Vec<bool>,
}

impl Placing<'_> {
    /// Vertices of the points, and the confidence of each.
    fn placed(&self) -> (Vec<u32>, [f32; LANDMARKS]) {
        let (points, mut point_confidence) = (&self.face.points, self.face.point_confidence);
        let mirror = self.mirror();
        let mut vertices = self.cast(mirror);
        // Confidence falls with the distance of the vertex from the fitted point.
        let eyes = distance(points[39], points[42]).max(f32::MIN_POSITIVE);
        for ((sure, point), &v) in point_confidence.iter_mut().zip(points).zip(&vertices) {
            let at = self.screen[v as usize];
            *sure /= distance_penalty(distance(*point, [at.x as f32, at.y as f32]) / eyes);
        }
        // Brows and jaw keep only the confidence of the face.
        point_confidence[..UNMARKED].fill(self.face.confidence);
        let shares = self.by_the_rest(mirror, &mut vertices);
        for (sure, share) in point_confidence.iter_mut().zip(shares) {
            *sure *= share as f32;
        }
        (vertices, point_confidence)
    }

    /// The rendering enlarged, with the points drawn in.
    fn picture(&self, vertices: &[u32]) -> RgbImage {
        let side = PIXELS * ENLARGED;
        let filter = image::imageops::FilterType::Triangle;
        let drawn = &self.face.seen.canvas.image;
        let mut picture = image::imageops::resize(drawn, side, side, filter);
        for (k, &v) in vertices.iter().enumerate() {
            let p = self.screen[v as usize];
            let [x, y] = [p.x, p.y].map(|c| ((c + 0.5) * f64::from(ENLARGED)) as f32);
            // Inner lips and lids in a second colour.
            let lines = matches!(k, 36..=47 | 60..=67);
            let colour = if lines { [250, 220, 40] } else { [30, 220, 70] };
            canvas::square(&mut picture, x, y, 2, colour);
        }
        picture
    }

    /// Places brows and jaw by the shape model. Returns a confidence factor per point.
    fn by_the_rest(&self, mirror: Option<f64>, vertices: &mut [u32]) -> [f64; LANDMARKS] {
        let upright = |p: &Vec3| Vec3::new(p.x, -p.y, p.z);
        let view: Vec<Vec3> = self.screen.iter().map(upright).collect();
        let found: [Vec3; LANDMARKS] = std::array::from_fn(|k| view[vertices[k] as usize]);
        let Some(laid) = by_shape::completed(&self.model.shape, &found) else {
            return [0.0; LANDMARKS];
        };
        let eyes = (found[39] - found[42]).norm();
        // Former brow and jaw vertices must not block new ones.
        vertices[..UNMARKED].fill(u32::MAX);
        std::array::from_fn(|k| {
            let mut there = laid[k];
            if let Some(plane) = mirror {
                let mut other = laid[MIRROR[k]];
                other.x = 2.0 * plane - other.x;
                there = (there + other) / 2.0;
            }
            if k < UNMARKED {
                let far = |v: u32| (view[v as usize] - there).norm_squared();
                let free = |v: &u32| self.skin[*v as usize] && !vertices.contains(v);
                let free = (0..view.len() as u32).filter(free);
                let nearest = free.min_by(|&a, &b| far(a).total_cmp(&far(b)));
                vertices[k] = nearest.unwrap_or(0);
            }
            let miss = (view[vertices[k] as usize] - there).norm() / (DOUBTFUL * eyes);
            (-0.5 * miss * miss).exp()
        })
    }

    /// The vertex under each fitted point.
    fn cast(&self, mirror: Option<f64>) -> Vec<u32> {
        let Face { points, seen, .. } = self.face;
        let (screen, rings) = (&self.screen, self.rings);
        let n = screen.len();
        let normals = self.mesh.vertex_normals(&self.mesh.positions);
        let towards = seen.to_view.transpose() * Vec3::z();
        let faces = |v: usize| normals[v].dot(&towards) > 0.0 && seen.canvas.shows(&screen[v]);
        let visible: Vec<bool> = (0..n).map(|v| self.skin[v] && faces(v)).collect();
        let border = self.mesh.border();
        let ends = |v: usize| border[v] || rings.members(v).iter().any(|&o| !visible[o as usize]);
        let rim: Vec<bool> = (0..n).map(|v| visible[v] && ends(v)).collect();
        // In a symmetric head, the mean of a point and its mirrored partner.
        let aim = |k: usize| {
            let [p, q] = [k, MIRROR[k]].map(|k| points[k].map(f64::from));
            mirror.map_or(p, |plane| {
                [0.5 * (p[0] + 2.0 * plane - q[0]), 0.5 * (p[1] + q[1])]
            })
        };
        let up = |v: usize| (seen.to_view * normals[v]).y;
        let deep = DEEP * f64::from(distance(points[39], points[42]));
        let mut taken: Vec<u32> = Vec::with_capacity(LANDMARKS);
        for k in 0..LANDMARKS {
            let [x, y] = aim(k);
            let far = |v: usize| (screen[v].x - x).hypot(screen[v].y - y);
            let nearest = |fits: &dyn Fn(usize) -> bool| {
                let free = |v: &usize| visible[*v] && fits(*v) && !taken.contains(&(*v as u32));
                let free = (0..n).filter(free);
                free.min_by(|&a, &b| far(a).total_cmp(&far(b)))
            };
            // An upper edge faces down, a lower one up; corners may face anywhere.
            let lines = |v: usize| match k {
                37 | 38 | 43 | 44 | 61..=63 => rim[v] && up(v) < 0.1,
                40 | 41 | 46 | 47 | 65..=67 => rim[v] && up(v) > -0.1,
                _ => rim[v],
            };
            // Vertices seen through an opening lie too deep.
            let level = |v: usize| (screen[v].z - self.face.depths[k]).abs() < deep;
            let mut vertex = None;
            if matches!(k, 36..=47 | 60..=67) {
                vertex = nearest(&|v| lines(v) && level(v)).filter(|&v| far(v) < RIM * WIDTH);
            }
            let vertex = vertex.or_else(|| nearest(&level));
            let vertex = vertex.or_else(|| nearest(&|_| true));
            taken.push(vertex.unwrap_or(0) as u32);
        }
        for [corner, outer] in [[39, 36], [42, 45]] {
            if let Some(end) = self.lids_meet(taken[corner], taken[outer], &|v| visible[v], &up) {
                taken[corner] = end;
            }
        }
        taken
    }

    /// The vertex at which an eye's lids meet beside the nose, beyond the lacrimal caruncle: from the fitted corner
    /// on, and level with it, the first with upward-facing skin right below and downward-facing skin right above.
    fn lids_meet(
        &self,
        corner: u32,
        outer: u32,
        visible: &dyn Fn(usize) -> bool,
        up: &dyn Fn(usize) -> f64,
    ) -> Option<u32> {
        let at = |v: u32| self.screen[v as usize].xy();
        let along = at(corner) - at(outer);
        let wide = along.norm();
        let beyond = |v: u32| (at(v) - at(corner)).dot(&along) / (wide * wide);
        let level = |v: u32| (at(v) - at(corner)).perp(&along).abs() / (wide * wide) < LEVEL;
        let near = |v: u32| (0.0..CORNER).contains(&beyond(v)) && level(v) && visible(v as usize);
        let meets = |v: u32| {
            let mut lids = [false; 2];
            for &o in self.rings.members(v as usize) {
                lids[0] |= up(o as usize) > STEEP && at(o).y >= at(v).y;
                lids[1] |= up(o as usize) < -STEEP && at(o).y <= at(v).y;
            }
            lids == [true; 2]
        };
        let corners = (0..self.screen.len() as u32).filter(|&v| near(v) && meets(v));
        corners.min_by(|&a, &b| beyond(a).total_cmp(&beyond(b)))
    }

    /// Column of the mirror plane, if nearly all vertices of the face have a partner there.
    fn mirror(&self) -> Option<f64> {
        let points = &self.face.points;
        let mean = points.iter().map(|p| f64::from(p[0])).sum::<f64>() / LANDMARKS as f64;
        let [top, chin] = [27, 8].map(|k| f64::from(points[k][1]));
        // Shoulders and hair need not be symmetric.
        let tall = (chin - top).abs();
        let near = |p: &&Vec3| p.y > top - 0.5 * tall && p.y < chin && (p.x - mean).abs() < WIDTH;
        let of_skin = self.screen.iter().zip(&self.skin).filter(|s| *s.1);
        let all: Vec<&Vec3> = of_skin.map(|s| s.0).filter(near).collect();
        let tip = all.iter().max_by(|a, b| a.z.total_cmp(&b.z))?;
        let (low, high) = bounding_box(all.iter().copied());
        let middles = [tip.x, 0.5 * (low.x + high.x), mean];
        let alone = middles.map(|at| (alone(&all, at, 0.02 * WIDTH), at));
        let least = alone.into_iter().min_by(|a, b| a.0.total_cmp(&b.0));
        least.filter(|least| least.0 < 0.05).map(|least| least.1)
    }
}

/// Share of points without a mirrored partner.
fn alone(all: &[&Vec3], middle: f64, cell: f64) -> f64 {
    let key = |x: f64, p: &Vec3| [x, p.y, p.z].map(|c| (c / cell).round() as i64);
    let there: HashSet<[i64; 3]> = all.iter().map(|p| key(p.x - middle, p)).collect();
    let alone = all.iter().filter(|p| {
        let [x, y, z] = key(middle - p.x, p);
        !(-1..=1).any(|d| there.contains(&[x + d, y, z]))
    });
    alone.count() as f64 / all.len().max(1) as f64
}
