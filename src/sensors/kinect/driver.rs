//! The camera over any [`PacketSource`]: calibration, start, pictures, watchdog, stop; LED and tilt.
//!
//! Every exchange is bounded: a reply is polled every millisecond for at most a second, and a failed exchange is retried
//! twice with a new tag. A stream that delivers no packet for a second is stopped and restarted; if that fails twice in a
//! row, [`KinectError::Silent`] asks the caller to reopen the device.
//!
//! Depth is useful without colour: after a second without a pair, depth pictures are passed on alone, and this is logged;
//! after five seconds, and then at doubling intervals, the streams are restarted. A colour stream that stays silent does
//! not end depth.
//!
//! Nothing inessential stops the pictures: LED, tilt and the automatic functions of the colour sensor report their
//! errors and change nothing else. Memory: two pictures of each stream, 1.5 MB, allocated at opening.

use crate::Frame;
use core::time::Duration;
use mien_stages::base::settings::keyed;

use super::calibration::CalibrationError;
use super::colour;
use super::command::{BadReply, register};
use super::device::{DeviceError, Model, PacketSource, Stream};
use super::frame::Developed;
use super::motor::{Light, TILT_LIMIT_DEG};
use super::pairing::{Paired, Pairing, RawPair};
use super::picture_clock::PictureClock;
use super::registration::Registration;
use super::stream::{Assembler, Tally};
use super::unpack::unpack_depth;

mod exchange;

keyed! {
    /// What can be chosen.
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

/// A stream is dead when nothing came for this long.
const SILENCE: Duration = Duration::from_secs(1);
/// Consecutive restarts that may fail before the device is reopened.
const RESTARTS: u32 = 2;
/// Without a pair for this long depth pictures are given alone.
const ALONE: Duration = Duration::from_secs(1);
/// Without a pair for this long the streams are restarted; each time waits twice as long as the one before,
const UNPAIRED: Duration = Duration::from_secs(5);
/// up to this.
const UNPAIRED_MOST: Duration = Duration::from_secs(80);
/// A stream of fewer whole pictures a second than this, but some, loses packets, which a restart does not mend.
const LOSSY_HZ: u64 = 15;
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
        "the Kinect did not reply to command 0x{0:02x} within 1 s; unplug it and plug it in again"
    )]
    NoReply(u16),
    /// A command got a wrong reply, three times.
    #[error(
        "the Kinect's reply to command 0x{0:02x} is wrong: {1}; unplug it and plug it in again"
    )]
    BadReply(u16, BadReply),
    /// The camera answered a command, for a register or block, with an error: its status.
    #[error(
        "the Kinect refused command 0x{0:02x} for 0x{1:03x} with status {2}; unplug it and plug it in again"
    )]
    Refused(u16, u16, u16),
    /// The calibration is not a Kinect's.
    #[error(transparent)]
    Calibration(#[from] CalibrationError),
    /// No packets although the stream was restarted.
    #[error(
        "the Kinect sends no {0:?} packets although it was restarted; check its power supply and give it its own USB controller"
    )]
    Silent(Stream),
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
    /// Depth pictures given without colour.
    pub alone: u64,
    /// Times the watchdog restarted the streams.
    pub restarts: u64,
}

