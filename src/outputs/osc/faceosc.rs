//! OSC preset `faceosc`: the raw distances of FaceOSC, expected by many sketches in Processing, Max and Pd.
//!
//! `/found` alone, then one bundle per frame: `/pose/position` in pixels, `/pose/scale`, `/pose/orientation` in radians
//! (pitch, yaw, roll), and `/gesture/…`. Gestures are distances on the face with the head pose removed, in FaceOSC's
//! unit of about 3.6 mm (a mouth is about 14 wide); the scale is pixels per unit. Left and right are the subject's own;
//! mirroring swaps them and reflects the image. One face: the first seen, until lost. A lost face is held for `hold_s`, then
//! reported as not found, because distances have no neutral value to fade to.

use super::packet::Argument;
use super::wire::{Targets, Wire};
use crate::{Every, LossPolicy, OneFace, Output, OutputError, Report, Tally, View, finite};
use mien_stages::base::capacity::WIDTH;
use mien_stages::base::geometry::{Point, Rigid, Vector, yaw_pitch_roll};
use mien_stages::base::prelude::*;
use mien_stages::base::settings::keyed;
use mien_stages::base::time::Timestamp;
use mien_stages::landmarks::Landmarks;

/// FaceOSC's unit of length, metres.
const UNIT_M: f32 = 0.0036;
/// Interval at which `/found` is repeated, seconds.
const FOUND_S: f64 = 1.0;

keyed! {
    /// Settings of the FaceOSC output, which has no units.
    pub struct Settings {
        /// Whether this output is enabled.
        enabled: bool = false => Bool(),
        /// Destinations: hosts, broadcast addresses or multicast groups.
        targets "target": Vec<String> = vec!["127.0.0.1:8338".to_owned()] => targets(),
        /// Whether left and right are swapped, as in a mirror.
        mirror: bool = false => Bool(),
        /// How long a lost face is held.
        hold_s: f32 = LossPolicy::default().hold_s => seconds(),
    }
}

/// Gestures: the name, and two groups of landmarks; the value is the distance between their means.
const GESTURES: [(&str, &[usize], &[usize]); 8] = [
    ("mouth/width", &[48], &[54]),
    ("mouth/height", &[61, 62, 63], &[65, 66, 67]),
    ("eyebrow/left", &[22, 23, 24, 25, 26], &[42, 45]),
    ("eyebrow/right", &[17, 18, 19, 20, 21], &[36, 39]),
    ("eye/left", &[43, 44], &[46, 47]),
    ("eye/right", &[37, 38], &[40, 41]),
    ("jaw", &[33], &[7, 8, 9]),
    ("nostrils", &[31], &[35]),
];
/// Indices in [`GESTURES`] with left and right swapped.
const MIRRORED: [usize; 8] = [0, 1, 3, 2, 5, 4, 6, 7];

/// Values of a face in one frame.
#[derive(Clone, Copy)]
struct Numbers {
    /// Position (2, pixels), scale (pixels per unit), orientation (3, radians).
    pose: [f32; 6],
    gestures: [f32; 8],
}

/// A sender of raw distances.
pub struct FaceOsc {
    wire: Wire,
    face: OneFace,
    found: bool,
    repeat: Every,
    /// Values and capture time of the last face.
    last: Option<(Numbers, Timestamp)>,
}

impl FaceOsc {
    /// Opens the sockets.
    ///
    /// # Errors
    /// If a target is unusable or no socket can be opened.
    #[cfg(feature = "std")]
    pub fn new(settings: Settings) -> Result<Self, OutputError> {
        let targets = super::udp::open(&settings.targets)?;
        Ok(Self::with_targets(targets, settings))
    }

