//! Serial line, in one of three styles. `text`: one line of whole numbers per frame that any serial monitor, microcontroller
//! or script reads. `plot`: `AU25:0,AU12L:34` per frame, as the Arduino plotter draws it. `cobs`: binary frames (see
//! `serial/cobs.rs`). The style `text`:
//!
//! ```text
//! $AU,<number>,<t_ms>,<state>,<confidence 0…99>,<weights 0…100>*HH      per frame; `full` instead of 100
//! $AUP,<number>,<x>,<y>,<z mm>,<yaw>,<pitch>,<roll, tenths of a degree>*HH   per frame, if wanted
//! $AUH,1,<schema>,<names of the units>*HH                               on opening and every 5 s
//! ```
//! `HH` is the XOR of all bytes between `$` and `*`, two upper-case hexadecimal digits (the rule of NMEA 0183); lines end in
//! CR LF. A line that does not check is to be ignored, so a receiver may join at any time.
//!
//! What the line cannot carry is planned at the start (see `serial/budget.rs`): the rate is lowered, below `min_rate_hz`
//! units are left out, and the log says so once.
//!
//! A line has one face: the first user seen is followed until lost, then whoever comes next. A thread of its own feeds the
//! port, so that a slow or stuck one holds up nothing: one frame waits, the newest; those it replaces are counted. The
//! thread keeps to the baud rate itself, because some ports (USB, pseudo-terminals) take more than the line does. A port
//! that is absent or unplugged is a state: it is tried again after 0.5 s, 1 s, … at most 5 s, for as long as it takes, under
//! the stable name the system has for it, if it has one. `tcp:host:port` is a port behind a socket, as of a serial server;
//! there the system keeps what a stuck reader has not read, so the newest frame wins only once that is full.
//! Memory: four buffers of 2 kB.

mod budget;
mod cobs;
mod frame;
mod line;
mod port;

use std::fmt::Write;
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use super::{
    LossPolicy, OneFace, Output, OutputError, Report, SCHEMA_VERSION, Tally, TrackingState, View,
    unit_range,
};
use frame::Frame;
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
    /// Path of the port, as `/dev/serial/by-id/…`, or `tcp:host:port`; empty = no serial output.
    pub port: String,
    /// Bits per second.
    pub baud: u32,
    /// What is written.
    pub style: Style,
    /// What a weight of 1 is in the styles `text` and `plot`: 100 are whole percents.
    pub full: u32,
    /// Whether poses are sent too.
    pub pose: bool,
    /// FACS names of the units to send, the most important first; empty = all.
    pub units: Vec<String>,
    /// Frames a second below which units are left out, Hz.
    pub min_rate_hz: f32,
    /// Whether the line DTR is raised on opening; else it stays as the system has it.
    pub dtr: bool,
    /// How the units are shown.
    pub view: View,
    /// What is sent of a face that is lost.
    pub loss: LossPolicy,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            port: String::new(),
            baud: 115_200,
            style: Style::default(),
            full: 100,
            pose: false,
            units: Vec::new(),
            min_rate_hz: 10.0,
            dtr: false,
            view: View::default(),
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
    full: u32,
    style: Style,
    /// Names of the units that are sent, as shown.
    units: Box<[String]>,
    pose: bool,
    view: View,
    face: OneFace,
    last_ms: u32,
}

