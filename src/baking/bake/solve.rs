//! Deformation of a mesh by control points: AOI-constrained Laplacian editing, paper section 4, Procedure 1.
//!
//! Unknown is the displacement `d`: `M V0 = L0`, so `L = M V` is `M d = L − L0`, the same system better conditioned.
//! One shape minimises `Σ ρ/A |L d − (L_t − L0)|²` over the vertices of its area of influence; control points have
//! exactly their displacement, everything outside the area exactly 0. The paper's δ alone would not fix the outside:
//! δ = 0 preserves a Laplacian, not a position. Only positions are fixed and two rings of equations reach over the
//! edge, so the edge stays smooth. Then Procedure 1: lengths of the Laplacian rows are restored where δ > 0 and the
//! system is solved again with the same factor.
//!
//! The stiffness ρ grows with the distance from lids and lips ([`stiffness`]): skin there is thin and folds, cheeks
//! and forehead move in one sheet. Divided by the vertex's area A it makes the result the same on any sampling of the
//! surface; the energy as printed (ρ/A = 1) treats sampling density as stiffness and matches sculpted shapes less
//! closely.
//!
//! One factor serves shapes with different control points: an unknown vertex may be pinned by a force that moves it
//! to its given displacement.
//!
//! Units: the mesh's. Memory: the factor of the largest area, one per thread. Cost: about 10 ms for 4,400 unknowns.
//! Degenerate cases: rows whose Laplacian vanishes in the neutral or the deformed shape keep their direction from the
//! neutral one; an area without unknowns returns the controls alone.
//! Limits: rotation of details is restored only as far as the rounds do; large rotations need more control points.

use std::cell::Cell;

use nalgebra::{DMatrix, Matrix3xX};

use super::laplacian::Operator;
use super::mesh::Vec3;
use super::sparse::{Factor, Unknowns};
use mien_workbench::fault::Fault;

/// Stiffness is this power of the distance from lids and lips plus [`THIN`]; both were fitted to sculpted shapes,
/// with a wide valley of equally good pairs.
const STIFFENING: i32 = 3;
/// Distance added in the stiffness, in inner-eye-corner distances.
const THIN: f64 = 0.6;

/// Stiffness ρ of the skin, a pure number, at a distance from the nearest landmark of a lid or lip (inner-eye-corner
/// distances).
pub fn stiffness(distance: f64) -> f64 {
    (distance + THIN).powi(STIFFENING)
}

/// Length, as part of the neutral's mean, below which a row keeps its direction.
const FLAT_ROW: f64 = 1e-3;

/// λ of the influence field, in inner-eye-corner distances.
pub const REACH: f64 = 0.41;
/// Radius of the disc around a control on which the field is given, in inner-eye-corner distances.
pub const DISC: f64 = 0.11;
/// The AOI ends where the influence falls to this, in inner-eye-corner distances: 0.05 mm. Five times as much saves a quarter of
/// the time of a head, but shapes are .02 further from sculpted ones (`tests/it/bakes_local_shapes.rs`).
pub const EDGE: f64 = 0.0014;
/// δ reaches 1 at this influence, in inner-eye-corner distances (1/s).
pub const FULL: f64 = 0.14;
/// Rounds of Procedure 1 after the first solve.
pub const ROUNDS: usize = 1;

thread_local! {
    /// Target rows of a right-hand side, reused on each thread.
    static WANTED: Cell<Vec<Vec3>> = const { Cell::new(Vec::new()) };
}

/// The factored system of one area of influence, for all shapes with the same area and control vertices.
pub struct System {
    unknowns: Unknowns,
    /// The unknown vertices, ascending, so that neighbours are close in memory.
    free: Vec<u32>,
    factor: Factor,
    /// Rows of the operator with an unknown.
    rows: Vec<u32>,
    /// Unknown vertices that may be pinned.
    pins: Vec<u32>,
}

