//! Materials, and the noise for strands and folds.

use crate::virtual_head::random::{hash, uniform};

/// Material of a surface, as it matters to the sensor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
pub(crate) enum Material {
    /// Walls, furniture, paper: reflects the pattern well.
    #[default]
    Matt = 0,
    Skin = 1,
    Cloth = 2,
    /// Black cloth, plastic.
    Dark = 3,
    /// Fair hair: thin strands scatter the pattern.
    Hair = 4,
    /// Dark hair: also absorbs the pattern.
    DarkHair = 5,
    /// Glass: depth behind it is measured badly.
    Glass = 6,
    /// Polished surfaces and screens: reflect the pattern away.
    #[cfg(feature = "studio")]
    Gloss = 7,
}

impl Material {
    /// Contrast of the grain in colour; strength of highlights; share of failed depth readings at 1 m, inside and near the edge;
    /// raggedness of the edge, pixels (one standard deviation).
    pub(crate) const fn properties(self) -> [f32; 5] {
        match self {
            Self::Matt => [0.04, 0.0, 0.0004, 0.05, 1.0],
            Self::Skin => [0.03, 0.0, 0.003, 0.05, 1.0],
            Self::Cloth => [0.12, 0.0, 0.0006, 0.05, 1.0],
            Self::Dark => [0.12, 0.0, 0.006, 0.07, 1.1],
            Self::Hair => [0.36, 0.9, 0.009, 0.16, 1.8],
            Self::DarkHair => [0.36, 0.9, 0.022, 0.20, 2.4],
            Self::Glass => [0.03, 0.0, 0.12, 0.30, 1.0],
            #[cfg(feature = "studio")]
            Self::Gloss => [0.03, 0.7, 0.85, 0.95, 1.5],
        }
    }
}

/// Value noise over the plane, −1…1: one value per cell, bilinear.
pub(crate) fn grain(u: f32, v: f32) -> f32 {
    let (col, row) = (u.floor(), v.floor());
    let (fu, fv) = (u - col, v - row);
    let at = |du: i64, dv: i64| {
        let cell = ((row as i64 + dv) << 24) ^ (col as i64 + du);
        uniform(0x77ea, cell.cast_unsigned())
    };
    let upper = at(0, 0) * (1.0 - fu) + at(1, 0) * fu;
    let lower = at(0, 1) * (1.0 - fu) + at(1, 1) * fu;
    upper * (1.0 - fv) + lower * fv
}

/// Uniform random number in 0…1 for each seed and index.
pub(crate) fn share(seed: u64, index: u64) -> f32 {
    uniform(seed, index) * 0.5 + 0.5
}

/// Linear ramp: 0 at `from`, 1 at `to`, clamped; `from` may be above `to`.
pub(super) fn slope(x: f32, from: f32, to: f32) -> f32 {
    ((x - from) / (to - from)).clamp(0.0, 1.0)
}

/// Interpolates a table of points with ascending x linearly; constant beyond its ends.
pub(super) fn along(table: &[[f32; 2]], at: f32) -> f32 {
    match table.iter().position(|[x, _]| *x > at) {
        Some(0) => table[0][1],
        Some(k) => {
            let ([x, y], [p, q]) = (table[k - 1], table[k]);
            y + (q - y) * (at - x) / (p - x)
        }
        None => table[table.len() - 1][1],
    }
}

/// Seed for one part of an appearance.
pub(super) fn part_seed(seed: u64, index: u64) -> u64 {
    hash(seed, 0x5ea7 + index)
}
