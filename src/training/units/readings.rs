//! `mien-studio units`: learns how each unit is read from all measures together, on tracked faces with known
//! expressions.
//!
//! People of the training split act random mixtures (`Scene::Mixed`) in front of the simulated sensor, some of them
//! with hair and accessories, through the whole pipeline. Every frame with a confident face and a learned rest gives
//! an example, the deviations of all inputs and the true units ([`crate::evaluate::acted`]), and its mirror image
//! another; real smiles ([`super::smiles`]) are added. Ridge regression on rises and falls gives the shares. A unit
//! is read from inputs of its own part of the face ([`uses_input`]): correlations with others do not transfer from
//! renderings. A reading is scaled, by [`MAX_SCALE`] at most, so that the median full expression reads as [`FULL`],
//! as poorly visible units regress to small readings. Last, cross-talk is removed (`chosen.toml`). Seeded; eye
//! distances.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::Path;
use std::sync::LazyLock;

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::examples::{self, Example, Glance, gaze_reader, written};
use super::gaze;
use crate::evaluate::acted::{Acted, UNIT_COUNT, UNITS};
use crate::evaluate::sessions::{Trial, lighting, median, person_seed};
use crate::frame_time::frame_time;
use mien_baking::bake::names::swapped;
use mien_baking::heads::PersonHead;
use mien_sensors::Frame;
use mien_simulator::virtual_head::{Appearance, Scene, Sensor, Simulator};
use mien_stages::base::capacity::{FEATURES, INPUTS, LEARNT_MEASURES, LENGTHS};
use mien_stages::expression::readings::input_name;
use mien_stages::expression::{Units, features};
use mien_stages::users::TrackingState;
use mien_workbench::atomic_write;
use mien_workbench::correlation::correlation;
use mien_workbench::fault::Fault;
use mien_workbench::people_split::Split;
use mien_workbench::progress::Progress;

/// Seconds after which the rest is learnt.
const SETTLED_S: f64 = 6.0;
/// Frames per example, as neighbours are redundant.
const FRAMES_PER_EXAMPLE: usize = 2;
/// One person in this many wears hair and accessories, which take four times as long to render.
const DRESSED: usize = 5;
/// One person in this many has the photograph's eyes, others synthetic ones.
const PHOTOGRAPHED: usize = 4;
/// Ridge penalty, in examples, on inputs scaled to their deviation.
const PENALTY: f64 = 1000.0;
/// Weight of real smiles relative to all acted examples.
const SMILES: f64 = 0.03;
/// Target value of real smiles: most are slight.
const SMILE: f64 = 0.8;
/// Units that real smiles raise.
const SMILERS: [&str; 2] = ["AU12L", "AU12R"];
/// Units that real smiles do not move; their effect on others differs from person to person.
const NOT_SMILING: [&str; 5] = ["AU20", "AU18", "AU29", "AU9L", "AU9R"];
/// Target reading of the median full expression.
const FULL: f64 = 0.95;
/// Largest factor that scales a reading to [`FULL`].
const MAX_SCALE: f64 = 2.0;
/// Largest factor that scales a reading of lids that open wide, which hardly move.
const MAX_LID_SCALE: f64 = 2.4;
/// Least correlation of a unit without a measure of its own for being emitted: AU6 and AU14 have .38 on heads of every age, the
/// units that are left out .26 at most.
const LEAST_R: f64 = 0.35;

/// Manually chosen numbers, from `chosen.toml`.
#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Chosen {
    pub(super) errors: BTreeMap<String, f64>,
    pub(super) cross_talk: BTreeMap<String, CrossTalk>,
}

#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CrossTalk {
    factor: f64,
    /// What a side loses of the other side's reading, relative to its own, and gains beforehand, so that a symmetric act reads the
    /// same.
    #[serde(default)]
    other_side: f64,
    pub(super) loses: BTreeMap<String, f64>,
}

pub(super) static CHOSEN: LazyLock<Chosen> =
    LazyLock::new(|| toml::from_str(include_str!("chosen.toml")).expect("a test reads it"));

/// True weight from which an expression is full.
const FULL_TRUTH: f64 = 0.8;

