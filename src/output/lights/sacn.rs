//! sACN, ANSI E1.31-2018: one data packet per universe and frame, to the universe's multicast group (239.255.x.y, port 5568)
//! or to named hosts. On exit three stream-terminated packets, as the standard requires, so that receivers release at once.
//!
//! | bytes | meaning, all big endian |
//! | --- | --- |
//! | 0–37 | root layer: preamble 0x0010 0x0000, `ASC-E1.17` and zeros, 0x726e, vector 4, the source's CID (16 bytes) |
//! | 38–114 | framing layer: 0x7258, vector 2, name (64), priority, 0 0, sequence number, options (0x40 in the last), universe (2) |
//! | 115–637 | DMP layer: 0x720b, 2, 0xa1, 0, 1, 513, start code 0, 512 values |

use super::{CHANNELS, Desk};
use crate::output::features::{LightSettings, SacnSettings};
use crate::output::osc::{Targets, udp};
use crate::output::{Output, OutputError, Report, Tally, identity};

const NAME: std::ops::Range<usize> = 44..108;
const VALUES: usize = 126;
/// Bytes of a datagram.
pub const LENGTH: usize = VALUES + CHANNELS;
/// Option bit of the last packet.
const TERMINATED: u8 = 0x40;
/// Packets that end a stream.
const LAST: usize = 3;

/// Everything before the name, for a datagram of full length.
const ROOT: [u8; 22] = *b"\0\x10\0\0ASC-E1.17\0\0\0\x72\x6e\0\0\0\x04";
const DMP: [u8; 11] = *b"\x72\x0b\x02\xa1\0\0\0\x01\x02\x01\0";

/// The contents of a datagram.
#[derive(Debug, PartialEq, Eq)]
pub struct Packet<'a> {
    /// Of the source.
    pub cid: [u8; 16],
    /// Of the source, without the zeros.
    pub name: &'a [u8],
    /// 0 to 200.
    pub priority: u8,
    /// Of the packet.
    pub number: u8,
    /// Whether the stream ends.
    pub terminated: bool,
    /// 1 to 63999.
    pub universe: u16,
    /// From channel 1 on.
    pub values: &'a [u8],
}

/// Writes a datagram. The name is truncated to 63 bytes.
#[must_use]
pub fn emit(packet: &Packet) -> [u8; LENGTH] {
    let mut bytes = [0; LENGTH];
    bytes[..22].copy_from_slice(&ROOT);
    bytes[22..38].copy_from_slice(&packet.cid);
    bytes[38..44].copy_from_slice(b"\x72\x58\0\0\0\x02");
    let name = &packet.name[..packet.name.len().min(NAME.len() - 1)];
    bytes[NAME][..name.len()].copy_from_slice(name);
    bytes[108] = packet.priority;
    bytes[111] = packet.number;
    bytes[112] = if packet.terminated { TERMINATED } else { 0 };
    bytes[113..115].copy_from_slice(&packet.universe.to_be_bytes());
    bytes[115..VALUES].copy_from_slice(&DMP);
    let count = packet.values.len().min(CHANNELS);
    bytes[VALUES..][..count].copy_from_slice(&packet.values[..count]);
    bytes
}

/// Parses a datagram; `None` if it is not a data packet with start code 0.
#[must_use]
pub fn parse(bytes: &[u8]) -> Option<Packet<'_>> {
    let (header, values) = bytes.split_at_checked(VALUES)?;
    let word = |at: usize| u16::from_be_bytes([header[at], header[at + 1]]);
    // Each layer's length counts from its own first byte to the last of the packet.
    let layer = |at: usize| word(at) == 0x7000 | (bytes.len() - at) as u16;
    let count = usize::from(word(123)).checked_sub(1)?;
    let shaped = header[..16] == ROOT[..16]
        && header[18..22] == ROOT[18..]
        && header[40..44] == [0, 0, 0, 2]
        && header[117..123] == DMP[2..8]
        && header[125] == 0
        && bytes.len() < 0x1000
        && [16, 38, 115].into_iter().all(layer)
        && count == values.len()
        && count <= CHANNELS;
    let name = &header[NAME];
    let end = name.iter().position(|&byte| byte == 0)?;
    let universe = word(113);
    let valid = shaped && (1..=63_999).contains(&universe) && header[108] <= 200;
    valid.then_some(Packet {
        cid: header[22..38].try_into().ok()?,
        name: &name[..end],
        priority: header[108],
        number: header[111],
        terminated: header[112] & TERMINATED != 0,
        universe,
        values,
    })
}

