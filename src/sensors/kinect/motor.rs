//! Messages for motor and LED. The first series has a motor device with vendor requests; later ones take bulk messages through the
//! audio device, if its firmware is running.
//!
//! Tilt is in degrees relative to the horizon. The device has no limit stop, so nothing beyond ±31° is sent.

#[cfg(not(feature = "std"))]
use mien_stages::base::prelude::*;

/// Largest tilt up or down, degrees.
pub const TILT_LIMIT_DEG: f32 = 31.0;

/// State of the LED.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Light {
    /// Dark.
    Off,
    /// Green: a face is tracked.
    Green,
    /// Red: a fault.
    Red,
    /// Yellow, on later models dark: a gesture is on.
    Yellow,
    /// Blinking green: looking for a face.
    BlinkGreen,
}

/// Vendor request that sets the LED.
pub const SET_LIGHT: u8 = 0x06;
/// Vendor request that sets the tilt.
pub const SET_TILT: u8 = 0x31;
/// Vendor request that reads the motor device's state.
pub const STATE: u8 = 0x32;
/// Bytes of that state.
pub const STATE_BYTES: usize = 10;

/// Acceleration in a state of the motor device: x to the left in the picture, y up, z forward; 819 counts a g, at rest upwards.
pub fn acceleration(state: &[u8; STATE_BYTES]) -> [i16; 3] {
    [2, 4, 6].map(|at| i16::from_be_bytes([state[at], state[at + 1]]))
}

impl Light {
    /// Values for [`SET_LIGHT`] and for the audio device.
    pub const fn values(self) -> (u16, u32) {
        match self {
            Self::Off => (0, 1),
            Self::Green => (1, 3),
            Self::Red => (2, 4),
            Self::Yellow => (3, 1),
            Self::BlinkGreen => (4, 2),
        }
    }
}

/// Value for [`SET_TILT`]: half degrees, limited to ±31°.
pub fn tilt_value(degrees: f32) -> u16 {
    ((clamp_tilt(degrees) * 2.0).round() as i16).cast_unsigned()
}

/// Limits a tilt to ±31°; NaN becomes 0.
fn clamp_tilt(degrees: f32) -> f32 {
    if degrees.is_nan() {
        return 0.0;
    }
    degrees.clamp(-TILT_LIMIT_DEG, TILT_LIMIT_DEG)
}

/// Messages through the audio device of the later models.
pub mod audio {
    use super::{Light, clamp_tilt};
    #[cfg(not(feature = "std"))]
    use mien_stages::base::prelude::*;

    const MAGIC: u32 = 0x0602_2009;
    const STATUS_MAGIC: u32 = 0x0a6f_e000;
    /// Bytes of the status that replies to a message.
    pub const STATUS: usize = 12;

    fn words(words: &[u32]) -> Vec<u8> {
        words.iter().flat_map(|word| word.to_le_bytes()).collect()
    }

    /// Message that sets the LED.
    pub fn light(tag: u32, light: Light) -> Vec<u8> {
        words(&[MAGIC, tag, 0, 0x10, light.values().1])
    }

    /// Message that sets the tilt, rounded to whole degrees.
    pub fn tilt(tag: u32, degrees: f32) -> Vec<u8> {
        let degrees = (clamp_tilt(degrees).round() as i32).cast_unsigned();
        words(&[MAGIC, tag, 0, 0x803b, degrees])
    }

    /// Bytes of the state, which precedes the status.
    pub const STATE: usize = 104;

    /// Message that asks for the state.
    pub fn state(tag: u32) -> Vec<u8> {
        words(&[MAGIC, tag, STATE as u32, 0x8032])
    }

    /// Acceleration in a state, as [`super::acceleration`].
    pub fn acceleration(state: &[u8; STATE]) -> [i16; 3] {
        [16, 20, 24].map(|at| i16::from_le_bytes([state[at], state[at + 1]]))
    }

    /// Whether `bytes` is the status "done" for `tag`.
    pub fn is_done(bytes: &[u8], tag: u32) -> bool {
        bytes.len() == STATUS && bytes == words(&[STATUS_MAGIC, tag, 0])
    }

    /// Device side: status "done" for `tag`.
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
    fn acceleration_is_read_from_both_states() {
        // x = −819, y = 12, z = −3.
        let state = [0, 0, 0xfc, 0xcd, 0, 12, 0xff, 0xfd, 0, 0];
        assert_eq!(acceleration(&state), [-819, 12, -3]);
        let mut state = [0; audio::STATE];
        for (at, value) in [(16, -819i32), (20, 12), (24, -3)] {
            state[at..at + 4].copy_from_slice(&value.to_le_bytes());
        }
        assert_eq!(audio::acceleration(&state), [-819, 12, -3]);
        assert_eq!(
            audio::state(1),
            [9, 0x20, 2, 6, 1, 0, 0, 0, 0x68, 0, 0, 0, 0x32, 0x80, 0, 0]
        );
    }

    #[test]
    fn done_is_said_of_one_message() {
        assert!(audio::is_done(&audio::status(7), 7) && !audio::is_done(&audio::status(7), 8));
    }
}
