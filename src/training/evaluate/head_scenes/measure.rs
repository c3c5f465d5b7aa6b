//! Figures of a scene: reports matched to the people present.

use crate::evaluate::sessions::{Spread, mean_offset, pose_errors};
use mien_appliance::pipeline::Pipeline;
use mien_simulator::virtual_head::Truth;
use mien_stages::base::capacity::{HEIGHT, WIDTH};
use mien_stages::base::geometry::{Point, Rigid, Vector, yaw_pitch_roll};
use mien_stages::camera::Camera;
use mien_stages::users::TrackingState;

/// Largest distance of a report's head from its person's, metres.
const SAME_M: f32 = 0.12;
/// Frames within which a newcomer must be found.
const ARRIVAL_FRAMES: usize = 10;

/// One person in one frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sight {
    pub(super) truth: Rigid,
    /// Wholly in the image, not occluded, facing the sensor within the range.
    pub(super) visible: bool,
    pub(super) slot: Option<usize>,
    pub(super) state: TrackingState,
    pub(super) found: Option<Rigid>,
}

/// A scene played by one cast.
#[derive(Clone, Debug, Default)]
pub(super) struct SceneRun {
    /// By frame and person; `None` for absent people.
    pub(super) frames: Vec<Vec<Option<Sight>>>,
    /// Number of faces reported where nobody is.
    pub(super) ghosts: usize,
}

impl SceneRun {
    /// Adds the reports of a frame.
    pub(super) fn add(&mut self, truths: &[Option<&Truth>], pipeline: &Pipeline) {
        let camera = pipeline.camera();
        let unseen = |(k, truth): (usize, &Option<&Truth>)| {
            Some(Sight {
                truth: (*truth)?.sensor_from_head,
                visible: visible(k, truths, camera),
                slot: None,
                state: TrackingState::Absent,
                found: None,
            })
        };
        let mut people: Vec<_> = truths.iter().enumerate().map(unseen).collect();
        let mut ghost = false;
        for report in &pipeline.reports() {
            let Some(pose) = report.sensor_from_face else {
                continue;
            };
            let apart =
                |sight: &Sight| (sight.truth.translation.vector - pose.translation.vector).norm();
            let people = people.iter_mut().flatten();
            let nearest = people.min_by(|a, b| apart(a).total_cmp(&apart(b)));
            match nearest.filter(|sight| apart(sight) < SAME_M && sight.slot.is_none()) {
                Some(sight) => {
                    sight.slot = report.user;
                    sight.state = report.state;
                    let live = report.state != TrackingState::Held;
                    sight.found = live.then_some(*pose);
                }
                None => ghost |= report.state != TrackingState::Held,
            }
        }
        self.ghosts += usize::from(ghost);
        self.frames.push(people);
    }

    fn person(&self, k: usize) -> impl Iterator<Item = Option<&Sight>> {
        self.frames.iter().map(move |frame| frame[k].as_ref())
    }

    fn people(&self) -> usize {
        self.frames.first().map_or(0, Vec::len)
    }

    /// Found and true pose of every frame with a found one.
    fn pairs(&self, k: usize) -> Vec<(Rigid, Rigid)> {
        let pair = |sight: &Sight| Some((sight.truth, sight.found?));
        self.person(k).flatten().filter_map(pair).collect()
    }

    /// Number of frames without the pose of a visible person, and of visible frames, excluding arrivals.
    pub(super) fn missing(&self) -> [usize; 2] {
        let (mut missing, mut all) = (0, 0);
        for k in 0..self.people() {
            let mut since = 0;
            for sight in self.person(k) {
                since = match sight {
                    Some(sight) if sight.visible => since + 1,
                    _ => 0,
                };
                if let Some(sight) = sight.filter(|_| since > ARRIVAL_FRAMES) {
                    all += 1;
                    missing += usize::from(sight.found.is_none());
                }
            }
        }
        [missing, all]
    }

    /// Number of frames with a wrong slot, and of frames with one. Correct is the first slot of a person, unless it
    /// already is another's.
    pub(super) fn wrong_ids(&self) -> [usize; 2] {
        let mut owner: Vec<Option<usize>> = vec![None; self.people()];
        let (mut wrong, mut all) = (0, 0);
        for frame in &self.frames {
            for (k, sight) in frame.iter().enumerate() {
                let Some(slot) = sight.filter(|s| s.found.is_some()).and_then(|s| s.slot) else {
                    continue;
                };
                if owner[k].is_none() && !owner.contains(&Some(slot)) {
                    owner[k] = Some(slot);
                }
                all += 1;
                wrong += usize::from(owner[k] != Some(slot));
            }
        }
        [wrong, all]
    }

