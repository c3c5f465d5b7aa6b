//! The skin of one shape: its area of influence, the solve, and contacts until nothing touches.
//!
//! * lids: both lid lines go to one common line, on paths lifted around the eyeball ([`goals`]); skin that would sink
//!   into the ball deeper than it was (or than a margin) is lifted out, held, and the shape is solved again;
//! * lips that crossed are parted, and what lies behind lips and lids stays behind the skin before it;
//! * jaw: the lower half of the mouth's inside moves rigidly with it, and would otherwise hang as a sheet in the open mouth.
//!
//! Units: the mesh's. Cost: one factor of the area, and up to two of what lies around contacts.
//! Limits: only the front half of a ball counts; behind its widest part the socket's skin is out of sight. Contact holds at full weight; half way a lid's straight path may dip below the margin.

use std::collections::BTreeMap;

use rayon::prelude::*;

use super::head::{Head, LANDMARKS, LIP_FREE};
use super::jaw::turned;
use super::mesh::{Nearest, Vec3, extent_of};
use super::seam::{along, near_corner};
use super::shape::Target;
use super::solve::{DISC, EDGE, FULL, REACH, ROUNDS, System};
use mien_workbench::fault::Fault;

/// A derived point that moves by a whole eye distance speaks for no skin further than this, in eye distances.
const DERIVED_REACH: f64 = 2.9;
/// Skin nearer than this to a lid line that closes takes part, in eye distances.
const BESIDE_LID: f64 = 0.22;
/// Lids that shut slide towards the nose by at most this part of their length, as three of four artists have it.
const SLIDE: f64 = 0.04;
/// The upper lid's line ends this part of both rims' height below the lower lid's: lines that only meet leave a groove between
/// the rims.
const LAP: f64 = 0.25;
/// Rounds of lifting sunk lid skin and parting crossed lips.
const CONTACT_ROUNDS: usize = 2;
/// Skin within this of what touched is solved again, in eye distances.
const CONTACT_REACH: f64 = 0.4;

/// What skin is expected to do beyond the solve counts fully where the influence is this much above the edge's, in eye
/// distances: 0.1 mm.
const FADES: f64 = 0.003;

/// Height that moving lid skin keeps above the eyeball, in eye distances: a lid's edge is not thinner.
const LID_MARGIN: f64 = 0.012;
/// Skin further than this from the ball's centre cannot sink into it, in eye distances.
const BALL_REACH: f64 = 0.75;
/// Skin that sank by less than this is left, in eye distances: 4 micrometres.
const SUNK: f64 = 1e-4;
/// Lips that cross by less than this are left, in eye distances: 0.05 mm.
const TOUCH: f64 = 0.0015;
/// The mouth's inside can come through skin no further before it than this, and stays this far behind it, in eye distances.
const AT_LINE: f64 = 0.1;
const BEFORE: f64 = 0.2;
const BEHIND: f64 = 0.015;
/// Between the vertices of a coarse mesh the skin lies nearer to the mouth's inside than at them. Where the skin slides, the inside
/// keeps this part of the slide, of an edge at most, as additional distance …
const BETWEEN: f64 = 0.5;
/// … less this, in eye distances: fine meshes need none.
const FINE: f64 = 0.02;

/// What can touch what on one head, measured on the neutral.
pub(super) struct Contacts<'a> {
    pub(super) head: &'a Head,
    /// Skin near an eyeball: its side, the vertex and the height above the ball it must keep.
    beside: Vec<(usize, u32, f64)>,
    /// Height of the upper above the lower inner lip line.
    lips: Vec<f64>,
    /// The mouth's inside: vertex, the nearest of the skin before it, and how far behind that it must stay.
    inside: Vec<(u32, u32, f64)>,
    /// Corners of the skin's faces: vertex, the one after and the one before it in the face; ascending.
    corners: Vec<[u32; 3]>,
    /// Each derived point with the skin around it: distance and vertex, ascending.
    around: Vec<(u32, Vec<(f64, u32)>)>,
}

