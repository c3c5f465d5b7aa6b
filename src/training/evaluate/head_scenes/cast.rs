//! The people of the scenes, the pipeline in front of them, and playing of scenes.

use rayon::prelude::*;

use super::measure::SceneRun;
use crate::evaluate::sessions::Trial;
use crate::frame_time::frame_time;
use mien_appliance::pipeline::{
    PipelineError, REID_EARLY_DISTANCE, REID_FULL_DISTANCE, REID_FULL_FRAMES, REID_MIN_FRAMES,
};
use mien_baking::heads::PersonHead;
use mien_sensors::Frame;
use mien_sensors::kinect::colour;
use mien_simulator::virtual_head::{HeadAsset, Scene, Simulator};
use mien_stages::base::geometry::{Rigid, Rotation, Vector, rotation_from_yaw_pitch_roll};
use mien_stages::pose::PoseTracker;
use mien_stages::segment::Segmenter;
use mien_stages::users::likeness::Likeness;

/// Frames after which a newcomer is compared with people who left, and the largest distance of heads that match.
const REID_RULES: [(usize, f32); 2] = [
    (REID_MIN_FRAMES as usize, REID_EARLY_DISTANCE),
    (REID_FULL_FRAMES as usize, REID_FULL_DISTANCE),
];

/// The people of the scenes and the pipeline's settings.
pub(super) struct Cast<'a> {
    pub(super) heads: Vec<PersonHead>,
    pub(super) trial: &'a Trial<'a>,
    pub(super) frames: usize,
}

