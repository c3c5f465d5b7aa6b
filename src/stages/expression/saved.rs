//! Saves and loads a person's learned ranges, as plain text that is validated on loading.
//!
//! One line per range, `name low rest high`, after a header with the version and the eye distance in metres: every measure, then,
//! if units are read from all measures together, every feature and every unit's reading:
//! ```text
//! mien-ranges 2 0.0372
//! lip_gap 0.0213 0.0213 0.7961
//! …
//! brow_distance 0.4821 0.4821 0.4821
//! …
//! AU25 0.0000 0.0000 0.8512
//! ```
//! Version 1 has the measures only. Units: inner-eye-corner distances; readings have none. Memory: fixed. Degenerate: a file
//! with a missing measure or feature, in the wrong order, or with a non-finite or implausible number is rejected; the caller
//! then starts from the population.

use core::fmt::Write;

use super::features;
use super::measures::Measure;
use super::prior::UnitName;
use super::range::Range;
use super::units::Units;
use crate::base::capacity::{FEATURES, LEARNT_MEASURES, UNITS};

const HEADER: &str = "mien-ranges";
/// Largest plausible measure, in eye distances.
const LARGEST: f64 = 20.0;

/// One person's learned ranges.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Learned {
    /// Inner-eye-corner distance, metres.
    pub eye_distance_m: f32,
    /// Ranges by learnt measure, in units of the eye distance.
    pub ranges: [Range; LEARNT_MEASURES],
    /// Ranges by feature, in the order of [`features::names`]; empty in a file of version 1 and with the paper's method.
    pub features: heapless::Vec<Range, FEATURES>,
    /// Ranges by unit's reading; empty as `features`.
    pub readings: heapless::Vec<(UnitName, Range), UNITS>,
}

/// Why saved ranges are rejected.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SavedError {
    /// The header is missing or invalid.
    #[error(
        "saved ranges: expected a first line \"mien-ranges VERSION EYE_DISTANCE\", version 1 or 2 and 0.015 to 0.06 (metres); delete the file to start over"
    )]
    Header,
    /// A malformed line: its number from 1, and the expected name.
    #[error(
        "saved ranges, line {0}: expected \"{1} low rest high\" with low <= rest <= high within 20; delete the file to start over"
    )]
    Line(usize, &'static str),
}

/// Name and range of a line; `None` if malformed or implausible.
fn parse_line(line: &str) -> Option<(&str, Range)> {
    let mut words = line.split_ascii_whitespace();
    let name = words.next()?;
    let mut number = || words.next()?.parse::<f64>().ok();
    let (low, rest, high) = (number()?, number()?, number()?);
    let ordered = low <= rest && rest <= high && low >= -LARGEST && high <= LARGEST;
    (ordered && words.next().is_none()).then_some((name, Range { low, rest, high }))
}

impl Learned {
    /// Readings that version 1, which has none, implies: large movements of a measure mean high readings of its units.
    pub(super) fn implied_readings<'a>(
        &'a self,
        units: &'a Units,
    ) -> impl Iterator<Item = (&'a UnitName, Range)> {
        units
            .rows
            .iter()
            .zip(&self.ranges)
            .flat_map(|(row, range)| {
                let sides = [
                    (&row.rises, range.high - range.rest, row.prior.up),
                    (&row.falls, range.rest - range.low, row.prior.down),
                ];
                sides.into_iter().filter_map(|(unit, own, usual)| {
                    let high = own / usual;
                    let range = Range {
                        high,
                        ..Range::default()
                    };
                    unit.as_ref()
                        .filter(|_| usual > 0.0)
                        .map(|unit| (unit, range))
                })
            })
    }

    /// Writes the text.
    ///
    /// # Errors
    /// If the writer fails.
    pub fn write(&self, text: &mut impl Write) -> core::fmt::Result {
        writeln!(text, "{HEADER} 2 {:.6}", self.eye_distance_m)?;
        let mut line = |name: &str, Range { low, rest, high }: &Range| {
            writeln!(text, "{name} {low:.6} {rest:.6} {high:.6}")
        };
        for (name, range) in names().zip(self.ranges.iter().chain(&self.features)) {
            line(name, range)?;
        }
        for (unit, range) in &self.readings {
            line(unit.as_str(), range)?;
        }
        Ok(())
    }

    /// Parses the text.
    ///
    /// # Errors
    /// If anything is missing, out of order or implausible.
    pub fn read(text: &str) -> Result<Self, SavedError> {
        let mut lines = text.lines();
        // The number of lines distinguishes the versions.
        let header = |line: &str| {
            let (version, width) = line.strip_prefix(HEADER)?.trim().split_once(' ')?;
            let width = width.trim().parse().ok()?;
            (["1", "2"].contains(&version) && (0.015..0.06).contains(&width)).then_some(width)
        };
        let mut learned = Self {
            eye_distance_m: lines.next().and_then(header).ok_or(SavedError::Header)?,
            ranges: [Range::default(); LEARNT_MEASURES],
            features: heapless::Vec::new(),
            readings: heapless::Vec::new(),
        };
        for (k, name) in names().enumerate() {
            let line = lines.next();
            if k == LEARNT_MEASURES && line.is_none() {
                return Ok(learned);
            }
            let range = line
                .and_then(parse_line)
                .filter(|(found, _)| *found == name);
            let (_, range) = range.ok_or(SavedError::Line(k + 2, name))?;
            match learned.ranges.get_mut(k) {
                Some(slot) => *slot = range,
                // Capacity: one per feature.
                None => _ = learned.features.push(range),
            }
        }
        for (line, number) in lines.zip(names().count() + 2..) {
            let reading =
                parse_line(line).and_then(|(unit, range)| Some((unit.parse().ok()?, range)));
            let kept = reading.and_then(|reading| learned.readings.push(reading).ok());
            kept.ok_or(SavedError::Line(number, "a unit:"))?;
        }
        Ok(learned)
    }
}

