//! One person's stages in order (pose, landmarks, expression) and that person's state.
//!
//! All memory is allocated at construction, about 0.3 MB per person; the standard head is shared.

use super::stage::{FrameContext, Stage};
use mien_outputs::Report;
use mien_stages::base::capacity::{REGIONS, UNITS};
use mien_stages::base::frames::SensorFromFace;
use mien_stages::base::geometry::{Point, Vector};
use mien_stages::base::time::Timestamp;

use mien_stages::expression::{Expression, UnitRange};
use mien_stages::landmarks::{LandmarkStage, Landmarks};
use mien_stages::pose::{Evidence, HeadPose, PoseTracker, guess};
use mien_stages::segment::{HeadCloud, PixelRect, gather_at_pose};
use mien_stages::users::likeness::{FaceLengths, Likeness};
use mien_stages::users::matching::LastSeen;
use mien_stages::users::memory::Gone;
use mien_stages::users::{Presence, TrackingState};

/// Consecutive frames without a face after which a known person's pose is rejected.
const FACELESS_FRAMES: u32 = 3;
/// Frames with a face after which depth alone tracks a hidden face; without colour, frames after which unsure poses count.
const KNOWN_FRAMES: u64 = 30;
/// Frames with a face after which the head's velocity predicts its position well enough to skip segmentation.
const SETTLED_FRAMES: u64 = 8;
/// Cosine of the angle between face and line of sight, 70° to 20°, in which a head counts as turned away but still has a depth
/// image of its face.
const AWAY_FACING: core::ops::Range<f32> = 0.34..0.94;
/// Time unseen after which a head may be another person's, seconds; a slow camera's frames may be further apart.
const AWAY_GAP_S: f64 = 0.1;
/// Confidence reported for a face tracked by depth alone.
const AWAY_CONFIDENCE: f32 = 0.25;
/// Minimum confidence of a face that may correct the head pose.
const FUSED_CONFIDENCE: f32 = 0.6;
/// Frames with a face in which a person is new to [`PoseTracker::register_face`].
const CORRECTED_FRAMES: u64 = 3;
/// Consecutive frames with a sure head after which it becomes a user without an image.
const POSED_FRAMES: u64 = 2;
/// Minimum coverage of the middle of the standard head's face for a sure head, 0…1.
const SURE_COVERAGE: f32 = 0.65;
/// Minimum agreement with the standard head for a sure head, 0…1. In the real recording nine of ten frames of the head pass;
/// chair, arms, paper and clothes never exceed 0.54.
const SURE_CONFIDENCE: f32 = 0.56;
/// Agreement at which one frame suffices instead of [`POSED_FRAMES`].
const CERTAIN_CONFIDENCE: f32 = 0.62;

/// A person's state outside their stages.
#[derive(Clone, Default)]
pub(crate) struct Person {
    pub(crate) state: TrackingState,
    /// Last head pose; kept while held.
    head: Option<SensorFromFace>,
    /// Last landmarks; kept while the face is held.
    landmarks: Option<Landmarks>,
    /// Confidence of the landmarks, or of the pose if there are none; 0…1.
    pub(crate) confidence: f32,
    /// Box of the head in this frame's depth image, pixels; `None` if not seen.
    pub(crate) head_box: Option<PixelRect>,
    /// Last position and velocity, for prediction.
    pub(crate) position: Option<LastSeen>,
    /// Time of the first head pose.
    pub(crate) first_seen: Timestamp,
    /// Time of the last head pose, with a face or by depth alone.
    pub(crate) last_seen: Timestamp,
    /// Frames in which the face was seen.
    pub(crate) face_frames: u64,
    /// Consecutive frames in which the head was tracked without colour.
    posed_frames: u64,
    /// Whether the head was missed since the last pose; the next one without an image must then be sure.
    missed: bool,
    /// Facial proportions for re-identification.
    face_lengths: FaceLengths,
}

