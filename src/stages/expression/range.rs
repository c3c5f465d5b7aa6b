//! A measure's range and the resulting weight: the last step of both learning methods.
//!
//! Soft dead zone: e = g − rest, w = max(|e| − δ, 0)/(side − δ) with the sign of e, so resting noise up to δ gives exactly 0
//! and the full expression still gives 1. With δ = 0 it is equation (8) from rest, and equation (9), of Jiang Na et al.
//! Continuous and monotone for any nodes. Units of the measure in, weights out. Degenerate: δ is capped at 0.35 of the side.

use super::units::{Kind, Prior};

/// Learnt or assumed nodes of a measure, `low ≤ rest ≤ high`; on a side without a unit the node equals rest.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Range {
    /// Full falling expression (g_min).
    pub low: f64,
    /// Neutral (g_rest; g_min or g_max of a one-way unit).
    pub rest: f64,
    /// Full rising expression (g_max).
    pub high: f64,
}

/// Largest dead zone, as a share of its side.
const DEAD_ZONE_SHARE: f64 = 0.35;

impl Range {
    /// The population's range.
    pub fn from_prior(prior: &Prior, kind: Kind) -> Self {
        Self {
            low: prior.rest - if kind.falls() { prior.down } else { 0.0 },
            rest: prior.rest,
            high: prior.rest + if kind.rises() { prior.up } else { 0.0 },
        }
    }

    /// Interpolates to another range: 0 is self, 1 the other.
    #[must_use]
    pub fn towards(self, other: Self, share: f64) -> Self {
        let mix = |a: f64, b: f64| a + (b - a) * share;
        Self {
            low: mix(self.low, other.low),
            rest: mix(self.rest, other.rest),
            high: mix(self.high, other.high),
        }
    }

    /// Widened on each side to at least the other's width.
    #[must_use]
    pub fn at_least_as_wide_as(self, other: &Self) -> Self {
        Self {
            low: self.low.min(self.rest - (other.rest - other.low)),
            rest: self.rest,
            high: self.high.max(self.rest + (other.high - other.rest)),
        }
    }

    /// Signed weight: positive above rest, negative below, 0 on a side without a unit, beyond ±1 exaggerated. `dead_zone` in the unit of
    /// the measure.
    pub fn weight(&self, g: f64, kind: Kind, dead_zone: f64) -> f64 {
        let side = |e: f64, side: f64| {
            let dead = dead_zone.clamp(0.0, DEAD_ZONE_SHARE * side.max(0.0));
            if side > dead {
                (e - dead).max(0.0) / (side - dead)
            } else {
                0.0
            }
        };
        let e = g - self.rest;
        if e >= 0.0 {
            if kind.rises() {
                side(e, self.high - self.rest)
            } else {
                0.0
            }
        } else if kind.falls() {
            -side(-e, self.rest - self.low)
        } else {
            0.0
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RANGE: Range = Range {
        low: 1.0,
        rest: 2.0,
        high: 6.0,
    };

    #[test]
    fn without_a_dead_zone_it_is_equation_8_or_9() {
        for (g, expected) in [
            (2.0, 0.0),
            (4.0, 0.5),
            (8.0, 1.5),
            (1.5, -0.5),
            (1.0, -1.0),
            (0.5, -1.5),
        ] {
            assert_eq!(RANGE.weight(g, Kind::TwoWay, 0.0), expected, "{g}");
        }
        let [rising, falling] = [1.0, 5.0].map(|rest| Range {
            low: 1.0,
            rest,
            high: 5.0,
        });
        for (g, rises, falls) in [(3.0, 0.5, -0.5), (7.0, 1.5, 0.0), (0.0, 0.0, -1.25)] {
            assert_eq!(rising.weight(g, Kind::Rising, 0.0), rises, "{g}");
            assert_eq!(falling.weight(g, Kind::Falling, 0.0), falls, "{g}");
        }
    }

    #[test]
    fn dead_zone_keeps_both_ends() {
        let w = |g| RANGE.weight(g, Kind::TwoWay, 0.2);
        for g in [2.0, 2.19, 1.81] {
            assert_eq!(w(g), 0.0);
        }
        assert!((w(6.0) - 1.0).abs() < 1e-12 && (w(1.0) + 1.0).abs() < 1e-12);
        assert!((w(4.1) - 0.5).abs() < 1e-12);
        // A huge one is cut to 0.35 of the side: (0.5 − 0.35)/0.65.
        assert!((RANGE.weight(1.5, Kind::TwoWay, 9.0) + 0.15 / 0.65).abs() < 1e-12);
    }

    #[test]
    fn monotone_for_any_nodes() {
        let mut random = fastrand::Rng::with_seed(3);
        for _ in 0..200 {
            let rest = random.f64();
            let range = Range {
                low: rest - random.f64(),
                rest,
                high: rest + random.f64(),
            };
            let dead = 0.5 * random.f64();
            for kind in [Kind::Rising, Kind::Falling, Kind::TwoWay] {
                let mut last = f64::NEG_INFINITY;
                for i in 0..300 {
                    let w = range.weight(-1.0 + 0.01 * f64::from(i), kind, dead);
                    assert!(w >= last && w.is_finite());
                    last = w;
                }
            }
        }
    }

    #[test]
    fn collapsed_sides_give_nothing() {
        let range = Range {
            low: 1.0,
            rest: 1.0,
            high: 1.0,
        };
        assert_eq!(range.weight(3.0, Kind::TwoWay, 0.0), 0.0);
        assert_eq!(RANGE.weight(0.0, Kind::Rising, 0.0), 0.0);
        assert_eq!(RANGE.weight(5.0, Kind::Falling, 0.0), 0.0);
    }
}
