//! A canonical mesh for every file format, so that results do not depend on how vertices are split and numbered.
//!
//! OBJ has quads and one vertex per position; glTF has triangles, duplicates at seams, single precision and another
//! order, which would break ties between diagonals differently. So every head is first normalised: positions in
//! single precision, duplicates welded, triangles paired to quads as in [`super::weld`], vertices sorted by position,
//! faces by their vertices. It is solved in that order, and shapes are returned in the file's.
//!
//! Positions are compared on a grid of a thousandth of the head, so that the same head in metres and in centimetres
//! is sorted alike; vertices in one cell by exact position, vertices at one position by their surroundings.
//!
//! Units: the mesh's. Cost: sorting vertices and faces. Limits: texture, normals and materials stay with the file.

use std::cmp::Ordering;
use std::collections::HashMap;

use super::head::no_such_vertex;
use super::mesh::{Corner, Mesh, Vec3, bounding_box};
use super::morphs::single;
use super::shape::Shape;
use super::weld::{faces, recut, welded};
use mien_workbench::fault::Fault;

/// Cells of the grid along the head's longest side.
const CELLS: f64 = 1000.0;

/// A head's geometry in canonical order, and the mapping to the file's.
pub struct Ordered {
    /// The canonical mesh.
    pub mesh: Mesh,
    /// Its vertex for each vertex of the file.
    vertex: Vec<u32>,
}

impl Ordered {
    /// Normalises a mesh.
    pub fn new(source: &Mesh) -> Self {
        // Adding 0 turns -0 into 0.
        let rounded = source.positions.iter().map(|p| single(p).map(|x| x + 0.0));
        let rounded: Vec<[f32; 3]> = rounded.collect();
        // Faces sorted by material, as in glTF.
        let mut by_material: Vec<usize> = (0..source.faces()).collect();
        by_material.sort_by_key(|&f| source.face_material[f]);
        let cut = by_material.into_iter().flat_map(|f| source.solid(f));
        let mut triangles: Vec<[u32; 3]> = cut.map(|t| t.map(|c| c.vertex)).collect();
        let same = welded(&rounded, &triangles, &vec![0; triangles.len()]);
        for t in &mut triangles {
            *t = t.map(|v| same[v as usize]);
        }
        let positions = rounded.iter().map(|p| Vec3::from(p.map(f64::from)));
        let positions: Vec<Vec3> = positions.collect();
        let mut faces = faces(&positions, &triangles);
        recut(&positions, &mut faces);
        let order = order(&positions, &faces, &same);
        let mut vertex = vec![u32::MAX; positions.len()];
        for (k, &v) in order.iter().enumerate() {
            vertex[v as usize] = k as u32;
        }
        for face in &mut faces {
            for v in face.iter_mut() {
                *v = vertex[*v as usize];
            }
            // A quad keeps its diagonal from the first to the third corner.
            let firsts = (0..face.len()).step_by(if face.len() == 4 { 2 } else { 1 });
            let least = firsts.min_by_key(|&k| face[k]).unwrap_or(0);
            face.rotate_left(least);
        }
        faces.sort_unstable();
        let mut mesh = Mesh {
            positions: order.iter().map(|&v| positions[v as usize]).collect(),
            materials: vec!["skin".into()],
            ..Mesh::default()
        };
        for face in &faces {
            let corners: Vec<Corner> = face.iter().map(|&v| Corner::bare(v)).collect();
            mesh.push_face(&corners, 0);
        }
        let vertex = same.iter().map(|&v| vertex[v as usize]).collect();
        Self { mesh, vertex }
    }

    /// Vertex of the canonical mesh for each vertex of the file.
    pub fn vertex(&self) -> &[u32] {
        &self.vertex
    }

    /// Landmarks of the file as vertices of the canonical mesh.
    ///
    /// # Errors
    /// If a number is no vertex of the file.
    pub fn landmarks(&self, numbers: &[u64]) -> Result<Vec<u64>, Fault> {
        let ordered = numbers.iter().enumerate().map(|(landmark, &vertex)| {
            let found = self.vertex.get(vertex as usize);
            let found = found.ok_or_else(|| no_such_vertex(landmark, vertex, self.vertex.len()))?;
            Ok(u64::from(*found))
        });
        ordered.collect()
    }

    /// A shape of the canonical mesh in the file's vertex order.
    pub fn scattered(&self, shape: Shape) -> Shape {
        let all = || self.vertex.iter().map(|&v| v as usize);
        Shape {
            displacement: all().map(|v| shape.displacement[v]).collect(),
            area: all().map(|v| shape.area[v]).collect(),
            ..shape
        }
    }
}

