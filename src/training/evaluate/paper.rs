//! The paper's experiments: its own system beside the default, before the same sensor.
//!
//! | row | of the paper | content |
//! | --- | --- | --- |
//! | `time` | Table 1, Figs. 15, 16 | processor time of a frame with one user, four, and two who swap |
//! | `poses` | Fig. 18 | found poses at the ends of ±25° of yaw and ±15° of pitch |
//! | `errors` | | mean absolute error of the weights by light, covered share, yaw and pitch |
//!
//! People are of the test split. Times are of the thread's processor, so that other load on the machine hardly
//! matters.

use super::acted::Acted;
use super::sessions::Trial;
use crate::frame_time::frame_time;
use mien_appliance::pipeline::{Pipeline, PipelineError};
use mien_appliance::settings::Settings;
use mien_baking::heads::PersonHead;
use mien_sensors::Frame;
use mien_simulator::virtual_head::{Appearance, Held, Light, Scene, Simulator, Truth};
use mien_stages::base::capacity::LANDMARKS;
use mien_stages::base::geometry::{Rigid, rotation_from_yaw_pitch_roll, yaw_pitch_roll};
use mien_stages::expression::units::Units;
use mien_workbench::fault::Fault;

/// Names of the rows.
pub const ROWS: [&str; 3] = ["time", "poses", "errors"];
/// The compared systems.
const SYSTEMS: [&str; 2] = ["paper", "default"];
/// Seconds at the start of a session in which ranges are learnt and errors ignored.
const LEARNS_S: f64 = 4.0;
/// Frames that a condition needs for its mean error.
const MIN_FRAMES: f64 = 20.0;

/// Plays the experiments named in `only`, all if empty; the settings are the paper's, `say` prints the figures.
///
/// # Errors
/// If the data sets cannot be read or the model does not fit the settings.
pub fn play(trial: &Trial, only: &[String], say: &mut dyn FnMut(&str)) -> Result<(), Fault> {
    let heads = trial.held_out()?;
    let experiments = Experiments { heads, trial };
    let wanted = |name: &str| only.is_empty() || only.iter().any(|one| one == name);
    for name in ROWS.into_iter().filter(|name| wanted(name)) {
        match name {
            "time" => experiments.time(say)?,
            "poses" => experiments.poses(say)?,
            _ => experiments.errors(say)?,
        }
    }
    Ok(())
}

struct Experiments<'a> {
    heads: Vec<PersonHead>,
    trial: &'a Trial<'a>,
}

