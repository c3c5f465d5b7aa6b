//! The default method: point-to-plane against the learned head ([`plane`]), from a constant-velocity prediction, or by a
//! search among several starts ([`start`]), half of it a frame.

use alloc::sync::Arc;

use super::anchor::Anchor;
use super::plane::{self, Coverage, Effort, PlaneFit};
use super::settings::{HeadPose, Settings};
use super::shape::HeadShape;
use super::start;
use super::trail::{COAST_S, Found, STEP_M, Tracker, Trail};
use crate::base::frames::{HeadFromSensor, SensorFromHead};
use crate::base::geometry::{Point, Vector};
use crate::base::prelude::*;
use crate::base::time::Timestamp;
use crate::segment::HeadCloud;

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
/// Share of the least agreement down to which a tracked head may be confirmed by its face instead.
const UNPROVEN: f32 = 0.7;
/// Least share of the middle of the face that the cloud must cover: of a tracked head, which a hand may half cover,
const COVERED_FOLLOWED: f32 = 0.45;
/// and of a newly found one.
const COVERED_FOUND: f32 = 0.60;
/// Least number of agreeing live points.
const MIN_AGREEING: u32 = 120;
/// A frame teaches the shape from this agreement on.
const TEACHING_AGREEMENT: f32 = 0.6;

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

/// Tracks one head by planes.
pub(super) struct PlaneTracker {
    anchor: Arc<Anchor>,
    shape: HeadShape,
    /// Below this agreement (0…1) the head counts as lost.
    min_agreement: f32,
    /// Whether size and shape are learned.
    learns: bool,
    /// Centre of the cloud of the last pose or of a half-finished search, and its motion since.
    middle: Option<Point>,
    moved: Vector,
    /// Anchor points covered by a cloud.
    hit: Vec<bool>,
    /// State of a half-finished search, and its time.
    finalists: heapless::Vec<HeadFromSensor, FINALISTS>,
    /// Remaining results of a finished search, best first, in case the first one shows no face.
    ends: heapless::Vec<HeadFromSensor, ENDS>,
    searched: Timestamp,
    /// The last frame's fit, until the shape has learned from it.
    pending: Option<PlaneFit>,
}

impl Tracker for PlaneTracker {
    fn shape(&self) -> &HeadShape {
        &self.shape
    }

    fn is_searching(&self) -> bool {
        !self.finalists.is_empty() || !self.ends.is_empty()
    }

    fn expected(
        &mut self,
        trail: &Trail,
        at: Timestamp,
        middle: Option<Point>,
    ) -> Option<SensorFromHead> {
        if let Some(middle) = middle {
            self.measure_motion(middle);
        }
        Some(trail.predicted(at, &self.moved)?.inverse())
    }

    fn follow(&mut self, head: &HeadCloud, trail: &Trail, at: Timestamp) -> Option<Found> {
        let cloud = &head.points;
        let start = trail.predicted(at, &self.moved)?;
        let near = self.aligned(cloud, start, &APPROACH_M, APPROACH_STRIDE, 0.0, 1.0)?;
        let scale_sigma = self.scale_sigma();
        let fit = self.aligned(cloud, near.head_from_sensor, &FOLLOW_M, 1, scale_sigma, 1.0)?;
        // Hair, beard and things let a head agree badly: where a face is seen, that proves it.
        let proven = fit.agreement >= self.min_agreement;
        let enough = fit.agreement >= UNPROVEN * self.min_agreement;
        if !enough || fit.agreeing < MIN_AGREEING {
            return None;
        }
        let coverage = self.covered(cloud, &fit, COVERED_FOLLOWED)?;
        self.clear_search();
        // What is gathered around a pose has the middle of that pose.
        self.middle = None;
        let (pose, known) = self.believed(head, fit, coverage);
        Some((HeadPose { proven, ..pose }, known))
    }

