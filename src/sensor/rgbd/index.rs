//! The lists of pictures: times from the first depth picture, and which pictures belong together.

/// Pictures are this far apart if there is only one, µs.
const PERIOD_US: i64 = 33_333;

/// A line of a list.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Entry {
    pub(super) name: String,
    /// Since the first depth picture; `None` if the line has none or is not after the line before.
    pub(super) time_us: Option<u64>,
    /// The picture that goes with it, by its place in the other list.
    pub(super) picture: Option<usize>,
}

/// Both lists.
pub(super) struct Index {
    pub(super) depth: Vec<Entry>,
    pub(super) pictures: Vec<Entry>,
}

/// Time and name of every line that is no comment.
fn lines(text: &str) -> impl Iterator<Item = (Option<i64>, &str)> {
    let lines = text.lines().map(str::trim);
    let lines = lines.filter(|line| !line.is_empty() && !line.starts_with('#'));
    lines.map(|line| {
        let (time, name) = line.split_once(char::is_whitespace).unwrap_or(("", line));
        let seconds = time.parse().ok().filter(|s: &f64| s.abs() < 1e11);
        // A recording names files of its own.
        let name = name.trim();
        let inside = !name.starts_with('/') && name.split(['/', '\\']).all(|part| part != "..");
        let seconds = seconds.filter(|_| inside);
        (seconds.map(|s| (s * 1e6).round() as i64), name)
    })
}

impl Index {
    pub(super) fn parse(depth: &str, pictures: &str) -> Self {
        let start = lines(depth).find_map(|(time, _)| time).unwrap_or(0);
        let list = |text: &str| {
            let mut last = None;
            let entries = lines(text).map(|(time, name)| {
                let time = time.filter(|time| last.is_none_or(|last| *time > last));
                last = time.or(last);
                let time_us = time.map(|time| time - start);
                (time_us, name.to_owned())
            });
            entries.collect::<Vec<_>>()
        };
        let (depth, pictures) = (list(depth), list(pictures));
        let known = |list: &[(Option<i64>, String)]| -> Vec<(i64, usize)> {
            let known = list.iter().enumerate();
            let known = known.filter_map(|(k, (time, _))| Some(((*time)?, k)));
            known.collect()
        };
        let of_depth = known(&depth);
        let periods = of_depth.windows(2).map(|two| two[1].0 - two[0].0);
        let mut periods: Vec<i64> = periods.collect();
        periods.sort_unstable();
        let period = periods.get(periods.len() / 2).copied().unwrap_or(PERIOD_US);
        let others = known(&pictures);
        let nearest = |time: i64| {
            let at = others.partition_point(|(other, _)| *other < time);
            let near = others[at.saturating_sub(1)..(at + 1).min(others.len())].iter();
            let nearest = near.min_by_key(|(other, _)| (other - time).abs())?;
            ((nearest.0 - time).abs() * 2 <= period).then_some(nearest.1)
        };
        let entry = |(time, name): (Option<i64>, String)| Entry {
            name,
            time_us: time.and_then(|time| time.try_into().ok()),
            picture: time.and_then(nearest),
        };
        Self {
            depth: depth.into_iter().map(entry).collect(),
            pictures: pictures.into_iter().map(entry).collect(),
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
        let known: Vec<_> = index.depth.iter().map(|e| (e.time_us, e.picture)).collect();
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
        assert!(Index::parse("", "").depth.is_empty());
    }
}
