//! The usbredir protocol's framing: messages in and out of one socket.

use std::io::{ErrorKind, Read, Write};
use std::os::unix::net::UnixStream;

use super::Result;

/// Message types of the protocol.
pub(crate) mod message {
    pub(crate) const HELLO: u32 = 0;
    pub(crate) const DEVICE_CONNECT: u32 = 1;
    pub(crate) const DEVICE_DISCONNECT: u32 = 2;
    pub(crate) const RESET: u32 = 3;
    pub(crate) const INTERFACE_INFO: u32 = 4;
    pub(crate) const EP_INFO: u32 = 5;
    pub(crate) const SET_CONFIGURATION: u32 = 6;
    pub(crate) const GET_CONFIGURATION: u32 = 7;
    pub(crate) const CONFIGURATION_STATUS: u32 = 8;
    pub(crate) const SET_ALT_SETTING: u32 = 9;
    pub(crate) const GET_ALT_SETTING: u32 = 10;
    pub(crate) const ALT_SETTING_STATUS: u32 = 11;
    pub(crate) const START_ISO_STREAM: u32 = 12;
    pub(crate) const STOP_ISO_STREAM: u32 = 13;
    pub(crate) const ISO_STREAM_STATUS: u32 = 14;
    pub(crate) const CANCEL_DATA_PACKET: u32 = 21;
    pub(crate) const CONTROL_PACKET: u32 = 100;
    pub(crate) const BULK_PACKET: u32 = 101;
    pub(crate) const ISO_PACKET: u32 = 102;
}

pub(crate) const STALL: u8 = 4;
pub(crate) const CANCELLED: u8 = 1;
pub(crate) const IO_ERROR: u8 = 3;
/// Device version in connect, packet sizes in ep_info, 64-bit ids, 32-bit bulk lengths.
pub(crate) const CAPABILITIES: u32 = 1 << 1 | 1 << 4 | 1 << 5 | 1 << 6;
pub(crate) const WIDE_IDS: u32 = 1 << 5;

/// One connection to QEMU.
pub(crate) struct Wire {
    pub(crate) socket: UnixStream,
    pub(crate) inbox: Vec<u8>,
    pub(crate) outbox: Vec<u8>,
    pub(crate) wide_ids: bool,
}

impl Wire {
    pub(crate) fn send(&mut self, kind: u32, id: u64, parts: &[&[u8]]) {
        let length: usize = parts.iter().map(|part| part.len()).sum();
        self.outbox.extend(kind.to_le_bytes());
        self.outbox.extend((length as u32).to_le_bytes());
        if self.wide_ids {
            self.outbox.extend(id.to_le_bytes());
        } else {
            self.outbox.extend((id as u32).to_le_bytes());
        }
        for part in parts {
            self.outbox.extend_from_slice(part);
        }
    }

    /// Answers a bulk transfer.
    pub(crate) fn bulk(&mut self, id: u64, endpoint: u8, status: u8, bytes: &[u8]) {
        let [l0, l1, l2, l3] = (bytes.len() as u32).to_le_bytes();
        let head = [endpoint, status, l0, l1, 0, 0, 0, 0, l2, l3];
        self.send(message::BULK_PACKET, id, &[&head, bytes]);
    }

    pub(crate) fn flush(&mut self) -> Result<()> {
        if !self.outbox.is_empty() {
            self.socket.write_all(&self.outbox)?;
            self.outbox.clear();
        }
        Ok(())
    }

    /// Reads for at most a millisecond. False when QEMU has gone.
    pub(crate) fn fill(&mut self) -> Result<bool> {
        let mut buffer = [0; 4096];
        match self.socket.read(&mut buffer) {
            Ok(0) => Ok(false),
            Ok(n) => {
                self.inbox.extend_from_slice(&buffer[..n]);
                Ok(true)
            }
            Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => Ok(true),
            Err(e) if e.kind() == ErrorKind::ConnectionReset => Ok(false),
            Err(e) => Err(e.into()),
        }
    }

    /// The next whole message: type, id, body.
    pub(crate) fn next(&mut self) -> Option<(u32, u64, Vec<u8>)> {
        let word = |at: usize| Some(u32::from_le_bytes(*self.inbox.get(at..)?.first_chunk()?));
        let (kind, length) = (word(0)?, word(4)? as usize);
        let wide = self.wide_ids && kind != message::HELLO;
        let header = if wide { 16 } else { 12 };
        if self.inbox.len() < header + length {
            return None;
        }
        let id = u64::from(word(8)?) | if wide { u64::from(word(12)?) << 32 } else { 0 };
        let body = self.inbox[header..header + length].to_vec();
        self.inbox.drain(..header + length);
        Some((kind, id, body))
    }
}
