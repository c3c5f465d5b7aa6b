//! Promise: from the simulated sensor's raw frames to weights, without calibration, the units follow what was acted.
//!
//! All stages in turn on the acted scene; the first ten seconds are for learning, then each unit is correlated with the
//! expressions that drive it, and each measure with its true value: what a measure lacks is the landmarks' fault, what a
//! unit lacks beyond that is the learner's. `cargo test --test reads_an_acted_face -- --ignored --nocapture` prints both.

use mien::capacity::MEASURES;
use mien::expression::{Expression, Measure, Units, measures};
use mien::face_model::FaceModel;
use mien::geometry::{Point, Vector};
use mien::landmarks::LandmarkFitter;
use mien::pose::PoseTracker;
use mien::segment::Segmenter;
use mien::sensor::Frame;
use mien::sensor::virtual_head::{HeadAsset, Scene, Simulator};
use mien::time::Timestamp;

const FRAMES: u64 = 1500;
const LEARNING: u64 = 300;

/// Unit, the expressions whose strongest it should follow, and the least r.
const FOLLOWS: [(&str, &[&str], f64); 12] = [
    ("AU26", &["jawOpen"], 0.85),
    ("AU25", &["jawOpen"], 0.0),
    (
        "AU20",
        &[
            "mouthSmile_L",
            "mouthSmile_R",
            "mouthStretch_L",
            "mouthStretch_R",
        ],
        0.85,
    ),
    ("AU18", &["mouthPucker"], 0.0),
    ("AU2L", &["browOuterUp_L", "browInnerUp_L"], 0.85),
    ("AU2R", &["browOuterUp_R", "browInnerUp_R"], 0.85),
    ("AU4L", &["browDown_L"], 0.0),
    ("AU4R", &["browDown_R"], 0.0),
    ("AU43L", &["eyeBlink_L"], 0.85),
    ("AU43R", &["eyeBlink_R"], 0.85),
    ("AU9L", &["noseSneer_L"], 0.0),
    ("AU9R", &["noseSneer_R"], 0.0),
];

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

#[test]
#[ignore = "draws and fits 1500 frames; ask for it with --ignored after every new face model"]
fn units_follow_the_actor() {
    let mut simulator = Simulator::new(HeadAsset::shipped(), Scene::Acted, 7);
    let model = FaceModel::shipped();
    let head: Vec<(Point, Vector)> = model
        .standard_head
        .points
        .iter()
        .copied()
        .zip(model.standard_head.normals.iter().copied())
        .collect();
    let mut segmenter = Segmenter::new(mien::segment::Settings::default());
    let mut tracker =
        PoseTracker::new(mien::pose::Settings::default(), &head).expect("the shipped head");
    let mut fitter = LandmarkFitter::new(mien::landmarks::Settings::default(), &model);
    let mut expression = Expression::new(mien::expression::Settings::default(), Units::shipped());
    let mut frame = Frame::default();
    let camera = mien::sensor::camera::Camera::nominal();
    let mut pairs = vec![Vec::new(); FOLLOWS.len()];
    let mut lost = 0;
    let mut measured = vec![Vec::new(); MEASURES];
    for n in 0..FRAMES {
        let truth = simulator
            .draw(Timestamp::from_us(n * 33_333), &mut frame)
            .expect("somebody acts");
        let pose = segmenter
            .segment(&frame, &camera)
            .and_then(|cloud| tracker.track(cloud, frame.at));
        let landmarks =
            pose.and_then(|pose| Some((pose, fitter.fit(&frame.luma, &camera, &pose, frame.at)?)));
        let Some((pose, landmarks)) = landmarks else {
            lost += 1;
            continue;
        };
        let weights = expression
            .observe(landmarks, &pose.sensor_from_head, frame.at)
            .units()
            .to_vec();
        if n < LEARNING {
            continue;
        }
        let true_raw = measures::raw(&truth.landmarks_head);
        let w = true_raw[Measure::EyeDistance as usize];
        let true_measures = measures::scaled(&true_raw, w);
        for (k, pairs) in measured.iter_mut().enumerate() {
            let found = expression.weights().measures[k];
            pairs.push((f64::from(true_measures[k]), f64::from(found)));
        }
        for ((unit, follows, _), pairs) in FOLLOWS.iter().zip(&mut pairs) {
            let column = expression
                .unit_names()
                .iter()
                .position(|name| name == unit)
                .expect("a unit of the table");
            let asset = simulator.asset();
            let acted = follows
                .iter()
                .filter_map(|name| truth.activations.get(asset.expression(name)?))
                .fold(0.0f32, |a, &b| a.max(b));
            pairs.push((f64::from(acted), f64::from(weights[column])));
        }
    }
    println!(
        "{lost} of {FRAMES} frames without a face; {} changes of person",
        expression.resets()
    );
    for (measure, pairs) in Measure::ALL.iter().zip(&measured) {
        let r = correlation(pairs);
        println!("m_{:15} r {r:.3} with its true value", measure.name());
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
}
