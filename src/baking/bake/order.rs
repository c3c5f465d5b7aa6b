//! One mesh, whichever file a head comes in: what is baked does not depend on how its vertices are split and numbered.
//!
//! OBJ keeps quads and one vertex a place; glTF has triangles, copies of a vertex at every seam, single precision and another
//! order. Which of two equal diagonals cuts a quad would fall out differently. So every head is first brought to one form:
//! positions in single precision, copies sewn, triangles paired to quads as in [`super::weld`], vertices numbered by place,
//! faces by their vertices. It is solved in that order, and the shapes are handed back in the order of the file.
//!
//! Place is compared on a grid of a thousandth of the head, so that another rounding (the same head in metres and in
//! centimetres) numbers alike; vertices in one cell by their exact place, vertices in one place by what surrounds them.
//!
//! Units: the mesh's. Cost: sorting vertices and faces. Limits: texture, normals and materials stay with the file.

use std::cmp::Ordering;
use std::collections::HashMap;

use super::head::beyond;
use super::mesh::{Corner, Mesh, Vec3, extent_of};
use super::morphs::single;
use super::shape::Shape;
use super::weld::{faces, recut, sewn};
use mien_workbench::fault::Fault;

/// Cells of the grid along the head's longest side.
const CELLS: f64 = 1000.0;

/// A head's geometry in the one order, and the way back to the file's.
pub struct Ordered {
    /// What is solved.
    pub mesh: Mesh,
    /// Vertex of that mesh for each one of the file's.
    vertex: Vec<u32>,
}

impl Ordered {
    /// Of a mesh as its file has it.
    pub fn new(source: &Mesh) -> Self {
        // Adding 0 makes one zero of both.
        let rounded = source.positions.iter().map(|p| single(p).map(|x| x + 0.0));
        let rounded: Vec<[f32; 3]> = rounded.collect();
        // As glTF has them: by material.
        let mut by_material: Vec<usize> = (0..source.faces()).collect();
        by_material.sort_by_key(|&f| source.face_material[f]);
        let cut = by_material.into_iter().flat_map(|f| source.solid(f));
        let mut triangles: Vec<[u32; 3]> = cut.map(|t| t.map(|c| c.vertex)).collect();
        let same = sewn(&rounded, &triangles, &vec![0; triangles.len()]);
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
            // A quad stays cut between its first and its third corner.
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

    /// Vertex of the ordered mesh for each one of the file's.
    pub fn vertex(&self) -> &[u32] {
        &self.vertex
    }

    /// The file's landmarks as vertices of the ordered mesh.
    ///
    /// # Errors
    /// If one is no vertex of the file.
    pub fn landmarks(&self, numbers: &[u64]) -> Result<Vec<u64>, Fault> {
        let ordered = numbers.iter().enumerate().map(|(landmark, &vertex)| {
            let found = self.vertex.get(vertex as usize);
            let found = found.ok_or_else(|| beyond(landmark, vertex, self.vertex.len()))?;
            Ok(u64::from(*found))
        });
        ordered.collect()
    }

    /// A shape of the ordered mesh as one of the file's.
    pub fn scattered(&self, shape: Shape) -> Shape {
        let all = || self.vertex.iter().map(|&v| v as usize);
        Shape {
            displacement: all().map(|v| shape.displacement[v]).collect(),
            area: all().map(|v| shape.area[v]).collect(),
            ..shape
        }
    }
}

/// Vertices by place, those without a face last and in their own order; `same` names the first of several copies.
fn order(positions: &[Vec3], faces: &[Vec<u32>], same: &[u32]) -> Vec<u32> {
    let mut used = vec![false; positions.len()];
    for &v in faces.iter().flatten() {
        used[v as usize] = true;
    }
    let all = 0..positions.len() as u32;
    let (mut order, loose): (Vec<u32>, Vec<u32>) = all.partition(|&v| used[v as usize]);
    let (low, high) = extent_of(order.iter().map(|&v| &positions[v as usize]));
    let cell = ((high - low).max() / CELLS).max(f64::MIN_POSITIVE);
    // From bottom to top: halves of a head stay together, and so does memory.
    let exact = |v: u32| <[f64; 3]>::from(positions[v as usize].yxz());
    let key = |v: u32| exact(v).map(|x| (x / cell).round() as i64);
    let place = |v: &u32| (key(*v), exact(*v));
    order.sort_by(|a, b| place(a).partial_cmp(&place(b)).unwrap_or(Ordering::Equal));
    // Closed lips and lids: two vertices in one place, told apart by the faces around them.
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
