//! Checks of baked shapes, with measures and bounds calibrated on artists' shapes.
//!
//! The definitions are those of `tests/heads/verdict.py`, which states them in full and measures the artists' shapes;
//! this code is independent of it and of the solver's own checks. On the skin visible in one of nine views of the
//! neutral: folded edges, inverted area, back faces at the mouth. In `jawOpen`: the chin's path, the lips and a
//! mask's rim. Also the inside of the mouth, and the open area left in a blink.
//!
//! Frame: that of the face (left, up, out), origin between the inner eye corners, unit one eye distance. Cost: nine
//! small depth buffers a head, one a shape.

use std::collections::HashMap;

use nalgebra::{Rotation3, Vector2};
use rayon::prelude::*;

use super::head::{Follow, Head};
use super::mesh::{Vec3, area_vector, bounding_box};
use super::shape::{Shape, shown};
use mien_simulator::virtual_head::raster::{Corner, DepthBuffer};

/// Yaw to the left and pitch upwards of the views, degrees.
const VIEWS: [[f64; 2]; 9] = [
    [0.0, 0.0],
    [-40.0, 0.0],
    [40.0, 0.0],
    [-75.0, 0.0],
    [75.0, 0.0],
    [0.0, 30.0],
    [0.0, -40.0],
    [-40.0, -35.0],
    [40.0, -35.0],
];
/// Side of a cell of a depth buffer.
const CELL: f64 = 0.02;
/// Distance in front of a point from which a surface hides it.
const IN_FRONT: f64 = 0.06;
/// Distance from the eyes, vertically or laterally, up to which vertices belong to the face.
const FACE: f64 = 5.0;
/// Least cosine between the faces at an edge that is flat in the neutral.
const FLAT: f64 = 0.819_152;
/// Cosine below which an edge is folded.
const FOLDED: f64 = 0.0;
/// Cosine with the neutral normal below which a triangle is inverted.
const TURNED: f64 = -0.5;
/// Radius of the lids' region.
const AT_LID: f64 = 0.3;
/// Radius of the chin's region.
const AT_CHIN: f64 = 0.4;
/// Share of the way from chin to lower lip up to which the chin's region extends.
const TO_LIP: f64 = 0.7;
/// Distance aside of the mouth up to which its region extends.
const ASIDE: f64 = 0.3;
/// Distance into the mouth up to which its region extends.
const DEEP: f64 = 0.35;
/// Distance below the chin up to which a mask's rim is searched.
const MASK: f64 = 0.8;
/// Millimetres between the inner eye corners, for measures of the mouth in millimetres.
const MM: f64 = 34.0;
/// Mean opening below which a neutral eye is shut.
const SHUT: f64 = 0.05;
/// Beginnings of lower-case names of shapes that move jaw or tongue: recipes for other programs capitalise.
const JAW: [&str; 5] = ["jaw", "mouthstretchwide", "mouthclose", "tongue", "viseme"];

/// The checks, as listed by report and command.
pub const CHECKED: &str = "folds, skin turned over or seen from behind, the jaw's path, lips that part, teeth, the inside of the mouth, \
    eyes that shut, the rim of a mask, and what the recipe asks of each shape";

/// A measure's name and its least and largest value.
struct Bar(&'static str, f64, f64);

const FREE: f64 = f64::INFINITY;
const FOLDS: Bar = Bar("length of folds", -FREE, 0.6);
const LID_FOLDS: Bar = Bar("length of folds at the lids", -FREE, 0.8);
const TURNED_OVER: Bar = Bar("area turned over", -FREE, 0.02);
const BEHIND: Bar = Bar("area seen from behind at the mouth", -FREE, 0.015);
const INSIDE: Bar = Bar("mouth inside moves, mm", -FREE, 3.0);
const GROWN: Bar = Bar("share of edges of teeth that double", -FREE, 0.01);
const BACK: Bar = Bar("chin back for one down", -FREE, 1.25);
const HINGE: Bar = Bar("height of the hinge over its depth", 0.6, 0.9);
const LIPS: Bar = Bar("lips part", 0.85, FREE);
const UPPER: Bar = Bar("upper lip's share of the lower's way", -FREE, 0.25);
const RIM: Bar = Bar("rim's share of the chin's way", 0.8, FREE);
const OPEN: Bar = Bar("share of the eye left open", -FREE, 0.08);

impl Bar {
    /// What exceeds the bounds, in words.
    fn missed(&self, value: f64) -> Option<String> {
        let Self(what, least, most) = self;
        let bound = match () {
            () if value < *least => format!("at least {least}"),
            () if value > *most => format!("at most {most}"),
            () => return None,
        };
        Some(format!("{what} {value:.3}, expected {bound}"))
    }
}

/// An edge between two visible triangles that is flat in the neutral.
struct Edge {
    sides: [usize; 2],
    length: f64,
    at_lid: bool,
}

/// Measurements of the neutral.
struct Judge<'a> {
    head: &'a Head,
    q: Vec<Vec3>,
    all: Vec<[u32; 3]>,
    visible: Vec<[u32; 3]>,
    is_visible: Vec<bool>,
    normals: Vec<Vec3>,
    edges: Vec<Edge>,
    inside: Vec<usize>,
    teeth: Vec<[usize; 2]>,
    behind: f64,
}