/// An opened camera.
pub struct Kinect<S> {
    /// The source below.
    pub source: S,
    settings: Settings,
    /// Calibration of this unit.
    pub registration: Registration,
    tag: u16,
    audio_tag: u32,
    command: Vec<u8>,
    assemblers: [Assembler; 2],
    pairing: Pairing,
    streaming: bool,
    /// When the last packet came, by stream.
    heard: [Duration; 2],
    failed_restarts: u32,
    /// When the last pair was made, or the sensor started, and whole pictures by stream until then;
    paired: (Duration, [u64; 2]),
    /// when the streams are restarted if there is none until then,
    restart_at: Duration,
    /// and how long it was waited for that.
    patience: Duration,
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
            paired: (Duration::ZERO, [0; 2]),
            restart_at: Duration::MAX,
            patience: UNPAIRED,
            health: Health::default(),
            frozen: false,
        };
        kinect.set(register::DEPTH_STREAM, 0)?;
        kinect.set(register::COLOUR_STREAM, 0)?;
        kinect.read_calibration()?;
        if settings.set_tilt
            && let Err(problem) = kinect.tilt(settings.tilt_deg)
        {
            tracing::info!("tilt not set: {problem}");
        }
        Ok(kinect)
    }

    /// Counts so far.
    pub fn health(&self) -> Health {
        Health {
            streams: self.assemblers.each_ref().map(|assembler| assembler.tally),
            unpaired: self.pairing.unpaired,
            ..self.health
        }
    }

    /// Starts both streams. All registers are written: some survive a former program.
    ///
    /// # Errors
    /// USB or the camera refuses.
    pub fn start(&mut self) -> Result<(), KinectError> {
        self.switch_on()?;
        self.is_paired(self.source.clock());
        Ok(())
    }

    fn switch_on(&mut self) -> Result<(), KinectError> {
        self.set(register::COLOUR_STREAM, 0)?;
        self.set(register::DEPTH_STREAM, 0)?;
        if self.source.model() == Model::Windows1517 {
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
            tracing::warn!("exposure not changed: {problem}");
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

    /// Takes what arrived, waiting at most `wait` for something, and calls `each` for every pair completed, or, when there have
    /// been none for a second, for every depth picture. Restarts streams that fell silent or make no pairs.
    ///
    /// # Errors
    /// The device is gone, or silent in spite of restarts.
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
        let (mut heard, mut paired) = ([false; 2], false);
        source.poll(wait, &mut |received| {
            let i = received.stream.index();
            heard[i] |= !received.bytes.is_empty();
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
                health.alone += 1 - made;
                each(pair);
            }
        })?;
        let now = self.source.clock();
        for (at, _) in self.heard.iter_mut().zip(heard).filter(|(_, heard)| *heard) {
            *at = now;
        }
        if heard == [true; 2] {
            self.failed_restarts = 0;
        }
        if paired {
            self.is_paired(now);
        }
        self.watch(now)
    }

    /// A pair was made, or waiting for one starts now.
    fn is_paired(&mut self, now: Duration) {
        self.pairing.alone = false;
        self.paired = (now, self.pictures());
        (self.restart_at, self.patience) = (now + UNPAIRED, UNPAIRED);
    }

    /// Whole pictures so far, by stream.
    fn pictures(&self) -> [u64; 2] {
        self.assemblers.each_ref().map(|one| one.tally.pictures)
    }

    /// Whether a stream that came through badly is reason enough for there being no pairs.
    fn is_lossy(&self, unpaired: Duration) -> bool {
        let (_, before) = self.paired;
        let mut came = self.pictures().into_iter().zip(before);
        came.any(|(now, before)| (1..LOSSY_HZ * unpaired.as_secs()).contains(&(now - before)))
    }

    fn watch(&mut self, now: Duration) -> Result<(), KinectError> {
        if !self.streaming {
            return Ok(());
        }
        let unpaired = now.saturating_sub(self.paired.0);
        if unpaired >= ALONE && !self.pairing.alone {
            let [colour, depth] = self.pairing.unpaired;
            tracing::warn!(
                "no colour picture has matched a depth picture for 1 s ({colour} colour and {depth} depth pictures unpaired so far); tracking continues without colour"
            );
            self.pairing.alone = true;
        }
        let silent = |stream: &Stream| now.saturating_sub(self.heard[stream.index()]) >= SILENCE;
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
                self.patience = (2 * self.patience).min(UNPAIRED_MOST);
                self.restart_at = now + self.patience;
            }
            _ => return Ok(()),
        }
        self.health.restarts += 1;
        self.stop();
        self.switch_on()
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
            tracing::warn!("exposure not changed: {problem}");
        }
    }
}

/// Unpacks a pair, or a depth picture alone. The Bayer picture is swapped, not copied.
pub fn develop(pair: &mut RawPair, clock: &mut PictureClock, into: &mut impl Developed) {
    let [colour_ticks, ticks] = pair.ticks;
    let (frame, original) = into.parts();
    (frame.index, frame.at) = (pair.number, clock.stamp(ticks));
    develop_depth(pair, frame);
    if pair.has_colour {
        develop_colour(pair, frame);
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

/// The depth half of [`develop`].
pub fn develop_depth(pair: &RawPair, frame: &mut Frame) {
    let packed = pair.pictures[Stream::Depth.index()].first_chunk();
    unpack_depth(packed.expect("a depth picture's length"), &mut frame.depth);
}

/// The colour half of [`develop`].
pub fn develop_colour(pair: &RawPair, frame: &mut Frame) {
    let bayer = pair.pictures[Stream::Colour.index()].first_chunk();
    frame.has_colour = true;
    colour::luma_from_bayer(bayer.expect("a colour picture's length"), &mut frame.luma);
}
