//! People of the simulator set up every default gesture by making it five times, then act all at full and at 60 %, speak, blink, look
//! about, turn and rest, or play everyday life: the tables that `tests/gestures/run` and `tests/gestures/hours` judge. Also checks that gaze is read correctly.

use std::io::Write;
use std::path::Path;

use mien_appliance::pipeline::{Pipeline, Settings};
use mien_baking::heads::{PersonHead, textured_heads};
use mien_outputs::csv::Csv;
use mien_outputs::gesture::{Gesture, Gestures, PRESETS, SetUpState};
use mien_outputs::{Command, Output, Report};
use mien_sensors::Frame;
use mien_simulator::virtual_head::{Light, Scene, Simulator};
use mien_stages::base::capacity::{HEIGHT, WIDTH};
use mien_stages::base::geometry::{Rigid, Rotation, rotation_from_yaw_pitch_roll};
use mien_stages::base::time::Timestamp;
use mien_stages::face_model::FaceModel;
use mien_workbench::people_split::Split;
use rayon::prelude::*;

use crate::common;
use crate::common::data::Set;

/// Rounds of all gestures at each strength, the time of one, and its rise, fall and length at full, seconds.
const ROUNDS: usize = 3;
const ACT_S: f32 = 3.0;
/// Strengths of the rounds that are judged, as shares of full.
const STRENGTHS: [(&str, f32); 2] = [("full", 1.0), ("weak", 0.6)];
/// Before them, each gesture is set up: the person rests, then makes it five times at full, seconds.
const SET_UP_REST_S: f32 = 4.0;
const SET_UP_S: f32 = SET_UP_REST_S + 5.0 * ACT_S;
const RISE_S: f32 = 0.25;
const FULL_S: f32 = 1.2;
/// Time of each of what must fire nothing.
const CALM_S: f32 = 45.0;
const CALM: [&str; 5] = ["speak", "blink", "look", "turn", "rest"];
/// Activities of a person who makes no deliberate gesture, repeated in this order: name and duration in seconds. Laughing, yawning and
/// dozing contain the expressions of gestures, but unintentionally.
const LIFE: [(&str, f32); 12] = [
    ("rest", 40.0),
    ("speak", 90.0),
    ("look", 30.0),
    ("chew", 40.0),
    ("laugh", 4.0),
    ("turn", 30.0),
    ("speak", 60.0),
    ("yawn", 5.0),
    ("rest", 40.0),
    ("blink", 20.0),
    ("doze", 7.0),
    ("speak", 60.0),
];
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

/// Strength of an act `within` seconds after its time began.
fn height(within: f32) -> f32 {
    let (t, down) = (within - 0.5, RISE_S + FULL_S);
    smooth(0.0, RISE_S, t) * (1.0 - smooth(down, down + RISE_S, t))
}

/// What is acted at a time: the part of the play, its name, how much of it, and whether the time is over.
fn acted(t: f32) -> Option<(&'static str, &'static str, f32)> {
    let preset = |index: f32| PRESETS[index as usize % PRESETS.len()].0;
    let t = t - START_S;
    if t < 0.0 {
        return Some(("start", "", 0.0));
    }
    let set_ups = SET_UP_S * PRESETS.len() as f32;
    if t < set_ups {
        let within = t % SET_UP_S - SET_UP_REST_S;
        let now = if within < 0.0 {
            0.0
        } else {
            height(within % ACT_S)
        };
        return Some(("set up", preset(t / SET_UP_S), now));
    }
    let (t, round) = (t - set_ups, ACT_S * (ROUNDS * PRESETS.len()) as f32);
    if let Some((part, strength)) = STRENGTHS.get((t / round) as usize) {
        return Some((part, preset(t / ACT_S), strength * height(t % ACT_S)));
    }
    CALM.get(((t - STRENGTHS.len() as f32 * round) / CALM_S) as usize)
        .map(|calm| ("calm", *calm, 1.0))
}

/// Activity at a time of everyday life, and its strength, 0…1.
fn lived(t: f32) -> (&'static str, f32) {
    let mut within = (t - START_S).max(0.0) % LIFE.iter().map(|(_, s)| s).sum::<f32>();
    for (what, s) in LIFE {
        if within < s {
            return (
                what,
                smooth(0.0, 0.4 * s, within) * (1.0 - smooth(0.8 * s, s, within)),
            );
        }
        within -= s;
    }
    ("rest", 0.0)
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
    let wave = |hz: f32| 0.5 - 0.5 * (t * hz * core::f32::consts::TAU).cos();
    let parts: &[(&str, f32)] = match what {
        // Lips stay closed.
        "chew" => {
            let open = 0.3 * wave(1.4) * noise(seed, 8, 0.5, t);
            &[
                ("jawOpen", open),
                ("mouthClose", open),
                ("mouthPress_L", 0.3),
                ("mouthPress_R", 0.3),
            ]
        }
        "laugh" => &[
            ("jawOpen", height * (0.15 + 0.3 * wave(4.5))),
            ("mouthSmile_L", 0.9 * height),
            ("mouthSmile_R", 0.9 * height),
            ("cheekSquint_L", 0.6 * height),
            ("cheekSquint_R", 0.6 * height),
            ("eyeSquint_L", 0.5 * height),
            ("eyeSquint_R", 0.5 * height),
        ],
        "yawn" => &[
            ("jawOpen", 0.9 * height),
            ("browInnerUp_L", 0.3 * height),
            ("browInnerUp_R", 0.3 * height),
            ("eyeBlink_L", 0.6 * height),
            ("eyeBlink_R", 0.6 * height),
        ],
        "doze" => &[("eyeBlink_L", 0.95 * height), ("eyeBlink_R", 0.95 * height)],
        _ => &[],
    };
    parts.iter().for_each(|(name, weight)| set(name, *weight));
    // Eyes blink always but when they act: every three seconds, or every one.
    let eyes = ["wink_left", "wink_right", "blink_long", "doze"].contains(&what)
        || what.starts_with("look_");
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
    // With MINUTES, all people play everyday life, MINUTES in total; otherwise PEOPLE people, by default six, act every gesture.
    let minutes = std::env::var("MINUTES").map(|text| text.parse::<f32>().expect("minutes"));
    let people =
        std::env::var("PEOPLE").map_or(6, |text| text.parse().expect("a number of people"));
    let people = if minutes.is_ok() { usize::MAX } else { people };
    let keep = |person| Split::from_index(person) == split;
    let heads = textured_heads(data.path(), keep, people).unwrap();
    let lives_s = minutes
        .ok()
        .map(|minutes| 60.0 * minutes / heads.len() as f32);
    let heads = heads.into_par_iter().enumerate();
    heads.for_each(|(number, head)| act(head, number, lives_s, Path::new(&out)));
}