    /// Frames from visibility to tracking, for each arrival; all frames if never tracked.
    pub(super) fn arrivals(&self) -> Vec<usize> {
        let mut found = Vec::new();
        for k in 0..self.people() {
            let mut waiting: Option<usize> = None;
            let mut followed = false;
            for sight in self.person(k) {
                let Some(sight) = sight else {
                    (waiting, followed) = (None, false);
                    continue;
                };
                if sight.found.is_some() {
                    if !followed {
                        found.push(waiting.unwrap_or(0));
                    }
                    (followed, waiting) = (true, None);
                } else if sight.visible && !followed {
                    waiting = Some(waiting.unwrap_or(0) + 1);
                }
            }
            found.extend(waiting);
        }
        found
    }

    /// Changes of the first person's state into or out of `held`, per ten seconds.
    pub(super) fn flips(&self) -> f64 {
        let held = |sight: Option<&Sight>| sight.is_some_and(|s| s.state == TrackingState::Held);
        let states: Vec<bool> = self.person(0).map(held).collect();
        let flips = states.windows(2).filter(|two| two[0] != two[1]).count();
        flips as f64 * 300.0 / states.len().max(1) as f64
    }

    /// Lag of the found yaw behind the true one, frames: least squares over frames that turn.
    pub(super) fn lag(&self) -> f64 {
        let pairs = self.pairs(0);
        let yaw = |pose: &Rigid| f64::from(yaw_pitch_roll(&pose.rotation).0);
        let (mut ev, mut vv) = (0.0, 0.0);
        let offsets = pairs.iter().map(|(truth, found)| yaw(truth) - yaw(found));
        let offset = offsets.sum::<f64>() / pairs.len().max(1) as f64;
        for three in pairs.windows(3) {
            let v = (yaw(&three[2].0) - yaw(&three[0].0)) / 2.0;
            if v.abs() > 0.01 {
                let e = yaw(&three[1].0) - yaw(&three[1].1) - offset;
                ev += e * v;
                vv += v * v;
            }
        }
        ev / vv
    }

    /// Root mean square about the mean of each second: rotation in degrees, position in millimetres.
    pub(super) fn jitter(&self) -> [f64; 2] {
        let pairs = self.pairs(0);
        let seconds = pairs.chunks_exact(30).skip(2);
        let errors = seconds.flat_map(|second| pose_errors(second, &mean_offset(second)));
        let errors: Vec<[f64; 2]> = errors.collect();
        let sum = |k: usize| errors.iter().map(|e| e[k].powi(2)).sum::<f64>();
        [0, 1].map(|k| (sum(k) / errors.len() as f64).sqrt())
    }
}

/// Rotation (degrees) and translation (mm) errors over runs, less one fixed offset per run.
pub(super) fn pose_spreads(runs: &[SceneRun]) -> [Spread; 2] {
    let mut errors: Vec<[f64; 2]> = Vec::new();
    for run in runs {
        for k in 0..run.people() {
            let pairs = run.pairs(k);
            errors.extend(pose_errors(&pairs, &mean_offset(&pairs)));
        }
    }
    [0, 1].map(|k| Spread::from_values(errors.iter().map(|e| e[k]).collect()))
}

/// Whether a person's whole head is in the image and not occluded.
fn visible(k: usize, truths: &[Option<&Truth>], camera: &Camera) -> bool {
    let Some(pose) = truths[k].map(|truth| truth.sensor_from_head) else {
        return false;
    };
    let corners = [
        (-0.08, 0.0, 0.06),
        (0.08, 0.0, 0.06),
        (0.0, -0.10, 0.06),
        (0.0, 0.12, 0.03),
    ];
    let inside = corners.iter().all(|&(x, y, z)| {
        let [col, row] = camera.depth_pixel(&(pose * Point::new(x, y, z)));
        (8.0..(WIDTH - 16) as f32).contains(&col) && (4.0..(HEIGHT - 4) as f32).contains(&row)
    });
    let middle = |pose: &Rigid| pose * Point::new(0.0, 0.02, 0.07);
    let mine = middle(&pose);
    let hidden = truths.iter().enumerate().any(|(other, truth)| {
        truth.filter(|_| other != k).is_some_and(|truth| {
            let theirs = middle(&truth.sensor_from_head);
            let between = (mine.coords.normalize() - theirs.coords.normalize()).norm();
            theirs.z < mine.z && between < 0.10 / mine.z + 0.11 / theirs.z
        })
    });
    let forward: Vector = pose.rotation * Vector::z();
    let facing = forward.dot(&mine.coords.normalize());
    inside && !hidden && facing > 0.5
}
