//! The units table: which measure drives which FACS action unit, in which direction, and the prior of its range.
//!
//! Read from `config/units.toml`, which is built in ([`Units::shipped`]). One-way and two-way units are those of Jiang Na
//! et al., sections 2.5 and 2.6; the names are FACS (Ekman & Friesen 1978). Values are in units of the inner-eye-corner
//! distance w. Memory: about 2 KiB. A test checks the built-in table.

use serde::{Deserialize, Deserializer};

use super::gaze::Gaze;
use super::measures::Measure;
pub use super::prior::{Kind, Prior, UnitName};
use super::readings::Reading;
use crate::base::capacity::{FEATURES, LEARNT_MEASURES, UNITS};
use crate::base::prelude::*;

/// Cross-talk of another measure into this one.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Explained {
    /// The other measure.
    pub by: Measure,
    /// Side of its rest on which it acts.
    #[serde(default)]
    pub when: Side,
    /// Change of this measure per change of the other.
    pub share: f64,
}

/// A side of rest.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Side {
    /// Above.
    #[default]
    Rises,
    /// Below.
    Falls,
}

/// One row: a measure and its units.
#[derive(Clone, Debug, Deserialize)]
pub struct Unit {
    /// The measure.
    pub measure: Measure,
    /// Prior, with the kind of the robust method.
    #[serde(flatten)]
    pub prior: Prior,
    /// Kind for the paper's method, if different.
    paper: Option<Kind>,
    /// FACS unit of a rising measure.
    #[serde(default, deserialize_with = "unit_name")]
    pub rises: Option<UnitName>,
    /// FACS unit of a falling measure.
    #[serde(default, deserialize_with = "unit_name")]
    pub falls: Option<UnitName>,
    /// Cross-talk to remove.
    #[serde(default)]
    pub explained: Vec<Explained>,
}

/// The units table.
#[derive(Clone, Debug, Deserialize)]
pub struct Units {
    /// One row for each learnt measure, in the order of [`Measure::ALL`].
    #[serde(rename = "unit")]
    pub rows: [Unit; LEARNT_MEASURES],
    /// Population mean of the inner-eye-corner distance in metres.
    pub eye_distance_m: f32,
    /// Priors of the features in order, if units are read from all measures together.
    #[serde(rename = "feature", deserialize_with = "feature_priors")]
    pub features: Option<[Prior; FEATURES]>,
    /// Readings of units from all measures together, absolute ones last; a unit without a reading is read from its own measure.
    #[serde(rename = "reading", deserialize_with = "super::readings::table")]
    pub readings: Vec<Reading>,
    /// Maps from eye patches to gaze; without them gaze is straight ahead.
    pub gaze: Option<Gaze>,
}

fn unit_name<'de, D: Deserializer<'de>>(name: D) -> Result<Option<UnitName>, D::Error> {
    Ok(String::deserialize(name)?.parse().ok())
}

/// A feature's rest, its standard deviation over people, and the span of expressions to either side.
#[derive(Deserialize)]
struct FeatureRow {
    rest: f64,
    rest_sd: f64,
    span: f64,
}

fn feature_priors<'de, D: Deserializer<'de>>(
    rows: D,
) -> Result<Option<[Prior; FEATURES]>, D::Error> {
    let rows = <[FeatureRow; FEATURES]>::deserialize(rows)?;
    Ok(Some(rows.map(|row| Prior {
        kind: Kind::TwoWay,
        rest: row.rest,
        rest_sd: row.rest_sd,
        up: row.span,
        down: row.span,
    })))
}

impl Units {
    /// The built-in table, `config/units.toml`.
    pub fn shipped() -> Self {
        toml::from_str(include_str!("../../../config/units.toml"))
            .expect("the shipped table is read by a test")
    }

    /// The same table with every unit read from its own measure alone.
    #[must_use]
    pub fn by_measure(mut self) -> Self {
        self.features = None;
        self.readings.clear();
        self.gaze = None;
        self
    }

    /// Index of a unit's reading.
    pub fn reading(&self, unit: Option<&UnitName>) -> Option<usize> {
        unit.and_then(|unit| self.readings.iter().position(|one| one.unit == *unit))
    }

    /// Indices of the readings of units that no row names, in order: their columns follow those of the rows.
    pub fn derived_units(&self) -> impl Iterator<Item = usize> + '_ {
        let of_a_row = |unit: &UnitName| {
            let mut rows = self.rows.iter();
            rows.any(|row| row.rises.as_ref() == Some(unit) || row.falls.as_ref() == Some(unit))
        };
        (0..self.readings.len()).filter(move |&at| !of_a_row(&self.readings[at].unit))
    }

    /// Names of the weight columns: by row, the rising unit first, then [`Self::derived_units`]. With `paper`, only the
    /// units of the paper's method.
    pub fn columns(&self, paper: bool) -> heapless::Vec<UnitName, UNITS> {
        let mut columns = heapless::Vec::new();
        for row in &self.rows {
            let kind = row.kind(paper);
            let rises = row.rises.as_ref().filter(|_| kind.rises());
            let falls = row.falls.as_ref().filter(|_| kind.falls());
            for name in rises.into_iter().chain(falls) {
                // Capacity: at most two names a row, and UNITS is over twice the rows.
                let _ = columns.push(name.clone());
            }
        }
        for reading in self.derived_units().filter(|_| !paper) {
            // Capacity is checked by a test for the built-in table; units beyond it have no column.
            let _ = columns.push(self.readings[reading].unit.clone());
        }
        columns
    }
}

