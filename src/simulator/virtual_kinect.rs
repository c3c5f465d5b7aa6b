//! A virtual Kinect, for running the driver without a device.
//!
//! * [`VirtualCamera`]: answers commands from registers and calibration blocks like a camera, with an empty reply before each real
//!   one, so that polling is exercised.
//! * [`Player`]: cuts the frames of a [`FrameSource`] into packets and spreads them over the picture's time.
//! * [`VirtualKinect`]: both as a [`PacketSource`] in virtual time: each poll takes one millisecond. The driver runs on it unchanged.
//!
//! When the source ends, the device is gone. Limitations: only the formats of the driver; no bus errors (tests inject those).

use core::time::Duration;

use mien_sensors::kinect::device::{DeviceError, Model, PacketSource, Received, Request, Stream};
use mien_sensors::kinect::registration::Registration;

mod camera;
mod player;

pub use camera::VirtualCamera;
pub use player::{FrameSource, Player};

/// A whole Kinect in this process, in virtual time.
pub struct VirtualKinect<D> {
    /// Registers and motor.
    pub camera: VirtualCamera,
    /// The frames being sent.
    pub player: Player<D>,
    serial: String,
    now: Duration,
    /// Whether transfers are in flight, by stream.
    polled: [bool; 2],
}

/// Longest virtual time that passes in a poll.
pub const STEP: Duration = Duration::from_millis(1);
/// Time between pictures at 30 Hz.
pub const PERIOD: Duration = Duration::from_nanos(33_333_333);

impl<D: FrameSource> VirtualKinect<D> {
    /// A `model` with the nominal calibration that sends the frames of `source`.
    pub fn new(model: Model, serial: &str, source: D) -> Self {
        Self {
            camera: VirtualCamera::new(model, Registration::default()),
            player: Player::new(source, PERIOD),
            serial: serial.to_owned(),
            now: Duration::ZERO,
            polled: [false; 2],
        }
    }
}

impl<D: FrameSource> PacketSource for VirtualKinect<D> {
    fn model(&self) -> Model {
        self.camera.model
    }

    fn serial(&self) -> &str {
        &self.serial
    }

    fn request(&mut self, request: Request<'_>) -> Result<usize, DeviceError> {
        let camera = &mut self.camera;
        let has_motor = camera.model == Model::Xbox1414;
        let answer = |answer: Vec<u8>, to: &mut [u8]| {
            let n = answer.len().min(to.len());
            to[..n].copy_from_slice(&answer[..n]);
            n
        };
        match request {
            Request::Command(bytes) if !camera.command(bytes) => return Err(DeviceError::Stall),
            Request::Command(_) => {}
            Request::Reply(to) => return Ok(answer(camera.fetch(), to)),
            Request::Motor(request, value) if has_motor => {
                camera.motor_write(request, value);
            }
            Request::MotorState(to) if has_motor => {
                return Ok(answer(camera.motor_state().to_vec(), to));
            }
            Request::Audio(message) if !has_motor => camera.audio_write(message),
            Request::AudioAnswer(to) if !has_motor => {
                let message = camera.audio.pop_front().ok_or(DeviceError::TimedOut)?;
                return Ok(answer(message, to));
            }
            _ => return Err(DeviceError::NoMotor),
        }
        Ok(0)
    }

    fn start(&mut self, stream: Stream) -> Result<(), DeviceError> {
        self.polled[stream.index()] = true;
        Ok(())
    }

    fn stop(&mut self, stream: Stream) {
        self.polled[stream.index()] = false;
    }

    fn poll(
        &mut self,
        wait: Duration,
        sink: &mut dyn FnMut(Received<'_>),
    ) -> Result<(), DeviceError> {
        self.now += STEP.min(wait);
        let on =
            Stream::BOTH.map(|stream| self.polled[stream.index()] && self.camera.streams(stream));
        if self.player.play(self.now, on, sink) {
            return Ok(());
        }
        Err(DeviceError::Gone)
    }

    fn clock(&self) -> Duration {
        self.now
    }

    fn sleep(&mut self, time: Duration) {
        self.now += time;
    }
}
