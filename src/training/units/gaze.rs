//! Learns gaze and lids from images of the eyes while people look around ([`mien_stages::expression::gaze`]).
//!
//! Ridge regression over people, on the deviations of both eyes' cells from the person's mean: horizontal gaze from the difference
//! of the mirrored eyes, vertical gaze and lids from their sum, each with the head's rotation. The readings of the expressions can
//! then account for lids that follow the gaze.

use std::fmt::Write;

use nalgebra::{DMatrix, DVector};

use super::examples::{Example, Seen};
use crate::evaluate::acted::{UNIT_COUNT, UNITS};
use mien_stages::base::capacity::{LEARNT_MEASURES, LENGTHS};
use mien_stages::expression::features;
use mien_stages::landmarks::eyes::CELLS;
use mien_workbench::correlation::correlation;

/// Ridge penalty, in examples of unit contrast: with less, rendered eyes are read better and real ones worse.
const PENALTY: f64 = 10_000.0;
/// True AU43 above which lids hide the iris.
const CLOSED: f64 = 0.3;
/// Travel of a closing lid as multiple of its rise when the eye opens wide (AU5).
const CLOSES: f64 = 2.0;

/// Results: lines for `config/units.toml`, and a report.
pub(super) struct Learnt {
    pub text: String,
    pub say: String,
}

/// Learns the maps and writes their readings into all examples with open eyes.
pub(super) fn learn(examples: &mut [Example]) -> Learnt {
    let sides = |name| (0..UNIT_COUNT).filter(move |&k| UNITS[k].0.starts_with(name));
    let truth = |e: &Example, name| sides(name).map(|k| e.truth[k]).sum::<f64>() / 2.0;
    let (mut text, mut say) = (String::from("\n[gaze]\n"), String::from("gaze:"));
    for (axis, name) in ["left", "up", "lids"].into_iter().enumerate() {
        let open = |example: &Example| sides("AU43").all(|k| example.truth[k] < CLOSED);
        let all = examples.iter().enumerate().filter(|(_, e)| open(e));
        let lifted = |e| truth(e, "AU5") - CLOSES * truth(e, "AU43");
        let all = all.filter_map(|(at, e)| Some(e.glance.as_ref()?.seen(at, axis, lifted(e))));
        let mut seen: Vec<Seen> = all.collect();
        centre(&mut seen);
        let weights = regress(&seen, axis < 2);
        let dot = |row: &[f64]| row.iter().zip(&weights).map(|(a, b)| a * b).sum();
        let read: Vec<f64> = seen.iter().map(|s| dot(&s.row)).collect();
        let r = correlation(read.iter().zip(&seen).map(|(read, s)| [*read, s.looks]));
        let _ = write!(say, " {name} r {r:.3} of {}", seen.len());
        for (seen, read) in seen.iter().zip(&read) {
            examples[seen.at].departures[LEARNT_MEASURES + LENGTHS + axis] = *read;
        }
        let _ = write!(text, "{name} = [");
        for (k, weight) in weights.iter().enumerate() {
            let break_ = if k % 16 == 0 { "\n" } else { "" };
            let _ = write!(text, "{break_}{weight:.3},");
        }
        text.push_str("\n]\n");
    }
    for (name, unit, [rise, fall]) in DIRECTIONS {
        let _ = write!(
            text,
            "\n[[reading]]\nunit = \"{unit}\"\nabsolute = true\nfrom = [[\"{name}\", {rise:.1}, {fall:.1}]]\n"
        );
    }
    Learnt { text, say }
}

/// Unit, feature and direction of each gaze unit.
const DIRECTIONS: [(&str, &str, [f64; 2]); 4] = [
    (features::GAZE[0], "AU61", [1.0, 0.0]),
    (features::GAZE[0], "AU62", [0.0, -1.0]),
    (features::GAZE[1], "AU63", [1.0, 0.0]),
    (features::GAZE[1], "AU64", [0.0, -1.0]),
];

