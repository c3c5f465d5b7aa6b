//! The shape of one user's head, relative to the standard head, and how it is learned while tracking.
//!
//! If a head differs from the standard head, the alignment is a compromise that depends on which part is visible, so the pose
//! error depends on the pose. So a uniform scale is learned (a running mean of each frame's estimate, bounded 0.86 to 1.16) and
//! for every anchor point an offset along its normal (a running mean of the distances of its live points; the idea of a fused
//! reference model, Newcombe et al., *KinectFusion: real-time dense surface mapping and tracking*, ISMAR 2011, on the anchor's
//! points instead of a volume).
//!
//! Rigid motion and scale contained in the offsets are removed ([`HeadShape::remove_rigid_and_scale`]), because they belong to
//! the pose; otherwise the learned head could drift from the standard one. Only the bare face ([`Anchor`]) counts there: over
//! the whole head, hair off the cranium shifts the face by a centimetre in half a minute. Offsets are smoothed along the
//! surface, which extends them slightly into unseen parts.
//!
//! Head frame, metres. Memory: 12 bytes per anchor point. Cost: one look-up per live point and frame, and a 7 × 7 solve.
//! Limitation: offsets follow the normal up to [`MAX_OFFSET_M`]; long beards and high hair exceed it and stay outliers.

use nalgebra::SVector;

use super::anchor::{Anchor, BATCH, Batch, NEIGHBOURS};
use crate::base::frames::HeadFromSensor;
use crate::base::geometry::Point;
use crate::base::prelude::*;

/// Largest |ln(scale)|: heads are 0.86 to 1.16 of the standard size.
pub(crate) const MAX_LOG_SCALE: f64 = 0.15;

/// Weight of the standard head in an offset's mean, frames, against single noisy frames.
const PRIOR_FRAMES: f32 = 1.0;

/// Largest cosine between viewing ray and normal of an anchor point that faces the camera.
pub(crate) const FACING: f32 = -0.15;

/// Largest distance of a live point that is learned from, metres: farther ones are hands, hair or the neck.
const MAX_RESIDUAL_M: f32 = 0.008;

/// Share of the neighbours' mean mixed in per frame: at unseen points, and at seen ones.
const SMOOTHING_SHARES: (f32, f32) = (0.08, 0.001);

/// Length of the scale's running mean, frames.
const SCALE_MEMORY_FRAMES: f64 = 300.0;

/// Length of an offset's running mean, frames.
const MEMORY_FRAMES: f32 = 300.0;
/// Length of an offset's running mean where the size is derived from the offsets, frames: shorter, so that they settle first.
const SIZE_MEMORY_FRAMES: f32 = 50.0;

/// Number of first usable frames that are all learned from.
pub(super) const LEARN_ALL: u64 = 60;
/// Later only every so many usable frames are learned from: consecutive ones are redundant.
const LEARN_STEP: u64 = 3;

/// Largest learned offset, metres.
const MAX_OFFSET_M: f32 = 0.015;

/// Learned scale and offsets of one head.
#[derive(Clone, Debug)]
pub(crate) struct HeadShape {
    /// Natural logarithm of the head's size relative to the standard head.
    pub(crate) log_scale: f64,
    /// Usable frames so far.
    pub(crate) learned_frames: u64,
    /// Offset of each anchor point along its normal, metres at the standard size.
    pub(crate) offset: Vec<f32>,
    /// Frames from which each offset was learned, capped.
    seen: Vec<f32>,
    /// Frames from which the scale was learned.
    frames: f64,
    /// Sum and count of this frame's distances per anchor point.
    sums: Vec<(f32, f32)>,
}

impl HeadShape {
    /// The standard head, for an anchor of `points` points.
    pub(crate) fn standard(points: usize) -> Self {
        Self {
            log_scale: 0.0,
            learned_frames: 0,
            offset: vec![0.0; points],
            seen: vec![0.0; points],
            frames: 0.0,
            sums: vec![(0.0, 0.0); points],
        }
    }

