//! Finds and turns faces that run clockwise seen from outside, as the solver needs outward normals.
//!
//! Two faces at an edge agree if they pass it in opposite directions. Every connected part is made consistent, first
//! over shared vertices, then, by the majority of edges, over seams of duplicated vertices. A part faces outwards if
//! its volume, closed by a cone over its border, is positive. An open part inside another may be the lining of a
//! mouth or half an eyeball, and a plate has no volume: both are turned only if at least nine in ten of the parts
//! that can be judged are.
//!
//! Units: the mesh's. Cost: two sorts of the edges. Limits: edges of three or more faces end a part; a lone reversed
//! half eyeball stays.

use std::cmp::Reverse;
use std::collections::{BTreeMap, HashMap};

use super::mesh::{Mesh, Vec3, bounding_box};
use super::morphs::single;

/// Volume over area to the power of 1.5 below which an open part is a plate: .094 for a ball, .066 for half a one,
/// .04 to .09 for heads.
const PLATE: f64 = 0.02;
/// Most parts that are tested for containing others.
const HOLDERS: usize = 16;
/// Largest volume of a contained part, as share of the container's.
const HELD: f64 = 0.1;
/// Share of the total area from which an open part is judged by its own volume: strands of hair bend either way.
const LARGE: f64 = 0.01;
/// Least share of reversed parts, among the judged ones, for which the others are turned as well.
const MIN_REVERSED_SHARE: f64 = 0.9;
/// Least share of the smaller set's open edges that must coincide with the other's for a seam.
const SEAM: f64 = 0.1;

/// Two vertices in ascending order; the face; whether it runs from the first to the second.
type Edge = ([u32; 2], u32, bool);

fn edge([a, b]: [u32; 2], face: u32) -> Edge {
    ([a.min(b), a.max(b)], face, a < b)
}

/// Union-find of faces: a face of the same set, and whether one is opposite to the other.
struct Sets(Vec<(u32, bool)>);

impl Sets {
    fn root(&mut self, face: u32) -> (u32, bool) {
        let (mut at, mut opposite) = (face, false);
        while self.0[at as usize].0 != at {
            let (up, one) = self.0[at as usize];
            let (top, two) = self.0[up as usize];
            self.0[at as usize] = (top, one ^ two);
            opposite ^= one ^ two;
            at = top;
        }
        (at, opposite)
    }

    fn join(&mut self, a: u32, b: u32, opposite: bool) {
        let ((a, one), (b, two)) = (self.root(a), self.root(b));
        self.0[a.max(b) as usize] = (a.min(b), opposite ^ one ^ two && a != b);
    }
}

/// Integrals over the faces of one set.
#[derive(Default)]
struct Part {
    area: f64,
    /// Number of faces with the set's orientation, less the others.
    running: i64,
    /// Sums over faces of twice the area vector, and of its product with the position.
    normal: Vec3,
    moment: f64,
    /// Centroid of the border times its length, and its length.
    rim: Vec3,
    border: f64,
    /// Smallest and largest coordinates.
    extent: (Vec3, Vec3),
}

impl Part {
    fn volume(&self) -> f64 {
        let apex = self.rim / self.border.max(f64::MIN_POSITIVE);
        (self.moment - apex.dot(&self.normal)) / 6.0
    }

    fn is_plate(&self) -> bool {
        let least = if self.border > 0.0 {
            PLATE
        } else {
            PLATE / 20.0
        };
        self.volume().abs() <= least * self.area.powf(1.5)
    }

    /// Whether this open part lies inside the other.
    fn is_in(&self, other: &Self) -> bool {
        let ((low, high), (least, most)) = (self.extent, other.extent);
        self.border > 0.0
            && self.volume().abs() < HELD * other.volume().abs()
            && least.inf(&low) == least
            && most.sup(&high) == most
    }
}

