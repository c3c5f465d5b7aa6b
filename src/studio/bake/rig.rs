//! All shapes of a head: influence, skin, what follows the skin.
//!
//! What is added to the paper here, shape by shape: contacts ([`super::skin`]), no triangle turned over ([`super::relax`]),
//! and the parts that are not skin: lower teeth and tongue move rigidly with the jaw, lashes and other loose parts with the
//! nearest skin, eyeballs turn with the gaze.
//!
//! Units: the mesh's. Cost: one factor of the area per shape, two to four for lids; shapes run in parallel.
//! One file: the order of a shape; each of its steps has its own. The rest is the second implementation it is held against.

use std::time::Instant;

use rayon::prelude::*;

use super::canonical::Canonical;
use super::contact::Contacts;
use super::goals::goals;
use super::head::{Follow, Head};
use super::influence::{self, Field};
use super::laplacian::Operator;
use super::mesh::{Rings, Vec3};
use super::names::LANDMARKS;
use super::prior::Prior;
use super::recipe::Target;
use super::relax::{relax, rings_about};
use super::shape::Shape;
use super::skin::{Kept, Placing, Solved};
use super::solve::{self, Settings, System};
use super::sparse::Singular;
use super::surroundings::Surroundings;

/// Displacements below this part of the eye distance are nothing: 0.04 micrometres.
const NOTHING: f64 = 1e-6;

/// Rings around a place where what was learned is at fault within which it gives way to the plain solution.
const BLENDED_RINGS: [usize; 2] = [6, 16];

/// Which method places the skin.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Method {
    /// AOI-constrained Laplacian deformation.
    #[default]
    Aoi,
    /// The paper's Procedure 1 with its printed Laplacian, equations (10) to (13), on the whole skin.
    Paper,
    /// Plain Laplacian least squares, for comparison.
    Laplacian,
}

impl Method {
    /// The method that `--method` calls so.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        Some(match name {
            "aoi" => Self::Aoi,
            "paper" => Self::Paper,
            "laplacian" => Self::Laplacian,
            _ => return None,
        })
    }
}

/// Procedure 1 as printed: ω of control points and steps of equation (12), s of (13) in eye distances, rounds. The paper leaves
/// all four open; these are ours.
const PRINTED_WEIGHT: f64 = 10.0;
const PRINTED_STEPS: usize = 100;
const PRINTED_FACTOR: f64 = 30.0;
const PRINTED_ROUNDS: usize = 7;

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
    bake_with(
        head,
        targets,
        settings,
        method,
        Some(Prior::shipped()),
        done,
    )
}

/// The same with another prior of the skin, or none.
///
/// # Errors
/// If a system is singular.
pub fn bake_with(
    head: &Head,
    targets: &[Target],
    settings: &Settings,
    method: Method,
    prior: Option<&Prior>,
    done: &(dyn Fn(&str) + Sync),
) -> Result<Vec<Shape>, Singular> {
    faer::set_global_parallelism(faer::Par::Seq);
    let rig = Rig::new(head, targets, settings, method, prior)?;
    let solved: Result<Vec<Vec<(usize, Shape)>>, Singular> = rows(targets)
        .par_iter()
        .map(|row| {
            let mut made: Vec<(usize, Shape)> = Vec::with_capacity(row.len());
            for &k in row {
                let base = beneath(&targets[k]);
                let base = base.and_then(|name| made.iter().find(|s| s.1.name == *name));
                let shape = rig.shape(k, base.map(|s| &s.1.displacement[..]))?;
                done(&shape.name);
                made.push((k, shape));
            }
            Ok(made)
        })
        .collect();
    let mut shapes: Vec<(usize, Shape)> = solved?.into_iter().flatten().collect();
    shapes.sort_by_key(|s| s.0);
    let mut shapes: Vec<Shape> = shapes.into_iter().map(|s| s.1).collect();
    take_off_pairs(&mut shapes, targets, NOTHING * head.eye_distance);
    Ok(shapes)
}

