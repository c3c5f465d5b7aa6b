//! Paints eyes by rule over a photograph's: sharp irises of many colours.
//!
//! A photograph shows one glance, with its iris half hidden by the lids it was taken with. Iris and pupil are cones about the
//! eyeball's axis: 11.7 mm across on a ball of 24 mm, Gross & Rubeiz's mean.

use std::sync::Arc;

use crate::simulator::virtual_head::HeadAsset;
use crate::studio::heads::ict::eyeballs;

/// Angles from the axis up to which there is pupil, iris and the dark rim of the iris, radians.
const PUPIL: f32 = 0.17;
const IRIS: f32 = 0.44;
const RIM: f32 = 0.51;

/// Paints both eyeballs of a head; seeded.
pub fn paint(asset: &mut HeadAsset, seed: u64) {
    let mut random = fastrand::Rng::with_seed(seed);
    let mut between = |low: f32, high: f32| low + (high - low) * random.f32();
    // From nearly black by brown to grey, green and blue.
    let light = between(18.0, 110.0);
    let iris = [
        light * between(0.9, 1.3),
        light * between(0.75, 1.1),
        light * between(0.5, 1.25),
    ];
    let white = between(150.0, 225.0);
    let (mut share, mut colour) = (asset.photo_share.to_vec(), asset.colour.to_vec());
    for (ball, centre) in eyeballs(&asset.neutral) {
        for v in ball {
            let out = asset.neutral[v] - centre;
            // The face looks towards the camera, against z.
            let angle = (-out.z / out.norm().max(1e-6)).acos();
            share[v] = 0.0;
            colour[v] = match angle {
                a if a < PUPIL => [10.0, 9.0, 9.0],
                a if a < IRIS => iris,
                a if a < RIM => iris.map(|c| 0.4 * c),
                _ => [white, 0.95 * white, 0.92 * white],
            };
        }
    }
    (asset.photo_share, asset.colour) = (Arc::from(share), Arc::from(colour));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::geometry::{Point, Vector};
    use crate::studio::heads::ict::{Delta, part, turn_eyes};

    /// Two balls of 12 mm, covered evenly (Fibonacci).
    fn round_eyes() -> Vec<Point> {
        let half = part::EYEBALLS.len() / 2;
        let mut neutral = vec![Point::origin(); part::EYEBALLS.end];
        for v in part::EYEBALLS {
            let k = v - part::EYEBALLS.start;
            let x = if k < half { -0.03 } else { 0.03 };
            let z = 1.0 - 2.0 * ((k % half) as f32 + 0.5) / half as f32;
            let (r, turn) = ((1.0 - z * z).sqrt(), 2.4 * k as f32);
            neutral[v] = Point::new(
                x + 0.012 * r * turn.cos(),
                0.012 * r * turn.sin(),
                0.012 * z,
            );
        }
        neutral
    }

    #[test]
    fn eyes_look_where_the_expression_says_and_stay_in_their_sockets() {
        let neutral = round_eyes();
        let half = part::EYEBALLS.len() / 2;
        for (name, side, to) in [
            ("eyeLookOut_L", 1, Vector::x()),
            ("eyeLookIn_L", 1, -Vector::x()),
            ("eyeLookOut_R", 0, -Vector::x()),
            ("eyeLookUp_R", 0, -Vector::y()),
            ("eyeLookDown_L", 1, Vector::y()),
            ("eyeBlink_L", 1, Vector::zeros()),
        ] {
            let mut expressions = [Delta {
                name: name.into(),
                offsets: vec![Vector::zeros(); neutral.len()],
            }];
            turn_eyes(&neutral, &mut expressions);
            let offsets = &expressions[0].offsets;
            let start = part::EYEBALLS.start + side * half;
            let pupil =
                (start..start + half).min_by(|&a, &b| neutral[a].z.total_cmp(&neutral[b].z));
            let moved = offsets[pupil.expect("a ball")];
            // 12 mm by the sine of 30°.
            assert!(
                (moved.dot(&to) - 0.006 * to.norm()).abs() < 3e-4,
                "{name} {moved}"
            );
            let other = part::EYEBALLS.start + (1 - side) * half;
            assert!(
                offsets[other..other + half]
                    .iter()
                    .all(|o| *o == Vector::zeros())
            );
            let radius = |v: usize| (neutral[v] + offsets[v] - eyeballs(&neutral)[side].1).norm();
            assert!(
                (start..start + half).all(|v| (radius(v) - 0.012).abs() < 1e-4),
                "{name}"
            );
        }
    }

    #[test]
    fn irises_are_round_and_in_the_middle_of_both_eyes() {
        let half = part::EYEBALLS.len() / 2;
        let n = part::EYEBALLS.end;
        let mut asset = HeadAsset {
            neutral: round_eyes(),
            photo_share: vec![1.0; n].into(),
            colour: vec![[0.0; 3]; n].into(),
            ..HeadAsset::default()
        };
        paint(&mut asset, 5);
        for (side, x) in [(0, -0.03), (1, 0.03)] {
            let start = part::EYEBALLS.start + side * half;
            let dark: Vec<Point> = (start..start + half)
                .filter(|&v| asset.colour[v][0] < 140.0)
                .map(|v| asset.neutral[v])
                .collect();
            let share = dark.len() as f32 / half as f32;
            // A cone of angle a covers (1 − cos a) / 2 of a ball.
            assert!((share - (1.0 - RIM.cos()) / 2.0).abs() < 0.005, "{share}");
            let middle = dark.iter().map(|p| p.x).sum::<f32>() / dark.len() as f32;
            assert!((middle - x).abs() < 5e-4 && dark.iter().all(|p| p.z < -0.01));
        }
        assert!(part::EYEBALLS.clone().all(|v| asset.photo_share[v] == 0.0));
    }
}
