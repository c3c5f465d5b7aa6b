//! A polygon mesh as an artist made it: positions, faces of any size with their texture and normal corners, materials.
//!
//! The solver works on *position indices* (the OBJ `v` order); faces are split into triangles only for operators and for
//! glTF. Coordinates stay in the file's own unit and axes (y up, z out of the face, x to the subject's left).
//!
//! Memory and cost: linear in the mesh. Degenerate input: faces that name a vertex twice and faces without area are
//! kept for the output and ignored by the operators; unused vertices belong to no component with faces.

use std::collections::HashMap;
use std::hash::Hash;

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use nalgebra::Vector3;

/// A position or displacement in the file's unit.
pub type Vec3 = Vector3<f64>;

/// One corner of a face.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Corner {
    /// Position index.
    pub vertex: u32,
    /// Index into [`Mesh::uv`].
    pub uv: Option<u32>,
    /// Index into [`Mesh::normals`].
    pub normal: Option<u32>,
}

impl Corner {
    /// A corner without texture and normal.
    pub fn bare(vertex: u32) -> Self {
        Self {
            vertex,
            uv: None,
            normal: None,
        }
    }
}

/// The mesh. Faces are stored flat: face `f` has the corners `starts[f]..starts[f + 1]`.
#[derive(Clone, Debug, Default)]
pub struct Mesh {
    /// One per vertex.
    pub positions: Vec<Vec3>,
    /// All corners of all faces.
    pub corners: Vec<Corner>,
    /// First corner of each face, and the end.
    pub starts: Vec<u32>,
    /// Texture coordinates, origin at the bottom left as in OBJ.
    pub uv: Vec<[f32; 2]>,
    /// Normals as given; empty if the file has none.
    pub normals: Vec<[f32; 3]>,
    /// Linear red, green and blue of every vertex; empty if the file has none.
    pub tints: Vec<[f32; 3]>,
    /// Material names; never empty once a face exists.
    pub materials: Vec<String>,
    /// Material of each face.
    pub face_material: Vec<u32>,
}

/// Lists of numbers, one list per owner, stored flat.
pub struct Lists {
    starts: Vec<u32>,
    all: Vec<u32>,
}

/// Neighbours of every vertex along edges.
pub type Rings = Lists;

impl Lists {
    /// From pairs (owner, number), without duplicates.
    pub(super) fn new(owners: usize, mut pairs: Vec<[u32; 2]>) -> Self {
        pairs.sort_unstable();
        pairs.dedup();
        let start = |owner| pairs.partition_point(|pair| pair[0] < owner) as u32;
        Self {
            starts: (0..=owners as u32).map(start).collect(),
            all: pairs.iter().map(|pair| pair[1]).collect(),
        }
    }

    /// Number of owners.
    pub(super) fn owners(&self) -> usize {
        self.starts.len() - 1
    }

    /// Breadth-first rings around some vertices, at most `most` edges away; each vertex once.
    pub(super) fn about(&self, some: &[u32], most: usize) -> Vec<Vec<u32>> {
        let mut seen = vec![false; self.owners()];
        let mut new = |v: &u32| !std::mem::replace(&mut seen[*v as usize], true);
        let mut out: Vec<Vec<u32>> = vec![some.iter().copied().filter(&mut new).collect()];
        for ring in 0..most {
            let near = out[ring].iter().flat_map(|&v| self.members(v as usize));
            let next = near.copied().filter(&mut new).collect();
            out.push(next);
        }
        out
    }

    /// Vertices connected to `center` by edges whose ends lie within `radius` of it; `center` first.
    pub(super) fn disc(&self, positions: &[Vec3], center: u32, radius: f64) -> Vec<u32> {
        let middle = positions[center as usize];
        let mut found = vec![center];
        let mut next = 0;
        while next < found.len() {
            for &o in self.members(found[next] as usize) {
                if (positions[o as usize] - middle).norm() < radius && !found.contains(&o) {
                    found.push(o);
                }
            }
            next += 1;
        }
        found
    }

    /// The numbers of one owner, ascending.
    pub fn members(&self, owner: usize) -> &[u32] {
        &self.all[self.starts[owner] as usize..self.starts[owner + 1] as usize]
    }
}

/// Edge neighbours of every vertex; an edge may be listed more than once.
pub(super) fn neighbour_lists(vertices: usize, edges: impl Iterator<Item = [u32; 2]>) -> Rings {
    let edges = edges.filter(|[a, b]| a != b);
    let both_ways = edges.flat_map(|[a, b]| [[a, b], [b, a]]);
    Lists::new(vertices, both_ways.collect())
}

