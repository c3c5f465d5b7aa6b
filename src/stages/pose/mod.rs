//! Head cloud to `sensor_from_head`: rigid ICP, anchored, smoothed (paper section 1.1, steps 2 and 3).
//!
//! Two methods implement [`Tracker`]: the paper's ([`paper_tracker`]), and the default ([`plane_tracker`]) against a standard
//! head whose size and shape adapt to the user ([`shape`]). Both find the first pose among several starts ([`start`]) and store
//! their poses in a [`trail`], which smooths them ([`smoothing`]).
//!
//! Frames: clouds in the sensor frame, poses `sensor_from_head`, metres. Memory: anchor 0.7 MB, built at construction; the
//! paper's method builds a tree per frame and so allocates, the default does not. Degenerate: a cloud that agrees poorly with
//! the head gives `None`, and the next frame searches again; a learned shape survives short losses only. Limitation: in depth
//! the back of a head resembles a face; the landmarks have to distinguish them.

pub mod anchor;
mod face_in_head;
pub mod guess;
mod hand_over;
pub mod icp;
mod paper_tracker;
mod plane;
mod plane_tracker;
mod settings;
mod shape;
pub mod signature;
pub mod smoothing;
mod start;
#[cfg(test)]
mod tests;
mod trail;

use alloc::sync::Arc;

use crate::base::frames::{HeadFromFace, SensorFromFace, SensorFromHead};
use crate::base::geometry::{Point, Vector};
use crate::base::prelude::*;
use crate::base::time::Timestamp;
use crate::segment::HeadCloud;
use anchor::{Anchor, Surface};
pub use face_in_head::FaceInHead;
use hand_over::HandOver;
use paper_tracker::PaperTracker;
use plane_tracker::PlaneTracker;
pub use settings::{HeadPose, Method, Settings, WINDOW_FRAMES};
use signature::{Difference, Signature};
use trail::{Information, Tracker, Trail};

/// The standard head is unusable; it has this many points.
#[derive(Debug, thiserror::Error)]
#[error(
    "standard head: expected {} to 65534 finite points, found {} points; use a face model written by `mien-studio train`",
    icp::MIN_PAIRS,
    .0
)]
pub struct PoseError(pub usize);

/// Parts of a search, each of which may run in a separate frame.
const SEARCH_HALVES: u32 = 2;
/// Loss after which the learned shape is dropped, seconds: it may be another person.
const FORGET_S: f64 = 2.0;

/// Result of the landmark stage at a pose, if it is no face.
pub enum Evidence<'a> {
    /// No face, but certainly a head: in the dark, or behind a hand.
    Head(&'a HeadCloud),
    /// No face, and depth alone does not prove a head: the pose is discarded.
    Nothing,
    /// No face for too long: the next cloud is aligned from the next search candidate, or searched anew. The learned shape stays.
    NoFace,
    /// A face elsewhere, where depth found no head: the next alignment starts at this pose.
    Elsewhere(SensorFromHead, Timestamp),
}

/// Tracks one head.
pub struct PoseTracker {
    settings: Settings,
    anchor: Arc<Anchor>,
    surface: Option<Arc<Surface>>,
    tracker: Box<dyn Tracker>,
    trail: Trail,
    /// Pose of the face within the head; landmark fits start from it and update it.
    pub face: FaceInHead,
    /// Whether the next start is from the image.
    has_hint: bool,
    hand_over: HandOver,
}

impl PoseTracker {
    /// Prepares the anchor from the standard head: points with outward unit normals, head frame, metres.
    ///
    /// # Errors
    /// If [`Anchor::new`] rejects the standard head.
    pub fn new(settings: Settings, standard_head: &[(Point, Vector)]) -> Result<Self, PoseError> {
        let anchor = Anchor::new(standard_head).ok_or(PoseError(standard_head.len()))?;
        let surface = (settings.method == Method::Paper).then(|| Arc::new(anchor.fine_surface()));
        Ok(Self::with_anchor(settings, Arc::new(anchor), surface))
    }

