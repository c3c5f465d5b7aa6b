//! The skin of a head for placing points: intersection with the viewer's ray, nearest vertex, and mirrored vertex.
//!
//! A landmark is a vertex, so a point snaps to the nearest eligible one: on the skin, facing the viewer, not used by
//! another landmark and, where closed lids or lips meet, on the edge that faces the right way.
//!
//! Units and frame: the mesh's. Cost: linear in the mesh per point, milliseconds. Limits: an asymmetric head is
//! mirrored about the middle of its present points.

use mien_baking::bake::mesh::{Mesh, Nearest, Vec3, bounding_box};
use mien_baking::bake::names::{LANDMARKS, mirrored};
use mien_baking::bake::order::Ordered;

/// Cosine between a normal and the line of sight above which a vertex faces away.
const MAX_FACING_AWAY: f64 = 0.5;
/// Distance penalty for the wrong edge of lids or lips, as a fraction of the skin's size.
const WRONG_EDGE: f64 = 0.01;
/// Largest distance of a mirrored vertex from its twin, in sizes of the skin.
const TWIN: f64 = 0.005;
/// Distance penalty for leaving the middle of the head, for points in it.
const OFF_MIDDLE: f64 = 20.0;
/// Least share of sampled vertices with a twin in a symmetric head.
const MIN_TWIN_SHARE: f64 = 0.95;
/// Number of sampled vertices.
const SAMPLED_VERTICES: usize = 500;

/// A line of sight.
#[derive(Clone, Copy, Debug)]
pub struct Ray {
    /// Position of the viewer.
    pub from: Vec3,
    /// Direction, of any length.
    pub along: Vec3,
}

/// A mirror plane: `p · across = at`.
#[derive(Clone, Copy, Debug)]
pub struct Plane {
    /// Unit vector to one side.
    across: Vec3,
    at: f64,
}

impl Plane {
    fn off(&self, p: &Vec3) -> f64 {
        p.dot(&self.across) - self.at
    }

    /// The mirrored point.
    pub fn mirrored(&self, p: &Vec3) -> Vec3 {
        p - self.across * (2.0 * self.off(p))
    }
}

/// The skin of a mesh.
pub struct Surface {
    positions: Vec<Vec3>,
    normals: Vec<Vec3>,
    triangles: Vec<[u32; 3]>,
    skin: Vec<bool>,
    size: f64,
    /// The mirror plane of a symmetric head.
    plane: Option<Plane>,
}

impl Surface {
    /// The surface of a mesh and its canonical form; the skin is the part with the chin's vertex.
    pub fn new(mesh: &Mesh, ordered: &Ordered, chin: u64) -> Self {
        let rings = ordered.mesh.rings();
        let (component, _) = ordered.mesh.components(&rings);
        let of = |v: u32| component.get(v as usize);
        let all = ordered.vertex();
        let wanted = all.get(chin as usize).and_then(|&v| of(v));
        let skin: Vec<bool> = all.iter().map(|&v| of(v) == wanted).collect();
        let mut surface = Self {
            normals: mesh.vertex_normals(&mesh.positions),
            triangles: mesh.triangles(),
            positions: mesh.positions.clone(),
            skin,
            size: 0.0,
            plane: None,
        };
        surface.plane = surface.find_plane();
        surface
    }

    /// Whether a vertex is on the skin.
    pub fn is_skin(&self, vertex: u64) -> bool {
        usize::try_from(vertex).is_ok_and(|v| self.skin.get(v) == Some(&true))
    }

    /// Whether the head is symmetric.
    pub fn is_symmetric(&self) -> bool {
        self.plane.is_some()
    }

    /// Position and unit normal of a vertex.
    pub fn position_and_normal(&self, vertex: u64) -> (Vec3, Vec3) {
        let v = vertex as usize;
        (self.positions[v], self.normals[v])
    }

    fn find_plane(&mut self) -> Option<Plane> {
        let all = 0..self.positions.len() as u32;
        let skin: Vec<u32> = all.filter(|&v| self.skin[v as usize]).collect();
        let (low, high) = bounding_box(skin.iter().map(|&v| &self.positions[v as usize]));
        self.size = (high - low).max();
        let nearest = Nearest::new(&self.positions, &skin);
        let looked = || skin.iter().step_by((skin.len() / SAMPLED_VERTICES).max(1));
        // The face looks along z or x.
        [Vec3::x(), Vec3::z()].into_iter().find_map(|across| {
            let at = 0.5 * (low + high).dot(&across);
            let plane = Plane { across, at };
            let has_twin = |&&v: &&u32| {
                let there = plane.mirrored(&self.positions[v as usize]);
                let twin = nearest.closest(&there);
                twin.is_some_and(|t| (self.positions[t as usize] - there).norm() < TWIN * self.size)
            };
            let twins = looked().filter(has_twin).count();
            (twins as f64 > MIN_TWIN_SHARE * looked().count() as f64).then_some(plane)
        })
    }

