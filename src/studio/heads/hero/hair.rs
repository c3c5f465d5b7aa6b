//! Hair: a cap over the skull and locks combed over it from a parting on the left.
//!
//! The skull is taken as a distance from its middle in every direction, so that a lock is a path over directions with a height
//! above the skin. The hairline is a height of direction by angle around the head.

use crate::base::geometry::smoothstep;
use nalgebra::{Rotation3, Unit};

use super::layer::Layer;
use super::look;
use super::palette::{HAIR, curve, dice, linear, mix, noise};
use crate::studio::bake::mesh::Vec3;

/// Middle of the skull.
const MIDDLE: Vec3 = Vec3::new(0.0, 0.030, -0.088);
/// The hairline: degrees around the head from the front, degrees above the level of the middle.
const LINE: [(f64, f64); 12] = [
    (0.0, 33.0),
    (18.0, 34.5),
    (34.0, 33.5),
    (47.0, 26.0),
    (56.0, 13.0),
    (62.0, 1.0),
    (69.0, -6.0),
    (76.0, -4.0),
    (88.0, 2.0),
    (106.0, -6.0),
    (122.0, -33.0),
    (180.0, -43.0),
];
/// Cells of the map of the skull: around, from below to above.
const MAP: [usize; 2] = [72, 36];
const LOCKS: u32 = 760;
/// Rings of a lock and corners of a ring.
const RINGS: usize = 9;
const CORNERS: usize = 5;

/// Angle around the head from the front, positive to the left, and above the level of the middle, radians.
fn angles(d: &Vec3) -> [f64; 2] {
    [d.x.atan2(d.z), d.y.atan2(d.x.hypot(d.z))]
}

fn direction([around, above]: [f64; 2]) -> Vec3 {
    let (sin, cos) = around.sin_cos();
    Vec3::new(sin * above.cos(), above.sin(), cos * above.cos())
}

fn line(around: f64) -> f64 {
    let points = LINE.map(|(a, b)| Vec3::new(a, b, 0.0));
    let degrees = around.abs().to_degrees();
    let k = LINE.iter().rposition(|p| p.0 <= degrees).unwrap_or(0);
    let k = k.min(LINE.len() - 2);
    let u = (degrees - LINE[k].0) / (LINE[k + 1].0 - LINE[k].0);
    curve(&points, k as f64 + u).y.to_radians()
}

/// Distance of the skin from the middle, by direction.
struct Skull(Vec<f64>);

impl Skull {
    fn of(skin: &[Vec3]) -> Self {
        let [wide, tall] = MAP;
        let mut sums = vec![[0.0; 2]; wide * tall];
        for p in skin {
            // Ears stand off.
            let ear = p.x.abs() > 0.0735 && p.y < 0.042 && (-0.118..-0.055).contains(&p.z);
            let d = p - MIDDLE;
            if ear || d.y < -0.11 {
                continue;
            }
            let at = Self::cell(angles(&d));
            let [x, y] = at.map(|c| c.round() as usize);
            let slot = &mut sums[y.min(tall - 1) * wide + x % wide];
            *slot = [slot[0] + d.norm(), slot[1] + 1.0];
        }
        // Empty cells from their neighbours, then everything a little smoother.
        for round in 0..14 {
            let before = sums.clone();
            for y in 0..tall {
                for x in 0..wide {
                    let here = before[y * wide + x];
                    let mut sum = [0.0; 2];
                    if here[1] > 0.0 {
                        if round < 11 {
                            continue;
                        }
                        sum = [here[0] / here[1], 1.0];
                    }
                    for (dx, dy) in [(1, 0), (wide - 1, 0), (0, 1), (0, tall)] {
                        let row = match dy {
                            1 => (y + 1).min(tall - 1),
                            0 => y,
                            _ => y.saturating_sub(1),
                        };
                        let o = before[row * wide + (x + dx) % wide];
                        if o[1] > 0.0 {
                            sum = [sum[0] + o[0] / o[1], sum[1] + 1.0];
                        }
                    }
                    if sum[1] > 0.0 {
                        sums[y * wide + x] = [sum[0] / sum[1], 1.0];
                    }
                }
            }
        }
        Self(sums.iter().map(|s| s[0] / s[1].max(1.0)).collect())
    }

