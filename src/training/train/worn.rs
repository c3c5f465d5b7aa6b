//! Beards, glasses, hair, headwear, hands and objects painted over the grey training picture, each occasionally, in
//! this order.
//!
//! Positioned by the projected landmarks, so that all of it rotates and scales with the face; seeded by the caller.
//! Pixels, grey levels. Limitation: flat drawings without parallax; they train against reliance on single patches.

use fastrand::Rng;

use super::grey_picture::{Picture, inside, middle};
use super::hair_and_headwear::{headwear, mane};
use super::random::{either, normal};
use mien_simulator::virtual_head::Points;
use mien_stages::base::capacity::LANDMARKS;
use mien_stages::face_model::scheme;

type Mark = fn(&mut Rng, &mut Picture);

/// Adds beard, glasses, hair, headwear and occluders, each occasionally.
pub(super) fn wear(rng: &mut Rng, picture: &mut Picture) {
    let worn: [(f32, Mark); 4] = [
        (0.2, beard),
        (0.15, glasses),
        (0.35, mane),
        (0.15, headwear),
    ];
    for (often, put_on) in worn {
        if rng.f32() < often {
            put_on(rng, picture);
        }
    }
    if rng.f32() < 0.22 {
        let cover = if rng.f32() < 0.35 { hand } else { block };
        cover(rng, picture);
    }
}

/// An occluder of about a hand's or a cup's size, flat or noisy grey.
fn block(rng: &mut Rng, picture: &mut Picture) {
    let points = picture.points;
    let wide = (points[16][0] - points[0][0]).abs();
    let face = wide.max((points[8][1] - points[27][1]).abs()).max(8.0);
    let at = points[rng.usize(..LANDMARKS)];
    let half = [0, 1].map(|_| face * (0.08 + 0.22 * rng.f32()));
    let (round, base) = (rng.bool(), 20.0 + 210.0 * rng.f32());
    let rough = 40.0 * rng.f32() * rng.f32();
    picture.paint(|x, y| {
        let (u, v) = ((x - at[0]) / half[0], (y - at[1]) / half[1]);
        let square = u.abs().max(v.abs());
        let far = if round { u.hypot(v) } else { square };
        (far < 1.0).then(|| base + rough * either(rng))
    });
}

/// Width of the face, pixels.
fn face_width(points: &Points) -> f32 {
    scheme::outer_eye_distance(points).max(4.0) * 1.55
}

/// A beard or stubble between jaw and lips, sometimes only on the upper lip or on the chin, sometimes well below the jaw.
fn beard(rng: &mut Rng, picture: &mut Picture) {
    let (points, width) = (picture.points, picture.width);
    let outline = beard_outline(rng, points);
    let soft = (face_width(points) * 0.025).max(1.0) as usize;
    let mut mask = Vec::with_capacity(picture.grey.len());
    picture.each(|x, y, _| {
        let grows = inside(&outline, x, y) && !inside(&points[48..60], x, y);
        mask.push(f32::from(u8::from(grows)));
    });
    // Soft edges: a running mean along rows; beards fade sideways more than their grain.
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

/// The outline of a beard.
fn beard_outline(rng: &mut Rng, points: &Points) -> Vec<[f32; 2]> {
    let between = |a: usize, b: usize, t: f32| {
        [0, 1].map(|k| points[a][k] + t * (points[b][k] - points[a][k]))
    };
    let on = |k: usize| points[k];
    match rng.u8(..4) {
        // Upper lip.
        0 => {
            let above = [(48, 31), (33, 51), (54, 35)].map(|(a, b)| between(a, b, 0.25));
            [&above[..], &[54, 52, 51, 50, 48].map(on)].concat()
        }
        // Chin.
        1 => {
            let [left, right] = [(10, 55), (6, 59)].map(|(a, b)| between(a, b, 0.2));
            [
                &[59, 57, 55].map(on)[..],
                &[left],
                &[9, 8, 7].map(on),
                &[right],
            ]
            .concat()
        }
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
fn glasses(rng: &mut Rng, picture: &mut Picture) {
    let points = picture.points;
    let eyes = [36..42, 42..48].map(|eye| middle(&points[eye]));
    let distance = |a: [f32; 2], b: [f32; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
    let between = distance(eyes[0], eyes[1]).max(4.0);
    let along = [0, 1].map(|k| (eyes[1][k] - eyes[0][k]) / between);
    let down = [-along[1], along[0]];
    // Each rim is as wide as its own eye: the far one is narrower in a turned head.
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
    picture.each(|x, y, value| {
        let mut frame = false;
        for side in 0..2 {
            let off = [x - eyes[side][0], y - eyes[side][1]];
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
    });
}

/// Fingers in front of the face: rounded strips of about the skin's grey, shaded across.
fn hand(rng: &mut Rng, picture: &mut Picture) {
    let (points, width) = (picture.points, picture.width);
    let face = face_width(points);
    let at = points[rng.usize(..LANDMARKS)];
    let [x, y] = points[30].map(|at| at.max(0.0) as usize);
    let nose = (y * width + x.min(width - 1)).min(picture.grey.len() - 1);
    let skin = picture.grey[nose] * (1.0 + 0.2 * normal(rng));
    let (sin, cos) = (std::f32::consts::TAU * rng.f32()).sin_cos();
    let finger = face * (0.05 + 0.03 * rng.f32());
    let fingers = (0..2 + rng.usize(..3)).map(|k| {
        let middle = (k as f32 - 1.5) * finger * 2.05 + 0.2 * finger * either(rng);
        [middle, 0.25 * face * rng.f32()]
    });
    let fingers: Vec<[f32; 2]> = fingers.collect();
    picture.paint(|x, y| {
        let (dx, dy) = (x - at[0], y - at[1]);
        let (u, v) = (dx * cos + dy * sin, dy * cos - dx * sin);
        let far = |[middle, end]: &[f32; 2]| {
            let beyond = ((v - end) / finger).max(0.0);
            ((u - middle) / finger).hypot(beyond)
        };
        // Darker towards the edges.
        let far = fingers.iter().map(far).fold(f32::INFINITY, f32::min);
        (far < 1.0).then_some(skin * (1.05 - 0.45 * far * far))
    });
}
