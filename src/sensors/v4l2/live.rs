//! A camera that may come and go ([`crate::live`]): its thread passes images on through a bounded ring, in which new images overwrite
//! old ones (counted), and reopens a camera that stopped giving images.
//!
//! Memory: three images, 0.9 MB (2.8 MB with depth), allocated at the start; images are passed on by swapping buffers.

use core::time::Duration;
use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Instant;

use super::capture::Taken;
use super::device::{CameraError, Device};
use super::streams::{Geometry, Image, Streams};
use crate::NO_DEPTH;
use crate::camera::Camera;
use crate::kinect::frame::FrameSink;
use crate::live::{Live, Shared, Worker};
use crate::rgbd::calibration::Calibration;
use crate::sensor::{Sensor, SensorError, SensorState};
use mien_stages::base::capacity::{HEIGHT, WAITING_FRAMES as RING, WIDTH};
use mien_stages::base::time::Timestamp;

/// Longest wait for an image in the thread; a request to stop is noticed after at most this time.
const POLL: Duration = Duration::from_millis(50);
/// Longest wait for an image in the main thread.
const WAIT: Duration = Duration::from_millis(500);
/// Consecutive frames without luma after which a warning is logged once; three seconds at 30 frames per second.
const WITHOUT_LUMA: u32 = 90;
/// Time without a whole image after which the camera is reopened; in the dark some cameras give one image per second.
const SILENT: Duration = Duration::from_secs(3);
/// Largest difference between the driver's clock and ours in the time from one image to the next.
const CLOCK_TOLERANCE: Duration = Duration::from_millis(500);

struct Inner {
    /// Images, oldest first.
    ring: VecDeque<Image>,
    free: Vec<Image>,
    /// Why there are no images; `None` while streaming, and before the first attempt.
    waiting_for: Option<CameraError>,
    /// Geometry of the camera last opened.
    geometry: Option<Arc<Geometry>>,
    damaged: u64,
    overwritten: u64,
    stop: bool,
}

impl Inner {
    fn new(has_depth: bool) -> Self {
        Self {
            ring: VecDeque::with_capacity(RING),
            free: (0..RING).map(|_| Image::new(has_depth)).collect(),
            waiting_for: None,
            geometry: None,
            damaged: 0,
            overwritten: 0,
            stop: false,
        }
    }
}

impl Live for Inner {
    type Problem = CameraError;
    const NAME: &str = "camera";
    const TITLE: &str = "camera";

    fn waiting_for(&mut self) -> &mut Option<CameraError> {
        &mut self.waiting_for
    }

    fn was_opened(&self) -> bool {
        self.geometry.is_some()
    }

    fn stop(&mut self) -> &mut bool {
        &mut self.stop
    }
}

/// Time since the first image, by the driver's clock where it is plausible, else by ours.
#[derive(Default)]
struct Clock {
    last: Option<(Option<Duration>, Instant)>,
    at_us: u64,
}

impl Clock {
    /// Time of the image that was `taken` on the driver's clock, if that is known, and `arrived` on ours. Times increase strictly.
    fn stamp(&mut self, taken: Option<Duration>, arrived: Instant) -> Timestamp {
        if let Some((last, last_arrived)) = self.last.replace((taken, arrived)) {
            let passed = arrived.saturating_duration_since(last_arrived);
            let by_driver = taken
                .zip(last)
                .and_then(|(taken, last)| taken.checked_sub(last));
            let by_driver = by_driver.filter(|step| step.abs_diff(passed) < CLOCK_TOLERANCE);
            let step_us = by_driver.unwrap_or(passed).as_micros();
            self.at_us += u64::try_from(step_us).unwrap_or(0).max(1);
        }
        Timestamp::from_us(self.at_us)
    }
}

/// The consumer's end.
pub(super) struct LiveCamera {
    worker: Worker<Inner>,
    clock: Clock,
    arrived: Option<Instant>,
    /// Geometry of the last image; it changes when another camera is plugged in.
    geometry: Arc<Geometry>,
}

impl LiveCamera {
    /// Starts a thread that calls `open` until it succeeds, and again whenever the camera is lost. Returns at once.
    /// `has_depth`: whether it is a depth camera.
    pub(super) fn new<D: Device>(
        has_depth: bool,
        mut open: impl FnMut() -> Result<Streams<D>, CameraError> + Send + 'static,
    ) -> Self {
        let (mut spare, mut number) = (Image::new(has_depth), 0);
        let worker = Worker::start(Inner::new(has_depth), move |shared| {
            deliver(shared, &open()?, &mut spare, &mut number)
        });
        Self {
            worker,
            clock: Clock::default(),
            arrived: None,
            geometry: Arc::new(Geometry::new(&Calibration::assumed(None, [WIDTH, HEIGHT]))),
        }
    }

