//! OSC preset `vrchat`: avatar parameters of VRChat, with the names of Unified Expressions v2.
//!
//! Addresses are `/avatar/parameters/<prefix>v2/<Name>`; the avatar's author chooses the prefix, `FT/` is common. Only measured
//! parameters are sent, and only when they change; all of them once a second, for avatars loaded in the meantime. Parameters that
//! avatar templates read are sent at once; the others take turns in the space left in a frame's last datagram, so that they need
//! no datagram of their own. `EyeTrackingActive`, `ExpressionTrackingActive` and `LipTrackingActive` say whether there is a face.
//! One face: the first seen, until lost.
//!
//! An avatar has few bits for parameters, so authors use binary switches: a value v with n bits is the integer |v| × (2ⁿ − 1),
//! truncated, whose bits are `<Name>1`, `<Name>2`, `<Name>4`, …; `<Name>Negative` is the sign of parameters that have one.

use core::fmt;

use super::packet::Argument;
use super::parameters::Parameter;
use super::wire::{self, Targets, Wire};
use crate::{Every, OneFace, Output, OutputError, Report, Tally, View};
use mien_stages::base::prelude::*;
use mien_stages::base::settings::keyed;
use mien_stages::base::time::Timestamp;

/// Smaller changes are not sent: half a step of the receiver's 8 bits.
const LEAST_CHANGE: f32 = 1.0 / 512.0;
/// Interval at which all parameters are sent, seconds.
const REFRESH_S: f64 = 1.0;
/// Parameters that say whether there is a face.
const SWITCHES: [&str; 3] = [
    "EyeTrackingActive",
    "ExpressionTrackingActive",
    "LipTrackingActive",
];

/// Most binary switches per parameter, besides its sign.
pub const MOST_BITS: u32 = 8;

/// How values are sent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Values {
    /// As numbers.
    #[default]
    Float,
    /// As binary switches, one per bit.
    Binary,
    /// Both ways.
    Both,
}

keyed! {
    /// Settings of the VRChat output.
    pub struct Settings {
        /// Whether this output is enabled.
        enabled: bool = false => Bool(),
        /// Destinations: hosts, broadcast addresses or multicast groups.
        targets "target": Vec<String> = vec!["127.0.0.1:9000".to_owned()] => targets(),
        /// Prefix that the avatar's author put before the parameter names.
        prefix: String = "FT/".to_owned() =>
            Text("empty or ending in a slash", |prefix| prefix.is_empty() || prefix.ends_with('/')),
        /// Parameters as floats, as binary switches, or both.
        values: Values = Values::default() =>
            choice(&[("float", Values::Float), ("binary", Values::Binary), ("both", Values::Both)]),
        /// Binary switches per parameter, besides its sign.
        bits: u32 = 4 => number(1.0, MOST_BITS as f32, ""),
        ..view: View,
    }
}

/// A sender of avatar parameters.
pub struct VrChat {
    wire: Wire,
    face: OneFace,
    values: Values,
    bits: u32,
    parameters: Box<[Sent]>,
    /// Parameters sent where there is room.
    others: Box<[Sent]>,
    /// Index of the next of the others.
    next_other: usize,
    active: bool,
    refresh: Every,
}

/// A parameter and its last value sent.
struct Sent {
    parameter: Parameter,
    value: f32,
    /// Bits last sent, with the sign above them.
    switches: u32,
    /// Whether the value can be negative.
    signed: bool,
    /// Whether to send it even without a change.
    stale: bool,
}

impl VrChat {
    /// Opens the sockets. `units` are the names in the order of the weights.
    ///
    /// # Errors
    /// If the settings are unusable or no socket can be opened.
    #[cfg(feature = "std")]
    pub fn new(settings: Settings, units: &[&str]) -> Result<Self, OutputError> {
        Self::with_targets(super::udp::open(&settings.targets)?, settings, units)
    }

    /// As [`Self::new`], but with these targets instead of the configured ones.
    ///
    /// # Errors
    /// If the prefix is unusable.
    pub fn with_targets(
        targets: Targets,
        settings: Settings,
        units: &[&str],
    ) -> Result<Self, OutputError> {
        let prefix = format!("/avatar/parameters/{}v2", settings.prefix);
        let load = |rig| {
            let parameters = Parameter::for_rig(rig, units).into_iter();
            parameters.map(Sent::new).collect()
        };
        Ok(Self {
            wire: Wire::new(targets, wire::checked_prefix(prefix)?),
            face: OneFace::new(units, &settings.view),
            values: settings.values,
            bits: settings.bits.clamp(1, MOST_BITS),
            parameters: load("unified"),
            others: load("unified_more"),
            next_other: 0,
            active: false,
            refresh: Every::default(),
        })
    }

