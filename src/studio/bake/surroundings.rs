//! Inverted triangles, found by looking at each triangle among its neighbours.
//!
//! An inverted triangle is one whose normal opposes the mean normal of the triangles up to two rings around it *in the
//! deformed mesh* (cosine below 0) although it agreed in the neutral (above 0.3). Comparing with the neutral normal
//! instead would count the honest rolling of lips and lids.
//!
//! Cost: linear in the triangles looked at; memory: a few numbers per triangle and vertex.

use super::head::Head;
use super::mesh::{Rings, Vec3};

/// A triangle that agrees less with its surroundings in the neutral (cosine) is not judged.
const AGREES: f64 = 0.3;

/// An edge is torn that has grown beyond this many times its length and this part of the eye distance.
const TORN: [f64; 2] = [5.0, 0.05];

/// The skin's triangles and how they lie in their surroundings in the neutral shape.
pub struct Surroundings {
    triangles: Vec<[u32; 3]>,
    /// Neighbours along the triangles' edges: also along those that cut a face.
    rings: Rings,
    /// Triangles at each vertex, stored flat.
    starts: Vec<u32>,
    at: Vec<u32>,
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
    /// 0, or what is wanted of a vertex: 1 the normal of its triangles, 2 that of its ring's.
    wanted: Vec<u8>,
    one: Vec<[f64; 3]>,
    two: Vec<[f64; 3]>,
    /// Normals of triangles, as long as twice their area, where they are marked.
    normal: Vec<[f64; 3]>,
    /// Marks of triangles, all unset between uses.
    seen: Vec<bool>,
}

