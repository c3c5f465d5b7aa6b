//! One person's stages in order (pose, landmarks, expression) and everything known about that person.
//!
//! All memory is allocated at construction, about 0.3 MB per person; the standard head is shared.

use super::stage::{Now, Stage};
use mien_outputs::Report;
use mien_stages::base::capacity::UNITS;
use mien_stages::base::frames::SensorFromFace;
use mien_stages::base::geometry::{Point, Vector};
use mien_stages::base::time::Timestamp;
use mien_stages::camera::Camera;
use mien_stages::expression::{Expression, UnitRange};
use mien_stages::landmarks::{LandmarkStage, Landmarks};
use mien_stages::pose::{Evidence, HeadPose, PoseTracker, guess};
use mien_stages::segment::{HeadCloud, PixelRect, gather_at_pose};
use mien_stages::users::likeness::{FaceLengths, Likeness};
use mien_stages::users::matching::LastSeen;
use mien_stages::users::memory::Gone;
use mien_stages::users::{Presence, TrackingState};

/// A pose without a face for this many frames is rejected.
const FACELESS_FRAMES: u32 = 3;
/// A face seen in this many frames is known, and may turn away.
const KNOWN_FRAMES: u64 = 30;
/// A head whose face was seen in this many frames has a speed, by which it is found where it is expected.
const SETTLED_FRAMES: u64 = 8;
/// Cosines of the angle to the line of sight between which a head counts as turned away while depth still sees its face: 20°
/// and 70°.
const AWAY_FACING: core::ops::Range<f32> = 0.34..0.94;
/// After this long unseen, a head may be another person's, seconds.
const AWAY_GAP_S: f64 = 0.1;
/// Confidence reported for a face tracked by depth alone.
const AWAY_CONFIDENCE: f32 = 0.25;
/// Minimum confidence of a face that may correct the head pose.
const FUSED_CONFIDENCE: f32 = 0.6;
/// The face corrects a pose in this many of its first frames.
const CORRECTED_FRAMES: u64 = 3;
/// Without a picture, a head becomes a user once it was certain in this many consecutive frames.
const POSED_FRAMES: u64 = 2;
/// Certain head: least coverage of the middle of the standard head's face, and least agreement with it. In the real film
/// nine of ten frames of the head pass; chair, arms, paper and clothes never exceed an agreement of 0.54.
const SURE_COVERAGE: f32 = 0.65;
const SURE_CONFIDENCE: f32 = 0.56;
/// A head with this agreement needs only one frame.
const CERTAIN_CONFIDENCE: f32 = 0.62;

/// What is known of a person besides what their stages have learned.
#[derive(Clone, Default)]
pub(crate) struct Person {
    pub(crate) state: TrackingState,
    /// Last head pose; kept while held.
    head: Option<SensorFromFace>,
    /// Last landmarks; kept while the face is held.
    points: Option<Landmarks>,
    /// Confidence of the landmarks, or of the pose if there are none; 0…1.
    confidence: f32,
    /// The head's box in this frame's depth picture, if there is one.
    pub(crate) rect: Option<PixelRect>,
    /// Expected position.
    pub(crate) place: Option<LastSeen>,
    /// When they came.
    pub(crate) since: Timestamp,
    /// When the head was last tracked, with its face or by depth alone.
    pub(crate) last_seen: Timestamp,
    /// Frames in which the face was seen.
    pub(crate) frames: u64,
    /// Consecutive frames in which the head was tracked without colour.
    posed: u64,
    /// Whether the head was missed since, so that a new detection has to be certain.
    missed: bool,
    /// Features for re-identification, besides the head.
    face: FaceLengths,
}

/// Tracks one person.
pub(crate) struct Follower {
    pub(crate) pose: PoseTracker,
    pub(crate) landmarks: LandmarkStage,
    pub(crate) expression: Expression,
    pub(crate) presence: Presence,
    pub(crate) person: Person,
    /// Consecutive frames with a pose and without a face.
    faceless: u32,
    /// Number of places searched for a face without depth; continues from person to person.
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

    /// Whether enough was seen to make this a user: a face, or without colour a stable head.
    pub(crate) fn is_somebody(&self) -> bool {
        self.person.frames > 0 || self.person.posed >= POSED_FRAMES
    }

    /// Whether enough was seen to accept an uncertain pose.
    fn is_known(&self) -> bool {
        self.person.frames > 0 || self.person.posed >= KNOWN_FRAMES
    }

