//! The datagram being filled, and where it is sent when it is full.

use core::net::IpAddr;

use super::packet::{Argument, Packet};
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;
use crate::output::OutputError;

/// Somewhere datagrams go.
pub trait Datagrams: Send {
    /// Hands one on, without waiting; whether it was taken.
    fn send(&mut self, datagram: &[u8]) -> bool;

    /// The host they go to, if it is one and known.
    fn host(&self) -> Option<IpAddr> {
        None
    }
}

/// All receivers of one schema; each gets every datagram.
pub type Targets = Box<[Box<dyn Datagrams>]>;

/// Longest prefix, so that an address always leaves room for what it carries.
const LONGEST_PREFIX: usize = 64;

/// The targets and the datagram being filled.
pub(super) struct Wire {
    targets: Targets,
    packet: Packet,
    prefix: String,
    sent: u64,
    dropped: u64,
}

/// The prefix, if addresses may start with it.
pub(super) fn usable(prefix: String) -> Result<String, OutputError> {
    let plain = |c: char| c.is_ascii_graphic() && !"#*,?[]{}".contains(c);
    let shaped = prefix.is_empty() || prefix.starts_with('/') && !prefix.ends_with('/');
    if !shaped || prefix.len() > LONGEST_PREFIX || !prefix.chars().all(plain) {
        return Err(OutputError::Prefix { prefix });
    }
    Ok(prefix)
}

/// One datagram more that was taken, or dropped.
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

    /// Whether anybody was told anything; else there is nothing to take leave of.
    pub(super) fn is_used(&self) -> bool {
        self.sent + self.dropped > 0
    }

    /// Datagrams sent, over all targets.
    pub(super) fn sent(&self) -> u64 {
        self.sent
    }

    /// Datagrams the system did not take, or for which the target's name is not found yet.
    pub(super) fn dropped(&self) -> u64 {
        self.dropped
    }

    /// Puts a message in the datagram; sends what is there before, if there is no room. One that does not fit an empty
    /// datagram is dropped and counted; the check of the names at the start leaves none such.
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

    /// Sends the datagram to every target, if there is anything in it.
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
