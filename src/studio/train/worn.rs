//! What is worn and held in a training picture, each now and then, in this order.

use fastrand::Rng;

use super::beards_glasses_hands::{beard, glasses, hand};
use super::grey_picture::{Picture, Points};
use super::hair_and_headwear::{headwear, mane};
use super::random::either;
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
    let (round, base, rough) = (
        rng.bool(),
        20.0 + 210.0 * rng.f32(),
        40.0 * rng.f32() * rng.f32(),
    );
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
