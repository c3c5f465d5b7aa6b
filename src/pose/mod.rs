//! Head cloud to `sensor_from_head`: rigid ICP, anchored, smoothed (paper section 1.1, steps 2 and 3).
//!
//! Two methods. [`Method::Paper`]: point-to-point ICP ([`icp`]), against the standard head in the first frame, then frame to
//! frame, each followed by an alignment to the standard head until convergence, because frame-to-frame motion alone drifts.
//! [`Method::Plane`], the default: point-to-plane against the standard head ([`plane`]), whose size and shape adapt to the
//! user ([`shape`]), from a constant-velocity prediction. Both find the first pose among several starts ([`start`]), which
//! may be spread over two frames, and pass the result to the same filter ([`smoothing`]).
//!
//! Frames: clouds in the sensor frame, poses `sensor_from_head`, metres. Memory: anchor 0.7 MB, all built at construction;
//! the paper's method builds a tree per frame and so allocates, the default does not. Degenerate: a cloud that agrees
//! poorly with the head gives `None`, and the next frame searches again; a learned shape survives short losses only.
//! Limitation: in depth the back of a head looks like a head; the landmarks have to tell them apart.
//! One file: the order of the steps; alignment, shape, start and smoothing have their own files.

pub mod anchor;
pub mod guess;
pub mod icp;
mod lean;
mod patches;
mod plane;
mod shape;
mod shape_learning;
pub mod signature;
pub mod smoothing;
mod start;

use alloc::sync::Arc;

use nalgebra::SMatrix;

use crate::base::defaults;
use crate::base::frames::{HeadFromFace, HeadFromSensor, SensorFromHead};
use crate::base::geometry::{Point, Rigid, Vector};
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;
use crate::base::time::Timestamp;
use crate::segment::HeadCloud;
use anchor::{Anchor, Surface};
use plane::{Coverage, Effort, PlaneFit};
use shape::HeadShape;
use signature::{Difference, Signature};
use smoothing::{PoseFilter, Smoothing};

/// A head pose and its confidence.
#[derive(Clone, Copy, Debug)]
pub struct HeadPose {
    /// Maps head coordinates to the depth camera's.
    pub sensor_from_head: SensorFromHead,
    /// Agreement, 0…1: share of the evidence that fits.
    pub confidence: f32,
    /// Root mean square distance of the accepted pairs, metres.
    pub residual: f32,
    /// Share of the middle of the face, or of the nose if that is less, that the cloud covers, 0…1; 1 with the paper's method,
    /// which does not compute it.
    pub coverage: f32,
    /// Whether depth alone confirms it; otherwise it must be reverted ([`PoseTracker::take_back`]) unless a face is seen
    /// there.
    pub proven: bool,
}

/// Pose estimation method.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Method {
    /// Point-to-point, frame to frame, anchored: the paper's.
    Paper,
    /// Point-to-plane against the learned head.
    #[default]
    Plane,
}

defaults! {
    /// Settings of the pose stage.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct Settings {
        /// Which method.
        pub method: Method = Method::default(),
        /// Filter over time.
        pub smoothing: Smoothing = Smoothing::default(),
        /// Below this agreement (0…1) the head counts as lost.
        pub min_agreement: f32 = 0.45,
        /// Whether size and shape of the user's head are learned (plane method).
        pub learn_shape: bool = true,
        /// Frames of [`Smoothing::Window`].
        pub window_frames: u32 = WINDOW_FRAMES,
        /// Rounds of an alignment at most (paper's method).
        pub rounds: u32 = 400,
    }
}

/// Default length of the window, frames.
pub const WINDOW_FRAMES: u32 = 5;

/// Why a tracker cannot be created.
#[derive(Debug, thiserror::Error)]
pub enum PoseError {
    /// The anchor is unusable.
    #[error(
        "standard head: expected {} to 65534 finite points, found {found} points; the face model is not one of mien's",
        icp::MIN_PAIRS
    )]
    StandardHead {
        /// Points given.
        found: usize,
    },
}

/// Cut-offs of every start's rounds, metres: wide enough for a start 20° off.
const SEARCH_M: [f32; 4] = [0.035, 0.035, 0.03, 0.025];
/// Of the starts kept.
const NARROW_M: [f32; 5] = [0.025, 0.02, 0.015, 0.012, 0.010];
/// Of the finalists.
const SETTLE_M: [f32; 8] = [0.025, 0.020, 0.015, 0.012, 0.010, 0.008, 0.008, 0.008];
/// Of a tracked frame: first on few points, then on all.
const APPROACH_M: [f32; 2] = [0.020, 0.012];
const FOLLOW_M: [f32; 3] = [0.008, 0.006, 0.006];
/// Stride over the points while searching, in the final, and while approaching.
const SEARCH_STRIDE: usize = 5;
const FINAL_STRIDE: usize = 2;
const APPROACH_STRIDE: usize = 4;
/// Weight of points outside the bare face at the end of a search: a fringe or hair beside the face biases the pose.
const BESIDE: f32 = 0.5;
/// Starts kept after the first rounds, and finalists aligned with more points after the next.
const GO_ON: usize = 12;
const FINALISTS: usize = 6;
/// Results of a search kept for the face to choose from, at least this far apart, radians.
const ENDS: usize = 3;
const APART_RAD: f32 = 0.17;
/// Steps of a search, each of which may run in a separate frame.
const SEARCH_HALVES: u32 = 2;
/// Without a pose for this long the prediction is useless, seconds.
const COAST_S: f64 = 0.2;
/// A head moves no further than this between two frames, metres.
const STEP_M: f32 = 0.1;
/// After this long it may be another person: the learned shape is dropped, seconds.
const FORGET_S: f64 = 2.0;
/// Share of the least agreement down to which a tracked head may be confirmed by its face instead.
const UNPROVEN: f32 = 0.7;
/// Share of the pairs with the standard head that is kept, nearest first. More includes what is not face, less drops the
/// cheek that shows the yaw: mean error on two development people 1.5° at 0.80, 1.1° at 0.90, 1.0° at 0.93, 1.1° at 0.95,
/// 3.7° at 1.
const KEPT: f32 = 0.92;
/// At most this many points of a cloud are aligned; more cost time and move a pose by less than its noise.
const MOST_MOVING: usize = 1200;
/// Step at which the alignment with the frame before ends, metres.
const FRAME_STOP_M: f32 = 1e-4;
/// Least share of the pairs that the paper's method must keep.
const MIN_PAIRED: f32 = 0.35;
/// Least share of the middle of the face that the cloud must cover: of a tracked head, which a hand may half cover,
const COVERED_FOLLOWED: f32 = 0.45;
/// and of a newly found one.
const COVERED_FOUND: f32 = 0.60;
/// Least number of agreeing live points.
const MIN_AGREEING: u32 = 120;
/// A frame teaches the shape from this agreement on.
const TEACHING_AGREEMENT: f32 = 0.6;
/// The first [`TAUGHT_ALL`] such frames all teach the shape, later ones every [`TAUGHT_STEP`]-th: neighbours are redundant.
const TAUGHT_ALL: u64 = 60;
const TAUGHT_STEP: u64 = 3;
/// The paper's method rebuilds its target after so many such frames at first, and then.
const REMADE_EARLY: u64 = 3;
const REMADE: u64 = 15;

