//! The units table: which measure drives which FACS action unit, in which direction, and the prior of its range.
//!
//! Read from `config/units.toml`, which is built in ([`Units::shipped`]). One-way and two-way units are those of Jiang Na
//! et al., sections 2.5 and 2.6; the names are FACS (Ekman & Friesen 1978). Values are in units of the inner-eye-corner
//! distance w. Memory: about 2 KiB. Degenerate: a table with a missing or repeated measure, a direction without its unit
//! or range, or a range that is not above 0 is rejected.
//! One file: the table, its parser and its errors.

use serde::Deserialize;

use super::features;
use super::gaze::{Gaze, GazeRow};
use super::measures::Measure;
pub use super::prior::{Kind, Prior, UnitName};
use super::readings::{FeaturePrior, Reading, input_named};
use crate::base::capacity::{FEATURES, INPUTS, LEARNT_MEASURES, UNITS};
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;

/// How another measure moves this one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Explained {
    /// The other measure.
    pub by: Measure,
    /// On which side of its rest.
    pub when: Side,
    /// Change of this measure per change of the other.
    pub share: f64,
}

/// Measures that may explain another, at most.
pub const EXPLAINED: usize = 4;

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
    pub explained: heapless::Vec<Explained, EXPLAINED>,
}

/// The whole table, one row for each measure but the eye distance, in the order of [`Measure::ALL`].
#[derive(Clone, Debug)]
pub struct Units {
    /// Rows.
    pub rows: [Unit; LEARNT_MEASURES],
    /// Population mean of the inner-eye-corner distance in metres.
    pub eye_distance_m: f32,
    /// Its standard deviation in metres.
    pub eye_distance_sd_m: f32,
    /// Features in order, if the table has readings.
    pub features: Option<[FeaturePrior; FEATURES]>,
    /// Readings of units from all measures together; a unit without one is read from its own measure.
    pub readings: Vec<Reading>,
    /// The map from eye images to gaze; without it the eyes look ahead.
    pub gaze: Option<Gaze>,
}

