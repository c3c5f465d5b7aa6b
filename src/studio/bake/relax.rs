//! Inverted triangles turned back.
//!
//! Each one is turned until it lies like its surroundings, its corners moving no further than that takes: the rest of the
//! shape stays as it was asked for, lids that meet included. Where triangles only hand the fold on to each other, the displacement
//! around them is smoothed as well, ever further. What outlasts that is spanned over, by the displacement of what lies ever
//! further around it.
//!
//! Units: the mesh's. Cost: a look at what has moved in each of at most [`TURNS`] and [`SPANNED`] rounds.
//! Degenerate case: what cannot move, outside the area, stays inverted and is counted in the report.

use super::head::Head;
use super::mesh::Vec3;
use super::shape::Target;
use super::skin::{Contacts, Solved};
use super::surroundings::{Flattened, Surroundings};

/// Rounds of turning, those of them before lids that meet may move too and before smoothing; and of spanning.
const TURNS: usize = 36;
const LIDS_HOLD: usize = 6;
const SMOOTHS: usize = 12;
const SPANNED: usize = 12;
/// Smoothing rounds after which it reaches a ring further.
const GROW_EVERY: usize = 3;
/// Height to which a triangle is turned over its surroundings, as part of its own area in the neutral, and sweeps over all of them.
const TURNED: f64 = 0.04;
const SWEEPS: usize = 8;
const SPANS: usize = 40;

/// One shape on its way.
struct Relaxing<'a> {
    head: &'a Head,
    around: &'a Surroundings,
    contacts: &'a Contacts<'a>,
    target: &'a Target,
    base: Option<&'a [Vec3]>,
    area: &'a [bool],
    /// Vertices of lids that meet or follow a gaze: what gives way first is the skin behind them.
    held: Vec<bool>,
    /// Displacement of this shape, and with the one beneath: that is what is seen and has to be smooth.
    d: Vec<Vec3>,
    all: Vec<Vec3>,
    began: Vec<Vec3>,
}

/// Displacements of a skin with what is inverted turned back, or with `spans` spanned over; `base` is the displacement of the
/// shape this one is added to. The round with the fewest inverted counts.
pub(super) fn relax(
    around: &Surroundings,
    contacts: &Contacts,
    target: &Target,
    base: Option<&[Vec3]>,
    Solved { d, area }: &Solved,
    spans: bool,
) -> Vec<Vec3> {
    let head = contacts.head;
    let below = |v: usize| base.map_or(Vec3::zeros(), |b| b[v]);
    let all: Vec<Vec3> = d.iter().enumerate().map(|(v, d)| d + below(v)).collect();
    let relaxing = Relaxing {
        head,
        around,
        contacts,
        target,
        base,
        area,
        held: held(head, target),
        d: d.clone(),
        began: all.clone(),
        all,
    };
    relaxing.settled(spans)
}

/// Lids that meet stay so, and lids that follow a gaze follow it; what the jaw alone moves is out of sight and gives way to nothing.
fn held(head: &Head, target: &Target) -> Vec<bool> {
    let all = 0..head.mesh.positions.len();
    let mut held: Vec<bool> = all.map(|v| head.deep(v)).collect();
    for (side, seam) in head.lids.iter().enumerate() {
        let shut = target.close[side].is_some_and(|(amount, _)| amount > 0.99);
        if shut || target.gaze[side].is_some() {
            for v in seam.both() {
                let t = seam.across(&head.mesh, &head.mesh.positions[v as usize]);
                held[v as usize] = (0.07..0.93).contains(&t);
            }
        }
    }
    held
}