    fn with_anchor(settings: Settings, anchor: Arc<Anchor>, surface: Option<Arc<Surface>>) -> Self {
        let tracker: Box<dyn Tracker> = match &surface {
            Some(surface) => Box::new(PaperTracker::new(
                &settings,
                anchor.clone(),
                surface.clone(),
            )),
            None => Box::new(PlaneTracker::new(&settings, anchor.clone())),
        };
        Self {
            trail: Trail::new(&settings),
            settings,
            anchor,
            surface,
            tracker,
            face: FaceInHead::default(),
            has_hint: false,
            hand_over: HandOver::default(),
        }
    }

    /// A tracker of another head, with the same settings and a shared standard head.
    pub fn for_another_head(&self) -> Self {
        Self::with_anchor(self.settings, self.anchor.clone(), self.surface.clone())
    }

    /// Whether it follows the image alone, even if there is depth.
    pub fn ignores_depth(&self) -> bool {
        self.settings.method == Method::Image
    }

    /// Number of frames from which this head's shape was learned.
    pub fn learned_frames(&self) -> u64 {
        self.tracker.shape().learned_frames
    }

    /// Signature of this head, for re-identification.
    pub fn signature(&self) -> Signature {
        Signature::from_shape(&self.anchor, self.tracker.shape())
    }

    /// Difference of two heads; `None` if they have too few patches in common.
    pub fn difference(&self, one: &Signature, other: &Signature) -> Option<Difference> {
        one.difference(other, &self.anchor)
    }

    /// Size of the user's head relative to the standard head, 0.86 to 1.17; 1 until learned.
    pub fn head_scale(&self) -> f32 {
        self.tracker.shape().log_scale.exp() as f32
    }

    /// Whether a search continues in the next frame, or a start from the image is pending.
    pub fn is_searching(&self) -> bool {
        self.has_hint || self.tracker.is_searching()
    }

    /// Forgets pose and user; the next cloud belongs to a new person.
    pub fn reset(&mut self) {
        self.restart();
        self.face.reset();
    }

    fn restart(&mut self) {
        self.trail.restart(None);
        self.tracker.forget();
        self.has_hint = false;
        self.hand_over = HandOver::default();
    }

    /// Forgets the user but keeps the pose, from which tracking continues.
    pub fn forget(&mut self) {
        let last = self.trail.last;
        self.reset();
        self.trail.last = last;
    }

    /// Prepares for a frame, which comes `since_s` seconds after the one before.
    pub fn begin_frame(&mut self, since_s: f64) {
        self.trail.frame_s = since_s;
    }

    /// Longest time without the head after which it still counts as the same, seconds: `usual_s`, or with a slow camera two and a half
    /// frames, at most 0.9 s.
    pub fn longest_gap_s(&self, usual_s: f64) -> f64 {
        self.trail.longest_gap_s(usual_s)
    }

    /// Predicted pose and size (relative to the standard head) of a tracked head, to gather its cloud for [`Self::follow`].
    /// `middle`: centre of its segmented cloud in this frame, sensor frame, metres. `None` with the paper's method.
    pub fn expected(
        &mut self,
        at: Timestamp,
        middle: Option<Point>,
    ) -> Option<(SensorFromHead, f32)> {
        let pose = self.tracker.expected(&self.trail, at, middle)?;
        Some((pose, self.head_scale()))
    }

    /// Finds the head near its predicted pose only. On `None` the state is unchanged, so that another cloud of the same frame can be
    /// tried.
    pub fn follow(&mut self, cloud: &HeadCloud, at: Timestamp) -> Option<HeadPose> {
        let (found, information) = self.tracker.follow(cloud, &self.trail, at)?;
        Some(self.trail.store(found, information, at))
    }

    /// Finds the head anywhere in the cloud. A search costs as much as tracking for many frames, so each of `searches` pays for half
    /// of one: with one per frame, [`Self::is_searching`] holds after the first, and the second gives the pose. Also returns the
    /// searches left.
    pub fn find(
        &mut self,
        cloud: &HeadCloud,
        at: Timestamp,
        mut searches: u32,
    ) -> (Option<HeadPose>, u32) {
        self.has_hint = false;
        if let Some((_, before)) = self.trail.last {
            let gap = at.seconds_since(before);
            if !(0.0..FORGET_S).contains(&gap) {
                self.restart();
            } else if gap > self.trail.coast_s() {
                self.break_continuity();
            }
        }
        let found = self.tracker.find(cloud, &self.trail, at, &mut searches);
        let found = found.map(|(found, information)| self.trail.store(found, information, at));
        if found.is_none() {
            self.trail.earlier = None;
        }
        (found, searches)
    }

