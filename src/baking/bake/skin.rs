//! The skin of one shape: its area of influence, the solve, and resolution of contacts.
//!
//! * lids: both lid lines go to one common line, on paths lifted around the eyeball ([`goals`]); skin that would sink
//!   into the ball deeper than before (or than a margin) is lifted, constrained, and the shape is solved again;
//! * crossed lips are separated, and the mouth's inside stays behind the skin in front of it;
//! * jaw: the lower half of the mouth's inside moves rigidly with it, and would otherwise hang as a sheet in the open
//!   mouth.
//!
//! Units: the mesh's. Cost: one factor of the area, and up to two of the surroundings of contacts.
//! Limits: only the front half of a ball counts; behind its widest part the socket's skin is out of sight. Contact holds at full weight; half way a lid's straight path may dip below the margin.

use std::collections::BTreeMap;

use rayon::prelude::*;

use super::head::{Head, LANDMARKS, LIP_FREE};
use super::jaw::turned;
use super::mesh::{Nearest, Vec3, area_vector, bounding_box};
use super::seam::{along, near_corner};
use super::shape::Target;
use super::solve::{DISC, EDGE, FULL, REACH, ROUNDS, System};
use mien_workbench::fault::Fault;

/// Reach of a derived point that moves by a whole eye distance, in eye distances.
const DERIVED_REACH: f64 = 2.9;
/// Reach of a closing lid line over the skin beside it, in eye distances.
const BESIDE_LID: f64 = 0.22;
/// Largest slide of closing lids towards the nose as part of their length, as in the shapes of three of four artists.
const SLIDE: f64 = 0.04;
/// How far the upper lid's line ends below the lower's, as part of both rims' height: lines that only meet leave a
/// groove between the rims.
const LAP: f64 = 0.25;
/// Rounds of lifting sunk lid skin and separating crossed lips.
const CONTACT_ROUNDS: usize = 2;
/// Distance from contacts within which skin is solved again, in eye distances.
const CONTACT_REACH: f64 = 0.4;

/// Influence above the area's edge at which the residual counts fully, in eye distances: 0.1 mm.
const FADES: f64 = 0.003;

/// Height of moving lid skin above the eyeball, in eye distances: the thickness of a lid's edge.
const LID_MARGIN: f64 = 0.012;
/// Largest distance from the ball's centre at which skin is tested for sinking, in eye distances.
const BALL_REACH: f64 = 0.75;
/// Depth of sinking that is ignored, in eye distances: 4 micrometres.
const SUNK: f64 = 1e-4;
/// Crossing of lips that is ignored, in eye distances: 0.05 mm.
const TOUCH: f64 = 0.0015;
/// Distance from the lip line within which the mouth's inside is not tested against the skin, in eye distances.
const AT_LINE: f64 = 0.1;
/// Largest distance at which skin in front of the mouth's inside is tested, in eye distances.
const BEFORE: f64 = 0.2;
/// Distance that the mouth's inside keeps behind the skin, in eye distances.
const BEHIND: f64 = 0.015;
/// Additional distance where the skin slides, as part of the slide, at most of an edge: between the vertices of a
/// coarse mesh the skin lies nearer to the mouth's inside than at them.
const BETWEEN: f64 = 0.5;
/// Part of the additional distance [`BETWEEN`] that is waived, in eye distances: fine meshes need none.
const FINE: f64 = 0.02;

/// Possible contacts of one head, measured on the neutral.
pub(super) struct Contacts<'a> {
    pub(super) head: &'a Head,
    /// Skin near an eyeball: side, vertex, and least height above the ball.
    beside: Vec<(usize, u32, f64)>,
    /// Height of the upper above the lower inner lip line.
    lips: Vec<f64>,
    /// The mouth's inside: vertex, the nearest skin in front of it, and least distance behind that.
    inside: Vec<(u32, u32, f64)>,
    /// Corners of the skin's faces: vertex, the one after and the one before it in the face; ascending.
    corners: Vec<[u32; 3]>,
    /// Each derived point with the skin around it: distance and vertex, ascending.
    around: Vec<(u32, Vec<(f64, u32)>)>,
}

