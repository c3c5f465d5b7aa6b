//! Infers the weights of a covered mouth from the time since it was last seen (the paper's future work).
//!
//! While depth shows something in front of the mouth and its points have low confidence, a mouth unit's weight is held at its
//! last value for [`HELD_S`] and then decays to rest with the time constant τ at which this person's mouth usually relaxes:
//! w(t) = w₀ e^(−t/τ), the expected weight given w₀. τ is learned from the visible mouth,
//! ρ = Σ w(t) w(t − [`LAG_S`]) / Σ w(t − [`LAG_S`])² = e^(−LAG_S/τ), starting at [`PRIOR_RHO`].
//!
//! The visible part of the face is not used: regressions of the mouth on brows, lids and nose change the error by less than a
//! hundredth on held-out people, or raise it (three recordings of real faces, six simulated people).
//!
//! Mean absolute error of the mouth's units, relative to holding them: 0.61 in the simulator, better for four of four people, at
//! worst 0.76; a mouth always at rest has 0.5
//! (`mien-studio evaluate --heads --rows mouth --people 4 --seconds 36`). In the second world's `occlude` the error is 0.038 in
//! the frames that change, against 0.050 measured through the hand; scenes without a hand do not change.
//!
//! A mouth that the picture does not show ([`crate::landmarks::visibility`]: a mask) is covered too, whatever depth says.
//!
//! Memory: three sets of weights. Cost: negligible. Degenerate: a mouth that stays covered decays to rest; one of permanently
//! low confidence (a beard) is covered by an object only below its usual confidence.

use super::regions::{MOUTH as MOUTH_REGION, RegionSet};
use crate::base::capacity::UNITS;
use crate::base::defaults;
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;
use crate::face_model::scheme::MOUTH;
use crate::landmarks::Landmarks;

/// Landmarks of brows, nose and eyes.
const OTHERS: core::ops::Range<usize> = 17..48;
/// A cover lowers the confidence of the mouth by this much more than that of the other points, which light, blur and distance
/// lower too.
const MOUTH_DEFICIT: f32 = 0.05;
/// Least share of the mouth's points behind an object for a mouth to become covered.
const HIDDEN: f32 = 0.3;
/// Least share of the mouth's points behind an object for a mouth to stay covered.
const HIDDEN_RELEASE: f32 = 0.1;
/// Mean confidence of the mouth's points for full trust. Under a hand it is 0.3 to 0.7; for a free mouth, turned by 35° or with
/// bushy hair, at least 0.70.
const FULL_TRUST: f32 = 0.70;
/// Confidence below full trust at which there is none.
const TRUST_FALLOFF: f32 = 0.06;
/// Additional confidence for trust in a mouth that was covered.
const HYSTERESIS: f32 = 0.13;
/// Where confidence is always low, the mouth is trusted down to this much below the person's usual confidence.
const BELOW_USUAL: f32 = 0.15;
/// Averaging time of the usual confidence, seconds.
const USUAL_S: f32 = 8.0;
/// Averaging time of the usual confidence, once known, while the mouth is covered, seconds.
const USUAL_COVERED_S: f32 = 60.0;
/// Weights are stored only while the mouth's confidence exceeds its limit by this much.
const STORE_MARGIN: f32 = 0.05;
/// Period of stored weights, seconds. Weights one to two periods old are used, because a cover is misread as an expression before
/// it is detected.
const STORE_PERIOD_S: f32 = 0.1;
/// Time for which the weights of a covered mouth are held, seconds.
const HELD_S: f32 = 0.1;
/// Fade to the measured weights once the mouth is visible again, seconds.
const RETURN_S: f32 = 0.15;
/// Time lag of ρ, seconds.
const LAG_S: f32 = 0.5;
/// ρ of the population.
const PRIOR_RHO: f32 = 0.29;
/// Weight of the population's ρ, as a sum of squared weights.
const PRIOR_RHO_WEIGHT: f32 = 4.0;
/// Bounds of ρ.
const RHO: [f32; 2] = [0.1, 0.8];
/// Sum of squared weights at which both sums are halved: minutes of acting.
const MAX_RHO_WEIGHT: f32 = 400.0;

defaults! {
    /// State of one person's mouth.
    #[derive(Clone, Debug)]
    pub(super) struct CoveredMouth {
        /// Mean confidence of the mouth.
        usual: f32 = 0.0,
        /// Seconds averaged in `usual`, up to [`USUAL_S`].
        known_s: f32 = 0.0,
        /// 0 (visible) to 1 (covered).
        covered: f32 = 0.0,
        /// Seconds since it was covered.
        covered_s: f32 = 0.0,
        /// Weights up to one and two [`STORE_PERIOD_S`] old.
        recent: [[f32; UNITS]; 2] = [[0.0; UNITS]; 2],
        recent_s: f32 = 0.0,
        /// Weights up to [`LAG_S`] old.
        lagged: [f32; UNITS] = [0.0; UNITS],
        lagged_s: f32 = 0.0,
        /// Σ w(t) w(t − LAG_S) and Σ w(t − LAG_S)².
        sums: [f32; 2] = [PRIOR_RHO * PRIOR_RHO_WEIGHT, PRIOR_RHO_WEIGHT],
    }
}