/// Tracks one person through all stages.
pub(crate) struct Follower {
    pub(crate) pose: PoseTracker,
    pub(crate) landmarks: LandmarkStage,
    pub(crate) expression: Expression,
    pub(crate) presence: Presence,
    pub(crate) person: Person,
    /// Consecutive frames with a pose and without a face.
    faceless: u32,
    /// Number of searches for a face in the image alone; selects the next regions.
    guesses: usize,
    /// Learned ranges, one for each unit.
    ranges: heapless::Vec<UnitRange, UNITS>,
}

impl Follower {
    pub(crate) fn new(
        pose: PoseTracker,
        landmarks: LandmarkStage,
        expression: Expression,
        presence: Presence,
    ) -> Self {
        Self {
            pose,
            landmarks,
            expression,
            presence,
            person: Person::default(),
            faceless: 0,
            guesses: 0,
            ranges: heapless::Vec::new(),
        }
    }

    /// Whether this follower is assigned to a person.
    pub(crate) fn is_taken(&self) -> bool {
        self.person.state != TrackingState::Absent
    }

    /// Whether the candidate may become a user: a face was seen or, without colour, a sure head.
    pub(crate) fn is_admissible(&self) -> bool {
        self.person.face_frames > 0 || self.person.posed_frames >= POSED_FRAMES
    }

    /// Whether the person is known well enough to accept an unsure pose.
    fn is_known(&self) -> bool {
        self.person.face_frames > 0 || self.person.posed_frames >= KNOWN_FRAMES
    }

    /// Whether the face was seen for long enough to be followed when something hides it from depth.
    pub(super) fn is_known_face(&self) -> bool {
        self.person.face_frames >= KNOWN_FRAMES
    }

    /// Whether the face is tracked without interruption, so that segmentation can be skipped.
    pub(crate) fn is_settled(&self) -> bool {
        self.person.face_frames >= SETTLED_FRAMES
            && self.faceless == 0
            && self.person.state.has_face()
    }

    /// Number of tracked frames.
    pub(crate) fn tracked_frames(&self) -> u64 {
        self.person.face_frames + self.person.posed_frames
    }

    /// Runs the stages at the expected head pose, shifted to the segmented centre `middle` (sensor frame, metres) if given, and
    /// fills `cloud` with the head's points. `None`: no head there; otherwise whether a face was found.
    pub(crate) fn follow_expected(
        &mut self,
        context: &mut FrameContext<'_>,
        cloud: &mut HeadCloud,
        middle: Option<Point>,
    ) -> Option<bool> {
        self.person.head_box = None;
        let at = context.frame.at;
        let (expected_pose, scale) = self.pose.expected(at, middle)?;
        let (depth, camera) = (&context.frame.depth, context.camera);
        if !gather_at_pose(depth, camera, &expected_pose, scale, cloud) {
            return None;
        }
        let pose = self.pose.follow(cloud, at);
        (context.stage_done)(Stage::Pose);
        Some(self.run_face_stages(context, cloud, &pose?))
    }

    /// Runs the stages on a segmented head. Returns whether a face was found, or a pose that needs none.
    pub(crate) fn follow_in_cloud(
        &mut self,
        context: &mut FrameContext<'_>,
        cloud: &HeadCloud,
    ) -> bool {
        let (at, budget) = (context.frame.at, context.search_budget);
        let (pose, left) = self.pose.find(cloud, at, budget);
        context.search_budget = left;
        (context.stage_done)(Stage::Pose);
        let Some(pose) = pose else {
            self.person.head_box = Some(cloud.rect);
            self.miss_head();
            self.search_face(context, cloud);
            return false;
        };
        self.run_face_stages(context, cloud, &pose)
    }

