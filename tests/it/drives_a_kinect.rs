//! Promise: the driver says to the camera what the camera needs, survives its silence, and reads its calibration.
//! One file: one promise in many cases of one made-up camera.

use std::cell::RefCell;
use std::time::Duration;

use mien_sensors::kinect::command::{Command, image_sensor, register};
use mien_sensors::kinect::device::{DeviceError, Model, PacketSource, Received, Request, Stream};
use mien_sensors::kinect::driver::{Kinect, KinectError, Settings, unpack_into};
use mien_sensors::kinect::frame::KinectFrame;
use mien_sensors::kinect::motor::Light;
use mien_sensors::kinect::pairing::{Paired, RawPair};
use mien_sensors::kinect::picture_clock::PictureClock;
use mien_sensors::kinect::picture_clock::timestamp_from_ticks;
use mien_sensors::kinect::registration::Registration;
use mien_sensors::sensor::Activity;
use mien_simulator::simulated::Simulated;
use mien_simulator::virtual_head::{HeadAsset, Scene, Simulator};
use mien_simulator::virtual_kinect::VirtualKinect;

use crate::common::assert_same_pictures;
use crate::common::faults::{Faulty, Rates};

const MODELS: [Model; 3] = [Model::Xbox1414, Model::Xbox1473, Model::Windows1517];

fn grey() -> impl FnMut(&mut KinectFrame) -> bool {
    let mut number = 0u32;
    move |frame| {
        frame.original.ticks = number.wrapping_mul(2_000_000);
        frame.original.colour_ticks = frame.original.ticks;
        number += 1;
        true
    }
}

fn virtual_kinect(model: Model) -> VirtualKinect<impl FnMut(&mut KinectFrame) -> bool> {
    VirtualKinect::new(model, "A00366A08793039A", grey())
}

fn pairs_in<S: PacketSource>(
    kinect: &mut Kinect<S>,
    milliseconds: u64,
) -> Result<u64, KinectError> {
    let mut pairs = 0;
    for _ in 0..milliseconds {
        kinect.poll(Duration::from_millis(1), |_| pairs += 1)?;
    }
    Ok(pairs)
}

#[test]
fn starts_streams_and_stops_every_model() {
    for model in MODELS {
        let mut kinect = Kinect::open(virtual_kinect(model), Settings::default()).unwrap();
        assert_eq!(kinect.registration, Registration::default());
        assert_eq!(pairs_in(&mut kinect, 100), Ok(0));
        kinect.start().unwrap();
        let camera = &kinect.source.camera;
        assert!(camera.streams(Stream::Depth) && camera.streams(Stream::Colour));
        assert!((29..=31).contains(&pairs_in(&mut kinect, 1010).unwrap()));
        kinect.stop();
        let camera = &kinect.source.camera;
        assert!(!camera.streams(Stream::Depth) && !camera.streams(Stream::Colour));
        // On again, as if nothing had been.
        kinect.start().unwrap();
        assert!((29..=31).contains(&pairs_in(&mut kinect, 1010).unwrap()));
    }
}

#[test]
fn near_mode_is_of_the_windows_model_only() {
    for (model, near_mode, expected) in [
        (Model::Windows1517, true, [0x07, 0]),
        (Model::Windows1517, false, [0x1e, 0x190]),
        (Model::Xbox1414, true, [0, 0]),
    ] {
        let settings = Settings {
            near_mode,
            ..Settings::default()
        };
        let mut kinect = Kinect::open(virtual_kinect(model), settings).unwrap();
        kinect.start().unwrap();
        let camera = &kinect.source.camera;
        assert_eq!(
            [register::DEPTH_GAIN, register::NEAR_MODE].map(|r| camera.register(r)),
            expected
        );
    }
}

#[test]
fn exposure_is_held_while_a_face_is_tracked_if_asked() {
    const BOTH: u16 = image_sensor::AUTO_EXPOSURE | image_sensor::AUTO_WHITE_BALANCE;
    for freeze_exposure in [false, true] {
        let settings = Settings {
            freeze_exposure,
            ..Settings::default()
        };
        let mut kinect = Kinect::open(virtual_kinect(Model::Xbox1473), settings).unwrap();
        kinect.start().unwrap();
        let automatic = |kinect: &Kinect<VirtualKinect<_>>| kinect.source.camera.automatic & BOTH;
        assert_eq!(automatic(&kinect), BOTH);
        kinect.show(Activity::Tracking);
        assert_eq!(automatic(&kinect), if freeze_exposure { 0 } else { BOTH });
        kinect.show(Activity::Searching);
        assert_eq!(automatic(&kinect), BOTH);
    }
}

