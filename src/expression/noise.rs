//! How noisy one measure is from frame to frame, without knowing what it does.
//!
//! Method: von Neumann et al. 1941, dispersion from successive differences, made robust: for white noise of deviation σ the
//! second difference g0 − 2 g1 + g2 has deviation √6 σ and median size 0.6745 √6 σ, while anything smooth cancels. The
//! median is followed by a step up or down in proportion to itself. Units of the measure. Memory: three numbers.
//! Limitation: it sees the white part of the noise only; [`Noise::sigma`] is that times 1.5, as correlated jitter of a
//! face tracker is about as large as its white part.

/// Step of the running median, per frame: half of the way in about 20 frames.
const STEP: f64 = 0.035;
/// From the white part to all of it.
const WHITE_TO_ALL: f64 = 1.5;
/// 0.6745 √6.
const MEDIAN_OF_SECOND_DIFFERENCE: f64 = 1.652_181;

/// Running noise of one measure.
#[derive(Clone, Debug)]
pub struct Noise {
    white: f64,
    least: f64,
    last: [f64; 2],
    seen: u8,
}

impl Noise {
    /// Starts at `assumed` (the white part) and never falls under a thirtieth of it.
    #[must_use]
    pub fn new(assumed: f64) -> Self {
        Self {
            white: assumed,
            least: assumed / 30.0,
            last: [0.0; 2],
            seen: 0,
        }
    }

    /// Takes the next frame's value.
    pub fn observe(&mut self, g: f64) {
        if self.seen >= 2 {
            let target =
                (self.last[1] - 2.0 * self.last[0] + g).abs() / MEDIAN_OF_SECOND_DIFFERENCE;
            let factor = if target > self.white {
                1.0 + STEP
            } else {
                1.0 / (1.0 + STEP)
            };
            self.white = (self.white * factor).max(self.least);
        } else {
            self.seen += 1;
        }
        self.last = [g, self.last[0]];
    }

    /// Frames were lost: the next difference would span them.
    pub fn interrupt(&mut self) {
        self.seen = 0;
    }

    /// Deviation of the measure's noise.
    #[must_use]
    pub fn sigma(&self) -> f64 {
        WHITE_TO_ALL * self.white
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn normal(random: &mut fastrand::Rng) -> f64 {
        (-2.0 * (1.0 - random.f64()).ln()).sqrt() * (core::f64::consts::TAU * random.f64()).cos()
    }

    #[test]
    fn finds_the_noise_under_a_moving_signal() {
        let mut random = fastrand::Rng::with_seed(11);
        let mut noise = Noise::new(0.006);
        let mut mean = 0.0;
        for frame in 0..6000 {
            let signal = (f64::from(frame) * 0.05).sin();
            noise.observe(signal + 0.02 * normal(&mut random));
            if frame >= 1000 {
                mean += noise.sigma() / 5000.0;
            }
        }
        assert!((mean / (1.5 * 0.02) - 1.0).abs() < 0.06, "{mean}");
    }

    #[test]
    fn a_constant_measure_ends_at_the_floor() {
        let mut noise = Noise::new(0.006);
        for _ in 0..1000 {
            noise.observe(0.4);
        }
        assert!((noise.sigma() - 0.0003).abs() < 1e-9);
    }
}
