//! The recipe: which shapes there are and how their control points move, read from TOML and measured out on a head.
//!
//! The format is explained at the top of `config/blendshapes.toml`, which is built into the program. Lengths there are in
//! distances of the face itself; [`Recipe::targets`] turns them into displacements in the mesh's unit and axes.

use nalgebra::{Isometry3, Rotation3, Translation3, Unit, UnitQuaternion};
use serde::Deserialize;

use super::head::Head;
use super::mesh::Vec3;
use super::names::{self, NAMES, mirrored};
use super::promise::{Deed, Promise};
use super::shape::PAIR;

/// The shipped recipe.
pub const SHIPPED: &str = include_str!("../../../config/blendshapes.toml");

/// Why a recipe is refused.
#[derive(Debug, thiserror::Error)]
pub enum RecipeError {
    /// Not TOML, or a key that does not exist.
    #[error("{0}")]
    Toml(#[from] toml::de::Error),
    /// A shape's entry.
    #[error("shape {shape}: expected {expected}, found {found:?}")]
    Entry {
        /// Shape.
        shape: String,
        /// What should be there.
        expected: &'static str,
        /// The word.
        found: String,
    },
    /// A corrective of a shape that the recipe does not have.
    #[error("a corrective: expected the names of two shapes of the recipe, found {found:?}")]
    Pair {
        /// The name it gives.
        found: String,
    },
    /// A name given twice.
    #[error("two shapes are called {name:?}; names must differ")]
    Twice {
        /// The name.
        name: String,
    },
}

/// What the numbers of `move` count.
#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Measure {
    #[default]
    EyeDistance,
    EyeOpening,
    MouthWidth,
}

/// A row of `must`: with one group of points or with two.
#[derive(Clone, Debug, Deserialize)]
#[serde(untagged)]
enum Asked {
    Of(String, String, f64),
    Between(String, String, String, f64),
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    name: String,
    unit: Option<String>,
    mirror: Option<String>,
    upon: Option<String>,
    #[serde(rename = "why")]
    _why: String,
    #[serde(default, rename = "in")]
    measure: Measure,
    #[serde(default, rename = "move")]
    moves: Vec<(String, f64, f64, f64)>,
    #[serde(default)]
    jaw: Vec<(String, f64)>,
    #[serde(default)]
    jaw_turn: [f64; 2],
    #[serde(default)]
    jaw_shift: [f64; 3],
    #[serde(default)]
    close: Vec<(String, f64, f64)>,
    gaze: Option<(String, f64, f64)>,
    #[serde(default)]
    undo: Vec<(String, String, f64)>,
    tongue: Option<[f64; 2]>,
    #[serde(default)]
    must: Vec<Asked>,
}

/// Two shapes that do not simply add.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Pair {
    of: [String; 2],
    #[serde(rename = "why")]
    _why: String,
}

/// The recipe as read.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Recipe {
    shape: Vec<Entry>,
    #[serde(default)]
    corrective: Vec<Pair>,
}

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
    /// The controls must be met exactly, even at the price of an inverted triangle.
    pub exact: bool,
    /// The skin between the controls moves as learned from sculpted shapes, see [`super::prior`].
    pub derive: bool,
    /// Lid closing per eye (left, right): amount and line.
    pub close: [Option<(f64, f64)>; 2],
    /// Eyeball rotation per eye.
    pub gaze: [Option<Rotation3<f64>>; 2],
    /// Motion of the jaw and what it carries.
    pub jaw: Option<Isometry3<f64>>,
    /// Displacement of the tongue's tip.
    pub tongue: Option<Vec3>,
    /// Shape whose effect on the lip line is taken back, and its share.
    pub undo: Option<(String, f64)>,
    /// The two shapes that this one makes together; what is left of it when both are taken off is their corrective.
    pub corrects: Option<[String; 2]>,
    /// What is checked once it is baked.
    pub must: Vec<Promise>,
}

/// The unit of the other side: a trailing L becomes R and the other way round.
fn swapped(unit: &str) -> String {
    match (unit.strip_suffix('L'), unit.strip_suffix('R')) {
        (Some(stem), _) => format!("{stem}R"),
        (_, Some(stem)) => format!("{stem}L"),
        _ => unit.to_owned(),
    }
}

/// +1 for a point of the left side or the middle, −1 for one of the right.
fn outward(point: usize) -> f64 {
    let name = NAMES[point];
    let right = mirrored(point) != point && name.contains("_R");
    if right { -1.0 } else { 1.0 }
}