    /// Place in the map of a direction.
    fn cell([around, above]: [f64; 2]) -> [f64; 2] {
        use std::f64::consts::{PI, TAU};
        [
            (around + PI) / TAU * MAP[0] as f64,
            (above + 0.5 * PI) / PI * (MAP[1] - 1) as f64,
        ]
    }

    fn radius(&self, d: &Vec3) -> f64 {
        let [wide, tall] = MAP;
        let [x, y] = Self::cell(angles(d));
        let (col, row) = (x.floor(), y.floor().min((tall - 2) as f64));
        let (u, v) = (x - col, y - row);
        let at = |i: usize, j: usize| self.0[(row as usize + j) * wide + (col as usize + i) % wide];
        (at(0, 0) * (1.0 - u) + at(1, 0) * u) * (1.0 - v)
            + (at(0, 1) * (1.0 - u) + at(1, 1) * u) * v
    }
}

/// Thickness of the hair in a direction, metres: full on top and in front, short beside and behind.
fn thickness(d: &Vec3) -> f64 {
    let [around, above] = angles(d);
    let inside = smoothstep(-0.02, 0.38, above - line(around));
    let top = smoothstep(0.35, 0.95, above);
    let front = smoothstep(0.1, 0.9, d.z) * top;
    inside * (0.0065 + 0.0115 * top + 0.006 * front)
}

/// Where hair is combed to, along the skull.
fn combed(d: &Vec3) -> Vec3 {
    let part = 0.30;
    let top = smoothstep(0.30, 0.75, d.y);
    let across = if d.x > part {
        Vec3::new(0.85, -0.35, -0.55)
    } else {
        Vec3::new(-0.85, 0.10, -0.62)
    };
    let behind = smoothstep(0.25, -0.45, d.z);
    let down = Vec3::new(-0.15 * (1.0 - behind), -0.75, -0.65 * (1.0 - behind));
    let crown = Vec3::new(-0.35, -0.4, -0.85);
    let over = across * (1.0 - behind) + crown * behind;
    over * top + down * (1.0 - top)
}

pub(super) fn grow(dress: &mut Layer, skin: &[Vec3]) {
    let skull = Skull::of(skin);
    cap(dress, &skull);
    for k in 0..LOCKS {
        // A spiral over the sphere, then those above the hairline.
        let y = 1.0 - 1.72 * (f64::from(k) + 0.5) / f64::from(LOCKS);
        let around = 2.399_963 * f64::from(k) + 0.5 * dice(k * 3);
        let around = (around + 3.15).rem_euclid(std::f64::consts::TAU) - 3.15;
        let d = direction([around, y.asin()]);
        let [around, above] = angles(&d);
        // Before the ear and at the nape a lock would hang in the air.
        let least = match around.abs() {
            0.95..1.75 => 0.13,
            1.75.. => 0.09,
            _ => -0.015,
        };
        if above - line(around) > least {
            lock(dress, &skull, d, k);
        }
    }
}