/// Why a units table is rejected.
#[derive(Debug, thiserror::Error)]
pub enum UnitsError {
    /// Not TOML, or unknown or missing keys.
    #[error("units table: {0}")]
    Syntax(#[from] toml::de::Error),
    /// Unknown measure, or one without units.
    #[error("units table: expected a measure such as lip_gap, found {found:?}")]
    UnknownMeasure {
        /// The name found.
        found: heapless::String<32>,
    },
    /// Each measure needs exactly one row.
    #[error("units table: expected exactly one [[unit]] for measure {measure}, found {found}")]
    Rows {
        /// The measure.
        measure: &'static str,
        /// How many rows there are.
        found: usize,
    },
    /// A reading that does not fit.
    #[error("units table: [[reading]] of {unit}: expected {expected}")]
    Reading {
        /// The unit.
        unit: String,
        /// What it should be.
        expected: &'static str,
    },
    /// A direction without its name or range.
    #[error("units table: measure {measure} is {kind:?} and needs {needs}")]
    Incomplete {
        /// The measure.
        measure: &'static str,
        /// Its kind.
        kind: Kind,
        /// What is missing or out of range.
        needs: &'static str,
    },
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
    gaze: Option<GazeRow>,
}

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
        let refuse = |expected| UnitsError::Reading {
            unit: self.unit.chars().take(16).collect(),
            expected,
        };
        let unit = unit_name(&self.unit).ok_or_else(|| refuse("a name such as AU12 or AU12L"))?;
        let mut shares = [[0.0; 2]; INPUTS];
        for (name, rise, fall) in &self.from {
            let input =
                input_named(name).ok_or_else(|| refuse("names of measures and features"))?;
            if !rise.is_finite() || !fall.is_finite() {
                return Err(refuse("finite weights"));
            }
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
fn feature_priors(rows: &[FeatureRow]) -> Result<[FeaturePrior; FEATURES], UnitsError> {
    let mut priors = [None; FEATURES];
    for row in rows {
        let sound = row.rest.abs() < 10.0 && row.rest_sd > 0.0 && row.span > 0.0;
        if let Some(at) = features::named(&row.name).filter(|_| sound) {
            priors[at] = Some(FeaturePrior {
                rest: row.rest,
                rest_sd: row.rest_sd,
                span: row.span,
            });
        }
    }
    let known: heapless::Vec<FeaturePrior, FEATURES> = priors.into_iter().flatten().collect();
    known.into_array().map_err(|_| UnitsError::Reading {
        unit: "any".into(),
        expected: "one [[feature]] with rest, rest_sd and span for each that readings use",
    })
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Row {
    measure: String,
    kind: Kind,
    paper: Option<Kind>,
    rises: Option<String>,
    falls: Option<String>,
    rest: f64,
    rest_sd: f64,
    up: Option<f64>,
    down: Option<f64>,
    #[serde(default)]
    explained: Vec<ExplainedRow>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ExplainedRow {
    by: String,
    #[serde(default)]
    when: Side,
    share: f64,
}

/// Whether a name is valid for outputs and columns.
fn unit_name(name: &str) -> Option<UnitName> {
    let fits = name.starts_with("AU") && name.bytes().all(|b| b.is_ascii_alphanumeric());
    UnitName::try_from(name).ok().filter(|_| fits)
}

fn measure_named(name: &str) -> Result<Measure, UnitsError> {
    Measure::named(name)
        .filter(|&measure| measure != Measure::EyeDistance)
        .ok_or_else(|| UnitsError::UnknownMeasure {
            found: name.chars().take(16).filter(char::is_ascii).collect(),
        })
}

impl Row {
    fn unit(&self, measure: Measure) -> Result<Unit, UnitsError> {
        let refuse = |needs| UnitsError::Incomplete {
            measure: measure.name(),
            kind: self.kind,
            needs,
        };
        let name = |name: &Option<String>| -> Result<Option<UnitName>, UnitsError> {
            let Some(name) = name else { return Ok(None) };
            let name = unit_name(name).map(Some);
            name.ok_or_else(|| refuse("unit names such as AU12 or AU12L"))
        };
        let side = |range: Option<f64>, active: bool, needs| match range {
            Some(range) if active && range > 0.0 && range < 10.0 => Ok(range),
            None if !active => Ok(0.0),
            _ => Err(refuse(needs)),
        };
        let (rises, falls) = (name(&self.rises)?, name(&self.falls)?);
        if rises.is_some() != self.kind.rises() || falls.is_some() != self.kind.falls() {
            return Err(refuse(
                "`rises` for what acts as it rises, `falls` for what acts as it falls",
            ));
        }
        let positive = self.rest_sd > 0.0 && self.rest_sd < 10.0 && self.rest.abs() < 10.0;
        if !positive {
            return Err(refuse("`rest` within ±10 w and `rest_sd` above 0"));
        }
        let paper_kind = self.paper.unwrap_or(self.kind);
        if self.kind != Kind::TwoWay && paper_kind != self.kind {
            return Err(refuse("`paper` to be one of its own directions"));
        }
        let explained = self
            .explained
            .iter()
            .map(|row| {
                let by = measure_named(&row.by)?;
                if by == measure || !row.share.is_finite() {
                    return Err(refuse(
                        "`explained` by another measure, with a finite share",
                    ));
                }
                Ok(Explained {
                    by,
                    when: row.when,
                    share: row.share,
                })
            })
            .collect::<Result<Vec<_>, _>>()?;
        Ok(Unit {
            measure,
            prior: Prior {
                kind: self.kind,
                rest: self.rest,
                rest_sd: self.rest_sd,
                up: side(
                    self.up,
                    self.kind.rises(),
                    "`up` above 0 exactly if it rises",
                )?,
                down: side(
                    self.down,
                    self.kind.falls(),
                    "`down` above 0 exactly if it falls",
                )?,
            },
            paper_kind,
            rises,
            falls,
            explained: heapless::Vec::from_slice(&explained)
                .map_err(|_| refuse("at most four `explained`"))?,
        })
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
        for row in &table.unit {
            measure_named(&row.measure)?;
        }
        let row_of = |measure: Measure| {
            let mut rows = table
                .unit
                .iter()
                .filter(|row| row.measure == measure.name());
            match (rows.next(), rows.count()) {
                (Some(row), 0) => row.unit(measure),
                (first, more) => Err(UnitsError::Rows {
                    measure: measure.name(),
                    found: usize::from(first.is_some()) + more,
                }),
            }
        };
        let rows: heapless::Vec<Unit, LEARNT_MEASURES> = Measure::ALL
            .into_iter()
            .filter(|&measure| measure != Measure::EyeDistance)
            .map(row_of)
            .collect::<Result<_, _>>()?;
        let Ok(rows) = rows.into_array() else {
            return Err(UnitsError::Rows {
                measure: "any",
                found: table.unit.len(),
            });
        };
        if !(0.015..0.06).contains(&table.eye_distance_m)
            || !(0.0005..0.02).contains(&table.eye_distance_sd_m)
        {
            return Err(UnitsError::Incomplete {
                measure: Measure::EyeDistance.name(),
                kind: Kind::TwoWay,
                needs: "eye_distance_m within 0.015 to 0.06 m and eye_distance_sd_m within 0.0005 to 0.02 m",
            });
        }
        let readings = table.reading.iter().map(ReadingRow::reading);
        let mut readings = readings.collect::<Result<Vec<_>, _>>()?;
        // Those that have no range come last and need no learner.
        readings.sort_by_key(|reading| reading.absolute);
        if readings.len() > UNITS {
            return Err(UnitsError::Reading {
                unit: "all".into(),
                expected: "no more of them than there are units",
            });
        }
        for (at, reading) in readings.iter().enumerate() {
            if readings[..at]
                .iter()
                .any(|other| other.unit == reading.unit)
            {
                return Err(UnitsError::Reading {
                    unit: reading.unit.as_str().into(),
                    expected: "one of each unit",
                });
            }
        }
        let gaze = table.gaze.as_ref().map(|row| {
            row.gaze().ok_or(UnitsError::Reading {
                unit: "gaze".into(),
                expected: "as many finite weights as an eye has cells",
            })
        });
        let gaze = gaze.transpose()?;
        let features = (!readings.is_empty() || !table.feature.is_empty())
            .then(|| feature_priors(&table.feature))
            .transpose()?;
        Ok(Self {
            rows,
            eye_distance_m: table.eye_distance_m,
            eye_distance_sd_m: table.eye_distance_sd_m,
            features,
            readings,
            gaze,
        })
    }

    /// For each column of the robust method, whether its measure belongs to the mouth, or it is read from the lips.
    pub(crate) fn of_mouth(&self) -> [bool; UNITS] {
        let mut of_mouth = [false; UNITS];
        let sides = |row: &Unit| [row.prior.kind.rises(), row.prior.kind.falls()];
        let columns = self.rows.iter().flat_map(|row| {
            let is = super::covered::is_of_mouth(row.measure);
            sides(row).into_iter().filter(|side| *side).map(move |_| is)
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
        let further = " AU14L AU14R AU15L AU15R AU61 AU62 AU63 AU64";
        assert_eq!(
            units.columns(false).join(" "),
            expected.to_owned() + further
        );
        let paper = units.columns(true).join(" ");
        let two_way_only = ["AU5L ", "AU5R ", "AU17 "];
        let one_way = two_way_only
            .iter()
            .fold(expected.to_owned(), |s, name| s.replace(name, ""));
        assert_eq!(paper, one_way);
    }

    #[test]
    fn refuses_what_does_not_fit_together_with_one_sentence() {
        let cases = [
            (
                SHIPPED.replace("\"brow_R\"", "\"brow_L\""),
                "exactly one [[unit]] for measure brow_L, found 2",
            ),
            (
                SHIPPED.replace("\"brow_R\"", "\"nose\""),
                "such as lip_gap, found \"nose\"",
            ),
            (
                SHIPPED.replace("up = 0.80", "up = -1.0"),
                "measure lip_gap is Rising and needs `up`",
            ),
            (
                SHIPPED.replace("falls = \"AU18\"", ""),
                "measure mouth_width is TwoWay and needs `rises`",
            ),
            (
                SHIPPED.replace("rest_sd = 0.13", "rest_sd = nan"),
                "mouth_width is TwoWay and needs `rest`",
            ),
            (
                SHIPPED.replace("AU18", "pucker"),
                "needs unit names such as",
            ),
            (
                SHIPPED.replace("[\"lip_gap\", ", "[\"lip_gasp\", "),
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
