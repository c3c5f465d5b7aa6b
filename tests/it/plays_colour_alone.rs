//! Promise: what has no depth plays too: a folder of pictures alone, and a film from a file or through a pipe. Every frame comes, at its
//! time and with the geometry that is known or assumed, and a pipe that delivers nothing keeps no run from ending.

use std::fs;
use std::io::Write;
use std::path::Path;
use std::process::{Child, Output, Stdio};
use std::time::{Duration, Instant};

use mien_appliance::source;
use mien_sensors::{Frame, NO_DEPTH};
use mien_stages::base::capacity::WIDTH;
use mien_stages::base::geometry::Point;
use tempfile::TempDir;

use crate::common::{mien, signal};

const CAMERA: &str = r#"{"colour": {"width": 1280, "height": 720, "fx": 910.0, "fy": 911.0, "cx": 640.0, "cy": 360.0}}"#;
const LIST: &str = "# colour\n100.00 0.pgm\n100.04 1.pgm\n100.08 none.pgm\n100.20 2.pgm\n";

fn pgm(path: &Path, [columns, rows]: [usize; 2], luma: u8) {
    let header = format!("P5 {columns} {rows} 255\n").into_bytes();
    let pixels = vec![luma; columns * rows];
    fs::write(path, [header, pixels].concat()).unwrap();
}

/// Three pictures, ever brighter, and one that is missing.
fn folder() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    for (k, luma) in [40, 80, 120].into_iter().enumerate() {
        pgm(&folder.path().join(format!("{k}.pgm")), [1280, 720], luma);
    }
    fs::write(folder.path().join("rgb.txt"), LIST).unwrap();
    fs::write(folder.path().join("camera.json"), CAMERA).unwrap();
    folder
}

/// A film of so many frames at 25 Hz, ever brighter.
fn film(frames: u8) -> Vec<u8> {
    let frame = |luma: u8| [b"FRAME\n".as_slice(), &[luma; 96 * 64 * 3 / 2]].concat();
    let header = b"YUV4MPEG2 W96 H64 F25:1 Ip A1:1 C420jpeg XCOLORRANGE=LIMITED\n";
    [header.to_vec(), (0..frames).flat_map(frame).collect()].concat()
}

/// Number and time of every row of a table.
fn rows(done: &Output) -> Vec<(u64, u64)> {
    let said = String::from_utf8_lossy(&done.stderr);
    assert!(done.status.success(), "{said}");
    let table = String::from_utf8_lossy(&done.stdout);
    let mut lines = table.lines();
    assert!(lines.next().unwrap().starts_with("frame,time_us,"));
    let cells = lines.map(|line| line.split(',').map(|cell| cell.parse().unwrap_or(u64::MAX)));
    cells
        .map(|mut cells| (cells.next().unwrap(), cells.next().unwrap()))
        .collect()
}

fn from_pipe(words: &str) -> Child {
    let mut run = mien(words);
    let run = run.stdin(Stdio::piped()).stdout(Stdio::piped());
    run.stderr(Stdio::piped()).spawn().unwrap()
}

#[test]
fn pictures_alone_come_at_their_time_and_calibration_without_depth() {
    let folder = folder();
    let mut source = source::recording(folder.path()).unwrap();
    let mut frame = Frame::default();
    for (number, at, luma) in [(0, 0, 40), (1, 40_000, 80), (3, 200_000, 120)] {
        frame.depth.fill(700);
        assert!(source.next_frame(&mut frame).unwrap());
        assert_eq!((frame.index, frame.at.as_us()), (number, at));
        assert!(frame.has_colour && frame.luma.iter().all(|&found| found == luma));
        assert!(frame.depth.iter().all(|&raw| raw == NO_DEPTH));
    }
    assert!(!source.next_frame(&mut frame).unwrap());
    let state = source.state();
    assert_eq!((state.frames, state.skipped, state.reduced), (4, 1, [2, 2]));
    // Two by two pixels to one.
    assert_eq!(source.luma_size(), [640, 360]);
    let [col, row] = source.camera().colour_pixel(&Point::new(0.1, -0.05, 0.8));
    let expected = [
        (640.0 - 0.5 + 910.0 / 8.0) / 2.0,
        (360.0 - 0.5 - 911.0 / 16.0) / 2.0,
    ];
    assert!((col - expected[0]).abs() < 1e-3 && (row - expected[1]).abs() < 1e-3);
}

#[test]
fn an_unknown_camera_is_sixty_degrees_wide_at_four_to_three() {
    let folder = folder();
    fs::remove_file(folder.path().join("camera.json")).unwrap();
    // What is first in the list is missing.
    fs::remove_file(folder.path().join("0.pgm")).unwrap();
    let film_path = folder.path().join("film.y4m");
    fs::write(&film_path, film(1)).unwrap();
    // 1280 x 720 is reduced to 640 x 360, which is as high as 480 x 360; 96 x 64 is as high as 85.3 x 64.
    for (path, columns, rows) in [(folder.path(), 640.0, 360.0), (&film_path, 96.0, 64.0)] {
        let source = source::recording(path).unwrap();
        // The right border of 4:3 is 30 degrees from the axis: 1 m aside at √3 m.
        let [col, _] = source
            .camera()
            .colour_pixel(&Point::new(1.0, 0.0, 3.0_f32.sqrt()));
        let expected = columns / 2.0 + rows * 2.0 / 3.0 - 0.5;
        assert!((col - expected).abs() < 1e-3, "{col}, not {expected}");
    }
    let done = mien("run --fast --csv - --source")
        .arg(folder.path())
        .output()
        .unwrap();
    assert_eq!(rows(&done), [(1, 40_000), (3, 200_000)]);
    let said = String::from_utf8_lossy(&done.stderr);
    let warning =
        "camera.json is missing, so a camera with a field of view of 60 degrees is assumed; write";
    assert_eq!(said.matches(warning).count(), 1, "{said}");
}

