//! Promise: a recording plays as it comes: without colour (heads are then followed by depth alone), with colour now and then, with
//! gaps, at another rate, disordered, with names of what is no file. Only what is broken is left out.
//! One file: one promise in many cases of one recording.
#![cfg(unix)]

use std::fs;
use std::path::Path;
use std::sync::OnceLock;

use mien_appliance::pipeline::Pipeline;
use mien_appliance::settings::Settings;
use mien_sensors::Frame;
use mien_sensors::kinect::frame::KinectFrame;
use mien_sensors::kinect::recording::{Recorder, Recording};
use mien_simulator::simulated::Simulated;
use mien_stages::base::geometry::{Rigid, Vector};
use mien_stages::face_model::FaceModel;
use mien_stages::segment::PixelRect;
use mien_stages::users::TrackingState::{self, Absent, Held, Lost, Posed, Tracking, Warming};
use tempfile::TempDir;

use crate::common::{make_pipe, mien};

/// Frames of the recording that all tests play parts of.
const FRAMES: usize = 75;
/// Frames from the first of a head to its pose.
const SEARCH: usize = 3;
/// As the program has it: frames in a row until a head without a face is a user.
const POSED_FRAMES: usize = 2;
/// Time of the last frame.
const LAST_MS: u64 = 1000 * (FRAMES as u64 - 1) / 30;

/// A recording, and where its head is in truth.
struct Session {
    folder: TempDir,
    truth: Vec<Rigid>,
    /// Names of the depth and the colour picture of each frame.
    names: Vec<[String; 2]>,
}

fn session() -> &'static Session {
    static SESSION: OnceLock<Session> = OnceLock::new();
    SESSION.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let mut sensor = Simulated::new(Some("acted")).unwrap();
        let mut recorder = Recorder::create(folder.path(), sensor.registration(), 1.7e9).unwrap();
        let mut frame = KinectFrame::default();
        let mut truth = Vec::new();
        for _ in 0..FRAMES {
            sensor.next_frame(&mut frame);
            truth.push(sensor.truth().expect("somebody acts").sensor_from_head);
            recorder.write(&frame).unwrap();
        }
        let index = fs::read_to_string(folder.path().join("INDEX.txt")).unwrap();
        let lines: Vec<&str> = index.lines().collect();
        let names = lines.chunks_exact(2);
        let names = names.map(|pair| [pair[1].to_owned(), pair[0].to_owned()]);
        Session {
            truth,
            names: names.collect(),
            folder,
        }
    })
}

/// A recording of those lines; each is a file of the session, or `new name<-file of the session`.
fn recording(lines: &[String]) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let link = |from: &str, to: &str| {
        let from = session().folder.path().join(from);
        if from.exists() {
            std::os::unix::fs::symlink(from, folder.path().join(to)).unwrap();
        }
    };
    link("device.json", "device.json");
    let mut index = String::new();
    for line in lines {
        let (name, file) = line.split_once("<-").unwrap_or((line, line));
        link(file, name);
        index += name;
        index.push('\n');
    }
    fs::write(folder.path().join("INDEX.txt"), index).unwrap();
    folder
}

/// Lines of the frames that `keep` keeps, of each the depth picture and, if wanted, the colour picture.
fn lines(keep: impl Fn(usize) -> Option<bool>) -> Vec<String> {
    let mut lines = Vec::new();
    for (number, [depth, colour]) in session().names.iter().enumerate() {
        if let Some(with_colour) = keep(number) {
            lines.extend(with_colour.then(|| colour.clone()));
            lines.push(depth.clone());
        }
    }
    lines
}

/// A frame as it was played.
#[derive(Debug, PartialEq)]
struct Played {
    /// Number of the depth file.
    number: usize,
    ms: u64,
    state: TrackingState,
    user: Option<usize>,
    pose: Option<Rigid>,
    head: Option<PixelRect>,
    /// Whether there are points and weights.
    face: bool,
}

