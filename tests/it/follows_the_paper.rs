//! Promise: the paper's own system, `config/paper.toml` as it is shipped, follows a face: pose, points and measures.
//!
//! On the shipped head for everybody who builds, and on a person whom its model has never seen where the data sets are.
//! Bars are near what it reaches, so that a stage that
//! loses its footing shows; before it had a shape model that could open its mouth, rotation was off by 8°, points by 13 %,
//! and no measure was followed.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::process::Command;

use mien_appliance::pipeline::Pipeline;
use mien_appliance::settings::Settings;
use mien_sensors::Frame;
use mien_sensors::kinect::recording::Recording;
use mien_simulator::simulated::Simulated;
use mien_stages::base::geometry::{Point, Rotation, Vector};
use mien_stages::expression::{Measure, measures};
use mien_stages::face_model::FaceModel;
use mien_stages::{expression, landmarks, pose};

use crate::common;
#[cfg(feature = "studio")]
use crate::common::data::Set;

const FRAMES: u32 = 300;

fn settings() -> Settings {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/paper.toml");
    mien_appliance::service::settings(Some(&file)).expect("the shipped file")
}

fn correlation(pairs: &[[f32; 2]]) -> f32 {
    let n = pairs.len() as f32;
    let mean = [0, 1].map(|k| pairs.iter().map(|p| p[k]).sum::<f32>() / n);
    let (mut xx, mut yy, mut xy) = (0.0, 0.0, 1e-20);
    for pair in pairs {
        let [x, y] = [pair[0] - mean[0], pair[1] - mean[1]];
        (xx, yy, xy) = (xx + x * x, yy + y * y, xy + x * y);
    }
    xy / (xx * yy).sqrt().max(1e-20)
}

#[test]
fn every_stage_is_the_papers() {
    let settings = settings();
    assert_eq!(settings.stages.pose.method, pose::Method::Paper);
    let window = settings.stages.pose.smoothing;
    assert!(matches!(window, pose::smoothing::Smoothing::Window(_)));
    assert_eq!(settings.stages.landmarks.method, landmarks::Method::Paper);
    assert_eq!(settings.stages.learning.method, expression::Method::Paper);
    // It never forgets, and σ is what the paper says.
    assert_eq!(settings.stages.learning.half_life_s, 0.0);
    assert_eq!(settings.stages.learning.compensation_scale, 0.0);
}

#[test]
fn the_papers_system_follows_the_actor() {
    let model = FaceModel::shipped();
    let mut source = Simulated::new(Some("acted")).expect("a scene");
    let mut pipeline = Pipeline::new(
        &settings().stages,
        &mien_sensors::kinect::geometry::nominal(),
        &model,
    )
    .expect("the shipped model");
    let mut frame = Frame::default();
    let (mut turns, mut off) = (Vec::new(), 0.0);
    let told = [Measure::LipGap, Measure::JawDrop, Measure::MouthWidth];
    let mut measured = told.map(|_| Vec::new());
    for _ in 0..FRAMES {
        source.next_frame(&mut frame);
        let truth = source.truth().expect("somebody acts");
        pipeline.follow(&frame);
        let report = pipeline.report();
        let (true, Some(pose), Some(found)) = (
            report.state.is_present(),
            report.sensor_from_face,
            report.landmarks,
        ) else {
            continue;
        };
        turns.push((truth.sensor_from_head.rotation.inverse() * pose.rotation).scaled_axis());
        let placed = &truth.landmarks_px;
        let eye = (placed[36][0] - placed[45][0]).hypot(placed[36][1] - placed[45][1]);
        let sum: f32 = placed
            .iter()
            .zip(&found.pixels)
            .map(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1]))
            .sum();
        off += 100.0 * sum / (placed.len() as f32 * eye);
        let both = [
            measures::raw(&found.head),
            measures::raw(&truth.landmarks_head),
        ];
        for (pairs, measure) in measured.iter_mut().zip(told) {
            // In metres: the learner divides by the person's eye distance, which is a constant.
            pairs.push(both.map(|raw| raw[measure as usize]));
        }
        assert!(report.weights.iter().all(|w| w.is_finite() && *w >= 0.0));
    }
    // Where a head's frame sits on a face is a convention: one fixed turn is told and taken out.
    let n = turns.len() as f32;
    let fixed = turns.iter().sum::<Vector>() / n;
    let left = turns.iter().map(|turn| {
        let left = Rotation::from_scaled_axis(fixed).inverse() * Rotation::from_scaled_axis(*turn);
        left.angle().to_degrees()
    });
    let (fixed, left, off) = (fixed.norm().to_degrees(), left.sum::<f32>() / n, off / n);
    let follows = measured.each_ref().map(|pairs| correlation(pairs));
    println!(
        "{n} of {FRAMES} frames; rotation off by a fixed {fixed:.2} deg and {left:.2} beside it, landmarks {off:.2} % of the \
         outer-eye distance; correlation of {told:?} {follows:.3?}"
    );
    assert!(n >= 0.98 * FRAMES as f32, "{n} of {FRAMES} frames");
    // Near what it reaches: 5.1 and 0.8 deg, 1.9 %; 0.99, 0.97, 0.93.
    assert!(fixed < 5.5 && left < 1.3 && off < 2.4);
    assert!(follows[0] > 0.95 && follows[1] > 0.9 && follows[2] > 0.88);
}

