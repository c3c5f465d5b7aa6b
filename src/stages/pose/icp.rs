//! Rigid point-to-point ICP: the motion that aligns one cloud with another.
//!
//! Method: Algorithm 1 of the paper (section 1.1, step 2); iterative closest point after Besl & McKay 1992 with the rotation
//! by singular value decomposition (Arun, Huang & Blostein 1987), its reflection guard (Umeyama 1991), and trimmed pairs
//! (Chetverikov et al. 2002). Steps of the algorithm:
//!
//! 1. C2' = nearest neighbour in C1 of each point of C2 ([`Target`], a k-d tree); pairs beyond a distance and the worst
//!    share of the rest are rejected, because the clouds overlap only in part;
//! 2. – 4. [`rigid_from_pairs`]: with column vectors M = 1/n Σ (C2'ᵢ − C2'm)(C2ᵢ − C2m)ᵀ = U W Vᵀ,
//!    R = U diag(1, 1, det(U Vᵀ)) Vᵀ and t = C2'm − R C2m. The paper's t = C2'm − C2m R mixes row and column vectors,
//!    and without the guard a flat or noisy set of pairs can give a mirror image;
//! 5. move C2, repeat until the step is below [`Settings::stop_m`] or the iterations are used up.
//!
//! Frames and units: both clouds in metres, in any two frames; the result maps the moving cloud's frame to the target's.
//! Cost: n log n per iteration (n² without `std`, which the tree needs) and some tens of iterations: along the surface
//! convergence is slow, so steps in the same direction are extrapolated ([`Step`]). Memory: a tree per target and one pair
//! per moving point. Degenerate: fewer than [`MIN_PAIRS`] pairs give `None`; pairs on one line leave the
//! rotation about it undetermined (a proper rotation is still given). Limitation: finds the nearest minimum only, and on
//! quantised depth it stops up to a degree short of it: the pose stage uses it as the paper's reference method.

#[cfg(feature = "std")]
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use nalgebra::{Matrix3, Rotation3, Vector3};

use crate::base::defaults;
use crate::base::geometry::{Point, Rigid, Rotation, Vector};
use crate::base::prelude::*;

/// Fewer pairs than this do not determine a rigid motion reliably.
pub const MIN_PAIRS: usize = 12;

defaults! {
    /// Limits of the search.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct Settings {
        /// Maximum number of iterations.
        pub iterations: u32 = 400,
        /// Pairs further apart are rejected, metres.
        pub max_distance_m: f32 = 0.03,
        /// Share of the remaining pairs that is kept, nearest first, 0…1.
        pub keep: f32 = 0.85,
        /// Converged when no point of a head-sized cloud moves more than this in one iteration, metres.
        pub stop_m: f32 = 1e-5,
    }
}

/// Result of an alignment.
#[derive(Clone, Copy, Debug)]
pub struct Alignment {
    /// Maps the moving cloud onto the target.
    pub target_from_moving: Rigid,
    /// Root mean square distance of the pairs kept in the last iteration, metres.
    pub residual: f32,
    /// Share of the moving points that have a pair within the allowed distance, 0…1.
    pub paired: f32,
    /// Iterations done.
    pub iterations: u32,
}

/// The fixed cloud, prepared for nearest-neighbour queries.
pub struct Target {
    #[cfg(feature = "std")]
    tree: ImmutableKdTree<f32, 3>,
    points: Vec<Point>,
}

impl Target {
    /// Builds the tree of points in metres. `None` if there are fewer than [`MIN_PAIRS`] or they coincide.
    pub fn new(points: &[Point]) -> Option<Self> {
        if points.len() < MIN_PAIRS {
            return None;
        }
        #[cfg(feature = "std")]
        let coordinates: Vec<[f32; 3]> = points.iter().map(|p| [p.x, p.y, p.z]).collect();
        Some(Self {
            #[cfg(feature = "std")]
            tree: ImmutableKdTree::new_from_slice(&coordinates).ok()?,
            points: points.to_vec(),
        })
    }

    /// Index of the nearest point and its squared distance, square metres.
    #[cfg(feature = "std")]
    pub fn nearest(&self, p: &Point) -> (usize, f32) {
        let found = self
            .tree
            .query(&[p.x, p.y, p.z])
            .nearest_one::<SquaredEuclidean<f32>>()
            .execute();
        (found.item as usize, found.distance)
    }

