//! One shape: as it is asked for, what it must do as its recipe says, and as the solver leaves it for report and files.
//!
//! Units: the mesh's; of what it must do, eye distances.

use nalgebra::{Isometry3, Rotation3};
use serde::Deserialize;

use super::head::Head;
use super::mesh::Vec3;

/// Between the names of two shapes in that of their corrective, as rigging tools and engines write it.
pub const PAIR: &str = "_";

/// The two shapes that `name` is the corrective of, if it is one; `exists` says whether there is a shape of a name.
pub fn pair(name: &str, exists: impl Fn(&str) -> bool) -> Option<[&str; 2]> {
    let (a, b) = name.split_once(PAIR)?;
    (exists(a) && exists(b)).then_some([a, b])
}

/// One baked shape.
#[derive(Clone, Debug, Default)]
pub struct Shape {
    /// Name of the morph target.
    pub name: String,
    /// Expression unit that drives it.
    pub unit: Option<String>,
    /// Shape it is meant to be added to.
    pub upon: Option<String>,
    /// What it must do and does not, in words; `None` if nothing is asked of it.
    pub misses: Option<Vec<String>>,
    /// Per vertex, mesh units.
    pub displacement: Vec<Vec3>,
    /// Vertices that were allowed to move.
    pub area: Vec<bool>,
}

impl Shape {
    /// Where it moves vertices that are at `places`.
    pub(super) fn moved(&self, places: &[Vec3]) -> Vec<Vec3> {
        let moved = places.iter().zip(&self.displacement);
        moved.map(|(p, d)| p + d).collect()
    }

    /// The shapes it is added to.
    pub fn beneath<'a>(&'a self, all: &'a [Self]) -> impl Iterator<Item = &'a Self> {
        let pair = pair(&self.name, |name| all.iter().any(|s| s.name == name));
        let pair = pair.into_iter().flatten();
        let names = self.upon.as_deref().into_iter().chain(pair);
        names.filter_map(|name| all.iter().find(|s| s.name == *name))
    }
}

/// Displacement of a shape as it is meant to be seen: with the shape it is meant to be added to.
pub fn shown(shapes: &[Shape], k: usize) -> Vec<Vec3> {
    let mut d = shapes[k].displacement.clone();
    for base in shapes[k].beneath(shapes) {
        for (d, b) in d.iter_mut().zip(&base.displacement) {
            *d += b;
        }
    }
    d
}

/// The name of a shape that is taken back, and its share.
pub type Undo = (String, f64);

/// One shape measured out on a head: what moves, in the mesh's unit and axes.
#[derive(Clone, Debug, Default)]
pub struct Target {
    /// Name of the morph target.
    pub name: String,
    /// Expression unit that drives it.
    pub unit: Option<String>,
    /// Shape it is meant to be added to.
    pub upon: Option<String>,
    /// Displacements of control vertices; those not named are free.
    pub controls: Vec<(u32, Vec3)>,
    /// The controls are met exactly: contacts are not parted, and faults do not change the skin.
    pub exact: bool,
    /// The skin between the controls moves as learned from sculpted shapes, see [`super::prior`].
    pub derive: bool,
    /// Lid closing per eye (left, right): amount and line.
    pub close: [Option<(f64, f64)>; 2],
    /// Eyeball rotation per eye.
    pub gaze: [Option<Rotation3<f64>>; 2],
    /// Motion of the jaw and what it carries.
    pub jaw: Option<Isometry3<f64>>,
    /// Share of that motion at the points on the skin; all shapes of a recipe have it at the same ones.
    pub shares: Vec<(u32, f64)>,
    /// What lies in the mouth stays, as it does in a recipe's shape without a jaw; a table of controls says itself what moves.
    pub still_inside: bool,
    /// Displacement of the tongue's tip.
    pub tongue: Option<Vec3>,
    /// Shape whose effect on the lip line is taken back, and its share.
    pub undo: Option<Undo>,
    /// The two shapes that this one makes together; what is left of it when both are taken off is their corrective.
    pub corrects: Option<[String; 2]>,
    /// It is not solved: other shapes and what it takes of each.
    pub sum: Option<Vec<(String, f64)>>,
    /// What is checked once it is baked.
    pub must: Vec<Promise>,
}

