//! Saves and loads what was learned about a person, as plain text that is validated on loading.
//!
//! One line per measure, `measure low rest high`, after a header with the version and the eye distance in metres:
//! ```text
//! mien-ranges 1 0.0372
//! lip_gap 0.0213 0.0213 0.7961
//! ```
//! Units: inner-eye-corner distances. Memory: fixed. Degenerate: a file with a missing measure, in the wrong
//! order, or with a non-finite or implausible number is rejected; the caller then starts from the population.

use core::fmt::Write;

use super::measures::Measure;
use super::range::Range;
use crate::base::capacity::LEARNT_MEASURES;

const HEADER: &str = "mien-ranges 1";
/// Largest plausible measure, in eye distances.
const LARGEST: f64 = 20.0;

/// One person's ranges.
#[derive(Clone, Debug, PartialEq)]
pub struct Learned {
    /// Inner-eye-corner distance, metres.
    pub eye_distance_m: f32,
    /// By learnt measure.
    pub ranges: [Range; LEARNT_MEASURES],
}

/// Why saved ranges are rejected.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SavedError {
    /// Not this format.
    #[error(
        "saved ranges: expected a first line \"mien-ranges 1 <eye distance in metres, 0.015 to 0.06>\"; delete the file to start over"
    )]
    Header,
    /// A malformed line: its number from 1, and its measure.
    #[error(
        "saved ranges, line {0}: expected \"{1} low rest high\" with low <= rest <= high within 20; delete the file to start over"
    )]
    Line(usize, &'static str),
}

impl Learned {
    /// As text.
    ///
    /// # Errors
    /// If the writer fails.
    pub fn write(&self, text: &mut impl Write) -> core::fmt::Result {
        writeln!(text, "{HEADER} {:.6}", self.eye_distance_m)?;
        for (measure, range) in Measure::ALL.iter().zip(&self.ranges) {
            let Range { low, rest, high } = range;
            writeln!(text, "{} {low:.6} {rest:.6} {high:.6}", measure.name())?;
        }
        Ok(())
    }

    /// From text.
    ///
    /// # Errors
    /// If anything is missing, out of order or implausible.
    pub fn read(text: &str) -> Result<Self, SavedError> {
        let mut lines = text.lines();
        let eye_distance_m = lines
            .next()
            .and_then(|line| line.strip_prefix(HEADER)?.trim().parse().ok())
            .filter(|w| (0.015..0.06).contains(w))
            .ok_or(SavedError::Header)?;
        let mut ranges = [Range::default(); LEARNT_MEASURES];
        for (m, range) in ranges.iter_mut().enumerate() {
            let measure = Measure::ALL[m].name();
            let parse = |line: &str| {
                let mut words = line.split_ascii_whitespace();
                (words.next()? == measure).then_some(())?;
                let mut number = || words.next()?.parse::<f64>().ok();
                let (low, rest, high) = (number()?, number()?, number()?);
                let ordered = low <= rest && rest <= high && low >= -LARGEST && high <= LARGEST;
                (ordered && words.next().is_none()).then_some(Range { low, rest, high })
            };
            *range = lines
                .next()
                .and_then(parse)
                .ok_or(SavedError::Line(m + 2, measure))?;
        }
        Ok(Self {
            eye_distance_m,
            ranges,
        })
    }
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
    fn refuses_what_is_damaged() {
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
    fn a_range_may_end_at_rest_and_reach_as_far_as_any() {
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
