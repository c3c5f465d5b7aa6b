//! A hand that is laid over the mouth of somebody who acts: what is said of the mouth meanwhile, against the truth.
//!
//! Errors are mean absolute ones over the mouth's units, from the frame in which the hand touches the face to the one in which it leaves.
//! Holding is what was last reported while the hand was still below the chin.

use super::cast::Cast;
use crate::evaluate::acted::Acted;
use crate::frame_time::frame_time;
use mien_appliance::pipeline::PipelineError;
use mien_sensors::Frame;
use mien_simulator::virtual_head::{Held, Look, Scene, Simulator};
use mien_stages::expression::units::Units;

/// Way of the hand from its place, up to which it covers the mouth, and beyond which the face is free, metres.
const COVERS_M: f32 = 0.02;
const FREE_M: f32 = 0.16;
/// Seconds before what is measured, in which ranges are learnt.
const LEARNS_S: f32 = 10.0;

/// Sums of one person's film.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Errors {
    /// Frames times units.
    count: f64,
    /// As reported, held, and at rest.
    sums: [f64; 3],
    /// The same in frames in which some other unit is acted by half or more.
    others: [f64; 3],
    /// Covered frames, and those with a report.
    frames: [usize; 2],
    /// Frames in which the mouth is free: as reported.
    free: [f64; 2],
}

/// One person's film.
pub(super) fn play(cast: &Cast<'_>, k: usize) -> Result<Errors, PipelineError> {
    let look = Look {
        seed: cast.trial.sessions.seed ^ k as u64,
        held: Held::Mouth,
        ..Look::demonstration()
    };
    let seed = cast.trial.sessions.seed ^ (k as u64 + 1) << 8;
    let mut simulator = Simulator::new(cast.asset(k), Scene::Acted, seed).dressed([look]);
    let mut pipeline = cast.trial.pipeline(simulator.camera())?;
    let acted = Acted::new(simulator.asset());
    let units = Units::shipped();
    let of_mouth = units.of_mouth();
    let names = units.columns(false);
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
        let unit = |k: usize| acted.truth_of(names[k].as_str(), &truth);
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

/// What is said of all films.
pub(super) fn figure(films: &[Errors]) -> String {
    let sum = |of: &dyn Fn(&Errors) -> f64| films.iter().map(of).sum::<f64>();
    let count = sum(&|film| film.count);
    let [reported, held, rest] = [0, 1, 2].map(|k| sum(&|film| film.sums[k]));
    let share = |film: &Errors| film.sums[0] / film.sums[1];
    let better = films.iter().filter(|film| share(film) < 1.0).count();
    let worst = films.iter().map(share).fold(0.0, f64::max);
    let [others, others_held] = [0, 1].map(|k| sum(&|film| film.others[k]));
    let free = sum(&|film| film.free[0]) / sum(&|film| film.free[1]);
    let [frames, seen] = [0, 1].map(|k| films.iter().map(|film| film.frames[k]).sum::<usize>());
    format!(
        "{:.3}, held {:.3}, at rest {:.3} (free: {free:.3}): {:.2} of holding, {:.2} while brows, lids or nose act; better for {better} of {} people, at worst {worst:.2}; {seen} of {frames} frames",
        reported / count,
        held / count,
        rest / count,
        reported / held,
        others / others_held,
        films.len(),
    )
}
