//! The datagram being filled, and where it is sent when it is full.

use core::net::IpAddr;

use super::packet::{Argument, Packet};
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;
use crate::output::OutputError;

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

/// The targets and the datagram being filled.
pub(super) struct Wire {
    targets: Targets,
    packet: Packet,
    prefix: String,
    sent: u64,
    dropped: u64,
}

/// The prefix, if it is valid in addresses.
pub(super) fn usable(prefix: String) -> Result<String, OutputError> {
    let plain = |c: char| c.is_ascii_graphic() && !"#*,?[]{}".contains(c);
    let shaped = prefix.is_empty() || prefix.starts_with('/') && !prefix.ends_with('/');
    if !shaped || prefix.len() > LONGEST_PREFIX || !prefix.chars().all(plain) {
        return Err(OutputError::Prefix { prefix });
    }
    Ok(prefix)
}

/// Counts a datagram as sent or dropped.
fn count(taken: bool, sent: &mut u64, dropped: &mut u64) {
    *(if taken { sent } else { dropped }) += 1;
}

impl Wire {
    /// To `targets`; every address starts with `prefix`, which is [`usable`].
    pub(super) fn new(targets: Targets, prefix: String) -> Self {
        Self {
            targets,
            packet: Packet::new(),
            prefix,
            sent: 0,
            dropped: 0,
        }
    }

    /// Whether anything was sent; otherwise there is nothing to close.
    pub(super) fn is_used(&self) -> bool {
        self.sent + self.dropped > 0
    }

    /// Datagrams sent, over all targets.
    pub(super) fn sent(&self) -> u64 {
        self.sent
    }

    /// Datagrams the system did not accept, or whose target is not resolved yet.
    pub(super) fn dropped(&self) -> u64 {
        self.dropped
    }

    /// Appends a message to the datagram, sending it first if there is no room. A message that does not fit an empty datagram is
    /// dropped and counted; the check of the names at start-up rules that out.
    pub(super) fn message<'a>(
        &mut self,
        address: core::fmt::Arguments,
        arguments: impl Iterator<Item = Argument<'a>> + Clone,
    ) {
        if self.packet.push(&self.prefix, address, arguments.clone()) {
            return;
        }
        self.flush();
        if !self.packet.push(&self.prefix, address, arguments) {
            self.dropped += 1;
        }
    }

    /// Sends a message of one number with an address of its own, in a datagram of its own.
    #[cfg(feature = "gestures")]
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
        if self.packet.is_empty() {
            return;
        }
        for target in &mut self.targets {
            let taken = target.send(self.packet.bytes());
            count(taken, &mut self.sent, &mut self.dropped);
        }
        self.packet.clear();
    }

    /// Sends the datagram to the targets on one host, or `otherwise`.
    #[cfg(feature = "std")]
    pub(super) fn flush_to(&mut self, host: IpAddr, otherwise: impl FnOnce(&[u8]) -> bool) {
        let host = host.to_canonical();
        let mut answered = false;
        for target in &mut self.targets {
            if target.host() == Some(host) {
                answered = true;
                let taken = target.send(self.packet.bytes());
                count(taken, &mut self.sent, &mut self.dropped);
            }
        }
        if !answered {
            let taken = otherwise(self.packet.bytes());
            count(taken, &mut self.sent, &mut self.dropped);
        }
        self.packet.clear();
    }
}
