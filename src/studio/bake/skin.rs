//! The skin of one shape: its area of influence, the solve, and contacts until nothing touches.
//!
//! * lids: both lid lines go to one common line, on paths lifted around the eyeball ([`goals`]); skin that would sink
//!   into the ball deeper than it was (or than a margin) is lifted out, held, and the shape is solved again;
//! * jaw: the lower half of the mouth's inside moves rigidly with it, and would otherwise hang as a sheet in the open mouth.
//!
//! Units: the mesh's. Cost: one factor of the area, up to three for lids.
//! Limits: contact holds at full weight; half way a lid's straight path may dip below the margin.

use std::collections::BTreeMap;

use super::contact::{Contacts, LID_MARGIN};
use super::head::{Head, LIP_FREE};
use super::mesh::{Vec3, extent_of};
use super::names::LANDMARKS;
use super::recipe::Target;
use super::solve::{DISC, EDGE, FULL, REACH, ROUNDS, System, unknown};
use crate::base::geometry::smoothstep;
use crate::studio::fault::Fault;

/// Skin nearer than this to a lid line that closes takes part, in eye distances.
const BESIDE_LID: f64 = 0.22;
/// Rounds of lifting sunk lid skin and parting crossed lips.
const CONTACT_ROUNDS: usize = 2;
/// Skin within this of what touched is solved again, in eye distances.
const CONTACT_REACH: f64 = 0.4;

/// What skin is expected to do beyond the solve counts fully where the influence is this much above the edge's, in eye
/// distances: 0.1 mm.
const FADES: f64 = 0.003;

/// All control vertices of a shape with their displacements.
pub(super) fn goals(head: &Head, target: &Target) -> BTreeMap<u32, Vec3> {
    let mut goal: BTreeMap<u32, Vec3> = target.controls.iter().copied().collect();
    let at = |v: u32| head.mesh.positions[v as usize];
    for side in 0..2 {
        let seam = &head.lids[side];
        let lines = [&seam.upper, &seam.lower];
        if let Some((amount, line)) = target.close[side] {
            for &v in lines.iter().flat_map(|line| &line[1..line.len() - 1]) {
                let p = at(v);
                let t = seam.across(&head.mesh, &p);
                let [u, l] = lines.map(|line| seam.on_line(&head.mesh, line, t));
                let meeting = l + (u - l) * line;
                // Both lines go to the same curve; the depth there is the ball's, given below.
                let moved = (meeting - p) * (amount * near_corner(t));
                *goal.entry(v).or_insert_with(Vec3::zeros) += moved;
            }
        }
        let Some(ball) = head.balls[side].as_ref().filter(|_| !target.exact) else {
            continue;
        };
        let turned = ball.turned(target.gaze[side].as_ref());
        for v in seam.both() {
            let Some(d) = goal.get_mut(&v).filter(|d| d.norm() > 0.0) else {
                continue;
            };
            let (p, moved) = (at(v), at(v) + *d);
            let least = match target.close[side] {
                // Lines that meet go to the same point, so that no lid stands before the other.
                Some((amount, _)) if amount > 0.99 => 2.0 * LID_MARGIN * head.eye_distance,
                _ => ball.height(&p).min(LID_MARGIN * head.eye_distance),
            };
            if turned.height(&moved) < least {
                *d = turned.lifted(&moved, least) - p;
            }
        }
    }
    goal
}

/// 1 along a lid line, falling to 0 at its ends, where the lids are one skin: `t` from 0 to 1 across.
fn near_corner(t: f64) -> f64 {
    smoothstep(0.0, 0.035, t) * smoothstep(1.0, 0.965, t)
}

/// Whether a place lies further than `reach` from a box.
fn apart((low, high): (Vec3, Vec3), reach: f64) -> impl Fn(&Vec3) -> bool {
    move |p| (p - p.sup(&low).inf(&high)).norm_squared() > reach * reach
}

/// The skin of one shape.
pub(super) struct Solved {
    /// Displacement of every vertex.
    pub(super) d: Vec<Vec3>,
    /// Vertices that could move.
    pub(super) area: Vec<bool>,
}

