//! The paper's method: point-to-point ICP ([`icp`]), against the standard head in the first frame, then frame to frame, each
//! followed by an alignment of the face to the standard head until convergence, because frame-to-frame motion alone drifts.

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
/// Only the face is aligned to the standard head: below the hairline, above the chin, in front of the ears, metres. With a whole
/// head, hair as round as a ball holds back its turns: of 35° of a bushy head 20° were found, now 34°.
const FACE_ABOVE_M: f32 = -0.06;
const FACE_BELOW_M: f32 = 0.06;
const FACE_BEHIND_M: f32 = 0.06;
const FACE_BESIDE_M: f32 = 0.08;
/// Whether a place of the head frame is one of the face.
fn is_face(p: &Point) -> bool {
    (FACE_ABOVE_M..FACE_BELOW_M).contains(&p.y) && p.z < FACE_BEHIND_M && p.x.abs() < FACE_BESIDE_M
}

/// Fewer points of the face, behind a hand or from the side, are joined by the rest of the head.
const LEAST_FACE: usize = 150;
/// Share of the face's pairs that is kept, nearest first, and the largest distance of a pair, metres: what is farther is a hand.
/// Mean error of a sweep of ±35° 1.6° at 0.92, 1.2° at 0.98 and at 1.
const KEPT: f32 = 0.98;
const PAIRED_M: f32 = 0.02;
/// At most this many points of a cloud are aligned; more cost time and move a pose by less than its noise.
const MOST_MOVING: usize = 1200;
/// Step at which the alignment with the frame before ends, metres.
const FRAME_STOP_M: f32 = 1e-4;
/// Least share of the pairs that must be kept.
const MIN_PAIRED: f32 = 0.35;
/// The target is rebuilt after so many such frames at first, and then.
const REMADE_EARLY: u64 = 3;
const REMADE: u64 = 15;

/// Tracks one head by points.
pub(super) struct PaperTracker {
    anchor: Arc<Anchor>,
    shape: HeadShape,
    /// Whether the size is learned.
    learns: bool,
    /// Rounds of an alignment at most.
    rounds: u32,
    /// The surface between anchor points, and of the learned head.
    surface: Arc<Surface>,
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
        let every = cloud.len().div_ceil(MOST_MOVING).max(1);
        let cloud: Vec<Point> = cloud.iter().step_by(every).copied().collect();
        let cloud = cloud.as_slice();
        let to_frame = icp::Settings {
            iterations: self.rounds,
            ..icp::Settings::default()
        };
        // Where it leads is a start: a tenth of a millimetre will do.
        let roughly = icp::Settings {
            stop_m: FRAME_STOP_M,
            ..to_frame
        };
        let start = match (self.previous.take(), trail.last) {
            (Some(previous), Some((last, _))) => {
                let (start, scratch) = (Rigid::identity(), &mut self.scratch);
                let step = icp::align(&previous, cloud, start, &roughly, scratch)?;
                HeadFromSensor::of(*last.inverse() * step.target_from_moving)
            }
            _ => {
                *searches = searches.checked_sub(1)?;
                self.search(cloud)?
            }
        };
        let to_anchor = icp::Settings {
            keep: KEPT,
            max_distance_m: PAIRED_M,
            ..to_frame
        };
        let is_face = |p: &&Point| is_face(&(start * **p));
        let face: Vec<Point> = cloud.iter().filter(is_face).copied().collect();
        let seen = if face.len() < LEAST_FACE {
            cloud
        } else {
            &face
        };
        let standard = self.standard.as_ref().unwrap_or(&self.anchor.target);
        let found = icp::align(standard, seen, *start, &to_anchor, &mut self.scratch)
            .filter(|found| found.paired >= MIN_PAIRED && found.residual < 0.008)?;
        self.previous = icp::Target::new(cloud);
        let head_from_sensor = HeadFromSensor::of(found.target_from_moving);
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
        if self.shape.takes_frame() {
            self.shape
                .learn(&self.anchor, &cloud.points, &head_from_sensor, None);
        }
        let remade = if self.shape.learned_frames <= LEARN_ALL {
            REMADE_EARLY
        } else {
            REMADE
        };
        if self.shape.learned_frames.is_multiple_of(remade) {
            self.standard = self.known_head();
        }
    }

    fn lose(&mut self) {
        self.previous = None;
    }

    fn restart(&mut self) {
        self.lose();
    }

    fn forget(&mut self) {
        self.restart();
        self.pending = None;
        if self.shape.learned_frames > 0 {
            self.shape.forget();
            self.standard = self.known_head();
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
    fn known_head(&self) -> Option<icp::Target> {
        self.surface.target(|i| self.shape.place(&self.anchor, i))
    }

    /// The first frame: a few iterations from each start, then the best.
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
        Some(HeadFromSensor::of(best.target_from_moving))
    }
}
