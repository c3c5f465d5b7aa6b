//! The default method: point-to-plane against the learned head ([`plane`]), from a constant-velocity prediction, or by a
//! search among several starts ([`start`]), half of it a frame.

use alloc::sync::Arc;

use super::anchor::Anchor;
use super::plane::{self, AlignOptions, Coverage, PlaneFit};
use super::settings::{HeadPose, Settings};
use super::shape::HeadShape;
use super::start;
use super::trail::{Found, STEP_M, Tracker, Trail};
use crate::base::frames::{HeadFromSensor, SensorFromHead};
use crate::base::geometry::{Point, Vector};
use crate::base::prelude::*;
use crate::base::time::Timestamp;
use crate::segment::HeadCloud;

/// Cut-offs of the coarse search, metres: wide enough for a start 20° off.
const SEARCH_CUTOFFS_M: [f32; 4] = [0.035, 0.035, 0.03, 0.025];
/// Cut-offs of the second round of the search, metres.
const NARROW_CUTOFFS_M: [f32; 5] = [0.025, 0.02, 0.015, 0.012, 0.010];
/// Cut-offs of the finalists, metres.
const FINAL_CUTOFFS_M: [f32; 8] = [0.025, 0.020, 0.015, 0.012, 0.010, 0.008, 0.008, 0.008];
/// Cut-offs of a tracked frame on subsampled points, metres.
const APPROACH_CUTOFFS_M: [f32; 2] = [0.020, 0.012];
/// Cut-offs of a tracked frame on all points, metres.
const FOLLOW_CUTOFFS_M: [f32; 3] = [0.008, 0.006, 0.006];
/// Stride over the points in both rounds of the search.
const SEARCH_STRIDE: usize = 5;
/// Stride over the points for finalists.
const FINAL_STRIDE: usize = 2;
/// Stride over the points with [`APPROACH_CUTOFFS_M`].
const APPROACH_STRIDE: usize = 4;
/// Weight of points outside the bare face for finalists: a fringe or hair beside the face biases the pose.
const HAIR_WEIGHT: f32 = 0.5;
/// Starts kept after the coarse search.
const KEPT_COARSE: usize = 12;
/// Finalists kept after the second round.
const FINALISTS: usize = 6;
/// Most results of a search kept as candidates, of which the landmarks select one.
const CANDIDATES: usize = 3;
/// Least rotation between candidates, radians.
const DISTINCT_RAD: f32 = 0.17;
/// Share of the least agreement above which a tracked head may still be confirmed by its face.
const UNPROVEN_SHARE: f32 = 0.7;
/// Least coverage of the middle of the face for a tracked head, which a hand may half cover.
const MIN_COVERAGE_TRACKED: f32 = 0.45;
/// Least coverage of the middle of the face for a newly found head.
const MIN_COVERAGE_FOUND: f32 = 0.60;
/// Least number of agreeing live points.
const MIN_AGREEING: u32 = 120;
/// Least agreement of a frame that the shape is learned from.
const LEARNING_AGREEMENT: f32 = 0.6;

/// Score of a search result: agreement of the bare face, size of its visible part, and coverage of the middle. Hair and collar do
/// not count, because they agree with the sides of a head in many poses.
fn score(fit: &PlaneFit, covered: &Coverage) -> f32 {
    fit.agreement * (fit.agreeing as f32).sqrt() * covered.middle
}

/// The best `N` results of a round of the search, best first. Ranked by the support of the whole cloud, because the subsampled
/// bare face has too few points.
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

/// Tracks one head by point-to-plane alignment.
pub(super) struct PlaneTracker {
    anchor: Arc<Anchor>,
    shape: HeadShape,
    /// Least agreement of a head, 0…1.
    min_agreement: f32,
    /// Whether size and shape are learned.
    learns: bool,
    /// Centre of the cloud of the last pose or of a half-finished search, sensor frame, metres.
    last_centre: Option<Point>,
    /// Motion of the cloud's centre since, metres.
    cloud_shift: Vector,
    /// Anchor points covered by a cloud.
    hit: Vec<bool>,
    /// Poses of a half-finished search.
    finalists: heapless::Vec<HeadFromSensor, FINALISTS>,
    /// Remaining results of a finished search, best first, in case the first shows no face.
    candidates: heapless::Vec<HeadFromSensor, CANDIDATES>,
    /// Time of the last part of a search.
    searched: Timestamp,
    /// The last frame's fit, until the shape has learned from it.
    pending: Option<PlaneFit>,
}

