//! Point-to-plane alignment of a live cloud with the anchor: the tracker's default.
//!
//! Method: Gauss–Newton on distances along the anchor's normals (Chen & Medioni 1992), pairs weighted by Tukey's biweight, the
//! anchor's trust and the sensor's error, with a decreasing cut-off per iteration. Distances along the normal let the surfaces
//! slide over each other, so that a few iterations replace dozens of point-to-point ones, and depth steps average out. Besides the six motion parameters, the head's uniform scale is estimated, with a quadratic prior.
//!
//! With q = `head_from_sensor` p, scale s, anchor point a with normal n and learned offset o along it:
//! r = n·(q/s − a) − o, ∂r/∂ω = (q × n)/s, ∂r/∂v = n/s, ∂r/∂ln s = −n·q/s.
//!
//! Head frame, metres, radians; sums in f64. Cost about 40 ns per point and iteration. Memory: none. Degenerate: too few
//! pairs or a singular system give `None`. Pairs at the anchor's rim are dropped (the live point may belong to a part that the
//! anchor lacks), and so are pairs whose anchor normal points away from the camera.

use nalgebra::{SMatrix, SVector};

use super::anchor::{Anchor, HEAD_PARTS};
use super::shape::{FACING, HeadShape, MAX_LOG_SCALE};
use crate::base::frames::{Head, HeadFromSensor, Motion};
use crate::base::geometry::{Point, Rigid, Vector};
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;
use crate::base::vectors::with_avx2;

/// Least total weight of pairs that determines a pose.
const MIN_WEIGHT: f64 = 40.0;

/// Settings of an alignment.
#[derive(Clone, Copy, Debug)]
pub(crate) struct AlignOptions<'a> {
    /// Cut-off of the biweight per iteration, metres.
    pub(crate) cutoffs_m: &'a [f32],
    /// Stride over the live points.
    pub(crate) stride: usize,
    /// Weight of points outside the bare face, which may be hair, 0…1.
    pub(crate) hair_weight: f32,
    /// Prior standard deviation of ln(scale) about the learned one; 0 keeps the scale.
    pub(crate) scale_sigma: f64,
}

/// Result of an alignment.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PlaneFit {
    pub(crate) head_from_sensor: HeadFromSensor,
    /// Size relative to the standard head.
    pub(crate) scale: f32,
    /// Agreeing share of the live points on the bare face, 0…1.
    pub(crate) agreement: f32,
    /// Agreeing share of the live points on the bare face above a beard, 0…1.
    pub(crate) agreement_above_beard: f32,
    /// Agreeing share of all live points, hair included, 0…1: ranks poses.
    pub(crate) support: f32,
    /// Number of agreeing live points on the bare face.
    pub(crate) agreeing: u32,
    /// Information of the live points on rotation and shift (normal matrix, head frame, radians and metres), per unit of weight.
    pub(crate) information: SMatrix<f64, 6, 6>,
}

/// Largest distance of a live point that covers an anchor point, metres.
const COVERED_WITHIN_M: f32 = 0.008;

/// Shares of the face covered by live points, 0…1.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Coverage {
    /// Of the area between brows and mouth.
    pub(crate) middle: f32,
    /// Of the ridge and tip of the nose: a flat object may cover most of the middle.
    pub(crate) nose: f32,
}

