//! sACN, ANSI E1.31-2018: one data packet per universe and frame, to the universe's multicast group (239.255.x.y, port 5568)
//! or to named hosts. On exit three stream-terminated packets, as the standard requires, so that receivers release at once.
//!
//! | bytes | meaning, all big endian |
//! | --- | --- |
//! | 0–37 | root layer: preamble 0x0010 0x0000, `ASC-E1.17` and zeros, 0x726e, vector 4, the source's CID (16 bytes) |
//! | 38–114 | framing layer: 0x7258, vector 2, name (64), priority, 0 0, sequence number, options (0x40 in the last), universe (2) |
//! | 115–637 | DMP layer: 0x720b, 2, 0xa1, 0, 1, 513, start code 0, 512 values |

use super::{Lights, Protocol};
use crate::output::features::{LightSettings, SacnSettings};
use crate::output::osc::udp;
use crate::output::{OutputError, identity};

const SACN: Protocol = Protocol {
    name: "sacn",
    universes: 1..=63_999,
    expected: "an sACN universe, 1 to 63999",
    number_at: 111,
    first: 0,
    end: Some((112, 0x40)),
};
/// Bytes of the source's name.
const NAME: usize = 64;

/// What stands before the values. The name is truncated to 63 bytes.
fn header(cid: [u8; 16], name: &str, priority: u8, universe: u16) -> Vec<u8> {
    let mut bytes = b"\0\x10\0\0ASC-E1.17\0\0\0\x72\x6e\0\0\0\x04".to_vec();
    bytes.extend(cid);
    bytes.extend(b"\x72\x58\0\0\0\x02");
    let end = bytes.len() + NAME;
    bytes.extend(name.bytes().take(NAME - 1));
    bytes.resize(end, 0);
    bytes.extend([priority, 0, 0, 0, 0]);
    bytes.extend(universe.to_be_bytes());
    bytes.extend(b"\x72\x0b\x02\xa1\0\0\0\x01\x02\x01\0");
    bytes
}

/// Opens the sockets. `units` are the names in the order of the weights, `name` is the box's.
///
/// # Errors
/// If the table is unusable or no socket can be opened.
pub fn open(
    settings: &SacnSettings,
    lights: &LightSettings,
    name: &str,
    units: &[&str],
) -> Result<Lights, OutputError> {
    let name = identity::name(name);
    let cid = identity::uuid(&name, "sacn");
    let (name, priority) = (format!("mien {name}"), settings.priority.min(200) as u8);
    let header = |universe| header(cid, &name, priority, universe);
    let group = |universe: u16| {
        let [high, low] = universe.to_be_bytes();
        Ok(udp::open(&[format!("239.255.{high}.{low}:5568")])?.into())
    };
    Lights::new(SACN, lights, units, header, |universes| {
        match &settings.targets[..] {
            [] => universes.iter().map(|&universe| group(universe)).collect(),
            targets => Ok(Box::from([udp::open(targets)?.into()])),
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_datagram_is_the_one_that_the_library_sacn_writes() {
        let mut bytes = header(*b"0123456789abcdef", "mien hall", 100, 63_999);
        bytes[SACN.number_at] = 255;
        let (options, terminated) = SACN.end.unwrap();
        bytes[options] = terminated;
        // sacn 1.11.0 (PyPI), DataPacket(cid, "mien hall", 63999, priority=100, sequence=255, streamTerminated=True).
        let mut expected =
            b"\x00\x10\x00\x00ASC-E1.17\x00\x00\x00\x72\x6e\x00\x00\x00\x040123456789abcdef\
            \x72\x58\x00\x00\x00\x02mien hall"
                .to_vec();
        expected.resize(108, 0);
        expected
            .extend(b"\x64\x00\x00\xff\x40\xf9\xff\x72\x0b\x02\xa1\x00\x00\x00\x01\x02\x01\x00");
        assert_eq!(bytes, expected);
    }
}