impl Mesh {
    /// Number of faces.
    pub fn faces(&self) -> usize {
        self.starts.len().saturating_sub(1)
    }

    /// Corners of face `f`.
    pub fn face(&self, f: usize) -> &[Corner] {
        &self.corners[self.starts[f] as usize..self.starts[f + 1] as usize]
    }

    /// Adds a face.
    pub fn push_face(&mut self, corners: &[Corner], material: u32) {
        if self.starts.is_empty() {
            self.starts.push(0);
        }
        self.corners.extend_from_slice(corners);
        self.starts.push(self.corners.len() as u32);
        self.face_material.push(material);
    }

    /// Triangles of face `f` as corner positions within it: a quad along its shorter diagonal, a larger face as a
    /// fan.
    pub fn split(&self, f: usize) -> Vec<[usize; 3]> {
        let face = self.face(f);
        if face.len() == 4 {
            let p = |k: usize| self.positions[face[k].vertex as usize];
            if (p(1) - p(3)).norm_squared() < (p(0) - p(2)).norm_squared() * (1.0 - 1e-9) {
                return vec![[0, 1, 3], [1, 2, 3]];
            }
        }
        (2..face.len()).map(|k| [0, k - 1, k]).collect()
    }

    /// Face `f` as a fan about its first corner, for rendering.
    pub(crate) fn fan(&self, f: usize) -> impl Iterator<Item = [Corner; 3]> {
        let face = self.face(f);
        (2..face.len()).map(|k| [face[0], face[k - 1], face[k]])
    }

    /// All faces as fans, in the order of the file.
    pub fn fans(&self) -> impl Iterator<Item = [Corner; 3]> {
        (0..self.faces()).flat_map(|f| self.fan(f))
    }

    /// All triangles as vertex indices, without degenerate ones.
    pub fn triangles(&self) -> Vec<[u32; 3]> {
        let all = (0..self.faces()).flat_map(|f| self.solid(f));
        all.map(|t| t.map(|c| c.vertex)).collect()
    }

    /// Corners of the non-degenerate triangles of face `f`.
    pub(super) fn solid(&self, f: usize) -> impl Iterator<Item = [Corner; 3]> {
        let face = self.face(f);
        let cut = self.split(f).into_iter().map(|t| t.map(|k| face[k]));
        let apart = |a: &Corner, b: &Corner| a.vertex != b.vertex;
        cut.filter(move |[a, b, c]| apart(a, b) && apart(b, c) && apart(a, c))
    }

    /// Unit normal of a corner: the file's, or else the vertex's of `smooth`.
    pub(super) fn normal(&self, corner: &Corner, smooth: &[Vec3]) -> Vec3 {
        let given = corner.normal.map(|k| self.normals[k as usize]);
        let given = given.and_then(|n| Vec3::from(n.map(f64::from)).try_normalize(0.0));
        given.unwrap_or(smooth[corner.vertex as usize])
    }

    /// The edges around face `f`, each in its direction.
    pub(super) fn sides(&self, f: usize) -> impl Iterator<Item = [u32; 2]> {
        let face = self.face(f);
        (0..face.len()).map(|k| [face[k], face[(k + 1) % face.len()]].map(|c| c.vertex))
    }

    fn edges(&self) -> impl Iterator<Item = [u32; 2]> {
        (0..self.faces()).flat_map(|f| self.sides(f))
    }

    /// Edge neighbours of every vertex (diagonals of quads are not edges).
    pub fn rings(&self) -> Rings {
        neighbour_lists(self.positions.len(), self.edges())
    }

    /// Connected component of every vertex, numbered in order of their first vertex, and their number.
    pub fn components(&self, rings: &Rings) -> (Vec<u32>, usize) {
        connected(rings, |_| true)
    }

    /// Area vector of face `f`, twice its area long, by Newell's method: exact for planar faces, of the mean plane
    /// for others, independent of a diagonal.
    pub(super) fn newell(&self, f: usize, positions: &[Vec3]) -> Vec3 {
        let at = |side: [u32; 2]| side.map(|v| positions[v as usize]);
        let turns = self.sides(f).map(at).map(|[a, b]| a.cross(&b));
        turns.fold(Vec3::zeros(), |sum, turn| sum + turn)
    }

    /// Area-weighted unit normals of `positions` under this mesh's faces; (0, 0, 1) where there is no area.
    pub fn vertex_normals(&self, positions: &[Vec3]) -> Vec<Vec3> {
        let mut normals = vec![Vec3::zeros(); positions.len()];
        for f in 0..self.faces() {
            let n = self.newell(f, positions);
            for corner in self.face(f) {
                normals[corner.vertex as usize] += n;
            }
        }
        for n in &mut normals {
            let length = n.norm();
            *n = if length > 0.0 { *n / length } else { Vec3::z() };
        }
        normals
    }

