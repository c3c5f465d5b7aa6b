//! Inverted triangles, found by looking at each triangle among its neighbours.
//!
//! An inverted triangle is one whose normal opposes the mean normal of the triangles up to two rings around it *in the
//! deformed mesh* (cosine below 0) although it agreed in the neutral (above 0.3). Comparing with the neutral normal
//! instead would count the honest rolling of lips and lids.
//!
//! Cost: linear in the triangles looked at; memory: a few numbers per triangle and vertex.

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
    /// Doubled area that it is to have, seen along that normal.
    pub wanted: f64,
    /// It faces away from them.
    pub inverted: bool,
}

/// Room for looking at the surroundings of some triangles, used again and again. Plain numbers: what is not looked at costs no
/// memory.
pub struct Scratch {
    /// Marks of vertices, all unset between uses.
    wanted: Vec<bool>,
    one: Vec<[f64; 3]>,
    two: Vec<[f64; 3]>,
    /// Normals of triangles, as long as twice their area, where they are marked.
    normal: Vec<[f64; 3]>,
    /// Marks of triangles, all unset between uses.
    seen: Vec<bool>,
}

/// Marks a number; whether it was not marked yet.
fn is_new(marks: &mut [bool], k: u32) -> bool {
    !std::mem::replace(&mut marks[k as usize], true)
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
        let lie = out.lie(&|v| head.mesh.positions[v], &all, &mut out.scratch());
        out.neutral = lie.into_iter().map(|lie| (lie.0, lie.1)).collect();
        out
    }

    /// Room for one thread.
    pub fn scratch(&self) -> Scratch {
        let n = self.at.owners();
        Scratch {
            wanted: vec![false; n],
            one: vec![[0.0; 3]; n],
            two: vec![[0.0; 3]; n],
            normal: vec![[0.0; 3]; self.triangles.len()],
            seen: vec![false; self.triangles.len()],
        }
    }

    /// All triangles that see one of the changed vertices in their surroundings, ascending.
    pub fn seeing(&self, changed: &[u32], scratch: &mut Scratch) -> Vec<u32> {
        // A triangle sees the corners of all triangles that touch the ring of one of its corners: three steps.
        let Scratch { wanted, seen, .. } = scratch;
        let mut near = changed.to_vec();
        for &v in changed {
            wanted[v as usize] = true;
        }
        let mut from = 0;
        for _ in 0..2 {
            let to = near.len();
            for k in from..to {
                let ring = self.rings.of(near[k] as usize).iter().copied();
                near.extend(ring.filter(|&o| is_new(wanted, o)));
            }
            from = to;
        }
        let mut found = Vec::new();
        for v in near {
            wanted[v as usize] = false;
            let at = self.at.of(v as usize).iter().copied();
            found.extend(at.filter(|&k| is_new(seen, k)));
        }
        // Ascending; where there are many, all marks are read sooner than some numbers sorted.
        if found.len() > self.triangles.len() / 32 {
            let all = 0..self.triangles.len() as u32;
            found.clear();
            found.extend(all.filter(|&k| seen[k as usize]));
        } else {
            found.sort_unstable();
        }
        for &k in &found {
            seen[k as usize] = false;
        }
        found
    }

    /// Doubled area, cosine with the mean normal of the surroundings and that normal, for some of the triangles.
    fn lie(
        &self,
        p: &impl Fn(usize) -> Vec3,
        some: &[u32],
        scratch: &mut Scratch,
    ) -> Vec<(f64, f64, Vec3)> {
        let (corners, all) = self.needed(some, scratch);
        self.add_normals(p, &all, scratch);
        let (one, two, normal) = (&scratch.one, &mut scratch.two, &scratch.normal);
        for v in corners.into_iter().map(|v| v as usize) {
            let add = |sum: Vec3, &o: &u32| sum + Vec3::from(one[o as usize]);
            two[v] = self.rings.of(v).iter().fold(one[v].into(), add).into();
        }
        let lie = |&k: &u32| {
            let n = Vec3::from(normal[k as usize]);
            let around = self.triangles[k as usize].iter();
            let around: Vec3 = around.map(|&v| Vec3::from(two[v as usize])).sum();
            let around = around.try_normalize(0.0).unwrap_or_default();
            let (area, along) = (n.norm(), n.dot(&around));
            (area, if area > 0.0 { along / area } else { 0.0 }, around)
        };
        some.iter().map(lie).collect()
    }

    /// The corners of some triangles, and these with their rings, each once.
    fn needed(&self, some: &[u32], scratch: &mut Scratch) -> (Vec<u32>, Vec<u32>) {
        let wanted = &mut scratch.wanted;
        let corners = some.iter().flat_map(|&k| self.triangles[k as usize]);
        let corners: Vec<u32> = corners.filter(|&v| is_new(wanted, v)).collect();
        let mut all = corners.clone();
        for &v in &corners {
            let ring = self.rings.of(v as usize).iter().copied();
            all.extend(ring.filter(|&o| is_new(wanted, o)));
        }
        for &v in &all {
            wanted[v as usize] = false;
        }
        (corners, all)
    }

    /// Normals of the triangles at some vertices, and their sum at each.
    fn add_normals(&self, p: &impl Fn(usize) -> Vec3, some: &[u32], scratch: &mut Scratch) {
        let Scratch {
            one, normal, seen, ..
        } = scratch;
        for &v in some {
            let mut sum = Vec3::zeros();
            for &k in self.at.of(v as usize) {
                if is_new(seen, k) {
                    let [a, b, c] = self.triangles[k as usize].map(|v| p(v as usize));
                    normal[k as usize] = (b - a).cross(&(c - a)).into();
                }
                sum += Vec3::from(normal[k as usize]);
            }
            one[v as usize] = sum.into();
        }
        for &k in some.iter().flat_map(|&v| self.at.of(v as usize)) {
            seen[k as usize] = false;
        }
    }

    /// Vertices of the triangles that a displacement turns over and of the edges that it tears, ascending; `at` is where vertices
    /// are then.
    pub fn faults(&self, head: &Head, d: &[Vec3], at: &impl Fn(usize) -> Vec3) -> Vec<u32> {
        let all = 0..d.len() as u32;
        let changed: Vec<u32> = all.filter(|&v| d[v as usize] != Vec3::zeros()).collect();
        let mut scratch = self.scratch();
        let some = self.seeing(&changed, &mut scratch);
        let flattened = self.flattened(at, &some, 0.0, &mut scratch).into_iter();
        let mut found: Vec<u32> = flattened.flat_map(|t| t.corners).collect();
        let spare = TORN[1] * head.eye_distance;
        let torn = |edge: &[u32; 2]| {
            let [v, o] = edge.map(|v| v as usize);
            let was = head.mesh.positions[v] - head.mesh.positions[o];
            (at(v) - at(o)).norm() > TORN[0] * was.norm() + spare
        };
        let edges = some.iter().map(|&k| self.triangles[k as usize]);
        let edges = edges.flat_map(|[a, b, c]| [[a, b], [b, c], [c, a]]);
        found.extend(edges.filter(torn).flatten());
        found.sort_unstable();
        found.dedup();
        found
    }

    /// Inverted triangles among some, and how many of them lost 98 % of their area.
    pub fn inverted(
        &self,
        moved: &impl Fn(usize) -> Vec3,
        some: &[u32],
        scratch: &mut Scratch,
    ) -> (usize, usize) {
        let lie = self.lie(moved, some, scratch);
        let (mut inverted, mut collapsed) = (0, 0);
        for (&k, (area, cosine, _)) in some.iter().zip(lie) {
            let before = self.neutral[k as usize];
            if before.1 > AGREES {
                inverted += usize::from(cosine < 0.0);
                collapsed += usize::from(area < 0.02 * before.0);
            }
        }
        (inverted, collapsed)
    }

    /// Triangles among some that rise less than `height` of their neutral area towards their surroundings, with the mean normals
    /// of these and the doubled area that is missing; none if none of them is inverted.
    pub fn flattened(
        &self,
        moved: &impl Fn(usize) -> Vec3,
        some: &[u32],
        height: f64,
        scratch: &mut Scratch,
    ) -> Vec<Flattened> {
        let mut found = Vec::new();
        let mut inverted = false;
        for (&k, (area, cosine, normal)) in some.iter().zip(self.lie(moved, some, scratch)) {
            let before = self.neutral[k as usize];
            if before.1 > AGREES && (cosine < 0.0 || area * cosine < height * before.0) {
                inverted |= cosine < 0.0;
                found.push(Flattened {
                    corners: self.triangles[k as usize],
                    normal,
                    wanted: height * before.0,
                    inverted: cosine < 0.0,
                });
            }
        }
        found.retain(|_| inverted);
        found
    }
}
