//! Other programs' parameters as sums of our units: `config/rigs.toml`, resolved at start-up against the available units.
//!
//! The table is built in; the file documents its format.

use crate::base::prelude::*;
use alloc::borrow::Cow;
use alloc::collections::BTreeMap;

/// The built-in table.
const SHIPPED: &str = include_str!("../../../config/rigs.toml");

/// A gain, and the units it applies to.
type Term<'a> = (f32, Vec<&'a str>);

/// A parameter in terms of units. Of several units in one term the largest counts: left and right, where the parameter has
/// no sides, or a unit without sides, where the parameter has them.
#[derive(Debug, Default, PartialEq)]
struct Sum<'a> {
    /// Value at rest.
    rest: f32,
    /// Summed. The units of the first must be there, else the parameter is left out: what is not measured is
    /// not sent.
    terms: Vec<Term<'a>>,
}

impl<'a> Sum<'a> {
    /// Reads `0.75 - 0.75 AU43L|AU43 + AU5L`; `None` if it is no such sum.
    fn read(text: &'a str) -> Option<Self> {
        let mut sum = Self::default();
        // Sign of the term that is being read, and its gain, if one stands there.
        let (mut sign, mut gain) = (Some(1.0), None);
        for word in text.split_whitespace() {
            match (word, sign) {
                ("+" | "-", None) => sign = Some(if word == "+" { 1.0 } else { -1.0 }),
                ("+" | "-", Some(_)) if sum.terms.is_empty() => {
                    sum.rest = gain.take()?;
                    sign = Some(if word == "+" { 1.0 } else { -1.0 });
                }
                (_, Some(_))
                    if gain.is_none() && word.starts_with(|c: char| c.is_ascii_digit()) =>
                {
                    gain = Some(word.parse().ok()?);
                }
                (_, Some(plus)) if word.starts_with("AU") => {
                    let units = word.split('|').collect();
                    sum.terms.push((plus * gain.take().unwrap_or(1.0), units));
                    sign = None;
                }
                _ => return None,
            }
        }
        let ended = gain.is_none() && (sign.is_none() || text.is_empty());
        ended.then_some(sum)
    }
}

/// A parameter that can be computed.
pub(in crate::output) struct Parameter {
    pub(in crate::output) name: Cow<'static, str>,
    rest: f32,
    terms: Box<[(f32, Box<[usize]>)]>,
}

impl Parameter {
    /// The parameters of a rig for which there are units, by name.
    pub(in crate::output) fn of_rig(rig: &str, units: &[&str]) -> Box<[Self]> {
        Self::read(SHIPPED, rig, units).expect("the shipped table is read by a test")
    }

    /// ARKit's shapes: those that are measured, and if asked for those that are derived too.
    pub(in crate::output) fn of_arkit(derived: bool, units: &[&str]) -> Box<[Self]> {
        let mut shapes = Self::of_rig("arkit", units).into_vec();
        if derived {
            let others = Self::of_rig("derived", units).into_iter();
            let known: Vec<_> = shapes.iter().map(|shape| shape.name.clone()).collect();
            shapes.extend(others.filter(|other| !known.contains(&other.name)));
        }
        shapes.into()
    }

    /// A sum of units, if the first of them is there.
    pub(in crate::output) fn of_sum(sum: &str, units: &[&str]) -> Option<Self> {
        Self::resolve("", &Sum::read(sum)?, units)
    }

    fn read(text: &str, rig: &str, units: &[&str]) -> Result<Box<[Self]>, String> {
        let table = toml::from_str::<BTreeMap<String, BTreeMap<String, String>>>(text)
            .map_err(|error| format!("expected sections of names with sums in quotes: {error}"))?;
        let none = || format!("expected a section [{rig}], found none");
        let rows = table.get(rig).ok_or_else(none)?;
        let mut parameters = Vec::new();
        for (name, text) in rows {
            let expected = r#"a sum such as "0.5 AU20 + AU12L|AU12R""#;
            let sum = Sum::read(text)
                .ok_or_else(|| format!("expected {expected} for {name}, found {text:?}"))?;
            parameters.extend(Self::resolve(name, &sum, units));
        }
        Ok(parameters.into())
    }

    fn resolve(name: &str, sum: &Sum, units: &[&str]) -> Option<Self> {
        let index = |name: &&str| units.iter().position(|unit| unit == name);
        let there = |(gain, names): &Term| (*gain, names.iter().filter_map(index).collect());
        let terms: Box<[(f32, Box<[usize]>)]> = sum.terms.iter().map(there).collect();
        let measured = terms.first().is_some_and(|(_, units)| !units.is_empty());
        measured.then(|| Self {
            name: name.to_owned().into(),
            rest: sum.rest,
            terms,
        })
    }

