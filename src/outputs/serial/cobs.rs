//! Style `cobs`: binary frames for microcontrollers. Consistent Overhead Byte Stuffing (Cheshire and Baker, 1999) with a zero
//! after each frame, and CRC-16/MCRF4XX over the payload (avr-libc's `_crc_ccitt_update`).
//!
//! | type | payload, little endian |
//! | --- | --- |
//! | 1 weights | type, number, time ms (u16, wraps), flags, confidence 0…255, count, weights 0…255, CRC |
//! | 2 pose | type, number, time ms, x y z in mm, quaternion x y z w × 32767, all i16, CRC |
//! | 3 gesture | type, its index, 0 or 1, the user's slot or 255, its name, CRC; on change and every 2 s |
//! | 16 hello | type, schema version, count, the first names, each behind its length, CRC |
//! | 18 more names | type, schema version, index of the first name in this frame, names, each behind its length, CRC |
//!
//! Flags: bit 0 tracked, 1 ranges frozen, 2 warming, 3 held or fading, 4 and 5 the user's slot, 6 (with 3) posed. No frame is
//! longer than an AVR's receive buffer: weights of up to 52 units, and as many names as fit.

use super::budget::AVR_BUFFER;
use super::line::{LARGEST, Line};
use crate::gesture::Switch;
use crate::{Report, SCHEMA_VERSION, TrackingState};
use mien_stages::base::checksum::crc16;
use mien_stages::base::geometry::Rigid;
use mien_stages::base::prelude::*;

/// Types of frames.
pub(super) const WEIGHTS: u8 = 1;
pub(super) const POSE: u8 = 2;
pub(super) const GESTURE: u8 = 3;
pub(super) const HELLO: u8 = 16;
pub(super) const MORE_NAMES: u8 = 18;
/// The flag of frozen ranges.
pub(super) const FROZEN: u8 = 1 << 1;
/// The flags of the state.
#[cfg(feature = "studio")]
pub(super) const STATE: u8 = 0b0100_1101;
/// Lowest bit of the user's slot in the flags.
pub(super) const SLOT: u8 = 4;
/// The byte of a confidence or weight of 1.
pub(super) const SHARE: f32 = 255.0;
/// The number of 1 in a quaternion.
pub(super) const QUATERNION: f32 = 32767.0;

/// A frame before stuffing; leaves room for the stuffing in a line.
type Payload = heapless::Vec<u8, { LARGEST / 2 }>;

/// Appends the payload with its checksum, stuffed.
///
/// # Errors
/// If there is no room.
fn append(mut payload: Payload, line: &mut Line) -> core::fmt::Result {
    let crc = crc16(&payload).to_le_bytes();
    let whole = payload.extend_from_slice(&crc);
    whole.map_err(|_| core::fmt::Error)?;
    let mut stuffed = [0; LARGEST];
    let length = cobs::try_encode(&payload, &mut stuffed[..LARGEST - 1]);
    let length = length.map_err(|_| core::fmt::Error)?;
    stuffed[length] = 0;
    line.put(&stuffed[..=length])
}

/// Bytes of a pose on the wire.
pub(super) const POSE_BYTES: usize = 22;
/// Largest payload, bytes: the receive buffer minus the checksum, the stuffing's code byte and the zero.
const LONGEST_PAYLOAD: usize = AVR_BUFFER - 4;

/// Appends the unit names, in as many frames as needed.
///
/// # Errors
/// If there is no room or there are more than 255 names.
pub(super) fn unit_names(names: &[String], line: &mut Line) -> core::fmt::Result {
    let version = SCHEMA_VERSION as u8;
    let count = u8::try_from(names.len()).map_err(|_| core::fmt::Error)?;
    let mut payload: Payload = [HELLO, version, count].into_iter().collect();
    for (index, name) in names.iter().enumerate() {
        if payload.len() + 1 + name.len() > LONGEST_PAYLOAD {
            let next = [MORE_NAMES, version, index as u8].into_iter().collect();
            append(core::mem::replace(&mut payload, next), line)?;
        }
        payload.extend([name.len() as u8].into_iter().chain(name.bytes()));
    }
    append(payload, line)
}

