//! Commands to the camera and their replies, as bytes: emit, check, parse. Both directions, for the driver and the virtual device.
//!
//! ```text
//! byte   0..1             2..3                     4..5      6..7   8..
//!        "GM" or "RB"     words that follow        command   tag    words, little endian
//! ```

use mien_stages::base::prelude::*;

/// Bytes of the header.
pub const HEADER: usize = 8;
/// Bytes of the buffer for a reply. A full buffer is no reply: some hosts return it when the reply is not ready.
pub const REPLY: usize = 512;

/// First bytes of a command.
const TO_CAMERA: [u8; 2] = *b"GM";
/// First bytes of a reply.
const FROM_CAMERA: [u8; 2] = *b"RB";

/// A command to the camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Command {
    /// Reads a register: register → value.
    GetParameter = 0x02,
    /// Writes a register: register, value.
    SetParameter = 0x03,
    /// Reads the optics of this unit.
    FixedParameters = 0x04,
    /// Reads the registration of this unit, in three blocks.
    AlgorithmParameters = 0x16,
    /// Reads or writes a register of the colour image sensor.
    ImageSensor = 0x95,
}

impl Command {
    /// The command with this number.
    pub fn from_number(number: u16) -> Option<Self> {
        let all = [
            Self::GetParameter,
            Self::SetParameter,
            Self::FixedParameters,
            Self::AlgorithmParameters,
            Self::ImageSensor,
        ];
        all.into_iter().find(|command| *command as u16 == number)
    }
}

/// Registers of the camera, by the names of its firmware.
pub mod register {
    /// Colour stream: 0 off, 1 colour.
    pub const COLOUR_STREAM: u16 = 0x05;
    /// Depth stream: 0 off, 2 depth.
    pub const DEPTH_STREAM: u16 = 0x06;
    /// Format of colour pictures: 0 = Bayer.
    pub const COLOUR_FORMAT: u16 = 0x0c;
    /// Size of colour pictures: 1 = 640×480.
    pub const COLOUR_RESOLUTION: u16 = 0x0d;
    /// Colour pictures per second.
    pub const COLOUR_RATE: u16 = 0x0e;
    /// Format of depth pictures: 3 = packed 11 bit.
    pub const DEPTH_FORMAT: u16 = 0x12;
    /// Size of depth pictures: 1 = 640×480.
    pub const DEPTH_RESOLUTION: u16 = 0x13;
    /// Depth pictures per second.
    pub const DEPTH_RATE: u16 = 0x14;
    /// Brightness of the projector's picture: 0x1e usual, 7 in near mode.
    pub const DEPTH_GAIN: u16 = 0x15;
    /// Depth pictures: 1 = mirrored.
    pub const DEPTH_MIRROR: u16 = 0x17;
    /// Colour pictures: 1 = mirrored.
    pub const COLOUR_MIRROR: u16 = 0x47;
    /// Duty cycle of the projector: 0 = always on.
    pub const PROJECTOR_CYCLE: u16 = 0x105;
    /// Second register of near mode: 0 near, 0x190 usual.
    pub const NEAR_MODE: u16 = 0x2ef;
    /// Highest number in use.
    pub const LAST: u16 = 0x2ef;
}

/// Registers of the colour image sensor.
pub mod image_sensor {
    /// Automatic functions, one bit each.
    pub const AUTOMATIC: u16 = 0x0106;
    /// Bit of [`AUTOMATIC`]: automatic exposure.
    pub const AUTO_EXPOSURE: u16 = 1 << 14;
    /// Bit of [`AUTOMATIC`]: automatic white balance.
    pub const AUTO_WHITE_BALANCE: u16 = 1 << 1;
}

/// Why bytes are not the reply to a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum BadReply {
    /// It does not start with "RB".
    #[error("it starts with {0:02x?}, expected 52 42")]
    Magic([u8; 2]),
    /// It replies to another command.
    #[error("it replies to command 0x{0:02x}")]
    Command(u16),
    /// It has another tag: tag found, tag sent.
    #[error("it carries tag {0}, expected {1}")]
    Tag(u16, u16),
    /// Wrong length: bytes found, bytes expected.
    #[error("it has {0} bytes, expected {1}")]
    Length(usize, usize),
}

fn word(bytes: &[u8], at: usize) -> u16 {
    u16::from_le_bytes([bytes[at], bytes[at + 1]])
}

