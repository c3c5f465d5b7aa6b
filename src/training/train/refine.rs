//! Learns the depth correction of a fit ([`Refinement`]): tracked sessions of rendered training people, regressed on
//! their truth.
//!
//! Each person plays the scene `mixed` (random expressions, so that no order of acts is learnt) under a light of
//! their own through segmentation, pose and landmarks. The residual of the fitted shape is regressed on depth and
//! fit, both relative to the person's means, as constant differences do not transfer between people and expression is
//! a change. Method: ridge regression by the normal equations. Memory: 0.5 kB a frame. Degenerate: `None` without a
//! tracked frame.

use std::path::Path;

use nalgebra::{DMatrix, DVector};

use super::shape::{Face, aligned};
use crate::evaluate::sessions::{lighting, person_seed};
use mien_appliance::settings::Settings;
use mien_baking::heads::ict::Delta;
use mien_baking::heads::reshape::reshape;
use mien_baking::heads::{PersonHead, textured_heads};
use mien_sensors::Frame;
use mien_sensors::kinect::picture_clock::{FRAME_TICKS, timestamp_from_ticks};
use mien_simulator::virtual_head::{HeadAsset, Scene, Simulator, Truth};
use mien_stages::face_model::FaceModel;
use mien_stages::face_model::refinement::{Inputs, PUFFS, Refinement};
use mien_stages::landmarks::{LandmarkFitter, Scratch};
use mien_stages::pose::PoseTracker;
use mien_stages::segment::Segmenter;
use mien_workbench::fault::Fault;
use mien_workbench::progress::Progress;

/// Time between used frames: every second, as neighbours are redundant.
const STEP_TICKS: i64 = 2 * FRAME_TICKS;
/// Used frames a second.
const FRAMES_PER_S: f64 = 15.0;
/// Initial frames of a person that are skipped, while means are still being estimated.
const SETTLE_FRAMES: i64 = 30;
/// People to train on.
pub const PEOPLE: usize = 40;
/// Length of each session, seconds.
const SECONDS: f64 = 30.0;
/// Penalty of the regression, as a share of the number of frames.
const PENALTY: f64 = 0.01;

/// One frame, relative to the person's means: inputs, and residuals of shape and cheeks.
struct Example {
    inputs: Inputs,
    lacks: Vec<f32>,
}

/// One person's examples, and the subtracted means of their inputs.
#[derive(Default)]
struct Session {
    means: Vec<f32>,
    examples: Vec<Example>,
}

/// Trains on the people that `keep` accepts, every second with one of the `shapes`, with a seed of movements, lights and noise.
///
/// # Errors
/// If the data sets cannot be read or the model does not fit the default settings.
pub fn learn_refinement(
    data: &Path,
    model: &FaceModel,
    keep: impl Fn(usize) -> bool,
    people: usize,
    shapes: &[Delta],
    seed: u64,
) -> Result<Option<Refinement>, Fault> {
    let mut heads = textured_heads(data, keep, people)?;
    reshape(&mut heads, shapes, 2, data)?;
    let plain = FaceModel {
        refinement: None,
        ..model.clone()
    };
    let session = |head: PersonHead| practise(head.asset, &plain, person_seed(seed, head.person));
    let sessions = Progress::each("train: depth", heads, session);
    Ok(regressed(sessions, model.shape.modes.len()))
}

fn practise(asset: HeadAsset, model: &FaceModel, seed: u64) -> Session {
    let (light, exposure) = lighting(&mut fastrand::Rng::with_seed(seed));
    let cheeks = ["cheekPuff_R", "cheekPuff_L"].map(|name| asset.expression(name));
    let mut simulator = Simulator::new(asset, Scene::Mixed, seed).with_light(light, exposure);
    let camera = simulator.camera().clone();
    let settings = Settings::default();
    let mut segmenter = Segmenter::new(settings.stages.segment);
    let Ok(mut pose) = PoseTracker::new(settings.stages.pose, &model.standard_head) else {
        return Session::default();
    };
    let mut fitter = LandmarkFitter::new(settings.stages.landmarks.cascade, model);
    let mut scratch = Scratch::default();
    let mean: Face = std::array::from_fn(|i| model.shape.mean[i]);
    let mut frame = Frame::default();
    let mut examples = Vec::new();
    for index in 0..(SECONDS * FRAMES_PER_S) as i64 {
        let at = timestamp_from_ticks(index * STEP_TICKS);
        let truth = simulator.draw(at, &mut frame);
        let cloud = segmenter.segment(&frame, &camera);
        let Some(head) = cloud.and_then(|cloud| pose.track(cloud, at)) else {
            continue;
        };
        let (luma, depth) = (&frame.luma, &frame.depth);
        let fit = fitter.fit(
            &mut scratch,
            luma,
            depth,
            &camera,
            &head,
            &mut pose.face,
            at,
        );
        let teaches = fit.is_some() && index >= SETTLE_FRAMES;
        if let Some(truth) = truth.filter(|_| teaches) {
            let inputs = fitter.refinement_inputs();
            examples.push(example(model, &mean, &truth, inputs, &cheeks));
        }
    }
    let means = centred(&mut examples);
    Session { means, examples }
}