/// Writes one person's tables of gestures and acted expressions; in everyday life (`lives_s`: duration in seconds) also an image of each
/// activation.
fn act(mut head: PersonHead, number: usize, lives_s: Option<f32>, out: &Path) {
    let seed = 77 + number as u64;
    // Irises in a photograph are partly hidden by its lids.
    mien_baking::heads::eyes::paint(&mut head.asset, seed);
    let expressions = head.asset.expressions.iter().map(|e| e.name.clone());
    let expressions: Vec<String> = expressions.collect();
    let light = Light {
        ambient: 0.55 + 0.05 * (number % 6) as f32,
        ..Light::default()
    };
    let mut simulator = Simulator::new(head.asset, Scene::Still, seed).with_light(light, 0.9);
    let (settings, model) = (Settings::default(), FaceModel::shipped());
    let mut pipeline = Pipeline::new(&settings, simulator.camera(), &model).unwrap();
    let names = PRESETS.map(|preset| preset.0);
    let new = || Gestures::new(&names.map(Gesture::named), &pipeline.unit_names());
    // As configured, and set up for the person.
    let [mut gestures, mut taught] = [new(), new()];
    let mut states = [SetUpState::None; PRESETS.len()];
    let person = number + 1;
    let file = |end: &str| {
        let file = std::fs::File::create(out.join(format!("person{person}{end}")));
        std::io::BufWriter::new(file.unwrap())
    };
    let (measures, units) = (Pipeline::measure_names(), pipeline.unit_names());
    let mut csv = Csv::new(file(".csv"), &measures, &units, &names).unwrap();
    let mut truth = file("-acted.csv");
    writeln!(truth, "frame,part,acted,height,g_{}", names.join(",g_")).unwrap();
    let (mut frame, mut on, mut taught_last) = (Frame::default(), 0, None);
    for index in 0_u64.. {
        let t = index as f32 / 30.0;
        let now = match lives_s {
            Some(seconds) => (t < seconds).then(|| {
                let (what, height) = lived(t + 61.0 * number as f32);
                ("life", what, height)
            }),
            None => acted(t),
        };
        let Some((part, what, height)) = now else {
            break;
        };
        let acts = names.iter().position(|name| *name == what);
        if let Some(index) = acts.filter(|_| part == "set up" && taught_last != acts) {
            taught.execute(Command::Teach(index, true));
        }
        taught_last = acts.filter(|_| part == "set up");
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
        let shown = shown.expect("somebody or nobody");
        csv.send(shown).unwrap();
        let shown_gestures = shown.gestures;
        taught.observe(&mut reports);
        taught.for_each_switch(|_| ());
        taught.for_each_set_up(|one| states[one.facts.index] = one.facts.state);
        let theirs = reports.iter().find(|report| !report.other_is_shown);
        let theirs = theirs.map_or(0, |report| report.gestures);
        write!(truth, "{index},{part},{what},{height:.3}").unwrap();
        (0..names.len()).for_each(|bit| write!(truth, ",{}", theirs >> bit & 1).unwrap());
        writeln!(truth).unwrap();
        let new = shown_gestures & !std::mem::replace(&mut on, shown_gestures);
        for (bit, name) in names.iter().enumerate() {
            if lives_s.is_some() && new >> bit & 1 == 1 {
                let picture = format!("person{person}-{index}-{name}-{what}.png");
                let size = (WIDTH as u32, HEIGHT as u32);
                let grey = image::GrayImage::from_raw(size.0, size.1, frame.luma.to_vec());
                grey.unwrap().save(out.join(picture)).unwrap();
            }
        }
    }
    let mut levels = file("-levels.csv");
    writeln!(levels, "gesture,state,on,off,hold_s").unwrap();
    for (index, name) in names.iter().enumerate() {
        let (now, state) = (taught.levels(index), states[index].name());
        let row = format!("{name},{state},{},{},{}", now.on, now.off, now.hold_s);
        writeln!(levels, "{row}").unwrap();
    }
}
