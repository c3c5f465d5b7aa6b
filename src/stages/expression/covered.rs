//! Infers the weights of a covered mouth from the time since it was last seen (the paper's future work).
//!
//! While depth shows something in front of the mouth and its points have low confidence, a mouth unit's weight is held at its
//! last value for [`HELD_S`] and then decays to rest with the time constant τ at which this person's mouth usually relaxes:
//! w(t) = w₀ e^(−t/τ), the expected weight given w₀. τ is learned from the visible mouth,
//! ρ = Σ w(t) w(t − [`LAG_S`]) / Σ w(t − [`LAG_S`])² = e^(−LAG_S/τ), starting at [`USUAL_RHO`].
//!
//! The visible part of the face is not used: regressions of the mouth on brows, lids and nose change the error by less than a
//! hundredth on held-out people, or raise it (three recordings of real faces, six simulated people).
//!
//! Mean absolute error of the mouth's units, relative to holding them: 0.61 in our simulator, better for four of four people, at
//! worst 0.76; a mouth always at rest has 0.5, so half of the error of holding is out of reach
//! (`mien-studio evaluate --heads --rows mouth --people 4 --seconds 36`). In the second world's `occlude` the error is 0.038 in
//! the frames that change, against 0.050 measured through the hand; scenes without a hand do not change.
//!
//! Memory: three sets of weights. Cost: negligible. Degenerate: a mouth that stays covered is at rest; one that is always
//! hard to see, as under a beard or a mask, counts as covered only where it is harder to see than usual.

use super::measures::Measure;
use crate::base::capacity::UNITS;
use crate::base::defaults;
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;
use crate::face_model::scheme::{CHIN, MOUTH};
use crate::landmarks::Landmarks;

/// Points of brows, nose and eyes.
const OTHERS: core::ops::Range<usize> = 17..48;
/// Light, blur and distance lower the confidence of all points; a cover lowers that of the mouth by this much more.
const HARDER: f32 = 0.05;
/// Share of its points with something in front that makes the mouth count as covered, and that keeps it so.
const HIDDEN: f32 = 0.3;
const STILL_HIDDEN: f32 = 0.1;
/// Their mean confidence up from which they are believed wholly, and how much below they are not at all. Under a hand it is 0.3 to
/// 0.7; of people who act with a free mouth, turning by 35° or with bushy hair, it is 0.70 at least.
const BELIEVED: f32 = 0.70;
const DISBELIEVED_BELOW: f32 = 0.06;
/// What counted as covered has to be seen better than that by this much to be believed again.
const HYSTERESIS: f32 = 0.13;
/// Where confidence is always low, points this far below the person's usual confidence are not trusted;
const UNUSUAL: f32 = 0.15;
/// so long it takes to know what is usual, with a mouth that is seen and, once that is known, with one that is not, seconds.
const USUAL_S: f32 = 8.0;
const USUAL_COVERED_S: f32 = 60.0;
/// Weights are stored only while the mouth's confidence exceeds the limit by this much.
const SURE: f32 = 0.05;
/// How far back they are stored, seconds (one to two of this): a cover is read as an expression before it is noticed.
const BACK_S: f32 = 0.1;
/// Time for which a covered mouth is held, seconds.
const HELD_S: f32 = 0.1;
/// Seconds over which the measured weights fade back in once the mouth is visible again.
const RETURN_S: f32 = 0.15;
/// Distance in time at which ρ is learnt, seconds; what it is of people at large, and how much of their own outweighs that.
const LAG_S: f32 = 0.5;
const USUAL_RHO: f32 = 0.29;
const USUAL_RHO_WORTH: f32 = 4.0;
/// Bounds of ρ.
const RHO: [f32; 2] = [0.1, 0.8];
/// Products beyond which the older ones count half: minutes of acting.
const MOST_WORTH: f32 = 400.0;

/// Whether a measure belongs to the mouth, or to what a hand over the mouth covers too: the chin, and the cheeks, which have no
/// landmarks.
pub(super) fn is_of_mouth(measure: Measure) -> bool {
    let covers = |point: usize| MOUTH.contains(&point) || CHIN.contains(&point);
    measure.groups().is_empty() || measure.landmarks().any(covers)
}

