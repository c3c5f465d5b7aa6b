//! Synthetic images; heads of the simulated sensor are in `tests/it/tracks_a_head.rs`.

use super::regions::CELL_PX;
use super::*;
use crate::base::capacity::HEAD_POINTS;
use crate::base::capacity::{HEIGHT, WIDTH};
use crate::base::frames::SensorFromHead;
use crate::base::geometry::{Point, Rigid};
use crate::camera::DepthScale;

/// Nearest surface of simple solids along each pixel's ray.
struct World {
    /// Centre and radii of ellipsoids.
    solids: Vec<([f32; 3], [f32; 3])>,
    /// Left, top, right, bottom, distance of flat rectangles (metres).
    panels: Vec<[f32; 5]>,
}

impl World {
    fn frame(&self, camera: &Camera) -> Frame {
        let mut frame = Frame::default();
        for row in 0..HEIGHT {
            for col in 0..WIDTH - 8 {
                let ray = camera.point(col as f32, row as f32, 1.0).coords;
                let mut z = f32::INFINITY;
                for (c, r) in &self.solids {
                    let (d, o) = (
                        [0, 1, 2].map(|k| ray[k] / r[k]),
                        [0, 1, 2].map(|k| -c[k] / r[k]),
                    );
                    let dot = |a: [f32; 3], b: [f32; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
                    let (a, b, c) = (dot(d, d), dot(d, o), dot(o, o) - 1.0);
                    let inside = b * b - a * c;
                    if inside > 0.0 {
                        z = z.min((-b - inside.sqrt()) / a);
                    }
                }
                for [left, top, right, bottom, distance] in &self.panels {
                    let (x, y) = (ray.x * distance, ray.y * distance);
                    if x > *left && x < *right && y > *top && y < *bottom {
                        z = z.min(*distance);
                    }
                }
                if z.is_finite() && z > 0.4 {
                    frame.depth[row * WIDTH + col] = camera.raw_from_m(z).round() as u16;
                }
            }
        }
        frame
    }
}

fn person(x: f32, y: f32, z: f32) -> Vec<([f32; 3], [f32; 3])> {
    vec![
        ([x, y, z], [0.078, 0.115, 0.095]),
        ([x, y + 0.14, z + 0.03], [0.055, 0.08, 0.055]),
        ([x, y + 0.36, z + 0.04], [0.21, 0.19, 0.11]),
    ]
}

const WALL: [f32; 5] = [-3.0, -3.0, 3.0, 3.0, 2.2];

/// Cameras that measure steps of 1/z, millimetres and quarters of them.
fn cameras() -> [Camera; 3] {
    let metric = |unit_m| Camera::of_scale(DepthScale::metric(unit_m));
    [Camera::default(), metric(0.001), metric(0.00025)]
}

#[test]
fn a_head_cut_off_at_the_edge_is_not_whole() {
    let rect = |x0: u16, y0: u16, x1: u16, y1: u16| PixelRect { x0, y0, x1, y1 };
    let (cell, size) = (CELL_PX as u16, [512, 424]);
    let [right, bottom] = size.map(|pixels| pixels as u16 - cell);
    assert!(rect(cell + 1, cell + 1, right - 1, bottom - 1).is_within(size));
    for cut in [
        rect(cell, 99, 200, 200),
        rect(99, cell, 200, 200),
        rect(99, 99, right, 200),
        rect(99, 99, 200, bottom),
    ] {
        assert!(!cut.is_within(size), "{cut:?}");
    }
}

#[test]
fn a_person_gives_one_head_of_the_right_position_and_size() {
    let mut segmenter = Segmenter::new(Settings::default());
    for (camera, z) in cameras()
        .iter()
        .flat_map(|camera| [0.6, 0.8, 1.0, 1.3].map(|z| (camera, z)))
    {
        let world = World {
            solids: person(0.05, -0.03, z),
            panels: vec![WALL],
        };
        segmenter.reset();
        let head = segmenter
            .segment(&world.frame(camera), camera)
            .unwrap_or_else(|| panic!("no head at {z}"));
        assert!(
            (head.centre.x - 0.05).abs() < 0.015 && (head.centre.y + 0.03).abs() < 0.04,
            "{z}: {:?}",
            head.centre
        );
        let pixels_per_m = camera.depth_focal_px() / z;
        let high = f32::from(head.rect.y1 - head.rect.y0) / pixels_per_m;
        assert!((0.19..0.30).contains(&high), "{z}: {high} m high");
        assert!(head.points.len() > HEAD_POINTS / 4);
        assert_eq!(segmenter.heads().len(), 1);
    }
}

#[test]
fn a_head_gathered_around_its_pose_is_as_large_as_the_head() {
    let camera = Camera::default();
    let (mut cloud, z) = (HeadCloud::default(), 0.9);
    let world = World {
        solids: person(0.05, -0.03, z),
        panels: vec![WALL],
    };
    let pose = Rigid::translation(0.05, -0.03, z - 0.095);
    let pose = SensorFromHead::assume_frames(pose);
    let frame = world.frame(&camera);
    assert!(cloud::gather_at_pose(
        &frame.depth,
        &camera,
        &pose,
        1.0,
        &mut cloud
    ));
    let PixelRect { x0, y0, x1, y1 } = cloud.rect;
    let [wide, high] = [x1 - x0, y1 - y0].map(|px| f32::from(px) * z / camera.depth_focal_px());
    assert!(
        (0.13..0.18).contains(&wide) && (0.2..0.26).contains(&high),
        "{wide} {high}"
    );
    let off = cloud.centre - Point::new(0.05, -0.03, z - 0.06);
    assert!(off.norm() < 0.02, "{off}");
}

#[test]
fn a_layers_end_that_crosses_somebody_moves_behind_them() {
    for camera in cameras() {
        let mut segmenter = Segmenter::new(Settings::default());
        let mut frame = Frame::default();
        // Somebody lying: evenly from 0.7 m to 1.2 m.
        let [near, far] = [0.7, 1.2].map(|z| camera.raw_from_m(z) as usize);
        for (i, raw) in frame.depth.iter_mut().enumerate() {
            *raw = (near + i % (far - near)) as u16;
        }
        let end = camera.depth_m(segmenter.foreground_end(&frame, &camera));
        assert!((end - 1.2).abs() < 0.008, "{end}");
    }
}

#[test]
fn two_people_give_two_heads_and_the_one_followed_stays_first() {
    let camera = Camera::default();
    let mut segmenter = Segmenter::new(Settings::default());
    let first = World {
        solids: person(-0.15, -0.02, 1.0),
        panels: vec![WALL],
    };
    assert!(segmenter.segment(&first.frame(&camera), &camera).is_some());
    let mut both = first;
    both.solids.extend(person(0.30, 0.0, 0.85));
    let head = segmenter.segment(&both.frame(&camera), &camera).unwrap();
    assert!(head.centre.x < 0.0, "the nearer newcomer took over");
    assert_eq!(segmenter.heads().len(), 2);
}

#[test]
fn objects_give_no_head() {
    let camera = Camera::default();
    let hand_flat = ([0.0, 0.0, 0.7], [0.05, 0.09, 0.012]);
    let forearm = ([0.02, 0.2, 0.72], [0.04, 0.16, 0.04]);
    let scenes: [(&str, World); 8] = [
        (
            "nothing",
            World {
                solids: vec![],
                panels: vec![],
            },
        ),
        (
            "a wall",
            World {
                solids: vec![],
                panels: vec![WALL],
            },
        ),
        (
            "a wall at head depth",
            World {
                solids: vec![],
                panels: vec![[-3.0, -3.0, 3.0, 3.0, 0.7]],
            },
        ),
        (
            "a chair",
            World {
                solids: vec![],
                panels: vec![WALL, [-0.2, 0.1, 0.25, 0.7, 1.1]],
            },
        ),
        (
            "a narrow board",
            World {
                solids: vec![],
                panels: vec![WALL, [-0.09, -0.1, 0.09, 0.7, 0.9]],
            },
        ),
        (
            "a hand",
            World {
                solids: vec![hand_flat, forearm],
                panels: vec![WALL],
            },
        ),
        (
            "a spread hand",
            World {
                solids: vec![([0.0, 0.0, 0.7], [0.09, 0.09, 0.01]), forearm],
                panels: vec![WALL],
            },
        ),
        (
            "a big cushion",
            World {
                solids: vec![([0.0, 0.1, 1.0], [0.25, 0.22, 0.12])],
                panels: vec![WALL],
            },
        ),
    ];
    for (name, world) in scenes {
        let mut segmenter = Segmenter::new(Settings::default());
        let frame = world.frame(&camera);
        for _ in 0..3 {
            assert!(
                segmenter.segment(&frame, &camera).is_none(),
                "{name} was taken for a head"
            );
        }
    }
}

#[test]
fn hands_do_not_hide_the_head() {
    let camera = Camera::default();
    let mut segmenter = Segmenter::new(Settings::default());
    let mut world = World {
        solids: person(0.0, 0.0, 0.85),
        panels: vec![WALL],
    };
    let free = segmenter
        .segment(&world.frame(&camera), &camera)
        .unwrap()
        .pixels;
    // Half the face behind a hand at 0.65 m.
    world
        .solids
        .push(([0.04, 0.02, 0.65], [0.035, 0.06, 0.012]));
    world.solids.push(([0.06, 0.2, 0.66], [0.03, 0.16, 0.03]));
    let head = segmenter
        .segment(&world.frame(&camera), &camera)
        .expect("head behind the hand");
    assert!(
        head.centre.z > 0.72,
        "the hand was taken: {:?}",
        head.centre
    );
    assert!(head.pixels > free / 4 && head.pixels < free);
    // A hand beside and above the head, the arm joined to the body.
    let mut raised = World {
        solids: person(0.0, 0.0, 0.85),
        panels: vec![WALL],
    };
    raised
        .solids
        .push(([0.2, -0.12, 0.86], [0.045, 0.09, 0.03]));
    raised.solids.push(([0.2, 0.1, 0.88], [0.04, 0.2, 0.04]));
    segmenter.reset();
    let head = segmenter
        .segment(&raised.frame(&camera), &camera)
        .expect("head beside the hand");
    assert!(head.centre.x.abs() < 0.03, "{:?}", head.centre);
}

#[test]
fn an_empty_frame_has_no_heads() {
    let camera = Camera::default();
    let mut segmenter = Segmenter::new(Settings::default());
    let world = World {
        solids: person(0.0, 0.0, 0.8),
        panels: vec![WALL],
    };
    segmenter.segment(&world.frame(&camera), &camera).unwrap();
    assert!(segmenter.heads()[0].pixels > 8000);
    assert!(segmenter.segment(&Frame::default(), &camera).is_none());
    assert!(segmenter.heads().is_empty());
}
