//! A run's CSV as curves over time: weights, measures, pose, confidence, states, and what range each measure covered.
//!
//! Columns are found by name; unknown ones are ignored. Rows of each user make their own curves. Frames without a value are
//! gaps. A malformed number is an error with its line and column.

use std::collections::BTreeMap;
use std::path::Path;

use super::album::{Album, Curve, Plot, name_of};
use super::error::InspectError;
use crate::studio::csv;

struct Table {
    header: Vec<String>,
    rows: Vec<Vec<Option<f64>>>,
    states: Vec<String>,
    users: Vec<Option<usize>>,
}

impl Table {
    fn read(path: &Path, text: &str) -> Result<Self, InspectError> {
        let run = csv::Table::new(text);
        for needed in ["frame", "time_us"] {
            if run.find(needed).is_none() {
                return Err(InspectError::NotARun {
                    path: path.into(),
                    missing: needed,
                });
            }
        }
        let is_text = |name: &str| name == "state";
        let mut table = Self {
            rows: Vec::new(),
            states: Vec::new(),
            users: Vec::new(),
            header: run.columns().iter().map(|&name| name.to_owned()).collect(),
        };
        for csv::Row { line, cells, .. } in run.rows() {
            if cells.len() != table.header.len() {
                return Err(InspectError::Row {
                    path: path.into(),
                    line,
                    expected: table.header.len(),
                    found: cells.len(),
                });
            }
            let row = cells.iter().zip(&table.header).map(|(cell, name)| {
                if cell.is_empty() || is_text(name) {
                    return Ok(None);
                }
                cell.parse().map(Some).map_err(|_| InspectError::Cell {
                    path: path.into(),
                    line,
                    column: name.clone(),
                    found: cell.chars().take(40).collect(),
                })
            });
            let row: Vec<Option<f64>> = row.collect::<Result<_, _>>()?;
            let cell = |name: &str| table.header.iter().position(|n| n == name);
            table
                .states
                .push(cell("state").map_or("", |k| cells[k]).to_owned());
            table
                .users
                .push(cell("user").and_then(|k| row[k]).map(|user| user as usize));
            table.rows.push(row);
        }
        if table.rows.is_empty() {
            return Err(InspectError::EmptyRun { path: path.into() });
        }
        Ok(table)
    }

    fn column(&self, name: &str) -> Option<usize> {
        self.header.iter().position(|n| n == name)
    }
}

/// Heading, columns with their legend, least span.
type Group = (String, Vec<(usize, String)>, Option<(f64, f64)>);

/// Groups of columns that share a plot.
fn groups(table: &Table) -> Vec<Group> {
    let mut groups = Vec::new();
    let mut add = |title: &str, names: &[&str], least| {
        let columns: Vec<_> = names
            .iter()
            .filter_map(|name| Some((table.column(name)?, (*name).to_owned())))
            .collect();
        if !columns.is_empty() {
            groups.push((title.to_owned(), columns, least));
        }
    };
    add("Confidence of the face", &["confidence"], Some((0.0, 1.0)));
    add(
        "Position of the head, metres in the sensor frame",
        &["tx_m", "ty_m", "tz_m"],
        None,
    );
    add(
        "Rotation of the head, quaternion",
        &["qx", "qy", "qz"],
        Some((-0.3, 0.3)),
    );
    // Weights: left and right, and both directions of one measure, belong together.
    for (title, names) in [
        ("Mouth opening and jaw", &["AU25", "AU26", "AU29"][..]),
        (
            "Mouth width: grin and pout",
            &["AU12L", "AU12R", "AU20", "AU18", "AU15L", "AU15R"],
        ),
        (
            "Lips sideways, forward, back",
            &["AU30L", "AU30R", "AU22", "AU28"],
        ),
        ("Brows", &["AU2L", "AU2R", "AU4L", "AU4R", "AU1L", "AU1R"]),
        ("Lids", &["AU43L", "AU43R", "AU5L", "AU5R"]),
        ("Nose", &["AU9L", "AU9R"]),
    ] {
        let columns: Vec<String> = names.iter().map(|name| format!("w_{name}")).collect();
        let names: Vec<&str> = columns.iter().map(String::as_str).collect();
        add(&format!("Weights: {title}"), &names, Some((0.0, 1.0)));
    }
    let shown: Vec<usize> = groups
        .iter()
        .flat_map(|(_, columns, _)| columns.iter().map(|(k, _)| *k))
        .collect();
    let others: Vec<(usize, String)> = table
        .header
        .iter()
        .enumerate()
        .filter(|(k, name)| name.starts_with("w_") && !shown.contains(k))
        .map(|(k, name)| (k, name.clone()))
        .collect();
    for some in others.chunks(6) {
        groups.push(("Weights: others".into(), some.to_vec(), Some((0.0, 1.0))));
    }
    let mut measures: BTreeMap<String, Vec<(usize, String)>> = BTreeMap::new();
    for (k, name) in table
        .header
        .iter()
        .enumerate()
        .filter(|(_, name)| name.starts_with("m_"))
    {
        let stem = name
            .trim_end_matches("_L")
            .trim_end_matches("_R")
            .to_owned();
        measures.entry(stem).or_default().push((k, name.clone()));
    }
    groups.extend(
        measures
            .into_iter()
            .map(|(stem, columns)| (format!("Measure {stem}"), columns, None)),
    );
    groups
}

