//! Device side of the command channel, the motor device and the audio device.

use mien_sensors::kinect::calibration::{Block, emit_block, emit_fixed};
use mien_sensors::kinect::command::{self, Command, image_sensor, register};
use mien_sensors::kinect::device::{Model, Stream};
use mien_sensors::kinect::motor::{self, audio};
use mien_sensors::kinect::registration::Registration;

/// Registers, calibration and motor of a camera, and the pending reply.
pub struct VirtualCamera {
    /// Simulated model.
    pub model: Model,
    registration: Registration,
    registers: Vec<u16>,
    /// Register with the colour sensor's automatic functions.
    pub automatic: u16,
    reply: Option<Vec<u8>>,
    /// Whether the next fetch finds the reply not ready.
    busy: bool,
    /// Value of the last LED request.
    pub light: u16,
    /// Last requested tilt, degrees above the horizon.
    pub tilt_deg: f32,
    /// Measurement of the accelerometer; by default of a level sensor.
    pub acceleration: [i16; 3],
    /// Pending replies of the audio device, oldest first.
    pub(super) audio: std::collections::VecDeque<Vec<u8>>,
}

impl VirtualCamera {
    /// A camera with streams and LED off.
    pub fn new(model: Model, registration: Registration) -> Self {
        Self {
            model,
            registration,
            registers: vec![0; usize::from(register::LAST) + 1],
            automatic: image_sensor::AUTO_EXPOSURE | image_sensor::AUTO_WHITE_BALANCE,
            reply: None,
            busy: false,
            light: 0,
            tilt_deg: 0.0,
            acceleration: [0, 819, 0],
            audio: std::collections::VecDeque::new(),
        }
    }

    /// Value of a register; 0 if there is none.
    pub fn register(&self, number: u16) -> u16 {
        let value = self.registers.get(usize::from(number));
        value.copied().unwrap_or_default()
    }

    /// Whether the stream is on, in the format sent by [`super::Player`].
    pub fn streams(&self, stream: Stream) -> bool {
        let settings = match stream {
            Stream::Colour => [
                (register::COLOUR_STREAM, 1),
                (register::COLOUR_FORMAT, 0),
                (register::COLOUR_RESOLUTION, 1),
            ],
            Stream::Depth => [
                (register::DEPTH_STREAM, 2),
                (register::DEPTH_FORMAT, 3),
                (register::DEPTH_RESOLUTION, 1),
            ],
        };
        let mut settings = settings.iter();
        settings.all(|(number, value)| self.register(*number) == *value)
    }

    /// Executes a command and prepares its reply; `false` = stall.
    pub fn command(&mut self, bytes: &[u8]) -> bool {
        let Some((command, tag, words)) = command::parse_command(bytes) else {
            return false;
        };
        let word = |i: usize| words.get(i).copied().unwrap_or(0);
        let le_bytes = |words: &[u16]| words.iter().flat_map(|word| word.to_le_bytes()).collect();
        const REFUSED: u16 = 1;
        let body: Vec<u8> = match command {
            Command::GetParameter => match self.registers.get(usize::from(word(0))) {
                Some(&value) => le_bytes(&[0, value]),
                None => le_bytes(&[REFUSED, 0]),
            },
            Command::SetParameter => match self.registers.get_mut(usize::from(word(0))) {
                Some(register) => {
                    *register = word(1);
                    le_bytes(&[0])
                }
                None => le_bytes(&[REFUSED]),
            },
            Command::FixedParameters => emit_fixed(&self.registration, self.model),
            Command::AlgorithmParameters => match Block::from_number(word(0)) {
                Some(block) => {
                    let mut body: Vec<u8> = le_bytes(&[0]);
                    body.extend(emit_block(block, &self.registration));
                    body
                }
                None => le_bytes(&[REFUSED]),
            },
            Command::ImageSensor => {
                let (number, write) = (word(1) & 0x7fff, word(1) & 0x8000 != 0);
                let is_automatic = number == image_sensor::AUTOMATIC;
                if is_automatic && write {
                    self.automatic = word(2);
                }
                let value = if is_automatic {
                    self.automatic
                } else {
                    word(2)
                };
                le_bytes(&[1, word(1), value])
            }
        };
        let mut reply = Vec::new();
        command::emit_reply(command, tag, &body, &mut reply);
        self.reply = Some(reply);
        self.busy = true;
        true
    }

    /// The reply; empty if there is none or it is not ready.
    pub fn fetch(&mut self) -> Vec<u8> {
        if core::mem::take(&mut self.busy) {
            return Vec::new();
        }
        self.reply.take().unwrap_or_default()
    }

    /// Executes a vendor request to the motor device.
    pub fn motor_write(&mut self, request: u8, value: u16) {
        match request {
            motor::SET_LIGHT => self.light = value,
            motor::SET_TILT => self.tilt_deg = f32::from(value.cast_signed()) / 2.0,
            _ => {}
        }
    }

    /// State of the motor device.
    pub fn motor_state(&self) -> [u8; motor::STATE_BYTES] {
        let mut state = [0; motor::STATE_BYTES];
        for (at, axis) in [2, 4, 6].into_iter().zip(self.acceleration) {
            state[at..at + 2].copy_from_slice(&axis.to_be_bytes());
        }
        state[8] = (2.0 * self.tilt_deg) as i8 as u8;
        state
    }

    /// Executes a bulk message to the audio device.
    pub fn audio_write(&mut self, message: &[u8]) {
        let (words, _) = message.as_chunks::<4>();
        let word = |i: usize| words.get(i).map_or(0, |word| u32::from_le_bytes(*word));
        match word(3) {
            0x10 => self.light = word(4) as u16,
            0x803b => self.tilt_deg = word(4).cast_signed() as f32,
            0x8032 => {
                let mut state = vec![0; audio::STATE];
                for (at, axis) in [16, 20, 24].into_iter().zip(self.acceleration) {
                    state[at..at + 4].copy_from_slice(&i32::from(axis).to_le_bytes());
                }
                self.audio.push_back(state);
            }
            _ => {}
        }
        self.audio.push_back(audio::status(word(1)));
    }
}