    /// Waits at most `wait` until a camera streams or the first attempt has failed; returns the reason for a failure.
    pub(super) fn wait_for_first_attempt(&mut self, wait: Duration) -> Option<CameraError> {
        let attempted = |inner: &mut Inner| inner.was_opened() || inner.waiting_for.is_some();
        let inner = self.worker.shared.wait(wait, attempted);
        let Some(geometry) = &inner.geometry else {
            let problem = inner.waiting_for.clone();
            return Some(problem.unwrap_or(CameraError::Late));
        };
        self.geometry = Arc::clone(geometry);
        None
    }
}

impl Sensor for LiveCamera {
    fn next_frame(&mut self, into: &mut dyn FrameSink) -> Result<bool, SensorError> {
        let mut inner = self
            .worker
            .shared
            .wait(WAIT, |inner| !inner.ring.is_empty());
        let Some(mut image) = inner.ring.pop_front() else {
            let problem = inner.waiting_for.clone().unwrap_or(CameraError::Late);
            return Err(SensorError::new(problem));
        };
        let (frame, original) = into.parts();
        match &mut image.depth {
            Some(depth) => core::mem::swap(&mut frame.depth, depth),
            None => frame.depth.fill(NO_DEPTH),
        }
        if image.has_luma {
            core::mem::swap(&mut frame.luma, &mut image.luma);
            frame.has_colour = true;
        } else {
            frame.drop_colour();
        }
        (frame.index, self.arrived) = (image.number, Some(image.arrived));
        frame.at = self.clock.stamp(image.taken, image.arrived);
        if let Some(geometry) = image.geometry.take() {
            self.geometry = geometry;
        }
        inner.free.push(image);
        drop(inner);
        if let Some(original) = original {
            original.set_grey(frame);
        }
        Ok(true)
    }

    fn camera(&self) -> &Camera {
        &self.geometry.camera
    }

    fn state(&self) -> SensorState {
        SensorState {
            is_live: true,
            arrived: self.arrived,
            skipped: self.worker.shared.lock().damaged,
            reduced: self.geometry.reduced,
            ..SensorState::default()
        }
    }

    fn luma_size(&self) -> [usize; 2] {
        self.geometry.luma_size
    }
}

/// Passes images on until asked to stop (`Ok`) or the camera fails. `number` counts whole images over all times that a camera was opened.
fn deliver<D: Device>(
    shared: &Shared<Inner>,
    streams: &Streams<D>,
    spare: &mut Image,
    number: &mut u64,
) -> Result<(), CameraError> {
    shared.lock().geometry = Some(Arc::clone(&streams.geometry));
    shared.notify();
    let (mut last, mut damaged, mut without_luma) = (Instant::now(), 0_u64, 0_u32);
    loop {
        let taken = streams.take(POLL, spare);
        let mut inner = shared.lock();
        if inner.stop {
            let (delivered, overwritten) = (*number, inner.overwritten);
            tracing::info!(
                "camera: {delivered} images whole, {} damaged, {overwritten} overwritten",
                inner.damaged
            );
            return Ok(());
        }
        match taken? {
            Taken::Whole(taken) => {
                last = Instant::now();
                (spare.number, spare.taken, spare.arrived) = (*number, taken, last);
                spare.geometry = Some(Arc::clone(&streams.geometry));
                *number += 1;
                without_luma = if spare.has_luma {
                    0
                } else {
                    without_luma.saturating_add(1)
                };
                if without_luma == WITHOUT_LUMA {
                    tracing::warn!(
                        "the camera gives depth without images of the same time: heads are followed, faces are not; unplug it and plug it in again"
                    );
                }
                inner.waiting_for = None;
                push(&mut inner, spare);
                shared.notify();
            }
            Taken::Damaged => {
                damaged += 1;
                inner.damaged += 1;
            }
            Taken::Nothing => {}
        }
        drop(inner);
        if last.elapsed() > SILENT {
            return Err(CameraError::Silent(
                streams.frames.node().to_owned(),
                damaged,
            ));
        }
    }
}

