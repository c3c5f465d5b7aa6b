//! The simulator's truth against its own pictures.

use nalgebra::Translation3;

use super::*;
use crate::geometry::rotation_from_yaw_pitch_roll;
use crate::sensor::NO_DEPTH;

fn facing(z: f32, yaw: f32) -> Rigid {
    Rigid::from_parts(
        Translation3::new(0.02, -0.01, z),
        rotation_from_yaw_pitch_roll(yaw, 0.05, 0.03),
    )
}

fn at(t: f64) -> Timestamp {
    Timestamp::from_us((t * 1e6) as u64)
}

/// Order-sensitive digest of what a frame holds (FNV-1a, 64 bit).
fn digest(frame: &Frame) -> u64 {
    let depth = frame.depth.iter().flat_map(|raw| raw.to_le_bytes());
    depth
        .chain(frame.bayer.iter().copied())
        .fold(0xcbf2_9ce4_8422_2325, |h, b| {
            (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3)
        })
}

#[test]
fn the_depth_at_a_landmark_is_the_truth_within_the_noise() {
    let mut simulator = Simulator::new(HeadAsset::shipped(), Scene::Still, 3);
    let mut frame = Frame::default();
    let weights = vec![0.0; simulator.asset().expressions.len()];
    for (z, yaw) in [(0.7, 0.0), (0.9, 0.3), (0.65, -0.2)] {
        let truth = simulator.draw_pose(&facing(z, yaw), &weights, at(z.into()), &mut frame);
        let camera = Camera::nominal();
        // Points of flat, open surface: bridge of the nose, lips.
        for k in [27, 28, 51, 57] {
            let p = truth.sensor_from_head * truth.landmarks_head[k];
            let [col, row] = camera.depth_pixel(&p);
            let raw = frame.depth[row.round() as usize * WIDTH + col.round() as usize];
            let error = f32::from(raw) - camera.raw_from_m(p.z);
            assert!(
                raw != NO_DEPTH && error.abs() < 4.0,
                "landmark {k}: {error} raw units off"
            );
        }
    }
}

#[test]
fn a_marked_landmark_is_seen_at_its_true_colour_pixel() {
    for k in [30, 33, 8, 51] {
        let mut asset = HeadAsset::shipped();
        let marked = asset.landmarks[k].vertices[0];
        asset.photo_share = vec![0.0; asset.neutral.len()].into();
        let mut colour = vec![[0.0; 3]; asset.neutral.len()];
        colour[marked as usize] = [255.0; 3];
        asset.colour = colour.into();
        // The mark is a vertex, so the landmark is made that vertex.
        let mut sites = asset.landmarks.to_vec();
        sites[k] = Site::vertex(marked);
        asset.landmarks = sites.into();
        let n = asset.expressions.len();
        let mut simulator = Simulator::new(asset, Scene::Still, 1).lit(
            Light {
                ambient: 1.0,
                ..Light::default()
            },
            1.0,
        );
        let mut frame = Frame::default();
        let truth = simulator.draw_pose(&facing(0.6, 0.15), &vec![0.0; n], at(1.0), &mut frame);
        let [x, y] = truth.landmarks_px[k];
        let (mut sum, mut cx, mut cy) = (0.0, 0.0, 0.0);
        for row in y as usize - 8..y as usize + 9 {
            for col in x as usize - 8..x as usize + 9 {
                let bright = (f32::from(frame.luma[row * WIDTH + col]) - 12.0).max(0.0);
                sum += bright;
                cx += bright * col as f32;
                cy += bright * row as f32;
            }
        }
        let (dx, dy) = (cx / sum - x, cy / sum - y);
        assert!(
            sum > 100.0 && dx.hypot(dy) < 1.0,
            "landmark {k}: {dx:.2}, {dy:.2} px off"
        );
    }
}

#[test]
fn the_same_seed_and_time_give_the_same_bytes_in_any_order() {
    let mut one = Simulator::new(HeadAsset::shipped(), Scene::Acted, 5);
    let mut two = Simulator::new(HeadAsset::shipped(), Scene::Acted, 5);
    let mut other = Simulator::new(HeadAsset::shipped(), Scene::Acted, 6);
    let (mut a, mut b) = (Frame::default(), Frame::default());
    one.draw(at(4.0), &mut a);
    one.draw(at(9.0), &mut a);
    two.draw(at(9.0), &mut b);
    assert_eq!(digest(&a), digest(&b));
    assert_eq!(a.luma, b.luma);
    other.draw(at(9.0), &mut b);
    assert_ne!(digest(&a), digest(&b));
    two.draw(at(9.034), &mut b);
    assert_ne!(a.depth, b.depth, "noise that stands still");
}

#[test]
fn an_empty_room_has_nobody_and_a_face_covers_a_tenth_at_most() {
    let mut frame = Frame::default();
    let mut empty = Simulator::new(HeadAsset::shipped(), Scene::Empty, 1);
    assert!(empty.draw(at(1.0), &mut frame).is_none());
    let nearest = frame.depth.iter().filter(|raw| **raw != NO_DEPTH).min();
    assert!(nearest.is_some_and(|&raw| Camera::nominal().depth_m(raw) > 1.0));
    let mut still = Simulator::new(HeadAsset::shipped(), Scene::Still, 1);
    let truth = still.draw(at(1.0), &mut frame).expect("somebody");
    let inside = truth
        .landmarks_px
        .iter()
        .all(|p| (0.0..640.0).contains(&p[0]) && (0.0..480.0).contains(&p[1]));
    assert!(inside);
}

/// Changes only on purpose: pictures of the whole chain of tests stand on it.
#[test]
fn a_still_frame_is_the_golden_one() {
    let mut frame = Frame::default();
    Simulator::new(HeadAsset::shipped(), Scene::Still, 1).draw(at(1.0), &mut frame);
    assert_eq!(format!("{:016x}", digest(&frame)), "44bc8aba5988b28d");
}