impl Unit {
    /// Directions under the paper's method or the robust one.
    pub fn kind(&self, paper: bool) -> Kind {
        self.paper.filter(|_| paper).unwrap_or(self.prior.kind)
    }
}

/// The mirrored unit: `AU12R` for `AU12L`, `AU62` for `AU61`; `None` for a unit without sides.
pub fn other_side(unit: &str) -> Option<String> {
    let (stem, side) = match (unit, unit.strip_suffix('L')) {
        ("AU61", _) => ("AU62", ""),
        ("AU62", _) => ("AU61", ""),
        (_, Some(stem)) => (stem, "R"),
        (_, None) => (unit.strip_suffix('R')?, "L"),
    };
    Some(format!("{stem}{side}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::expression::features;

    const SHIPPED: &str = include_str!("../../../config/units.toml");

    #[test]
    fn the_shipped_table_names_the_contracts_units() {
        let units = Units::shipped();
        let expected = "AU25 AU20 AU18 AU30L AU30R AU29 AU22 AU28 AU2L AU4L AU2R AU4R AU5L AU43L AU5R AU43R AU9L AU9R AU26 AU17 AU12L AU12R AU1L AU1R AU10L AU10R AU34L AU34R";
        let derived = " AU6L AU6R AU14L AU14R AU15L AU15R AU61 AU62 AU63 AU64";
        assert_eq!(
            units.columns(false).join(" "),
            expected.to_owned() + derived
        );
        let paper = units.columns(true).join(" ");
        let not_the_papers = ["AU5L ", "AU5R ", "AU17 ", "AU28 ", " AU34L AU34R"];
        let one_way = not_the_papers
            .iter()
            .fold(expected.to_owned(), |s, name| s.replace(name, ""));
        assert_eq!(paper, one_way);
    }

    #[test]
    fn the_shipped_table_keeps_all_rules() {
        let units = Units::shipped();
        let is_name = |name: &UnitName| {
            name.starts_with("AU") && name.bytes().all(|byte| byte.is_ascii_alphanumeric())
        };
        assert!((0.015..0.06).contains(&units.eye_distance_m));
        for (row, measure) in units.rows.iter().zip(Measure::ALL) {
            assert_eq!(row.measure, measure);
            let Prior {
                kind,
                rest,
                rest_sd,
                up,
                down,
            } = row.prior;
            assert!(
                rest.abs() < 10.0 && rest_sd > 0.0 && rest_sd < 10.0,
                "{measure:?}"
            );
            let sides = [
                (&row.rises, up, kind.rises()),
                (&row.falls, down, kind.falls()),
            ];
            for (unit, range, acts) in sides {
                assert_eq!((unit.is_some(), range > 0.0), (acts, acts), "{measure:?}");
                assert!(
                    unit.iter().all(is_name) && (0.0..10.0).contains(&range),
                    "{measure:?}"
                );
            }
            let paper = row.kind(true);
            assert!(
                kind == Kind::TwoWay || [kind, Kind::Unseen].contains(&paper),
                "{measure:?}"
            );
            for other in &row.explained {
                assert!(
                    other.by != measure && other.share.is_finite(),
                    "{measure:?}"
                );
            }
        }
        for prior in units.features.expect("readings need them") {
            assert!(
                prior.rest.abs() < 10.0 && prior.rest_sd > 0.0 && prior.up > 0.0,
                "{prior:?}"
            );
        }
        assert!(
            units.readings.len() <= UNITS && units.readings.is_sorted_by_key(|one| one.absolute)
        );
        for (at, reading) in units.readings.iter().enumerate() {
            assert_eq!(
                units.reading(Some(&reading.unit)),
                Some(at),
                "one of each unit"
            );
            let finite = reading
                .shares
                .as_flattened()
                .iter()
                .all(|share| share.is_finite());
            assert!(is_name(&reading.unit) && finite, "{}", reading.unit);
            for &(other, weight) in &reading.cross_talk {
                let learnt = !units.readings[other].absolute;
                assert!(other != at && learnt && (-1.0..0.0).contains(&weight));
            }
        }
    }

    #[test]
    fn the_shipped_table_has_nothing_that_is_not_read() {
        let table: toml::Table = SHIPPED.parse().expect("TOML");
        let known = |keys: &str, found: &toml::Table| {
            for key in found.keys() {
                assert!(keys.split(' ').any(|known| known == key), "{key}");
            }
        };
        known(
            "eye_distance_m eye_distance_sd_m unit feature reading gaze",
            &table,
        );
        let rows = |kind: &str| table[kind].as_array().expect("tables").iter();
        for (kind, count, keys) in [
            (
                "unit",
                LEARNT_MEASURES,
                "measure kind paper rises falls rest rest_sd up down explained",
            ),
            ("feature", FEATURES, "name rest rest_sd span"),
            (
                "reading",
                Units::shipped().readings.len(),
                "unit absolute from",
            ),
        ] {
            assert_eq!(rows(kind).count(), count, "{kind}");
            rows(kind).for_each(|row| known(keys, row.as_table().expect("a table")));
        }
        assert!(
            rows("feature")
                .map(|row| row["name"].as_str().expect("text"))
                .eq(features::names())
        );
        let sd = table["eye_distance_sd_m"].as_float().expect("a number");
        assert!((0.0005..0.02).contains(&sd));
    }
}
