//! Motor, LED and accelerometer, as messages: the first series has a motor device with vendor requests; later ones take
//! bulk messages through the audio device (only if its firmware is running).
//!
//! Units: degrees and multiples of standard gravity. The tilt is relative to the horizon; the device has no limit stop, so
//! nothing beyond ±31° is ever sent.

#[cfg(not(feature = "std"))]
use crate::base::prelude::*;

/// Largest tilt either way, degrees.
pub const TILT_LIMIT_DEG: f32 = 31.0;
/// Counts of the accelerometer per standard gravity.
const COUNTS_PER_G: f32 = 819.0;

/// What the LED can show.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Light {
    /// Dark.
    Off,
    /// Steady green: a face is tracked.
    Green,
    /// Steady red: a fault.
    Red,
    /// Blinking green: looking for a face.
    BlinkGreen,
}

/// What motor and accelerometer report.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Posture {
    /// Acceleration x, y, z in multiples of standard gravity; at rest it points up.
    pub acceleration_g: [f32; 3],
    /// Tilt against the horizon, degrees up; `None` while it moves.
    pub tilt_deg: Option<f32>,
}

/// Vendor request that sets the LED.
pub const SET_LIGHT: u8 = 0x06;
/// Vendor request that sets the tilt.
pub const SET_TILT: u8 = 0x31;
/// Vendor request that reads the posture, 10 bytes.
pub const GET_POSTURE: u8 = 0x32;

/// Value of [`SET_LIGHT`].
#[must_use]
pub const fn light_value(light: Light) -> u16 {
    match light {
        Light::Off => 0,
        Light::Green => 1,
        Light::Red => 2,
        Light::BlinkGreen => 4,
    }
}

/// Value of [`SET_TILT`]: half degrees, limited.
#[must_use]
pub fn tilt_value(degrees: f32) -> u16 {
    ((limited(degrees) * 2.0).round() as i16).cast_unsigned()
}

/// A tilt that may be sent; not a number becomes level.
fn limited(degrees: f32) -> f32 {
    if degrees.is_nan() {
        return 0.0;
    }
    degrees.clamp(-TILT_LIMIT_DEG, TILT_LIMIT_DEG)
}

/// Reads the motor device's posture; `None` if it is too short.
#[must_use]
pub fn parse_posture(bytes: &[u8]) -> Option<Posture> {
    let bytes = bytes.first_chunk::<10>()?;
    let axis = |at: usize| f32::from(i16::from_be_bytes([bytes[at], bytes[at + 1]])) / COUNTS_PER_G;
    let half_degrees = bytes[8].cast_signed();
    let moving = bytes[9] == 4 || half_degrees == i8::MIN;
    Some(Posture {
        acceleration_g: [axis(2), axis(4), axis(6)],
        tilt_deg: (!moving).then(|| f32::from(half_degrees) / 2.0),
    })
}

/// The motor device's side of [`parse_posture`].
#[must_use]
pub fn emit_posture(posture: &Posture) -> [u8; 10] {
    let mut bytes = [0; 10];
    for (i, g) in posture.acceleration_g.iter().enumerate() {
        let counts = (g * COUNTS_PER_G).round() as i16;
        bytes[2 + 2 * i..][..2].copy_from_slice(&counts.to_be_bytes());
    }
    match posture.tilt_deg {
        Some(degrees) => bytes[8] = ((degrees * 2.0).round() as i8).cast_unsigned(),
        None => (bytes[8], bytes[9]) = (0x80, 4),
    }
    bytes
}

/// Messages through the audio device of the later models.
pub mod audio {
    use super::{Light, Posture, limited};
    #[cfg(not(feature = "std"))]
    use crate::base::prelude::*;

    const MAGIC: u32 = 0x0602_2009;
    const STATUS_MAGIC: u32 = 0x0a6f_e000;
    /// Bytes of the status that answers every message.
    pub const STATUS: usize = 12;
    /// Bytes of the posture, which comes before its status.
    pub const POSTURE: usize = 104;

    fn words(words: &[u32]) -> Vec<u8> {
        words.iter().flat_map(|word| word.to_le_bytes()).collect()
    }

    /// Sets the LED.
    #[must_use]
    pub fn light(tag: u32, light: Light) -> Vec<u8> {
        let value = match light {
            Light::Off => 1,
            Light::BlinkGreen => 2,
            Light::Green => 3,
            Light::Red => 4,
        };
        words(&[MAGIC, tag, 0, 0x10, value])
    }

    /// Sets the tilt, whole degrees.
    #[must_use]
    pub fn tilt(tag: u32, degrees: f32) -> Vec<u8> {
        let degrees = (limited(degrees).round() as i32).cast_unsigned();
        words(&[MAGIC, tag, 0, 0x803b, degrees])
    }

    /// Asks for the posture.
    #[must_use]
    pub fn ask_posture(tag: u32) -> Vec<u8> {
        words(&[MAGIC, tag, POSTURE as u32, 0x8032])
    }

    /// True if `bytes` is the status "done" for `tag`.
    #[must_use]
    pub fn is_done(bytes: &[u8], tag: u32) -> bool {
        bytes.len() == STATUS && bytes == words(&[STATUS_MAGIC, tag, 0])
    }

    /// Reads the posture; `None` if it is too short.
    #[must_use]
    pub fn parse_posture(bytes: &[u8]) -> Option<Posture> {
        let bytes = bytes.first_chunk::<POSTURE>()?;
        let word = |at: usize| {
            i32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]) as f32
        };
        Some(Posture {
            acceleration_g: [16, 20, 24].map(|at| word(at) / super::COUNTS_PER_G),
            tilt_deg: Some(word(28)),
        })
    }

    /// The device's side: status of the message with `tag`.
    #[must_use]
    pub fn status(tag: u32) -> Vec<u8> {
        words(&[STATUS_MAGIC, tag, 0])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tilt_stays_within_its_limits() {
        for (degrees, value) in [
            (0.0, 0i16),
            (10.25, 21),
            (-10.0, -20),
            (90.0, 62),
            (-90.0, -62),
            (f32::NAN, 0),
        ] {
            assert_eq!(tilt_value(degrees).cast_signed(), value);
        }
        assert_eq!(
            audio::tilt(1, -40.0),
            [
                9, 0x20, 2, 6, 1, 0, 0, 0, 0, 0, 0, 0, 0x3b, 0x80, 0, 0, 0xe1, 0xff, 0xff, 0xff
            ]
        );
    }

    #[test]
    fn postures_are_read_as_written() {
        let level = Posture {
            acceleration_g: [0.0, 1.0, -0.5],
            tilt_deg: Some(-12.5),
        };
        let read = parse_posture(&emit_posture(&level)).unwrap();
        assert_eq!(read.tilt_deg, level.tilt_deg);
        for i in 0..3 {
            assert!((read.acceleration_g[i] - level.acceleration_g[i]).abs() < 1.0 / 819.0);
        }
        let moving = Posture {
            tilt_deg: None,
            ..level
        };
        assert_eq!(
            parse_posture(&emit_posture(&moving)).unwrap().tilt_deg,
            None
        );
        assert_eq!(parse_posture(&[0; 9]), None);
        assert_eq!(audio::parse_posture(&[0; 103]), None);
        assert!(audio::is_done(&audio::status(7), 7) && !audio::is_done(&audio::status(7), 8));
    }
}
