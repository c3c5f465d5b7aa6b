//! Inverted triangles, found by looking at each triangle among its neighbours.
//!
//! An inverted triangle is one whose normal opposes the mean normal of the triangles up to two rings around it *in the
//! deformed mesh* (cosine below 0) although it agreed in the neutral (above 0.3). Comparing with the neutral normal
//! instead would count the honest rolling of lips and lids.
//!
//! Cost: linear in the triangles looked at; memory: a few numbers per triangle and vertex.

use std::cell::Cell;

use super::head::Head;
use super::mesh::{Lists, Rings, Vec3, rings_of};

/// A triangle that agrees less with its surroundings in the neutral (cosine) is not judged.
const AGREES: f64 = 0.3;

/// An edge is torn that has grown beyond this many times its length and this part of the eye distance.
const TORN: [f64; 2] = [5.0, 0.05];

/// The skin's triangles and how they lie in their surroundings in the neutral shape.
pub struct Surroundings {
    triangles: Vec<[u32; 3]>,
    /// Neighbours along the triangles' edges: also along those that cut a face.
    rings: Rings,
    /// Triangles at each vertex.
    at: Lists,
    /// Doubled area and cosine with the surroundings of every triangle.
    neutral: Vec<(f64, f64)>,
}

/// A triangle that is inverted or not far from it.
pub struct Flattened {
    /// Its vertices.
    pub corners: [u32; 3],
    /// Mean normal of its surroundings.
    pub normal: Vec3,
    /// Its doubled area.
    pub area: f64,
    /// Doubled area that it is to have, seen along that normal.
    pub wanted: f64,
    /// It faces away from them.
    pub inverted: bool,
}

thread_local! {
    static KEPT: Cell<[Vec<Vec3>; 3]> = const { Cell::new([const { Vec::new() }; 3]) };
}

impl Surroundings {
    /// Of one head; films across a slit are left out.
    pub fn new(head: &Head) -> Self {
        let mut triangles = Vec::new();
        for f in 0..head.mesh.faces() {
            if !head.film[f] && head.skin[head.mesh.face(f)[0].vertex as usize] {
                // A quad as the file cuts it: from its first corner ([`super::order`]).
                triangles.extend(head.mesh.fan(f).map(|t| t.map(|c| c.vertex)));
            }
        }
        let n = head.mesh.positions.len();
        let numbered = triangles.iter().zip(0_u32..);
        let at = numbered.flat_map(|(t, k)| t.map(|v| [v, k]));
        let edges = triangles.iter();
        let edges = edges.flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]);
        let mut out = Self {
            at: Lists::new(n, at.collect()),
            rings: rings_of(n, edges),
            triangles,
            neutral: Vec::new(),
        };
        let all: Vec<u32> = (0..out.triangles.len() as u32).collect();
        let lie = out.lie(&|v| head.mesh.positions[v as usize], &all);
        out.neutral = lie.into_iter().map(|lie| (lie.0, lie.1)).collect();
        out
    }

    /// All triangles that see one of the changed vertices in their surroundings, ascending.
    pub fn seeing(&self, changed: &[u32]) -> Vec<u32> {
        // A triangle sees the corners of all triangles that touch the ring of one of its corners: three steps.
        let near = self.rings.about(changed, 2).concat();
        let mut sees = vec![false; self.triangles.len()];
        for &k in near.iter().flat_map(|&v| self.at.of(v as usize)) {
            sees[k as usize] = true;
        }
        let all = 0..self.triangles.len() as u32;
        all.filter(|&k| sees[k as usize]).collect()
    }

    /// Doubled area, cosine with the mean normal of the surroundings and that normal, for some of the triangles.
    fn lie(&self, p: &impl Fn(u32) -> Vec3, some: &[u32]) -> Vec<(f64, f64, Vec3)> {
        let corners = some.iter().flat_map(|&k| self.triangles[k as usize]);
        let needed = self.rings.about(&corners.collect::<Vec<u32>>(), 1);
        // Sums of normals around each vertex, and the normal of each triangle, as long as twice its area: kept on each thread, as
        // most looks are at a few triangles.
        let [mut one, mut two, mut normal] = KEPT.take();
        one.resize(one.len().max(self.at.owners()), Vec3::zeros());
        two.resize(one.len(), Vec3::zeros());
        normal.resize(normal.len().max(self.triangles.len()), Vec3::zeros());
        let mut known = vec![false; self.triangles.len()];
        for v in needed.iter().flatten().map(|&v| v as usize) {
            let mut sum = Vec3::zeros();
            for k in self.at.of(v).iter().map(|&k| k as usize) {
                if !std::mem::replace(&mut known[k], true) {
                    let [a, b, c] = self.triangles[k].map(p);
                    normal[k] = (b - a).cross(&(c - a));
                }
                sum += normal[k];
            }
            one[v] = sum;
        }
        for v in needed[0].iter().map(|&v| v as usize) {
            let ring = self.rings.of(v).iter();
            two[v] = ring.fold(one[v], |sum, &o| sum + one[o as usize]);
        }
        let lie = |&k: &u32| {
            let n = normal[k as usize];
            let around = self.triangles[k as usize].iter();
            let around: Vec3 = around.map(|&v| two[v as usize]).sum();
            let around = around.try_normalize(0.0).unwrap_or_default();
            let (area, along) = (n.norm(), n.dot(&around));
            (area, if area > 0.0 { along / area } else { 0.0 }, around)
        };
        let lie = some.iter().map(lie).collect();
        KEPT.set([one, two, normal]);
        lie
    }

    /// Vertices of the triangles that a displacement turns over and of the edges that it tears, ascending; `at` is where vertices
    /// are then.
    pub fn faults(&self, head: &Head, d: &[Vec3], at: &impl Fn(u32) -> Vec3) -> Vec<u32> {
        let all = 0..d.len() as u32;
        let changed: Vec<u32> = all.filter(|&v| d[v as usize] != Vec3::zeros()).collect();
        let some = self.seeing(&changed);
        let flattened = self.flattened(at, &some, 0.0).into_iter();
        let mut found: Vec<u32> = flattened.flat_map(|t| t.corners).collect();
        let spare = TORN[1] * head.eye_distance;
        let torn = |edge: &[u32; 2]| {
            let [was, is] = [edge.map(|v| head.mesh.positions[v as usize]), edge.map(at)];
            let [was, is] = [was, is].map(|[a, b]| (a - b).norm_squared());
            // Roots of the few that may be.
            is > TORN[0].powi(2) * was && is.sqrt() > TORN[0] * was.sqrt() + spare
        };
        let edges = some.iter().map(|&k| self.triangles[k as usize]);
        let edges = edges.flat_map(|[a, b, c]| [[a, b], [b, c], [c, a]]);
        found.extend(edges.filter(torn).flatten());
        found.sort_unstable();
        found.dedup();
        found
    }

    /// Triangles among some that rise less than `height` of their neutral area towards their surroundings.
    pub fn flattened(&self, p: &impl Fn(u32) -> Vec3, some: &[u32], height: f64) -> Vec<Flattened> {
        let lie = some.iter().zip(self.lie(p, some));
        let flattened = lie.filter_map(|(&k, (area, cosine, normal))| {
            let (before, agreed) = self.neutral[k as usize];
            let wanted = height * before;
            let flat = agreed > AGREES && (cosine < 0.0 || area * cosine < wanted);
            flat.then_some(Flattened {
                corners: self.triangles[k as usize],
                normal,
                area,
                wanted,
                inverted: cosine < 0.0,
            })
        });
        flattened.collect()
    }
}
