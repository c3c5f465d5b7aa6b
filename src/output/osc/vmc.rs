//! OSC preset `vmc`: the Virtual Motion Capture protocol, for avatars.
//!
//! As performer (default, to a marionette at port 39539): availability, time, root, the bone `Head`, blend shapes. As assistant
//! (to a performer at port 39540): blend shapes, and the head as a tracker. Blend shapes have the names of ARKit, of VRM 0 or
//! VRM 1 (`config/rigs.toml`), or the units' own; only those that are measured are sent. `Apply` closes the frame, in the last
//! datagram. `OK` tells whether a face is tracked (version 2.7 of the protocol).
//!
//! Coordinates are Unity's: left-handed, y up, z forward of the avatar. Ours, mirrored in all three axes (x to the
//! subject's left, y down, z into the head), are exactly that: positions change their sign and rotations keep their numbers.
//! One face: the first seen, until lost.

use super::packet::Argument;
use super::parameters::{Parameter, Rig};
use super::wire::{Targets, Wire};
use crate::base::defaults;
use crate::base::geometry::Rigid;
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;
use crate::output::{LossPolicy, OneFace, Output, OutputError, Report, Tally, View};

/// Calibrated, in normal mode: what `OK` says of the sender's own avatar.
const CALIBRATED: [i32; 2] = [3, 0];

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

defaults! {
    /// Settings of the VMC output.
    #[derive(Clone, Debug, PartialEq)]
    pub struct Settings {
        /// Whether this output is enabled.
        pub enabled: bool = false,
        /// Each `host:port`.
        pub targets: Vec<String> = vec!["127.0.0.1:39539".to_owned()],
        /// This program's role, as the receiver sees it.
        pub role: Role = Role::default(),
        /// Naming scheme of the blend shapes.
        pub names: Names = Names::default(),
        /// Names, gains and mirroring of the units.
        pub view: View = View::default(),
        /// What is sent when a face is lost.
        pub loss: LossPolicy = LossPolicy::default(),
    }
}

/// A sender of avatar movements.
pub struct Vmc {
    wire: Wire,
    role: Role,
    view: View,
    face: OneFace,
    shapes: Box<[Parameter]>,
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
    #[must_use]
    pub fn over(targets: Targets, settings: Settings, units: &[&str]) -> Self {
        let shapes = match settings.names {
            Names::Arkit => Parameter::of_rig(Rig::Arkit, units),
            Names::Vrm0 => Parameter::of_rig(Rig::Vrm0, units),
            Names::Vrm1 => Parameter::of_rig(Rig::Vrm1, units),
            Names::Units => Parameter::of_units(units.iter().map(|unit| settings.view.name(unit))),
        };
        Self {
            wire: Wire::new(targets, "/VMC/Ext".to_owned()),
            role: settings.role,
            face: OneFace::new(units, &settings.view, settings.loss),
            view: settings.view,
            shapes,
            seconds: 0.0,
        }
    }

    fn send_frame(&mut self, tracked: bool, sensor_from_head: Option<&Rigid>) {
        let wire = &mut self.wire;
        if self.role == Role::Performer {
            let [state, mode] = CALIBRATED;
            let ok = [1, state, mode, tracked.into()].map(Argument::Int);
            wire.message(format_args!("/OK"), ok.into_iter());
            wire.message(
                format_args!("/T"),
                core::iter::once(Argument::Float(self.seconds)),
            );
            wire.message(
                format_args!("/Root/Pos"),
                placed("root", [0.0; 3], [0.0, 0.0, 0.0, 1.0]),
            );
        }
        let pose = sensor_from_head.map(|pose| self.view.pose(pose));
        let pose = pose.map(|pose| (pose.translation.vector, pose.rotation.coords));
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
            let value = shape.value(self.face.weights.shown()).max(0.0);
            let arguments = [Argument::Text(&shape.name), Argument::Float(value)];
            wire.message(format_args!("/Blend/Val"), arguments.into_iter());
        }
        wire.message(format_args!("/Blend/Apply"), core::iter::empty());
        wire.flush();
    }
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
            let present = state.is_present();
            self.send_frame(present, report.sensor_from_head.filter(|_| present));
        }
        Ok(())
    }

    fn tally(&self) -> Tally {
        Tally {
            sent: self.wire.sent(),
            dropped: self.wire.dropped(),
            not_numbers: self.face.weights.not_numbers(),
            ..Tally::of("vmc")
        }
    }
}

impl Drop for Vmc {
    /// Neutral.
    fn drop(&mut self) {
        if !self.wire.is_used() {
            return;
        }
        self.face.weights.reset();
        self.send_frame(false, None);
    }
}
