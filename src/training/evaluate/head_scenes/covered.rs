//! A hand over the mouth of somebody who acts: weights of the mouth meanwhile, against the truth.
//!
//! Errors are mean absolute ones over the mouth's units, while the hand touches the face. "Held" repeats the last
//! report while the hand was still below the chin.

use super::cast::Cast;
use crate::evaluate::acted::Acted;
use crate::frame_time::frame_time;
use mien_appliance::pipeline::PipelineError;
use mien_sensors::Frame;
use mien_simulator::virtual_head::{Appearance, Held, Scene, Simulator};
use mien_stages::expression::regions::{MOUTH, RegionSet};
use mien_stages::expression::units::{UnitName, Units};

/// Displacement of the hand up to which it covers the mouth, metres.
const COVERS_M: f32 = 0.02;
/// Displacement of the hand from which the face is free, metres.
const FREE_M: f32 = 0.16;
/// Seconds before the measurement, in which ranges are learnt.
const LEARNS_S: f32 = 10.0;

/// Sums over one person's run.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Errors {
    /// Number of frames times units.
    count: f64,
    /// Errors as reported, held, and at rest.
    sums: [f64; 3],
    /// Errors as in [`Self::sums`], over frames in which another unit is acted by half or more.
    others: [f64; 3],
    /// Number of covered frames, and of those with a report.
    frames: [usize; 2],
    /// Error as reported, and count, over frames with a free mouth.
    free: [f64; 2],
}

/// Plays one person.
pub(super) fn play(cast: &Cast<'_>, k: usize) -> Result<Errors, PipelineError> {
    let look = Appearance {
        seed: cast.trial.sessions.seed ^ k as u64,
        held: Held::Mouth,
        ..Appearance::demonstration()
    };
    let seed = cast.trial.sessions.seed ^ (k as u64 + 1) << 8;
    let mut simulator = Simulator::new(cast.asset(k), Scene::Acted, seed).dressed([look]);
    let mut pipeline = cast.trial.pipeline(simulator.camera())?;
    let acted = Acted::new(simulator.asset());
    let units = Units::shipped();
    let names = units.columns(false);
    let moves_mouth = |unit: &UnitName| RegionSet::of_unit(unit).intersects(MOUTH);
    let of_mouth: Vec<bool> = names.iter().map(moves_mouth).collect();
    let place = |t| Held::Mouth.position_at(t);
    let home = place(3.2).map_or(0.0, |place| place.y);
    let (mut frame, mut errors) = (Frame::default(), Errors::default());
    let (mut held, mut now) = (vec![0.0f32; names.len()], vec![0.0f32; names.len()]);
    for n in 0..cast.frames {
        let t = n as f32 / 30.0;
        let Some(truth) = simulator.draw(frame_time(n), &mut frame) else {
            continue;
        };
        pipeline.follow(&frame);
        let reports = pipeline.reports();
        let report = reports.iter().find(|r| r.weights.len() == names.len());
        if let Some(report) = report {
            now.copy_from_slice(report.weights);
        }
        let away = place(t).map_or(f32::INFINITY, |place| place.y - home);
        if away > FREE_M {
            held.copy_from_slice(&now);
        }
        let unit = |k: usize| acted.true_weight(names[k].as_str(), &truth);
        if t < LEARNS_S {
            continue;
        }
        let others = (0..names.len()).filter(|&k| !of_mouth[k] && !names[k].starts_with("AU43"));
        let act = others.filter_map(unit).fold(0.0, f64::max) >= 0.5;
        if away < COVERS_M {
            errors.frames[0] += 1;
            errors.frames[1] += usize::from(report.is_some());
        }
        for k in (0..names.len()).filter(|&k| of_mouth[k]) {
            let Some(truth) = unit(k) else { continue };
            let error = |w: f32| (f64::from(w) - truth).abs();
            if away < COVERS_M {
                errors.count += 1.0;
                for (s, w) in [now[k], held[k], 0.0].into_iter().enumerate() {
                    errors.sums[s] += error(w);
                    errors.others[s] += if act { error(w) } else { 0.0 };
                }
            } else if away > FREE_M {
                errors.free[0] += error(now[k]);
                errors.free[1] += 1.0;
            }
        }
    }
    Ok(errors)
}

/// The figure over all people.
pub(super) fn figure(runs: &[Errors]) -> String {
    let sum = |of: &dyn Fn(&Errors) -> f64| runs.iter().map(of).sum::<f64>();
    let count = sum(&|run| run.count);
    let [reported, held, rest] = [0, 1, 2].map(|k| sum(&|run| run.sums[k]));
    let share = |run: &Errors| run.sums[0] / run.sums[1];
    let better = runs.iter().filter(|run| share(run) < 1.0).count();
    let worst = runs.iter().map(share).fold(0.0, f64::max);
    let [others, others_held] = [0, 1].map(|k| sum(&|run| run.others[k]));
    let free = sum(&|run| run.free[0]) / sum(&|run| run.free[1]);
    let [frames, seen] = [0, 1].map(|k| runs.iter().map(|run| run.frames[k]).sum::<usize>());
    format!(
        "{:.3}, held {:.3}, at rest {:.3} (free: {free:.3}): {:.2} of holding, {:.2} while brows, lids or nose act; better for {better} of {} people, at worst {worst:.2}; {seen} of {frames} frames",
        reported / count,
        held / count,
        rest / count,
        reported / held,
        others / others_held,
        runs.len(),
    )
}
