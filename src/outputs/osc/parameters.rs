//! Other programs' parameters as sums of our units: `config/rigs.toml`, resolved at start-up against the available units.
//!
//! The table is built in; the file documents its format, and a test reads all of it.

use alloc::collections::BTreeMap;
use mien_stages::base::prelude::*;

/// The built-in table.
const SHIPPED: &str = include_str!("../../../config/rigs.toml");

/// A gain, and the indices of its units, of which the largest weight counts: left and right for a parameter without sides, or a
/// unit without sides as a substitute.
type Term = (f32, Box<[usize]>);

/// A parameter that can be computed from the available units.
pub struct Parameter {
    /// The receiver's name for it.
    pub name: String,
    /// Value at rest.
    rest: f32,
    /// Lower limit.
    least: f32,
    /// Terms of the sum.
    terms: Box<[Term]>,
}

impl Parameter {
    /// The parameters of a rig that the available units allow, by name.
    pub(crate) fn for_rig(rig: &str, units: &[&str]) -> Vec<Self> {
        Self::read(SHIPPED, rig, units).expect("the shipped table is read by a test")
    }

    fn read(text: &str, rig: &str, units: &[&str]) -> Option<Vec<Self>> {
        let table = toml::from_str::<BTreeMap<String, BTreeMap<String, String>>>(text).ok()?;
        let rows = table.get(rig)?.iter();
        let parameters = rows.filter_map(|(name, sum)| Self::parse_sum(name, sum, units));
        Some(parameters.collect())
    }

    /// ARKit's shapes that are measured and, if `derived`, those derived from related units.
    pub fn arkit(derived: bool, units: &[&str]) -> Vec<Self> {
        let mut shapes = Self::for_rig("arkit", units);
        if derived {
            let others = Self::for_rig("derived", units).into_iter();
            let known: Vec<_> = shapes.iter().map(|shape| shape.name.clone()).collect();
            shapes.extend(others.filter(|other| !known.contains(&other.name)));
        }
        shapes
    }

    /// Parses a sum such as `0.75 - 0.75 AU43L|AU43 + AU5L`; `None` if no unit of its first term is available, since then it is
    /// not measured.
    pub(crate) fn parse_sum(name: &str, sum: &str, units: &[&str]) -> Option<Self> {
        let (mut rest, mut sign, mut gain) = (0.0, 1.0, None);
        let (sum, least) = match sum.split_once(" >= ") {
            Some((sum, least)) => (sum, least.parse().ok()?),
            None => (sum, -1.0),
        };
        let mut terms: Vec<Term> = Vec::new();
        for word in sum.split_whitespace() {
            match word {
                "+" | "-" => {
                    // A leading number without a unit is the value at rest.
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

    /// One parameter per unit, with the given names.
    pub(super) fn for_units<'a>(names: impl Iterator<Item = &'a str>) -> Vec<Self> {
        let parameter = |(unit, name): (usize, &str)| Self {
            name: name.to_owned(),
            rest: 0.0,
            least: 0.0,
            terms: Box::new([(1.0, Box::from([unit]))]),
        };
        names.enumerate().map(parameter).collect()
    }

    /// Whether its value can be negative.
    pub(super) fn can_be_negative(&self) -> bool {
        let least = |(gain, units): &Term| if units.is_empty() { 0.0 } else { gain.min(0.0) };
        self.least < 0.0 && self.rest + self.terms.iter().map(least).sum::<f32>() < 0.0
    }

    /// Value for weights of 0…1, between the lower limit (−1 by default) and 1.
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
        let expected = "arkit derived unified unified_more vrm0 vrm1";
        assert_eq!(sections.join(" "), expected);
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
        let sent = |derived| Parameter::arkit(derived, &units).len();
        assert_eq!((sent(false), sent(true)), (41, 52));
        for unit in shipped.columns(false) {
            let reached = Parameter::for_rig("arkit", &[unit.as_str()]);
            assert!(!reached.is_empty() || unit == "AU25", "{unit}");
        }
    }
}