    /// Whether the face is followed without interruption, so that the head need not be cut out.
    pub(crate) fn is_settled(&self) -> bool {
        self.person.frames >= SETTLED_FRAMES && self.faceless == 0 && self.person.state.has_face()
    }

    /// Frames for which the candidate was tracked.
    pub(crate) fn followed(&self) -> u64 {
        self.person.frames + self.person.posed
    }

    /// The stages where the head is expected, whose cut-out is centred on `middle`; `None` if it is not there. Whether they
    /// found it. `cloud` is filled with its points.
    pub(crate) fn follow_expected(
        &mut self,
        now: &mut Now<'_>,
        cloud: &mut HeadCloud,
        middle: Option<Point>,
    ) -> Option<bool> {
        self.person.rect = None;
        let at = now.frame.at;
        let (place, scale) = self.pose.expected(at, middle)?;
        if !gather_at_pose(&now.frame.depth, now.camera, &place, scale, cloud) {
            return None;
        }
        let pose = self.pose.follow(cloud, at);
        (now.after)(Stage::Pose);
        Some(self.look(now, cloud, &pose?))
    }

    /// The stages on a cut-out head; whether a face was found, or the pose where that is enough.
    pub(crate) fn follow_in(&mut self, now: &mut Now<'_>, cloud: &HeadCloud) -> bool {
        let pose;
        (pose, now.searches) = self.pose.find(cloud, now.frame.at, now.searches);
        (now.after)(Stage::Pose);
        let Some(pose) = pose else {
            self.person.rect = Some(cloud.rect);
            self.miss_head();
            self.search_face(now, cloud);
            return false;
        };
        self.look(now, cloud, &pose)
    }

    /// The stages after the pose: landmarks, the pose's correction by them, expression.
    fn look(&mut self, now: &mut Now<'_>, cloud: &HeadCloud, pose: &HeadPose) -> bool {
        self.person.rect = Some(cloud.rect);
        let Some(landmarks) = self.fit(now, pose) else {
            return self.follow_without_face(now, cloud, pose);
        };
        let is_confident = landmarks.confidence >= FUSED_CONFIDENCE;
        let is_new = self.person.frames < CORRECTED_FRAMES;
        let sensor_from_face = self.pose.register_face(cloud, pose, is_confident, is_new);
        self.expression
            .observe(&landmarks, &sensor_from_face, now.frame.at);
        self.ranges = self.expression.unit_ranges();
        self.person.face.add(&landmarks.head);
        self.show(now, landmarks, sensor_from_face, cloud);
        true
    }

    /// The landmarks at a pose, if the frame has a picture and there is a face.
    fn fit(&mut self, now: &mut Now<'_>, pose: &HeadPose) -> Option<Landmarks> {
        let frame = now.frame;
        if !frame.has_image() {
            return None;
        }
        self.person.posed = 0;
        let fitted = self.landmarks.fit(
            now.scratch,
            &frame.luma,
            &frame.depth,
            now.camera,
            pose,
            &mut self.pose.face,
            frame.at,
        );
        (now.after)(Stage::Landmarks);
        fitted.cloned()
    }

    /// A pose without a face, which may be one all the same: in the dark, turned away, or behind a hand.
    fn follow_without_face(
        &mut self,
        now: &mut Now<'_>,
        cloud: &HeadCloud,
        pose: &HeadPose,
    ) -> bool {
        let is_sure = pose.coverage >= SURE_COVERAGE && pose.confidence >= SURE_CONFIDENCE;
        if !pose.proven {
            self.pose.update(Evidence::Nothing);
            return false;
        }
        if !now.frame.has_image() {
            // Until somebody is known to be there, only what is surely a head counts.
            let is_one = is_sure || (self.is_known() && !self.person.missed);
            if is_one {
                self.follow_by_depth(now, cloud, pose);
            } else {
                self.miss_head();
            }
            return is_one;
        }
        let sensor_from_face = self.pose.sensor_from_face(&pose.sensor_from_head);
        if let Some(landmarks) = self.turned_away(&sensor_from_face, now.camera, now.frame.at) {
            self.show(now, landmarks, sensor_from_face, cloud);
            return true;
        }
        // Somebody whose head is there beyond doubt: a hand, the light or the hair hides the face.
        if self.person.frames >= KNOWN_FRAMES && is_sure {
            self.follow_by_depth(now, cloud, pose);
            return true;
        }
        self.count_faceless();
        self.search_face(now, cloud);
        false
    }

