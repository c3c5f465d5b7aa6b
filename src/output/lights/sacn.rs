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
use crate::output::osc::{Sender, udp};
use crate::output::{Output, OutputError, Report, Tally, identity};

const NAME: std::ops::Range<usize> = 44..108;
const VALUES: usize = 126;
/// Bytes of a datagram.
const LENGTH: usize = VALUES + CHANNELS;
/// Option bit of the last packet.
const TERMINATED: u8 = 0x40;
/// Packets that end a stream.
const LAST: usize = 3;

/// A sender of sACN.
pub struct Sacn {
    desk: Desk,
    /// One per universe, or one for all.
    to: Box<[Sender]>,
    cid: [u8; 16],
    name: String,
    priority: u8,
    number: u8,
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
        let expected = "an sACN universe, 1 to 63999";
        let desk = Desk::new(lights, units, 1..=63_999, expected)?;
        let open = |targets: &[String]| udp::open(targets).map(Sender::from);
        let to: Box<[Sender]> = if settings.targets.is_empty() {
            let groups = desk.universes.iter().map(|(universe, _)| {
                let [high, low] = universe.to_be_bytes();
                open(&[format!("239.255.{high}.{low}:5568")])
            });
            groups.collect::<Result<_, _>>()?
        } else {
            Box::new([open(&settings.targets)?])
        };
        let name = identity::name(name);
        Ok(Self {
            desk,
            to,
            cid: identity::uuid(&name, "sacn"),
            name: format!("mien {name}"),
            priority: settings.priority.min(200) as u8,
            number: 0,
        })
    }

    /// Writes a datagram. The name is truncated to 63 bytes.
    fn emit(&self, terminated: bool, universe: u16, values: &[u8; CHANNELS]) -> [u8; LENGTH] {
        let mut bytes = [0; LENGTH];
        bytes[..22].copy_from_slice(b"\0\x10\0\0ASC-E1.17\0\0\0\x72\x6e\0\0\0\x04");
        bytes[22..38].copy_from_slice(&self.cid);
        bytes[38..44].copy_from_slice(b"\x72\x58\0\0\0\x02");
        let name = &self.name.as_bytes()[..self.name.len().min(NAME.len() - 1)];
        bytes[NAME][..name.len()].copy_from_slice(name);
        bytes[108] = self.priority;
        bytes[111] = self.number;
        bytes[112] = if terminated { TERMINATED } else { 0 };
        bytes[113..115].copy_from_slice(&universe.to_be_bytes());
        bytes[115..VALUES].copy_from_slice(b"\x72\x0b\x02\xa1\0\0\0\x01\x02\x01\0");
        bytes[VALUES..].copy_from_slice(values);
        bytes
    }

    fn send_all(&mut self, terminated: bool) {
        for (at, (universe, values)) in self.desk.universes.iter().enumerate() {
            let datagram = self.emit(terminated, *universe, values);
            let which = at.min(self.to.len() - 1);
            self.to[which].send(&datagram);
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
        let not_numbers = self.desk.face.weights.not_numbers;
        let mut all = Tally::of("sacn");
        for one in self.to.iter().map(|one| one.tally("sacn", not_numbers)) {
            (all.sent, all.dropped) = (all.sent + one.sent, all.dropped + one.dropped);
            all.not_numbers = one.not_numbers;
        }
        all
    }
}

impl Drop for Sacn {
    /// Nobody, then the end of the stream.
    fn drop(&mut self) {
        if !self.to.iter().any(Sender::is_used) {
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

    #[test]
    fn a_datagram_is_the_one_that_the_library_sacn_writes() {
        let mut sacn = Sacn::new(
            &SacnSettings::default(),
            &LightSettings::default(),
            "hall",
            &[],
        )
        .unwrap();
        (sacn.cid, sacn.number) = (*b"0123456789abcdef", 255);
        let values = std::array::from_fn(|at| at as u8);
        let bytes = sacn.emit(true, 63_999, &values);
        // sacn 1.11.0 (PyPI), DataPacket(cid, "mien hall", 63999, priority=100, sequence=255, streamTerminated=True).
        let mut expected =
            b"\x00\x10\x00\x00ASC-E1.17\x00\x00\x00\x72\x6e\x00\x00\x00\x040123456789abcdef\
            \x72\x58\x00\x00\x00\x02mien hall"
                .to_vec();
        expected.resize(108, 0);
        expected
            .extend(b"\x64\x00\x00\xff\x40\xf9\xff\x72\x0b\x02\xa1\x00\x00\x00\x01\x02\x01\x00");
        expected.extend(values);
        assert_eq!(bytes[..], expected);
    }
}
