//! The recipe: which shapes there are and how their control points move, read from TOML and measured out on a head.
//!
//! The format is explained at the top of `config/blendshapes.toml`, which is built into the program. Lengths there are in
//! distances of the face itself; [`Recipe::targets`] turns them into displacements in the mesh's unit and axes.

use std::collections::HashSet;

use nalgebra::{Isometry3, Rotation3, Translation3, Unit, UnitQuaternion};
use serde::Deserialize;

use super::head::Head;
use super::jaw::{self, turned};
use super::mesh::Vec3;
use super::names::{self, LANDMARKS, NAMES, mirrored};
use super::shape::{MustRow, Requirement, RequirementKind, Target, Undo};
use super::visemes::{self, Viseme};
use mien_stages::expression::units::other_side;
use mien_workbench::fault::Fault;

/// The shipped recipe.
pub const SHIPPED: &str = include_str!("../../../config/blendshapes.toml");

/// Most shapes of a recipe; each is solved.
const MAX_SHAPES: usize = 512;
/// Largest length or share in a recipe: a head is four distances of its inner eye corners wide.
const MAX_LENGTH: f64 = 5.0;
/// Largest angle in a recipe, degrees.
const MAX_ANGLE_DEG: f64 = 90.0;

/// Two shapes whose sum needs a corrective.
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
    #[serde(default)]
    viseme: Vec<Viseme>,
}

impl Recipe {
    /// Reads TOML.
    ///
    /// # Errors
    /// If it is not TOML, has unknown keys, repeats a name, sums unknown shapes, or has numbers out of range.
    pub fn read(text: &str) -> Result<Self, Fault> {
        let recipe: Self = toml::from_str(text)?;
        recipe.check_numbers()?;
        let names = recipe.names();
        let visemes = recipe.viseme.iter().map(|viseme| viseme.name.as_str());
        let mut seen = HashSet::new();
        let mut all = names.iter().copied().chain(visemes);
        let wrong = |text: String| Err(Fault::new(text));
        if let Some(twice) = all.find(|name| !seen.insert(*name)) {
            return wrong(format!(
                "two shapes are called {twice:?}; names must differ"
            ));
        }
        let mut corrected = recipe.corrective.iter().flat_map(|pair| &pair.of);
        if let Some(name) = corrected.find(|name| !names.contains(&name.as_str())) {
            return wrong(format!(
                "a corrective: expected the names of two shapes of the recipe, found {name:?}"
            ));
        }
        visemes::check(&recipe.viseme, &names, |name| recipe.other_side(name))?;
        Ok(recipe)
    }

    /// The name of the mirrored shape; of a symmetric shape its own.
    fn other_side<'a>(&'a self, name: &'a str) -> &'a str {
        let pairs = self.shape.iter();
        let mut pairs = pairs.filter_map(|e| Some([&*e.name, e.mirror.as_deref()?]));
        let other = pairs.find_map(|[left, right]| match name {
            _ if name == left => Some(right),
            _ => (name == right).then_some(left),
        });
        other.unwrap_or(name)
    }

    /// Checks the number of shapes and the range of every number.
    fn check_numbers(&self) -> Result<(), Fault> {
        let count = self.names().len();
        if count > MAX_SHAPES {
            return Err(Fault::new(format!(
                "expected at most {MAX_SHAPES} shapes, found {count}"
            )));
        }
        let entries = self.shape.iter();
        let mut numbers = entries.flat_map(|e| e.numbers().map(|n| (&e.name, n)));
        let beyond = |(_, (value, most)): &(&String, (f64, f64))| !(-most..=*most).contains(value);
        match numbers.find(beyond) {
            Some((name, (value, most))) => Err(Fault::new(format!(
                "shape {name}: expected a number within {most} of 0, found {value}"
            ))),
            None => Ok(()),
        }
    }

    /// Names of all shapes, mirrors after their originals.
    pub fn names(&self) -> Vec<&str> {
        let sides = self.shape.iter().flat_map(Entry::sides);
        sides.map(|side| side.name()).collect()
    }