/// Score of a search result: how well the bare face agrees, how much of it is seen, and how much of the face's middle. Hair
/// and collar, which agree with the sides of a head in many places, no longer count.
fn proof(fit: &PlaneFit, covered: &Coverage) -> f32 {
    fit.agreement * (fit.agreeing as f32).sqrt() * covered.middle
}

/// The best few results of a search's first rounds, best first: on few points with loose cut-offs they cannot be ranked
/// reliably. The score is the support of the whole cloud: too little of the bare face alone is used yet.
struct Best<const N: usize>(heapless::Vec<PlaneFit, N>);

impl<const N: usize> Best<N> {
    const fn new() -> Self {
        Self(heapless::Vec::new())
    }

    fn offer(&mut self, fit: Option<PlaneFit>) {
        let Some(fit) = fit else { return };
        let place = self.0.iter().position(|other| fit.support > other.support);
        if place.is_some() && self.0.is_full() {
            self.0.pop();
        }
        // Full and worse than all: dropped.
        let _ = self.0.insert(place.unwrap_or(self.0.len()), fit);
    }
}

/// The last two poses and the filter, as they were before an unconfirmed pose.
type Before = (
    Option<(SensorFromHead, Timestamp)>,
    Option<(SensorFromHead, Timestamp)>,
    PoseFilter,
);

/// Tracks one head.
pub struct PoseTracker {
    settings: Settings,
    anchor: Arc<Anchor>,
    shape: HeadShape,
    filter: PoseFilter,
    /// Last pose as measured, before the filter, and when.
    last: Option<(SensorFromHead, Timestamp)>,
    /// The one before that.
    earlier: Option<(SensorFromHead, Timestamp)>,
    /// State to restore if the pose is not confirmed.
    before: Option<Before>,
    /// The filter before the last pose, and the information matrix of that pose's alignment, for combining it with the picture.
    unfiltered: PoseFilter,
    known: SMatrix<f64, 6, 6>,
    /// Centre of the cloud of the last pose or of a half-finished search, and its motion since.
    middle: Option<Point>,
    moved: Vector,
    /// Paper's method: the surface between anchor points, the learned head, the frames it was learned from, the last frame's
    /// cloud, and scratch for the pairs.
    surface: Option<Arc<Surface>>,
    standard: Option<icp::Target>,
    lessons: u64,
    previous: Option<icp::Target>,
    scratch: icp::Scratch,
    /// Anchor points covered by a cloud.
    hit: Vec<bool>,
    /// State of a half-finished search, and its time.
    finalists: heapless::Vec<HeadFromSensor, FINALISTS>,
    /// Remaining results of a finished search, best first, in case the first one shows no face.
    ends: heapless::Vec<HeadFromSensor, ENDS>,
    searched: Timestamp,
    /// The last frame's fit, until it has taught the shape.
    lesson: Option<PlaneFit>,
    /// Whether the picture gave the next start of the search.
    is_told: bool,
    /// Frames good enough to learn the shape from.
    taught: u64,
}

impl PoseTracker {
    /// Prepares the anchor from the standard head: points with outward unit normals, head frame, metres.
    ///
    /// # Errors
    /// When the standard head has too few points or one that is not finite.
    pub fn new(settings: Settings, standard_head: &[(Point, Vector)]) -> Result<Self, PoseError> {
        let anchor = Anchor::new(standard_head).ok_or(PoseError::StandardHead {
            found: standard_head.len(),
        })?;
        let surface = (settings.method == Method::Paper).then(|| Arc::new(anchor.fine_surface()));
        Ok(Self::over(settings, Arc::new(anchor), surface))
    }

    fn over(settings: Settings, anchor: Arc<Anchor>, surface: Option<Arc<Surface>>) -> Self {
        let standard = surface
            .as_ref()
            .and_then(|surface| surface.target(|i| anchor.points[i]));
        Self {
            standard,
            surface,
            lessons: 0,
            shape: HeadShape::standard(anchor.points.len()),
            hit: vec![false; anchor.points.len()],
            anchor,
            filter: PoseFilter::new(match settings.smoothing {
                Smoothing::Window(_) => Smoothing::Window(settings.window_frames as usize),
                other => other,
            }),
            settings,
            last: None,
            earlier: None,
            before: None,
            unfiltered: PoseFilter::new(settings.smoothing),
            known: SMatrix::zeros(),
            middle: None,
            moved: Vector::zeros(),
            previous: None,
            scratch: icp::Scratch::default(),
            finalists: heapless::Vec::new(),
            ends: heapless::Vec::new(),
            searched: Timestamp::default(),
            lesson: None,
            is_told: false,
            taught: 0,
        }
    }

    /// A tracker of another head, with the same settings and a shared standard head.
    #[must_use]
    pub fn another(&self) -> Self {
        Self::over(
            self.settings,
            Arc::clone(&self.anchor),
            self.surface.clone(),
        )
    }

    /// Frames from which this head's shape was learned.
    #[must_use]
    pub fn taught(&self) -> u64 {
        self.taught
    }

