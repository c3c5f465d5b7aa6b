//! Settings of the serial output: which port, how it is used, and what is written.

#[cfg(not(feature = "std"))]
use crate::base::prelude::*;
use crate::output::{LossPolicy, View};

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
    /// Value of a weight of 1 in the styles `text` and `plot`: 100 gives percentages. Below 128, tenths are added if the line is
    /// fast enough.
    pub full: u32,
    /// Whether poses are sent too.
    pub pose: bool,
    /// FACS names of the units to send, the most important first; empty = all.
    pub units: Vec<String>,
    /// Frame rate below which units are left out, Hz.
    pub min_rate_hz: f32,
    /// Whether DTR is raised on opening; otherwise it is left unchanged.
    pub dtr: bool,
    /// Names, gains and mirroring of the units.
    pub view: View,
    /// What is sent when a face is lost.
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