    /// Name and unit of every shape driven by one.
    pub fn units(&self) -> Vec<(String, String)> {
        let sides = self.shape.iter().flat_map(Entry::sides);
        let driven = sides.filter_map(|side| Some((side.name().to_owned(), side.unit()?)));
        driven.collect()
    }

    /// Computes the targets of every shape on a head.
    ///
    /// # Errors
    /// If a point, side or shape does not exist.
    pub fn targets(&self, head: &Head) -> Result<Vec<Target>, Fault> {
        let mut targets: Vec<Target> = Vec::new();
        for side in self.shape.iter().flat_map(Entry::sides) {
            targets.push(side.target(head, &targets)?);
        }
        Ok(targets)
    }

    /// Correctives of the listed pairs on both sides, as shapes; `targets` are all of the recipe's.
    pub fn correctives(&self, targets: &[Target]) -> Vec<Target> {
        let other_side = |name: &String| self.other_side(name).to_owned();
        let mut pairs: Vec<[String; 2]> = Vec::new();
        for pair in &self.corrective {
            for of in [pair.of.clone(), pair.of.each_ref().map(other_side)] {
                if !pairs.contains(&of) {
                    pairs.push(of);
                }
            }
        }
        let named = |name: &String| targets.iter().find(|t| t.name == *name);
        let together = |of: [String; 2]| Some(named(&of[0])?.combined(named(&of[1])?, of));
        pairs.into_iter().filter_map(together).collect()
    }

    /// The visemes, as sums of shapes.
    ///
    /// # Errors
    /// If a point in their requirements does not exist.
    pub fn visemes(&self, head: &Head) -> Result<Vec<Target>, Fault> {
        let one = |viseme: &Viseme| {
            let entry = &Entry {
                name: viseme.name.clone(),
                ..Entry::default()
            };
            let must = entry.sides().flat_map(|side| {
                let must = viseme.must.iter();
                must.map(move |asked| side.requirement(asked, head))
            });
            let sum = viseme.summed(|name| self.other_side(name));
            Ok(Target {
                name: viseme.name.clone(),
                sum: Some(sum),
                must: must.collect::<Result<_, _>>()?,
                ..Target::default()
            })
        };
        self.viseme.iter().map(one).collect()
    }
}

/// Unit of the numbers of `move`.
#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Measure {
    #[default]
    EyeDistance,
    EyeOpening,
    MouthWidth,
}

#[derive(Clone, Debug, Default, Deserialize)]
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
    jaw_opens: Option<f64>,
    #[serde(default)]
    jaw_shift: [f64; 3],
    #[serde(default)]
    close: Vec<(String, f64, f64)>,
    gaze: Option<(String, f64, f64)>,
    #[serde(default)]
    undo: Vec<(String, String, f64)>,
    tongue: Option<[f64; 2]>,
    #[serde(default)]
    must: Vec<MustRow>,
}

/// +1 for a point of the left side or the middle, −1 for the right.
fn outward(point: usize) -> f64 {
    let name = NAMES[point];
    let right = mirrored(point) != point && name.contains("_R");
    if right { -1.0 } else { 1.0 }
}

const POINTS: &str = "names of control points; the list stands at the top of the shipped recipe";
const DEEDS: &str = "part, meet, less, lids, up, down, out, in, forward or back in `must`";
const ABOVE: &str = "the name of a shape above it in the recipe, to take back";

impl Entry {
    /// The shape as written, and mirrored if it has a name for that.
    fn sides(&self) -> impl Iterator<Item = Side<'_>> {
        let side = |mirror| Side {
            entry: self,
            mirror,
        };
        std::iter::once(side(false)).chain(self.mirror.is_some().then(|| side(true)))
    }

    /// All numbers, each with its largest allowed value.
    fn numbers(&self) -> impl Iterator<Item = (f64, f64)> {
        let lengths = self.moves.iter().flat_map(|m| [m.1, m.2, m.3]);
        let lengths = lengths.chain(self.jaw_shift).chain(self.jaw_opens);
        let lengths = lengths.chain(self.tongue.into_iter().flatten());
        let closing = self.close.iter().flat_map(|c| [c.1, c.2]);
        let shares = self.jaw.iter().map(|j| j.1).chain(closing);
        let shares = shares.chain(self.undo.iter().map(|u| u.2));
        let bounds = self.must.iter().map(|asked| asked.parts().3);
        let near = lengths.chain(shares).chain(bounds).map(|x| (x, MAX_LENGTH));
        let gaze = self.gaze.iter().flat_map(|g| [g.1, g.2]);
        let angles = self.jaw_turn.into_iter().chain(gaze);
        near.chain(angles.map(|x| (x, MAX_ANGLE_DEG)))
    }
}

