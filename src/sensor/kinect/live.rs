//! A Kinect that may come and go: its own thread opens it, keeps it streaming, and reopens it after it was unplugged, lost
//! power, or fell silent. The consumer takes frames, or learns what the thread is waiting for.
//!
//! The thread reaps packets, copies payloads into pictures, and hands pairs of pictures over through a bounded ring in
//! which the newest wins: a slow consumer loses frames (counted), but costs no memory and adds no delay. Unpacking and luma
//! are done by the consumer. Memory: two pairs, 1.5 MB, allocated at the start; a pair is handed over by swapping buffers.

use core::time::Duration;
use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Instant;

use super::device::{DeviceError, Model, PacketSource, Stream};
use super::driver::{Health, Kinect, KinectError, Settings, develop};
use super::frame::Developed;
use super::motor::Light;
use super::pairing::{Paired, RawPair};
use super::picture_clock::PictureClock;
use super::registration::Registration;
use super::usb::UsbKinect;
use crate::base::capacity::WAITING_FRAMES as RING;
use crate::sensor::camera::Camera;

/// Between two looks for an absent device.
const RETRY: Duration = Duration::from_millis(500);
/// Longest wait for packets; commands and the end are noticed as often.
const POLL: Duration = Duration::from_millis(20);

/// What there is to know about the sensor besides its frames.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Status {
    /// Why there are no frames; `None` while streaming, and before the first attempt.
    pub waiting_for: Option<KinectError>,
    /// The sensor last opened.
    pub sensor: Option<(Model, String)>,
    /// Counts of the sensor last opened, since then.
    pub health: Health,
    /// Times a sensor was opened.
    pub openings: u64,
    /// Frames overwritten because the consumer was slow.
    pub overwritten: u64,
}

struct Shared {
    inner: Mutex<Inner>,
    news: Condvar,
}

struct Inner {
    /// Filled pairs, oldest first, each with the opening it belongs to and the time it was whole.
    ring: VecDeque<(u64, Instant, RawPair)>,
    free: Vec<RawPair>,
    status: Status,
    registration: Registration,
    tracking: Option<bool>,
    tilt_deg: Option<f32>,
    end: bool,
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Inner> {
        // What is inside stays consistent at every step, even if a holder panicked.
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The consumer's end.
pub struct LiveKinect {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
    clock: PictureClock,
    /// Opening of the last frame, and when it was taken from the ring.
    last: Option<(u64, Instant)>,
    arrived: Option<Instant>,
    registration: Registration,
    camera: Camera,
}

impl LiveKinect {
    /// A Kinect on USB: the one with `serial`, else the first that is free. Returns at once, whether or not it is there.
    #[must_use]
    pub fn usb(serial: Option<String>, settings: Settings) -> Self {
        Self::over(
            move || UsbKinect::open(serial.as_deref(), settings.reset_audio),
            settings,
        )
    }

    /// Whatever `open` opens; it is called again until it succeeds, and whenever the device is lost.
    pub fn over<S: PacketSource>(
        open: impl FnMut() -> Result<S, DeviceError> + Send + 'static,
        settings: Settings,
    ) -> Self {
        let shared = Arc::new(Shared {
            inner: Mutex::new(Inner {
                ring: VecDeque::with_capacity(RING),
                free: (0..RING).map(|_| RawPair::default()).collect(),
                status: Status::default(),
                registration: Registration::default(),
                tracking: None,
                tilt_deg: None,
                end: false,
            }),
            news: Condvar::new(),
        });
        let theirs = Arc::clone(&shared);
        let thread = std::thread::Builder::new()
            .name("kinect".to_owned())
            .spawn(move || feed(&theirs, open, settings))
            .map_err(|problem| tracing::error!("cannot start the sensor thread: {problem}"))
            .ok();
        Self {
            shared,
            thread,
            clock: PictureClock::default(),
            last: None,
            arrived: None,
            registration: Registration::default(),
            camera: Registration::default().camera(),
        }
    }

    /// Fills `frame` with the oldest frame in the ring, waiting at most `wait` for one; false if none came.
    pub fn next_frame(&mut self, frame: &mut impl Developed, wait: Duration) -> bool {
        let deadline = Instant::now() + wait;
        let mut inner = self.shared.lock();
        let (opening, mut pair) = loop {
            if let Some((opening, arrived, pair)) = inner.ring.pop_front() {
                self.arrived = Some(arrived);
                break (opening, pair);
            }
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return false;
            }
            let (guard, _) = self
                .shared
                .news
                .wait_timeout(inner, left)
                .unwrap_or_else(PoisonError::into_inner);
            inner = guard;
        };
        let now = Instant::now();
        if let Some((former, at)) = self.last
            && former != opening
        {
            self.clock.restart(now - at);
        }
        if self.last.is_none_or(|(former, _)| former != opening) {
            Self::calibrate(
                &mut self.registration,
                &mut self.camera,
                &inner.registration,
            );
        }
        self.last = Some((opening, now));
        drop(inner);
        develop(&mut pair, &mut self.clock, frame);
        self.shared.lock().free.push(pair);
        true
    }

    /// Waits until a sensor has been opened or the first attempt has failed, at most `wait`.
    #[must_use]
    pub fn wait_for_first_attempt(&mut self, wait: Duration) -> Status {
        let deadline = Instant::now() + wait;
        let mut inner = self.shared.lock();
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            if inner.status.openings > 0 || inner.status.waiting_for.is_some() || left.is_zero() {
                Self::calibrate(
                    &mut self.registration,
                    &mut self.camera,
                    &inner.registration,
                );
                return inner.status.clone();
            }
            let (guard, _) = self
                .shared
                .news
                .wait_timeout(inner, left)
                .unwrap_or_else(PoisonError::into_inner);
            inner = guard;
        }
    }

