//! LED, tilt and accelerometer: of the motor device, or through the audio device of the later models.

use super::Kinect;
use crate::sensor::kinect::device::{DeviceError, Model, PacketSource};
use crate::sensor::kinect::motor::{self, Light, Posture, audio};

impl<S: PacketSource> Kinect<S> {
    /// Sets the LED.
    ///
    /// # Errors
    /// This Kinect has no reachable motor device; the pictures go on.
    pub fn set_light(&mut self, light: Light) -> Result<(), DeviceError> {
        if self.model() == Model::Xbox1414 {
            return self
                .source
                .motor_write(motor::SET_LIGHT, motor::light_value(light));
        }
        let tag = self.next_audio_tag();
        self.source.audio_write(&audio::light(tag, light))?;
        self.audio_done(tag)
    }

    /// Tilts to `degrees` above the horizon, limited to ±31. Not more often than once a second.
    ///
    /// # Errors
    /// This Kinect has no reachable motor device; the pictures go on.
    pub fn tilt(&mut self, degrees: f32) -> Result<(), DeviceError> {
        if self.model() == Model::Xbox1414 {
            return self
                .source
                .motor_write(motor::SET_TILT, motor::tilt_value(degrees));
        }
        let tag = self.next_audio_tag();
        self.source.audio_write(&audio::tilt(tag, degrees))?;
        self.audio_done(tag)
    }

    /// Reads accelerometer and tilt.
    ///
    /// # Errors
    /// This Kinect has no reachable motor device; the pictures go on.
    pub fn posture(&mut self) -> Result<Posture, DeviceError> {
        if self.model() == Model::Xbox1414 {
            let mut bytes = [0; 10];
            let n = self.source.motor_read(motor::GET_POSTURE, &mut bytes)?;
            return motor::parse_posture(&bytes[..n]).ok_or(DeviceError::TimedOut);
        }
        let tag = self.next_audio_tag();
        self.source.audio_write(&audio::ask_posture(tag))?;
        let mut bytes = [0; 512];
        let n = self.source.audio_read(&mut bytes)?.min(bytes.len());
        let posture = audio::parse_posture(&bytes[..n]).ok_or(DeviceError::TimedOut)?;
        self.audio_done(tag)?;
        Ok(posture)
    }

    fn next_audio_tag(&mut self) -> u32 {
        self.audio_tag = self.audio_tag.wrapping_add(1);
        self.audio_tag
    }

    fn audio_done(&mut self, tag: u32) -> Result<(), DeviceError> {
        let mut bytes = [0; 512];
        let n = self.source.audio_read(&mut bytes)?.min(bytes.len());
        if audio::is_done(&bytes[..n], tag) {
            return Ok(());
        }
        Err(DeviceError::TimedOut)
    }
}