/// Unit normal of a triangle and its area.
fn normal(q: &[Vec3], t: &[u32; 3]) -> (Vec3, f64) {
    let n = area_vector(t.map(|v| q[v as usize]));
    (n.try_normalize(0.0).unwrap_or_default(), 0.5 * n.norm())
}

/// A depth buffer of the region between `low` and `high`, seen along −z, with the foremost triangle in each cell.
fn drawn(q: &[Vec3], all: &[[u32; 3]], low: Vec3, high: Vec3) -> (DepthBuffer, Vec<u32>) {
    let cells = |k: usize| ((high[k] - low[k]) / CELL).max(0.0) as usize + 2;
    let mut depth = DepthBuffer::new(cells(0), cells(1));
    let mut front = vec![u32::MAX; depth.inverse.len()];
    for (t, k) in all.iter().zip(0_u32..) {
        let place = |v: u32| cell(&q[v as usize], &low);
        let mut corners = t.map(place);
        let [a, b, c] = &corners;
        if (b.x - a.x) * (c.y - a.y) < (b.y - a.y) * (c.x - a.x) {
            corners.swap(1, 2);
        }
        depth.triangle(corners, |pixel, _, _| front[pixel] = k);
    }
    (depth, front)
}

/// A point in cells from `low`, with positive depth.
fn cell(p: &Vec3, low: &Vec3) -> Corner {
    let place = [0, 1].map(|k| ((p[k] - low[k]) / CELL - 0.5) as f32);
    Corner::new(place, ((p.z - low.z) + 1.0) as f32)
}

impl<'a> Judge<'a> {
    fn new(head: &'a Head) -> Self {
        let origin = (head.point(39) + head.point(42)) / 2.0;
        let to_face = head.axes.transpose() / head.eye_distance;
        let places = head.mesh.positions.iter();
        let q: Vec<Vec3> = places.map(|p| to_face * (p - origin)).collect();
        let mut out = Self {
            all: head.mesh.triangles(),
            is_visible: vec![false; q.len()],
            q,
            head,
            visible: Vec::new(),
            normals: Vec::new(),
            edges: Vec::new(),
            inside: Vec::new(),
            teeth: Vec::new(),
            behind: 0.0,
        };
        out.mark_visible();
        out.find_edges();
        out.find_mouth_vertices();
        out.behind = out.seen_from_behind(&out.q);
        out
    }

    /// Marks the skin vertices visible in some view.
    fn mark_visible(&mut self) {
        let head = self.head;
        let near: Vec<bool> = self.q.iter().map(|p| p.y.abs() < FACE).collect();
        let smooth = head.mesh.vertex_normals(&head.mesh.positions);
        let is_near = |t: &&[u32; 3]| t.iter().all(|&v| near[v as usize]);
        let some: Vec<[u32; 3]> = self.all.iter().filter(is_near).copied().collect();
        let seen = VIEWS.par_iter().map(|turn| {
            let [aside, up] = turn.map(f64::to_radians);
            let lift = Rotation3::from_axis_angle(&Vec3::x_axis(), up);
            let view = lift * Rotation3::from_axis_angle(&Vec3::y_axis(), -aside);
            let q: Vec<Vec3> = self.q.iter().map(|p| view * p).collect();
            let (low, high) = bounding_box(some.iter().flatten().map(|&v| &q[v as usize]));
            let (depth, _) = drawn(&q, &some, low, high);
            let faces = view * head.axes.transpose();
            let shows = |v: usize| {
                let at = cell(&q[v], &low);
                let [x, y] = [at.x, at.y].map(|c| c.round().max(0.0) as usize);
                let hides = f64::from(depth.inverse[y * depth.width + x]) - IN_FRONT;
                near[v] && f64::from(at.inverse) > hides && (faces * smooth[v]).z > 0.1
            };
            let all = 0..q.len();
            all.map(|v| head.skin[v] && near[v] && shows(v)).collect()
        });
        for view in seen.collect::<Vec<Vec<bool>>>() {
            for (seen, here) in self.is_visible.iter_mut().zip(view) {
                *seen |= here;
            }
        }
    }

