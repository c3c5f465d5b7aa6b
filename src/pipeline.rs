//! The stages in order: the drawing of the library as code.

use crate::capacity::UNITS;
use crate::expression::Expression;
use crate::expression::measures::Measure;
use crate::expression::saved::Learned;
use crate::expression::units::Units;
use crate::face_model::FaceModel;
use crate::geometry::Rigid;
use crate::landmarks::{LandmarkStage, Landmarks};
use crate::output::{Command, Report};
use crate::pose::{PoseError, PoseTracker};
use crate::segment::{HeadCloud, Segmenter};
use crate::sensor::Frame;
use crate::sensor::camera::{Camera, Registration};
use crate::settings::Settings;
use crate::time::Timestamp;
use crate::users::{Presence, TrackingState};

/// The slot of the one user that is followed.
const SLOT: usize = 0;

/// Frame to report: segmentation, pose, landmarks, expression, and what is known of the user.
pub struct Pipeline {
    camera: Camera,
    segmenter: Segmenter,
    pose: PoseTracker,
    landmarks: LandmarkStage,
    expression: Expression,
    presence: Presence,
    /// What was seen last; kept while the face is held.
    seen: Option<(Rigid, Landmarks)>,
    frame: u64,
    at: Timestamp,
    state: TrackingState,
    /// Learned ranges, one for each unit.
    ranges: heapless::Vec<[f32; 3], UNITS>,
}

/// Stages of [`Pipeline::follow`], in order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Heads out of the depth picture.
    Segment,
    /// Where the head is.
    Pose,
    /// The 68 points.
    Landmarks,
    /// Measures, ranges, weights.
    Expression,
}

/// Why a pipeline cannot be made of these settings and this model.
#[derive(Debug, thiserror::Error)]
pub enum PipelineError {
    /// The model's standard head.
    #[error(transparent)]
    Pose(#[from] PoseError),
    /// The model's appearance.
    #[error(transparent)]
    Landmarks(#[from] crate::landmarks::LandmarkError),
}

impl Pipeline {
    /// Builds every stage; all memory is taken here.
    ///
    /// # Errors
    /// If the model lacks what a stage or the chosen method needs.
    pub fn new(
        settings: &Settings,
        registration: &Registration,
        model: &FaceModel,
    ) -> Result<Self, PipelineError> {
        let head = &model.standard_head;
        let anchor: Vec<_> = head
            .points
            .iter()
            .copied()
            .zip(head.normals.iter().copied())
            .collect();
        Ok(Self {
            camera: Camera::new(registration),
            segmenter: Segmenter::new(settings.segment),
            pose: PoseTracker::new(settings.pose, &anchor)?,
            landmarks: LandmarkStage::new(settings.landmarks, model)?,
            expression: Expression::new(settings.learning.clone(), Units::shipped()),
            presence: Presence::new(settings.users.hold_s, settings.users.forget_s),
            seen: None,
            frame: 0,
            at: Timestamp::default(),
            state: TrackingState::Absent,
            ranges: heapless::Vec::new(),
        })
    }

    /// Follows one frame; [`Pipeline::report`] then tells what is known.
    pub fn follow(&mut self, frame: &Frame) {
        self.follow_by_stage(frame, |_| {});
    }

    /// As [`Pipeline::follow`], and calls `after` at the end of each stage that is reached.
    pub fn follow_by_stage(&mut self, frame: &Frame, after: impl FnMut(Stage)) {
        (self.frame, self.at) = (frame.index, frame.at);
        self.state = if self.find(frame, after) {
            self.presence
                .seen(frame.at, !self.expression.weights().warming)
        } else {
            let state = self.presence.unseen(frame.at);
            if state == TrackingState::Absent && self.state != TrackingState::Absent {
                self.forget();
            }
            state
        };
    }

    /// Runs the stages; whether the face was found.
    fn find(&mut self, frame: &Frame, mut after: impl FnMut(Stage)) -> bool {
        let cloud = self.segmenter.segment(frame, &self.camera);
        after(Stage::Segment);
        let Some(cloud) = cloud else {
            return false;
        };
        let pose = self.pose.track(cloud, frame.at);
        after(Stage::Pose);
        let Some(pose) = pose else {
            return false;
        };
        let fitted = self
            .landmarks
            .fit(&frame.luma, &self.camera, &pose, frame.at);
        after(Stage::Landmarks);
        let Some(landmarks) = fitted.cloned() else {
            return false;
        };
        let sensor_from_head = pose.sensor_from_head * self.landmarks.turn();
        self.expression
            .observe(&landmarks, &sensor_from_head, frame.at);
        self.ranges = self.expression.unit_ranges();
        self.seen = Some((sensor_from_head, landmarks));
        after(Stage::Expression);
        true
    }

    /// The next person starts from the priors.
    fn forget(&mut self) {
        self.pose.reset();
        self.landmarks.reset();
        self.expression.reset();
        self.seen = None;
    }

    /// What is known after the last frame.
    #[must_use]
    pub fn report(&self) -> Report<'_> {
        let known = Report {
            frame: self.frame,
            at: self.at,
            user: (self.state != TrackingState::Absent).then_some(SLOT),
            state: self.state,
            ..Report::default()
        };
        match &self.seen {
            Some((pose, landmarks)) if self.state.is_present() => Report {
                confidence: landmarks.confidence,
                sensor_from_head: Some(pose),
                landmarks: Some(landmarks),
                frozen: self.expression.weights().frozen,
                measures: &self.expression.weights().measures,
                weights: self.expression.weights().units(),
                ranges: &self.ranges,
                ..known
            },
            _ => known,
        }
    }

    /// Names of the measures, in the order of [`Report::measures`].
    #[must_use]
    pub fn measure_names() -> Vec<&'static str> {
        Measure::ALL.iter().map(|measure| measure.name()).collect()
    }

    /// Names of the units, in the order of [`Report::weights`].
    #[must_use]
    pub fn unit_names(&self) -> Vec<&str> {
        self.expression
            .unit_names()
            .iter()
            .map(|name| name.as_str())
            .collect()
    }

    /// Does what a receiver asks for; a slot without a user is left as it is.
    pub fn obey(&mut self, command: Command) {
        match command {
            Command::Forget(SLOT) => self.forget(),
            Command::Freeze(SLOT, frozen) => self.expression.freeze(frozen),
            Command::Neutral(SLOT) => self.expression.take_neutral(),
            Command::Forget(_) | Command::Freeze(..) | Command::Neutral(_) => {}
        }
    }

    /// The frames now come from another camera.
    pub fn set_camera(&mut self, registration: &Registration) {
        self.camera = Camera::new(registration);
        self.forget();
    }

    /// The camera the pipeline assumes.
    #[must_use]
    pub fn camera(&self) -> &Camera {
        &self.camera
    }

    /// The head's depth points of the last frame, if one was found.
    #[must_use]
    pub fn head_cloud(&self) -> Option<&HeadCloud> {
        self.segmenter.heads().first()
    }

    /// The segmenter, for pictures of what it saw.
    #[must_use]
    pub fn segmenter(&self) -> &Segmenter {
        &self.segmenter
    }

    /// What was learnt, for pictures and tables.
    #[must_use]
    pub fn expression(&self) -> &Expression {
        &self.expression
    }

    /// Goes on with what another pipeline learnt of its user, as when settings change in the middle of a run.
    pub fn adopt(&mut self, learned: &Learned) {
        self.expression.restore(learned);
    }
}
