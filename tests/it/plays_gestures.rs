//! People of the simulator act every default gesture at full, then speak, blink, look about, turn and rest: the tables that
//! `tests/gestures/run` judges. Also checks that gaze is read correctly.

use std::io::Write;

use mien_appliance::pipeline::{Pipeline, Settings};
use mien_baking::heads::textured_heads;
use mien_outputs::csv::Csv;
use mien_outputs::gesture::{Gesture, Gestures, PRESETS};
use mien_outputs::{Output, Report};
use mien_sensors::Frame;
use mien_simulator::virtual_head::{Light, Scene, Simulator};
use mien_stages::base::geometry::{Rigid, Rotation, rotation_from_yaw_pitch_roll};
use mien_stages::base::time::Timestamp;
use mien_stages::face_model::FaceModel;
use mien_workbench::people_split::Split;

use crate::common;
use crate::common::data::Set;

/// Rounds of all gestures, the time of one, and its rise, fall and length at full, seconds.
const ROUNDS: usize = 3;
const ACT_S: f32 = 3.0;
const RISE_S: f32 = 0.25;
const FULL_S: f32 = 1.2;
/// Time of each of what must fire nothing.
const CALM_S: f32 = 45.0;
const CALM: [&str; 5] = ["speak", "blink", "look", "turn", "rest"];
/// Nothing is acted at first.
const START_S: f32 = 6.0;

/// What each gesture is made of, by the head's expressions.
fn made_of(gesture: &str) -> &'static [&'static str] {
    match gesture {
        "smile" => &["mouthSmile_L", "mouthSmile_R"],
        "brows" => &[
            "browInnerUp_L",
            "browInnerUp_R",
            "browOuterUp_L",
            "browOuterUp_R",
        ],
        "mouth_open" => &["jawOpen"],
        "wink_left" => &["eyeBlink_L"],
        "wink_right" => &["eyeBlink_R"],
        "blink_long" => &["eyeBlink_L", "eyeBlink_R"],
        "look_left" => &["eyeLookOut_L", "eyeLookIn_R"],
        "look_right" => &["eyeLookOut_R", "eyeLookIn_L"],
        "look_up" => &["eyeLookUp_L", "eyeLookUp_R"],
        "kiss" => &["mouthPucker"],
        _ => &[],
    }
}

fn smooth(from: f32, to: f32, t: f32) -> f32 {
    let f = ((t - from) / (to - from)).clamp(0.0, 1.0);
    f * f * (3.0 - 2.0 * f)
}

/// Noise in 0…1 that is a new one `hz` times a second.
fn noise(seed: u64, channel: u64, hz: f32, t: f32) -> f32 {
    let at =
        |i: u64| fastrand::Rng::with_seed(seed ^ channel << 40 ^ i.wrapping_mul(0x9e37_79b9)).f32();
    let s = t * hz;
    let k = s.floor();
    let (a, b) = (at(k as u64), at(k as u64 + 1));
    a + (b - a) * smooth(0.0, 1.0, s - k)
}

/// What is acted at a time: its name, how much of it, and whether the time is over.
fn acted(t: f32) -> Option<(&'static str, f32)> {
    let acts = ACT_S * (ROUNDS * PRESETS.len()) as f32;
    let t = t - START_S;
    if t < 0.0 {
        return Some(("", 0.0));
    }
    if t < acts {
        let preset = PRESETS[(t / ACT_S) as usize % PRESETS.len()].0;
        let within = t % ACT_S - 0.5;
        let down = RISE_S + FULL_S;
        let height = smooth(0.0, RISE_S, within) * (1.0 - smooth(down, down + RISE_S, within));
        return Some((preset, height));
    }
    CALM.get(((t - acts) / CALM_S) as usize)
        .map(|calm| (*calm, 1.0))
}

