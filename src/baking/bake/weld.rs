//! Welds triangles as stored in glTF back into the mesh that they were made from.
//!
//! A file repeats a vertex wherever its texture or normal changes, so the position alone cannot distinguish a
//! duplicate at a seam from a touching vertex of another part. The triangles can: along a seam two open edges
//! coincide and run in opposite directions, each with its triangle on its own side. Only such edges are welded;
//! closed lips, teeth in gums and balls in sockets stay separate although they touch.
//!
//! Exporters write the two triangles of a quad consecutively; where nearly all triangles pair up like that, they
//! become quads again, so that a head bakes as it does from OBJ.
//!
//! Cost: linear with a hash map. Limits: two parts whose open edges coincide exactly are welded; duplicates must
//! agree to the last bit; faces of both windings along one seam stay separate.

use std::collections::{HashMap, HashSet};

use super::mesh::{Vec3, area_vector, first_alike};

/// Share of paired triangles from which a mesh counts as one of quads.
const MOSTLY_QUADS: f64 = 0.85;
/// Least cosine of the normals of a quad's triangles, 60 degrees.
const BENT: f64 = 0.5;

/// Most edges at one position that are searched for one of the same part.
const FOLDED: usize = 64;

/// Start row, end row, part.
type Edge = (u32, u32, u32);

/// For every row the first row that is the same vertex. `places` are the rows' positions, `parts` the part of each
/// triangle (edges of one part are welded first).
pub(super) fn welded(places: &[[f32; 3]], triangles: &[[u32; 3]], parts: &[u32]) -> Vec<u32> {
    // Adding 0 turns -0 into 0.
    let place = first_alike(places.iter().map(|p| p.map(|x| (x + 0.0).to_bits())));
    let around = |(t, &part): (&[u32; 3], &u32)| [0, 1, 2].map(|k| (t[k], t[(k + 1) % 3], part));
    let edges = || triangles.iter().zip(parts).flat_map(around);
    let there: HashSet<(u32, u32)> = edges().map(|(a, b, _)| (a, b)).collect();
    // Open edges by position.
    let mut open: HashMap<(u32, u32), Vec<Edge>> = HashMap::new();
    for (a, b, part) in edges().filter(|&(a, b, _)| a != b && !there.contains(&(b, a))) {
        let key = (place[a as usize], place[b as usize]);
        open.entry(key).or_default().push((a, b, part));
    }
    let mut same: Vec<u32> = (0..places.len() as u32).collect();
    let mut keys: Vec<(u32, u32)> = open.keys().copied().filter(|&(a, b)| a < b).collect();
    keys.sort_unstable();
    for (a, b) in keys {
        let Some(mut back) = open.remove(&(b, a)) else {
            continue;
        };
        let mut forth = open.remove(&(a, b)).unwrap_or_default();
        let mut sew = |(from, to, _), (there, here, _)| {
            join(&mut same, from, here);
            join(&mut same, to, there);
        };
        // Many edges at one position are no seam of a head.
        forth.retain(|edge| {
            let mut near = back.iter().take(FOLDED);
            let own = near.position(|e| e.2 == edge.2);
            if let Some(at) = own {
                sew(*edge, back.swap_remove(at));
            }
            own.is_none()
        });
        for (edge, other) in forth.into_iter().zip(back) {
            sew(edge, other);
        }
    }
    for row in 0..same.len() as u32 {
        same[row as usize] = root(&same, row);
    }
    same
}

/// First of the rows that are the same vertex.
fn root(same: &[u32], mut row: u32) -> u32 {
    while same[row as usize] != row {
        row = same[row as usize];
    }
    row
}

/// Merges the sets of two rows.
fn join(same: &mut [u32], a: u32, b: u32) {
    let (a, b) = (root(same, a), root(same, b));
    same[a.max(b) as usize] = a.min(b);
}

/// Faces of the mesh: the triangles, or quads where nearly all pair up.
pub(super) fn faces(positions: &[Vec3], triangles: &[[u32; 3]]) -> Vec<Vec<u32>> {
    let n = triangles.len();
    // Neighbours in the list may share an edge without being a quad. The best pairing of the whole list counts, in
    // which the halves of a quad start or end with the same corner, as exporters cut them.
    let mut best = vec![0_u32; n + 2];
    for k in (0..n.saturating_sub(1)).rev() {
        let (one, two) = (triangles[k], triangles[k + 1]);
        let pair = quad(positions, one, two)
            .map(|_| 2 + 3 * u32::from(one[0] == two[0] || one[2] == two[2]));
        best[k] = best[k + 1].max(pair.map_or(0, |gain| gain + best[k + 2]));
    }
    let mut faces: Vec<Vec<u32>> = Vec::with_capacity(n);
    let mut k = 0;
    while k < n {
        let pairs = best[k] > best[k + 1] && k + 1 < n;
        let pair = pairs.then(|| quad(positions, triangles[k], triangles[k + 1]));
        let pair = pair.flatten();
        faces.push(pair.map_or_else(|| triangles[k].to_vec(), |quad| quad.to_vec()));
        k += faces[faces.len() - 1].len() - 2;
    }
    let paired = 2 * (n - faces.len());
    if (paired as f64) < MOSTLY_QUADS * n as f64 {
        return triangles.iter().map(|t| t.to_vec()).collect();
    }
    faces
}