fn play(folder: &Path) -> (Vec<Played>, u64) {
    let mut recording = Recording::open(folder).unwrap();
    let (settings, model) = (Settings::default(), FaceModel::shipped());
    let mut pipeline = Pipeline::new(&settings.stages, &recording.camera, &model).unwrap();
    let mut frame = Frame::default();
    let mut played = Vec::new();
    while recording.next_frame(&mut frame) {
        pipeline.follow(&frame);
        let reports = pipeline.reports();
        assert_eq!(reports.len(), 1, "one person");
        let report = reports[0];
        assert_eq!(report.landmarks.is_some(), !report.weights.is_empty());
        assert_eq!(report.landmarks.is_some(), !report.measures.is_empty());
        played.push(Played {
            number: frame.index as usize,
            ms: frame.at.as_us() / 1000,
            state: report.state,
            user: report.user,
            pose: report.sensor_from_face.copied(),
            head: report.head_box,
            face: report.landmarks.is_some(),
        });
    }
    (played, recording.skipped())
}

fn states(played: &[Played]) -> Vec<TrackingState> {
    played.iter().map(|one| one.state).collect()
}

/// Checks the medians of how far poses are from the truth, the offset of the whole run taken out.
fn is_accurate(what: &str, played: &[Played], frame: impl Fn(&Played) -> usize) {
    let pairs = played.iter();
    let pairs = pairs.filter_map(|one| Some((one.pose?, session().truth[frame(one)])));
    let pairs: Vec<(Rigid, Rigid)> = pairs.collect();
    let turns = pairs.iter().map(|(pose, truth)| {
        let turn = truth.rotation.inverse() * pose.rotation;
        turn.scaled_axis()
    });
    let turns: Vec<Vector> = turns.collect();
    let places = pairs.iter().map(|(pose, truth)| {
        let off = pose.translation.vector - truth.translation.vector;
        truth.rotation.inverse() * off
    });
    let places: Vec<Vector> = places.collect();
    let spread = |off: &[Vector]| {
        let mean = off.iter().sum::<Vector>() / off.len() as f32;
        let mut apart: Vec<f32> = off.iter().map(|one| (one - mean).norm()).collect();
        apart.sort_by(f32::total_cmp);
        apart[apart.len() / 2]
    };
    let (turn_deg, place_mm) = (spread(&turns).to_degrees(), spread(&places) * 1e3);
    let errors = format!("{what}: {turn_deg:.2}°, {place_mm:.1} mm");
    println!("{errors}");
    assert!(turn_deg < 1.5 && place_mm < 4.0, "{errors}");
}

/// Follows depth alone: a user after two frames, posed from then on, nothing of a face, pose right, box around the head.
fn is_posed(played: &[Played]) {
    let (states, from) = (states(played), SEARCH + POSED_FRAMES);
    let (mut first, mut others) = (states[..from].iter(), states[from..].iter());
    let is_first = |state: &TrackingState| matches!(state, Absent | Posed);
    assert!(first.all(is_first), "{states:?}");
    assert!(others.all(|state| *state == Posed), "{states:?}");
    assert!(played.iter().all(|one| !one.face));
    is_accurate("depth alone", played, |one| one.number);
    for one in &played[from..] {
        assert_eq!(one.user, Some(0), "frame {}", one.number);
        // The face's origin, by the nominal depth camera.
        let at = session().truth[one.number].translation.vector;
        let [x, y] = [at.x, at.y].map(|off| 575.8 * off / at.z);
        let (x, y) = (x + 319.5, y + 239.5);
        let head = one.head.expect("a box");
        let inside = (f32::from(head.x0)..f32::from(head.x1)).contains(&x)
            && (f32::from(head.y0)..f32::from(head.y1)).contains(&y);
        assert!(inside, "frame {}: {x} {y} in {head:?}", one.number);
    }
}

#[test]
fn depth_alone_is_followed() {
    // As from a sensor of which only depth and the accelerometer were kept.
    let mut lines = lines(|_| Some(false));
    lines.insert(0, "a-1700000000.000000-0.dump".to_owned());
    let (played, skipped) = play(recording(&lines).path());
    assert_eq!((played.len(), skipped), (FRAMES, 0));
    is_posed(&played);
}

#[test]
fn colour_pictures_that_are_named_but_not_there_are_none() {
    let mut lines = lines(|_| Some(true));
    for line in lines.iter_mut().filter(|line| line.starts_with("r-")) {
        line.push_str("<-nowhere");
    }
    let (played, skipped) = play(recording(&lines).path());
    assert_eq!((played.len(), skipped), (FRAMES, 0));
    is_posed(&played);
}