/// Pose and expressions of a person at a time.
fn play(seed: u64, t: f32, what: &str, height: f32, mut set: impl FnMut(&str, f32)) -> Rigid {
    made_of(what).iter().for_each(|name| set(name, height));
    if what == "speak" {
        // With pauses for breath.
        let loud = smooth(0.3, 0.4, noise(seed, 9, 0.4, t));
        let open = (1.6 * noise(seed, 1, 7.0, t) - 0.3).clamp(0.0, 1.0);
        set("jawOpen", 0.4 * loud * open);
        set("mouthFunnel", 0.5 * loud * noise(seed, 2, 4.3, t));
        set(
            "mouthPucker",
            0.5 * loud * (2.0 * noise(seed, 3, 3.7, t) - 1.0).max(0.0),
        );
        for side in ["_L", "_R"] {
            set(&format!("mouthLowerDown{side}"), 0.4 * loud * open);
            set(
                &format!("mouthStretch{side}"),
                0.3 * loud * noise(seed, 4, 4.0, t),
            );
            set(
                &format!("browOuterUp{side}"),
                0.4 * noise(seed, 5, 0.7, t).powi(3),
            );
        }
    }
    if what == "look" {
        // Glances of a second or less, as far as eyes go without the head.
        let [left, up] = [(6, 0.5), (7, 0.35)].map(|(channel, far)| {
            let glance = (t * 1.2).floor() / 1.2;
            far * (2.0 * noise(seed, channel, 1.2, glance) - 1.0)
        });
        set("eyeLookOut_L", left);
        set("eyeLookIn_R", left);
        set("eyeLookOut_R", -left);
        set("eyeLookIn_L", -left);
        for side in ["_L", "_R"] {
            set(&format!("eyeLookUp{side}"), up);
            set(&format!("eyeLookDown{side}"), -up);
        }
    }
    // Eyes blink always but when they act: every three seconds, or every one.
    let eyes =
        ["wink_left", "wink_right", "blink_long"].contains(&what) || what.starts_with("look_");
    let every = if what == "blink" { 1.1 } else { 3.1 };
    if !eyes {
        let blink = t % every - 0.3;
        let shut = smooth(0.0, 0.08, blink) * (1.0 - smooth(0.13, 0.28, blink));
        set("eyeBlink_L", shut);
        set("eyeBlink_R", shut);
    }
    let (far, hz) = if what == "turn" {
        ([40.0, 20.0], 0.5)
    } else {
        ([7.0, 5.0], 0.3)
    };
    let angle = |channel, far: f32| far.to_radians() * (2.0 * noise(seed, channel, hz, t) - 1.0);
    let turn = rotation_from_yaw_pitch_roll(angle(20, far[0]), angle(21, far[1]), angle(22, 5.0));
    let sway = |channel, m: f32| m * (2.0 * noise(seed, channel, 0.2, t) - 1.0);
    let place = [
        sway(23, 0.02),
        -0.02 + sway(24, 0.01),
        0.75 + sway(25, 0.05),
    ];
    Rigid::from_parts(place.into(), turn)
}

/// While the head is still, eyes of people the models have never seen turn: each look is read in its own direction, roughly as
/// far as it is acted, and at less than half of that in the other three.
#[test]
fn eyes_that_turn_are_read_where_they_look() {
    let Some(data) = common::data::only([Set::FacesFrl189, Set::IctFacekit]) else {
        return;
    };
    let heads = textured_heads(
        data.path(),
        |person| Split::from_index(person) == Split::Test,
        2,
    )
    .unwrap();
    let model = FaceModel::shipped();
    const LOOKS: [(&str, [&str; 2]); 4] = [
        ("AU61", ["eyeLookOut_L", "eyeLookIn_R"]),
        ("AU62", ["eyeLookOut_R", "eyeLookIn_L"]),
        ("AU63", ["eyeLookUp_L", "eyeLookUp_R"]),
        ("AU64", ["eyeLookDown_L", "eyeLookDown_R"]),
    ];
    const HEIGHT: f32 = 0.5;
    let mut frame = Frame::default();
    for (number, mut head) in heads.into_iter().enumerate() {
        mien_baking::heads::eyes::paint(&mut head.asset, 30 + number as u64);
        let expressions = head.asset.expressions.iter().map(|e| e.name.clone());
        let expressions: Vec<String> = expressions.collect();
        let mut simulator = Simulator::new(head.asset, Scene::Still, 5);
        let mut pipeline = Pipeline::new(&Settings::default(), simulator.camera(), &model).unwrap();
        let names = pipeline.unit_names();
        let columns = LOOKS.map(|(unit, _)| names.iter().position(|n| *n == unit).expect(unit));
        let mut read = [[0.0_f32; 4]; 4];
        // Six seconds ahead, then two of each look with one ahead between.
        for index in 0..18 * 30_u64 {
            let t = index as f32 / 30.0 - 6.0;
            let acted = (t >= 0.0 && t % 3.0 < 2.0).then_some((t / 3.0) as usize);
            let mut weights = vec![0.0; expressions.len()];
            for (weight, name) in weights.iter_mut().zip(&expressions) {
                let acts = acted.is_some_and(|k| LOOKS[k].1.contains(&name.as_str()));
                *weight = if acts { HEIGHT } else { 0.0 };
            }
            let pose = Rigid::from_parts([0.0, -0.02, 0.7].into(), Rotation::identity());
            let at = Timestamp::from_us(index * 100_000 / 3);
            simulator.draw_pose(&pose, &weights, at, &mut frame);
            (frame.index, frame.at) = (index, at);
            pipeline.follow(&frame);
            if let (Some(k), true) = (acted, t % 3.0 > 1.0) {
                let report = pipeline.report();
                for (sum, &column) in read[k].iter_mut().zip(&columns) {
                    *sum += report.weights[column] / 30.0;
                }
            }
        }
        for (k, row) in read.iter().enumerate() {
            let said = format!("person {number}, {}: {row:.2?}", LOOKS[k].0);
            assert!(row[k] > 0.5 * HEIGHT && row[k] < 1.6 * HEIGHT, "{said}");
            for (other, value) in row.iter().enumerate() {
                assert!(other == k || *value < 0.5 * HEIGHT, "{said}");
            }
        }
    }
}

