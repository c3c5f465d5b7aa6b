//! Promise: real recordings, whole and damaged, are followed as they were when somebody last looked: a change of behaviour is
//! seen as one.
//!
//! Made from the data sets by their own scripts: a film of a seated man without colour, two men at a desk, held faces in
//! two poses; and from these, with colour taken away, gaps, cut files, and an index out of order. What a run says of every
//! frame is held to `tests/golden/corpus/*.txt`, one user a line: frame, user, state, then where there is a pose the
//! place in mm, yaw, pitch and roll in degrees, and where there are weights their sum in tenths. Other processors differ in
//! the last bits, which a search may decide by: one line in fifty may be another, and a place counts as the same within 2 mm,
//! a turn within a degree, a sum within three tenths.
//!
//! `MIEN_WRITE_GOLDEN=1 cargo test --test it replays_the_corpus -- --nocapture` writes the tables anew and says which
//! differ. Skips with a line without the data sets, or without python3 with numpy and OpenCV.
#![cfg(unix)]

use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use mien_appliance::pipeline::Pipeline;
use mien_appliance::settings::Settings;
use mien_sensors::Frame;
use mien_sensors::kinect::recording::Recording;
use mien_stages::base::geometry::yaw_pitch_roll;
use mien_stages::face_model::FaceModel;
use tempfile::TempDir;

use crate::common;
use crate::common::data::Set;

/// One line in so many may be another.
const ONE_IN: usize = 50;
/// How far a number may be from the golden one: places in mm, turns in degrees, the sum of the weights in tenths.
const WITHIN: [i32; 7] = [2, 2, 2, 1, 1, 1, 3];

/// A recording as a data set's script writes it; `None`, told in one line, if it cannot.
fn made(set: Set, words: &[&str]) -> Option<TempDir> {
    let script = common::data::folder(set)?.join("to_session.py");
    let mut has = Command::new("python3");
    has.args(["-c", "import cv2, numpy"]).stderr(Stdio::null());
    if !has.status().is_ok_and(|status| status.success()) {
        common::data::leave_out("python3 with numpy and OpenCV");
        return None;
    }
    let folder = tempfile::tempdir().unwrap();
    let out = Command::new("python3")
        .arg(script)
        .arg(folder.path())
        .args(words)
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&out.stderr);
    assert!(out.status.success(), "{} {words:?}: {said}", set.name());
    Some(folder)
}

/// The lines of a recording's index.
fn index(of: &Path) -> Vec<String> {
    let text = fs::read_to_string(of.join("INDEX.txt")).unwrap();
    text.lines().map(str::to_owned).collect()
}

/// The same recording with another index; `damage` may put something else in the place of a file.
fn damaged(of: &Path, lines: &[String], damage: impl Fn(&str, &Path) -> bool) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    for name in lines.iter().map(String::as_str).chain(["device.json"]) {
        let to = folder.path().join(name);
        if !damage(name, &to) {
            std::os::unix::fs::symlink(of.join(name), to).unwrap();
        }
    }
    fs::write(folder.path().join("INDEX.txt"), lines.join("\n") + "\n").unwrap();
    folder
}

/// What is said of every frame, a line for each user, and the frames that were skipped.
fn replayed(folder: &Path) -> (Vec<String>, u64) {
    let mut recording = Recording::open(folder).unwrap();
    let model = FaceModel::shipped();
    let camera = &recording.camera;
    let mut pipeline = Pipeline::new(&Settings::default().stages, camera, &model).unwrap();
    let mut frame = Frame::default();
    let mut lines = Vec::new();
    while recording.next_frame(&mut frame) {
        pipeline.follow(&frame);
        for report in pipeline.reports() {
            let user = report.user.map_or("-".to_owned(), |user| user.to_string());
            let mut line = format!("{} {user} {}", frame.index, report.state.name());
            if let Some(pose) = report.sensor_from_face {
                for metres in pose.translation.vector.iter() {
                    write!(line, " {:.0}", metres * 1e3).unwrap();
                }
                let (yaw, pitch, roll) = yaw_pitch_roll(&pose.rotation);
                for turn in [yaw, pitch, roll] {
                    write!(line, " {:.0}", turn.to_degrees()).unwrap();
                }
            }
            if !report.weights.is_empty() {
                let sum: f32 = report.weights.iter().sum();
                write!(line, " {:.0}", sum * 10.0).unwrap();
            }
            lines.push(line.replace(" -0", " 0"));
        }
    }
    (lines, recording.skipped())
}

/// Whether two lines say the same.
fn agree(one: &str, other: &str) -> bool {
    let [one, other] = [one, other].map(|line| line.split(' ').collect::<Vec<_>>());
    let words = one.len().min(3);
    one.len() == other.len()
        && one[..words] == other[..words]
        && one[words..].iter().zip(&other[words..]).zip(WITHIN).all(
            |((one, other), within)| match (one.parse::<i32>(), other.parse::<i32>()) {
                (Ok(one), Ok(other)) => (one - other).abs() <= within,
                _ => false,
            },
        )
}

/// The lines that are not alike, by frame and user: `was`, `is`.
fn differences<'a>(golden: &'a [String], lines: &'a [String]) -> Vec<[&'a str; 2]> {
    let key = |line: &str| {
        line.split(' ')
            .take(2)
            .map(str::to_owned)
            .collect::<Vec<_>>()
    };
    let find = |all: &'a [String], of: &str| {
        let found = all.iter().find(|line| key(line) == key(of));
        found.map_or("(none)", String::as_str)
    };
    let changed = lines.iter().map(|is| [find(golden, is), is.as_str()]);
    let gone = golden.iter().map(|was| [was.as_str(), find(lines, was)]);
    let gone = gone.filter(|[_, is]| *is == "(none)");
    let all = changed.chain(gone);
    all.filter(|[was, is]| !agree(was, is)).collect()
}

