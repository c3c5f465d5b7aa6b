//! Motion of an input without expression: leakage of the head's rotation and distance, and drift.
//!
//! Landmarks slide slightly on a face as the head turns or moves away, differently on each face, and a resting face drifts. Both are
//! learnt per input near rest: the slope of its deviation over the head's motion by recursive ridge regression, in which expressions
//! are outliers of little weight (M-estimation; Geman & McClure 1987), and the standard deviation s of the remainder d. The
//! slope is subtracted in proportion to its evidence, unless rest is no better for it. Of the remainder, d · d²/(d² + s²) is
//! kept: the shrinkage of a sparse signal in noise. s grows with the distance of the motion from its mean, where slopes are not constant,
//! and beyond [`NEAR_M`] with the square of the distance, as the noise of depth does and as pixels there become few.
//!
//! Deviations in eye distances; motion: a rotation vector (radians) and the scaled logarithm of the distance, about the person's mean.
//! Memory: 224 bytes an input. Cost: a Cholesky decomposition of 4 × 4 a frame and input. Degenerate: without evidence only the
//! shrinkage applies.

use nalgebra::{Cholesky, Matrix4, Vector3, Vector4};

use crate::base::defaults;
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;

/// Deviation at which [`outlying`] is 0.5, eye distances.
const OUTLYING: f64 = 0.03;
/// Penalty on slopes: squared motion times seconds.
const PENALTY: f64 = 0.2 / 30.0;
/// Factor on the logarithm of the distance, which varies more than rotations do.
const LN_DISTANCE_SCALE: f64 = 0.5;
/// Limit of a component of the motion.
const FARTHEST: f64 = 0.6;
/// Motion from the mean at which the standard deviation is doubled.
const DOUBLES: f64 = 0.15;
/// Distance up to which a face is large in the picture, metres.
const NEAR_M: f64 = 1.0;
/// Distance beyond that at which the standard deviation is doubled, metres.
const FAR_DOUBLES_M: f64 = 0.5;
/// Seconds of rest at which half of the slope is subtracted.
const HALF_KNOWN_S: f64 = 6.7;
/// Initial standard deviation, eye distances.
const ASSUMED: f64 = 0.015;
/// Time constant of the standard deviation, seconds.
const DEVIATION_S: f64 = 6.7;
/// Ratio of a normal variable's standard deviation to its mean magnitude.
const SIZE_TO_DEVIATION: f64 = 1.25;
/// Time constant of the mean motion, seconds.
const MEAN_S: f64 = 30.0;

/// A person's usual rotation and distance.
#[derive(Clone, Debug, Default)]
pub(super) struct HeadMotion {
    mean: Vector4<f64>,
    seconds: f64,
}

impl HeadMotion {
    /// The motion of a head with this rotation vector (radians) at a distance (metres).
    pub(super) fn at(rotation: &Vector3<f64>, distance_m: f64) -> Vector4<f64> {
        rotation.push(LN_DISTANCE_SCALE * distance_m.max(0.1).ln())
    }

    /// A motion relative to the mean, clamped to [`FARTHEST`] per component.
    pub(super) fn about_mean(&self, motion: &Vector4<f64>) -> Vector4<f64> {
        (motion - self.mean).map(|component| component.clamp(-FARTHEST, FARTHEST))
    }

    /// Adds a frame's motion.
    pub(super) fn observe(&mut self, motion: &Vector4<f64>, dt: f64) {
        self.seconds = (self.seconds + dt).min(MEAN_S);
        if self.seconds > 0.0 {
            self.mean += (motion - self.mean) * (dt / self.seconds);
        }
    }
}

defaults! {
    /// Learned head-motion leakage and drift of one input.
    #[derive(Clone, Copy, Debug)]
    pub(super) struct HeadMotionLeak {
        gram: Matrix4<f64> = Matrix4::zeros(),
        right: Vector4<f64> = Vector4::zeros(),
        slope: Vector4<f64> = Vector4::zeros(),
        seconds: f64 = 0.0,
        deviation: f64 = ASSUMED,
        /// Accumulated [`outlying`] with the slope subtracted, and without.
        costs: [f64; 2] = [0.0; 2],
    }
}

/// Outlier measure of a deviation: 0 at rest, 1 far from it.
fn outlying(deviation: f64) -> f64 {
    let square = deviation * deviation;
    square / (square + OUTLYING * OUTLYING)
}

impl HeadMotionLeak {
    /// A deviation without the effect of head rotation.
    fn without_head_motion(&self, deviation: f64, motion: &Vector4<f64>) -> f64 {
        deviation - self.seconds / (self.seconds + HALF_KNOWN_S) * self.slope.dot(motion)
    }

    /// The part of a deviation that is expression, at a distance in metres.
    pub(super) fn expression_part(
        &self,
        deviation: f64,
        motion: &Vector4<f64>,
        distance_m: f64,
    ) -> f64 {
        let [with, without] = self.costs;
        let deviation = if with < without {
            self.without_head_motion(deviation, motion)
        } else {
            deviation
        };
        let square = deviation * deviation;
        let far = (distance_m - NEAR_M).max(0.0) / FAR_DOUBLES_M;
        let spread = self.deviation * (1.0 + motion.norm() / DOUBLES + far * far);
        deviation * square / (square + spread * spread)
    }

