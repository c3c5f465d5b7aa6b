//! Outputs: CSV, OSC, serial and others. Each takes a [`Report`] per frame and user and is independent of the others.
//!
//! Except in CSV, weights are 0…1 and never NaN. When a face is lost, or only its head is still tracked by depth, its last weights
//! are held briefly and then fade to neutral ([`LossPolicy`]). Dropping an output sends neutral and absent. Nothing allocates per
//! report. No output blocks the pipeline: data that cannot be sent at once is dropped and counted.

#![cfg_attr(not(feature = "std"), no_std)]

extern crate alloc;

pub mod command;
pub mod csv;
mod every;
mod face;
#[cfg(feature = "std")]
pub mod features;
pub mod gesture;
#[cfg(feature = "wires")]
mod identity;
#[cfg(feature = "wires")]
mod key_codes;
#[cfg(feature = "wires")]
pub mod keys;
#[cfg(feature = "std")]
pub mod limits;
#[cfg(feature = "wires")]
pub mod live_link;
#[cfg(feature = "wires")]
pub mod mailbox;
#[cfg(feature = "wires")]
pub mod mqtt;
pub mod osc;
#[cfg(feature = "studio")]
pub mod received;
mod report;
pub mod serial;
#[cfg(feature = "std")]
pub mod table;
mod view;
#[cfg(any(feature = "studio", feature = "wires"))]
pub mod web;

pub use command::Command;
use every::Every;
use face::{OneFace, WireWeights};
use mien_stages::base::defaults;
use mien_stages::base::prelude::*;
pub use mien_stages::users::TrackingState;
pub use report::finite;
use report::unit_range;
pub use report::{Report, SCHEMA_VERSION};
pub use view::all_units;
pub(crate) use view::is_unit;
pub use view::{LossPolicy, UnitView, View, is_name, numbers};

defaults! {
    /// Counters of an output.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub struct Tally {
        /// Section of the configuration.
        pub name: &'static str = "",
        /// Datagrams, frames or rows sent, over all targets.
        pub sent: u64 = 0,
        /// Datagrams, frames or rows dropped: not accepted at once, replaced by a newer one, or without a known destination.
        pub dropped: u64 = 0,
        /// Whether there is a destination: false while a serial port is absent, and after the table of a live run could not be written.
        pub connected: bool = true,
        /// Weights that were NaN and were sent as 0.
        pub not_numbers: u64 = 0,
        /// Commands accepted, and commands refused as malformed or too frequent.
        pub commands: [u64; 2] = [0; 2],
    }
}

impl Tally {
    /// Adds the counters; name and `connected` are taken from `later`.
    #[cfg(feature = "std")]
    pub fn plus(self, later: Self) -> Self {
        let [a, b] = [self.commands, later.commands];
        Self {
            sent: self.sent + later.sent,
            dropped: self.dropped + later.dropped,
            not_numbers: self.not_numbers + later.not_numbers,
            commands: [a[0] + b[0], a[1] + b[1]],
            ..later
        }
    }

    /// Counters at zero.
    fn empty(name: &'static str) -> Self {
        Self {
            name,
            ..Self::default()
        }
    }
}

/// A destination of reports.
pub trait Output {
    /// Sends one report.
    ///
    /// # Errors
    /// Only if the output cannot recover, such as a file on a full disk. An absent receiver or port is a state, not an
    /// error.
    fn send(&mut self, report: &Report) -> Result<(), OutputError>;

    /// Reports that nobody is there while the sensor gives no frames. By default it is sent like the report of a frame.
    ///
    /// # Errors
    /// As [`Self::send`].
    fn send_absence(&mut self, nobody: &Report) -> Result<(), OutputError> {
        self.send(nobody)
    }

    /// Reports a gesture that went on or off, or repeats its state; ignored by default.
    fn switch(&mut self, _: &gesture::Switch<'_>) {}

    /// Reports levels and set-up of a gesture when they change, and repeats them; ignored by default.
    fn set_up(&mut self, _: &gesture::SetUp<'_>) {}

    /// The counters so far.
    fn tally(&self) -> Tally;

    /// The next command received; none by default.
    fn next_command(&mut self) -> Option<Command> {
        None
    }
}

/// Why an output cannot be created or used.
#[derive(Debug, thiserror::Error)]
pub enum OutputError {
    /// The CSV cannot be written.
    #[cfg(feature = "std")]
    #[error("cannot write the CSV: {0}; check the path and the free space")]
    Csv(std::io::Error),
    /// A UDP socket cannot be opened.
    #[cfg(feature = "std")]
    #[error("cannot open a UDP socket to send OSC: {0}; is the network configured?")]
    Socket(std::io::Error),
    /// The command port cannot be opened.
    #[error(
        "cannot listen for OSC commands at {0:?}; expected address:port of this machine, like 127.0.0.1:9131"
    )]
    Listen(String),
    /// The target is not a `host:port`.
    #[error("OSC target is {0:?}, expected host:port like 127.0.0.1:9130")]
    Target(String),
    /// The OSC prefix does not start with a slash or has pattern characters.
    #[error(
        "OSC prefix is {0:?}, expected printable ASCII like /face, at most 64 characters, without space # * , ? [ ] {{ }}"
    )]
    Prefix(String),
    /// The unit names do not fit one datagram or line: number of units, bytes needed, bytes available.
    #[error("the names of {0} units take {1} bytes, expected at most {2}; shorten some in [units]")]
    Names(usize, usize, usize),
    /// An unknown unit is requested.
    #[error(
        "serial.units names {0:?}, which is not measured with these settings; remove it from the list"
    )]
    Unit(String),
    /// The password file cannot be read or has no password.
    #[cfg(feature = "std")]
    #[error(
        "cannot use password_file {0:?}: {1}; expected the password in its first line, readable by mien's user"
    )]
    Password(String, std::io::Error),
    /// The certificate file cannot be read.
    #[cfg(feature = "std")]
    #[error("cannot read mqtt.ca_file {0:?}: {1}; expected the CA certificates in PEM")]
    Certificates(String, std::io::Error),
    /// The enabled section is not part of this build.
    #[error(
        "[{0}] is enabled, but this mien was built without it; build with --features wires, or install the package"
    )]
    NotBuilt(&'static str),
    /// A gesture's key does not exist on a keyboard over USB.
    #[cfg(feature = "wires")]
    #[error(
        "a keyboard over USB has no key {0:?}; choose another, or remove device from [keys] to press keys of this computer"
    )]
    NotOverUsb(String),
    /// The device that presses keys cannot be used.
    #[cfg(feature = "wires")]
    #[error(
        "cannot press keys through {0:?}: {1}; is the module uinput loaded, and may mien's user write to it?"
    )]
    Keys(String, std::io::Error),
    /// A thread cannot be started.
    #[cfg(feature = "std")]
    #[error("cannot start a thread for an output: {0}; is there a limit on memory or tasks?")]
    Thread(std::io::Error),
}

impl OutputError {
    /// The configuration key at fault; empty for the section as a whole.
    #[cfg(feature = "std")]
    pub fn key(&self) -> &'static str {
        match self {
            Self::Listen(_) => "listen",
            Self::Target(_) => "target",
            Self::Prefix(_) => "prefix",
            Self::Unit(_) => "units",
            Self::Password(..) => "password_file",
            Self::Certificates(..) => "ca_file",
            Self::NotBuilt(_) => "enabled",
            _ => "",
        }
    }
}
