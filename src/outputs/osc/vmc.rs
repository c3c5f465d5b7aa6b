//! OSC preset `vmc`: the Virtual Motion Capture protocol, for avatars.
//!
//! As performer (default, to a marionette at port 39539): availability, time, root, the bones of head and eyes, blend shapes. As assistant
//! (to a performer at port 39540): blend shapes, and the head as a tracker. Blend shapes have the names of ARKit, of VRM 0 or
//! VRM 1 (`config/rigs.toml`), or the units' own; those that are not measured are derived, or left out. `Apply` closes the frame, in the last
//! datagram. `OK` tells whether a face is tracked (version 2.7 of the protocol).
//!
//! Coordinates are Unity's: left-handed, y up, z forward of the avatar. Ours, mirrored in all three axes (x to the
//! subject's left, y down, z into the head), are exactly that: positions change their sign and rotations keep their numbers.
//! One face: the first seen, until lost.

use super::packet::Argument;
use super::parameters::Parameter;
use super::wire::{Targets, Wire};
use crate::{OneFace, Output, OutputError, Report, Tally, View};
use mien_stages::base::prelude::*;
use mien_stages::base::settings::keyed;

/// This program's role, as the receiver sees it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Role {
    /// Sends everything a marionette needs.
    #[default]
    Performer,
    /// Helps a performer with the face.
    Assistant,
}

/// Naming scheme of the blend shapes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Names {
    /// Apple's ARKit.
    #[default]
    Arkit,
    /// Avatars of VRM 0.
    Vrm0,
    /// Avatars of VRM 1.
    Vrm1,
    /// The units' own, as configured.
    Units,
}

keyed! {
    /// Settings of the VMC output.
    pub struct Settings {
        /// Whether this output is enabled.
        enabled: bool = false => Bool(),
        /// Destinations: hosts, broadcast addresses or multicast groups.
        targets "target": Vec<String> = vec!["127.0.0.1:39539".to_owned()] => targets(),
        /// This program's role, as the receiver sees it.
        role: Role = Role::default() => choice(&[("performer", Role::Performer), ("assistant", Role::Assistant)]),
        /// Names of the blend shapes: ARKit's, VRM avatars', or the units' own.
        names: Names = Names::default() =>
            choice(&[("arkit", Names::Arkit), ("vrm0", Names::Vrm0), ("vrm1", Names::Vrm1), ("units", Names::Units)]),
        /// Whether ARKit shapes that are not measured are derived from related ones, such as raised cheeks from a smile.
        derived: bool = true => Bool(),
        /// Whether the gaze turns the bones of the eyes.
        eyes: bool = true => Bool(),
        ..view: View,
    }
}

/// A sender of avatar movements.
pub struct Vmc {
    wire: Wire,
    role: Role,
    face: OneFace,
    shapes: Vec<Parameter>,
    /// Gaze to the subject's left and up; none if it is not measured or not wanted.
    gaze: Option<[Parameter; 2]>,
    /// Time of the last frame.
    seconds: f32,
}

impl Vmc {
    /// Opens the sockets. `units` are the names in the order of the weights.
    ///
    /// # Errors
    /// If a target is unusable or no socket can be opened.
    #[cfg(feature = "std")]
    pub fn new(settings: Settings, units: &[&str]) -> Result<Self, OutputError> {
        let targets = super::udp::open(&settings.targets)?;
        Ok(Self::over(targets, settings, units))
    }

    /// As [`Self::new`], but to these targets instead of the configured ones.
    pub fn over(targets: Targets, settings: Settings, units: &[&str]) -> Self {
        let shapes = match settings.names {
            Names::Arkit => Parameter::of_arkit(settings.derived, units),
            Names::Vrm0 => Parameter::of_rig("vrm0", units),
            Names::Vrm1 => Parameter::of_rig("vrm1", units),
            Names::Units => Parameter::of_units(units.iter().map(|unit| settings.view.name(unit))),
        };
        let gaze = ["AU61 - AU62", "AU63 - AU64"].map(|sum| Parameter::of_sum("", sum, units));
        let [left, up] = gaze;
        let gaze = left.zip(up).map(|(left, up)| [left, up]);
        Self {
            wire: Wire::new(targets, "/VMC/Ext".to_owned()),
            role: settings.role,
            face: OneFace::new(units, &settings.view),
            shapes,
            gaze: gaze.filter(|_| settings.eyes && settings.role == Role::Performer),
            seconds: 0.0,
        }
    }

