//! Held-out people in front of the simulated sensor, fitted under every condition of the table.

use std::time::Instant;

use super::tallies::{Condition, Seen, Share};
use crate::evaluate::sessions::{Trial, lighting, person_seed};
use crate::frame_time::frame_time;
use crate::train::evaluate::{Differences, differences, mean_offsets, mean_percent, without};
use mien_appliance::pipeline::PipelineError;
use mien_baking::heads::PersonHead;
use mien_sensors::Frame;
use mien_simulator::virtual_head::{Light, Points, Scene, Simulator, Truth};
use mien_stages::base::capacity::{LANDMARKS, PIXELS, WIDTH};
use mien_stages::base::frames::SensorFromHead;
use mien_stages::base::geometry::{Rigid, Vector, rotation_from_yaw_pitch_roll};
use mien_stages::base::time::Timestamp;
use mien_stages::face_model::scheme;
use mien_stages::landmarks::{LandmarkFitter, Landmarks, Scratch, Settings as FitSettings};
use mien_stages::pose::{FaceInHead, HeadPose, PoseTracker};
use mien_stages::segment::Segmenter;
use mien_workbench::fault::Fault;
use mien_workbench::progress::Progress;

/// Period of cold and wrong starts, and of movements of the lamp, frames.
const SPARSE: usize = 5;
/// Period of hiding the whole face, and for how long at its end, frames.
const HIDE: [usize; 2] = [30, 8];

/// Number of covered points: a fifth.
const COVERED: usize = 14;

/// Plays all people.
pub(super) fn play(trial: &Trial) -> Result<Seen, Fault> {
    let play = |head| Player::new(head, trial).map(Player::play);
    let mut all = Seen::default();
    for one in Progress::each("evaluate", trial.held_out()?, play) {
        all.merge(one?);
    }
    Ok(all)
}

/// One person's sessions.
struct Player<'a> {
    trial: &'a Trial<'a>,
    person: usize,
    simulator: Simulator,
    light: Light,
    exposure: f32,
    frame: Frame,
    segmenter: Segmenter,
    pose: PoseTracker,
    random: fastrand::Rng,
    seen: Seen,
}

/// A landmark fitter with its calibration of the face in the head.
struct Fitter {
    landmarks: LandmarkFitter,
    face: FaceInHead,
}

impl Fitter {
    fn reset(&mut self) {
        self.landmarks.reset();
        self.face.reset();
    }
}

/// Fitters of a session, one for each disturbance of the image.
struct Play {
    index: usize,
    tracked: Fitter,
    dim: Fitter,
    covered: Fitter,
    lamp: Fitter,
    /// Restarts in every frame.
    once: Fitter,
    /// Has the appliance's confidence threshold.
    sceptic: Fitter,
    /// Frames since the face reappeared, until it is found.
    waited: Option<u32>,
    changed: Box<[u8; PIXELS]>,
    /// Differences of all points of all tracked frames.
    found: Vec<Differences>,
    /// The landmark around which points are covered.
    centre: usize,
}

/// Time of a frame, its found pose, and the truth.
struct Moment {
    at: Timestamp,
    pose: HeadPose,
    truth: Truth,
}

impl<'a> Player<'a> {
    fn new(head: PersonHead, trial: &'a Trial) -> Result<Self, PipelineError> {
        let seed = person_seed(trial.sessions.seed, head.person);
        let mut random = fastrand::Rng::with_seed(seed);
        let (light, exposure) = lighting(&mut random);
        let stages = &trial.settings.stages;
        Ok(Self {
            trial,
            person: head.person,
            simulator: Simulator::new(head.asset, Scene::Acted, seed).with_light(light, exposure),
            light,
            exposure,
            frame: Frame::default(),
            segmenter: Segmenter::new(stages.segment),
            pose: PoseTracker::new(stages.pose, &trial.model.standard_head)?,
            random,
            seen: Seen {
                people: 1,
                least: stages.landmarks.cascade.min_confidence,
                ..Seen::default()
            },
        })
    }

    /// A fitter with this least confidence.
    fn fitter(&self, min_confidence: f32) -> Fitter {
        let settings = FitSettings {
            min_confidence,
            ..self.trial.settings.stages.landmarks.cascade
        };
        Fitter {
            landmarks: LandmarkFitter::new(settings, self.trial.model),
            face: FaceInHead::default(),
        }
    }

