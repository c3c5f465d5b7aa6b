//! Frame to reports:
//!
//! ```text
//! frame ─► segment ─► heads ─► people ─► follower of each: pose ─► landmarks ─► expression ─► report of each
//! ```
//! All memory is allocated in [`Pipeline::new`].

use super::follower::Follower;
use super::people::{CANDIDATE, People, PipelineError};
use super::recognition::REID_MIN_FRAMES;
use super::settings::Settings;
use super::stage::{FrameContext, Stage};
use mien_outputs::{Command, Report};
use mien_sensors::Frame;
use mien_stages::base::capacity::USERS;
use mien_stages::base::time::Timestamp;
use mien_stages::camera::Camera;
use mien_stages::expression::Expression;
use mien_stages::expression::measures::Measure;
use mien_stages::expression::units::Units;
use mien_stages::face_model::{FaceModel, FaceTemplate};
use mien_stages::landmarks::face_search::FaceSearch;
use mien_stages::landmarks::{LandmarkStage, Scratch, StageSettings};
use mien_stages::pose;
use mien_stages::segment::Segmenter;
use mien_stages::users::TrackingState;
#[cfg(feature = "studio")]
use mien_stages::users::likeness::Likeness;
use mien_stages::users::memory::Gone;

/// Frame to reports: segmentation, then pose, landmarks and expression of each user.
pub struct Pipeline {
    camera: Camera,
    segmenter: Segmenter,
    face_search: FaceSearch,
    people: People,
    scratch: Scratch,
    /// Settings of pose and landmarks, to detect changes.
    settings: (pose::Settings, StageSettings),
}

impl Pipeline {
    /// Builds every stage; all memory is allocated here.
    ///
    /// # Errors
    /// If the model lacks what a stage or the chosen method needs.
    pub fn new(
        settings: &Settings,
        camera: &Camera,
        model: &FaceModel,
    ) -> Result<Self, PipelineError> {
        Ok(Self {
            camera: camera.clone(),
            segmenter: Segmenter::new(settings.segment),
            face_search: FaceSearch::new(FaceTemplate::shipped()),
            people: People::new(settings, model)?,
            scratch: Scratch::default(),
            settings: (settings.pose, settings.landmarks),
        })
    }

    /// Processes one frame; [`Pipeline::reports`] then gives the results.
    pub fn follow(&mut self, frame: &Frame) {
        self.follow_by_stage(frame, |_| {});
    }

    /// As [`Pipeline::follow`]; calls `stage_done` after each stage.
    pub fn follow_by_stage(&mut self, frame: &Frame, mut stage_done: impl FnMut(Stage)) {
        let mut context = FrameContext {
            frame,
            camera: &self.camera,
            scratch: &mut self.scratch,
            search_budget: 0,
            stage_done: &mut stage_done,
        };
        self.people
            .follow(&mut context, &mut self.segmenter, &mut self.face_search);
    }

