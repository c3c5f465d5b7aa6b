//! OSC preset `vmc`: the Virtual Motion Capture protocol, for avatars.
//!
//! As performer (default, to a marionette at port 39539): availability, time, root, the bone `Head`, blend shapes. As assistant
//! (to a performer at port 39540): blend shapes, and the head as a tracker. Blend shapes have ARKit's names; only those
//! that are measured are sent. `Apply` closes the frame, in the last datagram.
//!
//! Coordinates are Unity's: left-handed, y up, z forward of the avatar. Ours, mirrored in all three axes (x to the
//! subject's left, y down, z into the head), are exactly that: positions change their sign and rotations keep their numbers.
//! One face: the first seen, until lost.

use super::packet::Argument;
use super::parameters::{Definition, Parameter, plain};
use super::wire::Wire;
use crate::geometry::Rigid;
use crate::output::{LossPolicy, OneFace, Output, OutputError, Report};

/// What this programme is to the receiver.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Role {
    /// Sends all a marionette needs.
    #[default]
    Performer,
    /// Helps a performer with the face.
    Assistant,
}

/// Where and how it goes.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Whether anything is sent.
    pub enabled: bool,
    /// `host:port`.
    pub target: String,
    /// What this programme is to the receiver.
    pub role: Role,
    /// What is sent of a face that is lost.
    pub loss: LossPolicy,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            enabled: false,
            target: "127.0.0.1:39539".to_owned(),
            role: Role::default(),
            loss: LossPolicy::default(),
        }
    }
}

/// ARKit's blend shapes in terms of action units.
const SHAPES: [Definition; 44] = [
    plain("browInnerUp", &[(1.0, &["AU1L", "AU1R", "AU1"])]),
    plain("browOuterUpLeft", &[(1.0, &["AU2L", "AU2"])]),
    plain("browOuterUpRight", &[(1.0, &["AU2R", "AU2"])]),
    plain("browDownLeft", &[(1.0, &["AU4L", "AU4"])]),
    plain("browDownRight", &[(1.0, &["AU4R", "AU4"])]),
    plain("eyeWideLeft", &[(1.0, &["AU5L", "AU5"])]),
    plain("eyeWideRight", &[(1.0, &["AU5R", "AU5"])]),
    plain("cheekSquintLeft", &[(1.0, &["AU6L", "AU6"])]),
    plain("cheekSquintRight", &[(1.0, &["AU6R", "AU6"])]),
    plain("eyeSquintLeft", &[(1.0, &["AU7L", "AU7"])]),
    plain("eyeSquintRight", &[(1.0, &["AU7R", "AU7"])]),
    plain("noseSneerLeft", &[(1.0, &["AU9L", "AU9"])]),
    plain("noseSneerRight", &[(1.0, &["AU9R", "AU9"])]),
    plain("mouthUpperUpLeft", &[(1.0, &["AU10L", "AU10"])]),
    plain("mouthUpperUpRight", &[(1.0, &["AU10R", "AU10"])]),
    plain("mouthSmileLeft", &[(1.0, &["AU12L", "AU12"])]),
    plain("mouthSmileRight", &[(1.0, &["AU12R", "AU12"])]),
    plain("mouthDimpleLeft", &[(1.0, &["AU14L", "AU14"])]),
    plain("mouthDimpleRight", &[(1.0, &["AU14R", "AU14"])]),
    plain("mouthFrownLeft", &[(1.0, &["AU15L", "AU15"])]),
    plain("mouthFrownRight", &[(1.0, &["AU15R", "AU15"])]),
    plain("mouthLowerDownLeft", &[(1.0, &["AU16L", "AU16"])]),
    plain("mouthLowerDownRight", &[(1.0, &["AU16R", "AU16"])]),
    plain("mouthShrugLower", &[(1.0, &["AU17"])]),
    plain("mouthPucker", &[(1.0, &["AU18"])]),
    plain("mouthStretchLeft", &[(1.0, &["AU20L", "AU20"])]),
    plain("mouthStretchRight", &[(1.0, &["AU20R", "AU20"])]),
    plain("mouthFunnel", &[(1.0, &["AU22"])]),
    plain("mouthPressLeft", &[(1.0, &["AU24L", "AU24"])]),
    plain("mouthPressRight", &[(1.0, &["AU24R", "AU24"])]),
    plain("jawOpen", &[(1.0, &["AU26", "AU27"])]),
    plain("mouthRollLower", &[(1.0, &["AU28"])]),
    plain("mouthRollUpper", &[(1.0, &["AU28"])]),
    plain("jawForward", &[(1.0, &["AU29"])]),
    plain("jawLeft", &[(1.0, &["AU30L"])]),
    plain("jawRight", &[(1.0, &["AU30R"])]),
    plain("cheekPuff", &[(1.0, &["AU33", "AU34"])]),
    plain("eyeBlinkLeft", &[(1.0, &["AU43L", "AU43", "AU45L"])]),
    plain("eyeBlinkRight", &[(1.0, &["AU43R", "AU43", "AU45R"])]),
    plain("eyeLookInLeft", &[(1.0, &["AU62L"])]),
    plain("eyeLookInRight", &[(1.0, &["AU61R"])]),
    plain("eyeLookOutLeft", &[(1.0, &["AU61L"])]),
    plain("eyeLookOutRight", &[(1.0, &["AU62R"])]),
    plain("tongueOut", &[(1.0, &["AU19"])]),
];

