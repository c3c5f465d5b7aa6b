//! What is recorded replays bit for bit, and no damage to a recording ends a run.

use std::fs;
use std::path::Path;

use mien_appliance::source;
use mien_sensors::kinect::frame::{KinectFrame, Original};
use mien_sensors::kinect::recording::{Recorder, Recording};
use mien_sensors::kinect::registration::Registration;
use mien_stages::base::capacity::PIXELS;
use mien_stages::base::time::Timestamp;

use crate::common;
#[cfg(feature = "studio")]
use crate::common::data::Set;

const SEED: u64 = 20;

/// Records `count` frames of noise; the names of the files in the order of the index.
fn record(directory: &Path, count: u64) -> Vec<String> {
    let mut recorder =
        Recorder::create(directory, &Registration::default(), 1_700_000_000.5).unwrap();
    for number in 0..count {
        recorder.write(&common::noise_frame(number, SEED)).unwrap();
    }
    assert_eq!(recorder.frames(), count);
    let index = fs::read_to_string(directory.join("INDEX.txt")).unwrap();
    index.lines().map(str::to_owned).collect()
}

/// Number, time and ticks of a frame.
fn times(frame: &KinectFrame) -> (u64, Timestamp, [u32; 2]) {
    let Original {
        ticks,
        colour_ticks,
        ..
    } = frame.original;
    (frame.index, frame.at, [ticks, colour_ticks])
}

/// Numbers and times (µs) of the frames that play, and how many were skipped. Each must be the one recorded, or that without
/// colour.
fn replay(directory: &Path) -> (Vec<(u64, u64)>, u64) {
    let mut source = source::recording(directory).unwrap();
    let mut frame = KinectFrame::default();
    let mut played = Vec::new();
    while source.next_frame(&mut frame).unwrap() {
        let mut original = common::noise_frame(frame.index, SEED);
        if !frame.has_colour {
            original.frame.drop_colour();
            original.original.drop_colour();
        }
        common::assert_same_pictures(&frame, &original);
        assert_eq!(times(&frame), times(&original));
        played.push((frame.index, frame.at.as_us()));
    }
    (played, source.state().skipped)
}

#[test]
fn a_recording_replays_bit_for_bit() {
    let directory = tempfile::tempdir().unwrap();
    let names = record(directory.path(), 4);
    // The counter wraps within these frames.
    assert_eq!(names[0], "r-1700000000.500000-4290300000.ppm");
    assert_eq!(names[1], "d-1700000000.500000-4290000000.pgm");
    assert_eq!(names[7], "d-1700000000.600000-1032704.pgm");
    let expected = [(0, 0), (1, 33_333), (2, 66_666), (3, 100_000)];
    assert_eq!(replay(directory.path()), (expected.to_vec(), 0));
}

#[test]
fn a_simulated_run_and_its_replay_agree_bit_for_bit() {
    let directory = tempfile::tempdir().unwrap();
    let mut source = source::simulated(Some("acted")).unwrap();
    let mut recorder =
        Recorder::create(directory.path(), source.registration().unwrap(), 1.7e9).unwrap();
    let mut originals = vec![KinectFrame::default(); 5];
    for frame in &mut originals {
        assert!(source.next_frame(frame).unwrap());
        recorder.write(frame).unwrap();
    }
    let mut replay = source::recording(directory.path()).unwrap();
    assert_eq!(replay.registration(), source.registration());
    let mut frame = KinectFrame::default();
    for original in &originals {
        assert!(replay.next_frame(&mut frame).unwrap());
        common::assert_same_pictures(&frame, original);
        assert_eq!(times(&frame), times(original));
    }
    assert!(!replay.next_frame(&mut frame).unwrap());
    let refused = source::simulated(Some("opera")).err().unwrap().to_string();
    let expected = "expected one of the scenes acted, ";
    assert!(refused.starts_with(expected), "{refused}");
    assert!(refused.ends_with(", found opera"), "{refused}");
}

#[test]
fn the_files_are_those_of_fakenect() {
    let directory = tempfile::tempdir().unwrap();
    let names = record(directory.path(), 1);
    let frame = common::noise_frame(0, SEED);
    let depth = fs::read(directory.path().join(&names[1])).unwrap();
    assert_eq!(depth.len(), 17 + 2 * PIXELS);
    assert_eq!(&depth[..17], b"P5 640 480 65535\n");
    assert_eq!(depth[17..19], frame.depth[0].to_le_bytes());
    let colour = fs::read(directory.path().join(&names[0])).unwrap();
    assert_eq!(colour.len(), 15 + 3 * PIXELS);
    assert_eq!(&colour[..15], b"P6 640 480 255\n");
    // The first pixel of the mosaic is green.
    assert_eq!(colour[15 + 1], frame.original.bayer[0]);
}