defaults! {
    /// One person's mouth.
    #[derive(Clone, Debug)]
    pub(super) struct CoveredMouth {
        /// Confidence that is usual, and for how long it was looked at.
        usual: f32 = 0.0,
        known_s: f32 = 0.0,
        /// 0: seen; 1: covered.
        covered: f32 = 0.0,
        covered_s: f32 = 0.0,
        /// Weights up to one and two [`BACK_S`] old.
        recent: [[f32; UNITS]; 2] = [[0.0; UNITS]; 2],
        recent_s: f32 = 0.0,
        /// Weights of [`LAG_S`] ago at most.
        lagged: [f32; UNITS] = [0.0; UNITS],
        lagged_s: f32 = 0.0,
        /// Σ w(t) w(t − LAG_S) and Σ w(t − LAG_S)².
        sums: [f32; 2] = [USUAL_RHO * USUAL_RHO_WORTH, USUAL_RHO_WORTH],
    }
}

impl CoveredMouth {
    /// Judges a frame: whether the mouth is visible, and can thus be learned from.
    pub(super) fn look(&mut self, landmarks: &Landmarks, dt: f32) -> bool {
        let mean = |of: core::ops::Range<usize>| {
            let points = &landmarks.point_confidence[of];
            points.iter().sum::<f32>() / points.len() as f32
        };
        let (seen, others) = (mean(MOUTH), mean(OTHERS));
        let is_covered = self.covered > 0.0;
        self.known_s = (self.known_s + dt).min(USUAL_S);
        let takes_s = if is_covered && self.known_s >= USUAL_S {
            USUAL_COVERED_S
        } else {
            self.known_s
        };
        if takes_s > 0.0 {
            self.usual += (seen - self.usual) * (dt / takes_s);
        }
        let believed = (self.usual - UNUSUAL).min(BELIEVED).min(others - HARDER);
        let least = if is_covered {
            believed + HYSTERESIS
        } else {
            believed
        };
        // Changing light, distance and a bent head make a free mouth hard to see too: depth says whether something is before it.
        let hidden = landmarks.mouth_hidden >= if is_covered { STILL_HIDDEN } else { HIDDEN };
        let covered = if hidden {
            ((least - seen) / DISBELIEVED_BELOW).clamp(0.0, 1.0)
        } else {
            0.0
        };
        self.covered = covered.max(self.covered - dt / RETURN_S).max(0.0);
        if self.covered > 0.0 {
            self.covered_s += dt;
            // What is compared with the past has to be seen at both ends.
            self.lagged_s = f32::NEG_INFINITY;
        } else {
            self.covered_s = 0.0;
        }
        if self.covered == 0.0 && seen > believed + SURE {
            self.recent_s += dt;
        }
        self.covered == 0.0
    }

    /// Time constant at which this mouth relaxes, seconds.
    fn tau_s(&self) -> f32 {
        let [both, before] = self.sums;
        -LAG_S / (both / before).clamp(RHO[0], RHO[1]).ln()
    }

    /// Replaces the weights of the mouth's columns, `is_mouth`, as far as it is covered; otherwise learns from them.
    pub(super) fn weigh(&mut self, weights: &mut [f32], is_mouth: &[bool; UNITS], dt: f32) {
        let mouth = |k: &usize| is_mouth[*k];
        if self.covered > 0.0 {
            let fades_s = (self.covered_s - HELD_S).max(0.0);
            let left = (-fades_s / self.tau_s()).exp();
            for k in (0..weights.len()).filter(mouth) {
                let inferred = self.recent[1][k] * left;
                weights[k] += (inferred - weights[k]) * self.covered;
            }
            return;
        }
        if self.recent_s >= BACK_S {
            self.recent_s = 0.0;
            self.recent[1] = self.recent[0];
            self.recent[0][..weights.len()].copy_from_slice(weights);
        }
        self.lagged_s += dt;
        if self.lagged_s >= LAG_S || self.lagged_s == f32::NEG_INFINITY {
            if self.lagged_s >= LAG_S {
                for k in (0..weights.len()).filter(mouth) {
                    self.sums[0] += weights[k] * self.lagged[k];
                    self.sums[1] += self.lagged[k] * self.lagged[k];
                }
                if self.sums[1] > MOST_WORTH {
                    self.sums = self.sums.map(|sum| 0.5 * sum);
                }
            }
            self.lagged_s = 0.0;
            self.lagged[..weights.len()].copy_from_slice(weights);
        }
    }