    /// Resets to the standard head, in place.
    pub(crate) fn forget(&mut self) {
        self.log_scale = 0.0;
        self.learned_frames = 0;
        self.frames = 0.0;
        self.offset.fill(0.0);
        self.seen.fill(0.0);
    }

    /// Counts a usable frame; returns whether to learn from it.
    pub(super) fn counts_frame(&mut self) -> bool {
        self.learned_frames += 1;
        self.learned_frames <= LEARN_ALL || self.learned_frames.is_multiple_of(LEARN_STEP)
    }

    /// Measured offset of an anchor point, metres, without the standard head's share in the mean; `None` if unseen.
    pub(crate) fn measured(&self, i: usize) -> Option<f32> {
        let seen = self.seen[i];
        (seen >= 1.0).then(|| self.offset[i] * (seen + PRIOR_FRAMES) / seen)
    }

    /// Position of an anchor point on this head, head frame, metres.
    pub(crate) fn point(&self, anchor: &Anchor, i: usize) -> Point {
        let size = self.log_scale.exp() as f32;
        Point::from((anchor.points[i] + anchor.normals[i] * self.offset[i]).coords * size)
    }

    /// Prior standard deviation of ln(scale): 0.06 at first, decreasing to 0.004.
    pub(crate) fn scale_sigma(&self) -> f64 {
        (0.06 / (1.0 + self.frames * 0.1).sqrt()).max(0.004)
    }

    /// Calls `each` for every `stride`-th point of a cloud: with the point (sensor frame, metres), where `pose` moves it (head frame,
    /// metres), and its nearest anchor point with its distance from the head along that normal, metres at the standard size. That is
    /// `None` if no anchor point is near, or the nearest is on the rim or faces away from the camera.
    #[inline(always)]
    pub(crate) fn pairs(
        &self,
        anchor: &Anchor,
        (cloud, stride): (&[Point], usize),
        (pose, inverse_scale): (&HeadFromSensor, f32),
        mut each: impl FnMut(&Point, &Point, Option<(usize, f32)>),
    ) {
        let camera = Point::from(pose.translation.vector);
        let mut batch = Batch::EMPTY;
        for points in cloud.chunks(BATCH * stride) {
            anchor.locate(points, stride, (pose, inverse_scale), &mut batch);
            for (k, p) in points.iter().step_by(stride).enumerate() {
                let q = batch.point(k);
                let pair = anchor.nearest(batch.cell[k]).and_then(|i| {
                    let n = &anchor.normals[i];
                    let towards = n.dot(&(q - camera));
                    let is_seen = !anchor.rim[i] && towards <= FACING * batch.distance[k];
                    let x = Point::from(q.coords * inverse_scale);
                    is_seen.then(|| (i, n.dot(&(x - anchor.points[i])) - self.offset[i]))
                });
                each(p, &q, pair);
            }
        }
    }

    /// Learns from an aligned cloud (sensor frame, metres): adds its distances to the running means. Without a `scale` from the
    /// alignment, the size follows from the offsets' growth.
    pub(crate) fn learn(
        &mut self,
        anchor: &Anchor,
        cloud: &[Point],
        head_from_sensor: &HeadFromSensor,
        scale: Option<f32>,
    ) {
        let (mut inverse_scale, mut memory) = ((-self.log_scale).exp() as f32, SIZE_MEMORY_FRAMES);
        if let Some(scale) = scale {
            (inverse_scale, memory) = (1.0 / scale, MEMORY_FRAMES);
            self.frames = (self.frames + 1.0).min(SCALE_MEMORY_FRAMES);
            self.change_scale((f64::from(scale).ln() - self.log_scale) / self.frames);
        }
        self.sums.fill((0.0, 0.0));
        let mut sums = core::mem::take(&mut self.sums);
        let place = (head_from_sensor, inverse_scale);
        self.pairs(anchor, (cloud, 1), place, |_, _, pair| {
            if let Some((i, r)) = pair.filter(|(_, r)| r.abs() < MAX_RESIDUAL_M) {
                sums[i].0 += r;
                sums[i].1 += 1.0;
            }
        });
        self.sums = sums;
        for i in 0..self.offset.len() {
            let (sum, count) = self.sums[i];
            if count > 0.0 {
                self.seen[i] = (self.seen[i] + 1.0).min(memory);
                self.offset[i] += sum / count / (self.seen[i] + PRIOR_FRAMES);
            }
        }
        self.smooth_offsets(anchor);
        let growth = self.remove_rigid_and_scale(anchor);
        if scale.is_none() {
            self.change_scale(growth);
        }
    }