/// The ground of the hair: closed, from the hairline to the crown.
fn cap(dress: &mut Layer, skull: &Skull) {
    const AROUND: usize = 96;
    const UP: usize = 22;
    let dark = HAIR.map(|c| linear(c * 0.72));
    let mut rows = Vec::new();
    for row in 0..=UP {
        let t = row as f64 / UP as f64;
        let ring: Vec<u32> = (0..AROUND)
            .map(|k| {
                let around = (k as f64 / AROUND as f64 - 0.5) * std::f64::consts::TAU;
                let from = line(around) - 0.01;
                // The last ring is a small one around the crown.
                let above = from + (1.55 - from) * t;
                let d = direction([around, above]);
                let ripple = 0.0009 * noise(around * 24.0, t * 5.0, 31);
                // It comes out of the skin behind the roots of the first locks.
                let height = (0.5 + 0.22 * smoothstep(0.3, 0.75, d.y)) * thickness(&d)
                    - 0.0022 * smoothstep(0.09, 0.0, above - from)
                    + ripple * smoothstep(0.05, 0.2, t);
                dress.vertex(MIDDLE + d * (skull.radius(&d) + height), dark)
            })
            .collect();
        rows.push(ring);
    }
    for pair in rows.windows(2) {
        for k in 0..AROUND {
            let next = (k + 1) % AROUND;
            let corners = [pair[0][k], pair[0][next], pair[1][next], pair[1][k]];
            dress.face(&corners, look::HAIR);
        }
    }
    dress.face(rows.last().map_or(&[], Vec::as_slice), look::HAIR);
}

/// A lock that begins in direction `d`.
fn lock(dress: &mut Layer, skull: &Skull, mut d: Vec3, k: u32) {
    let roll = |of: u32| dice(k * 16 + of + 1000);
    let top = smoothstep(0.30, 0.75, d.y);
    let front = top * smoothstep(0.25, 0.75, d.z);
    let [around, above] = angles(&d);
    // Short and close at the nape, so that none hangs below the hairline.
    let nape = smoothstep(0.45, 0.0, above - line(around)) * smoothstep(1.75, 2.2, around.abs());
    let long = (0.027 + 0.029 * top + 0.008 * front) * (0.8 + 0.45 * roll(0)) * (1.0 - 0.62 * nape);
    let wide = (0.0088 + 0.0014 * top) * (0.75 + 0.5 * roll(1)) * (1.0 - 0.3 * nape);
    let stray = (0.5 - 0.2 * nape) * (roll(2) - 0.5);
    let lift = (0.0012 + 0.0028 * top + 0.004 * front) * roll(3);
    let bright = 0.82 + (0.26 + 0.16 * top as f32) * roll(4) as f32;
    let step = long / (RINGS - 1) as f64;
    let mut rings: Vec<Vec<u32>> = Vec::new();
    for ring in 0..RINGS {
        let t = ring as f64 / (RINGS - 1) as f64;
        let flow = combed(&d);
        let flow = (flow - d * flow.dot(&d))
            .try_normalize(1e-9)
            .unwrap_or_else(Vec3::x);
        let flow = Rotation3::from_axis_angle(&Unit::new_normalize(d), stray) * flow;
        let profile = smoothstep(0.0, 0.30, t + 0.08) * (1.0 - smoothstep(0.45, 1.04, t));
        let arch = (std::f64::consts::PI * t.powf(0.8)).sin();
        let base = thickness(&d);
        let height = base * (0.62 + 0.30 * profile) + lift * arch + 0.0009 * profile;
        let p = MIDDLE + d * (skull.radius(&d) + height);
        let side = flow.cross(&d);
        let colour = {
            let sheen =
                1.0 + 0.55 * smoothstep(0.15, 0.45, t) as f32 * smoothstep(0.8, 0.5, t) as f32;
            let root = mix(HAIR.map(|c| c * 0.8), HAIR, smoothstep(0.0, 0.3, t) as f32);
            root.map(|c| linear(c * bright * sheen))
        };
        let corners = (0..CORNERS).map(|c| {
            let a = std::f64::consts::PI * (c as f64 / (CORNERS - 1) as f64 - 0.5);
            let half = 0.5 * wide * profile.max(0.02);
            p + side * (half * a.sin()) + d * (0.55 * half * (a.cos() - 0.35))
        });
        rings.push(corners.map(|p| dress.vertex(p, colour)).collect());
        d = (p + flow * step - MIDDLE).normalize();
    }
    for pair in rings.windows(2) {
        for c in 0..CORNERS - 1 {
            let corners = [pair[0][c], pair[1][c], pair[1][c + 1], pair[0][c + 1]];
            dress.face(&corners, look::HAIR);
        }
    }
}
