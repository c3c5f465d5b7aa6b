//! What surfaces are made of, and the noise that cuts strands and folds out of them.

use crate::virtual_head::random::{hash, uniform};

/// What a surface is made of, as far as the sensor tells: how it answers infrared light.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
pub(crate) enum Stuff {
    /// Walls, furniture, paper: answers well.
    #[default]
    Matt = 0,
    Skin = 1,
    Cloth = 2,
    /// Black cloth, plastic.
    Dark = 3,
    /// Hair, fair and dark: thin strands that scatter and swallow the pattern.
    Hair = 4,
    DarkHair = 5,
    /// Glass in front of something: what is behind is seen badly.
    Glass = 6,
    /// Sends the pattern elsewhere: a polished desk, a screen.
    #[cfg(feature = "studio")]
    Gloss = 7,
}

impl Stuff {
    /// Contrast of its grain in colour, and strength of the light along its strands; shares of depth readings that fail at 1 m,
    /// within it and near its edge, and how far that edge is ragged, pixels (one standard deviation).
    pub(crate) const fn answers(self) -> [f32; 5] {
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

/// Value noise in −1…1 over the plane, one value per cell, bilinear.
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

/// A number in 0…1 for each seed and index.
pub(crate) fn share(seed: u64, index: u64) -> f32 {
    uniform(seed, index) * 0.5 + 0.5
}

/// 0 below `from`, 1 above `to`, straight between; `from` may be above `to`.
pub(super) fn slope(x: f32, from: f32, to: f32) -> f32 {
    ((x - from) / (to - from)).clamp(0.0, 1.0)
}

/// A line through the points of a table, by x ascending, level beyond its ends.
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

/// A seed for one part of a look.
pub(super) fn part(seed: u64, part: u64) -> u64 {
    hash(seed, 0x5ea7 + part)
}
