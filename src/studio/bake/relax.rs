//! Inverted triangles smoothed away.
//!
//! The displacement is smoothed in a patch that takes in what is inverted and grows while that lasts. Equal displacements
//! cannot invert anything, so a large enough patch ends it; what the recipe asked for gives way by what that takes, except
//! lid lines that meet.
//!
//! Units: the mesh's. Cost: a few sweeps over the patch per round; nothing outside the patch is looked at twice.
//! Degenerate case: what is inverted after the last round stays so and is counted in the report.

use super::contact::Contacts;
use super::head::Head;
use super::mesh::Vec3;
use super::recipe::Target;
use super::skin::Solved;
use super::surroundings::Surroundings;

/// Rounds of smoothing around inverted triangles.
const ROUNDS: usize = 72;
/// Rounds after which the smoothed patch grows by a ring.
const GROW_EVERY: usize = 3;
/// Sweeps in a round, at most: with one, a large patch would take as many rounds as it has rings. The first rounds have fewer,
/// so that what only just is inverted is only just mended: another rounding of the mesh must not make another shape.
const SWEEPS: usize = 16;

/// Vertices with marks.
struct Patch {
    inside: Vec<bool>,
    list: Vec<u32>,
}

impl Patch {
    fn add(&mut self, v: u32) {
        if !self.inside[v as usize] {
            self.inside[v as usize] = true;
            self.list.push(v);
        }
    }
}

/// Smooths until no triangle of the skin is inverted; `base` is the displacement of the shape this one is added to.
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
    let positions = &head.mesh.positions;
    let below = |v: usize| base.map_or(Vec3::zeros(), |b| b[v]);
    // What is seen is this shape upon the other one: that is what has to be smooth.
    let mut all: Vec<Vec3> = (0..n).map(|v| d[v] + below(v)).collect();
    let mut scratch = around.scratch();
    let changed: Vec<u32> = (0..n as u32)
        .filter(|&v| all[v as usize] != Vec3::zeros())
        .collect();
    let mut some = around.seeing(head, &changed, &mut scratch);
    let (mut inverted, _) = around.inverted(head, &|v| positions[v] + all[v], &some, &mut scratch);
    if inverted.is_empty() {
        return;
    }
    let closes = target.close.iter().flatten().any(|c| c.0 > 0.99);
    let mut held = vec![false; n];
    // Lids that meet stay so, and lids that follow a gaze follow it: what gives way is the skin behind them.
    for (side, seam) in head.lids.iter().enumerate() {
        let shut = target.close[side].is_some_and(|(amount, _)| amount > 0.99);
        if shut || target.gaze[side].is_some() {
            for v in seam.both() {
                let t = seam.across(&head.mesh, &positions[v as usize]);
                held[v as usize] = (0.07..0.93).contains(&t);
            }
        }
    }
    let mut patch = Patch {
        inside: vec![false; n],
        list: Vec::new(),
    };
    let mut smoothed: Vec<Vec3> = Vec::new();
    for round in 0..ROUNDS {
        for &v in inverted.iter().flatten() {
            patch.add(v);
            for &o in head.rings.of(v as usize) {
                patch.add(o);
            }
            // What cannot be had with lids that meet gives way at last, vertex by vertex.
            if round >= ROUNDS / 2 {
                held[v as usize] = false;
            }
        }
        if round % GROW_EVERY == GROW_EVERY - 1 {
            for k in 0..patch.list.len() {
                for &o in head.rings.of(patch.list[k] as usize) {
                    patch.add(o);
                }
            }
        }
        // Slivers in a fold outlast all smoothing: in the second half they and more and more around them move as one,
        // except at lids that meet, which that would open.
        let together = if closes {
            0
        } else {
            (round + 1).saturating_sub(ROUNDS / 2).div_ceil(GROW_EVERY)
        };
        let free = |v: u32| area[v as usize] && !held[v as usize];
        if together > 0 {
            for t in &inverted {
                let mut cluster = t.to_vec();
                for _ in 0..together {
                    for k in 0..cluster.len() {
                        cluster.extend(head.rings.of(cluster[k] as usize));
                    }
                    cluster.sort_unstable();
                    cluster.dedup();
                }
                cluster.retain(|&v| free(v));
                let sum: Vec3 = cluster.iter().map(|&v| all[v as usize]).sum();
                for &v in &cluster {
                    all[v as usize] = sum / cluster.len() as f64;
                    patch.add(v);
                }
            }
        } else {
            let inside: Vec<u32> = patch.list.iter().copied().filter(|&v| free(v)).collect();
            for _ in 0..SWEEPS.min(round + 1) {
                smoothed.clear();
                smoothed.extend(inside.iter().map(|&v| {
                    let ring = head.rings.of(v as usize);
                    let sum: Vec3 = ring.iter().map(|&o| all[o as usize]).sum();
                    (all[v as usize] + sum / ring.len() as f64) / 2.0
                }));
                for (&v, s) in inside.iter().zip(&smoothed) {
                    all[v as usize] = *s;
                }
            }
        }
        for &v in &patch.list {
            d[v as usize] = all[v as usize] - below(v as usize);
        }
        for (v, lifted) in contacts.sunk(d) {
            if !held[v as usize] {
                d[v as usize] = lifted;
                all[v as usize] = lifted + below(v as usize);
            }
        }
        // Smoothing must not bring back what the contacts have mended.
        for (v, parted) in contacts.crossed(d, base) {
            if area[v as usize] {
                d[v as usize] = parted;
                all[v as usize] = parted + below(v as usize);
                patch.add(v);
            }
        }
        // Only the patch has changed; what lies around it is unturned since the last look.
        some = around.seeing(head, &patch.list, &mut scratch);
        (inverted, _) = around.inverted(head, &|v| positions[v] + all[v], &some, &mut scratch);
        if inverted.is_empty() {
            break;
        }
    }
}