impl Surroundings {
    /// Of one head; films across a slit are left out.
    #[must_use]
    pub fn new(head: &Head) -> Self {
        let mut triangles = Vec::new();
        for f in 0..head.mesh.faces() {
            let face = head.mesh.face(f);
            if head.film[f] || !head.skin[face[0].vertex as usize] {
                continue;
            }
            // A quad as the file cuts it: from its first corner ([`super::order`]).
            for k in 2..face.len() {
                triangles.push([0, k - 1, k].map(|k| face[k].vertex));
            }
        }
        let n = head.mesh.positions.len();
        let mut starts = vec![0_u32; n + 1];
        for &v in triangles.iter().flatten() {
            starts[v as usize + 1] += 1;
        }
        for v in 0..n {
            starts[v + 1] += starts[v];
        }
        let (mut fill, mut at) = (starts.clone(), vec![0_u32; triangles.len() * 3]);
        for (k, t) in triangles.iter().enumerate() {
            for &v in t {
                at[fill[v as usize] as usize] = k as u32;
                fill[v as usize] += 1;
            }
        }
        let edges = triangles.iter();
        let edges = edges.flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]);
        let mut out = Self {
            rings: Rings::new(n, &edges.collect::<Vec<_>>()),
            triangles,
            starts,
            at,
            neutral: Vec::new(),
        };
        let all: Vec<u32> = (0..out.triangles.len() as u32).collect();
        let neutral = |v: usize| head.mesh.positions[v];
        let lie = out.lie(&neutral, &all, &mut out.scratch());
        out.neutral = lie
            .into_iter()
            .map(|(area, cosine, _)| (area, cosine))
            .collect();
        out
    }

    fn around(&self, v: u32) -> &[u32] {
        &self.at[self.starts[v as usize] as usize..self.starts[v as usize + 1] as usize]
    }

    /// Room for one thread.
    #[must_use]
    pub fn scratch(&self) -> Scratch {
        let n = self.starts.len() - 1;
        Scratch {
            wanted: vec![0; n],
            one: vec![[0.0; 3]; n],
            two: vec![[0.0; 3]; n],
            normal: vec![[0.0; 3]; self.triangles.len()],
            seen: vec![false; self.triangles.len()],
        }
    }

    /// All triangles that see one of the changed vertices in their surroundings, ascending.
    #[must_use]
    pub fn seeing(&self, changed: &[u32], scratch: &mut Scratch) -> Vec<u32> {
        // A triangle sees the corners of all triangles that touch the ring of one of its corners: three steps.
        let mut near = changed.to_vec();
        for &v in changed {
            scratch.wanted[v as usize] = 1;
        }
        let mut from = 0;
        for _ in 0..2 {
            let to = near.len();
            for k in from..to {
                for &o in self.rings.of(near[k] as usize) {
                    if scratch.wanted[o as usize] == 0 {
                        scratch.wanted[o as usize] = 1;
                        near.push(o);
                    }
                }
            }
            from = to;
        }
        let mut found = Vec::new();
        for v in near {
            scratch.wanted[v as usize] = 0;
            for &k in self.around(v) {
                if !scratch.seen[k as usize] {
                    scratch.seen[k as usize] = true;
                    found.push(k);
                }
            }
        }
        // Ascending; where there are many, all marks are read sooner than some numbers sorted.
        if found.len() > self.triangles.len() / 32 {
            let all = 0..self.triangles.len() as u32;
            found.clear();
            found.extend(all.filter(|&k| scratch.seen[k as usize]));
        } else {
            found.sort_unstable();
        }
        for &k in &found {
            scratch.seen[k as usize] = false;
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
        let Scratch {
            wanted,
            one,
            two,
            normal,
            seen,
        } = scratch;
        // Sums are made once for every vertex that is needed.
        let mut corners = Vec::new();
        for &k in some {
            for v in self.triangles[k as usize] {
                if wanted[v as usize] == 0 {
                    wanted[v as usize] = 2;
                    corners.push(v);
                }
            }
        }
        let mut all = corners.clone();
        for &v in &corners {
            for &o in self.rings.of(v as usize) {
                if wanted[o as usize] == 0 {
                    wanted[o as usize] = 1;
                    all.push(o);
                }
            }
        }
        for &v in &all {
            let mut sum = Vec3::zeros();
            for &k in self.around(v) {
                let k = k as usize;
                if !seen[k] {
                    seen[k] = true;
                    let [a, b, c] = self.triangles[k].map(|v| p(v as usize));
                    normal[k] = (b - a).cross(&(c - a)).into();
                }
                sum += Vec3::from(normal[k]);
            }
            one[v as usize] = sum.into();
        }
        for &v in &all {
            wanted[v as usize] = 0;
            for &k in self.around(v) {
                seen[k as usize] = false;
            }
        }
        for &v in &corners {
            let ring = self.rings.of(v as usize).iter();
            let own = Vec3::from(one[v as usize]);
            let sum = ring.fold(own, |sum, &o| sum + Vec3::from(one[o as usize]));
            two[v as usize] = sum.into();
        }
        some.iter()
            .map(|&k| {
                let n = Vec3::from(normal[k as usize]);
                let around: Vec3 = self.triangles[k as usize]
                    .iter()
                    .map(|&v| Vec3::from(two[v as usize]))
                    .sum();
                let around = around.try_normalize(0.0).unwrap_or_default();
                let area = n.norm();
                let cosine = if area > 0.0 {
                    n.dot(&around) / area
                } else {
                    0.0
                };
                (area, cosine, around)
            })
            .collect()
    }

    /// Vertices of the triangles that a displacement turns over and of the edges that it tears, ascending; `at` is where vertices
    /// are then.
    #[must_use]
    pub fn faults(&self, head: &Head, d: &[Vec3], at: &impl Fn(usize) -> Vec3) -> Vec<u32> {
        let changed: Vec<u32> = (0..d.len() as u32)
            .filter(|&v| d[v as usize] != Vec3::zeros())
            .collect();
        let mut scratch = self.scratch();
        let some = self.seeing(&changed, &mut scratch);
        let mut found: Vec<u32> = self
            .flattened(at, &some, 0.0, &mut scratch)
            .iter()
            .flat_map(|t| t.corners)
            .collect();
        let length =
            |p: &dyn Fn(usize) -> Vec3, v: u32, o: u32| (p(v as usize) - p(o as usize)).norm();
        let neutral = |v: usize| head.mesh.positions[v];
        let spare = TORN[1] * head.eye_distance;
        for k in &some {
            let t = self.triangles[*k as usize];
            for (v, o) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
                let now = length(at, v, o);
                if now > spare && now > TORN[0] * length(&neutral, v, o) + spare {
                    found.extend([v, o]);
                }
            }
        }
        found.sort_unstable();
        found.dedup();
        found
    }

    /// Inverted triangles among some, and how many of them lost 98 % of their area.
    #[must_use]
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
    #[must_use]
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
