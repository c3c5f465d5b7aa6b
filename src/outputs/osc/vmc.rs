//! OSC preset `vmc`: the Virtual Motion Capture protocol, for avatars.
//!
//! As performer (default, to a marionette at port 39539): availability, time, root, the bones of head and eyes, blend shapes. As
//! assistant (to a performer at port 39540): blend shapes, and the head as a tracker. Blend shapes have the names of ARKit, VRM 0 or
//! VRM 1 (`config/rigs.toml`), or the units' own; shapes that are not measured are derived or omitted. `Apply` ends the frame, in
//! its last datagram. `OK` says whether a face is tracked (version 2.7 of the protocol).
//!
//! Coordinates are Unity's: left-handed, y up, z forward of the avatar. Ours (x to the subject's left, y down, z into the head) have
//! all three axes reversed: positions change their sign, quaternions stay the same.
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
    /// Drives a marionette completely.
    #[default]
    Performer,
    /// Adds the face to a performer's data.
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
    /// Gaze to the subject's left and up; `None` if it is not measured or not sent.
    gaze: Option<[Parameter; 2]>,
    /// Capture time of the last frame, seconds.
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
        Ok(Self::with_targets(targets, settings, units))
    }

    /// As [`Self::new`], but with these targets instead of the configured ones.
    pub fn with_targets(targets: Targets, settings: Settings, units: &[&str]) -> Self {
        let shapes = match settings.names {
            Names::Arkit => Parameter::arkit(settings.derived, units),
            Names::Vrm0 => Parameter::for_rig("vrm0", units),
            Names::Vrm1 => Parameter::for_rig("vrm1", units),
            Names::Units => Parameter::for_units(units.iter().map(|unit| settings.view.name(unit))),
        };
        let gaze = ["AU61 - AU62", "AU63 - AU64"].map(|sum| Parameter::parse_sum("", sum, units));
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
            // Loaded (1), calibrated (3), normal mode (0).
            let ok = [1, 3, 0, tracked.into()].map(Argument::Int);
            wire.message(format_args!("/OK"), ok);
            wire.message(format_args!("/T"), [Argument::Float(self.seconds)]);
            let root = transform_arguments("root", [0.0; 3], [0.0, 0.0, 0.0, 1.0]);
            wire.message(format_args!("/Root/Pos"), root);
        }
        if let Some([x, y, z, rotation @ ..]) = pose {
            let (address, position) = match self.role {
                // The head bone stays on the neck.
                Role::Performer => (format_args!("/Bone/Pos"), [0.0; 3]),
                Role::Assistant => (format_args!("/Tra/Pos"), [-x, -y, -z]),
            };
            wire.message(address, transform_arguments("Head", position, rotation));
        }
        if let Some(gaze) = &self.gaze {
            let value = |direction: &Parameter| direction.value(self.face.weights.shown());
            let rotation = eye_turn(gaze.each_ref().map(value));
            for eye in ["LeftEye", "RightEye"] {
                let eye = transform_arguments(eye, [0.0; 3], rotation);
                wire.message(format_args!("/Bone/Pos"), eye);
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

/// Rotation of an eye in the head, quaternion x, y, z, w, for a gaze of −1…1 to the subject's left and up; 30° at weight 1.
fn eye_turn(gaze: [f32; 2]) -> [f32; 4] {
    let [yaw, pitch] = gaze.map(|share| -0.5 * share * core::f32::consts::FRAC_PI_6);
    let ((sy, cy), (sx, cx)) = (yaw.sin_cos(), pitch.sin_cos());
    [cy * sx, sy * cx, -sy * sx, cy * cx]
}

/// Arguments of a bone or tracker: name, position, quaternion x, y, z, w.
fn transform_arguments(
    name: &str,
    position: [f32; 3],
    rotation: [f32; 4],
) -> impl Iterator<Item = Argument<'_>> + Clone {
    let numbers = position.into_iter().chain(rotation).map(Argument::Float);
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
    /// Sends a neutral face that is not tracked.
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
