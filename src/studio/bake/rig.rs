//! All shapes of a head: influence, skin, what follows the skin.
//!
//! What is added to the paper here, shape by shape: contacts ([`super::skin`]), no triangle turned over ([`super::relax`]),
//! and the parts that are not skin: lower teeth and tongue move rigidly with the jaw, lashes and other loose parts with the
//! nearest skin, eyeballs turn with the gaze.
//!
//! Units: the mesh's. Cost: one factor of the area per shape, two to four for lids; shapes run in parallel.

use std::time::Instant;

use rayon::prelude::*;

use super::contact::Contacts;
use super::derive;
use super::goals::goals;
use super::head::{Follow, Head};
use super::influence::{self, Field};
use super::mesh::Vec3;
use super::names::LANDMARKS;
use super::recipe::Target;
use super::relax::relax;
use super::shape::Shape;
use super::skin::{Solved, skin};
use super::solve::{self, Settings, System};
use super::sparse::Singular;
use super::surroundings::Surroundings;

/// Displacements below this part of the eye distance are nothing: 0.04 micrometres.
const NOTHING: f64 = 1e-6;

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
    faer::set_global_parallelism(faer::Par::Seq);
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
        let lengths: Vec<Vec<f64>> = members
            .iter()
            .map(|&k| {
                let goal = goals(head, &targets[k]);
                vertices.iter().map(|v| goal[v].norm()).collect()
            })
            .collect();
        let spread = spread(head, vertices, &lengths, settings)?;
        for (&k, u) in members.iter().zip(spread) {
            influence[k] = u;
        }
    }
    let around = Surroundings::new(head);
    let contacts = Contacts::new(head);
    let whole = match method {
        Method::Aoi => None,
        Method::Paper => Some(printed(head, targets)?),
        Method::Laplacian => Some(plain(head, targets)?),
    };
    let one = |k: usize, base: Option<&[Vec3]>| {
        let start = Instant::now();
        let target = &targets[k];
        let solved = match &whole {
            Some(all) => Solved {
                d: all[k].clone(),
                area: head.skin.clone(),
                unknowns: 0,
            },
            None => {
                let place = |target| skin(head, &contacts, target, &influence[k], settings, base);
                let mut solved = place(target)?;
                if target.derive {
                    let mut more = target.clone();
                    for (v, d) in derive::derived(head, &solved.d) {
                        // What the table itself says of a point stands.
                        if !more.controls.iter().any(|c| c.0 == v) {
                            more.controls.push((v, d));
                        }
                    }
                    solved = place(&more)?;
                }
                if !target.exact {
                    relax(head, &around, &contacts, target, base, &mut solved);
                }
                solved
            }
        };
        let Solved {
            d: mut displacement,
            mut area,
            unknowns,
        } = solved;
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
    let positions = &head.mesh.positions;
    targets
        .par_iter()
        .map(|target| {
            let goal = goals(head, target);
            let controls: Vec<(u32, Vec3)> = goal.iter().map(|(&v, &d)| (v, d)).collect();
            let system = System::new(&operator, &head.skin, goal.keys().copied())?;
            let spread = influence::propagate(
                &head.rings,
                positions,
                &controls,
                PRINTED_WEIGHT,
                PRINTED_STEPS,
            );
            let delta = |v: usize| (spread[v].norm() * PRINTED_FACTOR / head.eye_distance).min(1.0);
            let mut d = vec![Vec3::zeros(); positions.len()];
            for (v, displacement) in controls {
                d[v as usize] = displacement;
            }
            system.deform(&operator, positions, &mut d, delta, PRINTED_ROUNDS);
            Ok(d)
        })
        .collect()
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