    /// Reports of the last frame: one per user, one with the state absent per user forgotten in it, or a single one without a
    /// user if there is neither.
    pub fn reports(&self) -> heapless::Vec<Report<'_>, { USERS + 1 }> {
        let people = &self.people;
        let users = &people.followers[..USERS];
        let nobody = Report {
            frame: people.frame,
            at: people.at,
            ..Report::default()
        };
        let mut reports = heapless::Vec::new();
        for (slot, user) in users.iter().enumerate() {
            if user.is_taken() || people.left[slot] {
                // Has room for all slots and one more.
                let _ = reports.push(user.report(Report {
                    user: Some(slot),
                    other_is_shown: people.choice.shown().is_some_and(|shown| shown != slot),
                    ..nobody
                }));
            }
        }
        if !users.iter().any(Follower::is_taken) {
            match reports.first_mut() {
                Some(gone) => gone.none_left = true,
                None => {
                    let _ = reports.push(nobody);
                }
            }
        }
        reports
    }

    /// The report of the user chosen for single-person outputs, else one without a user.
    pub fn report(&self) -> Report<'_> {
        let reports = self.reports();
        let shown = reports
            .iter()
            .find(|report| !report.other_is_shown && report.state != TrackingState::Absent);
        shown.or(reports.last()).copied().unwrap_or_default()
    }

    /// Names of the measures, in the order of [`Report::measures`].
    pub fn measure_names() -> Vec<&'static str> {
        Measure::ALL.iter().map(|measure| measure.name()).collect()
    }

    /// Names of the units with these settings, in the order of [`Report::weights`].
    pub fn unit_names_with(settings: &Settings) -> Vec<String> {
        let expression = Expression::new(settings.learning, Units::shipped());
        let names = expression.unit_names().iter();
        names.map(|name| name.as_str().to_owned()).collect()
    }

    /// Names of the units, in the order of [`Report::weights`].
    pub fn unit_names(&self) -> Vec<&str> {
        let names = self.expression(0).unit_names().iter();
        names.map(|name| name.as_str()).collect()
    }

    /// Executes a receiver's command. Commands for slots out of range are ignored.
    pub fn execute(&mut self, command: Command) {
        let people = &mut self.people;
        match command {
            Command::Forget(slot @ ..USERS) => {
                people.memory.forget_slot(slot);
                let user = &mut people.followers[slot];
                user.expression.reset();
                user.pose.forget();
                user.landmarks.reset();
            }
            Command::Freeze(slot @ ..USERS, frozen) => {
                people.followers[slot].expression.freeze(frozen);
            }
            Command::Neutral(slot @ ..USERS) => people.followers[slot].expression.take_neutral(),
            _ => {}
        }
    }

    /// Records of people to save at `now`: first those who left, longest gone first, then the present users. Omits people gone
    /// for longer than `users.remember_s`; empty if that is 0.
    pub fn people(&self, now: Timestamp) -> impl Iterator<Item = Gone> + '_ {
        let most_s = f64::from(self.people.settings.remember_s);
        let users = self.people.followers[..USERS].iter().enumerate();
        let known = users
            .filter(|(_, user)| user.is_taken() && user.pose.learned_frames() >= REID_MIN_FRAMES);
        let there = known.map(|(slot, user)| user.gone(slot));
        let all = self.people.memory.gone().iter().cloned().chain(there);
        all.filter(move |gone| most_s > 0.0 && gone.away_s(now) <= most_s)
    }

    /// Forgets people gone for longer than `users.remember_s` at `now`; each frame does so too.
    pub fn forget_older(&mut self, now: Timestamp) {
        let most_s = self.people.settings.remember_s.into();
        self.people.memory.forget_older(now, most_s);
    }

    /// Moves the departure of everybody remembered back by `seconds`.
    pub fn age(&mut self, seconds: f64) {
        self.people.memory.age(seconds);
    }

    /// Adds people saved by an earlier run to the memory.
    pub fn recall(&mut self, people: impl IntoIterator<Item = Gone>) {
        people
            .into_iter()
            .for_each(|gone| self.people.memory.keep(gone));
    }

    /// Builds the stages of one person as a check.
    ///
    /// # Errors
    /// As [`Pipeline::new`].
    pub fn check(settings: &Settings, model: &FaceModel) -> Result<(), PipelineError> {
        pose::PoseTracker::new(settings.pose, &model.standard_head)?;
        LandmarkStage::new(settings.landmarks, model)?;
        Ok(())
    }

    /// Applies new settings during a run. Users are kept; their poses and landmarks too unless those settings change. Stages are
    /// replaced person by person, which bounds peak memory.
    ///
    /// # Errors
    /// As [`Pipeline::new`]; nothing has changed then.
    pub fn rebuild(&mut self, settings: &Settings, model: &FaceModel) -> Result<(), PipelineError> {
        let stage_settings = (settings.pose, settings.landmarks);
        self.people
            .rebuild(settings, model, stage_settings != self.settings)?;
        self.segmenter.set(settings.segment);
        self.settings = stage_settings;
        Ok(())
    }

    /// Replaces the camera and forgets all users.
    pub fn set_camera(&mut self, camera: &Camera) {
        self.camera = camera.clone();
        self.segmenter.reset();
        self.people.rejected.clear();
        self.people.followers.iter_mut().for_each(Follower::forget);
    }

    /// Time of the last frame.
    pub fn last_frame_time(&self) -> Timestamp {
        self.people.at
    }

    /// The camera of the frames.
    pub fn camera(&self) -> &Camera {
        &self.camera
    }

    /// Expression stage of a slot, or of the candidate for a slot out of range.
    pub fn expression(&self, slot: usize) -> &Expression {
        &self.people.followers[slot.min(CANDIDATE)].expression
    }

    /// Distance of two people's features, dimensionless; `None` if too little of a head was seen.
    #[cfg(feature = "studio")]
    pub fn identity_distance(&self, one: &Likeness, other: &Likeness) -> Option<f32> {
        self.people.identity_distance(one, other)
    }

    /// Re-identification features of the user in a slot.
    ///
    /// # Panics
    /// If there is no such slot.
    #[cfg(feature = "studio")]
    pub fn likeness(&self, slot: usize) -> Likeness {
        self.people.followers[slot].likeness()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mien_simulator::simulated::Simulated;
    use mien_stages::pose::Evidence;

    #[test]
    fn every_third_frame_is_segmented_while_all_users_are_tracked() {
        let mut sensor = Simulated::new(Some("acted")).expect("a scene");
        let camera = sensor.camera().clone();
        let (settings, model) = (Settings::default(), FaceModel::shipped());
        let mut pipeline = Pipeline::new(&settings, &camera, &model).expect("a pipeline");
        let mut frame = Frame::default();
        let mut segmented = Vec::new();
        for number in 0..75 {
            sensor.next_frame(&mut frame);
            pipeline.follow_by_stage(&frame, |stage| {
                if stage == Stage::Segment {
                    segmented.push(number);
                }
            });
        }
        segmented.retain(|&number| number >= 45);
        assert_eq!(segmented, [47, 50, 53, 56, 59, 62, 65, 68, 71, 74]);
        // Without users every frame is segmented.
        frame.depth.fill(camera.raw_from_m(2.2) as u16);
        let mut searched = 0;
        for _ in 0..6 {
            pipeline.follow_by_stage(&frame, |stage| {
                searched += usize::from(stage == Stage::Segment);
            });
        }
        assert_eq!(searched, 6);
    }

    #[test]
    fn two_threads_give_the_reports_of_one() {
        let mut sensor = Simulated::new(Some("four")).expect("a scene");
        let mut pipelines = [false, true].map(|second_core| {
            let settings = Settings {
                second_core,
                ..Settings::default()
            };
            Pipeline::new(&settings, sensor.camera(), &FaceModel::shipped()).expect("a pipeline")
        });
        let mut frame = Frame::default();
        let mut most = 0;
        for _ in 0..60 {
            sensor.next_frame(&mut frame);
            pipelines.iter_mut().for_each(|one| one.follow(&frame));
            let [one, two] = [0, 1].map(|k| format!("{:?}", pipelines[k].reports()));
            assert_eq!(one, two);
            most = most.max(pipelines[0].reports().len());
        }
        assert_eq!(most, 4);
        let threads = pipelines.map(|one| one.people.second_core.is_some());
        assert_eq!(threads, [false, true]);
    }

    #[test]
    fn learning_settings_keep_the_face_and_pose_settings_restart_the_search() {
        for (rounds, searched) in [(0, 0), (1, 1)] {
            let mut sensor = Simulated::new(Some("acted")).expect("a scene");
            let mut settings = Settings::default();
            let mut before = Pipeline::new(&settings, sensor.camera(), &FaceModel::shipped())
                .expect("a pipeline");
            let mut frame = Frame::default();
            for _ in 0..46 {
                sensor.next_frame(&mut frame);
                before.follow(&frame);
            }
            settings.learning.half_life_s += 1.0;
            settings.pose.rounds += rounds;
            let mut after = before;
            after
                .rebuild(&settings, &FaceModel::shipped())
                .expect("a pipeline");
            sensor.next_frame(&mut frame);
            let mut segmented = 0;
            after.follow_by_stage(&frame, |stage| {
                segmented += usize::from(stage == Stage::Segment);
            });
            assert_eq!(segmented, searched);
            assert!(after.report().landmarks.is_some() || rounds > 0);
        }
    }

    #[test]
    fn a_forgotten_user_is_tracked_without_a_gap() {
        let mut sensor = Simulated::new(Some("acted")).expect("a scene");
        let mut pipeline =
            Pipeline::new(&Settings::default(), sensor.camera(), &FaceModel::shipped())
                .expect("a pipeline");
        let mut frame = Frame::default();
        for number in 0..50 {
            sensor.next_frame(&mut frame);
            pipeline.follow(&frame);
            let user = &pipeline.people.followers[0];
            let (learned, position) = (user.pose.learned_frames(), user.person.position);
            if number == 45 {
                pipeline.execute(Command::Forget(0));
                let user = &mut pipeline.people.followers[0];
                assert!(learned > 20 && user.pose.learned_frames() == 0);
                let (expected, _) = user.pose.expected(frame.at, None).expect("a place");
                let apart = expected.translation.vector - position.expect("one").centre().coords;
                assert!(apart.norm() < 0.15, "{apart}");
            }
            assert!(number < 45 || pipeline.report().landmarks.is_some());
        }
    }

    #[test]
    fn recognition_in_another_slot_keeps_the_time_of_arrival() {
        let mut sensor = Simulated::new(Some("acted")).expect("a scene");
        let camera = sensor.camera().clone();
        let settings = Settings::default();
        let mut pipeline =
            Pipeline::new(&settings, &camera, &FaceModel::shipped()).expect("a pipeline");
        let mut frame = Frame::default();
        let mut follow = |pipeline: &mut Pipeline, frames: usize, is_there: bool| {
            for _ in 0..frames {
                sensor.next_frame(&mut frame);
                if !is_there {
                    // A wall.
                    frame.depth.fill(camera.raw_from_m(2.2) as u16);
                }
                pipeline.follow(&frame);
            }
            frame.at
        };
        follow(&mut pipeline, 45, true);
        let since = pipeline.people.followers[0].person.first_seen;
        assert!(pipeline.people.followers[0].person.state.has_face());
        // Lost, in another slot, without a position.
        pipeline.people.followers.swap(0, 2);
        follow(&mut pipeline, 45, false);
        assert_eq!(
            pipeline.people.followers[2].person.state,
            TrackingState::Lost
        );
        pipeline.people.followers[2].person.position = None;
        pipeline.people.followers[2].pose.update(Evidence::NoFace);
        let left = pipeline.people.followers[2].person.last_seen;
        let now = follow(&mut pipeline, 15, true);
        let user = &pipeline.people.followers[2];
        assert!(
            user.person.state.has_face(),
            "known again: {:?}",
            user.person.state
        );
        assert!(!pipeline.people.followers[0].is_taken());
        assert_eq!(
            user.person.first_seen, since,
            "came at {left:?}, it is {now:?}"
        );
        assert!(user.person.first_seen < left);
    }
}