    fn find(&mut self, at: Timestamp) -> Option<HeadPose> {
        let camera = self.simulator.camera();
        let cloud = self.segmenter.segment(&self.frame, camera)?;
        self.pose.track(cloud, at)
    }

    /// Fits the points in the undisturbed image.
    fn fit<'f>(&self, by: &'f mut Fitter, now: &Moment) -> Option<&'f Landmarks> {
        self.fit_in(&self.frame.luma, by, now)
    }

    /// Fits the points in another image with the same depth.
    fn fit_in<'f>(
        &self,
        luma: &[u8; PIXELS],
        by: &'f mut Fitter,
        now: &Moment,
    ) -> Option<&'f Landmarks> {
        let (depth, scratch) = (&self.frame.depth, &mut Scratch::default());
        let camera = self.simulator.camera();
        let Fitter { landmarks, face } = by;
        landmarks.fit(scratch, luma, depth, camera, &now.pose, face, now.at)
    }

    /// Records a fit and its error under a condition; returns the error, NaN without a fit.
    fn record_under(
        &mut self,
        condition: Condition,
        fit: Option<&Landmarks>,
        truth: &Truth,
    ) -> f64 {
        let Some(fit) = fit else { return f64::NAN };
        let error = self.seen.record_fit(fit, truth, &[false; LANDMARKS]);
        self.seen.add(condition, error);
        error
    }

    fn play(mut self) -> Seen {
        self.acted();
        self.extreme_poses();
        self.still();
        self.seen
    }

    fn acted(&mut self) {
        let mut play = Play {
            index: 0,
            tracked: self.fitter(0.0),
            dim: self.fitter(0.0),
            covered: self.fitter(0.0),
            lamp: self.fitter(0.0),
            once: self.fitter(0.0),
            sceptic: self.fitter(self.seen.least),
            waited: None,
            changed: vec![0; PIXELS].try_into().expect("PIXELS long"),
            found: Vec::new(),
            centre: 0,
        };
        // A different section of the acts for each person.
        let first = 90 + (self.person * 151) % 1200;
        for index in 0..(self.trial.sessions.seconds * 30.0) as usize {
            play.index = index;
            let at = frame_time(first + index);
            let Some(truth) = self.simulator.draw(at, &mut self.frame) else {
                continue;
            };
            let Some(pose) = self.find(at) else { continue };
            let now = Moment { at, pose, truth };
            let error = self.tracked(&mut play, &now);
            self.dim(&mut play, &now);
            self.covered(&mut play, &now);
            self.hidden(&mut play, &now);
            if index % SPARSE == 0 {
                self.cold_start(&mut play, &now);
                self.under_a_lamp(&mut play, &now, error);
            }
        }
        let offsets = mean_offsets(&play.found);
        self.seen
            .add(Condition::Offset, mean_percent(&offsets).into());
        for d in &play.found {
            let rest = mean_percent(&without(d, &offsets));
            self.seen.add(Condition::Rest, rest.into());
        }
    }

    /// Fits the undisturbed image; returns the error.
    fn tracked(&mut self, play: &mut Play, now: &Moment) -> f64 {
        let began = Instant::now();
        let fit = self.fit(&mut play.tracked, now);
        let took = began.elapsed().as_secs_f64() * 1e3;
        self.seen.add(Condition::Time, took);
        let found = fit.map(|fit| differences(&fit.pixels, &now.truth.landmarks_px));
        play.found.extend(found);
        self.record_under(Condition::Tracked, fit, &now.truth)
    }

    /// A quarter of the light.
    fn dim(&mut self, play: &mut Play, now: &Moment) {
        for (to, from) in play.changed.iter_mut().zip(self.frame.luma.iter()) {
            *to = from / 4;
        }
        let fit = self.fit_in(&play.changed, &mut play.dim, now);
        self.record_under(Condition::Dim, fit, &now.truth);
    }

    /// Covers a fifth of the points.
    fn covered(&mut self, play: &mut Play, now: &Moment) {
        let truth = &now.truth;
        if play.index.is_multiple_of(30) {
            play.centre = self.random.usize(..LANDMARKS);
        }
        let (out, luma) = (&mut play.changed, &self.frame.luma);
        let hidden = cover(out, luma, truth, (play.centre, COVERED), &mut self.random);
        let Some(fit) = self.fit_in(&play.changed, &mut play.covered, now) else {
            return;
        };
        self.seen.record_fit(fit, truth, &hidden);
        let d = differences(&fit.pixels, &truth.landmarks_px);
        let seen = (0..LANDMARKS).filter(|&i| !hidden[i]);
        let sum: f32 = seen.map(|i| d[i][0].hypot(d[i][1])).sum();
        let error = f64::from(100.0 * sum / (LANDMARKS - COVERED) as f32);
        self.seen.add(Condition::Covered, error);
        for (confidence, hidden) in fit.point_confidence.iter().zip(hidden) {
            let share = [Share::Unflagged, Share::Flagged][usize::from(hidden)];
            self.seen.count(share, (*confidence < 0.5) == hidden);
        }
    }

    /// Hides the whole face for a while, and measures recovery.
    fn hidden(&mut self, play: &mut Play, now: &Moment) {
        let [every, last] = HIDE;
        if play.index % every >= every - last {
            let (out, luma) = (&mut play.changed, &self.frame.luma);
            cover(out, luma, &now.truth, (30, LANDMARKS), &mut self.random);
            let found = self.fit_in(&play.changed, &mut play.sceptic, now).is_some();
            self.seen.count(Share::Unseen, !found);
            play.waited = Some(0);
            return;
        }
        let found = self.fit(&mut play.sceptic, now).is_some_and(|fit| {
            mean_percent(&differences(&fit.pixels, &now.truth.landmarks_px)) <= 5.0
        });
        if let Some(frames) = &mut play.waited {
            *frames += 1;
            if found || play.index % every == every - last - 1 {
                self.seen.add(Condition::Recovered, f64::from(*frames));
                play.waited = None;
            }
        }
    }

    /// Cold starts from the found pose and from a wrong one.
    fn cold_start(&mut self, play: &mut Play, now: &Moment) {
        play.once.reset();
        let fit = self.fit(&mut play.once, now);
        self.record_under(Condition::Cold, fit, &now.truth);
        play.once.reset();
        let wrong = Moment {
            pose: self.wrong_pose(&now.pose),
            truth: now.truth.clone(),
            ..*now
        };
        if let Some(fit) = self.fit(&mut play.once, &wrong) {
            (self.seen).record_fit(fit, &now.truth, &[false; LANDMARKS]);
        }
    }

    /// Light from a circling lamp; `here` is the error without it.
    fn under_a_lamp(&mut self, play: &mut Play, now: &Moment, here: f64) {
        // One revolution in two seconds.
        let turn = std::f32::consts::PI * play.index as f32 / 30.0;
        let towards = Vector::new(turn.cos(), turn.sin() - 0.3, -0.8).normalize();
        let moved = Light {
            towards,
            ..self.light
        };
        self.simulator.set_light(moved, self.exposure);
        self.simulator.draw(now.at, &mut self.frame);
        self.simulator.set_light(self.light, self.exposure);
        let fit = self.fit(&mut play.lamp, now);
        if fit.is_some() {
            self.seen.add(Condition::SameAsLamp, here);
        }
        self.record_under(Condition::Lamp, fit, &now.truth);
    }

    /// The pose, displaced by up to a head's width.
    fn wrong_pose(&mut self, pose: &HeadPose) -> HeadPose {
        let mut about = |size: f32| size * (2.0 * self.random.f32() - 1.0);
        let shift = Vector::new(about(0.1), about(0.1), about(0.1));
        let turn = rotation_from_yaw_pitch_roll(about(0.5), about(0.5), about(0.5));
        let was = &pose.sensor_from_head;
        let shift = was.translation.vector + shift;
        HeadPose {
            sensor_from_head: SensorFromHead::from_parts(shift, turn * was.rotation),
            ..*pose
        }
    }

    /// Wide turns with two expressions a second, each up and down.
    fn extreme_poses(&mut self) {
        let mut fitter = self.fitter(0.0);
        self.pose.reset();
        let count = self.simulator.asset().expressions.len();
        let mut weights = vec![0.0; count];
        let mut chosen = [0; 2];
        for index in 0..(self.trial.sessions.seconds * 18.0) as usize {
            let at = frame_time(3000 + index);
            let t = index as f32 / 30.0;
            if index % 30 == 0 {
                chosen = [(); 2].map(|()| self.random.usize(..count));
            }
            weights.fill(0.0);
            for k in chosen {
                weights[k] = (std::f32::consts::PI * t.fract()).sin().powi(2);
            }
            let (yaw, pitch) = (40.0 * (1.9 * t).sin(), 25.0 * (2.6 * t).sin());
            let turn = rotation_from_yaw_pitch_roll(yaw.to_radians(), pitch.to_radians(), 0.0);
            let pose = Rigid::from_parts(Vector::new(0.0, -0.02, 0.75).into(), turn);
            let Some(now) = self.posed(&pose, &weights, at) else {
                continue;
            };
            let wide = yaw.abs() > 25.0 || pitch.abs() > 15.0;
            let fit = self.fit(&mut fitter, &now).filter(|_| wide);
            self.record_under(Condition::Beyond, fit, &now.truth);
        }
    }

    /// Renders a pose and finds it.
    fn posed(&mut self, pose: &Rigid, weights: &[f32], at: Timestamp) -> Option<Moment> {
        let truth = self.simulator.draw_pose(pose, weights, at, &mut self.frame);
        let pose = self.find(at)?;
        Some(Moment { at, pose, truth })
    }

    /// Jitter of the points of a motionless face.
    fn still(&mut self) {
        let mut fitter = self.fitter(0.0);
        self.pose.reset();
        let weights = vec![0.0; self.simulator.asset().expressions.len()];
        let turn = rotation_from_yaw_pitch_roll(0.1, 0.05, 0.02);
        let pose = Rigid::from_parts(Vector::new(0.02, -0.02, 0.75).into(), turn);
        let mut places: Vec<Points> = Vec::new();
        let mut eye = 1.0;
        for index in 0..60 {
            let at = frame_time(6000 + index);
            let Some(now) = self.posed(&pose, &weights, at) else {
                continue;
            };
            eye = scheme::outer_eye_distance(&now.truth.landmarks_px);
            if let Some(fit) = self.fit(&mut fitter, &now)
                && index >= 20
            {
                places.push(fit.pixels);
            }
        }
        let n = places.len().max(1) as f64;
        let mut squares = 0.0;
        for i in scheme::INNER {
            for axis in 0..2 {
                let mean = places.iter().map(|p| f64::from(p[i][axis])).sum::<f64>() / n;
                let spread = |p: &Points| (f64::from(p[i][axis]) - mean).powi(2);
                squares += places.iter().map(spread).sum::<f64>() / n;
            }
        }
        let count = 2.0 * scheme::INNER.len() as f64;
        let jitter = 100.0 * (squares / count).sqrt() / f64::from(eye);
        self.seen.add(Condition::Jitter, jitter);
    }
}