fn emit_header(magic: [u8; 2], words: usize, command: Command, tag: u16, out: &mut Vec<u8>) {
    out.clear();
    out.extend(magic);
    let words = u16::try_from(words).unwrap_or(u16::MAX);
    for field in [words, command as u16, tag] {
        out.extend(field.to_le_bytes());
    }
}

/// Replaces the content of `out` by a command with a tag and its words.
pub fn emit_command(command: Command, tag: u16, words: &[u16], out: &mut Vec<u8>) {
    emit_header(TO_CAMERA, words.len(), command, tag, out);
    out.extend(words.iter().flat_map(|word| word.to_le_bytes()));
}

/// The body of the reply to `command` with `tag`.
///
/// # Errors
/// If `bytes` is not that reply.
pub fn parse_reply(bytes: &[u8], command: Command, tag: u16) -> Result<&[u8], BadReply> {
    if bytes.len() < HEADER {
        return Err(BadReply::Length(bytes.len(), HEADER));
    }
    let body = &bytes[HEADER..];
    if bytes[..2] != FROM_CAMERA {
        return Err(BadReply::Magic([bytes[0], bytes[1]]));
    }
    if word(bytes, 4) != command as u16 {
        return Err(BadReply::Command(word(bytes, 4)));
    }
    if word(bytes, 6) != tag {
        return Err(BadReply::Tag(word(bytes, 6), tag));
    }
    let expected = HEADER + usize::from(word(bytes, 2)) * 2;
    if bytes.len() != expected {
        return Err(BadReply::Length(bytes.len(), expected));
    }
    Ok(body)
}

/// Camera side: parses command, tag and words; `None` if the command is malformed or unknown.
pub fn parse_command(bytes: &[u8]) -> Option<(Command, u16, Vec<u16>)> {
    if bytes.len() < HEADER || bytes[..2] != TO_CAMERA {
        return None;
    }
    let body = &bytes[HEADER..];
    if usize::from(word(bytes, 2)) * 2 != body.len() {
        return None;
    }
    let words = (0..body.len() / 2).map(|i| word(body, 2 * i)).collect();
    Some((Command::from_number(word(bytes, 4))?, word(bytes, 6), words))
}

/// Camera side: replaces the content of `out` by the reply to a command.
pub fn emit_reply(command: Command, tag: u16, body: &[u8], out: &mut Vec<u8>) {
    emit_header(FROM_CAMERA, body.len() / 2, command, tag, out);
    out.extend(body);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_bytes() {
        let mut out = Vec::new();
        emit_command(Command::SetParameter, 0x1267, &[0x06, 2], &mut out);
        assert_eq!(out, [0x47, 0x4d, 2, 0, 3, 0, 0x67, 0x12, 6, 0, 2, 0]);
        assert_eq!(
            parse_command(&out),
            Some((Command::SetParameter, 0x1267, vec![6, 2]))
        );
        let reply = [0x52, 0x42, 1, 0, 3, 0, 0x67, 0x12, 0, 0];
        assert_eq!(
            parse_reply(&reply, Command::SetParameter, 0x1267),
            Ok(&[0u8, 0][..])
        );
        let check = |at: usize, value: u8| {
            let mut reply = reply;
            reply[at] = value;
            parse_reply(&reply, Command::SetParameter, 0x1267).unwrap_err()
        };
        assert!(matches!(check(0, 0), BadReply::Magic(_)));
        assert!(matches!(check(2, 2), BadReply::Length(10, 12)));
        assert!(matches!(check(4, 2), BadReply::Command(2)));
        assert!(matches!(check(6, 0), BadReply::Tag(..)));
    }

    #[test]
    fn any_bytes_are_survived() {
        let mut random = fastrand::Rng::with_seed(3);
        let mut bytes = [0; 64];
        let mut accepted = 0;
        for _ in 0..300_000 {
            random.fill(&mut bytes);
            let n = random.usize(..=bytes.len());
            if random.bool() {
                // Mostly right, so that the later checks are reached.
                bytes[..8].copy_from_slice(&[0x52, 0x42, 0, 0, 2, 0, 9, 0]);
                bytes[2] = (n.saturating_sub(8) / 2) as u8;
                bytes[random.usize(..8)] ^= random.u8(..2);
            }
            if let Ok(body) = parse_reply(&bytes[..n], Command::GetParameter, 9) {
                assert_eq!(body.len(), n - 8);
                accepted += 1;
            }
            bytes[..2].copy_from_slice(b"GM");
            let _ = parse_command(&bytes[..n]);
        }
        assert!(accepted > 1000);
    }
}