/// The four corners of two triangles with a common edge, cut from the first to the third along the shorter diagonal,
/// regardless of the triangles' own.
fn corners(positions: &[Vec3], one: [u32; 3], two: [u32; 3]) -> Option<[u32; 4]> {
    (0..3).find_map(|k| {
        let [a, b, c] = [one[k], one[(k + 1) % 3], one[(k + 2) % 3]];
        let at = (0..3).find(|&j| two[j] == b && two[(j + 1) % 3] == a)?;
        let d = two[(at + 2) % 3];
        let far = |a: u32, b: u32| (positions[a as usize] - positions[b as usize]).norm_squared();
        let other = far(c, d) < far(a, b) * (1.0 - 1e-9);
        (c != d).then_some(if other { [c, a, d, b] } else { [b, c, a, d] })
    })
}

/// The convex quad that two triangles with a common edge make.
fn quad(positions: &[Vec3], one: [u32; 3], two: [u32; 3]) -> Option<[u32; 4]> {
    let normal = |t: [u32; 3]| area_vector(t.map(|v| positions[v as usize]));
    let quad = corners(positions, one, two)?;
    let [a, b, c, d] = quad;
    let (left, right) = (normal([a, b, c]), normal([a, c, d]));
    let mean = left + right;
    let flat = left.dot(&right) > BENT * left.norm() * right.norm();
    let mut others = [[b, c, d], [d, a, b]].into_iter().map(normal);
    let convex = others.all(|n| n.dot(&mean) > 0.0);
    (flat && convex).then_some(quad)
}

/// Cuts quads that are too bent along their shorter diagonals, as files differ in how they cut them.
pub(super) fn recut(positions: &[Vec3], faces: &mut [Vec<u32>]) {
    let mut at = 0;
    let some_quads = faces.iter().any(|face| face.len() == 4);
    while some_quads && at + 1 < faces.len() {
        if let ([a, b, c], [d, e, f]) = (&*faces[at], &*faces[at + 1])
            && (a == d || c == f)
            && let Some([p, q, r, s]) = corners(positions, [*a, *b, *c], [*d, *e, *f])
        {
            faces[at] = vec![p, q, r];
            faces[at + 1] = vec![p, r, s];
            at += 1;
        }
        at += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::super::mesh::tests::sheet;
    use super::*;

    /// Two squares of two triangles each, as rows; the second stands at `x` from the first.
    fn squares(x: f32) -> (Vec<[f32; 3]>, Vec<[u32; 3]>) {
        let square = |x: f32| {
            [
                [x, 0.0, 0.0],
                [x + 1.0, 0.0, 0.0],
                [x + 1.0, 1.0, 0.0],
                [x, 1.0, 0.0],
            ]
        };
        let places = [square(0.0), square(x)].concat();
        (places, vec![[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
    }

    #[test]
    fn a_seam_is_welded_and_a_touch_is_not() {
        let (places, triangles) = squares(1.0);
        assert_eq!(
            welded(&places, &triangles, &[0; 4]),
            [0, 1, 2, 3, 1, 5, 6, 2]
        );
        // Sheets that lie on each other, as closed lips do, run in the same direction along every edge.
        let (places, triangles) = squares(0.0);
        assert_eq!(
            welded(&places, &triangles, &[0; 4]),
            [0, 1, 2, 3, 4, 5, 6, 7]
        );
    }

    #[test]
    fn triangles_written_in_pairs_are_quads_again() {
        let (places, triangles) = squares(1.0);
        let positions: Vec<Vec3> = places
            .iter()
            .map(|p| Vec3::from(p.map(f64::from)))
            .collect();
        assert_eq!(
            faces(&positions, &triangles),
            [[0, 1, 2, 3], [4, 5, 6, 7]].map(|q| q.to_vec())
        );
        let other = [triangles[0], triangles[2], triangles[1], triangles[3]];
        assert_eq!(faces(&positions, &other).len(), 4);
    }

    #[test]
    fn bent_quads_are_cut_alike_for_either_diagonal_of_the_file() {
        let mut mesh = sheet(8, 1.0);
        mesh.positions[0].z = 3.0;
        let cut = |first: [[usize; 3]; 2]| {
            let halves = |f: usize| {
                if f == 0 {
                    first
                } else {
                    [[0, 1, 2], [0, 2, 3]]
                }
            };
            let corner = |f: usize, k: usize| mesh.face(f)[k].vertex;
            let all = (0..mesh.faces()).flat_map(|f| halves(f).map(|t| t.map(|k| corner(f, k))));
            let mut all = faces(&mesh.positions, &all.collect::<Vec<_>>());
            assert_eq!(all.len(), mesh.faces() + 1);
            recut(&mesh.positions, &mut all);
            all.iter_mut().for_each(|face| face.sort_unstable());
            all.sort_unstable();
            all
        };
        assert_eq!(cut([[0, 1, 2], [0, 2, 3]]), cut([[1, 2, 3], [1, 3, 0]]));
    }
}
