//! Serial line, style `text`: one line of whole numbers per frame that any serial monitor, microcontroller or script reads.
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
//! Memory: four lines of 1 kB.

mod line;
mod port;

use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use super::{
    LossPolicy, Output, OutputError, Report, SCHEMA_VERSION, TrackingState, WireWeights, unit_range,
};
use crate::geometry::yaw_pitch_roll;
use line::Line;
pub use port::PortState;
use port::Shared;

/// How long closing may take: to send the neutral line and no longer.
const CLOSING: Duration = Duration::from_millis(500);

/// Which port, and how it is used.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Path of the port, as `/dev/serial/by-id/…`; empty = no serial output.
    pub port: String,
    /// Bits per second.
    pub baud: u32,
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
            pose: false,
            loss: LossPolicy::default(),
        }
    }
}

/// A sender of text lines.
pub struct SerialText {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
    lines: Line,
    count: u16,
    pose: bool,
    weights: WireWeights,
    /// The user whose face is on the line, and whether it is there at present.
    user: Option<usize>,
    present: bool,
    last_ms: u32,
}

impl SerialText {
    /// Starts feeding the port. `units` are the names in the order of the weights.
    ///
    /// # Errors
    /// If the names do not fit a line, or no thread can be started. Not if the port is absent.
    pub fn new(settings: &Settings, units: &[&str]) -> Result<Self, OutputError> {
        let mut header = Line::new();
        let bytes = units
            .iter()
            .map(|name| name.len().max(3) + 1)
            .sum::<usize>()
            + 64;
        let names_fit = header.sentence(|line| {
            use std::fmt::Write;
            write!(line, "AUH,1,{SCHEMA_VERSION}")?;
            units.iter().try_for_each(|name| write!(line, ",{name}"))
        });
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
            pose: settings.pose,
            weights: WireWeights::new(units.len(), settings.loss),
            user: None,
            present: false,
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
        use std::fmt::Write;
        self.lines.clear();
        let confidence = if state.is_present() {
            unit_range(report.confidence)
        } else {
            0.0
        };
        let (count, ms, weights) = (self.count, self.last_ms, &self.weights);
        // The names fit half a line; so do the weights and a pose the whole.
        self.lines.sentence(|line| {
            write!(
                line,
                "AU,{count},{ms},{},{}",
                state.code(),
                (confidence * 99.0).round()
            )?;
            weights
                .shown()
                .try_for_each(|weight| write!(line, ",{}", (weight * 100.0).round()))
        });
        if let Some(pose) = report
            .sensor_from_head
            .filter(|_| self.pose && state.is_present())
        {
            let place = pose.translation.vector * 1000.0;
            let (yaw, pitch, roll) = yaw_pitch_roll(&pose.rotation);
            let angles = [yaw, pitch, roll].map(|angle| 10.0 * angle.to_degrees());
            self.lines.sentence(|line| {
                write!(line, "AUP,{count}")?;
                let mut numbers = place.iter().chain(&angles);
                // A cast of what is not a number gives 0.
                numbers.try_for_each(|number| write!(line, ",{}", number.round() as i32))
            });
        }
        self.count = self.count.wrapping_add(1);
        self.shared.put(&self.lines);
    }
}

impl Output for SerialText {
    fn send(&mut self, report: &Report) -> Result<(), OutputError> {
        let followed = report.user.is_some() && report.user == self.user;
        if report.user.is_some() && !followed {
            if self.present || !report.state.is_present() {
                return Ok(());
            }
            // The next face: nothing of the one before may fade into it.
            self.user = report.user;
            self.weights.reset();
        }
        self.present = report.state.is_present() && report.user.is_some();
        self.last_ms = (report.at.as_us() / 1000) as u32;
        self.weights.observe(report);
        let state = if report.user.is_some() {
            report.state
        } else {
            TrackingState::Absent
        };
        self.put(state, report);
        Ok(())
    }
}

impl Drop for SerialText {
    /// Neutral and absent, as far as the port takes it in half a second.
    fn drop(&mut self) {
        self.weights.reset();
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