#[test]
fn light_and_tilt_of_both_kinds_of_motor() {
    for (model, [red, searching, tracking, gesture]) in [
        (Model::Xbox1414, [2, 4, 1, 3]),
        (Model::Xbox1473, [4, 2, 3, 1]),
        (Model::Windows1517, [4, 2, 3, 1]),
    ] {
        let mut kinect = Kinect::open(virtual_kinect(model), Settings::default()).unwrap();
        kinect.set_light(Light::Red).unwrap();
        assert_eq!(kinect.source.camera.light, red);
        // Searching blinks, tracking is steady, and a gesture turns the LED yellow or, on later models, off.
        kinect.show(Activity::Searching);
        assert_eq!(kinect.source.camera.light, searching);
        kinect.show(Activity::Tracking);
        assert_eq!(kinect.source.camera.light, tracking);
        kinect.show(Activity::Gesture);
        assert_eq!(kinect.source.camera.light, gesture);
        kinect.tilt(-12.0).unwrap();
        assert_eq!(kinect.source.camera.tilt_deg, -12.0);
        kinect.tilt(80.0).unwrap();
        assert_eq!(kinect.source.camera.tilt_deg, 31.0);
    }
}

#[test]
fn the_sensor_is_tilted_on_opening_if_asked() {
    for (set_tilt, expected) in [(false, 0.0), (true, 8.0)] {
        let settings = Settings {
            set_tilt,
            tilt_deg: 8.0,
            ..Settings::default()
        };
        let kinect = Kinect::open(virtual_kinect(Model::Xbox1414), settings).unwrap();
        assert_eq!(kinect.source.camera.tilt_deg, expected);
    }
}

#[test]
fn a_stream_that_falls_silent_is_restarted() {
    let rates = Rates {
        stall: 1e-4,
        ..Rates::default()
    };
    let source = Faulty::new(virtual_kinect(Model::Xbox1414), rates, 3);
    let mut kinect = Kinect::open(source, Settings::default()).unwrap();
    kinect.start().unwrap();
    let pairs = pairs_in(&mut kinect, 60_000).unwrap();
    let injected = kinect.source.faults.injected.iter();
    let stalls: u64 = injected.map(|done| done.stalls).sum();
    let restarts = kinect.health().restarts;
    assert!(stalls > 10, "{stalls}");
    assert!(restarts > 5, "{restarts}");
    assert!(restarts <= stalls, "{restarts} restarts, {stalls} stalls");
    assert!(pairs > 600, "{pairs}");
}

/// Swallows everything after the start, or spoils replies.
struct Sick<S> {
    inner: S,
    mute: bool,
    silent: bool,
    /// The colour stream alone.
    colourless: bool,
    spoil_every: u32,
    replies: u32,
}