/// One shape to be placed.
pub(super) struct Placing<'a> {
    pub(super) contacts: &'a Contacts<'a>,
    pub(super) target: &'a Target,
    /// Displacement of the shape that this one takes back.
    pub(super) base: Option<&'a [Vec3]>,
}

/// Where one shape's vertices must go and how strongly it acts on each.
struct Asked {
    goal: BTreeMap<u32, Vec3>,
    /// Influence, mesh units.
    u: Vec<f64>,
    area: Vec<bool>,
}

impl Placing<'_> {
    /// Places the skin; `u` is the influence of the landmarks, `beyond` what the skin is expected to do beyond the solve: the
    /// energy then is that of the difference, inside the area. `kept` is the last system of the shape: by its landmarks alone it
    /// often has the same as whole.
    ///
    /// # Errors
    /// If a system is singular.
    pub(super) fn place(
        &self,
        u: &[f64],
        beyond: Option<&[Vec3]>,
        kept: &mut Option<System>,
    ) -> Result<Solved, Fault> {
        let (head, edge) = (self.contacts.head, EDGE * self.contacts.head.eye_distance);
        let mut asked = Asked {
            goal: goals(head, self.target),
            u: u.to_vec(),
            area: Vec::new(),
        };
        self.derived_points_act(&mut asked);
        self.lids_act(&mut asked);
        let shuts = self.target.close.iter().any(Option::is_some);
        let inside =
            |v: usize| head.skin[v] && asked.u[v] > edge && !(shuts && head.lines_socket(v));
        asked.area = (0..asked.u.len()).map(inside).collect();
        self.mouth_follows_jaw(&mut asked);
        self.lips_go_back(&mut asked);
        // Towards the area's edge what is expected fades, so that outside nothing moves at all.
        let fades = FADES * head.eye_distance;
        let fade = |v: usize| ((asked.u[v] - edge) / fades).clamp(0.0, 1.0);
        let share = |v: usize| if asked.area[v] { fade(v) } else { 0.0 };
        let beyond = beyond.into_iter().flatten().enumerate();
        let beyond: Vec<Vec3> = beyond.map(|(v, d)| d * share(v)).collect();
        let mut d = vec![Vec3::zeros(); asked.u.len()];
        let unknown = unknown(&asked.area, asked.goal.keys().copied());
        let system = match kept.take().filter(|kept| kept.unknown == unknown) {
            Some(same) => kept.insert(same),
            None => kept.insert(System::of(&head.operator, unknown)?),
        };
        self.solve(system, &asked, &beyond, &mut d);
        // A table of controls says itself how lids and lips go.
        if !self.target.exact {
            self.part(&mut asked, &beyond, &mut d)?;
        }
        let Asked { goal, mut area, .. } = asked;
        for &v in goal.keys() {
            area[v as usize] = true;
        }
        Ok(Solved { d, area })
    }

    /// Derived points speak for their surroundings by plain distance: they are few and far from lids and lips.
    fn derived_points_act(&self, asked: &mut Asked) {
        let head = self.contacts.head;
        let (w, positions) = (head.eye_distance, &head.mesh.positions);
        for v in &head.points[LANDMARKS..] {
            let Some(size) = asked.goal.get(v).map(Vec3::norm) else {
                continue;
            };
            let (reach, p) = (REACH * w, positions[*v as usize]);
            // Beyond this the point speaks of less than the area's edge.
            let last = DISC * w + reach * (size / (EDGE * w)).ln();
            for (k, u) in asked.u.iter_mut().enumerate() {
                let far = (positions[k] - p).norm_squared();
                if last > 0.0 && far < last * last && head.skin[k] {
                    let far = far.sqrt() - DISC * w;
                    *u = u.max(size * (-far.max(0.0) / reach).exp());
                }
            }
        }
    }

    /// Lid lines that are closed speak for the skin beside them, up to the corners, whose landmarks stay.
    fn lids_act(&self, asked: &mut Asked) {
        let (head, positions) = (self.contacts.head, &self.contacts.head.mesh.positions);
        for side in (0..2).filter(|&s| self.target.close[s].is_some()) {
            let reach = BESIDE_LID * head.eye_distance;
            let acts = |v: u32| Some((positions[v as usize], asked.goal.get(&v)?.norm()));
            let line: Vec<(Vec3, f64)> = head.lids[side].both().filter_map(acts).collect();
            for k in (0..positions.len()).filter(|&k| head.skin[k]) {
                let acts =
                    |(p, size): &(Vec3, f64)| size * (1.0 - (positions[k] - p).norm() / reach);
                asked.u[k] = line.iter().map(acts).fold(asked.u[k], f64::max);
            }
        }
    }

    /// The mouth's inside goes with the jaw, its lower half rigidly, except around the lips.
    fn mouth_follows_jaw(&self, asked: &mut Asked) {
        let (head, w) = (self.contacts.head, self.contacts.head.eye_distance);
        let Some(jaw) = &self.target.jaw else { return };
        for (v, &share) in head.socket.iter().enumerate() {
            let share = f64::from(share);
            if share.is_nan() {
                continue;
            }
            asked.area[v] = true;
            asked.u[v] = asked.u[v].max(EDGE * w * 1.01);
            if head.deep(v) {
                let p = head.mesh.positions[v];
                let moved = jaw.transform_point(&p.into()).coords - p;
                asked.goal.entry(v as u32).or_insert(moved * share);
            }
        }
    }

    /// Lips go back the way that the other shape took them; the inside stays where the jaw took it, except around them.
    fn lips_go_back(&self, asked: &mut Asked) {
        let (head, w) = (self.contacts.head, self.contacts.head.eye_distance);
        let (Some(base), Some((_, share))) = (self.base, &self.target.undo) else {
            return;
        };
        for v in head.lips.both() {
            asked.goal.insert(v, -base[v as usize] * *share);
        }
        for v in (0..asked.u.len()).filter(|&v| !head.socket[v].is_nan()) {
            asked.area[v] = f64::from(head.from_lips[v]) < 2.0 * LIP_FREE * w;
        }
    }

    fn solve(&self, system: &System, asked: &Asked, beyond: &[Vec3], d: &mut [Vec3]) {
        let put = |d: &mut [Vec3]| {
            for (&v, &moved) in &asked.goal {
                d[v as usize] = moved;
            }
        };
        let head = self.contacts.head;
        let full = FULL * head.eye_distance;
        let delta = |v: usize| (asked.u[v] / full).min(1.0);
        put(d);
        for (d, beyond) in d.iter_mut().zip(beyond) {
            *d -= beyond;
        }
        system.deform(&head.operator, &head.mesh.positions, d, delta, ROUNDS);
        for (d, beyond) in d.iter_mut().zip(beyond) {
            *d += beyond;
        }
        put(d);
    }

    /// Lifts sunk lid skin, parts crossed lips, and solves what lies around the contact again; further away its effect has faded.
    fn part(&self, asked: &mut Asked, beyond: &[Vec3], d: &mut [Vec3]) -> Result<(), Fault> {
        let (head, positions) = (self.contacts.head, &self.contacts.head.mesh.positions);
        for round in 0..=CONTACT_ROUNDS {
            let sunk = self.contacts.sunk(d, self.target);
            let mut crossed = self.contacts.crossed(d, self.base);
            crossed.extend(self.contacts.pierced(d, self.base));
            if sunk.is_empty() && crossed.is_empty() {
                break;
            }
            if round == CONTACT_ROUNDS {
                for (v, lifted) in sunk {
                    d[v as usize] = lifted;
                }
                asked.goal.extend(crossed);
                break;
            }
            let touched = sunk.iter().chain(&crossed);
            let places = touched.map(|&(v, _)| &positions[v as usize]);
            let apart = apart(extent_of(places), CONTACT_REACH * head.eye_distance);
            let area = asked.area.iter().zip(positions);
            let around: Vec<bool> = area.map(|(&inside, p)| inside && !apart(p)).collect();
            asked.goal.extend(sunk);
            asked.goal.extend(crossed);
            let system = System::new(&head.operator, &around, asked.goal.keys().copied())?;
            self.solve(&system, asked, beyond, d);
        }
        Ok(())
    }
}
