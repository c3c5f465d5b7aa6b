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
use crate::output::osc::{Targets, udp};
use crate::output::{Output, OutputError, Report, Tally};

const HEADER: usize = 18;
/// Bytes of a datagram.
pub const LENGTH: usize = HEADER + CHANNELS;

/// Writes a datagram.
#[must_use]
pub fn emit(universe: u16, number: u8, values: &[u8; CHANNELS]) -> [u8; LENGTH] {
    let mut bytes = [0; LENGTH];
    bytes[..8].copy_from_slice(b"Art-Net\0");
    bytes[8..14].copy_from_slice(&[0x00, 0x50, 0, 14, number, 0]);
    bytes[14..16].copy_from_slice(&universe.to_le_bytes());
    bytes[16..18].copy_from_slice(&(CHANNELS as u16).to_be_bytes());
    bytes[HEADER..].copy_from_slice(values);
    bytes
}

/// Universe, sequence number and values of a datagram; `None` if it is not an `ArtDmx`.
#[must_use]
pub fn parse(bytes: &[u8]) -> Option<(u16, u8, &[u8])> {
    let (header, values) = bytes.split_at_checked(HEADER)?;
    let length = usize::from(u16::from_be_bytes([header[16], header[17]]));
    let known =
        header[..10] == *b"Art-Net\0\x00\x50" && u16::from_be_bytes([header[10], header[11]]) >= 14;
    let universe = u16::from_le_bytes([header[14], header[15]]);
    let fits = known && universe <= 0x7fff && (2..=CHANNELS).contains(&length);
    Some((universe, header[12], values.get(..length)?)).filter(|_| fits)
}

/// A sender of Art-Net.
pub struct ArtNet {
    desk: Desk,
    targets: Targets,
    number: u8,
    sent: u64,
    dropped: u64,
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
        Ok(Self {
            desk: Desk::new(lights, units, 0, 0x7fff)?,
            targets: udp::open(&settings.targets)?,
            number: 0,
            sent: 0,
            dropped: 0,
        })
    }

    fn send_all(&mut self) {
        // 0 would say that numbers are not used.
        self.number = self.number.checked_add(1).unwrap_or(1);
        for (universe, values) in &self.desk.universes {
            let datagram = emit(*universe, self.number, values);
            for target in &mut self.targets {
                *(if target.send(&datagram) {
                    &mut self.sent
                } else {
                    &mut self.dropped
                }) += 1;
            }
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
        Tally {
            sent: self.sent,
            dropped: self.dropped,
            not_numbers: self.desk.face.weights.not_numbers(),
            ..Tally::of("artnet")
        }
    }
}

impl Drop for ArtNet {
    /// Nobody.
    fn drop(&mut self) {
        if self.sent + self.dropped > 0 {
            self.desk.neutral();
            self.send_all();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_read_and_stands_where_the_standard_has_it() {
        let mut values = [0; CHANNELS];
        values[0] = 7;
        values[511] = 9;
        let bytes = emit(0x1234, 200, &values);
        assert_eq!(
            bytes[..18],
            *b"Art-Net\0\x00\x50\x00\x0e\xc8\x00\x34\x12\x02\x00"
        );
        assert_eq!(parse(&bytes), Some((0x1234, 200, &values[..])));
        for at in [0, 8, 9, 11, 15, 16] {
            let mut other = bytes;
            other[at] ^= 0x89;
            assert!(parse(&other).is_none() || at == 11, "{at}");
        }
        assert_eq!(parse(&bytes[..LENGTH - 1]), None);
    }

    #[test]
    fn no_bytes_whatever_do_harm() {
        let mut random = fastrand::Rng::with_seed(3);
        let good = emit(1, 1, &[0; CHANNELS]);
        for _ in 0..100_000 {
            let mut bytes = good.to_vec();
            for _ in 0..random.usize(..4) {
                let at = random.usize(..20);
                bytes[at] = random.u8(..);
            }
            bytes.truncate(random.usize(..=bytes.len()));
            if let Some((universe, _, values)) = parse(&bytes) {
                assert!(universe <= 0x7fff && values.len() <= CHANNELS);
            }
        }
    }
}
