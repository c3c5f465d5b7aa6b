//! Lines where skin meets skin, at lids and lips: shortest paths along edges through landmarks.
//!
//! Units: the mesh's; a lateral position is a pure number, 0 at the subject's right end and 1 at the left.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap};
use std::hash::Hash;

use super::mesh::{Mesh, Rings, Vec3};
use mien_stages::base::geometry::smoothstep;

/// Upper and lower line of a lid pair or of the lips, both from the subject's right end to the left end, ends included.
pub struct Seam {
    /// Upper line, vertex numbers.
    pub upper: Vec<u32>,
    /// Lower line.
    pub lower: Vec<u32>,
}

impl Seam {
    /// Lateral position of a point, along the line through both ends.
    pub(super) fn across(&self, mesh: &Mesh, p: &Vec3) -> f64 {
        let at = |k: usize| mesh.positions[self.upper[k] as usize];
        let line = at(self.upper.len() - 1) - at(0);
        (p - at(0)).dot(&line) / line.norm_squared()
    }

    /// Point of a line of vertices at lateral position `t`.
    pub(super) fn on_line(&self, mesh: &Mesh, line: &[u32], t: f64) -> Vec3 {
        let p = |k: usize| mesh.positions[line[k] as usize];
        for k in 1..line.len() {
            let (a, b) = (self.across(mesh, &p(k - 1)), self.across(mesh, &p(k)));
            if t <= b || k + 1 == line.len() {
                let f = if b > a { (t - a) / (b - a) } else { 1.0 };
                return p(k - 1).lerp(&p(k), f.clamp(0.0, 1.0));
            }
        }
        p(0)
    }

    /// Trims both lines to where their ring of edges turns back, at most a quarter of a line beside the landmarks.
    fn turned(self, mesh: &Mesh) -> Self {
        let (right, left) = (0, self.upper.len() - 1);
        let back = self.lower[1..self.lower.len() - 1].iter().rev();
        let ring: Vec<u32> = self.upper.iter().chain(back).copied().collect();
        let at = |k: usize| mesh.positions[ring[k % ring.len()] as usize];
        let along = at(left) - at(right);
        let turns = |end: usize, way: f64| {
            let beside = ring.len() / 8;
            let near = ring.len() + end - beside..=ring.len() + end + beside;
            let far = |k: usize| way * at(k).dot(&along);
            let furthest = near.max_by(|&a, &b| far(a).total_cmp(&far(b)));
            furthest.map_or(end, |k| k % ring.len())
        };
        let (right, left) = (turns(right, -1.0), turns(left, 1.0));
        let between = |from: usize, to: usize| {
            let count = (to + ring.len() - from) % ring.len();
            let places = (0..=count).map(|k| ring[(from + k) % ring.len()]);
            places.collect::<Vec<u32>>()
        };
        let mut lower = between(left, right);
        lower.reverse();
        Self {
            upper: between(right, left),
            lower,
        }
    }

    /// Vertices of both lines.
    pub(super) fn both(&self) -> impl Iterator<Item = u32> + '_ {
        self.upper.iter().chain(&self.lower).copied()
    }
}

/// The inner vertices of a line with their shares of its length, as lids may rise steeply from a corner.
pub(super) fn along(line: &[u32], at: impl Fn(u32) -> Vec3) -> impl Iterator<Item = (u32, f64)> {
    let ways = line.windows(2).scan(0.0, |way, ends| {
        *way += (at(ends[1]) - at(ends[0])).norm();
        Some((ends[1], *way))
    });
    let mut ways: Vec<(u32, f64)> = ways.collect();
    let whole = ways.pop().map_or(1.0, |last| last.1);
    ways.into_iter().map(move |(v, way)| (v, way / whole))
}

/// Weight along a lid line, 1 in the middle and 0 at its ends, where the lids are one skin; `t` from 0 to 1.
pub(super) fn near_corner(t: f64) -> f64 {
    smoothstep(0.0, 0.035, t) * smoothstep(1.0, 0.965, t)
}

/// Whether all corners of each face lie on the two lines of one seam, on both of them.
pub(super) fn membranes(mesh: &Mesh, seams: &[&Seam]) -> Vec<bool> {
    let mut membrane = vec![false; mesh.faces()];
    for seam in seams {
        let mut on = vec![(false, false); mesh.positions.len()];
        seam.upper.iter().for_each(|&v| on[v as usize].0 = true);
        seam.lower.iter().for_each(|&v| on[v as usize].1 = true);
        for (f, membrane) in membrane.iter_mut().enumerate() {
            let corner = || mesh.face(f).iter().map(|c| on[c.vertex as usize]);
            *membrane |= corner().all(|(upper, lower)| upper || lower)
                && corner().any(|(_, lower)| !lower)
                && corner().any(|(upper, _)| !upper);
        }
    }
    membrane
}

