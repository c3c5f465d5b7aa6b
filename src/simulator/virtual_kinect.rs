//! The device side: a Kinect that exists only as bytes.
//!
//! * [`VirtualCamera`]: answers commands from registers and calibration blocks, as the camera does (one empty reply before
//!   each true one, so that polling is exercised).
//! * [`Player`]: cuts the frames of a scene into packets and spreads them over the picture's time.
//! * [`VirtualKinect`]: both as a [`PacketSource`] in this process, in virtual time: each poll lets one millisecond pass. The
//!   whole driver runs on top of it unchanged.
//!
//! What it sees is any [`View`]; it fills depth, Bayer and stamps, and returns false when it has ended (the device is then
//! gone). Limitations: only the formats the driver uses; nothing is simulated below the packet (no bus errors:
//! tests inject those).

use core::time::Duration;

use mien_sensors::kinect::device::{DeviceError, Model, PacketSource, Received, Request, Stream};
use mien_sensors::kinect::registration::Registration;

mod camera;
mod player;

pub use camera::VirtualCamera;
pub use player::{Player, View};

/// A whole Kinect in this process, in virtual time.
pub struct VirtualKinect<D> {
    /// Registers and motor.
    pub camera: VirtualCamera,
    /// What is being sent.
    pub player: Player<D>,
    serial: String,
    now: Duration,
    /// Transfers in flight, by stream.
    polled: [bool; 2],
}

/// What passes at each poll, at most.
pub const STEP: Duration = Duration::from_millis(1);
/// 30 pictures a second.
pub const PERIOD: Duration = Duration::from_nanos(33_333_333);

impl<D: View> VirtualKinect<D> {
    /// A `model` with the usual calibration that sees `view`.
    pub fn new(model: Model, serial: &str, view: D) -> Self {
        Self {
            camera: VirtualCamera::new(model, Registration::default()),
            player: Player::new(view, PERIOD),
            serial: serial.to_owned(),
            now: Duration::ZERO,
            polled: [false; 2],
        }
    }
}

impl<D: View> PacketSource for VirtualKinect<D> {
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
            Request::Audio(message) if !has_motor => camera.audio_write(message),
            Request::AudioAnswer(to) if !has_motor => {
                let said = camera.audio.pop_front().ok_or(DeviceError::TimedOut)?;
                return Ok(answer(said, to));
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