    fn send_frame(&mut self, tracked: bool, pose: Option<[f32; 7]>) {
        let wire = &mut self.wire;
        if self.role == Role::Performer {
            // Loaded, calibrated, in normal mode: the sender's own avatar.
            let ok = [1, 3, 0, tracked.into()].map(Argument::Int);
            wire.message(format_args!("/OK"), ok);
            wire.message(format_args!("/T"), [Argument::Float(self.seconds)]);
            let root = placed("root", [0.0; 3], [0.0, 0.0, 0.0, 1.0]);
            wire.message(format_args!("/Root/Pos"), root);
        }
        if let Some([x, y, z, turn @ ..]) = pose {
            let (address, place) = match self.role {
                // The bone keeps its place on the neck.
                Role::Performer => (format_args!("/Bone/Pos"), [0.0; 3]),
                Role::Assistant => (format_args!("/Tra/Pos"), [-x, -y, -z]),
            };
            wire.message(address, placed("Head", place, turn));
        }
        if let Some(gaze) = &self.gaze {
            let value = |way: &Parameter| way.value(self.face.weights.shown());
            let turn = eye_turn(gaze.each_ref().map(value));
            for eye in ["LeftEye", "RightEye"] {
                wire.message(format_args!("/Bone/Pos"), placed(eye, [0.0; 3], turn));
            }
        }
        for shape in &self.shapes {
            let value = shape.value(self.face.weights.shown()).max(0.0);
            let arguments = [Argument::Text(&shape.name), Argument::Float(value)];
            wire.message(format_args!("/Blend/Val"), arguments);
        }
        wire.message(format_args!("/Blend/Apply"), []);
        wire.flush();
    }
}

/// Rotation of an eye in its head, x, y, z, w: gaze of 0…1 to the subject's left and up, 30° at full weight as in Live Link.
fn eye_turn(gaze: [f32; 2]) -> [f32; 4] {
    let [yaw, pitch] = gaze.map(|share| -0.5 * share * core::f32::consts::FRAC_PI_6);
    let ((sy, cy), (sx, cx)) = (yaw.sin_cos(), pitch.sin_cos());
    [cy * sx, sy * cx, -sy * sx, cy * cx]
}

/// A name, a position and a rotation.
fn placed(
    name: &str,
    place: [f32; 3],
    turn: [f32; 4],
) -> impl Iterator<Item = Argument<'_>> + Clone {
    let numbers = place.into_iter().chain(turn).map(Argument::Float);
    core::iter::once(Argument::Text(name)).chain(numbers)
}

impl Output for Vmc {
    fn send(&mut self, report: &Report) -> Result<(), OutputError> {
        if let Some(state) = self.face.follow(report) {
            self.seconds = (report.at.as_us() as f64 * 1e-6) as f32;
            self.send_frame(state.is_present(), self.face.view.pose_numbers(report));
        }
        Ok(())
    }

    fn tally(&self) -> Tally {
        self.wire.to.tally("vmc", self.face.weights.not_numbers)
    }
}

impl Drop for Vmc {
    /// Neutral.
    fn drop(&mut self) {
        if self.wire.to.is_used() {
            self.face.weights.reset();
            self.send_frame(false, None);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mien_stages::base::geometry::Vector;
    use nalgebra::{Quaternion, UnitQuaternion};

    #[test]
    fn eyes_turn_to_where_they_look() {
        let looks = |gaze| {
            let [x, y, z, w] = eye_turn(gaze);
            UnitQuaternion::new_unchecked(Quaternion::new(w, x, y, z)) * -Vector::z()
        };
        // x to the subject's left, y down, z into the head.
        for (gaze, towards) in [
            ([0.0, 0.0], [0.0, 0.0, -1.0]),
            ([1.0, 0.0], [0.5, 0.0, -0.75_f32.sqrt()]),
            ([0.0, 1.0], [0.0, -0.5, -0.75_f32.sqrt()]),
            ([-1.0, -1.0], [-0.433, 0.5, -0.75]),
        ] {
            let off = looks(gaze) - Vector::from(towards);
            assert!(off.norm() < 1e-3, "{gaze:?}: {:?}", looks(gaze));
        }
    }
}
