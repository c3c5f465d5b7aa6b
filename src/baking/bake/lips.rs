//! Cuts joined lips, as scans and statues have them, open from corner to corner and adds a mouth cavity.
//!
//! * Faces crossed by the crease between the lips ([`super::crease`]) are split along it. The cut is the shortest
//!   path along edges from corner to corner, with edges beside the crease costing more (Dijkstra).
//! * Vertices of the cut are duplicated, and the faces below it use the copies. A closed mouth cavity is attached to
//!   both edges, so that neither the far side of the head nor back faces are visible.
//!
//! The file's vertices keep their numbers and positions; new ones follow. Units: the mesh's; frame as in
//! [`super::head`]. Cost: linear in the faces near the mouth. Limits: without connected skin between the corners
//! nothing is cut.

use std::collections::{HashMap, VecDeque};
use std::f64::consts::PI;

use super::crease::Crease;
use super::head::Head;
use super::mesh::{Corner, Mesh, Vec3};
use super::seam::paths;

/// Crossings nearer to an end of an edge than this part of it snap to that end.
const SNAP: f64 = 0.15;
/// Extra cost of an edge per eye distance from the crease.
const PULL: f64 = 60.0;
/// Largest distance of processed faces from the crease, in eye distances.
const MAX_FROM_CREASE: f64 = 1.0;
/// Rows of the cavity: depth behind the lips, and half the height in the middle, in eye distances.
const ROWS: [[f64; 2]; 5] = [
    [0.06, 0.008],
    [0.20, 0.06],
    [0.42, 0.15],
    [0.62, 0.14],
    [0.68, 0.0],
];
/// How much narrower than the mouth the cavity's last row is, in eye distances.
const NARROW: f64 = 0.3;
/// Width over which the cavity's rows are smoothed, in eye distances.
const SMOOTH: f64 = 0.12;

/// A mesh cut open between the lips.
pub(super) struct Opened {
    /// The unchanged faces first, in their order.
    pub(super) mesh: Mesh,
    /// Whether each face of the source is among these.
    pub(super) kept: Vec<bool>,
    /// New vertex numbers of landmarks 60 to 67.
    pub(super) landmarks: [u64; 8],
}

/// A face near the crease: one of the source, or a part of one.
struct Piece {
    face: usize,
    corners: Vec<Corner>,
    is_changed: bool,
    /// Whether it lies below the cut; `None` if it does not touch it.
    is_lower: Option<bool>,
}

/// An edge of the cut, as seen by the face on one side.
#[derive(Clone, Copy)]
struct Lip {
    /// In the direction of the cut.
    corners: [Corner; 2],
    /// Whether the face lists them in this order.
    is_forward: bool,
    material: u32,
}

/// Working state of the cut. A node is a vertex of the welded mesh, or a point at which an edge is split; these come
/// after all vertices.
struct Work<'a> {
    head: &'a Head,
    mesh: Mesh,
    /// The node of each vertex.
    node: Vec<u32>,
    /// Position of each node in the face's frame, and height above the crease; `NaN` away from it.
    places: Vec<Vec3>,
    above: Vec<f64>,
    pieces: Vec<Piece>,
    /// Nodes from corner to corner, and the index of each.
    path: Vec<u32>,
    on: HashMap<u32, usize>,
}

fn sorted([a, b]: [u32; 2]) -> [u32; 2] {
    [a.min(b), a.max(b)]
}

