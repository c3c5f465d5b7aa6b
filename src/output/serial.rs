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
//! What is written is made by an [`Encoder`], which a line without a system around it may use by itself.
//! Memory: four buffers of 2 kB.

mod budget;
mod cobs;
mod frame;
mod line;
#[cfg(feature = "std")]
mod port;
#[cfg(feature = "std")]
mod sender;

use core::fmt::Write;

use super::{
    LossPolicy, OneFace, OutputError, Report, SCHEMA_VERSION, TrackingState, View, unit_range,
};
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;
use frame::Frame;
pub use line::Line;
#[cfg(feature = "std")]
pub use port::PortState;
#[cfg(feature = "std")]
pub use sender::Serial;

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

/// Reports to the bytes of a line, one face at a time.
pub struct Encoder {
    line: Line,
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

impl Encoder {
    /// Plans what the line can carry. `units` are the names in the order of the weights.
    ///
    /// # Errors
    /// If a unit is asked for that there is not, or the names do not fit a line.
    pub fn new(settings: &Settings, units: &[&str]) -> Result<Self, OutputError> {
        Ok(Self::planned(settings, units)?.0)
    }

    /// Also what was planned.
    fn planned(settings: &Settings, units: &[&str]) -> Result<(Self, budget::Plan), OutputError> {
        let view = &settings.view;
        let plan = plan(settings, units)?;
        let names: Box<[String]> = plan
            .units
            .iter()
            .map(|&unit| view.name(units[unit]).to_owned())
            .collect();
        header(settings.style, &names)?;
        let channels = view.channels(units);
        let channels = plan.units.iter().map(|&unit| channels[unit]);
        let encoder = Self {
            line: Line::new(),
            count: 0,
            full: settings.full,
            style: settings.style,
            units: names,
            pose: settings.pose,
            view: view.clone(),
            face: OneFace::of(channels.collect(), settings.loss),
            last_ms: 0,
        };
        Ok((encoder, plan))
    }

    /// Names of the units that are sent, as shown.
    #[must_use]
    pub fn units(&self) -> &[String] {
        &self.units
    }

    /// What is to be sent on opening and every five seconds.
    #[must_use]
    pub fn header(&self) -> Line {
        header(self.style, &self.units).expect("the same names fitted before")
    }

    /// The next frame; `None` if the report is of a face that is not shown.
    pub fn encode(&mut self, report: &Report) -> Option<&Line> {
        let state = self.face.follow(report)?;
        self.last_ms = (report.at.as_us() / 1000) as u32;
        Some(self.frame(state, report))
    }

    /// A frame that leaves the receiver with nobody, for the end.
    pub fn neutral(&mut self) -> &Line {
        self.face.weights.reset();
        self.frame(TrackingState::Absent, &Report::default())
    }

    fn frame(&mut self, state: TrackingState, report: &Report) -> &Line {
        self.line.clear();
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
        frame.write(self.style, &self.units, weights, &mut self.line);
        self.count = self.count.wrapping_add(1);
        &self.line
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

/// Chooses the units that are sent.
fn plan(settings: &Settings, units: &[&str]) -> Result<budget::Plan, OutputError> {
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
    header(settings.style, &names(&wanted))?;
    let bytes = |of: &[usize]| {
        let (names, mut line) = (names(of), Line::new());
        let full = core::iter::repeat_n(1.0, of.len());
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
    Ok(budget::plan(
        settings.baud,
        settings.min_rate_hz,
        longest,
        wanted,
        rank,
        bytes,
    ))
}