impl<'a> Contacts<'a> {
    /// Measures the neutral of one head.
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
        for f in (0..head.mesh.faces()).filter(|&f| !head.membrane[f]) {
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

    /// The mouth's inside with skin close in front of it.
    fn behind_skin(&self) -> Vec<(u32, u32, f64)> {
        let (head, w) = (self.head, self.head.eye_distance);
        let at = |v: u32| head.mesh.positions[v as usize];
        let skin = (0..head.skin.len() as u32).filter(|&v| head.skin[v as usize]);
        let (outside, inside): (Vec<u32>, Vec<u32>) = skin.partition(|&v| head.outside(v));
        let nearest = Nearest::new(&head.mesh.positions, &outside);
        let close = inside.into_iter().filter_map(|v| {
            let before = nearest.closest(&at(v))?;
            let apart = at(before) - at(v);
            let behind = apart.dot(&self.normal(before, &at));
            let from_line = head.from_lips[v as usize].min(2.0 * head.from_lids[v as usize]);
            let close = apart.norm() < BEFORE * w && f64::from(from_line) > AT_LINE * w;
            (close && behind > -BEHIND * w).then(|| (v, before, behind.min(BEHIND * w)))
        });
        close.collect()
    }

    /// Whether a vertex is on or next to the line of lips or lids, between which the inside may be visible.
    fn at_line(&self, v: u32) -> bool {
        let seams = || [&self.head.lips].into_iter().chain(&self.head.lids);
        let on = |v: &u32| seams().any(|seam| seam.both().any(|o| o == *v));
        on(&v) || self.head.rings.members(v as usize).iter().any(on)
    }

    /// Normal of the skin at a vertex, from its faces.
    fn normal(&self, v: u32, at: &impl Fn(u32) -> Vec3) -> Vec3 {
        let first = self.corners.partition_point(|c| c[0] < v);
        let corners = self.corners[first..].iter().take_while(|c| c[0] == v);
        let areas = corners.map(|c| area_vector(c.map(at)));
        areas.sum::<Vec3>().try_normalize(0.0).unwrap_or_default()
    }

    /// Vertices of the mouth's inside that pierce the skin, with the displacement that puts them back behind it,
    /// invisibly.
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
            // The skin has slid: the nearest vertex now is a few edges away.
            let far = |o: u32| (at(o) - p).norm_squared();
            loop {
                let ring = head.rings.members(skin as usize).iter();
                let ring = ring.filter(|&&o| self.head.outside(o));
                match ring.min_by(|&&a, &&b| far(a).total_cmp(&far(b))) {
                    Some(&nearer) if far(nearer) < far(skin) => skin = nearer,
                    _ => break,
                }
            }
            let normal = self.normal(skin, &at);
            let depth = (at(skin) - p).dot(&normal);
            let slid = at(before) - p - (was(before) - was(v));
            let ring = head.rings.members(skin as usize).iter();
            let edge = ring.map(|&o| (at(o) - at(skin)).norm()).fold(0.0, f64::max);
            // On a coarse mesh the skin may be nearer between its vertices.
            let between = (BETWEEN * slid.norm().min(edge) - FINE * w).max(0.0);
            let near = far(skin).sqrt() < edge.max(0.5 * BEFORE * w);
            if depth < behind.min(0.0) + between && near && !self.at_line(skin) {
                found.push((v, d[v as usize] - normal * (behind + between - depth)));
            }
        }
        found
    }

    /// Skin vertices that sank into an eyeball, rotated by the shape's gaze, deeper than before (or than the margin),
    /// with the corrected displacement.
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

    /// Vertices of the inner lip lines that cross the other lip more than in the neutral, each with half of the
    /// correction.
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
        let reach = DERIVED_REACH * head.eye_distance;
        let skin = (0..positions.len()).filter(|&v| head.skin[v]).map(far);
        let mut near: Vec<_> = skin.filter(|(far, _)| *far < reach).collect();
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
                    // Both lines go to the same curve, whose depth is the ball's, see below.
                    let meeting = l + (u - l) * line - lap;
                    // Displacements of a corner fade along the lid with the third power of the distance.
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
                // Lids that meet go to the same point, so that neither is in front.
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

/// A test whether a point lies further than `reach` from a box.
fn is_outside((low, high): (Vec3, Vec3), reach: f64) -> impl Fn(&Vec3) -> bool {
    move |p| (p - p.sup(&low).inf(&high)).norm_squared() > reach * reach
}

/// The skin of one shape.
pub(super) struct Solved {
    /// Displacement of every vertex.
    pub(super) d: Vec<Vec3>,
    /// Vertices that could move.
    pub(super) area: Vec<bool>,
}

/// The solve of one shape.
pub(super) struct Placing<'a> {
    pub(super) contacts: &'a Contacts<'a>,
    pub(super) target: &'a Target,
    /// Displacement of the subtracted shape.
    pub(super) base: Option<&'a [Vec3]>,
    /// Displacement of the skin by the jaw.
    pub(super) jaw: Option<&'a [Vec3]>,
}