/// The shape that one takes back or is added to.
fn beneath(target: &Target) -> Option<&String> {
    let undone = target.undo.as_ref().map(|(name, _)| name);
    undone.or(target.upon.as_ref())
}

/// A shape upon another one follows it in the same breath; the longest such rows begin.
fn rows(targets: &[Target]) -> Vec<Vec<usize>> {
    let mut rows: Vec<Vec<usize>> = Vec::new();
    for (k, target) in targets.iter().enumerate() {
        let base = beneath(target);
        let base = base.and_then(|name| targets[..k].iter().position(|t| t.name == *name));
        match rows
            .iter_mut()
            .find(|row| base.is_some_and(|b| row.contains(&b)))
        {
            Some(row) => row.push(k),
            None => rows.push(vec![k]),
        }
    }
    rows.sort_by_key(|row| std::cmp::Reverse(row.len()));
    rows
}

/// What is made once for all shapes.
struct Rig<'a> {
    head: &'a Head,
    targets: &'a [Target],
    settings: &'a Settings,
    influence: Vec<Vec<f64>>,
    around: Surroundings,
    contacts: Contacts<'a>,
    learned: Option<Canonical<'a>>,
    /// All skins by a method of comparison.
    compared: Option<Vec<Vec<Vec3>>>,
}

/// What is wrong with a skin, the worst first: promises missed, triangles inverted and edges torn.
struct Faults {
    missed: usize,
    /// Vertices of these triangles and edges.
    places: Vec<u32>,
}

impl Faults {
    fn rank(&self) -> (usize, usize) {
        (self.missed, self.places.len())
    }
}

impl<'a> Rig<'a> {
    fn new(
        head: &'a Head,
        targets: &'a [Target],
        settings: &'a Settings,
        method: Method,
        prior: Option<&'a Prior>,
    ) -> Result<Self, Singular> {
        let learned = || {
            prior
                .filter(|_| method == Method::Aoi && targets.iter().any(|t| t.derive))
                .and_then(|prior| Canonical::new(head, prior))
        };
        let (influence, (around, contacts, learned)) = rayon::join(
            || fields(head, targets, settings),
            || (Surroundings::new(head), Contacts::new(head), learned()),
        );
        Ok(Self {
            head,
            targets,
            settings,
            influence: influence?,
            around,
            contacts,
            learned,
            compared: match method {
                Method::Aoi => None,
                Method::Paper => Some(printed(head, targets)?),
                Method::Laplacian => Some(plain(head, targets)?),
            },
        })
    }

    /// One shape; `base` is the displacement of the one it is added to.
    fn shape(&self, k: usize, base: Option<&[Vec3]>) -> Result<Shape, Singular> {
        let (head, target) = (self.head, &self.targets[k]);
        let start = Instant::now();
        let Solved {
            d: mut displacement,
            mut area,
            unknowns,
        } = match &self.compared {
            Some(all) => Solved {
                d: all[k].clone(),
                area: head.skin.clone(),
                unknowns: 0,
            },
            None => self.safest(k, base)?,
        };
        followers(head, target, &mut displacement, &mut area);
        for d in &mut displacement {
            if d.norm() < NOTHING * head.eye_distance {
                *d = Vec3::zeros();
            }
        }
        Ok(Shape {
            name: target.name.clone(),
            unit: target.unit.clone(),
            upon: target.upon.clone(),
            misses: (!target.must.is_empty()).then(|| {
                let at = self.moved(&displacement, base);
                let missed = target.must.iter().map(|m| m.missed(head, &at));
                missed.flatten().collect()
            }),
            displacement,
            area,
            unknowns,
            milliseconds: start.elapsed().as_secs_f64() * 1e3,
        })
    }