    /// Frames were missing.
    pub(super) fn interrupt(&mut self) {
        self.lagged_s = f32::NEG_INFINITY;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::capacity::LANDMARKS;
    use crate::base::geometry::Point;

    const DT: f32 = 1.0 / 30.0;

    fn face(mouth: f32) -> Landmarks {
        let mut landmarks = Landmarks {
            head: [Point::origin(); LANDMARKS],
            pixels: [[0.0; 2]; LANDMARKS],
            point_confidence: [0.95; LANDMARKS],
            confidence: 1.0,
            cheeks: [0.0; 2],
            eyes: None,
            mouth_hidden: if mouth < BELIEVED { 1.0 } else { 0.0 },
        };
        landmarks.point_confidence[MOUTH].fill(mouth);
        landmarks
    }

    /// One unit of the mouth and one that is not.
    const IS_MOUTH: [bool; UNITS] = {
        let mut is_mouth = [false; UNITS];
        is_mouth[0] = true;
        is_mouth
    };

    fn play(mouth: &mut CoveredMouth, seen: f32, read: f32) -> [f32; 2] {
        mouth.look(&face(seen), DT);
        let mut weights = [read, 0.7];
        mouth.weigh(&mut weights, &IS_MOUTH, DT);
        weights
    }

    #[test]
    fn a_mouth_that_is_seen_is_left_as_it_is() {
        let mut mouth = CoveredMouth::default();
        for n in 0..600 {
            let read = if n % 60 < 20 { 0.8 } else { 0.0 };
            let seen = if n % 7 == 0 { 0.72 } else { 0.95 };
            assert_eq!(play(&mut mouth, seen, read), [read, 0.7]);
        }
    }

    #[test]
    fn a_mouth_in_bad_light_with_nothing_before_it_is_read_on() {
        let mut mouth = CoveredMouth::default();
        let mut dim = face(0.3);
        dim.mouth_hidden = 0.0;
        for n in 0..300 {
            let read = if n % 60 < 20 { 0.8 } else { 0.0 };
            assert!(mouth.look(&dim, DT));
            let mut weights = [read, 0.7];
            mouth.weigh(&mut weights, &IS_MOUTH, DT);
            assert_eq!(weights, [read, 0.7]);
        }
    }

    #[test]
    fn under_a_hand_the_mouth_stays_for_a_moment_and_then_goes_to_rest_and_nothing_else_does() {
        let mut mouth = CoveredMouth::default();
        for _ in 0..60 {
            play(&mut mouth, 0.95, 0.8);
        }
        // The hand reads as something else.
        let covered: Vec<[f32; 2]> = (0..60).map(|_| play(&mut mouth, 0.4, 0.3)).collect();
        assert!(covered.iter().all(|[_, other]| *other == 0.7));
        assert!((covered[0][0] - 0.8).abs() < 1e-6, "{:?}", covered[0]);
        assert!(covered.windows(2).all(|two| two[1][0] <= two[0][0]));
        assert!((0.1..0.7).contains(&covered[20][0]), "{:?}", covered[20]);
        // Seen again it is read again, within a sixth of a second.
        let back: Vec<f32> = (0..8).map(|_| play(&mut mouth, 0.95, 0.3)[0]).collect();
        assert!((back[6] - 0.3).abs() < 1e-6, "{back:?}");
    }

    #[test]
    fn who_smiles_for_long_is_taken_to_go_on_smiling() {
        let left = |period: usize| {
            let mut mouth = CoveredMouth::default();
            for n in 0..30 * 120 {
                let read = if (n / period).is_multiple_of(2) {
                    0.8
                } else {
                    0.0
                };
                play(&mut mouth, 0.95, read);
            }
            for _ in 0..30 {
                play(&mut mouth, 0.95, 0.8);
            }
            (0..25).map(|_| play(&mut mouth, 0.3, 0.0)[0]).last()
        };
        let (short, long) = (left(12), left(150));
        assert!(
            long > Some(0.35) && short < Some(0.15),
            "{short:?} {long:?}"
        );
    }

    #[test]
    fn a_face_that_is_hard_to_see_all_over_has_no_covered_mouth() {
        let mut mouth = CoveredMouth::default();
        for n in 0..600 {
            let mut dark = face(0.95);
            if n > 300 {
                dark.point_confidence.fill(0.45);
            }
            mouth.look(&dark, DT);
            let mut weights = [0.4, 0.7];
            mouth.weigh(&mut weights, &IS_MOUTH, DT);
            assert_eq!(weights, [0.4, 0.7]);
        }
    }

    #[test]
    fn a_mouth_that_is_always_hard_to_see_is_not_covered() {
        let mut mouth = CoveredMouth::default();
        for _ in 0..1800 {
            assert_eq!(play(&mut mouth, 0.5, 0.4)[0], 0.4);
        }
        for _ in 0..3 {
            play(&mut mouth, 0.1, 0.9);
        }
        assert!(play(&mut mouth, 0.1, 0.9)[0] < 0.6, "a hand before it");
    }
}
