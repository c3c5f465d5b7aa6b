//! The eyes in one frame, kept as an example to learn a gaze from.

use std::fmt::Write;

use crate::base::geometry::{Rigid, Vector};
use crate::landmarks::eyes::{CELLS, Eyes};
use crate::simulator::virtual_head::{HeadAsset, Truth};

/// Where the numbers of a [`Glance`] are: who, where to, the head's turn, the right eye, the left.
const WHO: usize = 0;
pub(super) const LOOKS: usize = 1;
const AHEAD: usize = 3;
const EYES: usize = 5;
const NUMBERS: usize = EYES + 2 * CELLS;

/// The eyes in one frame.
#[derive(Clone)]
pub(super) struct Glance(pub(super) Vec<f32>);

impl Glance {
    /// Nothing seen.
    pub(super) const NONE: Self = Self(Vec::new());

    /// A person's eyes at a pose, looking so far to the left and up.
    pub(super) fn at(
        who: usize,
        eyes: Option<Eyes>,
        pose: Option<&Rigid>,
        looks: [f64; 2],
    ) -> Self {
        let (Some(eyes), Some(pose)) = (eyes, pose) else {
            return Self::NONE;
        };
        let ahead = pose.rotation * Vector::z();
        let mut numbers = vec![who as f32];
        numbers.extend(looks.map(|look| look as f32));
        numbers.extend([ahead.x, ahead.y]);
        numbers.extend(eyes.iter().flatten());
        Self(numbers)
    }

    pub(super) fn write(&self, text: &mut String) {
        for number in &self.0 {
            let _ = write!(text, "{number:.4} ");
        }
    }

    /// What [`Self::write`] wrote.
    pub(super) fn read(numbers: &[f64]) -> Option<Self> {
        let whole = numbers.is_empty() || numbers.len() == NUMBERS;
        whole.then(|| Self(numbers.iter().map(|&v| v as f32).collect()))
    }

    /// What tells of the direction across (0) or up (1), and that direction; `at` is the example's place.
    pub(super) fn seen(&self, at: usize, axis: usize) -> Option<Seen> {
        let who = *self.0.get(WHO)? as usize;
        let (right, left) = self.0[EYES..].split_at(CELLS);
        let sign = if axis == 0 { -1.0 } else { 1.0 };
        let cells = left.iter().zip(right).map(|(l, r)| l + sign * r);
        let turn = self.0[AHEAD + axis];
        Some(Seen {
            at,
            who,
            row: cells.chain([turn]).map(f64::from).collect(),
            looks: f64::from(self.0[LOOKS + axis]),
        })
    }
}

/// One direction of one [`Glance`].
pub(super) struct Seen {
    /// Which example.
    pub(super) at: usize,
    pub(super) who: usize,
    /// Cells, and the turn of the head.
    pub(super) row: Vec<f64>,
    pub(super) looks: f64,
}

/// Reads the true direction of a head's eyes.
pub(super) fn looks(asset: &HeadAsset) -> impl Fn(&Truth) -> [f64; 2] + use<> {
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
