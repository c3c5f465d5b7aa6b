//! Promise: from the simulated sensor's raw frames to weights, without calibration, the units follow what was acted.
//!
//! All stages on the shipped head; the first ten seconds are for learning, then each unit is correlated with the
//! expressions that drive it, and each measure with its true value: what a measure lacks is the landmarks' fault, what a
//! unit lacks beyond that is the learner's. `cargo test --test it reads_an_acted_face -- --nocapture` prints both. People and
//! scenes that were not used in development are the business of `mien-studio evaluate`.

use mien_appliance::pipeline::Pipeline;
use mien_appliance::settings::Settings;
use mien_sensors::Frame;
use mien_simulator::virtual_head::{HeadAsset, Scene, Simulator};
use mien_stages::base::capacity::MEASURES;
use mien_stages::base::time::Timestamp;
use mien_stages::expression::{Measure, measures};
use mien_stages::face_model::FaceModel;

/// The scene is joined ten seconds before its acts begin anew: mixed expressions to learn from, then every act once.
const FIRST: u64 = 1860;
const LEARNING: u64 = 300;
const FRAMES: u64 = 1600;

/// Unit, the expressions whose strongest it should follow, and the least r: 0.85 is asked of mouth opening, mouth width, brow
/// heights and lids (the mouth is widened by a smile, AU12), the others keep what they reach.
const FOLLOWS: [(&str, &[&str], f64); 17] = [
    ("AU26", &["jawOpen"], 0.85),
    ("AU25", &["jawOpen"], 0.7),
    ("AU20", &["mouthStretch_L", "mouthStretch_R"], 0.75),
    ("AU12L", &["mouthSmile_L"], 0.85),
    ("AU12R", &["mouthSmile_R"], 0.85),
    ("AU29", &["jawForward"], 0.6),
    ("AU34L", &["cheekPuff_L"], 0.85),
    ("AU34R", &["cheekPuff_R"], 0.85),
    ("AU18", &["mouthPucker"], 0.7),
    ("AU2L", &["browOuterUp_L", "browInnerUp_L"], 0.85),
    ("AU2R", &["browOuterUp_R", "browInnerUp_R"], 0.85),
    ("AU4L", &["browDown_L"], 0.4),
    ("AU4R", &["browDown_R"], 0.4),
    ("AU43L", &["eyeBlink_L"], 0.85),
    ("AU43R", &["eyeBlink_R"], 0.85),
    ("AU9L", &["noseSneer_L"], 0.5),
    ("AU9R", &["noseSneer_R"], 0.5),
];

/// Where the head may be against where it is: mean and 95th percentile.
const MOST_TURN_DEG: [f32; 2] = [0.65, 1.7];
const MOST_SHIFT_MM: [f32; 2] = [4.0, 4.5];

fn correlation(pairs: &[(f64, f64)]) -> f64 {
    let n = pairs.len() as f64;
    let mean = |f: fn(&(f64, f64)) -> f64| pairs.iter().map(f).sum::<f64>() / n;
    let (mx, my) = (mean(|p| p.0), mean(|p| p.1));
    let (mut xx, mut yy, mut xy) = (0.0, 0.0, 0.0);
    for (x, y) in pairs {
        xx += (x - mx) * (x - mx);
        yy += (y - my) * (y - my);
        xy += (x - mx) * (y - my);
    }
    xy / (xx * yy).sqrt().max(1e-12)
}

/// `most`: in the mean, and in nineteen of twenty frames.
fn assert_within(what: &str, unit: &str, errors: &mut [f32], most: [f32; 2]) {
    errors.sort_by(f32::total_cmp);
    let mean = errors.iter().sum::<f32>() / errors.len() as f32;
    let p95 = errors[errors.len() * 95 / 100];
    println!("{what} off by {mean:.2} {unit} in the mean, {p95:.2} in nineteen of twenty frames");
    assert!(
        mean < most[0] && p95 < most[1],
        "{what}: {mean} and {p95} {unit}"
    );
}

#[test]
fn units_follow_the_actor() {
    let mut simulator = Simulator::new(HeadAsset::shipped(), Scene::Acted, 7);
    let model = FaceModel::shipped();
    let mut pipeline = Pipeline::new(
        &Settings::default().stages,
        &mien_sensors::kinect::geometry::nominal(),
        &model,
    )
    .expect("the shipped model");
    let mut frame = Frame::default();
    let mut pairs = vec![Vec::new(); FOLLOWS.len()];
    let mut measured = vec![Vec::new(); MEASURES];
    let mut lost = 0;
    let (mut turned, mut shifted) = (Vec::new(), Vec::new());
    for n in 0..FRAMES {
        let truth = simulator
            .draw(Timestamp::from_us((FIRST + n) * 33_333), &mut frame)
            .expect("somebody acts");
        pipeline.follow(&frame);
        let report = pipeline.report();
        if !report.state.is_present() {
            lost += 1;
            continue;
        }
        if n < LEARNING {
            continue;
        }
        let head = report.sensor_from_face.expect("a face has a head");
        turned.push(
            head.rotation
                .angle_to(&truth.sensor_from_head.rotation)
                .to_degrees(),
        );
        let apart = head.translation.vector - truth.sensor_from_head.translation.vector;
        shifted.push(1e3 * apart.norm());
        let true_raw = measures::raw(&truth.landmarks_head);
        let w = true_raw[Measure::EyeDistance as usize];
        let true_measures = measures::scaled(&true_raw, w);
        for (k, pairs) in measured.iter_mut().enumerate() {
            pairs.push((f64::from(true_measures[k]), f64::from(report.measures[k])));
        }
        let asset = simulator.asset();
        for ((unit, follows, _), pairs) in FOLLOWS.iter().zip(&mut pairs) {
            let column = pipeline
                .unit_names()
                .iter()
                .position(|name| name == unit)
                .expect("a unit of the table");
            let acted = follows
                .iter()
                .filter_map(|name| truth.activations.get(asset.expression(name)?))
                .fold(0.0f32, |a, &b| a.max(b));
            pairs.push((f64::from(acted), f64::from(report.weights[column])));
        }
    }
    println!("{lost} of {FRAMES} frames without a face");
    for (measure, pairs) in Measure::ALL.iter().zip(&measured) {
        let r = correlation(pairs);
        println!("m_{:15} r {r:.3} with its true value", measure.name());
    }
    for (what, unit, errors, most) in [
        ("turn", "degrees", &mut turned, MOST_TURN_DEG),
        ("place", "mm", &mut shifted, MOST_SHIFT_MM),
    ] {
        assert_within(what, unit, errors, most);
    }
    let mut low = Vec::new();
    for ((unit, follows, least), pairs) in FOLLOWS.iter().zip(&pairs) {
        let r = correlation(pairs);
        println!("{unit:6} r {r:.3} with {}", follows.join(", "));
        if r < *least {
            low.push((unit, r));
        }
    }
    assert!(low.is_empty(), "too low: {low:?}");
    assert!(lost * 50 <= FRAMES, "{lost} frames without a face");
}