/// The flags of a state.
pub(super) fn state_bits(state: TrackingState) -> u8 {
    match state {
        TrackingState::Absent => 0,
        TrackingState::Tracking => 1,
        TrackingState::Warming => 1 << 2,
        TrackingState::Held | TrackingState::Lost => 1 << 3,
        TrackingState::Posed => 1 << 3 | 1 << 6,
    }
}

/// The flags of a weights frame: state, frozen ranges and slot.
pub(super) fn flags(state: TrackingState, report: &Report) -> u8 {
    let frozen = if report.frozen { FROZEN } else { 0 };
    state_bits(state) | frozen | (report.user.unwrap_or(0) as u8 & 3) << SLOT
}

/// Appends a weights frame; confidence and weights are 0…1.
///
/// # Errors
/// If there is no room.
pub(super) fn weights(
    number: u16,
    ms: u32,
    flags: u8,
    confidence: f32,
    weights: impl ExactSizeIterator<Item = f32>,
    line: &mut Line,
) -> core::fmt::Result {
    let byte = |value: f32| (value * SHARE).round() as u8;
    let [ms_low, ms_high, ..] = ms.to_le_bytes();
    let (confidence, count) = (byte(confidence), weights.len() as u8);
    let head = [
        WEIGHTS,
        number as u8,
        ms_low,
        ms_high,
        flags,
        confidence,
        count,
    ];
    append(head.into_iter().chain(weights.map(byte)).collect(), line)
}

/// Appends a pose frame.
///
/// # Errors
/// If there is no room.
pub(super) fn pose(
    number: u16,
    ms: u32,
    sensor_from_head: &Rigid,
    line: &mut Line,
) -> core::fmt::Result {
    let position = sensor_from_head.translation.vector * 1000.0;
    // nalgebra keeps quaternions as x, y, z, w.
    let rotation = sensor_from_head.rotation.coords * QUATERNION;
    let [ms_low, ms_high, ..] = ms.to_le_bytes();
    let head = [POSE, number as u8, ms_low, ms_high];
    let numbers = position.iter().chain(rotation.iter());
    let numbers = numbers.flat_map(|value| (value.round() as i16).to_le_bytes());
    append(head.into_iter().chain(numbers).collect(), line)
}