/// Holds a table to its golden one, or writes that.
fn hold(name: &str, lines: &[String]) {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/corpus");
    let path: PathBuf = folder.join(format!("{name}.txt"));
    let golden = fs::read_to_string(&path).unwrap_or_default();
    let golden: Vec<String> = golden.lines().map(str::to_owned).collect();
    let apart = differences(&golden, lines);
    println!("{name}: {} lines, {} are others", lines.len(), apart.len());
    if std::env::var_os("MIEN_WRITE_GOLDEN").is_some() {
        fs::create_dir_all(&folder).unwrap();
        fs::write(&path, lines.join("\n") + "\n").unwrap();
        return;
    }
    let mut first = String::new();
    for [was, is] in apart.iter().take(10) {
        write!(first, "\n  was {was}\n  is  {is}").unwrap();
    }
    assert!(
        apart.len() * ONE_IN <= lines.len(),
        "{name}: {} of {} lines differ; if intended, MIEN_WRITE_GOLDEN=1 rewrites the table{first}",
        apart.len(),
        lines.len()
    );
}

/// The part of the film in which the man holds paper before his face.
fn film() -> Option<TempDir> {
    made(
        Set::KinectV1Film,
        &["--depth-only", "--from", "20", "--to", "110"],
    )
}

fn face(person: &str, pose: &str) -> Option<TempDir> {
    let words = [
        "--person", person, "--pose", pose, "--first", "30", "--hold", "8",
    ];
    made(Set::KinectV2Faces, &words)
}

#[test]
fn the_film() {
    let Some(film) = film() else { return };
    let (lines, skipped) = replayed(film.path());
    assert_eq!(skipped, 0);
    hold("film", &lines);
}

#[test]
fn the_desk() {
    let Some(desk) = made(Set::KinectV1Desk, &["--hold", "3"]) else {
        return;
    };
    hold("desk", &replayed(desk.path()).0);
}

#[test]
fn faces() {
    for (person, pose) in [("p00", "4"), ("p03", "7"), ("p04", "2")] {
        let Some(face) = face(person, pose) else {
            return;
        };
        hold(&format!("{person}-{pose}"), &replayed(face.path()).0);
    }
}

#[test]
fn a_face_without_its_colour() {
    let Some(face) = face("p00", "4") else { return };
    let depth: Vec<String> = index(face.path())
        .into_iter()
        .filter(|name| name.starts_with('d'))
        .collect();
    let folder = damaged(face.path(), &depth, |_, _| false);
    let (lines, _) = replayed(folder.path());
    assert!(!lines.iter().any(|line| line.contains("tracking")));
    hold("p00-4-without-colour", &lines);
}

#[test]
fn a_film_with_gaps() {
    let Some(film) = film() else { return };
    let lines: Vec<String> = index(film.path());
    let kept = lines.iter().enumerate();
    let kept = kept.filter(|(k, _)| k % 7 != 3 && !(20..35).contains(k));
    let kept: Vec<String> = kept.map(|(_, line)| line.clone()).collect();
    let folder = damaged(film.path(), &kept, |_, _| false);
    hold("film-with-gaps", &replayed(folder.path()).0);
}

#[test]
fn a_film_with_cut_files() {
    let Some(film) = film() else { return };
    let lines = index(film.path());
    let cut = |name: &str| {
        lines
            .iter()
            .position(|line| line == name)
            .is_some_and(|k| k % 10 == 9)
    };
    let folder = damaged(film.path(), &lines, |name, to| {
        if cut(name) {
            let whole = fs::read(film.path().join(name)).unwrap();
            fs::write(to, &whole[..whole.len() / 2]).unwrap();
        }
        cut(name)
    });
    let (table, skipped) = replayed(folder.path());
    assert_eq!(skipped, lines.len() as u64 / 10, "what is cut is left out");
    hold("film-with-cut-files", &table);
}

#[test]
fn an_index_out_of_order_plays_the_same() {
    let Some(face) = face("p04", "2") else { return };
    let mut lines = index(face.path());
    let in_order = damaged(face.path(), &lines, |_, _| false);
    fastrand::Rng::with_seed(3).shuffle(&mut lines);
    let shuffled = damaged(face.path(), &lines, |_, _| false);
    // Numbers are those of the index; all else is as it was.
    let [one, other] = [in_order, shuffled].map(|folder| {
        let (lines, skipped) = replayed(folder.path());
        let unnumbered = |line: &String| line.split_once(' ').map(|(_, rest)| rest.to_owned());
        (lines.iter().map(unnumbered).collect::<Vec<_>>(), skipped)
    });
    assert_eq!(one, other);
}

#[test]
fn a_difference_is_seen() {
    let golden = [
        "0 0 tracking 1 2 700 0 0 0 12",
        "1 0 tracking 1 2 700 0 0 0 12",
    ];
    let golden = golden.map(str::to_owned);
    let with = |line: &str| [golden[0].clone(), line.to_owned()];
    for (line, differs) in [
        ("1 0 tracking 3 0 702 1 0 -1 15", false),
        ("1 0 tracking 4 2 700 0 0 0 12", true),
        ("1 0 tracking 1 2 700 2 0 0 12", true),
        ("1 0 tracking 1 2 700 0 0 0 16", true),
        ("1 0 held 1 2 700 0 0 0 12", true),
        ("1 1 tracking 1 2 700 0 0 0 12", true),
        ("1 0 posed 1 2 700 0 0 0", true),
    ] {
        let is = with(line);
        assert_eq!(!differences(&golden, &is).is_empty(), differs, "{line}");
    }
}