/// Vertices sorted by position, unused ones last in their former order; `same` is the first duplicate of each vertex.
fn order(positions: &[Vec3], faces: &[Vec<u32>], same: &[u32]) -> Vec<u32> {
    let mut used = vec![false; positions.len()];
    for &v in faces.iter().flatten() {
        used[v as usize] = true;
    }
    let all = 0..positions.len() as u32;
    let (mut order, loose): (Vec<u32>, Vec<u32>) = all.partition(|&v| used[v as usize]);
    let (low, high) = bounding_box(order.iter().map(|&v| &positions[v as usize]));
    let cell = ((high - low).max() / CELLS).max(f64::MIN_POSITIVE);
    // From bottom to top: halves of a head stay together, also in memory.
    let exact = |v: u32| <[f64; 3]>::from(positions[v as usize].yxz());
    let key = |v: u32| exact(v).map(|x| (x / cell).round() as i64);
    let place = |v: &u32| (key(*v), exact(*v));
    order.sort_by(|a, b| place(a).partial_cmp(&place(b)).unwrap_or(Ordering::Equal));
    // Closed lips and lids: two vertices at one position, distinguished by the faces around them.
    let together = |a: &u32, b: &u32| exact(*a) == exact(*b);
    let shared = order.chunk_by(together).filter(|group| group.len() > 1);
    let mut around: HashMap<u32, Vec<[i64; 3]>> =
        shared.flatten().map(|&v| (v, Vec::new())).collect();
    for face in faces {
        for &v in face {
            if let Some(cells) = around.get_mut(&v) {
                cells.extend(face.iter().filter(|&&o| o != v).map(|&o| key(o)));
            }
        }
    }
    around.values_mut().for_each(|cells| cells.sort_unstable());
    for group in order.chunk_by_mut(together).filter(|group| group.len() > 1) {
        group.sort_by(|a, b| around[a].cmp(&around[b]));
    }
    order.extend(loose.into_iter().filter(|&v| same[v as usize] == v));
    order
}

#[cfg(test)]
mod tests {
    use super::super::mesh::tests::sheet;
    use super::*;

    /// A sheet with other numbers, other first corners and the unit `scale`.
    fn shuffled(mesh: &Mesh, scale: f64, seed: u64) -> (Mesh, Vec<u32>) {
        let mut random = fastrand::Rng::with_seed(seed);
        let n = mesh.positions.len();
        let mut number: Vec<u32> = (0..n as u32).collect();
        random.shuffle(&mut number);
        let mut out = Mesh {
            positions: vec![Vec3::zeros(); n],
            materials: vec!["a".into(), "b".into()],
            ..Mesh::default()
        };
        for (v, p) in mesh.positions.iter().enumerate() {
            out.positions[number[v] as usize] = p * scale;
        }
        for f in 0..mesh.faces() {
            let mut face = mesh.face(f).to_vec();
            for corner in &mut face {
                corner.vertex = number[corner.vertex as usize];
            }
            face.rotate_left(random.usize(..4));
            out.push_face(&face, 0);
        }
        (out, number)
    }

    #[test]
    fn numbers_and_first_corners_do_not_matter() {
        let mut mesh = sheet(9, 0.31);
        // A vertex of no face.
        mesh.positions.push(Vec3::repeat(7.0));
        let one = Ordered::new(&mesh);
        assert_eq!(one.mesh.faces(), mesh.faces());
        for (seed, scale) in [(1, 1.0), (2, 1.0), (3, 0.01)] {
            let (other, number) = shuffled(&mesh, scale, seed);
            let two = Ordered::new(&other);
            assert_eq!(one.mesh.corners, two.mesh.corners);
            for v in 0..mesh.positions.len() {
                assert_eq!(one.vertex[v], two.vertex[number[v] as usize]);
            }
        }
    }

    #[test]
    fn copies_at_a_seam_are_one_and_move_as_one() {
        let mesh = sheet(4, 1.0);
        let mut cut = mesh.clone();
        // The right half gets copies of the middle column.
        for f in 0..cut.faces() {
            if f % 3 == 1 {
                for corner in &mut cut.corners[4 * f..4 * f + 4] {
                    if corner.vertex % 4 == 1 {
                        corner.vertex = 16 + corner.vertex / 4;
                    }
                }
            }
        }
        for row in 0..4 {
            cut.positions.push(mesh.positions[4 * row + 1]);
        }
        let (one, two) = (Ordered::new(&mesh), Ordered::new(&cut));
        assert_eq!(one.mesh.corners, two.mesh.corners);
        assert_eq!(one.mesh.positions, two.mesh.positions);
        let n = two.mesh.positions.len();
        let shape = Shape {
            name: "a".into(),
            displacement: (0..n).map(|v| Vec3::repeat(v as f64)).collect(),
            area: vec![true; n],
            ..Shape::default()
        };
        let scattered = two.scattered(shape).displacement;
        for row in 0..4 {
            assert_eq!(scattered[16 + row], scattered[4 * row + 1]);
        }
        assert!(two.landmarks(&[19, 20]).is_err());
        assert_eq!(two.landmarks(&[19]).unwrap(), [u64::from(two.vertex[19])]);
    }
}
