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
use super::stream::Tally;
use super::usb::UsbKinect;
use mien_stages::base::capacity::WAITING_FRAMES as RING;
use mien_stages::base::defaults;
use mien_stages::camera::Camera;

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

#[derive(Default)]
struct Shared {
    inner: Mutex<Inner>,
    news: Condvar,
}

defaults! {
    struct Inner {
        /// Filled pairs, oldest first, each with the opening it belongs to and the time it was whole.
        ring: VecDeque<(u64, Instant, RawPair)> = VecDeque::with_capacity(RING),
        free: Vec<RawPair> = (0..RING).map(|_| RawPair::default()).collect(),
        status: Status = Status::default(),
        registration: Registration = Registration::default(),
        tracking: bool = false,
        end: bool = false,
    }
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Inner> {
        // What is inside stays consistent at every step, even if a holder panicked.
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits for what `is_over` looks for, until it is there or at most `wait`.
    fn wait(&self, wait: Duration, is_over: impl Fn(&Inner) -> bool) -> MutexGuard<'_, Inner> {
        let waited = (self.news).wait_timeout_while(self.lock(), wait, |inner| !is_over(inner));
        waited.unwrap_or_else(PoisonError::into_inner).0
    }
}

/// The consumer's end.
pub struct LiveKinect {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
    clock: PictureClock,
    /// Opening of the last frame, and when it was taken from the ring.
    last: Option<(u64, Instant)>,
    /// When the last frame was whole in this machine's memory.
    pub arrived: Option<Instant>,
    /// Calibration of the sensor behind the last frame; the usual one before the first.
    pub registration: Registration,
    /// The same in the form the stages use.
    pub camera: Camera,
}

impl LiveKinect {
    /// A Kinect on USB: the one with `serial`, else the first that is free. Returns at once, whether or not it is there.
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
        let shared = Arc::<Shared>::default();
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
        let mut inner = self.shared.wait(wait, |inner| !inner.ring.is_empty());
        let Some((opening, arrived, mut pair)) = inner.ring.pop_front() else {
            return false;
        };
        self.arrived = Some(arrived);
        let now = Instant::now();
        if let Some((former, at)) = self.last
            && former != opening
        {
            self.clock.restart(now - at);
        }
        if self.last.is_none_or(|(former, _)| former != opening) {
            self.registration.clone_from(&inner.registration);
            self.camera = inner.registration.camera();
        }
        self.last = Some((opening, now));
        drop(inner);
        develop(&mut pair, &mut self.clock, frame);
        self.shared.lock().free.push(pair);
        true
    }

    /// Waits until a sensor has been opened or the first attempt has failed, at most `wait`.
    pub fn wait_for_first_attempt(&mut self, wait: Duration) -> Status {
        let attempted =
            |inner: &Inner| inner.status.openings > 0 || inner.status.waiting_for.is_some();
        let inner = self.shared.wait(wait, attempted);
        self.registration.clone_from(&inner.registration);
        self.camera = inner.registration.camera();
        inner.status.clone()
    }

    /// State and counts.
    pub fn status(&self) -> Status {
        self.shared.lock().status.clone()
    }

    /// Tells the sensor whether a face is tracked: LED, and exposure if the settings say so. Cheap to call every frame.
    pub fn show_tracking(&self, tracking: bool) {
        self.shared.lock().tracking = tracking;
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
        let opened = open().map_err(KinectError::from);
        let opened = opened.and_then(|source| Kinect::open(source, settings));
        attempted |= opened.is_ok();
        let streamed = opened.and_then(|kinect| stream(shared, kinect, &mut pictures));
        let Err(problem) = streamed else { return };
        let mut inner = shared.lock();
        if inner.status.waiting_for.as_ref() != Some(&problem) {
            // What became of the first attempt is for the one who asked for the sensor to say.
            if attempted {
                tracing::warn!("waiting for the Kinect: {problem}");
            }
            inner.status.waiting_for = Some(problem);
            shared.news.notify_all();
        }
        drop(inner);
        attempted = true;
        if shared.wait(RETRY, |inner| inner.end).end {
            return;
        }
    }
}

/// Streams until asked to stop (`Ok`) or the device fails. `pictures`: whole depth pictures before and after.
fn stream<S: PacketSource>(
    shared: &Shared,
    mut kinect: Kinect<S>,
    pictures: &mut u64,
) -> Result<(), KinectError> {
    let mut inner = shared.lock();
    let source = &kinect.source;
    inner.status.sensor = Some((source.model(), source.serial().to_owned()));
    inner.status.openings += 1;
    inner.registration = kinect.registration.clone();
    drop(inner);
    let result = deliver(shared, &mut kinect, *pictures);
    let failed = result.is_err();
    let light = if failed { Light::Red } else { Light::Off };
    if let Err(problem) = kinect.set_light(light) {
        tracing::debug!("LED: {problem}");
    }
    kinect.stop();
    let health = kinect.health();
    *pictures += health.streams[Stream::Depth.index()].pictures;
    let (alone, restarts) = (health.alone, health.restarts);
    for stream in Stream::BOTH {
        let unpaired = health.unpaired[stream.index()];
        let Tally {
            pictures,
            broken,
            packets,
            lost,
            repeated,
            damaged,
            bus_errors,
            wrong_length,
            misplaced,
        } = health.streams[stream.index()];
        tracing::info!(
            "{stream:?}: {pictures} pictures whole, {broken} broken; packets {packets}, lost {lost}, repeated {repeated}, damaged {damaged}, bus errors {bus_errors}, wrong length {wrong_length}, misplaced {misplaced}; unpaired pictures {unpaired}, depth alone {alone}, restarts {restarts}"
        );
    }
    shared.lock().status.health = health;
    result
}

/// Starts, and hands over what comes until asked to stop.
fn deliver<S: PacketSource>(
    shared: &Shared,
    kinect: &mut Kinect<S>,
    former: u64,
) -> Result<(), KinectError> {
    kinect.start()?;
    let (model, serial) = (kinect.source.model(), kinect.source.serial());
    tracing::info!("streaming from {model}, serial {serial}");
    let mut shown = None;
    loop {
        let mut delivered = false;
        kinect.poll(POLL, |pair| {
            delivered = true;
            hand_over(shared, former, pair);
        })?;
        let mut inner = shared.lock();
        if inner.end {
            return Ok(());
        }
        if delivered {
            inner.status.health = kinect.health();
            inner.status.waiting_for = None;
        }
        let tracking = inner.tracking;
        drop(inner);
        if shown.replace(tracking) != Some(tracking) {
            kinect.show_tracking(tracking);
        }
    }
}

/// Swaps a completed pair into the ring, numbered on from `former` pictures; the oldest in it gives way.
fn hand_over(shared: &Shared, former: u64, pair: Paired<'_>) {
    let mut inner = shared.lock();
    let opening = inner.status.openings;
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
