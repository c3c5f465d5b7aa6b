//! Promise: a recording of any depth camera plays: a folder in the layout of the TUM RGB-D data sets, at its own size and
//! calibration. What is broken in it is said in a sentence.

use std::fs;
use std::path::Path;
use std::process::Command;

use mien_appliance::pipeline::Pipeline;
use mien_appliance::settings::Settings;
use mien_appliance::source;
use mien_sensors::turned::upright;
use mien_sensors::{Frame, NO_DEPTH};
use mien_stages::base::capacity::WIDTH;
use mien_stages::base::frames::SensorFromHead;
use mien_stages::base::geometry::{Point, Rigid};
use mien_stages::face_model::FaceModel;
use mien_stages::segment::{HeadCloud, gather_at_pose};
use mien_stages::turn::Turn;
use tempfile::TempDir;

use crate::common;
use crate::common::data::Set;

const CAMERA: &str = r#"{
    "depth": {"width": 512, "height": 424, "fx": 365.0, "fy": 366.0, "cx": 256.0, "cy": 212.0, "metres_per_unit": 0.0002},
    "colour": {"width": 1280, "height": 720, "fx": 910.0, "fy": 911.0, "cx": 640.0, "cy": 360.0, "distortion": [0, 0, 0, 0, 0]},
    "colour_from_depth": [1, 0, 0, -0.03, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]
}"#;

fn pgm(path: &Path, [columns, rows]: [usize; 2], value: impl Fn(usize, usize) -> u16) {
    let pixels = (0..columns * rows).map(|k| value(k % columns, k / columns));
    let body = pixels.flat_map(u16::to_be_bytes);
    let header = format!("P5\n# by hand\n{columns} {rows}\n65535\n").into_bytes();
    fs::write(path, header.into_iter().chain(body).collect::<Vec<u8>>()).unwrap();
}

/// Two depth pictures, 0.8 m with a hole, and a picture that gets brighter to the right.
fn folder() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    for name in ["0", "1"] {
        let depth = |col, row| if col < 9 || row < 9 { 0 } else { 4000 };
        pgm(&at(&format!("d{name}.pgm")), [512, 424], depth);
    }
    pgm(&at("c0.pgm"), [1280, 720], |col, _| (col * 50) as u16);
    fs::write(at("depth.txt"), "# depth\n100.00 d0.pgm\n100.05 d1.pgm\n").unwrap();
    fs::write(at("rgb.txt"), "100.01 c0.pgm\n").unwrap();
    fs::write(at("camera.json"), CAMERA).unwrap();
    folder
}

#[test]
fn depth_and_picture_come_at_their_own_size_and_calibration() {
    let folder = folder();
    let mut source = source::recording(folder.path()).unwrap();
    let camera = source.camera().clone();
    assert_eq!(camera.depth_size(), [512, 424]);
    let mut frame = Frame::default();
    assert!(source.next_frame(&mut frame).unwrap());
    assert_eq!((frame.index, frame.at.as_us()), (0, 0));
    assert!((camera.depth_m(frame.depth[100 * WIDTH + 100]) - 0.8).abs() < 0.001);
    for (row, col) in [(100, 8), (8, 100), (100, 512), (424, 100)] {
        assert_eq!(frame.depth[row * WIDTH + col], NO_DEPTH);
    }
    // Two by two pixels to one: column 200 was 400 and 401.
    assert!(frame.has_colour && frame.has_image());
    let expected = (400 * 50 * 255 / 65535) as u8;
    assert_eq!(frame.luma[100 * WIDTH + 200], expected);
    assert_eq!(frame.luma[470 * WIDTH + 200], frame.luma[359 * WIDTH + 200]);
    let p = Point::new(0.1, -0.05, 0.8);
    let [col, row] = camera.depth_pixel(&p);
    assert!((col - (256.0 + 36.5 / 0.8)).abs() < 1e-3 && (row - (212.0 - 18.3 / 0.8)).abs() < 1e-3);
    let [col, row] = camera.colour_pixel(&p);
    let expected = [
        (640.0 - 0.5 + 910.0 * 0.07 / 0.8) / 2.0,
        (360.0 - 0.5 - 911.0 * 0.05 / 0.8) / 2.0,
    ];
    assert!((col - expected[0]).abs() < 1e-3 && (row - expected[1]).abs() < 1e-3);
    // The second has no picture within half a period.
    assert!(source.next_frame(&mut frame).unwrap());
    assert_eq!((frame.index, frame.at.as_us()), (1, 50_000));
    assert!(!frame.has_colour && frame.luma.iter().all(|&luma| luma == 0));
    assert!(!source.next_frame(&mut frame).unwrap());
    assert_eq!(source.state().skipped, 0);
}