/// The pinned vertices of one shape: positions among the unknowns, given displacements, response of every unknown to
/// a unit force at each (four side by side), and the forces.
struct Pinned {
    places: Vec<usize>,
    given: Matrix3xX<f64>,
    forced: Vec<Vec<[f64; 4]>>,
    forces: DMatrix<f64>,
}

impl System {
    /// `area` marks the vertices that may move, `given` lists those with given displacements (in the area or not).
    ///
    /// # Errors
    /// If the system is singular, which a part without a held vertex or control would be.
    pub fn new(
        operator: &Operator,
        area: &[bool],
        given: impl IntoIterator<Item = u32>,
    ) -> Result<Self, Fault> {
        let mut unknown = area.to_vec();
        for v in given {
            unknown[v as usize] = false;
        }
        let unknowns = operator.unknowns(|v| unknown[v]);
        let mut free = unknowns.rows.clone();
        free.sort_unstable();
        let mut seen = vec![false; unknown.len()];
        let mut rows = Vec::with_capacity(free.len() * 5 / 4);
        for &v in &free {
            let row = operator.cotangent.row(v as usize).map(|(c, _)| c);
            rows.extend(row.filter(|&c| !std::mem::replace(&mut seen[c], true)));
        }
        Ok(Self {
            factor: Factor::new(&operator.energy, &unknowns, |_| 0.0)?,
            rows: rows.into_iter().map(|c| c as u32).collect(),
            unknowns,
            free,
            pins: Vec::new(),
        })
    }

    /// The system with unknown vertices that may be pinned.
    pub(super) fn with_pins(mut self, pins: impl Iterator<Item = u32>) -> Self {
        for v in pins.filter(|&v| self.unknowns.place(v as usize).is_some()) {
            // On a coarse mesh two pins may be one vertex.
            if !self.pins.contains(&v) {
                self.pins.push(v);
            }
        }
        self
    }

    /// The unknowns that `is_pinned` marks, pinned to `d`.
    fn pinned(&self, d: &[Vec3], is_pinned: impl Fn(u32) -> bool) -> Option<Pinned> {
        let which = self.pins.iter().copied().filter(|&v| is_pinned(v));
        let which = which.filter_map(|v| Some((self.unknowns.place(v as usize)?, d[v as usize])));
        let (places, given): (Vec<usize>, Vec<Vec3>) = which.unzip();
        if places.is_empty() {
            return None;
        }
        let forced = places.chunks(4).map(|some| {
            let mut forced = vec![[0.0; 4]; self.free.len()];
            for (k, &at) in some.iter().enumerate() {
                forced[at][k] = 1.0;
            }
            self.factor.solve(&mut forced);
            forced
        });
        let forced: Vec<_> = forced.collect();
        let does = |r: usize, c: usize| forced[c / 4][places[r]][c % 4];
        Some(Pinned {
            forces: DMatrix::from_fn(places.len(), places.len(), does).try_inverse()?,
            given: Matrix3xX::from_columns(&given),
            places,
            forced,
        })
    }

