//! Settings of the serial output.

use crate::{View, is_unit};
use mien_stages::base::capacity::UNITS;
use mien_stages::base::prelude::*;
use mien_stages::base::settings::{is_host_port, keyed};

/// Format of the output.
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

keyed! {
    /// Settings of the serial output.
    pub struct Settings {
        /// The port; empty = no serial output.
        port: String = String::new() => Text(
            "the path of a port, like \"/dev/serial/by-id/usb-...\" or \"/dev/ttyUSB0\", tcp:host:port, or empty",
            |port| port.strip_prefix("tcp:").is_none_or(is_host_port)
        ),
        /// Baud rate.
        baud: u32 = 115_200 => number(1200.0, 4_000_000.0, "bit/s"),
        /// Lines with checksums, lines for the Arduino plotter, or binary frames.
        style: Style = Style::default() =>
            choice(&[("text", Style::Text), ("plot", Style::Plot), ("cobs", Style::Cobs)]),
        /// Number sent for a weight of 1 in text lines; 100 gives percentages, in tenths if the line is fast enough; from 128 on, numbers are whole.
        full: u32 = 100 => number(10.0, 10_000.0, ""),
        /// Whether head poses are sent too.
        pose: bool = false => Bool(),
        /// Units to send, most important first; empty = all.
        units: Vec<String> = Vec::new() => Texts("units, like [\"AU26\", \"AU25\"]", is_unit, [0, UNITS]),
        /// Frame rate below which units are omitted on a slow line.
        min_rate_hz: f32 = 10.0 => number(0.0, 30.0, "Hz"),
        /// Whether DTR is raised on opening, which resets many boards; otherwise it is left unchanged.
        dtr: bool = false => Bool(),
        ..view: View,
    }
}