    fn change_scale(&mut self, log_scale: f64) {
        let grown = self.log_scale + log_scale;
        self.log_scale = grown.clamp(-MAX_LOG_SCALE, MAX_LOG_SCALE);
    }

    fn smooth_offsets(&mut self, anchor: &Anchor) {
        for i in 0..self.offset.len() {
            let beside = anchor.neighbours[i].map(|k| self.offset[usize::from(k)]);
            let mean = beside.iter().sum::<f32>() / NEIGHBOURS as f32;
            let (new, known) = SMOOTHING_SHARES;
            let share = if self.seen[i] < 1.0 { new } else { known };
            self.offset[i] += (mean - self.offset[i]) * share;
            self.offset[i] = self.offset[i].clamp(-MAX_OFFSET_M, MAX_OFFSET_M);
        }
    }

    /// Removes the least-squares rigid motion and scale, fitted over the bare face and weighted by trust, from all offsets. Returns
    /// the removed ln(scale).
    fn remove_rigid_and_scale(&mut self, anchor: &Anchor) -> f64 {
        let mut g = SVector::<f64, 7>::zeros();
        let points = self.offset.iter().zip(&anchor.motions).zip(&anchor.trust);
        for (_, ((&offset, j), &trust)) in points.enumerate().filter(|(i, _)| anchor.is_bare(*i)) {
            g += (SVector::from(*j) * (trust * offset)).cast();
        }
        let motion = (anchor.motions_inverse * g).cast::<f32>();
        for (offset, j) in self.offset.iter_mut().zip(&anchor.motions) {
            let moved: f32 = (0..7).map(|a| j[a] * motion[a]).sum();
            *offset -= moved;
        }
        f64::from(motion[6])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    use crate::base::geometry::Rigid;
    use crate::pose::anchor::tests::half_egg;
    use crate::pose::signature::Signature;

    #[test]
    fn scale_in_the_offsets_counts_as_size() {
        let anchor = Anchor::new(&half_egg()).unwrap();
        let head = |log_scale: f64, growth: f32| {
            let mut shape = HeadShape::standard(anchor.points.len());
            shape.log_scale = log_scale;
            shape.seen.fill(MEMORY_FRAMES);
            let grown =
                |(a, n): (&Point, &crate::base::geometry::Vector)| n.dot(&a.coords) * growth;
            let grown = anchor.points.iter().zip(&anchor.normals).map(grown);
            let share = MEMORY_FRAMES / (MEMORY_FRAMES + PRIOR_FRAMES);
            shape.offset = grown.map(|offset| offset * share).collect();
            Signature::from_shape(&anchor, &shape)
        };
        let difference = |one: &Signature, other: &Signature| {
            one.difference(other, &anchor).expect("all is seen")
        };
        let same = difference(&head(0.04, -0.03), &head(0.01, 0.0));
        assert!(
            same.log_size.abs() < 0.002 && same.surface < 0.1,
            "{same:?}"
        );
        let other = difference(&head(0.04, 0.01), &head(0.01, 0.0));
        assert!((other.log_size - 0.04).abs() < 0.002, "{other:?}");
    }

    #[test]
    fn removing_leaves_no_rigid_motion_and_no_scale() {
        let anchor = Anchor::new(&half_egg()).unwrap();
        let mut shape = HeadShape::standard(anchor.points.len());
        for i in 0..shape.offset.len() {
            let (a, n) = (anchor.points[i], anchor.normals[i]);
            let turned = nalgebra::Vector3::new(0.02, -0.03, 0.01).cross(&a.coords);
            shape.offset[i] =
                n.dot(&(turned + nalgebra::Vector3::new(0.002, 0.001, -0.003) + a.coords * 0.04));
        }
        shape.remove_rigid_and_scale(&anchor);
        let worst = shape.offset.iter().fold(0.0f32, |m, o| m.max(o.abs()));
        assert!(worst < 2e-5, "{worst}");
    }

    #[test]
    fn measured_offsets_exclude_the_prior_and_scale_sigma_narrows() {
        let mut shape = HeadShape::standard(3);
        (shape.seen, shape.offset) = (vec![0.5, 1.0, 12.0], vec![0.001, 0.001, 0.003]);
        assert_eq!(shape.measured(0), None);
        // Of two frames' worth one was seen; of thirteen twelve.
        assert!((shape.measured(1).unwrap() - 0.002).abs() < 1e-8);
        assert!((shape.measured(2).unwrap() - 0.00325).abs() < 1e-8);
        for (frames, sigma) in [(0.0, 0.06), (30.0, 0.03), (1e6, 0.004)] {
            shape.frames = frames;
            assert!((shape.scale_sigma() - sigma).abs() < 1e-12);
        }
        (shape.log_scale, shape.frames) = (0.1, 9.0);
        shape.forget();
        assert_eq!((shape.log_scale, shape.frames), (0.0, 0.0));
        assert!(shape.offset.iter().chain(&shape.seen).all(|v| *v == 0.0));
    }

    #[test]
    fn learns_a_bump_and_the_mean_size() {
        let anchor = Anchor::new(&half_egg()).unwrap();
        let mut shape = HeadShape::standard(anchor.points.len());
        let pose = HeadFromSensor::assume_frames(Rigid::translation(0.0, 0.0, -0.7));
        // The tip of a nose is 4 mm longer than the standard one, over 2 cm.
        let bump = |p: &Point| 0.004 * (-p.coords.xy().norm_squared() / 2e-4).exp();
        let all = anchor.points.iter().zip(&anchor.normals);
        let cloud: Vec<Point> = all
            .map(|(p, n)| pose.inverse() * (p + n * bump(p)))
            .collect();
        for _ in 0..60 {
            shape.learn(&anchor, &cloud, &pose, Some(1.0));
        }
        let tip = (0..anchor.points.len())
            .filter(|&i| anchor.is_bare(i) && !anchor.rim[i])
            .min_by(|&a, &b| {
                let aside = |k: usize| anchor.points[k].coords.xy().norm();
                aside(a).total_cmp(&aside(b))
            })
            .unwrap();
        let learned = shape.measured(tip).unwrap();
        assert!((0.0025..0.0045).contains(&learned), "{learned}");
        let beside = (0..anchor.points.len())
            .filter(|&i| anchor.is_bare(i) && bump(&anchor.points[i]) < 1e-5 && shape.seen[i] > 9.0)
            .map(|i| shape.offset[i].abs());
        assert!(beside.clone().count() > 50 && beside.fold(0.0, f32::max) < 0.0015);
        // One of the size before, one a tenth larger in all: the mean of the logarithms.
        let mut shape = HeadShape::standard(anchor.points.len());
        shape.learn(&anchor, &[], &pose, Some(1.0));
        shape.learn(&anchor, &[], &pose, Some(1.1));
        assert!((shape.log_scale - 0.5 * 1.1f64.ln()).abs() < 1e-6);
    }
}
