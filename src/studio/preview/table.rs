//! Plays the CSV of a run ([`mien_outputs::csv`]), or any table with `time_us`, `user` and `w_…`: columns are found by name.
//!
//! Every row is sent as it is read and kept by the hub, so that the page can scrub back. Damaged rows are counted and skipped.
//! From standard input (`-`) rows are shown as they arrive.

use std::io::{BufRead, Read};
use std::path::Path;

use super::hub::Hub;
use super::sample::Sample;
use mien_stages::base::capacity::USERS;
use mien_stages::face_model::scheme::VISIBLE_REGIONS;
use mien_stages::users::TrackingState;
use mien_workbench::csv;
use mien_workbench::fault::Fault;
use mien_workbench::text_files::decoded;

/// Longest line, bytes: a row has some 3 kB.
const MAX_LINE: u64 = 1 << 16;

/// Opens the table and reads its header.
///
/// # Errors
/// If it cannot be read or is another kind of table.
pub fn open(path: &Path) -> Result<(Columns, Box<dyn BufRead + Send>), Fault> {
    let unreadable = Fault::cannot("read", path, "");
    let file: Box<dyn Read + Send> = match path.as_os_str() == "-" {
        true => Box::new(std::io::stdin()),
        false => Box::new(std::fs::File::open(path).map_err(&unreadable)?),
    };
    let mut reader = std::io::BufReader::new(file);
    let mut header = Vec::new();
    let mut first = reader.by_ref().take(MAX_LINE);
    first.read_until(b'\n', &mut header).map_err(unreadable)?;
    let header = decoded(&header);
    let table = Columns::new(&header).ok_or_else(|| {
        let found: String = header.trim_end().chars().take(60).collect();
        Fault::within(path)(format!(
            "line 1: expected a header with time_us, user and w_<unit> columns, found {found:?}; mien run --csv writes one"
        ))
    })?;
    Ok((table, Box::new(reader)))
}

/// Sends all rows to the hub.
pub fn play(mut table: Columns, mut reader: Box<dyn BufRead + Send>, hub: &Hub) {
    let mut line = Vec::new();
    loop {
        line.clear();
        match reader.by_ref().take(MAX_LINE).read_until(b'\n', &mut line) {
            Ok(0) => break,
            Ok(_) if line.trim_ascii().is_empty() => {}
            Ok(_) => match table.row(&String::from_utf8_lossy(&line)) {
                Some(sample) => {
                    hub.sample(&sample);
                    hub.count(1, 0);
                }
                None => hub.count(0, 1),
            },
            Err(error) => {
                hub.note(&format!("the CSV ends early: {error}"));
                break;
            }
        }
    }
}

/// Columns of the pose.
const POSE: [&str; 7] = ["tx_m", "ty_m", "tz_m", "qx", "qy", "qz", "qw"];
/// Columns of the head's box.
const HEAD_BOX: [&str; 4] = ["head_x0", "head_y0", "head_x1", "head_y1"];

/// Column indices, and the units.
pub struct Columns {
    cells: usize,
    time: usize,
    user: usize,
    frame: Option<usize>,
    state: Option<usize>,
    confidence: Option<usize>,
    /// Empty unless all of them exist.
    pose: Vec<usize>,
    points: Vec<usize>,
    head_box: Vec<usize>,
    /// How far each region can be seen.
    seen: Vec<usize>,
    units: Vec<(String, usize)>,
    rows: u64,
}

impl Columns {
    /// Finds the columns in the header; `None` if required ones are missing.
    pub fn new(header: &str) -> Option<Self> {
        let table = csv::Table::new(header);
        let units = table.beginning_with("w_");
        if units.is_empty() {
            return None;
        }
        let own = |(name, at): (&str, usize)| (name.to_owned(), at);
        Some(Self {
            cells: table.columns.len(),
            time: table.find("time_us")?,
            user: table.find("user")?,
            frame: table.find("frame"),
            state: table.find("state"),
            confidence: table.find("confidence"),
            pose: table.find_all(POSE).unwrap_or_default(),
            points: table.find_points().unwrap_or_default(),
            head_box: table.find_all(HEAD_BOX).unwrap_or_default(),
            seen: table
                .find_all(VISIBLE_REGIONS.map(|(region, _)| format!("s_{region}")))
                .unwrap_or_default(),
            units: units.into_iter().map(own).collect(),
            rows: 0,
        })
    }

    /// Names of the units in the order of the weights.
    pub fn units(&self) -> impl Iterator<Item = &str> {
        self.units.iter().map(|(name, _)| name.as_str())
    }