    fn find_edges(&mut self) {
        let mesh = &self.head.mesh;
        let faces = (0..mesh.faces()).filter(|&f| !self.head.membrane[f]);
        let triangles = faces.flat_map(|f| mesh.solid(f).map(|t| t.map(|c| c.vertex)));
        let seen = |t: &[u32; 3]| t.iter().all(|&v| self.is_visible[v as usize]);
        self.visible = triangles.filter(seen).collect();
        self.normals = self.visible.iter().map(|t| normal(&self.q, t).0).collect();
        let mut sides: HashMap<[u32; 2], Vec<usize>> = HashMap::new();
        for (k, &[a, b, c]) in self.visible.iter().enumerate() {
            for [a, b] in [[a, b], [b, c], [c, a]] {
                sides.entry([a.min(b), a.max(b)]).or_default().push(k);
            }
        }
        let at = |v: u32| self.q[v as usize];
        for (ends, sides) in sides {
            let &[one, other] = &sides[..] else { continue };
            if self.normals[one].dot(&self.normals[other]) > FLAT {
                let [a, b] = ends.map(at);
                let middle = (a + b) / 2.0;
                let mut lids = self.head.points[36..48].iter();
                self.edges.push(Edge {
                    sides: [one, other],
                    length: (a - b).norm(),
                    at_lid: lids.any(|&v| (at(v) - middle).norm() < AT_LID),
                });
            }
        }
    }

    /// Lists the vertices in the mouth.
    fn find_mouth_vertices(&mut self) {
        let head = self.head;
        let is_part = |v: usize| matches!(head.follow[v], Follow::Jaw(_));
        let far = DEEP * head.eye_distance;
        let deep = |v: usize| head.from_lips[v].is_finite() && f64::from(head.from_lips[v]) > far;
        let all = 0..self.q.len();
        self.inside = all.filter(|&v| is_part(v) || deep(v)).collect();
        let edges = (0..self.q.len()).filter(|&v| is_part(v));
        let ring = |v: usize| {
            let ring = head.rings.members(v).iter().map(|&o| o as usize);
            ring.filter(move |&o| v < o).map(move |o| [v, o])
        };
        self.teeth = edges.flat_map(ring).collect();
    }

    /// Area in front of the mouth in which the foremost surface is a back face of the skin.
    fn seen_from_behind(&self, q: &[Vec3]) -> f64 {
        let at = |k: usize| q[self.head.points[k] as usize];
        let across = || (48..60).map(|k| at(k).x);
        let left = across().fold(f64::NEG_INFINITY, f64::max) + ASIDE;
        let right = across().fold(f64::INFINITY, f64::min) - ASIDE;
        let low = Vec3::new(right, at(8).y, at(33).z - 4.0);
        let high = Vec3::new(left, at(33).y, 0.0);
        let near = |t: &&[u32; 3]| {
            let p = t.map(|v| q[v as usize]);
            p.iter().all(|p| p.z > low.z)
                && [0, 1].into_iter().all(|k: usize| {
                    p.iter().any(|p| p[k] > low[k]) && p.iter().any(|p| p[k] < high[k])
                })
        };
        let some: Vec<[u32; 3]> = self.all.iter().filter(near).copied().collect();
        let (_, front) = drawn(q, &some, low, high);
        let away = |&k: &&u32| {
            let t = some.get(*k as usize);
            t.is_some_and(|t| self.head.skin[t[0] as usize] && normal(q, t).0.z < 0.0)
        };
        front.iter().filter(away).count() as f64 * CELL * CELL
    }

    /// Positions with these displacements of the mesh.
    fn moved(&self, d: &[Vec3]) -> Vec<Vec3> {
        let to_face = self.head.axes.transpose() / self.head.eye_distance;
        let both = self.q.iter().zip(d);
        both.map(|(q, d)| q + to_face * d).collect()
    }