/// Sets of agreeing faces, and the edges where they end.
fn agreed(mesh: &Mesh) -> (Sets, Vec<Edge>) {
    let faces = mesh.faces() as u32;
    let mut sets = Sets((0..faces).map(|f| (f, false)).collect());
    let sides = (0..faces).flat_map(|f| mesh.sides(f as usize).map(move |side| edge(side, f)));
    let mut edges: Vec<Edge> = sides.filter(|e| e.0[0] != e.0[1]).collect();
    edges.sort_unstable();
    let (mut open, mut border) = (Vec::new(), Vec::new());
    for group in edges.chunk_by(|a, b| a.0 == b.0) {
        match *group {
            [one] => open.push(one),
            [(_, f, one), (_, g, two)] => sets.join(f, g, one == two),
            _ => border.extend(group),
        }
    }
    let mut first = HashMap::new();
    let mut place = |v: u32| {
        let key = single(&mesh.positions[v as usize]).map(|x| (x + 0.0).to_bits());
        *first.entry(key).or_insert(v)
    };
    let mut size: HashMap<u32, usize> = HashMap::new();
    for (ends, face, forward) in &mut open {
        let side = if *forward { *ends } else { [ends[1], ends[0]] };
        (*ends, _, *forward) = edge(side.map(&mut place), *face);
        *size.entry(sets.root(*face).0).or_default() += 1;
    }
    open.sort_unstable();
    // Votes for and against.
    let mut votes: BTreeMap<[u32; 2], [usize; 2]> = BTreeMap::new();
    for group in open.chunk_by(|a, b| a.0 == b.0) {
        match *group {
            [(ends, f, one), (_, g, two)] if one != two || !folded(mesh, ends, [f, g]) => {
                let ((f, turned), (g, other)) = (sets.root(f), sets.root(g));
                let opposite = (one == two) ^ turned ^ other;
                votes.entry([f.min(g), f.max(g)]).or_default()[usize::from(opposite)] += 1;
            }
            _ => border.extend(group),
        }
    }
    let seam = |([a, b], votes): &([u32; 2], [usize; 2])| {
        let shared = votes.iter().sum::<usize>() as f64;
        a != b && shared >= SEAM * size[a].min(size[b]) as f64
    };
    let mut votes: Vec<_> = votes.into_iter().filter(seam).collect();
    votes.sort_by_key(|(_, [same, opposite])| Reverse(*same.max(opposite)));
    for ([a, b], [same, opposite]) in votes {
        sets.join(a, b, opposite > same);
    }
    (sets, border)
}

/// Whether two faces at an edge are folded onto each other, as closed lips are, rather than side by side.
fn folded(mesh: &Mesh, ends: [u32; 2], faces: [u32; 2]) -> bool {
    let [a, b] = ends.map(|v| mesh.positions[v as usize]);
    let along = (b - a).normalize();
    let [one, two] = faces.map(|f| {
        let face = mesh.face(f as usize);
        let places = face.iter().map(|c| mesh.positions[c.vertex as usize]);
        let inward = places.sum::<Vec3>() / face.len() as f64 - a;
        inward - along * inward.dot(&along)
    });
    one.dot(&two) > 0.0
}

/// Whether the corners of each face run clockwise seen from outside.
fn reversed(mesh: &Mesh) -> Vec<bool> {
    let (mut sets, border) = agreed(mesh);
    let mut parts: BTreeMap<u32, Part> = BTreeMap::new();
    for f in 0..mesh.faces() {
        let (root, opposite) = sets.root(f as u32);
        let part = parts.entry(root).or_insert_with(|| Part {
            extent: bounding_box([]),
            ..Part::default()
        });
        let normal = mesh.newell(f, &mesh.positions) * if opposite { -1.0 } else { 1.0 };
        let mut middle = Vec3::zeros();
        for corner in mesh.face(f) {
            let (low, high) = part.extent;
            let p = mesh.positions[corner.vertex as usize];
            part.extent = (low.inf(&p), high.sup(&p));
            middle += p / mesh.face(f).len() as f64;
        }
        part.area += 0.5 * normal.norm();
        part.running += if opposite { -1 } else { 1 };
        part.normal += normal;
        // About the centroid, so that a bent face and its reverse enclose the same volume.
        part.moment += normal.dot(&middle);
    }
    for (ends, face, _) in border {
        let [a, b] = ends.map(|v| mesh.positions[v as usize]);
        let part = parts.entry(sets.root(face).0).or_default();
        part.rim += (a + b) / 2.0 * (b - a).norm();
        part.border += (b - a).norm();
    }
    let mut holders: Vec<&Part> = parts.values().filter(|p| !p.is_plate()).collect();
    holders.sort_by(|a, b| b.volume().abs().total_cmp(&a.volume().abs()));
    holders.truncate(HOLDERS);
    let all: f64 = parts.values().map(|p| p.area).sum();
    let shows = |p: &Part| {
        let large = p.border == 0.0 || p.area > LARGE * all;
        large && !p.is_plate() && !holders.iter().any(|other| p.is_in(other))
    };
    let own = parts
        .iter()
        .map(|(&root, p)| (root, shows(p).then(|| p.volume() < 0.0)));
    let own: BTreeMap<u32, Option<bool>> = own.collect();
    // The orientation of most of a part's faces in the file.
    let runs = |root: &u32| parts[root].running < 0;
    let sure: Vec<bool> = own
        .iter()
        .filter_map(|(root, own)| Some((*own)? ^ runs(root)))
        .collect();
    let turned = sure.iter().filter(|reversed| **reversed).count();
    let rest = turned > 0 && turned as f64 >= MIN_REVERSED_SHARE * sure.len() as f64;
    let face = |f: u32| {
        let (root, opposite) = sets.root(f);
        opposite ^ own[&root].unwrap_or_else(|| rest ^ runs(&root))
    };
    (0..mesh.faces() as u32).map(face).collect()
}

