//! Inverted triangles turned back.
//!
//! Each one is turned until it lies like its surroundings, its corners moving no further than that takes: the rest of the
//! shape stays as it was asked for, lids that meet included. Where triangles only hand the fold on to each other, the displacement
//! around them is smoothed as well, in a patch that grows. What outlasts that is taken back towards the neutral, or the
//! shape beneath, by ever more and around ever more of it: a shape that is nothing inverts nothing.
//!
//! Units: the mesh's. Cost: at most [`ROUNDS`] looks at the patch; nothing outside it is looked at twice.
//! Degenerate case: what cannot move, outside the area, stays inverted and is counted in the report.

use super::contact::Contacts;
use super::head::Head;
use super::mesh::{Rings, Vec3};
use super::recipe::Target;
use super::skin::Solved;
use super::surroundings::{Flattened, Scratch, Surroundings};

/// Rounds in all, those before lids that meet may move too, before smoothing and before taking back.
const ROUNDS: usize = 48;
const LIDS_HOLD: usize = 6;
const SMOOTHS: usize = 12;
const YIELDS: usize = 36;
/// Smoothing rounds after which the patch grows by a ring.
const GROW_EVERY: usize = 3;
/// Height to which a triangle is turned over its surroundings, as part of its own area in the neutral, and sweeps over all of them.
const TURNED: f64 = 0.04;
const SWEEPS: usize = 8;

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
    d: &'a mut [Vec3],
    all: Vec<Vec3>,
    scratch: Scratch,
}

/// Turns back what is inverted; `base` is the displacement of the shape this one is added to.
pub(super) fn relax(
    head: &Head,
    around: &Surroundings,
    contacts: &Contacts,
    target: &Target,
    base: Option<&[Vec3]>,
    solved: &mut Solved,
) {
    let Solved { d, area, .. } = solved;
    let n = d.len();
    let below = |v: usize| base.map_or(Vec3::zeros(), |b| b[v]);
    let all: Vec<Vec3> = (0..n).map(|v| d[v] + below(v)).collect();
    let changed: Vec<u32> = (0..n as u32)
        .filter(|&v| all[v as usize] != Vec3::zeros())
        .collect();
    let mut scratch = around.scratch();
    let all_seen = around.seeing(&changed, &mut scratch);
    let moved = |v: usize| head.mesh.positions[v] + all[v];
    let mut inverted = around.flattened(&moved, &all_seen, TURNED, &mut scratch);
    if inverted.is_empty() {
        return;
    }
    let mut relaxing = Relaxing {
        head,
        around,
        contacts,
        target,
        base,
        area,
        held: held(head, target),
        d,
        all,
        scratch,
    };
    let mut patch: Vec<u32> = Vec::new();
    for round in 0..ROUNDS {
        patch.extend(inverted.iter().flat_map(|t| &t.corners));
        let grows = round >= SMOOTHS && (round - SMOOTHS).is_multiple_of(GROW_EVERY);
        relaxing.widen(&mut patch, usize::from(grows));
        if round >= LIDS_HOLD {
            for &v in inverted.iter().flat_map(|t| &t.corners) {
                relaxing.held[v as usize] = false;
            }
        }
        if round >= YIELDS {
            relaxing.take_back(&inverted, round + 1 - YIELDS);
        } else {
            if round >= SMOOTHS {
                relaxing.smooth(&patch);
            }
            relaxing.turn(&inverted);
        }
        relaxing.part(&mut patch);
        inverted = relaxing.inverted(&patch);
        if inverted.is_empty() {
            break;
        }
    }
}

