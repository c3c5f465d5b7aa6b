//! A sensor on its side or upside down, as one that stands upright: its images and its camera are turned ([`Turn`]).
//!
//! Original data for displays cannot be turned, because a turned Bayer mosaic is another one; displays show the grey image instead.
//! Upright sensors cost a comparison a frame.

use crate::kinect::frame::FrameSink;
use crate::kinect::registration::Registration;
use crate::sensor::{Sensor, SensorError, SensorState};
use mien_stages::base::prelude::*;
use mien_stages::camera::Camera;
use mien_stages::turn::{Turn, TurnedImage};

/// Values of a key for the turn of a sensor; `auto` asks its accelerometer.
pub const TURNS: &[(&str, Option<Turn>)] = &[
    ("auto", None),
    ("0", Some(Turn::Upright)),
    ("90", Some(Turn::Quarter)),
    ("180", Some(Turn::Half)),
    ("270", Some(Turn::ThreeQuarters)),
];

/// A sensor whose images are turned upright.
struct Turned {
    sensor: Box<dyn Sensor>,
    /// The turn; `None` to ask the accelerometer.
    known: Option<Turn>,
    turn: Turn,
    /// The sensor's own camera and the turned one; unused if it is upright.
    cameras: [Camera; 2],
}

/// The sensor with its images upright, if it is turned by `turn`; `None`: as its accelerometer says, upright if it has none.
pub fn upright(sensor: Box<dyn Sensor>, turn: Option<Turn>) -> Box<dyn Sensor> {
    let cameras = [sensor.camera().clone(), sensor.camera().clone()];
    let mut turned = Turned {
        sensor,
        known: turn,
        turn: Turn::Upright,
        cameras,
    };
    turned.notice_changes();
    Box::new(turned)
}

impl Turned {
    /// Follows the sensor's turn and camera, which change when another device is plugged in.
    fn notice_changes(&mut self) {
        let measured = || self.sensor.acceleration().map(Turn::from_acceleration);
        let turn = self.known.or_else(measured).unwrap_or_default();
        let native = self.sensor.camera();
        if turn == self.turn && (turn == Turn::Upright || *native == self.cameras[0]) {
            return;
        }
        if turn != self.turn {
            let source = match self.known {
                Some(_) => "as configured",
                None => "says its accelerometer",
            };
            tracing::info!(
                "the sensor is turned by {} degrees, {source}",
                turn.degrees()
            );
        }
        let turned = native.clone().turned(turn, self.sensor.luma_size());
        (self.turn, self.cameras) = (turn, [native.clone(), turned]);
    }
}

impl Sensor for Turned {
    fn next_frame(&mut self, into: &mut dyn FrameSink) -> Result<bool, SensorError> {
        let more = self.sensor.next_frame(into)?;
        self.notice_changes();
        if more && self.turn != Turn::Upright {
            let (frame, original) = into.parts();
            let depth = self.cameras[0].depth_size();
            self.turn
                .turn_upright(frame, depth, self.sensor.luma_size());
            if let Some(original) = original {
                original.set_grey(frame);
            }
        }
        Ok(more)
    }

    fn camera(&self) -> &Camera {
        match self.turn {
            Turn::Upright => self.sensor.camera(),
            _ => &self.cameras[1],
        }
    }

    fn luma_size(&self) -> [usize; 2] {
        let (turn, size) = (self.turn, self.sensor.luma_size());
        TurnedImage { turn, size }.upright_size()
    }

    fn state(&self) -> SensorState {
        self.sensor.state()
    }

    fn registration(&self) -> Option<&Registration> {
        // It is that of the images before they are turned.
        let registration = self.sensor.registration();
        registration.filter(|_| self.turn == Turn::Upright)
    }

    fn seek(&mut self, number: usize) {
        self.sensor.seek(number);
    }

    fn show_tracking(&self, tracking: bool) {
        self.sensor.show_tracking(tracking);
    }
}