impl Experiments<'_> {
    /// Pipelines of both systems for the same sensor, in the order of [`SYSTEMS`].
    fn pipelines(&self, simulator: &Simulator) -> Result<Vec<Pipeline>, PipelineError> {
        let default = Trial {
            shapes: &[],
            settings: &Settings::default(),
            ..*self.trial
        };
        Ok(vec![
            self.trial.pipeline(simulator.camera())?,
            default.pipeline(simulator.camera())?,
        ])
    }

    fn time(&self, say: &mut dyn FnMut(&str)) -> Result<(), PipelineError> {
        const SCENES: [(&str, Scene, usize); 3] = [
            ("one user", Scene::Acted, 300),
            ("four users", Scene::Four, 150),
            ("users who swap", Scene::Swap, 1000),
        ];
        for (words, scene, frames) in SCENES {
            let mut assets = self.heads.iter().map(|head| head.asset.clone());
            let first = assets.next().expect("there is somebody");
            let mut simulator = Simulator::new(first, scene, 15).with_others(assets);
            let mut pipelines = self.pipelines(&simulator)?;
            let mut times: [Vec<f64>; 2] = Default::default();
            let mut frame = Frame::default();
            for n in 0..frames {
                simulator.draw(frame_time(n), &mut frame);
                for (times, pipeline) in times.iter_mut().zip(&mut pipelines) {
                    let before = processor_ms();
                    pipeline.follow(&frame);
                    times.push(processor_ms() - before);
                }
            }
            for (times, name) in times.iter().zip(SYSTEMS) {
                let least = times.iter().copied().fold(f64::INFINITY, f64::min);
                let most = times.iter().copied().fold(0.0, f64::max);
                let mean = times.iter().sum::<f64>() / times.len() as f64;
                say(&format!(
                    "{name}, {words}: {least:.1} / {mean:.1} / {most:.1} ms (min / mean / max of {frames} frames), {:.1} a second",
                    1e3 / mean
                ));
            }
        }
        Ok(())
    }

    fn poses(&self, say: &mut dyn FnMut(&str)) -> Result<(), PipelineError> {
        const ENDS_DEG: [[f32; 2]; 5] = [
            [0.0, 0.0],
            [-25.0, 0.0],
            [25.0, 0.0],
            [0.0, -15.0],
            [0.0, 15.0],
        ];
        /// Frames of the motion from the front.
        const WAY: usize = 25;
        /// Frames held at the end.
        const STAYS: usize = 6;
        // The head frame's pose on a face is a convention: the frontal estimate counts as 0.
        let mut front = [Rigid::identity(); 2];
        for [yaw, pitch] in ENDS_DEG {
            let mut simulator = Simulator::new(self.heads[0].asset.clone(), Scene::Still, 18);
            let mut pipelines = self.pipelines(&simulator)?;
            let (mut frame, mut truth) = (Frame::default(), Rigid::identity());
            for n in 0..WAY + STAYS {
                let share = (n as f32 / WAY as f32).min(1.0);
                let [yaw, pitch] = [yaw, pitch].map(|angle: f32| (angle * share).to_radians());
                let turn = rotation_from_yaw_pitch_roll(yaw, pitch, 0.0);
                truth = Rigid::from_parts(nalgebra::Translation3::new(0.0, -0.02, 0.7), turn);
                simulator.draw_pose(&truth, &[], frame_time(n), &mut frame);
                for pipeline in &mut pipelines {
                    pipeline.follow(&frame);
                }
            }
            for ((pipeline, front), name) in pipelines.iter().zip(&mut front).zip(SYSTEMS) {
                let found = pipeline.report().sensor_from_face.copied();
                if let (Some(found), [0.0, 0.0]) = (found, [yaw, pitch]) {
                    *front = truth.inverse() * found;
                }
                let angles = found.map_or("lost".to_owned(), |found| {
                    let (yaw, pitch, _) = yaw_pitch_roll(&(found * front.inverse()).rotation);
                    let [yaw, pitch] = [yaw, pitch].map(|angle| angle.to_degrees() + 0.0);
                    format!("{yaw:+.1} {pitch:+.1}")
                });
                say(&format!(
                    "{name}: true {yaw:+.0} {pitch:+.0}, found {angles}"
                ));
            }
        }
        Ok(())
    }

    fn errors(&self, say: &mut dyn FnMut(&str)) -> Result<(), PipelineError> {
        const EXPOSURES: [f32; 5] = [0.15, 0.3, 0.6, 1.0, 1.8];
        let mut by_light = Bins::new("exposure, 1 = as photographed", &EXPOSURES);
        const COVERED: [f32; 5] = [0.0, 15.0, 30.0, 45.0, 60.0];
        const YAWS: [f32; 7] = [5.0, 10.0, 15.0, 20.0, 25.0, 35.0, 45.0];
        let mut by_cover = Bins::new("points covered by a hand, %", &COVERED);
        let mut by_yaw = Bins::new("yaw, degrees to either side", &YAWS);
        let mut by_pitch = Bins::new("pitch, degrees up or down", &[5.0, 10.0, 15.0, 20.0, 30.0]);
        for head in &self.heads {
            let simulator = |scene, seed| Simulator::new(head.asset.clone(), scene, seed);
            let wide = simulator(Scene::Wide, 18);
            self.weights(wide, 2.0, |system, _, truth, error| {
                let (yaw, pitch, _) = yaw_pitch_roll(&truth.sensor_from_head.rotation);
                by_yaw.add(system, yaw.to_degrees().abs(), error);
                by_pitch.add(system, pitch.to_degrees().abs(), error);
            })?;
            let look = Appearance {
                held: Held::Mouth,
                ..Appearance::demonstration()
            };
            let covered = simulator(Scene::Acted, 14).dressed([look]);
            self.weights(covered, 2.0, |system, seconds, truth, error| {
                by_cover.add(system, 100.0 * covered_share(seconds, truth), error);
            })?;
            for exposure in EXPOSURES {
                let lit = simulator(Scene::Acted, 21).with_light(Light::default(), exposure);
                self.weights(lit, 0.7, |system, _, _, error| {
                    by_light.add(system, exposure, error);
                })?;
            }
        }
        for bins in [by_light, by_cover, by_yaw, by_pitch] {
            bins.report(say);
        }
        Ok(())
    }

    /// Plays a scene for a share of a session; `each` gets the system, the time in seconds, the truth and the mean
    /// error of the weights common to both systems.
    fn weights(
        &self,
        mut simulator: Simulator,
        share: f64,
        mut each: impl FnMut(usize, f32, &Truth, f64),
    ) -> Result<(), PipelineError> {
        let acted = Acted::new(simulator.asset());
        let mut pipelines = self.pipelines(&simulator)?;
        let mut frame = Frame::default();
        let units = Units::shipped().columns(true);
        for n in 0..((LEARNS_S + self.trial.sessions.seconds * share) * 30.0) as usize {
            let Some(truth) = simulator.draw(frame_time(n), &mut frame) else {
                continue;
            };
            let seconds = n as f64 / 30.0;
            for (system, pipeline) in pipelines.iter_mut().enumerate() {
                pipeline.follow(&frame);
                let report = pipeline.report();
                if seconds < LEARNS_S || report.weights.is_empty() {
                    continue;
                }
                let names = pipeline.unit_names();
                let named = names.iter().zip(report.weights);
                let errors = units.iter().filter_map(|unit| {
                    let (_, &weight) = named.clone().find(|(name, _)| *name == unit)?;
                    Some((f64::from(weight) - acted.true_weight(unit, &truth)?).abs())
                });
                let count = errors.clone().count().max(1) as f64;
                each(system, seconds as f32, &truth, errors.sum::<f64>() / count);
            }
        }
        Ok(())
    }
}