/// Coverage of the camera-facing part of the face by live points (sensor frame): a wrong pose may put all points on a cheek and
/// leave the rest empty; a forearm or a chair's back has no nose. `hit` is scratch, one per anchor point.
pub(crate) fn coverage(
    anchor: &Anchor,
    shape: &HeadShape,
    cloud: &[Point],
    fit: &PlaneFit,
    hit: &mut [bool],
) -> Coverage {
    hit.fill(false);
    let camera = Point::from(fit.head_from_sensor.translation.vector);
    let place = (&fit.head_from_sensor, 1.0 / fit.scale);
    shape.pairs(anchor, (cloud, 1), place, |_, _, pair| {
        if let Some((i, _)) = pair.filter(|(_, r)| r.abs() < COVERED_WITHIN_M) {
            hit[i] = true;
        }
    });
    let (mut facing, mut covered) = ([0.0; 2], [0.0; 2]);
    let points = anchor.points.iter().enumerate();
    for (i, p) in points.filter(|(_, p)| is_middle(p)) {
        let towards = p * fit.scale - camera;
        let away = anchor.normals[i].dot(&towards) > 2.0 * FACING * towards.norm();
        if away || anchor.rim[i] {
            continue;
        }
        let is_hit = hit[i] || anchor.neighbours[i].iter().any(|&k| hit[usize::from(k)]);
        for (k, is_in) in [true, is_nose(p)].into_iter().enumerate() {
            facing[k] += f32::from(u8::from(is_in));
            covered[k] += f32::from(u8::from(is_in && is_hit));
        }
    }
    let [middle, nose] = [0, 1].map(|k| covered[k] / f32::max(facing[k], 1.0));
    Coverage { middle, nose }
}

/// Whether a point (head frame, metres) is between brows and mouth, where every face has relief.
fn is_middle(p: &Point) -> bool {
    p.x.abs() < 0.040 && (-0.030..0.070).contains(&p.y)
}

/// Whether a point (head frame, metres) of the middle is on the ridge or tip of the nose, which protrudes by a centimetre.
fn is_nose(p: &Point) -> bool {
    p.x.abs() < 0.010 && (0.010..0.045).contains(&p.y)
}

/// Standard deviation of a live point's residual, metres: model error, not noise.
const RESIDUAL_SIGMA_M: f64 = 0.004;
/// Independent observations among some 1500 live points, whose errors are correlated.
const INDEPENDENT_POINTS: f64 = 60.0;
/// Variance of the combined residual, metres²; divided by a prior's variance, it is the prior's weight in units of live points.
pub(super) const RESIDUAL_VARIANCE_M2: f64 =
    RESIDUAL_SIGMA_M * RESIDUAL_SIGMA_M / INDEPENDENT_POINTS;

/// Sums over the live points in one iteration.
#[derive(Default)]
struct Sums {
    /// Normal matrix, of which the upper triangle is used, and the gradient as eighth column: rows of eight fill a vector.
    rows: [[f64; 8]; 7],
    points: u32,
    /// Paired points by part of the head.
    paired: [u32; HEAD_PARTS],
    agreement: [f64; HEAD_PARTS],
    agreeing: u32,
    support: f64,
    total: f64,
}

impl Sums {
    /// Adds the points of `cloud`. In place: the compiler would keep local sums in scalar registers instead of vectors.
    #[inline(always)]
    fn add(
        &mut self,
        anchor: &Anchor,
        shape: &HeadShape,
        cloud: (&[Point], usize),
        (pose, inverse_scale): (&HeadFromSensor, f32),
        (cutoff, hair_weight): (f32, f32),
        middle2: f32,
    ) {
        let place = (pose, inverse_scale);
        shape.pairs(
            anchor,
            cloud,
            place,
            #[inline(always)]
            |p, q, pair| {
                self.points += 1;
                let Some((i, r)) = pair else {
                    return;
                };
                let part = usize::from(anchor.part[i]);
                let bare = part > 0;
                self.paired[part] += 1;
                let u = r / cutoff;
                if u.abs() >= 1.0 {
                    return;
                }
                let biweight = (1.0 - u * u) * (1.0 - u * u);
                self.support += f64::from(biweight);
                self.agreement[part] += f64::from(biweight);
                self.agreeing += u32::from(bare);
                // The sensor's error grows with the distance squared, so the weight falls with its fourth power.
                let nearer = middle2 / (p.z * p.z);
                let trust = anchor.trust[i] * if bare { 1.0 } else { hair_weight };
                let w = f64::from(biweight * trust * nearer * nearer);
                self.total += w;
                let n = anchor.normals[i] * inverse_scale;
                let turn = q.coords.cross(&n);
                let growth = -n.dot(&q.coords);
                let j = [turn.x, turn.y, turn.z, n.x, n.y, n.z, growth, r].map(f64::from);
                for (a, row) in self.rows.iter_mut().enumerate() {
                    let wa = w * j[a];
                    // Whole vectors of four columns; those entirely below the diagonal are skipped, because nothing reads them.
                    for b in a / 4 * 4..8 {
                        row[b] += wa * j[b];
                    }
                }
            },
        );
    }
}