impl<S: PacketSource> PacketSource for Sick<S> {
    fn model(&self) -> Model {
        self.inner.model()
    }
    fn serial(&self) -> &str {
        self.inner.serial()
    }
    fn request(&mut self, request: Request<'_>) -> Result<usize, DeviceError> {
        let Request::Reply(reply) = request else {
            return self.inner.request(request);
        };
        let n = self.inner.request(Request::Reply(reply))?;
        if self.mute {
            return Ok(0);
        }
        if n > 0 {
            self.replies += 1;
            if self.spoil_every > 0 && self.replies.is_multiple_of(self.spoil_every) {
                reply[self.replies as usize % n.min(8)] ^= 0x55;
            }
        }
        Ok(n)
    }
    fn start(&mut self, stream: Stream) -> Result<(), DeviceError> {
        self.inner.start(stream)
    }
    fn stop(&mut self, stream: Stream) {
        self.inner.stop(stream);
    }
    fn poll(
        &mut self,
        wait: Duration,
        sink: &mut dyn FnMut(Received<'_>),
    ) -> Result<(), DeviceError> {
        let (silent, colourless) = (self.silent, self.colourless);
        self.inner.poll(wait, &mut |received| {
            let dropped = silent || colourless && received.stream == Stream::Colour;
            if !dropped {
                sink(received);
            }
        })
    }
    fn clock(&self) -> Duration {
        self.inner.clock()
    }
    fn sleep(&mut self, time: Duration) {
        self.inner.sleep(time);
    }
}

fn sick(model: Model) -> Sick<VirtualKinect<impl FnMut(&mut KinectFrame) -> bool>> {
    Sick {
        inner: virtual_kinect(model),
        mute: false,
        silent: false,
        colourless: false,
        spoil_every: 0,
        replies: 0,
    }
}

#[test]
fn a_camera_that_does_not_reply_is_given_up_in_seconds() {
    let mut source = sick(Model::Xbox1414);
    source.mute = true;
    let Err(problem) = Kinect::open(source, Settings::default()) else {
        panic!("opened a mute camera");
    };
    assert_eq!(problem, KinectError::NoReply(Command::SetParameter as u16));
}

#[test]
fn spoilt_replies_are_asked_again() {
    let mut source = sick(Model::Xbox1414);
    source.spoil_every = 3;
    let mut kinect = Kinect::open(source, Settings::default()).unwrap();
    kinect.start().unwrap();
    assert_eq!(kinect.registration, Registration::default());

    let mut source = sick(Model::Xbox1414);
    source.spoil_every = 1;
    assert!(matches!(
        Kinect::open(source, Settings::default()),
        Err(KinectError::BadReply(..))
    ));
}

#[test]
fn silence_in_spite_of_restarts_asks_to_be_opened_anew() {
    let mut source = sick(Model::Xbox1414);
    source.silent = true;
    let mut kinect = Kinect::open(source, Settings::default()).unwrap();
    kinect.start().unwrap();
    assert!(matches!(
        pairs_in(&mut kinect, 5000),
        Err(KinectError::Silent(_))
    ));
    assert_eq!(kinect.health().restarts, 2);
}

/// Polls for so many milliseconds; of what was delivered when, and whether it had colour, and that numbers and stamps go on.
fn delivered<S: PacketSource>(kinect: &mut Kinect<S>, milliseconds: u64) -> Vec<(u64, bool)> {
    let (mut pair, mut clock) = (RawPair::default(), PictureClock::default());
    let (mut frame, mut last) = (KinectFrame::default(), None);
    let mut delivered = Vec::new();
    for millisecond in 0..milliseconds {
        let each = |paired: Paired<'_>| {
            paired.swap_into(&mut pair);
            unpack_into(&mut pair, &mut clock, &mut frame);
            assert!(last.replace(frame.index) < Some(frame.index));
            let is_black = frame.luma.iter().all(|&luma| luma == 0);
            assert!(frame.has_colour || frame.original.colour_ticks == 0 && is_black);
            delivered.push((millisecond, frame.has_colour));
        };
        kinect
            .poll(Duration::from_millis(1), each)
            .expect("the device is there");
    }
    delivered
}

thread_local! {
    /// What this thread has logged since it began to listen.
    static SAID: RefCell<Option<Vec<String>>> = const { RefCell::new(None) };
}

/// Keeps what is logged by the threads that listen. One for the whole process: a subscriber of one thread may be passed over where
/// another thread met the line first.
struct Said;

