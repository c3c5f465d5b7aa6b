//! Priors of each measure from the ICT head: rest over random identities, and its change by each expression at full
//! weight. `config/units.toml` has the rounded numbers, with `rest_sd` widened by a fifth, at the brows to 0.08, and
//! anatomical sizes (16, 8, 6, -, 1.7 and 6 mm) over w = 37 mm for mouth_width.down, lip_shift, lip_thrust.up,
//! lip_protrusion.down, lid.up and part of brow.up.
//!
//! Identities are drawn as neutral + Σ c_n mode_n, c_n ~ N(0, 1). Units: the inner-eye-corner distance w of the
//! neutral.

use nalgebra::Vector3;

use super::readings::{CHOSEN, learn};
use crate::data::{Set, folder, only};
use crate::evaluate::acted::UNITS;
use crate::evaluate::sessions::{Sessions, Trial};
use crate::golden::{compare_with_golden, figures};
use mien_baking::heads::ict::IctHead;
use mien_simulator::virtual_head::Scene;
use mien_stages::base::capacity::{LANDMARKS, MEASURES};
use mien_stages::base::frames::SensorFromFace;
use mien_stages::base::geometry::Point;
use mien_stages::base::time::Timestamp;
use mien_stages::expression::measures::{self, Measure};
use mien_stages::expression::{Expression, Settings, Units};
use mien_stages::landmarks::Landmarks;
use mien_workbench::correlation::correlation;

#[test]
fn chosen_numbers_are_of_acted_units() {
    let units = CHOSEN.errors.keys().chain(CHOSEN.cross_talk.keys());
    let lost = CHOSEN.cross_talk.values();
    for unit in units.chain(lost.flat_map(|one| one.loses.keys())) {
        let is_acted = UNITS
            .iter()
            .any(|(name, _)| name.starts_with(unit.as_str()));
        assert!(is_acted, "{unit}");
    }
}

/// Mean and standard deviation over people.
#[derive(Clone, Copy, Debug, Default)]
struct Spread {
    /// Mean.
    mean: f64,
    /// Standard deviation.
    sd: f64,
}

/// Mean and deviation of an iterator.
fn spread(values: impl Iterator<Item = f64> + Clone) -> Spread {
    let n = values.clone().count().max(1) as f64;
    let mean = values.clone().sum::<f64>() / n;
    let sd = (values.map(|v| (v - mean).powi(2)).sum::<f64>() / n).sqrt();
    Spread { mean, sd }
}

/// Rest of every measure, and its change by every expression (in the head's order), over random people.
struct Priors {
    /// Rest by measure.
    rest: [Spread; MEASURES],
    /// Change at full weight by expression, then by measure.
    change: Vec<[Spread; MEASURES]>,
}

/// Draws `people` identities from a seed.
fn priors(head: &IctHead, people: usize, seed: u64) -> Priors {
    let mut random = fastrand::Rng::with_seed(seed);
    let (mut rest, mut changes) = (Vec::new(), Vec::new());
    for _ in 0..people {
        let coefficients: Vec<f32> = head
            .identities
            .iter()
            .map(|_| normal(&mut random))
            .collect();
        let point = |l: usize, extra: Vector3<f32>| {
            let v = head.landmarks[l];
            let identity = head.identities.iter().zip(&coefficients);
            head.neutral[v] + identity.fold(extra, |sum, (mode, &c)| sum + mode.offsets[v] * c)
        };
        let neutral: [Point; LANDMARKS] = std::array::from_fn(|l| point(l, Vector3::zeros()));
        let raw = measures::raw(&neutral);
        let w = raw[Measure::EyeDistance as usize];
        let scaled = measures::scaled(&raw, w);
        let change: Vec<[f32; MEASURES]> = head
            .expressions
            .iter()
            .map(|expression| {
                let face: [Point; LANDMARKS] =
                    std::array::from_fn(|l| neutral[l] + expression.offsets[head.landmarks[l]]);
                let moved = measures::scaled(&measures::raw(&face), w);
                std::array::from_fn(|m| moved[m] - scaled[m])
            })
            .collect();
        rest.push(scaled);
        changes.push(change);
    }
    Priors {
        rest: std::array::from_fn(|m| spread(rest.iter().map(|r| f64::from(r[m])))),
        change: (0..head.expressions.len())
            .map(|e| std::array::from_fn(|m| spread(changes.iter().map(|c| f64::from(c[e][m])))))
            .collect(),
    }
}