    /// The signature of this head, for re-identification.
    #[must_use]
    pub fn signature(&self) -> Signature {
        Signature::of(&self.anchor, &self.shape)
    }

    /// How two heads differ. `None` when too little was seen to tell.
    #[must_use]
    pub fn differ(&self, one: &Signature, other: &Signature) -> Option<Difference> {
        one.differ(other, &self.anchor)
    }

    /// Forgets pose and user; the next cloud belongs to a new person.
    pub fn reset(&mut self) {
        self.lose();
        self.last = None;
        self.finalists.clear();
        self.ends.clear();
        self.is_told = false;
        self.lesson = None;
        self.taught = 0;
        self.shape.forget();
        if self.lessons > 0 {
            self.lessons = 0;
            self.standard = self.known_head();
        }
    }

    /// Whether a search continues in the next frame, or a place from the picture is tried.
    #[must_use]
    pub fn is_searching(&self) -> bool {
        !self.finalists.is_empty() || !self.ends.is_empty() || self.is_told
    }

    fn lose(&mut self) {
        self.earlier = None;
        self.previous = None;
        self.filter.reset();
    }

    /// Size of the user's head relative to the standard head, 0.86 to 1.17; 1 until something is learned.
    #[must_use]
    pub fn head_scale(&self) -> f32 {
        self.shape.log_scale.exp() as f32
    }

    /// Finds the head in the cloud and learns from it. `None` when it is not there or agrees poorly; the next call searches again.
    pub fn track(&mut self, cloud: &HeadCloud, at: Timestamp) -> Option<HeadPose> {
        let mut searches = SEARCH_HALVES;
        let pose = self.track_with(cloud, at, &mut searches);
        self.learn(cloud);
        pose
    }

    /// Learns size and shape of the head, once, from the cloud tracked last, which has been confirmed as a head.
    pub fn learn(&mut self, cloud: &HeadCloud) {
        let Some(fit) = self.lesson.take() else {
            return;
        };
        if self.settings.method == Method::Paper {
            self.learn_points(cloud, &fit.head_from_sensor);
            return;
        }
        self.taught += 1;
        if self.taught <= TAUGHT_ALL || self.taught.is_multiple_of(TAUGHT_STEP) {
            self.shape.learn(&self.anchor, &cloud.points, &fit);
        }
    }

    /// The same for the paper's method.
    fn learn_points(&mut self, cloud: &HeadCloud, head_from_sensor: &HeadFromSensor) {
        self.lessons += 1;
        let every = |early, late| {
            if self.lessons <= TAUGHT_ALL {
                early
            } else {
                late
            }
        };
        if self.lessons.is_multiple_of(every(1, TAUGHT_STEP)) {
            self.shape
                .learn_size(&self.anchor, &cloud.points, head_from_sensor);
        }
        if self.lessons.is_multiple_of(every(REMADE_EARLY, REMADE)) {
            self.standard = self.known_head();
        }
    }

    /// The surface of the learned head.
    fn known_head(&self) -> Option<icp::Target> {
        let surface = self.surface.as_ref()?;
        surface.target(|i| self.shape.place(&self.anchor, i))
    }

    /// The last pose was wrong: the face is at `head_from_face` in it, so the head is there. The next cloud is aligned from that.
    pub fn correct(&mut self, head_from_face: &HeadFromFace) {
        self.previous = None;
        self.filter.reset();
        // The one before was as wrong: the head's speed stays.
        for (pose, _) in self.last.iter_mut().chain(&mut self.earlier) {
            // The face sits in this head as it should.
            *pose = SensorFromHead::of(*(*pose * *head_from_face));
        }
    }

    /// The last pose combined with the one that the picture gives ([`lean`]), smoothed; `None` if it stays as it was.
    pub fn lean(&mut self, told: &SensorFromHead) -> Option<SensorFromHead> {
        let (depth, at) = self.last?;
        let leant = lean::lean(&depth, &self.known, told)?;
        self.last = Some((leant, at));
        self.filter.clone_from(&self.unfiltered);
        Some(SensorFromHead::of(self.filter.smooth(*leant, at)))
    }

    /// The picture shows a face where depth found none: the next cloud is aligned starting at `sensor_from_head`.
    pub fn look_at(&mut self, sensor_from_head: SensorFromHead, at: Timestamp) {
        self.lose();
        self.last = Some((sensor_from_head, at));
        (self.middle, self.moved) = (None, Vector::zeros());
        self.finalists.clear();
        self.ends.clear();
        self.is_told = true;
    }

    /// The centre of this head's cut-out in this frame, before tracking: until the head has a speed, that of a person
    /// walking in at 40 mm a frame is predicted from how far this has moved.
    pub fn meet(&mut self, middle: Point) {
        self.moved = self
            .middle
            .map_or(Vector::zeros(), |before| middle - before);
    }

    /// The last pose was not confirmed, and no face was seen there: reverts to the state before it.
    pub fn take_back(&mut self) {
        if let Some((last, earlier, filter)) = self.before.take() {
            (self.last, self.earlier, self.filter) = (last, earlier, filter);
        }
    }

    /// Rejects the pose that was found: the next cloud is aligned from the next result of its search, or searched from scratch.
    /// What was learned about the head stays.
    pub fn doubt(&mut self) {
        self.lose();
        self.last = None;
    }

    /// As [`Self::track`], but without learning ([`Self::learn`]), and a search, which costs as much as following a head for
    /// many frames, only if `searches` are left. Each does half of it: with one a frame, [`Self::is_searching`] after the
    /// first, the pose in the second.
    pub fn track_with(
        &mut self,
        cloud: &HeadCloud,
        at: Timestamp,
        searches: &mut u32,
    ) -> Option<HeadPose> {
        self.lesson = None;
        self.is_told = false;
        if let Some((_, before)) = self.last {
            let gap = at.seconds_since(before);
            if !(0.0..FORGET_S).contains(&gap) {
                self.reset();
            } else if gap > COAST_S {
                self.lose();
            }
        }
        self.meet(cloud.centre);
        let found = match self.settings.method {
            Method::Paper => self.track_points(cloud, searches),
            Method::Plane => self
                .follow_planes(cloud, at)
                .or_else(|| self.find_planes(cloud, at, searches)),
        };
        let Some(found) = found else {
            self.earlier = None;
            self.previous = None;
            return None;
        };
        let found = self.keep(found, at);
        self.middle = Some(cloud.centre);
        Some(found)
    }