/// Cuts a source open between the lips; `vertex` gives the head's vertex for each of the source's. `None` if no path
/// joins the corners.
pub(super) fn opened(source: &Mesh, vertex: &[u32], head: &Head) -> Option<Opened> {
    let to_face = head.axes.transpose();
    let seen: Vec<Vec3> = head.mesh.positions.iter().map(|p| to_face * p).collect();
    let crease = Crease::traced(head, &seen);
    let [from, to] = [60, 64].map(|corner| crease.end(head, &seen, corner));
    let mut work = Work {
        head,
        mesh: source.clone(),
        node: vertex.to_vec(),
        above: vec![f64::NAN; seen.len()],
        places: seen,
        pieces: Vec::new(),
        path: Vec::new(),
        on: HashMap::new(),
    };
    work.split(&crease, [from, to]);
    let path = work.shortest(from, to);
    // At least one vertex between the corners for each landmark.
    work.path = path.filter(|path| path.len() > 4)?;
    work.on = work.path.iter().copied().zip(0..).collect();
    work.find_sides();
    work.double();
    let [upper, lower] = [false, true].map(|is_lower| work.lips(is_lower));
    let lips = [upper?, lower?];
    let landmarks = work.landmarks(&lips);
    let cavity = work.cavity(&lips);
    Some(work.finish(source, &cavity, landmarks))
}

