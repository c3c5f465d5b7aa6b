//! The simulated sensor as a source: a virtual Kinect in front of simulated people. Frames pass through the real one's packets and
//! driver, at 30 Hz by the same counter, so that a run and the replay of its recording agree in every time stamp and pixel.
//!
//! Cost of the packets: about a millisecond per frame, a tenth of rendering.

use super::virtual_head::{Appearance, HeadAsset, Scene, Simulator, Truth};
use super::virtual_kinect::{FrameSource, STEP, VirtualKinect};
use mien_sensors::kinect::device::Model;
use mien_sensors::kinect::driver::{Kinect, Settings, unpack_into};
use mien_sensors::kinect::frame::{FrameSink, KinectFrame};
use mien_sensors::kinect::pairing::RawPair;
use mien_sensors::kinect::picture_clock::{FRAME_TICKS, PictureClock, timestamp_from_ticks};
use mien_sensors::kinect::registration::Registration;
use mien_sensors::sensor::{Sensor, SensorError, SensorState};
use mien_stages::base::nearest_word::hint;
use mien_stages::camera::Camera;

/// Seed of movements and noise; every run is the same.
const SEED: u64 = 1;
/// Serial number of the virtual sensor.
const SERIAL: &str = "simulated";

/// Source of the virtual Kinect: the simulator's frames with time stamps.
struct Drawn {
    simulator: Simulator,
    frames: u64,
}

impl FrameSource for Drawn {
    fn draw(&mut self, frame: &mut KinectFrame) -> bool {
        let ticks = self.frames * FRAME_TICKS.cast_unsigned();
        let at = timestamp_from_ticks(ticks.cast_signed());
        self.simulator.draw(at, frame);
        // The counter wraps, as the real one does.
        frame.has_colour = true;
        (frame.original.ticks, frame.original.colour_ticks) = (ticks as u32, ticks as u32);
        self.frames += 1;
        true
    }
}

/// There is no scene of that name.
#[derive(Debug, thiserror::Error)]
#[error("expected one of the scenes {}, found {}{}", scene_names(), .0, hint(.0, Scene::NAMES.iter().map(|s| s.0)))]
pub struct UnknownScene(pub String);

/// A running simulated sensor; its frames never end.
pub struct Simulated {
    kinect: Kinect<VirtualKinect<Drawn>>,
    pair: RawPair,
    clock: PictureClock,
}

impl Simulated {
    /// Starts the scene of this name, by default [`Scene::Demo`].
    ///
    /// # Errors
    /// If there is no scene of that name.
    pub fn new(scene: Option<&str>) -> Result<Self, UnknownScene> {
        let scene = Self::scene(scene)?;
        let simulator = Simulator::new(HeadAsset::shipped(), scene, SEED);
        Ok(Self::from(match scene {
            Scene::Demo => simulator.dressed([Appearance::demonstration()]),
            _ => simulator,
        }))
    }

    /// The scene of this name, by default [`Scene::Demo`].
    ///
    /// # Errors
    /// If there is no scene of that name.
    pub fn scene(name: Option<&str>) -> Result<Scene, UnknownScene> {
        name.map_or(Ok(Scene::Demo), |name| {
            Scene::named(name).ok_or_else(|| UnknownScene(name.to_owned()))
        })
    }

    /// Fills `frame` with the next one.
    pub fn next_frame(&mut self, frame: &mut impl FrameSink) {
        let mut filled = false;
        while !filled {
            let polled = self.kinect.poll(STEP, |paired| {
                paired.swap_into(&mut self.pair);
                unpack_into(&mut self.pair, &mut self.clock, frame);
                filled = true;
            });
            polled.expect("the virtual Kinect has no faults and its scene no end");
        }
    }

    /// Truth of the last frame's first person; `None` if nobody is there.
    pub fn truth(&self) -> Option<&Truth> {
        // The next frame is drawn only when its first packet is due.
        self.simulator().truths().flatten().next()
    }

    /// The simulator that draws the frames.
    pub fn simulator(&self) -> &Simulator {
        &self.kinect.source.player.source.simulator
    }

    /// Geometry of the virtual Kinect.
    pub fn camera(&self) -> &Camera {
        self.simulator().camera()
    }

    /// Calibration, as read from the virtual Kinect.
    pub fn registration(&self) -> &Registration {
        &self.kinect.registration
    }
}

impl Sensor for Simulated {
    fn next_frame(&mut self, mut into: &mut dyn FrameSink) -> Result<bool, SensorError> {
        Simulated::next_frame(self, &mut into);
        Ok(true)
    }

    fn camera(&self) -> &Camera {
        Simulated::camera(self)
    }

    fn state(&self) -> SensorState {
        SensorState::default()
    }

    fn registration(&self) -> Option<&Registration> {
        Some(Simulated::registration(self))
    }

    fn acceleration(&self) -> Option<[i16; 3]> {
        self.kinect.acceleration
    }
}

impl From<Simulator> for Simulated {
    /// A sensor with any head, scene and light.
    fn from(simulator: Simulator) -> Self {
        let acceleration = simulator.sensor().acceleration();
        let drawn = Drawn {
            simulator,
            frames: 0,
        };
        let mut device = VirtualKinect::new(Model::Xbox1414, SERIAL, drawn);
        device.camera.acceleration = acceleration;
        let answers = "the virtual Kinect answers every command";
        let mut kinect = Kinect::open(device, Settings::default()).expect(answers);
        kinect.start().expect(answers);
        Self {
            kinect,
            pair: RawPair::default(),
            clock: PictureClock::default(),
        }
    }
}

/// Names of the scenes, for messages.
pub(super) fn scene_names() -> String {
    let names: Vec<&str> = Scene::NAMES.iter().map(|(name, _)| *name).collect();
    names.join(", ")
}
