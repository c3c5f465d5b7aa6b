//! Helpers of the tests.
#![allow(
    dead_code,
    unreachable_pub,
    reason = "each test program uses some of them"
)]

pub mod actors;
pub mod data;
pub mod drivers_table;
pub mod faults;
pub mod paced;
pub mod service;
pub mod small_model;
pub mod test_pattern;
pub mod whole_run;

use std::path::Path;
use std::process::{Child, Command};

use mien_sensors::kinect::colour;
use mien_sensors::kinect::frame::KinectFrame;
use mien_sensors::kinect::picture_clock::timestamp_from_ticks;
use mien_sensors::kinect::unpack::NO_READING;

/// Path of `mien`: this build's, or the release build without wires that `MIEN_LEAN` names.
pub fn program() -> String {
    std::env::var("MIEN_LEAN").unwrap_or_else(|_| env!("CARGO_BIN_EXE_mien").to_owned())
}

/// `mien` with these words, which a space separates.
pub fn mien(words: &str) -> Command {
    let mut command = Command::new(program());
    command.args(words.split(' '));
    command
}

/// `mien-studio` with these words, which a space separates.
#[cfg(feature = "studio")]
pub fn studio(words: &str) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_mien-studio"));
    command.args(words.split(' '));
    command
}

/// Sends a signal such as `-TERM` to a program that the test started.
pub fn signal(child: &Child, name: &str) {
    let id = child.id().to_string();
    let sent = Command::new("kill").args([name, &id]).status();
    assert!(sent.unwrap().success());
}

/// A new named pipe with nobody at its other end, in place of what was there.
pub fn make_pipe(path: &Path) {
    let _before = std::fs::remove_file(path);
    assert!(Command::new("mkfifo").arg(path).status().unwrap().success());
}

/// Ticks of the sensor's counter per frame.
pub const FRAME_TICKS: u32 = mien_sensors::kinect::picture_clock::FRAME_TICKS as u32;

/// A frame of seeded noise: every raw depth value, every colour.
pub fn noise_frame(number: u64, seed: u64) -> KinectFrame {
    let mut random = fastrand::Rng::with_seed(seed ^ number);
    let mut frame = KinectFrame::default();
    frame.depth.fill_with(|| random.u16(..=NO_READING));
    frame.original.bayer.fill_with(|| random.u8(..));
    stamp(&mut frame, number, 4_290_000_000);
    frame
}

/// Checks that a frame has the pictures of another, to the bit.
pub fn assert_same_pictures(found: &KinectFrame, expected: &KinectFrame) {
    let index = found.index;
    let colour = [found, expected].map(|frame| &frame.original.bayer);
    assert!(found.depth == expected.depth, "depth of frame {index}");
    assert!(found.luma == expected.luma, "luma of frame {index}");
    assert!(colour[0] == colour[1], "mosaic of frame {index}");
}

/// Completes a frame whose pictures are drawn: luma, number, times. `first_ticks` is the counter at the start.
pub fn stamp(frame: &mut KinectFrame, number: u64, first_ticks: u32) {
    colour::luma_from_bayer(&frame.original.bayer, &mut frame.frame.luma);
    let ticks = number * u64::from(FRAME_TICKS);
    frame.index = number;
    frame.at = timestamp_from_ticks(ticks as i64);
    frame.original.ticks = first_ticks.wrapping_add(ticks as u32);
    // The two cameras run at a constant offset.
    frame.original.colour_ticks = frame.original.ticks.wrapping_add(300_000);
}

/// A frame of a real Kinect v1, from `<name>_{depth,rgb}.png` of the data set `kinect_v1_pcl`. The depth there lies on the
/// grid of the colour picture and has the focal length 525, ours is the depth camera's own view at 575.8: as a recording it
/// has real noise, steps and shadows, but its colour is displaced against its depth and everything is about a tenth
/// nearer to the axis than it was.
#[cfg(feature = "studio")]
pub fn kinect_frame(set: &Path, name: &str) -> KinectFrame {
    let camera = mien_sensors::kinect::geometry::nominal();
    let open = |kind: &str| image::open(set.join(format!("{name}_{kind}.png"))).expect(name);
    let mut frame = KinectFrame::default();
    let depth_mm = open("depth").into_luma16();
    for (raw, &z_mm) in frame.depth.iter_mut().zip(depth_mm.iter()) {
        if z_mm > 0 {
            *raw = camera.raw_from_m(f32::from(z_mm) * 1e-3).round() as u16;
        }
    }
    colour::bayer_from_rgb(&open("rgb").into_rgb8(), &mut frame.original.bayer);
    frame
}

/// Writes a recording of real frames, each of the names held for `repeat` frames.
#[cfg(feature = "studio")]
pub fn write_kinect_recording(set: &Path, names: &[&str], repeat: u64, to: &Path) {
    use mien_sensors::kinect::recording::Recorder;
    let registration = mien_sensors::kinect::registration::Registration::default();
    let recorder = Recorder::create(to, &registration, 1.7e9);
    let mut recorder = recorder.expect("an empty directory");
    for name in names {
        let mut frame = kinect_frame(set, name);
        for _ in 0..repeat {
            stamp(&mut frame, recorder.frames(), 0);
            let written = recorder.write(&frame);
            written.expect("the directory can be written");
        }
    }
}
