//! The skin of one shape: its area of influence, the solve, and contacts until nothing touches.
//!
//! * lids: both lid lines go to one common line, on paths lifted around the eyeball ([`super::goals`]); skin that would sink
//!   into the ball deeper than it was (or than a margin) is lifted out, held, and the shape is solved again;
//! * jaw: the lower half of the mouth's inside moves rigidly with it, and would otherwise hang as a sheet in the open mouth.
//!
//! Units: the mesh's. Cost: one factor of the area, up to three for lids.
//! Limits: contact holds at full weight; half way a lid's straight path may dip below the margin.

use std::collections::BTreeMap;

use super::contact::Contacts;
use super::goals::goals;
use super::head::Head;
use super::mesh::Vec3;
use super::names::LANDMARKS;
use super::recipe::Target;
use super::solve::{Settings, System};
use super::sparse::Singular;

/// Skin nearer than this to a lid line that closes takes part, in eye distances.
const BESIDE_LID: f64 = 0.22;
/// Rounds of lifting sunk lid skin and parting crossed lips.
const CONTACT_ROUNDS: usize = 2;
/// Skin within this of what touched is solved again, in eye distances.
const CONTACT_REACH: f64 = 0.4;
/// Inside of the mouth nearer than this to the lip line stays free, in eye distances, so that lips can roll.
const LIP_FREE: f64 = 0.2;

/// What skin is expected to do beyond the solve counts fully where the influence is this much above the edge's, in eye
/// distances: 0.1 mm.
const FADES: f64 = 0.003;

/// What lies further than `reach` from the box around some points.
struct Apart {
    low: Vec3,
    high: Vec3,
    reach: f64,
}

impl Apart {
    fn new(points: impl Iterator<Item = Vec3>, reach: f64) -> Self {
        let start = (Vec3::repeat(f64::INFINITY), Vec3::repeat(-f64::INFINITY));
        let (low, high) = points.fold(start, |(low, high), p| (low.inf(&p), high.sup(&p)));
        Self { low, high, reach }
    }

    fn is(&self, p: &Vec3) -> bool {
        (p - p.sup(&self.low).inf(&self.high)).norm_squared() > self.reach * self.reach
    }
}

/// The skin of one shape.
pub(super) struct Solved {
    /// Displacement of every vertex.
    pub(super) d: Vec<Vec3>,
    /// Vertices that could move.
    pub(super) area: Vec<bool>,
    /// Size of the largest system.
    pub(super) unknowns: usize,
}

/// The last system of a shape: the shape by its landmarks alone often has the same as the whole one.
#[derive(Default)]
pub(super) struct Kept(Option<(Vec<bool>, Vec<u32>, System)>);

impl Kept {
    /// The system of an area with these given vertices.
    fn system(
        &mut self,
        head: &Head,
        area: &[bool],
        goal: &BTreeMap<u32, Vec3>,
    ) -> Result<&System, Singular> {
        let same = |(known, given, _): &(Vec<bool>, Vec<u32>, System)| {
            known == area && goal.keys().eq(given)
        };
        if !self.0.as_ref().is_some_and(same) {
            let system = System::new(&head.operator, area, goal.keys().copied())?;
            self.0 = Some((area.to_vec(), goal.keys().copied().collect(), system));
        }
        Ok(&self.0.as_ref().expect("just made").2)
    }
}