    /// Where the head is expected (`sensor_from_head`), and its size against the standard head, if it was followed up to now:
    /// there its points are to be gathered for [`Self::follow`]. Nothing with the paper's method.
    #[must_use]
    pub fn expected(&self, at: Timestamp) -> Option<(SensorFromHead, f32)> {
        let pose = self.predicted(at)?.inverse();
        (self.settings.method == Method::Plane).then(|| (pose, self.head_scale()))
    }

    /// As [`Self::track_with`], but only from where the head is expected. Without it there all is left as it was, so that
    /// the head can be tracked in another cloud of the same frame.
    pub fn follow(&mut self, cloud: &HeadCloud, at: Timestamp) -> Option<HeadPose> {
        let found = self.follow_planes(cloud, at)?;
        Some(self.keep(found, at))
    }

    /// Stores and smooths the result.
    fn keep(&mut self, found: HeadPose, at: Timestamp) -> HeadPose {
        self.before = (!found.proven).then(|| (self.last, self.earlier, self.filter.clone()));
        self.earlier = self.last;
        self.last = Some((found.sensor_from_head, at));
        self.unfiltered.clone_from(&self.filter);
        // What is gathered around a pose has the middle of that pose.
        self.middle = None;
        HeadPose {
            sensor_from_head: SensorFromHead::of(self.filter.smooth(*found.sensor_from_head, at)),
            ..found
        }
    }

    /// Pose predicted for `at` at constant velocity; only if the head was seen recently.
    fn predicted(&self, at: Timestamp) -> Option<HeadFromSensor> {
        let (last, last_at) = self.last?;
        let since = at.seconds_since(last_at);
        if since > COAST_S {
            return None;
        }
        let Some((earlier, earlier_at)) = self.earlier else {
            let moved = last.translation.vector + self.moved.cap_magnitude(STEP_M);
            return Some(SensorFromHead::from_parts(moved, last.rotation).inverse());
        };
        let dt = last_at.seconds_since(earlier_at);
        if dt <= 0.0 {
            return Some(last.inverse());
        }
        // The step about the head's own place, so that a turn does not swing it about the camera.
        let ratio = (since / dt).min(2.0) as f32 * 0.9;
        let turn = (last.rotation * earlier.rotation.inverse()).scaled_axis() * ratio;
        let shift = (last.translation.vector - earlier.translation.vector) * ratio;
        let sensor_from_head = SensorFromHead::from_parts(
            last.translation.vector + shift,
            crate::base::geometry::Rotation::new(turn) * last.rotation,
        );
        Some(sensor_from_head.inverse())
    }

    /// How much of the middle of the face the cloud covers, if the fit is accepted: at least `least`.
    fn accepted(&mut self, cloud: &[Point], fit: &PlaneFit, least: f32) -> Option<Coverage> {
        if fit.agreement < self.settings.min_agreement || fit.agreeing < MIN_AGREEING {
            return None;
        }
        self.covered(cloud, fit, least)
    }

    /// The head's coverage by the cloud, if enough of its middle is covered.
    fn covered(&mut self, cloud: &[Point], fit: &PlaneFit, least: f32) -> Option<Coverage> {
        let covered = plane::coverage(&self.anchor, &self.shape, cloud, fit, &mut self.hit);
        (covered.middle >= least).then_some(covered)
    }

    /// Aligns the cloud with the learned head, starting at `start`.
    fn aligned(
        &self,
        cloud: &[Point],
        start: HeadFromSensor,
        cutoffs_m: &[f32],
        stride: usize,
        scale_sigma: f64,
        beside: f32,
    ) -> Option<PlaneFit> {
        let effort = Effort {
            cutoffs_m,
            stride,
            beside,
            scale_sigma,
        };
        plane::align(&self.anchor, &self.shape, cloud, start, &effort)
    }

    /// Prior deviation of the scale in an alignment, as a logarithm.
    fn scale_sigma(&self) -> f64 {
        if self.settings.learn_shape {
            self.shape.scale_sigma()
        } else {
            0.0
        }
    }

    fn follow_planes(&mut self, head: &HeadCloud, at: Timestamp) -> Option<HeadPose> {
        let cloud = &head.points;
        let start = self.predicted(at)?;
        let near = self.aligned(cloud, start, &APPROACH_M, APPROACH_STRIDE, 0.0, 1.0)?;
        let scale_sigma = self.scale_sigma();
        let fit = self.aligned(cloud, near.head_from_sensor, &FOLLOW_M, 1, scale_sigma, 1.0)?;
        // Hair, beard and things let a head agree badly: where a face is seen, that proves it.
        let proven = fit.agreement >= self.settings.min_agreement;
        let enough = fit.agreement >= UNPROVEN * self.settings.min_agreement;
        if !enough || fit.agreeing < MIN_AGREEING {
            return None;
        }
        let coverage = self.covered(cloud, &fit, COVERED_FOLLOWED)?;
        self.finalists.clear();
        self.ends.clear();
        Some(HeadPose {
            proven,
            ..self.believed(head, fit, coverage)
        })
    }

    fn find_planes(
        &mut self,
        head: &HeadCloud,
        at: Timestamp,
        searches: &mut u32,
    ) -> Option<HeadPose> {
        let scale_sigma = self.scale_sigma();
        if !(0.0..=COAST_S).contains(&at.seconds_since(self.searched)) {
            self.finalists.clear();
            self.ends.clear();
        }
        // What the last search left goes first, if its pose was doubted and not lost: it costs little.
        if self.last.is_some() {
            self.ends.clear();
        }
        if let Some(found) = self.settle(head, scale_sigma) {
            self.searched = at;
            return Some(found);
        }
        if self.finalists.is_empty() {
            *searches = searches.checked_sub(1)?;
            self.searched = at;
            self.search(&head.points, scale_sigma);
            self.middle = Some(head.centre);
        }
        *searches = searches.checked_sub(1)?;
        self.searched = at;
        self.decide(&head.points, scale_sigma);
        (self.middle, self.moved) = (Some(head.centre), Vector::zeros());
        self.settle(head, scale_sigma)
    }

