//! Other programs' parameters as sums of our units: `config/rigs.toml`, resolved at start-up against the available units.
//!
//! The table is built in; the file documents its format, and a test reads all of it.

use alloc::collections::BTreeMap;
use mien_stages::base::prelude::*;

/// The built-in table.
const SHIPPED: &str = include_str!("../../../config/rigs.toml");

/// A gain, and the units it applies to. Of several units in one term the largest counts: left and right, where the parameter
/// has no sides, or a unit without sides, where the parameter has them.
type Term = (f32, Box<[usize]>);

/// A parameter that can be computed.
pub struct Parameter {
    /// Its name, as the receiver knows it.
    pub name: String,
    /// Value at rest.
    rest: f32,
    /// What it does not go below.
    least: f32,
    /// Summed.
    terms: Box<[Term]>,
}

impl Parameter {
    /// The parameters of a rig for which there are units, by name.
    pub(crate) fn of_rig(rig: &str, units: &[&str]) -> Vec<Self> {
        Self::read(SHIPPED, rig, units).expect("the shipped table is read by a test")
    }

    fn read(text: &str, rig: &str, units: &[&str]) -> Option<Vec<Self>> {
        let table = toml::from_str::<BTreeMap<String, BTreeMap<String, String>>>(text).ok()?;
        let rows = table.get(rig)?.iter();
        let parameters = rows.filter_map(|(name, sum)| Self::of_sum(name, sum, units));
        Some(parameters.collect())
    }

    /// ARKit's shapes: those that are measured, and if asked for those that are derived too.
    pub fn of_arkit(derived: bool, units: &[&str]) -> Vec<Self> {
        let mut shapes = Self::of_rig("arkit", units);
        if derived {
            let others = Self::of_rig("derived", units).into_iter();
            let known: Vec<_> = shapes.iter().map(|shape| shape.name.clone()).collect();
            shapes.extend(others.filter(|other| !known.contains(&other.name)));
        }
        shapes
    }

    /// A sum such as `0.75 - 0.75 AU43L|AU43 + AU5L`; `None` unless a unit of its first term is there: what is not measured is
    /// not sent.
    pub(crate) fn of_sum(name: &str, sum: &str, units: &[&str]) -> Option<Self> {
        let (mut rest, mut sign, mut gain) = (0.0, 1.0, None);
        let (sum, least) = match sum.split_once(" >= ") {
            Some((sum, least)) => (sum, least.parse().ok()?),
            None => (sum, -1.0),
        };
        let mut terms: Vec<Term> = Vec::new();
        for word in sum.split_whitespace() {
            match word {
                "+" | "-" => {
                    // A number by itself, first, is the value at rest.
                    rest += gain.take().unwrap_or(0.0);
                    sign = if word == "+" { 1.0 } else { -1.0 };
                }
                _ if word.starts_with("AU") => {
                    let index = |name: &str| units.iter().position(|unit| *unit == name);
                    let known = word.split('|').filter_map(index).collect();
                    terms.push((sign * gain.take().unwrap_or(1.0), known));
                }
                number => gain = number.parse().ok(),
            }
        }
        let measured = terms.first().is_some_and(|(_, units)| !units.is_empty());
        measured.then(|| Self {
            name: name.to_owned(),
            rest,
            least,
            terms: terms.into(),
        })
    }

    /// Each unit by itself, under the given names.
    pub(super) fn of_units<'a>(names: impl Iterator<Item = &'a str>) -> Vec<Self> {
        names
            .enumerate()
            .map(|(unit, name)| Self {
                name: name.to_owned(),
                rest: 0.0,
                least: 0.0,
                terms: Box::new([(1.0, Box::from([unit]))]),
            })
            .collect()
    }

    /// Whether there are weights that make it negative.
    pub(super) fn can_be_negative(&self) -> bool {
        let least = |(gain, units): &Term| if units.is_empty() { 0.0 } else { gain.min(0.0) };
        self.least < 0.0 && self.rest + self.terms.iter().map(least).sum::<f32>() < 0.0
    }

    /// Value for weights of 0…1, limited to −1…1 or to what the sum says.
    pub fn value(&self, weights: impl ExactSizeIterator<Item = f32> + Clone) -> f32 {
        let weight = |index: usize| weights.clone().nth(index).unwrap_or(0.0);
        let term = |(gain, units): &Term| {
            gain * units.iter().map(|&unit| weight(unit)).fold(0.0, f32::max)
        };
        (self.rest + self.terms.iter().map(term).sum::<f32>()).clamp(self.least, 1.0)
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
        assert_eq!(
            sections,
            [
                "arkit",
                "derived",
                "unified",
                "unified_more",
                "vrm0",
                "vrm1"
            ]
        );
        assert_eq!(table["arkit"].len(), 52);
        for (name, text) in table.values().flatten() {
            // Signs stand between terms, gains before units, a number by itself only first.
            let sum = text.strip_suffix(" >= 0").unwrap_or(text);
            let terms: Vec<&str> = sum.split([' ']).collect();
            let terms: Vec<&[&str]> = terms.split(|word| ["+", "-"].contains(word)).collect();
            for (i, term) in terms.into_iter().enumerate() {
                let is_number = |word: &str| word.parse().is_ok_and(|n: f32| n >= 0.0);
                let (gain, units) = match *term {
                    [""] if text.is_empty() => continue,
                    [rest] if i == 0 && is_number(rest) && text != rest => continue,
                    [units] => ("1", units),
                    [gain, units] => (gain, units),
                    _ => panic!("{name}: {text}"),
                };
                assert!(is_number(gain), "{name}: {gain}");
                for unit in units.split('|') {
                    let digits = unit.strip_prefix("AU").unwrap_or_default();
                    let digits = digits.trim_end_matches(['L', 'R']);
                    assert!(digits.parse().is_ok_and(|n: u8| n <= 64), "{name}: {unit}");
                }
            }
        }
        // Every unit that we emit reaches ARKit's names, and all of these are sent.
        let shipped = mien_stages::expression::units::Units::shipped();
        let columns = shipped.columns(false);
        let units: Vec<&str> = columns.iter().map(|unit| unit.as_str()).collect();
        let sent = |derived| Parameter::of_arkit(derived, &units).len();
        assert_eq!((sent(false), sent(true)), (41, 52));
        for unit in shipped.columns(false) {
            let reached = Parameter::of_rig("arkit", &[unit.as_str()]);
            assert!(!reached.is_empty() || unit == "AU25", "{unit}");
        }
    }
}
