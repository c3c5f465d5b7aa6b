//! What people wear and hold, drawn over the grey picture of a face, each now and then, in this order: beards, glasses, hair,
//! headwear, and hands and things before the face.
//!
//! Drawn from the projected landmarks, so all of it turns and grows with the face; seeded by the caller. Pixels, grey levels.
//! Limitation: flat drawings without parallax; what they teach is not to lean on one patch alone.

use fastrand::Rng;

use super::grey_picture::{Picture, Points, inside, middle};
use super::hair_and_headwear::{headwear, mane};
use super::random::{either, normal};
use crate::base::capacity::LANDMARKS;

/// Beard, glasses, hair, headwear and what is before the face, each now and then.
pub(super) fn wear(rng: &mut Rng, points: &Points, picture: &mut Picture) {
    if rng.f32() < 0.2 {
        beard(rng, points, picture);
    }
    if rng.f32() < 0.15 {
        glasses(rng, points, picture);
    }
    if rng.f32() < 0.35 {
        mane(rng, points, picture);
    }
    if rng.f32() < 0.15 {
        headwear(rng, points, picture);
    }
    if rng.f32() < 0.22 {
        let cover = if rng.f32() < 0.35 { hand } else { block };
        cover(rng, points, picture);
    }
}

/// Something in front of the face: a hand's or a cup's worth of flat or noisy grey.
fn block(rng: &mut Rng, points: &Points, picture: &mut Picture) {
    let face = (points[16][0] - points[0][0])
        .abs()
        .max((points[8][1] - points[27][1]).abs())
        .max(8.0);
    let at = points[rng.usize(..LANDMARKS)];
    let half = [0, 1].map(|_| face * (0.08 + 0.22 * rng.f32()));
    let (round, base) = (rng.bool(), 20.0 + 210.0 * rng.f32());
    let rough = 40.0 * rng.f32() * rng.f32();
    let covers = |x: f32, y: f32| {
        let (u, v) = ((x - at[0]) / half[0], (y - at[1]) / half[1]);
        if round {
            u * u + v * v < 1.0
        } else {
            u.abs() < 1.0 && v.abs() < 1.0
        }
    };
    for row in 0..picture.height {
        for col in 0..picture.width {
            if covers(col as f32, row as f32) {
                picture.grey[row * picture.width + col] = base + rough * either(rng);
            }
        }
    }
    for (point, visible) in points.iter().zip(&mut *picture.visible) {
        *visible &= !covers(point[0], point[1]);
    }
}

fn distance(a: [f32; 2], b: [f32; 2]) -> f32 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// Width of the face, pixels.
fn face_width(points: &Points) -> f32 {
    distance(points[36], points[45]).max(4.0) * 1.55
}

/// A beard or stubble between jaw and lips, sometimes only on the upper lip or on the chin, sometimes well below the jaw.
fn beard(rng: &mut Rng, points: &Points, picture: &mut Picture) {
    let outline = beard_outline(rng, points);
    let (width, height) = (picture.width, picture.height);
    let face = face_width(points);
    let soft = (face * 0.025).max(1.0) as usize;
    let mut mask = vec![0.0; width * height];
    for row in 0..height {
        for column in 0..width {
            let (x, y) = (column as f32, row as f32);
            if inside(&outline, x, y) && !inside(&points[48..60], x, y) {
                mask[row * width + column] = 1.0;
            }
        }
    }
    // Soft edges: a running mean along rows, twice as long along none; beards fade sideways more than their grain.
    for row in mask.chunks_exact_mut(width) {
        let line = row.to_vec();
        for (column, value) in row.iter_mut().enumerate() {
            let from = column.saturating_sub(soft);
            let to = (column + soft + 1).min(width);
            *value = line[from..to].iter().sum::<f32>() / (to - from) as f32;
        }
    }
    let dense = 0.2 + 0.7 * rng.f32();
    let shade = 15.0 + 110.0 * rng.f32() * rng.f32();
    let grain = 0.5 * rng.f32();
    for (value, share) in picture.grey.iter_mut().zip(mask.iter()) {
        if *share > 0.0 {
            let share = (share * dense * (1.0 + grain * either(rng))).clamp(0.0, 1.0);
            *value += share * (shade - *value);
        }
    }
}

/// Where a beard grows.
fn beard_outline(rng: &mut Rng, points: &Points) -> Vec<[f32; 2]> {
    let between = |a: usize, b: usize, t: f32| {
        [0, 1].map(|k| points[a][k] + t * (points[b][k] - points[a][k]))
    };
    match rng.u8(..4) {
        // Upper lip.
        0 => vec![
            between(48, 31, 0.25),
            between(33, 51, 0.25),
            between(54, 35, 0.25),
            points[54],
            points[52],
            points[51],
            points[50],
            points[48],
        ],
        // Chin.
        1 => vec![
            points[59],
            points[57],
            points[55],
            between(10, 55, 0.2),
            points[9],
            points[8],
            points[7],
            between(6, 59, 0.2),
        ],
        _ => {
            let top = 0.1 + 0.4 * rng.f32();
            // Fuller beards hide the jaw.
            let full = 1.0 + 0.3 * (rng.f32() - 0.4).max(0.0);
            let mut outline: Vec<[f32; 2]> = (3..=13).map(|k| between(33, k, full)).collect();
            let above = [(13, 54, 0.35), (54, 35, top), (33, 51, 0.3), (48, 31, top)];
            outline.extend(above.map(|(a, b, t)| between(a, b, t)));
            outline.push(between(3, 48, 0.35));
            outline
        }
    }
}