impl<'a> Contacts<'a> {
    /// Of one head.
    pub(super) fn new(head: &'a Head) -> Self {
        let w = head.eye_distance;
        let mut beside = Vec::new();
        for (side, ball) in head.balls.iter().enumerate() {
            let Some(ball) = ball else { continue };
            let positions = head.mesh.positions.iter().enumerate();
            let near = positions
                .filter(|&(v, p)| head.skin[v] && (p - ball.center).norm() <= BALL_REACH * w);
            let height = |p| ball.height(p).min(LID_MARGIN * w);
            beside.extend(near.map(|(v, p)| (side, v as u32, height(p))));
        }
        let mut corners = Vec::new();
        for f in (0..head.mesh.faces()).filter(|&f| !head.film[f]) {
            let face = head.mesh.face(f);
            let of = |k: usize| face[k % face.len()].vertex;
            let all = (0..face.len()).map(|k| [of(k), of(k + 1), of(k + face.len() - 1)]);
            corners.extend(all.filter(|c| head.outside(c[0])));
        }
        corners.sort_unstable();
        let gaps = head.lip_gaps(|v| head.mesh.positions[v as usize]);
        let mut out = Self {
            head,
            beside,
            lips: gaps.into_iter().map(|(.., gap)| gap).collect(),
            inside: Vec::new(),
            corners,
            around: around_derived(head),
        };
        out.inside = out.behind_skin();
        out
    }

    /// The mouth's inside where skin is close before it.
    fn behind_skin(&self) -> Vec<(u32, u32, f64)> {
        let (head, w) = (self.head, self.head.eye_distance);
        let at = |v: u32| head.mesh.positions[v as usize];
        let skin = (0..head.skin.len() as u32).filter(|&v| head.skin[v as usize]);
        let (outside, inside): (Vec<u32>, Vec<u32>) = skin.partition(|&v| head.outside(v));
        let nearest = Nearest::new(&head.mesh.positions, &outside);
        let close = inside.into_iter().filter_map(|v| {
            let before = nearest.of(&at(v))?;
            let apart = at(before) - at(v);
            let behind = apart.dot(&self.normal(before, &at));
            let from_line = head.from_lips[v as usize].min(2.0 * head.from_lids[v as usize]);
            let close = apart.norm() < BEFORE * w && f64::from(from_line) > AT_LINE * w;
            (close && behind > -BEHIND * w).then(|| (v, before, behind.min(BEHIND * w)))
        });
        close.collect()
    }

    /// On the line of lips or lids or beside it: what is nearest to it may be seen between them.
    fn at_line(&self, v: u32) -> bool {
        let seams = || [&self.head.lips].into_iter().chain(&self.head.lids);
        let on = |v: &u32| seams().any(|seam| seam.both().any(|o| o == *v));
        on(&v) || self.head.rings.of(v as usize).iter().any(on)
    }

    /// Normal of the skin at a vertex, by the ring around it.
    fn normal(&self, v: u32, at: &impl Fn(u32) -> Vec3) -> Vec3 {
        let first = self.corners.partition_point(|c| c[0] < v);
        let corners = self.corners[first..].iter().take_while(|c| c[0] == v);
        let sum: Vec3 = corners
            .map(|&[_, a, b]| (at(a) - at(v)).cross(&(at(b) - at(v))))
            .sum();
        sum.try_normalize(0.0).unwrap_or_default()
    }