    /// The landmarks of this frame, in it or moved with the head.
    fn show(
        &mut self,
        now: &mut Now<'_>,
        landmarks: Landmarks,
        sensor_from_face: SensorFromFace,
        cloud: &HeadCloud,
    ) {
        (now.after)(Stage::Expression);
        let at = now.frame.at;
        self.find(sensor_from_face, cloud, at);
        self.person.confidence = landmarks.confidence;
        self.person.points = Some(landmarks);
        self.faceless = 0;
        self.person.missed = false;
        self.person.frames += 1;
        let ready = !self.expression.weights().warming;
        self.person.state = self.presence.seen(at, ready);
    }

    /// Searches the colour picture for a face that depth does not show: one place per frame.
    fn search_face(&mut self, now: &mut Now<'_>, cloud: &HeadCloud) {
        if !now.frame.has_image() {
            return;
        }
        let guesses = guess::guesses(&cloud.points, self.guesses);
        self.guesses += 1;
        let (luma, camera) = (&now.frame.luma, now.camera);
        let search_face = |guess| {
            self.landmarks
                .search_face(now.scratch, luma, camera, &guess)
        };
        let found = guesses.into_iter().flatten().filter_map(search_face);
        if let Some((_, head)) = found.max_by(|(a, _), (b, _)| a.total_cmp(b)) {
            self.pose.update(Evidence::Elsewhere(head, now.frame.at));
        }
    }

    /// The head was found, with or without its face.
    fn find(&mut self, sensor_from_face: SensorFromFace, cloud: &HeadCloud, at: Timestamp) {
        let origin = sensor_from_face.translation.vector;
        match &mut self.person.place {
            Some(place) => place.update(cloud.centre, origin, at),
            None => self.person.place = Some(LastSeen::new(cloud.centre, origin, at)),
        }
        if self.person.head.is_none() {
            self.person.since = at;
        }
        self.person.head = Some(sensor_from_face);
        self.person.last_seen = at;
    }

    /// Depth shows no head; for a known person a single such frame is ignored.
    fn miss_head(&mut self) {
        self.person.missed = true;
        if !self.is_known() {
            self.person.posed = 0;
        }
    }

    /// A frame without colour: the pose is accepted, and a face that was just seen moves with it.
    fn follow_by_depth(&mut self, now: &Now<'_>, cloud: &HeadCloud, pose: &HeadPose) {
        let at = now.frame.at;
        let sensor_from_face = self.pose.sensor_from_face(&pose.sensor_from_head);
        self.pose.update(Evidence::Head(cloud));
        self.find(sensor_from_face, cloud, at);
        self.faceless = 0;
        self.person.missed = false;
        self.person.posed += 1 + u64::from(pose.confidence >= CERTAIN_CONFIDENCE);
        self.person.state = self.presence.posed(at);
        if self.person.state == TrackingState::Posed {
            self.person.points = None;
        }
        match &mut self.person.points {
            Some(points) => points.reproject(&sensor_from_face, now.camera),
            None => self.person.confidence = pose.confidence,
        }
    }

    /// A known head that turns away is tracked by depth alone: its landmarks stay fixed to the head and the weights unchanged.
    /// `None` for a head that faces the sensor without showing a face, or was not tracked until now.
    fn turned_away(
        &self,
        pose: &SensorFromFace,
        camera: &Camera,
        at: Timestamp,
    ) -> Option<Landmarks> {
        let last = self.person.points.as_ref()?;
        let known = self.person.frames >= KNOWN_FRAMES
            && at.seconds_since(self.person.last_seen) < AWAY_GAP_S;
        let facing = (pose.rotation * Vector::z()).dot(&pose.translation.vector.normalize());
        if !known || !AWAY_FACING.contains(&facing) {
            return None;
        }
        let mut landmarks = last.clone();
        landmarks.reproject(pose, camera);
        landmarks.confidence = landmarks.confidence.min(AWAY_CONFIDENCE);
        for confidence in &mut landmarks.point_confidence {
            *confidence = confidence.min(AWAY_CONFIDENCE);
        }
        Some(landmarks)
    }

    /// A pose without a face: after a few of them it is rejected, since depth alone may track a wrong pose for long.
    fn count_faceless(&mut self) {
        self.faceless += 1;
        if self.faceless >= FACELESS_FRAMES || self.person.frames < KNOWN_FRAMES {
            self.faceless = 0;
            self.pose.update(Evidence::NoFace);
        }
    }