/// Plays, learns and returns the text of the `[[feature]]` and `[[reading]]` tables for `config/units.toml`; acted
/// examples are saved to the file `kept`, or read from it if it exists.
///
/// # Errors
/// If the data sets cannot be read or the model does not fit the settings.
pub fn learn(
    trial: &Trial,
    kept: Option<&Path>,
    say: &mut dyn FnMut(&str),
) -> Result<String, Fault> {
    let heads = trial.heads(|split| split != Split::Test, 2)?;
    let priors = feature_priors(&heads);
    let mut examples = examples(trial, heads, kept)?;
    let gaze = gaze::learn(&mut examples);
    say(&gaze.say);
    let smiles = super::smiles::departures(&trial.data.join("faces_frl189"), trial.model)?;
    let (acted, smiling) = (examples.len(), smiles.len());
    say(&format!("{acted} examples, {smiling} real smiles"));
    let mirrored: Vec<Example> = examples.iter().map(Example::mirrored).collect();
    examples.extend(mirrored);
    let smiles = smiles.into_iter().flat_map(|departures| {
        let smile = Example {
            departures,
            truth: [0.0; UNIT_COUNT],
            glance: None,
        };
        [smile.mirrored(), smile]
    });
    let smiles: Vec<Example> = smiles.collect();
    let mut text = priors;
    let learnt = (0..UNIT_COUNT).into_par_iter();
    let learnt: Vec<_> = learnt.map(|k| regress(&examples, &smiles, k)).collect();
    let measured = Units::shipped().by_measure().columns(false);
    for ((unit, _), (shares, r, line)) in UNITS.iter().zip(learnt) {
        let weak = r < LEAST_R && !measured.iter().any(|name| name == unit);
        let left_out = if weak { ", left out" } else { "" };
        say(&format!("{unit:6} r {r:.3}, {line}{left_out}"));
        if !weak {
            write_reading(&mut text, unit, &shares);
        }
    }
    text.push_str(&gaze.text);
    Ok(text)
}

/// Examples of all people, from the file if they were saved.
fn examples(
    trial: &Trial,
    heads: Vec<PersonHead>,
    kept: Option<&Path>,
) -> Result<Vec<Example>, Fault> {
    if let Some(path) = kept.filter(|path| path.is_file()) {
        let text = std::fs::read_to_string(path).map_err(unusable(path))?;
        let examples = examples::read(&text);
        if examples.is_empty() {
            let found = "expected lines written by --examples, found none; give another file";
            return Err(Fault::within(path)(found));
        }
        return Ok(examples);
    }
    let play = |(number, head)| practise(trial, number, head);
    let played = Progress::each("units", heads.into_iter().enumerate().collect(), play);
    let examples = played.into_iter().collect::<Result<Vec<_>, _>>()?.concat();
    if let Some(path) = kept {
        atomic_write::write(path, written(&examples)).map_err(unusable(path))?;
    }
    Ok(examples)
}

fn unusable(path: &Path) -> impl Fn(std::io::Error) -> Fault {
    let advice = "; give another file with --examples";
    Fault::cannot("read or write", path, advice)
}

fn practise(trial: &Trial, number: usize, mut head: PersonHead) -> Result<Vec<Example>, Fault> {
    let seed = person_seed(trial.sessions.seed, head.person);
    let (light, exposure) = lighting(&mut fastrand::Rng::with_seed(seed));
    if number % PHOTOGRAPHED != 1 {
        mien_baking::heads::eyes::paint(&mut head.asset, seed);
    }
    let acted = Acted::new(&head.asset);
    let mut simulator = Simulator::new(head.asset, Scene::Mixed, seed).with_light(light, exposure);
    if number % DRESSED == 1 {
        simulator = simulator
            .dressed([Appearance::numbered(number, seed)])
            .with_sensor(Sensor {
                faults: 1.0,
                ..Sensor::default()
            });
    }
    let look = gaze_reader(simulator.asset());
    let mut pipeline = trial.pipeline(simulator.camera())?;
    let mut frame = Frame::default();
    let mut examples = Vec::new();
    for index in 0..(trial.sessions.seconds * 30.0) as usize {
        let shown = simulator.draw(frame_time(index), &mut frame);
        pipeline.follow(&frame);
        let state = pipeline.report().state;
        let followed = matches!(state, TrackingState::Warming | TrackingState::Tracking);
        let (Some(shown), true) = (shown, followed) else {
            continue;
        };
        if (index as f64) < SETTLED_S * 30.0 || index % FRAMES_PER_EXAMPLE != 0 {
            continue;
        }
        let Some(&departures) = pipeline.expression(0).deviations() else {
            continue;
        };
        let report = pipeline.report();
        let eyes = report.landmarks.and_then(|face| face.eyes);
        examples.push(Example {
            departures,
            glance: Glance::from_frame(number, eyes, report.sensor_from_face, look(&shown)),
            truth: core::array::from_fn(|k| acted.true_weight(UNITS[k].0, &shown).unwrap_or(0.0)),
        });
    }
    Ok(examples)
}

