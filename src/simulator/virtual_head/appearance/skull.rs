//! The surface of a head as a distance from its middle by direction, as a base for hair and hats.

use crate::virtual_head::asset::{HeadAsset, Part};
use mien_stages::base::geometry::{Point, Vector};

/// Middle of the skull, head frame, metres.
const MIDDLE: [f32; 3] = [0.0, -0.02, 0.08];
/// Height (y) below which vertices belong to the neck, metres.
const LOWEST_M: f32 = 0.13;
const ROWS: usize = 32;
const COLUMNS: usize = 64;

/// Unit vector: `theta` from straight up, `phi` from the face towards the image right, radians.
pub(super) fn direction(theta: f32, phi: f32) -> Vector {
    let (sin_t, cos_t) = theta.sin_cos();
    let (sin_p, cos_p) = phi.sin_cos();
    Vector::new(sin_t * sin_p, -cos_t, -sin_t * cos_p)
}

/// Distance of the surface from the middle by direction, metres.
pub(super) struct Skull {
    radius: Vec<f32>,
}

impl Skull {
    pub(super) fn from_asset(asset: &HeadAsset) -> Self {
        let mut radius = vec![0.0f32; (ROWS + 1) * COLUMNS];
        let middle = Point::from(MIDDLE);
        let mut reach = |p: Point| {
            let d = p - middle;
            let r = d.norm();
            if p.y > LOWEST_M || r < 1e-3 {
                return;
            }
            let theta = (-d.y / r).clamp(-1.0, 1.0).acos() / std::f32::consts::PI;
            let phi = d.x.atan2(-d.z) / std::f32::consts::TAU + 1.0;
            let row = (theta * ROWS as f32).round() as usize;
            let column = (phi * COLUMNS as f32).round() as usize % COLUMNS;
            let cell = &mut radius[row * COLUMNS + column];
            *cell = cell.max(r);
        };
        for (&triangle, &part) in asset.triangles.iter().zip(asset.parts.iter()) {
            if part == Part::Skin {
                let [a, b, c] = triangle.map(|k| asset.neutral[k as usize]);
                reach(a);
                reach(nalgebra::center(&a, &b));
                reach(nalgebra::center(&b, &c));
                reach(nalgebra::center(&a, &c));
            }
        }
        let mut skull = Self { radius };
        // Directions without a triangle take the mean of their neighbours.
        for _ in 0..8 {
            skull.relax(|here, around| if here > 0.0 { here } else { around });
        }
        skull.relax(|here, around| 0.5 * (here + around).max(here));
        skull
    }

    fn relax(&mut self, blend: impl Fn(f32, f32) -> f32) {
        let before = self.radius.clone();
        for row in 0..=ROWS {
            for column in 0..COLUMNS {
                let (mut sum, mut count) = (0.0, 0.0);
                for (r, c) in [
                    (row.saturating_sub(1), column),
                    ((row + 1).min(ROWS), column),
                    (row, (column + 1) % COLUMNS),
                    (row, (column + COLUMNS - 1) % COLUMNS),
                ] {
                    let there = before[r * COLUMNS + c];
                    if there > 0.0 {
                        sum += there;
                        count += 1.0;
                    }
                }
                let around = if count > 0.0 { sum / count } else { 0.0 };
                let here = &mut self.radius[row * COLUMNS + column];
                *here = blend(*here, around);
            }
        }
    }

    /// Point `lift` metres above the surface in a direction, head frame.
    pub(super) fn point(&self, theta: f32, phi: f32, lift: f32) -> Point {
        let row = (theta / std::f32::consts::PI * ROWS as f32).clamp(0.0, ROWS as f32 - 0.001);
        let turn = phi / std::f32::consts::TAU;
        let column = (turn - turn.floor()) * COLUMNS as f32;
        let (r, c) = (row as usize, column as usize % COLUMNS);
        let (fr, fc) = (row - r as f32, column - column.floor());
        let at = |r: usize, c: usize| self.radius[r * COLUMNS + c % COLUMNS];
        let radius = (at(r, c) * (1.0 - fc) + at(r, c + 1) * fc) * (1.0 - fr)
            + (at(r + 1, c) * (1.0 - fc) + at(r + 1, c + 1) * fc) * fr;
        Point::from(MIDDLE) + direction(theta, phi) * (radius + lift)
    }

    /// Point on a cloth that follows the skull to the angle [`HANGS`] and hangs straight down from there: angle `along`, then `below_m`
    /// metres down.
    pub(super) fn drape(&self, along: f32, below_m: f32, phi: f32, lift: f32) -> Point {
        let mut p = self.point(along.min(HANGS), phi, lift);
        p.y += below_m;
        p
    }
}

/// Angle from straight up at which things begin to hang, radians.
pub(super) const HANGS: f32 = 1.65;