    /// As [`Self::new`], but with these targets instead of the configured ones.
    pub fn with_targets(targets: Targets, settings: Settings) -> Self {
        let view = View {
            mirror: settings.mirror,
            loss: LossPolicy {
                hold_s: settings.hold_s,
                ..LossPolicy::default()
            },
            ..View::default()
        };
        Self {
            wire: Wire::new(targets, String::new()),
            face: OneFace::new(&[], &view),
            found: false,
            repeat: Every::default(),
            last: None,
        }
    }

    fn send_found(&mut self, found: bool) {
        self.found = found;
        let argument = Argument::Int(found.into());
        self.wire.message(format_args!("/found"), [argument]);
        self.wire.flush();
    }

    fn measure(&self, sensor_from_head: &Rigid, landmarks: &Landmarks) -> Numbers {
        let count = landmarks.pixels.len() as f32;
        let pixels = landmarks.pixels.iter();
        let mean_px = |axis: usize| pixels.clone().map(|pixel| pixel[axis]).sum::<f32>() / count;
        let mut x = mean_px(0);
        let mirror = self.face.view.mirror;
        if mirror {
            x = (WIDTH - 1) as f32 - x;
        }
        let corners = [39, 42].map(|i| landmarks.pixels[i]);
        let apart_px = (corners[0][0] - corners[1][0]).hypot(corners[0][1] - corners[1][1]);
        // Scale from the foreshortened distance: turning away does not change the scale.
        let across = sensor_from_head.rotation * (landmarks.head[42] - landmarks.head[39]);
        let scale = apart_px * UNIT_M / across.xy().norm();
        let (yaw, pitch, roll) = yaw_pitch_roll(&self.face.view.pose(sensor_from_head).rotation);
        let mean = |group: &[usize]| {
            let sum: Vector = group.iter().map(|&i| landmarks.head[i].coords).sum();
            Point::from(sum / group.len() as f32)
        };
        let distance = |i: usize| {
            let (_, from, to) = GESTURES[if mirror { MIRRORED[i] } else { i }];
            finite((mean(from) - mean(to)).norm() / UNIT_M)
        };
        Numbers {
            pose: [x, mean_px(1), scale, pitch, yaw, roll].map(finite),
            gestures: core::array::from_fn(distance),
        }
    }

    fn send_numbers(&mut self, Numbers { pose, gestures }: Numbers) {
        let wire = &mut self.wire;
        let floats = |range: core::ops::Range<usize>| range.map(move |i| Argument::Float(pose[i]));
        wire.message(format_args!("/pose/position"), floats(0..2));
        wire.message(format_args!("/pose/scale"), floats(2..3));
        wire.message(format_args!("/pose/orientation"), floats(3..6));
        for ((name, ..), distance) in GESTURES.iter().zip(gestures) {
            wire.message(format_args!("/gesture/{name}"), [Argument::Float(distance)]);
        }
        wire.flush();
    }
}

impl Output for FaceOsc {
    fn send(&mut self, report: &Report) -> Result<(), OutputError> {
        let Some(state) = self.face.follow(report) else {
            return Ok(());
        };
        match (report.sensor_from_face, report.landmarks) {
            (Some(pose), Some(landmarks)) if state.has_face() => {
                self.last = Some((self.measure(pose, landmarks), report.at));
            }
            _ => {
                let hold_s = f64::from(self.face.view.loss.hold_s);
                let is_held = |last: &(_, _)| report.at.seconds_since(last.1) <= hold_s;
                self.last = self.last.filter(is_held);
            }
        }
        let found = self.last.is_some();
        if self.repeat.due(report.at, FOUND_S) || found != self.found {
            self.send_found(found);
        }
        if let Some((numbers, _)) = self.last {
            self.send_numbers(numbers);
        }
        Ok(())
    }

    fn tally(&self) -> Tally {
        self.wire.to.tally("faceosc", 0)
    }
}

impl Drop for FaceOsc {
    /// Sends that no face is found.
    fn drop(&mut self) {
        if self.wire.to.is_used() {
            self.send_found(false);
        }
    }
}