fn head() -> Option<IctHead> {
    let folder = folder(Set::IctFacekit)?;
    Some(IctHead::read(&folder).unwrap())
}

#[test]
fn prints_the_priors() {
    let Some(head) = head() else { return };
    let priors = priors(&head, 400, 1);
    for measure in Measure::ALL {
        let m = measure as usize;
        println!(
            "{}: rest {:.3} ± {:.3}",
            measure.name(),
            priors.rest[m].mean,
            priors.rest[m].sd
        );
        for (expression, change) in head.expressions.iter().zip(&priors.change) {
            if change[m].mean.abs() > 0.02 {
                println!(
                    "    {:20} {:+.3} ± {:.3}",
                    expression.name, change[m].mean, change[m].sd
                );
            }
        }
    }
    let gap = priors.change[head.expression("jawOpen").unwrap()][Measure::LipGap as usize].mean;
    assert!(gap > 0.3, "opening the jaw opens the lips, by {gap} w");
}

/// Unit, the expressions whose strongest it should follow, and the least r. AU20 and AU18 share one measure with the
/// funnel and the rolled lips, which the head model also acts, hence their low bounds.
const FOLLOWS: [(&str, &[&str], f64); 20] = [
    ("AU26", &["jawOpen"], 0.9),
    ("AU20", &["mouthStretch_L", "mouthStretch_R"], 0.8),
    ("AU12L", &["mouthSmile_L"], 0.9),
    ("AU12R", &["mouthSmile_R"], 0.9),
    ("AU1L", &["browInnerUp_L"], 0.8),
    ("AU1R", &["browInnerUp_R"], 0.8),
    ("AU18", &["mouthPucker"], 0.7),
    ("AU30L", &["jawLeft"], 0.95),
    ("AU30R", &["jawRight"], 0.95),
    ("AU29", &["jawForward"], 0.7),
    ("AU2L", &["browOuterUp_L", "browInnerUp_L"], 0.95),
    ("AU2R", &["browOuterUp_R", "browInnerUp_R"], 0.95),
    ("AU4L", &["browDown_L"], 0.7),
    ("AU4R", &["browDown_R"], 0.7),
    ("AU43L", &["eyeBlink_L"], 0.9),
    ("AU43R", &["eyeBlink_R"], 0.9),
    ("AU5L", &["eyeWide_L"], 0.5),
    ("AU5R", &["eyeWide_R"], 0.5),
    ("AU9L", &["noseSneer_L"], 0.8),
    ("AU9R", &["noseSneer_R"], 0.8),
];
const PEOPLE: u64 = 5;
/// Standard deviation of jitter as part of the outer eye-corner distance.
const JITTER: f32 = 0.0025;
const OUTER_M: f32 = 0.098;

fn normal(random: &mut fastrand::Rng) -> f32 {
    (-2.0 * (1.0 - random.f32()).ln()).sqrt() * (std::f32::consts::TAU * random.f32()).cos()
}