#[test]
fn what_does_not_go_together_gets_a_sentence() {
    let with = |change: &dyn Fn(&Path)| {
        let folder = folder();
        change(folder.path());
        let said = source::recording(folder.path()).err().unwrap().to_string();
        assert!(!said.contains('\n'), "{said}");
        said
    };
    let write = |name: &'static str, text: &'static str| {
        move |folder: &Path| fs::write(folder.join(name), text).unwrap()
    };
    for (said, expected) in [
        (
            with(&write("depth.txt", "0 0.pgm\n")),
            "camera.json: expected `depth`, because there is a depth.txt, found only `colour`; add",
        ),
        (
            with(&write("camera.json", "{}")),
            "expected `depth`, `colour` or both, found neither",
        ),
        (
            with(&write("rgb.txt", "# none\n")),
            "rgb.txt: lists no picture, expected lines like 1305031102.160407 rgb/0001.png",
        ),
        (
            with(&write("rgb.txt", "10,033 0.pgm\n")),
            "rgb.txt: expected seconds with a decimal point",
        ),
        (
            with(&|folder| {
                fs::remove_file(folder.join("camera.json")).unwrap();
                fs::write(folder.join("rgb.txt"), "0 none.pgm\n").unwrap();
            }),
            "camera.json: is missing, and the size of the first pictures cannot be read",
        ),
    ] {
        assert!(said.contains(expected), "{said}");
    }
    // A depth camera that recorded no depth: its pictures play.
    let folder = folder();
    let camera = CAMERA.replace("colour", "depth");
    fs::write(folder.path().join("camera.json"), camera).unwrap();
    let mut source = source::recording(folder.path()).unwrap();
    assert!(source.next_frame(&mut Frame::default()).unwrap());
}

#[test]
fn every_picture_is_a_row_of_the_table() {
    let folder = folder();
    let done = mien("run --csv - --source")
        .arg(folder.path())
        .output()
        .unwrap();
    assert_eq!(rows(&done), [(0, 0), (1, 40_000), (3, 200_000)]);
}

#[test]
fn a_film_plays_from_a_file_and_through_a_pipe() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("film.y4m");
    // It ends in its sixth frame.
    let bytes = &film(6)[..film(5).len() + 999];
    fs::write(&path, bytes).unwrap();
    let mut source = source::recording(&path).unwrap();
    assert_eq!(source.state().frames, 6);
    let mut frame = Frame::default();
    for number in [3_u8, 1, 4] {
        source.seek(number.into());
        assert!(source.next_frame(&mut frame).unwrap());
        assert_eq!(
            (frame.index, frame.luma[63 * WIDTH + 95]),
            (number.into(), number)
        );
        assert_eq!(frame.at.as_us(), 40_000 * u64::from(number));
    }
    assert!(!source.next_frame(&mut frame).unwrap());
    assert_eq!(source.state().skipped, 1);
    let expected: Vec<(u64, u64)> = (0..5).map(|k| (k, 40_000 * k)).collect();
    let done = mien("run --fast --csv - --source")
        .arg(&path)
        .output()
        .unwrap();
    assert_eq!(rows(&done), expected);
    let mut run = from_pipe("run --fast --csv - --source -");
    run.stdin.take().unwrap().write_all(bytes).unwrap();
    let done = run.wait_with_output().unwrap();
    assert_eq!(rows(&done), expected);
    let said = String::from_utf8_lossy(&done.stderr);
    assert!(
        said.contains("frame 5 skipped: standard input: ends before its last pixel"),
        "{said}"
    );
}

#[test]
fn a_pipe_without_a_film_is_refused_and_a_blocked_one_ends_on_request() {
    let mut run = from_pipe("run --csv - --source -");
    run.stdin
        .take()
        .unwrap()
        .write_all(b"\0\0\0 ftypisom")
        .unwrap();
    let done = run.wait_with_output().unwrap();
    let said = String::from_utf8_lossy(&done.stderr);
    assert_eq!(done.status.code(), Some(1), "{said}");
    assert!(
        said.contains("standard input: expected a film that begins with YUV4MPEG2, found"),
        "{said}"
    );
    assert_eq!(said.lines().count(), 1, "{said}");
    // Half a frame, and then nothing.
    let mut run = from_pipe("run --csv - --source -");
    let mut pipe = run.stdin.take().unwrap();
    pipe.write_all(&film(2)[..film(1).len() + 999]).unwrap();
    std::thread::sleep(Duration::from_millis(1500));
    let asked = Instant::now();
    signal(&run, "-TERM");
    let done = run.wait_with_output().unwrap();
    assert!(asked.elapsed() < Duration::from_secs(2));
    drop(pipe);
    assert_eq!(rows(&done)[0], (0, 0));
    let said = String::from_utf8_lossy(&done.stderr);
    assert_eq!(
        said.matches("no frame came through for half a second")
            .count(),
        1,
        "{said}"
    );
}

#[test]
fn checking_a_configuration_leaves_the_film_in_the_pipe() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mien.toml");
    fs::write(&path, "[sensor]\nsource = \"-\"\n").unwrap();
    let mut run = from_pipe(&format!("run --fast --csv - --config {}", path.display()));
    run.stdin.take().unwrap().write_all(&film(2)).unwrap();
    assert_eq!(rows(&run.wait_with_output().unwrap()).len(), 2);
}
