//! The picture of the skin: wrapped around the upright axis of the head, painted by rule from the 68 landmarks.
//!
//! A place of the picture is an angle about the axis and a height. What lies behind the ears has no picture; its edges
//! are plain skin, so that there is no seam. Lengths in metres along the picture: angle times [`RADIUS_M`], and height.

use crate::base::geometry::smoothstep;
use image::RgbImage;

use super::hair;
use super::palette::{HAIR, SKIN, curve, dice, mix, noise, picture};
use crate::studio::bake::mesh::Vec3;

/// The axis.
const AXIS_Z_M: f64 = -0.085;
/// Angle from the middle to an edge of the picture, radians.
const REACH: f64 = 1.75;
const RADIUS_M: f64 = 0.10;
/// Height of the lower and upper edge.
const HEIGHT_M: [f64; 2] = [-0.13, 0.10];
const SIDE: usize = 1024;
const LIP: [f32; 3] = [0.735, 0.425, 0.405];
const BROW: [f32; 3] = [0.250, 0.165, 0.120];

fn angle(p: &Vec3) -> f64 {
    p.x.atan2(p.z - AXIS_Z_M)
}

/// Whether the picture has this place.
pub(super) fn reaches(p: &Vec3) -> bool {
    angle(p).abs() < REACH * 0.98
}

/// Place in the picture, 0…1 from the top left. What lies beyond is a little inside its edges: OBJ cannot say that a
/// picture does not repeat, and beneath its lower edge the hair of its upper one would show.
pub(super) fn place(p: &Vec3) -> [f32; 2] {
    let u = 0.5 + 0.5 * angle(p) / REACH;
    let v = (HEIGHT_M[1] - p.y) / (HEIGHT_M[1] - HEIGHT_M[0]);
    [u, v].map(|t| t.clamp(0.01, 0.99) as f32)
}

/// On the picture: metres aside, height.
fn flat(p: &Vec3) -> Vec3 {
    Vec3::new(angle(p) * RADIUS_M, p.y, 0.0)
}

/// A closed outline, finely cut.
struct Outline(Vec<Vec3>);

impl Outline {
    fn through(points: &[Vec3]) -> Self {
        let n = points.len();
        let around: Vec<Vec3> = (0..n + 3).map(|k| points[(k + n - 1) % n]).collect();
        let steps = (0..8 * n).map(|k| curve(&around, 1.0 + k as f64 / 8.0));
        Self(steps.collect())
    }

    /// Distance to the line, negative inside.
    fn distance(&self, x: f64, y: f64) -> f64 {
        let (mut best, mut inside) = (f64::INFINITY, false);
        let n = self.0.len();
        for k in 0..n {
            let (a, b) = (self.0[k], self.0[(k + 1) % n]);
            let (along, to) = (b - a, Vec3::new(x, y, 0.0) - a);
            let t = (to.dot(&along) / along.norm_squared().max(1e-18)).clamp(0.0, 1.0);
            best = best.min((to - along * t).norm());
            if (a.y > y) != (b.y > y) && x < a.x + along.x * (y - a.y) / along.y {
                inside = !inside;
            }
        }
        if inside { -best } else { best }
    }
}

/// One hair of a brow: from, to, half its width.
struct Stroke(Vec3, Vec3, f64);

/// Hairs of a brow whose five landmarks go from the nose outwards.
fn brow(marks: &[Vec3], seed: u32) -> Vec<Stroke> {
    const HAIRS: u32 = 640;
    let side = (marks[4].x - marks[0].x).signum();
    (0..HAIRS)
        .map(|k| {
            let roll = |of: u32| dice(seed ^ (k * 8 + of));
            let t = 4.0 * (roll(0) * 0.96 + 0.02);
            let share = t / 4.0;
            let p = curve(marks, t);
            let ahead = curve(marks, t + 0.05) - curve(marks, t - 0.05);
            let ahead = ahead.try_normalize(1e-12).unwrap_or_else(Vec3::x);
            let up = Vec3::new(-ahead.y * side, ahead.x * side, 0.0);
            // Full near the nose, a point at the temple.
            let thick = 0.0040
                * smoothstep(-0.10, 0.16, share)
                * (1.0 - 0.80 * smoothstep(0.45, 1.0, share));
            let root = p + up * (thick * (2.0 * roll(1) - 1.0) - 0.0004);
            // Upright near the nose, along the brow further out; upper hairs lean down, lower ones up.
            let lean =
                1.15 * smoothstep(0.32, 0.0, share) + 0.25 * (p - root).dot(&up) / thick.max(1e-4);
            let long = 0.0048 * (0.7 + 0.5 * roll(2)) * (1.0 - 0.3 * share);
            let along = ahead * lean.cos() + up * lean.sin();
            Stroke(root, root + along * long, 0.00010 + 0.00006 * roll(3))
        })
        .collect()
}

/// How much of a pixel at a place the strokes cover, 0…1.
fn covered<'a>(strokes: impl Iterator<Item = &'a Stroke>, x: f64, y: f64) -> f32 {
    let p = Vec3::new(x, y, 0.0);
    let mut bare = 1.0;
    for Stroke(a, b, half) in strokes {
        let along = b - a;
        let t = ((p - a).dot(&along) / along.norm_squared()).clamp(0.0, 1.0);
        let d = (a + along * t - p).norm();
        bare *= 1.0 - 0.46 * smoothstep(half * (1.0 - 0.6 * t) + 0.00030, 0.0, d);
    }
    (1.0 - bare) as f32
}