/// Glasses: two rims, a bridge, the start of the temples, sometimes a sheen or tinted glass.
fn glasses(rng: &mut Rng, points: &Points, picture: &mut Picture) {
    let (width, height) = (picture.width, picture.height);
    let eyes = [36..42, 42..48].map(|eye| middle(&points[eye]));
    let between = distance(eyes[0], eyes[1]).max(4.0);
    let along = [0, 1].map(|k| (eyes[1][k] - eyes[0][k]) / between);
    let down = [-along[1], along[0]];
    // Each rim as wide as its own eye: the far one is narrower when the head is turned.
    let wide = [(36, 39), (42, 45)].map(|(a, b)| distance(points[a], points[b]).max(2.0));
    let (grow, tall) = (0.85 + 0.25 * rng.f32(), 0.24 + 0.14 * rng.f32());
    let sharp = 2.0 + 4.0 * rng.f32() * rng.f32();
    let low = between * (0.06 * rng.f32() - 0.01);
    let thick = between * (0.012 + 0.045 * rng.f32() * rng.f32());
    let rim = 15.0 + 200.0 * rng.f32() * rng.f32();
    let (tint, sheen) = if rng.f32() < 0.2 {
        (0.3 + 0.6 * rng.f32(), 0.0)
    } else {
        (1.0, 50.0 * rng.f32() * rng.f32())
    };
    let radius = wide.map(|w| [w * grow, between * tall]);
    for row in 0..height {
        for column in 0..width {
            let value = &mut picture.grey[row * width + column];
            let mut frame = false;
            for side in 0..2 {
                let off = [column as f32 - eyes[side][0], row as f32 - eyes[side][1]];
                let u = off[0] * along[0] + off[1] * along[1];
                let v = off[0] * down[0] + off[1] * down[1] - low;
                let norm = |grown: f32| {
                    (u.abs() / (radius[side][0] + grown)).powf(sharp)
                        + (v.abs() / (radius[side][1] + grown)).powf(sharp)
                };
                if v.abs() > radius[side][1] + thick {
                    continue;
                }
                if norm(0.0) < 1.0 {
                    *value = *value * tint + sheen;
                } else if norm(thick) < 1.0 {
                    frame = true;
                }
                // Bridge and temples at the height of the upper rim.
                let outwards = if side == 0 { -u } else { u };
                let high = (v + 0.35 * radius[side][1]).abs() < 0.7 * thick;
                let bridge = -outwards > radius[side][0] && -outwards < 0.5 * between;
                let temple = outwards > radius[side][0] && outwards < 1.7 * wide[side];
                frame |= high && (bridge || temple);
            }
            if frame {
                *value += 0.9 * (rim - *value);
            }
        }
    }
}

/// Fingers before the face: rounded strips of about the skin's grey, shaded across.
fn hand(rng: &mut Rng, points: &Points, picture: &mut Picture) {
    let face = face_width(points);
    let at = points[rng.usize(..LANDMARKS)];
    let cheek = |[x, y]: [f32; 2]| {
        let (x, y) = (x.max(0.0) as usize, y.max(0.0) as usize);
        picture.grey[y.min(picture.height - 1) * picture.width + x.min(picture.width - 1)]
    };
    let skin = cheek(points[30]) * (1.0 + 0.2 * normal(rng));
    let (sin, cos) = (std::f32::consts::TAU * rng.f32()).sin_cos();
    let finger = face * (0.05 + 0.03 * rng.f32());
    let fingers = (0..2 + rng.usize(..3)).map(|k| {
        let middle = (k as f32 - 1.5) * finger * 2.05 + 0.2 * finger * either(rng);
        [middle, 0.25 * face * rng.f32()]
    });
    let fingers: Vec<[f32; 2]> = fingers.collect();
    // Darkness at a place, none if it is not covered.
    let cover = |x: f32, y: f32| {
        let (dx, dy) = (x - at[0], y - at[1]);
        let (u, v) = (dx * cos + dy * sin, dy * cos - dx * sin);
        let far = |[middle, end]: &[f32; 2]| {
            let beyond = ((v - end) / finger).max(0.0);
            ((u - middle) / finger).hypot(beyond)
        };
        fingers.iter().map(far).fold(f32::INFINITY, f32::min)
    };
    picture.paint(points, |x, y| {
        let far = cover(x, y);
        (far < 1.0).then_some(skin * (1.05 - 0.45 * far * far))
    });
}
