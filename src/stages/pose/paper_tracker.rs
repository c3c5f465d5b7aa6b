//! The paper's method: point-to-point ICP ([`icp`]) against the standard head in the first frame, then against the last frame,
//! each time followed by an alignment of the face with the standard head, because frame-to-frame motion alone drifts.

use alloc::sync::Arc;

use nalgebra::SMatrix;

use super::anchor::{Anchor, Surface};
use super::settings::{HeadPose, Settings};
use super::shape::{HeadShape, LEARN_ALL};
use super::trail::{Found, Tracker, Trail};
use super::{icp, start};
use crate::base::frames::HeadFromSensor;
use crate::base::geometry::{Point, Rigid};
use crate::base::prelude::*;
use crate::base::time::Timestamp;
use crate::segment::HeadCloud;

/// Stride over the points while searching.
const SEARCH_STRIDE: usize = 5;
/// Top of the face (hairline), y in the head frame, metres. Only the face is aligned with the standard head, because round hair
/// attenuates rotations: of 35° of a bushy head 20° were found, with the face alone 34°.
const FACE_TOP_M: f32 = -0.06;
/// Bottom of the face, above the chin, y in the head frame, metres.
const FACE_BOTTOM_M: f32 = 0.06;
/// Back of the face, before the ears, z in the head frame, metres.
const FACE_BACK_M: f32 = 0.06;
/// Sides of the face, |x| in the head frame, metres.
const FACE_SIDE_M: f32 = 0.08;

/// Whether a point of the head frame belongs to the face.
fn is_face(p: &Point) -> bool {
    (FACE_TOP_M..FACE_BOTTOM_M).contains(&p.y) && p.z < FACE_BACK_M && p.x.abs() < FACE_SIDE_M
}

/// With fewer points of the face (behind a hand, from the side) the whole head is aligned.
const MIN_FACE_POINTS: usize = 150;
/// Share of the face's pairs kept, nearest first. Mean error over a sweep of ±35°: 1.6° at 0.92, 1.2° at 0.98 and at 1.
const KEPT_PAIRS: f32 = 0.98;
/// Largest distance of a pair of the face, metres: farther points are a hand.
const MAX_PAIR_M: f32 = 0.02;
/// Most aligned points of a cloud: more change the pose by less than its noise.
const MAX_MOVING_POINTS: usize = 1200;
/// Step at which the alignment with the last frame ends, metres.
const FRAME_STOP_M: f32 = 1e-4;
/// Least share of the points with a pair.
const MIN_PAIRED: f32 = 0.35;
/// Learned frames between rebuilds of the target during the first [`LEARN_ALL`].
const REBUILD_EVERY_EARLY: u64 = 3;
/// Learned frames between rebuilds of the target afterwards.
const REBUILD_EVERY: u64 = 15;

/// Tracks one head by point-to-point alignment.
pub(super) struct PaperTracker {
    anchor: Arc<Anchor>,
    shape: HeadShape,
    /// Whether the size is learned.
    learns: bool,
    /// Most iterations of an alignment.
    rounds: u32,
    /// Surface between the anchor points.
    surface: Arc<Surface>,
    /// Surface of the learned head.
    standard: Option<icp::Target>,
    /// The last frame's cloud.
    previous: Option<icp::Target>,
    scratch: icp::Scratch,
    /// The last frame's pose, until the size has learned from it.
    pending: Option<HeadFromSensor>,
}

impl Tracker for PaperTracker {
    fn shape(&self) -> &HeadShape {
        &self.shape
    }

