//! The camera over any [`PacketSource`]: calibration, start, pictures, watchdog, stop; LED, tilt and accelerometer.
//!
//! Every exchange is bounded: a reply is polled for each millisecond for at most a second, and a failed exchange is tried
//! again twice under a new tag. A stream from which no packet comes for a second is stopped and started; if that does not
//! help twice running, [`KinectError::Silent`] asks the caller to open the device anew.
//!
//! What is not essential never stops the pictures: LED, tilt and the automatic functions of the colour sensor report their
//! errors and change nothing else. Memory: about 6 MB of pictures, allocated at opening.

use core::time::Duration;

use super::Frame;
use super::calibration::{Block, CalibrationError, parse_block, parse_fixed};
use super::camera::Registration;
use super::colour;
use super::command::{self, BadReply, Command, image_sensor, register};
use super::device::{DeviceError, Model, PacketSource, Stream};
use super::motor::{self, Light, Posture, audio};
use super::pairing::{Pairing, RawPair};
use super::picture_clock::PictureClock;
use super::stream::{Assembler, Tally};
use super::unpack::unpack_depth;

/// What can be chosen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Settings {
    /// Kinect for Windows: measure from 0.4 m instead of 0.8 m. No effect on the others.
    pub near_mode: bool,
    /// Hold exposure and white balance once a face is tracked, so that the face's texture does not drift.
    pub freeze_exposure: bool,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            near_mode: true,
            freeze_exposure: false,
        }
    }
}

/// Between two looks for a reply.
const REPLY_STEP: Duration = Duration::from_millis(1);
/// A reply comes within this or not at all.
const REPLY_LIMIT: Duration = Duration::from_secs(1);
/// Times a command is sent before its failure counts.
const TRIES: usize = 3;
/// A stream is dead when nothing came for this long.
const SILENCE: Duration = Duration::from_secs(1);
/// Restarts in a row that may fail before the device is opened anew.
const RESTARTS: u32 = 2;
/// The camera needs this between the two steps of near mode.
const NEAR_MODE_PAUSE: Duration = Duration::from_millis(100);

/// Why the camera does not deliver.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum KinectError {
    /// USB says so.
    #[error(transparent)]
    Device(#[from] DeviceError),
    /// A command got no reply.
    #[error(
        "the Kinect did not reply to command 0x{command:02x} within 1 s; unplug it and plug it in again"
    )]
    NoReply {
        /// Number of the command.
        command: u16,
    },
    /// A command got a wrong reply, three times.
    #[error(
        "the Kinect's reply to command 0x{command:02x} is wrong: {problem}; unplug it and plug it in again"
    )]
    BadReply {
        /// Number of the command.
        command: u16,
        /// What is wrong.
        problem: BadReply,
    },
    /// The camera answered with an error.
    #[error(
        "the Kinect refused command 0x{command:02x} for 0x{register:03x} with status {status}; unplug it and plug it in again"
    )]
    Refused {
        /// Number of the command.
        command: u16,
        /// Register or block.
        register: u16,
        /// Its status.
        status: u16,
    },
    /// The calibration is not a Kinect's.
    #[error(transparent)]
    Calibration(#[from] CalibrationError),
    /// No packets although the stream was restarted.
    #[error(
        "the Kinect sends no {stream:?} packets although it was restarted; check its power supply and give it a USB controller of its own"
    )]
    Silent {
        /// The stream.
        stream: Stream,
    },
}

/// Counts since opening.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Health {
    /// What happened to the packets, by stream.
    pub streams: [Tally; 2],
    /// Whole pictures without a partner, by stream.
    pub unpaired: [u64; 2],
    /// Pairs made.
    pub pairs: u64,
    /// Times the watchdog restarted the streams.
    pub restarts: u64,
}

/// An opened camera.
pub struct Kinect<S> {
    source: S,
    settings: Settings,
    registration: Registration,
    tag: u16,
    audio_tag: u32,
    command: Vec<u8>,
    assemblers: [Assembler; 2],
    pairing: Pairing,
    streaming: bool,
    /// When the last packet came, by stream.
    heard: [Duration; 2],
    failed_restarts: u32,
    health: Health,
    frozen: bool,
}