    /// State and counts.
    #[must_use]
    pub fn status(&self) -> Status {
        self.shared.lock().status.clone()
    }

    /// Calibration of the sensor behind the last frame; the usual one before the first.
    #[must_use]
    pub const fn registration(&self) -> &Registration {
        &self.registration
    }

    /// The same in the form the stages use.
    #[must_use]
    pub const fn camera(&self) -> &Camera {
        &self.camera
    }

    fn calibrate(known: &mut Registration, camera: &mut Camera, read: &Registration) {
        if known != read {
            known.clone_from(read);
            *camera = read.camera();
        }
    }

    /// When the last frame was whole in this machine's memory.
    #[must_use]
    pub fn arrived(&self) -> Option<Instant> {
        self.arrived
    }

    /// Tells the sensor whether a face is tracked: LED, and exposure if the settings say so. Cheap to call every frame.
    pub fn show_tracking(&self, tracking: bool) {
        self.shared.lock().tracking = Some(tracking);
    }

    /// Tilts the sensor to `degrees` above the horizon, where it has a motor.
    pub fn tilt(&self, degrees: f32) {
        self.shared.lock().tilt_deg = Some(degrees);
    }
}

impl Drop for LiveKinect {
    fn drop(&mut self) {
        self.shared.lock().end = true;
        self.shared.news.notify_all();
        if let Some(thread) = self.thread.take() {
            // A panic there has been reported already.
            let _ = thread.join();
        }
    }
}