/// Cost of an edge that leads from one ring to another, as part of its length.
const CROSSES: f64 = 3.0;
/// Vertices of both lines below which a mesh is coarse and its landmarks are not moved.
const FINE: usize = 24;
/// Most candidate vertices of a landmark.
const PLACES: usize = 12;
/// Cost of using another vertex than the landmark, as part of their distance.
const PULL: f64 = 0.7;
/// Cost of using another vertex than the landmark at the ends of a line, where short cuts lead inwards, as part of
/// their distance.
const END_PULL: f64 = 3.0;

/// Priority queue of path ends, the shortest first. Lengths are not negative, so that their bits sort as they do.
type Steps<T> = BinaryHeap<Reverse<(u64, T)>>;

fn step<T>(length: f64, at: T) -> Reverse<(u64, T)> {
    Reverse((length.to_bits(), at))
}

/// The `most` shortest paths from `start` to places that pass `ends`, with their lengths (Dijkstra). `steps` passes each
/// neighbour of a place on, with the cost of going there.
pub(super) fn paths<T: Copy + Hash + Ord>(
    start: T,
    most: usize,
    ends: impl Fn(T) -> bool,
    steps: impl Fn(T, &mut dyn FnMut(T, f64)),
) -> Vec<(f64, Vec<T>)> {
    let mut best = HashMap::from([(start, (0.0, start))]);
    let mut heap = Steps::from([step(0.0, start)]);
    let mut paths = Vec::new();
    while let Some(Reverse((length, at))) = heap.pop() {
        let length = f64::from_bits(length);
        if length > best[&at].0 {
            continue;
        }
        if !ends(at) {
            steps(at, &mut |next, cost| {
                let total = length + cost;
                if best.get(&next).is_none_or(|&(known, _)| total < known) {
                    best.insert(next, (total, at));
                    heap.push(step(total, next));
                }
            });
            continue;
        }
        let mut path = vec![at];
        while path[path.len() - 1] != start {
            path.push(best[&path[path.len() - 1]].1);
        }
        path.reverse();
        paths.push((length, path));
        if paths.len() == most {
            break;
        }
    }
    paths
}

/// Distance of every vertex from the nearest of `sources`, along edges between vertices that pass `within`; infinite
/// if unconnected.
pub(super) fn distances(
    positions: &[Vec3],
    rings: &Rings,
    sources: &[u32],
    within: impl Fn(usize) -> bool,
) -> Vec<f32> {
    let mut best = vec![f32::INFINITY; positions.len()];
    let mut heap: Steps<u32> = sources.iter().map(|&v| step(0.0, v)).collect();
    for &v in sources {
        best[v as usize] = 0.0;
    }
    while let Some(Reverse((length, v))) = heap.pop() {
        let length = f64::from_bits(length);
        if length as f32 > best[v as usize] {
            continue;
        }
        let near = rings.members(v as usize).iter();
        for &o in near.filter(|&&o| within(o as usize)) {
            let edge = positions[v as usize] - positions[o as usize];
            let total = length + edge.norm();
            if (total as f32) < best[o as usize] {
                best[o as usize] = total as f32;
                heap.push(step(total, o));
            }
        }
    }
    best
}

/// Candidate vertices of a landmark on a line with their costs, 0 for the landmark itself.
type Candidates = Vec<(u32, f64)>;

/// A path along edges: number of landmarks passed, and vertex.
type Way = Vec<(usize, u32)>;

/// The shortest paths along edges from `start` through one candidate of each other landmark, one per end vertex, with
/// their lengths; `ends` are the first and last landmark. Independent of direction.
fn ways(
    mesh: &Mesh,
    rings: &Rings,
    start: u32,
    through: &[Candidates],
    ends: [u32; 2],
    rim: Option<(Vec3, f64)>,
) -> Vec<(f64, Way)> {
    let [from, to] = ends.map(|v| mesh.positions[v as usize]);
    let along = (to - from).try_normalize(0.0).unwrap_or_default();
    // Cost of a point's distance from the lid's edge, the foremost and nearest to the slit.
    let behind = |p: &Vec3| {
        rim.map_or(0.0, |(out, reach)| {
            let t = ((p - from).dot(&along) / (to - from).dot(&along)).clamp(0.0, 1.0);
            let apart = p - (from + (to - from) * t);
            let open = apart.dot(&out.cross(&along)).abs();
            (2.0 + (open - apart.dot(&out)) / reach).max(0.0)
        })
    };
    let most = through[through.len() - 1].len();
    let has_passed_all = |at: (usize, u32)| at.0 == through.len();
    paths((0, start), most, has_passed_all, |(passed, v), to| {
        if let Some((_, cost)) = through[passed].iter().find(|(o, _)| *o == v) {
            to((passed + 1, v), *cost);
        }
        let here = mesh.positions[v as usize];
        let share = 1.0 + 0.5 * behind(&here);
        for &o in rings.members(v as usize) {
            let there = mesh.positions[o as usize];
            let (far, across) = ((here - there).norm(), (here - there).dot(&along).abs());
            let cost = far * (share + 0.5 * behind(&there)) + CROSSES * (far - across);
            to((passed, o), cost);
        }
    })
}

