//! The simulator's truth against its own pictures.

use nalgebra::Translation3;

use super::*;
use mien_sensors::kinect::frame::KinectFrame;
use mien_sensors::kinect::unpack::NO_READING;
use mien_stages::base::geometry::{Vector, rotation_from_yaw_pitch_roll};

fn facing(z: f32, yaw: f32) -> Rigid {
    Rigid::from_parts(
        Translation3::new(0.02, -0.01, z),
        rotation_from_yaw_pitch_roll(yaw, 0.05, 0.03),
    )
}

fn seconds(t: f64) -> Timestamp {
    Timestamp::from_us((t * 1e6) as u64)
}

/// Order-sensitive digest of what a frame holds (FNV-1a, 64 bit).
fn digest(frame: &KinectFrame) -> u64 {
    let depth = frame.depth.iter().flat_map(|raw| raw.to_le_bytes());
    depth
        .chain(frame.original.bayer.iter().copied())
        .fold(0xcbf2_9ce4_8422_2325, |h, b| {
            (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3)
        })
}

#[test]
fn the_depth_at_a_landmark_is_the_truth_within_the_noise() {
    let mut simulator = Simulator::new(HeadAsset::shipped(), Scene::Still, 3);
    let mut frame = KinectFrame::default();
    let weights = vec![0.0; simulator.asset().expressions.len()];
    for (z, yaw) in [(0.7, 0.0), (0.9, 0.3), (0.65, -0.2)] {
        let truth = simulator.draw_pose(&facing(z, yaw), &weights, seconds(z.into()), &mut frame);
        let camera = mien_sensors::kinect::geometry::nominal();
        // Points of flat, open surface: bridge of the nose, lips.
        for k in [27, 28, 51, 57] {
            let p = truth.sensor_from_head * truth.landmarks_head[k];
            let [col, row] = camera.depth_pixel(&p);
            let raw = frame.depth[row.round() as usize * WIDTH + col.round() as usize];
            let error = f32::from(raw) - camera.raw_from_m(p.z);
            assert!(
                raw != NO_READING && error.abs() < 4.0,
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
        let mut simulator = Simulator::new(asset, Scene::Still, 1).with_light(
            Light {
                ambient: 1.0,
                ..Light::default()
            },
            1.0,
        );
        let mut frame = KinectFrame::default();
        let truth =
            simulator.draw_pose(&facing(0.6, 0.15), &vec![0.0; n], seconds(1.0), &mut frame);
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
    let (mut a, mut b) = (KinectFrame::default(), KinectFrame::default());
    one.draw(seconds(4.0), &mut a);
    one.draw(seconds(9.0), &mut a);
    two.draw(seconds(9.0), &mut b);
    assert_eq!(digest(&a), digest(&b));
    assert_eq!(a.luma, b.luma);
    other.draw(seconds(9.0), &mut b);
    assert_ne!(digest(&a), digest(&b));
    two.draw(seconds(9.034), &mut b);
    assert_ne!(a.depth, b.depth, "noise that stands still");
}

#[test]
fn an_empty_room_has_nobody_and_a_face_covers_a_tenth_at_most() {
    let mut frame = KinectFrame::default();
    let mut empty = Simulator::new(HeadAsset::shipped(), Scene::Empty, 1);
    assert!(empty.draw(seconds(1.0), &mut frame).is_none());
    let nearest = frame.depth.iter().filter(|raw| **raw != NO_READING).min();
    assert!(
        nearest.is_some_and(|&raw| mien_sensors::kinect::geometry::nominal().depth_m(raw) > 1.0)
    );
    let mut still = Simulator::new(HeadAsset::shipped(), Scene::Still, 1);
    let truth = still.draw(seconds(1.0), &mut frame).expect("somebody");
    let inside = truth
        .landmarks_px
        .iter()
        .all(|p| (0.0..640.0).contains(&p[0]) && (0.0..480.0).contains(&p[1]));
    assert!(inside);
}

/// Changes only on purpose: pictures of the whole chain of tests stand on it.
#[test]
fn a_still_frame_is_the_golden_one() {
    let mut frame = KinectFrame::default();
    Simulator::new(HeadAsset::shipped(), Scene::Still, 1).draw(seconds(1.0), &mut frame);
    assert_eq!(format!("{:016x}", digest(&frame)), "44bc8aba5988b28d");
}

fn dressed(look: Appearance) -> Simulator {
    Simulator::new(HeadAsset::shipped(), Scene::Acted, 5).dressed([look])
}

fn drawn(simulator: &mut Simulator, t: f64) -> (KinectFrame, Truth) {
    let mut frame = KinectFrame::default();
    let truth = simulator.draw(seconds(t), &mut frame).expect("somebody");
    (frame, truth)
}

#[test]
fn hair_stands_off_the_head_and_both_cameras_see_it() {
    let look = |hair| Appearance {
        hair,
        hair_colour: [20.0, 18.0, 18.0],
        clothes: [120.0, 120.0, 120.0],
        ..Appearance::default()
    };
    let camera = mien_sensors::kinect::geometry::nominal();
    let (bald, truth) = drawn(&mut dressed(look(HairStyle::Bald)), 0.5);
    let (bushy, _) = drawn(&mut dressed(look(HairStyle::Bushy)), 0.5);
    let (long, _) = drawn(&mut dressed(look(HairStyle::Long)), 0.5);
    // Of the 9 × 9 pixels around a point, the share nearer than 1 m, and the mean grey level.
    let around = |frame: &KinectFrame, p: &Point| {
        let places = |[col, row]: [f32; 2]| {
            (0..81).map(move |k| {
                let (c, r) = (col as usize + k % 9 - 4, row as usize + k / 9 - 4);
                r * WIDTH + c
            })
        };
        let near =
            |&at: &usize| frame.depth[at] != NO_READING && camera.depth_m(frame.depth[at]) < 1.0;
        let grey = places(camera.colour_pixel(p)).map(|at| f32::from(frame.luma[at]));
        let count = places(camera.depth_pixel(p)).filter(near).count();
        (count as f32 / 81.0, grey.sum::<f32>() / 81.0)
    };
    // Two centimetres above the crown of the bald, and beside the neck.
    let pose = truth.sensor_from_head;
    let crown = pose * Point::new(0.0, -0.135, 0.06);
    let beside = [-0.08, 0.08].map(|x| pose * Point::new(x, 0.05, 0.07));
    for (frame, p) in [(&bushy, crown), (&long, beside[0]), (&long, beside[1])] {
        let ((with, dark), (without, bright)) = (around(frame, &p), around(&bald, &p));
        assert!(
            with > 0.4 && without < 0.1,
            "{p}: {with} with hair, {without} without"
        );
        assert!(
            dark < 70.0 && bright > 90.0,
            "{p}: {dark} with hair, {bright} without"
        );
    }
    // The face itself is free.
    let nose = pose * truth.landmarks_head[30];
    let [col, row] = camera.depth_pixel(&nose);
    let raw = long.depth[row.round() as usize * WIDTH + col.round() as usize];
    assert!((camera.depth_m(raw) - nose.z).abs() < 0.006);
}

#[test]
fn dressed_people_are_the_same_every_time() {
    let mut frames = [5, 5, 6].map(|seed| {
        let look = Appearance {
            seed,
            ..Appearance::demonstration()
        };
        let sensor = Sensor {
            faults: 1.0,
            ..Sensor::default()
        };
        let mut simulator = dressed(look).with_sensor(sensor);
        drawn(&mut simulator, if seed == 5 { 1.0 } else { 4.0 });
        digest(&drawn(&mut simulator, 2.0).0)
    });
    assert_eq!(frames[0], frames[1]);
    frames.sort_unstable();
    assert!(frames[0] != frames[2], "a look of another seed is another");
}

#[test]
fn a_sensor_without_faults_gives_the_bytes_of_old() {
    let plain = || Simulator::new(HeadAsset::shipped(), Scene::Acted, 5);
    let (old, _) = drawn(&mut plain(), 3.0);
    let (same, _) = drawn(&mut plain().with_sensor(Sensor::default()), 3.0);
    assert_eq!(digest(&old), digest(&same));
    let real = Sensor {
        faults: 1.0,
        ..Sensor::default()
    };
    let (other, _) = drawn(&mut plain().with_sensor(real), 3.0);
    assert!(old.depth != other.depth && old.original.bayer == other.original.bayer);
}

/// How far a picture has moved to the right against another around a pixel: the shift of the best agreement.
fn moved(before: &KinectFrame, after: &KinectFrame, [x, y]: [f32; 2]) -> i32 {
    let (x, y) = (x as i32, y as i32);
    let value = |frame: &KinectFrame, col: i32, row: i32| {
        i32::from(frame.luma[row as usize * WIDTH + col as usize])
    };
    let apart = |shift: i32| -> i32 {
        (-25..25)
            .flat_map(|r| (-25..25).map(move |c| (x + c, y + r)))
            .map(|(c, r)| (value(before, c, r) - value(after, c + shift, r)).abs())
            .sum()
    };
    (-20..21).min_by_key(|&shift| apart(shift)).expect("shifts")
}

#[test]
fn a_late_colour_picture_shows_where_the_head_is_by_then() {
    // Walking past at 0.2 m/s.
    let (t, late) = (0.3, 0.05);
    let simulator = || Simulator::new(HeadAsset::shipped(), Scene::Crossing, 1);
    let (in_time, before) = drawn(&mut simulator(), t);
    let sensor = Sensor {
        colour_late_s: late,
        ..Sensor::default()
    };
    let (delayed, shown) = drawn(&mut simulator().with_sensor(sensor), t);
    let (_, after) = drawn(&mut simulator(), t + f64::from(late));
    assert_eq!(in_time.depth, delayed.depth);
    assert_eq!(before.sensor_from_head, shown.sensor_from_head);
    let nose = 30;
    let way = after.landmarks_px[nose][0] - before.landmarks_px[nose][0];
    assert!(way.abs() > 4.0, "{way} px");
    let off = shown.landmarks_px[nose][0] - after.landmarks_px[nose][0];
    assert!(off.abs() < 0.05, "{off} px");
    let seen = moved(&in_time, &delayed, before.landmarks_px[nose]);
    assert!((seen as f32 - way).abs() <= 1.0, "{seen} of {way} px");
}

#[test]
fn registration_that_is_off_and_a_bent_lens_move_picture_and_truth_alike() {
    let simulator = || Simulator::new(HeadAsset::shipped(), Scene::Still, 1);
    let (straight, before) = drawn(&mut simulator(), 1.0);
    let sensor = Sensor {
        colour_shift_px: [3.0, 0.0],
        distortion: [0.1, -0.1],
        ..Sensor::default()
    };
    let (off, shown) = drawn(&mut simulator().with_sensor(sensor), 1.0);
    let middle = 27;
    let way = shown.landmarks_px[middle][0] - before.landmarks_px[middle][0];
    assert!((way - 3.0).abs() < 0.5, "{way} px");
    let seen = moved(&straight, &off, before.landmarks_px[middle]);
    assert!((seen as f32 - way).abs() <= 1.0, "{seen} of {way} px");
    assert_eq!(straight.depth, off.depth);
}

#[test]
fn a_sensor_above_sees_a_head_that_looks_down() {
    let sensor = Sensor {
        above: 0.3,
        ..Sensor::default()
    };
    let (_, level) = drawn(&mut dressed(Appearance::demonstration()), 0.5);
    let (_, above) = drawn(
        &mut dressed(Appearance::demonstration()).with_sensor(sensor),
        0.5,
    );
    let forward = |truth: &Truth| truth.sensor_from_head.rotation * -Vector::z();
    // y points down.
    let turned = forward(&above).y - forward(&level).y;
    assert!((turned - 0.3f32.sin()).abs() < 0.05, "{turned}");
}

#[cfg(feature = "studio")]
#[test]
fn a_cast_of_nineteen_wears_everything_and_every_outfit_can_be_drawn() {
    let looks: Vec<Appearance> = (0..19).map(|k| Appearance::numbered(k, 77)).collect();
    let told: String = looks.iter().map(|look| format!("{look}; ")).collect();
    for thing in [
        "short",
        "long hair",
        "bushy",
        "fringe",
        "cropped",
        "curly",
        "bun",
        "bald",
        "stubble",
        "full beard",
        "glasses",
        "cap",
        "hood",
        "headphones",
        "scarf",
        "collar",
        "hand at the chin",
        "sheet of paper",
        "cup",
        "phone",
        "chair",
        "somebody behind",
    ] {
        assert!(told.contains(thing), "nobody with {thing}");
    }
    // Figures in the documents are of these pictures: if they are meant to change, measure again.
    let mut all = 0_u64;
    for look in looks {
        let mut simulator = dressed(look);
        let (frame, truth) = drawn(&mut simulator, 4.0);
        all = all.rotate_left(1) ^ digest(&frame);
        let seen = frame.depth.iter().filter(|raw| **raw != NO_READING).count();
        assert!(seen > PIXELS / 2, "{look}: {seen} readings");
        assert!(truth.landmarks_px.iter().flatten().all(|x| x.is_finite()));
    }
    assert_eq!(all, 0x8e6e_31ac_05de_2636);
}
