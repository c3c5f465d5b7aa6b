//! The output's adaptive low-pass ([`crate::base::one_euro`]): still faces are smoothed, fast expressions pass.
//!
//! Speeds are in ranges per second, so that one setting serves all measures. Latency: at rest about 1/(2π f_c), 50 ms at
//! 3 Hz; at two ranges a second half of that. Degenerate: a cutoff or range of 0 switches the filter off.

use crate::base::one_euro::{Cutoffs, OneEuro};

/// Hz of cutoff per range per second of speed.
const CUTOFF_PER_SPEED: f64 = 1.5;
/// Cutoff of the speed's own low-pass, Hz.
const SPEED_CUTOFF_HZ: f64 = 1.5;

/// Filter of one measure.
#[derive(Clone, Debug, Default)]
pub struct MeasureFilter(OneEuro<f64>);

impl MeasureFilter {
    /// Filters the next value; `range` is what counts as a full expression, `cutoff_hz` the cutoff at rest.
    pub fn filter(&mut self, g: f64, range: f64, cutoff_hz: f64, dt: f64) -> f64 {
        if cutoff_hz > 0.0 && dt > 0.0 && range > 0.0 {
            let cutoffs = Cutoffs {
                still_hz: cutoff_hz,
                per_speed: CUTOFF_PER_SPEED,
                speed_hz: SPEED_CUTOFF_HZ,
            };
            self.0.filter(g, range, &cutoffs, dt)
        } else {
            self.0.start(g)
        }
    }

    /// Starts anew with the next value.
    pub fn reset(&mut self) {
        self.0.reset();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn off_is_off() {
        let mut filter = MeasureFilter::default();
        for g in [0.0, 1.0, -3.0] {
            assert_eq!(filter.filter(g, 1.0, 0.0, 0.03), g);
        }
    }
}
