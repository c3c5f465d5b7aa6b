//! OSC over UDP, schema `native`: presence, pose and weights of each user.
//!
//! | address | arguments | when |
//! | --- | --- | --- |
//! | `/face/<u>/frame` | number, time ms, state (0 absent, 1 warming, 2 tracking, 3 held, 4 lost, 5 posed), confidence, latency ms | every report, first of its datagram |
//! | `/face/<u>/au` | all weights in schema order | every report (styles vector, both) |
//! | `/face/<u>/au/<unit>` | one weight | every report (styles scalar, both) |
//! | `/face/<u>/pose` | x y z in metres, sensor frame, quaternion x y z w | every report with a pose |
//! | `/face/<u>/present` | 0 or 1 | on change and once a second |
//! | `/face/<u>/frozen` | 0 or 1: learning is frozen | the same |
//! | `/face/<u>/seen/<region>` | how far a region of the face can be seen, 0…1 in hundredths | the same, while there is a face |
//! | `/face/schema` | version, names of the units | at the start and every 5 s |
//! | `/face/alive` | number, program version, capture time in seconds | every second, even with nobody |
//! | `/mien/gesture/<name>`, per person `/mien/gesture/<name>/<u>` | 1 or 0 | on change and every 2 s, a datagram each |
//! | `/mien/setup/<name>` | index, state, repetitions, `on`, `off`, `hold_s`, `rise_s`, can be undone, activations, seconds with a face | the same, with `levels` |
//! | `/face/<u>/range/<unit>` | low, rest, high of the range from which its weight is computed; readiness 0…1 | every 5 s with a face, if enabled |
//!
//! The latency is the time from the frame's arrival in this machine to its being sent. Units have the names set in the
//! configuration. Receivers may send commands if the configuration allows it ([`commands`]).
//!
//! Datagrams are bundles of at most 1472 bytes with the time tag "immediately"; a message is never split. Presets for programs
//! with their own OSC schema: [`vmc`], [`vrchat`], [`faceosc`].

pub mod commands;
pub mod faceosc;
#[cfg(feature = "std")]
mod listener;
pub mod packet;
pub mod parameters;
#[cfg(feature = "studio")]
pub mod receiver;
#[cfg(feature = "std")]
pub(super) mod udp;
pub mod vmc;
pub mod vrchat;
mod wire;

#[cfg(feature = "std")]
use super::Command;
use super::gesture::{self, SetUp, Switch};
use super::{
    Every, Output, OutputError, Report, SCHEMA_VERSION, Tally, TrackingState, View, WireWeights,
    finite, unit_range,
};
#[cfg(feature = "std")]
use commands::Request;
#[cfg(feature = "std")]
use listener::Listener;
use mien_stages::base::capacity::{REGIONS, USERS};
use mien_stages::base::prelude::*;
use mien_stages::base::settings::keyed;
use mien_stages::base::time::Timestamp;
use mien_stages::face_model::scheme::VISIBLE_REGIONS;
use packet::Argument;
#[cfg(feature = "wires")]
pub(super) use wire::Sender;
use wire::Wire;
pub use wire::{Datagrams, Targets, is_prefix};

/// Words of the addresses: of the box, of a user, of a gesture.
const SCHEMA: &str = "schema";
const ALIVE: &str = "alive";
const FRAME: &str = "frame";
const AU: &str = "au";
const POSE: &str = "pose";
const PRESENT: &str = "present";
const FROZEN: &str = "frozen";
const SEEN: &str = "seen";
const RANGE: &str = "range";
const MIEN: &str = "mien";
const GESTURE: &str = "gesture";
const SET_UP: &str = "setup";

/// Interval at which the unit names are repeated for receivers that join later, seconds.
const SCHEMA_PERIOD_S: f64 = 5.0;
/// Interval between range messages, seconds.
const RANGES_PERIOD_S: f64 = 5.0;
/// Interval between presence and heartbeat messages, seconds.
const ALIVE_PERIOD_S: f64 = 1.0;

/// How weights are sent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Style {
    /// All in one message, in schema order.
    Vector,
    /// Each under its own address, as patching programs prefer.
    Scalar,
    /// Both ways.
    #[default]
    Both,
}

keyed! {
    /// Settings of the OSC output.
    pub struct Settings {
        /// Whether this output is enabled.
        enabled: bool = true => Bool(),
        /// Destinations: hosts, broadcast addresses or multicast groups.
        targets "target": Vec<String> = vec!["127.0.0.1:9130".to_owned()] => targets(),
        /// Prefix of every address.
        prefix: String = "/face".to_owned() =>
            Text("a slash and a name of at most 63 characters, without spaces or # * , ? [ ] { }", is_prefix),
        /// All weights in one message, each under its own address, or both.
        style: Style = Style::default() =>
            choice(&[("vector", Style::Vector), ("scalar", Style::Scalar), ("both", Style::Both)]),
        /// Whether learned ranges are sent, every 5 s.
        ranges: bool = false => Bool(),
        /// Whether the commands /face/cmd/forget, freeze, neutral and schema are accepted.
        commands: bool = true => Bool(),
        /// Whether gestures can be set up by the commands /face/cmd/level, hold, teach and undo; their levels are then sent too.
        levels: bool = false => Bool(),
        /// Address on which these commands are received; 127.0.0.1 accepts this machine only, 0.0.0.0 its networks and the targets named by address.
        listen: String = "127.0.0.1:9131".to_owned() => listen(),
        ..view: View,
    }
}