    /// Procedure 1: solves for the unknowns of `d`, the displacements of all vertices; known and pinned ones are
    /// kept. `delta` is equation (13) per vertex, `rounds` the number of length restorations.
    pub fn deform(
        &self,
        operator: &Operator,
        d: &mut [Vec3],
        is_pinned: impl Fn(u32) -> bool,
        delta: impl Fn(usize) -> f64,
        rounds: usize,
    ) {
        let pinned = self.pinned(d, is_pinned);
        // Right-hand side by the given displacements, the same in every round.
        let pull = self.factor.pulled(|v| [d[v].x, d[v].y, d[v].z, 0.0]);
        // Step 1 with L = L0.
        self.place(pull.clone(), pinned.as_ref(), d);
        let before = |&r: &u32| operator.neutral[r as usize];
        let mean = self.rows.iter().map(|r| before(r).norm()).sum::<f64>() / self.rows.len() as f64;
        // Only for the rows that the unknowns see.
        let mut wanted = WANTED.take();
        wanted.resize(d.len().max(wanted.len()), Vec3::zeros());
        for _ in 0..rounds {
            for r in &self.rows {
                // Step 2: L' = M V; step 3: L'' = (|L0| / |L'|) L'.
                let (l0, v) = (before(r), *r as usize);
                let now = l0 + operator.cotangent.row_times(v, d);
                let (had, has) = (l0.norm(), now.norm());
                let counts = has.min(had) > FLAT_ROW * mean;
                let restored = if counts { now * (had / has) } else { l0 };
                // Step 4: L = D L'' + (I − D) L0, kept as L − L0 times the row's weight.
                wanted[v] = (restored - l0) * (delta(v) * operator.weight[v]);
            }
            let mut rhs = pull.clone();
            for &v in &self.free {
                let more = operator.cotangent.row_times(v as usize, &wanted);
                if let Some(at) = self.unknowns.place(v as usize) {
                    add(&mut rhs[at], &more);
                }
            }
            self.place(rhs, pinned.as_ref(), d);
        }
        WANTED.set(wanted);
    }

    /// Solves for the unknowns and stores them in `d`; `x` holds the right-hand sides in the order of elimination.
    fn place(&self, mut x: Vec<[f64; 4]>, pinned: Option<&Pinned>, d: &mut [Vec3]) {
        self.factor.solve(&mut x);
        if let Some(pinned) = pinned {
            let mut misses = pinned.given.clone();
            for (mut miss, &at) in misses.column_iter_mut().zip(&pinned.places) {
                miss -= Vec3::from_column_slice(&x[at][..3]);
            }
            let forces = misses * &pinned.forces;
            for (c, forced) in pinned.forced.iter().enumerate() {
                let force = |k| (k < forces.ncols()).then(|| Vec3::from(forces.column(k)));
                let each: [Vec3; 4] = std::array::from_fn(|k| force(4 * c + k).unwrap_or_default());
                for (x, does) in x.iter_mut().zip(forced) {
                    for (force, does) in each.iter().zip(does) {
                        add(x, &(force * *does));
                    }
                }
            }
        }
        for (&v, x) in self.unknowns.rows.iter().zip(&x) {
            d[v as usize] = Vec3::new(x[0], x[1], x[2]);
        }
    }
}

/// Three coordinates; a fourth, unused one fills the vector registers.
fn add(to: &mut [f64; 4], what: &Vec3) {
    for k in 0..3 {
        to[k] += what[k];
    }
}

#[cfg(test)]
mod tests {
    use super::super::mesh::Mesh;
    use super::super::mesh::tests::sheet;
    use super::*;

    fn constrained(
        op: &Operator,
        neutral: &[Vec3],
        u: &[f64],
        controls: &[(u32, Vec3)],
        rounds: usize,
    ) -> Vec<Vec3> {
        let area: Vec<bool> = u.iter().map(|&u| u > 0.5).collect();
        let system = System::new(op, &area, controls.iter().map(|c| c.0)).unwrap();
        let mut d = vec![Vec3::zeros(); neutral.len()];
        for &(v, displacement) in controls {
            d[v as usize] = displacement;
        }
        system.deform(op, &mut d, |_| false, |v| u[v].min(1.0), rounds);
        d
    }

    fn operator(mesh: &Mesh) -> Operator {
        Operator::new(mesh, |_| false, |_| 1.0)
    }

    /// u = 1 within `radius` of the middle vertex, 0 outside.
    fn round_area(mesh: &Mesh, radius: f64) -> (u32, Vec<f64>) {
        let middle = (mesh.positions.len() / 2) as u32;
        let c = mesh.positions[middle as usize];
        let u = mesh
            .positions
            .iter()
            .map(|p| f64::from(u8::from((p - c).norm() < radius)))
            .collect();
        (middle, u)
    }