    /// Whether each material is an open sheet with a visible back: strands of hair, lashes, cloth, a mask. OBJ does
    /// not state this. A part is a sheet if the square of its border's length exceeds `SHEET` times its area: 12.6
    /// for a disc, 6.3 for half a ball, 1 to 2 for a head open at the neck, 0 for a closed part. Vertices at one
    /// position count as one.
    pub fn sheets(&self) -> Vec<bool> {
        const SHEET: f64 = 4.0;
        let exact = |p: &Vec3| [p.x, p.y, p.z].map(f64::to_bits);
        let place = first_alike(self.positions.iter().map(exact));
        // Keyed by position, with the face: faces that share an edge belong together, faces that share a corner do
        // not.
        let edge = |f: usize, side: [u32; 2]| {
            let mut ends = side.map(|v| place[v as usize]);
            ends.sort_unstable();
            (ends, f as u32)
        };
        let edges = (0..self.faces()).flat_map(|f| self.sides(f).map(move |side| (f, side)));
        let mut edges: Vec<_> = edges.map(|(f, side)| edge(f, side)).collect();
        edges.sort_unstable();
        let groups = || edges.chunk_by(|a, b| a.0 == b.0);
        let beside = groups().flat_map(|same| same.windows(2).map(|pair| [pair[0].1, pair[1].1]));
        let rings = neighbour_lists(self.faces(), beside);
        let (part, parts) = connected(&rings, |_| true);
        let part_of = |f: usize| part[f] as usize;
        let (mut border, mut area) = (vec![0.0; parts], vec![0.0; parts]);
        for (ends, f) in groups().filter(|same| same.len() == 1).map(|same| same[0]) {
            let [a, b] = ends.map(|v| self.positions[v as usize]);
            border[part_of(f as usize)] += (a - b).norm();
        }
        for f in 0..self.faces() {
            area[part_of(f)] += 0.5 * self.newell(f, &self.positions).norm();
        }
        let mut thin = vec![false; self.materials.len()];
        for f in 0..self.faces() {
            let part = part_of(f);
            thin[self.face_material[f] as usize] |= border[part].powi(2) > SHEET * area[part];
        }
        thin
    }

    /// Whether each vertex is on a border, an edge of only one face.
    pub fn border(&self) -> Vec<bool> {
        let mut border = vec![false; self.positions.len()];
        let mut edges: Vec<[u32; 2]> = self.edges().collect();
        edges.iter_mut().for_each(|edge| edge.sort_unstable());
        edges.sort_unstable();
        let groups = edges.chunk_by(|a, b| a == b);
        for &v in groups.filter(|same| same.len() == 1).flatten().flatten() {
            border[v as usize] = true;
        }
        border
    }
}

/// A k-d tree of vertices, which finds the nearest to a point in microseconds.
pub struct Nearest {
    /// `None` for an empty set.
    tree: Option<ImmutableKdTree<f64, 3>>,
    vertices: Vec<u32>,
}

impl Nearest {
    /// From some vertices of a mesh.
    pub fn new(positions: &[Vec3], some: &[u32]) -> Self {
        let points: Vec<[f64; 3]> = some.iter().map(|&v| positions[v as usize].into()).collect();
        let tree = (!points.is_empty()).then(|| ImmutableKdTree::new_from_slice(&points).ok());
        Self {
            tree: tree.flatten(),
            vertices: some.to_vec(),
        }
    }

    /// The vertex nearest to a point; `None` if the set is empty.
    pub fn closest(&self, p: &Vec3) -> Option<u32> {
        let point = [p.x, p.y, p.z];
        let found = self.tree.as_ref()?.query(&point);
        let found = found.nearest_one::<SquaredEuclidean<f64>>().execute();
        self.vertices.get(found.item as usize).copied()
    }
}

/// For every item the number of the first one with the same key.
pub(super) fn first_alike<K: Eq + Hash>(keys: impl Iterator<Item = K>) -> Vec<u32> {
    let mut first = HashMap::new();
    keys.zip(0..)
        .map(|(key, k)| *first.entry(key).or_insert(k))
        .collect()
}

/// Normal of a triangle, twice its area long.
pub(super) fn area_vector([a, b, c]: [Vec3; 3]) -> Vec3 {
    (b - a).cross(&(c - a))
}