    /// The skin with the fewest faults: as learned; where that is at fault, blended into the plain solution around the places,
    /// ever wider; the plain one; and each of them relaxed only if that makes it no worse.
    fn safest(&self, k: usize, base: Option<&[Vec3]>) -> Result<Solved, Singular> {
        let (head, target) = (self.head, &self.targets[k]);
        let mut kept = Kept::default();
        let mut place = |target: &Target, beyond: Option<&[Vec3]>| {
            let placing = Placing {
                head,
                contacts: &self.contacts,
                settings: self.settings,
                target,
                // Only what takes a shape back is solved from it.
                base: base.filter(|_| target.undo.is_some()),
            };
            placing.place(&self.influence[k], beyond, &mut kept)
        };
        let learned = self.learned.as_ref().filter(|_| target.derive);
        let mut solved = match learned {
            None => place(target, None)?,
            Some(learned) => {
                let first = place(&landmarks_alone(head, target), None)?;
                let landmarks = head.points[..LANDMARKS].iter();
                let moved: Vec<Vec3> = landmarks.map(|&v| first.d[v as usize]).collect();
                place(target, Some(&learned.beyond(head, &moved, &first.d)))?
            }
        };
        if target.exact {
            return Ok(solved);
        }
        let mut faults = self.faults(target, base, &solved.d);
        if learned.is_some() && faults.rank() > (0, 0) {
            let plain = place(target, None)?.d;
            let others = self.faults(target, base, &plain);
            let own = |v: &u32| others.places.binary_search(v).is_err();
            let places: Vec<u32> = faults.places.iter().copied().filter(own).collect();
            let whole = solved.d.clone();
            let nowhere = places.is_empty();
            for rings in BLENDED_RINGS.into_iter().filter(|_| !nowhere) {
                let mut d = self.blended(&whole, &plain, &places, rings);
                let sunk = self.contacts.sunk(&d, target).into_iter();
                for (v, moved) in sunk.chain(self.contacts.crossed(&d, base)) {
                    d[v as usize] = if solved.area[v as usize] {
                        moved
                    } else {
                        d[v as usize]
                    };
                }
                self.take(target, base, d, &mut solved.d, &mut faults);
            }
            self.take(target, base, plain, &mut solved.d, &mut faults);
        }
        for spans in [false, true] {
            if !faults.places.is_empty() {
                let mut d = solved.d.clone();
                let (around, contacts) = (&self.around, &self.contacts);
                relax(
                    head,
                    around,
                    contacts,
                    target,
                    base,
                    (&mut d, &solved.area),
                    spans,
                );
                self.take(target, base, d, &mut solved.d, &mut faults);
            }
        }
        Ok(solved)
    }

    /// Takes another skin if it has fewer faults.
    fn take(
        &self,
        target: &Target,
        base: Option<&[Vec3]>,
        other: Vec<Vec3>,
        d: &mut Vec<Vec3>,
        faults: &mut Faults,
    ) {
        let others = self.faults(target, base, &other);
        if others.rank() < faults.rank() {
            (*d, *faults) = (other, others);
        }
    }

    /// Where vertices are.
    fn moved<'d>(&self, d: &'d [Vec3], base: Option<&'d [Vec3]>) -> impl Fn(usize) -> Vec3 {
        let positions = &self.head.mesh.positions;
        move |v| positions[v] + d[v] + base.map_or(Vec3::zeros(), |b| b[v])
    }

    fn faults(&self, target: &Target, base: Option<&[Vec3]>, d: &[Vec3]) -> Faults {
        let (head, at) = (self.head, self.moved(d, base));
        let missed = target.must.iter().filter(|m| m.missed(head, &at).is_some());
        Faults {
            missed: missed.count(),
            places: self.around.faults(head, d, &at),
        }
    }

    /// `plain` around some places, `learned` so many rings away, evenly from one to the other.
    fn blended(&self, learned: &[Vec3], plain: &[Vec3], places: &[u32], rings: usize) -> Vec<Vec3> {
        let mut out = learned.to_vec();
        for (ring, some) in rings_about(&self.head.rings, places, rings)
            .iter()
            .enumerate()
        {
            let share = (2.0 * ring as f64 / rings as f64 - 1.0).max(0.0);
            for &v in some {
                let v = v as usize;
                out[v] = plain[v] + (learned[v] - plain[v]) * share;
            }
        }
        out
    }
}

