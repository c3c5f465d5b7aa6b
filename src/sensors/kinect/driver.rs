//! The camera over any [`PacketSource`]: calibration, start, pictures, watchdog, stop; LED, tilt, accelerometer.
//!
//! Every exchange is bounded: a reply is polled every millisecond for at most a second, and a failed exchange is retried twice with
//! a new tag. A stream without packets for a second is restarted; if that fails twice in a row, [`KinectError::Silent`] asks the
//! caller to reopen the device.
//!
//! Depth works without colour: after a second without a pair, depth pictures are delivered without colour; after five seconds, and
//! then at doubling intervals, the streams are restarted. A silent colour stream does not end depth.
//!
//! Errors of LED, tilt, accelerometer and automatic exposure do not stop the pictures. Memory: two pictures of each stream,
//! 1.5 MB, allocated at opening.

use crate::Frame;
use crate::sensor::Activity;
use core::time::Duration;
use mien_stages::base::settings::keyed;

use super::calibration::CalibrationError;
use super::colour;
use super::command::{BadReply, register};
use super::device::{DeviceError, Model, PacketSource, Stream};
use super::frame::FrameSink;
use super::motor::{Light, TILT_LIMIT_DEG};
use super::pairing::{Paired, Pairing, RawPair};
use super::picture_clock::PictureClock;
use super::registration::Registration;
use super::stream::{Assembler, Tally};
use super::unpack::unpack_depth;

mod exchange;

keyed! {
    /// Settings of the Kinect.
    #[derive(Copy)]
    pub struct Settings {
        /// Kinect for Windows: measure from 0.4 m instead of 0.8 m.
        near_mode: bool = true => Bool(),
        /// Whether exposure and white balance are locked while a face is tracked.
        freeze_exposure: bool = false => Bool(),
        /// Whether the motor tilts the Kinect when it is opened.
        set_tilt: bool = false => Bool(),
        /// The tilt, relative to the horizon.
        tilt_deg: f32 = 0.0 => number(-TILT_LIMIT_DEG, TILT_LIMIT_DEG, "degrees"),
        /// Model 1473 and Kinect for Windows: reset the audio device when opening, for sensors that otherwise stop streaming.
        reset_audio: bool = false => Bool(),
    }
}

/// A stream without packets for this long is restarted.
const SILENCE_LIMIT: Duration = Duration::from_secs(1);
/// Consecutive restarts that may fail before the device is reopened.
const RESTARTS: u32 = 2;
/// Time without a pair after which depth pictures are delivered without colour.
const DEPTH_ONLY_AFTER: Duration = Duration::from_secs(1);
/// Time without a pair after which the streams are restarted; doubles with every restart.
const RESTART_AFTER: Duration = Duration::from_secs(5);
/// Longest time between restarts for lack of pairs.
const RESTART_AFTER_MAX: Duration = Duration::from_secs(80);
/// Rate of whole pictures below which, but above 0, a stream is taken to lose packets, which a restart does not cure.
const LOSSY_HZ: u64 = 15;
/// Pause that the camera needs between the two registers of near mode.
const NEAR_MODE_PAUSE: Duration = Duration::from_millis(100);

/// Why the camera does not deliver.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum KinectError {
    /// USB error.
    #[error(transparent)]
    Device(#[from] DeviceError),
    /// No reply to this command.
    #[error(
        "the Kinect did not reply to command 0x{0:02x} within 1 s; unplug it and plug it in again"
    )]
    NoReply(u16),
    /// Wrong reply to this command, in all tries.
    #[error(
        "the Kinect's reply to command 0x{0:02x} is wrong: {1}; unplug it and plug it in again"
    )]
    BadReply(u16, BadReply),
    /// The camera refused a command: command, register or block, status.
    #[error(
        "the Kinect refused command 0x{0:02x} for 0x{1:03x} with status {2}; unplug it and plug it in again"
    )]
    Refused(u16, u16, u16),
    /// The calibration is invalid.
    #[error(transparent)]
    Calibration(#[from] CalibrationError),
    /// No packets on this stream in spite of restarts.
    #[error(
        "the Kinect sends no {0:?} packets although it was restarted; check its power supply and give it its own USB controller"
    )]
    Silent(Stream),
}

/// Counters since opening.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Health {
    /// Packet counters by stream.
    pub streams: [Tally; 2],
    /// Whole pictures without a partner, by stream.
    pub unpaired: [u64; 2],
    /// Pairs delivered.
    pub pairs: u64,
    /// Depth pictures delivered without colour.
    pub depth_only: u64,
    /// Restarts of the streams by the watchdog.
    pub restarts: u64,
}