impl Relaxing<'_> {
    /// Round by round until nothing is inverted; then the best round's.
    fn settled(mut self, spans: bool) -> Vec<Vec3> {
        let changed = (0..self.d.len() as u32).filter(|&v| self.all[v as usize] != Vec3::zeros());
        let mut flat = self.flattened(&changed.collect::<Vec<u32>>());
        let (mut patch, mut best, mut fewest) = (Vec::new(), Vec::new(), usize::MAX);
        for round in 0..if spans { SPANNED } else { TURNS } {
            let inverted = flat.iter().filter(|t| t.inverted);
            let inverted: Vec<u32> = inverted.flat_map(|t| t.corners).collect();
            if inverted.is_empty() {
                return self.d;
            }
            if inverted.len() < fewest {
                (fewest, best) = (inverted.len(), self.d.clone());
            }
            patch.extend(flat.iter().flat_map(|t| &t.corners));
            if spans {
                self.span(&inverted, round + 1, &mut patch);
            } else {
                if round >= LIDS_HOLD {
                    for &v in flat.iter().flat_map(|t| &t.corners) {
                        self.held[v as usize] = false;
                    }
                }
                if round >= SMOOTHS {
                    let rings = (round - SMOOTHS) / GROW_EVERY;
                    self.smooth(&inverted, rings, &mut patch);
                }
                self.turn(&flat);
            }
            self.part(&mut patch);
            flat = self.flattened(&patch);
        }
        let inverted = flat.iter().any(|t| t.inverted);
        if inverted { best } else { self.d }
    }

    fn below(&self, v: u32) -> Vec3 {
        self.base.map_or(Vec3::zeros(), |b| b[v as usize])
    }

    fn put(&mut self, v: u32, all: Vec3) {
        self.all[v as usize] = all;
        self.d[v as usize] = all - self.below(v);
    }

    fn free(&self, v: u32) -> bool {
        self.area[v as usize] && !self.held[v as usize]
    }

    /// The triangles that see the patch and are inverted or nearly so.
    fn flattened(&self, patch: &[u32]) -> Vec<Flattened> {
        let some = self.around.seeing(patch);
        self.around.flattened(&|v| self.at(v), &some, TURNED)
    }

    /// Where a vertex is now.
    fn at(&self, v: u32) -> Vec3 {
        self.head.mesh.positions[v as usize] + self.all[v as usize]
    }

    /// Turns triangles until they rise towards their surroundings, corners moving in proportion to what each lifts; in turns, as
    /// one moves another.
    fn turn(&mut self, flat: &[Flattened]) {
        for t in std::iter::repeat_n(flat, SWEEPS).flatten() {
            let [a, b, c] = t.corners.map(|v| self.at(v));
            let (by_b, by_c) = ((c - a).cross(&t.normal), t.normal.cross(&(b - a)));
            let lacks = t.wanted - by_c.dot(&(c - a));
            let by = [-by_b - by_c, by_b, by_c];
            let moves = t.corners.map(|v| self.free(v));
            let free = || (0..3).filter(|&k| moves[k]);
            let size: f64 = free().map(|k| by[k].norm_squared()).sum();
            if lacks > 0.0 && size > 0.0 {
                // A sliver would be turned by a spike: no corner goes further than an edge.
                let edge = (t.wanted / TURNED).sqrt();
                for k in free() {
                    let v = t.corners[k];
                    let from = self.began[v as usize];
                    let moved = self.all[v as usize] + by[k] * (lacks / size) - from;
                    self.put(v, from + moved.cap_magnitude(edge));
                }
            }
        }
    }

    /// Half of the way to the mean of the neighbours, within `rings` of some vertices.
    fn smooth(&mut self, some: &[u32], rings: usize, patch: &mut Vec<u32>) {
        let mut inside = self.head.rings.about(some, rings).concat();
        inside.retain(|&v| self.free(v));
        let mean = |&v: &u32| {
            let ring = self.head.rings.of(v as usize);
            let sum: Vec3 = ring.iter().map(|&o| self.at(o)).sum();
            let (p, all) = (self.head.mesh.positions[v as usize], self.all[v as usize]);
            (sum / ring.len() as f64 - p + all) / 2.0
        };
        let smoothed: Vec<Vec3> = inside.iter().map(mean).collect();
        for (&v, all) in inside.iter().zip(smoothed) {
            self.put(v, all);
        }
        patch.extend(inside);
    }

    /// Spans the displacement evenly over the skin within `rings` of some vertices.
    fn span(&mut self, some: &[u32], rings: usize, patch: &mut Vec<u32>) {
        let mut inside = self.head.rings.about(some, rings).concat();
        inside.retain(|&v| self.area[v as usize]);
        for &v in std::iter::repeat_n(&inside, SPANS).flatten() {
            let ring = self.head.rings.of(v as usize);
            let sum: Vec3 = ring.iter().map(|&o| self.all[o as usize]).sum();
            self.put(v, sum / ring.len() as f64);
        }
        patch.extend(inside);
    }

    /// Turning and smoothing must not bring back what the contacts have mended.
    fn part(&mut self, patch: &mut Vec<u32>) {
        let mut touched = self.contacts.sunk(&self.d, self.target);
        touched.retain(|(v, _)| !self.held[*v as usize]);
        touched.extend(self.contacts.crossed(&self.d, self.base));
        for (v, moved) in touched {
            if self.area[v as usize] {
                self.put(v, moved + self.below(v));
                patch.push(v);
            }
        }
        patch.sort_unstable();
        patch.dedup();
    }
}