    /// Index of the nearest point and its squared distance, square metres, by exhaustive search.
    #[cfg(not(feature = "std"))]
    pub fn nearest(&self, p: &Point) -> (usize, f32) {
        let distances = self.points.iter().map(|point| (point - p).norm_squared());
        let nearest = distances.enumerate().min_by(|a, b| a.1.total_cmp(&b.1));
        nearest.expect("at least MIN_PAIRS points")
    }
}

/// A pair: indices of the moving and the target point, and their squared distance, square metres.
#[derive(Clone, Copy, Debug)]
struct Pair {
    moving: u32,
    target: u32,
    distance2: f32,
}

/// Buffer of pairs, kept between calls.
#[derive(Default)]
pub struct Scratch(Vec<Pair>);

/// Steps 2 to 4: the rigid motion that minimises the squared distances of `(target, moving)` pairs. Sums in f64.
/// `None` if there are no pairs or they are not finite.
pub fn rigid_from_pairs(pairs: impl Iterator<Item = (Point, Point)> + Clone) -> Option<Rigid> {
    let to_f64 = |p: Point| p.coords.cast::<f64>();
    let (mut n, mut target_mean, mut moving_mean) = (0.0, Vector3::zeros(), Vector3::zeros());
    for (target, moving) in pairs.clone() {
        target_mean += to_f64(target);
        moving_mean += to_f64(moving);
        n += 1.0;
    }
    if n == 0.0 {
        return None;
    }
    target_mean /= n;
    moving_mean /= n;
    let mut m = Matrix3::<f64>::zeros();
    for (target, moving) in pairs {
        m += (to_f64(target) - target_mean) * (to_f64(moving) - moving_mean).transpose();
    }
    m /= n;
    if !m.iter().all(|c| c.is_finite()) {
        return None;
    }
    let svd = m.svd(true, true);
    let (u, v_t) = (svd.u?, svd.v_t?);
    // Flipping the direction of the least spread is the cheapest way to a proper rotation (Umeyama); nalgebra sorts singular
    // values downwards, so it is the last one.
    let guard = Vector3::new(1.0, 1.0, (u * v_t).determinant().signum());
    let r = u * Matrix3::from_diagonal(&guard) * v_t;
    let t = target_mean - r * moving_mean;
    let rotation = Rotation::from_rotation_matrix(&Rotation3::from_matrix_unchecked(r.cast()));
    Some(Rigid::from_parts(t.cast::<f32>().into(), rotation))
}

/// The step of one iteration.
#[derive(Clone, Copy)]
struct Step {
    /// Rotation vector, radians.
    turn: Vector,
    /// Motion of `middle`, metres.
    moved: Vector,
    /// A point of the cloud before the step, metres.
    middle: Point,
}

impl Step {
    /// Remaining motion if steps shrink geometrically, as along a smooth surface; `None` unless this step has the direction of
    /// `last`. The accelerated ICP of Besl and McKay 1992, with a geometric series instead of a parabola.
    fn extrapolate(&self, last: &Self) -> Option<Rigid> {
        let six = |step: &Self| (step.turn * HEAD_RADIUS_M, step.moved);
        let ((turn, moved), (last_turn, last_moved)) = (six(self), six(last));
        let along = turn.dot(&last_turn) + moved.dot(&last_moved);
        let size = (turn.norm_squared() + moved.norm_squared()).sqrt();
        let last_size = (last_turn.norm_squared() + last_moved.norm_squared()).sqrt();
        if along < MIN_STEP_COSINE * size * last_size {
            return None;
        }
        let ratio = (size / last_size.max(f32::MIN_POSITIVE)).min(MAX_STEP_RATIO);
        let remaining = ratio / (1.0 - ratio);
        let rotation = Rotation::new(self.turn * remaining);
        let shift = self.middle.coords + self.moved * remaining - rotation * self.middle.coords;
        Some(Rigid::from_parts(shift.into(), rotation))
    }
}

/// Least cosine of the angle between two steps in the same direction.
const MIN_STEP_COSINE: f32 = 0.97;
/// Largest ratio of successive steps that is extrapolated.
const MAX_STEP_RATIO: f32 = 0.92;