    /// Runs the stages after the pose: landmarks, face registration, expression. Returns as [`Self::follow_in_cloud`].
    fn run_face_stages(
        &mut self,
        context: &mut FrameContext<'_>,
        cloud: &HeadCloud,
        pose: &HeadPose,
    ) -> bool {
        self.person.head_box = Some(cloud.rect);
        let Some(landmarks) = self.fit_landmarks(context, pose) else {
            return self.follow_without_face(context, cloud, pose);
        };
        let is_confident = landmarks.confidence >= FUSED_CONFIDENCE;
        let is_new = self.person.face_frames < CORRECTED_FRAMES;
        let sensor_from_face = self.pose.register_face(cloud, pose, is_confident, is_new);
        if landmarks.seen == [1.0; REGIONS] {
            self.person.face_lengths.add(&landmarks.head);
        }
        self.observe_face(context, landmarks, sensor_from_face, cloud.centre);
        true
    }

    /// Reads the expression of a fitted face, whose head has its `centre` there (sensor frame, metres), and stores both.
    pub(super) fn observe_face(
        &mut self,
        context: &mut FrameContext<'_>,
        landmarks: Landmarks,
        sensor_from_face: SensorFromFace,
        centre: Point,
    ) {
        self.expression
            .observe(&landmarks, &sensor_from_face, context.frame.at);
        self.ranges = self.expression.unit_ranges();
        self.accept_landmarks(context, landmarks, sensor_from_face, centre);
    }

    /// Fits landmarks at a pose; `None` without an image or a face.
    fn fit_landmarks(
        &mut self,
        context: &mut FrameContext<'_>,
        pose: &HeadPose,
    ) -> Option<Landmarks> {
        let frame = context.frame;
        if !frame.has_image() {
            return None;
        }
        self.person.posed_frames = 0;
        let fitted = self.landmarks.fit(
            context.scratch,
            &frame.luma,
            &frame.depth,
            context.camera,
            pose,
            &mut self.pose.face,
            frame.at,
        );
        (context.stage_done)(Stage::Landmarks);
        fitted.cloned()
    }

    /// Accepts a pose without a face in the dark, for a head turned away, or for a covered face. Returns whether it did.
    fn follow_without_face(
        &mut self,
        context: &mut FrameContext<'_>,
        cloud: &HeadCloud,
        pose: &HeadPose,
    ) -> bool {
        let is_sure = pose.coverage >= SURE_COVERAGE && pose.confidence >= SURE_CONFIDENCE;
        if !pose.proven {
            self.pose.update(Evidence::Nothing);
            return false;
        }
        if !context.frame.has_image() {
            // Before the person is known, only a sure head counts.
            let is_head = is_sure || (self.is_known() && !self.person.missed);
            if is_head {
                self.follow_by_depth(context, cloud, pose);
            } else {
                self.miss_head();
            }
            return is_head;
        }
        let sensor_from_face = self.pose.sensor_from_face(&pose.sensor_from_head);
        if let Some(landmarks) = self.turned_away(&sensor_from_face, context) {
            self.accept_landmarks(context, landmarks, sensor_from_face, cloud.centre);
            return true;
        }
        // A sure head of a known person: a hand, the light or hair hides the face.
        if self.person.face_frames >= KNOWN_FRAMES && is_sure {
            self.follow_by_depth(context, cloud, pose);
            return true;
        }
        self.count_faceless();
        self.search_face(context, cloud);
        false
    }

    /// Stores the frame's landmarks, fitted or moved with the head, whose `centre` is in the sensor frame, metres.
    fn accept_landmarks(
        &mut self,
        context: &mut FrameContext<'_>,
        landmarks: Landmarks,
        sensor_from_face: SensorFromFace,
        centre: Point,
    ) {
        (context.stage_done)(Stage::Expression);
        let at = context.frame.at;
        self.accept_head(sensor_from_face, centre, at);
        self.person.confidence = landmarks.confidence;
        self.person.landmarks = Some(landmarks);
        self.faceless = 0;
        self.person.missed = false;
        self.person.face_frames += 1;
        let ready = !self.expression.weights().warming;
        self.person.state = self.presence.seen(at, ready);
    }

