//! Reads each unit from all measures: a unit affects several measures, so it is estimated from all of them, not only its own.
//!
//! Input i differs from the person's rest by d_i, in eye distances; a unit's reading is Σ rise_i · max(d_i, 0) +
//! fall_i · min(d_i, 0), near 0 at rest and near 1 in the full expression of an average person. The coefficients come
//! from ridge regression on tracked faces with known expressions (`mien-studio units`), so they reflect each measure's tracking
//! accuracy. Then cross-talk is removed, as by [`super::units::Explained`] between measures: a reading is reduced by a share of
//! the others' readings above 0 ([`Reading::cross_talk`]). No sum over inputs can do that, because it is one-sided: stretched
//! lips resemble lowered corners, but not vice versa. Each unit then has a learner, like a measure: rest, full
//! expression and noise are the person's; both sides share it. Of a measure's two units only the larger one is output.
//!
//! Memory: fixed, [`INPUTS`] coefficients per unit. Cost: a thousand multiplications a frame. Degenerate: without readings in
//! the table, each unit is read from its own measure.

use serde::{Deserialize, Deserializer};

use super::features;
use super::measures::Measure;
use super::prior::{Kind, Prior, UnitName};
use crate::base::capacity::{FEATURES, INPUTS, LEARNT_MEASURES};
use crate::base::prelude::*;

/// Coefficients of one unit's reading.
#[derive(Clone, Debug)]
pub struct Reading {
    /// The unit.
    pub unit: UnitName,
    /// By input: coefficients for positive and negative deviations.
    pub shares: [[f32; 2]; INPUTS],
    /// Whether the reading is the weight itself, as for gaze, which has no personal range.
    pub absolute: bool,
    /// Cross-talk: index of another reading in the table, and the coefficient (below 0) of its positive part.
    pub cross_talk: Vec<(usize, f32)>,
}

/// A row of the table.
#[derive(Deserialize)]
struct Row {
    unit: String,
    #[serde(default)]
    absolute: bool,
    /// Input and coefficients for positive and negative deviations; or another unit, the coefficient of its positive part, and 0.
    from: Vec<(String, f32, f32)>,
}

/// Deserialises the table.
pub(super) fn table<'de, D: Deserializer<'de>>(rows: D) -> Result<Vec<Reading>, D::Error> {
    let rows = Vec::<Row>::deserialize(rows)?;
    let reading = |row: &Row| {
        let (mut shares, mut cross_talk) = ([[0.0; 2]; INPUTS], Vec::new());
        for (name, rise, fall) in &row.from {
            match rows.iter().position(|other| other.unit == *name) {
                Some(other) => cross_talk.push((other, *rise)),
                None => shares[input_named(name).expect("a measure or a feature")] = [*rise, *fall],
            }
        }
        Reading {
            unit: row.unit.parse().expect("a short name"),
            shares,
            absolute: row.absolute,
            cross_talk,
        }
    };
    Ok(rows.iter().map(reading).collect())
}

impl Reading {
    /// Prior of a unit's reading: rest at 0; full expression below 1, because people express less than the training heads; `rest_sd` is
    /// the spread that remains once every input's rest is known.
    pub const PRIOR: Prior = Prior {
        kind: Kind::Rising,
        rest: 0.0,
        rest_sd: 0.05,
        up: 0.85,
        down: 0.0,
    };

    /// The unit's reading from the deviations of all inputs (eye distances), before [`Self::correction`].
    pub fn value(&self, deviations: &[f64; INPUTS]) -> f64 {
        let sum = self.shares.iter().zip(deviations);
        sum.map(|(&[rise, fall], &d)| d * f64::from(if d > 0.0 { rise } else { fall }))
            .sum()
    }

    /// Correction to add against cross-talk; `read`: all readings by [`Self::value`].
    pub fn correction(&self, read: &[f64]) -> f64 {
        let cross_talk = self.cross_talk.iter();
        cross_talk
            .map(|&(k, weight)| f64::from(weight) * read[k].max(0.0))
            .sum()
    }
}

/// Name of an input, a measure or a feature.
pub fn input_name(input: usize) -> &'static str {
    if input < LEARNT_MEASURES {
        Measure::ALL[input].name()
    } else {
        features::names()
            .nth(input - LEARNT_MEASURES)
            .unwrap_or_default()
    }
}

/// Index of the input with a name.
pub fn input_named(name: &str) -> Option<usize> {
    (0..LEARNT_MEASURES + FEATURES).find(|&input| input_name(input) == name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::expression::Units;

    #[test]
    fn rises_and_falls_have_separate_coefficients() {
        let mut shares = [[0.0; 2]; INPUTS];
        shares[3] = [2.0, 0.5];
        shares[INPUTS - 1] = [-1.0, -3.0];
        let reading = Reading {
            unit: UnitName::try_from("AU12L").unwrap(),
            shares,
            absolute: false,
            cross_talk: vec![(1, -0.5), (2, -0.25)],
        };
        assert_eq!(reading.correction(&[9.0, 0.4, -2.0]), -0.2);
        let mut deviations = [0.0; INPUTS];
        assert_eq!(reading.value(&deviations), 0.0);
        (deviations[3], deviations[INPUTS - 1]) = (0.2, 0.1);
        assert!((reading.value(&deviations) - 0.3).abs() < 1e-9);
        (deviations[3], deviations[INPUTS - 1]) = (-0.2, -0.1);
        assert!((reading.value(&deviations) - 0.2).abs() < 1e-9);
    }

    #[test]
    fn every_shipped_unit_is_read_and_both_sides_alike() {
        let units = Units::shipped();
        let swapped = |name: &str| match name.strip_suffix('L') {
            Some(stem) => format!("{stem}R"),
            None => name
                .strip_suffix('R')
                .map_or_else(|| name.to_owned(), |stem| format!("{stem}L")),
        };
        for name in units.columns(false) {
            let reading = &units.readings[units.reading(Some(&name)).expect("a reading")];
            let other = UnitName::try_from(swapped(&name).as_str()).unwrap();
            let Some(other) = units.reading(Some(&other)).filter(|_| *other != *name) else {
                continue;
            };
            for (input, shares) in reading.shares.iter().enumerate() {
                // One-sided features have opposite signs on the two sides.
                if input_name(input).ends_with("_shift") || input_name(input) == "gaze_left" {
                    continue;
                }
                let mirrored = input_named(&swapped(input_name(input))).unwrap_or(input);
                for (a, b) in shares.iter().zip(units.readings[other].shares[mirrored]) {
                    assert!(
                        (a - b).abs() <= 0.021,
                        "{name}, {}: {a} and {b}",
                        input_name(input)
                    );
                }
            }
        }
    }
}