/// Appends a gesture frame.
///
/// # Errors
/// If there is no room.
pub(super) fn switch(switch: &Switch<'_>, line: &mut Line) -> core::fmt::Result {
    let user = switch.user.map_or(u8::MAX, |user| user as u8);
    let head = [GESTURE, switch.index as u8, switch.is_on.into(), user];
    let bytes = head.iter().chain(switch.gesture.name.as_bytes());
    append(bytes.copied().collect(), line)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Undoes the stuffing, by its definition.
    fn unstuffed(wire: &[u8]) -> Vec<u8> {
        let (&end, mut rest) = wire.split_last().unwrap();
        assert_eq!(end, 0);
        assert!(!rest.contains(&0));
        let mut payload = Vec::new();
        while let Some((&code, after)) = rest.split_first() {
            let (run, after) = after.split_at(usize::from(code) - 1);
            payload.extend_from_slice(run);
            if code < 255 && !after.is_empty() {
                payload.push(0);
            }
            rest = after;
        }
        payload
    }

    #[test]
    fn weights_are_the_reference_frame() {
        let mut line = Line::default();
        let values = [0.0, 128.0 / 255.0, 1.0];
        weights(1, 33, 1, 200.0 / 255.0, values.into_iter(), &mut line).unwrap();
        let wire = [
            0x04, 1, 1, 0x21, 0x04, 1, 0xc8, 3, 0x05, 0x80, 0xff, 0x17, 0x79, 0,
        ];
        assert_eq!(line.bytes(), wire);
    }

    #[test]
    fn flags_tell_state_and_slot() {
        let flags = |state, user, frozen| {
            let mut line = Line::default();
            let report = Report {
                user: Some(user),
                frozen,
                ..Report::default()
            };
            let flags = flags(state, &report);
            weights(7, 0x10203, flags, 0.0, [0.0].into_iter(), &mut line).unwrap();
            let payload = unstuffed(line.bytes());
            assert_eq!(payload[..4], [1, 7, 3, 2]);
            payload[4]
        };
        assert_eq!(flags(TrackingState::Warming, 0, false), 0b0000_0100);
        assert_eq!(flags(TrackingState::Tracking, 3, true), 0b0011_0011);
        assert_eq!(flags(TrackingState::Held, 1, false), 0b0001_1000);
        assert_eq!(flags(TrackingState::Absent, 0, false), 0);
        assert_eq!(flags(TrackingState::Posed, 2, false), 0b0110_1000);
    }

    #[test]
    fn any_payload_comes_back() {
        let mut random = fastrand::Rng::with_seed(5);
        for length in 0..500 {
            for zeros in [0.0, 0.3, 1.0] {
                let bytes = (0..length).map(|_| {
                    if random.f32() < zeros {
                        0
                    } else {
                        random.u8(1..)
                    }
                });
                let payload: Payload = bytes.collect();
                let mut line = Line::default();
                append(payload.clone(), &mut line).unwrap();
                let back = unstuffed(line.bytes());
                let (back, checksum) = back.split_at(length);
                assert_eq!(
                    (back, checksum),
                    (&payload[..], &crc16(&payload).to_le_bytes()[..])
                );
            }
        }
    }

    #[test]
    fn hello_names_the_units_and_a_pose_its_numbers() {
        let mut line = Line::default();
        unit_names(&["AU25".into(), "AU12L".into()], &mut line).unwrap();
        let payload = unstuffed(line.bytes());
        assert_eq!(
            payload[..payload.len() - 2],
            *b"\x10\x01\x02\x04AU25\x05AU12L"
        );
        line.clear();
        pose(9, 33, &Rigid::translation(0.1, -0.25, 0.75), &mut line).unwrap();
        let payload = unstuffed(line.bytes());
        assert_eq!(payload[..10], [2, 9, 33, 0, 100, 0, 0x06, 0xff, 0xee, 0x02]);
        assert_eq!(payload[10..18], [0, 0, 0, 0, 0, 0, 0xff, 0x7f]);
        assert_eq!(line.bytes().len(), POSE_BYTES);
        assert!(unit_names(&vec!["AU".into(); 300], &mut line).is_err());
    }

    #[test]
    fn many_names_come_in_frames_that_fit_the_ring() {
        let names: Vec<String> = (0..40).map(|i| format!("AU{i}L")).collect();
        let mut line = Line::default();
        unit_names(&names, &mut line).unwrap();
        let mut back = Vec::new();
        for frame in line.bytes().split_inclusive(|&byte| byte == 0) {
            assert!(frame.len() <= AVR_BUFFER);
            let payload = unstuffed(frame);
            let (head, mut rest) = payload[..payload.len() - 2].split_at(3);
            let first = back.len() as u8;
            assert_eq!(
                head,
                if first == 0 {
                    [0x10, 1, 40]
                } else {
                    [0x12, 1, first]
                }
            );
            while let Some((&length, after)) = rest.split_first() {
                let (name, after) = after.split_at(length.into());
                back.push(String::from_utf8(name.to_vec()).unwrap());
                rest = after;
            }
        }
        assert_eq!(back, names);
    }

    #[test]
    fn fifty_two_units_fit_the_ring_of_an_avr() {
        let mut line = Line::default();
        let values = core::iter::repeat_n(0.5, 52).collect::<Vec<_>>();
        weights(0, 0, 0xff, 0.0, values.into_iter(), &mut line).unwrap();
        assert!(line.bytes().len() <= 63, "{}", line.bytes().len());
    }
}
