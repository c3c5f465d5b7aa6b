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
//! subject's left shoulder. Eyes turn 30° at weight 1. Shapes that are not measured are 0. Not tested with Unreal: the signs of
//! the angles are derived from its axes.

use super::features::LiveLinkSettings;
use super::osc::parameters::Parameter;
use super::osc::{Sender, udp};
use super::{OneFace, Output, OutputError, Report, Tally, identity};
use mien_stages::base::time::Timestamp;

/// The shapes in the order of the protocol: ARKit's names with an upper-case first letter.
#[rustfmt::skip]
const SHAPES: [&str; 52] = [
    "EyeBlinkLeft", "EyeLookDownLeft", "EyeLookInLeft", "EyeLookOutLeft", "EyeLookUpLeft", "EyeSquintLeft",
    "EyeWideLeft", "EyeBlinkRight", "EyeLookDownRight", "EyeLookInRight", "EyeLookOutRight", "EyeLookUpRight",
    "EyeSquintRight", "EyeWideRight", "JawForward", "JawLeft", "JawRight", "JawOpen", "MouthClose", "MouthFunnel",
    "MouthPucker", "MouthLeft", "MouthRight", "MouthSmileLeft", "MouthSmileRight", "MouthFrownLeft",
    "MouthFrownRight", "MouthDimpleLeft", "MouthDimpleRight", "MouthStretchLeft", "MouthStretchRight",
    "MouthRollLower", "MouthRollUpper", "MouthShrugLower", "MouthShrugUpper", "MouthPressLeft", "MouthPressRight",
    "MouthLowerDownLeft", "MouthLowerDownRight", "MouthUpperUpLeft", "MouthUpperUpRight", "BrowDownLeft",
    "BrowDownRight", "BrowInnerUp", "BrowOuterUpLeft", "BrowOuterUpRight", "CheekPuff", "CheekSquintLeft",
    "CheekSquintRight", "NoseSneerLeft", "NoseSneerRight", "TongueOut",
];
/// Shapes and angles.
const VALUES: usize = SHAPES.len() + 9;
/// Indices in [`SHAPES`] of the left eye's gaze: down, in, out, up.
const LEFT_EYE: [usize; 4] = [1, 2, 3, 4];
/// Indices in [`SHAPES`] of the right eye's gaze: down, in, out, up.
const RIGHT_EYE: [usize; 4] = [8, 9, 10, 11];
/// Frames a second.
const RATE: u32 = 30;
/// Longest name of a subject, bytes.
const LONGEST: usize = 64;
/// Bytes of the longest datagram.
const LARGEST: usize = 1 + 4 + 36 + 4 + LONGEST + 16 + 1 + 4 * VALUES;

/// A sender for Unreal.
pub struct LiveLink {
    to: Sender,
    face: OneFace,
    device: String,
    subject: String,
    /// Measured shapes, with their index in [`SHAPES`].
    shapes: Box<[(usize, Parameter)]>,
    /// Last yaw, pitch and roll of the head, radians.
    head_angles: [f32; 3],
    at: Timestamp,
}

impl LiveLink {
    /// Opens the sockets. `units` are the names in the order of the weights, `name` is the name of the box.
    ///
    /// # Errors
    /// If no socket can be opened.
    pub fn new(
        settings: LiveLinkSettings,
        name: &str,
        units: &[&str],
    ) -> Result<Self, OutputError> {
        let name = identity::name(name);
        let index = |parameter: Parameter| {
            let same = |shape: &&str| shape.eq_ignore_ascii_case(&parameter.name);
            Some((SHAPES.iter().position(same)?, parameter))
        };
        let shapes = Parameter::arkit(settings.derived, units).into_iter();
        let subject = Some(settings.subject).filter(|subject| !subject.is_empty());
        let mut subject = subject.unwrap_or_else(|| name.clone());
        while subject.len() > LONGEST {
            subject.pop();
        }
        Ok(Self {
            to: udp::open(&settings.targets)?.into(),
            face: OneFace::new(units, &settings.view),
            device: as_text(identity::uuid(&name)),
            subject,
            shapes: shapes.filter_map(index).collect(),
            head_angles: [0.0; 3],
            at: Timestamp::default(),
        })
    }

    fn send_frame(&mut self, face: bool) {
        let values = face.then(|| {
            let mut values = [0.0; VALUES];
            for (index, shape) in &self.shapes {
                values[*index] = shape.value(self.face.weights.shown()).max(0.0);
            }
            let full = std::f32::consts::FRAC_PI_6;
            let [down, inwards, out, up] = LEFT_EYE.map(|at| values[at]);
            let left = [inwards - out, down - up, 0.0].map(|share| share * full);
            let [down, inwards, out, up] = RIGHT_EYE.map(|at| values[at]);
            let right = [out - inwards, down - up, 0.0].map(|share| share * full);
            let angles = [self.head_angles, left, right];
            values[SHAPES.len()..].copy_from_slice(angles.as_flattened());
            values
        });
        self.to.send(&self.emit(values.as_ref()));
    }

