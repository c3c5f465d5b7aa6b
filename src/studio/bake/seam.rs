//! Lines along which skin meets skin: the lids of an eye, the lips. Found as shortest ways along edges through landmarks.
//!
//! Units: the mesh's; a position across is a pure number, 0 at the subject's right end and 1 at the left one.

use std::collections::BinaryHeap;

use super::mesh::{Mesh, Rings, Vec3};

/// Upper and lower line of a lid pair or of the lips, both from the subject's right end to the left end, ends included.
pub struct Seam {
    /// Upper line, vertex numbers.
    pub upper: Vec<u32>,
    /// Lower line.
    pub lower: Vec<u32>,
}

impl Seam {
    /// Position of a point across the face, along the line through both ends.
    pub(super) fn across(&self, mesh: &Mesh, p: &Vec3) -> f64 {
        let ends = [self.upper[0], self.upper[self.upper.len() - 1]];
        let ends = ends.map(|v| mesh.positions[v as usize]);
        let line = ends[1] - ends[0];
        (p - ends[0]).dot(&line) / line.norm_squared()
    }

    /// Point of one of the two lines at the position `t` across.
    pub(super) fn on_line(&self, mesh: &Mesh, line: &[u32], t: f64) -> Vec3 {
        let p = |k: usize| mesh.positions[line[k] as usize];
        for k in 1..line.len() {
            let (a, b) = (self.across(mesh, &p(k - 1)), self.across(mesh, &p(k)));
            if t <= b || k + 1 == line.len() {
                let f = if b > a {
                    ((t - a) / (b - a)).clamp(0.0, 1.0)
                } else {
                    1.0
                };
                return p(k - 1) * (1.0 - f) + p(k) * f;
            }
        }
        p(0)
    }

    /// Vertices of both lines.
    pub(super) fn both(&self) -> impl Iterator<Item = u32> + '_ {
        self.upper.iter().chain(&self.lower).copied()
    }
}

/// Faces whose corners all lie on the two lines of one seam, on both of them.
pub(super) fn films(mesh: &Mesh, seams: &[&Seam]) -> Vec<bool> {
    let mut film = vec![false; mesh.faces()];
    for seam in seams {
        let mut on = vec![(false, false); mesh.positions.len()];
        for &v in &seam.upper {
            on[v as usize].0 = true;
        }
        for &v in &seam.lower {
            on[v as usize].1 = true;
        }
        for (f, film) in film.iter_mut().enumerate() {
            let corner = || mesh.face(f).iter().map(|c| on[c.vertex as usize]);
            *film |= corner().all(|(upper, lower)| upper || lower)
                && corner().any(|(_, lower)| !lower)
                && corner().any(|(upper, _)| !upper);
        }
    }
    film
}

#[derive(PartialEq)]
struct Step(f64, u32);
impl Eq for Step {}
impl Ord for Step {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        other.0.total_cmp(&self.0).then(other.1.cmp(&self.1))
    }
}
impl PartialOrd for Step {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

/// Distance of every vertex from the nearest of `sources`, along edges between vertices that pass `within`; infinite where no
/// way leads.
pub(super) fn distances(
    positions: &[Vec3],
    rings: &Rings,
    sources: &[u32],
    within: impl Fn(usize) -> bool,
) -> Vec<f32> {
    let mut best = vec![f32::INFINITY; positions.len()];
    let mut heap: BinaryHeap<Step> = sources.iter().map(|&v| Step(0.0, v)).collect();
    for &v in sources {
        best[v as usize] = 0.0;
    }
    while let Some(Step(length, v)) = heap.pop() {
        if length as f32 > best[v as usize] {
            continue;
        }
        for &o in rings.of(v as usize).iter().filter(|&&o| within(o as usize)) {
            let edge = positions[v as usize] - positions[o as usize];
            let total = length + edge.norm();
            if (total as f32) < best[o as usize] {
                best[o as usize] = total as f32;
                heap.push(Step(total, o));
            }
        }
    }
    best
}

/// Vertices of the shortest way along edges from `a` to `b`; empty after `a` if there is none.
pub(super) fn shortest(
    mesh: &Mesh,
    rings: &Rings,
    a: u32,
    b: u32,
) -> impl Iterator<Item = u32> + use<> {
    let mut best = std::collections::HashMap::from([(a, (0.0, a))]);
    let mut heap = BinaryHeap::from([Step(0.0, a)]);
    while let Some(Step(length, v)) = heap.pop() {
        if v == b {
            break;
        }
        if length > best[&v].0 {
            continue;
        }
        for &o in rings.of(v as usize) {
            let edge = mesh.positions[v as usize] - mesh.positions[o as usize];
            let total = length + edge.norm();
            if best.get(&o).is_none_or(|&(known, _)| total < known) {
                best.insert(o, (total, v));
                heap.push(Step(total, o));
            }
        }
    }
    let mut path = Vec::new();
    if best.contains_key(&b) {
        let mut v = b;
        while v != a {
            path.push(v);
            v = best[&v].1;
        }
    }
    path.push(a);
    path.reverse();
    path.into_iter()
}

/// A way through `points` without the detours that come back to where they began.
pub(super) fn line(mesh: &Mesh, rings: &Rings, points: &[u32]) -> Vec<u32> {
    let mut path = vec![points[0]];
    for pair in points.windows(2) {
        for v in shortest(mesh, rings, pair[0], pair[1]).skip(1) {
            if let Some(k) = path.iter().position(|&o| o == v) {
                path.truncate(k);
            }
            path.push(v);
        }
    }
    path
}
