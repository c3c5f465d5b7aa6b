//! Runs in the guest: the driver against the virtual Kinect, every frame checked pixel by pixel.
//!
//! `vm-client FRAMES SECONDS [SERIAL]` ends after that many frames or seconds, or when there is a file `/tmp/enough`, and prints
//! what was delivered, wrong, and lost by reason.
//! Exit code 1 if any pixel was wrong or nothing came.

use std::path::Path;
use std::process::ExitCode;
use std::time::{Duration, Instant};

use mien_sensors::kinect::device::Stream;
use mien_sensors::kinect::driver::Settings;
use mien_sensors::kinect::frame::KinectFrame;
use mien_sensors::kinect::live::LiveKinect;
use mien_sensors::kinect::registration::Registration;
use mien_sensors::kinect::usb_devices;
use mien_sensors::sensor::Activity;
use mien_stages::base::capacity::{PIXELS, WIDTH};

#[path = "../common/drivers_table.rs"]
mod drivers_table;
#[path = "../common/test_pattern.rs"]
mod test_pattern;

use drivers_table::{DriversTable, depth_mm};

fn hash(h: u64, word: u32) -> u64 {
    (h ^ u64::from(word)).wrapping_mul(1_099_511_628_211)
}

/// The same check values that `freenect_client.c` prints: raw depth to millimetres, depth pixels to colour pixels.
fn tables(registration: &Registration) -> [u64; 2] {
    const START: u64 = 1_469_598_103_934_665_603;
    let table = DriversTable::new(registration);
    let distances = (0..1089).fold(START, |h, raw| hash(h, depth_mm(registration, raw).into()));
    let mut places = START;
    for pixel in (0..PIXELS).step_by(97) {
        for z_mm in (450..4000).step_by(37) {
            let place = table.colour_pixel(pixel % WIDTH, pixel / WIDTH, z_mm);
            let word = place.map_or(u32::MAX, |[col, row]| (row * WIDTH + col) as u32);
            places = hash(places, word);
        }
    }
    [distances, places]
}

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().collect();
    let number = |i: usize| arguments.get(i).and_then(|text| text.parse().ok());
    let (frames, seconds) = (number(1).unwrap_or(50), number(2).unwrap_or(60));
    match usb_devices::devices() {
        Ok(devices) => devices
            .iter()
            .for_each(|device| println!("device {device}")),
        Err(problem) => println!("device none: {problem}"),
    }
    let settings = Settings {
        reset_audio: true,
        ..Settings::default()
    };
    let mut live = LiveKinect::usb(arguments.get(3).cloned(), settings);
    let deadline = Instant::now() + Duration::from_secs(seconds);
    let mut frame = KinectFrame::default();
    let (mut delivered, mut wrong_frames, mut wrong_pixels, mut mixed) = (0u64, 0u64, 0usize, 0u64);
    let mut waiting = None;
    let mut last = None;
    let mut backwards = 0u64;
    let mut began = None;
    let enough = Path::new("/tmp/enough");
    while delivered < frames && Instant::now() < deadline && !enough.exists() {
        let status = live.status();
        if status.waiting_for != waiting {
            match &status.waiting_for {
                Some(problem) => println!("waiting {problem}"),
                None => println!("streaming"),
            }
            waiting = status.waiting_for;
        }
        if !live.next_frame(&mut frame, Duration::from_millis(200)) {
            continue;
        }
        if began.is_none() {
            println!("first frame");
            began = Some(Instant::now());
        }
        let ([depth, colour], wrong) = test_pattern::check(&frame);
        delivered += 1;
        wrong_pixels += wrong;
        wrong_frames += u64::from(wrong > 0);
        mixed += u64::from(depth != colour);
        backwards += u64::from(last.is_some_and(|last| depth <= last));
        last = Some(depth);
        live.show(if delivered > 5 {
            Activity::Tracking
        } else {
            Activity::Searching
        });
    }
    let status = live.status();
    if let Some((model, serial)) = &status.sensor {
        println!("sensor {model} serial {serial}");
    }
    let seconds = began.map_or(0.0, |began| began.elapsed().as_secs_f64());
    println!(
        "delivered {delivered} in {seconds:.1} s, wrong frames {wrong_frames}, wrong pixels {wrong_pixels}, mismatched pairs {mixed}, out of order {backwards}"
    );
    println!(
        "openings {} restarts {} overwritten {} unpaired {:?}",
        status.openings, status.health.restarts, status.overwritten, status.health.unpaired
    );
    for stream in Stream::BOTH {
        let tally = status.health.streams[stream.index()];
        println!("counted {stream:?}: {tally:?}");
    }
    if delivered > 0 {
        let [distances, places] = tables(&live.registration);
        println!("tables distances {distances:016x} places {places:016x}");
    }
    let calibrated = live.registration == Registration::default();
    println!("calibration as sent {calibrated}");
    let good = delivered > 0 && wrong_pixels == 0 && mixed == 0 && backwards == 0 && calibrated;
    ExitCode::from(u8::from(!good))
}