#[cfg(feature = "studio")]
#[test]
fn a_person_never_trained_on_is_followed_by_the_papers_system() {
    use mien_training::evaluate::sessions::{Sessions, Trial};
    use mien_training::evaluate::table::play;
    use mien_workbench::people_split::Split;

    let Some(data) = common::data::only([Set::FacesFrl189, Set::IctFacekit]) else {
        return;
    };
    let sessions = Sessions {
        people: 1,
        seconds: 8.0,
        split: Split::Test,
        ..Sessions::default()
    };
    let trial = Trial {
        shapes: &[],
        data: data.path(),
        model: &FaceModel::shipped(),
        settings: &settings(),
        sessions: &sessions,
    };
    let table = play(&trial).expect("the data sets");
    println!("{table}");
    assert!(table.tracked > 0.98, "{}", table.tracked);
    let rotation = table.rotation_deg[1].spread;
    assert!(rotation.mean < 2.0 && rotation.p95 < 4.0, "{rotation}");
    assert!(
        table.landmarks.spread.mean < 3.5,
        "{}",
        table.landmarks.spread
    );
    // Only what is acted in eight seconds has a correlation to speak of.
    for (measure, least) in [
        (Measure::LipGap, 0.9),
        (Measure::JawDrop, 0.85),
        (Measure::MouthWidth, 0.75),
        (Measure::LidL, 0.6),
        (Measure::BrowL, 0.65),
    ] {
        let of = table.following.iter().find(|of| of.measure == measure);
        let measured = of.expect("a unit of it").measured;
        assert!(measured > least, "{}: {measured}", measure.name());
    }
}

/// What a test that is left out wants.
const SECOND_WORLD: &str = "the second simulated world (MIEN_WORLD), or what it is built with";
/// Frames of the second world's scene, and those at its start that do not count.
const WORLD_FRAMES: usize = 360;
const WORLD_SKIPPED: usize = 60;