/// One side of an entry.
struct Side<'a> {
    entry: &'a Entry,
    mirror: bool,
}

/// The jaw's motion, and the landmarks' shares of it.
type Carried = (Isometry3<f64>, Vec<(u32, f64)>);
/// Displacements of all control points; `None` is free.
type Moves = Vec<Option<Vec3>>;

fn add(d: &mut Moves, point: usize, moved: Vec3) {
    *d[point].get_or_insert_with(Vec3::zeros) += moved;
}

impl<'a> Side<'a> {
    fn name(&self) -> &'a str {
        let Entry { name, mirror, .. } = self.entry;
        mirror.as_ref().filter(|_| self.mirror).unwrap_or(name)
    }

    fn unit(&self) -> Option<String> {
        let unit = self.entry.unit.as_ref()?;
        if !self.mirror {
            return Some(unit.clone());
        }
        let units = unit.split('|');
        let units = units.map(|one| other_side(one).unwrap_or_else(|| one.to_owned()));
        Some(units.collect::<Vec<_>>().join("|"))
    }

    /// −1 on the mirrored side.
    fn flip(&self) -> f64 {
        if self.mirror { -1.0 } else { 1.0 }
    }

    fn refuse(&self, expected: &str, found: &str) -> Fault {
        let shape = &self.entry.name;
        Fault::new(format!(
            "shape {shape}: expected {expected}, found {found:?}"
        ))
    }

    /// Control points of a row; `_S` stands for both sides.
    fn points(&self, words: &str) -> Result<Vec<usize>, Fault> {
        let mut points = Vec::new();
        for word in words.split_whitespace() {
            let both = word.contains("_S");
            let sides: &[&str] = if both { &["_L", "_R"] } else { &[""] };
            for side in sides {
                let point = names::index(&word.replace("_S", side));
                let point = point.ok_or_else(|| self.refuse(POINTS, word))?;
                points.push(if self.mirror { mirrored(point) } else { point });
            }
        }
        Ok(points)
    }

    fn side(&self, word: &str) -> Result<usize, Fault> {
        match word {
            "L" => Ok(usize::from(self.mirror)),
            "R" => Ok(usize::from(!self.mirror)),
            _ => Err(self.refuse("side \"L\" or \"R\"", word)),
        }
    }

    /// Sign of outwards at a point: to its own side, in the middle to the left.
    fn outwards(&self, point: usize) -> f64 {
        let middle = mirrored(point) == point;
        if middle { self.flip() } else { outward(point) }
    }

    /// A requirement of the shape.
    fn requirement(&self, asked: &MustRow, head: &Head) -> Result<Requirement, Fault> {
        let (what, first, other, bound) = asked.parts();
        // A row of lids names a side, not points.
        let named = if what == "lids" { "" } else { first };
        let (one, other) = (self.points(named)?, self.points(other)?);
        let along = |axis: usize, sign: f64| {
            RequirementKind::MinTravel(vec![head.axes.column(axis) * sign; one.len()])
        };
        let aside = |sign: f64| {
            let way = |&point: &usize| head.axes.column(0) * (sign * self.outwards(point));
            RequirementKind::MinTravel(one.iter().map(way).collect())
        };
        let kind = match what {
            "lids" => RequirementKind::MaxLidGap(self.side(first)?),
            "part" => RequirementKind::MinGap,
            "meet" => RequirementKind::MaxGapIncrease,
            "less" => RequirementKind::MaxRatio,
            "up" => along(1, 1.0),
            "down" => along(1, -1.0),
            "forward" => along(2, 1.0),
            "back" => along(2, -1.0),
            "out" => aside(1.0),
            "in" => aside(-1.0),
            _ => return Err(self.refuse(DEEDS, what)),
        };
        let words = one.iter().chain(&other).map(|&point| NAMES[point]);
        let words: Vec<&str> = std::iter::once(what).chain(words).collect();
        let vertices = |points: &[usize]| points.iter().map(|&p| head.points[p]).collect();
        Ok(Requirement {
            kind,
            one: vertices(&one),
            other: vertices(&other),
            bound,
            words: words.join(" "),
        })
    }

    /// Adds the rows of `move`.
    fn moved(&self, head: &Head, d: &mut Moves) -> Result<(), Fault> {
        for (words, outwards, up, forwards) in &self.entry.moves {
            for point in self.points(words)? {
                let unit = match self.entry.measure {
                    Measure::EyeDistance => head.eye_distance,
                    Measure::MouthWidth => head.mouth_width,
                    Measure::EyeOpening => head.eye_opening[usize::from(outward(point) < 0.0)],
                };
                let left = outwards * self.outwards(point);
                add(d, point, head.axes * Vec3::new(left, *up, *forwards) * unit);
            }
        }
        Ok(())
    }

    /// The jaw's motion, and the points' shares of it.
    fn jaw(&self, head: &Head, d: &mut Moves) -> Result<Option<Carried>, Fault> {
        let (turn, shift) = (self.entry.jaw_turn, self.entry.jaw_shift);
        if turn == [0.0; 2] && shift == [0.0; 3] {
            return Ok(None);
        }
        let mut shares = vec![0.0; LANDMARKS];
        let [most, left] = turn.map(f64::to_radians);
        let opens = self.entry.jaw_opens;
        let open = opens.map_or(most, |lowers| jaw::opening(head, lowers, most));
        // Opening rotates the chin down and back: from "out" towards "down", positive about the left axis.
        let turn = UnitQuaternion::from_axis_angle(&axis(head, 1), left * self.flip())
            * UnitQuaternion::from_axis_angle(&axis(head, 0), open);
        let [l, u, o] = shift;
        let shift = head.axes * Vec3::new(l * self.flip(), u, o) * head.eye_distance;
        let about = head.hinge;
        let jaw = Isometry3::from_parts(Translation3::from(about + shift - turn * about), turn);
        for (words, share) in &self.entry.jaw {
            for point in self.points(words)? {
                let p = head.point(point);
                let moved = turned(&jaw, &p);
                add(d, point, moved * *share);
                if let Some(of_point) = shares.get_mut(point) {
                    *of_point = *share;
                }
            }
        }
        let shares = head.points.iter().copied().zip(shares);
        Ok(Some((jaw, shares.collect())))
    }

    /// Subtracts a shape above; returned if it is one of the lips.
    fn undo(&self, head: &Head, above: &[Target], d: &mut Moves) -> Result<Option<Undo>, Fault> {
        let mut undo = None;
        for (words, shape, share) in &self.entry.undo {
            let other = above.iter().find(|t| t.name == *shape);
            let other = other.ok_or_else(|| self.refuse(ABOVE, shape))?;
            for point in self.points(words)? {
                let vertex = head.points[point];
                if let Some(&(_, moved)) = other.controls.iter().find(|(v, _)| *v == vertex) {
                    add(d, point, moved * -*share);
                }
                if matches!(point, 60..68) {
                    undo = Some((shape.clone(), *share));
                }
            }
        }
        Ok(undo)
    }

    fn target(&self, head: &Head, above: &[Target]) -> Result<Target, Fault> {
        let entry = self.entry;
        let mut d: Moves = vec![None; NAMES.len()];
        d[..LANDMARKS].fill(Some(Vec3::zeros()));
        self.moved(head, &mut d)?;
        let (jaw, shares) = self.jaw(head, &mut d)?.unzip();
        let undo = self.undo(head, above, &mut d)?;
        let mut close = [None; 2];
        for (side, amount, line) in &entry.close {
            close[self.side(side)?] = Some((*amount, *line));
        }
        let mut gaze = [None; 2];
        if let Some((side, up, outwards)) = &entry.gaze {
            let side = self.side(side)?;
            let out = if side == 0 { 1.0 } else { -1.0 };
            let aside = Rotation3::from_axis_angle(&axis(head, 1), out * outwards.to_radians());
            let up = Rotation3::from_axis_angle(&axis(head, 0), -up.to_radians());
            gaze[side] = Some(aside * up);
        }
        let controls = d.into_iter().zip(&head.points);
        let must = entry.must.iter().map(|asked| self.requirement(asked, head));
        Ok(Target {
            name: self.name().to_owned(),
            unit: self.unit(),
            upon: entry.upon.clone(),
            controls: controls.filter_map(|(d, &v)| Some((v, d?))).collect(),
            // A subtracted shape contains the prior already.
            derive: undo.is_none(),
            close,
            gaze,
            jaw,
            still_inside: shares.is_none(),
            shares: shares.unwrap_or_default(),
            tongue: entry.tongue.map(|[up, forwards]| {
                // The tongue lies in the jaw: its directions rotate with the jaw of the shape it is added to.
                let base = above.iter().find(|t| Some(&t.name) == entry.upon.as_ref());
                let turn = base.and_then(|t| t.jaw).unwrap_or_default().rotation;
                turn * (head.axes * Vec3::new(0.0, up, forwards) * head.eye_distance)
            }),
            undo,
            must: must.collect::<Result<_, _>>()?,
            ..Target::default()
        })
    }
}