/// Rows of one user further apart than this are not joined, seconds.
const AWAY_S: f64 = 0.25;

/// Value below which this share of the sorted values lies.
fn quantile(sorted: &[f64], share: f64) -> f64 {
    sorted[((sorted.len() - 1) as f64 * share).round() as usize]
}

/// Reads the CSV and draws it.
/// Long because it is the page of a run from top to bottom.
pub(super) fn inspect(path: &Path, text: &str) -> Result<Album, InspectError> {
    let table = Table::read(path, text)?;
    let mut album = Album {
        title: format!("Run {}", name_of(path)),
        ..Album::default()
    };
    let time = table.column("time_us").expect("checked while reading");
    let seconds = |row: &Vec<Option<f64>>| row[time].unwrap_or(0.0) * 1e-6;
    let (first, last) = (
        seconds(&table.rows[0]),
        table.rows.last().map_or(0.0, seconds),
    );
    album.fact("rows", table.rows.len().to_string());
    album.fact("duration", format!("{:.2} s", last - first));
    let mut states: BTreeMap<&str, usize> = BTreeMap::new();
    for state in &table.states {
        *states
            .entry(if state.is_empty() { "(none)" } else { state })
            .or_default() += 1;
    }
    let share = |n: usize| 100.0 * n as f64 / table.rows.len() as f64;
    let states: Vec<String> = states
        .iter()
        .map(|(state, &n)| format!("{state} {:.1} %", share(n)))
        .collect();
    album.fact("states", states.join(", "));

    let mut users: Vec<Option<usize>> = table.users.clone();
    users.sort_unstable();
    users.dedup();
    users.retain(|user| user.is_some() || users_are_unnamed(&table));
    album.fact(
        "users",
        users
            .iter()
            .flatten()
            .map(ToString::to_string)
            .collect::<Vec<_>>()
            .join(", "),
    );
    for &user in &users {
        let rows: Vec<&Vec<Option<f64>>> = table
            .rows
            .iter()
            .zip(&table.users)
            .filter(|(_, u)| **u == user)
            .map(|(row, _)| row)
            .collect();
        let mut x: Vec<f64> = rows.iter().map(|row| seconds(row)).collect();
        // Where the person was away the curves have a gap: a place without values.
        let away: Vec<usize> = (1..x.len()).filter(|&i| x[i] - x[i - 1] > AWAY_S).collect();
        for &i in away.iter().rev() {
            x.insert(i, 0.5 * (x[i - 1] + x[i]));
        }
        let values = |k: usize| {
            let mut values: Vec<Option<f64>> = rows.iter().map(|row| row[k]).collect();
            for &i in away.iter().rev() {
                values.insert(i, None);
            }
            values
        };
        let suffix = match user {
            Some(user) if users.len() > 1 => format!(" (user {user})"),
            _ => String::new(),
        };
        for (title, columns, at_least) in groups(&table) {
            let curves: Vec<Curve> = columns
                .into_iter()
                .map(|(k, name)| Curve {
                    name,
                    values: values(k),
                })
                .collect();
            album.plots.push(Plot {
                title: title + &suffix,
                x: x.clone(),
                x_name: "s".into(),
                curves,
                at_least,
            });
        }
        if album.table.is_empty() {
            album.table.push(
                ["column", "lowest", "5 %", "median", "95 %", "highest"]
                    .map(String::from)
                    .to_vec(),
            );
        }
        for (k, name) in table
            .header
            .iter()
            .enumerate()
            .filter(|(_, name)| name.starts_with("m_") || name.starts_with("w_"))
        {
            let mut values: Vec<f64> = rows
                .iter()
                .filter_map(|row| row[k])
                .filter(|v| v.is_finite())
                .collect();
            if values.is_empty() {
                continue;
            }
            values.sort_unstable_by(f64::total_cmp);
            let mut cells = vec![format!("{name}{suffix}")];
            cells.extend(
                [0.0, 0.05, 0.5, 0.95, 1.0].map(|share| format!("{:.3}", quantile(&values, share))),
            );
            album.table.push(cells);
        }
    }
    Ok(album)
}

/// A CSV of one person may do without the column.
fn users_are_unnamed(table: &Table) -> bool {
    table.users.iter().all(Option::is_none)
}

#[cfg(test)]
mod tests {
    use super::*;

    const RUN: &str = "frame,time_us,user,state,confidence,w_AU25,w_AU77,m_lip_gap\n\
                       0,0,,absent,,,,\n1,33333,0,warming,0.5,0.1,0.2,0.03\n2,66666,0,tracking,0.9,0.8,0.2,0.5\n";

    #[test]
    fn a_run_becomes_curves_and_ranges() {
        let album = inspect(Path::new("run.csv"), RUN).unwrap();
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
        let message = |text: &str| inspect(Path::new("x.csv"), text).err().unwrap().to_string();
        assert!(message("a,b\n1,2\n").contains("column frame"));
        assert!(message("frame,time_us\n").contains("no rows"));
        assert!(message("frame,time_us\n1\n").contains("line 2"));
        assert!(message("frame,time_us\n1,abc\n").contains("time_us"));
    }
}
