//! Unreal's Live Link, in the format of the Live Link Face app: one datagram per frame to port 11111 with ARKit's 52 shapes
//! and nine angles. One face: the first seen, until lost and faded out; datagrams then continue without values.
//!
//! | bytes | meaning, big endian |
//! | --- | --- |
//! | 1 | version, 6 |
//! | 4 + 36 | the device's UUID, as text |
//! | 4 + n | the subject's name |
//! | 4, 4, 4, 4 | frame, subframe (float), frame rate as a fraction: 30, 1 |
//! | 1 + 61 × 4 | the count 61 and as many floats; absent without a face |
//!
//! Angles are in radians, as Unreal turns the app's transforms: yaw to the subject's right, pitch down, roll towards the
//! subject's left shoulder. Eyes: 30° where the unit is 1. Shapes that are not measured are 0. Not tested with
//! Unreal itself: the signs of the angles are derived from its axes.
//! One file: most of it is the list of names.

use super::features::LiveLinkSettings;
use super::osc::parameters::Parameter;
use super::osc::{Targets, udp};
use super::{OneFace, Output, OutputError, Report, Tally, View, identity};
use crate::base::geometry::yaw_pitch_roll;
use crate::base::time::Timestamp;

/// The shapes in their order; ARKit's names but for the first letter.
pub const SHAPES: [&str; 52] = [
    "EyeBlinkLeft",
    "EyeLookDownLeft",
    "EyeLookInLeft",
    "EyeLookOutLeft",
    "EyeLookUpLeft",
    "EyeSquintLeft",
    "EyeWideLeft",
    "EyeBlinkRight",
    "EyeLookDownRight",
    "EyeLookInRight",
    "EyeLookOutRight",
    "EyeLookUpRight",
    "EyeSquintRight",
    "EyeWideRight",
    "JawForward",
    "JawLeft",
    "JawRight",
    "JawOpen",
    "MouthClose",
    "MouthFunnel",
    "MouthPucker",
    "MouthLeft",
    "MouthRight",
    "MouthSmileLeft",
    "MouthSmileRight",
    "MouthFrownLeft",
    "MouthFrownRight",
    "MouthDimpleLeft",
    "MouthDimpleRight",
    "MouthStretchLeft",
    "MouthStretchRight",
    "MouthRollLower",
    "MouthRollUpper",
    "MouthShrugLower",
    "MouthShrugUpper",
    "MouthPressLeft",
    "MouthPressRight",
    "MouthLowerDownLeft",
    "MouthLowerDownRight",
    "MouthUpperUpLeft",
    "MouthUpperUpRight",
    "BrowDownLeft",
    "BrowDownRight",
    "BrowInnerUp",
    "BrowOuterUpLeft",
    "BrowOuterUpRight",
    "CheekPuff",
    "CheekSquintLeft",
    "CheekSquintRight",
    "NoseSneerLeft",
    "NoseSneerRight",
    "TongueOut",
];
/// Shapes and angles.
pub const VALUES: usize = SHAPES.len() + 9;
/// Gaze among [`SHAPES`]: down, in, out, up, of the left and the right eye.
const LEFT_EYE: [usize; 4] = [1, 2, 3, 4];
const RIGHT_EYE: [usize; 4] = [8, 9, 10, 11];
/// Frames a second.
const RATE: u32 = 30;
/// Longest name of a subject, bytes.
const LONGEST: usize = 64;
/// Bytes of the longest datagram.
const LARGEST: usize = 1 + 4 + 36 + 4 + LONGEST + 16 + 1 + 4 * VALUES;

/// The contents of a datagram.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Packet<'a> {
    /// The device's UUID, as text.
    pub device: &'a [u8; 36],
    /// Name of the subject, at most 64 bytes.
    pub subject: &'a str,
    /// Number of the frame, and subframe.
    pub frame: (u32, f32),
    /// Shapes, then yaw, pitch and roll of the head, the left and the right eye; `None` without a face.
    pub values: Option<[f32; VALUES]>,
}

/// Writes a datagram into `bytes`; its length.
fn emit(packet: &Packet, bytes: &mut [u8; LARGEST]) -> usize {
    let mut length = 0;
    let mut put = |part: &[u8]| {
        bytes[length..length + part.len()].copy_from_slice(part);
        length += part.len();
    };
    let subject = &packet.subject.as_bytes()[..packet.subject.len().min(LONGEST)];
    put(&[6]);
    put(&36_u32.to_be_bytes());
    put(packet.device);
    put(&(subject.len() as u32).to_be_bytes());
    put(subject);
    let (frame, part) = packet.frame;
    for word in [frame, part.to_bits(), RATE, 1] {
        put(&word.to_be_bytes());
    }
    if let Some(values) = packet.values {
        put(&[VALUES as u8]);
        for value in values {
            put(&value.to_be_bytes());
        }
    }
    length
}