/// Names of the lines before the readings.
fn names() -> impl Iterator<Item = &'static str> {
    let measures = Measure::ALL[..LEARNT_MEASURES]
        .iter()
        .map(|measure| measure.name());
    measures.chain(features::names())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn person() -> Learned {
        Learned {
            eye_distance_m: 0.0371,
            ranges: core::array::from_fn(|m| {
                let rest = 0.25 * m as f64;
                Range {
                    low: rest - 0.125,
                    rest,
                    high: rest + 0.5,
                }
            }),
            features: (0..FEATURES).map(|k| at_rest(0.125 * k as f64)).collect(),
            readings: [("AU25", 0.75), ("AU43L", 1.5)]
                .map(|(unit, high)| {
                    (
                        unit.parse().unwrap(),
                        Range {
                            high,
                            ..Range::default()
                        },
                    )
                })
                .into_iter()
                .collect(),
        }
    }

    fn at_rest(rest: f64) -> Range {
        Range {
            low: rest,
            rest,
            high: rest,
        }
    }

    fn text() -> String {
        let mut text = String::new();
        person().write(&mut text).unwrap();
        text
    }

    #[test]
    fn reading_what_was_written_is_the_identity() {
        assert_eq!(Learned::read(&text()), Ok(person()));
    }

    #[test]
    fn version_1_has_the_ranges_of_the_measures() {
        let text = text().replace("mien-ranges 2", "mien-ranges 1");
        let lines: Vec<&str> = text.lines().take(1 + LEARNT_MEASURES).collect();
        let old = Learned::read(&lines.join("\n")).unwrap();
        assert_eq!(old.ranges, person().ranges);
        assert!(old.features.is_empty() && old.readings.is_empty());
    }

    #[test]
    fn the_movements_of_version_1_are_readings_in_populations_ranges() {
        let (units, person) = (Units::shipped(), person());
        let implied: Vec<_> = person.implied_readings(&units).collect();
        let mut expected = Vec::new();
        for row in &units.rows {
            // Up by 0.5 and down by 0.125, as the person is made.
            for (unit, own, usual) in [
                (&row.rises, 0.5, row.prior.up),
                (&row.falls, 0.125, row.prior.down),
            ] {
                expected.extend(
                    unit.as_ref()
                        .filter(|_| usual > 0.0)
                        .map(|u| (u, own / usual)),
                );
            }
        }
        assert!(implied.len() == expected.len() && expected.len() > 10);
        for ((unit, range), (name, high)) in implied.into_iter().zip(expected) {
            assert!(unit == name && (range.low, range.rest) == (0.0, 0.0));
            assert!((range.high - high).abs() < 1e-9, "{name:?}: {range:?}");
        }
    }

    #[test]
    fn refuses_damaged_text() {
        let whole = text();
        assert_eq!(Learned::read(""), Err(SavedError::Header));
        assert_eq!(
            Learned::read(&whole.replace("0.0371", "nan")),
            Err(SavedError::Header)
        );
        for (from, to, line) in [
            ("lip_gap -0.125", "lip_gap nan", 2),
            ("lip_gap -0.125", "lip_gap 7", 2),
            ("mouth_width", "mouth", 3),
            ("brow_distance", "brow", LEARNT_MEASURES + 2),
            ("AU25 0", "AU25 nan", LEARNT_MEASURES + FEATURES + 2),
            ("AU43L", "AU43Left_", LEARNT_MEASURES + FEATURES + 3),
        ] {
            match Learned::read(&whole.replacen(from, to, 1)) {
                Err(SavedError::Line(found, _)) => assert_eq!(found, line),
                other => panic!("{other:?}"),
            }
        }
        // Any cut but the last line's end is noticed or harmless, never a panic.
        for end in 0..whole.len() {
            let _ = Learned::read(&whole[..end]);
        }
    }

    #[test]
    fn ranges_may_be_one_sided_and_up_to_the_limit() {
        let whole = text();
        for (range, fits) in [
            ("0 0 0.5", true),
            ("-0.125 0 0", true),
            ("-20 0 20", true),
            ("-20.1 0 20", false),
            ("-20 0 20.1", false),
            ("0.1 0 0.5", false),
            ("0 0.6 0.5", false),
        ] {
            let line = whole.lines().nth(1).expect("the first measure");
            let text = whole.replacen(line, &format!("lip_gap {range}"), 1);
            assert_eq!(Learned::read(&text).is_ok(), fits, "{range} in {text}");
        }
    }
}