#[test]
fn the_table_of_a_run_has_pose_and_box_and_no_face() {
    let folder = recording(&lines(|_| Some(false)));
    let mut run = mien("run --fast --csv - --source");
    let output = run.arg(folder.path()).output().expect("mien starts");
    let text = String::from_utf8(output.stdout).unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
    let mut rows = text.lines().map(|line| line.split(',').collect::<Vec<_>>());
    let header = rows.next().unwrap();
    let rows: Vec<Vec<&str>> = rows.collect();
    assert_eq!(rows.len(), FRAMES);
    let posed: Vec<_> = rows.iter().filter(|row| row[3] == "posed").collect();
    let count = posed.len();
    assert!(count >= FRAMES - SEARCH - POSED_FRAMES, "{count}");
    for row in posed {
        for (name, cell) in header.iter().zip(row) {
            let is_of_head = matches!(
                *name,
                "frame" | "time_us" | "user" | "state" | "confidence" | "tx_m" | "ty_m" | "tz_m"
            ) || name.starts_with("head_")
                || name.starts_with('q');
            assert_eq!(cell.is_empty(), !is_of_head, "{name} is {cell:?}");
        }
    }
}

#[test]
fn a_lost_colour_picture_holds_the_face() {
    let missing = [30, 41, 55];
    let full = play(session().folder.path()).0;
    let folder = recording(&lines(|number| Some(!missing.contains(&number))));
    let (played, skipped) = play(folder.path());
    assert_eq!((played.len(), skipped), (FRAMES, 0));
    for (one, of_full) in played.iter().zip(&full) {
        // One picture is no loss: the points move with the head, and points and weights are kept.
        let kept = |of: &Played| (of.state, of.face);
        assert_eq!(kept(one), kept(of_full), "frame {}", one.number);
    }
    // The pose goes on: where colour is missing it is as good as elsewhere.
    for number in missing {
        let [pose, of_full] = [&played, &full].map(|of| of[number].pose.unwrap());
        let off = of_full.inverse() * pose;
        let (turn_deg, m) = (
            off.rotation.angle().to_degrees(),
            off.translation.vector.norm(),
        );
        assert!(turn_deg < 0.5 && m < 2e-3, "frame {number}: {off}");
    }
}

#[test]
fn colour_now_and_then_gives_the_face_back() {
    // A second of colour, 25 frames without, and colour again.
    let dark = 30..55;
    let folder = recording(&lines(|number| Some(!dark.contains(&number))));
    let (played, skipped) = play(folder.path());
    assert_eq!((played.len(), skipped), (FRAMES, 0));
    for one in &played[SEARCH..] {
        // `users.hold_s` is half a second.
        let expected: &[TrackingState] = match one.number {
            30..32 => &[Warming, Tracking],
            32..44 => &[Held],
            44..46 => &[Held, Posed],
            46..55 => &[Posed],
            // The face is found again in its first frames.
            55..58 => &[Warming, Tracking, Held],
            _ => &[Warming, Tracking],
        };
        assert!(expected.contains(&one.state), "{one:?}");
        assert_eq!(one.user, Some(0), "frame {}", one.number);
        assert!(one.pose.is_some() && one.head.is_some(), "{one:?}");
        assert!(one.state != Posed || !one.face, "{one:?}");
    }
}

#[test]
fn gaps_cost_a_search_and_no_user() {
    // A third of a second, then one second.
    let is_there = |number: &usize| !(20..30).contains(number) && !(40..70).contains(number);
    let folder = recording(&lines(|number| is_there(&number).then_some(true)));
    let (played, skipped) = play(folder.path());
    assert_eq!((played.len(), skipped), (FRAMES - 40, 0));
    // After a gap is searched; the frames that are there are numbered without the others.
    let searched = [0, 30, 70].map(|start| {
        let first = (0..start).filter(is_there).count();
        first..first + SEARCH
    });
    let is_searched = |one: &&Played| searched.iter().any(|all| all.contains(&one.number));
    for one in played.iter().filter(|one| !is_searched(one)) {
        assert!(one.face && one.user == Some(0), "{one:?}");
    }
    assert_eq!(played.last().unwrap().ms, LAST_MS);
}