impl Serial {
    /// Starts feeding the port. `units` are the names in the order of the weights.
    ///
    /// # Errors
    /// If a unit is asked for that there is not, the names do not fit a line, or no thread can be started. Not if the port
    /// is absent.
    pub fn new(settings: &Settings, units: &[&str]) -> Result<Self, OutputError> {
        let view = &settings.view;
        let planned = plan(settings, units)?;
        let names: Box<[String]> = planned
            .iter()
            .map(|&unit| view.name(units[unit]).to_owned())
            .collect();
        let header = header(settings.style, &names)?;
        let channels = view.channels(units);
        let channels = planned.iter().map(|&unit| channels[unit]).collect();
        let shared = Arc::new(Shared::new());
        let thread = port::feed(settings, header, Arc::clone(&shared))?;
        Ok(Self {
            shared,
            thread: Some(thread),
            lines: Line::new(),
            count: 0,
            full: settings.full,
            style: settings.style,
            units: names,
            pose: settings.pose,
            view: view.clone(),
            face: OneFace::of(channels, settings.loss),
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

    /// Names of the units that are sent, as shown.
    #[must_use]
    pub fn units(&self) -> &[String] {
        &self.units
    }

    /// Hands the frame to the thread.
    fn put(&mut self, state: TrackingState, report: &Report) {
        self.lines.clear();
        let confidence = if state.is_present() {
            unit_range(report.confidence)
        } else {
            0.0
        };
        let pose = report
            .sensor_from_head
            .filter(|_| self.pose && state.is_present());
        let frame = Frame {
            count: self.count,
            full: self.full,
            ms: self.last_ms,
            state,
            confidence,
            flags: cobs::flags(state, report),
            pose: pose.map(|pose| self.view.pose(pose)),
        };
        // The names fit half a buffer; so do the weights and a pose the whole.
        let weights = self.face.weights.shown();
        frame.write(self.style, &self.units, weights, &mut self.lines);
        self.count = self.count.wrapping_add(1);
        self.shared.put(&self.lines);
    }
}

/// Bytes of names that leave room in a buffer.
const NAMES_MOST: usize = line::LARGEST / 2;

/// What is sent on opening and every few seconds.
fn header(style: Style, names: &[String]) -> Result<Line, OutputError> {
    let mut header = Line::new();
    let bytes = names.iter().map(|name| name.len() + 5).sum::<usize>() + 64;
    let names_fit = match style {
        Style::Text => header.sentence(|line| {
            write!(line, "AUH,1,{SCHEMA_VERSION}")?;
            names.iter().try_for_each(|name| write!(line, ",{name}"))
        }),
        // A plotter would take a header for data.
        Style::Plot => true,
        Style::Cobs => cobs::hello(names, &mut header),
    };
    if !names_fit || bytes > NAMES_MOST {
        return Err(OutputError::Names {
            units: names.len(),
            bytes,
            most: NAMES_MOST,
        });
    }
    Ok(header)
}

/// Indices of the units that are sent; what the line cannot carry is said once.
fn plan(settings: &Settings, units: &[&str]) -> Result<Vec<usize>, OutputError> {
    let index = |name: &String| {
        let found = units.iter().position(|unit| unit == name);
        found.ok_or_else(|| OutputError::Unit { unit: name.clone() })
    };
    let listed = settings.units.iter().map(index);
    let listed: Vec<usize> = listed.collect::<Result<_, _>>()?;
    let wanted = if listed.is_empty() {
        (0..units.len()).collect()
    } else {
        listed.clone()
    };
    let names = |of: &[usize]| -> Box<[String]> {
        let names = of.iter().map(|&unit| settings.view.name(units[unit]));
        names.map(str::to_owned).collect()
    };
    // Names too long for a line are told before any plan is made.
    let all = names(&wanted);
    header(settings.style, &all)?;
    let bytes = |of: &[usize]| {
        let (names, mut line) = (names(of), Line::new());
        let full = std::iter::repeat_n(1.0, of.len());
        Frame::longest(settings.pose, settings.full).write(settings.style, &names, full, &mut line);
        let header = header(settings.style, &names).map_or(0, |header| header.bytes().len());
        (line.bytes().len(), header)
    };
    let rank = |unit: usize| match listed.iter().position(|&listed| listed == unit) {
        Some(at) => at,
        None => budget::rank(units[unit]),
    };
    let longest = match settings.style {
        Style::Cobs if settings.pose => budget::AVR_RING + cobs::POSE_BYTES,
        Style::Cobs => budget::AVR_RING,
        _ => line::LARGEST,
    };
    let baud = settings.baud;
    let plan = budget::plan(
        baud,
        settings.min_rate_hz,
        longest,
        wanted.clone(),
        rank,
        bytes,
    );
    let dropped: Vec<usize> = wanted
        .into_iter()
        .filter(|unit| !plan.units.contains(unit))
        .collect();
    let port = &settings.port;
    if !dropped.is_empty() {
        tracing::warn!(
            "serial port {port} carries {} of {} units at {baud} bit/s: left out are {}",
            plan.units.len(),
            all.len(),
            names(&dropped).join(" ")
        );
    }
    if plan.rate_hz < budget::FRAMES_HZ {
        tracing::warn!(
            "serial port {port} takes {:.1} frames a second of up to {} bytes at {baud} bit/s, the newest each time; {} come from the sensor",
            plan.rate_hz,
            plan.frame_bytes,
            budget::FRAMES_HZ
        );
    }
    Ok(plan.units)
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

    fn tally(&self) -> Tally {
        Tally {
            sent: self.shared.sent(),
            dropped: self.dropped(),
            connected: self.state() == PortState::Open,
            not_numbers: self.face.weights.not_numbers(),
            ..Tally::of("serial")
        }
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
