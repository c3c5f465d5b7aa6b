//! Settings of the serial output: which port, how it is used, and what is written.

use crate::base::defaults;
use crate::base::prelude::*;
use crate::output::View;

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

defaults! {
    /// Which port, and how it is used.
    #[derive(Clone, Debug, PartialEq)]
    pub struct Settings {
        /// Path of the port, as `/dev/serial/by-id/…`, or `tcp:host:port`; empty = no serial output.
        pub port: String = String::new(),
        /// Bits per second.
        pub baud: u32 = 115_200,
        /// What is written.
        pub style: Style = Style::default(),
        /// Value of a weight of 1 in the styles `text` and `plot`: 100 gives percentages. Below 128, tenths are added if the line is
        /// fast enough.
        pub full: u32 = 100,
        /// Whether poses are sent too.
        pub pose: bool = false,
        /// FACS names of the units to send, the most important first; empty = all.
        pub units: Vec<String> = Vec::new(),
        /// Frame rate below which units are left out, Hz.
        pub min_rate_hz: f32 = 10.0,
        /// Whether DTR is raised on opening; otherwise it is left unchanged.
        pub dtr: bool = false,
        /// How faces and units are shown.
        pub view: View = View::default(),
    }
}