impl tracing::Subscriber for Said {
    fn enabled(&self, _: &tracing::Metadata<'_>) -> bool {
        true
    }
    fn event(&self, event: &tracing::Event<'_>) {
        struct Words(String);
        impl tracing::field::Visit for Words {
            fn record_debug(&mut self, _: &tracing::field::Field, value: &dyn std::fmt::Debug) {
                self.0 += &format!("{value:?}");
            }
        }
        let mut words = Words(format!("{}: ", event.metadata().level()));
        event.record(&mut words);
        SAID.with_borrow_mut(|said| said.as_mut().map(|said| said.push(words.0)));
    }
    fn new_span(&self, _: &tracing::span::Attributes<'_>) -> tracing::span::Id {
        tracing::span::Id::from_u64(1)
    }
    fn record(&self, _: &tracing::span::Id, _: &tracing::span::Record<'_>) {}
    fn record_follows_from(&self, _: &tracing::span::Id, _: &tracing::span::Id) {}
    fn enter(&self, _: &tracing::span::Id) {}
    fn exit(&self, _: &tracing::span::Id) {}
}

#[test]
fn a_dead_colour_stream_leaves_depth() {
    let mut source = sick(Model::Xbox1414);
    source.colourless = true;
    let mut kinect = Kinect::open(source, Settings::default()).unwrap();
    kinect.start().unwrap();
    let dead = delivered(&mut kinect, 40_000);
    // From the second second on, 30 a second but for the pictures that the restarts cut: after 1, 2, 5, 15 and 35 s.
    assert!(dead[0].0 < 1200, "{:?}", dead[0]);
    assert!(dead.iter().all(|(_, has_colour)| !has_colour));
    assert!(dead.len() > 39 * 30 - 40, "{}", dead.len());
    assert_eq!(kinect.health().restarts, 5);
    assert_eq!(kinect.health().depth_only, dead.len() as u64);
    // It comes back.
    kinect.source.colourless = false;
    let back = delivered(&mut kinect, 3000);
    let alone = back.iter().filter(|(_, has_colour)| !has_colour).count();
    assert!(alone <= 2 && back.len() > 85, "{alone} of {}", back.len());
    assert_eq!(kinect.health().restarts, 5);
}

#[test]
fn pictures_that_never_pair_are_given_alone_then_restarted_and_counted() {
    // Colour is stamped ten seconds early until the 200th picture.
    let mut number = 0u32;
    let scene = move |frame: &mut KinectFrame| {
        frame.original.ticks = number.wrapping_mul(2_000_000);
        let early = if number < 200 { 600_000_000 } else { 0 };
        frame.original.colour_ticks = frame.original.ticks.wrapping_sub(early);
        number += 1;
        true
    };
    let source = VirtualKinect::new(Model::Xbox1414, "A", scene);
    let mut kinect = Kinect::open(source, Settings::default()).unwrap();
    kinect.start().unwrap();
    tracing::subscriber::set_global_default(Said).expect("nobody else listens");
    tracing::callsite::rebuild_interest_cache();
    SAID.set(Some(Vec::new()));
    let mut first = delivered(&mut kinect, 2000);
    let said = SAID.take().unwrap().join("\n");
    let expected = "WARN: no colour picture has matched a depth picture for 1 s";
    assert!(said.contains(expected), "within two seconds: {said}");
    first.extend(delivered(&mut kinect, 2900));
    assert!(first[0].0 < 2000, "{:?}", first[0]);
    assert!(first.len() > 110, "{}", first.len());
    assert!(first.iter().all(|(_, has_colour)| !has_colour));
    let before = kinect.health();
    assert_eq!((before.restarts, before.pairs), (0, 0));
    let unpaired = before.unpaired;
    assert!(unpaired.iter().all(|&one| one > 140), "{unpaired:?}");
    let after = delivered(&mut kinect, 400);
    assert_eq!(kinect.health().restarts, 1, "after five seconds");
    assert!(after.len() > 5);
    let healed = delivered(&mut kinect, 3700);
    let mut last = healed[healed.len() - 30..].iter();
    assert!(last.all(|(_, has_colour)| *has_colour));
    assert_eq!(kinect.health().restarts, 1);
}

#[test]
fn the_end_of_the_scene_is_an_unplugged_camera() {
    let mut left = 10;
    let scene = move |frame: &mut KinectFrame| {
        frame.original.ticks = frame.original.ticks.wrapping_add(2_000_000);
        frame.original.colour_ticks = frame.original.ticks;
        left -= 1;
        left > 0
    };
    let source = VirtualKinect::new(Model::Xbox1414, "A", scene);
    let mut kinect = Kinect::open(source, Settings::default()).unwrap();
    kinect.start().unwrap();
    assert_eq!(pairs_in(&mut kinect, 5000), Err(DeviceError::Gone.into()));
}

/// What the pipeline makes of a session cannot depend on its going through USB packets: the frames are those drawn, to the
/// bit, with the truth that goes with them.
#[test]
fn the_simulated_sensor_gives_what_was_drawn_through_packets() {
    let simulator = || Simulator::new(HeadAsset::shipped(), Scene::default(), 4);
    let (mut through, mut direct) = (Simulated::from(simulator()), simulator());
    assert_eq!(through.camera(), direct.camera());
    let (mut expected, mut frame) = (KinectFrame::default(), KinectFrame::default());
    for number in 0..20u32 {
        let ticks = number * 2_000_000;
        let at = timestamp_from_ticks(ticks.into());
        let truth = direct.draw(at, &mut expected).unwrap();
        through.next_frame(&mut frame);
        assert_eq!((frame.index, frame.at), (number.into(), at));
        let stamps = [frame.original.ticks, frame.original.colour_ticks];
        assert_eq!(stamps, [ticks; 2]);
        assert_same_pictures(&frame, &expected);
        let found = through.truth().unwrap();
        assert_eq!(found.sensor_from_head, truth.sensor_from_head);
        assert_eq!(found.landmarks_px, truth.landmarks_px);
    }
}