/// Parses a datagram; `None` unless it has 30 frames per second and 61 finite values.
#[must_use]
pub fn parse(bytes: &[u8]) -> Option<Packet<'_>> {
    fn word(bytes: &[u8]) -> Option<(u32, &[u8])> {
        let (word, rest) = bytes.split_first_chunk()?;
        Some((u32::from_be_bytes(*word), rest))
    }
    let rest = bytes.strip_prefix(&[6, 0, 0, 0, 36])?;
    let (device, rest) = rest.split_first_chunk()?;
    let (length, rest) = word(rest)?;
    let length = usize::try_from(length)
        .ok()
        .filter(|&length| length <= LONGEST)?;
    let (subject, rest) = rest.split_at_checked(length)?;
    let (frame, rest) = word(rest)?;
    let (part, rest) = word(rest)?;
    let rest = rest.strip_prefix(&[0, 0, 0, RATE as u8, 0, 0, 0, 1])?;
    let values = match rest.split_first() {
        None => None,
        Some((&count, rest)) if usize::from(count) == VALUES && rest.len() == 4 * VALUES => {
            let mut values = [0.0; VALUES];
            for (value, bytes) in values.iter_mut().zip(rest.chunks_exact(4)) {
                *value = f32::from_be_bytes(bytes.try_into().ok()?);
            }
            Some(values)
        }
        Some(_) => return None,
    };
    let finite = values.iter().flatten().all(|value| value.is_finite());
    finite.then_some(Packet {
        device,
        subject: std::str::from_utf8(subject).ok()?,
        frame: (frame, f32::from_bits(part)),
        values,
    })
}

/// A sender for Unreal.
pub struct LiveLink {
    targets: Targets,
    face: OneFace,
    view: View,
    device: [u8; 36],
    subject: String,
    /// Shapes that are sent, with their index.
    shapes: Box<[(usize, Parameter)]>,
    /// Yaw, pitch and roll of the head when last seen.
    turn: [f32; 3],
    at: Timestamp,
    sent: u64,
    dropped: u64,
}

impl LiveLink {
    /// Opens the sockets. `units` are the names in the order of the weights, `name` is the box's.
    ///
    /// # Errors
    /// If no socket can be opened.
    pub fn new(
        settings: LiveLinkSettings,
        name: &str,
        units: &[&str],
    ) -> Result<Self, OutputError> {
        let name = identity::name(name);
        let place = |parameter: Parameter| {
            let same = |shape: &&str| shape.eq_ignore_ascii_case(&parameter.name);
            Some((SHAPES.iter().position(same)?, parameter))
        };
        let shapes = Parameter::of_arkit(settings.derived, units).into_iter();
        let mut subject = if settings.subject.is_empty() {
            name.clone()
        } else {
            settings.subject
        };
        while subject.len() > LONGEST {
            subject.pop();
        }
        Ok(Self {
            targets: udp::open(&settings.targets)?,
            face: OneFace::new(units, &settings.view, settings.loss),
            view: settings.view,
            device: as_text(&identity::uuid(&name, "live-link")),
            subject,
            shapes: shapes.filter_map(place).collect(),
            turn: [0.0; 3],
            at: Timestamp::default(),
            sent: 0,
            dropped: 0,
        })
    }

    fn send_frame(&mut self, face: bool) {
        let values = face.then(|| {
            let mut values = [0.0; VALUES];
            for (place, shape) in &self.shapes {
                values[*place] = shape.value(self.face.weights.shown()).max(0.0);
            }
            let full = std::f32::consts::FRAC_PI_6;
            let [down, inwards, out, up] = LEFT_EYE.map(|at| values[at]);
            let left = [inwards - out, down - up, 0.0].map(|share| share * full);
            let [down, inwards, out, up] = RIGHT_EYE.map(|at| values[at]);
            let right = [out - inwards, down - up, 0.0].map(|share| share * full);
            let angles = [self.turn, left, right];
            values[SHAPES.len()..].copy_from_slice(angles.as_flattened());
            values
        });
        let frames = self.at.as_us() as f64 * 1e-6 * f64::from(RATE);
        let mut bytes = [0; LARGEST];
        let length = emit(
            &Packet {
                device: &self.device,
                subject: &self.subject,
                frame: (frames as u32, frames.fract() as f32),
                values,
            },
            &mut bytes,
        );
        for target in &mut self.targets {
            *(if target.send(&bytes[..length]) {
                &mut self.sent
            } else {
                &mut self.dropped
            }) += 1;
        }
    }
}

/// A UUID as text.
fn as_text(uuid: &[u8; 16]) -> [u8; 36] {
    let mut text = [b'-'; 36];
    let mut at = 0;
    for (i, byte) in uuid.iter().enumerate() {
        at += usize::from([4, 6, 8, 10].contains(&i));
        for digit in [byte >> 4, byte & 15] {
            text[at] = b"0123456789ABCDEF"[usize::from(digit)];
            at += 1;
        }
    }
    text
}

