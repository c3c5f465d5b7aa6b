//! A run's CSV as curves over time: weights, measures, pose, confidence, states, and what range each measure covered.
//!
//! Columns are found by name; unknown ones are ignored. Rows of each user make their own curves. Frames without a value are
//! gaps. A malformed number is an error with its line and column.

use std::collections::{BTreeMap, BTreeSet};

use super::album::Album;
use crate::chart::{Curve, Plot};
use mien_workbench::csv;
use mien_workbench::fault::Fault;

struct Row {
    seconds: f64,
    user: Option<usize>,
    state: String,
    cells: Vec<Option<f64>>,
}

struct Table<'a> {
    csv: csv::Table<'a>,
    rows: Vec<Row>,
}

impl<'a> Table<'a> {
    fn read(text: &'a str) -> Result<Self, Fault> {
        let run = csv::Table::new(text);
        let needed = |name| {
            let expected = format!("expected a header with a column {name}");
            let none = format!("not a CSV from mien: {expected}, which `mien run --csv` writes");
            run.find(name).ok_or(Fault::new(none))
        };
        needed("frame")?;
        let time = needed("time_us")?;
        let (user, state) = (run.find("user"), run.find("state"));
        let header = &run.columns;
        let mut rows = Vec::new();
        for csv::Row { line, cells, .. } in run.rows() {
            if cells.len() != header.len() {
                let (wanted, found) = (header.len(), cells.len());
                return Err(Fault::new(format!(
                    "line {line}: expected {wanted} cells as in the header, found {found}; is the file cut off?"
                )));
            }
            let number = |(k, cell): (usize, &&str)| {
                if cell.is_empty() || Some(k) == state {
                    return Ok(None);
                }
                cell.parse().map(Some).map_err(|_| {
                    let found: String = cell.chars().take(40).collect();
                    let expected = format!("column {}: expected a number or nothing", header[k]);
                    Fault::new(format!("line {line}, {expected}, found {found:?}"))
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
        Ok(Self { csv: run, rows })
    }

    /// The faces of rows with all points: seconds, user, points.
    fn faces(&self) -> Vec<(f64, usize, Vec<i32>)> {
        let Some(columns) = self.csv.find_points() else {
            return Vec::new();
        };
        let face = |row: &Row| {
            let rounded = |&k: &usize| row.cells[k].map(|at| at.round() as i32);
            let points: Option<_> = columns.iter().map(rounded).collect();
            Some((row.seconds, row.user.unwrap_or(0), points?))
        };
        let every = self.rows.len().div_ceil(FACES).max(1);
        self.rows.iter().step_by(every).filter_map(face).collect()
    }
}

/// Most faces in the page.
const FACES: usize = 2000;
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
/// Weights that share a plot, from the top. Left and right, and both directions of one measure, belong together.
const WEIGHTS: [(&str, &str); 8] = [
    ("brows", "AU1L AU1R AU2L AU2R AU4L AU4R"),
    ("lids", "AU5L AU5R AU43L AU43R"),
    ("gaze", "AU61 AU62 AU63 AU64"),
    ("nose and cheeks", "AU6L AU6R AU9L AU9R AU34L AU34R"),
    (
        "corners of the mouth",
        "AU12L AU12R AU15L AU15R AU14L AU14R",
    ),
    ("shape of the mouth", "AU20 AU18 AU22 AU28"),
    ("lips", "AU25 AU10L AU10R AU17"),
    ("jaw", "AU26 AU29 AU30L AU30R"),
];

/// Heading, columns, least span.
pub(super) type Group = (String, Vec<usize>, Least);

/// Plots of the units' weights, the columns whose names begin with `w_`.
pub(super) fn weight_groups(columns: &[impl AsRef<str>]) -> Vec<Group> {
    let unit = |k: usize| columns[k].as_ref().strip_prefix("w_");
    let mut left: Vec<usize> = (0..columns.len()).filter(|&k| unit(k).is_some()).collect();
    let find = |name| left.iter().copied().find(|&k| unit(k) == Some(name));
    let groups = WEIGHTS.map(|(of, names)| {
        let columns: Vec<usize> = names.split(' ').filter_map(find).collect();
        (format!("Weights: {of}"), columns, SHARE)
    });
    let mut groups = Vec::from(groups);
    left.retain(|k| !groups.iter().any(|(_, columns, _)| columns.contains(k)));
    let others = left.chunks(6).map(<[usize]>::to_vec);
    groups.extend(others.map(|some| ("Weights: others".to_owned(), some, SHARE)));
    groups.retain(|(_, columns, _)| !columns.is_empty());
    groups
}

/// Groups of columns that share a plot.
fn groups(csv: &csv::Table) -> Vec<Group> {
    let mut groups = weight_groups(&csv.columns);
    groups.extend(PLOTS.map(|(title, names, least)| {
        let columns = names.split(' ').filter_map(|name| csv.find(name));
        (title.to_owned(), columns.collect(), least)
    }));
    let mut measures: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
    for (name, k) in csv.beginning_with("m_") {
        let stem = name.trim_end_matches("_L").trim_end_matches("_R");
        measures.entry(stem).or_default().push(k);
    }
    for (stem, columns) in measures {
        groups.push((format!("Measure m_{stem}"), columns, None));
    }
    groups.retain(|group| !group.1.is_empty());
    groups
}

/// A plot over time; `places` are seconds with the values of all columns.
pub(super) fn plot(
    names: &[impl AsRef<str>],
    places: &[(f64, &[Option<f64>])],
    (title, columns, at_least): Group,
) -> Plot {
    let curve = |k: usize| Curve {
        name: names[k].as_ref().to_owned(),
        values: places.iter().map(|place| *place.1.get(k)?).collect(),
    };
    Plot {
        title,
        x: places.iter().map(|place| place.0).collect(),
        x_name: "s".into(),
        curves: columns.into_iter().map(curve).collect(),
        at_least,
    }
}

/// Gap between a user's rows above which they are not connected, seconds.
const AWAY_S: f64 = 0.25;

/// Plots of one user's rows; headings end with `suffix`.
fn plots(csv: &csv::Table, rows: &[&Row], suffix: &str) -> Vec<Plot> {
    // A point without values interrupts the curves while the person was away.
    let mut places: Vec<(f64, &[Option<f64>])> = Vec::new();
    for &row in rows {
        let before = places.last().map_or(row.seconds, |last| last.0);
        if row.seconds - before > AWAY_S {
            places.push((0.5 * (before + row.seconds), &[]));
        }
        places.push((row.seconds, &row.cells));
    }
    let groups = groups(csv).into_iter();
    let groups = groups.map(|(title, columns, least)| (title + suffix, columns, least));
    let plots = groups.map(|group| plot(&csv.columns, &places, group));
    plots.collect()
}

/// Range of a column's values of one user; `None` without any.
fn covered(rows: &[&Row], k: usize) -> Option<[String; 5]> {
    let values = rows.iter().filter_map(|row| row.cells[k]);
    let mut values: Vec<f64> = values.filter(|v| v.is_finite()).collect();
    values.sort_unstable_by(f64::total_cmp);
    let last = values.len().checked_sub(1)?;
    let at = |share: f64| values[(last as f64 * share).round() as usize];
    Some([0.0, 0.05, 0.5, 0.95, 1.0].map(|share| format!("{:.3}", at(share))))
}

/// The album of a run's CSV.
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
        // Frames without anybody; a CSV of one person may lack the column.
        users.remove(&None);
    }
    let named = users.iter().flatten().map(ToString::to_string);
    album.fact("users", named.collect::<Vec<_>>().join(", "));
    album.faces = table.faces();
    album.header(["column", "lowest", "5 %", "median", "95 %", "highest"]);
    for &user in &users {
        let rows: Vec<&Row> = table.rows.iter().filter(|row| row.user == user).collect();
        let suffix = match user {
            Some(user) if users.len() > 1 => format!(" (person {})", user + 1),
            _ => String::new(),
        };
        album.plots.extend(plots(&table.csv, &rows, &suffix));
        let tabled = ["m_", "w_"].map(|prefix| table.csv.beginning_with(prefix));
        for (_, k) in tabled.concat() {
            if let Some(covered) = covered(&rows, k) {
                let name = format!("{}{suffix}", table.csv.columns[k]);
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
                "Weights: lips",
                "Weights: others",
                "Confidence of the face",
                "Measure m_lip_gap"
            ]
        );
        assert_eq!(album.plots[0].curves[0].values, [Some(0.1), Some(0.8)]);
        assert!(
            album
                .facts
                .iter()
                .any(|(name, value)| name == "states" && value.contains("tracking 33.3 %"))
        );
        assert_eq!(album.table.len(), 4);
    }

    #[test]
    fn a_table_of_another_kind_is_refused_in_one_sentence() {
        let message = |text: &str| inspect("x.csv", text).err().unwrap().to_string();
        assert!(message("a,b\n1,2\n").contains("column frame"));
        assert!(message("frame,time_us\n").contains("no rows"));
        assert!(message("frame,time_us\n1\n").contains("line 2"));
        assert!(message("frame,time_us\n1,abc\n").contains("time_us"));
    }
}
