//! What an input does while nothing is expressed: it moves with the head, and it strays.
//!
//! Points slide a little on a face as the head turns, on each face in a way of its own, and what is seen of a resting face is never
//! quite still. Both are learnt per input, from whatever is near rest: the departure's slope over the head's rotation by
//! recursive ridge regression, in which expressions, as outliers, hardly count (M-estimation; Geman & McClure 1987), and
//! the mean size of what is left. The slope is taken off, the more the longer it has been learnt, unless that makes rest no better.
//! Of the remainder d with deviation s, d · d²/(d² + s²) is kept: the shrinkage of a sparse signal in noise.
//!
//! Departures in eye distances, rotations in radians about the person's mean. Memory: 160 bytes an input. Cost: a Cholesky
//! decomposition of 3 × 3 a frame and input. Degenerate: without evidence a departure is only shrunk.

use nalgebra::{Cholesky, Matrix3, Vector3};

use crate::base::defaults;
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;

/// Departure at which an expression outweighs rest, eye distances.
const OUTLYING: f64 = 0.03;
/// Penalty on slopes, rad² s.
const PENALTY: f64 = 0.2 / 30.0;
/// Turns beyond this are taken for no more: far out, slopes bend. Radians.
const FARTHEST: f64 = 0.15;
/// Seconds of rest at which half of the slope is taken off.
const HALF_KNOWN_S: f64 = 6.7;
/// Deviation assumed at first, eye distances, and the time constant of its mean, seconds.
const ASSUMED: f64 = 0.015;
const DEVIATION_S: f64 = 6.7;
/// From the mean size of a normal variable to its deviation.
const SIZE_TO_DEVIATION: f64 = 1.25;
/// Time constant of the mean rotation, seconds.
const MEAN_S: f64 = 30.0;

/// The rotation of a head about the person's mean.
#[derive(Clone, Debug, Default)]
pub(super) struct Turn {
    mean: Vector3<f64>,
    seconds: f64,
}

impl Turn {
    /// A rotation (axis times angle) about the mean, bounded.
    pub(super) fn about_mean(&self, rotation: &Vector3<f64>) -> Vector3<f64> {
        (rotation - self.mean).map(|turn| turn.clamp(-FARTHEST, FARTHEST))
    }

    pub(super) fn observe(&mut self, rotation: &Vector3<f64>, dt: f64) {
        self.seconds = (self.seconds + dt).min(MEAN_S);
        if self.seconds > 0.0 {
            self.mean += (rotation - self.mean) * (dt / self.seconds);
        }
    }
}

defaults! {
    /// One input's rest.
    #[derive(Clone, Copy, Debug)]
    pub(super) struct Resting {
        gram: Matrix3<f64> = Matrix3::zeros(),
        right: Vector3<f64> = Vector3::zeros(),
        slope: Vector3<f64> = Vector3::zeros(),
        seconds: f64 = 0.0,
        deviation: f64 = ASSUMED,
        /// How far from rest with the slope taken off, and without.
        costs: [f64; 2] = [0.0; 2],
    }
}

/// 0 at rest, 1 far from it.
fn outlying(departure: f64) -> f64 {
    let square = departure * departure;
    square / (square + OUTLYING * OUTLYING)
}

impl Resting {
    /// A departure without what the head's turn explains.
    fn straightened(&self, departure: f64, turn: &Vector3<f64>) -> f64 {
        departure - self.seconds / (self.seconds + HALF_KNOWN_S) * self.slope.dot(turn)
    }

    /// What of a departure is expression.
    pub(super) fn expressed(&self, departure: f64, turn: &Vector3<f64>) -> f64 {
        let [with, without] = self.costs;
        let departure = if with < without {
            self.straightened(departure, turn)
        } else {
            departure
        };
        let square = departure * departure;
        departure * square / (square + self.deviation * self.deviation)
    }

    /// Learns from a frame's departure; what was learnt halves in `half_life_s` (0: never).
    pub(super) fn observe(
        &mut self,
        departure: f64,
        turn: &Vector3<f64>,
        dt: f64,
        half_life_s: f64,
    ) {
        let left = self.straightened(departure, turn);
        let kept = if half_life_s > 0.0 {
            (-dt / half_life_s).exp2()
        } else {
            1.0
        };
        let is_rest = (1.0 - outlying(left)).powi(2) * dt;
        self.gram = self.gram * kept + turn * turn.transpose() * is_rest;
        self.right = self.right * kept + turn * (departure * is_rest);
        self.seconds = self.seconds * kept + is_rest;
        self.costs = [
            self.costs[0] * kept + outlying(left) * dt,
            self.costs[1] * kept + outlying(departure) * dt,
        ];
        self.deviation +=
            (SIZE_TO_DEVIATION * left.abs() - self.deviation) * (is_rest / DEVIATION_S);
        let gram = self.gram + Matrix3::from_diagonal_element(PENALTY);
        if let Some(gram) = Cholesky::new(gram) {
            self.slope = gram.solve(&self.right);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT: f64 = 1.0 / 30.0;

    /// A minute of a nodding head whose departure is `rest` of its pitch; every fifth second an expression of `acts`.
    fn a_minute(rest: impl Fn(f64) -> f64, acts: f64) -> Resting {
        let mut resting = Resting::default();
        for frame in 0..1800 {
            let seconds = f64::from(frame) * DT;
            let turn = Vector3::new(0.1 * (0.7 * seconds).sin(), 0.0, 0.0);
            let act = if frame / 30 % 5 == 4 { acts } else { 0.0 };
            resting.observe(rest(turn.x) + act, &turn, DT, 300.0);
        }
        resting
    }

    #[test]
    fn what_a_nod_does_to_a_brow_is_no_expression() {
        let nod = Vector3::new(0.1, 0.0, 0.0);
        let resting = a_minute(|pitch| 0.2 * pitch, 0.15);
        assert!(resting.expressed(0.02, &nod).abs() < 0.002);
        assert!((resting.expressed(0.17, &nod) - 0.15).abs() < 0.01);
        // Nobody who has not been seen nodding is corrected.
        assert!(Resting::default().expressed(0.17, &nod) > 0.165);
    }

    #[test]
    fn a_large_departure_stays_and_a_stray_shrinks() {
        let still = Vector3::zeros();
        let resting = a_minute(|_| 0.01, 0.0);
        assert!(resting.expressed(0.15, &still) > 0.145);
        assert!(resting.expressed(0.01, &still) < 0.005);
    }

    #[test]
    fn a_slope_that_does_not_help_is_not_taken_off() {
        let mut resting = a_minute(|pitch| 0.2 * pitch, 0.0);
        let nod = Vector3::new(0.1, 0.0, 0.0);
        let before = resting.expressed(0.1, &nod);
        // From now on the head's turn means nothing; the regression would still remember.
        resting.costs = [1.0, 0.5];
        assert!(resting.expressed(0.1, &nod) > before + 0.01);
    }
}
