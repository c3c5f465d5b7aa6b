//! Head cloud to `sensor_from_head`: rigid ICP, anchored, smoothed (paper section 1.1, steps 2 and 3).
//!
//! Two methods of one [`Tracker`]: the paper's ([`paper_tracker`]), and the default ([`plane_tracker`]) against a standard head
//! whose size and shape adapt to the user ([`shape`]). Both find the first pose among several starts ([`start`]), and leave
//! their poses in the same [`trail`], which smooths them ([`smoothing`]).
//!
//! Frames: clouds in the sensor frame, poses `sensor_from_head`, metres. Memory: anchor 0.7 MB, all built at construction;
//! the paper's method builds a tree per frame and so allocates, the default does not. Degenerate: a cloud that agrees
//! poorly with the head gives `None`, and the next frame searches again; a learned shape survives short losses only.
//! Limitation: in depth the back of a head looks like a head; the landmarks have to tell them apart.

pub mod anchor;
pub mod guess;
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

use crate::base::frames::{HeadFromFace, SensorFromHead};
use crate::base::geometry::{Point, Vector};
use crate::base::prelude::*;
use crate::base::time::Timestamp;
use crate::segment::HeadCloud;
use anchor::{Anchor, Surface};
use paper_tracker::PaperTracker;
use plane_tracker::PlaneTracker;
pub use settings::{HeadPose, Method, Settings, WINDOW_FRAMES};
use signature::{Difference, Signature};
use trail::{COAST_S, Tracker, Trail};

/// Why a tracker cannot be created: a standard head of so many points is unusable.
#[derive(Debug, thiserror::Error)]
#[error(
    "standard head: expected {} to 65534 finite points, found {} points; use a face model written by `mien-studio train`",
    icp::MIN_PAIRS,
    .0
)]
pub struct PoseError(pub usize);

/// Steps of a search, each of which may run in a separate frame.
const SEARCH_HALVES: u32 = 2;
/// After this long it may be another person: the learned shape is dropped, seconds.
const FORGET_S: f64 = 2.0;

/// What the picture shows at a pose that was found: the pose stage learns it after the landmarks.
pub enum Evidence<'a> {
    /// A face, in the cloud that gave the pose.
    Face {
        /// The cloud.
        cloud: &'a HeadCloud,
        /// The head pose that a face as sure as this one implies.
        by_picture: Option<SensorFromHead>,
        /// The pose was wrong: the face is here in it, and the head should be.
        head_from_face: Option<HeadFromFace>,
    },
    /// None, but a head beyond doubt: in the dark, or behind a hand.
    Head(&'a HeadCloud),
    /// None, where depth alone does not prove a head: as if the pose had not been found.
    Nothing,
    /// None for too long: the next cloud is aligned from the next result of its search, or searched anew. What was learned
    /// about the head stays.
    NoFace,
    /// A face where depth found no head: the next cloud is aligned starting there.
    Elsewhere(SensorFromHead, Timestamp),
}

/// Tracks one head.
pub struct PoseTracker {
    settings: Settings,
    anchor: Arc<Anchor>,
    surface: Option<Arc<Surface>>,
    tracker: Box<dyn Tracker>,
    trail: Trail,
    /// Whether the picture gave the next start.
    has_hint: bool,
}

impl PoseTracker {
    /// Prepares the anchor from the standard head: points with outward unit normals, head frame, metres.
    ///
    /// # Errors
    /// When the standard head has too few points or one that is not finite.
    pub fn new(settings: Settings, standard_head: &[(Point, Vector)]) -> Result<Self, PoseError> {
        let anchor = Anchor::new(standard_head).ok_or(PoseError(standard_head.len()))?;
        let surface = (settings.method == Method::Paper).then(|| Arc::new(anchor.fine_surface()));
        Ok(Self::over(settings, Arc::new(anchor), surface))
    }

