//! A Kinect that may come and go: a thread opens it, keeps it streaming, and reopens it after it was unplugged, lost power, or fell
//! silent. The consumer takes frames or the reason why there are none.
//!
//! The thread assembles pictures and passes pairs on through a bounded ring, in which new pairs replace old ones: a slow consumer
//! loses frames (counted), but adds no memory or delay. The consumer unpacks depth and computes luma. Memory: two pairs, 1.5 MB,
//! allocated at the start; pairs are passed on by swapping buffers.

use core::time::Duration;
use std::collections::VecDeque;
use std::time::Instant;

use super::device::{DeviceError, Model, PacketSource, Stream};
use super::driver::{Health, Kinect, KinectError, Settings, unpack_into};
use super::frame::FrameSink;
use super::motor::Light;
use super::pairing::{Paired, RawPair};
use super::picture_clock::PictureClock;
use super::registration::Registration;
use super::stream::Tally;
use super::usb::UsbKinect;
use crate::live::{Live, Shared, Worker};
use crate::sensor::Activity;
use mien_stages::base::capacity::WAITING_FRAMES as RING;
use mien_stages::base::defaults;
use mien_stages::camera::Camera;

/// Longest wait for packets; also the delay of commands and of the end.
const POLL: Duration = Duration::from_millis(20);

/// State of the sensor.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Status {
    /// Why there are no frames; `None` while streaming, and before the first attempt.
    pub waiting_for: Option<KinectError>,
    /// Model and serial number of the sensor last opened.
    pub sensor: Option<(Model, String)>,
    /// Counters of the sensor last opened, since then.
    pub health: Health,
    /// Number of times a sensor was opened.
    pub openings: u64,
    /// Frames overwritten because the consumer was slow.
    pub overwritten: u64,
}

defaults! {
    struct Inner {
        /// Filled pairs, oldest first, each with the number of its opening and the time of its completion.
        ring: VecDeque<(u64, Instant, RawPair)> = VecDeque::with_capacity(RING),
        free: Vec<RawPair> = (0..RING).map(|_| RawPair::default()).collect(),
        status: Status = Status::default(),
        registration: Registration = Registration::default(),
        acceleration: Option<[i16; 3]> = None,
        activity: Activity = Activity::Searching,
        stop: bool = false,
    }
}

impl Live for Inner {
    type Problem = KinectError;
    const NAME: &str = "kinect";
    const TITLE: &str = "Kinect";

    fn waiting_for(&mut self) -> &mut Option<KinectError> {
        &mut self.status.waiting_for
    }

    fn was_opened(&self) -> bool {
        self.status.openings > 0
    }

    fn stop(&mut self) -> &mut bool {
        &mut self.stop
    }
}

/// The consumer's end.
pub struct LiveKinect {
    worker: Worker<Inner>,
    clock: PictureClock,
    /// Number of the last frame's opening, and when it was taken from the ring.
    last: Option<(u64, Instant)>,
    /// When the last frame was complete in this machine's memory.
    pub arrived: Option<Instant>,
    /// Calibration of the last frame's sensor; the nominal one before the first frame.
    pub registration: Registration,
    /// Geometry by this calibration, for the stages.
    pub camera: Camera,
    /// What the accelerometer of that sensor measured when it was opened.
    pub acceleration: Option<[i16; 3]>,
}

impl LiveKinect {
    /// The Kinect with `serial`, or the first free one. Returns at once, whether or not there is one.
    pub fn usb(serial: Option<String>, settings: Settings) -> Self {
        Self::with_source(
            move || UsbKinect::open(serial.as_deref(), settings.reset_audio),
            settings,
        )
    }