/// Goals of a shape's vertices, and its influence on each.
struct Constraints {
    goal: BTreeMap<u32, Vec3>,
    /// Influence, mesh units.
    u: Vec<f64>,
    area: Vec<bool>,
}

impl Placing<'_> {
    /// Collects the constraints; `u` is the influence of the landmarks.
    fn constraints(&self, u: &[f64]) -> Constraints {
        let (head, edge) = (self.contacts.head, EDGE * self.contacts.head.eye_distance);
        let mut constraints = Constraints {
            goal: goals(head, self.target),
            u: u.to_vec(),
            area: Vec::new(),
        };
        self.derived_points_act(&mut constraints);
        self.lids_act(&mut constraints);
        let shuts = self.target.close.iter().any(Option::is_some);
        // Without a jaw, skin deep in the mouth is fixed.
        let still =
            |v: usize| shuts && head.lines_socket(v) || self.target.still_inside && head.deep(v);
        let inside = |v: usize| head.skin[v] && constraints.u[v] > edge && !still(v);
        constraints.area = (0..constraints.u.len()).map(inside).collect();
        let carried = self.jaw.into_iter().flatten();
        for (inside, moved) in constraints.area.iter_mut().zip(carried) {
            *inside |= *moved != Vec3::zeros();
        }
        self.mouth_follows_jaw(&mut constraints);
        self.lips_go_back(&mut constraints);
        constraints
    }

    /// The system of the shape's area with its constraints given; `also_alone`, derived points are only pinned, so
    /// that the same factor also solves the shape by its landmarks alone.
    ///
    /// # Errors
    /// If it is singular.
    pub(super) fn system(&self, u: &[f64], also_alone: bool) -> Result<System, Fault> {
        let (head, constraints) = (self.contacts.head, self.constraints(u));
        let free = if also_alone {
            LANDMARKS
        } else {
            head.points.len()
        };
        let derived = &head.points[free..];
        let given = constraints.goal.into_keys();
        let given = given.filter(|v| !derived.contains(v));
        let system = System::new(&head.operator, &constraints.area, given)?;
        Ok(system.with_pins(derived.iter().copied()))
    }

    /// Solves the skin; `u` is the influence of the landmarks, `residual` the learned displacement beyond the plain
    /// solve: the energy then is of the difference from it, inside the area.
    ///
    /// # Errors
    /// If a system is singular.
    pub(super) fn solved(
        &self,
        u: &[f64],
        residual: Option<&[Vec3]>,
        system: &System,
    ) -> Result<Solved, Fault> {
        let (head, edge) = (self.contacts.head, EDGE * self.contacts.head.eye_distance);
        let mut constraints = self.constraints(u);
        // The residual fades towards the area's edge, so that nothing moves outside.
        let fades = FADES * head.eye_distance;
        let fade = |v: usize| ((constraints.u[v] - edge) / fades).clamp(0.0, 1.0);
        let share = |v: usize| if constraints.area[v] { fade(v) } else { 0.0 };
        let residual = residual.into_iter().flatten().enumerate();
        let residual = residual.map(|(v, d)| d * share(v)).collect();
        let residual: Vec<Vec3> = self.jaw.map_or(residual, <[Vec3]>::to_vec);
        let mut d = vec![Vec3::zeros(); constraints.u.len()];
        self.solve(system, &constraints, &residual, &mut d);
        // A table of controls positions lids and lips itself.
        if !self.target.exact {
            self.separate(&mut constraints, &residual, &mut d)?;
        }
        let Constraints { goal, mut area, .. } = constraints;
        for &v in goal.keys() {
            area[v as usize] = true;
        }
        Ok(Solved { d, area })
    }

    /// Adds the influence of derived points by Euclidean distance: they are few and far from lids and lips.
    fn derived_points_act(&self, constraints: &mut Constraints) {
        let w = self.contacts.head.eye_distance;
        for (point, around) in &self.contacts.around {
            let Some(size) = constraints.goal.get(point).map(Vec3::norm) else {
                continue;
            };
            let reach = REACH * w;
            // Beyond this the influence is below the area's edge.
            let last = DISC * w + reach * (size / (EDGE * w)).ln();
            for (far, v) in around.iter().take_while(|near| near.0 < last) {
                let u = &mut constraints.u[*v as usize];
                *u = u.max(size * (-(far - DISC * w).max(0.0) / reach).exp());
            }
        }
    }

    /// Adds the influence of closed lid lines on the skin beside them.
    fn lids_act(&self, constraints: &mut Constraints) {
        let (head, positions) = (self.contacts.head, &self.contacts.head.mesh.positions);
        for side in (0..2).filter(|&s| self.target.close[s].is_some()) {
            let reach = BESIDE_LID * head.eye_distance;
            let acts = |v: u32| Some((positions[v as usize], constraints.goal.get(&v)?.norm()));
            let line: Vec<(Vec3, f64)> = head.lids[side].both().filter_map(acts).collect();
            let is_outside = is_outside(bounding_box(line.iter().map(|(p, _)| p)), reach);
            let near = |&k: &usize| head.skin[k] && !is_outside(&positions[k]);
            for k in (0..positions.len()).filter(near) {
                let acts =
                    |(p, size): &(Vec3, f64)| size * (1.0 - (positions[k] - p).norm() / reach);
                constraints.u[k] = line.iter().map(acts).fold(constraints.u[k], f64::max);
            }
        }
    }

    /// Constrains the mouth's inside to the jaw, its lower half rigidly, except around the lips.
    fn mouth_follows_jaw(&self, constraints: &mut Constraints) {
        let (head, w) = (self.contacts.head, self.contacts.head.eye_distance);
        let Some(jaw) = &self.target.jaw else { return };
        for (v, &share) in head.socket.iter().enumerate() {
            let share = f64::from(share);
            if share.is_nan() {
                continue;
            }
            constraints.area[v] = true;
            constraints.u[v] = constraints.u[v].max(EDGE * w * 1.01);
            if head.deep(v) {
                let moved = turned(jaw, &head.mesh.positions[v]) * share;
                constraints.goal.entry(v as u32).or_insert(moved);
            }
        }
    }

    /// Moves the lips back along the subtracted shape; the inside stays where the jaw moved it, except around them.
    fn lips_go_back(&self, constraints: &mut Constraints) {
        let (head, w) = (self.contacts.head, self.contacts.head.eye_distance);
        let (Some(base), Some((_, share))) = (self.base, &self.target.undo) else {
            return;
        };
        for v in head.lips.both() {
            constraints.goal.insert(v, -base[v as usize] * *share);
        }
        for v in (0..constraints.u.len()).filter(|&v| !head.socket[v].is_nan()) {
            constraints.area[v] = f64::from(head.from_lips[v]) < 2.0 * LIP_FREE * w;
        }
    }

    fn solve(&self, system: &System, constraints: &Constraints, residual: &[Vec3], d: &mut [Vec3]) {
        let put = |d: &mut [Vec3]| {
            for (&v, &moved) in &constraints.goal {
                d[v as usize] = moved;
            }
        };
        let head = self.contacts.head;
        let delta = |v: usize| (constraints.u[v] / (FULL * head.eye_distance)).min(1.0);
        put(d);
        for (d, residual) in d.iter_mut().zip(residual) {
            *d -= residual;
        }
        let is_pinned = |v: u32| constraints.goal.contains_key(&v);
        system.deform(&head.operator, d, is_pinned, delta, ROUNDS);
        for (d, residual) in d.iter_mut().zip(residual) {
            *d += residual;
        }
        put(d);
    }

    /// Lifts sunk lid skin, moves the mouth's inside back behind the skin, separates crossed lips, and solves their
    /// surroundings again, beyond which the effect has faded.
    fn separate(
        &self,
        constraints: &mut Constraints,
        residual: &[Vec3],
        d: &mut [Vec3],
    ) -> Result<(), Fault> {
        let (head, positions) = (self.contacts.head, &self.contacts.head.mesh.positions);
        for round in 0..=CONTACT_ROUNDS {
            let sunk = self.contacts.sunk(d, self.target);
            let mut touched = self.contacts.pierced(d, self.base);
            touched.extend(sunk);
            if round == CONTACT_ROUNDS {
                for &(v, moved) in &touched {
                    d[v as usize] = moved;
                }
                constraints.goal.extend(touched);
                break;
            }
            touched.extend(self.contacts.crossed(d, self.base));
            if touched.is_empty() {
                break;
            }
            let places = touched.iter().map(|&(v, _)| &positions[v as usize]);
            let is_outside = is_outside(bounding_box(places), CONTACT_REACH * head.eye_distance);
            let area = constraints.area.iter().zip(positions);
            let around: Vec<bool> = area.map(|(&inside, p)| inside && !is_outside(p)).collect();
            constraints.goal.extend(touched);
            let system = System::new(&head.operator, &around, constraints.goal.keys().copied())?;
            self.solve(&system, constraints, residual, d);
        }
        Ok(())
    }
}
