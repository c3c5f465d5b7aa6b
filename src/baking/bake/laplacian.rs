//! The mesh's Laplacian operator with cotangent weights, paper section 4, equations (10) and (11).
//!
//! `l_v = Σ ω_i (v_i − v)`, `ω_i = ½ (cot α_i + cot β_i)`. Stored here is `L = −M`, so that `L` is positive semidefinite:
//! `(L x)_v = Σ ω_i (x_v − x_i)`, which is the Laplacian times the vertex's area A.
//!
//! The energy is `Σ ρ/A |L d|²`, an approximation to the integral of `ρ |Δd|²` over the surface: how finely the mesh is
//! sampled cancels out. The stiffness ρ is given by place. Without it (`Σ |L d|²`, as printed) the sampling itself is the
//! stiffness, which changes with every remeshing.
//!
//! Units: cotangents are pure numbers, so `L x` has the unit of `x`. A face of four corners counts with half of each of
//! its two splits, so that no diagonal is preferred and a symmetric mesh has a symmetric operator.
//! Cost: linear. Degenerate triangles (height below 1e-6 of their longest edge) carry no weight; obtuse ones carry
//! negative weight, which the deformation tolerates and the influence field does not ([`Operator::positive`]).
//! Limits: a vertex that no face with area uses has an empty row: it cannot be solved for and stays where it is.

use super::mesh::{Mesh, Vec3};
use super::sparse::{Rows, Unknowns, summed};

/// Height below this part of the longest edge makes a triangle degenerate: its cotangents would exceed a million.
const FLAT: f64 = 1e-6;
/// Smallest weight of an edge in [`Operator::positive`]: small against the usual 0.3 to 2, large against rounding.
const LEAST_WEIGHT: f64 = 1e-3;

/// Operators of one mesh in its neutral shape.
#[derive(Clone)]
pub struct Operator {
    /// `L = −M`, cotangent weights of any sign.
    pub cotangent: Rows,
    /// [`Self::cotangent`] with every edge weight at least 0.001, for fields that must obey a maximum principle; rows in the order of elimination.
    pub positive: Rows,
    /// Weight ρ/A of each row in the energy; 0 for vertices without area.
    pub weight: Vec<f64>,
    /// `Lᵀ diag(ρ/A) L`, the matrix of the energy; rows in the order of elimination.
    pub energy: Rows,
    /// All vertices, in an order that leaves few entries in a factor of the energy.
    pub elimination: Vec<u32>,
    /// A third of the area of the triangles at each vertex, squared units of the mesh.
    pub area: Vec<f64>,
    /// `L V0`, of the neutral shape itself.
    pub neutral: Vec<Vec3>,
}

/// Cotangents at the three corners and the area; `None` if degenerate.
fn cotangents(p: [Vec3; 3]) -> Option<([f64; 3], f64)> {
    let doubled = (p[1] - p[0]).cross(&(p[2] - p[0])).norm();
    let edges = (0..3).map(|k| (p[(k + 1) % 3] - p[k]).norm_squared());
    let longest = edges.fold(0.0, f64::max);
    if doubled.is_nan() || doubled <= FLAT * longest {
        return None;
    }
    let at = |k: usize| {
        let (a, b) = (p[(k + 1) % 3] - p[k], p[(k + 2) % 3] - p[k]);
        a.dot(&b) / doubled
    };
    Some(([at(0), at(1), at(2)], doubled / 2.0))
}

/// Half-edge weights (a, b, ω) with a < b of all faces that do not pass `skip`, and the area at each vertex.
fn halves(mesh: &Mesh, skip: impl Fn(usize) -> bool) -> (Vec<(u32, u32, f64)>, Vec<f64>) {
    let mut halves = Vec::with_capacity(mesh.corners.len() * 3);
    let mut area = vec![0.0; mesh.positions.len()];
    let mut add = |v: [u32; 3], share: f64| {
        let Some((cot, size)) = cotangents(v.map(|v| mesh.positions[v as usize])) else {
            return;
        };
        for k in 0..3 {
            let (a, b) = (v[(k + 1) % 3], v[(k + 2) % 3]);
            if a != b {
                halves.push((a.min(b), a.max(b), 0.5 * share * cot[k]));
            }
            area[v[k] as usize] += share * size / 3.0;
        }
    };
    for f in (0..mesh.faces()).filter(|&f| !skip(f)) {
        let face = mesh.face(f);
        let (cut, share) = match face.len() {
            4 => (vec![[0, 1, 2], [0, 2, 3], [0, 1, 3], [1, 2, 3]], 0.5),
            _ => (mesh.split(f), 1.0),
        };
        for t in cut {
            add(t.map(|k: usize| face[k].vertex), share);
        }
    }
    (halves, area)
}