fn axis(head: &Head, k: usize) -> Unit<Vec3> {
    Unit::new_normalize(head.axes.column(k).into_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use mien_outputs::osc::parameters::Parameter;
    use mien_stages::expression::units::Units;

    #[test]
    fn arkit_shapes_are_driven_by_the_unit_that_outputs_send_under_their_name() {
        let units = Units::shipped().columns(false);
        let units: Vec<&str> = units.iter().map(|unit| unit.as_str()).collect();
        let recipe = Recipe::read(SHIPPED).unwrap();
        let drives = recipe.units();
        for parameter in Parameter::arkit(false, &units) {
            let name = &parameter.name;
            // Heads have a shape for each side.
            if name == "browInnerUp" {
                continue;
            }
            let driver = drives.iter().find(|(shape, _)| shape == name);
            let (_, driver) = driver.unwrap_or_else(|| panic!("nothing drives {name}"));
            for (k, unit) in units.iter().enumerate() {
                let weights = (0..units.len()).map(|i| f32::from(u8::from(i == k)));
                let on_the_head = f32::from(u8::from(driver.split('|').any(|one| one == *unit)));
                assert_eq!(parameter.value(weights), on_the_head, "{name} by {unit}");
            }
        }
    }

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
        for (row, found) in [
            ("move = [[\"chin\", 0.0, 1e6, 0.0]]", "1000000"),
            ("jaw_turn = [nan, 0.0]", "NaN"),
            ("must = [[\"up\", \"chin\", inf]]", "inf"),
        ] {
            let text = format!("[[shape]]\nname = \"a\"\nwhy = \"\"\n{row}\n");
            let said = Recipe::read(&text).unwrap_err().to_string();
            assert!(
                said.starts_with("shape a: ") && said.ends_with(found),
                "{said}"
            );
        }
        let many = (0..600).map(|k| format!("[[shape]]\nname = \"s{k}\"\nwhy = \"\"\n"));
        let said = Recipe::read(&many.collect::<String>())
            .unwrap_err()
            .to_string();
        assert!(said.contains("found 600"), "{said}");
    }

    #[test]
    fn requirements_have_one_group_of_points_or_two() {
        let text = "[[shape]]\nname = \"a\"\nwhy = \"\"\nmust = [[\"part\", \"chin\", \"nose_tip\", 0.4], [\"lids\", \"L\", 0.03]]\n";
        let recipe = Recipe::read(text).unwrap();
        assert!(matches!(
            recipe.shape[0].must[..],
            [MustRow::Between(..), MustRow::Of(..)]
        ));
    }
}