    /// The face was not found in this frame.
    pub(crate) fn miss(&mut self, at: Timestamp) {
        self.person.state = self.presence.unseen(at);
    }

    /// Resets for the next person, who starts from the priors.
    pub(crate) fn forget(&mut self) {
        self.pose.reset();
        self.landmarks.reset();
        self.expression.reset();
        self.expression.freeze(false);
        self.presence.reset();
        self.person = Person::default();
        self.faceless = 0;
    }

    /// Learns in another way from now on; what was learned about the person stays.
    pub(crate) fn learn_with(&mut self, mut expression: Expression, mut presence: Presence) {
        if self.is_taken() {
            expression.restore(&self.expression.learned());
            expression.freeze(self.expression.weights().frozen);
            presence.adopt(&self.presence);
        }
        (self.expression, self.presence) = (expression, presence);
        self.ranges = self.expression.unit_ranges();
    }

    /// Features for re-identification.
    pub(crate) fn likeness(&self) -> Likeness {
        Likeness {
            head: self.pose.signature(),
            face: self.person.face,
        }
    }

    /// What to remember of the person, and when they were last seen.
    pub(crate) fn gone(&self, slot: usize) -> Gone {
        Gone {
            slot,
            likeness: self.likeness(),
            learned: self.expression.learned(),
            last_seen: self.person.last_seen,
            before_s: 0.0,
        }
    }