    /// Vertices of the mouth's inside that came through the skin, moved back behind it: nobody sees them there.
    pub(super) fn pierced(&self, d: &[Vec3], base: Option<&[Vec3]>) -> Vec<(u32, Vec3)> {
        let (head, w) = (self.head, self.head.eye_distance);
        let at = head.moved(d, base);
        let was = |v: u32| head.mesh.positions[v as usize];
        let mut found = Vec::new();
        for &(v, before, behind) in &self.inside {
            if d[v as usize] == Vec3::zeros() && d[before as usize] == Vec3::zeros() {
                continue;
            }
            let (p, mut skin) = (at(v), before);
            // The skin has slid along: what is nearest now is a few edges away.
            let far = |o: u32| (at(o) - p).norm_squared();
            loop {
                let ring = head.rings.of(skin as usize).iter();
                let ring = ring.filter(|&&o| self.head.outside(o));
                match ring.min_by(|&&a, &&b| far(a).total_cmp(&far(b))) {
                    Some(&nearer) if far(nearer) < far(skin) => skin = nearer,
                    _ => break,
                }
            }
            let normal = self.normal(skin, &at);
            let depth = (at(skin) - p).dot(&normal);
            let slid = at(before) - p - (was(before) - was(v));
            let ring = head.rings.of(skin as usize).iter();
            let edge = ring.map(|&o| (at(o) - at(skin)).norm()).fold(0.0, f64::max);
            // On a coarse mesh the skin between vertices may lie nearer than any vertex.
            let between = (BETWEEN * slid.norm().min(edge) - FINE * w).max(0.0);
            let near = far(skin).sqrt() < edge.max(0.5 * BEFORE * w);
            if depth < behind.min(0.0) + between && near && !self.at_line(skin) {
                found.push((v, d[v as usize] - normal * (behind + between - depth)));
            }
        }
        found
    }

    /// Skin vertices that sank into an eyeball, turned as the shape turns it, deeper than before (or than the margin), with the
    /// displacement that cures it.
    pub(super) fn sunk(&self, d: &[Vec3], target: &Target) -> Vec<(u32, Vec3)> {
        let head = self.head;
        let out = head.axes.column(2);
        let balls = [0, 1].map(|side: usize| {
            let ball = head.balls[side].as_ref()?;
            Some(ball.turned(target.gaze[side].as_ref()))
        });
        let sunk = self.beside.iter().filter_map(|&(side, v, least)| {
            let (ball, moved) = (balls[side].as_ref()?, d[v as usize]);
            let p = head.mesh.positions[v as usize];
            let there = p + moved;
            let sank = moved != Vec3::zeros()
                && (there - ball.center).dot(&out) >= 0.0
                && ball.height(&there) < least - SUNK * head.eye_distance;
            sank.then(|| (v, ball.lifted(&there, least) - p))
        });
        sunk.collect()
    }

    /// Vertices of the inner lip lines that passed the other lip further than in the neutral, each half of the way back.
    pub(super) fn crossed(&self, d: &[Vec3], base: Option<&[Vec3]>) -> Vec<(u32, Vec3)> {
        let head = self.head;
        let up = head.axes.column(1).into_owned();
        let now = head.lip_gaps(head.moved(d, base));
        let both = self.lips.iter().zip(now);
        let crossed = both.filter_map(|(&before, (upper, lower, now))| {
            let excess = before.min(0.0) - now;
            let back = up * (excess / 2.0);
            let [above, below] = [upper, lower].map(|v| d[v as usize]);
            let moves = above != Vec3::zeros() || below != Vec3::zeros();
            let crosses = moves && excess > TOUCH * head.eye_distance;
            crosses.then(|| [(upper, above + back), (lower, below - back)])
        });
        crossed.flatten().collect()
    }
}

/// The derived points, each with the skin around it by distance.
fn around_derived(head: &Head) -> Vec<(u32, Vec<(f64, u32)>)> {
    let positions = &head.mesh.positions;
    let around = |&point: &u32| {
        let p = positions[point as usize];
        let far = |v: usize| ((positions[v] - p).norm(), v as u32);
        let skin = (0..positions.len()).filter(|&v| head.skin[v]).map(far);
        let mut near: Vec<_> = skin
            .filter(|(far, _)| *far < DERIVED_REACH * head.eye_distance)
            .collect();
        near.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
        (point, near)
    };
    head.points[LANDMARKS..].par_iter().map(around).collect()
}

