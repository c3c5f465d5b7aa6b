//! The area of influence (AOI): how far and how strongly moved control points act, paper section 4, equations (12) and (13).
//!
//! Two forms of equation (12), where |d_v| is called `u`:
//! * [`propagate`]: the equation as printed, a number of smoothing steps in which control points weigh more. Its reach
//!   is counted in edges, so a finer mesh has a smaller area.
//! * [`Field`]: the same run to its end with a decay per *length*: `(L + A/λ²) u = 0`, `A` the vertex areas, `u = |d|` on a
//!   small disc around every control point. Its reach is in units of the face, so that the mesh does not matter; one
//!   factor serves all shapes. Control points that stay hold `u = 0` and stop the field.
//!
//! The area is `{u > ε}`; the factor of equation (13) is `δ = min(u s, 1)`.
//!
//! Units: `u`, λ, ε and the disc's radius are lengths in the mesh's unit; s is 1/length.
//! Memory: one factor (about 100 numbers per vertex). Limits: discs are flood-filled along edges within a straight-line
//! radius, so they do not jump to the other lip, but on very coarse meshes they are single vertices.

use rayon::prelude::*;

use super::laplacian::Operator;
use super::mesh::{Rings, Vec3};
use super::sparse::Factor;
use mien_workbench::fault::Fault;

/// Equation (12) as printed: `steps` rounds; `controls` are (vertex, displacement), `weight` is ω of a control point (others
/// have 1). Returns d per vertex. Vertices without neighbours keep 0.
pub fn propagate(
    rings: &Rings,
    positions: &[Vec3],
    controls: &[(u32, Vec3)],
    weight: f64,
    steps: usize,
) -> Vec<Vec3> {
    let mut omega = vec![1.0; positions.len()];
    let mut d = vec![Vec3::zeros(); positions.len()];
    for &(v, displacement) in controls {
        omega[v as usize] = weight;
        d[v as usize] = displacement;
    }
    let fixed: Vec<bool> = omega.iter().map(|&w| w != 1.0).collect();
    let mut next = d.clone();
    for _ in 0..steps {
        for v in 0..positions.len() {
            if fixed[v] {
                continue;
            }
            let (mut sum, mut total) = (Vec3::zeros(), 0.0);
            for o in rings.members(v).iter().map(|&o| o as usize) {
                let length = (positions[v] - positions[o]).norm();
                if length > 0.0 {
                    sum += d[o] * (omega[o] / length);
                    total += omega[o] / length;
                }
            }
            if total > 0.0 {
                next[v] = sum / total;
            }
        }
        std::mem::swap(&mut d, &mut next);
    }
    d
}

/// The screened field of one set of control points, factored once for all shapes.
pub struct Field {
    /// Which control each vertex belongs to, `u32::MAX` for the free ones.
    owner: Vec<u32>,
    free: Vec<u32>,
    factor: Factor,
}

impl Field {
    /// Prepares the field on the `active` vertices, those in reach of a control.
    ///
    /// # Errors
    /// If the screened operator cannot be factored (it can for λ > 0 and vertices with area).
    pub fn new(
        operator: &Operator,
        rings: &Rings,
        positions: &[Vec3],
        active: &[bool],
        controls: &[u32],
        lambda: f64,
        radius: f64,
    ) -> Result<Self, Fault> {
        let mut owner = vec![u32::MAX; positions.len()];
        let mut distance = vec![f64::INFINITY; positions.len()];
        for (k, &c) in controls.iter().enumerate() {
            for v in rings.disc(positions, c, radius) {
                // Boundaries between neighbouring discs lie halfway.
                let d = (positions[v as usize] - positions[c as usize]).norm();
                if d < distance[v as usize] {
                    distance[v as usize] = d;
                    owner[v as usize] = k as u32;
                }
            }
        }
        // The order computed for the energy is good here as well.
        let free = operator.unknowns(|v| active[v] && owner[v] == u32::MAX);
        let screen = |k: usize| operator.area[free.rows[k] as usize] / (lambda * lambda);
        let factor = Factor::new(&operator.positive, &free, screen)?;
        Ok(Self {
            owner,
            free: free.rows,
            factor,
        })
    }

