//! A minimal training, compared with golden figures. Skipped without the data sets.

use std::path::Path;

use super::*;
use crate::data::{Set, only};
use crate::golden::{cells, compare_with_golden, equals_golden, figures};
use crate::train::render::Renderer;
use mien_stages::base::capacity::LANDMARKS;
use mien_stages::base::checksum::crc32;
use mien_stages::face_model::{
    FEATURES, FaceModel, PATCH, PATCH_BYTES, SHIPPED, VIEW_PARAMETERS, file, weight_at,
};
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

/// Of a small training.
fn arguments(data: &Path, folder: &Path) -> TrainArgs {
    TrainArgs {
        images: vec![data.join("faces_frl189")],
        out: folder.join("small.model"),
        data: Data {
            data: data.to_owned(),
        },
        drawn: 240,
        shapes: None,
        starts: 1,
        seed: 1,
        tracks: None,
        offsets: Some(folder.join("offsets.csv")),
        paper_of: Some(crate::data::root().join("config/face.model")),
        paper_into: None,
        round: None,
        person: None,
        template: false,
        hold_out_dev: true,
    }
}

#[test]
fn a_small_training_gives_the_golden_figures() {
    let Some(data) = only([Set::IctFacekit, Set::FacesFrl189]) else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let args = arguments(data.path(), folder.path());
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

/// A model of version 3 with one stage, whose weights are `steps`, and the confidence's weights `signs`.
fn version_3(rows: usize, steps: &[i8], signs: &[f32]) -> Vec<u8> {
    let floats = |value: f32, count: usize| value.to_le_bytes().repeat(count);
    let count = |count: usize| u32::try_from(count).expect("small").to_le_bytes();
    let weights = steps.iter().map(|step| step.cast_unsigned()).collect();
    let stage = [
        count(1).to_vec(),
        count(rows).to_vec(),
        floats(5.0, 1),
        floats(0.2, FEATURES),
        weights,
        floats(0.01, rows * LANDMARKS),
        floats(0.5, rows * rows),
        floats(0.0, rows),
    ];
    let signs = signs.iter().flat_map(|sign| sign.to_le_bytes()).collect();
    let confidence = [
        floats(4.0, 1),
        floats(0.2, FEATURES),
        signs,
        floats(1.0, 4 * LANDMARKS + 7),
    ];
    let (stage, confidence) = (stage.concat(), confidence.concat());
    let sections =
        file::sections(SHIPPED)
            .expect("the shipped model")
            .map(|(tag, bytes)| match tag {
                b"COLD" => (tag, &stage[..]),
                b"WARM" => (tag, &[0; 4][..]),
                b"CONF" => (tag, &confidence[..]),
                _ => (tag, bytes),
            });
    let mut bytes = file::framed(sections);
    bytes[8] = 3;
    let body = bytes.len() - 4;
    let checksum = crc32(&bytes[..body]);
    bytes[body..].copy_from_slice(&checksum.to_le_bytes());
    bytes
}

#[test]
fn a_model_of_eight_bits_a_weight_is_converted_and_a_short_one_refused() {
    let Some(data) = only([Set::IctFacekit, Set::FacesFrl189]) else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let (old, out) = (
        folder.path().join("old.model"),
        folder.path().join("new.model"),
    );
    let mut random = fastrand::Rng::with_seed(9);
    let steps: Vec<i8> = (0..VIEW_PARAMETERS * FEATURES)
        .map(|_| random.i8(-127..))
        .collect();
    let signs: Vec<f32> = (0..FEATURES).map(|_| random.f32() - 0.5).collect();
    let bytes = version_3(VIEW_PARAMETERS, &steps, &signs);
    std::fs::write(&old, &bytes).unwrap();
    let args = TrainArgs {
        round: Some(old.clone()),
        paper_of: None,
        offsets: None,
        out: out.clone(),
        drawn: 0,
        ..arguments(data.path(), folder.path())
    };
    run(&args, &mut |_| ()).expect("data are readable");
    let model = FaceModel::read(&std::fs::read(&out).unwrap()).expect("a model");
    let shipped = FaceModel::shipped();
    assert!(model.shape == shipped.shape && model.refinement == shipped.refinement);
    let stage = &model.cold[0];
    assert_eq!(
        (model.cold.len(), model.warm.len(), stage.bias.len()),
        (1, 0, VIEW_PARAMETERS)
    );
    let patches = stage.levels.as_chunks::<PATCH_BYTES>().0;
    let rounded = (0..steps.len()).map(|k| f64::from(weight_at(&patches[k / PATCH], k % PATCH)));
    let pairs = rounded.zip(&steps).map(|(a, b)| [a, f64::from(*b)]);
    let alike = mien_workbench::correlation::correlation(pairs);
    // Two bits of an even distribution have a correlation of .97 with it; passing errors on costs some of it.
    assert!(alike > 0.8, "{alike}");
    let found = model.confidence.weights.iter().enumerate();
    let found = found.map(|(k, w)| f32::from(*w) * model.confidence.scales[k / PATCH]);
    assert!(found.zip(&signs).all(|(a, b)| (a - b).abs() < 0.003));
    let mut damaged = bytes.clone();
    damaged[bytes.len() / 2] ^= 1;
    for (bad, expected) in [
        (&bytes[..bytes.len() / 2], "bytes, found"),
        (&damaged, "checksum"),
        (SHIPPED, "version 3"),
        (b"a picture", "MIENFACE"),
        (&version_3(1, &steps[..FEATURES], &signs), "rows in a stage"),
    ] {
        std::fs::write(&old, bad).unwrap();
        let refused = run(&args, &mut |_| ()).unwrap_err().to_string();
        assert!(refused.contains(expected), "{refused}");
    }
}
