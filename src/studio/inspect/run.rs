//! A run's CSV as curves over time: weights, measures, pose, confidence, states, and what range each measure covered.
//!
//! Columns are found by name; unknown ones are ignored. Rows of each user make their own curves. Frames without a value are
//! gaps. A malformed number is an error with its line and column.

use std::collections::{BTreeMap, BTreeSet};

use super::album::Album;
use crate::studio::chart::{Curve, Plot};
use crate::studio::csv;
use crate::studio::fault::Fault;

struct Row {
    seconds: f64,
    user: Option<usize>,
    state: String,
    cells: Vec<Option<f64>>,
}

struct Table {
    header: Vec<String>,
    rows: Vec<Row>,
}

impl Table {
    fn read(text: &str) -> Result<Self, Fault> {
        let run = csv::Table::new(text);
        let needed = |name| {
            run.find(name).ok_or_else(|| {
                Fault::new(format!(
                    "not a CSV from mien: expected a header with a column {name}, which `mien run --csv` writes"
                ))
            })
        };
        needed("frame")?;
        let time = needed("time_us")?;
        let (user, state) = (run.find("user"), run.find("state"));
        let header: Vec<String> = run.columns.iter().map(ToString::to_string).collect();
        let mut rows = Vec::new();
        for csv::Row { line, cells, .. } in run.rows() {
            if cells.len() != header.len() {
                return Err(Fault::new(format!(
                    "line {line}: expected {} cells as in the header, found {}; is the file cut off?",
                    header.len(),
                    cells.len()
                )));
            }
            let number = |(k, cell): (usize, &&str)| {
                if cell.is_empty() || Some(k) == state {
                    return Ok(None);
                }
                cell.parse().map(Some).map_err(|_| {
                    let found: String = cell.chars().take(40).collect();
                    Fault::new(format!(
                        "line {line}, column {}: expected a number or nothing, found {found:?}",
                        header[k]
                    ))
                })
            };
            let numbers = cells.iter().enumerate().map(number);
            let numbers: Vec<Option<f64>> = numbers.collect::<Result<_, _>>()?;
            rows.push(Row {
                seconds: numbers[time].unwrap_or(0.0) * 1e-6,
                user: user.and_then(|k| numbers[k]).map(|user| user as usize),
                state: state.map_or("", |k| cells[k]).to_owned(),
                cells: numbers,
            });
        }
        if rows.is_empty() {
            let none = "a header but no rows; run longer with `mien run --csv`";
            return Err(Fault::new(none));
        }
        Ok(Self { header, rows })
    }

    /// Columns whose names begin so.
    fn columns(&self, with: &str) -> impl Iterator<Item = usize> {
        (0..self.header.len()).filter(move |&k| self.header[k].starts_with(with))
    }
}

/// Least span of a plot.
type Least = Option<(f64, f64)>;

const SHARE: Least = Some((0.0, 1.0));

/// Heading, columns and least span of the first plots.
const PLOTS: [(&str, &str, Least); 3] = [
    ("Confidence of the face", "confidence", SHARE),
    (
        "Position of the head, metres in the sensor frame",
        "tx_m ty_m tz_m",
        None,
    ),
    (
        "Rotation of the head, quaternion",
        "qx qy qz",
        Some((-0.3, 0.3)),
    ),
];
/// Weights of the next ones. Left and right, and both directions of one measure, belong together.
const WEIGHTS: [(&str, &str); 6] = [
    ("Mouth opening and jaw", "AU25 AU26 AU29"),
    (
        "Mouth width: grin and pout",
        "AU12L AU12R AU20 AU18 AU15L AU15R",
    ),
    ("Lips sideways, forward, back", "AU30L AU30R AU22 AU28"),
    ("Brows", "AU2L AU2R AU4L AU4R AU1L AU1R"),
    ("Lids", "AU43L AU43R AU5L AU5R"),
    ("Nose", "AU9L AU9R"),
];

/// Heading, columns, least span.
type Group = (String, Vec<usize>, Least);

/// Groups of columns that share a plot.
fn groups(table: &Table) -> Vec<Group> {
    let find = |names: &str, prefix: &str| {
        let columns = names.split(' ').map(|name| format!("{prefix}{name}"));
        let at = |name: String| table.header.iter().position(|one| *one == name);
        columns.filter_map(at).collect::<Vec<usize>>()
    };
    let first = PLOTS.map(|(title, names, least)| (title.to_owned(), find(names, ""), least));
    let weights = WEIGHTS.map(|(of, units)| (format!("Weights: {of}"), find(units, "w_"), SHARE));
    let mut groups: Vec<Group> = first.into_iter().chain(weights).collect();
    let shown: Vec<usize> = groups.iter().flat_map(|group| group.1.clone()).collect();
    let others = table.columns("w_").filter(|k| !shown.contains(k));
    for some in others.collect::<Vec<_>>().chunks(6) {
        groups.push(("Weights: others".into(), some.to_vec(), SHARE));
    }
    let mut measures: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
    for k in table.columns("m_") {
        let stem = table.header[k].trim_end_matches("_L");
        let stem = stem.trim_end_matches("_R");
        measures.entry(stem).or_default().push(k);
    }
    for (stem, columns) in measures {
        groups.push((format!("Measure {stem}"), columns, None));
    }
    groups.retain(|group| !group.1.is_empty());
    groups
}

