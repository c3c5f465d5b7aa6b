//! One shape: as requested, with its requirements by the recipe, and as solved, for report and files.
//!
//! Units: the mesh's; of requirements, eye distances.

use nalgebra::{Isometry3, Rotation3};
use serde::Deserialize;

use super::head::Head;
use super::mesh::Vec3;

/// Separator of two shapes in the name of their corrective, as in rigging tools and engines.
pub const PAIR: &str = "_";

/// The two shapes that the corrective `name` belongs to; `None` if it is no corrective. `exists` tells which shapes
/// exist.
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
    /// Shape that it is added to.
    pub upon: Option<String>,
    /// Unmet requirements, in words; `None` without requirements.
    pub misses: Option<Vec<String>>,
    /// Per vertex, mesh units.
    pub displacement: Vec<Vec3>,
    /// Vertices that were allowed to move.
    pub area: Vec<bool>,
}

impl Shape {
    /// Positions of vertices at `places` displaced by it.
    pub(super) fn moved(&self, places: &[Vec3]) -> Vec<Vec3> {
        let moved = places.iter().zip(&self.displacement);
        moved.map(|(p, d)| p + d).collect()
    }

    /// The shapes that it is added to.
    pub fn bases<'a>(&'a self, all: &'a [Self]) -> impl Iterator<Item = &'a Self> {
        let pair = pair(&self.name, |name| all.iter().any(|s| s.name == name));
        let pair = pair.into_iter().flatten();
        let names = self.upon.as_deref().into_iter().chain(pair);
        names.filter_map(|name| all.iter().find(|s| s.name == *name))
    }
}

/// Displacement of shape `k` including the shapes that it is added to.
pub fn shown(shapes: &[Shape], k: usize) -> Vec<Vec3> {
    let mut d = shapes[k].displacement.clone();
    for base in shapes[k].bases(shapes) {
        for (d, b) in d.iter_mut().zip(&base.displacement) {
            *d += b;
        }
    }
    d
}

/// Name and share of a subtracted shape.
pub type Undo = (String, f64);

/// The target of a shape on a head, in the mesh's unit and axes.
#[derive(Clone, Debug, Default)]
pub struct Target {
    /// Name of the morph target.
    pub name: String,
    /// Expression unit that drives it.
    pub unit: Option<String>,
    /// Shape that it is added to.
    pub upon: Option<String>,
    /// Displacements of control vertices; others are free.
    pub controls: Vec<(u32, Vec3)>,
    /// The controls are met exactly: neither contacts nor defects change the skin.
    pub exact: bool,
    /// The skin between the controls moves as learned from sculpted shapes, see [`super::prior`].
    pub derive: bool,
    /// Lid closing per eye (left, right): amount, and height of the meeting line as share of the opening.
    pub close: [Option<(f64, f64)>; 2],
    /// Eyeball rotation per eye.
    pub gaze: [Option<Rotation3<f64>>; 2],
    /// Rigid motion of the jaw.
    pub jaw: Option<Isometry3<f64>>,
    /// Shares of that motion at the points on the skin, at the same ones for all shapes of a recipe.
    pub shares: Vec<(u32, f64)>,
    /// The mouth's inside is fixed, as in a recipe's shape without a jaw; a table of controls states all motion
    /// itself.
    pub still_inside: bool,
    /// Displacement of the tongue's tip.
    pub tongue: Option<Vec3>,
    /// Shape whose effect on the lip line is subtracted, and its share.
    pub undo: Option<Undo>,
    /// The two shapes combined here; the corrective is this displacement less theirs.
    pub corrects: Option<[String; 2]>,
    /// Weights of other shapes whose sum it is, instead of being solved.
    pub sum: Option<Vec<(String, f64)>>,
    /// Requirements checked after baking.
    pub must: Vec<Requirement>,
}

impl Target {
    /// Both shapes at once, named after `of`. Where both close a lid, the one that closes it further counts.
    pub(super) fn combined(&self, other: &Self, of: [String; 2]) -> Self {
        let mut controls = self.controls.clone();
        for &(v, d) in &other.controls {
            match controls.iter_mut().find(|c| c.0 == v) {
                Some(control) => control.1 += d,
                None => controls.push((v, d)),
            }
        }
        let sides = [0, 1];
        let moves_jaw = if self.jaw.is_some() { self } else { other };
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
            jaw: moves_jaw.jaw,
            shares: moves_jaw.shares.clone(),
            still_inside: self.still_inside && other.still_inside,
            tongue: self.tongue.or(other.tongue),
            corrects: Some(of),
            ..Self::default()
        }
    }
}

