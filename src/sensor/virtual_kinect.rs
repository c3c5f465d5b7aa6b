//! The device side: a Kinect that exists only as bytes.
//!
//! * [`VirtualCamera`]: answers commands from registers and calibration blocks, as the camera does (one empty reply before
//!   each true one, so that polling is exercised).
//! * [`Player`]: cuts the frames of a scene into packets and spreads them over the picture's time.
//! * [`VirtualKinect`]: both as a [`PacketSource`] in this process, in virtual time: each poll lets one millisecond pass. The
//!   whole driver runs on top of it unchanged.
//!
//! The scene is any `FnMut(&mut Frame) -> bool`; it fills depth, Bayer and stamps, and returns false when it has ended (the
//! device is then gone). Limitations: only the formats the driver uses; nothing is simulated below the packet (no bus errors;
//! see [`super::faults`]).

use core::time::Duration;

use super::Frame;
use super::calibration::{Block, emit_block, emit_fixed};
use super::camera::Registration;
use super::command::{self, Command, image_sensor, register};
use super::device::{DeviceError, Model, PacketSource, Received, Stream};
use super::motor::{self, Posture, audio};
use super::packet::LONGEST;
use super::stream::Cutter;
use super::unpack::{PACKED_DEPTH, pack_depth};

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

    /// True if the registers switch the stream on in the format that [`Player`] sends.
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

/// Share of a picture's time within which its packets go out; the rest of the microframes are empty.
const BUSY: f64 = 0.95;
/// A player that is asked later than this does not catch up: its clock slips.
const SLIP: Duration = Duration::from_millis(50);

/// Cuts the frames of a scene into packets, on time.
pub struct Player<D> {
    draw: D,
    frame: Box<Frame>,
    packed: Box<[u8; PACKED_DEPTH]>,
    cutters: [Cutter; 2],
    /// Packets of the present picture already sent, by stream.
    sent: [usize; 2],
    began: Option<Duration>,
    period: Duration,
    frames: u64,
}

impl<D: FnMut(&mut Frame) -> bool> Player<D> {
    /// Plays `draw`, one frame per `period`.
    #[must_use]
    pub fn new(draw: D, period: Duration) -> Self {
        Self {
            draw,
            frame: Box::default(),
            packed: vec![0; PACKED_DEPTH]
                .into_boxed_slice()
                .try_into()
                .expect("PACKED_DEPTH long"),
            cutters: [
                Cutter::new(Stream::Colour, 0),
                Cutter::new(Stream::Depth, 0),
            ],
            sent: [0; 2],
            began: None,
            period,
            frames: 0,
        }
    }

    /// The frame whose packets are going out.
    #[must_use]
    pub const fn frame(&self) -> &Frame {
        &self.frame
    }

    /// Frames begun.
    #[must_use]
    pub const fn frames(&self) -> u64 {
        self.frames
    }

    fn next_frame(&mut self) -> bool {
        self.sent = [0; 2];
        self.frames += 1;
        let alive = (self.draw)(&mut self.frame);
        pack_depth(&self.frame.depth, &mut self.packed);
        alive
    }

