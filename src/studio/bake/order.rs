//! One mesh, whichever file a head comes in: what is baked does not depend on how its vertices are split and numbered.
//!
//! OBJ keeps quads and one vertex a place; glTF has triangles, copies of a vertex at every seam, single precision and another
//! order. Some choices along the way (which of two equal diagonals, which triangle is smoothed first) would fall out
//! differently, and what is smoothed until nothing is inverted would show it. So every head is first brought to one form:
//! positions in single precision, copies sewn, triangles paired to quads as in [`super::weld`], vertices numbered by place,
//! faces by their vertices. It is solved in that order, and the shapes are handed back in the order of the file.
//!
//! Place is compared on a grid of a thousandth of the head, so that another rounding (the same head in metres and in
//! centimetres) numbers alike; vertices in one cell by their exact place, vertices in one place by what surrounds them.
//!
//! Units: the mesh's. Cost: sorting vertices and faces. Limits: texture, normals and materials stay with the file.

use super::head::HeadError;
use super::mesh::{Corner, Mesh, Vec3, extent_of};
use super::shape::Shape;
use super::weld::{faces, sewn};

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
    #[must_use]
    pub fn new(source: &Mesh) -> Self {
        let single: Vec<[f32; 3]> = source
            .positions
            .iter()
            // Adding 0 makes one zero of both.
            .map(|p| [p.x as f32 + 0.0, p.y as f32 + 0.0, p.z as f32 + 0.0])
            .collect();
        // As glTF has them: by material.
        let mut triangles = Vec::with_capacity(2 * source.faces());
        let mut by_material: Vec<usize> = (0..source.faces()).collect();
        by_material.sort_by_key(|&f| source.face_material[f]);
        for f in by_material {
            let face = source.face(f);
            let cut = source.split(f);
            let cut = cut.iter().map(|t| t.map(|k| face[k].vertex));
            triangles.extend(cut.filter(|t| t[0] != t[1] && t[1] != t[2] && t[0] != t[2]));
        }
        let same = sewn(&single, &triangles, &vec![0; triangles.len()]);
        for t in &mut triangles {
            *t = t.map(|v| same[v as usize]);
        }
        let positions: Vec<Vec3> = single
            .iter()
            .map(|p| Vec3::from(p.map(f64::from)))
            .collect();
        let mut faces = faces(&positions, &triangles);
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
            let corner = |&vertex: &u32| Corner {
                vertex,
                uv: None,
                normal: None,
            };
            mesh.push_face(&face.iter().map(corner).collect::<Vec<_>>(), 0);
        }
        let vertex = same.iter().map(|&v| vertex[v as usize]).collect();
        Self { mesh, vertex }
    }

    /// Vertex of the ordered mesh for each one of the file's.
    #[must_use]
    pub fn vertex(&self) -> &[u32] {
        &self.vertex
    }

    /// The file's landmarks as vertices of the ordered mesh.
    ///
    /// # Errors
    /// If one is no vertex of the file.
    pub fn landmarks(&self, numbers: &[u64]) -> Result<Vec<u64>, HeadError> {
        let vertices = self.vertex.len();
        let ordered = numbers.iter().enumerate().map(|(landmark, &vertex)| {
            let found = usize::try_from(vertex)
                .ok()
                .and_then(|v| self.vertex.get(v));
            found.map(|&v| u64::from(v)).ok_or(HeadError::Range {
                landmark,
                vertex,
                vertices,
            })
        });
        ordered.collect()
    }

    /// A shape of the ordered mesh as one of the file's.
    #[must_use]
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
    let placed = positions.iter().zip(&used).filter(|(_, used)| **used);
    let (low, high) = extent_of(placed.map(|(p, _)| p));
    let cell = ((high - low).max() / CELLS).max(f64::MIN_POSITIVE);
    let key = |v: u32| {
        let p = positions[v as usize];
        // From bottom to top: halves of a head stay together, and so does memory.
        [p.y, p.x, p.z].map(|x| (x / cell).round() as i64)
    };
    let mut order: Vec<([i64; 3], u32)> = (0..positions.len() as u32)
        .filter(|&v| used[v as usize])
        .map(|v| (key(v), v))
        .collect();
    let exact = |v: u32| {
        let p = positions[v as usize];
        [p.y, p.x, p.z]
    };
    let by_place = |a: &([i64; 3], u32), b: &([i64; 3], u32)| {
        let (p, q) = (exact(a.1), exact(b.1));
        let places = p.iter().zip(&q).map(|(p, q)| p.total_cmp(q));
        a.0.cmp(&b.0)
            .then(places.fold(std::cmp::Ordering::Equal, std::cmp::Ordering::then))
    };
    order.sort_unstable_by(by_place);
    // Closed lips and lids: two vertices in one place, told apart by the faces around them.
    let mut shared: Vec<usize> = Vec::new();
    for k in 1..order.len() {
        if exact(order[k - 1].1) == exact(order[k].1) {
            shared.extend([k - 1, k]);
        }
    }
    shared.dedup();
    if !shared.is_empty() {
        let surroundings = surroundings(positions, faces, &order, &shared, &key);
        let mut k = 0;
        while k < shared.len() {
            let mut end = k + 1;
            while end < shared.len()
                && shared[end] == shared[end - 1] + 1
                && exact(order[shared[end]].1) == exact(order[shared[k]].1)
            {
                end += 1;
            }
            let group = &mut order[shared[k]..=shared[end - 1]];
            group.sort_by(|a, b| surroundings[&a.1].cmp(&surroundings[&b.1]));
            k = end;
        }
    }
    let loose = (0..positions.len() as u32).filter(|&v| !used[v as usize] && same[v as usize] == v);
    order.into_iter().map(|(_, v)| v).chain(loose).collect()
}

/// Cells around some vertices, sorted.
fn surroundings(
    positions: &[Vec3],
    faces: &[Vec<u32>],
    order: &[([i64; 3], u32)],
    some: &[usize],
    key: &impl Fn(u32) -> [i64; 3],
) -> std::collections::HashMap<u32, Vec<[i64; 3]>> {
    let mut wanted = vec![false; positions.len()];
    for &k in some {
        wanted[order[k].1 as usize] = true;
    }
    let mut found: std::collections::HashMap<u32, Vec<[i64; 3]>> = std::collections::HashMap::new();
    for face in faces {
        for &v in face.iter().filter(|v| wanted[**v as usize]) {
            let others = face.iter().filter(|&&o| o != v).map(|&o| key(o));
            found.entry(v).or_default().extend(others);
        }
    }
    for cells in found.values_mut() {
        cells.sort_unstable();
    }
    found
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
            unit: None,
            upon: None,
            misses: None,
            displacement: (0..n).map(|v| Vec3::repeat(v as f64)).collect(),
            area: vec![true; n],
            unknowns: 0,
            milliseconds: 0.0,
        };
        let scattered = two.scattered(shape).displacement;
        for row in 0..4 {
            assert_eq!(scattered[16 + row], scattered[4 * row + 1]);
        }
        assert!(two.landmarks(&[19, 20]).is_err());
        assert_eq!(two.landmarks(&[19]).unwrap(), [u64::from(two.vertex[19])]);
    }
}