/// Processor time of this thread, milliseconds.
fn processor_ms() -> f64 {
    let now = nix::time::clock_gettime(nix::time::ClockId::CLOCK_THREAD_CPUTIME_ID);
    now.map_or(f64::NAN, |now| {
        now.tv_sec() as f64 * 1e3 + now.tv_nsec() as f64 * 1e-6
    })
}

/// Errors of the weights, binned by a condition.
struct Bins {
    condition: &'static str,
    /// Upper ends of the bins; the last one is unbounded.
    ends: &'static [f32],
    /// By bin and system: sum and count.
    sums: Vec<[[f64; 2]; 2]>,
}

impl Bins {
    fn new(condition: &'static str, ends: &'static [f32]) -> Self {
        Self {
            condition,
            ends,
            sums: vec![[[0.0; 2]; 2]; ends.len()],
        }
    }

    fn add(&mut self, system: usize, x: f32, error: f64) {
        let last = self.ends.len() - 1;
        let bin = self.ends.iter().position(|end| x <= *end).unwrap_or(last);
        let [sum, count] = &mut self.sums[bin][system];
        *sum += error;
        *count += 1.0;
    }

    fn report(&self, say: &mut dyn FnMut(&str)) {
        for (system, name) in SYSTEMS.iter().enumerate() {
            let means = self.ends.iter().zip(&self.sums).map(|(end, sums)| {
                let [sum, count] = sums[system];
                if count < MIN_FRAMES {
                    return format!("{end}: -");
                }
                format!("{end}: {:.3}", sum / count)
            });
            let means = means.collect::<Vec<_>>().join(", ");
            let condition = self.condition;
            say(&format!("weight error by {condition}, {name}: {means}"));
        }
    }
}

/// Share of the points covered by the hand over the mouth, the outline of its palm and fingers.
fn covered_share(seconds: f32, truth: &Truth) -> f32 {
    const HALF_M: [f32; 2] = [0.065, 0.040];
    let Some(place) = Held::Mouth.position_at(seconds) else {
        return 0.0;
    };
    let inside = truth.landmarks_head.iter().filter(|p| {
        let (x, y) = ((p.x - place.x) / HALF_M[0], (p.y - place.y) / HALF_M[1]);
        x * x + y * y < 1.0
    });
    inside.count() as f32 / LANDMARKS as f32
}
