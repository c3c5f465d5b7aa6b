//! All shapes of a head: influence, skin, and the parts that follow it.
//!
//! Additions to the paper, shape by shape: contacts ([`super::skin`]), the learned residual of the skin where it
//! inverts no triangle ([`super::surroundings`]), and parts other than skin: lower teeth and tongue move rigidly with
//! the jaw, lashes and other loose parts with the nearest skin, eyeballs rotate with the gaze.
//!
//! Units: the mesh's. Cost: one factor of the area per shape, and up to two around contacts; shapes run in parallel.

use std::collections::{BTreeMap, BTreeSet};

use rayon::prelude::*;

use super::canonical::Canonical;
use super::head::{Follow, Head, LANDMARKS};
use super::influence::Field;
use super::jaw::{Jaw, turned};
use super::laplacian::Operator;
use super::mesh::Vec3;
use super::printed::{self, printed};
use super::prior::Prior;
use super::shape::{Shape, Target};
use super::skin::{Contacts, Placing, Solved, goals};
use super::solve::{DISC, REACH};
use super::surroundings::Surroundings;
use mien_workbench::fault::Fault;

/// Displacements below this part of the eye distance are set to 0: 0.04 micrometres.
const FLUSH_BELOW: f64 = 1e-6;

/// Rings around a defect within which the plain solution replaces the learned one, the second tried after the first.
const BLENDED_RINGS: [usize; 2] = [6, 16];

/// Which method places the skin.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Method {
    /// AOI-constrained Laplacian deformation.
    #[default]
    Aoi,
    /// The paper's Procedure 1 with its printed Laplacian, equations (10) to (13), on the whole skin.
    Paper,
    /// Plain Laplacian least squares, for comparison.
    Laplacian,
}

/// Bakes all shapes, with a prior of the skin or none; `done` is called with the name of each finished shape.
///
/// # Errors
/// If a system is singular.
pub fn bake(
    head: &Head,
    targets: &[Target],
    method: Method,
    prior: Option<&Prior>,
    done: &(dyn Fn(&str) + Sync),
) -> Result<Vec<Shape>, Fault> {
    // Sums of other shapes come last.
    let (targets, sums) = targets.split_at(targets.partition_point(|t| t.sum.is_none()));
    let rig = Rig::new(head, targets, method, prior)?;
    let bases: Vec<Option<usize>> = (0..targets.len()).map(|k| base(targets, k)).collect();
    let mut shapes: Vec<Option<Shape>> = vec![None; targets.len()];
    while shapes.iter().any(Option::is_none) {
        let waits = |k: usize| bases[k].is_some_and(|base| shapes[base].is_none());
        let ready = (0..targets.len()).into_par_iter();
        let ready = ready.filter(|&k| shapes[k].is_none() && !waits(k));
        let made = ready.map(|k| {
            let base = bases[k].and_then(|base| shapes[base].as_ref());
            let shape = rig.shape(k, base.map(|base| &base.displacement[..]))?;
            done(&shape.name);
            Ok((k, shape))
        });
        for (k, shape) in made.collect::<Result<Vec<_>, Fault>>()? {
            shapes[k] = Some(shape);
        }
    }
    let mut shapes: Vec<Shape> = shapes.into_iter().flatten().collect();
    subtract_sums(&mut shapes, targets, FLUSH_BELOW * head.eye_distance);
    for target in sums {
        shapes.push(summed(head, target, &shapes));
        done(&target.name);
    }
    Ok(shapes)
}

/// A shape that is a weighted sum of others.
fn summed(head: &Head, target: &Target, shapes: &[Shape]) -> Shape {
    let n = head.mesh.positions.len();
    let (mut displacement, mut area) = (vec![Vec3::zeros(); n], vec![false; n]);
    for (name, weight) in target.sum.iter().flatten() {
        for shape in shapes.iter().filter(|s| s.name == *name) {
            for v in 0..n {
                displacement[v] += shape.displacement[v] * *weight;
                area[v] |= shape.area[v];
            }
        }
    }
    Shape {
        name: target.name.clone(),
        misses: misses(head, target, &displacement, None),
        displacement,
        area,
        ..Shape::default()
    }
}

/// Unmet requirements of a shape; `None` if it has none.
fn misses(head: &Head, target: &Target, d: &[Vec3], base: Option<&[Vec3]>) -> Option<Vec<String>> {
    let at = head.moved(d, base);
    let missed = target.must.iter().filter_map(|m| m.missed(head, &at));
    (!target.must.is_empty()).then(|| missed.collect())
}

/// Sets displacements shorter than `nothing` to 0.
fn flush_to_zero(d: &mut [Vec3], nothing: f64) {
    for d in d.iter_mut().filter(|d| d.norm() < nothing) {
        *d = Vec3::zeros();
    }
}