    /// The pose of an accepted fit, from which the head's shape may be learned.
    fn believed(&mut self, head: &HeadCloud, fit: PlaneFit, covered: Coverage) -> HeadPose {
        let coverage = covered.middle.min(covered.nose);
        // What the picture's edge cuts off would bend the shape.
        let teaches = fit.agreement >= TEACHING_AGREEMENT && head.whole;
        self.lesson = (self.settings.learn_shape && teaches).then_some(fit);
        self.known = fit.known;
        HeadPose {
            sensor_from_head: fit.head_from_sensor.inverse(),
            confidence: (fit.agreement * (coverage / COVERED_FOUND).min(1.0)).clamp(0.0, 1.0),
            residual: fit.residual,
            coverage,
            proven: true,
        }
    }

    /// First half of a search, giving the finalists: rounds for all starts, more for the better ones.
    fn search(&mut self, cloud: &[Point], scale_sigma: f64) {
        let mut first: Best<GO_ON> = Best::new();
        for start in start::starts(&self.anchor, cloud) {
            first.offer(self.aligned(cloud, start, &SEARCH_M, SEARCH_STRIDE, scale_sigma, 1.0));
        }
        let mut second: Best<FINALISTS> = Best::new();
        for fit in &first.0 {
            second.offer(self.aligned(
                cloud,
                fit.head_from_sensor,
                &NARROW_M,
                SEARCH_STRIDE,
                scale_sigma,
                1.0,
            ));
        }
        self.finalists = second.0.iter().map(|fit| fit.head_from_sensor).collect();
        self.moved = Vector::zeros();
    }

    /// Second half: the finalists, moved with the cloud, on all points; keeps the best distinct poses.
    fn decide(&mut self, cloud: &[Point], scale_sigma: f64) {
        let back = self.moved_back();
        let mut ends: heapless::Vec<(f32, HeadFromSensor), FINALISTS> = heapless::Vec::new();
        for start in &self.finalists {
            let start = moved_by(start, &back);
            let Some(fit) =
                self.aligned(cloud, start, &SETTLE_M, FINAL_STRIDE, scale_sigma, BESIDE)
            else {
                continue;
            };
            let covered = plane::coverage(&self.anchor, &self.shape, cloud, &fit, &mut self.hit);
            let proof = proof(&fit, &covered);
            let place = ends.iter().position(|(other, _)| proof > *other);
            // As many as finalists.
            let _ = ends.insert(place.unwrap_or(ends.len()), (proof, fit.head_from_sensor));
        }
        self.finalists.clear();
        self.ends.clear();
        for (_, end) in &ends {
            let is_new =
                |other: &HeadFromSensor| (other.inverse() * *end).rotation.angle() > APART_RAD;
            if !self.ends.is_full() && self.ends.iter().all(is_new) {
                // Room was seen to.
                let _ = self.ends.push(*end);
            }
        }
    }

    /// The best remaining result of a search, if one is accepted on all points.
    fn settle(&mut self, head: &HeadCloud, scale_sigma: f64) -> Option<HeadPose> {
        let back = self.moved_back();
        while !self.ends.is_empty() {
            let start = moved_by(&self.ends.remove(0), &back);
            let cloud = &head.points;
            let fit = self.aligned(cloud, start, &FOLLOW_M, 1, scale_sigma, BESIDE);
            let coverage = fit.and_then(|fit| self.accepted(cloud, &fit, COVERED_FOUND));
            if let (Some(fit), Some(coverage)) = (fit, coverage) {
                for end in &mut self.ends {
                    *end = moved_by(end, &back);
                }
                return Some(self.believed(head, fit, coverage));
            }
        }
        None
    }

    /// Motion from the cloud's current to its former position.
    fn moved_back(&self) -> nalgebra::Translation3<f32> {
        (-self.moved.cap_magnitude(STEP_M)).into()
    }

    fn track_points(&mut self, head: &HeadCloud, searches: &mut u32) -> Option<HeadPose> {
        let cloud = &head.points;
        let every = cloud.len().div_ceil(MOST_MOVING).max(1);
        let cloud: Vec<Point> = cloud.iter().step_by(every).copied().collect();
        let cloud = cloud.as_slice();
        let to_frame = icp::Settings {
            iterations: self.settings.rounds,
            ..icp::Settings::default()
        };
        // Where it leads is a start: a tenth of a millimetre will do.
        let roughly = icp::Settings {
            stop_m: FRAME_STOP_M,
            ..to_frame
        };
        let start = match (&self.previous, self.last) {
            (Some(previous), Some((last, _))) => {
                let step = icp::align(
                    previous,
                    cloud,
                    Rigid::identity(),
                    &roughly,
                    &mut self.scratch,
                )?;
                HeadFromSensor::of(*last.inverse() * step.target_from_moving)
            }
            _ => {
                *searches = searches.checked_sub(1)?;
                self.search_points(cloud)?
            }
        };
        let to_anchor = icp::Settings {
            keep: KEPT,
            ..to_frame
        };
        let standard = self.standard.as_ref().unwrap_or(&self.anchor.target);
        let found = icp::align(standard, cloud, *start, &to_anchor, &mut self.scratch)
            .filter(|found| found.paired >= MIN_PAIRED && found.residual < 0.008)?;
        self.previous = icp::Target::new(cloud);
        let teaches = self.settings.learn_shape && head.whole;
        self.lesson = teaches.then_some(PlaneFit {
            head_from_sensor: HeadFromSensor::of(found.target_from_moving),
            scale: self.head_scale(),
            agreement: found.paired,
            support: found.paired,
            residual: found.residual,
            agreeing: 0,
            known: SMatrix::zeros(),
        });
        Some(HeadPose {
            sensor_from_head: HeadFromSensor::of(found.target_from_moving).inverse(),
            confidence: found.paired,
            residual: found.residual,
            coverage: 1.0,
            proven: true,
        })
    }

