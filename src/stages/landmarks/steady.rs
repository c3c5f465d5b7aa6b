//! Temporal filter of the shape: removes jitter from a still face, tracks a moving one without delay.
//!
//! Each shape coefficient has its own first-order filter whose gain grows with the coefficient's speed
//! ([`crate::base::one_euro`]). Parameters are filtered rather than points, so the filtered face is still a face.
//! Latency: under one frame at a deviation per 0.2 s; a step of 0.1 deviations takes about 0.25 s. Seconds, standard
//! deviations. Degenerate: after a gap the filter restarts.

use crate::base::one_euro::{Cutoffs, OneEuro};
use crate::base::time::Timestamp;
use crate::face_model::MAX_MODES;

/// Longest gap the filter bridges, seconds.
const GAP_S: f64 = 0.5;

/// The filter's state.
#[derive(Clone, Debug)]
pub struct ShapeFilter {
    cutoffs: Cutoffs<f32>,
    filters: [OneEuro<f32>; MAX_MODES],
    last: Option<Timestamp>,
}

impl ShapeFilter {
    /// A filter without history.
    pub fn new(cutoffs: Cutoffs<f32>) -> Self {
        Self {
            cutoffs,
            filters: [OneEuro::default(); MAX_MODES],
            last: None,
        }
    }

    /// Forgets everything.
    pub fn reset(&mut self) {
        self.last = None;
    }

    /// Adds a measured shape (standard deviations) and returns the filtered one.
    pub fn follow(&mut self, measured: &[f32; MAX_MODES], at: Timestamp) -> [f32; MAX_MODES] {
        let step = self.last.map(|last| at.seconds_since(last));
        self.last = Some(at);
        let Some(step) = step.filter(|s| *s > 0.0 && *s < GAP_S) else {
            for (filter, b) in self.filters.iter_mut().zip(measured) {
                filter.reset();
                filter.start(*b);
            }
            return *measured;
        };
        core::array::from_fn(|i| {
            self.filters[i].filter(measured[i], 1.0, &self.cutoffs, step as f32)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn after_half_a_second_or_a_step_back_the_filter_starts_anew() {
        let cutoffs = Cutoffs {
            still_hz: 1.0,
            per_speed: 2.0,
            speed_hz: 1.0,
        };
        for (second_us, starts) in [(1_400_000, false), (1_600_000, true), (900_000, true)] {
            let mut filter = ShapeFilter::new(cutoffs);
            filter.follow(&[0.0; MAX_MODES], Timestamp::from_us(1_000_000));
            let b = filter.follow(&[1.0; MAX_MODES], Timestamp::from_us(second_us));
            // A deviation in 0.4 s: a speed of 2.5, smoothed to 1.79, a cut-off of 4.58 Hz and so a gain of 0.92.
            let expected = if starts { 1.0 } else { 0.92 };
            assert!((b[0] - expected).abs() < 0.002, "{second_us}: {}", b[0]);
        }
    }

    #[test]
    fn noise_is_smoothed_and_a_step_passes() {
        let mut random = fastrand::Rng::with_seed(3);
        let mut filter = ShapeFilter::new(Cutoffs {
            still_hz: 1.0,
            per_speed: 2.0,
            speed_hz: 3.0,
        });
        let (mut squares_in, mut squares_out) = (0.0, 0.0);
        let mut after_step = 0.0;
        for frame in 0..330u64 {
            let truth = if frame >= 300 { 2.0 } else { 0.0 };
            let noise = 0.1 * (random.f32() + random.f32() + random.f32() + random.f32() - 2.0);
            let mut measured = [0.0; MAX_MODES];
            measured[0] = truth + noise;
            let b = filter.follow(&measured, Timestamp::from_us(frame * 33_333))[0];
            if (30..300).contains(&frame) {
                squares_in += noise * noise;
                squares_out += b * b;
            }
            if frame == 301 {
                after_step = b;
            }
        }
        assert!(squares_out < 0.3 * squares_in, "{squares_out} {squares_in}");
        assert!(after_step > 1.5, "{after_step}");
    }
}
