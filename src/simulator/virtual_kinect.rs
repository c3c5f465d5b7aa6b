//! The device side: a Kinect that exists only as bytes.
//!
//! * [`VirtualCamera`]: answers commands from registers and calibration blocks, as the camera does (one empty reply before
//!   each true one, so that polling is exercised).
//! * [`Player`]: cuts the frames of a scene into packets and spreads them over the picture's time.
//! * [`VirtualKinect`]: both as a [`PacketSource`] in this process, in virtual time: each poll lets one millisecond pass. The
//!   whole driver runs on top of it unchanged.
//!
//! What it sees is any [`View`]; it fills depth, Bayer and stamps, and returns false when it has ended (the device is then
//! gone). Limitations: only the formats the driver uses; nothing is simulated below the packet (no bus errors;
//! see [`super::faults`]).

use core::time::Duration;

use crate::sensor::kinect::device::{DeviceError, Model, PacketSource, Received, Stream};
use crate::sensor::kinect::registration::Registration;

mod camera;
mod player;
pub mod test_pattern;
mod view;

pub use camera::VirtualCamera;
pub use player::Player;
pub use view::View;

/// A whole Kinect in this process, in virtual time.
pub struct VirtualKinect<D> {
    camera: VirtualCamera,
    player: Player<D>,
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
    #[must_use]
    pub fn new(model: Model, serial: &str, view: D) -> Self {
        Self {
            camera: VirtualCamera::new(model, Registration::default()),
            player: Player::new(view, PERIOD),
            serial: serial.to_owned(),
            now: Duration::ZERO,
            polled: [false; 2],
        }
    }

    /// One picture per `period` instead: slow hosts cannot carry 30 a second through a virtual machine.
    #[must_use]
    pub const fn with_period(mut self, period: Duration) -> Self {
        self.player.period = period;
        self
    }

    /// What it sees.
    #[must_use]
    pub const fn view(&self) -> &D {
        &self.player.view
    }

    /// Registers and motor.
    #[must_use]
    pub const fn camera(&self) -> &VirtualCamera {
        &self.camera
    }

    /// What is being sent.
    #[must_use]
    pub const fn player(&self) -> &Player<D> {
        &self.player
    }
}

impl<D: View> PacketSource for VirtualKinect<D> {
    fn model(&self) -> Model {
        self.camera.model()
    }

    fn serial(&self) -> &str {
        &self.serial
    }

    fn send(&mut self, command: &[u8]) -> Result<(), DeviceError> {
        self.camera
            .command(command)
            .then_some(())
            .ok_or(DeviceError::Stall)
    }

    fn receive(&mut self, reply: &mut [u8]) -> Result<usize, DeviceError> {
        let bytes = self.camera.fetch();
        let n = bytes.len().min(reply.len());
        reply[..n].copy_from_slice(&bytes[..n]);
        Ok(n)
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

    fn motor_write(&mut self, request: u8, value: u16) -> Result<(), DeviceError> {
        if self.camera.model() != Model::Xbox1414 {
            return Err(DeviceError::NoMotor);
        }
        self.camera
            .motor_write(request, value)
            .then_some(())
            .ok_or(DeviceError::Stall)
    }

    fn motor_read(&mut self, request: u8, reply: &mut [u8]) -> Result<usize, DeviceError> {
        if self.camera.model() != Model::Xbox1414 {
            return Err(DeviceError::NoMotor);
        }
        let bytes = self.camera.motor_read(request).ok_or(DeviceError::Stall)?;
        let n = bytes.len().min(reply.len());
        reply[..n].copy_from_slice(&bytes[..n]);
        Ok(n)
    }

    fn audio_write(&mut self, message: &[u8]) -> Result<(), DeviceError> {
        if self.camera.model() == Model::Xbox1414 {
            return Err(DeviceError::NoMotor);
        }
        self.camera.audio_write(message);
        Ok(())
    }

    fn audio_read(&mut self, reply: &mut [u8]) -> Result<usize, DeviceError> {
        let bytes = self.camera.audio_read().ok_or(DeviceError::TimedOut)?;
        let n = bytes.len().min(reply.len());
        reply[..n].copy_from_slice(&bytes[..n]);
        Ok(n)
    }
}
