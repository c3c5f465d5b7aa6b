//! Seconds of what `evaluate` plays for minutes, held to its figures. Skipped where the data sets are absent.

use super::sessions::Sessions;
use super::{head_scenes, landmark_accuracy, table};
use crate::appliance::settings::Settings;
use crate::face_model::FaceModel;
use crate::studio::golden::{figures, hold};

/// The heads, and what else a table has rows of.
fn data(more: &[&str]) -> Option<std::path::PathBuf> {
    crate::studio::data::data(&[&["ict_facekit", "faces_frl189"], more].concat())
}

fn short(people: usize, seconds: f64) -> Sessions {
    Sessions {
        people,
        seconds,
        ..Sessions::default()
    }
}

#[test]
fn somebody_who_acts_gives_the_table_they_gave() {
    let Some(data) = data(&[]) else { return };
    let (model, settings) = (FaceModel::shipped(), Settings::default());
    let table = table::play(&data, &model, &settings, &short(1, 20.0)).expect("data are readable");
    hold("evaluate/table", &figures(&table.to_string()));
}

#[test]
fn landmarks_under_every_condition_err_as_they_did() {
    let Some(data) = data(&["faces_ytfaces68", "video_talkingface"]) else {
        return;
    };
    let mut lines = Vec::new();
    let mut say = |line: &str| {
        // Neither times nor counts.
        if !line.contains("time") && !line.contains('→') {
            lines.extend(figures(line));
        }
    };
    let (model, settings) = (FaceModel::shipped(), Settings::default());
    landmark_accuracy::measure(&data, &model, &settings, &short(2, 2.0), &mut say)
        .expect("data are readable");
    hold("evaluate/landmarks", &lines);
}

#[test]
fn scenes_of_heads_give_the_rows_they_gave() {
    let Some(data) = data(&["kinect_v1_pcl"]) else {
        return;
    };
    let rows = ["acted", "wide", "first", "several", "known", "nobody"];
    let (model, settings) = (FaceModel::shipped(), Settings::default());
    let rows = rows.map(str::to_owned);
    let table = head_scenes::play(&data, &model, &settings, &short(2, 1.0), &rows)
        .expect("data are readable");
    let wild = head_scenes::wild::play(&data, &model, &settings, &short(4, 1.0)).unwrap();
    hold("evaluate/scenes", &figures(&(table + &wild)));
}