/// Person 3 of the second world (`MIEN_WORLD`, else `../shared/world`), drawn once a build. `None`, told in one line, where
/// there is no such world.
fn second_world() -> Option<PathBuf> {
    let world = std::env::var_os("MIEN_WORLD").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/world"),
        PathBuf::from,
    );
    if !world.join("Cargo.toml").is_file() {
        common::data::leave_out(SECOND_WORLD);
        return None;
    }
    let kept = Path::new(env!("CARGO_TARGET_TMPDIR")).join("second-world");
    let scene = kept.join(format!("person3-{WORLD_FRAMES}"));
    if scene.join("truth.csv").is_file() {
        return Some(scene);
    }
    let built = Command::new(env!("CARGO"))
        .args(["build", "--release", "--quiet", "--locked"])
        .current_dir(&world)
        .env("CARGO_TARGET_DIR", &kept)
        .status();
    if !built.is_ok_and(|built| built.success()) {
        common::data::leave_out(SECOND_WORLD);
        return None;
    }
    let drawn = Command::new(kept.join("release/kinect-synth"))
        .arg("single")
        .arg(&scene)
        .args(["--frames", &WORLD_FRAMES.to_string()])
        .args(["--seed", "7021", "--identity", "1003"])
        .current_dir(&world)
        .output();
    assert!(
        drawn.expect("kinect-synth").status.success(),
        "the drawing of a scene"
    );
    Some(scene)
}

#[test]
fn a_person_of_the_second_world_is_followed_by_the_papers_system() {
    let Some(scene) = second_world() else { return };
    let truth = std::fs::read_to_string(scene.join("truth.csv")).expect("the scene's truth");
    let mut lines = truth.lines();
    let names = lines.next().expect("names of the columns").split(',');
    let column: HashMap<&str, usize> = names.enumerate().map(|(k, name)| (name, k)).collect();
    let rows: Vec<Vec<&str>> = lines.map(|line| line.split(',').collect()).collect();
    let mut recording = Recording::open(&scene).expect("a recording");
    let camera = recording.camera.clone();
    let model = FaceModel::shipped();
    let mut pipeline =
        Pipeline::new(&settings().stages, &camera, &model).expect("the shipped model");
    let units = ["AU25", "AU43L", "AU43R"].map(|name| {
        let names = pipeline.unit_names();
        names.iter().position(|unit| *unit == name).expect("a unit")
    });
    let mut frame = Frame::default();
    let mut off = Vec::new();
    let mut pairs = units.map(|_| Vec::new());
    for row in &rows {
        assert!(recording.next_frame(&mut frame), "as many frames as lines");
        pipeline.follow(&frame);
        let report = pipeline.report();
        let (true, Some(found)) = (report.state.is_present(), report.landmarks) else {
            continue;
        };
        let at = |name: String| -> f32 { row[column[name.as_str()]].parse().expect("a number") };
        if at("frame".into()) < WORLD_SKIPPED as f32 {
            continue;
        }
        let placed: Vec<[f32; 2]> = (0..found.pixels.len())
            .map(|i| [at(format!("u{i}")), at(format!("v{i}"))])
            .collect();
        let eye = (placed[36][0] - placed[45][0]).hypot(placed[36][1] - placed[45][1]);
        let both = placed.iter().zip(&found.pixels);
        let sum: f32 = both.map(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1])).sum();
        off.push(100.0 * sum / (placed.len() as f32 * eye));
        let head: [Point; 68] = std::array::from_fn(|i| {
            let [x, y, z] = ["x", "y", "z"].map(|axis| at(format!("{axis}{i}")));
            Point::new(x, y, z)
        });
        let raw = measures::raw(&head);
        let true_measures =
            [Measure::LipGap, Measure::LidL, Measure::LidR].map(|m| raw[m as usize]);
        for ((pairs, unit), measure) in pairs.iter_mut().zip(units).zip(true_measures) {
            pairs.push([report.weights[unit], measure]);
        }
    }
    let mean = off.iter().sum::<f32>() / off.len() as f32;
    let [lips, left, right] = pairs.each_ref().map(|pairs| correlation(pairs));
    println!(
        "{} frames; landmarks {mean:.2} %; weight against true measure: lips {lips:.3}, lids {left:.3}, {right:.3}",
        off.len()
    );
    assert!(off.len() > (WORLD_FRAMES - WORLD_SKIPPED) * 95 / 100);
    // Near what it reaches: 2.4 %, .95, and lids that shut as the unit rises: -.96, -.78.
    assert!(mean < 3.3 && lips > 0.7 && left < -0.7 && right < -0.7);
}