    /// Hands to `sink` every packet due until `now` on the streams that are `on`. False when the scene has ended. A stream
    /// switched on in the middle of a frame starts with the next one; with both off the scene stands still.
    pub fn play(
        &mut self,
        now: Duration,
        on: [bool; 2],
        sink: &mut dyn FnMut(Received<'_>),
    ) -> bool {
        if on == [false; 2] {
            self.began = None;
            return true;
        }
        let total = self
            .cutters
            .each_ref()
            .map(|cutter| cutter.layout().packets());
        loop {
            if self.began.is_none() && !self.next_frame() {
                return false;
            }
            let began = *self.began.get_or_insert(now);
            let elapsed = now.saturating_sub(began);
            let share = elapsed.as_secs_f64() / (self.period.as_secs_f64() * BUSY);
            for stream in Stream::BOTH {
                let i = stream.index();
                if !on[i] {
                    self.sent[i] = total[i];
                }
                let due = ((share * total[i] as f64) as usize).min(total[i]);
                let (picture, ticks): (&[u8], u32) = match stream {
                    Stream::Colour => (self.frame.bayer.as_slice(), self.frame.colour_ticks),
                    Stream::Depth => (self.packed.as_slice(), self.frame.ticks),
                };
                let mut packet = [0; LONGEST];
                while self.sent[i] < due {
                    let n = self.cutters[i].cut(picture, ticks, self.sent[i], &mut packet);
                    self.sent[i] += 1;
                    sink(Received {
                        stream,
                        intact: true,
                        bytes: &packet[..n],
                    });
                }
            }
            if elapsed < self.period {
                return true;
            }
            let next = began + self.period;
            if !self.next_frame() {
                return false;
            }
            self.began = Some(if now.saturating_sub(next) > SLIP {
                now
            } else {
                next
            });
        }
    }
}

/// A whole Kinect in this process, in virtual time.
pub struct VirtualKinect<D> {
    camera: VirtualCamera,
    player: Player<D>,
    serial: String,
    now: Duration,
    /// Transfers in flight, by stream.
    polled: [bool; 2],
}

/// What passes at each poll.
const STEP: Duration = Duration::from_millis(1);
/// 30 pictures a second.
pub const PERIOD: Duration = Duration::from_nanos(33_333_333);

impl<D: FnMut(&mut Frame) -> bool> VirtualKinect<D> {
    /// A `model` with the usual calibration that sees `draw`.
    #[must_use]
    pub fn new(model: Model, serial: &str, draw: D) -> Self {
        Self {
            camera: VirtualCamera::new(model, Registration::default()),
            player: Player::new(draw, PERIOD),
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

impl<D: FnMut(&mut Frame) -> bool> PacketSource for VirtualKinect<D> {
    fn model(&self) -> Model {
        self.camera.model
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
        if self.camera.model != Model::Xbox1414 {
            return Err(DeviceError::NoMotor);
        }
        self.camera
            .motor_write(request, value)
            .then_some(())
            .ok_or(DeviceError::Stall)
    }

    fn motor_read(&mut self, request: u8, reply: &mut [u8]) -> Result<usize, DeviceError> {
        if self.camera.model != Model::Xbox1414 {
            return Err(DeviceError::NoMotor);
        }
        let bytes = self.camera.motor_read(request).ok_or(DeviceError::Stall)?;
        let n = bytes.len().min(reply.len());
        reply[..n].copy_from_slice(&bytes[..n]);
        Ok(n)
    }

    fn audio_write(&mut self, message: &[u8]) -> Result<(), DeviceError> {
        if self.camera.model == Model::Xbox1414 {
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

/// Frames that can be recognised: every pixel follows from the frame's number, so that one comparison tells whether a
/// frame is whole, wrong, or mixed from two.
pub mod test_pattern {
    use super::Frame;
    use crate::sensor::packet::TICKS_PER_PICTURE;

    fn mixed(number: u64) -> u64 {
        // SplitMix64's output function: neighbours become unlike.
        let z = number.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ z >> 31
    }

    fn depth(number: u64, group: usize) -> [u16; 4] {
        let bits = mixed(number ^ (group as u64) << 32);
        [0, 16, 32, 48].map(|shift| (bits >> shift & 0x7ff) as u16)
    }

    fn bayer(number: u64, group: usize) -> [u8; 8] {
        mixed(!number ^ (group as u64) << 32).to_le_bytes()
    }

    /// Draws frame `number`: its number in the first four pixels, noise that depends on it behind.
    pub fn draw(number: u64, frame: &mut Frame) {
        for (group, pixels) in frame.depth.as_chunks_mut().0.iter_mut().enumerate() {
            *pixels = depth(number, group);
        }
        for (group, pixels) in frame.bayer.as_chunks_mut().0.iter_mut().enumerate() {
            *pixels = bayer(number, group);
        }
        for i in 0..4 {
            frame.depth[i] = (number >> (8 * i) & 0xff) as u16;
            frame.bayer[i] = (number >> (8 * i) & 0xff) as u8;
        }
        frame.ticks = (number as u32).wrapping_mul(TICKS_PER_PICTURE);
        frame.colour_ticks = frame.ticks.wrapping_add(60_000);
    }

    /// Numbers read from a frame's depth and colour picture, and the pixels that are not what those numbers demand.
    #[must_use]
    pub fn check(frame: &Frame) -> ([u64; 2], usize) {
        let read = |value: &dyn Fn(usize) -> u64| (0..4).map(|i| value(i) << (8 * i)).sum::<u64>();
        let numbers = [
            read(&|i| u64::from(frame.depth[i]) & 0xff),
            read(&|i| u64::from(frame.bayer[i])),
        ];
        let mut wrong = 0;
        for (group, pixels) in frame.depth.as_chunks::<4>().0.iter().enumerate().skip(1) {
            let expected = depth(numbers[0], group);
            wrong += (0..4).filter(|&i| pixels[i] != expected[i]).count();
        }
        for (group, pixels) in frame.bayer.as_chunks::<8>().0.iter().enumerate().skip(1) {
            let expected = bayer(numbers[1], group);
            wrong += (0..8).filter(|&i| pixels[i] != expected[i]).count();
        }
        (numbers, wrong)
    }
}