impl Output for LiveLink {
    fn send(&mut self, report: &Report) -> Result<(), OutputError> {
        if self.face.follow(report).is_some() {
            self.at = report.at;
            let finite = |pose: &&_| {
                crate::base::geometry::Rigid::to_homogeneous(pose)
                    .iter()
                    .all(|n| n.is_finite())
            };
            if let Some(pose) = report.sensor_from_head.filter(finite) {
                let (yaw, pitch, roll) = yaw_pitch_roll(&self.view.pose(pose).rotation);
                self.turn = [yaw, pitch, roll];
            }
            self.send_frame(!self.face.weights.is_neutral());
        }
        Ok(())
    }

    fn tally(&self) -> Tally {
        Tally {
            sent: self.sent,
            dropped: self.dropped,
            not_numbers: self.face.weights.not_numbers(),
            ..Tally::of("live_link")
        }
    }
}

impl Drop for LiveLink {
    /// A neutral face, then none.
    fn drop(&mut self) {
        if self.sent + self.dropped > 0 {
            self.face.weights.reset();
            self.turn = [0.0; 3];
            self.send_frame(true);
            self.send_frame(false);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::geometry::{Rigid, rotation_from_yaw_pitch_roll};
    use crate::output::TrackingState;
    use std::net::UdpSocket;

    #[test]
    fn what_is_written_is_read_with_and_without_a_face() {
        let device = as_text(&[0xa5; 16]);
        assert_eq!(&device, b"A5A5A5A5-A5A5-A5A5-A5A5-A5A5A5A5A5A5");
        let values = std::array::from_fn(|i| i as f32 / 61.0);
        for values in [Some(values), None] {
            let packet = Packet {
                device: &device,
                subject: "hall",
                frame: (12_345, 0.5),
                values,
            };
            let mut bytes = [0; LARGEST];
            let length = emit(&packet, &mut bytes);
            assert_eq!(length, if values.is_some() { 306 + 4 } else { 65 });
            assert_eq!(parse(&bytes[..length]), Some(packet));
            for cut in 0..length {
                assert!(parse(&bytes[..cut]).is_none_or(|packet| packet.values.is_none()));
            }
        }
    }

    #[test]
    fn shapes_stand_in_their_places_and_angles_turn_the_right_way() {
        let receiver = UdpSocket::bind("127.0.0.1:0").unwrap();
        let settings = LiveLinkSettings {
            targets: vec![receiver.local_addr().unwrap().to_string()],
            subject: "one".into(),
            ..LiveLinkSettings::default()
        };
        let units = ["AU26", "AU12L", "AU62", "AU64"];
        let mut sender = LiveLink::new(settings, "", &units).unwrap();
        let pose = Rigid::from_parts(
            nalgebra::Vector3::new(0.0, 0.0, 0.8).into(),
            rotation_from_yaw_pitch_roll(0.3, -0.2, 0.1),
        );
        let report = Report {
            user: Some(0),
            state: TrackingState::Tracking,
            weights: &[0.75, 0.5, 1.0, 0.5],
            sensor_from_head: Some(&pose),
            at: Timestamp::from_us(2_050_000),
            ..Report::default()
        };
        sender.send(&report).unwrap();
        drop(sender);
        let mut bytes = [0; 1500];
        let mut next = || {
            let length = receiver.recv(&mut bytes).unwrap();
            parse(&bytes[..length]).unwrap().values
        };
        let values = next().unwrap();
        let of = |name: &str| values[SHAPES.iter().position(|shape| *shape == name).unwrap()];
        assert_eq!(
            (of("JawOpen"), of("MouthSmileLeft"), of("MouthSmileRight")),
            (0.75, 0.5, 0.0)
        );
        // Both eyes to the subject's right, and down by 15 degrees.
        assert_eq!(
            (
                of("EyeLookInLeft"),
                of("EyeLookOutRight"),
                of("EyeLookInRight")
            ),
            (1.0, 1.0, 0.0)
        );
        let full = std::f32::consts::FRAC_PI_6;
        let eye = [full, full / 2.0, 0.0];
        let expected = [[0.3, -0.2, 0.1], eye, eye];
        for (angle, expected) in values[52..].iter().zip(expected.as_flattened()) {
            assert!((angle - expected).abs() < 1e-4, "{:?}", &values[52..]);
        }
        assert!(next().unwrap().iter().all(|value| *value == 0.0));
        assert_eq!(next(), None);
    }

    #[test]
    fn every_shape_of_the_table_has_a_place() {
        let units = crate::expression::units::Units::shipped();
        let columns = units.columns(false);
        let units: Vec<&str> = columns.iter().map(|name| name.as_str()).collect();
        for parameter in Parameter::of_arkit(true, &units) {
            let same = |shape: &&str| shape.eq_ignore_ascii_case(&parameter.name);
            assert!(SHAPES.iter().any(same), "{}", parameter.name);
        }
    }
}