/// An OSC sender.
pub struct Osc {
    wire: Wire,
    style: Style,
    ranges: bool,
    levels: bool,
    /// Output names of the units.
    units: Box<[String]>,
    view: View,
    users: [User; USERS],
    schema: Every,
    alive: Every,
    alive_count: i32,
    /// Time of the last report.
    at: Timestamp,
    #[cfg(feature = "std")]
    commands: Option<Listener>,
}

/// State of one user as sent.
#[derive(Default)]
struct User {
    count: i32,
    /// Whether any report has named this user.
    known: bool,
    present: bool,
    frozen: bool,
    /// How far each region can be seen, hundredths; `None` without a face.
    seen: Option<[u8; REGIONS]>,
    presence: Every,
    range: Every,
    weights: WireWeights,
}

impl Osc {
    /// Opens the sockets. `units` are the names in the order of the weights.
    ///
    /// # Errors
    /// If the settings are unusable or no socket can be opened.
    #[cfg(feature = "std")]
    pub fn new(settings: Settings, units: &[&str]) -> Result<Self, OutputError> {
        let (targets, levels) = (&settings.targets, settings.levels);
        let open = || Listener::open(&settings.listen, &settings.prefix, targets, levels);
        let commands = settings.commands.then(open).transpose()?;
        let mut osc = Self::with_targets(udp::open(targets)?, settings, units)?;
        osc.commands = commands;
        Ok(osc)
    }

    /// As [`Self::new`], but with these targets instead of the configured ones and without a command port; the caller parses
    /// received datagrams with [`commands::requests`].
    ///
    /// # Errors
    /// If the prefix is unusable or the names do not fit a datagram.
    pub fn with_targets(
        targets: Targets,
        settings: Settings,
        units: &[&str],
    ) -> Result<Self, OutputError> {
        let Settings { prefix, view, .. } = settings;
        let names = view.names(units.iter().copied());
        // Address, tags, version and names, each padded, plus the bundle's header.
        let bytes = names.iter().map(|name| name.len() + 5).sum::<usize>() + prefix.len() + 40;
        if bytes > packet::LARGEST {
            return Err(OutputError::Names(units.len(), bytes, packet::LARGEST));
        }
        if prefix.is_empty() {
            return Err(OutputError::Prefix(prefix));
        }
        Ok(Self {
            wire: Wire::new(targets, wire::checked_prefix(prefix)?),
            style: settings.style,
            ranges: settings.ranges,
            levels: settings.levels,
            units: names,
            users: core::array::from_fn(|_| User {
                weights: WireWeights::new(view.channels(units), view.loss),
                ..User::default()
            }),
            view,
            schema: Every::default(),
            alive: Every::default(),
            alive_count: 0,
            at: Timestamp::default(),
            #[cfg(feature = "std")]
            commands: None,
        })
    }

    /// Appends all messages about one user, starting in the current datagram.
    fn send_user(&mut self, slot: usize, report: &Report, state: TrackingState) {
        let (wire, user) = (&mut self.wire, &mut self.users[slot]);
        let (present, confidence) = (state.is_present(), unit_range(report.confidence));
        let head = [
            Argument::Int(user.count),
            // Wraps to 0 every 24.8 days.
            Argument::Int(((report.at.as_us() / 1000) & 0x7fff_ffff) as i32),
            Argument::Int(state.code().into()),
            Argument::Float(if present { confidence } else { 0.0 }),
            Argument::Float(report.latency_us as f32 * 1e-3),
        ];
        user.count = next(user.count);
        wire.message(format_args!("/{slot}/{FRAME}"), head);
        let (vector, scalar) = (self.style != Style::Scalar, self.style != Style::Vector);
        if user.known && vector {
            let weights = user.weights.shown().map(Argument::Float);
            wire.message(format_args!("/{slot}/{AU}"), weights);
        }
        if user.known && scalar {
            for (name, weight) in self.units.iter().zip(user.weights.shown()) {
                wire.message(
                    format_args!("/{slot}/{AU}/{name}"),
                    [Argument::Float(weight)],
                );
            }
        }
        if let Some(pose) = self.view.pose_numbers(report) {
            wire.message(format_args!("/{slot}/{POSE}"), pose.map(Argument::Float));
        }
        let changed = (user.present, user.frozen) != (present, report.frozen);
        (user.present, user.frozen) = (present, report.frozen);
        // `due` is called even on a change, which restarts the interval.
        let is_due = user.presence.due(report.at, ALIVE_PERIOD_S) || changed;
        if is_due {
            for (what, is) in [(PRESENT, present), (FROZEN, report.frozen)] {
                let argument = Argument::Int(is.into());
                wire.message(format_args!("/{slot}/{what}"), [argument]);
            }
        }
        let seen = self.view.seen(report);
        let seen = seen.map(|seen| seen.map(|share| (share * 100.0).round() as u8));
        let sent = core::mem::replace(&mut user.seen, seen);
        for (k, share) in seen.iter().flatten().enumerate() {
            if is_due || sent.is_none_or(|sent| sent[k] != *share) {
                let address = format_args!("/{slot}/{SEEN}/{}", VISIBLE_REGIONS[k].0);
                wire.message(address, [Argument::Float(f32::from(*share) / 100.0)]);
            }
        }
        // Ranges are those of the unit itself, neither mirrored nor scaled.
        let wanted = self.ranges && present && !report.ranges.is_empty();
        if wanted && user.range.due(report.at, RANGES_PERIOD_S) {
            for (name, range) in self.units.iter().zip(report.ranges) {
                let numbers = [range.low, range.rest, range.high, range.readiness];
                let numbers = numbers.map(finite);
                let address = format_args!("/{slot}/{RANGE}/{name}");
                wire.message(address, numbers.map(Argument::Float));
            }
        }
    }

