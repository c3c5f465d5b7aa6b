//! Inverted triangles smoothed away.
//!
//! First a small patch is filled anew. Where that does not end it, the displacement is smoothed in a patch that takes in what
//! is inverted and grows while that lasts: equal displacements cannot invert anything, so a large enough patch ends it. What
//! the recipe asked for gives way by what that takes, except lid lines that meet or follow a gaze.
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

/// Rings around inverted triangles that are filled anew before smoothing begins to spread, and sweeps to fill them.
const MENDED_RINGS: usize = 6;
const MENDING_SWEEPS: usize = 60;

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

/// What mending a small place needs to know.
struct Nearby<'a> {
    head: &'a Head,
    around: &'a Surroundings,
    contacts: &'a Contacts<'a>,
    target: &'a Target,
    base: Option<&'a [Vec3]>,
    area: &'a [bool],
    held: &'a [bool],
}

impl Nearby<'_> {
    /// Fills a patch around what is inverted with the smoothest displacement that its edge allows, and begins anew with a larger
    /// one while that does not mend it. Says whether it did; if not, nothing has changed. So a few triangles cost a few rings
    /// of skin, whichever of them another rounding of the mesh turns over.
    fn mend(&self, inverted: &[[u32; 3]], all: &mut [Vec3], d: &mut [Vec3]) -> bool {
        let (head, before) = (self.head, (all.to_vec(), d.to_vec()));
        let below = |v: u32| self.base.map_or(Vec3::zeros(), |b| b[v as usize]);
        let mut scratch = self.around.scratch();
        let mut seeds: Vec<u32> = inverted.iter().flatten().copied().collect();
        for rings in 1..=MENDED_RINGS {
            all.copy_from_slice(&before.0);
            d.copy_from_slice(&before.1);
            let mut patch = Patch {
                inside: vec![false; all.len()],
                list: Vec::new(),
            };
            for &v in &seeds {
                patch.add(v);
            }
            for _ in 0..rings {
                for k in 0..patch.list.len() {
                    for &o in head.rings.of(patch.list[k] as usize) {
                        patch.add(o);
                    }
                }
            }
            let free = |v: &u32| self.area[*v as usize] && !self.held[*v as usize];
            let inside: Vec<u32> = patch.list.iter().copied().filter(free).collect();
            for _ in 0..MENDING_SWEEPS {
                for &v in &inside {
                    let ring = head.rings.of(v as usize);
                    let sum: Vec3 = ring.iter().map(|&o| all[o as usize]).sum();
                    all[v as usize] = sum / ring.len() as f64;
                }
            }
            for &v in &inside {
                d[v as usize] = all[v as usize] - below(v);
            }
            let mut touched = self.contacts.sunk(d, self.target);
            touched.retain(|(v, _)| !self.held[*v as usize]);
            touched.extend(self.contacts.crossed(d, self.base));
            for (v, moved) in touched {
                if self.area[v as usize] {
                    d[v as usize] = moved;
                    all[v as usize] = moved + below(v);
                    patch.add(v);
                }
            }
            let some = self.around.seeing(head, &patch.list, &mut scratch);
            let moved = |v: usize| head.mesh.positions[v] + all[v];
            let (now, _) = self.around.inverted(head, &moved, &some, &mut scratch);
            if now.is_empty() {
                return true;
            }
            seeds.extend(now.iter().flatten());
            seeds.sort_unstable();
            seeds.dedup();
        }
        all.copy_from_slice(&before.0);
        d.copy_from_slice(&before.1);
        false
    }
}

/// Smooths until no triangle of the skin is inverted; `base` is the displacement of the shape this one is added to.
/// Long because it is one loop whose rounds hand on patch, displacement and what is still inverted.
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
    let nearby = Nearby {
        head,
        around,
        contacts,
        target,
        base,
        area,
        held: &held,
    };
    if nearby.mend(&inverted, &mut all, d) {
        return;
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
        // Slivers in a fold outlast all smoothing: in the second half they and more and more around them move as one; at lids
        // that meet they alone do, as more would open these.
        let late = (round + 1).saturating_sub(ROUNDS / 2);
        let together = if closes { 0 } else { late.div_ceil(GROW_EVERY) };
        let free = |v: u32| area[v as usize] && !held[v as usize];
        if late > 0 {
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
        for (v, lifted) in contacts.sunk(d, target) {
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
