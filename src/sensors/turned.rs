//! A sensor on its side or upside down, as one that stands upright: its images and its camera are turned ([`Turn`]).
//!
//! Original data for displays cannot be turned, because a turned Bayer mosaic is another one; displays show the grey image instead.
//! Upright sensors cost a comparison a frame.

use crate::kinect::frame::FrameSink;
use crate::kinect::registration::Registration;
use crate::sensor::{Activity, Sensor, SensorError, SensorState};
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
    /// The turn, the sensor's own camera and the turned one; `None` while it is upright.
    turned: Option<(Turn, [Camera; 2])>,
}

/// The sensor with its images upright, if it is turned by `turn`; `None`: as its accelerometer says, upright if it has none.
pub fn upright(sensor: Box<dyn Sensor>, turn: Option<Turn>) -> Box<dyn Sensor> {
    let mut turned = Turned {
        sensor,
        known: turn,
        turned: None,
    };
    turned.notice_changes();
    Box::new(turned)
}

impl Turned {
    /// Follows the sensor's turn and camera, which change when another device is plugged in.
    fn notice_changes(&mut self) {
        let measured = || self.sensor.acceleration().map(Turn::from_acceleration);
        let turn = self.known.or_else(measured).unwrap_or_default();
        let (former, native) = (self.turn(), self.sensor.camera());
        let same_camera = |(_, [known, _]): &(Turn, [Camera; 2])| known == native;
        if turn == former && self.turned.as_ref().is_none_or(same_camera) {
            return;
        }
        if turn != former {
            let source = match self.known {
                Some(_) => "as configured",
                None => "says its accelerometer",
            };
            tracing::info!(
                "the sensor is turned by {} degrees, {source}",
                turn.degrees()
            );
        }
        let turned = || native.clone().turned(turn, self.sensor.luma_size());
        self.turned = (turn != Turn::Upright).then(|| (turn, [native.clone(), turned()]));
    }

    fn turn(&self) -> Turn {
        self.turned.as_ref().map_or(Turn::Upright, |known| known.0)
    }
}

impl Sensor for Turned {
    fn next_frame(&mut self, into: &mut dyn FrameSink) -> Result<bool, SensorError> {
        let more = self.sensor.next_frame(into)?;
        self.notice_changes();
        if more && let Some((turn, [native, _])) = &self.turned {
            let (frame, original) = into.parts();
            turn.turn_upright(frame, native.depth_size(), self.sensor.luma_size());
            if let Some(original) = original {
                original.set_grey(frame);
            }
        }
        Ok(more)
    }

    fn camera(&self) -> &Camera {
        let turned = self.turned.as_ref();
        turned.map_or(self.sensor.camera(), |(_, [_, turned])| turned)
    }

    fn luma_size(&self) -> [usize; 2] {
        let (turn, size) = (self.turn(), self.sensor.luma_size());
        TurnedImage { turn, size }.upright_size()
    }

    fn state(&self) -> SensorState {
        self.sensor.state()
    }

    fn registration(&self) -> Option<&Registration> {
        // It is that of the images before they are turned.
        let registration = self.sensor.registration();
        registration.filter(|_| self.turned.is_none())
    }

    fn seek(&mut self, number: usize) {
        self.sensor.seek(number);
    }

    fn show(&self, activity: Activity) {
        self.sensor.show(activity);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Frame;
    use crate::kinect::geometry::nominal;
    use mien_stages::base::capacity::{HEIGHT, WIDTH};

    /// A sensor that is replaced: its frames are of one turned by 90, by 90 with another camera, and by 180 degrees.
    struct Replaced(usize, [Camera; 2]);

    impl Sensor for Replaced {
        fn next_frame(&mut self, into: &mut dyn FrameSink) -> Result<bool, SensorError> {
            let (frame, _) = into.parts();
            frame.depth.fill(0);
            // One pixel in the corner.
            frame.depth[0] = 700;
            self.0 += 1;
            Ok(self.0 < 4)
        }

        fn camera(&self) -> &Camera {
            &self.1[self.0 / 2 % 2]
        }

        fn acceleration(&self) -> Option<[i16; 3]> {
            Some([[0, 819, 0], [-819, 0, 0], [-819, 0, 0], [0, -819, 0]][self.0.min(3)])
        }

        fn state(&self) -> SensorState {
            SensorState::default()
        }
    }

    #[test]
    fn the_turn_and_the_camera_are_those_of_the_sensor_plugged_in() {
        let other = Registration {
            const_shift: 190,
            ..Registration::default()
        };
        let cameras = [nominal(), other.camera()];
        let camera_columns = cameras[0].depth_size()[0];
        let mut sensor = upright(Box::new(Replaced(0, cameras.clone())), None);
        assert!(*sensor.camera() == cameras[0]);
        let mut frame = Frame::default();
        for (camera, turn) in [(0, Turn::Quarter), (1, Turn::Quarter), (1, Turn::Half)] {
            sensor.next_frame(&mut frame).expect("a frame");
            let expected = cameras[camera].clone().turned(turn, [WIDTH, HEIGHT]);
            assert!(*sensor.camera() == expected, "{turn:?}");
        }
        // The upper left corner is the lower right one now.
        let corner = (HEIGHT - 1) * WIDTH + camera_columns - 1;
        assert_eq!([frame.depth[0], frame.depth[corner]], [0, 700]);
        let mut fixed = upright(Box::new(Replaced(0, cameras.clone())), Some(Turn::Half));
        assert!(fixed.next_frame(&mut frame).expect("a frame"));
        assert_eq!(frame.depth[corner], 700);
        let mut level = upright(Box::new(Replaced(1, cameras)), Some(Turn::Upright));
        assert!(level.next_frame(&mut frame).expect("a frame"));
        assert_eq!(frame.depth[0], 700);
    }
}