    /// Each unit by itself, under the given names.
    pub(super) fn of_units<'a>(names: impl Iterator<Item = &'a str>) -> Box<[Self]> {
        names
            .enumerate()
            .map(|(unit, name)| Self {
                name: name.to_owned().into(),
                rest: 0.0,
                terms: Box::new([(1.0, Box::new([unit]) as Box<[usize]>)]),
            })
            .collect()
    }

    /// Whether there are weights that make it negative.
    pub(super) fn can_be_negative(&self) -> bool {
        let least = |(gain, units): &(f32, Box<[usize]>)| {
            if units.is_empty() { 0.0 } else { gain.min(0.0) }
        };
        self.rest + self.terms.iter().map(least).sum::<f32>() < 0.0
    }

    /// Value for weights of 0…1, limited to −1…1.
    pub(in crate::output) fn value(
        &self,
        weights: impl ExactSizeIterator<Item = f32> + Clone,
    ) -> f32 {
        let weight = |index: usize| weights.clone().nth(index).unwrap_or(0.0);
        let term = |(gain, units): &(f32, Box<[usize]>)| {
            gain * units.iter().map(|&unit| weight(unit)).fold(0.0, f32::max)
        };
        (self.rest + self.terms.iter().map(term).sum::<f32>()).clamp(-1.0, 1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TABLE: &str = r#"
        [arkit]
        Jaw = "AU26"
        Sided = "AU12L|AU12 - AU15L"
        Both = "0.5 AU4L|AU4R"
        Unknown = "AU99 + AU26"
        Lid = "0.75 - 0.75 AU43L"
        None = ""
    "#;

    #[test]
    fn parameters_are_sums_of_the_units_there_are() {
        let units = ["AU26", "AU12L", "AU4L", "AU4R", "AU43L"];
        let parameters = Parameter::read(TABLE, "arkit", &units).expect("a table");
        let weights = [0.5, 0.25, 0.4, 0.8, 1.0];
        let values: Vec<_> = parameters
            .iter()
            .map(|p| (&*p.name, p.value(weights.into_iter())))
            .collect();
        assert_eq!(
            values,
            [("Both", 0.4), ("Jaw", 0.5), ("Lid", 0.0), ("Sided", 0.25)]
        );
    }

    #[test]
    fn the_shipped_table_has_arkits_names_and_only_units_of_facs() {
        let table: BTreeMap<String, BTreeMap<String, String>> =
            toml::from_str(SHIPPED).expect("TOML");
        let sections: Vec<&str> = table.keys().map(String::as_str).collect();
        assert_eq!(sections, ["arkit", "derived", "unified", "vrm0", "vrm1"]);
        assert_eq!(table["arkit"].len(), 52);
        for (name, text) in table.values().flatten() {
            let sum = Sum::read(text).unwrap_or_else(|| panic!("{name}: {text}"));
            for unit in sum.terms.iter().flat_map(|(_, units)| units) {
                let digits = unit.trim_start_matches("AU").trim_end_matches(['L', 'R']);
                assert!(digits.parse().is_ok_and(|n: u8| n <= 64), "{name}: {unit}");
            }
        }
        // Every unit that we emit reaches ARKit's names, and all of these are sent.
        let shipped = crate::expression::units::Units::shipped();
        let columns = shipped.columns(false);
        let units: Vec<&str> = columns.iter().map(|unit| unit.as_str()).collect();
        let sent = |derived| Parameter::of_arkit(derived, &units).len();
        assert_eq!((sent(false), sent(true)), (41, 52));
        for unit in shipped.columns(false) {
            let reached = Parameter::of_rig("arkit", &[unit.as_str()]);
            assert!(!reached.is_empty() || unit == "AU25", "{unit}");
        }
    }

    #[test]
    fn refuses_what_is_no_sum_with_one_sentence() {
        for bad in [
            "AU1 AU2",
            "+",
            "AU1 +",
            "0.5",
            "0.5 0.5 AU1",
            "1 - + AU1",
            "jaw",
            "AU1 - 2",
        ] {
            let table = TABLE.replace("\"AU26\"", &format!("{bad:?}"));
            let told = Parameter::read(&table, "arkit", &["AU26"]).err();
            assert_eq!(
                told,
                Some(format!(
                    "expected a sum such as \"0.5 AU20 + AU12L|AU12R\" for Jaw, found {bad:?}"
                ))
            );
        }
        let told = Parameter::read("[vrm0]", "vrm1", &[]).err();
        assert_eq!(
            told.as_deref(),
            Some("expected a section [vrm1], found none")
        );
    }
}
