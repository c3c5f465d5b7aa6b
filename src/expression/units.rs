//! The units table: which measure drives which FACS action unit, in which direction, and the prior of its range.
//!
//! Read from `config/units.toml`, which is built in ([`Units::shipped`]). One-way and two-way units are those of Jiang Na
//! et al., sections 2.5 and 2.6; the names are FACS (Ekman & Friesen 1978). Values are in units of the inner-eye-corner
//! distance w. Memory: about 2 KiB. Degenerate: a table with a missing or repeated measure, a direction without its unit
//! or range, or a range that is not above 0 is rejected.

use serde::Deserialize;

use super::features;
use super::gaze::Gaze;
use super::measures::Measure;
pub use super::prior::{Kind, Prior, UnitName};
use super::readings::{Reading, input_named};
use crate::base::capacity::{FEATURES, INPUTS, LEARNT_MEASURES, UNITS};
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;

/// How another measure moves this one.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Explained {
    /// The other measure.
    pub by: Measure,
    /// On which side of its rest.
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
#[derive(Clone, Debug)]
pub struct Unit {
    /// The measure.
    pub measure: Measure,
    /// Prior, with the kind of the robust method.
    pub prior: Prior,
    /// Kind for the paper's method.
    pub paper_kind: Kind,
    /// FACS unit when the measure rises.
    pub rises: Option<UnitName>,
    /// FACS unit when it falls.
    pub falls: Option<UnitName>,
    /// Cross-talk to remove.
    pub explained: Vec<Explained>,
}

/// The whole table, one row for each measure but the eye distance, in the order of [`Measure::ALL`].
#[derive(Clone, Debug)]
pub struct Units {
    /// Rows.
    pub rows: [Unit; LEARNT_MEASURES],
    /// Population mean of the inner-eye-corner distance in metres.
    pub eye_distance_m: f32,
    /// Priors of the features in order, if the table has readings.
    pub features: Option<[Prior; FEATURES]>,
    /// Readings of units from all measures together; a unit without one is read from its own measure.
    pub readings: Vec<Reading>,
    /// The map from eye images to gaze; without it the eyes look ahead.
    pub gaze: Option<Gaze>,
}