/// Swaps an image into the ring; if the ring is full, it overwrites the oldest.
fn push(inner: &mut Inner, image: &mut Image) {
    let free = inner.free.pop();
    inner.overwritten += u64::from(free.is_none());
    if let Some(mut place) = free.or_else(|| inner.ring.pop_front()) {
        core::mem::swap(&mut place, image);
        // Luma that belongs to a later depth map stays.
        image.held = place.held.take();
        if image.held.is_some() {
            core::mem::swap(&mut place.luma, &mut image.luma);
        }
        inner.ring.push_back(place);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Frame;
    use crate::v4l2::capture::Capture;
    use crate::v4l2::format::Want;
    use crate::v4l2::scripted::{Script, whole};
    use mien_stages::base::geometry::Point;
    use std::path::Path;

    /// Starts scripted cameras one after the other; the number says how many attempts to open the camera fail first.
    fn camera(scripts: Vec<(usize, Script)>) -> LiveCamera {
        let mut scripts = VecDeque::from(scripts);
        LiveCamera::new(false, move || {
            let Some((absent, script)) = scripts.front_mut() else {
                return Err(CameraError::Absent);
            };
            if *absent > 0 {
                *absent -= 1;
                return Err(CameraError::Absent);
            }
            let script = script.clone();
            scripts.pop_front();
            let capture = Capture::start(script, Path::new("/dev/video0"), "card", Want::LUMA)?;
            Ok(Streams::new(capture, None, None))
        })
    }

    /// The next frame within five seconds, its index and time in microseconds.
    fn next(live: &mut LiveCamera, frame: &mut Frame) -> (u64, u64) {
        for _ in 0..10 {
            if live.next_frame(frame).is_ok() {
                return (frame.index, frame.at.as_us());
            }
        }
        panic!("no frame: {:?}", live.worker.shared.lock().waiting_for);
    }

    #[test]
    fn frames_have_luma_no_depth_and_the_times_of_the_driver_from_the_first() {
        let script = Script::honest();
        let mut live = camera(vec![(0, script.clone())]);
        assert_eq!(live.wait_for_first_attempt(Duration::from_secs(5)), None);
        let mut frame = Frame::default();
        frame.depth.fill(700);
        for (number, us) in [5_000_000, 5_033_300, 5_066_700].into_iter().enumerate() {
            script.then([Ok(whole(number, us))]);
            let expected = (number as u64, us - 5_000_000);
            assert_eq!(next(&mut live, &mut frame), expected);
            assert_eq!(frame.luma[637..643], [125, 126, 127, 0, 1, 2]);
            assert!(frame.has_colour && frame.depth.iter().all(|&raw| raw == NO_DEPTH));
        }
        let state = live.state();
        assert!(state.is_live && state.arrived.is_some() && state.skipped == 0);
        assert_eq!(live.luma_size(), [640, 480]);
    }

    #[test]
    fn an_unplugged_camera_is_waited_for_and_another_size_is_noticed() {
        let (first, mut second) = (Script::honest(), Script::honest());
        let damaged = || {
            Ok(crate::v4l2::device::Filled {
                is_damaged: true,
                ..whole(1, 0)
            })
        };
        first.then([
            Ok(whole(0, 1_000_000)),
            damaged(),
            damaged(),
            Err(libc::ENODEV),
        ]);
        second.formats = vec![(*b"GREY", vec![crate::v4l2::scripted::size(320, 240)])];
        // The clock of its driver has another origin.
        second.then([Ok(whole(0, 17))]);
        let mut live = camera(vec![(0, first), (1, second)]);
        let mut frame = Frame::default();
        assert_eq!(next(&mut live, &mut frame), (0, 0));
        assert_eq!(live.luma_size(), [640, 480]);
        let absent = live.next_frame(&mut frame).expect_err("no camera");
        let text = absent.to_string();
        assert!(
            text.contains("unplugged") || text.contains("no camera"),
            "{text}"
        );
        let (index, us) = next(&mut live, &mut frame);
        // Two attempts later, half a second each.
        assert!(
            index == 1 && (900_000..5_000_000).contains(&us),
            "{index} {us}"
        );
        assert_eq!((live.state().skipped, live.luma_size()), (2, [320, 240]));
        assert_eq!(live.camera().depth_size(), [320, 240]);
    }

    #[test]
    fn a_depth_camera_gives_both_and_what_has_no_luma_is_a_frame_without_colour() {
        let depth = Script::of(b"Z16 ", 900_u16.to_le_bytes().repeat(640 * 480));
        let luma = Script::of(b"GREY", vec![70; 640 * 480 * 2]);
        let at = |ms: u64| Ok(whole(0, ms * 1000));
        luma.then([at(1000), at(1066)]);
        depth.then([at(1000), at(1033), at(1066), Err(libc::ENODEV)]);
        let scripts = [(depth, Want::DEPTH), (luma, Want::INFRARED)];
        let mut scripts = Some(scripts);
        let mut live = LiveCamera::new(true, move || {
            let scripts = scripts.take().ok_or(CameraError::NoDepth)?;
            let [depth, luma] = scripts.map(|(script, want)| {
                Capture::start(script, Path::new("/dev/video0"), "card", want)
            });
            Ok(Streams::new(depth?, Some(luma?), None))
        });
        // The ring holds two of them.
        let mut frame = Frame::default();
        let mut seen = Vec::new();
        while live.next_frame(&mut frame).is_ok() {
            let luma = if frame.has_colour { 70 } else { 0 };
            assert!(frame.luma.iter().all(|&value| value == luma));
            assert!(frame.depth.iter().all(|&raw| raw == 900));
            seen.push((frame.index, frame.has_colour));
        }
        assert!(seen.ends_with(&[(1, false), (2, true)]), "{seen:?}");
        let problem = live
            .next_frame(&mut frame)
            .expect_err("unplugged")
            .to_string();
        assert!(problem.contains("no depth camera") || problem.contains("unplugged"));
    }

    #[test]
    fn a_slow_consumer_loses_the_oldest_images() {
        let script = Script::honest();
        script.then((0..5).map(|number| Ok(whole(number % 4, number as u64))));
        let mut live = camera(vec![(0, script)]);
        let done = live
            .worker
            .shared
            .wait(Duration::from_secs(5), |inner| inner.overwritten == 3);
        assert_eq!(done.overwritten, 3);
        drop(done);
        let mut frame = Frame::default();
        assert_eq!(next(&mut live, &mut frame).0, 3);
        assert_eq!(next(&mut live, &mut frame).0, 4);
    }

    #[test]
    fn a_camera_that_falls_silent_is_reopened() {
        let (silent, next_one) = (Script::honest(), Script::honest());
        next_one.then([Ok(whole(0, 0))]);
        let mut live = camera(vec![(0, silent), (0, next_one)]);
        let began = Instant::now();
        next(&mut live, &mut Frame::default());
        assert!(began.elapsed() > SILENT);
    }

    #[test]
    fn a_camera_that_is_absent_at_the_start_is_the_reason() {
        let mut live = camera(vec![]);
        let reason = live.wait_for_first_attempt(Duration::from_secs(5));
        assert_eq!(reason, Some(CameraError::Absent));
    }

    #[test]
    fn an_implausible_clock_is_replaced_by_ours() {
        let (mut clock, start) = (Clock::default(), Instant::now());
        let ms = Duration::from_millis;
        let images = [
            (Some(1000), 0, 0),
            (Some(1033), 40, 33_000),
            // Backwards, far ahead, unknown, known again, and twice the same: our clock decides.
            (Some(20), 73, 66_000),
            (Some(90_000), 106, 99_000),
            (None, 139, 132_000),
            (Some(10), 172, 165_000),
            (Some(43), 200, 198_000),
            (Some(43), 200, 198_001),
        ];
        for (taken, arrived, expected_us) in images {
            let at = clock.stamp(taken.map(ms), start + ms(arrived));
            assert_eq!(at.as_us(), expected_us);
        }
    }

    #[test]
    fn the_assumed_lens_sees_60_degrees_across_4_3_and_more_at_the_sides_of_16_9() {
        let right = |degrees: f32| Point::new(degrees.to_radians().tan(), 0.0, 1.0);
        let camera = |size| Geometry::new(&Calibration::assumed(None, size)).camera;
        let [col, row] = camera([640, 480]).colour_pixel(&right(30.0));
        assert!(
            (col - 639.5).abs() < 1e-3 && (row - 239.5).abs() < 1e-3,
            "{col} {row}"
        );
        let wide = camera([1280, 720]);
        // 480 of the 640 columns span 60 degrees.
        let [col, row] = wide.colour_pixel(&right(30.0));
        assert!(
            (col - 559.5).abs() < 1e-3 && (row - 179.5).abs() < 1e-3,
            "{col} {row}"
        );
        assert_eq!(wide.depth_size(), [640, 360]);
    }
}