/// Copies an image and covers the `count` points nearest to one of them, or all, with a rough disc of skin grey;
/// returns which.
fn cover(
    out: &mut [u8; PIXELS],
    luma: &[u8; PIXELS],
    truth: &Truth,
    (centre, count): (usize, usize),
    random: &mut fastrand::Rng,
) -> [bool; LANDMARKS] {
    let points = &truth.landmarks_px;
    let [x, y] = points[centre];
    let far = points.map(|p| (p[0] - x).hypot(p[1] - y));
    let mut order: [usize; LANDMARKS] = std::array::from_fn(|i| i);
    order.sort_by(|&a, &b| far[a].total_cmp(&far[b]));
    let last = far[order[count - 1]];
    let next = order.get(count).map(|&next| far[next]);
    let radius = next.map_or(1.1 * last, |next| 0.5 * (last + next));
    out.copy_from_slice(luma);
    let nose = points[30];
    let skin = f32::from(luma[(nose[1] as usize * WIDTH + nose[0] as usize).min(PIXELS - 1)]);
    let reach = radius.ceil() as i64;
    for row in -reach..=reach {
        for column in -reach..=reach {
            let (px, py) = (x as i64 + column, y as i64 + row);
            let off = (px as f32 - x).hypot(py as f32 - y) / radius;
            if off < 1.0 && (0..WIDTH as i64).contains(&px) && py >= 0 {
                let at = py as usize * WIDTH + px as usize;
                if at < PIXELS {
                    let grey = skin * (1.0 - 0.4 * off * off) + 6.0 * random.f32();
                    out[at] = grey.clamp(0.0, 255.0) as u8;
                }
            }
        }
    }
    std::array::from_fn(|i| order[..count].contains(&i))
}