/// The vertices within `slack` of a landmark, nearest first; another than itself costs `pull` times its distance.
fn candidates(mesh: &Mesh, rings: &Rings, landmark: u32, slack: f64, pull: f64) -> Candidates {
    let at = |v: u32| mesh.positions[v as usize];
    let near = rings.disc(&mesh.positions, landmark, slack).into_iter();
    let near = near.map(|v| (v, (at(v) - at(landmark)).norm() * pull));
    let mut place: Candidates = near.collect();
    place.sort_by(|a, b| a.1.total_cmp(&b.1));
    place.truncate(PLACES);
    place
}

/// Both lines of lids or lips through landmarks, each from the subject's right end over two or more to the left end.
/// They are the shortest pair, so that they stay on one ring of edges where landmarks lie up to `slack` beside it.
/// Also returns the vertices used for the landmarks.
pub(super) fn lines(
    mesh: &Mesh,
    rings: &Rings,
    landmarks: [&[u32]; 2],
    slack: f64,
    out: Option<Vec3>,
) -> (Seam, [Vec<u32>; 2]) {
    let last = landmarks[0].len() - 1;
    let places = landmarks.map(|line| {
        let of = |(k, &v): (usize, &u32)| {
            let pull = if k == 0 || k == last { END_PULL } else { PULL };
            candidates(mesh, rings, v, slack, pull)
        };
        line.iter().enumerate().map(of).collect::<Vec<Candidates>>()
    });
    let rim = out.map(|out| (out, slack));
    let (mut least, mut shortest) = (f64::INFINITY, None);
    for &(start, cost) in &places[0][0] {
        let ends = [landmarks[0][0], landmarks[0][last]];
        let ways = |line: usize| ways(mesh, rings, start, &places[line][1..], ends, rim);
        let [upper, lower] = [0, 1].map(ways);
        for (length, way) in upper {
            let same_end = lower.iter().find(|l| l.1.last() == way.last());
            // Both paths include the cost of their common end.
            let total = |other| 2.0 * cost + length + other;
            if let Some((other, below)) = same_end
                && total(other) < least
            {
                (least, shortest) = (total(other), Some([way, below.clone()]));
            }
        }
    }
    // If the skin is disconnected, the landmarks alone: there is no slit to close.
    let ways = shortest.unwrap_or(landmarks.map(|line| line.iter().copied().enumerate().collect()));
    let [upper, lower] = [0, 1].map(|line| straight(ways[line].iter().map(|at| at.1)));
    let seam = Seam { upper, lower };
    if slack > 0.0 && seam.upper.len() + seam.lower.len() < FINE {
        return lines(mesh, rings, landmarks, 0.0, None);
    }
    let mut through = ways.map(|way| {
        let first = |k: usize| way.iter().find(|at| at.0 == k).map_or(0, |at| at.1);
        (0..=last).map(first).collect::<Vec<u32>>()
    });
    let seam = if slack > 0.0 { seam.turned(mesh) } else { seam };
    for (line, through) in [&seam.upper, &seam.lower].into_iter().zip(&mut through) {
        (through[0], through[last]) = (line[0], line[line.len() - 1]);
    }
    (seam, through)
}

/// A path without detours that return to their start.
fn straight(way: impl Iterator<Item = u32>) -> Vec<u32> {
    let mut path: Vec<u32> = Vec::new();
    for v in way {
        if let Some(k) = path.iter().position(|&o| o == v) {
            path.truncate(k);
        }
        path.push(v);
    }
    path
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_steep_line_is_measured_along_its_length() {
        let places = [[0.0, 0.0], [0.0, 1.0], [2.0, 1.0], [3.0, 1.0]];
        let at = |v: u32| Vec3::new(places[v as usize][0], places[v as usize][1], 0.0);
        let shares: Vec<(u32, f64)> = along(&[0, 1, 2, 3], at).collect();
        assert_eq!(shares, [(1, 0.25), (2, 0.75)]);
    }
}