    fn break_continuity(&mut self) {
        self.trail.forget_speed();
        self.tracker.break_continuity();
    }

    /// [`Self::find`] with a whole search; learns from the cloud without waiting for a face.
    pub fn track(&mut self, cloud: &HeadCloud, at: Timestamp) -> Option<HeadPose> {
        let (pose, _) = self.find(cloud, at, SEARCH_HALVES);
        self.tracker.learn(cloud);
        pose
    }

    /// Pose of the face at a head pose.
    pub fn sensor_from_face(&self, sensor_from_head: &SensorFromHead) -> SensorFromFace {
        *sensor_from_head * self.face.rotation()
    }

    /// Registers the face that was just fitted at `pose`, the last one found: fuses depth with the image if the fit `is_confident`, and
    /// corrects the track if the face is misplaced in the head of a person who `is_new`. `cloud`: of the pose, sensor frame. Returns the
    /// pose of the face.
    pub fn register_face(
        &mut self,
        cloud: &HeadCloud,
        pose: &HeadPose,
        is_confident: bool,
        is_new: bool,
    ) -> SensorFromFace {
        let head_from_face = self.face.rotation();
        let residual = self.face.image_residual().filter(|_| is_confident);
        let fused =
            residual.and_then(|residual| self.trail.fuse(&(pose.sensor_from_head * residual)));
        // What covers a face is no part of its shape.
        if !self.face.is_partial {
            self.tracker.learn(cloud);
        }
        // The face knows better than hair where the head is.
        if let Some(misalignment) = is_new.then(|| self.face.take_misalignment()).flatten() {
            self.correct(&misalignment);
        }
        let seen = fused.unwrap_or(pose.sensor_from_head) * head_from_face;
        let at = self.trail.last.map_or(Timestamp::default(), |(_, at)| at);
        self.hand_over
            .reported(seen, false, at, self.trail.coast_s())
    }

    /// Predicted pose of a tracked face, for a frame whose depth does not show the head. `None` if it was last tracked too long ago.
    pub fn expected_face(&self, at: Timestamp) -> Option<SensorFromFace> {
        let head_from_sensor = self.trail.predicted(at, &Vector::zeros())?;
        Some(head_from_sensor.inverse() * self.face.pose())
    }

    /// Starts at the pose of a face that was found in the image.
    pub fn start_in_image(&mut self, seen: &SensorFromFace, at: Timestamp) {
        let head = *seen * self.face.pose().inverse();
        self.tracker.restart();
        self.trail.restart(Some((head, at)));
    }

    /// Continues at the pose of a face that the image alone shows; returns it smoothed.
    pub fn follow_in_image(&mut self, seen: &SensorFromFace, at: Timestamp) -> SensorFromFace {
        let found = HeadPose {
            sensor_from_head: *seen * self.face.pose().inverse(),
            confidence: 1.0,
            coverage: 0.0,
            proven: true,
        };
        let smoothed = self.trail.store(found, Information::zeros(), at);
        let seen = self.sensor_from_face(&smoothed.sensor_from_head);
        self.hand_over
            .reported(seen, true, at, self.trail.coast_s())
    }

    fn correct(&mut self, head_from_face: &HeadFromFace) {
        self.tracker.break_continuity();
        self.trail.correct(head_from_face);
    }

    /// Applies the landmark stage's result at the last pose.
    pub fn update(&mut self, evidence: Evidence<'_>) {
        match evidence {
            Evidence::Head(cloud) => self.tracker.learn(cloud),
            Evidence::Nothing => self.trail.revert(),
            Evidence::NoFace => {
                self.break_continuity();
                self.trail.last = None;
            }
            Evidence::Elsewhere(pose, at) => {
                self.tracker.restart();
                self.trail.restart(Some((pose, at)));
                self.has_hint = true;
            }
        }
    }
}