#[test]
fn a_camera_on_its_side_comes_upright_at_its_own_size() {
    let folder = folder();
    let mut native = source::recording(folder.path()).unwrap();
    let recording = source::recording(folder.path()).unwrap();
    let mut source = upright(recording, Some(Turn::ThreeQuarters));
    let (mut before, mut frame) = (Frame::default(), Frame::default());
    assert!(native.next_frame(&mut before).unwrap() && source.next_frame(&mut frame).unwrap());
    // Of 512 columns the middle 480 are the rows now, of the picture's 640 too; clockwise.
    let (depth, luma) = (source.camera().depth_size(), source.luma_size());
    assert_eq!((depth, luma), ([424, 480], [360, 480]));
    for row in 0..480 {
        for col in [0, 7, 300, 359] {
            let at = row * WIDTH + col;
            assert_eq!(
                frame.depth[at],
                before.depth[(423 - col) * WIDTH + 16 + row]
            );
            assert_eq!(frame.luma[at], before.luma[(359 - col) * WIDTH + 80 + row]);
        }
        assert_eq!(frame.depth[row * WIDTH + 424], NO_DEPTH);
        assert_eq!(frame.luma[row * WIDTH + 639], frame.luma[row * WIDTH + 359]);
    }
}

#[test]
fn depth_larger_than_a_frame_is_picked_and_not_smeared() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    // What is picked stands before a wall.
    let depth = |col, row| match [col % 2, row % 2] {
        [1, 1] => 800,
        _ => 1600,
    };
    pgm(&at("d.pgm"), [1280, 960], depth);
    fs::write(at("depth.txt"), "0 d.pgm\n").unwrap();
    let camera = r#"{"depth": {"width": 1280, "height": 960, "fx": 1000, "fy": 1000, "cx": 641, "cy": 481, "metres_per_unit": 0.001}}"#;
    fs::write(at("camera.json"), camera).unwrap();
    let mut source = source::recording(folder.path()).unwrap();
    let mut frame = Frame::default();
    assert!(source.next_frame(&mut frame).unwrap());
    let camera = source.camera();
    assert_eq!(camera.depth_size(), [640, 480]);
    assert_eq!(camera.depth_focal_px(), 500.0);
    let apart = |raw: &u16| (camera.depth_m(*raw) - 0.8).abs();
    assert!(frame.depth.iter().all(|raw| apart(raw) < 0.001));
    let middle = camera.point(320.0, 240.0, 0.8);
    assert_eq!((middle.x, middle.y), (0.0, 0.0));
}

#[test]
fn a_quarter_of_a_millimetre_reaches_the_point_cloud() {
    let folder = tempfile::tempdir().unwrap();
    // A ball larger than the box of a head, so that the whole cloud lies on it.
    let (z, radius) = (1.0f32, 0.25f32);
    let depth = |col, row| {
        let [x, y] = [col as f32 - 320.0, row as f32 - 240.0].map(|px| px / 480.0);
        let ray = x * x + y * y + 1.0;
        let root = z * z - ray * (z * z - radius * radius);
        let near = (z - root.max(0.0).sqrt()) / ray;
        if root > 0.0 {
            (near / 0.00025).round() as u16
        } else {
            0
        }
    };
    pgm(&folder.path().join("d.pgm"), [640, 480], depth);
    fs::write(folder.path().join("depth.txt"), "0 d.pgm\n").unwrap();
    let camera = r#"{"depth": {"width": 640, "height": 480, "fx": 480, "fy": 480, "cx": 320, "cy": 240, "metres_per_unit": 0.00025}}"#;
    fs::write(folder.path().join("camera.json"), camera).unwrap();
    let mut source = source::recording(folder.path()).unwrap();
    let (mut frame, mut cloud) = (Frame::default(), HeadCloud::default());
    assert!(source.next_frame(&mut frame).unwrap());
    let pose = SensorFromHead::assume_frames(Rigid::translation(0.0, 0.0, 0.78));
    let (depth, camera) = (&frame.depth, source.camera());
    assert!(gather_at_pose(depth, camera, &pose, 1.0, &mut cloud));
    let off = |p: &Point| (p - Point::new(0.0, 0.0, z)).norm() - radius;
    let squared = cloud.points.iter().map(|p| off(p).powi(2)).sum::<f32>();
    let off_mm = 1e3 * (squared / cloud.points.len() as f32).sqrt();
    // Steps of 1.6 mm at 1 m leave 0.06 mm.
    assert!(cloud.points.len() > 1000 && off_mm < 0.03, "{off_mm} mm");
}

