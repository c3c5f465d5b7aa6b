//! Paints synthetic eyes over a photograph's: sharp irises of many colours.
//!
//! A photograph shows one gaze, with the iris half hidden by the lids. Iris and pupil are cones about the eyeball's
//! axis: 11.7 mm across on a ball of 24 mm, the mean of Gross & Rubeiz.

use std::sync::Arc;

use crate::heads::ict::eyeballs;
use mien_simulator::virtual_head::HeadAsset;

/// Angle from the axis up to which there is pupil, radians.
const PUPIL: f32 = 0.17;
/// Angle from the axis up to which there is iris, radians.
const IRIS: f32 = 0.44;
/// Angle from the axis up to which there is the iris's dark rim, radians.
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
    let white = between(70.0, 225.0);
    let (mut share, mut colour) = (asset.photo_share.to_vec(), asset.colour.to_vec());
    for (ball, centre) in eyeballs(&asset.neutral) {
        for v in ball {
            let out = asset.neutral[v] - centre;
            // The face looks towards the camera, along −z.
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
    use crate::heads::ict::part;
    use crate::heads::ict::tests::round_eyes;
    use mien_stages::base::geometry::Point;

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