#[test]
fn damaged_and_missing_files_skip_their_frame_only() {
    type Damage = fn(&Path);
    let damages: [(&str, Damage); 8] = [
        ("missing", |file| fs::remove_file(file).unwrap()),
        ("empty", |file| fs::write(file, b"").unwrap()),
        ("header only", |file| {
            fs::write(file, b"P5 640 480 65535\n").unwrap()
        }),
        ("no newline", |file| fs::write(file, [b'P'; 4000]).unwrap()),
        ("cut short", |file| {
            let bytes = fs::read(file).unwrap();
            fs::write(file, &bytes[..bytes.len() - 1]).unwrap();
        }),
        ("another size", |file| {
            let bytes = fs::read(file).unwrap();
            fs::write(file, [&b"P5 320 240 65535\n"[..], &bytes[17..]].concat()).unwrap();
        }),
        ("another kind", |file| {
            let bytes = fs::read(file).unwrap();
            fs::write(file, [&b"P9"[..], &bytes[2..]].concat()).unwrap();
        }),
        ("a directory", |file| {
            fs::remove_file(file).unwrap();
            fs::create_dir(file).unwrap();
        }),
    ];
    for (what, damage) in damages {
        // Line 2 is the colour picture of frame 1, line 3 its depth picture.
        for line in [2, 3] {
            let directory = tempfile::tempdir().unwrap();
            let names = record(directory.path(), 3);
            damage(&directory.path().join(&names[line]));
            // Without a colour picture a frame has no colour; a damaged one may be of anything.
            let expected = if (what, line) == ("missing", 2) {
                (vec![(0, 0), (1, 33_333), (2, 66_666)], 0)
            } else {
                (vec![(0, 0), (2, 66_666)], 1)
            };
            assert_eq!(replay(directory.path()), expected, "{what}, line {line}");
        }
    }
}

#[test]
fn depth_in_another_byte_order_or_unit_is_not_taken_for_raw_values() {
    let directory = tempfile::tempdir().unwrap();
    let names = record(directory.path(), 2);
    let file = directory.path().join(&names[1]);
    let mut bytes = fs::read(&file).unwrap();
    bytes[17..19].copy_from_slice(&2048u16.to_le_bytes());
    fs::write(file, bytes).unwrap();
    assert_eq!(replay(directory.path()), (vec![(1, 33_333)], 1));
}

#[test]
fn the_index_may_be_damaged_too() {
    let directory = tempfile::tempdir().unwrap();
    let names = record(directory.path(), 3);
    let index =
        |lines: &[&str]| fs::write(directory.path().join("INDEX.txt"), lines.join("\n")).unwrap();
    let [r0, d0, r1, d1, r2, d2] = names.iter().map(String::as_str).collect::<Vec<_>>()[..] else {
        panic!("six files")
    };
    let escape = "d-../../etc/passwd-2032704.pgm";
    let damage = ["\u{fffd}binary", "", escape, "a-1.0-5.dump"];
    index(&[&[r0, d0], &damage[..], &[r1, r2, d2]].concat());
    // The name in the middle counts as a frame; what follows it has number 2, as recorded.
    assert_eq!(replay(directory.path()), (vec![(0, 0), (2, 66_666)], 1));
    // A time is counted from the first depth picture, also if its file is gone.
    fs::remove_file(directory.path().join(d0)).unwrap();
    index(&[r0, d0, r1, d1, r2, d2]);
    let expected = vec![(1, 33_333), (2, 66_666)];
    assert_eq!(replay(directory.path()), (expected, 1));
}