impl Tracker for PlaneTracker {
    fn shape(&self) -> &HeadShape {
        &self.shape
    }

    fn is_searching(&self) -> bool {
        !self.finalists.is_empty() || !self.candidates.is_empty()
    }

    fn expected(
        &mut self,
        trail: &Trail,
        at: Timestamp,
        middle: Option<Point>,
    ) -> Option<SensorFromHead> {
        if let Some(middle) = middle {
            self.measure_cloud_shift(middle);
        }
        Some(trail.predicted(at, &self.cloud_shift)?.inverse())
    }

    fn follow(&mut self, head: &HeadCloud, trail: &Trail, at: Timestamp) -> Option<Found> {
        let cloud = &head.points;
        let start = trail.predicted(at, &self.cloud_shift)?;
        let near = self.align(cloud, start, &APPROACH_CUTOFFS_M, APPROACH_STRIDE, 0.0, 1.0)?;
        let scale_sigma = self.scale_sigma();
        let fit = self.align(
            cloud,
            near.head_from_sensor,
            &FOLLOW_CUTOFFS_M,
            1,
            scale_sigma,
            1.0,
        )?;
        // Hair, a beard or objects lower the agreement of a true head, which its face then confirms.
        let proven = fit.agreement >= self.min_agreement;
        let enough = fit.agreement >= UNPROVEN_SHARE * self.min_agreement;
        if !enough || fit.agreeing < MIN_AGREEING {
            return None;
        }
        let coverage = self.sufficient_coverage(cloud, &fit, MIN_COVERAGE_TRACKED)?;
        self.clear_search();
        // A cloud gathered around a pose is centred by that pose.
        self.last_centre = None;
        let (pose, information) = self.report(head, fit, coverage);
        Some((HeadPose { proven, ..pose }, information))
    }

    fn find(
        &mut self,
        head: &HeadCloud,
        trail: &Trail,
        at: Timestamp,
        searches: &mut u32,
    ) -> Option<Found> {
        self.pending = None;
        self.measure_cloud_shift(head.centre);
        let found = self
            .follow(head, trail, at)
            .or_else(|| self.search(head, trail, at, searches))?;
        self.last_centre = Some(head.centre);
        Some(found)
    }

    fn learn(&mut self, cloud: &HeadCloud) {
        let Some(fit) = self.pending.take() else {
            return;
        };
        if self.shape.counts_frame() {
            let (pose, scale) = (&fit.head_from_sensor, fit.scale);
            self.shape
                .learn(&self.anchor, &cloud.points, pose, Some(scale));
        }
    }

