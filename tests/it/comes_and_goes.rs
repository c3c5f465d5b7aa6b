//! Promise: absent at the start, unplugged, plugged in again, taken by another program: the program waits, says for what, and
//! streams again by itself.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

use mien_sensors::kinect::device::{DeviceError, Model};
use mien_sensors::kinect::driver::{KinectError, Settings};
use mien_sensors::kinect::frame::KinectFrame;
use mien_sensors::kinect::live::LiveKinect;
use mien_simulator::virtual_kinect::VirtualKinect;

use crate::common::paced::Paced;

/// A device that is absent, then delivers `frames` and is unplugged, and so on.
fn hot_plugged(frames: u32) -> (LiveKinect, Arc<AtomicU32>) {
    let attempts = Arc::new(AtomicU32::new(0));
    let counter = Arc::clone(&attempts);
    let open = move || {
        let attempt = counter.fetch_add(1, Ordering::Relaxed);
        if attempt.is_multiple_of(2) {
            return Err(DeviceError::Absent);
        }
        let mut number = 0;
        let scene = move |frame: &mut KinectFrame| {
            frame.original.ticks = number * 2_000_000;
            frame.original.colour_ticks = frame.original.ticks;
            frame.original.bayer[0] = attempt as u8;
            number += 1;
            number <= frames
        };
        let source = VirtualKinect::new(Model::Xbox1414, "A", scene);
        Ok(Paced::new(source, 1))
    };
    (LiveKinect::with_source(open, Settings::default()), attempts)
}

#[test]
fn the_program_goes_on_across_absence_and_unplugging() {
    let (mut live, attempts) = hot_plugged(12);
    let status = live.wait_for_first_attempt(Duration::from_secs(20));
    assert_eq!(
        status.waiting_for,
        Some(KinectError::Device(DeviceError::Absent))
    );
    let mut frame = KinectFrame::default();
    let (mut openings, mut indices) = (Vec::new(), Vec::new());
    let limit = Instant::now() + Duration::from_secs(60);
    while openings.len() < 3 && Instant::now() < limit {
        if live.next_frame(&mut frame, Duration::from_millis(100)) {
            indices.push((frame.index, frame.at));
            if openings.last() != Some(&frame.original.bayer[0]) {
                openings.push(frame.original.bayer[0]);
            }
        }
    }
    assert_eq!(openings, [1, 3, 5], "frames of three openings");
    assert!(
        indices.windows(2).all(|w| w[0] < w[1]),
        "number and time go on: {indices:?}"
    );
    assert!(attempts.load(Ordering::Relaxed) >= 6);
}

#[test]
fn a_slow_consumer_gets_the_newest_and_the_rest_is_counted() {
    let (mut live, _) = hot_plugged(60);
    let mut frame = KinectFrame::default();
    let mut indices = Vec::new();
    let limit = Instant::now() + Duration::from_secs(60);
    while indices.len() < 4 && Instant::now() < limit {
        if live.next_frame(&mut frame, Duration::from_millis(100)) {
            indices.push(frame.index);
            std::thread::sleep(Duration::from_millis(300));
        }
    }
    assert!(live.status().overwritten > 5, "{:?}", live.status());
    assert!(indices.windows(2).all(|w| w[0] < w[1]), "{indices:?}");
}
