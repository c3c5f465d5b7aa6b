//! Short runs of `evaluate`, compared with golden figures. Skipped without the data sets.

use super::sessions::{Sessions, Trial};
use super::{head_scenes, landmark_accuracy, table};
use crate::data::{self, Set};
use crate::golden::{compare_with_golden, figures};
use crate::train::evaluate::{differences, mean_percent};
use mien_appliance::pipeline::Pipeline;
use mien_appliance::settings::Settings;
use mien_sensors::Frame;
use mien_sensors::kinect::recording::Recording;
use mien_stages::face_model::FaceModel;

/// The data sets with photographs.
fn people() -> Option<tempfile::TempDir> {
    data::only([Set::IctFacekit, Set::FacesFrl189])
}

/// Plays a short trial of the shipped model and settings.
fn tried<T>(
    data: &tempfile::TempDir,
    people: usize,
    seconds: f64,
    play: impl FnOnce(&Trial) -> T,
) -> T {
    let sessions = Sessions {
        people,
        seconds,
        ..Sessions::default()
    };
    play(&Trial {
        shapes: &[],
        data: data.path(),
        model: &FaceModel::shipped(),
        settings: &Settings::default(),
        sessions: &sessions,
    })
}

#[test]
fn an_acting_person_gives_the_golden_table() {
    let Some(data) = people() else { return };
    let table = tried(&data, 1, 20.0, table::play).expect("data are readable");
    compare_with_golden("evaluate/table", &figures(&table.to_string()));
}

#[test]
fn landmark_errors_equal_the_golden_ones() {
    let Some(data) = data::only([
        Set::IctFacekit,
        Set::FacesFrl189,
        Set::FacesYtfaces68,
        Set::VideoTalkingface,
    ]) else {
        return;
    };
    let mut lines = Vec::new();
    let mut say = |line: &str| {
        // Times and counts are excluded.
        if !line.contains("time") && !line.contains('→') {
            lines.extend(figures(line));
        }
    };
    tried(&data, 2, 2.0, |trial| {
        landmark_accuracy::measure(trial, &mut say)
    })
    .expect("data are readable");
    compare_with_golden("evaluate/landmarks", &lines);
}

#[test]
fn scenes_of_heads_give_the_golden_rows() {
    let Some(data) = data::only([Set::IctFacekit, Set::FacesFrl189, Set::KinectV1Pcl]) else {
        return;
    };
    let rows = ["acted", "wide", "first", "several", "known", "nobody"];
    let rows = rows.map(str::to_owned);
    let table = tried(&data, 2, 1.0, |trial| head_scenes::play(trial, &rows)).unwrap();
    let wild = tried(&data, 4, 1.0, |trial| head_scenes::wild::play(trial, false)).unwrap();
    compare_with_golden("evaluate/scenes", &figures(&(table + &wild)));
}

#[test]
fn recorded_wild_sessions_play_and_their_points_lie_where_the_truth_says() {
    let Some(data) = people() else { return };
    let folder = tempfile::tempdir().unwrap();
    tried(&data, 1, 1.0, |trial| {
        head_scenes::wild::record(trial, false, folder.path())
    })
    .unwrap();
    let session = folder.path().join("0");
    let truth = std::fs::read_to_string(session.join("truth.csv")).unwrap();
    let mut rows = truth.lines().skip(1).map(|line| {
        let numbers = line.split(',').map(|number| number.parse::<f32>().unwrap());
        numbers.collect::<Vec<f32>>()
    });
    let mut recording = Recording::open(&session).unwrap();
    let (settings, model) = (Settings::default(), FaceModel::shipped());
    let mut pipeline = Pipeline::new(&settings.stages, &recording.camera, &model).unwrap();
    let mut frame = Frame::default();
    let mut errors = Vec::new();
    while recording.next_frame(&mut frame) {
        pipeline.follow(&frame);
        let row = rows.find(|row| row[0] == frame.index as f32).unwrap();
        let points = std::array::from_fn(|i| [row[1 + 2 * i], row[2 + 2 * i]]);
        let found = pipeline.report().landmarks;
        errors.extend(found.map(|found| mean_percent(&differences(&found.pixels, &points))));
    }
    // As in the table of `scenes_of_heads_give_the_golden_rows`: 1.24 % of the same second.
    assert!(errors.len() >= 25, "{errors:?}");
    assert!(errors.iter().all(|&error| error < 2.5), "{errors:?}");
}