impl Recipe {
    /// Reads TOML.
    ///
    /// # Errors
    /// If it is not TOML, has unknown keys or gives a name twice.
    pub fn read(text: &str) -> Result<Self, RecipeError> {
        let recipe: Self = toml::from_str(text)?;
        let mut seen = std::collections::HashSet::new();
        for entry in &recipe.shape {
            for name in std::iter::once(&entry.name).chain(&entry.mirror) {
                if !seen.insert(name.as_str()) {
                    return Err(RecipeError::Twice { name: name.clone() });
                }
            }
        }
        for name in recipe.corrective.iter().flat_map(|pair| &pair.of) {
            if !seen.contains(name.as_str()) {
                return Err(RecipeError::Pair {
                    found: name.clone(),
                });
            }
        }
        Ok(recipe)
    }

    /// Names of all shapes, mirrors after their originals.
    #[must_use]
    pub fn names(&self) -> Vec<&str> {
        self.shape
            .iter()
            .flat_map(|e| std::iter::once(e.name.as_str()).chain(e.mirror.as_deref()))
            .collect()
    }

    /// Name and unit of every shape that has one.
    #[must_use]
    pub fn units(&self) -> Vec<(String, String)> {
        let mut out = Vec::new();
        for entry in &self.shape {
            let Some(unit) = &entry.unit else { continue };
            out.push((entry.name.clone(), unit.clone()));
            if let Some(name) = &entry.mirror {
                out.push((name.clone(), swapped(unit)));
            }
        }
        out
    }

    /// Measures every shape out on a head.
    ///
    /// # Errors
    /// If a point, side or shape does not exist.
    pub fn targets(&self, head: &Head) -> Result<Vec<Target>, RecipeError> {
        let mut targets: Vec<Target> = Vec::new();
        for entry in &self.shape {
            let target = entry.target(head, &targets, false)?;
            targets.push(target);
            if entry.mirror.is_some() {
                let target = entry.target(head, &targets, true)?;
                targets.push(target);
            }
        }
        Ok(targets)
    }

    /// The pairs that do not simply add, both sides of each, as shapes of their own; `targets` are all of the recipe's.
    #[must_use]
    pub fn correctives(&self, targets: &[Target]) -> Vec<Target> {
        let other_side = |name: &String| {
            let entries = self.shape.iter();
            let mut sides = entries.filter_map(|e| Some((&e.name, e.mirror.as_ref()?)));
            let other = sides.find_map(|(left, right)| match name {
                name if name == left => Some(right),
                name if name == right => Some(left),
                _ => None,
            });
            other.unwrap_or(name).clone()
        };
        let mut pairs: Vec<[String; 2]> = Vec::new();
        for pair in &self.corrective {
            for of in [pair.of.clone(), pair.of.each_ref().map(other_side)] {
                if !pairs.contains(&of) {
                    pairs.push(of);
                }
            }
        }
        let named = |name: &String| targets.iter().find(|t| t.name == *name);
        let together = |of: [String; 2]| {
            let [a, b] = of.each_ref().map(named);
            Some(a?.with(b?, of))
        };
        pairs.into_iter().filter_map(together).collect()
    }
}

impl Target {
    /// Both shapes at once. Of two that close a lid the one that closes it further says how.
    fn with(&self, other: &Self, of: [String; 2]) -> Self {
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
            tongue: self.tongue.or(other.tongue),
            corrects: Some(of),
            ..Self::default()
        }
    }
}

const POINTS: &str = "names of control points; the list stands at the top of the shipped recipe";
const DEEDS: &str = "part, meet, less, lids, up, down, out, in, forward or back in `must`";
const ABOVE: &str = "the name of a shape above it in the recipe, to take back";

impl Entry {
    fn refuse(&self, expected: &'static str, found: &str) -> RecipeError {
        RecipeError::Entry {
            shape: self.name.clone(),
            expected,
            found: found.to_owned(),
        }
    }

    /// Control points of a row; `_S` stands for both sides.
    fn points(&self, words: &str, mirror: bool) -> Result<Vec<usize>, RecipeError> {
        let mut points = Vec::new();
        for word in words.split_whitespace() {
            let both = word.find("_S").filter(|&at| {
                let tail = &word[at + 2..];
                tail.is_empty() || tail.starts_with(|c: char| c == '_' || c.is_ascii_digit())
            });
            let spelled = match both {
                Some(at) => ["_L", "_R"]
                    .map(|s| format!("{}{s}{}", &word[..at], &word[at + 2..]))
                    .to_vec(),
                None => vec![word.to_owned()],
            };
            for name in spelled {
                let point = names::index(&name).ok_or_else(|| self.refuse(POINTS, word))?;
                points.push(if mirror { mirrored(point) } else { point });
            }
        }
        Ok(points)
    }

