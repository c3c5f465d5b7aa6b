//! Reference methods on the whole skin with the Laplacian as printed: the paper's Procedure 1, equations (10) to
//! (13), and its first solve alone, plain Laplacian least squares (Huang et al. 2011).
//!
//! Units: the mesh's. Cost: one factor of the skin per shape.

use super::influence;
use super::laplacian::Operator;
use super::mesh::{Rings, Vec3};
use super::solve::System;
use mien_workbench::fault::Fault;

/// ω of control points in equation (12); the paper leaves it open.
const WEIGHT: f64 = 10.0;
/// Steps of equation (12); the paper leaves them open.
const STEPS: usize = 100;
/// s of equation (13), in eye distances; the paper leaves it open.
const FACTOR: f64 = 30.0;
/// Rounds of Procedure 1; the paper leaves them open.
pub(super) const ROUNDS: usize = 7;

/// Displacements of all vertices after this many length-restoring rounds; `controls` are (vertex, displacement),
/// `operator` the printed one.
///
/// # Errors
/// If a system is singular.
pub(super) fn printed(
    operator: &Operator,
    rings: &Rings,
    positions: &[Vec3],
    skin: &[bool],
    controls: &[(u32, Vec3)],
    eye_distance: f64,
    rounds: usize,
) -> Result<Vec<Vec3>, Fault> {
    let system = System::new(operator, skin, controls.iter().map(|c| c.0))?;
    let spread = influence::propagate(rings, positions, controls, WEIGHT, STEPS);
    let delta = |v: usize| (spread[v].norm() * FACTOR / eye_distance).min(1.0);
    let mut d = vec![Vec3::zeros(); positions.len()];
    for &(v, displacement) in controls {
        d[v as usize] = displacement;
    }
    system.deform(operator, &mut d, |_| false, delta, rounds);
    Ok(d)
}

#[cfg(test)]
mod tests {
    use nalgebra::DMatrix;

    use super::super::mesh::{Corner, Mesh};
    use super::*;

    const SIDE: usize = 9;
    const EYES: f64 = 4.0;

    /// A rough sheet of triangles: no row of its Laplacian is near 0, so that none is exempt.
    fn rough() -> (Mesh, Vec<[usize; 3]>) {
        let mut random = fastrand::Rng::with_seed(4);
        let mut mesh = Mesh {
            materials: vec!["skin".into()],
            ..Mesh::default()
        };
        for k in 0..SIDE * SIDE {
            let [a, b, c] = [(); 3].map(|()| random.f64() - 0.5);
            let (x, y) = ((k % SIDE) as f64, (k / SIDE) as f64);
            let z = (0.7 * x).sin() * (0.6 * y).cos() + 0.6 * c;
            mesh.positions.push(Vec3::new(x + 0.2 * a, y + 0.2 * b, z));
        }
        let mut triangles = Vec::new();
        for row in 0..SIDE - 1 {
            for col in 0..SIDE - 1 {
                let v = row * SIDE + col;
                triangles.push([v, v + 1, v + SIDE + 1]);
                triangles.push([v, v + SIDE + 1, v + SIDE]);
            }
        }
        for triangle in &triangles {
            mesh.push_face(&triangle.map(|v| Corner::bare(v as u32)), 0);
        }
        (mesh, triangles)
    }