    /// Formats a datagram. `values` are the shapes, then yaw, pitch and roll of the head, the left and the right eye; `None` without
    /// a face.
    fn emit(&self, values: Option<&[f32; VALUES]>) -> heapless::Vec<u8, LARGEST> {
        let mut bytes = heapless::Vec::new();
        // Always fits: the buffer has room for the longest subject.
        let mut append = |part: &[u8]| bytes.extend_from_slice(part).unwrap_or_default();
        append(&[6]);
        append(&36_u32.to_be_bytes());
        append(self.device.as_bytes());
        append(&(self.subject.len() as u32).to_be_bytes());
        append(self.subject.as_bytes());
        let frames = self.at.as_us() as f64 * 1e-6 * f64::from(RATE);
        for word in [frames as u32, (frames.fract() as f32).to_bits(), RATE, 1] {
            append(&word.to_be_bytes());
        }
        if let Some(values) = values {
            append(&[VALUES as u8]);
            values.iter().for_each(|value| append(&value.to_be_bytes()));
        }
        bytes
    }
}

/// A UUID as text.
fn as_text(uuid: [u8; 16]) -> String {
    let n = u128::from_be_bytes(uuid);
    let [a, b, c] = [80, 64, 48].map(|shift| (n >> shift) as u16);
    let last = n & 0xffff_ffff_ffff;
    format!("{:08X}-{a:04X}-{b:04X}-{c:04X}-{last:012X}", n >> 96)
}

impl Output for LiveLink {
    fn send(&mut self, report: &Report) -> Result<(), OutputError> {
        if self.face.follow(report).is_some() {
            self.at = report.at;
            self.head_angles = self.face.view.angles(report).unwrap_or(self.head_angles);
            self.send_frame(!self.face.weights.is_neutral());
        }
        Ok(())
    }

    fn tally(&self) -> Tally {
        self.to.tally("live_link", self.face.weights.not_numbers)
    }
}

impl Drop for LiveLink {
    /// Sends a neutral face, then none.
    fn drop(&mut self) {
        if self.to.is_used() {
            self.face.weights.reset();
            self.head_angles = [0.0; 3];
            self.send_frame(true);
            self.send_frame(false);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::TrackingState;
    use mien_stages::base::geometry::{Rigid, rotation_from_yaw_pitch_roll};
    use std::net::UdpSocket;

    fn sender(targets: Vec<String>, units: &[&str]) -> LiveLink {
        let settings = LiveLinkSettings {
            targets,
            subject: "hall".into(),
            ..LiveLinkSettings::default()
        };
        LiveLink::new(settings, "", units).unwrap()
    }

    #[test]
    fn a_datagram_is_the_one_that_pylivelinkface_writes() {
        let mut sender = sender(vec!["127.0.0.1:9".into()], &[]);
        sender.device = as_text([0xa5; 16]);
        // 12,345.5 frames.
        sender.at = Timestamp::from_us(411_516_667);
        let values: [f32; VALUES] = std::array::from_fn(|i| i as f32 / 64.0);
        // PyLiveLinkFace 0.1, encode() with this name, UUID, frame and values; its denominator at this rate is 0, the app's 1.
        let mut expected =
            b"\x06\0\0\0$A5A5A5A5-A5A5-A5A5-A5A5-A5A5A5A5A5A5\0\0\0\x04hall\0\0\x30\x39".to_vec();
        let bytes = sender.emit(Some(&values));
        assert_eq!(bytes[..expected.len()], expected);
        let subframe = f32::from_be_bytes(*bytes[expected.len()..].first_chunk().unwrap());
        assert!((subframe - 0.5).abs() < 1e-3, "{subframe}");
        expected = b"\0\0\0\x1e\0\0\0\x01\x3d\0\0\0\0\x3c\x80\0\0\x3d\0\0\0\x3d\x40\0\0".to_vec();
        assert_eq!(bytes[57..][..expected.len()], expected);
        assert_eq!(bytes[306..], [0x3f, 0x70, 0, 0]);
        assert_eq!(sender.emit(None).len(), 65);
    }

    #[test]
    fn shapes_stand_in_their_places_and_angles_turn_the_right_way() {
        let receiver = UdpSocket::bind("127.0.0.1:0").unwrap();
        let units = ["AU26", "AU12L", "AU62", "AU64"];
        let targets = vec![receiver.local_addr().unwrap().to_string()];
        let mut sender = sender(targets, &units);
        let pose = Rigid::from_parts(
            nalgebra::Vector3::new(0.0, 0.0, 0.8).into(),
            rotation_from_yaw_pitch_roll(0.3, -0.2, 0.1),
        );
        let report = Report {
            user: Some(0),
            state: TrackingState::Tracking,
            weights: &[0.75, 0.5, 1.0, 0.5],
            sensor_from_face: Some(&pose),
            at: Timestamp::from_us(2_050_000),
            ..Report::default()
        };
        sender.send(&report).unwrap();
        drop(sender);
        let mut bytes = [0; 1500];
        let mut next = || {
            let length = receiver.recv(&mut bytes).unwrap();
            let values = bytes[..length].get(66..)?.chunks_exact(4);
            let values: Vec<f32> = values
                .map(|four| f32::from_be_bytes(*four.first_chunk().unwrap()))
                .collect();
            Some(values)
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
        let units = mien_stages::expression::units::Units::shipped();
        let columns = units.columns(false);
        let units: Vec<&str> = columns.iter().map(|name| name.as_str()).collect();
        for parameter in Parameter::arkit(true, &units) {
            let same = |shape: &&str| shape.eq_ignore_ascii_case(&parameter.name);
            assert!(SHAPES.iter().any(same), "{}", parameter.name);
        }
    }
}