    /// Searches the image for a face without a depth pose, in one region per frame.
    fn search_face(&mut self, context: &mut FrameContext<'_>, cloud: &HeadCloud) {
        if !context.frame.has_image() {
            return;
        }
        let guesses = guess::guesses(&cloud.points, self.guesses);
        self.guesses += 1;
        let (luma, camera) = (&context.frame.luma, context.camera);
        let (stage, scratch) = (&mut self.landmarks, &mut *context.scratch);
        let search_face = |guess| stage.search_face(scratch, luma, camera, &guess);
        let found = guesses.into_iter().flatten().filter_map(search_face);
        if let Some((_, head)) = found.max_by(|(a, _), (b, _)| a.total_cmp(b)) {
            let evidence = Evidence::Elsewhere(head, context.frame.at);
            self.pose.update(evidence);
        }
    }

    /// Stores the head pose, found with or without a face.
    fn accept_head(&mut self, sensor_from_face: SensorFromFace, centre: Point, at: Timestamp) {
        let origin = sensor_from_face.translation.vector;
        match &mut self.person.position {
            Some(position) => position.update(centre, origin, at),
            None => self.person.position = Some(LastSeen::new(centre, origin, at)),
        }
        if self.person.head.is_none() {
            self.person.first_seen = at;
        }
        self.person.head = Some(sensor_from_face);
        self.person.last_seen = at;
    }

    /// Notes a frame without a head in depth.
    fn miss_head(&mut self) {
        self.person.missed = true;
        if !self.is_known() {
            self.person.posed_frames = 0;
        }
    }

    /// Accepts a pose without a face; landmarks still held move with it.
    fn follow_by_depth(&mut self, context: &FrameContext<'_>, cloud: &HeadCloud, pose: &HeadPose) {
        let at = context.frame.at;
        let sensor_from_face = self.pose.sensor_from_face(&pose.sensor_from_head);
        self.pose.update(Evidence::Head(cloud));
        self.accept_head(sensor_from_face, cloud.centre, at);
        self.faceless = 0;
        self.person.missed = false;
        self.person.posed_frames += 1 + u64::from(pose.confidence >= CERTAIN_CONFIDENCE);
        self.person.state = self.presence.posed(at);
        if self.person.state == TrackingState::Posed {
            self.person.landmarks = None;
        }
        match &mut self.person.landmarks {
            Some(points) => points.reproject(&sensor_from_face, context.camera),
            None => self.person.confidence = pose.confidence,
        }
    }

    /// The last landmarks moved with a known head that turns away, at low confidence. `None` if the head faces the sensor, turns
    /// too far, or was not tracked just before.
    fn turned_away(&self, pose: &SensorFromFace, context: &FrameContext) -> Option<Landmarks> {
        let last = self.person.landmarks.as_ref()?;
        let unseen_s = context.frame.at.seconds_since(self.person.last_seen);
        let longest_s = self.pose.longest_gap_s(AWAY_GAP_S);
        let known = self.person.face_frames >= KNOWN_FRAMES && unseen_s < longest_s;
        let facing = (pose.rotation * Vector::z()).dot(&pose.translation.vector.normalize());
        if !known || !AWAY_FACING.contains(&facing) {
            return None;
        }
        let mut landmarks = last.clone();
        landmarks.reproject(pose, context.camera);
        landmarks.confidence = landmarks.confidence.min(AWAY_CONFIDENCE);
        for confidence in &mut landmarks.point_confidence {
            *confidence = confidence.min(AWAY_CONFIDENCE);
        }
        Some(landmarks)
    }

    /// Counts a pose without a face and rejects it after a few: depth alone may track a wrong pose for long.
    fn count_faceless(&mut self) {
        self.faceless += 1;
        if self.faceless >= FACELESS_FRAMES || self.person.face_frames < KNOWN_FRAMES {
            self.faceless = 0;
            self.pose.update(Evidence::NoFace);
        }
    }

    /// Notes a frame in which the person was not found. Returns whether they are gone now.
    pub(crate) fn miss(&mut self, at: Timestamp) -> bool {
        let was_here = self.is_taken();
        self.person.state = self.presence.unseen(at);
        was_here && !self.is_taken()
    }