/// Aligns `cloud` (sensor frame, metres) with the head, from `start`; `None` with too few pairs or a singular system.
pub(crate) fn align(
    anchor: &Anchor,
    shape: &HeadShape,
    cloud: &[Point],
    start: HeadFromSensor,
    options: &AlignOptions,
) -> Option<PlaneFit> {
    let mut pose = start;
    let prior = shape.log_scale;
    let mut log_scale = prior;
    let mut fit = None;
    let middle2 = cloud.get(cloud.len() / 2).map_or(1.0, |p| p.z * p.z);
    let last = options.cutoffs_m.len().saturating_sub(1);
    let stride = options.stride.max(1);
    for (round, &cutoff) in options.cutoffs_m.iter().enumerate() {
        let inverse_scale = (-log_scale).exp() as f32;
        let mut sums = Sums::default();
        with_avx2(
            #[inline(always)]
            || {
                let (place, weights) = ((&pose, inverse_scale), (cutoff, options.hair_weight));
                sums.add(anchor, shape, (cloud, stride), place, weights, middle2);
            },
        );
        if sums.total < MIN_WEIGHT / stride as f64 {
            return None;
        }
        if round == last {
            let Sums { rows, total, .. } = &sums;
            let agreement = |from: usize| {
                let agree = sums.agreement[from..].iter().sum::<f64>();
                (agree / f64::from(sums.paired[from..].iter().sum::<u32>().max(1))) as f32
            };
            fit = Some(PlaneFit {
                head_from_sensor: pose,
                scale: log_scale.exp() as f32,
                agreement: agreement(1),
                agreement_above_beard: agreement(2),
                support: sums.support as f32 / sums.points as f32,
                agreeing: sums.agreeing * stride as u32,
                information: SMatrix::from_fn(|a, b| rows[a.min(b)][a.max(b)] / total),
            });
        }
        let step = step(&sums, options, log_scale - prior)?;
        let turn = Vector::new(step[0] as f32, step[1] as f32, step[2] as f32);
        let shift = Vector::new(step[3] as f32, step[4] as f32, step[5] as f32);
        let turn = turn.cap_magnitude(MAX_TURN_RAD);
        let moved = Rigid::new(shift.cap_magnitude(MAX_SHIFT_M), turn);
        pose = Motion::<Head, Head>::assume_frames(moved) * pose;
        log_scale = (log_scale + step[6]).clamp(-MAX_LOG_SCALE, MAX_LOG_SCALE);
    }
    // The statistics are those before the last step; pose and scale include it.
    let mut pose = *pose;
    pose.rotation.renormalize();
    let is_finite = pose.translation.vector.iter().all(|c| c.is_finite());
    fit.filter(|_| is_finite).map(|fit| PlaneFit {
        head_from_sensor: HeadFromSensor::assume_frames(pose),
        scale: log_scale.exp() as f32,
        ..fit
    })
}

