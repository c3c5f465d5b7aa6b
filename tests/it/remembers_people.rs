//! Promise: a restart forgets nobody: who was there gets their ranges back from a file, which is believed only whole.

use std::time::{Duration, SystemTime};

use mien_appliance::pipeline::Pipeline;
use mien_appliance::settings::Settings;
use mien_appliance::source;
use mien_sensors::Frame;
use mien_stages::base::time::Timestamp;
use mien_stages::expression::Measure;
use mien_stages::face_model::FaceModel;
use mien_stages::users::memory::Gone;
use mien_stages::users::saved::{People, read, write};

use crate::common::mien;

/// The built-in person before the simulated sensor, for so many frames.
fn play(pipeline: &mut Pipeline, frames: usize) {
    let mut source = source::simulated(Some("acted")).expect("built in");
    let mut frame = Frame::default();
    for _ in 0..frames {
        assert!(source.next_frame(&mut frame).expect("endless"));
        pipeline.follow(&frame);
    }
}

fn pipeline() -> Pipeline {
    let source = source::simulated(Some("acted")).expect("built in");
    let model = FaceModel::shipped();
    Pipeline::new(&Settings::default().stages, source.camera(), &model).expect("built in")
}

/// The file of a run that somebody has played for two seconds, and when it was written.
fn written() -> (String, SystemTime) {
    let mut pipeline = pipeline();
    play(&mut pipeline, 60);
    let at = SystemTime::UNIX_EPOCH + Duration::from_secs(1_700_000_000);
    let (mut text, now) = (String::new(), pipeline.last_frame_time());
    write(pipeline.people(now), (now, at), &mut text).expect("a String takes everything");
    (text, at)
}

#[test]
fn who_was_there_is_known_after_a_restart() {
    let mut before = pipeline();
    play(&mut before, 600);
    let people: Vec<Gone> = before.people(before.last_frame_time()).collect();
    assert_eq!(people.len(), 1, "one person is there");
    let learned = people[0].learned.clone();

    let folder = tempfile::tempdir().expect("temporary folder");
    let path = folder.path().join("people.ranges");
    let mut file = People::new(&path);
    assert!(file.load().is_empty(), "no file, nobody");
    file.save(people.iter().cloned(), before.last_frame_time());
    let names: Vec<_> = std::fs::read_dir(folder.path()).unwrap().collect();
    assert_eq!(names.len(), 1, "nothing is left beside it");

    let mut after = pipeline();
    after.recall(People::new(&path).load());
    play(&mut after, 30);
    let mut fresh = pipeline();
    play(&mut fresh, 30);
    let up = |range: &mien_stages::expression::Range| range.high - range.rest;
    let (mut own, mut strange) = (0.0, 0.0);
    use Measure::{BrowL, JawDrop, LipGap, MouthWidth};
    for m in [LipGap, JawDrop, MouthWidth, BrowL].map(|m| m as usize) {
        let off = |pipeline: &Pipeline| {
            let ratio = up(&pipeline.expression(0).ranges()[m]) / up(&learned.ranges[m]);
            ratio.ln().abs()
        };
        own += off(&after);
        strange += off(&fresh);
    }
    println!("sides are off by {own:.3} with the file, by {strange:.3} without");
    assert!(own < 0.4 * strange, "{own} {strange}");
}

#[test]
fn a_file_reads_back_and_ages() {
    let (text, at) = written();
    let later = read(&text, at + Duration::from_secs(90)).expect("just written");
    assert_eq!(later.len(), 1);
    assert!((later[0].before_s - 90.0).abs() <= 1.0);
    let mut again = String::new();
    let now = (Timestamp::default(), at + Duration::from_secs(90));
    write(later.iter().cloned(), now, &mut again).expect("a String takes everything");
    assert_eq!(again, text);
    let earlier = read(&text, at - Duration::from_secs(3600)).expect("just written");
    assert!(
        earlier[0].before_s == 0.0,
        "a clock set back makes nobody older"
    );
}

#[test]
fn a_damaged_file_is_refused_and_set_aside() {
    let (text, at) = written();
    for byte in 0..text.len() - 1 {
        let mut bytes = text.clone().into_bytes();
        bytes[byte] ^= 1;
        let damaged = String::from_utf8_lossy(&bytes).into_owned();
        assert!(read(&damaged, at).is_err(), "byte {byte}");
    }
    for length in 0..text.len() - 1 {
        assert!(read(&text[..length], at).is_err(), "cut at {length}");
    }

    let folder = tempfile::tempdir().expect("temporary folder");
    let path = folder.path().join("people.ranges");
    std::fs::write(&path, &text[..text.len() / 2]).expect("writable");
    assert!(People::new(&path).load().is_empty());
    assert!(!path.exists() && folder.path().join("people.ranges.damaged").exists());
}

#[test]
fn a_simulation_saves_nobody() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let people = folder.path().join("people.ranges");
    let config = folder.path().join("mien.toml");
    let text = format!(
        "[state]\npersist = true\npath = {people:?}\n[osc]\nenabled = false\n[status]\npath = \"\"\n"
    );
    std::fs::write(&config, text).expect("writable");
    let mut run = mien("run --source simulated --fast --frames 60 --config");
    let run = run.arg(&config).output().expect("runs");
    let said = String::from_utf8_lossy(&run.stderr);
    assert!(run.status.success(), "{said}");
    assert!(!people.exists());
}
