//! Serial line, in one of three styles. `text`: one line of whole numbers per frame that any serial monitor, microcontroller
//! or script reads. `plot`: `AU25:0,AU12L:34` per frame, as the Arduino plotter draws it. `cobs`: binary frames (see
//! `serial/cobs.rs`). The style `text`:
//!
//! ```text
//! $AU,<number>,<t_ms>,<state>,<confidence 0…99>,<weights 0…100>*HH      per frame
//! $AUP,<number>,<x>,<y>,<z mm>,<yaw>,<pitch>,<roll, tenths of a degree>*HH   per frame, if wanted
//! $AUH,1,<schema>,<names of the units>*HH                               on opening and every 5 s
//! ```
//! `HH` is the XOR of all bytes between `$` and `*`, two upper-case hexadecimal digits (the rule of NMEA 0183); lines end in
//! CR LF. A line that does not check is to be ignored, so a receiver may join at any time.
//!
//! A line has one face: the first user seen is followed until lost, then whoever comes next. A thread of its own feeds the
//! port, so that a slow or stuck one holds up nothing: one frame waits, the newest; those it replaces are counted. The
//! thread keeps to the baud rate itself, because some ports (USB, pseudo-terminals) take more than the line does. A port
//! that is absent or unplugged is a state: it is tried again after 0.5 s, 1 s, … at most 5 s, for as long as it takes.
//! Memory: four buffers of 2 kB.

mod cobs;
mod line;
mod port;

use std::fmt::Write;
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use super::{
    LossPolicy, OneFace, Output, OutputError, Report, SCHEMA_VERSION, TrackingState, unit_range,
};
use crate::geometry::{Rigid, yaw_pitch_roll};
use line::Line;
pub use port::PortState;
use port::Shared;

/// How long closing may take: to send the neutral line and no longer.
const CLOSING: Duration = Duration::from_millis(500);

/// What is written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Style {
    /// Lines with checksums.
    #[default]
    Text,
    /// Lines for the Arduino plotter.
    Plot,
    /// Binary frames.
    Cobs,
}

/// Which port, and how it is used.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Path of the port, as `/dev/serial/by-id/…`; empty = no serial output.
    pub port: String,
    /// Bits per second.
    pub baud: u32,
    /// What is written.
    pub style: Style,
    /// Whether poses are sent too.
    pub pose: bool,
    /// What is sent of a face that is lost.
    pub loss: LossPolicy,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            port: String::new(),
            baud: 115_200,
            style: Style::default(),
            pose: false,
            loss: LossPolicy::default(),
        }
    }
}

/// A sender of weights, one face at a time.
pub struct Serial {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
    lines: Line,
    count: u16,
    style: Style,
    /// Names of the units, for the style `plot`.
    units: Box<[String]>,
    pose: bool,
    face: OneFace,
    last_ms: u32,
}

impl Serial {
    /// Starts feeding the port. `units` are the names in the order of the weights.
    ///
    /// # Errors
    /// If the names do not fit a line, or no thread can be started. Not if the port is absent.
    pub fn new(settings: &Settings, units: &[&str]) -> Result<Self, OutputError> {
        let mut header = Line::new();
        let bytes = units.iter().map(|name| name.len() + 5).sum::<usize>() + 64;
        let names_fit = match settings.style {
            Style::Text => header.sentence(|line| {
                write!(line, "AUH,1,{SCHEMA_VERSION}")?;
                units.iter().try_for_each(|name| write!(line, ",{name}"))
            }),
            // A plotter would take a header for data.
            Style::Plot => true,
            Style::Cobs => cobs::hello(units, &mut header),
        };
        if !names_fit || bytes > line::LARGEST / 2 {
            return Err(OutputError::Names {
                units: units.len(),
                bytes,
                most: line::LARGEST / 2,
            });
        }
        let shared = Arc::new(Shared::new());
        let thread = port::feed(settings, header, Arc::clone(&shared))?;
        Ok(Self {
            shared,
            thread: Some(thread),
            lines: Line::new(),
            count: 0,
            style: settings.style,
            units: units.iter().map(|&name| name.to_owned()).collect(),
            pose: settings.pose,
            face: OneFace::new(units.len(), settings.loss),
            last_ms: 0,
        })
    }

    /// Whether the port is there.
    #[must_use]
    pub fn state(&self) -> PortState {
        self.shared.state()
    }

    /// Frames that were replaced by a newer one before the port could take them.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.shared.dropped()
    }

    /// Hands the frame to the thread.
    fn put(&mut self, state: TrackingState, report: &Report) {
        self.lines.clear();
        let confidence = if state.is_present() {
            unit_range(report.confidence)
        } else {
            0.0
        };
        let (count, ms) = (self.count, self.last_ms);
        let mut weights = self.face.weights.shown();
        let pose = report
            .sensor_from_head
            .filter(|_| self.pose && state.is_present());
        // The names fit half a buffer; so do the weights and a pose the whole.
        let line = &mut self.lines;
        match self.style {
            Style::Text => {
                line.sentence(|line| {
                    write!(
                        line,
                        "AU,{count},{ms},{},{}",
                        state.code(),
                        (confidence * 99.0).round()
                    )?;
                    weights.try_for_each(|weight| write!(line, ",{}", (weight * 100.0).round()))
                });
                if let Some(pose) = pose {
                    line.sentence(|line| write_pose(count, pose, line));
                }
            }
            Style::Plot => {
                line.all_or_nothing(|line| {
                    for (i, (name, weight)) in self.units.iter().zip(weights).enumerate() {
                        let comma = if i > 0 { "," } else { "" };
                        write!(line, "{comma}{name}:{}", (weight * 100.0).round())?;
                    }
                    line.put(b"\r\n")
                });
            }
            Style::Cobs => {
                cobs::weights(count, ms, state, report, confidence, weights, line);
                if let Some(pose) = pose {
                    cobs::pose(count, ms, pose, line);
                }
            }
        }
        self.count = self.count.wrapping_add(1);
        self.shared.put(&self.lines);
    }
}

/// Place in millimetres, angles in tenths of a degree.
fn write_pose(count: u16, sensor_from_head: &Rigid, line: &mut Line) -> std::fmt::Result {
    let place = sensor_from_head.translation.vector * 1000.0;
    let (yaw, pitch, roll) = yaw_pitch_roll(&sensor_from_head.rotation);
    let angles = [yaw, pitch, roll].map(|angle| 10.0 * angle.to_degrees());
    write!(line, "AUP,{count}")?;
    // A cast of what is not a number gives 0.
    let mut numbers = place.iter().chain(&angles);
    numbers.try_for_each(|number| write!(line, ",{}", number.round() as i32))
}

impl Output for Serial {
    fn send(&mut self, report: &Report) -> Result<(), OutputError> {
        let Some(state) = self.face.follow(report) else {
            return Ok(());
        };
        self.last_ms = (report.at.as_us() / 1000) as u32;
        self.put(state, report);
        Ok(())
    }
}

impl Drop for Serial {
    /// Neutral and absent, as far as the port takes it in half a second.
    fn drop(&mut self) {
        self.face.weights.reset();
        self.put(TrackingState::Absent, &Report::default());
        self.shared.stop();
        let Some(thread) = self.thread.take() else {
            return;
        };
        let start = Instant::now();
        while !thread.is_finished() && start.elapsed() < CLOSING {
            std::thread::sleep(Duration::from_millis(2));
        }
        if thread.is_finished() {
            // A panic of the thread has been reported by itself.
            thread.join().ok();
        }
    }
}