    /// Procedure 1 and equations (10) to (13) once more, from the paper: dense matrices, positions instead of displacements,
    /// angles instead of cross products, least squares by singular values instead of normal equations.
    fn from_the_paper(
        v0: &[Vec3],
        triangles: &[[usize; 3]],
        controls: &[(u32, Vec3)],
    ) -> Vec<Vec3> {
        let n = v0.len();
        let mut m = DMatrix::<f64>::zeros(n, n);
        let mut beside = vec![std::collections::BTreeSet::new(); n];
        for t in triangles {
            for k in 0..3 {
                let [a, b, c] = [t[k], t[(k + 1) % 3], t[(k + 2) % 3]];
                let omega = 0.5 / (v0[b] - v0[a]).angle(&(v0[c] - v0[a])).tan();
                m[(b, c)] += omega;
                m[(c, b)] += omega;
                m[(b, b)] -= omega;
                m[(c, c)] -= omega;
                beside[b].insert(c);
                beside[c].insert(b);
            }
        }
        let at = |x: &[Vec3]| DMatrix::from_fn(n, 3, |r, c| x[r][c]);
        let moved: std::collections::BTreeMap<usize, Vec3> =
            controls.iter().map(|&(v, d)| (v as usize, d)).collect();
        let (fixed, free): (Vec<usize>, Vec<usize>) = (0..n).partition(|v| moved.contains_key(v));
        // (12): ω of a control point 10, of others 1, by inverse length; control points keep their motion.
        let mut d: Vec<Vec3> = (0..n)
            .map(|v| moved.get(&v).copied().unwrap_or_default())
            .collect();
        for _ in 0..100 {
            let before = d.clone();
            for &v in &free {
                let weights = beside[v].iter().map(|&o| {
                    let omega = if moved.contains_key(&o) { 10.0 } else { 1.0 };
                    (o, omega / (v0[v] - v0[o]).norm())
                });
                let total: f64 = weights.clone().map(|(_, w)| w).sum();
                d[v] = weights.map(|(o, w)| before[o] * (w / total)).sum();
            }
        }
        // (13).
        let delta: Vec<f64> = d
            .iter()
            .map(|d| (d.norm() * 30.0 / EYES).min(1.0))
            .collect();
        let l0 = &m * at(v0);
        let least = l0
            .row_iter()
            .map(|row| row.norm())
            .fold(f64::INFINITY, f64::min);
        assert!(least > 0.02, "a row of {least} may be exempt");
        let of_free = m.select_columns(&free).svd(true, true);
        let there = DMatrix::from_fn(fixed.len(), 3, |r, c| (v0[fixed[r]] + moved[&fixed[r]])[c]);
        let given = m.select_columns(&fixed) * there;
        let mut v = v0.to_vec();
        let solve = |l: &DMatrix<f64>, v: &mut Vec<Vec3>| {
            let found = of_free.solve(&(l - &given), 1e-12).expect("both factors");
            for (r, &k) in free.iter().enumerate() {
                v[k] = Vec3::new(found[(r, 0)], found[(r, 1)], found[(r, 2)]);
            }
            for (k, d) in &moved {
                v[*k] = v0[*k] + d;
            }
        };
        solve(&l0, &mut v);
        for _ in 0..7 {
            let now = &m * at(&v);
            let wanted = DMatrix::from_fn(n, 3, |r, c| {
                let restored = l0.row(r).norm() / now.row(r).norm() * now[(r, c)];
                delta[r] * restored + (1.0 - delta[r]) * l0[(r, c)]
            });
            solve(&wanted, &mut v);
        }
        v.iter().zip(v0).map(|(v, v0)| v - v0).collect()
    }

    #[test]
    fn procedure_1_is_the_papers_by_a_second_implementation() {
        let (mesh, triangles) = rough();
        let count = mesh.positions.len();
        let operator = Operator::new(&mesh, |_| false, |_| 1.0).printed();
        let controls = [
            (0, Vec3::zeros()),
            (SIDE as u32 - 1, Vec3::zeros()),
            ((SIDE * (SIDE - 1)) as u32, Vec3::zeros()),
            (count as u32 - 1, Vec3::zeros()),
            (count as u32 / 2, Vec3::new(0.3, -0.2, 0.9)),
            (count as u32 / 2 + 2, Vec3::new(-0.1, 0.4, 0.2)),
        ];
        let skin = vec![true; count];
        let rings = mesh.rings();
        let found = printed(
            &operator,
            &rings,
            &mesh.positions,
            &skin,
            &controls,
            EYES,
            ROUNDS,
        );
        let found = found.expect("a regular system");
        let expected = from_the_paper(&mesh.positions, &triangles, &controls);
        let size = expected.iter().map(Vec3::norm).fold(0.0, f64::max);
        let apart = found.iter().zip(&expected).map(|(a, b)| (a - b).norm());
        let furthest = apart.fold(0.0, f64::max);
        println!("{furthest:.2e} apart of motions up to {size:.2}");
        assert!(size > 0.9 && furthest < 1e-7 * size, "{furthest}");
    }
}
