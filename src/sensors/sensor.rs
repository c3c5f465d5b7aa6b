//! What every sensor does ([`Sensor`]), and what is known of the devices of a kind ([`SensorKind`]).

use core::error::Error;
use std::time::Instant;

use crate::kinect;
use crate::kinect::frame::FrameSink;
use crate::kinect::registration::Registration;
use mien_stages::base::capacity::{HEIGHT, WIDTH};
use mien_stages::base::defaults;
use mien_stages::base::prelude::*;
use mien_stages::base::settings::keyed;
use mien_stages::camera::Camera;

keyed! {
    /// Settings of sensors that can be plugged in.
    pub struct Settings {
        /// Depth camera: a file with its focal lengths and the scale of its depth, as camera.json in docs/recordings.md. Without one a usual lens and millimetres are assumed.
        calibration: String = String::new() => Text("a path, or empty for none", |_| true),
        ..kinect: kinect::driver::Settings,
    }
}

/// Why a sensor gives no frame: what was expected, what was found, what to do.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct SensorError(Box<dyn Error + Send + Sync>);

impl SensorError {
    /// The sensor's own reason.
    pub fn new(reason: impl Error + Send + Sync + 'static) -> Self {
        Self(Box::new(reason))
    }
}

defaults! {
    /// What is known of a sensor besides its frames.
    #[derive(Clone, Copy, Debug)]
    pub struct SensorState {
        /// Whether it gives frames in its own time.
        pub is_live: bool = false,
        /// When the last frame was complete in this machine's memory; `None` for simulated or recorded frames.
        pub arrived: Option<Instant> = None,
        /// Frames of a recording, skipped ones included; 0 if it is none.
        pub frames: usize = 0,
        /// Frames skipped so far because they were damaged.
        pub skipped: u64 = 0,
        /// Pixels of the files to one of the frames, along each side: of depth, and of images.
        pub reduced: [usize; 2] = [1; 2],
    }
}

/// A source of frames: a device, a recording or a simulation.
pub trait Sensor: Send {
    /// Fills `into` with the next frame; `false` if there are no more. Damaged frames are skipped and counted.
    ///
    /// # Errors
    /// If a device delivers nothing for half a second, and why: retry.
    fn next_frame(&mut self, into: &mut dyn FrameSink) -> Result<bool, SensorError>;

    /// Geometry of the sensor behind the last frame.
    fn camera(&self) -> &Camera;

    /// Counts and times so far. Asked in every frame: allocates nothing.
    fn state(&self) -> SensorState;

    /// Columns and rows of the grey image.
    fn luma_size(&self) -> [usize; 2] {
        [WIDTH, HEIGHT]
    }

    /// What an accelerometer of the resting sensor measures: x to the left in the image, y up, z forward, upwards, in any unit; `None`
    /// if there is none.
    fn acceleration(&self) -> Option<[i16; 3]> {
        None
    }

    /// Calibration of the Kinect behind the frames, if it is one.
    fn registration(&self) -> Option<&Registration> {
        None
    }

    /// Continues a recording from the frame of this number.
    fn seek(&mut self, _number: usize) {}

    /// Shows the activity on the device's LED, if it has one.
    fn show(&self, _activity: Activity) {}
}

/// Activity of a run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Activity {
    /// It looks for a face.
    #[default]
    Searching,
    /// It tracks a face.
    Tracking,
    /// It tracks a face that makes a gesture.
    Gesture,
}

/// A device that is plugged in.
pub struct Found {
    /// One line about it.
    pub line: String,
    /// What may follow the colon in its source's name.
    pub serial: String,
    /// Its name, for kinds that are chosen by name too.
    pub name: String,
    /// What would keep it from being opened, and the remedy.
    pub trouble: Option<String>,
}

/// Why no device is listed.
pub struct Missing {
    /// Whether nothing is wrong except that none is plugged in.
    pub is_absent: bool,
    /// The reason and the remedy.
    pub text: String,
}

/// A sensor, and why its device could not be opened so far.
pub type Opened = (Box<dyn Sensor>, Option<SensorError>);

/// A kind of sensor that can be plugged in.
pub struct SensorKind {
    /// What the name of its source begins with: `kinect`, `kinect:SERIAL`.
    pub name: &'static str,
    /// Its name in messages.
    pub title: &'static str,
    /// Opens the device with this serial number or name, else the first free one. Returns within seconds, with the reason if it could
    /// not be opened so far; the sensor then waits for it.
    pub open: fn(Option<&str>, &Settings) -> Opened,
    /// Lists the devices.
    pub list: fn() -> Result<Vec<Found>, Missing>,
    /// The sentence that none of these devices is the one of this serial number or name; `None` if one is.
    pub missing: fn(&str, &[Found]) -> Option<String>,
}