#[test]
#[ignore = "takes minutes; tests/gestures/run plays it"]
fn people_act_gestures() {
    let data = common::data::only([Set::FacesFrl189, Set::IctFacekit]).expect("the data sets");
    let out = std::env::var("MIEN_GESTURES").expect("a folder for the tables");
    let tunes = std::env::var("SPLIT").is_ok_and(|split| split == "dev");
    let split = if tunes { Split::Dev } else { Split::Test };
    let model = FaceModel::shipped();
    let heads =
        textured_heads(data.path(), |person| Split::from_index(person) == split, 6).unwrap();
    let all: Vec<Gesture> = PRESETS
        .iter()
        .map(|preset| Gesture::named(preset.0))
        .collect();
    let names: Vec<&str> = PRESETS.iter().map(|preset| preset.0).collect();
    let mut frame = Frame::default();
    for (number, mut head) in heads.into_iter().enumerate() {
        let seed = 77 + number as u64;
        // Irises in a photograph are partly hidden by its lids.
        mien_baking::heads::eyes::paint(&mut head.asset, seed);
        let expressions: Vec<String> = head
            .asset
            .expressions
            .iter()
            .map(|e| e.name.clone())
            .collect();
        let light = Light {
            ambient: 0.55 + 0.05 * number as f32,
            ..Light::default()
        };
        let mut simulator = Simulator::new(head.asset, Scene::Still, seed).with_light(light, 0.9);
        let mut pipeline = Pipeline::new(&Settings::default(), simulator.camera(), &model).unwrap();
        let mut gestures = Gestures::new(&all, &pipeline.unit_names());
        let file =
            |end: &str| std::fs::File::create(format!("{out}/person{}{end}", number + 1)).unwrap();
        let table = std::io::BufWriter::new(file(".csv"));
        let mut csv = Csv::new(
            table,
            &Pipeline::measure_names(),
            &pipeline.unit_names(),
            &names,
        )
        .unwrap();
        let mut truth = std::io::BufWriter::new(file("-acted.csv"));
        writeln!(truth, "frame,acted,height").unwrap();
        for index in 0_u64.. {
            let t = index as f32 / 30.0;
            let Some((what, height)) = acted(t) else {
                break;
            };
            let mut weights = vec![0.0_f32; expressions.len()];
            let pose = play(seed, t, what, height, |name, weight| {
                if let Some(at) = expressions.iter().position(|expression| expression == name) {
                    weights[at] = weights[at].max(weight);
                }
            });
            let at = Timestamp::from_us(index * 100_000 / 3);
            simulator.draw_pose(&pose, &weights, at, &mut frame);
            (frame.index, frame.at) = (index, at);
            pipeline.follow(&frame);
            let mut reports = pipeline.reports();
            gestures.observe(&mut reports);
            let shown: Option<&Report<'_>> = reports.iter().find(|report| !report.other_is_shown);
            csv.send(shown.expect("somebody or nobody")).unwrap();
            writeln!(truth, "{index},{what},{height:.3}").unwrap();
        }
    }
}