    fn restart(&mut self) {
        self.clear_search();
        (self.last_centre, self.cloud_shift) = (None, Vector::zeros());
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
            last_centre: None,
            cloud_shift: Vector::zeros(),
            finalists: heapless::Vec::new(),
            candidates: heapless::Vec::new(),
            searched: Timestamp::default(),
            pending: None,
        }
    }

    fn clear_search(&mut self) {
        self.finalists.clear();
        self.candidates.clear();
    }

    /// Measures the motion of the segmented cloud, now centred at `middle`: predicts the pose until the head has a speed, as for a
    /// person walking in at 40 mm a frame.
    fn measure_cloud_shift(&mut self, middle: Point) {
        let moved = self.last_centre.map(|before| middle - before);
        self.cloud_shift = moved.unwrap_or_default();
    }

    /// Coverage of the face by the cloud, if agreement, number of points and coverage (at least `least`) suffice.
    fn accepted(&mut self, cloud: &[Point], fit: &PlaneFit, least: f32) -> Option<Coverage> {
        if fit.agreement < self.min_agreement || fit.agreeing < MIN_AGREEING {
            return None;
        }
        self.sufficient_coverage(cloud, fit, least)
    }

    /// Coverage of the face by the cloud, if the middle's is at least `least`.
    fn sufficient_coverage(
        &mut self,
        cloud: &[Point],
        fit: &PlaneFit,
        least: f32,
    ) -> Option<Coverage> {
        let covered = plane::coverage(&self.anchor, &self.shape, cloud, fit, &mut self.hit);
        (covered.middle >= least).then_some(covered)
    }

    /// Aligns the cloud with the learned head, from `start`.
    fn align(
        &self,
        cloud: &[Point],
        start: HeadFromSensor,
        cutoffs_m: &[f32],
        stride: usize,
        scale_sigma: f64,
        hair_weight: f32,
    ) -> Option<PlaneFit> {
        let options = AlignOptions {
            cutoffs_m,
            stride,
            hair_weight,
            scale_sigma,
        };
        plane::align(&self.anchor, &self.shape, cloud, start, &options)
    }

    /// Prior standard deviation of ln(scale) in an alignment; 0 if the shape is not learned.
    fn scale_sigma(&self) -> f64 {
        if self.learns {
            self.shape.scale_sigma()
        } else {
            0.0
        }
    }

    /// Searches for the head; each of `searches` pays for half of a search.
    fn search(
        &mut self,
        head: &HeadCloud,
        trail: &Trail,
        at: Timestamp,
        searches: &mut u32,
    ) -> Option<Found> {
        let scale_sigma = self.scale_sigma();
        if !(0.0..=trail.coast_s()).contains(&at.seconds_since(self.searched)) {
            self.clear_search();
        }
        // The last search's candidates first, if its pose was rejected (not lost): they cost little.
        if trail.last.is_some() {
            self.candidates.clear();
        }
        if let Some(found) = self.accept_candidate(head, scale_sigma) {
            self.searched = at;
            return Some(found);
        }
        if self.finalists.is_empty() {
            *searches = searches.checked_sub(1)?;
            self.searched = at;
            self.search_coarsely(&head.points, scale_sigma);
            self.last_centre = Some(head.centre);
        }
        *searches = searches.checked_sub(1)?;
        self.searched = at;
        self.refine_finalists(&head.points, scale_sigma);
        (self.last_centre, self.cloud_shift) = (Some(head.centre), Vector::zeros());
        self.accept_candidate(head, scale_sigma)
    }

    /// The pose of an accepted fit; keeps the fit for [`Self::learn`] if it is good enough.
    fn report(&mut self, head: &HeadCloud, fit: PlaneFit, covered: Coverage) -> Found {
        let coverage = covered.middle.min(covered.nose);
        // A head cut off by the image edge would distort the shape; a beard is part of the learned shape.
        let agreement = fit.agreement.max(fit.agreement_above_beard);
        let learns = agreement >= LEARNING_AGREEMENT && head.whole;
        self.pending = (self.learns && learns).then_some(fit);
        let pose = HeadPose {
            sensor_from_head: fit.head_from_sensor.inverse(),
            confidence: (fit.agreement * (coverage / MIN_COVERAGE_FOUND).min(1.0)).clamp(0.0, 1.0),
            coverage,
            proven: true,
        };
        (pose, fit.information)
    }

    /// First half of a search: aligns all starts, then the better ones further, and keeps the finalists.
    fn search_coarsely(&mut self, cloud: &[Point], scale_sigma: f64) {
        let mut first: Best<KEPT_COARSE> = Best::new();
        for start in start::starts(&self.anchor, cloud) {
            first.offer(self.align(
                cloud,
                start,
                &SEARCH_CUTOFFS_M,
                SEARCH_STRIDE,
                scale_sigma,
                1.0,
            ));
        }
        let mut second: Best<FINALISTS> = Best::new();
        for fit in &first.0 {
            let start = fit.head_from_sensor;
            second.offer(self.align(
                cloud,
                start,
                &NARROW_CUTOFFS_M,
                SEARCH_STRIDE,
                scale_sigma,
                1.0,
            ));
        }
        self.finalists = second.0.iter().map(|fit| fit.head_from_sensor).collect();
        self.cloud_shift = Vector::zeros();
    }

    /// Second half of a search: aligns the finalists, shifted with the cloud, and keeps the best distinct poses as candidates.
    fn refine_finalists(&mut self, cloud: &[Point], scale_sigma: f64) {
        let back = self.back_shift();
        let mut candidates: heapless::Vec<(f32, HeadFromSensor), FINALISTS> = heapless::Vec::new();
        for start in &self.finalists {
            let start = shifted_back(start, &back);
            let Some(fit) = self.align(
                cloud,
                start,
                &FINAL_CUTOFFS_M,
                FINAL_STRIDE,
                scale_sigma,
                HAIR_WEIGHT,
            ) else {
                continue;
            };
            let covered = plane::coverage(&self.anchor, &self.shape, cloud, &fit, &mut self.hit);
            let score = score(&fit, &covered);
            let place = candidates.iter().position(|(other, _)| score > *other);
            // Capacity: one per finalist.
            let _ = candidates.insert(
                place.unwrap_or(candidates.len()),
                (score, fit.head_from_sensor),
            );
        }
        self.clear_search();
        for (_, candidate) in &candidates {
            let is_new = |other: &HeadFromSensor| {
                (other.inverse() * *candidate).rotation.angle() > DISTINCT_RAD
            };
            if !self.candidates.is_full() && self.candidates.iter().all(is_new) {
                // Not full: checked above.
                let _ = self.candidates.push(*candidate);
            }
        }
    }

    /// The best remaining candidate that is accepted on all points.
    fn accept_candidate(&mut self, head: &HeadCloud, scale_sigma: f64) -> Option<Found> {
        let back = self.back_shift();
        while !self.candidates.is_empty() {
            let start = shifted_back(&self.candidates.remove(0), &back);
            let cloud = &head.points;
            let fit = self.align(cloud, start, &FOLLOW_CUTOFFS_M, 1, scale_sigma, HAIR_WEIGHT);
            let coverage = fit.and_then(|fit| self.accepted(cloud, &fit, MIN_COVERAGE_FOUND));
            if let (Some(fit), Some(coverage)) = (fit, coverage) {
                for candidate in &mut self.candidates {
                    *candidate = shifted_back(candidate, &back);
                }
                return Some(self.report(head, fit, coverage));
            }
        }
        None
    }

    /// Translation from the cloud's current to its former position, sensor frame.
    fn back_shift(&self) -> nalgebra::Translation3<f32> {
        (-self.cloud_shift.cap_magnitude(STEP_M)).into()
    }
}