#[test]
fn a_broken_one_gets_a_sentence() {
    let with = |name: &str, text: &str| {
        let folder = folder();
        fs::write(folder.path().join(name), text).unwrap();
        source::recording(folder.path()).err().unwrap().to_string()
    };
    let is_said = |said: String, expected: &str| {
        assert!(said.contains(expected) && !said.contains('\n'), "{said}");
    };
    is_said(with("depth.txt", "# nothing\n"), "lists no picture");
    for (from, to, expected) in [
        ("\"fx\": 365.0, ", "", "missing field `fx` at line 2"),
        ("metres_per_unit", "units", "unknown field `units`"),
        (
            "424",
            "42",
            "depth: width and height are [512, 42], expected",
        ),
        (
            "365.0",
            "0.365",
            "depth: fx and fy are [0.365, 366.0], expected",
        ),
        (
            "0.0002",
            "5000",
            "depth: metres_per_unit is 5000, expected 0.001",
        ),
        ("-0.03", "-30", "are these millimetres?"),
        (
            "0, 1, 0, 0",
            "0, 2, 0, 0",
            "colour_from_depth is not a rotation",
        ),
        ("\"depth\":", "\"depth\"", "at line 2 column"),
    ] {
        is_said(with("camera.json", &CAMERA.replace(from, to)), expected);
    }
    let folder = folder();
    fs::remove_file(folder.path().join("camera.json")).unwrap();
    let said = source::recording(folder.path()).err().unwrap().to_string();
    for expected in ["camera.json", "docs/recordings.md"] {
        assert!(said.contains(expected), "{said}");
    }
}

#[test]
fn a_damaged_frame_is_skipped_and_counted() {
    let folder = folder();
    let at = |name: &str| folder.path().join(name);
    pgm(&at("small.pgm"), [320, 240], |_, _| 4000);
    fs::write(at("text.pgm"), "no picture").unwrap();
    let whole = fs::read(at("d0.pgm")).unwrap();
    fs::write(at("cut.pgm"), &whole[..whole.len() / 2]).unwrap();
    let names = "small.pgm text.pgm cut.pgm none.pgm ../d0.pgm d0.pgm";
    let lines = names.split(' ').enumerate();
    let lines: Vec<String> = lines.map(|(k, name)| format!("{k} {name}")).collect();
    fs::write(at("depth.txt"), lines.join("\n")).unwrap();
    let mut source = source::recording(folder.path()).unwrap();
    let mut frame = Frame::default();
    assert!(source.next_frame(&mut frame).unwrap());
    assert_eq!((frame.index, source.state().skipped), (5, 5));
    assert!(!source.next_frame(&mut frame).unwrap());
}

#[test]
fn a_kinect_v2_is_followed_at_its_own_size() {
    let Some(data) = common::data::only([Set::KinectV2Faces]) else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/real/depth_camera.py");
    let words = "--person p00 --first 30 --hold 10 --order 2,1,2 --ending";
    let is_studio = cfg!(feature = "studio");
    let mut python = Command::new("python3");
    python.arg(script).arg(data.path()).arg(folder.path());
    python.args(words.split(' '));
    python.arg(if is_studio { "png" } else { "pgm" });
    if !python.output().is_ok_and(|done| done.status.success()) {
        return common::data::leave_out("python3 with numpy and OpenCV");
    }
    let mut source = source::recording(folder.path()).unwrap();
    let model = FaceModel::shipped();
    let mut pipeline = Pipeline::new(&Settings::default().stages, source.camera(), &model).unwrap();
    let (mut frame, mut faces) = (Frame::default(), 0);
    while source.next_frame(&mut frame).unwrap() {
        pipeline.follow(&frame);
        let report = pipeline.report();
        let Some(points) = report.landmarks.filter(|_| report.state.is_present()) else {
            continue;
        };
        faces += 1;
        // The outer eye corners of a head at 0.95 m are 35 pixels apart, at the place of the crop.
        let [right, left] = [36, 45].map(|k| points.pixels[k]);
        let apart = left[0] - right[0];
        assert!((30.0..42.0).contains(&apart), "{right:?} {left:?}");
        assert!((180.0..340.0).contains(&right[0]) && (120.0..240.0).contains(&right[1]));
    }
    assert_eq!(source.state().skipped, 0);
    assert!(faces >= 45, "a face in {faces} of 50 frames");
}