/// Step 1: pairs each moving point, at `pose`, with its nearest target point up to the squared distance `limit`.
fn pair_up(target: &Target, moving: &[Point], pose: &Rigid, limit: f32, pairs: &mut Vec<Pair>) {
    pairs.clear();
    for (k, p) in moving.iter().enumerate() {
        let (index, distance2) = target.nearest(&(pose * p));
        if distance2 <= limit {
            pairs.push(Pair {
                moving: k as u32,
                target: index as u32,
                distance2,
            });
        }
    }
}

/// Algorithm 1: aligns `moving` with `target` from `start` (target from moving, metres). `None` with fewer than [`MIN_PAIRS`] pairs
/// within the distance.
pub fn align(
    target: &Target,
    moving: &[Point],
    start: Rigid,
    settings: &Settings,
    scratch: &mut Scratch,
) -> Option<Alignment> {
    let pairs = &mut scratch.0;
    let limit = settings.max_distance_m * settings.max_distance_m;
    let mut pose = start;
    let (mut residual, mut paired, mut iterations) = (0.0, 0.0, 0);
    let mut last: Option<Step> = None;
    while iterations < settings.iterations {
        iterations += 1;
        pair_up(target, moving, &pose, limit, pairs);
        paired = pairs.len() as f32 / moving.len().max(1) as f32;
        let keep = (pairs.len() as f32 * settings.keep.clamp(0.0, 1.0)) as usize;
        if keep < MIN_PAIRS {
            return None;
        }
        pairs.select_nth_unstable_by(keep - 1, |a, b| a.distance2.total_cmp(&b.distance2));
        let kept = &pairs[..keep];
        residual =
            (kept.iter().map(|p| f64::from(p.distance2)).sum::<f64>() / keep as f64).sqrt() as f32;
        let step_pairs = kept.iter().map(|p| {
            (
                target.points[p.target as usize],
                pose * moving[p.moving as usize],
            )
        });
        // The step is measured at the cloud, not at the distant origin.
        let middle = pose * moving[kept[0].moving as usize];
        let step = rigid_from_pairs(step_pairs)?;
        pose = step * pose;
        let moved = step * middle - middle;
        let shift = moved.norm() + step.rotation.angle() * HEAD_RADIUS_M;
        if shift < settings.stop_m {
            break;
        }
        let iteration = Step {
            turn: step.rotation.scaled_axis(),
            moved,
            middle,
        };
        last = match last.and_then(|last| iteration.extrapolate(&last)) {
            Some(rest) => {
                pose = rest * pose;
                None
            }
            None => Some(iteration),
        };
    }
    pose.rotation.renormalize();
    Some(Alignment {
        target_from_moving: pose,
        residual,
        paired,
        iterations,
    })
}

