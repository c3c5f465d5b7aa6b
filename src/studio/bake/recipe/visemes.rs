//! Visemes of a recipe: mouth shapes of speech, as sums of its shapes.

use std::collections::HashSet;

use serde::Deserialize;

use super::{Asked, Entry, Recipe};
use crate::studio::bake::head::Head;
use crate::studio::bake::shape::Target;
use crate::studio::fault::Fault;

/// A mouth shape of speech: a sum of shapes, each of which stands for its mirror image as well.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Viseme {
    pub(super) name: String,
    sum: Vec<(String, f64)>,
    #[serde(default)]
    must: Vec<Asked>,
    #[serde(rename = "why")]
    _why: String,
}

/// Visemes of a recipe, and shapes of one of them.
const VISEMES: usize = 15;
/// The most that a viseme takes of a shape.
const WEIGHT: f64 = 1.5;

impl Recipe {
    /// That there are not too many visemes, and that each sums up shapes of the recipe.
    pub(super) fn check_visemes(&self) -> Result<(), Fault> {
        let found = self.viseme.len();
        if found > VISEMES {
            return Err(Fault::new(format!(
                "expected at most {VISEMES} visemes, found {found}"
            )));
        }
        let names = self.names();
        for Viseme { name, sum, .. } in &self.viseme {
            let mut seen = HashSet::new();
            let mut rows = sum.iter().enumerate();
            let bad = rows.find(|(k, (name, weight))| {
                let known = names.contains(&name.as_str()) && (0.0..=WEIGHT).contains(weight);
                // Of a pair either side stands for both.
                !known || *k == VISEMES || !seen.insert(self.other_side(name).min(name))
            });
            if let Some((_, row)) = bad {
                return Err(Fault::new(format!(
                    "viseme {name}: expected at most {VISEMES} shapes of the recipe, each or its mirror image once, with weights from 0 to {WEIGHT}, found {row:?}"
                )));
            }
        }
        Ok(())
    }

    /// The visemes, as shapes that are sums of others.
    ///
    /// # Errors
    /// If a point of what they must do does not exist.
    pub fn visemes(&self, head: &Head) -> Result<Vec<Target>, Fault> {
        let one = |viseme: &Viseme| {
            let entry = &Entry {
                name: viseme.name.clone(),
                ..Entry::default()
            };
            let must = entry.sides().flat_map(|side| {
                let must = viseme.must.iter();
                must.map(move |asked| side.promise(asked, head))
            });
            let sum = viseme.sum.iter().flat_map(|(name, weight)| {
                let other = Some(self.other_side(name)).filter(|other| other != name);
                let both = std::iter::once(&**name).chain(other);
                both.map(|name| (name.to_owned(), *weight))
            });
            Ok(Target {
                name: viseme.name.clone(),
                sum: Some(sum.collect()),
                must: must.collect::<Result<_, _>>()?,
                ..Target::default()
            })
        };
        self.viseme.iter().map(one).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_viseme_sums_up_shapes_that_are_there_once_each_with_weights_that_make_sense() {
        let shapes = "[[shape]]\nname = \"aL\"\nmirror = \"aR\"\nwhy = \"\"\n";
        let viseme = |name: &str, sum: &str| {
            let text =
                format!("{shapes}[[viseme]]\nname = \"{name}\"\nsum = [{sum}]\nwhy = \"\"\n");
            Recipe::read(&text).map(drop)
        };
        let good = "[\"aR\", 1.5]";
        assert!(viseme("v", good).is_ok() && viseme("v", "").is_ok());
        for sum in [
            "[\"b\", 1.0]",
            "[\"v\", 1.0]",
            "[\"aL\", 1.6]",
            "[\"aL\", -0.1]",
            "[\"aL\", nan]",
            "[\"aL\", 0.5], [\"aR\", 0.5]",
        ] {
            let refused = viseme("v", sum).expect_err(sum).to_string();
            assert!(refused.starts_with("viseme v: expected"), "{refused}");
        }
        assert!(viseme("aR", good).is_err());
        let one = |k| format!("[[viseme]]\nname = \"v{k}\"\nsum = []\nwhy = \"\"\n");
        let many = |n| Recipe::read(&(shapes.to_owned() + &(0..n).map(one).collect::<String>()));
        assert!(many(15).is_ok() && many(16).is_err());
    }
}