    fn find(
        &mut self,
        head: &HeadCloud,
        trail: &Trail,
        _: Timestamp,
        searches: &mut u32,
    ) -> Option<Found> {
        self.pending = None;
        let cloud = &head.points;
        let every = cloud.len().div_ceil(MAX_MOVING_POINTS).max(1);
        let cloud: Vec<Point> = cloud.iter().step_by(every).copied().collect();
        let cloud = cloud.as_slice();
        let to_frame = icp::Settings {
            iterations: self.rounds,
            ..icp::Settings::default()
        };
        // It only gives a start: 0.1 mm suffices.
        let to_previous = icp::Settings {
            stop_m: FRAME_STOP_M,
            ..to_frame
        };
        let start = match (self.previous.take(), trail.last) {
            (Some(previous), Some((last, _))) => {
                let (start, scratch) = (Rigid::identity(), &mut self.scratch);
                let step = icp::align(&previous, cloud, start, &to_previous, scratch)?;
                HeadFromSensor::assume_frames(*last.inverse() * step.target_from_moving)
            }
            _ => {
                *searches = searches.checked_sub(1)?;
                self.search(cloud)?
            }
        };
        let to_anchor = icp::Settings {
            keep: KEPT_PAIRS,
            max_distance_m: MAX_PAIR_M,
            ..to_frame
        };
        let is_face = |p: &&Point| is_face(&(start * **p));
        let face: Vec<Point> = cloud.iter().filter(is_face).copied().collect();
        let seen = if face.len() < MIN_FACE_POINTS {
            cloud
        } else {
            &face
        };
        let standard = self.standard.as_ref().unwrap_or(&self.anchor.target);
        let found = icp::align(standard, seen, *start, &to_anchor, &mut self.scratch)
            .filter(|found| found.paired >= MIN_PAIRED && found.residual < 0.008)?;
        self.previous = icp::Target::new(cloud);
        let head_from_sensor = HeadFromSensor::assume_frames(found.target_from_moving);
        self.pending = (self.learns && head.whole).then_some(head_from_sensor);
        let pose = HeadPose {
            sensor_from_head: head_from_sensor.inverse(),
            confidence: found.paired,
            coverage: 1.0,
            proven: true,
        };
        Some((pose, SMatrix::zeros()))
    }

    fn learn(&mut self, cloud: &HeadCloud) {
        let Some(head_from_sensor) = self.pending.take() else {
            return;
        };
        if self.shape.counts_frame() {
            self.shape
                .learn(&self.anchor, &cloud.points, &head_from_sensor, None);
        }
        let period = if self.shape.learned_frames <= LEARN_ALL {
            REBUILD_EVERY_EARLY
        } else {
            REBUILD_EVERY
        };
        if self.shape.learned_frames.is_multiple_of(period) {
            self.standard = self.learned_target();
        }
    }

    fn break_continuity(&mut self) {
        self.previous = None;
    }

    fn restart(&mut self) {
        self.break_continuity();
    }

    fn forget(&mut self) {
        self.restart();
        self.pending = None;
        if self.shape.learned_frames > 0 {
            self.shape.forget();
            self.standard = self.learned_target();
        }
    }
}

impl PaperTracker {
    pub(super) fn new(settings: &Settings, anchor: Arc<Anchor>, surface: Arc<Surface>) -> Self {
        Self {
            standard: surface.target(|i| anchor.points[i]),
            surface,
            shape: HeadShape::standard(anchor.points.len()),
            anchor,
            learns: settings.learn_shape,
            rounds: settings.rounds,
            previous: None,
            scratch: icp::Scratch::default(),
            pending: None,
        }
    }

    /// The surface of the learned head.
    fn learned_target(&self) -> Option<icp::Target> {
        self.surface.target(|i| self.shape.point(&self.anchor, i))
    }

    /// Pose of the first frame: the best of a few iterations from each start.
    fn search(&mut self, cloud: &[Point]) -> Option<HeadFromSensor> {
        let thin: Vec<Point> = cloud.iter().step_by(SEARCH_STRIDE).copied().collect();
        let brief = icp::Settings {
            iterations: 15,
            keep: 0.7,
            max_distance_m: 0.05,
            ..icp::Settings::default()
        };
        let (target, scratch) = (&self.anchor.target, &mut self.scratch);
        let ends = start::starts(&self.anchor, cloud)
            .filter_map(|start| icp::align(target, &thin, *start, &brief, scratch));
        let best = ends.min_by(|a, b| a.residual.total_cmp(&b.residual))?;
        Some(HeadFromSensor::assume_frames(best.target_from_moving))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_face_is_from_hairline_to_chin_and_before_the_ears() {
        for (x, y, z, expected) in [
            (0.0, 0.0, 0.0, true),
            (0.079, 0.0, 0.0, true),
            (-0.081, 0.0, 0.0, false),
            (0.0, -0.061, 0.0, false),
            (0.0, 0.061, 0.0, false),
            (0.0, 0.0, 0.059, true),
            (0.0, 0.0, 0.061, false),
        ] {
            assert_eq!(is_face(&Point::new(x, y, z)), expected, "{x} {y} {z}");
        }
    }
}
