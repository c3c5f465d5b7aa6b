//! Adaptive low-pass filter of one number: smooths it at rest, passes motion.
//!
//! Method: Casiez, Roussel, Vogel, *1 € filter: a simple speed-based low-pass filter for noisy input*, CHI 2012. The cutoff
//! rises with the number's speed. Memory: two numbers. Degenerate: the first value passes as it is.

use nalgebra::RealField;

/// Cut-off frequencies of the filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cutoffs<T> {
    /// Cutoff at rest, Hz.
    pub still_hz: T,
    /// Rise of the cutoff, Hz per unit of speed.
    pub per_speed: T,
    /// Cutoff of the speed's own low-pass, Hz.
    pub speed_hz: T,
}

/// Filter of one number.
#[derive(Clone, Copy, Debug, Default)]
pub struct OneEuro<T> {
    last: Option<T>,
    speed: T,
}

/// Gain of a first-order low-pass for one step of `dt` seconds.
fn gain<T: RealField + Copy>(cutoff_hz: T, dt: T) -> T {
    let r = T::two_pi() * cutoff_hz * dt;
    r / (r + T::one())
}

impl<T: RealField + Copy> OneEuro<T> {
    /// Filters the next value, `dt` > 0 seconds after the last; speeds are divided by `range`, the value's scale.
    pub fn filter(&mut self, value: T, range: T, cutoffs: &Cutoffs<T>, dt: T) -> T {
        let Some(last) = self.last else {
            return self.start(value);
        };
        let speed = (value - last) / (dt * range);
        self.speed += (speed - self.speed) * gain(cutoffs.speed_hz, dt);
        let cutoff = cutoffs.still_hz + cutoffs.per_speed * self.speed.abs();
        let filtered = last + (value - last) * gain(cutoff, dt);
        self.last = Some(filtered);
        filtered
    }

    /// Sets the filtered value; keeps the speed.
    pub fn start(&mut self, value: T) -> T {
        self.last = Some(value);
        value
    }

    /// Forgets value and speed.
    pub fn reset(&mut self) {
        (self.last, self.speed) = (None, T::zero());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CUTOFFS: Cutoffs<f64> = Cutoffs {
        still_hz: 2.0,
        per_speed: 1.5,
        speed_hz: 1.5,
    };

    #[test]
    fn smooths_rest_and_passes_a_step() {
        let mut random = fastrand::Rng::with_seed(2);
        let mut filter = OneEuro::default();
        let (mut before, mut after) = (0.0, 0.0);
        for _ in 0..3000 {
            let value = 0.05 * (random.f64() - 0.5);
            before += value * value;
            after += filter.filter(value, 1.0, &CUTOFFS, 1.0 / 30.0).powi(2);
        }
        assert!(after < 0.35 * before, "variance {}", after / before);
        let steps: Vec<f64> = (0..5)
            .map(|_| filter.filter(1.0, 1.0, &CUTOFFS, 1.0 / 30.0))
            .collect();
        assert!(steps[2] > 0.85 && steps[4] > 0.97, "{steps:?}");
    }

    #[test]
    fn filters_a_step_by_the_known_gain() {
        // A cutoff of 1 Hz without any rise, steps of a tenth of a second: 2π/10 over that and 1.
        let cutoffs = Cutoffs {
            still_hz: 1.0f32,
            per_speed: 0.0,
            speed_hz: 1.0,
        };
        let mut filter = OneEuro::default();
        assert_eq!(filter.filter(0.0, 1.0, &cutoffs, 0.1), 0.0);
        let step = filter.filter(1.0, 1.0, &cutoffs, 0.1);
        assert!((step - 0.385_87).abs() < 1e-5, "{step}");
        filter.reset();
        assert_eq!(filter.filter(5.0, 1.0, &cutoffs, 0.1), 5.0);
    }
}
