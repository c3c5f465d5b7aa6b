//! Reads rows of the table, or of any table with `time_us`, `user` and `w_…`, for `mien-studio preview`: columns are found by name.

use super::{BOX, FIRST, POSE, WEIGHT, point_columns, seen_columns};
use crate::finite;
use crate::received::Sample;
use mien_stages::base::capacity::USERS;
use mien_stages::base::prelude::*;
use mien_stages::users::TrackingState;

/// Cells of a line, trimmed.
fn cells(line: &str) -> impl Iterator<Item = &str> {
    line.split(',').map(str::trim)
}

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
        let cells: Vec<&str> = cells(header).collect();
        let find = |name: &str| cells.iter().position(|cell| *cell == name);
        let all = |names: &mut dyn Iterator<Item = String>| -> Vec<usize> {
            let found: Option<_> = names.map(|name| find(&name)).collect();
            found.unwrap_or_default()
        };
        let unit = |(at, cell): (usize, &&str)| Some((cell.strip_prefix(WEIGHT)?.to_owned(), at));
        let units: Vec<_> = cells.iter().enumerate().filter_map(unit).collect();
        let [frame, time, user, state, confidence] = FIRST.map(find);
        (!units.is_empty()).then_some(Self {
            cells: cells.len(),
            time: time?,
            user: user?,
            frame,
            state,
            confidence,
            pose: all(&mut POSE.map(str::to_owned).into_iter()),
            points: all(&mut point_columns()),
            head_box: all(&mut BOX.map(str::to_owned).into_iter()),
            seen: all(&mut seen_columns().into_iter()),
            units,
            rows: 0,
        })
    }

    /// Names of the units in the order of the weights.
    pub fn units(&self) -> impl Iterator<Item = &str> {
        self.units.iter().map(|(name, _)| name.as_str())
    }

    /// Parses a row; `None` if it is damaged.
    pub fn row(&mut self, line: &str) -> Option<Sample> {
        let cells: Vec<&str> = cells(line).collect();
        if cells.len() != self.cells {
            return None;
        }
        // An empty cell is absent; any other must be a number.
        let number = |at: usize| match cells[at] {
            "" => Some(f32::NAN),
            cell => cell.parse::<f32>().ok().filter(|value| value.is_finite()),
        };
        let micros: u64 = cells[self.time].parse().ok()?;
        let user = match cells[self.user] {
            "" => None,
            cell => Some(cell.parse().ok().filter(|&slot: &usize| slot < USERS)?),
        };
        let state = match self.state.map(|at| cells[at]) {
            None if user.is_some() => TrackingState::Tracking,
            None => TrackingState::Absent,
            Some(word) => {
                let mut known = TrackingState::ALL.into_iter();
                known.find(|state| state.name() == word)?
            }
        };
        let weights = self.units.iter().map(|unit| number(unit.1));
        let weights = weights.map(|weight| Some(finite(weight?)));
        let mut weights = weights.collect::<Option<Vec<f32>>>()?;
        if state == TrackingState::Posed {
            // Absent weights are not weights of 0.
            weights.clear();
        }
        // All of a group of columns, if each has a number.
        let whole = |columns: &[usize]| -> Option<Vec<f32>> {
            let values: Option<Vec<f32>> = columns.iter().map(|&at| number(at)).collect();
            let is_whole = |values: &Vec<f32>| values.iter().all(|value| value.is_finite());
            Some(Some(values?).filter(is_whole).unwrap_or_default())
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
    use crate::Report;
    use crate::csv::Rows;
    use mien_stages::base::geometry::Rigid;
    use mien_stages::base::time::Timestamp;
    use mien_stages::landmarks::Landmarks;
    use mien_stages::segment::PixelRect;

    #[test]
    fn rows_of_the_encoder_read_back_whole() {
        let pose = Rigid::translation(0.1, -0.05, 0.7);
        let landmarks = Landmarks {
            pixels: core::array::from_fn(|i| [100.0 + i as f32, 50.5]),
            seen: [1.0, 0.75, 0.5, 0.25, 0.0, 1.0],
            ..Landmarks::default()
        };
        let report = Report {
            frame: 12,
            at: Timestamp::from_us(400_000),
            user: Some(3),
            state: TrackingState::Held,
            confidence: 0.75,
            sensor_from_face: Some(&pose),
            head_box: Some(PixelRect {
                x0: 1,
                y0: 2,
                x1: 30,
                y1: 40,
            }),
            landmarks: Some(&landmarks),
            measures: &[0.5],
            weights: &[0.25, 1.5],
            gestures: 1,
            ..Report::default()
        };
        let mut rows = Rows::new(&["m_lip_gap"], &["AU25", "AU26"], &["smile"]);
        let mut columns = Columns::new(rows.text()).unwrap();
        assert!(columns.units().eq(["AU25", "AU26"]));
        assert!(rows.fill(&report));
        let expected = Sample {
            user: Some(3),
            number: 12,
            seconds: 400_000.0 * 1e-6,
            state: TrackingState::Held,
            confidence: 0.75,
            pose: Some([0.1, -0.05, 0.7, 0.0, 0.0, 0.0, 1.0]),
            head_box: Some([1, 2, 30, 40]),
            seen: Some(landmarks.seen),
            weights: vec![0.25, 1.5],
            points: landmarks.pixels.to_vec(),
            ..Sample::default()
        };
        assert_eq!(columns.row(rows.text()), Some(expected));
    }

    #[test]
    fn rows_are_read_by_name_and_damaged_ones_are_none() {
        let header = "w_AU26,user,time_us,state,other,w_AU25";
        let mut table = Columns::new(header).unwrap();
        assert!(table.units().eq(["AU26", "AU25"]));
        let row = table.row("0.5,1,33333,tracking,x,0.25\n").unwrap();
        assert_eq!(
            (row.user, row.state, row.number),
            (Some(1), TrackingState::Tracking, 0)
        );
        assert_eq!(row.weights, [0.5, 0.25]);
        let header = "w_AU26,user,time_us,state,head_x0,head_y0,head_x1,head_y1";
        let mut boxed = Columns::new(header).unwrap();
        let posed = boxed.row(",0,33333,posed,10,20,110,140").unwrap();
        assert_eq!(
            (posed.state, posed.head_box),
            (TrackingState::Posed, Some([10, 20, 110, 140]))
        );
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
            (None, TrackingState::Absent, vec![0.0; 2])
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
}