/// Smallest and largest coordinates of points; infinite and inverted without any.
pub fn bounding_box<'a>(places: impl IntoIterator<Item = &'a Vec3>) -> (Vec3, Vec3) {
    let none = (Vec3::repeat(f64::INFINITY), Vec3::repeat(f64::NEG_INFINITY));
    let wider = |(low, high): (Vec3, Vec3), p: &Vec3| (low.inf(p), high.sup(p));
    places.into_iter().fold(none, wider)
}

/// Components of the subgraph of vertices that pass `keep`; `u32::MAX` for the others. Returns labels and their number.
pub fn connected(rings: &Rings, keep: impl Fn(usize) -> bool) -> (Vec<u32>, usize) {
    let mut label = vec![u32::MAX; rings.owners()];
    let (mut stack, mut count) = (Vec::new(), 0);
    for start in 0..label.len() {
        if label[start] != u32::MAX || !keep(start) {
            continue;
        }
        label[start] = count;
        stack.push(start);
        while let Some(v) = stack.pop() {
            for o in rings.members(v).iter().map(|&o| o as usize) {
                if label[o] == u32::MAX && keep(o) {
                    label[o] = count;
                    stack.push(o);
                }
            }
        }
        count += 1;
    }
    (label, count as usize)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// A bumpy square sheet of quads, `n` by `n` vertices, spacing `h`.
    pub(crate) fn sheet(n: usize, h: f64) -> Mesh {
        let mut mesh = Mesh {
            materials: vec!["skin".into()],
            ..Mesh::default()
        };
        for row in 0..n {
            for col in 0..n {
                let (x, y) = (col as f64 * h, row as f64 * h);
                mesh.positions
                    .push(Vec3::new(x, y, 0.3 * (1.3 * x).sin() * (0.9 * y).cos()));
            }
        }
        for row in 0..n - 1 {
            for col in 0..n - 1 {
                let v = row * n + col;
                let face = [v, v + 1, v + n + 1, v + n];
                mesh.push_face(&face.map(|v| Corner::bare(v as u32)), 0);
            }
        }
        mesh
    }

    #[test]
    fn a_sheet_has_one_component_a_border_and_normals_that_point_up() {
        let mesh = sheet(6, 0.5);
        let rings = mesh.rings();
        assert_eq!(mesh.components(&rings).1, 1);
        assert_eq!(mesh.border().iter().filter(|&&b| b).count(), 20);
        assert_eq!(mesh.triangles().len(), 50);
        assert!(
            mesh.vertex_normals(&mesh.positions)
                .iter()
                .all(|n| n.z > 0.5)
        );
        assert_eq!(rings.members(7).len(), 4);
    }

    #[test]
    fn sheets_are_distinguished_from_closed_parts_and_heads_open_at_the_neck() {
        let mut mesh = sheet(6, 0.5);
        assert_eq!(mesh.sheets(), [true]);
        // A box without its bottom, five times as tall as wide; its corners are split as glTF splits them.
        let at = |k: usize, y: f64| {
            Vec3::new([0.0, 1.0, 1.0, 0.0][k % 4], y, [0.0, 0.0, 1.0, 1.0][k % 4])
        };
        let mut faces: Vec<[Vec3; 4]> = (0..4)
            .map(|k| [at(k, 0.0), at(k + 1, 0.0), at(k + 1, 5.0), at(k, 5.0)])
            .collect();
        faces.push([0, 1, 2, 3].map(|k| at(k, 5.0)));
        mesh.materials.push("box".into());
        for face in faces {
            let first = mesh.positions.len() as u32;
            mesh.positions.extend(face);
            mesh.push_face(&[0, 1, 2, 3].map(|k| Corner::bare(first + k)), 1);
        }
        assert_eq!(mesh.sheets(), [true, false]);
    }

    #[test]
    fn nearest_vertex_equals_brute_force() {
        let mut random = fastrand::Rng::with_seed(7);
        let mut point = |size: f64| Vec3::from_fn(|_, _| (random.f64() - 0.5) * size);
        let positions: Vec<Vec3> = (0..500).map(|_| point(2.0)).collect();
        let some: Vec<u32> = (0..500).filter(|v| v % 3 == 0).collect();
        let nearest = Nearest::new(&positions, &some);
        for _ in 0..300 {
            let p = point(4.0);
            let far = |v: u32| (positions[v as usize] - p).norm();
            let best = some.iter().map(|&v| far(v)).fold(f64::INFINITY, f64::min);
            assert!((far(nearest.closest(&p).unwrap()) - best).abs() < 1e-12);
        }
        assert_eq!(Nearest::new(&positions, &[]).closest(&positions[0]), None);
        assert_eq!(
            Nearest::new(&positions, &[5]).closest(&positions[9]),
            Some(5)
        );
    }
}
