//! The camera's side of the command channel, of the motor device and of the audio device.

use crate::sensor::kinect::calibration::{Block, emit_block, emit_fixed};
use crate::sensor::kinect::command::{self, Command, image_sensor, register};
use crate::sensor::kinect::device::{Model, Stream};
use crate::sensor::kinect::motor::{self, Posture, audio};
use crate::sensor::kinect::registration::Registration;

/// Registers, calibration and motor of a camera, and the reply that waits.
#[derive(Clone, Debug)]
pub struct VirtualCamera {
    model: Model,
    registration: Registration,
    registers: Vec<u16>,
    automatic: u16,
    reply: Option<Vec<u8>>,
    /// The next fetch finds the reply not ready.
    busy: bool,
    /// Value of the last LED request.
    light: u16,
    posture: Posture,
    /// What the audio device has to say, oldest first.
    audio: std::collections::VecDeque<Vec<u8>>,
}

impl VirtualCamera {
    /// Everything off.
    #[must_use]
    pub fn new(model: Model, registration: Registration) -> Self {
        Self {
            model,
            registration,
            registers: vec![0; usize::from(register::LAST) + 1],
            automatic: image_sensor::AUTO_EXPOSURE | image_sensor::AUTO_WHITE_BALANCE,
            reply: None,
            busy: false,
            light: 0,
            posture: Posture {
                acceleration_g: [0.0, 1.0, 0.0],
                tilt_deg: Some(0.0),
            },
            audio: std::collections::VecDeque::new(),
        }
    }

    /// Which sensor it plays.
    #[must_use]
    pub const fn model(&self) -> Model {
        self.model
    }

    /// Content of a register.
    #[must_use]
    pub fn register(&self, number: u16) -> u16 {
        self.registers
            .get(usize::from(number))
            .copied()
            .unwrap_or(0)
    }

    /// Automatic functions of the colour sensor.
    #[must_use]
    pub const fn automatic(&self) -> u16 {
        self.automatic
    }

    /// Value of the last LED request.
    #[must_use]
    pub const fn light(&self) -> u16 {
        self.light
    }

    /// True if the registers switch the stream on in the format that `Player` sends.
    #[must_use]
    pub fn streams(&self, stream: Stream) -> bool {
        match stream {
            Stream::Colour => {
                self.register(register::COLOUR_STREAM) == 1
                    && self.register(register::COLOUR_FORMAT) == 0
                    && self.register(register::COLOUR_RESOLUTION) == 1
            }
            Stream::Depth => {
                self.register(register::DEPTH_STREAM) == 2
                    && self.register(register::DEPTH_FORMAT) == 3
                    && self.register(register::DEPTH_RESOLUTION) == 1
            }
        }
    }

    /// A command arrives. False = stall.
    pub fn command(&mut self, bytes: &[u8]) -> bool {
        let Some((command, tag, words)) = command::parse_command(bytes) else {
            return false;
        };
        let word = |i: usize| words.get(i).copied().unwrap_or(0);
        let of = |words: &[u16]| words.iter().flat_map(|word| word.to_le_bytes()).collect();
        const REFUSED: u16 = 1;
        let body: Vec<u8> = match command {
            Command::GetParameter => match self.registers.get(usize::from(word(0))) {
                Some(&value) => of(&[0, value]),
                None => of(&[REFUSED, 0]),
            },
            Command::SetParameter => match self.registers.get_mut(usize::from(word(0))) {
                Some(register) => {
                    *register = word(1);
                    of(&[0])
                }
                None => of(&[REFUSED]),
            },
            Command::FixedParameters => emit_fixed(&self.registration, self.model),
            Command::AlgorithmParameters => match Block::of(word(0)) {
                Some(block) => {
                    let mut body: Vec<u8> = of(&[0]);
                    body.extend(emit_block(block, &self.registration));
                    body
                }
                None => of(&[REFUSED]),
            },
            Command::ImageSensor => {
                let (number, write) = (word(1) & 0x7fff, word(1) & 0x8000 != 0);
                if number == image_sensor::AUTOMATIC && write {
                    self.automatic = word(2);
                }
                let value = if number == image_sensor::AUTOMATIC {
                    self.automatic
                } else {
                    word(2)
                };
                of(&[1, word(1), value])
            }
        };
        let mut reply = Vec::new();
        command::emit_reply(command, tag, &body, &mut reply);
        self.reply = Some(reply);
        self.busy = true;
        true
    }

    /// The host fetches the reply: empty if there is none or it is not ready.
    pub fn fetch(&mut self) -> Vec<u8> {
        if core::mem::take(&mut self.busy) {
            return Vec::new();
        }
        self.reply.take().unwrap_or_default()
    }

    /// A vendor request without data to the motor device. False = stall.
    pub fn motor_write(&mut self, request: u8, value: u16) -> bool {
        match request {
            motor::SET_LIGHT => self.light = value,
            motor::SET_TILT => self.posture.tilt_deg = Some(f32::from(value.cast_signed()) / 2.0),
            _ => return false,
        }
        true
    }

    /// A vendor request that reads from the motor device; `None` = stall.
    #[must_use]
    pub fn motor_read(&self, request: u8) -> Option<Vec<u8>> {
        match request {
            0x10 => Some(vec![0x22]),
            motor::GET_POSTURE => Some(motor::emit_posture(&self.posture).to_vec()),
            _ => None,
        }
    }

    /// A bulk message to the audio device.
    pub fn audio_write(&mut self, message: &[u8]) {
        let (words, _) = message.as_chunks::<4>();
        let word = |i: usize| words.get(i).map_or(0, |word| u32::from_le_bytes(*word));
        match word(3) {
            0x10 => self.light = word(4) as u16,
            0x803b => self.posture.tilt_deg = Some(word(4).cast_signed() as f32),
            0x8032 => {
                let mut state = vec![0; audio::POSTURE];
                let tilt = self.posture.tilt_deg.unwrap_or(0.0) as i32;
                state[20..24].copy_from_slice(&819i32.to_le_bytes());
                state[28..32].copy_from_slice(&tilt.to_le_bytes());
                self.audio.push_back(state);
            }
            _ => {}
        }
        self.audio.push_back(audio::status(word(1)));
    }

    /// The next bulk answer of the audio device.
    pub fn audio_read(&mut self) -> Option<Vec<u8>> {
        self.audio.pop_front()
    }
}
