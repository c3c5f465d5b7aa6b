//! Commands and replies, bounded in time and tries, and on top of them calibration, registers and image sensor. LED, tilt and
//! acceleration, by the motor device, or through the audio device of the later models.

use core::time::Duration;

use super::{Kinect, KinectError};
use crate::kinect::calibration::{Block, parse_block, parse_fixed};
use crate::kinect::command::{self, BadReply, Command, image_sensor};
use crate::kinect::device::{DeviceError, Model, PacketSource, Request};
use crate::kinect::motor::{self, Light, audio};
use crate::kinect::registration::Registration;

/// Interval at which a reply is polled.
const REPLY_STEP: Duration = Duration::from_millis(1);
/// Time limit for a reply.
const REPLY_LIMIT: Duration = Duration::from_secs(1);
/// Number of times a command is sent before it fails.
const TRIES: usize = 3;

impl<S: PacketSource> Kinect<S> {
    pub(super) fn read_calibration(&mut self) -> Result<(), KinectError> {
        let mut registration = Registration::default();
        // Order of the manufacturer's driver: padding, optics, registration, shift.
        let model = self.source.model();
        self.algorithm_block(Block::Padding, &mut registration)?;
        registration.zero_plane = self.exchange(Command::FixedParameters, &[0; 5], |body| {
            Ok(parse_fixed(body, model))
        })??;
        self.algorithm_block(Block::Registration, &mut registration)?;
        self.algorithm_block(Block::ConstShift, &mut registration)?;
        self.registration = registration;
        Ok(())
    }

    fn algorithm_block(
        &mut self,
        block: Block,
        registration: &mut Registration,
    ) -> Result<(), KinectError> {
        const RESOLUTION: u16 = 1;
        const RATE: u16 = 30;
        let words = [block as u16, 0, RESOLUTION, RATE, 0];
        let (status, parsed) = self.exchange(Command::AlgorithmParameters, &words, |body| {
            let (status, content) = split_status(body)?;
            Ok((status, parse_block(block, content, registration)))
        })?;
        check_status(Command::AlgorithmParameters, block as u16, status)?;
        Ok(parsed?)
    }

    pub(super) fn set_register(&mut self, register: u16, value: u16) -> Result<(), KinectError> {
        let status = self.exchange(Command::SetParameter, &[register, value], |body| {
            Ok(split_status(body)?.0)
        })?;
        check_status(Command::SetParameter, register, status)
    }

    /// Sends a command and passes the body of its reply to `read`.
    ///
    /// # Errors
    /// If all tries fail or the device is gone.
    fn exchange<T>(
        &mut self,
        command: Command,
        words: &[u16],
        mut read: impl FnMut(&[u8]) -> Result<T, BadReply>,
    ) -> Result<T, KinectError> {
        let mut failure = KinectError::NoReply(command as u16);
        for _ in 0..TRIES {
            let tag = self.tag;
            // A new tag for every try, so that a late reply is not mistaken for this one's.
            self.tag = self.tag.wrapping_add(1);
            command::emit_command(command, tag, words, &mut self.command);
            match self.source.request(Request::Command(&self.command)) {
                Ok(_) => {}
                Err(problem @ (DeviceError::Stall | DeviceError::TimedOut)) => {
                    failure = problem.into();
                    continue;
                }
                Err(problem) => return Err(problem.into()),
            }
            match self.reply(command, tag, &mut read) {
                Ok(value) => return Ok(value),
                Err(KinectError::Device(problem @ (DeviceError::Gone | DeviceError::Other(_)))) => {
                    return Err(problem.into());
                }
                Err(problem) => failure = problem,
            }
        }
        Err(failure)
    }

    fn reply<T>(
        &mut self,
        command: Command,
        tag: u16,
        read: &mut impl FnMut(&[u8]) -> Result<T, BadReply>,
    ) -> Result<T, KinectError> {
        let deadline = self.source.clock() + REPLY_LIMIT;
        let mut failure = KinectError::NoReply(command as u16);
        loop {
            let mut buffer = [0; command::REPLY];
            let reply = Request::Reply(&mut buffer);
            let n = self.source.request(reply)?.min(command::REPLY);
            if n != 0 && n != command::REPLY {
                match command::parse_reply(&buffer[..n], command, tag).and_then(&mut *read) {
                    Ok(value) => return Ok(value),
                    Err(problem) => {
                        failure = KinectError::BadReply(command as u16, problem);
                        // A reply to an older command: ours may still arrive.
                        if !matches!(problem, BadReply::Tag(..) | BadReply::Command(_)) {
                            return Err(failure);
                        }
                    }
                }
            }
            if self.source.clock() >= deadline {
                return Err(failure);
            }
            self.source.sleep(REPLY_STEP);
        }
    }