#[test]
fn a_depth_picture_without_colour_nearby_is_a_frame_without_colour() {
    let directory = tempfile::tempdir().unwrap();
    let names = record(directory.path(), 3);
    let index = [&names[..2], &names[3..]].concat().join("\n");
    fs::write(directory.path().join("INDEX.txt"), index).unwrap();
    // The neighbours' colour is 0.85 and 1.15 frame periods away.
    let expected = vec![(0, 0), (1, 33_333), (2, 66_666)];
    assert_eq!(replay(directory.path()), (expected, 0));
    let mut recording = Recording::open(directory.path()).unwrap();
    let mut frame = KinectFrame::default();
    for has_colour in [true, false, true] {
        assert!(recording.next_frame(&mut frame));
        assert_eq!(frame.has_colour, has_colour);
        let black = |picture: &[u8]| picture.iter().all(|&value| value == 0);
        let is_black = black(&frame.luma[..]) && black(&frame.original.bayer[..]);
        assert_eq!(is_black, !has_colour);
    }
    // Recorded again it is the same recording.
    let again = tempfile::tempdir().unwrap();
    let mut recorder = Recorder::create(again.path(), &recording.registration, 1.7e9).unwrap();
    let mut recording = Recording::open(directory.path()).unwrap();
    while recording.next_frame(&mut frame) {
        recorder.write(&frame).unwrap();
    }
    let index = |folder: &Path| fs::read_to_string(folder.join("INDEX.txt")).unwrap();
    let kinds = |folder: &Path| -> Vec<u8> {
        let index = index(folder);
        index.lines().map(|line| line.as_bytes()[0]).collect()
    };
    assert_eq!(kinds(again.path()), b"rddrd");
    assert_eq!(kinds(again.path()), kinds(directory.path()));
}

#[test]
fn the_calibration_comes_back() {
    let directory = tempfile::tempdir().unwrap();
    let mut registration = Registration::default();
    registration.zero_plane.dcmos_rcmos_distance = 2.3;
    registration.const_shift = 201;
    let mut recorder = Recorder::create(directory.path(), &registration, 0.0).unwrap();
    recorder.write(&common::noise_frame(0, SEED)).unwrap();
    let read = || Recording::open(directory.path()).unwrap().registration;
    assert_eq!(read(), registration);
    fs::remove_file(directory.path().join("device.json")).unwrap();
    assert_eq!(read(), Registration::default());
}

#[test]
fn what_cannot_be_opened_says_so_in_one_sentence() {
    let directory = tempfile::tempdir().unwrap();
    let at = directory.path();
    let shown = at.display();
    let message = || Recording::open(at).err().unwrap().to_string();
    assert!(message().starts_with(&format!(
        "{shown}/INDEX.txt: cannot be read (no such file or directory); "
    )));
    fs::write(at.join("INDEX.txt"), "r-0-5.ppm\nnonsense\n").unwrap();
    assert!(message().starts_with(&format!("{shown}/INDEX.txt: lists no depth picture, ")));
    fs::remove_file(at.join("INDEX.txt")).unwrap();

    record(at, 1);
    let device = "{\n  \"reg_info\": {\"ax\": \"many\"}\n}";
    fs::write(at.join("device.json"), device).unwrap();
    assert_eq!(
        message(),
        format!(
            "{shown}/device.json: ax is \"many\", expected a whole number of 32 bits; correct it, or \
             remove the file to use the nominal calibration"
        )
    );
    let again = Recorder::create(at, &Registration::default(), 0.0);
    let said = again.err().unwrap().to_string();
    assert!(said.contains("already contains a recording"), "{said}");
    assert!(!said.contains('\n'));
}

#[cfg(feature = "studio")]
#[test]
fn real_frames_become_a_recording() {
    let Some(data) = common::data::folder(Set::KinectV1Pcl) else {
        return;
    };
    let directory = tempfile::tempdir().unwrap();
    common::write_kinect_recording(&data, &["desk_000", "five_people"], 2, directory.path());
    let mut recording = Recording::open(directory.path()).unwrap();
    let camera = recording.camera.clone();
    let mut frame = KinectFrame::default();
    let mut medians = Vec::new();
    while recording.next_frame(&mut frame) {
        let depth = frame.depth.iter().map(|&raw| camera.depth_m(raw));
        let mut depth: Vec<f32> = depth.filter(|&z| z > 0.0).collect();
        depth.sort_by(f32::total_cmp);
        assert!(depth.len() > PIXELS / 2);
        medians.push(depth[depth.len() / 2]);
    }
    // 0.67 to 1.7 m and 1.8 to 4 m, as the data say.
    println!("median depths: {medians:?} m");
    assert_eq!(medians.len(), 4);
    assert!(medians[..2].iter().all(|z| (0.67..1.7).contains(z)));
    assert!(medians[2..].iter().all(|z| (1.8..8.0).contains(z)));
}
