//! Compensating samples: one on each side of an observation that is not fully trusted.
//!
//! Method: Jiang Na et al., section 2.3. The true value behind an observation s of weight ω is N(s, σ²), σ = −ln ω. For
//! ω < 1 each side gets a sample of weight (1 − ω)/2 at s' = s ± σ √(2 ln(2ω/(1 − ω))), where the Gaussian density is to
//! that at s as the weights are. Units: those of s. No state.
//! Degenerate: ω ≥ 1 needs no compensation; ω < 1/3 has no solution (the compensating weight would exceed the
//! observation's), the sample is invalid.
//!
//! σ = −ln ω has no unit, and measures differ: at ω = 0.9 the literal offset is 0.25 w, more than a lid opens. The factor
//! `spread` gives it a unit: 1 is the literal form, a share of the measure's range the scaled one. Mean error of the paper's
//! weights on the acted sessions of `tests/it/learns_a_range.rs`, jitter 0.25 %, ω = 0.94, after 5 / 20 / 60 s:
//!
//! | σ | one-way units | two-way units |
//! | --- | --- | --- |
//! | literal | 0.253 / 0.426 / 0.419 | 0.243 / 0.143 / 0.158 |
//! | 0.5 × range | 0.177 / 0.301 / 0.281 | 0.406 / 0.473 / 0.419 |
//! | 0.25 × range | 0.172 / 0.290 / 0.264 | 0.410 / 0.430 / 0.421 |
//! | 0.1 × range | 0.169 / 0.286 / 0.257 | 0.415 / 0.507 / 0.463 |
//! | none | 0.168 / 0.284 / 0.255 | 0.415 / 0.464 / 0.437 |
//!
//! Literal is the default of the paper's method: it is best over all units. On two-way units that is coincidence: its far
//! samples give the three-node merging of section 2.6 its ends, which come from σ and not from the person (at 2 m and 28° they
//! are two to three times too far). For one-way units scaling is better. The robust method does not compensate, because there
//! it made no difference.

#[cfg(not(feature = "std"))]
use crate::base::prelude::*;

/// Samples with a smaller weight are invalid.
pub const LEAST_WEIGHT: f64 = 1.0 / 3.0;

/// Offset and weight of the two compensating samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Compensation {
    /// |s' − s|, in the unit of the measure.
    pub offset: f64,
    /// Weight of each sample, (1 − ω)/2.
    pub weight: f64,
}

/// Section 2.3 for one weight ω; `spread` multiplies σ (1 = literal). `None` if the sample is invalid (ω < 1/3 or NaN). The weight
/// is 0 at ω ≥ 1.
pub fn compensation(omega: f64, spread: f64) -> Option<Compensation> {
    let sigma = -omega.ln() * spread;
    // At ω = 1/3 the logarithm is 0 up to rounding.
    let ratio = (2.0 * (2.0 * omega / (1.0 - omega)).ln()).max(0.0);
    (omega >= LEAST_WEIGHT).then(|| Compensation {
        offset: sigma * ratio.sqrt(),
        weight: ((1.0 - omega) / 2.0).max(0.0),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn compensated(omega: f64, spread: f64) -> Compensation {
        compensation(omega, spread).expect("a valid weight")
    }

    #[test]
    fn literal_offsets() {
        for (omega, offset) in [
            (0.95, 0.139),
            (0.9, 0.253),
            (0.8, 0.455),
            (0.65, 0.698),
            (0.5, 0.816),
        ] {
            assert!(
                (compensated(omega, 1.0).offset - offset).abs() < 1e-3,
                "{omega}"
            );
        }
        assert!(
            (compensated(0.5, 1.0).offset - 2f64.ln() * (2.0 * 2f64.ln()).sqrt()).abs() < 1e-12
        );
    }

    #[test]
    fn densities_have_the_ratio_of_the_weights() {
        for omega in [0.35, 0.5, 0.7, 0.9, 0.99] {
            let c = compensated(omega, 1.0);
            let sigma = -f64::ln(omega);
            let density_ratio = (0.5 * (c.offset / sigma).powi(2)).exp();
            assert!(
                (density_ratio - omega / c.weight).abs() < 1e-9 * density_ratio,
                "{omega}"
            );
            assert!((omega + 2.0 * c.weight - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn one_third_is_the_least_weight() {
        assert_eq!(compensation(0.333, 1.0), None);
        assert_eq!(compensation(f64::NAN, 1.0), None);
        assert_eq!(compensated(1.0, 1.0).weight, 0.0);
        let c = compensated(1.0 / 3.0 + 1e-12, 1.0);
        assert!(c.offset < 1e-5 && (c.weight - 1.0 / 3.0).abs() < 1e-9);
    }

    #[test]
    fn spread_scales_the_offset_only() {
        let (a, b) = (compensated(0.8, 1.0), compensated(0.8, 0.1));
        assert!((b.offset - 0.1 * a.offset).abs() < 1e-12 && b.weight == a.weight);
    }
}