impl Operator {
    /// Builds the operators for the positions of `mesh`. Faces that pass `skip` tie nothing together; `stiff` is ρ of a
    /// vertex, a pure number.
    pub fn new(mesh: &Mesh, skip: impl Fn(usize) -> bool, stiff: impl Fn(usize) -> f64) -> Self {
        let n = mesh.positions.len();
        let (mut halves, area) = halves(mesh, skip);
        halves.sort_unstable_by_key(|&(a, b, _)| (a, b));
        let edges: Vec<_> = summed(&halves).collect();
        let entries = edges.iter();
        let entries = entries.flat_map(|&(a, b, w)| [(a, a, w), (b, b, w), (a, b, -w), (b, a, -w)]);
        let cotangent = Rows::from_triplets(n, entries.collect());
        // Normalised by the mean area, so that numbers stay near 1 in any unit of the mesh.
        let mean = area.iter().sum::<f64>() / n.max(1) as f64;
        let solid = |v: usize| Some(area[v]).filter(|area| *area > 0.0);
        let weight = |v: usize| solid(v).map_or(0.0, |area| stiff(v) * mean / area);
        let weight: Vec<f64> = (0..n).map(weight).collect();
        let energy = cotangent.squared(&weight);
        let elimination = energy.elimination();
        Self {
            positive: cotangent.positive(LEAST_WEIGHT).arranged(&elimination),
            neutral: (0..n)
                .map(|v| cotangent.row_times(v, &mesh.positions))
                .collect(),
            energy: energy.arranged(&elimination),
            elimination,
            weight,
            cotangent,
            area,
        }
    }

    /// Operators of the same mesh with the energy as printed, `Σ |L d|²`.
    pub fn printed(&self) -> Self {
        let weight = vec![1.0; self.area.len()];
        Self {
            energy: self.cotangent.squared(&weight).arranged(&self.elimination),
            weight,
            ..self.clone()
        }
    }

    /// Its energy with one stiffness everywhere.
    pub fn even(&self) -> Rows {
        let mean = self.area.iter().sum::<f64>() / self.area.len().max(1) as f64;
        let weight = |&area: &f64| if area > 0.0 { mean / area } else { 0.0 };
        let weight: Vec<f64> = self.area.iter().map(weight).collect();
        self.cotangent.squared(&weight).arranged(&self.elimination)
    }

    /// The vertices with area that pass, in the order in which they are eliminated.
    pub fn unknowns(&self, passes: impl Fn(usize) -> bool) -> Unknowns {
        Unknowns::new(&self.elimination, |v| self.area[v] > 0.0 && passes(v))
    }
}

#[cfg(test)]
mod tests {
    use super::super::mesh::Corner;
    use super::super::mesh::tests::sheet;
    use super::*;

    /// `L x` for every vertex.
    fn applied(op: &Operator, x: &[Vec3]) -> Vec<Vec3> {
        let rows = 0..op.area.len();
        rows.map(|r| op.cotangent.row_times(r, x)).collect()
    }

    fn operator(mesh: &Mesh) -> Operator {
        Operator::new(mesh, |_| false, |_| 1.0)
    }

    #[test]
    fn constants_are_in_the_null_space_and_translation_changes_nothing() {
        let mesh = sheet(9, 0.4);
        let op = operator(&mesh);
        let ones = vec![Vec3::new(1.0, -2.0, 3.0); mesh.positions.len()];
        assert!(applied(&op, &ones).iter().all(|l| l.norm() < 1e-12));
        let mut moved = mesh.clone();
        for p in &mut moved.positions {
            *p += Vec3::new(5.0, -7.0, 2.0);
        }
        let (here, there) = (
            applied(&op, &mesh.positions),
            applied(&operator(&moved), &moved.positions),
        );
        for (a, b) in here.iter().zip(&there) {
            assert!((a - b).norm() < 1e-10);
        }
    }

    #[test]
    fn linear_functions_are_harmonic_inside_a_flat_sheet() {
        let mut mesh = sheet(8, 0.5);
        for p in &mut mesh.positions {
            // Uneven but flat.
            *p = Vec3::new(p.x + 0.1 * p.y.sin(), p.y + 0.07 * (2.0 * p.x).cos(), 0.0);
        }
        let border = mesh.border();
        let l = applied(&operator(&mesh), &mesh.positions);
        for v in 0..mesh.positions.len() {
            assert!(border[v] || l[v].norm() < 1e-12, "{v}: {}", l[v]);
        }
    }

    #[test]
    fn areas_sum_to_the_sheet_and_bad_triangles_add_nothing() {
        let mut mesh = sheet(5, 1.0);
        for p in &mut mesh.positions {
            p.z = 0.0;
        }
        let before = operator(&mesh);
        assert!((before.area.iter().sum::<f64>() - 16.0).abs() < 1e-12);
        // A sliver along one row, and a face that names a vertex twice.
        mesh.push_face(&[0, 1, 2].map(Corner::bare), 0);
        mesh.push_face(&[0, 0, 7].map(Corner::bare), 0);
        let after = operator(&mesh);
        assert!((after.area.iter().sum::<f64>() - 16.0).abs() < 1e-12);
        for v in 0..mesh.positions.len() {
            let (a, b) = (
                before.cotangent.row_times(v, &mesh.positions),
                after.cotangent.row_times(v, &mesh.positions),
            );
            assert!((a - b).norm() < 1e-12);
        }
    }
}
