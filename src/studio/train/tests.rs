//! A training so small that it serves nobody, held to its figures. Left out where the data sets are absent.

use super::*;
use crate::face_model::FaceModel;
use crate::studio::data::{Set, only};
use crate::studio::golden::{figures, hold};
use crate::studio::people_split::Data;

/// A coefficient in so many parts of its table's largest.
const FINE: f32 = 200.0;

/// Sizes of some coefficients of a table, against its largest: a mode may point either way.
fn some(name: &str, table: &[f32]) -> String {
    let largest = table.iter().fold(0f32, |most, one| most.max(one.abs()));
    let every = (table.len() / 64).max(1);
    let coarse = table.iter().step_by(every);
    let coarse = coarse.map(|one| (one.abs() / largest * FINE).round().to_string());
    format!("{name} {}", coarse.collect::<Vec<_>>().join(" "))
}

#[test]
fn a_small_training_learns_what_it_learnt() {
    let Some(data) = only([Set::IctFacekit, Set::FacesFrl189]) else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let args = TrainArgs {
        images: vec![data.path().join("faces_frl189")],
        out: folder.path().join("small.model"),
        data: Data {
            data: data.path().to_owned(),
        },
        drawn: 240,
        starts: 1,
        seed: 1,
        tracks: None,
        offsets: Some(folder.path().join("offsets.csv")),
        paper_of: Some("config/face.model".into()),
        paper_into: None,
        person: None,
        hold_out_dev: true,
    };
    let mut lines = Vec::new();
    run(&args, &mut |line| {
        lines.extend(figures(line.split_once(" s ").expect("seconds first").1))
    })
    .expect("data are readable");
    // Where the two files were written, the model's size and its sum.
    lines.retain(|line| !line.starts_with("wrote"));
    let offsets = std::fs::read_to_string(args.offsets.expect("given above")).unwrap();
    let ten_thousandths = |word: &str| word.parse().map(|x: f32| (x * 1e4).round().to_string());
    lines.extend(offsets.lines().map(|line| {
        let words = line.split(',').skip(1);
        let words: Vec<_> = words
            .map(|w| ten_thousandths(w).unwrap_or_default())
            .collect();
        words.join(" ")
    }));
    let model = FaceModel::read(&std::fs::read(&args.out).unwrap()).expect("just written");
    lines.push(some("shape", &model.shape.deviations));
    lines.push(some(
        "depth",
        &model.refinement.expect("something is learnt").weights,
    ));
    lines.push(some("landmark confidence", &model.confidence.landmark));
    lines.push(some("face confidence", &model.confidence.face));
    let stages = model.cold.iter().chain(model.warm.iter());
    lines.extend(stages.map(|stage| some("stage", &stage.bias)));
    hold("train/small", &lines);
}