/// Gauss–Newton step: rotation (radians), shift (metres), ln(scale). `off`: difference of ln(scale) from its prior. `None` if the
/// system is singular.
#[inline]
fn step(sums: &Sums, options: &AlignOptions, off: f64) -> Option<SVector<f64, 7>> {
    let &Sums { rows, total, .. } = sums;
    let mut h = SMatrix::<f64, 7, 7>::from_fn(|a, b| rows[a.min(b)][a.max(b)]);
    let mut g = SVector::<f64, 7>::from(rows.map(|row| row[7]));
    if options.scale_sigma > 0.0 {
        // Prior weight in units of the sums.
        let strength = RESIDUAL_VARIANCE_M2 * total / (options.scale_sigma * options.scale_sigma);
        h[(6, 6)] += strength;
        g[6] += strength * off;
    } else {
        h.row_mut(6).fill(0.0);
        h.column_mut(6).fill(0.0);
        h[(6, 6)] = 1.0;
        g[6] = 0.0;
    }
    // Slight damping for undetermined directions (mm and mrad against hundreds of weighted pairs).
    for k in 0..6 {
        h[(k, k)] += 1e-4 * total * if k < 3 { 0.01 } else { 1.0 };
    }
    Some(h.cholesky()?.solve(&(-g)))
}

