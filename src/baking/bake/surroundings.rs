//! Inverted triangles and torn edges, found by comparing each triangle with its neighbours.
//!
//! A triangle is inverted if it rotates by more than 37 degrees from the neutral and faces away from the triangles up
//! to two rings around it in the deformed mesh (cosine below 0), although it agreed with them in the neutral (above
//! 0.3). Without the second condition, lips and lids that roll would count.
//!
//! Cost: linear in the triangles that move; memory: neighbours of triangles and vertices.

use super::head::Head;
use super::mesh::{Lists, Rings, Vec3, area_vector, neighbour_lists};

/// Least cosine with the surroundings in the neutral for a triangle to be judged.
const AGREES: f64 = 0.3;
/// Largest cosine with its neutral normal for a triangle to be judged.
const TURNS: f64 = 0.8;

/// An edge is torn that exceeds this multiple of its length by this part of the eye distance.
const TORN: [f64; 2] = [5.0, 0.05];

/// The skin's triangles and what surrounds them.
pub(super) struct Surroundings<'a> {
    /// Vertices of the neutral.
    neutral: &'a [Vec3],
    /// Allowed length of an edge beyond [`TORN`] times its own, mesh units.
    spare: f64,
    triangles: Vec<[u32; 3]>,
    /// Neighbours along the triangles' edges, diagonals included.
    rings: Rings,
    /// Triangles at each vertex.
    at: Lists,
}

impl<'a> Surroundings<'a> {
    /// For the skin of a head, without membranes across slits.
    pub(super) fn new(head: &'a Head) -> Self {
        let mut triangles = Vec::new();
        for f in 0..head.mesh.faces() {
            if !head.membrane[f] && head.skin[head.mesh.face(f)[0].vertex as usize] {
                // Quads are cut from their first corner, as in the file ([`super::order`]).
                triangles.extend(head.mesh.fan(f).map(|t| t.map(|c| c.vertex)));
            }
        }
        Self::from_triangles(&head.mesh.positions, triangles, head.eye_distance)
    }

    fn from_triangles(neutral: &'a [Vec3], triangles: Vec<[u32; 3]>, eye_distance: f64) -> Self {
        let n = neutral.len();
        let numbered = triangles.iter().zip(0_u32..);
        let at = numbered.flat_map(|(t, k)| t.map(|v| [v, k]));
        let edges = triangles.iter();
        let edges = edges.flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]);
        Self {
            at: Lists::new(n, at.collect()),
            rings: neighbour_lists(n, edges),
            triangles,
            neutral,
            spare: TORN[1] * eye_distance,
        }
    }

    /// The triangles with a moving corner.
    fn moving(&self, moves: impl Fn(usize) -> bool) -> impl Iterator<Item = [u32; 3]> {
        let all = self.triangles.iter().copied();
        all.filter(move |t| t.iter().any(|&v| moves(v as usize)))
    }

    /// Position of a vertex in the neutral.
    fn neutral(&self, v: u32) -> Vec3 {
        self.neutral[v as usize]
    }

    /// Cosine of a triangle's normal with the mean normal of its surroundings.
    fn agrees(&self, t: [u32; 3], p: &impl Fn(u32) -> Vec3) -> f64 {
        let one = |v: &u32| -> Vec3 {
            let around = self.at.members(*v as usize).iter();
            let around = around.map(|&k| self.triangles[k as usize].map(p));
            around.map(area_vector).sum()
        };
        let two = |v: &u32| {
            let ring = self.rings.members(*v as usize).iter();
            ring.fold(one(v), |sum, o| sum + one(o))
        };
        let around: Vec3 = t.iter().map(two).sum();
        let cosine = area_vector(t.map(p)).normalize().dot(&around.normalize());
        if cosine.is_nan() { 0.0 } else { cosine }
    }

    /// The inverted triangles with vertices `at`; `moves` tells which ones moved.
    fn inverted(
        &self,
        moves: impl Fn(usize) -> bool,
        at: &impl Fn(u32) -> Vec3,
    ) -> impl Iterator<Item = [u32; 3]> {
        let neutral = |v| self.neutral(v);
        self.moving(moves).filter(move |&t| {
            let (was, is) = (area_vector(t.map(neutral)), area_vector(t.map(at)));
            let along = was.dot(&is);
            let turns = along < 0.0
                || along.powi(2) < TURNS.powi(2) * was.norm_squared() * is.norm_squared();
            turns && self.agrees(t, at) < 0.0 && self.agrees(t, &neutral) > AGREES
        })
    }

    /// Vertices of inverted triangles and torn edges for displacements `d`, ascending; `at` gives the displaced
    /// positions.
    pub(super) fn defects(&self, d: &[Vec3], at: &impl Fn(u32) -> Vec3) -> Vec<u32> {
        let moves = |v: usize| d[v] != Vec3::zeros();
        let mut found: Vec<u32> = self.inverted(moves, at).flatten().collect();
        let torn = |edge: &[u32; 2]| {
            let [was, is] = [edge.map(|v| self.neutral(v)), edge.map(at)];
            let [was, is] = [was, is].map(|[a, b]| (a - b).norm_squared());
            // Roots only for the few candidates.
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

    /// Defects of a flat sheet of 7 × 7 vertices, spacing 0.1, displaced by `moved`.
    fn defects(moved: impl Fn(u32, Vec3) -> Vec3) -> Vec<u32> {
        let mesh = sheet(7, 0.1);
        let triangles = mesh.triangles();
        let around = Surroundings::from_triangles(&mesh.positions, triangles, 0.1);
        let places = mesh.positions.iter().zip(0..);
        let d: Vec<Vec3> = places.map(|(p, v)| moved(v, *p) - p).collect();
        around.defects(&d, &|v| mesh.positions[v as usize] + d[v as usize])
    }

    #[test]
    fn a_vertex_pushed_through_its_neighbours_is_found_and_a_turn_of_all_is_not() {
        // The middle one, beyond the next.
        let found = defects(|v, p| {
            if v == 24 {
                p + Vec3::new(0.15, 0.01, 0.0)
            } else {
                p
            }
        });
        assert!(found.contains(&24), "{found:?}");
        assert!(defects(|_, p| Vec3::new(-p.x, p.y, -p.z)).is_empty());
        assert!(defects(|_, p| p).is_empty());
    }

    #[test]
    fn an_edge_is_torn_that_grows_sixfold() {
        // One row lifted off the plane, so that no triangle is inverted.
        let lifted = |by: f64| move |v: u32, p: Vec3| if v < 7 { p + Vec3::z() * by } else { p };
        assert!(defects(lifted(0.4)).is_empty());
        assert!(!defects(lifted(0.7)).is_empty());
    }
}