impl Mesh {
    /// Turns clockwise faces; returns their number. They lose the file's normals.
    pub(super) fn turn_outward(&mut self) -> usize {
        let reversed = reversed(self);
        for f in (0..reversed.len()).filter(|&f| reversed[f]) {
            let face = &mut self.corners[self.starts[f] as usize..self.starts[f + 1] as usize];
            face.reverse();
            face.iter_mut().for_each(|corner| corner.normal = None);
        }
        reversed.into_iter().filter(|reversed| *reversed).count()
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{FRAC_PI_2, FRAC_PI_6, FRAC_PI_8};

    use super::super::mesh::Corner;
    use super::*;

    /// A ball of quads about a place, open at the top and the bottom by a ring.
    fn barrel(mesh: &mut Mesh, middle: Vec3, size: f64) {
        const AROUND: u32 = 12;
        let first = mesh.positions.len() as u32;
        for ring in 1..8 {
            for k in 0..AROUND {
                let (high, along) = (
                    FRAC_PI_8 * f64::from(ring) - FRAC_PI_2,
                    FRAC_PI_6 * f64::from(k),
                );
                let place = Vec3::new(
                    high.cos() * along.sin(),
                    high.sin(),
                    high.cos() * along.cos(),
                );
                mesh.positions.push(middle + place * size);
            }
        }
        for ring in 0..6 {
            for k in 0..AROUND {
                let at = |ring, k| Corner::bare(first + AROUND * ring + k % AROUND);
                mesh.push_face(
                    &[
                        at(ring, k),
                        at(ring, k + 1),
                        at(ring + 1, k + 1),
                        at(ring + 1, k),
                    ],
                    0,
                );
            }
        }
    }

    fn turned(mesh: &Mesh, turns: impl Fn(usize) -> bool) -> Mesh {
        let mut out = mesh.clone();
        for f in (0..mesh.faces()).filter(|&f| turns(f)) {
            out.corners[4 * f..4 * f + 4].reverse();
        }
        out
    }

    #[test]
    fn a_plate_is_thin_at_any_size() {
        for side in [0.01, 1.0, 100.0_f64] {
            // A closed box of so much of its width: area and six times the volume.
            let is_plate = |thick: f64| {
                let part = Part {
                    area: (2.0 + 4.0 * thick) * side.powi(2),
                    moment: 6.0 * thick * side.powi(3),
                    ..Part::default()
                };
                part.is_plate()
            };
            assert!(is_plate(0.001) && !is_plate(0.1), "{side}");
        }
    }

    #[test]
    fn faces_that_look_inwards_are_turned_whichever_they_are_and_linings_are_left() {
        let mut mesh = Mesh::default();
        barrel(&mut mesh, Vec3::zeros(), 1.0);
        let outer = mesh.faces();
        barrel(&mut mesh, Vec3::x() * 0.2, 0.3);
        // The inner one lines the outer one: seen from inside it.
        let head = turned(&mesh, |f| f >= outer);
        let beside = |turns: &dyn Fn(usize) -> bool| {
            let mut file = turned(&head, turns);
            let count = file.turn_outward();
            assert!(file.corners == head.corners);
            assert_eq!(count, (0..head.faces()).filter(|&f| turns(f)).count());
        };
        beside(&|_| false);
        beside(&|_| true);
        beside(&|f| f % 3 == 0);
        beside(&|f| f % 3 != 0);
        beside(&|f| f < outer && f % 3 == 0);
    }

    #[test]
    fn seams_of_repeated_vertices_hold_and_touching_sheets_do_not() {
        let mut whole = Mesh::default();
        barrel(&mut whole, Vec3::zeros(), 1.0);
        // Every face with corners of its own.
        let mut cut = Mesh::default();
        for f in 0..whole.faces() {
            let first = cut.positions.len() as u32;
            let places = whole
                .face(f)
                .iter()
                .map(|c| whole.positions[c.vertex as usize]);
            cut.positions.extend(places);
            cut.push_face(&[0, 1, 2, 3].map(|k| Corner::bare(first + k)), 0);
        }
        let mut mixed = turned(&cut, |f| f % 5 == 1);
        assert!(mixed.turn_outward() > 0);
        assert!(mixed.corners == cut.corners);
        // Two plates on each other, as closed lips.
        let mut plates = super::super::mesh::tests::sheet(3, 1.0);
        let other = plates.clone();
        plates.positions.extend_from_slice(&other.positions);
        for f in 0..4 {
            let corners = other.face(f).iter().rev();
            let corners: Vec<Corner> = corners.map(|c| Corner::bare(c.vertex + 9)).collect();
            plates.push_face(&corners, 0);
        }
        assert_eq!(plates.turn_outward(), 0);
    }
}