    /// Resets everything to the priors for the next person.
    pub(crate) fn forget(&mut self) {
        self.pose.reset();
        self.landmarks.reset();
        self.expression.reset();
        self.expression.freeze(false);
        self.presence.reset();
        self.person = Person::default();
        self.faceless = 0;
    }

    /// Replaces the learning stages; the person's learned ranges and presence carry over.
    pub(crate) fn replace_learning(&mut self, mut expression: Expression, mut presence: Presence) {
        if self.is_taken() {
            expression.restore(&self.expression.learned());
            expression.freeze(self.expression.weights().frozen);
            presence.adopt(&self.presence);
        }
        (self.expression, self.presence) = (expression, presence);
        self.ranges = self.expression.unit_ranges();
    }

    /// The person's features for re-identification.
    pub(crate) fn likeness(&self) -> Likeness {
        Likeness {
            head: self.pose.signature(),
            face: self.person.face_lengths,
        }
    }

    /// The person's record for [`mien_stages::users::memory`].
    pub(crate) fn gone(&self, slot: usize) -> Gone {
        Gone {
            slot,
            likeness: self.likeness(),
            learned: self.expression.learned(),
            last_seen: self.person.last_seen,
            before_s: 0.0,
        }
    }

    /// Adds the person's results to a report with frame, time and user.
    pub(crate) fn report<'a>(&'a self, known: Report<'a>) -> Report<'a> {
        let known = Report {
            state: self.person.state,
            ..known
        };
        if !self.person.state.is_present() {
            return known;
        }
        let known = Report {
            confidence: self.person.confidence,
            sensor_from_face: self.person.head.as_deref(),
            head_box: self.person.head_box,
            frozen: self.expression.weights().frozen,
            ..known
        };
        match &self.person.landmarks {
            Some(points) => Report {
                landmarks: Some(points),
                measures: &self.expression.weights().measures,
                weights: self.expression.weights().units(),
                ranges: &self.ranges,
                ..known
            },
            None => known,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::Settings;
    use mien_sensors::Frame;
    use mien_simulator::simulated::Simulated;
    use mien_stages::base::frames::SensorFromHead;
    use mien_stages::base::geometry::Rigid;
    use mien_stages::base::geometry::Rotation;
    use mien_stages::camera::Camera;
    use mien_stages::expression::Units;
    use mien_stages::face_model::FaceModel;
    use mien_stages::landmarks::Scratch;
    use mien_stages::segment::Segmenter;

    fn follower() -> Follower {
        let (settings, model) = (Settings::default(), FaceModel::shipped());
        Follower::new(
            PoseTracker::new(settings.pose, &model.standard_head).expect("a head"),
            LandmarkStage::new(settings.landmarks, &model).expect("a model"),
            Expression::new(settings.learning, Units::shipped()),
            Presence::new(settings.users.hold_s, settings.users.forget_s),
        )
    }

    /// Calls `see` with each frame of a seated person, its cloud and the true head pose.
    fn frames(count: usize, mut see: impl FnMut(&Frame, &Camera, &HeadCloud, Rigid)) {
        let mut sensor = Simulated::new(Some("acted")).expect("a scene");
        let camera = sensor.camera().clone();
        let mut segmenter = Segmenter::new(Settings::default().segment);
        let mut frame = Frame::default();
        for _ in 0..count {
            sensor.next_frame(&mut frame);
            let truth = sensor.truth().expect("somebody acts").sensor_from_head;
            if let Some(cloud) = segmenter.segment(&frame, &camera) {
                see(&frame, &camera, cloud, truth);
            }
        }
    }

    fn pose(sensor_from_head: Rigid) -> HeadPose {
        HeadPose {
            sensor_from_head: SensorFromHead::assume_frames(sensor_from_head),
            confidence: 0.9,
            coverage: 0.9,
            proven: true,
        }
    }

    /// Runs the face stages after a given pose; returns their result and the stages that ran.
    fn run_face_stages(
        follower: &mut Follower,
        (frame, camera): (&Frame, &Camera),
        cloud: &HeadCloud,
        pose: &HeadPose,
    ) -> (bool, Vec<Stage>) {
        let mut done = Vec::new();
        let mut context = FrameContext {
            frame,
            camera,
            scratch: &mut Scratch::default(),
            search_budget: 0,
            stage_done: &mut |stage| done.push(stage),
        };
        let seen = follower.run_face_stages(&mut context, cloud, pose);
        (seen, done)
    }

    /// How far a head faces the sensor: the cosine of the angle to the line of sight.
    fn facing(pose: &Rigid) -> f32 {
        (pose.rotation * Vector::z()).dot(&pose.translation.vector.normalize())
    }

    /// The frame with an image without a face.
    fn without_face(frame: &Frame) -> Frame {
        let mut hidden = frame.clone();
        for (k, luma) in hidden.luma.iter_mut().enumerate() {
            *luma = (k % 251) as u8;
        }
        hidden
    }

    #[test]
    fn landmarks_correct_a_rotated_depth_pose() {
        // Too small to restart the pose search.
        let wrong = Rotation::new(Vector::y() * 0.10);
        let mut follower = follower();
        let mut left = Vec::new();
        frames(40, |frame, camera, cloud, truth| {
            let given = pose(truth * wrong);
            let (seen, done) = run_face_stages(&mut follower, (frame, camera), cloud, &given);
            if seen {
                assert_eq!(done, [Stage::Landmarks, Stage::Expression]);
            }
            if seen && let Some(head) = follower.person.head {
                left.push(head.rotation.angle_to(&truth.rotation));
            }
        });
        assert!(left.len() > 30, "{} frames with a face", left.len());
        let late = &left[20..];
        let mean = late.iter().sum::<f32>() / late.len() as f32;
        assert!(mean < 0.06, "{mean} rad of 0.10 are left");
    }

    #[test]
    fn a_face_without_a_depth_pose_is_found_in_the_image() {
        let mut follower = follower();
        let mut random = fastrand::Rng::with_seed(5);
        let (mut looked, mut off) = (0, Vec::new());
        frames(24, |frame, camera, cloud, truth| {
            let search_face = |follower: &mut Follower, frame| {
                let mut context = FrameContext {
                    frame,
                    camera,
                    scratch: &mut Scratch::default(),
                    search_budget: 0,
                    stage_done: &mut |_| {},
                };
                follower.search_face(&mut context, cloud);
            };
            search_face(&mut follower, frame);
            looked += 1;
            if follower.pose.is_searching()
                && let Some((found, _)) = follower.pose.expected(frame.at, None)
            {
                let apart = (found.translation.vector - truth.translation.vector).norm();
                off.push((found.rotation.angle_to(&truth.rotation), apart));
            }
            // Noise leaves no state.
            follower.pose.reset();
            let mut covered = frame.clone();
            covered.luma.fill_with(|| random.u8(..));
            search_face(&mut follower, &covered);
            assert!(!follower.pose.is_searching(), "no face in noise");
        });
        assert!(looked > 20 && off.len() >= 4, "{} of {looked}", off.len());
        for (turned, apart) in &off {
            assert!(*turned < 0.3 && *apart < 0.05, "{turned} rad, {apart} m");
        }
    }

    #[test]
    fn other_learning_settings_keep_the_person() {
        let mut after = follower();
        let mut at = Timestamp::default();
        let mut face = FaceLengths::default();
        frames(12, |frame, camera, cloud, truth| {
            let frames = after.person.face_frames;
            run_face_stages(&mut after, (frame, camera), cloud, &pose(truth));
            if after.person.face_frames > frames {
                face.add(&after.person.landmarks.as_ref().expect("a face").head);
            }
            at = frame.at;
        });
        assert_eq!(
            after.person.face_lengths, face,
            "known by every face that was seen"
        );
        after.expression.freeze(true);
        let learned = format!("{:?}", after.expression.learned());
        let Follower {
            expression,
            presence,
            ..
        } = follower();
        after.replace_learning(expression, presence);
        assert_eq!(format!("{:?}", after.expression.learned()), learned);
        assert!(after.person.face_frames > 5 && after.person.face_lengths == face);
        assert!(after.expression.weights().frozen && !after.ranges.is_empty());
        // Presence carried over: a missed frame holds the user.
        after.miss(Timestamp::from_us(at.as_us() + 33_000));
        assert_eq!(after.person.state, TrackingState::Held);
        // Forgetting clears everything.
        after.forget();
        assert!(
            !after.is_taken() && after.person.head.is_none() && after.person.position.is_none()
        );
        assert!(!after.is_admissible() && !after.expression.weights().frozen);
    }

    #[test]
    fn a_sure_head_with_a_covered_face_is_tracked_by_depth() {
        let mut follower = follower();
        let mut frame_number = 0;
        let mut covered = 0;
        frames(45, |frame, camera, cloud, truth| {
            frame_number += 1;
            if frame_number <= 35 {
                run_face_stages(&mut follower, (frame, camera), cloud, &pose(truth));
                return;
            }
            if follower.person.face_frames < KNOWN_FRAMES {
                return;
            }
            let hidden = without_face(frame);
            covered += 1;
            let unsure = HeadPose {
                coverage: SURE_COVERAGE - 0.01,
                ..pose(truth)
            };
            let before = follower.person.face_frames;
            if facing(&truth) >= AWAY_FACING.end {
                if covered == 1 {
                    assert!(!run_face_stages(&mut follower, (&hidden, camera), cloud, &unsure).0);
                }
                assert!(run_face_stages(&mut follower, (&hidden, camera), cloud, &pose(truth)).0);
                assert_eq!(follower.person.face_frames, before, "no face was seen");
                assert_eq!(follower.person.last_seen, frame.at);
                assert!(follower.person.head.is_some_and(|head| {
                    (head.translation.vector - truth.translation.vector).norm() < 1e-4
                }));
            }
        });
        assert!(covered > 5, "{covered}");
    }

    #[test]
    fn without_colour_two_sure_frames_or_a_certain_one_admit_a_head() {
        for (confidence, coverage, somebody_after) in [
            (0.61, 0.7, Some(2)),
            (0.63, 0.7, Some(1)),
            (0.55, 0.7, None),
            (0.63, 0.64, None),
        ] {
            let mut follower = follower();
            let (mut seen, mut first) = (0, None);
            frames(6, |frame, camera, cloud, truth| {
                let mut dark = frame.clone();
                dark.has_colour = false;
                let given = HeadPose {
                    confidence,
                    coverage,
                    ..pose(truth)
                };
                let found = run_face_stages(&mut follower, (&dark, camera), cloud, &given).0;
                assert_eq!(found, somebody_after.is_some());
                seen += 1;
                if first.is_none() && follower.is_admissible() {
                    first = Some(seen);
                    assert_eq!(follower.person.state, TrackingState::Posed);
                    assert_eq!(follower.person.confidence, confidence);
                }
            });
            assert_eq!(first, somebody_after, "{confidence} {coverage}");
        }
    }

    #[test]
    fn a_known_pose_is_rejected_at_the_third_frame_without_a_face_an_unknown_one_at_the_first() {
        let mut follower = follower();
        for (frames, counts) in [(29, [0, 0, 0]), (30, [1, 2, 0])] {
            follower.person.face_frames = frames;
            for count in counts {
                follower.count_faceless();
                assert_eq!(follower.faceless, count, "{frames} frames");
            }
        }
    }

    #[test]
    fn a_covered_face_is_tracked_after_thirty_frames() {
        for (frames_before, followed) in [(29, false), (30, true)] {
            let mut looked = false;
            frames(6, |frame, camera, cloud, truth| {
                if looked || facing(&truth) < AWAY_FACING.end {
                    return;
                }
                looked = true;
                let hidden = (&without_face(frame), camera);
                let mut follower = follower();
                follower.person.face_frames = frames_before;
                let found = run_face_stages(&mut follower, hidden, cloud, &pose(truth)).0;
                assert_eq!(found, followed, "{frames_before} frames");
            });
            assert!(looked);
        }
    }
}
