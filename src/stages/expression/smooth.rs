//! The output's low-pass: still faces are smoothed, expressions pass.
//!
//! A step within the noise is smoothed with the cutoff; the larger it is beside the noise the more of it is taken at once, and
//! all of one of eight deviations. So nothing that is seen clearly comes late. Latency: at rest about 1/(2π f_c), 50 ms at
//! 3 Hz; none of a clear expression. Degenerate: a cutoff of 0 switches the filter off.

/// Deviations of the noise from which a step is taken whole.
const CLEAR: f64 = 8.0;

/// Filter of one measure.
#[derive(Clone, Debug, Default)]
pub struct MeasureFilter(Option<f64>);

impl MeasureFilter {
    /// Filters the next value; `sigma` is the deviation of its noise, `cutoff_hz` the cutoff at rest.
    pub fn filter(&mut self, g: f64, sigma: f64, cutoff_hz: f64, dt: f64) -> f64 {
        let last = self.0.filter(|_| cutoff_hz > 0.0).unwrap_or(g);
        let r = core::f64::consts::TAU * cutoff_hz * dt;
        let clear = (g - last).abs() / (CLEAR * sigma);
        let gain = (r / (r + 1.0)).max(clear.min(1.0));
        *self.0.insert(last + (g - last) * gain)
    }

    /// Starts anew with the next value.
    pub fn reset(&mut self) {
        self.0 = None;
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

    #[test]
    fn a_clear_step_passes_at_once_and_noise_is_smoothed() {
        let mut filter = MeasureFilter::default();
        filter.filter(0.0, 0.01, 3.0, 1.0 / 30.0);
        let noise = filter.filter(0.01, 0.01, 3.0, 1.0 / 30.0);
        assert!(noise < 0.004, "{noise}");
        assert_eq!(filter.filter(0.3, 0.01, 3.0, 1.0 / 30.0), 0.3);
    }
}
