//! Sessions of people the face model has never seen: selection, light, and comparison with the truth.

use std::fmt::{self, Display};
use std::path::Path;

use nalgebra::{Quaternion, UnitQuaternion, Vector4};
use rayon::prelude::*;

use crate::train::evaluate::{differences, mean_percent};
use mien_appliance::pipeline::{Pipeline, PipelineError};
use mien_appliance::settings::Settings;
use mien_baking::heads::ict::Delta;
use mien_baking::heads::reshape::reshape;
use mien_baking::heads::{PersonHead, textured_heads};
use mien_simulator::virtual_head::{Light, Points, Truth};
use mien_stages::base::defaults;
use mien_stages::base::geometry::{Rigid, Vector};
use mien_stages::camera::Camera;
use mien_stages::face_model::FaceModel;
use mien_workbench::fault::Fault;
use mien_workbench::people_split::Split;
use mien_workbench::progress::Progress;

defaults! {
    /// Extent of an evaluation.
    pub struct Sessions {
        /// Most held-out people.
        pub people: usize = usize::MAX,
        /// Length of each session, seconds.
        pub seconds: f64 = 45.0,
        /// Split of the people.
        pub split: Split = Split::Test,
        /// Seed of movements, lights and noise.
        pub seed: u64 = 77,
    }
}

/// Mean and 95th percentile.
#[derive(Clone, Copy, Debug, Default)]
pub struct Spread {
    /// Mean.
    pub mean: f64,
    /// 95th percentile.
    pub p95: f64,
}

impl Spread {
    /// From values; NaN without any.
    pub fn from_values(mut values: Vec<f64>) -> Self {
        values.sort_by(f64::total_cmp);
        let p95 = values.get(values.len().saturating_sub(1) * 95 / 100);
        Self {
            mean: mean(&values),
            p95: p95.copied().unwrap_or(f64::NAN),
        }
    }
}

impl Display for Spread {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let precision = f.precision().unwrap_or(2);
        write!(f, "{:.precision$} / {:.precision$}", self.mean, self.p95)
    }
}

/// An evaluation: data sets, model, settings and extent.
#[derive(Clone, Copy)]
pub struct Trial<'a> {
    /// Folder of the data sets.
    pub data: &'a Path,
    /// The face model.
    pub model: &'a FaceModel,
    /// Settings of the pipeline.
    pub settings: &'a Settings,
    /// People and length of the sessions.
    pub sessions: &'a Sessions,
    /// Shapes of heads that people get in turn; none = their own.
    pub shapes: &'a [Delta],
}

impl Trial<'_> {
    /// The people of the split, at most as many as configured.
    pub(super) fn held_out(&self) -> Result<Vec<PersonHead>, Fault> {
        self.heads(|split| split == self.sessions.split, 1)
    }

    /// The people of the splits that `keep` accepts, at most as many as configured; each `every`th has another shape, if there are
    /// any.
    pub(crate) fn heads(
        &self,
        keep: impl Fn(Split) -> bool,
        every: usize,
    ) -> Result<Vec<PersonHead>, Fault> {
        let keep = |person| keep(Split::from_index(person));
        let mut heads = textured_heads(self.data, keep, self.sessions.people)?;
        reshape(&mut heads, self.shapes, every, self.data)?;
        match heads.is_empty() {
            true => Err(Fault::new(format!(
                "no held-out people in {}; expected annotated portraits in faces_frl189",
                self.data.display()
            ))),
            false => Ok(heads),
        }
    }

    /// The pipeline for a camera.
    pub(crate) fn pipeline(&self, camera: &Camera) -> Result<Pipeline, PipelineError> {
        Pipeline::new(&self.settings.stages, camera, self.model)
    }

    /// Plays a session with each person, on all threads: `play` gets the person's index, the head and the frame
    /// numbers; `what` labels the progress.
    pub(super) fn each<T: Send, E: Into<Fault>>(
        &self,
        what: &str,
        play: impl Fn(usize, PersonHead, &mut dyn Iterator<Item = usize>) -> Result<T, E> + Sync,
    ) -> Result<Vec<T>, Fault> {
        let heads = self.held_out()?;
        let seconds = self.sessions.seconds;
        let progress = Progress::new(what, heads.len() * seconds as usize);
        let heads = heads.into_par_iter().enumerate();
        let one = |(place, head)| {
            let numbers = 0..(seconds * 30.0) as usize;
            // One step of progress a second.
            let each_second = |number: &usize| {
                if number % 30 == 29 {
                    progress.step();
                }
            };
            play(place, head, &mut numbers.inspect(each_second)).map_err(Into::into)
        };
        heads.map(one).collect()
    }
}

/// Seed of one person's session, derived from the common one.
pub(crate) fn person_seed(seed: u64, person: usize) -> u64 {
    seed ^ (person as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15)
}

/// A random light, and the camera's exposure.
pub(crate) fn lighting(random: &mut fastrand::Rng) -> (Light, f32) {
    let towards = Vector::new(random.f32() * 1.6 - 0.8, -random.f32() * 0.8, -1.0).normalize();
    let light = Light {
        towards,
        ambient: 0.45 + 0.4 * random.f32(),
        ..Light::default()
    };
    (light, 0.6 + 0.6 * random.f32())
}

pub(super) fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// The median, of an even number the upper one; NaN without any.
pub(crate) fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(f64::NAN)
}

/// Mean distance of all points, and without the jaw, percent of the outer-eye distance.
pub(super) fn landmark_error(found: &Points, truth: &Truth) -> [f64; 2] {
    let d = differences(found, &truth.landmarks_px);
    [&d[..], &d[17..]].map(|some| mean_percent(some).into())
}

/// Rotation (degrees) and translation (mm) errors of pairs (found, true), less an offset.
pub(super) fn pose_errors(seen: &[(Rigid, Rigid)], offset: &Rigid) -> Vec<[f64; 2]> {
    let offset = offset.inverse();
    let errors = seen.iter().map(|(truth, found)| {
        let error = truth.inverse() * found * offset;
        let shift = f64::from(error.translation.vector.norm()) * 1e3;
        [f64::from(error.rotation.angle()).to_degrees(), shift]
    });
    errors.collect()
}

/// Mean of `true⁻¹ · found` over pairs, a person's offset.
pub(super) fn mean_offset(seen: &[(Rigid, Rigid)]) -> Rigid {
    let (mut rotation, mut translation) = (Vector4::zeros(), Vector::zeros());
    for (truth, found) in seen {
        let offset = truth.inverse() * found;
        let q = offset.rotation.coords;
        rotation += if q.w < 0.0 { -q } else { q };
        translation += offset.translation.vector;
    }
    if seen.is_empty() {
        return Rigid::identity();
    }
    let rotation = UnitQuaternion::from_quaternion(Quaternion::from(rotation));
    Rigid::from_parts((translation / seen.len() as f32).into(), rotation)
}
