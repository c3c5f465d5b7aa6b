//! Art-Net 4: one `ArtDmx` per universe and frame. The universe in the table is the 15-bit Port-Address (net, sub-net,
//! universe); many nodes call their first one 0.
//!
//! | bytes | meaning |
//! | --- | --- |
//! | 0–7 | `Art-Net` and a zero |
//! | 8, 9 | 0x5000, little endian |
//! | 10, 11 | version 14, big endian |
//! | 12 | sequence number, 1 to 255 |
//! | 13 | physical port, 0 |
//! | 14, 15 | Port-Address, little endian |
//! | 16, 17 | channels, big endian |
//! | 18… | values |

use super::{CHANNELS, Lights, Protocol};
use crate::output::OutputError;
use crate::output::features::{ArtNetSettings, LightSettings};
use crate::output::osc::udp;

const ART_NET: Protocol = Protocol {
    name: "artnet",
    universes: 0..=0x7fff,
    expected: "an Art-Net universe, 0 to 32767",
    number_at: 12,
    // 0 would say that numbers are not used.
    first: 1,
    end: None,
};

/// What stands before the values.
fn header(universe: u16) -> Vec<u8> {
    let mut bytes = b"Art-Net\0\x00\x50\0\x0e\0\0".to_vec();
    bytes.extend(universe.to_le_bytes());
    bytes.extend((CHANNELS as u16).to_be_bytes());
    bytes
}

/// Opens the sockets. `units` are the names in the order of the weights.
///
/// # Errors
/// If the table is unusable or no socket can be opened.
pub fn open(
    settings: &ArtNetSettings,
    lights: &LightSettings,
    units: &[&str],
) -> Result<Lights, OutputError> {
    let all = |_: &_| Ok(Box::from([udp::open(&settings.targets)?.into()]));
    Lights::new(ART_NET, lights, units, header, all)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_stand_where_the_specification_has_them() {
        let mut bytes = header(0x1234);
        bytes[ART_NET.number_at] = 200;
        // Art-Net 4, table of ArtDmx: OpDmx 0x5000 low byte first, ProtVer 14, Sequence, Physical, SubUni, Net, Length.
        assert_eq!(bytes, *b"Art-Net\0\x00\x50\x00\x0e\xc8\x00\x34\x12\x02\x00");
    }
}