    /// Learns from a frame's deviation; older evidence is halved every `half_life_s` (0: never).
    pub(super) fn observe(
        &mut self,
        deviation: f64,
        motion: &Vector4<f64>,
        dt: f64,
        half_life_s: f64,
    ) {
        let left = self.without_head_motion(deviation, motion);
        let kept = if half_life_s > 0.0 {
            (-dt / half_life_s).exp2()
        } else {
            1.0
        };
        let is_rest = (1.0 - outlying(left)).powi(2) * dt;
        self.gram = self.gram * kept + motion * motion.transpose() * is_rest;
        self.right = self.right * kept + motion * (deviation * is_rest);
        self.seconds = self.seconds * kept + is_rest;
        self.costs = [
            self.costs[0] * kept + outlying(left) * dt,
            self.costs[1] * kept + outlying(deviation) * dt,
        ];
        self.deviation +=
            (SIZE_TO_DEVIATION * left.abs() - self.deviation) * (is_rest / DEVIATION_S);
        let gram = self.gram + Matrix4::from_diagonal_element(PENALTY);
        if let Some(gram) = Cholesky::new(gram) {
            self.slope = gram.solve(&self.right);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT: f64 = 1.0 / 30.0;

    /// A minute of a nodding head whose deviation is `rest` of its pitch; every fifth second an expression of `acts`.
    fn a_minute(rest: impl Fn(f64) -> f64, acts: f64) -> HeadMotionLeak {
        let mut resting = HeadMotionLeak::default();
        for frame in 0..1800 {
            let seconds = f64::from(frame) * DT;
            let motion = Vector4::new(0.1 * (0.7 * seconds).sin(), 0.0, 0.0, 0.0);
            let act = if frame / 30 % 5 == 4 { acts } else { 0.0 };
            resting.observe(rest(motion.x) + act, &motion, DT, 300.0);
        }
        resting
    }

    #[test]
    fn leakage_of_a_nod_is_removed() {
        let nod = Vector4::new(0.1, 0.0, 0.0, 0.0);
        let resting = a_minute(|pitch| 0.2 * pitch, 0.15);
        assert!(resting.expression_part(0.02, &nod, 0.7).abs() < 0.002);
        assert!((resting.expression_part(0.17, &nod, 0.7) - 0.15).abs() < 0.01);
        // Without observed nods there is no correction.
        assert!(HeadMotionLeak::default().expression_part(0.17, &nod, 0.7) > 0.165);
    }

    #[test]
    fn evidence_is_worth_half_after_a_half_life() {
        let before = a_minute(|pitch| 0.2 * pitch, 0.15);
        let mut after = before;
        // Ten seconds at rest, of a head that looks ahead.
        after.observe(0.0, &Vector4::zeros(), 10.0, 10.0);
        assert_eq!(after.gram, before.gram * 0.5);
        assert_eq!(after.right, before.right * 0.5);
        assert!((after.seconds - (0.5 * before.seconds + 10.0)).abs() < 1e-9);
        assert_eq!(after.costs, before.costs.map(|cost| 0.5 * cost));
        // A second at three hundredths, where it counts as half an expression.
        let mut surprised = HeadMotionLeak::default();
        surprised.observe(OUTLYING, &Vector4::zeros(), 1.0, 0.0);
        assert_eq!(surprised.costs, [0.5; 2]);
    }

    #[test]
    fn large_deviations_pass_and_drift_shrinks() {
        let still = Vector4::zeros();
        let resting = a_minute(|_| 0.01, 0.0);
        assert!(resting.expression_part(0.15, &still, 0.7) > 0.145);
        assert!(resting.expression_part(0.01, &still, 0.7) < 0.005);
    }

    #[test]
    fn leakage_of_distance_is_removed_and_far_motion_is_noise() {
        let (mut leak, mut mean) = (HeadMotionLeak::default(), HeadMotion::default());
        let at = |distance_m| HeadMotion::at(&Vector3::zeros(), distance_m);
        let rest = |distance_m: f64| 0.05 * (distance_m - 1.0);
        for frame in 0..3600 {
            let distance_m = 1.0 + 0.2 * (0.01 * f64::from(frame)).sin();
            mean.observe(&at(distance_m), DT);
            leak.observe(
                rest(distance_m),
                &mean.about_mean(&at(distance_m)),
                DT,
                300.0,
            );
        }
        let motion = mean.about_mean(&at(1.2));
        assert!(leak.expression_part(rest(1.2), &motion, 0.7).abs() < 0.002);
        // The same deviation in a turned face says less.
        let turned = Vector4::new(0.5, 0.0, 0.0, 0.0);
        let leak = HeadMotionLeak::default();
        let near = leak.expression_part(0.03, &Vector4::zeros(), 0.7);
        assert!(leak.expression_part(0.03, &turned, 0.7) < 0.5 * near);
        // As it does far away.
        let still = Vector4::zeros();
        assert_eq!(leak.expression_part(0.03, &still, 1.0), near);
        assert!(leak.expression_part(0.03, &still, 1.8) < 0.5 * near);
    }

    #[test]
    fn a_useless_slope_is_not_subtracted() {
        let mut resting = a_minute(|pitch| 0.2 * pitch, 0.0);
        let nod = Vector4::new(0.1, 0.0, 0.0, 0.0);
        let before = resting.expression_part(0.1, &nod, 0.7);
        // Costs under which subtracting the slope makes rest no better.
        resting.costs = [1.0, 0.5];
        assert!(resting.expression_part(0.1, &nod, 0.7) > before + 0.01);
    }
}