/// A sender of avatar movements.
pub struct Vmc {
    wire: Wire,
    role: Role,
    face: OneFace,
    shapes: Box<[Parameter]>,
}

impl Vmc {
    /// Opens the socket. `units` are the names in the order of the weights.
    ///
    /// # Errors
    /// If the target is unusable, or there is no socket to be had.
    pub fn new(settings: Settings, units: &[&str]) -> Result<Self, OutputError> {
        Ok(Self {
            wire: Wire::open(settings.target, "/VMC/Ext".to_owned())?,
            role: settings.role,
            face: OneFace::new(units.len(), settings.loss),
            shapes: Parameter::resolve(&SHAPES, units),
        })
    }

    /// Datagrams sent, and those that could not be.
    #[must_use]
    pub fn sent_and_dropped(&self) -> (u64, u64) {
        (self.wire.sent(), self.wire.dropped())
    }

    fn send_frame(&mut self, seconds: f32, sensor_from_head: Option<&Rigid>) {
        let wire = &mut self.wire;
        if self.role == Role::Performer {
            wire.message(format_args!("/OK"), std::iter::once(Argument::Int(1)));
            wire.message(
                format_args!("/T"),
                std::iter::once(Argument::Float(seconds)),
            );
            wire.message(
                format_args!("/Root/Pos"),
                placed("root", [0.0; 3], [0.0, 0.0, 0.0, 1.0]),
            );
        }
        let pose = sensor_from_head.map(|pose| (pose.translation.vector, pose.rotation.coords));
        if let Some((place, turn)) =
            pose.filter(|(p, q)| p.iter().chain(q.iter()).all(|number| number.is_finite()))
        {
            // nalgebra keeps quaternions as x, y, z, w.
            let turn = turn.into();
            match self.role {
                // The bone keeps its place on the neck.
                Role::Performer => {
                    wire.message(format_args!("/Bone/Pos"), placed("Head", [0.0; 3], turn))
                }
                Role::Assistant => wire.message(
                    format_args!("/Tra/Pos"),
                    placed("Head", (-place).into(), turn),
                ),
            }
        }
        for shape in &self.shapes {
            let value = shape.value(self.face.weights.shown());
            let arguments = [Argument::Text(shape.name), Argument::Float(value)];
            wire.message(format_args!("/Blend/Val"), arguments.into_iter());
        }
        wire.message(format_args!("/Blend/Apply"), std::iter::empty());
        wire.flush();
    }
}

/// A name, a place and a rotation.
fn placed(
    name: &str,
    place: [f32; 3],
    turn: [f32; 4],
) -> impl Iterator<Item = Argument<'_>> + Clone {
    let numbers = place.into_iter().chain(turn).map(Argument::Float);
    std::iter::once(Argument::Text(name)).chain(numbers)
}

impl Output for Vmc {
    fn send(&mut self, report: &Report) -> Result<(), OutputError> {
        if let Some(state) = self.face.follow(report) {
            let seconds = (report.at.as_us() as f64 * 1e-6) as f32;
            self.send_frame(
                seconds,
                report.sensor_from_head.filter(|_| state.is_present()),
            );
        }
        Ok(())
    }
}

impl Drop for Vmc {
    /// Neutral.
    fn drop(&mut self) {
        self.face.weights.reset();
        self.send_frame(0.0, None);
    }
}
