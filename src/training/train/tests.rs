//! A minimal training, compared with golden figures. Skipped without the data sets.

use super::*;
use crate::data::{Set, only};
use crate::golden::{cells, compare_with_golden, equals_golden, figures};
use crate::train::render::Renderer;
use mien_stages::face_model::FaceModel;
use mien_workbench::people_split::Data;

/// Resolution of a coefficient, as parts of its table's largest.
const FINE: f32 = 200.0;

/// Absolute values of some coefficients of a table, relative to its largest: a mode's sign is arbitrary.
fn some(name: &str, table: &[f32]) -> String {
    let largest = table.iter().fold(0f32, |most, one| most.max(one.abs()));
    let every = (table.len() / 64).max(1);
    let coarse = table.iter().step_by(every);
    let coarse = coarse.map(|one| (one.abs() / largest * FINE).round().to_string());
    format!("{name} {}", coarse.collect::<Vec<_>>().join(" "))
}

#[test]
fn a_small_training_gives_the_golden_figures() {
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
        shapes: None,
        starts: 1,
        seed: 1,
        tracks: None,
        offsets: Some(folder.path().join("offsets.csv")),
        paper_of: Some(crate::data::root().join("config/face.model")),
        paper_into: None,
        person: None,
        template: false,
        hold_out_dev: true,
    };
    let mut lines = Vec::new();
    run(&args, &mut |line| {
        lines.extend(figures(line.split_once(" s ").expect("seconds first").1))
    })
    .expect("data are readable");
    // Lines that state paths, sizes and checksums.
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
    compare_with_golden("train/small", &lines);
}

#[test]
fn a_training_picture_depends_on_its_number_and_seed_only() {
    let Some(data) = only([Set::IctFacekit, Set::FacesFrl189]) else {
        return;
    };
    let renderer =
        Renderer::new(data.path(), |person| person == 32, 1, &[]).expect("data are readable");
    let all = renderer.samples(0..4, 9);
    let one = renderer.samples(2..3, 9);
    assert_eq!(all[2].grey, one[0].grey);
    assert_ne!(all[2].grey, renderer.samples(2..3, 10)[0].grey);
    // Hats, hair, beards, glasses and hands: training pictures of the shipped model.
    let samples = renderer.samples(0..40, 9);
    let grey = samples
        .iter()
        .flat_map(|sample| cells::<16, 16>(&sample.grey, sample.grey.width() as usize));
    equals_golden("heads/training_pictures", &grey.collect::<Vec<_>>());
    let camera = mien_sensors::kinect::geometry::nominal();
    for sample in &all {
        for k in 0..mien_stages::base::capacity::LANDMARKS {
            let [x, y] = camera.colour_pixel(&(sample.sensor_from_head * sample.head[k]));
            let [u, v] = sample.points[k];
            assert!(
                (x - sample.origin[0] - u).abs() < 0.01 && (y - sample.origin[1] - v).abs() < 0.01
            );
        }
    }
}