    /// Defects of one shape, in words; `d` includes the shape that it is added to.
    fn defects(&self, name: &str, d: &[Vec3]) -> Vec<String> {
        let (q, name) = (self.moved(d), name.to_ascii_lowercase());
        let (mut folds, mut lids, mut turned) = (0.0, 0.0, 0.0);
        let now: Vec<Vec3> = self.visible.iter().map(|t| normal(&q, t).0).collect();
        for edge in &self.edges {
            let [one, other] = edge.sides.map(|k| now[k]);
            if one.dot(&other) < FOLDED {
                *(if edge.at_lid { &mut lids } else { &mut folds }) += edge.length;
            }
        }
        for ((t, was), is) in self.visible.iter().zip(&self.normals).zip(&now) {
            if was.dot(is) < TURNED {
                turned += normal(&self.q, t).1;
            }
        }
        let mut out = vec![
            FOLDS.missed(folds),
            LID_FOLDS.missed(lids),
            TURNED_OVER.missed(turned),
            BEHIND.missed(self.seen_from_behind(&q) - self.behind),
        ];
        if !JAW.iter().any(|jaw| name.starts_with(jaw)) && !self.inside.is_empty() {
            let ways = self.inside.iter().map(|&v| (q[v] - self.q[v]).norm());
            out.push(INSIDE.missed(MM * ways.sum::<f64>() / self.inside.len() as f64));
        }
        if !name.starts_with("tongue") && !self.teeth.is_empty() {
            let size = |q: &[Vec3], [a, b]: [usize; 2]| (q[a] - q[b]).norm();
            let doubled = |e: &&[usize; 2]| size(&q, **e) > 2.0 * size(&self.q, **e) + 1e-9;
            let doubled = self.teeth.iter().filter(doubled).count();
            out.push(GROWN.missed(doubled as f64 / self.teeth.len() as f64));
        }
        match &*name {
            "jawopen" => out.extend(self.jaw(&q)),
            "eyeblinkleft" => out.push(self.open(0, &q)),
            "eyeblinkright" => out.push(self.open(1, &q)),
            _ => (),
        }
        out.into_iter().flatten().collect()
    }

    /// Defects of the chin's path, the lips and a mask's rim.
    fn jaw(&self, q: &[Vec3]) -> [Option<String>; 5] {
        let vertex = |k: usize| self.head.points[k] as usize;
        let way = |k: usize| q[vertex(k)] - self.q[vertex(k)];
        let (chin, lip) = (self.q[vertex(8)], self.q[vertex(57)]);
        let front = chin + (lip - chin) * TO_LIP;
        let is_chin = |v: &usize| {
            let marked = *v == vertex(8) || *v == vertex(57);
            marked || self.is_visible[*v] && (self.q[*v] - front).norm() < AT_CHIN
        };
        let some: Vec<usize> = (0..q.len()).filter(is_chin).collect();
        let hinge = turns_about(&some, &self.q, q).map(|at| (at.x - chin.y) / (chin.z - at.y));
        let rim = self.rim(&chin);
        let mean = |some: &[usize]| {
            let ways = some.iter().map(|&v| q[v] - self.q[v]);
            (ways.sum::<Vec3>() / some.len().max(1) as f64).norm()
        };
        let rim = (!rim.is_empty()).then(|| mean(&rim) / way(8).norm().max(1e-9));
        [
            BACK.missed(way(8).z / way(8).y.min(-1e-9)),
            hinge.and_then(|ratio| HINGE.missed(ratio)),
            LIPS.missed(q[vertex(62)].y - q[vertex(66)].y),
            UPPER.missed(way(62).norm() / way(66).norm().max(1e-9)),
            rim.and_then(|share| RIM.missed(share)),
        ]
    }

    /// The lower edge of a mask, below its chin; empty for a head with a neck.
    fn rim(&self, chin: &Vec3) -> Vec<usize> {
        let skin = || (0..self.q.len()).filter(|&v| self.head.skin[v]);
        let middle = |v: usize| (self.q[v].x - chin.x).abs() < 0.3;
        let below = |v: usize| self.q[v].z < chin.z + 0.3 && self.q[v].y < chin.y - MASK;
        if skin().any(|v| middle(v) && below(v)) {
            return Vec::new();
        }
        let border = self.head.mesh.border();
        let near = |v: usize| (self.q[v] - chin).norm() < MASK && self.q[v].y < chin.y + 0.2;
        let rim = skin().filter(|&v| border[v] && middle(v) && near(v));
        rim.collect()
    }

