//! Low-pass of the output: smooths still faces, passes expressions.
//!
//! A step within the noise is smoothed with the cut-off; the gain grows with the step's ratio to the noise, up to 1 at eight
//! standard deviations. Latency: at rest about 1/(2π f_c), 50 ms at 3 Hz; none for a clear expression. Degenerate: a cut-off of
//! 0 disables the filter.

/// Step of gain 1, standard deviations of the noise.
const CLEAR: f64 = 8.0;

/// Filter of one measure.
#[derive(Clone, Debug, Default)]
pub struct MeasureFilter(Option<f64>);

impl MeasureFilter {
    /// Filters the next value, `dt` seconds after the last; `sigma`: standard deviation of its noise, `cutoff_hz`: cut-off at rest.
    pub fn filter(&mut self, g: f64, sigma: f64, cutoff_hz: f64, dt: f64) -> f64 {
        let last = self.0.filter(|_| cutoff_hz > 0.0).unwrap_or(g);
        let r = core::f64::consts::TAU * cutoff_hz * dt;
        let clear = (g - last).abs() / (CLEAR * sigma);
        let gain = (r / (r + 1.0)).max(clear.min(1.0));
        *self.0.insert(last + (g - last) * gain)
    }

    /// Restarts with the next value.
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
        // 2π · 3 Hz / 30 Hz = 0.628, and 0.628 / 1.628 of a hundredth.
        assert!((noise - 0.003_859).abs() < 1e-6, "{noise}");
        assert_eq!(filter.filter(0.3, 0.01, 3.0, 1.0 / 30.0), 0.3);
    }
}
