//! Random numbers for rendering; seeded by the caller.

use fastrand::Rng;

/// An approximately normal number of mean 0 and deviation 1.
pub(super) fn normal(rng: &mut Rng) -> f32 {
    let sum: f32 = (0..6).map(|_| rng.f32()).sum();
    (sum - 3.0) * std::f32::consts::SQRT_2
}

/// A uniform number in −1…1.
pub(super) fn either(rng: &mut Rng) -> f32 {
    2.0 * rng.f32() - 1.0
}
