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

use super::{CHANNELS, Desk};
use crate::output::features::{ArtNetSettings, LightSettings};
use crate::output::osc::{Sender, udp};
use crate::output::{Output, OutputError, Report, Tally};

const HEADER: usize = 18;
/// Bytes of a datagram.
const LENGTH: usize = HEADER + CHANNELS;

/// Writes a datagram.
fn emit(universe: u16, number: u8, values: &[u8; CHANNELS]) -> [u8; LENGTH] {
    let mut bytes = [0; LENGTH];
    bytes[..8].copy_from_slice(b"Art-Net\0");
    bytes[8..14].copy_from_slice(&[0x00, 0x50, 0, 14, number, 0]);
    bytes[14..16].copy_from_slice(&universe.to_le_bytes());
    bytes[16..18].copy_from_slice(&(CHANNELS as u16).to_be_bytes());
    bytes[HEADER..].copy_from_slice(values);
    bytes
}

/// A sender of Art-Net.
pub struct ArtNet {
    desk: Desk,
    to: Sender,
    number: u8,
}

impl ArtNet {
    /// Opens the sockets. `units` are the names in the order of the weights.
    ///
    /// # Errors
    /// If the table is unusable or no socket can be opened.
    pub fn new(
        settings: &ArtNetSettings,
        lights: &LightSettings,
        units: &[&str],
    ) -> Result<Self, OutputError> {
        let expected = "an Art-Net universe, 0 to 32767";
        Ok(Self {
            desk: Desk::new(lights, units, 0..=0x7fff, expected)?,
            to: udp::open(&settings.targets)?.into(),
            number: 0,
        })
    }

    fn send_all(&mut self) {
        // 0 would say that numbers are not used.
        self.number = self.number.checked_add(1).unwrap_or(1);
        for (universe, values) in &self.desk.universes {
            self.to.send(&emit(*universe, self.number, values));
        }
    }
}

impl Output for ArtNet {
    fn send(&mut self, report: &Report) -> Result<(), OutputError> {
        if self.desk.observe(report) {
            self.send_all();
        }
        Ok(())
    }

    fn tally(&self) -> Tally {
        self.to.tally("artnet", self.desk.face.weights.not_numbers)
    }
}

impl Drop for ArtNet {
    /// Nobody.
    fn drop(&mut self) {
        if self.to.is_used() {
            self.desk.neutral();
            self.send_all();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_stand_where_the_specification_has_them() {
        let values = std::array::from_fn(|at| at as u8);
        let bytes = emit(0x1234, 200, &values);
        // Art-Net 4, table of ArtDmx: OpDmx 0x5000 low byte first, ProtVer 14, Sequence, Physical, SubUni, Net, Length.
        assert_eq!(
            bytes[..18],
            *b"Art-Net\0\x00\x50\x00\x0e\xc8\x00\x34\x12\x02\x00"
        );
        assert_eq!(bytes[18..], values);
    }
}
