//! All shapes of a head: control points, contacts and followers around the solver of [`super::solve`].
//!
//! What is added to the paper here, shape by shape:
//! * lids: both lid lines go to one common line, on paths lifted around the eyeball; skin that would sink into the ball
//!   deeper than it was (or than a margin) is lifted out, held, and the shape is solved again;
//! * jaw: lower teeth and tongue move rigidly with it, and so does the lower half of the mouth's inside, which would
//!   otherwise hang as a sheet in the open mouth;
//! * lashes and other loose parts move with the nearest skin; eyeballs turn with the gaze.
//!
//! Units: the mesh's. Cost: one factor of the area per shape, two to four for lids; shapes run in parallel.
//! Limits: contact holds at full weight; half way a lid's straight path may dip below the margin.

use std::collections::BTreeMap;
use std::time::Instant;

use rayon::prelude::*;

use super::derive;
use super::head::{Follow, Head, Seam, smooth};
use super::influence::Field;
use super::measure::{Surroundings, lip_gaps};
use super::mesh::Vec3;
use super::recipe::Target;
use super::solve::{self, Settings, System};
use super::sparse::Singular;

/// Height that moving lid skin keeps above the eyeball, in eye distances: a lid's edge is not thinner.
const LID_MARGIN: f64 = 0.012;
/// Skin nearer than this to a lid line that closes takes part, in eye distances.
const BESIDE_LID: f64 = 0.22;
/// Rounds of lifting sunk lid skin and parting crossed lips.
const CONTACT_ROUNDS: usize = 2;
/// Lips that cross by less than this are left, in eye distances: 0.05 mm.
const TOUCH: f64 = 0.0015;
/// Rounds of smoothing around inverted triangles.
const RELAX_ROUNDS: usize = 72;
/// Rounds after which the smoothed patch grows by a ring.
const GROW_EVERY: usize = 3;
/// Inside of the mouth nearer than this to the lip line stays free, in eye distances, so that lips can roll.
const LIP_FREE: f64 = 0.2;
/// Displacements below this part of the eye distance are nothing: 0.04 micrometres.
const NOTHING: f64 = 1e-6;

/// Which method places the skin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// AOI-constrained Laplacian deformation.
    Aoi,
    /// Plain Laplacian least squares, for comparison.
    Laplacian,
}

/// One baked shape.
#[derive(Clone, Debug)]
pub struct Shape {
    /// Name of the morph target.
    pub name: String,
    /// Expression unit that drives it.
    pub unit: Option<String>,
    /// Shape it is meant to be added to.
    pub upon: Option<String>,
    /// Per vertex, mesh units.
    pub displacement: Vec<Vec3>,
    /// Vertices that were allowed to move.
    pub area: Vec<bool>,
    /// Size of the solved system.
    pub unknowns: usize,
    /// Time it took, milliseconds.
    pub milliseconds: f64,
}