/// Prefixes of inputs of the brows.
const BROWS: [&str; 2] = ["brow_", "inner_brow_"];
/// Prefixes of inputs of the outer brows.
const OUTER_BROWS: [&str; 1] = ["outer_brow_"];
/// Prefixes of inputs of the lids.
const LIDS: [&str; 4] = ["lid_", "upper_lid_", "lower_lid_", "gaze_"];
/// Prefixes of inputs of nose and upper lip, which brows and lids move as well.
const NOSE_AND_LIP: [&str; 4] = ["nostril_", "nose_width", "upper_lip_L", "upper_lip_R"];

/// Whether a unit is read from an input, by part of the face. A brow's lowering is read from measures alone, a
/// wrinkled nose from brows too, and a wide eye from lids and gaze alone, as lids follow the gaze.
fn uses_input(unit: &str, input: usize) -> bool {
    let name = input_name(input);
    let is = |names: &[&str]| names.iter().any(|start| name.starts_with(start));
    let (outer_brows, lids) = (is(&OUTER_BROWS), is(&LIDS));
    let brows_and_lids = is(&BROWS) || outer_brows || lids;
    let upper = brows_and_lids || is(&NOSE_AND_LIP);
    match stem(unit) {
        "AU4" => upper && input < LEARNT_MEASURES,
        "AU5" => lids,
        "AU1" | "AU2" | "AU7" | "AU43" => upper,
        "AU6" => true,
        "AU9" => !lids && !outer_brows,
        _ => !brows_and_lids,
    }
}

/// Shares of one unit by input and side, their correlation with the truth, and a report.
fn regress(
    examples: &[Example],
    smiles: &[Example],
    unit: usize,
) -> ([[f64; 2]; INPUTS], f64, String) {
    let side = |d: f64, s: usize| if s == 0 { d.max(0.0) } else { d.min(0.0) };
    let inputs = (0..INPUTS).filter(|&i| uses_input(UNITS[unit].0, i));
    let kept: Vec<(usize, usize)> = inputs.flat_map(|i| [(i, 0), (i, 1)]).collect();
    let scale = |&(i, s): &(usize, usize)| {
        let squares = examples.iter().map(|e| side(e.departures[i], s).powi(2));
        let mean = squares.sum::<f64>() / examples.len() as f64;
        mean.sqrt().max(1e-4)
    };
    let scales: Vec<f64> = kept.iter().map(scale).collect();
    let n = kept.len();
    let mut gram = DMatrix::from_diagonal_element(n, n, PENALTY);
    if let Some(error) = CHOSEN.errors.get(stem(UNITS[unit].0)) {
        // Errors are on either side of rest.
        let squares = 0.5 * examples.len() as f64 * error.powi(2);
        for (k, scale) in scales.iter().enumerate() {
            gram[(k, k)] += squares / scale.powi(2);
        }
    }
    let mut right = DVector::zeros(n);
    let mut row = vec![0.0; n];
    let (name, _) = UNITS[unit];
    let smiled = if SMILERS.contains(&name) { SMILE } else { 0.0 };
    let is_judged = smiled > 0.0 || NOT_SMILING.contains(&name);
    let weight = SMILES * examples.len() as f64 / smiles.len().max(1) as f64;
    let practised = examples.iter().map(|e| (e, 1.0, e.truth[unit]));
    let real = smiles.iter().filter(|_| is_judged);
    for (e, weight, truth) in practised.chain(real.map(|e| (e, weight, smiled))) {
        for ((x, &(i, s)), scale) in row.iter_mut().zip(&kept).zip(&scales) {
            *x = side(e.departures[i], s) / scale;
        }
        for a in (0..n).filter(|&a| row[a] != 0.0) {
            right[a] += weight * row[a] * truth;
            for b in 0..=a {
                gram[(a, b)] += weight * row[a] * row[b];
            }
        }
    }
    let mut shares = [[0.0; 2]; INPUTS];
    if let Some(solution) = nalgebra::linalg::Cholesky::new(gram).map(|c| c.solve(&right)) {
        for ((&(i, s), value), scale) in kept.iter().zip(solution.iter()).zip(&scales) {
            shares[i][s] = value / scale;
        }
    }
    let line = stretch(&mut shares, examples, unit);
    let pair = |e: &Example| [read(e, &shares).max(0.0), e.truth[unit]];
    (shares, correlation(examples.iter().map(pair)), line)
}

/// Reading of an example by these shares.
fn read(e: &Example, shares: &[[f64; 2]; INPUTS]) -> f64 {
    let sum = shares.iter().zip(&e.departures);
    sum.map(|(s, &d)| s[usize::from(d <= 0.0)] * d).sum()
}