/// Places the skin of one shape; `u` is its influence, `base` the displacement of the shape it takes back, `beyond` what the
/// skin is expected to do beyond the solve: the energy then is that of the difference, inside the area; `kept` what other solves
/// of the same shape left.
/// Long because it is one system of equations: unknowns, rows and right-hand sides are numbered as they are met.
///
/// # Errors
/// If a system is singular.
pub(super) fn skin(
    head: &Head,
    contacts: &Contacts,
    target: &Target,
    u: &[f64],
    settings: &Settings,
    base: Option<&[Vec3]>,
    beyond: Option<&[Vec3]>,
    kept: &mut Kept,
) -> Result<Solved, Singular> {
    let w = head.eye_distance;
    let positions = &head.mesh.positions;
    let mut goal = goals(head, target);
    let mut u = u.to_vec();
    // Derived points speak for their surroundings by plain distance: they are few and far from lids and lips.
    for v in &head.points[LANDMARKS..] {
        if let Some(size) = goal.get(v).map(Vec3::norm) {
            let (reach, p) = (settings.reach * w, positions[*v as usize]);
            // Beyond this the point speaks of less than the area's edge.
            let last = settings.disc * w + reach * (size / (settings.edge * w)).ln();
            for (k, u) in u.iter_mut().enumerate() {
                let far = (positions[k] - p).norm_squared();
                if last > 0.0 && far < last * last && head.skin[k] {
                    let far = far.sqrt() - settings.disc * w;
                    *u = u.max(size * (-far.max(0.0) / reach).exp());
                }
            }
        }
    }
    // Lid lines that are closed speak for the skin beside them, up to the corners, whose landmarks stay.
    for side in (0..2).filter(|&s| target.close[s].is_some()) {
        let seam = &head.lids[side];
        let reach = BESIDE_LID * w;
        let line: Vec<(Vec3, f64)> = seam
            .both()
            .filter_map(|v| Some((positions[v as usize], goal.get(&v)?.norm())))
            .collect();
        let apart = Apart::new(line.iter().map(|(p, _)| *p), reach);
        for (k, u) in u.iter_mut().enumerate().filter(|&(k, _)| head.skin[k]) {
            let q = positions[k];
            if apart.is(&q) {
                continue;
            }
            for (p, size) in &line {
                *u = u.max(size * (1.0 - (q - p).norm() / reach));
            }
        }
    }
    let mut area: Vec<bool> = (0..positions.len())
        .map(|v| head.skin[v] && u[v] > settings.edge * w)
        .collect();
    let by_lips = |v: usize, reach: f64| {
        let near = |l: u32| (positions[l as usize] - positions[v]).norm_squared() < reach * reach;
        head.lips.both().any(near)
    };
    if let Some(jaw) = &target.jaw {
        for v in 0..positions.len() {
            let share = f64::from(head.socket[v]);
            if share.is_nan() {
                continue;
            }
            area[v] = true;
            u[v] = u[v].max(settings.edge * w * 1.01);
            if !(0.05..=0.95).contains(&share) && !by_lips(v, LIP_FREE * w) {
                let p = positions[v];
                let moved = jaw.transform_point(&p.into()).coords - p;
                goal.entry(v as u32).or_insert(moved * share);
            }
        }
    }
    if let (Some(base), Some((_, share))) = (base, &target.undo) {
        for v in head.lips.both() {
            goal.insert(v, -base[v as usize] * *share);
        }
        for v in 0..positions.len() {
            // The inside stays where the jaw took it, except around the lips.
            if !head.socket[v].is_nan() {
                area[v] = by_lips(v, 2.0 * LIP_FREE * w);
            }
        }
    }
    // Towards the area's edge what is expected fades, so that outside nothing moves at all.
    let fade = |v: usize| ((u[v] - settings.edge * w) / (FADES * w)).clamp(0.0, 1.0);
    let beyond: Option<Vec<Vec3>> = beyond.map(|beyond| {
        let faded = beyond.iter().enumerate();
        faded
            .map(|(v, d)| if area[v] { d * fade(v) } else { Vec3::zeros() })
            .collect()
    });
    let full = settings.full * w;
    let delta = |v: usize| (u[v] / full).min(1.0);
    let solve = |system: &System, goal: &BTreeMap<u32, Vec3>, d: &mut [Vec3]| {
        for (&v, &moved) in goal {
            d[v as usize] = moved;
        }
        for (d, beyond) in d.iter_mut().zip(beyond.iter().flatten()) {
            *d -= beyond;
        }
        system.deform(&head.operator, positions, d, delta, settings.rounds);
        for (d, beyond) in d.iter_mut().zip(beyond.iter().flatten()) {
            *d += beyond;
        }
        for (&v, &moved) in goal {
            d[v as usize] = moved;
        }
    };
    let mut d = vec![Vec3::zeros(); positions.len()];
    let system = kept.system(head, &area, &goal)?;
    let unknowns = system.unknowns();
    solve(system, &goal, &mut d);
    // A table of controls says itself how lids and lips go.
    for round in (0..=CONTACT_ROUNDS).filter(|_| !target.exact) {
        let (sunk, crossed) = (contacts.sunk(&d, target), contacts.crossed(&d, base));
        if sunk.is_empty() && crossed.is_empty() {
            break;
        }
        if round == CONTACT_ROUNDS {
            for (v, lifted) in sunk {
                d[v as usize] = lifted;
            }
            goal.extend(crossed);
            break;
        }
        // Only what lies around the contact is solved again; further away its effect has faded.
        let mut around = area.clone();
        let apart = Apart::new(
            sunk.iter()
                .chain(&crossed)
                .map(|&(v, _)| positions[v as usize]),
            CONTACT_REACH * w,
        );
        for (v, inside) in around.iter_mut().enumerate() {
            *inside = *inside && !apart.is(&positions[v]);
        }
        goal.extend(sunk);
        goal.extend(crossed);
        let system = System::new(&head.operator, &around, goal.keys().copied())?;
        solve(&system, &goal, &mut d);
    }
    for &v in goal.keys() {
        area[v as usize] = true;
    }
    Ok(Solved { d, area, unknowns })
}