/// Why a units table is rejected.
#[derive(Debug, thiserror::Error)]
pub enum UnitsError {
    /// Not TOML, unknown or missing keys, or an unknown measure.
    #[error("units table: {0}")]
    Syntax(#[from] toml::de::Error),
    /// A row that does not fit: its beginning, and what is expected.
    #[error("units table: {0}: expected {1}")]
    Row(String, &'static str),
}

fn refused(row: &str, expected: &'static str) -> UnitsError {
    UnitsError::Row(row.chars().take(16).collect(), expected)
}

/// Whether all that a row has to be is true; else the first that is not.
fn require(row: &str, all: &[(bool, &'static str)]) -> Result<(), UnitsError> {
    let missing = all.iter().find(|(holds, _)| !holds);
    missing.map_or(Ok(()), |(_, expected)| Err(refused(row, expected)))
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Table {
    eye_distance_m: f32,
    eye_distance_sd_m: f32,
    unit: Vec<Row>,
    #[serde(default)]
    feature: Vec<FeatureRow>,
    #[serde(default)]
    reading: Vec<ReadingRow>,
    gaze: Option<Gaze>,
}

/// How far expressions move a feature, either way, and its rest.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct FeatureRow {
    name: String,
    rest: f64,
    rest_sd: f64,
    span: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ReadingRow {
    unit: String,
    #[serde(default)]
    absolute: bool,
    /// Input, weight per rise, weight per fall.
    from: Vec<(String, f32, f32)>,
}

impl ReadingRow {
    fn reading(&self) -> Result<Reading, UnitsError> {
        let refuse = |expected| refused(&self.unit, expected);
        let unit = unit_name(&self.unit).ok_or_else(|| refuse("a name such as AU12 or AU12L"))?;
        let mut shares = [[0.0; 2]; INPUTS];
        for (name, rise, fall) in &self.from {
            let input = input_named(name);
            let input = input.ok_or_else(|| refuse("names of measures and features"))?;
            let finite = rise.is_finite() && fall.is_finite();
            require(&self.unit, &[(finite, "finite weights")])?;
            shares[input] = [*rise, *fall];
        }
        Ok(Reading {
            unit,
            shares,
            absolute: self.absolute,
        })
    }
}

/// Priors of all features, in order.
fn feature_priors(rows: &[FeatureRow]) -> Result<[Prior; FEATURES], UnitsError> {
    let mut priors = [None; FEATURES];
    for row in rows {
        let sound = row.rest.abs() < 10.0 && row.rest_sd > 0.0 && row.span > 0.0;
        if let Some(at) = features::named(&row.name).filter(|_| sound) {
            priors[at] = Some(Prior {
                kind: Kind::TwoWay,
                rest: row.rest,
                rest_sd: row.rest_sd,
                up: row.span,
                down: row.span,
            });
        }
    }
    let known: heapless::Vec<Prior, FEATURES> = priors.into_iter().flatten().collect();
    let expected = "one [[feature]] with rest, rest_sd and span for each that readings use";
    known
        .into_array()
        .map_err(|_| refused("features", expected))
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Row {
    measure: Measure,
    kind: Kind,
    paper: Option<Kind>,
    rises: Option<String>,
    falls: Option<String>,
    rest: f64,
    rest_sd: f64,
    #[serde(default)]
    up: f64,
    #[serde(default)]
    down: f64,
    #[serde(default)]
    explained: Vec<Explained>,
}

/// A name that is valid for outputs and columns.
fn unit_name(name: &str) -> Option<UnitName> {
    let fits = name.starts_with("AU") && name.bytes().all(|b| b.is_ascii_alphanumeric());
    UnitName::try_from(name).ok().filter(|_| fits)
}

impl Row {
    fn unit(&self) -> Result<Unit, UnitsError> {
        let &Self { measure, kind, .. } = self;
        let paper_kind = self.paper.unwrap_or(kind);
        let [rises, falls] = [&self.rises, &self.falls].map(|name| unit_name(name.as_deref()?));
        let named =
            rises.is_some() == self.rises.is_some() && falls.is_some() == self.falls.is_some();
        let acts = rises.is_some() == kind.rises() && falls.is_some() == kind.falls();
        let side = |range: f64, acts: bool| (range > 0.0) == acts && (0.0..10.0).contains(&range);
        let by_others = |other: &Explained| other.by != measure && other.share.is_finite();
        require(
            measure.name(),
            &[
                (named, "unit names such as AU12 or AU12L"),
                (
                    acts,
                    "`rises` for what acts as it rises, `falls` for what acts as it falls",
                ),
                (self.rest.abs() < 10.0, "`rest` within ±10 w"),
                (
                    self.rest_sd > 0.0 && self.rest_sd < 10.0,
                    "`rest_sd` above 0, below 10 w",
                ),
                (
                    side(self.up, kind.rises()),
                    "`up` above 0 exactly if it rises",
                ),
                (
                    side(self.down, kind.falls()),
                    "`down` above 0 exactly if it falls",
                ),
                (
                    kind == Kind::TwoWay || [kind, Kind::Unseen].contains(&paper_kind),
                    "`paper` to be one of its own directions",
                ),
                (
                    self.explained.iter().all(by_others),
                    "`explained` by another measure, with a finite share",
                ),
            ],
        )?;
        Ok(Unit {
            measure,
            prior: Prior {
                kind,
                rest: self.rest,
                rest_sd: self.rest_sd,
                up: self.up,
                down: self.down,
            },
            paper_kind,
            rises,
            falls,
            explained: self.explained.clone(),
        })
    }
}

impl Table {
    /// The row of each learnt measure, in order.
    fn rows(&self) -> Result<[Unit; LEARNT_MEASURES], UnitsError> {
        let row_of = |&measure: &Measure| {
            let mut rows = self.unit.iter().filter(|row| row.measure == measure);
            match (rows.next(), rows.next()) {
                (Some(row), None) => row.unit(),
                _ => Err(refused(measure.name(), "exactly one [[unit]] for it")),
            }
        };
        let measures = Measure::ALL[..LEARNT_MEASURES].iter();
        let rows: heapless::Vec<Unit, LEARNT_MEASURES> =
            measures.map(row_of).collect::<Result<_, _>>()?;
        Ok(rows.into_array().expect("a row for each measure"))
    }

    /// The readings, last those that have no range and need no learner.
    fn readings(&self) -> Result<Vec<Reading>, UnitsError> {
        let readings = self.reading.iter().map(ReadingRow::reading);
        let mut readings = readings.collect::<Result<Vec<_>, _>>()?;
        readings.sort_by_key(|reading| reading.absolute);
        for (at, Reading { unit, .. }) in readings.iter().enumerate() {
            let is_new = readings[..at].iter().all(|other| other.unit != *unit);
            let all = [
                (is_new, "one of each unit"),
                (at < UNITS, "no more readings than there are units"),
            ];
            require(unit, &all)?;
        }
        Ok(readings)
    }
}

impl Units {
    /// The built-in table, `config/units.toml`.
    #[must_use]
    pub fn shipped() -> Self {
        Self::read(include_str!("../../config/units.toml"))
            .expect("the shipped table is read by a test")
    }

    /// Reads a table.
    ///
    /// # Errors
    /// If it is not TOML, or a row is missing, repeated or inconsistent.
    pub fn read(text: &str) -> Result<Self, UnitsError> {
        let table: Table = toml::from_str(text)?;
        let (distance, sd) = (table.eye_distance_m, table.eye_distance_sd_m);
        let distances = [
            (
                (0.015..0.06).contains(&distance),
                "eye_distance_m within 0.015 to 0.06",
            ),
            (
                (0.0005..0.02).contains(&sd),
                "eye_distance_sd_m within 0.0005 to 0.02",
            ),
        ];
        require("eye_distance", &distances)?;
        let gaze = table.gaze.as_ref().is_none_or(Gaze::is_whole);
        let expected = "as many finite weights as an eye has cells, and one";
        require("gaze", &[(gaze, expected)])?;
        let needs_features = !table.reading.is_empty() || !table.feature.is_empty();
        let features = needs_features.then(|| feature_priors(&table.feature));
        Ok(Self {
            rows: table.rows()?,
            eye_distance_m: distance,
            readings: table.readings()?,
            features: features.transpose()?,
            gaze: table.gaze,
        })
    }

    /// For each column of the robust method, whether its measure belongs to the mouth, or it is read from the lips.
    pub(crate) fn of_mouth(&self) -> [bool; UNITS] {
        let mut of_mouth = [false; UNITS];
        let columns = self.rows.iter().flat_map(|row| {
            let is = super::covered::is_of_mouth(row.measure);
            let sides = row.prior.kind.sides().into_iter();
            sides.filter(|side| *side).map(move |_| is)
        });
        let further = self.further().map(|reading| {
            let shares = self.readings[reading].shares[Measure::LipGap as usize];
            shares != [0.0; 2]
        });
        let columns = columns.chain(further);
        of_mouth.iter_mut().zip(columns).for_each(|(k, is)| *k = is);
        of_mouth
    }

    /// The same table with every unit read from its own measure alone.
    #[must_use]
    pub fn by_measure(mut self) -> Self {
        self.features = None;
        self.readings.clear();
        self.gaze = None;
        self
    }

    /// The reading of a unit.
    #[must_use]
    pub fn reading(&self, unit: Option<&UnitName>) -> Option<usize> {
        unit.and_then(|unit| self.readings.iter().position(|one| one.unit == *unit))
    }

    /// Readings of units that no measure is named after, in their order: columns of their own after those of the rows.
    pub fn further(&self) -> impl Iterator<Item = usize> + '_ {
        let of_a_row = |unit: &UnitName| {
            let mut rows = self.rows.iter();
            rows.any(|row| row.rises.as_ref() == Some(unit) || row.falls.as_ref() == Some(unit))
        };
        (0..self.readings.len()).filter(move |&at| !of_a_row(&self.readings[at].unit))
    }

    /// Names of the weight columns: by row, the rising unit first, then [`Self::further`] ones. With `paper`, only what the
    /// paper's method delivers.
    #[must_use]
    pub fn columns(&self, paper: bool) -> heapless::Vec<UnitName, UNITS> {
        let mut columns = heapless::Vec::new();
        for row in &self.rows {
            let kind = row.kind(paper);
            let rises = row.rises.as_ref().filter(|_| kind.rises());
            let falls = row.falls.as_ref().filter(|_| kind.falls());
            for name in rises.into_iter().chain(falls) {
                // There are at most two names a row, and UNITS is twice the rows.
                let _ = columns.push(name.clone());
            }
        }
        for reading in self.further().filter(|_| !paper) {
            // No more readings than UNITS, as `read` sees to; those without room have no column.
            let _ = columns.push(self.readings[reading].unit.clone());
        }
        columns
    }
}

impl Unit {
    /// Directions under the paper's method or the robust one.
    #[must_use]
    pub fn kind(&self, paper: bool) -> Kind {
        if paper {
            self.paper_kind
        } else {
            self.prior.kind
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SHIPPED: &str = include_str!("../../config/units.toml");

    #[test]
    fn the_shipped_table_names_the_contracts_units() {
        let units = Units::shipped();
        let expected = "AU25 AU20 AU18 AU30L AU30R AU29 AU22 AU28 AU2L AU4L AU2R AU4R AU5L AU43L AU5R AU43R AU9L AU9R AU26 AU17 AU12L AU12R AU1L AU1R AU10L AU10R AU34L AU34R";
        let further = " AU6L AU6R AU14L AU14R AU15L AU15R AU61 AU62 AU63 AU64";
        assert_eq!(
            units.columns(false).join(" "),
            expected.to_owned() + further
        );
        let paper = units.columns(true).join(" ");
        let not_the_papers = ["AU5L ", "AU5R ", "AU17 ", "AU28 ", " AU34L AU34R"];
        let one_way = not_the_papers
            .iter()
            .fold(expected.to_owned(), |s, name| s.replace(name, ""));
        assert_eq!(paper, one_way);
    }

    #[test]
    fn refuses_what_does_not_fit_together_with_one_sentence() {
        let cases = [
            (
                SHIPPED.replace("\"brow_R\"", "\"brow_L\""),
                "brow_L: expected exactly one [[unit]]",
            ),
            (SHIPPED.replace("\"brow_R\"", "\"nose\""), "such as lip_gap"),
            (
                SHIPPED.replace("up = 0.80", "up = -1.0"),
                "lip_gap: expected `up`",
            ),
            (
                SHIPPED.replace("falls = \"AU18\"", ""),
                "mouth_width: expected `rises`",
            ),
            (
                SHIPPED.replace("rest_sd = 0.13", "rest_sd = nan"),
                "mouth_width: expected `rest_sd`",
            ),
            (
                SHIPPED.replace("AU18", "pucker"),
                "expected unit names such as",
            ),
            (
                SHIPPED.replace("[\"lip_gap\",", "[\"lip_gasp\","),
                "expected names of measures and features",
            ),
            (
                SHIPPED.replace("\"chin_height\"\nrest", "\"chin\"\nrest"),
                "one [[feature]] with rest, rest_sd and span for each",
            ),
            (
                SHIPPED.replace("rest_sd = 0.13", "width = 3"),
                "unknown field `width`",
            ),
        ];
        for (text, expected) in cases {
            let message = Units::read(&text).unwrap_err().to_string();
            assert!(message.contains(expected), "{message}");
        }
    }

    #[test]
    fn numbers_are_refused_from_their_bounds_on() {
        // Of the first unit, the first feature or the head of the table; what is last inside, and what is outside.
        let cases = [
            ("rest = 0.02\n", "rest = 9.9\n", "rest = 10.0\n"),
            ("rest = 0.02\n", "rest = -9.9\n", "rest = -10.0\n"),
            ("rest_sd = 0.03\n", "rest_sd = 9.9\n", "rest_sd = 10.0\n"),
            ("rest_sd = 0.03\n", "rest_sd = 0.001\n", "rest_sd = 0.0\n"),
            ("rest_sd = 0.03\n", "rest_sd = 0.001\n", "rest_sd = -0.1\n"),
            ("up = 0.80", "up = 9.9", "up = 10.0"),
            ("up = 0.80", "up = 0.001", "up = 0.0"),
            ("share = -0.21", "share = -9.0", "share = inf"),
            (
                "by = \"jaw_drop\", share = -0.21",
                "by = \"jaw_drop\", share = 0.0",
                "by = \"mouth_width\", share = 0.1",
            ),
            (
                "eye_distance_sd_m = 0.003",
                "eye_distance_sd_m = 0.0199",
                "eye_distance_sd_m = 0.02",
            ),
            (
                "eye_distance_sd_m = 0.003",
                "eye_distance_sd_m = 0.0005",
                "eye_distance_sd_m = 0.0004",
            ),
            (
                "eye_distance_m = 0.037",
                "eye_distance_m = 0.015",
                "eye_distance_m = 0.06",
            ),
        ];
        for (shipped, inside, outside) in cases {
            assert!(SHIPPED.contains(shipped), "{shipped}");
            let with = |other: &str| Units::read(&SHIPPED.replacen(shipped, other, 1));
            assert!(with(inside).is_ok(), "{inside}: {:?}", with(inside).err());
            assert!(with(outside).is_err(), "{outside}");
        }
        // Of a feature, in whatever numbers it is.
        let at = SHIPPED.find("\n[[feature]]").expect("features");
        let (before, after) = SHIPPED.split_at(at);
        let row = after
            .lines()
            .find(|line| line.starts_with("rest = "))
            .expect("its rest");
        for (rest, fits) in [("rest = 9.9", true), ("rest = 10.0", false)] {
            let text = format!("{before}{}", after.replacen(row, rest, 1));
            assert_eq!(Units::read(&text).is_ok(), fits, "{rest}");
        }
        for (key, value) in [("rest_sd", "0.0"), ("span", "0.0")] {
            let row = after.lines().find(|line| line.starts_with(key)).expect(key);
            let text = format!(
                "{before}{}",
                after.replacen(row, &format!("{key} = {value}"), 1)
            );
            assert!(Units::read(&text).is_err(), "{key}");
        }
    }

    #[test]
    fn dimples_are_the_mouths_and_glances_are_not() {
        let units = Units::shipped();
        let of_mouth = units.of_mouth();
        let is = |name: &str| {
            let column = units.columns(false).iter().position(|unit| unit == name);
            of_mouth[column.expect("a column")]
        };
        assert!(is("AU25") && is("AU12L") && is("AU14L") && is("AU15R"));
        assert!(!is("AU43L") && !is("AU61") && !is("AU64"));
    }

    #[test]
    fn a_unit_read_twice_or_under_no_name_and_a_gaze_of_too_few_cells_are_refused() {
        let again = "\n[[reading]]\nunit = \"AU14L\"\nfrom = []\n";
        for (text, expected) in [
            (
                SHIPPED.replace("\n[gaze]", &format!("{again}\n[gaze]")),
                "one of each unit",
            ),
            (
                SHIPPED.replace("\"AU14L\"", "\"dimple\""),
                "a name such as AU12",
            ),
            (
                SHIPPED.replace("\n[gaze]\nleft = [", "\n[gaze]\nleft = [1.0, "),
                "as many finite weights",
            ),
        ] {
            let message = Units::read(&text).unwrap_err().to_string();
            assert!(message.contains(expected), "{message}");
        }
    }

    #[test]
    fn readings_need_features_and_features_alone_do_no_harm() {
        let table: String = SHIPPED[..SHIPPED.find("\n[[feature]]").expect("features")].to_owned();
        assert!(Units::read(&table).expect("units alone").features.is_none());
        let reading = "\n[[reading]]\nunit = \"AU25\"\nfrom = [[\"lip_gap\", 1.0, 0.0]]\n";
        let refused = Units::read(&(table.clone() + reading))
            .unwrap_err()
            .to_string();
        assert!(refused.contains("[[feature]]"), "{refused}");
        let end = SHIPPED.find("\n[[reading]]").expect("readings");
        let features = Units::read(&SHIPPED[..end]).expect("features alone");
        assert!(features.features.is_some() && features.readings.is_empty());
    }
}
