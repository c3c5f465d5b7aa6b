//! Training examples: deviations of all inputs in one frame and the true units; saved as JSON, and mirrored.

use super::glance::Glance;
use crate::base::capacity::INPUTS;
use crate::expression::readings::{input_name, input_named};
use crate::studio::bake::names::swapped;
use crate::studio::evaluate::acted::{COUNT, UNITS};

/// Departures of all inputs, truth of all units in the order of [`UNITS`], and what the eyes show.
#[derive(Clone)]
pub(super) struct Example {
    pub(super) departures: [f64; INPUTS],
    pub(super) truth: [f64; COUNT],
    pub(super) glance: Option<Glance>,
}

/// One line of JSON for each example: departures, truths, eyes.
pub(super) fn written(examples: &[Example]) -> String {
    let line = |e: &Example| serde_json::to_string(&(&e.departures[..], &e.truth[..], &e.glance));
    let lines: Vec<String> = examples.iter().filter_map(|e| line(e).ok()).collect();
    lines.join("\n")
}

/// What [`written`] wrote; lines that do not parse or are of another length are left out.
pub(super) fn read(text: &str) -> Vec<Example> {
    let example = |line: &str| {
        let (departures, truth, glance): (Vec<f64>, Vec<f64>, Option<Glance>) =
            serde_json::from_str(line).ok()?;
        if !glance.as_ref().is_none_or(Glance::is_whole) {
            return None;
        }
        Some(Example {
            departures: departures.try_into().ok()?,
            truth: truth.try_into().ok()?,
            glance,
        })
    };
    text.lines().filter_map(example).collect()
}

/// Inputs that change their sign in a mirror.
const LATERAL: [&str; 3] = ["lip_shift", "upper_lip_shift", "gaze_left"];

impl Example {
    pub(super) fn mirrored(&self) -> Self {
        let unit = |name: &str| UNITS.iter().position(|(unit, _)| *unit == name);
        Self {
            departures: core::array::from_fn(|i| {
                let name = input_name(i);
                let sign = if LATERAL.contains(&name) { -1.0 } else { 1.0 };
                sign * self.departures[input_named(&swapped(name)).unwrap_or(i)]
            }),
            glance: None,
            truth: core::array::from_fn(|k| self.truth[unit(&swapped(UNITS[k].0)).unwrap_or(k)]),
        }
    }
}