/// A sender of sACN.
pub struct Sacn {
    desk: Desk,
    /// One per universe, or one for all.
    targets: Box<[Targets]>,
    cid: [u8; 16],
    name: String,
    priority: u8,
    number: u8,
    sent: u64,
    dropped: u64,
}

impl Sacn {
    /// Opens the sockets. `units` are the names in the order of the weights, `name` is the box's.
    ///
    /// # Errors
    /// If the table is unusable or no socket can be opened.
    pub fn new(
        settings: &SacnSettings,
        lights: &LightSettings,
        name: &str,
        units: &[&str],
    ) -> Result<Self, OutputError> {
        let desk = Desk::new(lights, units, 1, 63_999)?;
        let group = |(universe, _): &(u16, [u8; CHANNELS])| {
            let [high, low] = universe.to_be_bytes();
            udp::open(&[format!("239.255.{high}.{low}:5568")])
        };
        let targets: Result<Box<[Targets]>, OutputError> = if settings.targets.is_empty() {
            desk.universes.iter().map(group).collect()
        } else {
            Ok(Box::new([udp::open(&settings.targets)?]))
        };
        let name = identity::name(name);
        Ok(Self {
            desk,
            targets: targets?,
            cid: identity::uuid(&name, "sacn"),
            name: format!("mien {name}"),
            priority: settings.priority.min(200) as u8,
            number: 0,
            sent: 0,
            dropped: 0,
        })
    }

    fn send_all(&mut self, terminated: bool) {
        for (at, (universe, values)) in self.desk.universes.iter().enumerate() {
            let datagram = emit(&Packet {
                cid: self.cid,
                name: self.name.as_bytes(),
                priority: self.priority,
                number: self.number,
                terminated,
                universe: *universe,
                values,
            });
            let which = at.min(self.targets.len() - 1);
            for target in &mut self.targets[which] {
                *(if target.send(&datagram) {
                    &mut self.sent
                } else {
                    &mut self.dropped
                }) += 1;
            }
        }
        self.number = self.number.wrapping_add(1);
    }
}

impl Output for Sacn {
    fn send(&mut self, report: &Report) -> Result<(), OutputError> {
        if self.desk.observe(report) {
            self.send_all(false);
        }
        Ok(())
    }

    fn tally(&self) -> Tally {
        Tally {
            sent: self.sent,
            dropped: self.dropped,
            not_numbers: self.desk.face.weights.not_numbers(),
            ..Tally::of("sacn")
        }
    }
}

impl Drop for Sacn {
    /// Nobody, then the end of the stream.
    fn drop(&mut self) {
        if self.sent + self.dropped == 0 {
            return;
        }
        self.desk.neutral();
        self.send_all(false);
        for _ in 0..LAST {
            self.send_all(true);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn packet(values: &[u8]) -> Packet<'_> {
        Packet {
            cid: *b"0123456789abcdef",
            name: b"mien hall",
            priority: 100,
            number: 255,
            terminated: true,
            universe: 63_999,
            values,
        }
    }

    #[test]
    fn what_is_written_is_read_and_has_the_lengths_of_the_standard() {
        let values: Vec<u8> = (0..CHANNELS).map(|at| at as u8).collect();
        let bytes = emit(&packet(&values));
        assert_eq!(bytes.len(), 638);
        assert_eq!(parse(&bytes), Some(packet(&values)));
        for at in [0, 4, 16, 21, 39, 43, 115, 118, 121, 124, 125] {
            let mut other = bytes;
            other[at] ^= 0xff;
            assert_eq!(parse(&other), None, "{at}");
        }
        assert_eq!(parse(&bytes[..637]), None);
    }

    #[test]
    fn no_bytes_whatever_do_harm() {
        let mut random = fastrand::Rng::with_seed(4);
        let good = emit(&packet(&[1; CHANNELS]));
        for _ in 0..100_000 {
            let mut bytes = good.to_vec();
            for _ in 0..random.usize(..3) {
                let at = random.usize(..130);
                bytes[at] = random.u8(..);
            }
            bytes.truncate(random.usize(..=bytes.len()));
            if let Some(packet) = parse(&bytes) {
                assert!(packet.values.len() <= CHANNELS && packet.name.len() < 64);
            }
        }
    }
}