impl Target {
    /// Both shapes at once. Of two that close a lid the one that closes it further says how.
    pub(super) fn with(&self, other: &Self, of: [String; 2]) -> Self {
        let mut controls = self.controls.clone();
        for &(v, d) in &other.controls {
            match controls.iter_mut().find(|c| c.0 == v) {
                Some(control) => control.1 += d,
                None => controls.push((v, d)),
            }
        }
        let sides = [0, 1];
        Self {
            name: of.join(PAIR),
            controls,
            exact: self.exact || other.exact,
            derive: self.derive && other.derive,
            close: sides.map(|side: usize| match (self.close[side], other.close[side]) {
                (Some(a), Some(b)) => Some(if a.0 >= b.0 { a } else { b }),
                (a, b) => a.or(b),
            }),
            gaze: sides.map(|side: usize| self.gaze[side].or(other.gaze[side])),
            jaw: self.jaw.or(other.jaw),
            shares: if self.jaw.is_some() {
                &self.shares
            } else {
                &other.shares
            }
            .clone(),
            still_inside: self.still_inside && other.still_inside,
            tongue: self.tongue.or(other.tongue),
            corrects: Some(of),
            ..Self::default()
        }
    }
}

/// What is asked.
#[derive(Clone, Debug)]
pub enum Deed {
    /// The middles of two groups of points end at least so far apart.
    Part,
    /// They end at most so much further apart than in the neutral, where lips need not touch.
    Meet,
    /// One moves at most so many times as far as the other.
    Less,
    /// The lid lines of an eye end at most so far apart anywhere.
    Lids(usize),
    /// The points move at least so far, each in its direction.
    Move(Vec<Vec3>),
}

/// Added to the name of what the file has under the name of a shape.
pub(super) const ORIGINAL: &str = ".original";

/// Whether two names are one as programs write them: `eyeBlinkLeft`, `EyeBlink_L`, `shapes.eyeBlink_L`.
pub(super) fn alike(one: &str, other: &str) -> bool {
    let plain = |name: &str| {
        let last = name.rsplit('.').next().unwrap_or_default();
        let plain = last.replace(['_', '-', ' '], "").to_lowercase();
        let side = plain.strip_suffix("eft").or(plain.strip_suffix("ight"));
        side.map_or(plain.clone(), str::to_owned)
    };
    plain(one) == plain(other)
}

/// A row of `must`: with one group of points or with two.
#[derive(Clone, Debug, Deserialize)]
#[serde(untagged)]
pub(super) enum Asked {
    Of(String, String, f64),
    Between(String, String, String, f64),
}

impl Asked {
    /// What is asked, the first and the other group of points, and the bound.
    pub(super) fn parts(&self) -> (&str, &str, &str, f64) {
        match self {
            Self::Of(what, one, bound) => (what, one, "", *bound),
            Self::Between(what, one, other, bound) => (what, one, other, *bound),
        }
    }
}

/// One thing that a shape must do.
#[derive(Clone, Debug)]
pub struct Promise {
    /// What.
    pub deed: Deed,
    /// The points meant, as vertices.
    pub one: Vec<u32>,
    /// The points they are compared with.
    pub other: Vec<u32>,
    /// How far, at least or at most.
    pub bound: f64,
    /// The same as the recipe says it.
    pub words: String,
}

impl Promise {
    /// What is found instead, in words; `at` is where vertices are.
    pub fn missed(&self, head: &Head, at: &impl Fn(u32) -> Vec3) -> Option<String> {
        let w = head.eye_distance;
        let middle = |some: &[u32], p: &dyn Fn(u32) -> Vec3| {
            some.iter().map(|&v| p(v)).sum::<Vec3>() / some.len().max(1) as f64
        };
        let neutral = |v: u32| head.mesh.positions[v as usize];
        let moves = |some: &[u32]| (middle(some, at) - middle(some, &neutral)).norm();
        let apart =
            |p: &dyn Fn(u32) -> Vec3| (middle(&self.one, p) - middle(&self.other, p)).norm() / w;
        let found = match &self.deed {
            Deed::Part => apart(at),
            Deed::Meet => apart(at) - apart(&neutral),
            Deed::Less => moves(&self.one) / moves(&self.other).max(f64::MIN_POSITIVE),
            Deed::Lids(side) => head.lid_gap(*side, at) / w,
            Deed::Move(ways) => {
                let along = self.one.iter().zip(ways);
                let along = along.map(|(&v, way)| (at(v) - neutral(v)).dot(way));
                along.sum::<f64>() / self.one.len().max(1) as f64 / w
            }
        };
        let kept = match self.deed {
            Deed::Part | Deed::Move(_) => found >= self.bound,
            _ => found <= self.bound,
        };
        (!kept).then(|| format!("{}: {found:.2} instead of {:.2}", self.words, self.bound))
    }
}
