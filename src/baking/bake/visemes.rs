//! Visemes of a recipe: mouth shapes of speech, as sums of its shapes.

use std::collections::HashSet;

use serde::Deserialize;

use super::shape::MustRow;
use mien_workbench::fault::Fault;

/// A mouth shape of speech: a sum of shapes, each of which stands for its mirror image as well.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Viseme {
    pub(super) name: String,
    sum: Vec<(String, f64)>,
    #[serde(default)]
    pub(super) must: Vec<MustRow>,
    #[serde(rename = "why")]
    _why: String,
}

/// Most visemes of a recipe, and most shapes of one.
const MAX_VISEMES: usize = 15;
/// Largest weight of a shape in a viseme.
const MAX_WEIGHT: f64 = 1.5;

impl Viseme {
    /// The shapes of the sum and their weights, both sides of a pair; `other_side` is the mirror image of a shape, or
    /// the shape itself.
    pub(super) fn summed<'a>(
        &'a self,
        other_side: impl Fn(&'a str) -> &'a str,
    ) -> Vec<(String, f64)> {
        let sum = self.sum.iter().flat_map(|(name, weight)| {
            let other = Some(other_side(name)).filter(|other| other != name);
            let both = std::iter::once(&**name).chain(other);
            both.map(|name| (name.to_owned(), *weight))
        });
        sum.collect()
    }
}

/// Checks the number of visemes, and that each sums shapes of these names; `other_side` as in [`Viseme::summed`].
pub(super) fn check<'a>(
    visemes: &'a [Viseme],
    names: &[&str],
    other_side: impl Fn(&'a str) -> &'a str,
) -> Result<(), Fault> {
    let found = visemes.len();
    if found > MAX_VISEMES {
        return Err(Fault::new(format!(
            "expected at most {MAX_VISEMES} visemes, found {found}"
        )));
    }
    for Viseme { name, sum, .. } in visemes {
        let mut seen = HashSet::new();
        let mut rows = sum.iter().enumerate();
        let bad = rows.find(|(k, (name, weight))| {
            let known = names.contains(&name.as_str()) && (0.0..=MAX_WEIGHT).contains(weight);
            // Either side of a pair stands for both.
            !known || *k == MAX_VISEMES || !seen.insert(other_side(name).min(name))
        });
        if let Some((_, row)) = bad {
            return Err(Fault::new(format!(
                "viseme {name}: expected at most {MAX_VISEMES} shapes of the recipe, each or its mirror image once, with weights from 0 to {MAX_WEIGHT}, found {row:?}"
            )));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use crate::bake::recipe::Recipe;

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
