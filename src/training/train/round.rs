//! A model of version 3, whose update matrices have 8 bits a weight, converted to the current format of two.
//!
//! Each stage is rounded on the features of training faces, where the rounded stages before it end; see
//! [`super::cascade::rounded`]. The stages' priors are rounded to 16 bits and the weights of the
//! confidence to 8; everything else stays the same.

use nalgebra::DMatrix;

use super::args::TrainArgs;
use super::cascade::{advance, cold_starts, feature_blocks, rounded};
use super::confidence::add_patch;
use super::paper_section::model_bytes;
use super::ridge::centred;
use super::schedule::training_starts;
use mien_stages::base::capacity::LANDMARKS;
use mien_stages::face_model::{
    CascadeStage, ConfidenceModel, FACE_INPUTS, FEATURES, FaceModel, LANDMARK_INPUTS,
    MAX_PARAMETERS, PATCH, Short, VIEW_PARAMETERS, file,
};
use mien_workbench::atomic_write::write_out;
use mien_workbench::fault::Fault;

/// Version of the models that are converted.
const VERSION: u32 = 3;

/// The bytes of one section, taken from the front.
struct Bytes<'a>(&'a [u8]);

impl<'a> Bytes<'a> {
    /// # Errors
    /// If there are fewer.
    fn take(&mut self, count: usize) -> Result<&'a [u8], Fault> {
        let split = self.0.split_at_checked(count);
        let (head, tail) = split.ok_or_else(|| {
            Fault::new("expected a face model of version 3, found fewer bytes; copy it again")
        })?;
        self.0 = tail;
        Ok(head)
    }

    fn number(&mut self) -> Result<usize, Fault> {
        let bytes = self.take(4)?.iter().rev();
        Ok(bytes.fold(0, |number, byte| number << 8 | usize::from(*byte)))
    }

    fn floats(&mut self, count: usize) -> Result<Vec<f32>, Fault> {
        let bytes = self.take(4 * count)?.as_chunks().0.iter();
        Ok(bytes.map(|bytes| f32::from_le_bytes(*bytes)).collect())
    }
}

/// A stage before rounding: its prior and bias, its weights on the image, and its mean features.
type Stage = (CascadeStage, DMatrix<f32>, Vec<f32>);

fn stages(bytes: &[u8]) -> Result<Vec<Stage>, Fault> {
    let mut bytes = Bytes(bytes);
    let count = bytes.number()?;
    let stage = |_| {
        let rows = bytes.number()?;
        if !(VIEW_PARAMETERS..=MAX_PARAMETERS).contains(&rows) {
            return Err(Fault::new(format!(
                "expected {VIEW_PARAMETERS} to {MAX_PARAMETERS} rows in a stage, found {rows}; copy the model again"
            )));
        }
        let cell_px = bytes.floats(1)?[0];
        let mean = bytes.floats(FEATURES)?;
        let steps = bytes.take(rows * FEATURES)?;
        let scales = bytes.floats(rows * LANDMARKS)?;
        let weights = DMatrix::from_fn(rows, FEATURES, |row, k| {
            let step = steps[row * FEATURES + k].cast_signed();
            scales[row * LANDMARKS + k / PATCH] * f32::from(step)
        });
        let stage = CascadeStage {
            cell_px,
            prior: bytes
                .floats(rows * rows)?
                .into_iter()
                .map(Short::from)
                .collect(),
            bias: bytes.floats(rows)?,
            ..CascadeStage::default()
        };
        Ok((stage, weights, mean))
    };
    (0..count).map(stage).collect()
}

fn confidence(bytes: &[u8]) -> Result<ConfidenceModel, Fault> {
    let mut bytes = Bytes(bytes);
    let mut model = ConfidenceModel {
        cell_px: bytes.floats(1)?[0],
        ..ConfidenceModel::default()
    };
    let [means, weights] = [bytes.floats(FEATURES)?, bytes.floats(FEATURES)?];
    for (mean, weights) in means.chunks(PATCH).zip(weights.chunks(PATCH)) {
        add_patch(&mut model, mean, weights);
    }
    model.landmark = bytes.floats(LANDMARK_INPUTS * LANDMARKS)?;
    let face = bytes.floats(FACE_INPUTS)?;
    model.face = std::array::from_fn(|k| face[k]);
    Ok(model)
}

/// Converts the model of `path` and writes it to `args.out`; `say` prints one line per stage.
///
/// # Errors
/// If model or data cannot be read, or the result cannot be written.
pub(super) fn convert(
    args: &TrainArgs,
    path: &std::path::Path,
    say: &mut dyn FnMut(&str),
) -> Result<(), Fault> {
    let bytes = model_bytes(path)?;
    let mut rest = Bytes(file::checked(&bytes, VERSION)?.0);
    let mut sections = Vec::new();
    while !rest.0.is_empty() {
        let tag = rest.take(4)?;
        let length = rest.number()?;
        sections.push((tag, rest.take(length)?));
    }
    let of = |tag: &[u8]| {
        let section = sections.iter().find(|section| section.0 == tag);
        section.map_or(&[][..], |section| section.1)
    };
    let old = [stages(of(b"COLD"))?, stages(of(b"WARM"))?];
    // The parts that stay are read from a file without stages.
    let confidence = file::put_confidence(&confidence(of(b"CONF"))?);
    let without_stages = sections.iter().map(|&(tag, bytes)| match tag {
        b"COLD" | b"WARM" => (tag, &[0; 4][..]),
        b"CONF" => (tag, &confidence[..]),
        _ => (tag, bytes),
    });
    let mut model = FaceModel::read(&file::framed(without_stages))?;
    let samples = training_starts(args, &model.shape, say)?;
    let mut progress = cold_starts(&samples);
    let mut new = [Vec::new(), Vec::new()];
    for (old, new) in old.into_iter().zip(&mut new) {
        for (stage, weights, mean) in old {
            let cell_px = stage.cell_px;
            let mut blocks = feature_blocks(&samples, &progress, &model.shape, cell_px);
            let sample_mean = centred(&mut blocks);
            let stage = rounded(stage, weights, &mean, &blocks, sample_mean.as_slice());
            advance(
                &samples,
                &mut progress,
                &model.shape,
                std::slice::from_ref(&stage),
            );
            say(&format!("rounded a stage of cells {cell_px} px apart"));
            new.push(stage);
        }
    }
    let [cold, warm] = new;
    (model.cold, model.warm) = (cold.into(), warm.into());
    write_out(&args.out, file::emit(&model))
}