    #[test]
    fn outside_the_area_nothing_moves_at_all() {
        let mesh = sheet(31, 0.2);
        let (middle, u) = round_area(&mesh, 1.4);
        let push = Vec3::new(0.1, 0.2, 0.6);
        let d = constrained(&operator(&mesh), &mesh.positions, &u, &[(middle, push)], 3);
        assert_eq!(d[middle as usize], push);
        for v in 0..d.len() {
            assert!(u[v] > 0.5 || d[v] == Vec3::zeros());
        }
        assert!(d.iter().filter(|d| d.norm() > 0.01).count() > 60);
    }

    #[test]
    fn no_motion_in_no_motion_out_and_the_result_scales_and_translates() {
        let mesh = sheet(21, 0.2);
        let (middle, u) = round_area(&mesh, 1.2);
        let op = operator(&mesh);
        let still = constrained(&op, &mesh.positions, &u, &[(middle, Vec3::zeros())], 2);
        assert!(still.iter().all(|d| d.norm() < 1e-12));
        let push = Vec3::new(0.0, 0.1, 0.3);
        let here = constrained(&op, &mesh.positions, &u, &[(middle, push)], 1);
        let mut far = mesh.clone();
        for p in &mut far.positions {
            *p = *p * 10.0 + Vec3::new(3.0, -8.0, 1.0);
        }
        let there = constrained(
            &operator(&far),
            &far.positions,
            &u,
            &[(middle, push * 10.0)],
            1,
        );
        for (a, b) in here.iter().zip(&there) {
            assert!((a * 10.0 - b).norm() < 1e-7);
        }
    }

    #[test]
    fn restoring_lengths_acts_exactly_where_delta_is_above_zero() {
        let mesh = sheet(31, 0.2);
        let (middle, u) = round_area(&mesh, 2.0);
        let op = operator(&mesh);
        let area: Vec<bool> = u.iter().map(|&u| u > 0.5).collect();
        let system = System::new(&op, &area, [middle]).unwrap();
        let with = |delta: f64, rounds| {
            let mut d = vec![Vec3::zeros(); u.len()];
            d[middle as usize] = Vec3::new(0.3, 0.0, 0.9);
            system.deform(&op, &mut d, |_| false, |_| delta, rounds);
            d
        };
        let plain = with(1.0, 0);
        let differs = |other: &[Vec3]| {
            plain
                .iter()
                .zip(other)
                .map(|(a, b)| (a - b).norm())
                .fold(0.0, f64::max)
        };
        assert!(differs(&with(0.0, 3)) < 1e-9);
        assert!(differs(&with(1.0, 1)) > 1e-3);
    }

    #[test]
    fn a_pinned_vertex_equals_a_given_one_and_an_unpinned_one_is_free() {
        let mesh = sheet(31, 0.2);
        let (middle, u) = round_area(&mesh, 2.0);
        let op = operator(&mesh);
        let area: Vec<bool> = u.iter().map(|&u| u > 0.5).collect();
        let beside = [
            middle + 3,
            middle - 70,
            middle + 64,
            middle + 91,
            middle - 5,
        ];
        let shared = System::new(&op, &area, [middle]).unwrap();
        let shared = shared.with_pins(beside.iter().copied());
        for given in [&beside[..0], &beside[1..3], &beside] {
            let mut d = vec![Vec3::zeros(); u.len()];
            d[middle as usize] = Vec3::new(0.3, 0.0, 0.9);
            for (&v, k) in given.iter().zip(1..) {
                d[v as usize] = Vec3::new(0.1, -0.1, 0.2) * f64::from(k);
            }
            let mut own = d.clone();
            let all = given.iter().copied().chain([middle]);
            let system = System::new(&op, &area, all).unwrap();
            system.deform(&op, &mut own, |_| false, |_| 0.7, 1);
            shared.deform(&op, &mut d, |v| given.contains(&v), |_| 0.7, 1);
            for (a, b) in d.iter().zip(&own) {
                assert!((a - b).norm() < 1e-9, "{}: {a} {b}", given.len());
            }
        }
    }
}