    /// The first frame of the paper's method: a few iterations from each start, then the best.
    fn search_points(&mut self, cloud: &[Point]) -> Option<HeadFromSensor> {
        let thin: Vec<Point> = cloud.iter().step_by(SEARCH_STRIDE).copied().collect();
        let brief = icp::Settings {
            iterations: 15,
            keep: 0.7,
            max_distance_m: 0.05,
            ..icp::Settings::default()
        };
        let mut best: Option<icp::Alignment> = None;
        for start in start::starts(&self.anchor, cloud) {
            let end = icp::align(
                &self.anchor.target,
                &thin,
                *start,
                &brief,
                &mut self.scratch,
            );
            if let Some(end) = end
                && best.is_none_or(|best| end.residual < best.residual)
            {
                best = Some(end);
            }
        }
        best.map(|best| HeadFromSensor::of(best.target_from_moving))
    }
}

/// A pose of a cloud that has since moved: `back` leads from its current to its former position, in the sensor frame.
fn moved_by(
    head_from_sensor: &HeadFromSensor,
    back: &nalgebra::Translation3<f32>,
) -> HeadFromSensor {
    HeadFromSensor::of(**head_from_sensor * back)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::geometry::rotation_from_yaw_pitch_roll;
    use anchor::tests::half_egg;

    fn cloud(sensor_from_head: &Rigid, noise: f32, seed: u64) -> HeadCloud {
        let mut rng = fastrand::Rng::with_seed(seed);
        let mut cloud = HeadCloud::default();
        for (p, n) in half_egg() {
            let q = sensor_from_head * p;
            if (sensor_from_head.rotation * n).dot(&q.coords.normalize()) < -0.2 {
                let along = q.coords.normalize() * (rng.f32() - 0.5) * noise;
                let _ = cloud.points.push(q + along);
            }
        }
        cloud
    }

    fn placed(yaw: f32, pitch: f32, roll: f32) -> Rigid {
        Rigid::from_parts(
            Vector::new(0.03, -0.02, 0.75).into(),
            rotation_from_yaw_pitch_roll(yaw.to_radians(), pitch.to_radians(), roll.to_radians()),
        )
    }

    #[test]
    fn the_first_frame_is_found_over_the_whole_range() {
        let settings = Settings {
            learn_shape: false,
            ..Settings::default()
        };
        let mut tracker = PoseTracker::new(settings, &half_egg()).unwrap();
        for yaw in [-45.0, -20.0, 0.0, 30.0, 45.0] {
            for pitch in [-30.0, 0.0, 25.0] {
                let truth = placed(yaw, pitch, 5.0);
                tracker.reset();
                let found = tracker.track(&cloud(&truth, 0.002, 1), Timestamp::from_us(0));
                let found = found.unwrap_or_else(|| panic!("lost at {yaw} {pitch}"));
                let error = found
                    .sensor_from_head
                    .rotation
                    .angle_to(&truth.rotation)
                    .to_degrees();
                assert!(error < 0.7, "at yaw {yaw} pitch {pitch}: {error} deg");
            }
        }
    }

    /// Mean error in degrees, the last second's mean offset out, of the paper's method on a head that is wider than the
    /// standard one and turns from side to side.
    fn wide_head_error(learn_shape: bool) -> f32 {
        let settings = Settings {
            method: Method::Paper,
            smoothing: Smoothing::Off,
            learn_shape,
            ..Settings::default()
        };
        let mut tracker = PoseTracker::new(settings, &half_egg()).unwrap();
        let mut off = Vec::new();
        for k in 0..150 {
            let yaw = 25.0 * (k as f32 * 0.1).sin();
            let truth = placed(yaw, 0.0, 0.0);
            let mut seen = HeadCloud::default();
            for (p, n) in half_egg() {
                let q = truth * Point::new(1.12 * p.x, p.y, p.z);
                if (truth.rotation * n).dot(&q.coords.normalize()) < -0.2 {
                    let _ = seen.points.push(q);
                }
            }
            seen.whole = true;
            let at = Timestamp::from_us(k * 33_333);
            let found = tracker.track(&seen, at).expect("a head");
            let found = found.sensor_from_head.rotation;
            off.push((truth.rotation.inverse() * found).scaled_axis());
        }
        let last = &off[60..];
        let mean = last.iter().sum::<Vector>() / last.len() as f32;
        let error = last.iter().map(|off| (off - mean).norm()).sum::<f32>();
        (error / last.len() as f32).to_degrees()
    }

    #[test]
    fn the_papers_method_learns_the_head_that_it_follows() {
        let [without, with] = [false, true].map(wide_head_error);
        println!("{without:.2} deg on the standard head, {with:.2} on the one learnt");
        assert!(with < 0.75 * without, "{with} {without}");
    }

    #[test]
    fn a_followed_head_that_agrees_badly_is_unproven_and_one_that_agrees_worse_is_lost() {
        let settings = Settings {
            learn_shape: false,
            ..Settings::default()
        };
        let here = placed(5.0, 0.0, 0.0);
        let smooth = cloud(&here, 0.0, 1);
        let mut tracker = PoseTracker::new(settings, &half_egg()).unwrap();
        assert!(tracker.track(&smooth, Timestamp::default()).is_some());
        let at = |frame: u64| Timestamp::from_us(frame * 33_333);
        let mut seen = [0; 3];
        for k in 1..40u64 {
            let before = tracker.follow(&smooth, at(2 * k));
            assert!(before.is_some_and(|pose| pose.proven));
            // Up to so far before and behind the surface, along the line of sight.
            let rough = cloud(&here, 0.001 * k as f32, 2);
            match tracker.follow(&rough, at(2 * k + 1)) {
                Some(pose) => {
                    // The whole egg is seen: the confidence is the agreement.
                    assert_eq!(pose.proven, pose.confidence >= settings.min_agreement);
                    assert!(pose.confidence >= 0.7 * settings.min_agreement);
                    seen[usize::from(!pose.proven)] += 1;
                }
                None => seen[2] += 1,
            }
        }
        assert!(seen.iter().all(|&count| count > 0), "{seen:?}");
    }

    #[test]
    fn a_correction_is_followed_at_once() {
        let settings = Settings {
            learn_shape: false,
            ..Settings::default()
        };
        let turn = placed(4.0, 0.0, 0.0).rotation;
        let before = placed(5.0, 0.0, 0.0);
        let after = Rigid::from_parts(before.translation, before.rotation * turn);
        let lag = |corrected: bool| {
            let mut tracker = PoseTracker::new(settings, &half_egg()).unwrap();
            let at = |k: u64| Timestamp::from_us(k * 33_333);
            for k in 0..30 {
                tracker
                    .track(&cloud(&before, 0.0, 1), at(k))
                    .expect("a head");
            }
            if corrected {
                tracker.correct(&HeadFromFace::of(Rigid::from_parts(
                    Vector::zeros().into(),
                    turn,
                )));
            }
            let pose = tracker.track(&cloud(&after, 0.0, 1), at(30));
            let found = pose.expect("a head").sensor_from_head.rotation;
            found.angle_to(&after.rotation).to_degrees()
        };
        let [corrected, smoothed] = [true, false].map(lag);
        assert!(corrected < 0.5 * smoothed, "{corrected} {smoothed}");
    }

    #[test]
    fn a_search_may_take_two_frames() {
        let mut tracker = PoseTracker::new(Settings::default(), &half_egg()).unwrap();
        let at = |k: u64| Timestamp::from_us(k * 33_333);
        let first = tracker.track_with(&cloud(&placed(28.0, -10.0, 0.0), 0.002, 1), at(0), &mut 1);
        assert!(first.is_none() && tracker.is_searching());
        let truth = placed(32.0, -8.0, 0.0);
        let found = tracker.track_with(&cloud(&truth, 0.002, 2), at(1), &mut 1);
        let found = found.expect("the second half").sensor_from_head.rotation;
        assert!(!tracker.is_searching());
        let error = found.angle_to(&truth.rotation).to_degrees();
        assert!(error < 1.5, "{error}");
        // What was begun long ago is begun again.
        tracker.reset();
        assert!(
            tracker
                .track_with(&cloud(&truth, 0.002, 3), at(2), &mut 1)
                .is_none()
        );
        assert!(
            tracker
                .track_with(&cloud(&truth, 0.002, 4), at(20), &mut 1)
                .is_none()
        );
        assert!(tracker.is_searching());
    }

    #[test]
    fn a_wall_and_nothing_are_refused() {
        let mut tracker = PoseTracker::new(Settings::default(), &half_egg()).unwrap();
        let mut wall = HeadCloud::default();
        for i in 0..40 {
            for j in 0..40 {
                let _ = wall.points.push(Point::new(
                    i as f32 * 0.006 - 0.12,
                    j as f32 * 0.006 - 0.12,
                    0.8,
                ));
            }
        }
        for (k, cloud) in [&wall, &HeadCloud::default()].into_iter().enumerate() {
            let at = Timestamp::from_us(k as u64 * 33_333);
            assert!(tracker.track(cloud, at).is_none(), "cloud {k}");
        }
    }

    #[test]
    fn loss_is_noticed_and_mended() {
        let mut tracker = PoseTracker::new(Settings::default(), &half_egg()).unwrap();
        let frame = |k: u64| Timestamp::from_us(k * 33_333);
        for k in 0..10 {
            assert!(
                tracker
                    .track(&cloud(&placed(0.0, 0.0, 0.0), 0.002, k), frame(k))
                    .is_some()
            );
        }
        assert!(tracker.track(&HeadCloud::default(), frame(10)).is_none());
        // Back, and turned meanwhile.
        let truth = placed(40.0, 15.0, 0.0);
        let found = tracker
            .track(&cloud(&truth, 0.002, 99), frame(14))
            .expect("found again");
        let error = found
            .sensor_from_head
            .rotation
            .angle_to(&truth.rotation)
            .to_degrees();
        assert!(error < 3.0, "{error}");
    }

    #[test]
    fn no_standard_head_is_an_error_that_says_so() {
        let error = PoseTracker::new(Settings::default(), &[]).err().unwrap();
        assert!(error.to_string().contains("found 0 points"));
    }

    #[test]
    fn a_head_is_expected_where_its_speed_takes_it() {
        let mut tracker = PoseTracker::new(Settings::default(), &half_egg()).unwrap();
        let at = |ms: u64| Timestamp::from_us(1_000_000 + ms * 1000);
        let pose = |x: f32, yaw: f32| {
            let turn = rotation_from_yaw_pitch_roll(yaw, 0.0, 0.0);
            SensorFromHead::from_parts(Vector::new(x, 0.0, 0.8), turn)
        };
        assert!(tracker.predicted(at(0)).is_none());
        tracker.last = Some((pose(0.01, 0.1), at(40)));
        let expected = tracker.predicted(at(60)).unwrap();
        assert!((expected * pose(0.01, 0.1)).translation.vector.norm() < 1e-6);
        // 0.01 m and 0.1 rad in 40 ms; nine tenths of that speed is believed, for twice the time at most.
        tracker.earlier = Some((pose(0.0, 0.0), at(0)));
        for (ms, steps) in [(60, 0.45), (80, 0.9), (120, 1.8), (200, 1.8)] {
            let apart =
                tracker.predicted(at(ms)).unwrap() * pose(0.01 + 0.01 * steps, 0.1 + 0.1 * steps);
            assert!(apart.translation.vector.norm() < 1e-5, "{ms}");
            assert!(apart.rotation.angle() < 1e-3, "{ms}");
        }
        // After a fifth of a second nothing is; time that stood still tells no speed.
        assert!(tracker.predicted(at(241)).is_none());
        tracker.earlier = Some((pose(0.5, 0.9), at(40)));
        let expected = tracker.predicted(at(60)).unwrap();
        assert!((expected * pose(0.01, 0.1)).translation.vector.norm() < 1e-6);
    }

    #[test]
    fn a_pose_is_as_sure_as_its_agreement_and_its_coverage() {
        let settings = Settings::default();
        let mut tracker = PoseTracker::new(settings, &half_egg()).unwrap();
        let head = cloud(&placed(0.0, 0.0, 0.0), 0.0, 1);
        let fit = |agreement: f32, agreeing: u32| PlaneFit {
            head_from_sensor: SensorFromHead::of(placed(0.0, 0.0, 0.0)).inverse(),
            scale: 1.0,
            agreement,
            support: 1.0,
            residual: 0.0,
            agreeing,
            known: SMatrix::zeros(),
        };
        assert!(
            tracker
                .accepted(&head.points, &fit(0.46, 120), 0.6)
                .is_some()
        );
        assert!(
            tracker
                .accepted(&head.points, &fit(0.44, 120), 0.6)
                .is_none()
        );
        assert!(
            tracker
                .accepted(&head.points, &fit(0.46, 119), 0.6)
                .is_none()
        );
        assert!(tracker.accepted(&[], &fit(0.9, 500), 0.6).is_none());
        // The least is enough.
        let least = tracker.settings.min_agreement;
        assert!(
            tracker
                .accepted(&head.points, &fit(least, 120), 0.6)
                .is_some()
        );
        let covered = |middle: f32, nose: f32| Coverage { middle, nose };
        let mut whole = head;
        whole.whole = true;
        for (agreement, middle, nose, confidence, teaches) in [
            (0.8, 0.9, 0.7, 0.8, true),
            (0.8, 0.9, 0.3, 0.4, true),
            (0.8, 0.3, 0.9, 0.4, true),
            (0.6, 0.9, 0.9, 0.6, true),
            (0.59, 0.9, 0.9, 0.59, false),
        ] {
            let pose = tracker.believed(&whole, fit(agreement, 500), covered(middle, nose));
            assert!((pose.confidence - confidence).abs() < 1e-6);
            assert_eq!(pose.coverage, middle.min(nose));
            assert_eq!(tracker.lesson.is_some(), teaches);
        }
        whole.whole = false;
        tracker.believed(&whole, fit(0.9, 500), covered(0.9, 0.9));
        assert!(tracker.lesson.is_none(), "cut off at the side");
    }

    #[test]
    fn the_first_sixty_frames_teach_one_by_one_then_every_third() {
        let mut tracker = PoseTracker::new(Settings::default(), &half_egg()).unwrap();
        let head = cloud(&placed(0.0, 0.0, 0.0), 0.0, 1);
        let mut taught = Vec::new();
        for frame in 1..=70 {
            // Larger each time, so that a lesson moves the scale.
            tracker.lesson = Some(PlaneFit {
                head_from_sensor: SensorFromHead::of(placed(0.0, 0.0, 0.0)).inverse(),
                scale: 1.0 + 0.001 * frame as f32,
                agreement: 0.8,
                support: 1.0,
                residual: 0.0,
                agreeing: 500,
                known: SMatrix::zeros(),
            });
            let before = tracker.head_scale();
            tracker.learn(&head);
            if tracker.head_scale() != before {
                taught.push(frame);
            }
            // Nothing is learned twice.
            let after = tracker.head_scale();
            tracker.learn(&head);
            assert_eq!(tracker.head_scale(), after);
        }
        let expected: Vec<i32> = (1..=60).chain([63, 66, 69]).collect();
        assert_eq!(taught, expected);
    }

    #[test]
    fn the_best_ends_are_kept_best_first_and_of_equals_the_first() {
        let fit = |support: f32, name: f32| PlaneFit {
            head_from_sensor: HeadFromSensor::identity(),
            scale: 1.0,
            agreement: name,
            support,
            residual: 0.0,
            agreeing: 0,
            known: nalgebra::SMatrix::zeros(),
        };
        let mut best = Best::<3>::new();
        best.offer(None);
        for (support, name) in [(0.5, 1.0), (0.7, 2.0), (0.5, 3.0), (0.7, 4.0), (0.2, 5.0)] {
            best.offer(Some(fit(support, name)));
        }
        let kept: Vec<f32> = best.0.iter().map(|fit| fit.agreement).collect();
        assert_eq!(kept, [2.0, 4.0, 1.0]);
    }

    #[test]
    fn a_followed_head_that_agrees_just_enough_is_proven() {
        let here = placed(5.0, 0.0, 0.0);
        let (smooth, rough) = (cloud(&here, 0.0, 1), cloud(&here, 0.012, 2));
        let mut tracker = PoseTracker::new(Settings::default(), &half_egg()).unwrap();
        let mut followed = |min_agreement: f32| {
            tracker.settings = Settings {
                learn_shape: false,
                min_agreement,
                ..Settings::default()
            };
            tracker.reset();
            tracker
                .track(&smooth, Timestamp::default())
                .expect("a head");
            let pose = tracker.follow(&rough, Timestamp::from_us(33_333));
            let pose = pose.expect("a head");
            (pose.confidence, pose.proven)
        };
        // The whole egg is seen: the confidence is the agreement.
        let (agreement, _) = followed(0.45);
        assert_eq!(followed(agreement), (agreement, true));
        assert_eq!(followed(agreement.next_up()), (agreement, false));
    }

    #[test]
    fn a_hundred_and_twenty_live_points_that_agree_are_enough_to_follow() {
        let here = placed(0.0, 0.0, 0.0);
        let mut tracker = PoseTracker::new(Settings::default(), &half_egg()).unwrap();
        let whole = cloud(&here, 0.0, 1);
        tracker.track(&whole, Timestamp::default()).expect("a head");
        // Well within the bare face and seen from before: there every point agrees.
        let face: Vec<Point> = half_egg()
            .iter()
            .filter(|(p, n)| {
                p.x.abs() < 0.05 && (-0.045..0.05).contains(&p.y) && p.z < 0.03 && n.z < -0.4
            })
            .map(|(p, _)| here * p)
            .collect();
        let mut follows = |count: usize| {
            let mut few = HeadCloud::default();
            for k in 0..count {
                few.points.push(face[k * face.len() / count]).unwrap();
            }
            let pose = tracker.follow(&few, Timestamp::from_us(33_333));
            pose.is_some_and(|pose| pose.confidence > 0.9)
        };
        assert!(!follows(119) && follows(120));
    }
}