/// Leaves of what two shapes make together what they do not make by being added; lengths below `nothing` are 0.
fn take_off_pairs(shapes: &mut [Shape], targets: &[Target], nothing: f64) {
    for k in 0..shapes.len() {
        let Some(of) = &targets[k].corrects else {
            continue;
        };
        for name in of {
            let Some(one) = targets.iter().position(|t| t.name == *name) else {
                continue;
            };
            let (one, both) = if one < k {
                let (before, after) = shapes.split_at_mut(k);
                (&before[one], &mut after[0])
            } else {
                let (before, after) = shapes.split_at_mut(one);
                (&after[0], &mut before[k])
            };
            for (v, d) in one.displacement.iter().enumerate() {
                both.displacement[v] -= d;
                both.area[v] |= one.area[v];
            }
        }
        for d in &mut shapes[k].displacement {
            if d.norm() < nothing {
                *d = Vec3::zeros();
            }
        }
    }
}

/// The shape as its landmarks alone would have it, without contacts: what the prior of the skin compares.
fn landmarks_alone(head: &Head, target: &Target) -> Target {
    let mut alone = target.clone();
    alone
        .controls
        .retain(|c| !head.points[LANDMARKS..].contains(&c.0));
    alone.exact = true;
    alone
}

/// Influence per shape: the screened field of its landmarks.
fn fields(head: &Head, targets: &[Target], settings: &Settings) -> Result<Vec<Vec<f64>>, Singular> {
    let w = head.eye_distance;
    // One field per set of control vertices; a recipe has one set, a table of controls may have several.
    let mut sets: Vec<(Vec<u32>, Vec<usize>)> = Vec::new();
    for (k, target) in targets.iter().enumerate() {
        let mut vertices: Vec<u32> = target
            .controls
            .iter()
            .map(|c| c.0)
            .filter(|v| !head.points[LANDMARKS..].contains(v))
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
        let field = Field::new(
            &head.operator,
            &head.rings,
            &head.mesh.positions,
            &head.skin,
            vertices,
            settings.reach * w,
            settings.disc * w,
        )?;
        let lengths: Vec<Vec<f64>> = members
            .iter()
            .map(|&k| {
                let goal = goals(head, &targets[k]);
                vertices.iter().map(|v| goal[v].norm()).collect()
            })
            .collect();
        for (&k, u) in members.iter().zip(field.spread(&lengths)) {
            influence[k] = u;
        }
    }
    Ok(influence)
}

/// The comparison method on the whole skin.
fn plain(head: &Head, targets: &[Target]) -> Result<Vec<Vec<Vec3>>, Singular> {
    let held = vec![false; head.skin.len()];
    let operator = head.operator.printed();
    targets
        .par_iter()
        .map(|target| {
            let goal = goals(head, target);
            let vertices: Vec<u32> = goal.keys().copied().collect();
            let shape: Vec<Vec3> = goal.values().copied().collect();
            let baked = solve::plain(&operator, &head.skin, &held, &vertices, &[shape], 100.0)?;
            Ok(baked.into_iter().next().unwrap_or_default())
        })
        .collect()
}

/// Procedure 1 as printed on the whole skin.
fn printed(head: &Head, targets: &[Target]) -> Result<Vec<Vec<Vec3>>, Singular> {
    let operator = head.operator.printed();
    let one = |target: &Target| {
        let controls: Vec<(u32, Vec3)> = goals(head, target).into_iter().collect();
        let positions = &head.mesh.positions;
        let eyes = head.eye_distance;
        procedure_1(
            &operator,
            &head.rings,
            positions,
            &head.skin,
            &controls,
            eyes,
        )
    };
    targets.par_iter().map(one).collect()
}