/// The earlier target that target `k` subtracts or is added to.
fn base(targets: &[Target], k: usize) -> Option<usize> {
    let undone = targets[k].undo.as_ref().map(|(name, _)| name);
    let name = undone.or(targets[k].upon.as_ref())?;
    targets[..k].iter().position(|t| t.name == *name)
}

/// Data shared by all shapes.
struct Rig<'a> {
    head: &'a Head,
    targets: &'a [Target],
    influence: Vec<Vec<f64>>,
    around: Surroundings<'a>,
    contacts: Contacts<'a>,
    learned: Option<Canonical<'a>>,
    jaw: Jaw<'a>,
    /// Operator and rounds of a reference method.
    printed: Option<(Operator, usize)>,
}

/// Defects of a skin, the worst kind first: unmet requirements, then inverted triangles and torn edges.
struct Defects {
    missed: usize,
    /// Vertices of inverted triangles and torn edges.
    places: Vec<u32>,
}

impl Defects {
    fn rank(&self) -> (usize, usize) {
        (self.missed, self.places.len())
    }
}

/// The best skin of a shape so far.
struct Best<'a> {
    rig: &'a Rig<'a>,
    target: &'a Target,
    base: Option<&'a [Vec3]>,
    solved: Solved,
    defects: Defects,
}

impl<'a> Rig<'a> {
    fn new(
        head: &'a Head,
        targets: &'a [Target],
        method: Method,
        prior: Option<&'a Prior>,
    ) -> Result<Self, Fault> {
        let prior = prior.filter(|_| method == Method::Aoi && targets.iter().any(|t| t.derive));
        let learned = || prior.and_then(|prior| Canonical::new(head, prior));
        let (influence, (around, contacts, learned)) = rayon::join(
            || fields(head, targets),
            || (Surroundings::new(head), Contacts::new(head), learned()),
        );
        Ok(Self {
            head,
            targets,
            influence: influence?,
            around,
            contacts,
            learned,
            jaw: Jaw::new(head, targets)?,
            printed: match method {
                Method::Aoi => None,
                Method::Paper => Some((head.operator.printed(), printed::ROUNDS)),
                Method::Laplacian => Some((head.operator.printed(), 0)),
            },
        })
    }

    /// Solves one shape; `base` is the displacement of the one it is added to.
    fn shape(&self, k: usize, base: Option<&[Vec3]>) -> Result<Shape, Fault> {
        let (head, target) = (self.head, &self.targets[k]);
        let Solved { mut d, mut area } = match &self.printed {
            Some((operator, rounds)) => {
                let controls: Vec<(u32, Vec3)> = goals(head, target).into_iter().collect();
                let (rings, positions, skin) = (&head.rings, &head.mesh.positions, &head.skin);
                let eyes = head.eye_distance;
                let d = printed(operator, rings, positions, skin, &controls, eyes, *rounds)?;
                let area = skin.clone();
                Solved { d, area }
            }
            None => self.safest(k, base)?,
        };
        followers(head, target, &mut d, &mut area);
        flush_to_zero(&mut d, FLUSH_BELOW * head.eye_distance);
        Ok(Shape {
            name: target.name.clone(),
            unit: target.unit.clone(),
            upon: target.upon.clone(),
            misses: misses(head, target, &d, base),
            displacement: d,
            area,
        })
    }

    /// The skin with the fewest defects. The learned one is tried first; around its defects the plain solution is
    /// blended in ever wider, and finally used alone.
    fn safest(&self, k: usize, base: Option<&[Vec3]>) -> Result<Solved, Fault> {
        let (head, target) = (self.head, &self.targets[k]);
        let carried = self.jaw.motion(target);
        let placing = |target| Placing {
            contacts: &self.contacts,
            target,
            // Only a shape that subtracts another is solved from it.
            base: base.filter(|_| self.targets[k].undo.is_some()),
            jaw: carried.as_deref(),
        };
        // Where the jaw moves the skin, its share field replaces the learned residual.
        let learned = self.learned.as_ref();
        let learned = learned.filter(|_| target.derive && carried.is_none());
        let u = &self.influence[k];
        let system = placing(target).system(u, learned.is_some())?;
        let place =
            |target, residual: Option<&[Vec3]>| placing(target).solved(u, residual, &system);
        let Some(learned) = learned else {
            return place(target, None);
        };
        let alone = landmarks_alone(head, target);
        let first = placing(&alone).solved(u, None, &system)?;
        let landmarks = head.points[..LANDMARKS].iter();
        let moved: Vec<Vec3> = landmarks.map(|&v| first.d[v as usize]).collect();
        let solved = place(target, Some(&learned.residual(head, &moved, &first.d)))?;
        let defects = self.defects(target, base, &solved.d);
        if target.exact || defects.rank() == (0, 0) {
            return Ok(solved);
        }
        let mut best = Best {
            rig: self,
            target,
            base,
            defects,
            solved,
        };
        best.blend(place(target, None)?);
        Ok(best.solved)
    }