    fn find(
        &mut self,
        head: &HeadCloud,
        trail: &Trail,
        at: Timestamp,
        searches: &mut u32,
    ) -> Option<Found> {
        self.pending = None;
        self.measure_motion(head.centre);
        let found = self
            .follow(head, trail, at)
            .or_else(|| self.search(head, trail, at, searches))?;
        self.middle = Some(head.centre);
        Some(found)
    }

    fn learn(&mut self, cloud: &HeadCloud) {
        let Some(fit) = self.pending.take() else {
            return;
        };
        if self.shape.takes_frame() {
            let (pose, scale) = (&fit.head_from_sensor, fit.scale);
            self.shape
                .learn(&self.anchor, &cloud.points, pose, Some(scale));
        }
    }

    fn restart(&mut self) {
        self.clear_search();
        (self.middle, self.moved) = (None, Vector::zeros());
    }

    fn forget(&mut self) {
        self.restart();
        self.pending = None;
        self.shape.forget();
    }
}

impl PlaneTracker {
    pub(super) fn new(settings: &Settings, anchor: Arc<Anchor>) -> Self {
        Self {
            shape: HeadShape::standard(anchor.points.len()),
            hit: vec![false; anchor.points.len()],
            anchor,
            min_agreement: settings.min_agreement,
            learns: settings.learn_shape,
            middle: None,
            moved: Vector::zeros(),
            finalists: heapless::Vec::new(),
            ends: heapless::Vec::new(),
            searched: Timestamp::default(),
            pending: None,
        }
    }

    fn clear_search(&mut self) {
        self.finalists.clear();
        self.ends.clear();
    }

    /// How far the head's cut-out has moved, whose centre is now `middle`: until the head has a speed, that of a person walking
    /// in at 40 mm a frame is predicted from it.
    fn measure_motion(&mut self, middle: Point) {
        let moved = self.middle.map(|before| middle - before);
        self.moved = moved.unwrap_or_default();
    }