/// What is required, with [`Requirement::bound`] in eye distances.
#[derive(Clone, Debug)]
pub enum RequirementKind {
    /// Least final distance of the middles of two groups of points.
    MinGap,
    /// Largest increase of that distance over the neutral's, where lips need not touch.
    MaxGapIncrease,
    /// Largest displacement of the first group over that of the second.
    MaxRatio,
    /// Largest final distance of the lid lines of an eye (0 left, 1 right).
    MaxLidGap(usize),
    /// Least displacement of the points, each in its direction.
    MinTravel(Vec<Vec3>),
}

/// Suffix for the name of an existing target or expression under the name of a shape.
pub(super) const ORIGINAL: &str = ".original";

/// Whether two names are spellings of one: `eyeBlinkLeft`, `EyeBlink_L`, `shapes.eyeBlink_L`.
pub(super) fn is_same_name(one: &str, other: &str) -> bool {
    let plain = |name: &str| {
        let last = name.rsplit('.').next().unwrap_or_default();
        let plain = last.replace(['_', '-', ' '], "").to_lowercase();
        let side = plain.strip_suffix("eft").or(plain.strip_suffix("ight"));
        side.map_or(plain.clone(), str::to_owned)
    };
    plain(one) == plain(other)
}

/// A row of `must`, with one group of points or two.
#[derive(Clone, Debug, Deserialize)]
#[serde(untagged)]
pub(super) enum MustRow {
    Of(String, String, f64),
    Between(String, String, String, f64),
}

impl MustRow {
    /// Word of the requirement, first and second group of points, and bound.
    pub(super) fn parts(&self) -> (&str, &str, &str, f64) {
        match self {
            Self::Of(what, one, bound) => (what, one, "", *bound),
            Self::Between(what, one, other, bound) => (what, one, other, *bound),
        }
    }
}

/// One requirement of a shape.
#[derive(Clone, Debug)]
pub struct Requirement {
    /// What is required.
    pub kind: RequirementKind,
    /// First group of points, as vertices.
    pub one: Vec<u32>,
    /// Second group of points, as vertices.
    pub other: Vec<u32>,
    /// Bound, eye distances or a ratio.
    pub bound: f64,
    /// The row of the recipe, for messages.
    pub words: String,
}

impl Requirement {
    /// The value found and the bound, in words; `None` if the requirement is met. `at` gives positions.
    pub fn missed(&self, head: &Head, at: &impl Fn(u32) -> Vec3) -> Option<String> {
        let w = head.eye_distance;
        let middle = |some: &[u32], p: &dyn Fn(u32) -> Vec3| {
            some.iter().map(|&v| p(v)).sum::<Vec3>() / some.len().max(1) as f64
        };
        let neutral = |v: u32| head.mesh.positions[v as usize];
        let moves = |some: &[u32]| (middle(some, at) - middle(some, &neutral)).norm();
        let apart =
            |p: &dyn Fn(u32) -> Vec3| (middle(&self.one, p) - middle(&self.other, p)).norm() / w;
        let found = match &self.kind {
            RequirementKind::MinGap => apart(at),
            RequirementKind::MaxGapIncrease => apart(at) - apart(&neutral),
            RequirementKind::MaxRatio => {
                moves(&self.one) / moves(&self.other).max(f64::MIN_POSITIVE)
            }
            RequirementKind::MaxLidGap(side) => head.lid_gap(*side, at) / w,
            RequirementKind::MinTravel(ways) => {
                let along = self.one.iter().zip(ways);
                let along = along.map(|(&v, way)| (at(v) - neutral(v)).dot(way));
                along.sum::<f64>() / self.one.len().max(1) as f64 / w
            }
        };
        let kept = match self.kind {
            RequirementKind::MinGap | RequirementKind::MinTravel(_) => found >= self.bound,
            _ => found <= self.bound,
        };
        (!kept).then(|| format!("{}: {found:.2} instead of {:.2}", self.words, self.bound))
    }
}