/// Subtracts each person's mean.
fn centre(seen: &mut [Seen]) {
    let people = seen.iter().map(|s| s.who + 1).max().unwrap_or(0);
    for person in 0..people {
        let mut own: Vec<&mut Seen> = seen.iter_mut().filter(|s| s.who == person).collect();
        let share = 1.0 / own.len() as f64;
        let mut mean = vec![0.0; CELLS + 1];
        let mut looks = 0.0;
        for one in &own {
            for (mean, value) in mean.iter_mut().zip(&one.row) {
                *mean += share * value;
            }
            looks += share * one.looks;
        }
        for one in &mut own {
            for (value, mean) in one.row.iter_mut().zip(&mean) {
                *value -= mean;
            }
            one.looks -= looks;
        }
    }
}

/// Ridge regression; `whole`: rescaled so that full gaze reads as 1.
fn regress(seen: &[Seen], whole: bool) -> Vec<f64> {
    let n = CELLS + 1;
    let mut gram = DMatrix::from_diagonal_element(n, n, PENALTY);
    // The rotation is a sine, of a few tenths, and not penalised.
    gram[(CELLS, CELLS)] = 1.0;
    let mut right = DVector::zeros(n);
    for one in seen {
        let row = DVector::from_column_slice(&one.row);
        gram.ger(1.0, &row, &row, 1.0);
        right.axpy(one.looks, &row, 1.0);
    }
    let Some(solver) = nalgebra::linalg::Cholesky::new(gram) else {
        return vec![0.0; n];
    };
    let mut weights = solver.solve(&right);
    if whole {
        weights *= seen.iter().map(|s| s.looks * s.looks).sum::<f64>() / weights.dot(&right);
    }
    weights.iter().copied().collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::examples::{self, Glance};
    use mien_stages::base::capacity::INPUTS;
    use mien_stages::base::geometry::Rigid;
    use mien_stages::landmarks::eyes::Eyes;

    #[test]
    fn a_planted_map_is_learnt_over_people_who_rest_differently_and_blink() {
        let mut random = fastrand::Rng::with_seed(9);
        let mut normal = || (0..6).map(|_| random.f64() - 0.5).sum::<f64>();
        let shut = UNITS
            .iter()
            .position(|(unit, _)| *unit == "AU43L")
            .expect("a lid");
        let mut examples = Vec::new();
        for who in 0..4 {
            let constant: Vec<f64> = (0..2 * CELLS).map(|_| normal()).collect();
            for frame in 0..200 {
                let looks = [normal() * 0.4, normal() * 0.3];
                let closed = frame % 9 == 0;
                // The third cell of each eye follows the gaze; the rest is person and noise.
                let mut eyes: Eyes = [[0.0; CELLS]; 2];
                for (side, eye) in eyes.iter_mut().enumerate() {
                    let toward = if side == 0 { -looks[0] } else { looks[0] };
                    for (k, cell) in eye.iter_mut().enumerate() {
                        let told = if k == 3 {
                            toward
                        } else if k == 40 {
                            looks[1]
                        } else {
                            0.0
                        };
                        *cell = (constant[side * CELLS + k] + told + 0.05 * normal()) as f32;
                    }
                }
                let pose = Rigid::identity();
                let mut truth = [0.0; UNIT_COUNT];
                truth[shut] = if closed { 1.0 } else { 0.0 };
                let looks = if closed { [9.0, 9.0] } else { looks };
                examples.push(Example {
                    departures: [0.0; INPUTS],
                    truth,
                    glance: Glance::from_frame(who, Some(eyes), Some(&pose), looks),
                });
            }
        }
        let learnt = learn(&mut examples);
        let open = |e: &&Example| e.truth[shut] == 0.0;
        for axis in 0..2 {
            let pairs = examples.iter().filter(open).map(|e| {
                let looks = e.glance.as_ref().expect("eyes").looks[axis];
                [e.departures[LEARNT_MEASURES + LENGTHS + axis], looks]
            });
            let r = correlation(pairs);
            assert!(r > 0.9, "axis {axis}: {r}");
        }
        assert!(learnt.text.contains("unit = \"AU64\"\nabsolute = true"));
        // Saved and read again, it is the same; truncated lines are skipped.
        let text = examples::written(&examples);
        let mut again = examples::read(&text);
        assert_eq!(learn(&mut again).text, learnt.text);
        assert_eq!(
            examples::read(&text[..text.len() - 9]).len(),
            examples.len() - 1
        );
    }
}
