//! Regression tests: synthetic sessions compared with the recorded output of the stages.
//!
//! They need no data set, unlike `tests/it/replays_the_corpus.rs`, and detect one constant changed by a tenth. The recorded
//! output is that of the last accepted version, not ground truth. `MIEN_WRITE_GOLDEN=1 cargo test -p mien-appliance
//! pipeline::tests` rewrites `tests/golden/stages/*.txt`.

use std::fmt::Write;

use crate::hold::compare_with_golden;
use crate::pipeline::Pipeline;
use crate::pipeline::Settings;
use crate::toy_face::toy_face;
use mien_outputs::Command;
use mien_sensors::{Frame, NO_DEPTH};
use mien_simulator::virtual_head::{Appearance, HeadAsset, Scene, Simulator};
use mien_stages::base::capacity::LANDMARKS;
use mien_stages::base::frames::SensorFromFace;
use mien_stages::base::geometry::{
    Point, Rigid, Vector, rotation_from_yaw_pitch_roll, yaw_pitch_roll,
};
use mien_stages::base::time::Timestamp;
use mien_stages::expression::{Expression, Method, Scale, Settings as ExpressionSettings, Units};
use mien_stages::face_model::FaceModel;
use mien_stages::landmarks::Landmarks;

/// Replaces `-0` by `0`, as the sign of a rounded zero is arbitrary.
fn plain(line: &str) -> String {
    let words = line
        .split(' ')
        .map(|word| if word == "-0" { "0" } else { word });
    words.collect::<Vec<_>>().join(" ")
}

/// Frame `n`, at 30 Hz, of a face whose parts move at different rates; its height is scaled by `longer`.
fn acting(n: u64, longer: f32, random: &mut fastrand::Rng) -> Landmarks {
    let seconds = n as f32 / 30.0;
    let mut head = toy_face().map(|p| Point::new(p.x, p.y * longer, p.z));
    // Landmarks, displacement (mm), cycles per minute; at rest for the first three seconds and half of the time.
    let parts: [(&[usize], [f32; 3], f32); 11] = [
        (&[65, 66, 67, 55, 56, 57, 58, 59], [0.0, 9.0, 0.0], 17.0),
        (&[7, 8, 9], [0.0, 12.0, 1.0], 13.0),
        (&[54], [6.0, -5.0, 1.0], 11.0),
        (&[48], [-6.0, -5.0, 1.0], 10.0),
        (&[54, 48], [0.0, 4.0, 0.0], 7.0),
        (&[22, 23, 24, 25, 26], [0.0, -5.0, 0.0], 9.0),
        (&[17, 18, 19, 20, 21], [0.0, 4.0, 0.0], 8.0),
        (&[37, 38, 43, 44], [0.0, 4.0, 0.0], 19.0),
        (&[31, 32, 34, 35], [0.0, -3.0, 0.0], 6.0),
        (&[50, 51, 52, 56, 57, 58], [0.0, 0.0, -6.0], 5.0),
        (&[56, 57, 58, 7, 8, 9], [4.0, 0.0, 0.0], 4.0),
    ];
    for (k, (points, by, a_minute)) in parts.iter().enumerate() {
        let phase = core::f32::consts::TAU * (seconds * a_minute / 60.0 + 0.1 * k as f32);
        let much = (phase.sin() * 1.5 - 0.2).clamp(0.0, 1.0) * (seconds - 3.0).clamp(0.0, 1.0);
        for &i in *points {
            head[i] += Vector::from(*by) * (1e-3 * much);
        }
    }
    for point in &mut head {
        for axis in 0..3 {
            point[axis] += 6e-4 * (random.f32() - 0.5);
        }
    }
    let mut point_confidence = [0.9; LANDMARKS];
    if (n / 90).is_multiple_of(5) {
        point_confidence[17..27].fill(0.1);
    }
    Landmarks {
        head,
        point_confidence,
        cheeks: [0.001 * (seconds * 0.7).sin(); 2],
        confidence: if n % 200 < 190 { 0.9 } else { 0.2 },
        ..Landmarks::default()
    }
}

fn check_learning(name: &str, settings: ExpressionSettings, units: Units) {
    let mut expression = Expression::new(settings, units);
    let mut random = fastrand::Rng::with_seed(11);
    let mut lines = Vec::new();
    // Gaps of half a second and four seconds; after the second one the face is another person's.
    let frames = (0..900).chain(915..1500).chain(1620..2400);
    for (k, n) in frames.enumerate() {
        let face = acting(n, if n < 1500 { 1.0 } else { 1.15 }, &mut random);
        let turn = rotation_from_yaw_pitch_roll((n as f32 * 0.01).sin() * 0.8, 0.1, 0.0);
        let position = nalgebra::Translation3::new(0.1, 0.0, 0.7 + 0.3 * (n as f32 * 0.003).sin());
        let at = Timestamp::from_us(n * 33_333);
        let pose = Rigid::from_parts(position, turn);
        let weights = expression
            .observe(&face, &SensorFromFace::assume_frames(pose), at)
            .clone();
        match n {
            1000 => expression.freeze(true),
            1050 => expression.freeze(false),
            1200 => expression.take_neutral(),
            2100 => expression.restore(&expression.learned()),
            _ => {}
        }
        if k % 37 != 0 {
            continue;
        }
        let mut line = format!("{n} {} {}", expression.resets(), weights.warming);
        for (weight, ready) in weights.units().iter().zip(weights.readiness()) {
            write!(line, " {:.0} {:.0}", 500.0 * weight, 200.0 * ready).unwrap();
        }
        for range in expression.ranges() {
            for value in [range.low, range.rest, range.high] {
                write!(line, " {:.0}", 1000.0 * value).unwrap();
            }
        }
        for range in expression.unit_ranges() {
            write!(
                line,
                " {:.0} {:.0}",
                1000.0 * range.high,
                5000.0 * range.noise
            )
            .unwrap();
        }
        lines.push(plain(&line));
    }
    compare_with_golden(&format!("stages/{name}"), &lines);
}