/// Bakes all shapes; `done` is called after each with its name.
///
/// # Errors
/// If a system is singular.
pub fn bake(
    head: &Head,
    targets: &[Target],
    settings: &Settings,
    method: Method,
    done: &(dyn Fn(&str) + Sync),
) -> Result<Vec<Shape>, Singular> {
    faer::set_global_parallelism(faer::Par::Seq);
    let w = head.eye_distance;
    // One field per set of control vertices; a recipe has one set, a table of controls may have several.
    let mut sets: Vec<(Vec<u32>, Vec<usize>)> = Vec::new();
    for (k, target) in targets.iter().enumerate() {
        let mut vertices: Vec<u32> = target
            .controls
            .iter()
            .map(|c| c.0)
            .filter(|v| !head.points[super::names::LANDMARKS..].contains(v))
            .collect();
        vertices.sort_unstable();
        vertices.dedup();
        match sets.iter_mut().find(|(set, _)| *set == vertices) {
            Some((_, members)) => members.push(k),
            None => sets.push((vertices, vec![k])),
        }
    }
    let mut influence: Vec<Vec<f64>> = vec![Vec::new(); targets.len()];
    for (vertices, members) in &sets {
        let lengths: Vec<Vec<f64>> = members
            .iter()
            .map(|&k| {
                let goal = controls(head, &targets[k]);
                vertices.iter().map(|v| goal[v].norm()).collect()
            })
            .collect();
        let spread = spread(head, vertices, &lengths, settings)?;
        for (&k, u) in members.iter().zip(spread) {
            influence[k] = u;
        }
    }
    let around = Surroundings::new(head);
    let plain = match method {
        Method::Aoi => None,
        Method::Laplacian => Some(plain(head, targets)?),
    };
    let one = |k: usize, base: Option<&[Vec3]>| {
        let start = Instant::now();
        let target = &targets[k];
        let solved = match &plain {
            Some(all) => (all[k].clone(), head.skin.clone(), 0),
            None => {
                let mut solved = skin(head, target, &influence[k], settings, base)?;
                if target.derive {
                    let mut more = target.clone();
                    for (v, d) in derive::derived(head, &solved.0) {
                        // What the table itself says of a point stands.
                        if !more.controls.iter().any(|c| c.0 == v) {
                            more.controls.push((v, d));
                        }
                    }
                    solved = skin(head, &more, &influence[k], settings, base)?;
                }
                if !target.exact {
                    relax(head, &around, target, base, &mut solved);
                }
                solved
            }
        };
        let (mut displacement, mut area, unknowns) = solved;
        followers(head, target, &mut displacement, &mut area);
        for d in &mut displacement {
            if d.norm() < NOTHING * w {
                *d = Vec3::zeros();
            }
        }
        done(&target.name);
        Ok(Shape {
            name: target.name.clone(),
            unit: target.unit.clone(),
            upon: target.upon.clone(),
            displacement,
            area,
            unknowns,
            milliseconds: start.elapsed().as_secs_f64() * 1e3,
        })
    };
    // Shapes that take another one back come after it.
    let order = |late: bool| (0..targets.len()).filter(move |&k| targets[k].undo.is_some() == late);
    let first: Vec<usize> = order(false).collect();
    let mut shapes: Vec<Option<Shape>> = vec![None; targets.len()];
    let solved: Result<Vec<Shape>, Singular> = first.par_iter().map(|&k| one(k, None)).collect();
    for (k, shape) in first.into_iter().zip(solved?) {
        shapes[k] = Some(shape);
    }
    for k in order(true) {
        let base = targets[k]
            .undo
            .as_ref()
            .and_then(|(name, _)| shapes.iter().flatten().find(|s| s.name == *name));
        let base = base.map(|shape| shape.displacement.clone());
        shapes[k] = Some(one(k, base.as_deref())?);
    }
    Ok(shapes.into_iter().flatten().collect())
}

/// Influence per shape: the screened field of the landmarks.
fn spread(
    head: &Head,
    vertices: &[u32],
    lengths: &[Vec<f64>],
    settings: &Settings,
) -> Result<Vec<Vec<f64>>, Singular> {
    let w = head.eye_distance;
    let field = Field::new(
        &head.operator,
        &head.rings,
        &head.mesh.positions,
        &head.skin,
        vertices,
        settings.reach * w,
        settings.disc * w,
    )?;
    Ok(field.spread(lengths))
}

/// The comparison method on the whole skin.
fn plain(head: &Head, targets: &[Target]) -> Result<Vec<Vec<Vec3>>, Singular> {
    let held = vec![false; head.skin.len()];
    let operator = head.operator.printed();
    targets
        .par_iter()
        .map(|target| {
            let goal = controls(head, target);
            let vertices: Vec<u32> = goal.keys().copied().collect();
            let shape: Vec<Vec3> = goal.values().copied().collect();
            let baked = solve::plain(&operator, &head.skin, &held, &vertices, &[shape], 100.0)?;
            Ok(baked.into_iter().next().unwrap_or_default())
        })
        .collect()
}

/// Position along a seam: across the face, from the subject's right end to the left one.
fn across(head: &Head, seam: &Seam, p: &Vec3) -> f64 {
    let ends =
        [seam.upper[0], seam.upper[seam.upper.len() - 1]].map(|v| head.mesh.positions[v as usize]);
    let line = ends[1] - ends[0];
    (p - ends[0]).dot(&line) / line.norm_squared()
}

/// Point of a line of vertices at the position `t` across.
fn on_line(head: &Head, seam: &Seam, line: &[u32], t: f64) -> Vec3 {
    let p = |k: usize| head.mesh.positions[line[k] as usize];
    for k in 1..line.len() {
        let (a, b) = (across(head, seam, &p(k - 1)), across(head, seam, &p(k)));
        if t <= b || k + 1 == line.len() {
            let f = if b > a {
                ((t - a) / (b - a)).clamp(0.0, 1.0)
            } else {
                1.0
            };
            return p(k - 1) * (1.0 - f) + p(k) * f;
        }
    }
    p(0)
}

