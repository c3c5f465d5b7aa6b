//! The eyes in one frame, kept as an example to learn a gaze from.

use serde::{Deserialize, Serialize};

use crate::base::geometry::{Rigid, Vector};
use crate::expression::gaze;
use crate::landmarks::eyes::{CELLS, Eyes};
use crate::simulator::virtual_head::{HeadAsset, Truth};

/// The eyes in one frame.
#[derive(Clone, Serialize, Deserialize)]
pub(super) struct Glance {
    who: usize,
    /// To the left and up.
    pub(super) looks: [f64; 2],
    /// The head's turn.
    ahead: [f32; 2],
    right: Vec<f32>,
    left: Vec<f32>,
}

impl Glance {
    /// A person's eyes at a pose, looking so far to the left and up; `None` without either.
    pub(super) fn at(
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
        [&self.right, &self.left]
            .iter()
            .all(|eye| eye.len() == CELLS)
    }

    /// Regression row and target for gaze across (0) or up (1), or for the lids (2, target `lifted`); `at` is the example's index.
    pub(super) fn seen(&self, at: usize, axis: usize, lifted: f64) -> Seen {
        let [right, left] = [&self.right, &self.left].map(|eye| core::array::from_fn(|k| eye[k]));
        Seen {
            at,
            who: self.who,
            row: gaze::row(&[right, left], self.ahead, axis)
                .map(f64::from)
                .to_vec(),
            looks: self.looks.get(axis).copied().unwrap_or(lifted),
        }
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
