//! Training examples: deviations of all inputs in one frame, the true units and images of the eyes; saved as JSON,
//! and mirrored.

use serde::{Deserialize, Serialize};

use crate::evaluate::acted::{UNIT_COUNT, UNITS};
use mien_baking::bake::names::swapped;
use mien_simulator::virtual_head::{HeadAsset, Truth};
use mien_stages::base::capacity::INPUTS;
use mien_stages::base::geometry::{Rigid, Vector};
use mien_stages::expression::gaze;
use mien_stages::expression::readings::{input_name, input_named};
use mien_stages::landmarks::eyes::{CELLS, Eyes};

/// Deviations of all inputs, true weights in the order of [`UNITS`], and images of the eyes.
#[derive(Clone)]
pub(super) struct Example {
    pub(super) departures: [f64; INPUTS],
    pub(super) truth: [f64; UNIT_COUNT],
    pub(super) glance: Option<Glance>,
}

/// Formats examples as lines of JSON: deviations, true weights, eyes.
pub(super) fn written(examples: &[Example]) -> String {
    let line = |e: &Example| serde_json::to_string(&(&e.departures[..], &e.truth[..], &e.glance));
    let lines: Vec<String> = examples.iter().filter_map(|e| line(e).ok()).collect();
    lines.join("\n")
}

/// Parses the lines of [`written`], skipping lines that do not parse or have another length.
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

/// Inputs that change sign in the mirror image.
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

/// The eyes in one frame.
#[derive(Clone, Serialize, Deserialize)]
pub(super) struct Glance {
    who: usize,
    /// True gaze, to the left and up.
    pub(super) looks: [f64; 2],
    /// The head's rotation.
    ahead: [f32; 2],
    right: Vec<f32>,
    left: Vec<f32>,
}

impl Glance {
    /// A person's eyes at a pose, with their true gaze; `None` without eyes or pose.
    pub(super) fn from_frame(
        who: usize,
        eyes: Option<Eyes>,
        pose: Option<&Rigid>,
        looks: [f64; 2],
    ) -> Option<Self> {
        let ahead = pose?.rotation * Vector::z();
        let [right, left] = eyes?.map(Vec::from);
        Some(Self {
            who,
            looks,
            ahead: [ahead.x, ahead.y],
            right,
            left,
        })
    }

    /// Whether both eyes have all cells.
    pub(super) fn is_whole(&self) -> bool {
        self.right.len() == CELLS && self.left.len() == CELLS
    }

    /// Regression row and target for horizontal (0) or vertical (1) gaze, or for the lids (2, target `lifted`); `at`
    /// is the example's index.
    pub(super) fn seen(&self, at: usize, axis: usize, lifted: f64) -> Seen {
        let [right, left] = [&self.right, &self.left].map(|eye| core::array::from_fn(|k| eye[k]));
        let row = gaze::row(&[right, left], self.ahead, axis);
        Seen {
            at,
            who: self.who,
            row: row.map(f64::from).to_vec(),
            looks: self.looks.get(axis).copied().unwrap_or(lifted),
        }
    }
}

/// One direction of one [`Glance`].
pub(super) struct Seen {
    /// Index of the example.
    pub(super) at: usize,
    pub(super) who: usize,
    /// Cells, and the rotation of the head.
    pub(super) row: Vec<f64>,
    pub(super) looks: f64,
}

/// A function that reads the true gaze of a head.
pub(super) fn gaze_reader(asset: &HeadAsset) -> impl Fn(&Truth) -> [f64; 2] + use<> {
    let pairs = [
        ["eyeLookOut_L", "eyeLookIn_L"],
        ["eyeLookUp_L", "eyeLookDown_L"],
    ]
    .map(|pair| pair.map(|name| asset.expression(name)));
    move |shown| {
        pairs.map(|pair| {
            let [there, back] = pair.map(|at| {
                let weight = at.and_then(|k| shown.activations.get(k));
                f64::from(weight.copied().unwrap_or(0.0))
            });
            there - back
        })
    }
}