    fn send_frame(&mut self, at: Timestamp, active: bool) {
        let all = self.refresh.due(at, REFRESH_S);
        let switched = all || active != self.active;
        self.active = active;
        for name in SWITCHES.into_iter().filter(|_| switched) {
            let wire = &mut self.wire;
            wire.message(format_args!("/{name}"), [Argument::Bool(active)]);
        }
        self.send_parameters(all);
        self.send_others(all, false);
        self.wire.flush();
    }

    /// Sends the main parameters that have changed, or all.
    fn send_parameters(&mut self, all: bool) {
        let (wire, weights) = (&mut self.wire, &self.face.weights);
        for sent in &mut self.parameters {
            sent.stale |= all;
            let value = sent.parameter.value(weights.shown());
            sent.send(value, self.values, self.bits, &mut |address, argument| {
                wire.message(address, [argument]);
                true
            });
        }
    }

    /// Sends the others that have changed, or all, from `next_other` on until the datagram is full; `at_the_end` regardless of room.
    fn send_others(&mut self, all: bool, at_the_end: bool) {
        let (wire, weights) = (&mut self.wire, &self.face.weights);
        let mut put = |address: fmt::Arguments, argument| {
            if at_the_end {
                wire.message(address, [argument]);
            }
            at_the_end || wire.message_if_room(address, argument)
        };
        let (first, count) = (self.next_other, self.others.len());
        for sent in &mut self.others {
            sent.stale |= all;
        }
        for at in (first..first + count).map(|at| at % count) {
            let sent = &mut self.others[at];
            let value = sent.parameter.value(weights.shown());
            if !sent.send(value, self.values, self.bits, &mut put) {
                self.next_other = at;
                return;
            }
        }
    }
}

/// Appends a message; returns whether there was room.
type Put<'a> = dyn FnMut(fmt::Arguments<'_>, Argument<'static>) -> bool + 'a;

impl Sent {
    /// A parameter not sent so far.
    fn new(parameter: Parameter) -> Self {
        Self {
            signed: parameter.can_be_negative(),
            parameter,
            value: f32::NAN,
            switches: 0,
            stale: true,
        }
    }

    /// Sends the value if it has changed or is stale; returns whether there was room.
    fn send(&mut self, value: f32, values: Values, bits: u32, put: &mut Put) -> bool {
        let whole = (values == Values::Binary || self.send_number(value, put))
            && (values == Values::Float || self.send_switches(value, bits, put));
        self.stale &= !whole;
        whole
    }

    fn send_number(&mut self, value: f32, put: &mut Put) -> bool {
        // Rest and the limits are sent exactly, so that an eye closes completely.
        let changed = (value - self.value).abs() >= LEAST_CHANGE
            || (value != self.value && [-1.0, 0.0, 1.0].contains(&value));
        if !self.stale && !changed {
            return true;
        }
        let name = &self.parameter.name;
        let taken = put(format_args!("/{name}"), Argument::Float(value));
        if taken {
            self.value = value;
        }
        taken
    }

    fn send_switches(&mut self, value: f32, bits: u32, put: &mut Put) -> bool {
        // Without a sign switch, negative values become 0.
        let least = if self.signed { -1.0 } else { 0.0 };
        let size = value.max(least).abs();
        let most = (1 << bits) - 1;
        let whole = (size * most as f32) as u32;
        let negative = u32::from(value < 0.0 && whole > 0);
        let switches = whole | negative << bits;
        let differing = switches ^ self.switches;
        let changed = if self.stale { !0 } else { differing };
        let name = &self.parameter.name;
        for bit in (0..bits + u32::from(self.signed)).filter(|bit| changed >> bit & 1 == 1) {
            let on = Argument::Bool(switches >> bit & 1 == 1);
            let taken = match bit < bits {
                true => put(format_args!("/{name}{}", 1 << bit), on),
                false => put(format_args!("/{name}Negative"), on),
            };
            if !taken {
                return false;
            }
            self.switches = self.switches & !(1 << bit) | switches & 1 << bit;
        }
        true
    }
}

impl Output for VrChat {
    fn send(&mut self, report: &Report) -> Result<(), OutputError> {
        if let Some(state) = self.face.follow(report) {
            self.send_frame(report.at, state.has_face());
        }
        Ok(())
    }

    fn tally(&self) -> Tally {
        self.wire.to.tally("vrchat", self.face.weights.not_numbers)
    }
}

impl Drop for VrChat {
    /// Sends a neutral face and that there is none.
    fn drop(&mut self) {
        if self.wire.to.is_used() {
            self.face.weights.reset();
            self.refresh = Every::default();
            self.send_frame(Timestamp::default(), false);
            self.send_others(false, true);
            self.wire.flush();
        }
    }
}