    fn defects(&self, target: &Target, base: Option<&[Vec3]>, d: &[Vec3]) -> Defects {
        let (head, at) = (self.head, self.head.moved(d, base));
        let missed = target.must.iter().filter(|m| m.missed(head, &at).is_some());
        Defects {
            missed: missed.count(),
            places: self.around.defects(d, &at),
        }
    }
}

impl Best<'_> {
    /// Tries the plain solution around defects that it does not have itself, then alone.
    fn blend(&mut self, plain: Solved) {
        // Its contacts may have moved vertices outside the other's area.
        let Solved { d: plain, area } = plain;
        for (inside, also) in self.solved.area.iter_mut().zip(area) {
            *inside |= also;
        }
        let others = self.rig.defects(self.target, self.base, &plain);
        let mut own = self.defects.places.clone();
        own.retain(|v| others.places.binary_search(v).is_err());
        let whole = self.solved.d.clone();
        for rings in BLENDED_RINGS.into_iter().filter(|_| !own.is_empty()) {
            let mut d = whole.clone();
            let around = self.rig.head.rings.about(&own, rings);
            for (ring, some) in around.iter().enumerate() {
                let share = (2.0 * ring as f64 / rings as f64 - 1.0).max(0.0);
                for v in some.iter().map(|&v| v as usize) {
                    d[v] = plain[v] + (whole[v] - plain[v]) * share;
                }
            }
            self.take(d);
        }
        self.take_with(others, plain);
    }

    /// Resolves contacts in another skin, and keeps it if it has fewer defects.
    fn take(&mut self, mut d: Vec<Vec3>) {
        let contacts = &self.rig.contacts;
        let mut touched = contacts.pierced(&d, self.base);
        touched.extend(contacts.sunk(&d, self.target));
        touched.extend(contacts.crossed(&d, self.base));
        for (v, moved) in touched {
            if self.solved.area[v as usize] {
                d[v as usize] = moved;
            }
        }
        let defects = self.rig.defects(self.target, self.base, &d);
        self.take_with(defects, d);
    }

    fn take_with(&mut self, defects: Defects, d: Vec<Vec3>) {
        if defects.rank() < self.defects.rank() {
            (self.solved.d, self.defects) = (d, defects);
        }
    }
}

/// Subtracts from correctives the sum of their two shapes.
fn subtract_sums(shapes: &mut [Shape], targets: &[Target], nothing: f64) {
    for (k, target) in targets.iter().enumerate() {
        for name in target.corrects.iter().flatten() {
            let Some(one) = targets.iter().position(|t| t.name == *name) else {
                continue;
            };
            let [one, both] = shapes.get_disjoint_mut([one, k]).expect("two shapes");
            for (v, d) in one.displacement.iter().enumerate() {
                both.displacement[v] -= d;
                both.area[v] |= one.area[v];
            }
            flush_to_zero(&mut both.displacement, nothing);
        }
    }
}

/// The target with landmarks alone and without contacts, from which the prior compares motions.
fn landmarks_alone(head: &Head, target: &Target) -> Target {
    let (mut alone, derived) = (target.clone(), &head.points[LANDMARKS..]);
    alone.controls.retain(|c| !derived.contains(&c.0));
    alone.exact = true;
    alone
}

/// Influence per shape: the screened field of its landmarks.
fn fields(head: &Head, targets: &[Target]) -> Result<Vec<Vec<f64>>, Fault> {
    let (operator, rings) = (&head.operator, &head.rings);
    let (positions, skin) = (&head.mesh.positions, &head.skin);
    let [reach, radius] = [REACH, DISC].map(|far| far * head.eye_distance);
    // One field per set of control vertices: a recipe has one set, a table of controls several.
    let mut sets: BTreeMap<BTreeSet<u32>, Vec<usize>> = BTreeMap::new();
    for (k, target) in targets.iter().enumerate() {
        let controls = target.controls.iter().map(|c| c.0);
        let own = controls.filter(|v| !head.points[LANDMARKS..].contains(v));
        sets.entry(own.collect()).or_default().push(k);
    }
    let mut influence: Vec<Vec<f64>> = vec![Vec::new(); targets.len()];
    for (vertices, members) in sets {
        let vertices = Vec::from_iter(vertices);
        let field = Field::new(operator, rings, positions, skin, &vertices, reach, radius)?;
        let lengths = members.iter().map(|&k| {
            let goal = goals(head, &targets[k]);
            vertices.iter().map(|v| goal[v].norm()).collect()
        });
        let lengths: Vec<Vec<f64>> = lengths.collect();
        for (&k, u) in members.iter().zip(field.spread(&lengths)) {
            influence[k] = u;
        }
    }
    Ok(influence)
}

/// Moves all parts other than skin.
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
                let jaw = target.jaw.map_or(Vec3::zeros(), |jaw| turned(&jaw, &p));
                jaw * f64::from(share) + tip * f64::from(head.tongue[v])
            }
        };
        if moved != Vec3::zeros() {
            d[v] = moved;
            area[v] = true;
        }
    }
}
