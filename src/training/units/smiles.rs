//! Effect of real smiles on all inputs of the readings: smiling portraits against neutral ones of the same person,
//! both fitted.
//!
//! A modelled smile lifts the corners of the mouth and does little else; real smiles are wider and lift them less.
//! Uses people of the training split; eye distances. Smiling portraits have no annotated points, so their fit starts
//! in the neutral portrait's box, and again at its own result. Cheeks, which require depth, stay unchanged.

use std::collections::BTreeMap;
use std::path::Path;

use mien_stages::base::capacity::{INPUTS, LANDMARKS, LEARNT_MEASURES};
use mien_stages::base::geometry::Point;
use mien_stages::expression::{Measure, features, measures};
use mien_stages::face_model::FaceModel;
use mien_stages::face_model::refinement::PUFFS;
use mien_workbench::dataset::{Entry, read_folder};
use mien_workbench::fault::Fault;
use mien_workbench::people_split::Split;
use mien_workbench::still::{FaceBox, StillFitter};

/// Least confidence of a usable fit.
const LEAST_CONFIDENCE: f32 = 0.5;

/// All inputs of the readings, computed as [`mien_stages::expression`] does.
fn inputs(head: &[Point; LANDMARKS]) -> [f64; INPUTS] {
    let raw = measures::with_cheeks(head, [0.0; PUFFS]);
    let w = raw[Measure::EyeDistance as usize];
    let scaled = measures::scaled(&raw, w);
    core::array::from_fn(|input| match input.checked_sub(LEARNT_MEASURES) {
        None => scaled[input].into(),
        Some(k) => features::ALL
            .get(k)
            .map_or(0.0, |length| f64::from(length.raw(head) / w)),
    })
}

/// Deviations of each person's smile from their neutral face.
///
/// # Errors
/// If the portraits cannot be read.
pub(super) fn departures(portraits: &Path, model: &FaceModel) -> Result<Vec<[f64; INPUTS]>, Fault> {
    let entries = read_folder(portraits)?;
    let persons: Vec<_> = entries.iter().map(|e| (&*e.set, &*e.person)).collect();
    let mut pairs: BTreeMap<&str, [Option<&Entry>; 2]> = BTreeMap::new();
    for (entry, split) in entries.iter().zip(Split::from_persons(&persons)) {
        let mut kinds = ["neutral", "smile"].iter();
        let which = kinds.position(|e| *e == entry.expression);
        if let (Some(which), true) = (which, split != Split::Test) {
            pairs.entry(&entry.person).or_default()[which] = Some(entry);
        }
    }
    let mut fitter = StillFitter::new(model);
    let mut smiles = Vec::new();
    for pair in pairs.into_values() {
        let [Some(neutral), Some(smile)] = pair else {
            continue;
        };
        let Some(points) = &neutral.points else {
            continue;
        };
        let at_rest = fitter.fit_file(&neutral.path, &FaceBox::around(points), 0.0)?;
        let near = fitter.fit_file(&smile.path, &FaceBox::around(points), 0.0)?;
        let smiling = fitter.fit_file(&smile.path, &FaceBox::around(&near.points), 0.0)?;
        if at_rest.confidence.min(smiling.confidence) < LEAST_CONFIDENCE {
            continue;
        }
        let (before, after) = (inputs(&at_rest.head), inputs(&smiling.head));
        smiles.push(core::array::from_fn(|i| after[i] - before[i]));
    }
    Ok(smiles)
}