/// Largest rotation of one iteration, radians: limit of the linearisation.
const MAX_TURN_RAD: f32 = 0.3;
/// Largest shift of one iteration, metres.
const MAX_SHIFT_M: f32 = 0.04;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::geometry::Rotation;
    use crate::pose::anchor::tests::half_egg;

    /// A live point of the middle of the face, as deep as `z`, and the pose that lays it on the head `off` metres before its
    /// surface.
    fn seen(anchor: &Anchor, z: f32, off: f32) -> (Point, HeadFromSensor) {
        let i = (0..anchor.points.len())
            .filter(|&i| anchor.is_bare(i) && !anchor.rim[i])
            .min_by(|&a, &b| {
                let aside = |k: usize| anchor.points[k].coords.xy().norm();
                aside(a).total_cmp(&aside(b))
            })
            .expect("a face");
        // The head as the camera at its z sees it, not turned.
        let q = anchor.points[i] + anchor.normals[i] * off;
        let pose = HeadFromSensor::assume_frames(Rigid::translation(0.0, 0.0, q.z - z));
        (pose.inverse() * q, pose)
    }

    /// The sums over that point alone.
    fn one_point(anchor: &Anchor, z: f32, off: f32, middle: f32) -> Sums {
        let shape = HeadShape::standard(anchor.points.len());
        let (p, pose) = seen(anchor, z, off);
        let place = (&pose, 1.0);
        let mut sums = Sums::default();
        let (cloud, middle2) = ((&[p][..], 1), middle * middle);
        sums.add(anchor, &shape, cloud, place, (0.02, 0.5), middle2);
        sums
    }

    #[test]
    fn weight_falls_with_the_fourth_power_of_the_distance_and_by_the_biweight() {
        let anchor = Anchor::new(&half_egg()).expect("a head");
        let near = one_point(&anchor, 0.6, 0.0, 0.6);
        let far = one_point(&anchor, 1.2, 0.0, 0.6);
        assert!(near.total > 0.1, "{}", near.total);
        assert!((near.total / far.total - 16.0).abs() < 0.01);
        // Relative to the cloud's own middle: the same head farther away weighs the same.
        let there = one_point(&anchor, 1.2, 0.0, 1.2);
        assert!((near.total - there.total).abs() < 1e-6);
        // At half the cut-off the biweight is (1 - 1/4)^2, and the gradient gives the distance.
        let off = one_point(&anchor, 0.6, 0.01, 0.6);
        assert!((off.total / near.total - 0.5625).abs() < 0.02);
        let distance = off.rows[5][7].abs() / (off.rows[5][5] * off.total).sqrt();
        assert!((distance - 0.01).abs() < 5e-4, "{distance}");
        // Beyond the cut-off: no weight, but counted as paired.
        let none = one_point(&anchor, 0.6, 0.021, 0.6);
        assert!(none.total == 0.0 && none.paired == [0, 0, 1] && none.points == 1);
    }

    #[test]
    fn the_normal_equations_point_back_to_the_surface() {
        // A point 5 mm before the surface: the step is back along the normal.
        let anchor = Anchor::new(&half_egg()).expect("a head");
        let sums = one_point(&anchor, 0.6, 0.005, 0.6);
        let along = sums.rows[5][7];
        // Normals of a face point to the camera, which is at negative z.
        assert!(along < 0.0 && along.abs() > sums.rows[3][7].abs().max(sums.rows[4][7].abs()));
        let (g, h) = (sums.rows[5][7], sums.rows[5][5]);
        assert!((-g / h - 0.005).abs() < 1e-3, "{}", -g / h);
    }

    #[test]
    fn middle_and_nose_are_classified() {
        let point = |x: f32, y: f32| Point::new(x, y, 0.0);
        for (x, y, middle, nose) in [
            (0.0, 0.02, true, true),
            (0.039, 0.0, true, false),
            (-0.039, 0.0, true, false),
            (0.041, 0.0, false, false),
            (-0.041, 0.0, false, false),
            (0.0, -0.031, false, false),
            (0.0, 0.069, true, false),
            (0.0, 0.071, false, false),
            (0.009, 0.044, true, true),
            (-0.011, 0.044, true, false),
            (0.0, 0.009, true, false),
        ] {
            assert_eq!(
                (is_middle(&point(x, y)), is_nose(&point(x, y))),
                (middle, nose),
                "{x} {y}"
            );
        }
    }

    #[test]
    fn the_middle_and_the_nose_end_at_their_bounds() {
        for (x, y, middle, nose) in [
            (0.039, 0.0, true, false),
            (0.040, 0.0, false, false),
            (0.0, -0.030, true, false),
            (0.0, 0.070, false, false),
            (0.009, 0.010, true, true),
            (0.010, 0.010, true, false),
            (0.0, 0.045, true, false),
        ] {
            let p = Point::new(x, y, 0.0);
            assert_eq!((is_middle(&p), is_nose(&p)), (middle, nose), "{x} {y}");
        }
    }

    #[test]
    fn the_share_of_the_face_that_is_covered_is_the_same_near_and_far() {
        let head = half_egg();
        let anchor = Anchor::new(&head).expect("a head");
        let shape = HeadShape::standard(anchor.points.len());
        // Of a head turned by 40 degrees, what faces the camera by so much and is above so much.
        let covered = |z: f32, facing: f32, most_y: f32| {
            let turn = Rotation::from_axis_angle(&Vector::y_axis(), 0.7);
            let pose = Rigid::from_parts(Vector::new(0.0, 0.0, z).into(), turn);
            let is_seen = |p: &Point, n: &Vector| {
                let ray = (pose * p).coords.normalize();
                p.y < most_y && (pose.rotation * n).dot(&ray) < -facing
            };
            let seen = head.iter().filter(|(p, n)| is_seen(p, n));
            let cloud: Vec<Point> = seen.map(|(p, _)| pose * p).collect();
            let fit = PlaneFit {
                head_from_sensor: HeadFromSensor::assume_frames(pose.inverse()),
                scale: 1.0,
                agreement: 1.0,
                agreement_above_beard: 1.0,
                support: 1.0,
                agreeing: 500,
                information: SMatrix::zeros(),
            };
            let mut hit = vec![false; anchor.points.len()];
            coverage(&anchor, &shape, &cloud, &fit, &mut hit).middle
        };
        // What looks away from the camera is not missed, and the upper half of the face is half.
        assert!(covered(0.7, 0.2, 1.0) > 0.99);
        let half = covered(0.7, 0.2, 0.02);
        assert!((0.4..0.7).contains(&half), "{half}");
        let [near, far] = [0.7, 2.1].map(|z| covered(z, 0.75, 1.0));
        assert!(near < 0.95 && (near - far).abs() < 0.05, "{near} {far}");
    }

    #[test]
    fn hair_has_support_but_no_agreement() {
        let head = half_egg();
        let anchor = Anchor::new(&head).expect("a head");
        let shape = HeadShape::standard(anchor.points.len());
        let pose = HeadFromSensor::assume_frames(Rigid::translation(0.0, 0.0, -0.75));
        let options = AlignOptions {
            cutoffs_m: &[0.01],
            stride: 1,
            hair_weight: 1.0,
            scale_sigma: 0.0,
        };
        let fit = |belongs: fn(&Point) -> bool| {
            let cloud: Vec<Point> = head
                .iter()
                .filter(|(p, _)| belongs(p))
                .map(|(p, _)| pose.inverse() * p)
                .collect();
            align(&anchor, &shape, &cloud, pose, &options).expect("enough points")
        };
        let hair = fit(|p| p.y < -0.06);
        assert_eq!((hair.agreement, hair.agreeing), (0.0, 0));
        assert!(hair.support > 0.5, "{}", hair.support);
        let face = fit(|p| p.y.abs() < 0.04 && p.x.abs() < 0.05);
        assert!(face.agreement > 0.9, "{}", face.agreement);
        // A beard 2 cm deep, from the mouth down.
        let cloud = head.iter().map(|(p, n)| match p.y {
            y if y > 0.06 => pose.inverse() * (p + n * 0.02),
            _ => pose.inverse() * p,
        });
        let cloud: Vec<Point> = cloud.collect();
        let bearded = align(&anchor, &shape, &cloud, pose, &options).expect("enough points");
        let (all, above) = (bearded.agreement, bearded.agreement_above_beard);
        assert!(all < 0.95 * above && above > 0.9, "{all} {above}");
    }

    #[test]
    fn a_planted_motion_about_three_axes_and_a_size_are_found() {
        let head = half_egg();
        let anchor = Anchor::new(&head).expect("a head");
        let shape = HeadShape::standard(anchor.points.len());
        let start = HeadFromSensor::assume_frames(Rigid::translation(0.0, 0.0, -0.75));
        let options = AlignOptions {
            cutoffs_m: &[0.03, 0.02, 0.02, 0.01, 0.01, 0.01, 0.01, 0.01],
            stride: 1,
            hair_weight: 1.0,
            scale_sigma: 0.2,
        };
        for (turn, shift, size) in [
            ([0.05, -0.04, 0.06], [0.004, -0.003, 0.005], 1.0),
            ([-0.03, 0.06, 0.04], [-0.005, 0.002, -0.004], 1.06),
            ([0.04, 0.05, -0.05], [0.0, 0.005, 0.003], 0.94),
        ] {
            let planted = Rigid::new(shift.into(), turn.into());
            let truth = HeadFromSensor::assume_frames(planted * *start);
            let cloud: Vec<Point> = head
                .iter()
                .map(|(p, _)| truth.inverse() * (p * size))
                .collect();
            let fit = align(&anchor, &shape, &cloud, start, &options).expect("enough points");
            let apart = *fit.head_from_sensor * *truth.inverse();
            let (turned, moved) = (apart.rotation.angle(), apart.translation.vector.norm());
            assert!(
                turned < 0.01 && moved < 0.001,
                "{turn:?} {size}: {turned} rad, {moved} m"
            );
            assert!((fit.scale - size).abs() < 0.005, "{} for {size}", fit.scale);
        }
    }

    #[test]
    fn the_least_weight_is_forty_points() {
        let anchor = Anchor::new(&half_egg()).expect("a head");
        let shape = HeadShape::standard(anchor.points.len());
        // On the surface, where trust is whole, and as deep as the cloud's middle.
        assert_eq!(one_point(&anchor, 0.6, 0.0, 0.6).total, 1.0);
        let (p, pose) = seen(&anchor, 0.6, 0.0);
        let is_enough = |stride: usize| {
            let options = AlignOptions {
                cutoffs_m: &[0.02],
                stride,
                hair_weight: 0.5,
                scale_sigma: 0.0,
            };
            align(&anchor, &shape, &[p], pose, &options).is_some()
        };
        assert!(!is_enough(39) && is_enough(40));
    }
}