/// An opened camera.
pub struct Kinect<S> {
    /// The device.
    pub source: S,
    settings: Settings,
    /// Calibration of this unit.
    pub registration: Registration,
    /// What its accelerometer measured at opening, as [`super::motor::acceleration`]; `None` if it could not be asked.
    pub acceleration: Option<[i16; 3]>,
    tag: u16,
    audio_tag: u32,
    command: Vec<u8>,
    assemblers: [Assembler; 2],
    pairing: Pairing,
    streaming: bool,
    /// Arrival of the last packet, by stream.
    last_packet: [Duration; 2],
    failed_restarts: u32,
    /// Time of the last pair, or of the start, and the number of whole pictures by stream at that time.
    last_pair: (Duration, [u64; 2]),
    /// When to restart the streams if no pair has arrived.
    restart_at: Duration,
    /// Current interval between restarts for lack of pairs.
    backoff: Duration,
    health: Health,
    frozen: bool,
}

impl<S: PacketSource> Kinect<S> {
    /// Stops streams that a former program left running and reads the calibration.
    ///
    /// # Errors
    /// If the camera does not answer as a Kinect does.
    pub fn open(source: S, settings: Settings) -> Result<Self, KinectError> {
        let mut kinect = Self {
            source,
            settings,
            registration: Registration::default(),
            acceleration: None,
            tag: 0,
            audio_tag: 0,
            command: Vec::with_capacity(64),
            assemblers: Stream::BOTH.map(Assembler::new),
            pairing: Pairing::default(),
            streaming: false,
            last_packet: [Duration::ZERO; 2],
            failed_restarts: 0,
            last_pair: (Duration::ZERO, [0; 2]),
            restart_at: Duration::MAX,
            backoff: RESTART_AFTER,
            health: Health::default(),
            frozen: false,
        };
        kinect.set_register(register::DEPTH_STREAM, 0)?;
        kinect.set_register(register::COLOUR_STREAM, 0)?;
        kinect.read_calibration()?;
        kinect.acceleration = kinect
            .read_acceleration()
            .inspect_err(|problem| tracing::debug!("accelerometer: {problem}"))
            .ok();
        if settings.set_tilt
            && let Err(problem) = kinect.tilt(settings.tilt_deg)
        {
            tracing::info!("tilt not set: {problem}");
        }
        Ok(kinect)
    }

    /// Counters so far.
    pub fn health(&self) -> Health {
        Health {
            streams: self.assemblers.each_ref().map(|assembler| assembler.tally),
            unpaired: self.pairing.unpaired,
            ..self.health
        }
    }

    /// Starts both streams. Writes all registers, because a former program may have left other values.
    ///
    /// # Errors
    /// If USB or the camera refuses.
    pub fn start(&mut self) -> Result<(), KinectError> {
        self.switch_on()?;
        self.note_pair(self.source.clock());
        Ok(())
    }

