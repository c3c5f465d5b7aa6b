//! Lashes: thin blades along the lines that the head's file has for the left eye, mirrored for the right.
//!
//! Each is a separate part beside the lid, so that the baker attaches it to the nearest skin.

use super::layer::Layer;
use super::look;
use super::make::{COLUMNS, ROWS};
use crate::bake::mesh::Vec3;

/// For the upper, then the lower lid: number, length as share of the guide line, width at the root in metres.
const LIDS: [(usize, f64, f64); 2] = [(44, 0.62, 0.00042), (26, 0.40, 0.00026)];
/// Points of a blade from root to tip.
const STEPS: usize = 5;

pub(super) fn grow(face: &mut Layer, guides: &[Vec3]) {
    for ((count, length, width), card) in LIDS.into_iter().zip(guides.chunks(COLUMNS * ROWS)) {
        for side in [1.0, -1.0] {
            for k in 0..count {
                let across = (k as f64 + 0.5 + 0.5 * (dice(k as u32) - 0.5)) / count as f64;
                let long = length * (0.85 + 0.3 * dice(k as u32 + 77));
                blade(face, card, [across, long, width], side);
            }
        }
    }
}

/// One blade `across` the lid (0…1), `long` (share of the line), `wide` at its root (metres).
fn blade(face: &mut Layer, card: &[Vec3], [across, long, wide]: [f64; 3], side: f64) {
    let line = |t: f64, shift: f64| {
        let column = (across * (COLUMNS - 1) as f64 + shift).clamp(0.0, (COLUMNS - 1) as f64);
        let row = |r: usize| {
            let points: Vec<Vec3> = (0..COLUMNS).map(|c| card[c * ROWS + r]).collect();
            curve(&points, column)
        };
        let points: Vec<Vec3> = (0..ROWS).map(row).collect();
        curve(&points, t * long * (ROWS - 1) as f64)
    };
    let aside = (line(0.0, 0.3) - line(0.0, -0.3))
        .try_normalize(1e-12)
        .unwrap_or_else(Vec3::x);
    let mut rows: Vec<Vec<u32>> = Vec::new();
    for step in 0..STEPS {
        let t = step as f64 / (STEPS - 1) as f64;
        let (p, half) = (line(t, 0.0), aside * (0.5 * wide * (1.0 - t)));
        let places = match step + 1 == STEPS {
            true => vec![p],
            false => vec![p - half, p + half],
        };
        let mirrored = |p: Vec3| Vec3::new(side * p.x, p.y, p.z);
        let places = places.into_iter().map(mirrored);
        rows.push(places.map(|p| face.vertex(p, [1.0; 3])).collect());
    }
    for pair in rows.windows(2) {
        let mut corners = vec![pair[0][0], pair[0][1]];
        corners.extend(pair[1].iter().rev());
        if side < 0.0 {
            corners.reverse();
        }
        face.face(&corners, look::LASHES);
    }
}

/// A pseudorandom number 0…1 for `k`.
fn dice(k: u32) -> f64 {
    let mut x = k.wrapping_mul(0x9E37_79B9) ^ 0x85EB_CA6B;
    for shift in [16, 13] {
        x = (x ^ (x >> shift)).wrapping_mul(0xC2B2_AE35);
    }
    f64::from(x ^ (x >> 16)) / f64::from(u32::MAX)
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