impl<S: PacketSource> Kinect<S> {
    /// Stops whatever a former program left running and reads the calibration.
    ///
    /// # Errors
    /// The camera does not answer, or not as a Kinect.
    pub fn open(source: S, settings: Settings) -> Result<Self, KinectError> {
        let mut kinect = Self {
            source,
            settings,
            registration: Registration::default(),
            tag: 0,
            audio_tag: 0,
            command: Vec::with_capacity(64),
            assemblers: Stream::BOTH.map(Assembler::new),
            pairing: Pairing::default(),
            streaming: false,
            heard: [Duration::ZERO; 2],
            failed_restarts: 0,
            health: Health::default(),
            frozen: false,
        };
        kinect.set(register::DEPTH_STREAM, 0)?;
        kinect.set(register::COLOUR_STREAM, 0)?;
        kinect.read_calibration()?;
        Ok(kinect)
    }

    /// Which sensor it is.
    pub fn model(&self) -> Model {
        self.source.model()
    }

    /// Serial of the unit.
    pub fn serial(&self) -> &str {
        self.source.serial()
    }

    /// Calibration of this unit.
    pub const fn registration(&self) -> &Registration {
        &self.registration
    }

    /// Counts so far.
    pub fn health(&self) -> Health {
        Health {
            streams: self
                .assemblers
                .each_ref()
                .map(|assembler| *assembler.tally()),
            unpaired: self.pairing.unpaired(),
            ..self.health
        }
    }

    /// The source below.
    pub const fn source(&self) -> &S {
        &self.source
    }

    /// The source below, to be changed: tests inject faults with it.
    pub const fn source_mut(&mut self) -> &mut S {
        &mut self.source
    }