/// Lids that meet stay so, and lids that follow a gaze follow it; what the jaw alone moves is out of sight and gives way to nothing.
fn held(head: &Head, target: &Target) -> Vec<bool> {
    let mut held: Vec<bool> = (0..head.mesh.positions.len())
        .map(|v| head.deep(v))
        .collect();
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

    /// Adds so many rings; each vertex is once in a patch, ascending.
    fn widen(&self, patch: &mut Vec<u32>, rings: usize) {
        for _ in 0..rings {
            for k in 0..patch.len() {
                patch.extend(self.head.rings.of(patch[k] as usize));
            }
            patch.sort_unstable();
            patch.dedup();
        }
        patch.sort_unstable();
        patch.dedup();
    }

    /// The triangles that see the patch and are inverted or nearly so, with the normals of their surroundings; none if none is
    /// inverted.
    fn inverted(&mut self, patch: &[u32]) -> Vec<Flattened> {
        let some = self.around.seeing(patch, &mut self.scratch);
        let moved = |v: usize| self.head.mesh.positions[v] + self.all[v];
        self.around
            .flattened(&moved, &some, TURNED, &mut self.scratch)
    }

    /// Turns triangles until they rise towards their surroundings, corners moving in proportion to what each lifts; in turns, as
    /// one moves another.
    fn turn(&mut self, flat: &[Flattened]) {
        for t in std::iter::repeat_n(flat, SWEEPS).flatten() {
            let at = |v: u32| self.head.mesh.positions[v as usize] + self.all[v as usize];
            let [a, b, c] = t.corners.map(at);
            let (by_b, by_c) = ((c - a).cross(&t.normal), t.normal.cross(&(b - a)));
            let lacks = t.wanted - by_c.dot(&(c - a));
            let by = [-by_b - by_c, by_b, by_c];
            let moves = t.corners.map(|v| self.free(v));
            let free = || (0..3).filter(|&k| moves[k]);
            let size: f64 = free().map(|k| by[k].norm_squared()).sum();
            if lacks > 0.0 && size > 0.0 {
                for k in free() {
                    let v = t.corners[k];
                    self.put(v, self.all[v as usize] + by[k] * (lacks / size));
                }
            }
        }
    }

    /// Half of the way to the mean of the neighbours.
    fn smooth(&mut self, patch: &[u32]) {
        let inside: Vec<u32> = patch.iter().copied().filter(|&v| self.free(v)).collect();
        let mean = |&v: &u32| {
            let ring = self.head.rings.of(v as usize);
            let sum: Vec3 = ring.iter().map(|&o| self.all[o as usize]).sum();
            (self.all[v as usize] + sum / ring.len() as f64) / 2.0
        };
        let smoothed: Vec<Vec3> = inside.iter().map(mean).collect();
        for (v, all) in inside.into_iter().zip(smoothed) {
            self.put(v, all);
        }
    }

    /// Halves the displacement where triangles are inverted, and less and less of it within `rings` of them.
    fn take_back(&mut self, inverted: &[Flattened], rings: usize) {
        let turned = inverted.iter().filter(|t| t.inverted);
        let from: Vec<u32> = turned.flat_map(|t| t.corners).collect();
        let reached = rings_about(&self.head.rings, &from, rings + 1);
        for (ring, some) in reached.iter().enumerate() {
            let share = 0.5 * (1.0 - ring as f64 / reached.len() as f64);
            for &v in some {
                let kept = self.d[v as usize] * (1.0 - share);
                self.put(v, self.below(v) + kept);
            }
        }
    }

    /// Turning and smoothing must not bring back what the contacts have mended.
    fn part(&mut self, patch: &mut Vec<u32>) {
        let mut touched = self.contacts.sunk(self.d, self.target);
        touched.retain(|(v, _)| !self.held[*v as usize]);
        touched.extend(self.contacts.crossed(self.d, self.base));
        for (v, moved) in touched {
            if self.area[v as usize] {
                self.put(v, moved + self.below(v));
                patch.push(v);
            }
        }
        self.widen(patch, 0);
    }
}

/// Some vertices, their neighbours, the neighbours of these and so on: each vertex once, by its distance in edges.
pub(super) fn rings_about(rings: &Rings, some: &[u32], most: usize) -> Vec<Vec<u32>> {
    let mut seen: std::collections::HashSet<u32> = some.iter().copied().collect();
    let mut out = vec![seen.iter().copied().collect::<Vec<u32>>()];
    for ring in 0..most {
        let near = out[ring].iter().flat_map(|&v| rings.of(v as usize));
        let next = near.copied().filter(|&v| seen.insert(v)).collect();
        out.push(next);
    }
    out
}