/// Lever that converts a rotation to the path of a point on a head, metres.
const HEAD_RADIUS_M: f32 = 0.1;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::geometry::rotation_from_yaw_pitch_roll;

    fn random_point(rng: &mut fastrand::Rng, scale: f32) -> Point {
        Point::new(rng.f32() - 0.5, rng.f32() - 0.5, rng.f32() - 0.5) * scale
    }

    #[test]
    fn halving_steps_are_extrapolated_and_others_are_not() {
        let step = |turn: f32, moved: f32| Step {
            turn: Vector::y() * turn,
            moved: Vector::x() * moved,
            middle: Point::new(0.0, 0.0, 1.0),
        };
        let rest = step(0.01, 0.002)
            .extrapolate(&step(0.02, 0.004))
            .expect("a rest");
        assert!((rest.rotation.scaled_axis() - Vector::y() * 0.01).norm() < 1e-6);
        let middle = rest * Point::new(0.0, 0.0, 1.0);
        assert!((middle - Point::new(0.002, 0.0, 1.0)).norm() < 1e-6);
        for other in [step(-0.02, -0.004), step(0.0, 0.02), step(-0.02, 0.004)] {
            assert!(step(0.01, 0.002).extrapolate(&other).is_none());
        }
    }

    /// Points some 25 mm apart throughout a box: a motion of less than half of that leaves nearly every point nearest to
    /// its own place, so the basin is known. (On a smooth surface point-to-point stops short; the pose tests measure it.)
    fn scattered() -> Vec<Point> {
        let mut rng = fastrand::Rng::with_seed(9);
        let mut points = Vec::new();
        for i in 0..8 {
            for j in 0..8 {
                for k in 0..8 {
                    let grid = Point::new(i as f32, j as f32, k as f32) * 0.025;
                    points
                        .push(grid + random_point(&mut rng, 0.012).coords - Vector::repeat(0.0875));
                }
            }
        }
        points
    }

    #[test]
    fn pairs_give_back_any_planted_motion() {
        let mut rng = fastrand::Rng::with_seed(1);
        for _ in 0..200 {
            let planted = Rigid::from_parts(
                (Vector::new(rng.f32(), rng.f32(), rng.f32()) * 2.0).into(),
                rotation_from_yaw_pitch_roll(
                    rng.f32() * 6.0,
                    rng.f32() * 3.0 - 1.5,
                    rng.f32() * 6.0,
                ),
            );
            let moving: Vec<Point> = (0..30).map(|_| random_point(&mut rng, 0.2)).collect();
            let found = rigid_from_pairs(moving.iter().map(|p| (planted * p, *p))).unwrap();
            let apart = planted.inverse() * found;
            assert!(apart.rotation.angle() < 1e-4, "{}", apart.rotation.angle());
            assert!((planted * moving[0] - found * moving[0]).norm() < 1e-5);
        }
    }

    #[test]
    fn a_mirrored_cloud_never_gives_a_reflection() {
        let mut rng = fastrand::Rng::with_seed(2);
        for _ in 0..100 {
            let moving: Vec<Point> = (0..20).map(|_| random_point(&mut rng, 0.2)).collect();
            let found =
                rigid_from_pairs(moving.iter().map(|p| (Point::new(-p.x, p.y, p.z), *p))).unwrap();
            let matrix = found.rotation.to_rotation_matrix();
            assert!((matrix.matrix().determinant() - 1.0).abs() < 1e-4);
            // Best proper motion: no other turn may do better.
            let cost = |r: &Rigid| -> f32 {
                moving
                    .iter()
                    .map(|p| (r * p - Point::new(-p.x, p.y, p.z)).norm_squared())
                    .sum()
            };
            let best = cost(&found);
            for _ in 0..20 {
                let nudge = Rotation::new(random_point(&mut rng, 0.1).coords);
                let centre = moving.iter().map(|p| (found * p).coords).sum::<Vector>() / 20.0;
                let other = Rigid::rotation_wrt_point(nudge, centre.into()) * found;
                assert!(cost(&other) >= best * 0.9999);
            }
        }
    }

    #[test]
    fn icp_recovers_planted_motions_in_its_basin() {
        let head = scattered();
        let target = Target::new(&head).unwrap();
        let mut scratch = Scratch::default();
        let settings = Settings {
            iterations: 400,
            keep: 1.0,
            stop_m: 1e-6,
            ..Settings::default()
        };
        let mut rng = fastrand::Rng::with_seed(3);
        for _ in 0..12 {
            let axis = random_point(&mut rng, 1.0).coords.normalize();
            let planted = Rigid::new(random_point(&mut rng, 0.006).coords, axis * 0.08);
            // Planted motion taken out of the cloud: the alignment has to put it back.
            let moving: Vec<Point> = head.iter().map(|p| planted.inverse() * p).collect();
            let found =
                align(&target, &moving, Rigid::identity(), &settings, &mut scratch).unwrap();
            let apart = planted.inverse() * found.target_from_moving;
            assert!(
                apart.rotation.angle() < 0.08 / 200.0,
                "{} rad left",
                apart.rotation.angle()
            );
            assert!(apart.translation.vector.norm() < 1e-5);
        }
    }

    #[test]
    fn outliers_in_the_cloud_are_trimmed() {
        let head = scattered();
        let target = Target::new(&head).unwrap();
        let planted = Rigid::new(
            Vector::new(0.003, -0.002, 0.004),
            Vector::new(0.05, 0.08, -0.03),
        );
        let mut moving: Vec<Point> = head.iter().map(|p| planted.inverse() * p).collect();
        let mut rng = fastrand::Rng::with_seed(4);
        for _ in 0..60 {
            // A hand in front of the face.
            moving.push(Point::new(0.0, 0.03, -0.30) + random_point(&mut rng, 0.1).coords);
        }
        let settings = Settings {
            iterations: 400,
            stop_m: 1e-6,
            keep: 0.95,
            ..Settings::default()
        };
        let found = align(
            &target,
            &moving,
            Rigid::identity(),
            &settings,
            &mut Scratch::default(),
        )
        .unwrap();
        let apart = planted.inverse() * found.target_from_moving;
        assert!(
            apart.rotation.angle() < 0.02,
            "{} rad left",
            apart.rotation.angle()
        );
        assert!(found.paired < 0.97);
    }

    #[test]
    fn stops_after_the_given_iterations() {
        let head = scattered();
        let target = Target::new(&head).unwrap();
        let moving: Vec<Point> = head.iter().map(|p| p + Vector::repeat(0.004)).collect();
        for iterations in [1, 3] {
            let settings = Settings {
                iterations,
                stop_m: 0.0,
                ..Settings::default()
            };
            let mut scratch = Scratch::default();
            let found = align(&target, &moving, Rigid::identity(), &settings, &mut scratch);
            assert_eq!(found.expect("an alignment").iterations, iterations);
        }
    }

    #[test]
    fn too_little_to_align_is_none() {
        assert!(Target::new(&[Point::origin(); 3]).is_none());
        let target = Target::new(&scattered()).unwrap();
        let far = vec![Point::new(0.0, 0.0, 5.0); 50];
        let mut scratch = Scratch::default();
        assert!(
            align(
                &target,
                &far,
                Rigid::identity(),
                &Settings::default(),
                &mut scratch
            )
            .is_none()
        );
        assert!(
            align(
                &target,
                &[],
                Rigid::identity(),
                &Settings::default(),
                &mut scratch
            )
            .is_none()
        );
    }

    #[test]
    fn keeps_the_given_share_of_pairs() {
        let head = scattered();
        let target = Target::new(&head).unwrap();
        let mut rng = fastrand::Rng::with_seed(8);
        // Every other point a few millimetres off.
        let mut moving = head.clone();
        for point in moving.iter_mut().step_by(2) {
            *point += random_point(&mut rng, 0.008).coords;
        }
        let mut residual = |keep: f32| {
            let settings = Settings {
                keep,
                ..Settings::default()
            };
            let mut scratch = Scratch::default();
            let found = align(&target, &moving, Rigid::identity(), &settings, &mut scratch);
            found.expect("an alignment").residual
        };
        let [half, most, all] = [0.45, 0.85, 1.0].map(&mut residual);
        assert!(
            half < 0.3 * most && most < 0.95 * all,
            "{half} {most} {all}"
        );
    }

    /// Iterations with the default settings if `motion` is all that has to be put back: the first step does it.
    fn iterations_for(points: &[Point], motion: Rigid) -> u32 {
        let target = Target::new(points).unwrap();
        let moving: Vec<Point> = points.iter().map(|p| motion.inverse() * p).collect();
        let (settings, mut scratch) = (Settings::default(), Scratch::default());
        let found = align(&target, &moving, Rigid::identity(), &settings, &mut scratch);
        found.expect("an alignment").iterations
    }

    #[test]
    fn stops_at_a_step_below_a_hundredth_of_a_millimetre() {
        for (shift_m, iterations) in [(7e-6, 1), (1.4e-5, 2)] {
            let motion = Rigid::translation(shift_m, 0.0, 0.0);
            assert_eq!(iterations_for(&scattered(), motion), iterations);
        }
    }

    #[test]
    fn rotations_count_with_a_lever_of_a_tenth_of_a_metre() {
        // A cloud of a centimetre: its own points move by a tenth of that path at most.
        let small: Vec<Point> = scattered().iter().map(|p| p * 0.06).collect();
        for (turn_rad, iterations) in [(7e-5, 1), (1.4e-4, 2)] {
            let motion = Rigid::rotation(Vector::y() * turn_rad);
            assert_eq!(iterations_for(&small, motion), iterations);
        }
    }
}
