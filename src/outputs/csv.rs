//! CSV: a header, then one row per frame and user.
//!
//! Numbers have a fixed number of decimals, so that equal values give equal bytes. A missing or non-finite value is an empty
//! field. Memory: one row (about 5 kB), kept; cost: about 250 numbers and one write per row.

#[cfg(feature = "studio")]
pub mod columns;

use core::fmt::Write as _;
#[cfg(feature = "std")]
use std::io::Write;

#[cfg(feature = "std")]
use super::{Output, OutputError, Tally};
use super::{Report, TrackingState};
use mien_stages::base::capacity::{LANDMARKS, REGIONS};
use mien_stages::base::prelude::*;
use mien_stages::face_model::scheme::VISIBLE_REGIONS;
use mien_stages::landmarks::Landmarks;

/// Decimals of lengths in metres, quaternions, measures and weights: 1 µm, below their accuracy.
const FINE: usize = 6;
/// Decimals of pixels and confidences.
const COARSE: usize = 4;
/// The first columns.
const FIRST: [&str; 5] = ["frame", "time_us", "user", "state", "confidence"];
/// Columns of the pose.
const POSE: [&str; 7] = ["tx_m", "ty_m", "tz_m", "qx", "qy", "qz", "qw"];
/// Start of the columns of weights.
const WEIGHT: &str = "w_";
/// Columns of the head's box, depth pixels: first column and row, one past the last.
const BOX: [&str; 4] = ["head_x0", "head_y0", "head_x1", "head_y1"];
/// Bytes of the longest field: the largest f32 written out, with its comma.
const FIELD_BYTES: usize = 52;

/// Columns of the 68 points.
fn point_columns() -> impl Iterator<Item = String> {
    (0..LANDMARKS).flat_map(|i| [format!("x{i}"), format!("y{i}")])
}

/// Columns of how far each region can be seen.
fn seen_columns() -> [String; REGIONS] {
    VISIBLE_REGIONS.map(|(region, _)| format!("s_{region}"))
}

/// Formats rows as text, one at a time in a reused buffer.
pub struct Rows {
    row: String,
    measures: usize,
    units: usize,
    gestures: usize,
    /// Camera pixels per frame pixel along each side: of depth, of pictures.
    reduced: [usize; 2],
}

impl Rows {
    /// Starts with the header row. `measures` are names with or without `m_`; `units` and `gestures` are names without `w_` and
    /// `g_`.
    pub fn new(measures: &[&str], units: &[&str], gestures: &[&str]) -> Self {
        let names = point_columns();
        let names = names.chain((0..LANDMARKS).map(|i| format!("c{i}")));
        let plain = measures.iter().map(|m| m.strip_prefix("m_").unwrap_or(m));
        let names = names.chain(plain.map(|measure| format!("m_{measure}")));
        let names = names.chain(units.iter().map(|unit| format!("{WEIGHT}{unit}")));
        let names = names.chain(BOX.map(str::to_owned));
        let names = names.chain(gestures.iter().map(|gesture| format!("g_{gesture}")));
        let mut row = [&FIRST[..], &POSE].concat().join(",");
        let mut fields = FIRST.len() + POSE.len();
        names.chain(seen_columns()).for_each(|name| {
            row += &format!(",{name}");
            fields += 1;
        });
        row.push('\n');
        row.reserve(fields * FIELD_BYTES);
        Self {
            row,
            measures: measures.len(),
            units: units.len(),
            gestures: gestures.len(),
            reduced: [1; 2],
        }
    }

    /// The header, later the last row, each with its newline.
    pub fn text(&self) -> &str {
        &self.row
    }

    /// Appends a number; an empty field if it is missing or not finite.
    fn number(&mut self, value: Option<f32>, decimals: usize) {
        self.row.push(',');
        let start = self.row.len();
        if let Some(value) = value.filter(|value| value.is_finite()) {
            write!(self.row, "{value:.decimals$}").expect("a String takes everything");
        }
        // No sign on a value rounded to zero.
        if let Some(digits) = self.row[start..].strip_prefix('-')
            && digits.bytes().all(|digit| matches!(digit, b'0' | b'.'))
        {
            self.row.remove(start);
        }
    }