#[test]
fn fifteen_frames_a_second_are_followed() {
    for with_colour in [true, false] {
        let folder = recording(&lines(|number| (number % 2 == 0).then_some(with_colour)));
        let (played, skipped) = play(folder.path());
        assert_eq!((played.len(), skipped), (FRAMES.div_ceil(2), 0));
        let from = SEARCH + if with_colour { 0 } else { POSED_FRAMES };
        for one in &played[from..] {
            assert_eq!(one.face, with_colour, "{one:?}");
            assert!(one.pose.is_some(), "{one:?}");
        }
        let what = format!("15 a second, colour {with_colour}");
        is_accurate(&what, &played, |one| 2 * one.number);
    }
}

#[test]
fn a_pipe_is_not_waited_for() {
    let names = &session().names;
    let folder = recording(&lines(|number| (number < 12).then_some(true)));
    let [depth, _] = &names[4];
    let [_, colour] = &names[7];
    for name in [depth, colour] {
        make_pipe(&folder.path().join(name));
    }
    let (played, skipped) = play(folder.path());
    let numbers: Vec<usize> = played.iter().map(|one| one.number).collect();
    assert_eq!(numbers, [0, 1, 2, 3, 5, 6, 8, 9, 10, 11]);
    assert_eq!(skipped, 2);
    for name in ["device.json", "INDEX.txt"] {
        make_pipe(&folder.path().join(name));
        let said = Recording::open(folder.path()).err().unwrap().to_string();
        let expected = [name, "not a regular file"];
        assert!(expected.iter().all(|part| said.contains(part)), "{said}");
        assert!(!said.contains('\n'));
    }
}

#[test]
fn an_index_without_an_end_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let index = folder.path().join("INDEX.txt");
    let refused = || {
        let said = Recording::open(folder.path()).err().unwrap().to_string();
        assert!(said.contains("INDEX.txt: file too large"), "{said}");
    };
    // A file of nothing costs no disk, and a name of a picture that is none no letters.
    fs::File::create(&index).unwrap().set_len(1 << 40).unwrap();
    refused();
    fs::write(&index, "d-\n".repeat(3 << 20)).unwrap();
    refused();
}

#[test]
fn a_stamp_far_ahead_costs_its_own_frame() {
    for side in 0..2 {
        let mut lines = lines(|_| Some(true));
        // Of frame 20: half a minute ahead.
        let name = &session().names[20][side];
        let ending = if side == 0 { ".pgm" } else { ".ppm" };
        let (front, ticks) = name.strip_suffix(ending).unwrap().rsplit_once('-').unwrap();
        let ticks: u32 = ticks.parse().unwrap();
        let wrong = ticks.wrapping_add(1_800_000_000);
        let line = lines.iter_mut().find(|line| *line == name).unwrap();
        *line = format!("{front}-{wrong}{ending}<-{name}");
        let (played, skipped) = play(recording(&lines).path());
        // Without its depth a frame is none, without its colour the face goes on with its head.
        let frames = FRAMES - usize::from(side == 0);
        assert_eq!((played.len(), skipped), (frames, (FRAMES - frames) as u64));
        assert_eq!(played.last().unwrap().ms, LAST_MS);
        let states = states(&played[SEARCH..]);
        for state in [Held, Lost, Absent] {
            assert!(!states.contains(&state), "{states:?}");
        }
    }
}

#[test]
fn a_shuffled_index_plays_the_same() {
    let (mut expected, _) = play(session().folder.path());
    let mut lines = lines(|_| Some(true));
    fastrand::Rng::with_seed(3).shuffle(&mut lines);
    let (played, skipped) = play(recording(&lines).path());
    assert_eq!(skipped, 0);
    // Numbers are those of the index; all else is as it was.
    let of_index = lines.iter().filter(|line| line.starts_with("d-"));
    for one in &mut expected {
        let name = &session().names[one.number][0];
        one.number = of_index.clone().position(|line| line == name).unwrap();
    }
    assert_eq!(played, expected);
}
