//! The lists of a recording: time and file of every picture, and which ones belong together.

use crate::picture_file::nearest;
use mien_stages::base::sorting::sort;

/// Assumed period if there is only one picture, µs.
const PERIOD_US: i64 = 33_333;

/// A line of a list.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Entry {
    pub(super) name: String,
    /// Time since the first frame, µs; `None` if it is missing or not later than the line before.
    pub(super) time_us: Option<i64>,
    /// Index of a frame's picture in the other list.
    pub(super) picture: Option<usize>,
}

/// Both lists.
pub(super) struct Index {
    /// A frame each: the depth pictures, or without depth the pictures.
    pub(super) frames: Vec<Entry>,
    pub(super) pictures: Vec<Entry>,
    /// Time of the first picture since the first frame, µs.
    picture_start: Option<i64>,
}

/// Time and file name of every line that is no comment, as text.
fn fields(text: &str) -> impl Iterator<Item = (&str, &str)> {
    let lines = text.lines().map(str::trim);
    let lines = lines.filter(|line| !line.is_empty() && !line.starts_with('#'));
    lines.map(|line| line.split_once(char::is_whitespace).unwrap_or(("", line)))
}

/// Units of time used by mistake in lists, and their number per second.
const OTHER_UNITS: [(&str, f64); 3] = [
    ("nanoseconds", 1e9),
    ("microseconds", 1e6),
    ("milliseconds", 1e3),
];
/// Largest plausible median period, seconds; larger ones indicate another unit of time.
const PERIOD_MAX_S: f64 = 4.0;
/// Smallest share of depth pictures that must have a partner.
const PAIRED_SHARE: f64 = 0.1;

fn median(mut values: Vec<f32>) -> Option<f64> {
    let middle = values.len() / 2;
    sort(&mut values);
    values.get(middle).map(|value| f64::from(*value))
}

/// The problem with the times of a list, if they are evidently not seconds.
pub(super) fn misread_times(text: &str) -> Option<String> {
    if let Some((time, _)) = fields(text).find(|(time, _)| {
        let split = time.split_once(',');
        split.is_some_and(|(a, b)| a.parse::<u64>().is_ok() && b.parse::<u64>().is_ok())
    }) {
        return Some(format!(
            "expected seconds with a decimal point, found {time:?}; replace the commas"
        ));
    }
    let times = fields(text).filter_map(|(time, _)| time.parse::<f64>().ok());
    let times: Vec<f64> = times.filter(|time| time.is_finite()).collect();
    let spacing = median(
        times
            .windows(2)
            .map(|two| (two[1] - two[0]) as f32)
            .collect(),
    )?;
    let (unit, second) = OTHER_UNITS
        .into_iter()
        .find(|(_, second)| spacing / second >= 1e-3 && spacing >= PERIOD_MAX_S)?;
    Some(format!(
        "expected seconds, found times {spacing:.1} apart, which look like {unit}; divide them by {second}"
    ))
}

/// Time (µs) and file name of every line that is no comment; no time if the file is outside of the folder.
fn lines(text: &str) -> impl Iterator<Item = (Option<i64>, &str)> {
    fields(text).map(|(time, name)| {
        let seconds = time.parse().ok().filter(|s: &f64| s.abs() < 1e11);
        let name = name.trim();
        let inside = !name.starts_with('/') && name.split(['/', '\\']).all(|part| part != "..");
        let seconds: Option<f64> = seconds.filter(|_| inside);
        (seconds.map(|s| (s * 1e6).round() as i64), name)
    })
}

/// The entries of a list, without partners; times are relative to `start`, µs.
fn entries(text: &str, start: i64) -> Vec<Entry> {
    let mut last = None;
    let entries = lines(text).map(|(time, name)| {
        let time = time.filter(|time| last.is_none_or(|last| *time > last));
        last = time.or(last);
        Entry {
            name: name.to_owned(),
            time_us: time.map(|time| time - start),
            picture: None,
        }
    });
    entries.collect()
}