    /// Formats the row of a report; `false` if it gets no row.
    pub fn fill(&mut self, report: &Report) -> bool {
        // A forgotten user gets no row; a frame with nobody gets one without a user.
        let gone = report.user.is_some() && report.state == TrackingState::Absent;
        if gone && !report.none_left {
            return false;
        }
        let user = report.user.filter(|_| !gone);
        self.row.clear();
        let row = &mut self.row;
        write!(row, "{},{},", report.frame, report.at.as_us()).expect("a String takes everything");
        if let Some(user) = user {
            write!(row, "{user}").expect("a String takes everything");
        }
        write!(row, ",{}", report.state.name()).expect("a String takes everything");
        self.number(Some(report.confidence), COARSE);

        // Lost and absent users get no values, posed ones no face values, even if the report has some.
        let present = report.state.is_present();
        let pose = report.pose();
        let position = pose.map(|pose| pose.translation.vector);
        (0..3).for_each(|i| self.number(position.map(|position| position[i]), FINE));
        // nalgebra keeps quaternions as x, y, z, w.
        let rotation = pose.map(|pose| pose.rotation.coords);
        (0..4).for_each(|i| self.number(rotation.map(|rotation| rotation[i]), FINE));

        let face = report.state.has_face();
        let [depth_factor, picture_factor] = self.reduced;
        let middle = (picture_factor - 1) as f32 * 0.5;
        let camera_pixel = |pixel: f32| pixel * picture_factor as f32 + middle;
        let points =
            |value: &dyn Fn(&Landmarks) -> f32| report.landmarks.filter(|_| face).map(value);
        for i in 0..LANDMARKS {
            for axis in 0..2 {
                self.number(points(&|face| camera_pixel(face.pixels[i][axis])), COARSE);
            }
        }
        for i in 0..LANDMARKS {
            self.number(points(&|face| face.point_confidence[i]), COARSE);
        }
        let value = |values: &[f32], i: usize| values.get(i).copied().filter(|_| face);
        (0..self.measures).for_each(|i| self.number(value(report.measures, i), FINE));
        for i in 0..self.units {
            // Not `max`: it would turn NaN into 0.
            let weight =
                value(report.weights, i).map(|weight| if weight < 0.0 { 0.0 } else { weight });
            self.number(weight, FINE);
        }
        let sides = report.head_box.filter(|_| present);
        let sides = sides
            .map(|r| [r.x0, r.y0, r.x1, r.y1].map(|side| u32::from(side) * depth_factor as u32));
        (0..BOX.len()).for_each(|i| self.number(sides.map(|sides| sides[i] as f32), 0));
        for i in 0..self.gestures {
            let is_on = report.gestures >> i & 1 == 1;
            self.row.push_str(if is_on { ",1" } else { ",0" });
        }
        (0..REGIONS).for_each(|i| self.number(points(&|face| face.seen[i]), COARSE));
        self.row.push('\n');
        true
    }
}

/// A CSV output to a writer.
#[cfg(feature = "std")]
pub struct Csv<W> {
    to: W,
    rows: Rows,
    tally: Tally,
    /// Whether the source is live.
    live: bool,
}

#[cfg(feature = "std")]
impl<W: Write> Csv<W> {
    /// Writes the header; the names are those of [`Rows::new`].
    ///
    /// # Errors
    /// If nothing can be written.
    pub fn new(
        to: W,
        measures: &[&str],
        units: &[&str],
        gestures: &[&str],
    ) -> Result<Self, OutputError> {
        let mut csv = Self {
            to,
            rows: Rows::new(measures, units, gestures),
            tally: Tally::empty("csv"),
            live: false,
        };
        csv.write_row()?;
        csv.tally = Tally::empty("csv");
        Ok(csv)
    }

    /// Writes points and boxes in camera pixels: depth and picture were reduced by these factors. The table is the purpose of
    /// playing a recording, so that an error ends the run; a live run keeps its other outputs, and only the table ends.
    pub fn of_source(mut self, reduced: [usize; 2], live: bool) -> Self {
        (self.rows.reduced, self.live) = (reduced, live);
        self
    }

    fn write_row(&mut self) -> Result<(), OutputError> {
        // One write per row, so that a reader does not see partial rows.
        let row = self.rows.text().as_bytes();
        match self.to.write_all(row).and_then(|()| self.to.flush()) {
            Ok(()) => self.tally.sent += 1,
            Err(error) if error.kind() == std::io::ErrorKind::WouldBlock => self.tally.dropped += 1,
            Err(source) => {
                let problem = OutputError::Csv(source);
                if !self.live {
                    return Err(problem);
                }
                tracing::error!("{problem}; the CSV ends here, the run continues");
                self.tally.connected = false;
            }
        }
        Ok(())
    }
}

#[cfg(feature = "std")]
impl<W: Write> Output for Csv<W> {
    fn send(&mut self, report: &Report) -> Result<(), OutputError> {
        if self.tally.connected && self.rows.fill(report) {
            self.write_row()?;
        }
        Ok(())
    }

    /// The table has rows for frames only.
    fn send_absence(&mut self, _: &Report) -> Result<(), OutputError> {
        Ok(())
    }

    fn tally(&self) -> Tally {
        self.tally
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io;

    /// Takes the header and then fails; counts what it is asked to write.
    struct FullDisk(usize);

    impl Write for FullDisk {
        fn write(&mut self, row: &[u8]) -> io::Result<usize> {
            self.0 += 1;
            match self.0 {
                1 => Ok(row.len()),
                _ => Err(io::ErrorKind::StorageFull.into()),
            }
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn an_error_ends_the_table_of_a_live_run_and_a_recordings_run() {
        let csv = || Csv::new(FullDisk(0), &[], &["AU26"], &[]).unwrap();
        let mut recorded = csv();
        assert!(recorded.send(&Report::default()).is_err());
        let mut live = csv().of_source([1; 2], true);
        for _ in 0..2 {
            assert!(live.send(&Report::default()).is_ok());
            assert!(!live.tally().connected);
        }
        assert_eq!(live.to.0, 2, "the header and one row");
    }

    #[test]
    fn a_frame_that_did_not_come_has_no_row() {
        let mut csv = Csv::new(Vec::new(), &[], &["AU26"], &[]).unwrap();
        csv.send_absence(&Report::default()).unwrap();
        assert_eq!(csv.tally().sent, 0);
        csv.send(&Report::default()).unwrap();
        assert_eq!(csv.tally().sent, 1);
    }
}