    /// The device opened by `open`, which is called until it succeeds and whenever the device is lost.
    pub fn with_source<S: PacketSource>(
        mut open: impl FnMut() -> Result<S, DeviceError> + Send + 'static,
        settings: Settings,
    ) -> Self {
        // Whole depth pictures of former openings, to continue the numbering.
        let mut pictures = 0;
        let worker = Worker::start(Inner::default(), move |shared| {
            let kinect = Kinect::open(open()?, settings)?;
            stream(shared, kinect, &mut pictures)
        });
        Self {
            worker,
            clock: PictureClock::default(),
            last: None,
            arrived: None,
            registration: Registration::default(),
            camera: Registration::default().camera(),
            acceleration: None,
        }
    }

    /// Fills `frame` with the oldest frame in the ring, waiting at most `wait`; `false` if there is none.
    pub fn next_frame(&mut self, frame: &mut impl FrameSink, wait: Duration) -> bool {
        let mut inner = self
            .worker
            .shared
            .wait(wait, |inner| !inner.ring.is_empty());
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
            self.acceleration = inner.acceleration;
        }
        self.last = Some((opening, now));
        drop(inner);
        unpack_into(&mut pair, &mut self.clock, frame);
        self.worker.shared.lock().free.push(pair);
        true
    }

    /// Waits for at most `wait` until a sensor has been opened or the first attempt has failed.
    pub fn wait_for_first_attempt(&mut self, wait: Duration) -> Status {
        let attempted =
            |inner: &mut Inner| inner.status.openings > 0 || inner.status.waiting_for.is_some();
        let inner = self.worker.shared.wait(wait, attempted);
        self.registration.clone_from(&inner.registration);
        self.camera = inner.registration.camera();
        self.acceleration = inner.acceleration;
        inner.status.clone()
    }

    /// Damaged depth images of the sensor last opened. Cheap to call every frame: nothing is copied.
    pub fn broken_depth_images(&self) -> u64 {
        self.worker.shared.lock().status.health.streams[Stream::Depth.index()].broken
    }

    /// State and counters.
    pub fn status(&self) -> Status {
        self.worker.shared.lock().status.clone()
    }

    /// Shows the activity on the LED, and locks or frees exposure if the settings say so. Cheap to call every frame.
    pub fn show(&self, activity: Activity) {
        self.worker.shared.lock().activity = activity;
    }
}

/// Streams until asked to stop (`Ok`) or the device fails. `pictures` counts whole depth pictures of all openings.
fn stream<S: PacketSource>(
    shared: &Shared<Inner>,
    mut kinect: Kinect<S>,
    pictures: &mut u64,
) -> Result<(), KinectError> {
    let mut inner = shared.lock();
    let source = &kinect.source;
    inner.status.sensor = Some((source.model(), source.serial().to_owned()));
    inner.status.openings += 1;
    inner.registration = kinect.registration.clone();
    inner.acceleration = kinect.acceleration;
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
    let (depth_only, restarts) = (health.depth_only, health.restarts);
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
            "{stream:?}: {pictures} pictures whole, {broken} broken; packets {packets}, lost {lost}, repeated {repeated}, damaged {damaged}, bus errors {bus_errors}, wrong length {wrong_length}, misplaced {misplaced}; unpaired pictures {unpaired}, depth alone {depth_only}, restarts {restarts}"
        );
    }
    shared.lock().status.health = health;
    result
}

/// Starts the streams and passes pairs on until asked to stop.
fn deliver<S: PacketSource>(
    shared: &Shared<Inner>,
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
            push_pair(shared, former, pair);
        })?;
        let mut inner = shared.lock();
        if inner.stop {
            return Ok(());
        }
        if delivered {
            inner.status.health = kinect.health();
            inner.status.waiting_for = None;
        }
        let activity = inner.activity;
        drop(inner);
        if shown.replace(activity) != Some(activity) {
            kinect.show(activity);
        }
    }
}

/// Swaps a completed pair into the ring, replacing the oldest if full; numbers continue from `former`.
fn push_pair(shared: &Shared<Inner>, former: u64, pair: Paired<'_>) {
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
        shared.notify();
    }
}