/// All control vertices of a shape with their displacements.
fn controls(head: &Head, target: &Target) -> BTreeMap<u32, Vec3> {
    let mut goal: BTreeMap<u32, Vec3> = BTreeMap::new();
    for &(v, d) in &target.controls {
        goal.insert(v, d);
    }
    let at = |v: u32| head.mesh.positions[v as usize];
    for side in 0..2 {
        let seam = &head.lids[side];
        if let Some((amount, line)) = target.close[side] {
            for path in [&seam.upper, &seam.lower] {
                for &v in &path[1..path.len() - 1] {
                    let p = at(v);
                    let t = across(head, seam, &p);
                    let (u, l) = (
                        on_line(head, seam, &seam.upper, t),
                        on_line(head, seam, &seam.lower, t),
                    );
                    let meeting = l + (u - l) * line;
                    // Both lines go to the same curve; the depth there is the ball's, given below.
                    *goal.entry(v).or_insert_with(Vec3::zeros) +=
                        (meeting - p) * (amount * near_corner(t));
                }
            }
        }
        let Some(ball) = head.balls[side].as_ref().filter(|_| !target.exact) else {
            continue;
        };
        for path in [&seam.upper, &seam.lower] {
            for &v in path {
                if let Some(d) = goal.get_mut(&v).filter(|d| d.norm() > 0.0) {
                    let (p, moved) = (at(v), at(v) + *d);
                    let least = match target.close[side] {
                        // Lines that meet go to the same point, so that no lid stands before the other.
                        Some((amount, _)) if amount > 0.99 => 2.0 * LID_MARGIN * head.eye_distance,
                        _ => ball.height(&p).min(LID_MARGIN * head.eye_distance),
                    };
                    if ball.height(&moved) < least {
                        *d = ball.lifted(&moved, least) - p;
                    }
                }
            }
        }
    }
    goal
}

/// Displacement of the skin, the vertices that could move, and the number of unknowns.
fn skin(
    head: &Head,
    target: &Target,
    u: &[f64],
    settings: &Settings,
    base: Option<&[Vec3]>,
) -> Result<(Vec<Vec3>, Vec<bool>, usize), Singular> {
    let w = head.eye_distance;
    let positions = &head.mesh.positions;
    let mut goal = controls(head, target);
    let mut u = u.to_vec();
    // Derived points speak for their surroundings by plain distance: they are few and far from lids and lips.
    for &v in &head.points[super::names::LANDMARKS..] {
        if let Some(d) = goal.get(&v) {
            let (size, p) = (d.norm(), positions[v as usize]);
            for (k, u) in u.iter_mut().enumerate() {
                if head.skin[k] {
                    let far = (positions[k] - p).norm() - settings.disc * w;
                    *u = u.max(size * (-far.max(0.0) / (settings.reach * w)).exp());
                }
            }
        }
    }
    // Lid lines that are closed speak for the skin beside them, up to the corners, whose landmarks stay.
    for seam in (0..2)
        .filter(|&s| target.close[s].is_some())
        .map(|s| &head.lids[s])
    {
        for v in seam.upper.iter().chain(&seam.lower) {
            let Some(size) = goal.get(v).map(Vec3::norm) else {
                continue;
            };
            let p = positions[*v as usize];
            for (k, u) in u.iter_mut().enumerate().filter(|&(k, _)| head.skin[k]) {
                let far = (positions[k] - p).norm() / (BESIDE_LID * w);
                *u = u.max(size * (1.0 - far));
            }
        }
    }
    let mut area: Vec<bool> = (0..positions.len())
        .map(|v| head.skin[v] && u[v] > settings.edge * w)
        .collect();
    if let Some(jaw) = &target.jaw {
        let near: Vec<Vec3> = head
            .lips
            .upper
            .iter()
            .chain(&head.lips.lower)
            .map(|&v| positions[v as usize])
            .collect();
        for v in 0..positions.len() {
            let share = f64::from(head.socket[v]);
            if share.is_nan() {
                continue;
            }
            area[v] = true;
            u[v] = u[v].max(settings.edge * w * 1.01);
            let free = near
                .iter()
                .any(|p| (p - positions[v]).norm() < LIP_FREE * w);
            if !free && !(0.05..=0.95).contains(&share) {
                let p = positions[v];
                let moved = jaw.transform_point(&p.into()).coords - p;
                goal.entry(v as u32).or_insert(moved * share);
            }
        }
    }
    if let (Some(base), Some((_, share))) = (base, &target.undo) {
        for &v in head.lips.upper.iter().chain(&head.lips.lower) {
            goal.insert(v, -base[v as usize] * *share);
        }
        for v in 0..positions.len() {
            // The inside stays where the jaw took it, except around the lips.
            if !head.socket[v].is_nan() {
                let close =
                    head.lips.upper.iter().chain(&head.lips.lower).any(|&l| {
                        (positions[l as usize] - positions[v]).norm() < 2.0 * LIP_FREE * w
                    });
                area[v] = close;
            }
        }
    }
    let mut unknowns = 0;
    let mut d = Vec::new();
    for round in 0..=CONTACT_ROUNDS {
        let list: Vec<(u32, Vec3)> = goal.iter().map(|(&v, &d)| (v, d)).collect();
        let vertices: Vec<u32> = list.iter().map(|c| c.0).collect();
        let system = System::new(&head.operator, area.clone(), &vertices)?;
        let full = settings.full * w;
        d = system.deform(
            &head.operator,
            positions,
            &list,
            |v| (u[v] / full).min(1.0),
            settings.rounds,
        );
        unknowns = unknowns.max(system.unknowns());
        // A table of controls says itself how lids and lips go.
        if target.exact {
            break;
        }
        let (sunk, crossed) = (sunk(head, &d), crossed(head, &d, base));
        if sunk.is_empty() && crossed.is_empty() {
            break;
        }
        for (v, lifted) in sunk {
            if round == CONTACT_ROUNDS {
                d[v as usize] = lifted;
            } else {
                goal.insert(v, lifted);
            }
        }
        goal.extend(crossed);
    }
    for &v in goal.keys() {
        area[v as usize] = true;
    }
    Ok((d, area, unknowns))
}

