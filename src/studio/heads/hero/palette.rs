//! Colours of the hero and how they are put on: sRGB 0…1 unless called linear.

use crate::base::geometry::smoothstep;

use crate::studio::bake::mesh::Vec3;
use crate::studio::srgb;

/// Skin without a blush.
pub(super) const SKIN: [f32; 3] = [0.885, 0.700, 0.605];
/// Hair in its middle.
pub(super) const HAIR: [f32; 3] = [0.265, 0.170, 0.120];

/// sRGB to linear light (IEC 61966-2-1), both 0…1.
pub(super) fn linear(v: f32) -> f32 {
    srgb::linear(f64::from(v.clamp(0.0, 1.0))) as f32
}

/// From `a` to `b` by `share`.
pub(super) fn mix(a: [f32; 3], b: [f32; 3], share: f32) -> [f32; 3] {
    [0, 1, 2].map(|k| a[k] + (b[k] - a[k]) * share)
}

/// A number 0…1 that belongs to `k`.
pub(super) fn dice(k: u32) -> f64 {
    let mut x = k.wrapping_mul(0x9E37_79B9) ^ 0x85EB_CA6B;
    for shift in [16, 13] {
        x = (x ^ (x >> shift)).wrapping_mul(0xC2B2_AE35);
    }
    f64::from(x ^ (x >> 16)) / f64::from(u32::MAX)
}

/// Smooth noise of a place, -1…1, about one wave a unit.
pub(super) fn noise(x: f64, y: f64, seed: u32) -> f64 {
    let (i, j) = (x.floor(), y.floor());
    let (u, v) = (smoothstep(0.0, 1.0, x - i), smoothstep(0.0, 1.0, y - j));
    let corner = |a: f64, b: f64| {
        let k = ((i + a) as i32 as u32).wrapping_mul(73_856_093);
        dice(k ^ ((j + b) as i32 as u32).wrapping_mul(19_349_663) ^ seed)
    };
    let low = corner(0.0, 0.0) * (1.0 - u) + corner(1.0, 0.0) * u;
    let high = corner(0.0, 1.0) * (1.0 - u) + corner(1.0, 1.0) * u;
    2.0 * (low * (1.0 - v) + high * v) - 1.0
}

/// A curve through points (Catmull & Rom 1974), `t` from 0 to the last point's number.
pub(super) fn curve(points: &[Vec3], t: f64) -> Vec3 {
    let last = points.len() - 1;
    let k = (t.max(0.0) as usize).min(last.saturating_sub(1));
    let u = (t - k as f64).clamp(0.0, 1.0);
    let at = |i: isize| points[(k as isize + i).clamp(0, last as isize) as usize];
    let [a, b, c, d] = [at(-1), at(0), at(1), at(2)];
    0.5 * ((2.0 * b)
        + (c - a) * u
        + (2.0 * a - 5.0 * b + 4.0 * c - d) * u * u
        + (3.0 * b - a - 3.0 * c + d) * u * u * u)
}