/// Rows of one user further apart than this are not joined, seconds.
const AWAY_S: f64 = 0.25;

/// Plots of one user's rows, whose headings end with `suffix`.
fn plots<'a>(table: &'a Table, rows: &[&'a Row], suffix: &str) -> Vec<Plot> {
    // Where the person was away the curves have a gap: a place without values.
    let mut places: Vec<(f64, Option<&Row>)> = Vec::new();
    for &row in rows {
        let before = places.last().map_or(row.seconds, |last| last.0);
        if row.seconds - before > AWAY_S {
            places.push((0.5 * (before + row.seconds), None));
        }
        places.push((row.seconds, Some(row)));
    }
    let curve = |k: usize| Curve {
        name: table.header[k].clone(),
        values: places.iter().map(|place| place.1?.cells[k]).collect(),
    };
    let plot = |(title, columns, at_least): Group| Plot {
        title: title + suffix,
        x: places.iter().map(|place| place.0).collect(),
        x_name: "s".into(),
        curves: columns.into_iter().map(curve).collect(),
        at_least,
    };
    groups(table).into_iter().map(plot).collect()
}

/// What a column's values of one user cover; `None` without any.
fn covered(rows: &[&Row], k: usize) -> Option<[String; 5]> {
    let values = rows.iter().filter_map(|row| row.cells[k]);
    let mut values: Vec<f64> = values.filter(|v| v.is_finite()).collect();
    values.sort_unstable_by(f64::total_cmp);
    let last = values.len().checked_sub(1)?;
    let at = |share: f64| values[(last as f64 * share).round() as usize];
    Some([0.0, 0.05, 0.5, 0.95, 1.0].map(|share| format!("{:.3}", at(share))))
}

/// Reads the CSV and draws it.
pub(super) fn inspect(name: &str, text: &str) -> Result<Album, Fault> {
    let table = Table::read(text)?;
    let mut album = Album::new(format!("Run {name}"));
    let count = table.rows.len();
    let duration = table.rows[count - 1].seconds - table.rows[0].seconds;
    album.fact("rows", count.to_string());
    album.fact("duration", format!("{duration:.2} s"));
    let mut states: BTreeMap<&str, usize> = BTreeMap::new();
    for row in &table.rows {
        *states.entry(&row.state).or_default() += 1;
    }
    let states = states.into_iter().map(|(state, n)| {
        let state = if state.is_empty() { "(none)" } else { state };
        format!("{state} {:.1} %", 100.0 * n as f64 / count as f64)
    });
    album.fact("states", states.collect::<Vec<_>>().join(", "));
    let mut users: BTreeSet<Option<usize>> = table.rows.iter().map(|row| row.user).collect();
    if users.len() > 1 {
        // Frames without anybody; a CSV of one person may do without the column.
        users.remove(&None);
    }
    let named = users.iter().flatten().map(ToString::to_string);
    album.fact("users", named.collect::<Vec<_>>().join(", "));
    album.header(["column", "lowest", "5 %", "median", "95 %", "highest"]);
    for &user in &users {
        let rows: Vec<&Row> = table.rows.iter().filter(|row| row.user == user).collect();
        let suffix = match user {
            Some(user) if users.len() > 1 => format!(" (user {user})"),
            _ => String::new(),
        };
        album.plots.extend(plots(&table, &rows, &suffix));
        for k in table.columns("m_").chain(table.columns("w_")) {
            if let Some(covered) = covered(&rows, k) {
                let name = format!("{}{suffix}", table.header[k]);
                album.table.push([&[name], &covered[..]].concat());
            }
        }
    }
    Ok(album)
}

#[cfg(test)]
mod tests {
    use super::*;

    const RUN: &str = "frame,time_us,user,state,confidence,w_AU25,w_AU77,m_lip_gap\n\
                       0,0,,absent,,,,\n1,33333,0,warming,0.5,0.1,0.2,0.03\n2,66666,0,tracking,0.9,0.8,0.2,0.5\n";

    #[test]
    fn a_run_becomes_curves_and_ranges() {
        let album = inspect("run.csv", RUN).unwrap();
        let titles: Vec<&str> = album.plots.iter().map(|plot| plot.title.as_str()).collect();
        assert_eq!(
            titles,
            [
                "Confidence of the face",
                "Weights: Mouth opening and jaw",
                "Weights: others",
                "Measure m_lip_gap"
            ]
        );
        assert_eq!(album.plots[1].curves[0].values, [Some(0.1), Some(0.8)]);
        assert!(
            album
                .facts
                .iter()
                .any(|(name, value)| name == "states" && value.contains("tracking 33.3 %"))
        );
        assert_eq!(album.table.len(), 4);
    }

    #[test]
    fn what_is_no_run_is_said_in_one_sentence() {
        let message = |text: &str| inspect("x.csv", text).err().unwrap().to_string();
        assert!(message("a,b\n1,2\n").contains("column frame"));
        assert!(message("frame,time_us\n").contains("no rows"));
        assert!(message("frame,time_us\n1\n").contains("line 2"));
        assert!(message("frame,time_us\n1,abc\n").contains("time_us"));
    }
}