impl Cast<'_> {
    pub(super) fn asset(&self, k: usize) -> HeadAsset {
        self.heads[k % self.heads.len()].asset.clone()
    }

    /// Number of frames of scenes limited to ten seconds.
    pub(super) fn short(&self) -> usize {
        self.frames.min(300)
    }

    pub(super) fn simulator(&self, scene: Scene, k: usize) -> Simulator {
        let others = [1, 2].map(|next| self.asset(k + next));
        Simulator::new(
            self.asset(k),
            scene,
            self.trial.sessions.seed ^ (k as u64 + 1) << 8,
        )
        .with_others(others)
    }

    /// Plays a scene whose frames `draw` draws.
    fn run_scene(
        &self,
        mut simulator: Simulator,
        frames: usize,
        mut draw: impl FnMut(&mut Simulator, usize, &mut Frame),
    ) -> Result<SceneRun, PipelineError> {
        let mut pipeline = self.trial.pipeline(simulator.camera())?;
        let (mut frame, mut run) = (Frame::default(), SceneRun::default());
        for n in 0..frames {
            draw(&mut simulator, n, &mut frame);
            pipeline.follow(&frame);
            let truths: Vec<_> = simulator.truths().collect();
            run.add(&truths, &pipeline);
        }
        Ok(run)
    }

    /// Runs `play` once with each person.
    pub(super) fn each<T: Send>(
        &self,
        play: impl Fn(usize) -> Result<T, PipelineError> + Sync,
    ) -> Result<Vec<T>, PipelineError> {
        (0..self.heads.len()).into_par_iter().map(&play).collect()
    }

    pub(super) fn runs(&self, scene: Scene, frames: usize) -> Result<Vec<SceneRun>, PipelineError> {
        self.each(|k| {
            self.run_scene(self.simulator(scene, k), frames, |simulator, n, frame| {
                simulator.draw(frame_time(n), frame);
            })
        })
    }

    /// Scene `acted`, from 0.5 to 1.2 m.
    pub(super) fn near_and_far(&self, k: usize) -> Result<SceneRun, PipelineError> {
        let asset = self.asset(k);
        let simulator = self.simulator(Scene::Acted, k);
        self.run_scene(simulator, self.frames, |simulator, n, frame| {
            let mut weights = vec![0.0f32; asset.expressions.len()];
            let t = (frame_time(n).as_us() as f64 * 1e-6) as f32;
            let pose = Scene::Acted.play(self.trial.sessions.seed + k as u64, t, |name, weight| {
                if let Some(slot) = asset.expression(name) {
                    weights[slot] = weights[slot].max(weight);
                }
            });
            let mut pose = pose.expect("somebody acts");
            pose.translation.vector.z = 0.85 + (pose.translation.vector.z - 0.8) * 1.75;
            simulator.draw_pose(&pose, &weights, frame_time(n), frame);
        })
    }

    /// Rotation error (degrees) after two frames from each direction, infinite without a pose, relative to the offset
    /// of the frontal pose.
    pub(super) fn first_poses(&self, k: usize) -> Result<Vec<f64>, PipelineError> {
        let mut simulator = self.simulator(Scene::Still, k);
        let mut tracker = PoseTracker::new(
            self.trial.settings.stages.pose,
            &self.trial.model.standard_head,
        )?;
        let mut segmenter = Segmenter::new(self.trial.settings.stages.segment);
        let mut frame = Frame::default();
        let (mut turns, mut frontal) = (Vec::new(), None);
        for yaw in [-60.0f32, -30.0, 0.0, 30.0, 60.0] {
            for pitch in [-40.0f32, -20.0, 0.0, 20.0, 40.0] {
                let turn = rotation_from_yaw_pitch_roll(yaw.to_radians(), pitch.to_radians(), 0.0);
                let truth = Rigid::from_parts(Vector::new(0.0, -0.02, 0.8).into(), turn);
                segmenter.reset();
                tracker.reset();
                let mut found = None;
                for n in 0..2 {
                    simulator.draw_pose(&truth, &[], frame_time(n), &mut frame);
                    let cloud = segmenter.segment(&frame, simulator.camera());
                    found = cloud.and_then(|cloud| tracker.track(cloud, frame_time(n)));
                }
                let off = found.map(|found| turn.inverse() * found.sensor_from_head.rotation);
                if yaw == 0.0 && pitch == 0.0 {
                    frontal = off;
                }
                turns.push(off);
            }
        }
        let offset = frontal.unwrap_or_default();
        let angle = |off: Rotation| f64::from(off.angle_to(&offset)).to_degrees();
        let error = |off: Option<Rotation>| off.map_or(f64::INFINITY, angle);
        Ok(turns.into_iter().map(error).collect())
    }

    /// How often a head is recognised in another session, and how often others are taken for it.
    pub(super) fn known_again(&self) -> Result<String, PipelineError> {
        let simulator = self.simulator(Scene::Acted, 0);
        let judge = self.trial.pipeline(simulator.camera())?;
        let session =
            |k: usize, seed: u64, frames: &[usize]| -> Result<Vec<Likeness>, PipelineError> {
                let mut simulator = Simulator::new(self.asset(k), Scene::Acted, seed);
                let mut pipeline = self.trial.pipeline(simulator.camera())?;
                let (mut frame, mut seen) = (Frame::default(), Vec::new());
                // Starts in the middle of a movement.
                for n in 0..*frames.last().unwrap_or(&0) {
                    simulator.draw(frame_time(100 + n), &mut frame);
                    pipeline.follow(&frame);
                    if frames.contains(&(n + 1)) {
                        seen.push(pipeline.likeness(0));
                    }
                }
                Ok(seen)
            };
        let learned = self.each(|k| Ok(session(k, self.trial.sessions.seed, &[90])?.remove(0)))?;
        let frames = REID_RULES.map(|(frames, _)| frames);
        let looks = self.each(|k| session(k, self.trial.sessions.seed + 99, &frames))?;
        let mut text = Vec::new();
        for (look, (frames, most)) in REID_RULES.into_iter().enumerate() {
            let (mut same, mut other) = ([0; 2], [0; 2]);
            for (k, seen) in looks.iter().enumerate() {
                for (n, known) in learned.iter().enumerate() {
                    let apart = judge.identity_distance(&seen[look], known);
                    let count = if n == k { &mut same } else { &mut other };
                    count[0] += usize::from(apart.is_some_and(|apart| apart < most));
                    count[1] += 1;
                }
            }
            text.push(format!(
                "after {frames} frames {} of {} recognised, {} of {} mistaken for another",
                same[0], same[1], other[0], other[1]
            ));
        }
        Ok(text.join("; "))
    }

    /// Numbers of frames with a detected face, and of frames, among real ones without a face.
    pub(super) fn real_faces(&self) -> Result<Option<[usize; 2]>, PipelineError> {
        let camera = mien_sensors::kinect::geometry::nominal();
        let mut pipeline = self.trial.pipeline(&camera)?;
        let mut frame = Frame::default();
        let (mut faces, mut count) = (0, 0);
        for name in ["five_people", "desk_000", "desk_001"] {
            let folder = self.trial.data.join("kinect_v1_pcl");
            let picture = |kind| image::open(folder.join(format!("{name}_{kind}.png")));
            let [Ok(depth), Ok(rgb)] = ["depth", "rgb"].map(picture) else {
                return Ok(None);
            };
            for (raw, &z_mm) in frame.depth.iter_mut().zip(depth.into_luma16().iter()) {
                let z = f32::from(z_mm) * 1e-3;
                *raw = if z_mm > 0 {
                    camera.raw_from_m(z).round() as u16
                } else {
                    mien_sensors::NO_DEPTH
                };
            }
            colour::luma_from_rgb(&rgb.into_rgb8(), &mut frame.luma);
            for _ in 0..15 {
                (frame.index, frame.at) = (count as u64, frame_time(count));
                pipeline.follow(&frame);
                count += 1;
                let reports = pipeline.reports();
                faces += usize::from(reports.iter().any(|report| report.landmarks.is_some()));
            }
        }
        Ok(Some([faces, count]))
    }
}