/// Displacements of all vertices; `controls` are (vertex, displacement), `operator` the printed one.
fn procedure_1(
    operator: &Operator,
    rings: &Rings,
    positions: &[Vec3],
    skin: &[bool],
    controls: &[(u32, Vec3)],
    eye_distance: f64,
) -> Result<Vec<Vec3>, Singular> {
    let system = System::new(operator, skin, controls.iter().map(|c| c.0))?;
    let spread = influence::propagate(rings, positions, controls, PRINTED_WEIGHT, PRINTED_STEPS);
    let delta = |v: usize| (spread[v].norm() * PRINTED_FACTOR / eye_distance).min(1.0);
    let mut d = vec![Vec3::zeros(); positions.len()];
    for &(v, displacement) in controls {
        d[v as usize] = displacement;
    }
    system.deform(operator, positions, &mut d, delta, PRINTED_ROUNDS);
    Ok(d)
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

#[cfg(test)]
mod tests {
    use nalgebra::DMatrix;

    use super::super::mesh::{Corner, Mesh};
    use super::*;

    const SIDE: usize = 9;
    const EYES: f64 = 4.0;

    /// A rough sheet of triangles: no row of its Laplacian is near 0, so that none is exempt.
    fn rough() -> (Mesh, Vec<[usize; 3]>) {
        let mut random = fastrand::Rng::with_seed(4);
        let mut mesh = Mesh {
            materials: vec!["skin".into()],
            ..Mesh::default()
        };
        for k in 0..SIDE * SIDE {
            let [a, b, c] = [(); 3].map(|()| random.f64() - 0.5);
            let (x, y) = ((k % SIDE) as f64, (k / SIDE) as f64);
            let z = (0.7 * x).sin() * (0.6 * y).cos() + 0.6 * c;
            mesh.positions.push(Vec3::new(x + 0.2 * a, y + 0.2 * b, z));
        }
        let mut triangles = Vec::new();
        for row in 0..SIDE - 1 {
            for col in 0..SIDE - 1 {
                let v = row * SIDE + col;
                triangles.push([v, v + 1, v + SIDE + 1]);
                triangles.push([v, v + SIDE + 1, v + SIDE]);
            }
        }
        for triangle in &triangles {
            let corner = |v: usize| Corner {
                vertex: v as u32,
                uv: None,
                normal: None,
            };
            mesh.push_face(&triangle.map(corner), 0);
        }
        (mesh, triangles)
    }

    /// Procedure 1 and equations (10) to (13) once more, from the paper: dense matrices, positions instead of displacements,
    /// angles instead of cross products, least squares by singular values instead of normal equations.
    fn from_the_paper(
        v0: &[Vec3],
        triangles: &[[usize; 3]],
        controls: &[(u32, Vec3)],
    ) -> Vec<Vec3> {
        let n = v0.len();
        let mut m = DMatrix::<f64>::zeros(n, n);
        let mut beside = vec![std::collections::BTreeSet::new(); n];
        for t in triangles {
            for k in 0..3 {
                let [a, b, c] = [t[k], t[(k + 1) % 3], t[(k + 2) % 3]];
                let omega = 0.5 / (v0[b] - v0[a]).angle(&(v0[c] - v0[a])).tan();
                m[(b, c)] += omega;
                m[(c, b)] += omega;
                m[(b, b)] -= omega;
                m[(c, c)] -= omega;
                beside[b].insert(c);
                beside[c].insert(b);
            }
        }
        let at = |x: &[Vec3]| DMatrix::from_fn(n, 3, |r, c| x[r][c]);
        let moved: std::collections::BTreeMap<usize, Vec3> =
            controls.iter().map(|&(v, d)| (v as usize, d)).collect();
        let (fixed, free): (Vec<usize>, Vec<usize>) = (0..n).partition(|v| moved.contains_key(v));
        // (12): ω of a control point 10, of others 1, by inverse length; control points keep their motion.
        let mut d: Vec<Vec3> = (0..n)
            .map(|v| moved.get(&v).copied().unwrap_or_default())
            .collect();
        for _ in 0..100 {
            let before = d.clone();
            for &v in &free {
                let weights = beside[v].iter().map(|&o| {
                    let omega = if moved.contains_key(&o) { 10.0 } else { 1.0 };
                    (o, omega / (v0[v] - v0[o]).norm())
                });
                let total: f64 = weights.clone().map(|(_, w)| w).sum();
                d[v] = weights.map(|(o, w)| before[o] * (w / total)).sum();
            }
        }
        // (13).
        let delta: Vec<f64> = d
            .iter()
            .map(|d| (d.norm() * 30.0 / EYES).min(1.0))
            .collect();
        let l0 = &m * at(v0);
        let least = l0
            .row_iter()
            .map(|row| row.norm())
            .fold(f64::INFINITY, f64::min);
        assert!(least > 0.02, "a row of {least} may be exempt");
        let of_free = m.select_columns(&free).svd(true, true);
        let there = DMatrix::from_fn(fixed.len(), 3, |r, c| (v0[fixed[r]] + moved[&fixed[r]])[c]);
        let given = m.select_columns(&fixed) * there;
        let mut v = v0.to_vec();
        let solve = |l: &DMatrix<f64>, v: &mut Vec<Vec3>| {
            let found = of_free.solve(&(l - &given), 1e-12).expect("both factors");
            for (r, &k) in free.iter().enumerate() {
                v[k] = Vec3::new(found[(r, 0)], found[(r, 1)], found[(r, 2)]);
            }
            for (k, d) in &moved {
                v[*k] = v0[*k] + d;
            }
        };
        solve(&l0, &mut v);
        for _ in 0..7 {
            let now = &m * at(&v);
            let wanted = DMatrix::from_fn(n, 3, |r, c| {
                let restored = l0.row(r).norm() / now.row(r).norm() * now[(r, c)];
                delta[r] * restored + (1.0 - delta[r]) * l0[(r, c)]
            });
            solve(&wanted, &mut v);
        }
        v.iter().zip(v0).map(|(v, v0)| v - v0).collect()
    }

    #[test]
    fn procedure_1_is_the_papers_by_a_second_implementation() {
        let (mesh, triangles) = rough();
        let count = mesh.positions.len();
        let node: Vec<u32> = (0..count as u32).collect();
        let operator = Operator::new(&mesh, &node, count, |_| false, |_| 1.0).printed();
        let controls = [
            (0, Vec3::zeros()),
            (SIDE as u32 - 1, Vec3::zeros()),
            ((SIDE * (SIDE - 1)) as u32, Vec3::zeros()),
            (count as u32 - 1, Vec3::zeros()),
            (count as u32 / 2, Vec3::new(0.3, -0.2, 0.9)),
            (count as u32 / 2 + 2, Vec3::new(-0.1, 0.4, 0.2)),
        ];
        let skin = vec![true; count];
        let rings = mesh.rings();
        let found = procedure_1(&operator, &rings, &mesh.positions, &skin, &controls, EYES);
        let found = found.expect("a regular system");
        let expected = from_the_paper(&mesh.positions, &triangles, &controls);
        let size = expected.iter().map(Vec3::norm).fold(0.0, f64::max);
        let apart = found.iter().zip(&expected).map(|(a, b)| (a - b).norm());
        let furthest = apart.fold(0.0, f64::max);
        println!("{furthest:.2e} apart of motions up to {size:.2}");
        assert!(size > 0.9 && furthest < 1e-7 * size, "{furthest}");
    }
}
