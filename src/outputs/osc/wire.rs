//! The datagram being filled, and where it is sent when it is full.

use core::net::IpAddr;

use super::packet::{Argument, Packet};
use crate::{OutputError, Tally};
use mien_stages::base::prelude::*;

/// A destination of datagrams.
pub trait Datagrams: Send {
    /// Sends one without blocking; whether it was accepted.
    fn send(&mut self, datagram: &[u8]) -> bool;

    /// The destination host, if there is a single one and it is known.
    fn host(&self) -> Option<IpAddr> {
        None
    }
}

/// All receivers of one schema; each gets every datagram.
pub type Targets = Box<[Box<dyn Datagrams>]>;

/// Longest prefix, so that an address always leaves room for its arguments.
const LONGEST_PREFIX: usize = 64;

/// The receivers, and what was sent to them.
#[derive(Default)]
pub(crate) struct Sender {
    targets: Targets,
    sent: u64,
    /// Datagrams the system did not accept, or whose target is not resolved yet.
    dropped: u64,
}

impl From<Targets> for Sender {
    fn from(targets: Targets) -> Self {
        Self {
            targets,
            ..Self::default()
        }
    }
}

impl Sender {
    /// Sends a datagram to every target.
    pub(crate) fn send(&mut self, datagram: &[u8]) {
        for at in 0..self.targets.len() {
            let taken = self.targets[at].send(datagram);
            self.count(taken);
        }
    }

    fn count(&mut self, taken: bool) {
        self.sent += u64::from(taken);
        self.dropped += u64::from(!taken);
    }

    /// Whether anything was sent; otherwise there is nothing to close.
    pub(crate) fn is_used(&self) -> bool {
        self.sent + self.dropped > 0
    }

    /// The counters so far, of the output called `name`.
    pub(crate) fn tally(&self, name: &'static str, not_numbers: u64) -> Tally {
        Tally {
            sent: self.sent,
            dropped: self.dropped,
            not_numbers,
            ..Tally::empty(name)
        }
    }
}

/// The receivers and the datagram being filled.
pub(super) struct Wire {
    pub(super) to: Sender,
    packet: Packet,
    prefix: String,
}

/// Whether every address may begin so.
pub fn is_prefix(prefix: &str) -> bool {
    !prefix.is_empty() && usable(prefix.to_owned()).is_ok()
}

/// The prefix, if it is valid in addresses.
pub(super) fn usable(prefix: String) -> Result<String, OutputError> {
    let plain = |c: char| c.is_ascii_graphic() && !"#*,?[]{}".contains(c);
    let shaped = prefix.is_empty() || prefix.starts_with('/') && !prefix.ends_with('/');
    if !shaped || prefix.len() > LONGEST_PREFIX || !prefix.chars().all(plain) {
        return Err(OutputError::Prefix(prefix));
    }
    Ok(prefix)
}

impl Wire {
    /// To `targets`; every address starts with `prefix`, which is [`usable`].
    pub(super) fn new(targets: Targets, prefix: String) -> Self {
        Self {
            to: targets.into(),
            packet: Packet::default(),
            prefix,
        }
    }

    /// Appends a message to the datagram, sending it first if there is no room. A message that does not fit an empty datagram is
    /// dropped and counted; the check of the names at start-up rules that out.
    pub(super) fn message<'a>(
        &mut self,
        address: core::fmt::Arguments,
        arguments: impl IntoIterator<Item = Argument<'a>, IntoIter: Clone>,
    ) {
        let arguments = arguments.into_iter();
        if self.packet.push(&self.prefix, address, arguments.clone()) {
            return;
        }
        self.flush();
        if !self.packet.push(&self.prefix, address, arguments) {
            self.to.count(false);
        }
    }

    /// Appends a message to the datagram if that has been begun and has room; says whether it did.
    pub(super) fn message_if_room<'a>(
        &mut self,
        address: core::fmt::Arguments,
        arguments: impl IntoIterator<Item = Argument<'a>, IntoIter: Clone>,
    ) -> bool {
        let arguments = arguments.into_iter();
        !self.packet.is_empty() && self.packet.push(&self.prefix, address, arguments)
    }

    /// Sends a message of one number with an address of its own, in a datagram of its own.
    pub(super) fn alone(&mut self, address: core::fmt::Arguments, number: i32) {
        self.flush();
        // It always fits.
        let _ = self
            .packet
            .push("", address, core::iter::once(Argument::Int(number)));
        self.flush();
    }

    /// Sends the datagram to every target, unless it is empty.
    pub(super) fn flush(&mut self) {
        if !self.packet.is_empty() {
            self.to.send(self.packet.bytes());
            self.packet.clear();
        }
    }

    /// Sends the datagram to the targets on one host, or `otherwise`.
    #[cfg(feature = "std")]
    pub(super) fn flush_to(&mut self, host: IpAddr, otherwise: impl FnOnce(&[u8]) -> bool) {
        let host = Some(host.to_canonical());
        let mut answered = false;
        for at in 0..self.to.targets.len() {
            if self.to.targets[at].host() == host {
                answered = true;
                let taken = self.to.targets[at].send(self.packet.bytes());
                self.to.count(taken);
            }
        }
        if !answered {
            self.to.count(otherwise(self.packet.bytes()));
        }
        self.packet.clear();
    }
}