    fn side(&self, word: &str, mirror: bool) -> Result<usize, RecipeError> {
        match word {
            "L" => Ok(usize::from(mirror)),
            "R" => Ok(usize::from(!mirror)),
            _ => Err(self.refuse("side \"L\" or \"R\"", word)),
        }
    }

    /// What the shape must do.
    fn promises(&self, head: &Head, mirror: bool) -> Result<Vec<Promise>, RecipeError> {
        let promise = |asked: &Asked| {
            let (what, one, other, bound) = match asked {
                Asked::Of(what, one, bound) => (what, one, "", *bound),
                Asked::Between(what, one, other, bound) => (what, one, other.as_str(), *bound),
            };
            if what == "lids" {
                return Ok(Promise {
                    deed: Deed::Lids(self.side(one, mirror)?),
                    one: Vec::new(),
                    other: Vec::new(),
                    bound,
                    words: "lids".into(),
                });
            }
            let (one, other) = (self.points(one, mirror)?, self.points(other, mirror)?);
            let outwards = |&point: &usize| {
                let middle = mirrored(point) == point;
                let sign = if middle && mirror {
                    -1.0
                } else {
                    outward(point)
                };
                head.axes.column(0) * sign
            };
            let along =
                |axis: usize, sign: f64| Deed::Move(vec![head.axes.column(axis) * sign; one.len()]);
            let deed = match what.as_str() {
                "part" => Deed::Part,
                "meet" => Deed::Meet,
                "less" => Deed::Less,
                "up" => along(1, 1.0),
                "down" => along(1, -1.0),
                "forward" => along(2, 1.0),
                "back" => along(2, -1.0),
                "out" => Deed::Move(one.iter().map(outwards).collect()),
                "in" => Deed::Move(one.iter().map(|p| -outwards(p)).collect()),
                _ => {
                    return Err(self.refuse(DEEDS, what));
                }
            };
            let mut words = what.clone();
            for &point in one.iter().chain(&other) {
                words = words + " " + NAMES[point];
            }
            let vertices = |points: Vec<usize>| points.into_iter().map(|p| head.points[p]);
            Ok(Promise {
                deed,
                one: vertices(one).collect(),
                other: vertices(other).collect(),
                bound,
                words,
            })
        };
        self.must.iter().map(promise).collect()
    }