    /// Parses a row; `None` if it is damaged.
    pub fn row(&mut self, line: &str) -> Option<Sample> {
        let cells = csv::cells(line);
        if cells.len() != self.cells {
            return None;
        }
        // An empty cell is absent; any other must be a number.
        let number = |at: usize| match cells[at] {
            "" => Some(f32::NAN),
            cell => cell.parse::<f32>().ok().filter(|value| value.is_finite()),
        };
        let several = |columns: &[usize]| -> Option<Vec<f32>> {
            columns.iter().map(|&at| number(at)).collect()
        };
        let micros: u64 = cells[self.time].parse().ok()?;
        let user = match cells[self.user] {
            "" => None,
            cell => Some(cell.parse().ok().filter(|&slot: &usize| slot < USERS)?),
        };
        let state = match self.state.map(|at| cells[at]) {
            None => u8::from(user.is_some()) * TrackingState::Tracking.code(),
            Some(word) => {
                let mut known = TrackingState::ALL.iter();
                known.find(|state| state.name() == word)?.code()
            }
        };
        let weights = self.units.iter().map(|unit| number(unit.1));
        let weights = weights.map(|weight| Some(mien_outputs::finite(weight?)));
        let mut weights = weights.collect::<Option<Vec<f32>>>()?;
        if state == TrackingState::Posed.code() {
            // Absent weights are not weights of 0.
            weights.clear();
        }
        // All of a group of columns, if each has a number.
        let whole = |columns: &[usize]| {
            let is_whole = |values: &Vec<f32>| values.iter().all(|value| value.is_finite());
            Some(Some(several(columns)?).filter(is_whole).unwrap_or_default())
        };
        let points = whole(&self.points)?;
        let head_box: Option<[f32; 4]> = whole(&self.head_box)?.try_into().ok();
        let is_there = |sides: &[f32; 4]| sides.iter().all(|side| (0.0..=65535.0).contains(side));
        let head_box = head_box.filter(is_there);
        self.rows += 1;
        let frame = self.frame.and_then(|at| cells[at].parse().ok());
        Some(Sample {
            user,
            number: frame.unwrap_or(self.rows - 1),
            seconds: micros as f64 * 1e-6,
            state,
            confidence: self.confidence.map_or(Some(f32::NAN), number)?,
            pose: whole(&self.pose)?.try_into().ok(),
            head_box: head_box.map(|sides| sides.map(|side| side as u16)),
            seen: whole(&self.seen)?.try_into().ok(),
            weights,
            points: points.chunks_exact(2).map(|p| [p[0], p[1]]).collect(),
            ..Sample::default()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_read_by_name_and_damaged_ones_are_none() {
        let header = "w_AU26,user,time_us,state,other,w_AU25";
        let mut table = Columns::new(header).unwrap();
        assert!(table.units().eq(["AU26", "AU25"]));
        let row = table.row("0.5,1,33333,tracking,x,0.25\n").unwrap();
        assert_eq!((row.user, row.state, row.number), (Some(1), 2, 0));
        assert_eq!(row.weights, [0.5, 0.25]);
        let header = "w_AU26,user,time_us,state,head_x0,head_y0,head_x1,head_y1";
        let mut boxed = Columns::new(header).unwrap();
        let posed = boxed.row(",0,33333,posed,10,20,110,140").unwrap();
        assert_eq!((posed.state, posed.head_box), (5, Some([10, 20, 110, 140])));
        assert!(posed.weights.is_empty(), "no weights are not weights of 0");
        let held = boxed.row("0.5,0,66666,held,,,,").unwrap();
        assert_eq!((held.head_box, held.weights), (None, vec![0.5]));
        let header = "w_AU26,user,time_us,state,s_mouth,s_brow_R,s_eye_L,s_eye_R,s_nose,s_brow_L";
        let mut covered = Columns::new(header).unwrap();
        let row = covered.row("0,0,33333,tracking,0.0000,0.2,0.3,0.4,0.5,0.1");
        assert_eq!(row.unwrap().seen, Some([0.1, 0.2, 0.3, 0.4, 0.5, 0.0]));
        let lost = covered.row(",0,66666,lost,,,,,,").unwrap();
        assert_eq!((lost.seen, held.seen), (None, None));
        let nobody = table.row(",,66666,absent,,\n").unwrap();
        assert_eq!(
            (nobody.user, nobody.state, nobody.weights),
            (None, 0, vec![0.0; 2])
        );
        for bad in [
            "0.5,1,33333,tracking,x",
            "nan,1,33333,tracking,x,0",
            "0.5,9,33333,tracking,x,0",
            "0.5,1,-3,tracking,x,0",
            "0.5,1,3,sleeping,x,0",
        ] {
            assert!(table.row(bad).is_none(), "{bad}");
        }
        assert!(Columns::new("a,b").is_none());
    }

    #[test]
    fn another_kind_of_table_is_refused_with_its_first_line() {
        let path = std::env::temp_dir().join(format!("mien-table-{}.csv", std::process::id()));
        std::fs::write(&path, "a,b\n1,2\n").unwrap();
        let wrong = open(&path).err().unwrap().to_string();
        std::fs::remove_file(&path).unwrap();
        assert!(wrong.contains("time_us") && wrong.contains("\"a,b\""));
    }
}
