//! LED and tilt: of the motor device, or through the audio device of the later models.

use super::Kinect;
use crate::sensor::kinect::device::{DeviceError, Model, PacketSource, Request};
use crate::sensor::kinect::motor::{self, Light, audio};

impl<S: PacketSource> Kinect<S> {
    /// Sets the LED.
    ///
    /// # Errors
    /// This Kinect has no reachable motor device; the pictures go on.
    pub fn set_light(&mut self, light: Light) -> Result<(), DeviceError> {
        let value = light.values().0;
        self.move_or_tell(motor::SET_LIGHT, value, |tag| audio::light(tag, light))
    }

    /// Tilts to `degrees` above the horizon, limited to ±31. Not more often than once a second.
    ///
    /// # Errors
    /// This Kinect has no reachable motor device; the pictures go on.
    pub fn tilt(&mut self, degrees: f32) -> Result<(), DeviceError> {
        let value = motor::tilt_value(degrees);
        self.move_or_tell(motor::SET_TILT, value, |tag| audio::tilt(tag, degrees))
    }

    /// Sends the motor device a request, or the audio device the `message` that does the same.
    fn move_or_tell(
        &mut self,
        request: u8,
        value: u16,
        message: impl FnOnce(u32) -> Vec<u8>,
    ) -> Result<(), DeviceError> {
        if self.model() == Model::Xbox1414 {
            self.source.request(Request::Motor(request, value))?;
            return Ok(());
        }
        self.audio_tag = self.audio_tag.wrapping_add(1);
        let message = message(self.audio_tag);
        self.source.request(Request::Audio(&message))?;
        let mut answer = [0; 512];
        let n = self.source.request(Request::AudioAnswer(&mut answer))?;
        let is_done = audio::is_done(&answer[..n.min(answer.len())], self.audio_tag);
        is_done.then_some(()).ok_or(DeviceError::TimedOut)
    }
}