/// Adapts a pose to a cloud that has moved since; `back` leads from its current to its former position, sensor frame.
fn shifted_back(
    head_from_sensor: &HeadFromSensor,
    back: &nalgebra::Translation3<f32>,
) -> HeadFromSensor {
    HeadFromSensor::assume_frames(**head_from_sensor * back)
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

    fn fit(agreement: f32, agreeing: u32) -> PlaneFit {
        PlaneFit {
            head_from_sensor: SensorFromHead::assume_frames(placed(0.0, 0.0, 0.0)).inverse(),
            scale: 1.0,
            agreement,
            agreement_above_beard: 0.0,
            support: 1.0,
            agreeing,
            information: SMatrix::zeros(),
        }
    }

    #[test]
    fn a_search_prefers_agreement_a_large_face_and_a_covered_middle() {
        let score = |agreement, agreeing, middle| {
            let covered = Coverage { middle, nose: 1.0 };
            super::score(&fit(agreement, agreeing), &covered)
        };
        let usual = score(0.6, 400, 0.8);
        assert!(score(0.7, 400, 0.8) > usual && score(0.6, 400, 0.9) > usual);
        // Four times the points are worth twice the agreement.
        assert!((score(0.3, 1600, 0.8) - usual).abs() < 1e-4);
    }

    #[test]
    fn confidence_is_agreement_times_coverage() {
        let mut tracker = tracker();
        let head = cloud(&placed(0.0, 0.0, 0.0), 0.0, 1);
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
        for (agreement, middle, nose, confidence, learns) in [
            (0.8, 0.9, 0.7, 0.8, true),
            (0.8, 0.9, 0.3, 0.4, true),
            (0.8, 0.3, 0.9, 0.4, true),
            (0.6, 0.9, 0.9, 0.6, true),
            (0.59, 0.9, 0.9, 0.59, false),
        ] {
            let (pose, _) = tracker.report(&whole, fit(agreement, 500), covered(middle, nose));
            assert!((pose.confidence - confidence).abs() < 1e-6);
            assert_eq!(pose.coverage, middle.min(nose));
            assert_eq!(tracker.pending.is_some(), learns);
        }
        let bearded = PlaneFit {
            agreement_above_beard: 0.6,
            ..fit(0.4, 500)
        };
        let (pose, _) = tracker.report(&whole, bearded, covered(0.9, 0.9));
        assert!((pose.confidence - 0.4).abs() < 1e-6 && tracker.pending.is_some());
        whole.whole = false;
        tracker.report(&whole, fit(0.9, 500), covered(0.9, 0.9));
        assert!(tracker.pending.is_none(), "cut off at the side");
    }

    #[test]
    fn learns_sixty_frames_then_every_third() {
        let mut tracker = tracker();
        let head = cloud(&placed(0.0, 0.0, 0.0), 0.0, 1);
        let mut taught = Vec::new();
        for frame in 1..=70 {
            // Larger each time, so that a lesson moves the scale.
            tracker.pending = Some(PlaneFit {
                scale: 1.0 + 0.001 * frame as f32,
                ..fit(0.8, 500)
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
    fn the_best_results_are_kept_in_order() {
        let fit = |support: f32, name: f32| PlaneFit {
            support,
            ..fit(name, 0)
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