impl Work<'_> {
    fn node(&self, corner: &Corner) -> u32 {
        self.node[corner.vertex as usize]
    }

    /// The sides of a polygon as nodes.
    fn sides(&self, corners: &[Corner]) -> Vec<[u32; 2]> {
        let n = corners.len();
        let side = |k: usize| [corners[k], corners[(k + 1) % n]].map(|c| self.node(&c));
        (0..n).map(side).collect()
    }

    /// Adds a vertex with the attributes of another.
    fn push(&mut self, at: Vec3, like: u32) -> u32 {
        let tint = self.mesh.tints.get(like as usize).copied();
        self.mesh.tints.extend(tint);
        self.mesh.positions.push(at);
        self.node.push(self.node[like as usize]);
        self.mesh.positions.len() as u32 - 1
    }

    /// Share of an edge at which it crosses the crease between the corners; `None` if it does not.
    fn crossed(&self, [from, to]: [u32; 2]) -> Option<f64> {
        let [a, b] = [from, to].map(|v| self.above[v as usize]);
        let [p, q] = [from, to].map(|v| self.places[v as usize].x);
        let [right, left] = [60, 64].map(|k| self.places[self.head.points[k] as usize].x);
        let share = a / (a - b);
        (a * b < 0.0 && (right..left).contains(&(p + (q - p) * share))).then_some(share)
    }

    /// Splits the faces near the mouth along the crease, which `ends` lie on.
    fn split(&mut self, crease: &Crease, ends: [u32; 2]) {
        let (head, near) = (self.head, MAX_FROM_CREASE * self.head.eye_distance);
        let [right, left] = ends.map(|v| self.places[v as usize]);
        for (v, p) in self.places.iter().enumerate() {
            let aside = (right.x - near..left.x + near).contains(&p.x);
            let above = crease.above(p);
            if head.skin[v] && aside && above.abs() < near && p.z > right.z.min(left.z) - near {
                self.above[v] = above;
            }
        }
        for v in ends {
            self.above[v as usize] = 0.0;
        }
        let near = |c: &Corner| !self.above[self.node(c) as usize].is_nan();
        let faces = (0..self.mesh.faces()).map(|f| self.mesh.face(f).to_vec());
        let faces = faces.enumerate().filter(|(_, face)| face.iter().all(near));
        let faces: Vec<(usize, Vec<Corner>)> = faces.collect();
        let sides = faces.iter().flat_map(|(_, face)| self.sides(face));
        for side in sides.collect::<Vec<_>>() {
            match self.crossed(side) {
                Some(share) if share < SNAP => self.above[side[0] as usize] = 0.0,
                Some(share) if share > 1.0 - SNAP => self.above[side[1] as usize] = 0.0,
                _ => {}
            }
        }
        let (mut cuts, mut made) = (HashMap::new(), HashMap::new());
        for (face, whole) in faces {
            let mut corners = Vec::new();
            for (k, c) in whole.iter().enumerate() {
                let d = &whole[(k + 1) % whole.len()];
                corners.push(*c);
                let ends = sorted([c, d].map(|c| self.node(c)));
                if let Some(share) = self.crossed(ends) {
                    let is_forward = self.node(c) == ends[0];
                    let edge = if is_forward { [*c, *d] } else { [*d, *c] };
                    let node = *cuts.entry(ends).or_insert_with(|| {
                        let [p, q] = ends.map(|v| self.places[v as usize]);
                        self.places.push(p + (q - p) * share);
                        self.above.push(0.0);
                        self.places.len() as u32 - 1
                    });
                    corners.push(self.between(edge, share, node, &mut made));
                }
            }
            let is_split = corners.len() > whole.len();
            self.divide(face, corners, is_split);
        }
    }

    /// The corner of a node at `share` of an edge.
    fn between(
        &mut self,
        [a, b]: [Corner; 2],
        share: f64,
        node: u32,
        made: &mut HashMap<[u32; 2], u32>,
    ) -> Corner {
        let vertex = *made.entry([a.vertex, b.vertex]).or_insert_with(|| {
            let [p, q] = [a, b].map(|c| self.mesh.positions[c.vertex as usize]);
            let vertex = self.push(p + (q - p) * share, a.vertex);
            self.node[vertex as usize] = node;
            vertex
        });
        let uv = a.uv.zip(b.uv).map(|(a, b)| {
            let [p, q] = [a, b].map(|k| self.mesh.uv[k as usize]);
            let mixed = [0, 1].map(|k| p[k] + (q[k] - p[k]) * share as f32);
            self.mesh.uv.push(mixed);
            self.mesh.uv.len() as u32 - 1
        });
        Corner {
            uv,
            ..Corner::bare(vertex)
        }
    }

    /// Divides a polygon along the crease.
    fn divide(&mut self, face: usize, corners: Vec<Corner>, is_split: bool) {
        let n = corners.len();
        let on = |k: &usize| self.above[self.node(&corners[*k]) as usize] == 0.0;
        let on: Vec<usize> = (0..n).filter(on).collect();
        let apart = |a: usize, b: usize| b - a > 1 && b - a + 1 < n;
        let ends = on.first().copied().zip(on.last().copied());
        let parts = match ends.filter(|&(a, b)| apart(a, b)) {
            None => vec![corners],
            Some((a, b)) => vec![
                corners[a..=b].to_vec(),
                [&corners[b..], &corners[..=a]].concat(),
            ],
        };
        let is_changed = is_split || parts.len() > 1;
        self.pieces.extend(parts.into_iter().map(|corners| Piece {
            face,
            corners,
            is_changed,
            is_lower: None,
        }));
    }

    /// The shortest path along edges of pieces between two nodes.
    fn shortest(&self, from: u32, to: u32) -> Option<Vec<u32>> {
        let mut beside: HashMap<u32, Vec<u32>> = HashMap::new();
        for piece in &self.pieces {
            for [a, b] in self.sides(&piece.corners) {
                beside.entry(a).or_default().push(b);
                beside.entry(b).or_default().push(a);
            }
        }
        let w = self.head.eye_distance;
        let off = |v: u32| self.above[v as usize].abs();
        let mut found = paths(
            from,
            1,
            |at| at == to,
            |at, step| {
                for &next in beside.get(&at).into_iter().flatten() {
                    let [p, q] = [at, next].map(|v| self.places[v as usize]);
                    step(
                        next,
                        (p - q).norm() * (1.0 + PULL * (off(at) + off(next)) / w),
                    );
                }
            },
        );
        found.pop().map(|(_, path)| path)
    }

    /// The index of an edge of the cut, and whether it is listed in the cut's direction.
    fn on_cut(&self, [a, b]: [u32; 2]) -> Option<(usize, bool)> {
        let (a, b) = (*self.on.get(&a)?, *self.on.get(&b)?);
        (a.abs_diff(b) == 1).then_some((a.min(b), a < b))
    }

    /// Whether a node lies on the cut and not at its end.
    fn is_inner(&self, node: u32) -> bool {
        let at = self.on.get(&node);
        at.is_some_and(|&at| at > 0 && at + 1 < self.path.len())
    }

    /// Marks the pieces below the cut: those with an edge of it in one direction, and all connected to them.
    fn find_sides(&mut self) {
        let normals = self.head.mesh.vertex_normals(&self.head.mesh.positions);
        let lip = normals[self.head.points[57] as usize];
        let faces_out = lip.dot(&self.head.axes.column(2)) > 0.0;
        let mut beside: HashMap<[u32; 2], Vec<usize>> = HashMap::new();
        let mut queue = VecDeque::new();
        for k in 0..self.pieces.len() {
            for side in self.sides(&self.pieces[k].corners) {
                beside.entry(sorted(side)).or_default().push(k);
                if let Some((_, is_forward)) = self.on_cut(side) {
                    self.pieces[k].is_lower = Some(is_forward != faces_out);
                    queue.push_back(k);
                }
            }
        }
        while let Some(k) = queue.pop_front() {
            for side in self.sides(&self.pieces[k].corners) {
                if self.on_cut(side).is_none() && side.iter().any(|&node| self.is_inner(node)) {
                    for &other in &beside[&sorted(side)] {
                        if self.pieces[other].is_lower.is_none() {
                            self.pieces[other].is_lower = self.pieces[k].is_lower;
                            queue.push_back(other);
                        }
                    }
                }
            }
        }
    }

    /// Duplicates the vertices of the cut for the pieces below it.
    fn double(&mut self) {
        let mut copies: HashMap<u32, u32> = HashMap::new();
        let mut pieces = std::mem::take(&mut self.pieces);
        for piece in pieces.iter_mut().filter(|p| p.is_lower == Some(true)) {
            for corner in &mut piece.corners {
                if self.is_inner(self.node(corner)) {
                    let v = corner.vertex;
                    let at = self.mesh.positions[v as usize];
                    corner.vertex = *copies.entry(v).or_insert_with(|| self.push(at, v));
                    piece.is_changed = true;
                }
            }
        }
        self.pieces = pieces;
    }

    /// Edges of the cut as the faces on one side list them; `None` if a face is missing.
    fn lips(&self, is_lower: bool) -> Option<Vec<Lip>> {
        let mut lips = vec![None; self.path.len() - 1];
        for piece in self.pieces.iter().filter(|p| p.is_lower == Some(is_lower)) {
            let next = piece.corners.iter().cycle().skip(1);
            let sides = self.sides(&piece.corners).into_iter();
            for ((&a, &b), side) in piece.corners.iter().zip(next).zip(sides) {
                if let Some((at, is_forward)) = self.on_cut(side) {
                    lips[at] = Some(Lip {
                        corners: if is_forward { [a, b] } else { [b, a] },
                        is_forward,
                        material: self.mesh.face_material[piece.face],
                    });
                }
            }
        }
        lips.into_iter().collect()
    }

    /// Vertices of the inner lip landmarks on the edges of their lips, straight below or above the former ones.
    fn landmarks(&self, lips: &[Vec<Lip>; 2]) -> [u64; 8] {
        let left = self.head.axes.column(0);
        let place = |lip: &Lip| self.mesh.positions[lip.corners[1].vertex as usize].dot(&left);
        let ends = [lips[0].first(), lips[0].last()].map(|lip| lip.map(|lip| lip.corners));
        std::array::from_fn(|k| {
            let aim = self.head.point(60 + k).dot(&left);
            let far = |lip: &&Lip| (place(lip) - aim).abs();
            let line = &lips[usize::from(k > 4)];
            let inner = line[..line.len() - 1].iter();
            let nearest = inner.min_by(|a, b| far(a).total_cmp(&far(b)));
            let corner = match k {
                0 => ends[0].map(|[start, _]| start),
                4 => ends[1].map(|[_, end]| end),
                _ => nearest.or(line.first()).map(|lip| lip.corners[1]),
            };
            corner.map_or(0, |corner| u64::from(corner.vertex))
        })
    }

    /// The cut, smoothed and never in front of it, which the rows of the cavity follow.
    fn line(&self) -> Vec<Vec3> {
        let path = || self.path.iter().map(|&node| self.places[node as usize]);
        let smooth = |p: Vec3| {
            let near = path().map(|q| {
                let apart = (p.x - q.x) / (SMOOTH * self.head.eye_distance);
                Vec3::new(q.y, q.z, 1.0) * (-apart * apart).exp()
            });
            let sum: Vec3 = near.sum();
            Vec3::new(p.x, sum.x / sum.z, sum.y / sum.z)
        };
        let mut line: Vec<Vec3> = path().map(smooth).collect();
        let before = line.iter().zip(path()).map(|(p, q)| p.z - q.z);
        let most = before.fold(0.0, f64::max);
        line.iter_mut().for_each(|p| p.z -= most);
        line
    }

    /// Attaches a closed cavity to both edges; returns its faces.
    fn cavity(&mut self, lips: &[Vec<Lip>; 2]) -> Vec<([Corner; 4], u32)> {
        let (line, axes, w) = (self.line(), self.head.axes, self.head.eye_distance);
        let (last, like) = (line.len() - 1, lips[0][0].corners[0].vertex);
        let middle = (line[0].x + line[last].x) / 2.0;
        // Vertices of a row on the upper and the lower side; shared at the corners and at the end.
        let mut rows: Vec<[Vec<u32>; 2]> = Vec::new();
        for (row, [back, half]) in ROWS.into_iter().enumerate() {
            let narrow = NARROW * row as f64 / (ROWS.len() - 1) as f64;
            let mut place = |at: usize, side: f64| {
                let p = line[at];
                let high = half * (PI * at as f64 / last as f64).sin().max(0.0).sqrt();
                let moved = Vec3::new((middle - p.x) * narrow, side * high * w, -back * w);
                self.push(axes * (p + moved), like)
            };
            let upper: Vec<u32> = (0..=last).map(|at| place(at, 1.0)).collect();
            let mut lower = upper.clone();
            if half > 0.0 {
                (1..last).for_each(|at| lower[at] = place(at, -1.0));
            }
            rows.push([upper, lower]);
        }
        let mut faces = Vec::new();
        for (side, lips) in lips.iter().enumerate() {
            for (at, lip) in lips.iter().enumerate() {
                let mut edge = lip.corners.map(|c| Corner { normal: None, ..c });
                for row in &rows {
                    let [a, b] = edge;
                    let deeper = |vertex, of: Corner| Corner { vertex, ..of };
                    let next = [deeper(row[side][at], a), deeper(row[side][at + 1], b)];
                    let face = if lip.is_forward {
                        [b, a, next[0], next[1]]
                    } else {
                        [a, b, next[1], next[0]]
                    };
                    faces.push((face, lip.material));
                    edge = next;
                }
            }
        }
        faces
    }

    /// Assembles the mesh: unchanged faces, pieces at the cut, the cavity.
    fn finish(self, source: &Mesh, cavity: &[([Corner; 4], u32)], landmarks: [u64; 8]) -> Opened {
        let mut kept = vec![true; source.faces()];
        let changed = self.pieces.iter().filter(|piece| piece.is_changed);
        changed.clone().for_each(|piece| kept[piece.face] = false);
        let mut mesh = Mesh {
            corners: Vec::new(),
            starts: Vec::new(),
            face_material: Vec::new(),
            ..self.mesh
        };
        for f in (0..source.faces()).filter(|&f| kept[f]) {
            mesh.push_face(source.face(f), source.face_material[f]);
        }
        for Piece { face, corners, .. } in changed {
            let bare = corners.iter().map(|&c| Corner { normal: None, ..c });
            mesh.push_face(&bare.collect::<Vec<_>>(), source.face_material[*face]);
        }
        for (corners, material) in cavity {
            mesh.push_face(corners, *material);
        }
        Opened {
            mesh,
            kept,
            landmarks,
        }
    }
}