    fn switch_on(&mut self) -> Result<(), KinectError> {
        self.set_register(register::COLOUR_STREAM, 0)?;
        self.set_register(register::DEPTH_STREAM, 0)?;
        if self.source.model() == Model::Windows1517 {
            let (gain, companion) = if self.settings.near_mode {
                (0x07, 0)
            } else {
                (0x1e, 0x190)
            };
            self.set_register(register::DEPTH_GAIN, gain)?;
            self.source.sleep(NEAR_MODE_PAUSE);
            self.set_register(register::NEAR_MODE, companion)?;
        }
        for assembler in &mut self.assemblers {
            assembler.restart();
        }
        self.pairing.restart();

        // Transfers before registers, so that the first picture is complete.
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
            self.set_register(register, value)?;
        }
        self.last_packet = [self.source.clock(); 2];
        if let Err(problem) = self.freeze(false) {
            tracing::warn!("exposure not changed: {problem}");
        }
        Ok(())
    }

    /// Stops both streams. Transfers are cancelled even if the camera does not answer.
    pub fn stop(&mut self) {
        if !core::mem::take(&mut self.streaming) {
            return;
        }
        for (register, stream) in [
            (register::DEPTH_STREAM, Stream::Depth),
            (register::COLOUR_STREAM, Stream::Colour),
        ] {
            if let Err(problem) = self.set_register(register, 0) {
                tracing::debug!("stopping the {stream:?} stream: {problem}");
            }
            self.source.stop(stream);
        }
    }

    /// Processes received packets, waiting for at most `wait`. Calls `each` for every completed pair, and after a second without
    /// pairs for every depth picture. Restarts streams that are silent or do not pair.
    ///
    /// # Errors
    /// If the device is gone, or silent in spite of restarts.
    pub fn poll(
        &mut self,
        wait: Duration,
        mut each: impl FnMut(Paired<'_>),
    ) -> Result<(), KinectError> {
        let Self {
            source,
            assemblers,
            pairing,
            health,
            ..
        } = self;
        let (mut arrived, mut paired) = ([false; 2], false);
        source.poll(wait, &mut |received| {
            let i = received.stream.index();
            arrived[i] |= !received.bytes.is_empty();
            let assembler = &mut assemblers[i];
            let Some(ticks) = assembler.push(received.intact, received.bytes) else {
                return;
            };
            let number = assembler.tally.pictures - 1;
            let picture = &mut assembler.picture;
            if let Some(pair) = pairing.offer(received.stream, number, ticks, picture) {
                let made = u64::from(pair.has_colour());
                paired |= made > 0;
                health.pairs += made;
                health.depth_only += 1 - made;
                each(pair);
            }
        })?;
        let now = self.source.clock();
        for (at, _) in self
            .last_packet
            .iter_mut()
            .zip(arrived)
            .filter(|(_, arrived)| *arrived)
        {
            *at = now;
        }
        if arrived == [true; 2] {
            self.failed_restarts = 0;
        }
        if paired {
            self.note_pair(now);
        }
        self.watchdog(now)
    }

    /// Restarts the timers for lack of pairs: after a pair, or at the start.
    fn note_pair(&mut self, now: Duration) {
        self.pairing.depth_only = false;
        self.last_pair = (now, self.picture_counts());
        (self.restart_at, self.backoff) = (now + RESTART_AFTER, RESTART_AFTER);
    }

    /// Whole pictures so far, by stream.
    fn picture_counts(&self) -> [u64; 2] {
        self.assemblers.each_ref().map(|one| one.tally.pictures)
    }

    /// Whether packet loss explains the lack of pairs.
    fn is_lossy(&self, unpaired: Duration) -> bool {
        let (_, before) = self.last_pair;
        let mut came = self.picture_counts().into_iter().zip(before);
        came.any(|(now, before)| (1..LOSSY_HZ * unpaired.as_secs()).contains(&(now - before)))
    }

    fn watchdog(&mut self, now: Duration) -> Result<(), KinectError> {
        if !self.streaming {
            return Ok(());
        }
        let unpaired = now.saturating_sub(self.last_pair.0);
        if unpaired >= DEPTH_ONLY_AFTER && !self.pairing.depth_only {
            let [colour, depth] = self.pairing.unpaired;
            tracing::warn!(
                "no colour picture has matched a depth picture for 1 s ({colour} colour and {depth} depth pictures unpaired so far); tracking continues without colour"
            );
            self.pairing.depth_only = true;
        }
        let silent =
            |stream: &Stream| now.saturating_sub(self.last_packet[stream.index()]) >= SILENCE_LIMIT;
        let silent = [Stream::Depth, Stream::Colour].into_iter().find(silent);
        match silent {
            Some(stream) if self.failed_restarts < RESTARTS => {
                tracing::warn!("no {stream:?} packets for 1 s; restarting the Kinect's streams");
                self.failed_restarts += 1;
            }
            Some(stream @ Stream::Depth) => return Err(KinectError::Silent(stream)),
            _ if now >= self.restart_at && !self.is_lossy(unpaired) => {
                tracing::warn!(
                    "depth and colour pictures do not pair; restarting the Kinect's streams"
                );
                self.backoff = (2 * self.backoff).min(RESTART_AFTER_MAX);
                self.restart_at = now + self.backoff;
            }
            _ => return Ok(()),
        }
        self.health.restarts += 1;
        self.stop();
        self.switch_on()
    }

    /// Shows the activity on the LED, and locks or frees exposure if the settings say so.
    pub fn show(&mut self, activity: Activity) {
        let light = match activity {
            Activity::Searching => Light::BlinkGreen,
            Activity::Tracking => Light::Green,
            Activity::Gesture => Light::Yellow,
        };
        let tracking = activity != Activity::Searching;
        if let Err(problem) = self.set_light(light) {
            tracing::debug!("LED: {problem}");
        }
        if self.settings.freeze_exposure
            && tracking != self.frozen
            && let Err(problem) = self.freeze(tracking)
        {
            tracing::warn!("exposure not changed: {problem}");
        }
    }
}

/// Unpacks a pair, or a depth picture without colour, and sets number and capture time. The Bayer picture is swapped, not copied.
pub fn unpack_into(pair: &mut RawPair, clock: &mut PictureClock, into: &mut impl FrameSink) {
    let [colour_ticks, ticks] = pair.ticks;
    let (frame, original) = into.parts();
    (frame.index, frame.at) = (pair.number, clock.stamp(ticks));
    depth_from_pair(pair, frame);
    if pair.has_colour {
        luma_from_pair(pair, frame);
    } else {
        frame.drop_colour();
    }
    let Some(original) = original else { return };
    original.ticks = ticks;
    if pair.has_colour {
        original.colour_ticks = colour_ticks;
        let bayer = &mut pair.pictures[Stream::Colour.index()];
        let taken = core::mem::take(bayer).try_into();
        let taken = taken.expect("a colour picture's length");
        let former = core::mem::replace(&mut original.bayer, taken);
        *bayer = former;
    } else {
        original.drop_colour();
    }
}

/// Unpacks the depth picture of a pair to raw values.
pub fn depth_from_pair(pair: &RawPair, frame: &mut Frame) {
    let packed = pair.pictures[Stream::Depth.index()].first_chunk();
    unpack_depth(packed.expect("a depth picture's length"), &mut frame.depth);
}

/// Converts the Bayer picture of a pair to luma.
pub fn luma_from_pair(pair: &RawPair, frame: &mut Frame) {
    let bayer = pair.pictures[Stream::Colour.index()].first_chunk();
    frame.has_colour = true;
    colour::luma_from_bayer(bayer.expect("a colour picture's length"), &mut frame.luma);
}