    /// `u` per vertex for several shapes at once; `lengths[s][k]` is |d| of control `k` in shape `s`.
    pub fn spread(&self, lengths: &[Vec<f64>]) -> Vec<Vec<f64>> {
        // As many columns side by side as fill the vector registers, in parallel.
        const SIDE_BY_SIDE: usize = 8;
        lengths
            .par_chunks(SIDE_BY_SIDE)
            .flat_map_iter(|some| {
                let length = |v: usize, s: usize| Some(*some.get(s)?.get(self.owner[v] as usize)?);
                let lengths = |v| std::array::from_fn(|s| length(v, s).unwrap_or(0.0));
                let mut x = self.factor.pulled::<SIDE_BY_SIDE>(lengths);
                self.factor.solve(&mut x);
                let spread = |(s, shape): (usize, &Vec<f64>)| {
                    let given = self.owner.iter().map(|&o| shape.get(o as usize));
                    let mut u: Vec<f64> = given.map(|u| u.copied().unwrap_or(0.0)).collect();
                    for (&v, x) in self.free.iter().zip(&x) {
                        u[v as usize] = x[s].max(0.0);
                    }
                    u
                };
                some.iter().enumerate().map(spread).collect::<Vec<_>>()
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::super::mesh::Mesh;
    use super::super::mesh::tests::sheet;
    use super::*;

    fn field(mesh: &Mesh, controls: &[u32], lambda: f64, radius: f64) -> Field {
        let op = Operator::new(mesh, |_| false, |_| 1.0);
        let active = vec![true; mesh.positions.len()];
        Field::new(
            &op,
            &mesh.rings(),
            &mesh.positions,
            &active,
            controls,
            lambda,
            radius,
        )
        .unwrap()
    }

    #[test]
    fn the_field_never_exceeds_the_displacement_and_falls_with_distance() {
        let mesh = sheet(41, 0.1);
        let middle = 20 * 41 + 20;
        let u = &field(&mesh, &[middle], 0.5, 0.15).spread(&[vec![0.7]])[0];
        assert!(u.iter().all(|&u| (0.0..=0.7 + 1e-12).contains(&u)));
        let at = |col: usize| u[20 * 41 + col];
        assert!(at(20) > at(24) && at(24) > at(30) && at(30) > at(38));
        assert!(at(38) < 0.05);
    }

    #[test]
    fn a_control_that_stays_stops_the_field() {
        let mesh = sheet(41, 0.1);
        let column: Vec<u32> = (0..41).map(|row| row * 41 + 28).collect();
        let controls: Vec<u32> = [20 * 41 + 20].into_iter().chain(column).collect();
        let mut lengths = vec![0.0; controls.len()];
        lengths[0] = 0.7;
        let u = &field(&mesh, &controls, 0.5, 0.05).spread(&[lengths])[0];
        assert!(u[20 * 41 + 35] < 1e-12 && u[20 * 41 + 5] > 1e-3);
    }

    #[test]
    fn a_finer_mesh_has_the_same_field_where_single_steps_do_not() {
        let (coarse, fine) = (sheet(41, 0.1), sheet(81, 0.05));
        let (c, f) = (20 * 41 + 20, 40 * 81 + 40);
        let a = &field(&coarse, &[c], 0.5, 0.25).spread(&[vec![1.0]])[0];
        let b = &field(&fine, &[f], 0.5, 0.25).spread(&[vec![1.0]])[0];
        let spread = |mesh: &Mesh, v: u32| {
            propagate(&mesh.rings(), &mesh.positions, &[(v, Vec3::x())], 10.0, 60)
        };
        let (pa, pb) = (spread(&coarse, c), spread(&fine, f));
        let (mut field_sum, mut steps_sum) = (0.0_f64, 0.0_f64);
        for row in 0..41 {
            for col in 0..41 {
                let (i, j) = (row * 41 + col, 2 * row * 81 + 2 * col);
                field_sum += (a[i] - b[j]).powi(2);
                steps_sum += (pa[i] - pb[j]).norm_squared();
            }
        }
        let (field_rms, steps_rms) = (field_sum.sqrt() / 41.0, steps_sum.sqrt() / 41.0);
        assert!(field_rms < 0.02, "{field_rms}");
        assert!(
            steps_rms > 2.0 * field_rms,
            "{steps_rms} against {field_rms}"
        );
    }

    #[test]
    fn equation_12_with_equal_weights_is_the_mean_of_the_neighbours() {
        let mut mesh = sheet(3, 1.0);
        for p in &mut mesh.positions {
            p.z = 0.0;
        }
        let d = propagate(&mesh.rings(), &mesh.positions, &[(0, Vec3::x())], 4.0, 1);
        // Vertex 1 sees the control (ω = 4) and two others (ω = 1), all one unit away.
        assert!((d[1].x - 4.0 / 6.0).abs() < 1e-12);
        assert_eq!(d[4], Vec3::zeros());
        assert_eq!(d[0], Vec3::x());
    }
}
