//! Collects messages in a datagram and sends it to all receivers.

use core::fmt::Arguments;
use core::net::IpAddr;

use super::packet::{Argument, Packet};
use crate::{OutputError, Tally};
use mien_stages::base::prelude::*;

/// A destination of datagrams.
pub trait Datagrams: Send {
    /// Sends a datagram without blocking; returns whether it was accepted.
    fn send(&mut self, datagram: &[u8]) -> bool;

    /// The destination host, if it is known.
    fn host(&self) -> Option<IpAddr> {
        None
    }
}

/// All receivers of one schema; each gets every datagram.
pub type Targets = Box<[Box<dyn Datagrams>]>;

/// Longest prefix, bytes, so that an address leaves room for its arguments.
const LONGEST_PREFIX: usize = 64;

/// The receivers, with counters.
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

    /// Whether anything was sent, and so receivers need a closing message.
    pub(crate) fn is_used(&self) -> bool {
        self.sent + self.dropped > 0
    }

    /// Counters of the output called `name`.
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

/// Whether the text is valid as a prefix of OSC addresses and not empty.
pub fn is_prefix(prefix: &str) -> bool {
    !prefix.is_empty() && checked_prefix(prefix.to_owned()).is_ok()
}

/// The prefix, if it is empty or valid in OSC addresses.
///
/// # Errors
/// [`OutputError::Prefix`] otherwise.
pub(super) fn checked_prefix(prefix: String) -> Result<String, OutputError> {
    let plain = |c: char| c.is_ascii_graphic() && !"#*,?[]{}".contains(c);
    let shaped = prefix.is_empty() || prefix.starts_with('/') && !prefix.ends_with('/');
    if !shaped || prefix.len() > LONGEST_PREFIX || !prefix.chars().all(plain) {
        return Err(OutputError::Prefix(prefix));
    }
    Ok(prefix)
}

impl Wire {
    /// Sends to `targets`; every address starts with `prefix`, which has passed [`checked_prefix`].
    pub(super) fn new(targets: Targets, prefix: String) -> Self {
        Self {
            to: targets.into(),
            packet: Packet::default(),
            prefix,
        }
    }

    /// Appends a message; if there is no room, sends the datagram first. A message too long for an empty datagram is dropped and
    /// counted; the check of names at start-up prevents that.
    pub(super) fn message<'a>(
        &mut self,
        address: Arguments,
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

    /// Appends a message if the datagram is not empty and has room; returns whether it did.
    pub(super) fn message_if_room(&mut self, address: Arguments, argument: Argument) -> bool {
        let arguments = core::iter::once(argument);
        !self.packet.is_empty() && self.packet.push(&self.prefix, address, arguments)
    }

    /// Sends numbers to `address` without the prefix, in a datagram of their own.
    pub(super) fn send_alone(&mut self, address: Arguments, numbers: &[Argument<'_>]) {
        self.flush();
        // They always fit.
        let _ = self.packet.push("", address, numbers.iter().copied());
        self.flush();
    }

    /// Sends the datagram to every target, unless it is empty.
    pub(super) fn flush(&mut self) {
        if !self.packet.is_empty() {
            self.to.send(self.packet.bytes());
            self.packet.clear();
        }
    }

    /// Sends the datagram to the targets on `host`; if there are none, passes it to `otherwise`, which returns whether it was sent.
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