#[test]
fn learning_by_evidence() {
    let settings = ExpressionSettings {
        half_life_s: 40.0,
        ..ExpressionSettings::default()
    };
    check_learning("learned", settings, Units::shipped());
}

#[test]
fn learning_of_single_measures() {
    let settings = ExpressionSettings {
        scale: Scale::Frame,
        half_life_s: 0.0,
        ..ExpressionSettings::default()
    };
    check_learning(
        "learned_by_measure",
        settings,
        Units::shipped().by_measure(),
    );
}

#[test]
fn learning_as_in_the_paper() {
    let settings = ExpressionSettings {
        method: Method::Paper,
        compensation_scale: 0.05,
        half_life_s: 40.0,
        ..ExpressionSettings::default()
    };
    check_learning("learned_as_in_the_paper", settings, Units::shipped());
}

/// Runs a scene at 15 frames per second over the given spans, seconds; appends a line per user to `lines`.
fn follow(pipeline: &mut Pipeline, scene: Scene, seconds: &[[u64; 2]], lines: &mut Vec<String>) {
    let people = if matches!(scene, Scene::Swap | Scene::Two) {
        2
    } else {
        1
    };
    let heads = (0..people).map(|_| HeadAsset::shipped());
    let mut heads = heads.collect::<Vec<_>>().into_iter();
    let first = heads.next().expect("one");
    let appearances = if scene == Scene::Demo {
        vec![Appearance::demonstration()]
    } else {
        Vec::new()
    };
    let mut simulator = Simulator::new(first, scene, 5)
        .with_others(heads)
        .dressed(appearances);
    let mut frame = Frame::default();
    for (k, tick) in seconds
        .iter()
        .flat_map(|[from, to]| 15 * from..15 * to)
        .enumerate()
    {
        let at = Timestamp::from_us(tick * 66_667);
        simulator.draw(at, &mut frame);
        (frame.at, frame.index) = (at, tick);
        match tick % 90 {
            // Frames without depth, then without colour.
            70..74 => frame.depth.fill(NO_DEPTH),
            80..84 => frame.drop_colour(),
            _ => {}
        }
        pipeline.follow(&frame);
        if k % 3 != 0 {
            continue;
        }
        for report in pipeline.reports() {
            let user = report.user.map_or("-".to_owned(), |user| user.to_string());
            let mut line = format!("{scene:?} {tick} {user} {}", report.state.name());
            write!(line, " {:.0}", 100.0 * report.confidence).unwrap();
            if let Some(pose) = report.sensor_from_face {
                for metres in pose.translation.vector.iter() {
                    write!(line, " {:.0}", metres * 5e3).unwrap();
                }
                let (yaw, pitch, roll) = yaw_pitch_roll(&pose.rotation);
                for turn in [yaw, pitch, roll] {
                    write!(line, " {:.0}", 10.0 * turn.to_degrees()).unwrap();
                }
            }
            for (m, measure) in report
                .measures
                .iter()
                .enumerate()
                .filter(|(m, _)| m % 4 == 1)
            {
                write!(line, " {:.0}", if m == 0 { 1e4 } else { 100.0 } * measure).unwrap();
            }
            let sum: f32 = report.weights.iter().sum();
            write!(line, " {:.0}", 20.0 * sum).unwrap();
            lines.push(plain(&line));
        }
    }
}

fn pipeline() -> Pipeline {
    let (seen, model) = (
        Simulator::new(HeadAsset::shipped(), Scene::Demo, 5),
        FaceModel::shipped(),
    );
    Pipeline::new(&Settings::default(), seen.camera(), &model).expect("a pipeline")
}

fn check_tracking(scene: Scene, seconds: &[[u64; 2]]) {
    let mut lines = Vec::new();
    follow(&mut pipeline(), scene, seconds, &mut lines);
    compare_with_golden(&format!("stages/followed_{scene:?}").to_lowercase(), &lines);
}

#[test]
fn tracking_of_a_person_who_leaves_and_returns() {
    check_tracking(Scene::Leaving, &[[5, 9], [12, 17]]);
}

#[test]
fn tracking_of_an_acting_person() {
    check_tracking(Scene::Demo, &[[0, 4]]);
}

#[test]
fn tracking_of_fast_turns() {
    check_tracking(Scene::Fast, &[[0, 3]]);
}

#[test]
fn tracking_behind_a_hand() {
    check_tracking(Scene::Hand, &[[4, 7]]);
}

#[test]
fn tracking_of_a_person_replaced_by_another() {
    check_tracking(Scene::Swap, &[[4, 9], [12, 16]]);
}

#[test]
fn tracking_of_wide_turns_and_forgetting() {
    let (mut pipeline, mut lines) = (pipeline(), Vec::new());
    follow(&mut pipeline, Scene::Wide, &[[4, 10]], &mut lines);
    pipeline.execute(Command::Neutral(0));
    pipeline.execute(Command::Forget(0));
    follow(&mut pipeline, Scene::Wide, &[[10, 11]], &mut lines);
    compare_with_golden("stages/followed_wide", &lines);
}