    /// Locks (`true`) or frees (`false`) exposure and white balance.
    ///
    /// # Errors
    /// If the camera refuses; the pictures continue.
    pub fn freeze(&mut self, frozen: bool) -> Result<(), KinectError> {
        const BOTH: u16 = image_sensor::AUTO_EXPOSURE | image_sensor::AUTO_WHITE_BALANCE;
        let read = self.image_sensor(image_sensor::AUTOMATIC, None)?;
        let value = if frozen { read & !BOTH } else { read | BOTH };
        self.image_sensor(image_sensor::AUTOMATIC, Some(value))?;
        self.frozen = frozen;
        Ok(())
    }

    fn image_sensor(&mut self, register: u16, value: Option<u16>) -> Result<u16, KinectError> {
        const WRITE: u16 = 0x8000;
        let words = match value {
            Some(value) => [1, register | WRITE, value],
            None => [1, register, 0],
        };
        self.exchange(Command::ImageSensor, &words, |body| match *body {
            [_, _, _, _, low, high, ..] => Ok(u16::from_le_bytes([low, high])),
            _ => Err(too_short(body, 6)),
        })
    }
}

fn too_short(body: &[u8], expected: usize) -> BadReply {
    BadReply::Length(command::HEADER + body.len(), command::HEADER + expected)
}

/// Status word of a reply's body, and the remaining bytes.
///
/// # Errors
/// If the body is too short.
fn split_status(body: &[u8]) -> Result<(u16, &[u8]), BadReply> {
    match body {
        [low, high, rest @ ..] => Ok((u16::from_le_bytes([*low, *high]), rest)),
        _ => Err(too_short(body, 2)),
    }
}

fn check_status(command: Command, register: u16, status: u16) -> Result<(), KinectError> {
    if status == 0 {
        return Ok(());
    }
    Err(KinectError::Refused(command as u16, register, status))
}

impl<S: PacketSource> Kinect<S> {
    /// Sets the LED.
    ///
    /// # Errors
    /// If this Kinect has no reachable motor device; the pictures continue.
    pub fn set_light(&mut self, light: Light) -> Result<(), DeviceError> {
        let value = light.values().0;
        self.send_to_motor(motor::SET_LIGHT, value, |tag| audio::light(tag, light))
    }

    /// Tilts to `degrees` above the horizon, limited to ±31. To be called at most once a second.
    ///
    /// # Errors
    /// If this Kinect has no reachable motor device; the pictures continue.
    pub fn tilt(&mut self, degrees: f32) -> Result<(), DeviceError> {
        let value = motor::tilt_value(degrees);
        self.send_to_motor(motor::SET_TILT, value, |tag| audio::tilt(tag, degrees))
    }

    /// Asks the accelerometer; the result is as [`motor::acceleration`].
    ///
    /// # Errors
    /// If this Kinect has no reachable motor device; the pictures continue.
    pub fn read_acceleration(&mut self) -> Result<[i16; 3], DeviceError> {
        if self.source.model() == Model::Xbox1414 {
            let mut state = [0; motor::STATE_BYTES];
            let read = self.source.request(Request::MotorState(&mut state))?;
            let is_whole = read == state.len();
            return is_whole
                .then(|| motor::acceleration(&state))
                .ok_or(DeviceError::TimedOut);
        }
        self.audio_tag = self.audio_tag.wrapping_add(1);
        let message = audio::state(self.audio_tag);
        self.source.request(Request::Audio(&message))?;
        let mut answer = [0; 512];
        let read = self.source.request(Request::AudioAnswer(&mut answer))?;
        let state = answer[..read.min(answer.len())].first_chunk().copied();
        // The status follows, unless it was all there is.
        if state.is_some() {
            self.source.request(Request::AudioAnswer(&mut answer))?;
        }
        let state = state.ok_or(DeviceError::TimedOut)?;
        Ok(audio::acceleration(&state))
    }

    /// Sends a request to the motor device, or the equivalent `message` to the audio device.
    fn send_to_motor(
        &mut self,
        request: u8,
        value: u16,
        message: impl FnOnce(u32) -> Vec<u8>,
    ) -> Result<(), DeviceError> {
        if self.source.model() == Model::Xbox1414 {
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