/// Plays two minutes of the acted scene on a random identity, with jitter on the true landmarks; for every row of
/// [`FOLLOWS`] the pairs of truth and weight after the first 20 s.
fn play(head: &IctHead, person: u64) -> Vec<Vec<[f64; 2]>> {
    let mut random = fastrand::Rng::with_seed(40 + person);
    let c: Vec<f32> = head
        .identities
        .iter()
        .map(|_| normal(&mut random))
        .collect();
    let neutral: [Point; LANDMARKS] = std::array::from_fn(|l| {
        let v = head.landmarks[l];
        let modes = head.identities.iter().zip(&c);
        modes.fold(head.neutral[v], |p, (mode, &c)| p + mode.offsets[v] * c)
    });
    // By measures alone, as readings were learnt from other faces.
    let mut expression = Expression::new(Settings::default(), Units::shipped().by_measure());
    let mut slow = [Vector3::zeros(); LANDMARKS];
    let keep = (-1.0f32 / 30.0 / 0.25).exp();
    let mut pairs = vec![Vec::new(); FOLLOWS.len()];
    for n in 0..3600u64 {
        let mut weights = vec![0f32; head.expressions.len()];
        let pose = Scene::Acted.play(person, n as f32 / 30.0, |name, w| {
            if let Some(k) = head.expression(name) {
                weights[k] = weights[k].max(w);
            }
        });
        let pose = pose.expect("somebody acts");
        let mut points = neutral;
        for (expression, &w) in head.expressions.iter().zip(&weights) {
            for (point, &v) in points.iter_mut().zip(&head.landmarks) {
                *point += expression.offsets[v] * w;
            }
        }
        for (point, slow) in points.iter_mut().zip(&mut slow) {
            let mut draw =
                || Vector3::from_fn(|axis, _| [1.0, 1.0, 1.7][axis] * normal(&mut random));
            *slow = *slow * keep + draw() * (1.0 - keep * keep).sqrt();
            *point += (draw() * 0.6 + *slow * 0.8) * JITTER * OUTER_M;
        }
        let landmarks = Landmarks::certain(points);
        expression.observe(
            &landmarks,
            &SensorFromFace::assume_frames(pose),
            Timestamp::from_us(n * 33_333),
        );
        if n < 600 {
            continue;
        }
        for ((unit, follows, _), pairs) in FOLLOWS.iter().zip(&mut pairs) {
            let column = expression.unit_names().iter().position(|name| name == unit);
            let found = expression.weights().units()[column.expect("a unit of the table")];
            let truths = follows
                .iter()
                .filter_map(|name| Some(weights[head.expression(name)?]));
            pairs.push([truths.fold(0.0, f32::max), found].map(f64::from));
        }
    }
    assert_eq!(expression.resets(), 0, "one person stays one person");
    pairs
}

#[test]
fn the_acted_scene_is_read_right_on_people_of_the_head_model() {
    let Some(head) = head() else { return };
    let people: Vec<_> = (0..PEOPLE).map(|person| play(&head, person)).collect();
    let mut low = Vec::new();
    for (k, (unit, follows, least)) in FOLLOWS.iter().enumerate() {
        let r = people
            .iter()
            .map(|pairs| correlation(pairs[k].iter().copied()))
            .sum::<f64>()
            / PEOPLE as f64;
        println!("{unit:6} r {r:.3} with {}", follows.join(", "));
        if r < *least {
            low.push((unit, r));
        }
    }
    assert!(low.is_empty(), "too low: {low:?}");
}

/// Two people who act for some seconds give useless readings, but always the same.
#[test]
fn a_short_practice_gives_the_golden_readings() {
    let Some(data) = only([Set::IctFacekit, Set::FacesFrl189]) else {
        return;
    };
    let trial = Trial {
        shapes: &[],
        data: data.path(),
        model: &mien_stages::face_model::FaceModel::shipped(),
        settings: &mien_appliance::settings::Settings::default(),
        sessions: &Sessions {
            people: 2,
            seconds: 9.0,
            seed: 41,
            ..Sessions::default()
        },
    };
    let mut lines = Vec::new();
    let mut say = |line: &str| lines.extend(figures(line));
    let text = learn(&trial, None, &mut say).expect("data are readable");
    lines.extend(figures(&text));
    compare_with_golden("units/short", &lines);
}
