//! OSC preset `faceosc`: the raw distances of FaceOSC, which many sketches in Processing, Max and Pd expect.
//!
//! `/found` alone, then one bundle per frame: `/pose/position` in pixels, `/pose/scale`, `/pose/orientation` in radians
//! (pitch, yaw, roll), and `/gesture/…`. Gestures are distances on the face, the head's turning taken out, in FaceOSC's
//! unit of about 3.6 mm (a mouth is about 14 wide); the scale is pixels per unit. Left and right are the subject's own. One face:
//! the first seen, until lost.

use super::packet::Argument;
use super::wire::Wire;
use crate::geometry::{Point, Rigid, yaw_pitch_roll};
use crate::landmarks::Landmarks;
use crate::output::{Every, LossPolicy, OneFace, Output, OutputError, Report};

/// FaceOSC's unit of length, metres.
const UNIT_M: f32 = 0.0036;
/// How often `/found` is repeated, seconds.
const FOUND_S: f64 = 1.0;

/// Where it goes.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Whether anything is sent.
    pub enabled: bool,
    /// `host:port`.
    pub target: String,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            enabled: false,
            target: "127.0.0.1:8338".to_owned(),
        }
    }
}

/// A gesture: its name and the two groups of landmarks whose means are apart by it.
type Gesture = (&'static str, &'static [usize], &'static [usize]);
const GESTURES: [Gesture; 8] = [
    ("mouth/width", &[48], &[54]),
    ("mouth/height", &[61, 62, 63], &[65, 66, 67]),
    ("eyebrow/left", &[22, 23, 24, 25, 26], &[42, 45]),
    ("eyebrow/right", &[17, 18, 19, 20, 21], &[36, 39]),
    ("eye/left", &[43, 44], &[46, 47]),
    ("eye/right", &[37, 38], &[40, 41]),
    ("jaw", &[33], &[7, 8, 9]),
    ("nostrils", &[31], &[35]),
];

/// A sender of raw distances.
pub struct FaceOsc {
    wire: Wire,
    face: OneFace,
    found: bool,
    repeat: Every,
}

impl FaceOsc {
    /// Opens the socket.
    ///
    /// # Errors
    /// If the target is unusable, or there is no socket to be had.
    pub fn new(settings: Settings) -> Result<Self, OutputError> {
        Ok(Self {
            wire: Wire::open(settings.target, String::new())?,
            // Distances do not fade: a face that is lost is not found.
            face: OneFace::new(0, LossPolicy::default()),
            found: false,
            repeat: Every::default(),
        })
    }

    /// Datagrams sent, and those that could not be.
    #[must_use]
    pub fn sent_and_dropped(&self) -> (u64, u64) {
        (self.wire.sent(), self.wire.dropped())
    }

    fn send_found(&mut self, found: bool) {
        self.found = found;
        self.wire.message(
            format_args!("/found"),
            std::iter::once(Argument::Int(found.into())),
        );
        self.wire.flush();
    }

    fn send_face(&mut self, sensor_from_head: &Rigid, landmarks: &Landmarks) {
        let count = landmarks.pixels.len() as f32;
        let centre = [0, 1].map(|axis| {
            landmarks
                .pixels
                .iter()
                .map(|pixel| pixel[axis])
                .sum::<f32>()
                / count
        });
        let corners = [39, 42].map(|i| landmarks.pixels[i]);
        let apart_px = (corners[0][0] - corners[1][0]).hypot(corners[0][1] - corners[1][1]);
        // Turned away, the eyes come closer in the picture, not on the face.
        let across = sensor_from_head.rotation * (landmarks.head[42] - landmarks.head[39]);
        let scale = apart_px * UNIT_M / across.xy().norm();
        let (yaw, pitch, roll) = yaw_pitch_roll(&sensor_from_head.rotation);
        let numbers = [centre[0], centre[1], scale, pitch, yaw, roll].map(finite);

        let wire = &mut self.wire;
        let floats = |values: &[f32]| -> heapless::Vec<Argument<'static>, 3> {
            values.iter().copied().map(Argument::Float).collect()
        };
        wire.message(
            format_args!("/pose/position"),
            floats(&numbers[..2]).into_iter(),
        );
        wire.message(
            format_args!("/pose/scale"),
            floats(&numbers[2..3]).into_iter(),
        );
        wire.message(
            format_args!("/pose/orientation"),
            floats(&numbers[3..]).into_iter(),
        );
        let mean = |group: &[usize]| {
            let sum = group
                .iter()
                .map(|&i| landmarks.head[i].coords)
                .sum::<crate::geometry::Vector>();
            Point::from(sum / group.len() as f32)
        };
        for (name, from, to) in GESTURES {
            let distance = finite((mean(from) - mean(to)).norm() / UNIT_M);
            wire.message(
                format_args!("/gesture/{name}"),
                std::iter::once(Argument::Float(distance)),
            );
        }
        wire.flush();
    }
}

/// What is not a number becomes 0.
fn finite(value: f32) -> f32 {
    if value.is_finite() { value } else { 0.0 }
}

impl Output for FaceOsc {
    fn send(&mut self, report: &Report) -> Result<(), OutputError> {
        let Some(state) = self.face.follow(report) else {
            return Ok(());
        };
        let found = state.is_present();
        if self.repeat.due(report.at, FOUND_S) || found != self.found {
            self.send_found(found);
        }
        if let (true, Some(pose), Some(landmarks)) =
            (found, report.sensor_from_head, report.landmarks)
        {
            self.send_face(pose, landmarks);
        }
        Ok(())
    }
}

impl Drop for FaceOsc {
    /// Nobody.
    fn drop(&mut self) {
        self.send_found(false);
    }
}