impl Index {
    /// The problem with pairing, if hardly any depth picture has a partner.
    pub(super) fn pairing_problem(&self) -> Option<String> {
        let paired = self.frames.iter().filter(|entry| entry.picture.is_some());
        let enough = paired.count() as f64 >= PAIRED_SHARE * self.frames.len() as f64;
        let seconds = self.picture_start? as f64 * 1e-6;
        (!enough).then(|| {
            format!("hardly any picture was taken at the time of one in depth.txt, and its times begin {seconds:.3} s later: are both from the same clock? Heads are tracked by depth alone")
        })
    }

    /// Of the list of depth pictures and that of the others; without depth, of the latter twice.
    pub(super) fn parse(frames: &str, pictures: &str) -> Self {
        let start = lines(frames).find_map(|(time, _)| time).unwrap_or(0);
        let (mut frames, pictures) = (entries(frames, start), entries(pictures, start));
        let times: Vec<i64> = frames.iter().filter_map(|entry| entry.time_us).collect();
        let periods = times.windows(2).map(|two| (two[1] - two[0]) as f32);
        let period = median(periods.collect()).map_or(PERIOD_US, |us| us as i64);
        let timed = pictures.iter().enumerate();
        let timed = timed.filter_map(|(at, entry)| Some((entry.time_us?, at)));
        let timed: Vec<(i64, usize)> = timed.collect();
        let partner = |time: i64| {
            let (other, at) = timed[nearest(&timed, time, |other| other.0)?];
            ((other - time).abs() * 2 <= period).then_some(at)
        };
        for entry in &mut frames {
            entry.picture = entry.time_us.and_then(partner);
        }
        Self {
            picture_start: timed.first().map(|other| other.0),
            frames,
            pictures,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_nearest_in_time_goes_together_and_a_step_back_has_no_time() {
        let depth = "# depth maps\n10.000 d/0\n10.033 d/1\n10.066 d/2\n10.050 d/x\n10.2 d/3\nodd\n10.3 ../d\n";
        let index = Index::parse(
            depth,
            "# colour\n9.99 r/0\n10.045 r/1\n10.06 r/2\n10.222 r/3\n",
        );
        let known: Vec<_> = index
            .frames
            .iter()
            .map(|e| (e.time_us, e.picture))
            .collect();
        let expected = [
            (Some(0), Some(0)),
            (Some(33_000), Some(1)),
            (Some(66_000), Some(2)),
            (None, None),
            (Some(200_000), None),
            (None, None),
            (None, None),
        ];
        assert_eq!(known, expected);
        assert!(Index::parse("", "").frames.is_empty());
        assert_eq!(index.pairing_problem(), None);
        let problem = Index::parse("10.0 d/0\n10.033 d/1\n", "900.5 r/0\n").pairing_problem();
        assert!(
            problem
                .expect("two clocks")
                .contains("begin 890.500 s later")
        );
    }

    #[test]
    fn times_that_are_no_seconds_are_named() {
        let list = |first: f64, spacing: f64| -> String {
            (0..5)
                .map(|k| format!("{} d/{k}\n", first + spacing * f64::from(k)))
                .collect()
        };
        for (first, spacing, unit) in [
            (0.0, 33.0, "milliseconds"),
            (1_763_720_000_000.0, 33.0, "milliseconds"),
            (0.0, 33_333.0, "microseconds"),
            (1.76e18, 33_333_333.0, "nanoseconds"),
        ] {
            let problem = misread_times(&list(first, spacing)).expect(unit);
            assert!(problem.contains(unit), "{problem}");
        }
        let problem = misread_times("10,033 d/0\n10,066 d/1\n").expect("commas");
        assert!(
            problem.contains("decimal point, found \"10,033\""),
            "{problem}"
        );
        for (first, spacing) in [(1_305_031_102.16, 0.033), (0.0, 1.0), (0.0, 0.004)] {
            assert_eq!(misread_times(&list(first, spacing)), None);
        }
    }
}
