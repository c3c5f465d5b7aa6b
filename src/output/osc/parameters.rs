//! Other programmes' parameters as sums of our units: tables of names, resolved against the units there are at the start.

#[cfg(not(feature = "std"))]
use crate::prelude::*;
use alloc::borrow::Cow;

/// A gain, and the units it applies to.
pub(super) type Term = (f32, &'static [&'static str]);

/// A parameter in terms of units. Of several units in one term the largest counts: left and right, where the parameter has
/// no sides, or a unit without sides, where the parameter has them.
pub(super) struct Definition {
    pub(super) name: &'static str,
    /// Value at rest.
    pub(super) rest: f32,
    /// Summed. The units of the first must be there, else the parameter is left out: what is not measured is
    /// not sent.
    pub(super) terms: &'static [Term],
}

/// A parameter that can be computed.
pub(super) struct Parameter {
    pub(super) name: Cow<'static, str>,
    rest: f32,
    terms: Box<[(f32, Box<[usize]>)]>,
}

impl Parameter {
    /// Those of the table for which there are units.
    pub(super) fn resolve(table: &[Definition], units: &[&str]) -> Box<[Self]> {
        let indices = |names: &[&str]| -> Box<[usize]> {
            names
                .iter()
                .filter_map(|name| units.iter().position(|unit| unit == name))
                .collect()
        };
        let resolved = table.iter().map(|definition| Self {
            name: definition.name.into(),
            rest: definition.rest,
            terms: definition
                .terms
                .iter()
                .map(|&(gain, names)| (gain, indices(names)))
                .collect(),
        });
        resolved
            .filter(|parameter| {
                parameter
                    .terms
                    .first()
                    .is_some_and(|(_, units)| !units.is_empty())
            })
            .collect()
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
    pub(super) fn value(&self, weights: impl ExactSizeIterator<Item = f32> + Clone) -> f32 {
        let weight = |index: usize| weights.clone().nth(index).unwrap_or(0.0);
        let term = |(gain, units): &(f32, Box<[usize]>)| {
            gain * units.iter().map(|&unit| weight(unit)).fold(0.0, f32::max)
        };
        (self.rest + self.terms.iter().map(term).sum::<f32>()).clamp(-1.0, 1.0)
    }
}

/// A definition that is 0 at rest.
pub(super) const fn plain(name: &'static str, terms: &'static [Term]) -> Definition {
    Definition {
        name,
        rest: 0.0,
        terms,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parameters_are_sums_of_the_units_there_are() {
        let table = [
            plain("Jaw", &[(1.0, &["AU26"])]),
            plain("Sided", &[(1.0, &["AU12L", "AU12"]), (-1.0, &["AU15L"])]),
            plain("Both", &[(0.5, &["AU4L", "AU4R"])]),
            plain("Unknown", &[(1.0, &["AU99"]), (1.0, &["AU26"])]),
            Definition {
                name: "Lid",
                rest: 0.75,
                terms: &[(-0.75, &["AU43L"])],
            },
        ];
        let parameters = Parameter::resolve(&table, &["AU26", "AU12L", "AU4L", "AU4R", "AU43L"]);
        let weights = [0.5, 0.25, 0.4, 0.8, 1.0];
        let values: Vec<_> = parameters
            .iter()
            .map(|p| (&*p.name, p.value(weights.into_iter())))
            .collect();
        assert_eq!(
            values,
            [("Jaw", 0.5), ("Sided", 0.25), ("Both", 0.4), ("Lid", 0.0)]
        );
    }
}