    fn over(settings: Settings, anchor: Arc<Anchor>, surface: Option<Arc<Surface>>) -> Self {
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
            has_hint: false,
        }
    }

    /// A tracker of another head, with the same settings and a shared standard head.
    pub fn another(&self) -> Self {
        Self::over(self.settings, self.anchor.clone(), self.surface.clone())
    }

    /// Frames from which this head's shape was learned.
    pub fn learned_frames(&self) -> u64 {
        self.tracker.shape().learned_frames
    }

    /// The signature of this head, for re-identification.
    pub fn signature(&self) -> Signature {
        Signature::of(&self.anchor, self.tracker.shape())
    }

    /// How two heads differ. `None` when too little was seen to tell.
    pub fn differ(&self, one: &Signature, other: &Signature) -> Option<Difference> {
        one.differ(other, &self.anchor)
    }

    /// Size of the user's head relative to the standard head, 0.86 to 1.17; 1 until something is learned.
    pub fn head_scale(&self) -> f32 {
        self.tracker.shape().log_scale.exp() as f32
    }

    /// Whether a search continues in the next frame, or a place from the picture is tried.
    pub fn is_searching(&self) -> bool {
        self.has_hint || self.tracker.is_searching()
    }

    /// Forgets pose and user; the next cloud belongs to a new person.
    pub fn reset(&mut self) {
        self.trail.restart(None);
        self.tracker.forget();
        self.has_hint = false;
    }

    /// Forgets the user and not the pose: whoever it is is followed on from there.
    pub fn forget(&mut self) {
        let last = self.trail.last;
        self.reset();
        self.trail.last = last;
    }

    /// Where the head is expected (`sensor_from_head`), and its size against the standard head, if it was followed up to now:
    /// there its points are to be gathered for [`Self::follow`]. `middle` is the centre of its cut-out in this frame.
    /// Nothing with the paper's method.
    pub fn expected(
        &mut self,
        at: Timestamp,
        middle: Option<Point>,
    ) -> Option<(SensorFromHead, f32)> {
        let pose = self.tracker.expected(&self.trail, at, middle)?;
        Some((pose, self.head_scale()))
    }

    /// Finds the head only where it is expected. Without it there all is left as it was, so that the head can be found in
    /// another cloud of the same frame.
    pub fn follow(&mut self, cloud: &HeadCloud, at: Timestamp) -> Option<HeadPose> {
        let (found, known) = self.tracker.follow(cloud, &self.trail, at)?;
        Some(self.trail.keep(found, known, at))
    }

    /// Finds the head anywhere in the cloud. A search costs as much as following a head for many frames, so half of it runs
    /// for each of `searches`: with one a frame, [`Self::is_searching`] after the first, the pose in the second. Returns how
    /// many are left, too.
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
                self.reset();
            } else if gap > COAST_S {
                self.lose();
            }
        }
        let found = self.tracker.find(cloud, &self.trail, at, &mut searches);
        let found = found.map(|(found, known)| self.trail.keep(found, known, at));
        if found.is_none() {
            self.trail.earlier = None;
        }
        (found, searches)
    }

    fn lose(&mut self) {
        self.trail.lose();
        self.tracker.lose();
    }

    /// [`Self::find`] with a whole search, and learns from the cloud as if its face had been seen.
    pub fn track(&mut self, cloud: &HeadCloud, at: Timestamp) -> Option<HeadPose> {
        let (pose, _) = self.find(cloud, at, SEARCH_HALVES);
        self.tracker.learn(cloud);
        pose
    }

    /// Takes up what the picture shows at the last pose; the pose of both together where it differs from that of depth.
    pub fn update(&mut self, evidence: Evidence<'_>) -> Option<SensorFromHead> {
        match evidence {
            Evidence::Face {
                cloud,
                by_picture,
                head_from_face,
            } => {
                let fused = by_picture.and_then(|pose| self.trail.fuse(&pose));
                self.tracker.learn(cloud);
                if let Some(head_from_face) = head_from_face {
                    self.tracker.lose();
                    self.trail.correct(&head_from_face);
                }
                return fused;
            }
            Evidence::Head(cloud) => self.tracker.learn(cloud),
            Evidence::Nothing => self.trail.revert(),
            Evidence::NoFace => {
                self.lose();
                self.trail.last = None;
            }
            Evidence::Elsewhere(pose, at) => {
                self.tracker.restart();
                self.trail.restart(Some((pose, at)));
                self.has_hint = true;
            }
        }
        None
    }
}