    /// How much of the middle of the face the cloud covers, if the fit is accepted: at least `least`.
    fn accepted(&mut self, cloud: &[Point], fit: &PlaneFit, least: f32) -> Option<Coverage> {
        if fit.agreement < self.min_agreement || fit.agreeing < MIN_AGREEING {
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
        if self.learns {
            self.shape.scale_sigma()
        } else {
            0.0
        }
    }

    /// By a search, half of it or both as `searches` are left.
    fn search(
        &mut self,
        head: &HeadCloud,
        trail: &Trail,
        at: Timestamp,
        searches: &mut u32,
    ) -> Option<Found> {
        let scale_sigma = self.scale_sigma();
        if !(0.0..=COAST_S).contains(&at.seconds_since(self.searched)) {
            self.clear_search();
        }
        // What the last search left goes first, if its pose was doubted and not lost: it costs little.
        if trail.last.is_some() {
            self.ends.clear();
        }
        if let Some(found) = self.settle(head, scale_sigma) {
            self.searched = at;
            return Some(found);
        }
        if self.finalists.is_empty() {
            *searches = searches.checked_sub(1)?;
            self.searched = at;
            self.begin(&head.points, scale_sigma);
            self.middle = Some(head.centre);
        }
        *searches = searches.checked_sub(1)?;
        self.searched = at;
        self.decide(&head.points, scale_sigma);
        (self.middle, self.moved) = (Some(head.centre), Vector::zeros());
        self.settle(head, scale_sigma)
    }

    /// The pose of an accepted fit, from which the head's shape may be learned.
    fn believed(&mut self, head: &HeadCloud, fit: PlaneFit, covered: Coverage) -> Found {
        let coverage = covered.middle.min(covered.nose);
        // What the picture's edge cuts off would bend the shape; a beard teaches its own.
        let agreement = fit.agreement.max(fit.agreement_above_beard);
        let teaches = agreement >= TEACHING_AGREEMENT && head.whole;
        self.pending = (self.learns && teaches).then_some(fit);
        let pose = HeadPose {
            sensor_from_head: fit.head_from_sensor.inverse(),
            confidence: (fit.agreement * (coverage / COVERED_FOUND).min(1.0)).clamp(0.0, 1.0),
            coverage,
            proven: true,
        };
        (pose, fit.known)
    }

    /// First half of a search, giving the finalists: rounds for all starts, more for the better ones.
    fn begin(&mut self, cloud: &[Point], scale_sigma: f64) {
        let mut first: Best<GO_ON> = Best::new();
        for start in start::starts(&self.anchor, cloud) {
            first.offer(self.aligned(cloud, start, &SEARCH_M, SEARCH_STRIDE, scale_sigma, 1.0));
        }
        let mut second: Best<FINALISTS> = Best::new();
        for fit in &first.0 {
            let start = fit.head_from_sensor;
            second.offer(self.aligned(cloud, start, &NARROW_M, SEARCH_STRIDE, scale_sigma, 1.0));
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
        self.clear_search();
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
    fn settle(&mut self, head: &HeadCloud, scale_sigma: f64) -> Option<Found> {
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
    use nalgebra::SMatrix;

    use super::*;
    use crate::pose::anchor::tests::half_egg;
    use crate::pose::tests::{cloud, placed};

    fn tracker() -> PlaneTracker {
        let anchor = Anchor::new(&half_egg()).unwrap();
        PlaneTracker::new(&Settings::default(), Arc::new(anchor))
    }

    #[test]
    fn a_pose_is_as_sure_as_its_agreement_and_its_coverage() {
        let mut tracker = tracker();
        let head = cloud(&placed(0.0, 0.0, 0.0), 0.0, 1);
        let fit = |agreement: f32, agreeing: u32| PlaneFit {
            head_from_sensor: SensorFromHead::of(placed(0.0, 0.0, 0.0)).inverse(),
            scale: 1.0,
            agreement,
            agreement_above_beard: 0.0,
            support: 1.0,
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
        let least = tracker.min_agreement;
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
            let (pose, _) = tracker.believed(&whole, fit(agreement, 500), covered(middle, nose));
            assert!((pose.confidence - confidence).abs() < 1e-6);
            assert_eq!(pose.coverage, middle.min(nose));
            assert_eq!(tracker.pending.is_some(), teaches);
        }
        let bearded = PlaneFit {
            agreement_above_beard: 0.6,
            ..fit(0.4, 500)
        };
        let (pose, _) = tracker.believed(&whole, bearded, covered(0.9, 0.9));
        assert!((pose.confidence - 0.4).abs() < 1e-6 && tracker.pending.is_some());
        whole.whole = false;
        tracker.believed(&whole, fit(0.9, 500), covered(0.9, 0.9));
        assert!(tracker.pending.is_none(), "cut off at the side");
    }

    #[test]
    fn the_first_sixty_frames_teach_one_by_one_then_every_third() {
        let mut tracker = tracker();
        let head = cloud(&placed(0.0, 0.0, 0.0), 0.0, 1);
        let mut taught = Vec::new();
        for frame in 1..=70 {
            // Larger each time, so that a lesson moves the scale.
            tracker.pending = Some(PlaneFit {
                head_from_sensor: SensorFromHead::of(placed(0.0, 0.0, 0.0)).inverse(),
                scale: 1.0 + 0.001 * frame as f32,
                agreement: 0.8,
                agreement_above_beard: 0.8,
                support: 1.0,
                agreeing: 500,
                known: SMatrix::zeros(),
            });
            let before = tracker.shape.log_scale;
            tracker.learn(&head);
            if tracker.shape.log_scale != before {
                taught.push(frame);
            }
            // Nothing is learned twice.
            let after = tracker.shape.log_scale;
            tracker.learn(&head);
            assert_eq!(tracker.shape.log_scale, after);
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
            agreement_above_beard: name,
            support,
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
}
