//! Inverted triangles and torn edges, found by looking at each triangle among its neighbours.
//!
//! A triangle is inverted if it turns by more than 37 degrees from the neutral and faces away from the triangles up to two rings
//! around it in the deformed mesh (cosine below 0), although it agreed with them in the neutral (above 0.3). Without the second
//! condition, lips and lids that roll would count.
//!
//! Cost: linear in the triangles that move; memory: neighbours of triangles and vertices.

use super::head::Head;
use super::mesh::{Lists, Rings, Vec3, rings_of};

/// A triangle that agrees less with its surroundings in the neutral (cosine) is not judged.
const AGREES: f64 = 0.3;
/// Nor one that turns by less than this (cosine).
const TURNS: f64 = 0.8;

/// An edge is torn that has grown beyond this many times its length and this part of the eye distance.
const TORN: [f64; 2] = [5.0, 0.05];

/// The skin's triangles and what surrounds them.
pub(super) struct Surroundings<'a> {
    /// Vertices of the neutral.
    neutral: &'a [Vec3],
    /// Length that an edge may grow beyond [`TORN`] times its own.
    spare: f64,
    triangles: Vec<[u32; 3]>,
    /// Neighbours along the triangles' edges: also along those that cut a face.
    rings: Rings,
    /// Triangles at each vertex.
    at: Lists,
}

/// Normal of a triangle, as long as twice its area.
fn normal([a, b, c]: [Vec3; 3]) -> Vec3 {
    (b - a).cross(&(c - a))
}

impl<'a> Surroundings<'a> {
    /// Of one head; films across a slit are left out.
    pub(super) fn new(head: &'a Head) -> Self {
        let mut triangles = Vec::new();
        for f in 0..head.mesh.faces() {
            if !head.film[f] && head.skin[head.mesh.face(f)[0].vertex as usize] {
                // A quad as the file cuts it: from its first corner ([`super::order`]).
                triangles.extend(head.mesh.fan(f).map(|t| t.map(|c| c.vertex)));
            }
        }
        Self::of(&head.mesh.positions, triangles, head.eye_distance)
    }

    fn of(neutral: &'a [Vec3], triangles: Vec<[u32; 3]>, eye_distance: f64) -> Self {
        let n = neutral.len();
        let numbered = triangles.iter().zip(0_u32..);
        let at = numbered.flat_map(|(t, k)| t.map(|v| [v, k]));
        let edges = triangles.iter();
        let edges = edges.flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]);
        Self {
            at: Lists::new(n, at.collect()),
            rings: rings_of(n, edges),
            triangles,
            neutral,
            spare: TORN[1] * eye_distance,
        }
    }

    /// The triangles with a corner that moves.
    fn moving(&self, moves: impl Fn(usize) -> bool) -> impl Iterator<Item = [u32; 3]> {
        let all = self.triangles.iter().copied();
        all.filter(move |t| t.iter().any(|&v| moves(v as usize)))
    }

    /// Where a vertex is in the neutral.
    fn neutral(&self, v: u32) -> Vec3 {
        self.neutral[v as usize]
    }

    /// Cosine of a triangle's normal with the mean normal of its surroundings.
    fn agrees(&self, t: [u32; 3], p: &impl Fn(u32) -> Vec3) -> f64 {
        let one = |v: &u32| -> Vec3 {
            let around = self.at.of(*v as usize).iter();
            around
                .map(|&k| normal(self.triangles[k as usize].map(p)))
                .sum()
        };
        let two = |v: &u32| {
            let ring = self.rings.of(*v as usize).iter();
            ring.fold(one(v), |sum, o| sum + one(o))
        };
        let around: Vec3 = t.iter().map(two).sum();
        let cosine = normal(t.map(p)).normalize().dot(&around.normalize());
        if cosine.is_nan() { 0.0 } else { cosine }
    }

    /// The triangles that are inverted where vertices are `at`; `moves` says which are elsewhere than in the neutral.
    fn inverted(
        &self,
        moves: impl Fn(usize) -> bool,
        at: &impl Fn(u32) -> Vec3,
    ) -> impl Iterator<Item = [u32; 3]> {
        let neutral = |v| self.neutral(v);
        self.moving(moves).filter(move |&t| {
            let (was, is) = (normal(t.map(neutral)), normal(t.map(at)));
            let along = was.dot(&is);
            let turns = along < 0.0
                || along.powi(2) < TURNS.powi(2) * was.norm_squared() * is.norm_squared();
            turns && self.agrees(t, at) < 0.0 && self.agrees(t, &neutral) > AGREES
        })
    }

    /// Vertices of the triangles that a displacement turns over and of the edges that it tears, ascending; `at` is where vertices
    /// are then.
    pub(super) fn faults(&self, d: &[Vec3], at: &impl Fn(u32) -> Vec3) -> Vec<u32> {
        let moves = |v: usize| d[v] != Vec3::zeros();
        let mut found: Vec<u32> = self.inverted(moves, at).flatten().collect();
        let torn = |edge: &[u32; 2]| {
            let [was, is] = [edge.map(|v| self.neutral(v)), edge.map(at)];
            let [was, is] = [was, is].map(|[a, b]| (a - b).norm_squared());
            // Roots of the few that may be.
            is > TORN[0].powi(2) * was && is.sqrt() > TORN[0] * was.sqrt() + self.spare
        };
        let edges = self
            .moving(moves)
            .flat_map(|[a, b, c]| [[a, b], [b, c], [c, a]]);
        found.extend(edges.filter(torn).flatten());
        found.sort_unstable();
        found.dedup();
        found
    }
}

#[cfg(test)]
mod tests {
    use super::super::mesh::tests::sheet;
    use super::*;

    /// Faults of a flat sheet of 7 × 7 vertices, 0.1 apart, whose vertices go where `moved` says.
    fn faults(moved: impl Fn(u32, Vec3) -> Vec3) -> Vec<u32> {
        let mesh = sheet(7, 0.1);
        let triangles = mesh.triangles();
        let around = Surroundings::of(&mesh.positions, triangles, 0.1);
        let places = mesh.positions.iter().zip(0..);
        let d: Vec<Vec3> = places.map(|(p, v)| moved(v, *p) - p).collect();
        around.faults(&d, &|v| mesh.positions[v as usize] + d[v as usize])
    }

    #[test]
    fn a_vertex_pushed_through_its_neighbours_is_found_and_a_turn_of_all_is_not() {
        // The middle one, beyond the next.
        let found = faults(|v, p| {
            if v == 24 {
                p + Vec3::new(0.15, 0.01, 0.0)
            } else {
                p
            }
        });
        assert!(found.contains(&24), "{found:?}");
        assert!(faults(|_, p| Vec3::new(-p.x, p.y, -p.z)).is_empty());
        assert!(faults(|_, p| p).is_empty());
    }

    #[test]
    fn an_edge_is_torn_that_grows_sixfold() {
        // One row lifted off the plane, so that no triangle is inverted.
        let lifted = |by: f64| move |v: u32, p: Vec3| if v < 7 { p + Vec3::z() * by } else { p };
        assert!(faults(lifted(0.4)).is_empty());
        assert!(!faults(lifted(0.7)).is_empty());
    }
}
