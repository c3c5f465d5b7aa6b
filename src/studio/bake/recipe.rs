//! The recipe: which shapes there are and how their control points move, read from TOML and measured out on a head.
//!
//! The format is explained at the top of `config/blendshapes.toml`, which is built into the program. Lengths there are in
//! distances of the face itself; [`Recipe::targets`] turns them into displacements in the mesh's unit and axes.

use serde::Deserialize;

use super::entry::Entry;
use super::head::Head;
pub use super::shape::Target;
use crate::studio::fault::Fault;

/// The shipped recipe.
pub const SHIPPED: &str = include_str!("../../../config/blendshapes.toml");

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

impl Recipe {
    /// Reads TOML.
    ///
    /// # Errors
    /// If it is not TOML, has unknown keys or gives a name twice.
    pub fn read(text: &str) -> Result<Self, Fault> {
        let recipe: Self = toml::from_str(text)?;
        let mut seen = std::collections::HashSet::new();
        if let Some(twice) = recipe.names().into_iter().find(|name| !seen.insert(*name)) {
            return Err(Fault::new(format!(
                "two shapes are called {twice:?}; names must differ"
            )));
        }
        for name in recipe.corrective.iter().flat_map(|pair| &pair.of) {
            if !seen.contains(name.as_str()) {
                return Err(Fault::new(format!(
                    "a corrective: expected the names of two shapes of the recipe, found {name:?}"
                )));
            }
        }
        Ok(recipe)
    }

    /// Names of all shapes, mirrors after their originals.
    pub fn names(&self) -> Vec<&str> {
        let sides = self.shape.iter().flat_map(Entry::sides);
        sides.map(|side| side.name()).collect()
    }

    /// Name and unit of every shape that has one.
    pub fn units(&self) -> Vec<(String, String)> {
        let sides = self.shape.iter().flat_map(Entry::sides);
        sides
            .filter_map(|side| Some((side.name().to_owned(), side.unit()?)))
            .collect()
    }

    /// Measures every shape out on a head.
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

    /// The pairs that do not simply add, both sides of each, as shapes of their own; `targets` are all of the recipe's.
    pub fn correctives(&self, targets: &[Target]) -> Vec<Target> {
        let sides = self.shape.iter();
        let sides = sides.filter_map(|e| Some([&e.name, e.mirror.as_ref()?]));
        let sides: Vec<_> = sides.flat_map(|[l, r]| [[l, r], [r, l]]).collect();
        let other_side = |name: &String| {
            let pair = sides.iter().find(|pair| pair[0] == name);
            pair.map_or(name, |pair| pair[1]).clone()
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
        let together = |of: [String; 2]| Some(named(&of[0])?.with(named(&of[1])?, of));
        pairs.into_iter().filter_map(together).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::super::entry::Asked;
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