    /// Appends the schema message.
    fn write_schema(&mut self) {
        let names = self.units.iter().map(|name| Argument::Text(name));
        let arguments = core::iter::once(Argument::Int(SCHEMA_VERSION)).chain(names);
        self.wire.message(format_args!("/{SCHEMA}"), arguments);
    }

    fn send_alive(&mut self, report: &Report) {
        let arguments = [
            Argument::Int(self.alive_count),
            Argument::Text(env!("CARGO_PKG_VERSION")),
            Argument::Float(report.at.as_us() as f32 * 1e-6),
        ];
        self.alive_count = next(self.alive_count);
        self.wire.message(format_args!("/{ALIVE}"), arguments);
        self.wire.flush();
    }
}

impl Output for Osc {
    fn send(&mut self, report: &Report) -> Result<(), OutputError> {
        self.at = report.at;
        if self.schema.due(report.at, SCHEMA_PERIOD_S) {
            self.write_schema();
            self.wire.flush();
        }
        if self.alive.due(report.at, ALIVE_PERIOD_S) {
            self.send_alive(report);
        }
        match report.user {
            Some(slot) if slot < USERS => {
                let user = &mut self.users[slot];
                user.known = true;
                user.weights.observe(report);
                self.send_user(slot, report, report.state);
            }
            _ => {
                // Nobody: former users fade out. Slot 0 keeps counting, so that receivers can tell an empty scene from loss.
                for slot in 0..USERS {
                    let user = &mut self.users[slot];
                    let fading = user.present || !user.weights.is_neutral();
                    user.weights.observe(report);
                    if fading || slot == 0 {
                        self.send_user(slot, report, TrackingState::Absent);
                    }
                }
            }
        }
        self.wire.flush();
        Ok(())
    }

    fn tally(&self) -> Tally {
        let weights = self.users.iter().map(|user| &user.weights);
        let not_numbers = weights.map(|weights| weights.not_numbers).sum();
        Tally {
            #[cfg(feature = "std")]
            commands: self.commands.as_ref().map_or([0; 2], Listener::counts),
            ..self.wire.to.tally("osc", not_numbers)
        }
    }

    fn switch(&mut self, switch: &Switch<'_>) {
        if gesture::ENABLED {
            let address = format_args!("/{MIEN}/{GESTURE}/{switch}");
            let is_on = Argument::Int(switch.is_on.into());
            self.wire.send_alone(address, &[is_on]);
        }
    }

    fn set_up(&mut self, set_up: &SetUp<'_>) {
        if gesture::ENABLED && self.levels {
            let address = format_args!("/{MIEN}/{SET_UP}/{}", set_up.name);
            self.wire.send_alone(address, &set_up.facts.to_osc());
        }
    }

    #[cfg(feature = "std")]
    fn next_command(&mut self) -> Option<Command> {
        loop {
            match self.commands.as_mut()?.next_request()? {
                (Request::Schema, asker) => {
                    self.write_schema();
                    let commands = self.commands.as_ref();
                    self.wire.flush_to(asker.ip(), |datagram| {
                        commands.is_some_and(|commands| commands.answer(datagram, asker))
                    });
                }
                (Request::Command(command), _) => return Some(command),
            }
        }
    }
}

impl Drop for Osc {
    /// Sends neutral and absent for every user seen so far.
    fn drop(&mut self) {
        if !self.wire.to.is_used() {
            return;
        }
        for slot in 0..USERS {
            if slot == 0 || self.users[slot].known {
                let user = &mut self.users[slot];
                (user.known, user.present) = (true, true);
                user.weights.reset();
                let report = Report {
                    at: self.at,
                    ..Report::default()
                };
                self.send_user(slot, &report, TrackingState::Absent);
                self.wire.flush();
            }
        }
    }
}

/// The number after `count`; wraps to 0 instead of becoming negative.
fn next(count: i32) -> i32 {
    count.checked_add(1).unwrap_or(0)
}
