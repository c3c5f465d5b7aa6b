//! The simulated sensor as a source: frames at 30 a second by the same counter as the real one, so that a run and the replay
//! of its recording agree in every time and every pixel.

use super::virtual_head::{HeadAsset, Scene, Simulator, Truth};
use super::{Frame, SourceError, timestamp_from_ticks};

/// Seed of the scene's movements and noise: every run is the same.
const SEED: u64 = 1;
/// Ticks of the 60 MHz counter per frame.
const FRAME_TICKS: u64 = 2_000_000;

/// A simulated sensor that is running. Never ends.
pub struct Simulated {
    simulator: Simulator,
    frames: u64,
    truth: Option<Truth>,
}

impl Simulated {
    /// Starts a scene by its name; without one, [`Scene::default`].
    ///
    /// # Errors
    /// If there is no scene of that name.
    pub fn new(scene: Option<&str>) -> Result<Self, SourceError> {
        let scene = match scene {
            None => Scene::default(),
            Some(name) => Scene::named(name).ok_or_else(|| SourceError::Scene {
                name: name.to_owned(),
            })?,
        };
        Ok(Self::from(Simulator::new(
            HeadAsset::shipped(),
            scene,
            SEED,
        )))
    }

    /// Fills `frame` with the next one.
    pub fn next_frame(&mut self, frame: &mut Frame) {
        let ticks = self.frames * FRAME_TICKS;
        let at = timestamp_from_ticks(ticks as i64);
        self.truth = self.simulator.draw(at, frame);
        (frame.index, frame.at) = (self.frames, at);
        // The counter wraps, as the real one does.
        frame.ticks = ticks as u32;
        frame.colour_ticks = frame.ticks;
        self.frames += 1;
    }

    /// What the last frame shows; `None` if nobody is there.
    #[must_use]
    pub fn truth(&self) -> Option<&Truth> {
        self.truth.as_ref()
    }

    /// What draws the frames.
    #[must_use]
    pub fn simulator(&self) -> &Simulator {
        &self.simulator
    }
}

impl From<Simulator> for Simulated {
    /// Any head, scene and light.
    fn from(simulator: Simulator) -> Self {
        Self {
            simulator,
            frames: 0,
            truth: None,
        }
    }
}

/// Names of the scenes, for messages.
pub(super) fn scene_names() -> String {
    Scene::NAMES.map(|(name, _)| name).join(", ")
}