fn example(
    model: &FaceModel,
    mean: &Face,
    truth: &Truth,
    inputs: &Inputs,
    cheeks: &[Option<usize>; PUFFS],
) -> Example {
    let mut shape = vec![0.0; model.shape.modes.len()];
    let face = aligned(&truth.landmarks_head, mean);
    model.shape.coefficients(&face, &mut shape);
    for (b, fitted) in shape.iter_mut().zip(inputs) {
        *b -= fitted;
    }
    let blown = |k: &Option<usize>| k.and_then(|k| truth.activations.get(k)).map_or(0.0, |w| *w);
    shape.extend(cheeks.iter().map(blown));
    Example {
        inputs: inputs.clone(),
        lacks: shape,
    }
}

/// Subtracts the means over the frames from a person's examples and returns those of the inputs; missing inputs
/// become 0.
fn centred(examples: &mut [Example]) -> Vec<f32> {
    let Some(first) = examples.first() else {
        return Vec::new();
    };
    let mut means = vec![f32::NAN; first.inputs.len()];
    for i in 0..first.inputs.len() {
        let (sum, count) = sum_of_finite(examples.iter().map(|e| e.inputs[i]));
        let mean = sum / count;
        means[i] = mean;
        for e in &mut *examples {
            let x = e.inputs[i] - mean;
            e.inputs[i] = if x.is_finite() { x } else { 0.0 };
        }
    }
    for i in 0..examples[0].lacks.len() {
        let mean = examples.iter().map(|e| e.lacks[i]).sum::<f32>() / examples.len() as f32;
        examples.iter_mut().for_each(|e| e.lacks[i] -= mean);
    }
    means
}

/// Sum and count of the finite numbers.
fn sum_of_finite(numbers: impl Iterator<Item = f32>) -> (f32, f32) {
    let finite = numbers.filter(|x| x.is_finite());
    finite.fold((0.0, 0.0), |(sum, count), x| (sum + x, count + 1.0))
}

fn regressed(sessions: Vec<Session>, modes: usize) -> Option<Refinement> {
    let first = sessions.iter().find_map(|s| s.examples.first())?;
    let inputs = first.inputs.len();
    // Over people, not frames: longer tracked people are no more typical.
    let mean = |i: usize| {
        let of_people = sessions.iter().filter_map(|s| s.means.get(i).copied());
        let (sum, count) = sum_of_finite(of_people);
        sum / count.max(1.0)
    };
    let mean = (0..inputs).map(mean).collect();
    let examples: Vec<Example> = sessions.into_iter().flat_map(|s| s.examples).collect();
    let frames = examples.len() as f64;
    let deviation = |i: usize| {
        let squares = examples.iter().map(|e| f64::from(e.inputs[i]).powi(2));
        (squares.sum::<f64>() / frames).sqrt().max(1e-6)
    };
    let deviation: Vec<f64> = (0..inputs).map(deviation).collect();
    let mut scatter = DMatrix::zeros(inputs, inputs);
    let mut shared = DMatrix::zeros(inputs, modes + PUFFS);
    for e in &examples {
        let x = DVector::from_fn(inputs, |i, _| f64::from(e.inputs[i]) / deviation[i]);
        let y = DVector::from_fn(modes + PUFFS, |k, _| f64::from(e.lacks[k]));
        scatter.syger(1.0, &x, &x, 1.0);
        shared.ger(1.0, &x, &y, 1.0);
    }
    scatter.fill_upper_triangle_with_lower_triangle();
    for i in 0..inputs {
        scatter[(i, i)] += PENALTY * frames;
    }
    let solved = scatter.cholesky()?.solve(&shared);
    Some(Refinement {
        mean,
        deviation: deviation.iter().map(|d| *d as f32).collect(),
        weights: solved.as_slice().iter().map(|w| *w as f32).collect(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_planted_map_is_learnt_whatever_is_constant_of_a_person() {
        const MODES: usize = 2;
        let mut random = fastrand::Rng::with_seed(5);
        let mut sessions = Vec::new();
        for _ in 0..6 {
            let own: Vec<f32> = (0..8).map(|_| 3.0 * random.f32()).collect();
            let mut examples: Vec<Example> = (0..400)
                .map(|_| {
                    let x: Vec<f32> = (0..5).map(|_| random.f32() - 0.5).collect();
                    let lacks = [0.8 * x[0] - 0.3 * x[3], 0.2 * x[1], x[4], 0.0];
                    Example {
                        inputs: x.iter().zip(&own).map(|(x, own)| x + own).collect(),
                        lacks: lacks
                            .iter()
                            .zip(&own[4..])
                            .map(|(y, own)| y + own)
                            .collect(),
                    }
                })
                .collect();
            let means = centred(&mut examples);
            sessions.push(Session { means, examples });
        }
        let map = regressed(sessions, MODES).expect("enough");
        let weight = |row: usize, input: usize| map.weights[row * 5 + input] / map.deviation[input];
        for (row, input, planted) in [
            (0, 0, 0.8),
            (0, 3, -0.3),
            (0, 1, 0.0),
            (1, 1, 0.2),
            (2, 4, 1.0),
        ] {
            let found = weight(row, input);
            assert!(
                (found - planted).abs() < 0.03,
                "{row} {input}: {found} for {planted}"
            );
        }
    }
}