    fn read_calibration(&mut self) -> Result<(), KinectError> {
        let mut registration = Registration::default();
        // The camera's own driver asks in this order: padding, optics, registration, shift.
        let model = self.model();
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
            let (status, content) = status_of(body)?;
            Ok((status, parse_block(block, content, registration)))
        })?;
        refused_unless_zero(Command::AlgorithmParameters, block as u16, status)?;
        Ok(parsed?)
    }

    fn set(&mut self, register: u16, value: u16) -> Result<(), KinectError> {
        let status = self.exchange(Command::SetParameter, &[register, value], |body| {
            Ok(status_of(body)?.0)
        })?;
        refused_unless_zero(Command::SetParameter, register, status)
    }

    /// One command and its reply, bounded in time and tries.
    fn exchange<T>(
        &mut self,
        command: Command,
        words: &[u16],
        mut read: impl FnMut(&[u8]) -> Result<T, BadReply>,
    ) -> Result<T, KinectError> {
        let mut failure = KinectError::NoReply {
            command: command as u16,
        };
        for _ in 0..TRIES {
            let tag = self.tag;
            // A new tag for every try: a late reply to the last one cannot be taken for this one's.
            self.tag = self.tag.wrapping_add(1);
            command::emit_command(command, tag, words, &mut self.command);
            match self.source.send(&self.command) {
                Ok(()) => {}
                Err(problem @ (DeviceError::Stall | DeviceError::TimedOut)) => {
                    failure = problem.into();
                    continue;
                }
                Err(problem) => return Err(problem.into()),
            }
            match self.reply(command, tag, &mut read) {
                Ok(value) => return Ok(value),
                Err(KinectError::Device(
                    problem @ (DeviceError::Gone | DeviceError::Other { .. }),
                )) => return Err(problem.into()),
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
        let mut failure = KinectError::NoReply {
            command: command as u16,
        };
        loop {
            let mut buffer = [0; command::REPLY];
            let n = self.source.receive(&mut buffer)?.min(buffer.len());
            if n != 0 && n != command::REPLY {
                match command::parse_reply(&buffer[..n], command, tag).and_then(&mut *read) {
                    Ok(value) => return Ok(value),
                    Err(problem) => {
                        failure = KinectError::BadReply {
                            command: command as u16,
                            problem,
                        };
                        // The reply to an older question: ours may still come.
                        if !matches!(problem, BadReply::Tag { .. } | BadReply::Command { .. }) {
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

    /// Starts both streams. All registers are written: some survive a former program.
    ///
    /// # Errors
    /// USB or the camera refuses.
    pub fn start(&mut self) -> Result<(), KinectError> {
        self.set(register::COLOUR_STREAM, 0)?;
        self.set(register::DEPTH_STREAM, 0)?;
        if self.model() == Model::Windows1517 {
            let (gain, companion) = if self.settings.near_mode {
                (0x07, 0)
            } else {
                (0x1e, 0x190)
            };
            self.set(register::DEPTH_GAIN, gain)?;
            self.source.sleep(NEAR_MODE_PAUSE);
            self.set(register::NEAR_MODE, companion)?;
        }
        for assembler in &mut self.assemblers {
            assembler.restart();
        }
        self.pairing.restart();

        // Transfers first, registers after: nothing of the first picture is missed.
        self.streaming = true;
        self.source.start(Stream::Depth)?;
        self.source.start(Stream::Colour)?;
        for (register, value) in [
            (register::PROJECTOR_CYCLE, 0),
            (register::DEPTH_FORMAT, 3),
            (register::DEPTH_RESOLUTION, 1),
            (register::DEPTH_RATE, 30),
            (register::DEPTH_STREAM, 2),
            (register::DEPTH_MIRROR, 0),
            (register::COLOUR_FORMAT, 0),
            (register::COLOUR_RESOLUTION, 1),
            (register::COLOUR_RATE, 30),
            (register::COLOUR_STREAM, 1),
            (register::COLOUR_MIRROR, 0),
        ] {
            self.set(register, value)?;
        }
        self.heard = [self.source.clock(); 2];
        if let Err(problem) = self.freeze(false) {
            tracing::warn!("exposure left as it was: {problem}");
        }
        Ok(())
    }

    /// Stops both streams. Whatever fails, the transfers are taken back.
    pub fn stop(&mut self) {
        if !core::mem::take(&mut self.streaming) {
            return;
        }
        for (register, stream) in [
            (register::DEPTH_STREAM, Stream::Depth),
            (register::COLOUR_STREAM, Stream::Colour),
        ] {
            if let Err(problem) = self.set(register, 0) {
                tracing::debug!("stopping the {stream:?} stream: {problem}");
            }
            self.source.stop(stream);
        }
    }

    /// Takes what arrived, waiting at most `wait` for something, and calls `each` for every pair completed (which it may
    /// swap for buffers of its own). Restarts streams that fell silent.
    ///
    /// # Errors
    /// The device is gone, or silent in spite of restarts.
    pub fn poll(
        &mut self,
        wait: Duration,
        pair: &mut RawPair,
        mut each: impl FnMut(&mut RawPair),
    ) -> Result<(), KinectError> {
        let Self {
            source,
            assemblers,
            pairing,
            health,
            ..
        } = self;
        let mut heard = [false; 2];
        source.poll(wait, &mut |received| {
            let i = received.stream.index();
            heard[i] |= !received.bytes.is_empty();
            let assembler = &mut assemblers[i];
            if let Some(ticks) = assembler.push(received.intact, received.bytes)
                && pairing.offer(received.stream, ticks, assembler.picture(), pair)
            {
                health.pairs += 1;
                each(pair);
            }
        })?;
        let now = self.source.clock();
        for stream in Stream::BOTH {
            let i = stream.index();
            if heard[i] {
                self.heard[i] = now;
            }
        }
        if heard == [true; 2] {
            self.failed_restarts = 0;
        }
        self.watch(now)
    }

    fn watch(&mut self, now: Duration) -> Result<(), KinectError> {
        let silent = Stream::BOTH
            .into_iter()
            .find(|stream| now.saturating_sub(self.heard[stream.index()]) >= SILENCE);
        let Some(stream) = silent.filter(|_| self.streaming) else {
            return Ok(());
        };
        if self.failed_restarts >= RESTARTS {
            return Err(KinectError::Silent { stream });
        }
        tracing::warn!("no {stream:?} packets for 1 s; restarting the Kinect's streams");
        self.failed_restarts += 1;
        self.health.restarts += 1;
        self.stop();
        self.start()
    }

    /// Holds (`true`) or frees (`false`) exposure and white balance.
    ///
    /// # Errors
    /// The camera refuses; the pictures go on.
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
            _ => Err(BadReply::Body {
                expected: 6,
                found: body.len(),
            }),
        })
    }

    /// Tells the camera whether a face is tracked: LED, and exposure held or freed if the settings say so.
    pub fn show_tracking(&mut self, tracking: bool) {
        let light = if tracking {
            Light::Green
        } else {
            Light::BlinkGreen
        };
        if let Err(problem) = self.set_light(light) {
            tracing::debug!("LED: {problem}");
        }
        if self.settings.freeze_exposure
            && tracking != self.frozen
            && let Err(problem) = self.freeze(tracking)
        {
            tracing::warn!("exposure: {problem}");
        }
    }

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

/// Status word and the rest of a reply's body.
fn status_of(body: &[u8]) -> Result<(u16, &[u8]), BadReply> {
    match body {
        [low, high, rest @ ..] => Ok((u16::from_le_bytes([*low, *high]), rest)),
        _ => Err(BadReply::Body {
            expected: 2,
            found: body.len(),
        }),
    }
}

fn refused_unless_zero(command: Command, register: u16, status: u16) -> Result<(), KinectError> {
    if status == 0 {
        return Ok(());
    }
    Err(KinectError::Refused {
        command: command as u16,
        register,
        status,
    })
}

/// Unpacks a pair into `frame`: depth, Bayer, luma, number and time.
pub fn develop(pair: &RawPair, clock: &mut PictureClock, frame: &mut Frame) {
    let [colour_ticks, ticks] = pair.ticks;
    let [bayer, packed] = &pair.pictures;
    (frame.index, frame.at) = clock.stamp(ticks);
    (frame.ticks, frame.colour_ticks) = (ticks, colour_ticks);
    unpack_depth(
        packed.first_chunk().expect("a depth picture's length"),
        &mut frame.depth,
    );
    frame.bayer.copy_from_slice(bayer);
    colour::luma_from_bayer(&frame.bayer, &mut frame.luma);
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use super::*;
    use crate::sensor::device::Received;
    use crate::sensor::stream::{Cutter, Layout};

    /// One 30 Hz second of packets through parsing, assembly, pairing, unpacking and luma.
    #[test]
    #[ignore = "a measurement: cargo test --lib kinect -- --ignored --nocapture"]
    fn time_per_frame() {
        let mut random = fastrand::Rng::with_seed(1);
        let mut packets: Vec<(Stream, Vec<u8>)> = Vec::new();
        let mut cutters = Stream::BOTH.map(|stream| Cutter::new(stream, 0));
        for number in 0..30 {
            for (cutter, stream) in cutters.iter_mut().zip(Stream::BOTH) {
                let mut picture = vec![0; Layout::of(stream).bytes];
                random.fill(&mut picture);
                for i in 0..cutter.layout().packets() {
                    let mut packet = [0; crate::sensor::packet::LONGEST];
                    let n = cutter.cut(&picture, number * 2_000_000, i, &mut packet);
                    packets.push((stream, packet[..n].to_vec()));
                }
            }
        }
        let mut assemblers = Stream::BOTH.map(Assembler::new);
        let mut pairing = Pairing::default();
        let mut pair = RawPair::default();
        let mut clock = PictureClock::default();
        let mut frame = Frame::default();
        let (mut best_all, mut best_packets) = (f64::MAX, f64::MAX);
        for round in 0..40 {
            let with_pictures = round % 2 == 0;
            let start = Instant::now();
            let mut frames = 0;
            for (stream, bytes) in &packets {
                let received = Received {
                    stream: *stream,
                    intact: true,
                    bytes,
                };
                let assembler = &mut assemblers[stream.index()];
                if let Some(ticks) = assembler.push(received.intact, received.bytes)
                    && pairing.offer(*stream, ticks, assembler.picture(), &mut pair)
                {
                    frames += 1;
                    if with_pictures {
                        develop(&pair, &mut clock, &mut frame);
                    }
                }
            }
            let ms = start.elapsed().as_secs_f64() * 1e3 / 30.0;
            assert_eq!(frames, 30);
            let best = if with_pictures {
                &mut best_all
            } else {
                &mut best_packets
            };
            *best = best.min(ms);
        }
        let start = Instant::now();
        for _ in 0..100 {
            unpack_depth(pair.pictures[1].first_chunk().unwrap(), &mut frame.depth);
            std::hint::black_box(&mut frame);
        }
        let unpack = start.elapsed().as_secs_f64() * 10.0;
        println!(
            "unpacking {unpack:.3} ms, packets to pictures {best_packets:.3} ms, with depth, Bayer and luma {best_all:.3} ms per frame"
        );
    }
}