impl CoveredMouth {
    /// Updates the state from a frame; returns whether the mouth is visible and can be learned from.
    pub(super) fn update_visibility(&mut self, landmarks: &Landmarks, dt: f32) -> bool {
        let mean = |range: core::ops::Range<usize>| {
            let points = &landmarks.point_confidence[range];
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
        let trusted = (self.usual - BELOW_USUAL)
            .min(FULL_TRUST)
            .min(others - MOUTH_DEFICIT);
        let least = if is_covered {
            trusted + HYSTERESIS
        } else {
            trusted
        };
        // Light, distance and a bent head lower the confidence of a free mouth too, so depth must show an object before it.
        let hidden = landmarks.mouth_hidden >= if is_covered { HIDDEN_RELEASE } else { HIDDEN };
        let by_object = if hidden {
            ((least - seen) / TRUST_FALLOFF).clamp(0.0, 1.0)
        } else {
            0.0
        };
        let covered = by_object.max(1.0 - MOUTH_REGION.seen(&landmarks.seen));
        self.covered = covered.max(self.covered - dt / RETURN_S).max(0.0);
        if self.covered > 0.0 {
            self.covered_s += dt;
            // ρ needs visible weights at both ends of the lag.
            self.lagged_s = f32::NEG_INFINITY;
        } else {
            self.covered_s = 0.0;
        }
        if self.covered == 0.0 && seen > trusted + STORE_MARGIN {
            self.recent_s += dt;
        }
        self.covered == 0.0
    }

    /// Time constant at which this mouth relaxes, seconds.
    fn tau_s(&self) -> f32 {
        let [both, before] = self.sums;
        -LAG_S / (both / before).clamp(RHO[0], RHO[1]).ln()
    }

    /// Blends the weights of the mouth's columns with the inferred ones as far as the mouth is covered; otherwise learns from them.
    pub(super) fn infer_weights(
        &mut self,
        weights: &mut [f32],
        regions: &[RegionSet; UNITS],
        dt: f32,
    ) {
        let mouth = |k: &usize| regions[*k].intersects(MOUTH_REGION);
        if self.covered > 0.0 {
            let fades_s = (self.covered_s - HELD_S).max(0.0);
            let left = (-fades_s / self.tau_s()).exp();
            for k in (0..weights.len()).filter(mouth) {
                let inferred = self.recent[1][k] * left;
                weights[k] += (inferred - weights[k]) * self.covered;
            }
            return;
        }
        if self.recent_s >= STORE_PERIOD_S {
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
                if self.sums[1] > MAX_RHO_WEIGHT {
                    self.sums = self.sums.map(|sum| 0.5 * sum);
                }
            }
            self.lagged_s = 0.0;
            self.lagged[..weights.len()].copy_from_slice(weights);
        }
    }

    /// Marks a gap of frames.
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
            mouth_hidden: if mouth < FULL_TRUST { 1.0 } else { 0.0 },
            seen: [1.0; 6],
        };
        landmarks.point_confidence[MOUTH].fill(mouth);
        landmarks
    }

    /// One unit of the mouth and one that is not.
    const REGIONS: [RegionSet; UNITS] = {
        let mut regions = [RegionSet::NONE; UNITS];
        regions[0] = MOUTH_REGION;
        regions
    };

    fn play(mouth: &mut CoveredMouth, seen: f32, read: f32) -> [f32; 2] {
        mouth.update_visibility(&face(seen), DT);
        let mut weights = [read, 0.7];
        mouth.infer_weights(&mut weights, &REGIONS, DT);
        weights
    }

    #[test]
    fn a_visible_mouth_is_unchanged() {
        let mut mouth = CoveredMouth::default();
        for n in 0..600 {
            let read = if n % 60 < 20 { 0.8 } else { 0.0 };
            let seen = if n % 7 == 0 { 0.72 } else { 0.95 };
            assert_eq!(play(&mut mouth, seen, read), [read, 0.7]);
        }
    }

    #[test]
    fn a_dark_mouth_without_an_object_before_it_is_still_measured() {
        let mut mouth = CoveredMouth::default();
        let mut dim = face(0.3);
        dim.mouth_hidden = 0.0;
        for n in 0..300 {
            let read = if n % 60 < 20 { 0.8 } else { 0.0 };
            assert!(mouth.update_visibility(&dim, DT));
            let mut weights = [read, 0.7];
            mouth.infer_weights(&mut weights, &REGIONS, DT);
            assert_eq!(weights, [read, 0.7]);
        }
    }

    #[test]
    fn a_covered_mouth_is_held_then_decays_and_other_units_do_not() {
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
    fn long_smiles_decay_more_slowly() {
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
    fn low_confidence_of_all_points_is_no_covered_mouth() {
        let mut mouth = CoveredMouth::default();
        for n in 0..600 {
            let mut dark = face(0.95);
            if n > 300 {
                dark.point_confidence.fill(0.45);
            }
            mouth.update_visibility(&dark, DT);
            let mut weights = [0.4, 0.7];
            mouth.infer_weights(&mut weights, &REGIONS, DT);
            assert_eq!(weights, [0.4, 0.7]);
        }
    }

    #[test]
    fn permanently_low_confidence_is_no_covered_mouth() {
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