/// Smooths the displacement around inverted triangles until there are none: in a patch that takes in what is inverted and
/// grows while that lasts. Equal displacements cannot invert anything, so a large enough patch ends it; what the recipe
/// asked for gives way by what that takes, except lid lines that meet.
fn relax(
    head: &Head,
    around: &Surroundings,
    target: &Target,
    base: Option<&[Vec3]>,
    (d, area, _): &mut (Vec<Vec3>, Vec<bool>, usize),
) {
    let mut held = vec![false; d.len()];
    let closes = target.close.iter().flatten().any(|c| c.0 > 0.99);
    for side in 0..2 {
        if target.close[side].is_some_and(|(amount, _)| amount > 0.99) {
            let seam = &head.lids[side];
            for &v in seam.upper.iter().chain(&seam.lower) {
                let t = across(head, seam, &head.mesh.positions[v as usize]);
                held[v as usize] = (0.07..0.93).contains(&t);
            }
        }
    }
    let below = |v: usize| base.map_or(Vec3::zeros(), |b| b[v]);
    let mut patch = vec![false; d.len()];
    let mut moved: Vec<Vec3> = (0..d.len())
        .map(|v| head.mesh.positions[v] + d[v] + below(v))
        .collect();
    let mut some = around.seeing(head, |v| moved[v] != head.mesh.positions[v]);
    for round in 0..RELAX_ROUNDS {
        let (inverted, _) = around.inverted(head, &moved, &some);
        if inverted.is_empty() {
            break;
        }
        for &v in inverted.iter().flatten() {
            patch[v as usize] = true;
            for &o in head.rings.of(v as usize) {
                patch[o as usize] = true;
            }
            // What cannot be had with lids that meet gives way at last, vertex by vertex.
            if round >= RELAX_ROUNDS / 2 {
                held[v as usize] = false;
            }
        }
        if round % GROW_EVERY == GROW_EVERY - 1 {
            let before = patch.clone();
            for v in (0..patch.len()).filter(|&v| before[v]) {
                for &o in head.rings.of(v) {
                    patch[o as usize] = true;
                }
            }
        }
        let inside: Vec<usize> = (0..patch.len())
            .filter(|&v| patch[v] && area[v] && !held[v])
            .collect();
        // Slivers in a fold outlast all smoothing: in the second half they and more and more around them move as one,
        // except at lids that meet, which that would open.
        let together = if closes {
            0
        } else {
            (round + 1)
                .saturating_sub(RELAX_ROUNDS / 2)
                .div_ceil(GROW_EVERY)
        };
        for t in inverted.iter().filter(|_| together > 0) {
            let mut cluster = t.to_vec();
            for _ in 0..together {
                for k in 0..cluster.len() {
                    cluster.extend(head.rings.of(cluster[k] as usize));
                }
                cluster.sort_unstable();
                cluster.dedup();
            }
            cluster.retain(|&v| area[v as usize] && !held[v as usize]);
            let all = |v: &u32| d[*v as usize] + below(*v as usize);
            let mean = cluster.iter().map(all).sum::<Vec3>() / cluster.len().max(1) as f64;
            for v in cluster {
                d[v as usize] = mean - below(v as usize);
                patch[v as usize] = true;
            }
        }
        // Several sweeps, or a large patch would take as many rounds as it has rings.
        for _ in 0..if together > 0 { 0 } else { 16 } {
            let smoothed: Vec<Vec3> = inside
                .iter()
                .map(|&v| {
                    // What is seen is this shape upon the other one: that is what has to be smooth.
                    let all = |v: usize| d[v] + below(v);
                    let ring = head.rings.of(v);
                    let mean =
                        ring.iter().map(|&o| all(o as usize)).sum::<Vec3>() / ring.len() as f64;
                    (all(v) + mean) / 2.0 - below(v)
                })
                .collect();
            for (&v, s) in inside.iter().zip(smoothed) {
                d[v] = s;
            }
        }
        for (v, lifted) in sunk(head, d) {
            if !held[v as usize] {
                d[v as usize] = lifted;
            }
        }
        // Only the patch has changed; what lies around it is unturned since the last look.
        for v in 0..d.len() {
            moved[v] = head.mesh.positions[v] + d[v] + below(v);
        }
        some = around.seeing(head, |v| patch[v]);
    }
}