/// All control vertices of a shape with their displacements.
pub(super) fn goals(head: &Head, target: &Target) -> BTreeMap<u32, Vec3> {
    let mut goal: BTreeMap<u32, Vec3> = target.controls.iter().copied().collect();
    let at = |v: u32| head.mesh.positions[v as usize];
    for (side, inwards) in [-SLIDE, SLIDE].into_iter().enumerate() {
        let seam = &head.lids[side];
        let lines = [&seam.upper, &seam.lower];
        if let Some((amount, line)) = target.close[side] {
            let corners = [0, seam.upper.len() - 1].map(|k| goal.get(&seam.upper[k]).copied());
            let [right, left] = corners.map(Option::unwrap_or_default);
            let lap = head.axes.column(1) * (LAP * head.lid_rim[side]);
            for (own, lap) in lines.into_iter().zip([lap, Vec3::zeros()]) {
                for (v, t) in along(own, at) {
                    // The slide is largest in the middle of the lid and 0 at its corners.
                    let (p, slide) = (at(v), inwards * 4.0 * t * (1.0 - t));
                    let across = seam.across(&head.mesh, &p) + slide;
                    let [u, l] = lines.map(|line| seam.on_line(&head.mesh, line, across));
                    // Both lines go to the same curve; the depth there is the ball's, given below.
                    let meeting = l + (u - l) * line - lap;
                    // What a corner moves fades along the lid with the third power of the way.
                    *goal.entry(v).or_default() += (meeting - p) * (amount * near_corner(t))
                        + right * (1.0 - t).powi(3)
                        + left * t.powi(3);
                }
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
    /// How the jaw moves the skin.
    pub(super) jaw: Option<&'a [Vec3]>,
}

/// Where one shape's vertices must go and how strongly it acts on each.
struct Asked {
    goal: BTreeMap<u32, Vec3>,
    /// Influence, mesh units.
    u: Vec<f64>,
    area: Vec<bool>,
}

impl Placing<'_> {
    /// What is asked of the skin; `u` is the influence of the landmarks.
    fn asked(&self, u: &[f64]) -> Asked {
        let (head, edge) = (self.contacts.head, EDGE * self.contacts.head.eye_distance);
        let mut asked = Asked {
            goal: goals(head, self.target),
            u: u.to_vec(),
            area: Vec::new(),
        };
        self.derived_points_act(&mut asked);
        self.lids_act(&mut asked);
        let shuts = self.target.close.iter().any(Option::is_some);
        // In a shape without a jaw, the skin deep in the mouth stays.
        let still =
            |v: usize| shuts && head.lines_socket(v) || self.target.still_inside && head.deep(v);
        let inside = |v: usize| head.skin[v] && asked.u[v] > edge && !still(v);
        asked.area = (0..asked.u.len()).map(inside).collect();
        for (inside, moved) in asked.area.iter_mut().zip(self.jaw.into_iter().flatten()) {
            *inside |= *moved != Vec3::zeros();
        }
        self.mouth_follows_jaw(&mut asked);
        self.lips_go_back(&mut asked);
        asked
    }

    /// The system of the shape: on its area, with all that it moves given; derived points are only pinned if it is also solved by
    /// its landmarks alone.
    ///
    /// # Errors
    /// If it is singular.
    pub(super) fn system(&self, u: &[f64], also_alone: bool) -> Result<System, Fault> {
        let (head, asked) = (self.contacts.head, self.asked(u));
        let derived = if also_alone {
            &head.points[LANDMARKS..]
        } else {
            &[]
        };
        let given = asked.goal.into_keys().filter(|v| !derived.contains(v));
        let system = System::new(&head.operator, &asked.area, given)?;
        Ok(system.with_pins(derived.iter().copied()))
    }

    /// Places the skin; `u` is the influence of the landmarks, `beyond` what the skin is expected to do beyond the solve: the
    /// energy then is that of the difference, inside the area.
    ///
    /// # Errors
    /// If a system is singular.
    pub(super) fn place(
        &self,
        u: &[f64],
        beyond: Option<&[Vec3]>,
        system: &System,
    ) -> Result<Solved, Fault> {
        let (head, edge) = (self.contacts.head, EDGE * self.contacts.head.eye_distance);
        let mut asked = self.asked(u);
        // Towards the area's edge what is expected fades, so that outside nothing moves at all.
        let fades = FADES * head.eye_distance;
        let fade = |v: usize| ((asked.u[v] - edge) / fades).clamp(0.0, 1.0);
        let share = |v: usize| if asked.area[v] { fade(v) } else { 0.0 };
        let beyond = beyond.into_iter().flatten().enumerate();
        let beyond = beyond.map(|(v, d)| d * share(v)).collect();
        let beyond: Vec<Vec3> = self.jaw.map_or(beyond, <[Vec3]>::to_vec);
        let mut d = vec![Vec3::zeros(); asked.u.len()];
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
        let w = self.contacts.head.eye_distance;
        for (point, around) in &self.contacts.around {
            let Some(size) = asked.goal.get(point).map(Vec3::norm) else {
                continue;
            };
            let reach = REACH * w;
            // Beyond this the point speaks of less than the area's edge.
            let last = DISC * w + reach * (size / (EDGE * w)).ln();
            for (far, v) in around.iter().take_while(|near| near.0 < last) {
                let u = &mut asked.u[*v as usize];
                *u = u.max(size * (-(far - DISC * w).max(0.0) / reach).exp());
            }
        }
    }

    /// Closed lid lines influence the skin beside them.
    fn lids_act(&self, asked: &mut Asked) {
        let (head, positions) = (self.contacts.head, &self.contacts.head.mesh.positions);
        for side in (0..2).filter(|&s| self.target.close[s].is_some()) {
            let reach = BESIDE_LID * head.eye_distance;
            let acts = |v: u32| Some((positions[v as usize], asked.goal.get(&v)?.norm()));
            let line: Vec<(Vec3, f64)> = head.lids[side].both().filter_map(acts).collect();
            let apart = apart(extent_of(line.iter().map(|(p, _)| p)), reach);
            let near = |&k: &usize| head.skin[k] && !apart(&positions[k]);
            for k in (0..positions.len()).filter(near) {
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
                let moved = turned(jaw, &head.mesh.positions[v]) * share;
                asked.goal.entry(v as u32).or_insert(moved);
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
        let delta = |v: usize| (asked.u[v] / (FULL * head.eye_distance)).min(1.0);
        put(d);
        for (d, beyond) in d.iter_mut().zip(beyond) {
            *d -= beyond;
        }
        let is_pinned = |v: u32| asked.goal.contains_key(&v);
        system.deform(&head.operator, d, is_pinned, delta, ROUNDS);
        for (d, beyond) in d.iter_mut().zip(beyond) {
            *d += beyond;
        }
        put(d);
    }

    /// Lifts sunk lid skin, puts the mouth's inside back behind the skin, parts crossed lips, and solves what lies around them again;
    /// further away their effect has faded.
    fn part(&self, asked: &mut Asked, beyond: &[Vec3], d: &mut [Vec3]) -> Result<(), Fault> {
        let (head, positions) = (self.contacts.head, &self.contacts.head.mesh.positions);
        for round in 0..=CONTACT_ROUNDS {
            let sunk = self.contacts.sunk(d, self.target);
            let mut touched = self.contacts.pierced(d, self.base);
            touched.extend(sunk);
            if round == CONTACT_ROUNDS {
                for &(v, moved) in &touched {
                    d[v as usize] = moved;
                }
                asked.goal.extend(touched);
                break;
            }
            touched.extend(self.contacts.crossed(d, self.base));
            if touched.is_empty() {
                break;
            }
            let places = touched.iter().map(|&(v, _)| &positions[v as usize]);
            let apart = apart(extent_of(places), CONTACT_REACH * head.eye_distance);
            let area = asked.area.iter().zip(positions);
            let around: Vec<bool> = area.map(|(&inside, p)| inside && !apart(p)).collect();
            asked.goal.extend(touched);
            let system = System::new(&head.operator, &around, asked.goal.keys().copied())?;
            self.solve(&system, asked, beyond, d);
        }
        Ok(())
    }
}