/// The thread: open, stream, and again.
fn feed<S: PacketSource>(
    shared: &Shared,
    mut open: impl FnMut() -> Result<S, DeviceError>,
    settings: Settings,
) {
    let mut attempted = false;
    // Whole depth pictures of former openings: numbering goes on.
    let mut pictures = 0;
    loop {
        let problem = match open()
            .map_err(KinectError::from)
            .and_then(|source| Kinect::open(source, settings))
        {
            Ok(kinect) => {
                attempted = true;
                match stream(shared, kinect, &mut pictures) {
                    Ok(()) => return,
                    Err(problem) => problem,
                }
            }
            Err(problem) => problem,
        };
        let mut inner = shared.lock();
        if inner.status.waiting_for.as_ref() != Some(&problem) {
            // What became of the first attempt is for the one who asked for the sensor to say.
            if attempted {
                tracing::warn!("waiting for the Kinect: {problem}");
            }
            inner.status.waiting_for = Some(problem);
            shared.news.notify_all();
        }
        attempted = true;
        let deadline = Instant::now() + RETRY;
        loop {
            if inner.end {
                return;
            }
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                break;
            }
            let (guard, _) = shared
                .news
                .wait_timeout(inner, left)
                .unwrap_or_else(PoisonError::into_inner);
            inner = guard;
        }
    }
}

/// Streams until asked to stop (`Ok`) or the device fails. `pictures`: whole depth pictures before and after.
fn stream<S: PacketSource>(
    shared: &Shared,
    mut kinect: Kinect<S>,
    pictures: &mut u64,
) -> Result<(), KinectError> {
    let opening = {
        let mut inner = shared.lock();
        inner.status.sensor = Some((kinect.model(), kinect.serial().to_owned()));
        inner.status.openings += 1;
        inner.registration = kinect.registration().clone();
        inner.status.openings
    };
    let result = kinect.start().and_then(|()| {
        tracing::info!(
            "streaming from {}, serial {}",
            kinect.model(),
            kinect.serial()
        );
        let mut shown = None;
        loop {
            let mut delivered = false;
            kinect.poll(POLL, |pair| {
                delivered = true;
                hand_over(shared, opening, *pictures, pair);
            })?;
            let mut inner = shared.lock();
            if inner.end {
                return Ok(());
            }
            if delivered {
                inner.status.health = kinect.health();
                inner.status.waiting_for = None;
            }
            let tracking = Some(inner.tracking.unwrap_or(false));
            let tilt = inner.tilt_deg.take();
            drop(inner);
            if shown != tracking {
                shown = tracking;
                kinect.show_tracking(tracking == Some(true));
            }
            if let Some(degrees) = tilt
                && let Err(problem) = kinect.tilt(degrees)
            {
                tracing::warn!("tilt: {problem}");
            }
        }
    });
    let light = match &result {
        Ok(()) => Light::Off,
        Err(_) => Light::Red,
    };
    if let Err(problem) = kinect.set_light(light) {
        tracing::debug!("LED: {problem}");
    }
    kinect.stop();
    *pictures += kinect.health().streams[Stream::Depth.index()].pictures;
    let mut inner = shared.lock();
    inner.status.health = kinect.health();
    for stream in Stream::BOTH {
        let health = &inner.status.health;
        let tally = health.streams[stream.index()];
        tracing::info!(
            "{stream:?}: {} pictures whole, {} broken; packets {}, lost {}, repeated {}, damaged {}, bus errors {}, wrong length {}, misplaced {}; unpaired pictures {}, depth alone {}, restarts {}",
            tally.pictures,
            tally.broken,
            tally.packets,
            tally.lost,
            tally.repeated,
            tally.damaged,
            tally.bus_errors,
            tally.wrong_length,
            tally.misplaced,
            health.unpaired[stream.index()],
            health.alone,
            health.restarts,
        );
    }
    result
}

/// Swaps a completed pair into the ring, numbered on from `former` pictures; the oldest in it gives way.
fn hand_over(shared: &Shared, opening: u64, former: u64, pair: Paired<'_>) {
    let mut inner = shared.lock();
    if inner.free.is_empty()
        && let Some((_, _, oldest)) = inner.ring.pop_front()
    {
        inner.status.overwritten += 1;
        inner.free.push(oldest);
    }
    if let Some(mut filled) = inner.free.pop() {
        pair.swap_into(&mut filled);
        filled.number += former;
        inner.ring.push_back((opening, Instant::now(), filled));
        shared.news.notify_all();
    }
}