/// 1 along a lid line, falling to 0 at its ends, where the lids are one skin: `t` from 0 to 1 across.
fn near_corner(t: f64) -> f64 {
    smooth(0.0, 0.035, t) * smooth(1.0, 0.965, t)
}

/// Skin vertices that sank into an eyeball deeper than before (or than the margin), with the displacement that cures it.
fn sunk(head: &Head, d: &[Vec3]) -> Vec<(u32, Vec3)> {
    let w = head.eye_distance;
    let mut found = Vec::new();
    for ball in head.balls.iter().flatten() {
        let reach = 0.75 * w;
        for v in 0..d.len() {
            let p = head.mesh.positions[v];
            if !head.skin[v] || d[v] == Vec3::zeros() || (p - ball.center).norm() > reach {
                continue;
            }
            let moved = p + d[v];
            // Behind the ball's widest part the socket's skin is out of sight.
            if (moved - ball.center).dot(&head.axes.column(2)) < 0.0 {
                continue;
            }
            let least = ball.height(&p).min(LID_MARGIN * w);
            if ball.height(&moved) < least - 1e-4 * w {
                found.push((v as u32, ball.lifted(&moved, least) - p));
            }
        }
    }
    found
}

/// Vertices of the inner lip lines that passed the other lip further than in the neutral, each half of the way back.
fn crossed(head: &Head, d: &[Vec3], base: Option<&[Vec3]>) -> Vec<(u32, Vec3)> {
    let up = head.axes.column(1).into_owned();
    let at = |v: u32| head.mesh.positions[v as usize];
    let before = lip_gaps(head, at);
    let now = lip_gaps(head, |v| {
        at(v) + d[v as usize] + base.map_or(Vec3::zeros(), |b| b[v as usize])
    });
    let mut found = Vec::new();
    for ((.., before), (upper, lower, now)) in before.into_iter().zip(now) {
        let excess = before.min(0.0) - now;
        let moves = d[upper as usize] != Vec3::zeros() || d[lower as usize] != Vec3::zeros();
        if moves && excess > TOUCH * head.eye_distance {
            found.push((upper, d[upper as usize] + up * (excess / 2.0)));
            found.push((lower, d[lower as usize] - up * (excess / 2.0)));
        }
    }
    found
}

/// Everything that is not skin.
fn followers(head: &Head, target: &Target, d: &mut [Vec3], area: &mut [bool]) {
    let tip = target.tongue.unwrap_or_default();
    for v in 0..d.len() {
        let p = head.mesh.positions[v];
        let moved = match head.follow[v] {
            Follow::Skin | Follow::Still => continue,
            Follow::Nearest(s) => d[s as usize],
            Follow::Eyeball(side) => match (&target.gaze[side], &head.balls[side]) {
                (Some(turn), Some(ball)) => turn * (p - ball.center) + ball.center - p,
                _ => continue,
            },
            Follow::Jaw(share) => {
                let jaw = target.jaw.map_or(Vec3::zeros(), |jaw| {
                    jaw.transform_point(&p.into()).coords - p
                });
                jaw * f64::from(share) + tip * f64::from(head.tongue[v])
            }
        };
        if moved != Vec3::zeros() {
            d[v] = moved;
            area[v] = true;
        }
    }
}
