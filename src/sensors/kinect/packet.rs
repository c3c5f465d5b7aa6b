//! Header of an isochronous packet: field ranges, check, parse, emit.
//!
//! ```text
//! byte   0    1    2    3     4    5         6..7   8..11                    12..
//!        'R'  'B'  0    flag  ?    sequence  size   time, 60 MHz, little e.  payload
//! ```
//!
//! The high nibble of the flag is the stream (7 depth, 8 colour), the low nibble the position in the picture (1 first, 2 middle,
//! 5 last). `sequence` counts the packets of one stream modulo 256, across pictures. `size` is the length of the packet, big
//! endian; it is written but not checked, as in common drivers.

use super::device::Stream;

/// Bytes of the header.
pub const HEADER: usize = 12;
/// First two bytes of each packet.
pub const MAGIC: [u8; 2] = *b"RB";
/// Rate of the camera's counter, Hz.
pub const TICKS_PER_SECOND: u32 = 60_000_000;
/// Ticks between pictures at 30 Hz.
pub const TICKS_PER_PICTURE: u32 = TICKS_PER_SECOND / 30;
/// Longest packet of either stream, bytes.
pub const LONGEST: usize = 1920;

/// Position of a packet in its picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Position {
    /// First packet.
    First = 1,
    /// Any packet in between.
    Middle = 2,
    /// Last packet.
    Last = 5,
}

/// Content of a header.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Header {
    /// Stream of the packet.
    pub stream: Stream,
    /// Position in the picture.
    pub position: Position,
    /// Number of the packet in its stream, modulo 256.
    pub sequence: u8,
    /// Time stamp of the picture: 60 MHz counter, wraps after 71.6 s.
    pub ticks: u32,
}

const fn stream_nibble(stream: Stream) -> u8 {
    match stream {
        Stream::Depth => 0x70,
        Stream::Colour => 0x80,
    }
}

impl Header {
    /// Parses the header of a packet received on `stream`; the payload starts at byte [`HEADER`]. `None` if the packet is too short
    /// or has another magic or an invalid flag.
    pub fn parse(bytes: &[u8], stream: Stream) -> Option<Self> {
        let [m0, m1, _, flag, _, sequence, _, _, ticks @ ..] = *bytes.first_chunk::<HEADER>()?;
        let position = match flag ^ stream_nibble(stream) {
            1 => Position::First,
            2 => Position::Middle,
            5 => Position::Last,
            _ => return None,
        };
        let header = Self {
            stream,
            position,
            sequence,
            ticks: u32::from_le_bytes(ticks),
        };
        ([m0, m1] == MAGIC).then_some(header)
    }

    /// The header of a packet whose payload has `payload` bytes.
    pub fn emit(&self, payload: usize) -> [u8; HEADER] {
        let mut header = [0; HEADER];
        header[..2].copy_from_slice(&MAGIC);
        header[3] = stream_nibble(self.stream) | self.position as u8;
        header[5] = self.sequence;
        let size = u16::try_from(HEADER + payload).unwrap_or(u16::MAX);
        header[6..8].copy_from_slice(&size.to_be_bytes());
        header[8..].copy_from_slice(&self.ticks.to_le_bytes());
        header
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_bytes() {
        let header = Header {
            stream: Stream::Depth,
            position: Position::Last,
            sequence: 0xfe,
            ticks: 0x0403_0201,
        };
        // 0x0478 is what old captures show in the last depth packet.
        let bytes = [b'R', b'B', 0, 0x75, 0, 0xfe, 4, 0x78, 1, 2, 3, 4];
        assert_eq!(header.emit(1132), bytes);
        assert_eq!(Header::parse(&bytes, Stream::Depth), Some(header));
        assert_eq!(Header::parse(&bytes, Stream::Colour), None);
        assert_eq!(Header::parse(&bytes[..11], Stream::Depth), None);
    }

    #[test]
    fn parse_inverts_emit_and_survives_any_bytes() {
        let mut random = fastrand::Rng::with_seed(1);
        for _ in 0..200_000 {
            let stream = Stream::BOTH[random.usize(..2)];
            let header = Header {
                stream,
                position: [Position::First, Position::Middle, Position::Last][random.usize(..3)],
                sequence: random.u8(..),
                ticks: random.u32(..),
            };
            assert_eq!(
                Header::parse(&header.emit(random.usize(..3000)), stream),
                Some(header)
            );
            let mut noise = [0; 16];
            random.fill(&mut noise);
            let noise = &noise[..random.usize(..=16)];
            if let Some(header) = Header::parse(noise, stream) {
                assert_eq!(Header::parse(&header.emit(0), stream), Some(header));
            }
        }
    }
}