    /// Defect of the open area between the lids, relative to the neutral's.
    fn open(&self, side: usize, q: &[Vec3]) -> Option<String> {
        const STEPS: u32 = 200;
        let seam = &self.head.lids[side];
        let area = |q: &[Vec3]| {
            let line = |line: &[u32]| {
                let mut places: Vec<Vec3> = line.iter().map(|&v| q[v as usize]).collect();
                places.sort_by(|a, b| a.x.total_cmp(&b.x));
                places
            };
            let (upper, lower) = (line(&seam.upper), line(&seam.lower));
            let [from, to] = [0, seam.lower.len() - 1].map(|k| self.q[seam.lower[k] as usize].x);
            let gap = |k: u32| {
                let x = from + (to - from) * f64::from(k) / f64::from(STEPS);
                (height(&upper, x) - height(&lower, x)).max(0.0)
            };
            (0..=STEPS).map(gap).sum::<f64>() / f64::from(STEPS + 1)
        };
        let before = Some(area(&self.q)).filter(|before| *before > SHUT)?;
        OPEN.missed(area(q) / before)
    }
}

/// Height at x of a line ordered by x; constant beyond its ends.
fn height(line: &[Vec3], x: f64) -> f64 {
    let after = line.partition_point(|p| p.x < x);
    if after == 0 || after == line.len() {
        return line[after.min(line.len() - 1)].y;
    }
    let (a, b) = (line[after - 1], line[after]);
    a.y + (b.y - a.y) * (x - a.x) / (b.x - a.x).max(1e-12)
}

/// Pivot, in (up, out), of the best rigid motion of some points; `None` if it rotates by less than two degrees.
fn turns_about(some: &[usize], before: &[Vec3], after: &[Vec3]) -> Option<Vector2<f64>> {
    let flat = |q: &[Vec3]| some.iter().map(|&v| q[v].yz()).collect::<Vec<_>>();
    let (a, b) = (flat(before), flat(after));
    let mean = |p: &[Vector2<f64>]| p.iter().sum::<Vector2<f64>>() / p.len() as f64;
    let (a0, b0) = (mean(&a), mean(&b));
    let (mut cross, mut dot) = (0.0, 0.0);
    for (a, b) in a.iter().zip(&b) {
        cross += (a - a0).perp(&(b - b0));
        dot += (a - a0).dot(&(b - b0));
    }
    let angle = Some(cross.atan2(dot)).filter(|angle| angle.abs() > 2_f64.to_radians())?;
    let turn = nalgebra::Rotation2::new(angle).into_inner();
    let rest = nalgebra::Matrix2::identity() - turn;
    Some(rest.try_inverse()? * (b0 - turn * a0))
}

/// Defects of every shape, in words: by the measures and by its requirements.
pub fn defects(head: &Head, shapes: &[Shape]) -> Vec<Vec<String>> {
    let judge = Judge::new(head);
    let one = |k: usize| {
        let mut defects = judge.defects(&shapes[k].name, &shown(shapes, k));
        defects.extend(shapes[k].misses.iter().flatten().cloned());
        defects
    };
    (0..shapes.len()).into_par_iter().map(one).collect()
}

/// The number of shapes that pass, and the defects of the others, one sentence each.
pub fn verdict(shapes: &[Shape], defects: &[Vec<String>]) -> String {
    let failing = shapes.iter().zip(defects).filter(|(_, f)| !f.is_empty());
    let failing = failing.map(|(shape, f)| format!("{} ({})", shape.name, f.join("; ")));
    let failing: Vec<String> = failing.collect();
    let (all, passing) = (shapes.len(), shapes.len() - failing.len());
    let mut out = format!("{passing} of {all} shapes pass the checks: {CHECKED}.");
    if !failing.is_empty() {
        out += &format!(
            " These fail, lengths in eye distances: {}.",
            failing.join(", ")
        );
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_has_its_heights_and_goes_on_level_beyond_its_ends() {
        let line = [[1.0, 0.0], [3.0, 4.0], [7.0, 2.0]].map(|[x, y]| Vec3::new(x, y, 0.0));
        for (x, y) in [(0.0, 0.0), (2.0, 2.0), (4.0, 3.5), (8.0, 2.0)] {
            assert_eq!(height(&line, x), y, "{x}");
        }
    }
}