/// Scales a reading until the median full expression reads as [`FULL`], within bounds; returns a report.
fn stretch(shares: &mut [[f64; 2]; INPUTS], examples: &[Example], unit: usize) -> String {
    let full = examples.iter().filter(|e| e.truth[unit] > FULL_TRUTH);
    let full: Vec<f64> = full.map(|e| read(e, shares)).collect();
    let middle = if full.is_empty() { FULL } else { median(&full) };
    let is_lid = UNITS[unit].0.starts_with("AU5");
    let most = if is_lid { MAX_LID_SCALE } else { MAX_SCALE };
    let stretch = (FULL / middle.max(1e-3)).clamp(1.0, most);
    for share in shares.iter_mut().flatten() {
        *share *= stretch;
    }
    format!("full {middle:.2}, stretched by {stretch:.2}")
}

/// Rest, its deviation and span of every feature over these people's neutral heads and single expressions.
fn feature_priors(heads: &[PersonHead]) -> String {
    let mut rests = vec![Vec::new(); LENGTHS];
    let mut spans = [0.0f64; LENGTHS];
    for head in heads {
        let asset = &head.asset;
        let lengths = |acted: Option<usize>| -> Vec<f64> {
            let points = asset.acting(acted, 1.0);
            let w = nalgebra::distance(&points[39], &points[42]);
            let all = features::ALL.iter();
            all.map(|f| f64::from(f.raw(&points) / w)).collect()
        };
        let neutral = lengths(None);
        for (rests, &rest) in rests.iter_mut().zip(&neutral) {
            rests.push(rest);
        }
        for k in 0..asset.expressions.len() {
            for ((span, full), rest) in spans.iter_mut().zip(lengths(Some(k))).zip(&neutral) {
                *span = span.max((full - rest).abs());
            }
        }
    }
    let mut text = String::new();
    for ((feature, rests), span) in features::ALL.iter().zip(&rests).zip(&spans) {
        let n = rests.len() as f64;
        let mean = rests.iter().sum::<f64>() / n;
        let sd = (rests.iter().map(|r| (r - mean).powi(2)).sum::<f64>() / n).sqrt();
        // People vary more than this head set.
        let sd = 1.2 * sd + 0.01;
        let _ = write!(
            text,
            "\n[[feature]]\nname = \"{}\"\nrest = {mean:.3}\nrest_sd = {sd:.3}\nspan = {:.3}\n",
            feature.name,
            0.5 * span
        );
    }
    // Gaze is centred and varies in every person.
    for name in features::GAZE {
        text += &format!(
            "\n[[feature]]\nname = \"{name}\"\nrest = 0.000\nrest_sd = 0.300\nspan = 0.500\n"
        );
    }
    text
}

fn write_reading(text: &mut String, unit: &str, shares: &[[f64; 2]; INPUTS]) {
    let _ = write!(text, "\n[[reading]]\nunit = \"{unit}\"\nfrom = [\n");
    let cross_talk = CHOSEN.cross_talk.get(stem(unit));
    let gained = 1.0 + other_side(unit);
    let factor = gained * cross_talk.map_or(1.0, |cross_talk| cross_talk.factor);
    for (i, share) in shares.iter().enumerate() {
        if *share != [0.0; 2] {
            let [rise, fall] = share.map(|share| share * factor);
            let _ = writeln!(text, "[\"{}\",{rise:.2},{fall:.2}],", input_name(i));
        }
    }
    for (by, share) in cross_talk.iter().flat_map(|cross_talk| &cross_talk.loses) {
        // Inputs of the same side if both have sides, else all.
        let side = &unit[stem(unit).len()..];
        let counts = |other: &&str| {
            let sided = !side.is_empty() && other.len() > by.len();
            stem(other) == *by && (!sided || other.ends_with(side))
        };
        let others: Vec<&str> = UNITS.iter().map(|unit| unit.0).filter(counts).collect();
        for other in &others {
            let _ = writeln!(
                text,
                "[\"{other}\",-{:.2},0.00],",
                share / others.len() as f64 / (1.0 + other_side(other))
            );
        }
    }
    if gained > 1.0 {
        let _ = writeln!(
            text,
            "[\"{}\",-{:.2},0.00],",
            swapped(unit),
            other_side(unit) / gained
        );
    }
    text.push_str("]\n");
}

/// [`CrossTalk::other_side`] of a unit; 0 if it has no sides.
fn other_side(unit: &str) -> f64 {
    let chosen = CHOSEN.cross_talk.get(stem(unit));
    let sided = chosen.filter(|_| stem(unit) != unit);
    sided.map_or(0.0, |one| one.other_side)
}

/// A unit without its side.
fn stem(unit: &str) -> &str {
    unit.trim_end_matches(['L', 'R'])
}

/// Measures come first among the inputs.
const _: () = assert!(INPUTS == LEARNT_MEASURES + FEATURES);