    /// Fills in a report that has frame, time and user.
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
            head_box: self.person.rect,
            frozen: self.expression.weights().frozen,
            ..known
        };
        match &self.person.points {
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

    /// Frames of a seated person, each with its cloud and the true head pose.
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

    /// The stages after a given pose; which ones ran.
    fn look(
        follower: &mut Follower,
        (frame, camera): (&Frame, &Camera),
        cloud: &HeadCloud,
        pose: &HeadPose,
    ) -> (bool, Vec<Stage>) {
        let mut done = Vec::new();
        let mut now = Now {
            frame,
            camera,
            scratch: &mut Scratch::default(),
            searches: 0,
            after: &mut |stage| done.push(stage),
        };
        let seen = follower.look(&mut now, cloud, pose);
        (seen, done)
    }

    #[test]
    fn a_head_that_depth_has_turned_is_turned_back_by_its_face() {
        // Less than what makes the pose be searched anew.
        let wrong = Rotation::new(Vector::y() * 0.10);
        let mut follower = follower();
        let mut left = Vec::new();
        frames(40, |frame, camera, cloud, truth| {
            let given = pose(truth * wrong);
            let (seen, done) = look(&mut follower, (frame, camera), cloud, &given);
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

    fn search_face(follower: &mut Follower, frame: &Frame, camera: &Camera, cloud: &HeadCloud) {
        let mut now = Now {
            frame,
            camera,
            scratch: &mut Scratch::default(),
            searches: 0,
            after: &mut |_| {},
        };
        follower.search_face(&mut now, cloud);
    }

    #[test]
    fn a_face_that_depth_does_not_tell_of_is_found_in_the_picture() {
        let mut follower = follower();
        let mut random = fastrand::Rng::with_seed(5);
        let (mut looked, mut off) = (0, Vec::new());
        frames(24, |frame, camera, cloud, truth| {
            search_face(&mut follower, frame, camera, cloud);
            looked += 1;
            if follower.pose.is_searching()
                && let Some((found, _)) = follower.pose.expected(frame.at, None)
            {
                let apart = (found.translation.vector - truth.translation.vector).norm();
                off.push((found.rotation.angle_to(&truth.rotation), apart));
            }
            // Noise is not believed: nothing is kept of it.
            follower.pose.reset();
            let mut covered = frame.clone();
            covered.luma.fill_with(|| random.u8(..));
            search_face(&mut follower, &covered, camera, cloud);
            assert!(!follower.pose.is_searching(), "no face in noise");
        });
        assert!(looked > 20 && off.len() >= 4, "{} of {looked}", off.len());
        for (turned, apart) in &off {
            assert!(*turned < 0.3 && *apart < 0.05, "{turned} rad, {apart} m");
        }
    }

    #[test]
    fn who_learns_with_other_settings_is_who_they_were() {
        let mut after = follower();
        let mut at = Timestamp::default();
        let mut face = FaceLengths::default();
        frames(12, |frame, camera, cloud, truth| {
            let frames = after.person.frames;
            look(&mut after, (frame, camera), cloud, &pose(truth));
            if after.person.frames > frames {
                face.add(&after.person.points.as_ref().expect("a face").head);
            }
            at = frame.at;
        });
        assert_eq!(after.person.face, face, "known by every face that was seen");
        after.expression.freeze(true);
        let learned = format!("{:?}", after.expression.learned());
        let Follower {
            expression,
            presence,
            ..
        } = follower();
        after.learn_with(expression, presence);
        assert_eq!(format!("{:?}", after.expression.learned()), learned);
        assert!(after.person.frames > 5 && after.person.face == face);
        assert!(after.expression.weights().frozen && !after.ranges.is_empty());
        // Unseen just after, they are held and not lost: their presence came along.
        after.miss(Timestamp::from_us(at.as_us() + 33_000));
        assert_eq!(after.person.state, TrackingState::Held);
        // And nothing is left of them in the end.
        after.forget();
        assert!(!after.is_taken() && after.person.head.is_none() && after.person.place.is_none());
        assert!(!after.is_somebody() && !after.expression.weights().frozen);
    }

    #[test]
    fn a_known_head_whose_face_is_covered_is_followed_by_depth_if_it_is_surely_one() {
        let mut follower = follower();
        let mut frame_number = 0;
        let mut covered = 0;
        frames(45, |frame, camera, cloud, truth| {
            frame_number += 1;
            if frame_number <= 35 {
                look(&mut follower, (frame, camera), cloud, &pose(truth));
                return;
            }
            if follower.person.frames < KNOWN_FRAMES {
                return;
            }
            // Something before the face: a picture, but none of a face.
            let mut hidden = frame.clone();
            for (k, luma) in hidden.luma.iter_mut().enumerate() {
                *luma = (k % 251) as u8;
            }
            covered += 1;
            let unsure = HeadPose {
                coverage: SURE_COVERAGE - 0.01,
                ..pose(truth)
            };
            let faces = (truth.rotation * Vector::z()).dot(&truth.translation.vector.normalize());
            let before = follower.person.frames;
            if faces >= AWAY_FACING.end {
                if covered == 1 {
                    assert!(!look(&mut follower, (&hidden, camera), cloud, &unsure).0);
                }
                assert!(look(&mut follower, (&hidden, camera), cloud, &pose(truth)).0);
                assert_eq!(follower.person.frames, before, "no face was seen");
                assert_eq!(follower.person.last_seen, frame.at);
                assert!(follower.person.head.is_some_and(|head| {
                    (head.translation.vector - truth.translation.vector).norm() < 1e-4
                }));
            }
        });
        assert!(covered > 5, "{covered}");
    }

    #[test]
    fn without_colour_two_frames_of_a_sure_head_make_somebody_or_one_of_a_certain_one() {
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
                let found = look(&mut follower, (&dark, camera), cloud, &given).0;
                assert_eq!(found, somebody_after.is_some());
                seen += 1;
                if first.is_none() && follower.is_somebody() {
                    first = Some(seen);
                    assert_eq!(follower.person.state, TrackingState::Posed);
                    assert_eq!(follower.person.confidence, confidence);
                }
            });
            assert_eq!(first, somebody_after, "{confidence} {coverage}");
        }
    }

    #[test]
    fn who_is_known_is_doubted_at_the_third_frame_without_a_face_who_is_not_at_once() {
        let mut follower = follower();
        for (frames, counts) in [(29, [0, 0, 0]), (30, [1, 2, 0])] {
            follower.person.frames = frames;
            for count in counts {
                follower.count_faceless();
                assert_eq!(follower.faceless, count, "{frames} frames");
            }
        }
    }

    #[test]
    fn a_covered_face_is_followed_from_the_thirtieth_frame_of_a_head_on() {
        for (frames_before, followed) in [(29, false), (30, true)] {
            let mut looked = false;
            frames(6, |frame, camera, cloud, truth| {
                let faces =
                    (truth.rotation * Vector::z()).dot(&truth.translation.vector.normalize());
                if looked || faces < AWAY_FACING.end {
                    return;
                }
                looked = true;
                let mut hidden = frame.clone();
                for (k, luma) in hidden.luma.iter_mut().enumerate() {
                    *luma = (k % 251) as u8;
                }
                let mut follower = follower();
                follower.person.frames = frames_before;
                let found = look(&mut follower, (&hidden, camera), cloud, &pose(truth)).0;
                assert_eq!(found, followed, "{frames_before} frames");
            });
            assert!(looked);
        }
    }
}
