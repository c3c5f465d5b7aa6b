//! Eyes: one picture for both, seen from in front.

use crate::base::geometry::smoothstep;
use image::RgbImage;

use super::palette::{dice, mix, noise, picture};
use crate::studio::bake::mesh::Vec3;

/// Middle of the left eyeball; of the right one x is negative.
const BALL: Vec3 = Vec3::new(0.031, 0.0035, -0.0135);
/// Middle of the iris from there, towards the nose: who looks at somebody an arm away converges.
const INWARD_M: f64 = 0.0007;
/// What the picture shows from its middle to its edge.
const REACH_M: f64 = 0.0165;
const IRIS_M: f64 = 0.0064;
const PUPIL_M: f64 = 0.0024;
const SIDE: usize = 512;

/// Place of a vertex of an eyeball in the picture.
pub(super) fn place(p: &Vec3) -> [f32; 2] {
    let side = p.x.signum();
    let x = p.x - side * (BALL.x - INWARD_M);
    let mut flat = nalgebra::Vector2::new(x, p.y - BALL.y);
    // What looks back is white.
    if p.z < BALL.z {
        flat = flat.try_normalize(1e-9).unwrap_or_default() * REACH_M;
    }
    let at = |d: f64| (0.5 + 0.5 * d / REACH_M).clamp(0.0, 1.0) as f32;
    [at(flat.x), at(-flat.y)]
}

pub(super) fn paint() -> RgbImage {
    picture(SIDE, |col, row| {
        let at = |k: usize| (2.0 * (k as f64 + 0.5) / SIDE as f64 - 1.0) * REACH_M;
        let (x, y) = (at(col), -at(row));
        let (r, angle) = (x.hypot(y), y.atan2(x));
        let red = smoothstep(0.009, 0.015, r) as f32;
        let white = mix([0.93, 0.925, 0.91], [0.88, 0.78, 0.74], 0.6 * red);
        let iris = {
            let t = (r - PUPIL_M) / (IRIS_M - PUPIL_M);
            let fibre = noise(angle * 16.0, r * 400.0, 5) * 0.6 + noise(angle * 40.0, 3.0, 9) * 0.4;
            let ring = smoothstep(0.45, 0.0, t) as f32;
            let base = mix([0.24, 0.44, 0.50], [0.55, 0.47, 0.28], 0.75 * ring);
            let lit = 1.0 + 0.30 * fibre as f32;
            // Light that falls in from above leaves the lower half brighter.
            let below = 1.0 + 0.22 * (-(y / IRIS_M)) as f32;
            base.map(|c| c * lit * below)
        };
        let rim = (smoothstep(IRIS_M * 0.80, IRIS_M * 0.97, r)) as f32;
        let iris = mix(iris, [0.07, 0.11, 0.13], 0.85 * rim);
        let pupil = smoothstep(PUPIL_M * 1.08, PUPIL_M * 0.92, r) as f32;
        let iris = mix(iris, [0.015, 0.012, 0.012], pupil);
        let inside = smoothstep(IRIS_M * 1.05, IRIS_M * 0.96, r) as f32;
        let mut colour = mix(white, iris, inside);
        // Reflections of a window, to one side of both eyes, so that they look at the same.
        for (dx, dy, size, strength) in [
            (-0.0021, 0.0022, 0.00115, 0.95),
            (0.0022, -0.0024, 0.0007, 0.35),
        ] {
            let d = (x - dx).hypot(y - dy);
            let share = strength * smoothstep(size * 1.15, size * 0.75, d) as f32;
            colour = mix(colour, [1.0; 3], share);
        }
        let grain = (dice((row * SIDE + col) as u32) as f32 - 0.5) * 0.012;
        colour.map(|c| c + grain)
    })
}