/// A soft spot: colour, middle, radii, strength.
type Spot = ([f32; 3], [f64; 2], [f64; 2], f32);

/// Where skin is redder, darker or lighter; those aside also mirrored.
const SPOTS: [Spot; 9] = [
    ([0.86, 0.50, 0.45], [0.050, -0.030], [0.026, 0.022], 0.34),
    ([0.86, 0.54, 0.48], [0.0, -0.034], [0.013, 0.013], 0.28),
    ([0.84, 0.56, 0.50], [0.0, -0.098], [0.018, 0.012], 0.16),
    // Lids, and the hollow beneath.
    ([0.76, 0.52, 0.45], [0.033, 0.0095], [0.017, 0.0055], 0.16),
    ([0.74, 0.52, 0.47], [0.032, -0.0075], [0.017, 0.006], 0.14),
    // Between nose and lips, under the lower lip.
    ([0.78, 0.55, 0.48], [0.0, -0.050], [0.012, 0.006], 0.12),
    ([0.70, 0.46, 0.40], [0.0, -0.081], [0.014, 0.004], 0.22),
    // Forehead, and the bridge of the nose.
    ([0.94, 0.78, 0.68], [0.0, 0.052], [0.050, 0.022], 0.35),
    ([0.94, 0.78, 0.69], [0.0, -0.008], [0.006, 0.024], 0.25),
];

fn bare(x: f64, y: f64) -> [f32; 3] {
    let mut colour = SKIN;
    for (spot, [cx, cy], [rx, ry], strength) in SPOTS {
        for side in [1.0, -1.0] {
            if cx == 0.0 && side < 0.0 {
                continue;
            }
            let d = ((x - side * cx) / rx).powi(2) + ((y - cy) / ry).powi(2);
            colour = mix(colour, spot, strength * (-d).exp() as f32);
        }
    }
    let uneven = 0.010 * noise(x * 90.0, y * 90.0, 1)
        + 0.010 * noise(x * 420.0, y * 420.0, 2)
        + 0.012 * noise(x * 1300.0, y * 1300.0, 3);
    colour.map(|c| c * (1.0 + uneven as f32))
}

pub(super) fn paint(marks: &[Vec3]) -> RgbImage {
    let marks: Vec<Vec3> = marks.iter().map(flat).collect();
    let lips = Outline::through(&marks[48..60]);
    // Outwards: the right brow's landmarks come the other way.
    let right: Vec<Vec3> = marks[17..22].iter().rev().copied().collect();
    let brows = [brow(&right, 0x51), brow(&marks[22..27], 0xA7)];
    let [bottom, top] = HEIGHT_M;
    picture(SIDE, |col, row| {
        let x = (2.0 * (col as f64 + 0.5) / SIDE as f64 - 1.0) * REACH * RADIUS_M;
        let y = top - (row as f64 + 0.5) / SIDE as f64 * (top - bottom);
        let mut colour = bare(x, y);
        if x.abs() < 0.045 && (-0.090..-0.045).contains(&y) {
            let d = lips.distance(x, y);
            let share = smoothstep(0.0009, -0.0011, d) as f32;
            let lines = noise(x * 1500.0, y * 120.0, 4) as f32;
            // The upper lip faces down and is the darker.
            let upper = smoothstep(-0.0680, -0.0640, y) as f32;
            let lip = LIP.map(|c| c * (1.0 - 0.07 * upper) * (1.0 + 0.035 * lines));
            let line = smoothstep(0.0016, 0.0, (y - (-0.0662 - 9.0 * x * x)).abs()) as f32;
            let lip = mix(lip, [0.40, 0.17, 0.16], 0.5 * line);
            colour = mix(colour, lip, 0.92 * share);
        }
        if (0.010..0.045).contains(&y) {
            let strokes = brows[usize::from(x > 0.0)].iter();
            let strokes =
                strokes.filter(|Stroke(root, ..)| (root - Vec3::new(x, y, root.z)).amax() < 0.010);
            // Between the hairs lies their shade.
            let shade = strokes.clone().map(|Stroke(a, b, _)| {
                let m = (a + b) * 0.5;
                (-((m.x - x).powi(2) + (m.y - y).powi(2)) / (0.0013 * 0.0013)).exp()
            });
            let shade = (shade.sum::<f64>() * 0.035).min(0.42) as f32;
            colour = mix(colour, BROW, shade);
            colour = mix(colour, BROW, 0.95 * covered(strokes, x, y));
        }
        // Roots of the hair show through the skin.
        let angle = x / RADIUS_M;
        let p = Vec3::new(0.094 * angle.sin(), y, AXIS_Z_M + 0.094 * angle.cos());
        let ragged = 0.030 * noise(x * 900.0, y * 60.0, 8) + 0.02 * noise(x * 300.0, y * 40.0, 9);
        let grown = smoothstep(-0.07, 0.05, hair::above_line(&p) + ragged) as f32;
        let colour = mix(colour, HAIR, 0.8 * grown);
        // Plain at the edges.
        let aside = smoothstep(0.85, 0.97, x.abs() / (REACH * RADIUS_M));
        let edge = aside.max(smoothstep(bottom + 0.015, bottom, y));
        mix(colour, SKIN, edge as f32)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_outline_knows_its_inside() {
        let square = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)];
        let outline = Outline::through(&square.map(|(x, y)| Vec3::new(x, y, 0.0)));
        assert!(outline.distance(0.0, 0.0) < -0.9);
        // Rounded corners lie a little outside the square.
        assert!((1.7..2.1).contains(&outline.distance(3.0, 0.0)));
    }
}
