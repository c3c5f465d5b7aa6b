//! The output's adaptive low-pass: still faces are smoothed, fast expressions pass.
//!
//! Method: Casiez, Roussel, Vogel, *1 € filter: a simple speed-based low-pass filter for noisy input*, CHI 2012. The cutoff
//! rises with the measure's speed, here in ranges per second so that one setting serves all measures.
//! Latency: at rest about 1/(2π f_c), 50 ms at 3 Hz; at two ranges a second half of that. Memory: two numbers. Degenerate:
//! the first value passes as it is; a cutoff or range of 0 switches the
//! filter off.

/// Hz of cutoff per range per second of speed.
const CUTOFF_PER_SPEED: f64 = 1.5;
/// Cutoff of the speed's own low-pass, Hz.
const SPEED_CUTOFF_HZ: f64 = 1.5;

/// Filter of one measure.
#[derive(Clone, Debug, Default)]
pub struct OneEuro {
    last: Option<f64>,
    speed: f64,
}

fn share(cutoff_hz: f64, dt: f64) -> f64 {
    let r = core::f64::consts::TAU * cutoff_hz * dt;
    r / (r + 1.0)
}

impl OneEuro {
    /// Filters the next value; `range` is what counts as a full expression, `cutoff_hz` the cutoff at rest.
    pub fn filter(&mut self, g: f64, range: f64, cutoff_hz: f64, dt: f64) -> f64 {
        let Some(last) = self
            .last
            .filter(|_| cutoff_hz > 0.0 && dt > 0.0 && range > 0.0)
        else {
            self.last = Some(g);
            return g;
        };
        let speed = (g - last) / (dt * range);
        self.speed += (speed - self.speed) * share(SPEED_CUTOFF_HZ, dt);
        let cutoff = cutoff_hz + CUTOFF_PER_SPEED * self.speed.abs();
        let filtered = last + (g - last) * share(cutoff, dt);
        self.last = Some(filtered);
        filtered
    }

    /// Starts anew with the next value.
    pub fn reset(&mut self) {
        *self = Self::default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn smooths_rest_and_lets_a_step_pass() {
        let mut random = fastrand::Rng::with_seed(2);
        let mut filter = OneEuro::default();
        let (mut before, mut after) = (0.0, 0.0);
        for _ in 0..3000 {
            let g = 0.05 * (random.f64() - 0.5);
            before += g * g;
            after += filter.filter(g, 1.0, 2.0, 1.0 / 30.0).powi(2);
        }
        assert!(after < 0.35 * before, "variance {}", after / before);
        let steps: Vec<f64> = (0..5)
            .map(|_| filter.filter(1.0, 1.0, 2.0, 1.0 / 30.0))
            .collect();
        assert!(steps[2] > 0.85 && steps[4] > 0.97, "{steps:?}");
    }

    #[test]
    fn off_is_off() {
        let mut filter = OneEuro::default();
        for g in [0.0, 1.0, -3.0] {
            assert_eq!(filter.filter(g, 1.0, 0.0, 0.03), g);
        }
    }
}