    /// The mirror plane for these points.
    fn plane(&self, points: &[u64]) -> Plane {
        self.plane.unwrap_or_else(|| {
            let at = |k: usize| self.positions[points[k] as usize];
            let all = (0..LANDMARKS).map(|k| (k, mirrored(k)));
            let pairs = || all.clone().filter(|(a, b)| a < b);
            let across = pairs().map(|(a, b)| at(b) - at(a)).sum::<Vec3>();
            let across = across.try_normalize(0.0).unwrap_or_else(Vec3::x);
            let middles = pairs().map(|(a, b)| 0.5 * (at(a) + at(b)).dot(&across));
            let at = middles.sum::<f64>() / pairs().count() as f64;
            Plane { across, at }
        })
    }

    /// The first intersection of a ray with the mesh.
    pub fn hit(&self, ray: &Ray) -> Option<Vec3> {
        let met = self.triangles.iter().filter_map(|t| {
            let [a, b, c] = t.map(|v| self.positions[v as usize]);
            let (ab, ac) = (b - a, c - a);
            let h = ray.along.cross(&ac);
            let det = ab.dot(&h);
            // Parallel to the triangle, or degenerate.
            if det == 0.0 {
                return None;
            }
            let s = ray.from - a;
            let u = s.dot(&h) / det;
            let q = s.cross(&ab);
            let v = ray.along.dot(&q) / det;
            let far = ac.dot(&q) / det;
            (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && far > 0.0).then_some(far)
        });
        let far = met.min_by(f64::total_cmp)?;
        Some(ray.from + ray.along * far)
    }

    /// The vertex for landmark `k` at `place`, seen along `sight`, excluding those `taken`.
    fn snapped(
        &self,
        k: usize,
        sight: &Vec3,
        taken: &[u64],
        far: &dyn Fn(&Vec3) -> f64,
    ) -> Option<u64> {
        let cost = |v: usize| {
            let up = self.normals[v].y;
            let wrong = match k {
                37 | 38 | 43 | 44 | 61..=63 => up > 0.1,
                40 | 41 | 46 | 47 | 65..=67 => up < -0.1,
                _ => false,
            };
            far(&self.positions[v]) + if wrong { WRONG_EDGE * self.size } else { 0.0 }
        };
        (0..self.positions.len())
            .filter(|&v| self.skin[v] && self.normals[v].dot(sight) < MAX_FACING_AWAY)
            .filter(|&v| !taken.contains(&(v as u64)))
            .min_by(|&a, &b| cost(a).total_cmp(&cost(b)))
            .map(|v| v as u64)
    }

    /// The points after dragging landmark `k` to the intersection of `ray` with the head, or its nearest approach;
    /// with `mirror` its partner on the other side follows, and a point of the middle stays in it.
    pub fn moved(&self, points: &[u64], k: usize, ray: &Ray, mirror: bool) -> Vec<u64> {
        let partner = mirrored(k);
        let sight = ray.along.normalize();
        let plane = mirror.then(|| self.plane(points));
        let place = self.hit(ray).map(|p| match plane {
            Some(plane) if partner == k => p - plane.across * plane.off(&p),
            _ => p,
        });
        self.placed(points, k, &sight, plane, &|p| match place {
            Some(place) => (p - place).norm(),
            None => (p - ray.from).cross(&sight).norm(),
        })
    }

    /// The points after moving landmark `k` to the nearest vertex within 45° of a direction in the view along
    /// `sight`; `mirror` as for [`Self::moved`].
    pub fn stepped(
        &self,
        points: &[u64],
        k: usize,
        [sight, towards]: [Vec3; 2],
        mirror: bool,
    ) -> Vec<u64> {
        let (sight, towards) = (sight.normalize(), towards.normalize());
        let plane = mirror.then(|| self.plane(points));
        let middle = plane.filter(|_| mirrored(k) == k);
        let (from, _) = self.position_and_normal(points[k]);
        self.placed(points, k, &sight, plane, &|p| {
            let off = p - from;
            let (along, far) = (off.dot(&towards), off.norm());
            let seen = (off - sight * off.dot(&sight)).norm();
            if along <= std::f64::consts::FRAC_1_SQRT_2 * seen || seen < 1e-6 * self.size {
                return f64::INFINITY;
            }
            // Along the middle of the head.
            far + middle.map_or(0.0, |plane| OFF_MIDDLE * plane.off(p).abs())
        })
    }

    /// The points with landmark `k` on the eligible vertex of least `far`, and its twin opposite if there is a plane;
    /// unchanged if no vertex is eligible.
    fn placed(
        &self,
        points: &[u64],
        k: usize,
        sight: &Vec3,
        plane: Option<Plane>,
        far: &dyn Fn(&Vec3) -> f64,
    ) -> Vec<u64> {
        let partner = mirrored(k);
        let mut now = points.to_vec();
        // The moving point does not block its own vertex.
        now[k] = u64::MAX;
        if plane.is_some() {
            now[partner] = u64::MAX;
        }
        let found = self.snapped(k, sight, &now, far);
        let is_there = |&v: &u64| far(&self.positions[v as usize]).is_finite();
        let Some(found) = found.filter(is_there) else {
            return points.to_vec();
        };
        now[k] = found;
        if let Some(plane) = plane
            && partner != k
        {
            let there = plane.mirrored(&self.positions[found as usize]);
            let sight = sight - plane.across * (2.0 * sight.dot(&plane.across));
            let twin = self.snapped(partner, &sight, &now, &|p| (p - there).norm());
            now[partner] = twin.unwrap_or(points[partner]);
        }
        now
    }
}