    /// Long because every field of a shape's entry has its place in the target.
    fn target(&self, head: &Head, above: &[Target], mirror: bool) -> Result<Target, RecipeError> {
        let w = head.eye_distance;
        let flip = if mirror { -1.0 } else { 1.0 };
        let mut d: Vec<Option<Vec3>> = vec![None; NAMES.len()];
        d[..names::LANDMARKS].fill(Some(Vec3::zeros()));
        for (words, outwards, up, forwards) in &self.moves {
            for point in self.points(words, mirror)? {
                let unit = match self.measure {
                    Measure::EyeDistance => w,
                    Measure::MouthWidth => head.mouth_width,
                    Measure::EyeOpening => head.eye_opening[usize::from(outward(point) < 0.0)],
                };
                let left = if mirrored(point) == point {
                    outwards * flip
                } else {
                    outwards * outward(point)
                };
                *d[point].get_or_insert_with(Vec3::zeros) +=
                    head.axes * Vec3::new(left, *up, *forwards) * unit;
            }
        }
        let jaw = (self.jaw_turn != [0.0; 2] || self.jaw_shift != [0.0; 3]).then(|| {
            let axis = |k: usize| Unit::new_normalize(head.axes.column(k).into_owned());
            let [open, left] = self.jaw_turn.map(f64::to_radians);
            // Opening turns the chin down and back: from "out" towards "down", positive about the left axis.
            let turn = UnitQuaternion::from_axis_angle(&axis(1), left * flip)
                * UnitQuaternion::from_axis_angle(&axis(0), open);
            let [l, u, o] = self.jaw_shift;
            let shift = head.axes * Vec3::new(l * flip, u, o) * w;
            let about = head.hinge;
            Isometry3::from_parts(Translation3::from(about + shift - turn * about), turn)
        });
        if let Some(jaw) = &jaw {
            for (words, share) in &self.jaw {
                for point in self.points(words, mirror)? {
                    let p = head.point(point);
                    let moved = jaw.transform_point(&p.into()).coords - p;
                    *d[point].get_or_insert_with(Vec3::zeros) += moved * *share;
                }
            }
        }
        let mut undo: Option<(String, f64)> = None;
        for (words, shape, share) in &self.undo {
            let other = above.iter().find(|t| t.name == *shape);
            let other = other.ok_or_else(|| self.refuse(ABOVE, shape))?;
            for point in self.points(words, mirror)? {
                let vertex = head.points[point];
                if let Some(&(_, moved)) = other.controls.iter().find(|(v, _)| *v == vertex) {
                    *d[point].get_or_insert_with(Vec3::zeros) -= moved * *share;
                }
                if matches!(point, 60..68) {
                    undo = Some((shape.clone(), *share));
                }
            }
        }
        let mut close = [None; 2];
        for (side, amount, line) in &self.close {
            close[self.side(side, mirror)?] = Some((*amount, *line));
        }
        let mut gaze = [None; 2];
        if let Some((side, up, outwards)) = &self.gaze {
            let side = self.side(side, mirror)?;
            let out = if side == 0 { 1.0 } else { -1.0 };
            let axis = |k: usize| Unit::new_normalize(head.axes.column(k).into_owned());
            gaze[side] = Some(
                Rotation3::from_axis_angle(&axis(1), out * outwards.to_radians())
                    * Rotation3::from_axis_angle(&axis(0), -up.to_radians()),
            );
        }
        let unit = self
            .unit
            .as_ref()
            .map(|unit| if mirror { swapped(unit) } else { unit.clone() });
        let name = if mirror {
            self.mirror.clone().unwrap_or_default()
        } else {
            self.name.clone()
        };
        Ok(Target {
            name,
            unit,
            upon: self.upon.clone(),
            controls: d
                .into_iter()
                .enumerate()
                .filter_map(|(k, d)| Some((head.points[k], d?)))
                .collect(),
            exact: false,
            // What is taken back was placed already.
            derive: undo.is_none(),
            close,
            gaze,
            jaw,
            tongue: self.tongue.map(|[up, forwards]| {
                // The tongue lies in the jaw: its directions turn with the jaw of the shape it is added to.
                let base = above.iter().find(|t| Some(&t.name) == self.upon.as_ref());
                let turn = base.and_then(|t| t.jaw).unwrap_or_default().rotation;
                turn * (head.axes * Vec3::new(0.0, up, forwards) * w)
            }),
            undo,
            corrects: None,
            must: self.promises(head, mirror)?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shipped_recipe_has_67_shapes_and_all_of_arkit() {
        let recipe = Recipe::read(SHIPPED).unwrap();
        let names = recipe.names();
        assert_eq!(names.len(), 67);
        for name in [
            "eyeBlinkLeft",
            "eyeBlinkRight",
            "jawOpen",
            "mouthClose",
            "tongueOut",
            "noseSneerRight",
        ] {
            assert!(names.contains(&name), "{name}");
        }
    }

    #[test]
    fn a_bad_recipe_is_refused_with_the_place() {
        let twice = "[[shape]]\nname = \"a\"\nmirror = \"a\"\nwhy = \"\"\n";
        let alone = "[[shape]]\nname = \"a\"\nwhy = \"\"\n[[corrective]]\nof = [\"a\", \"b\"]\nwhy = \"\"\n";
        let found = Recipe::read(alone).unwrap_err().to_string();
        assert!(found.ends_with("found \"b\""), "{found}");
        assert!(
            Recipe::read(twice)
                .unwrap_err()
                .to_string()
                .contains("two shapes")
        );
        let unknown = "[[shape]]\nname = \"a\"\nwhy = \"\"\nmoev = []\n";
        assert!(
            Recipe::read(unknown)
                .unwrap_err()
                .to_string()
                .contains("moev")
        );
    }

    #[test]
    fn what_a_shape_must_do_is_read_with_one_group_of_points_or_two() {
        let text = "[[shape]]\nname = \"a\"\nwhy = \"\"\nmust = [[\"part\", \"chin\", \"nose_tip\", 0.4], [\"lids\", \"L\", 0.03]]\n";
        let recipe = Recipe::read(text).unwrap();
        assert!(matches!(
            recipe.shape[0].must[..],
            [Asked::Between(..), Asked::Of(..)]
        ));
    }
}
