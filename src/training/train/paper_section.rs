//! The paper's active appearance model as a section of the model file: trained with the rest, copied from an earlier
//! model, or replaced in a file that otherwise stays the same, byte for byte.

use std::borrow::Cow;
use std::path::Path;

use super::args::TrainArgs;
use super::paper_aam::paper_aam_block;
use super::person::learn_frames;
use crate::nrsfm::Tracks;
use mien_appliance::source;
use mien_sensors::Frame;
use mien_stages::face_model::{FaceModel, SHIPPED, ShapeModel, file};
use mien_workbench::atomic_write::write_out;
use mien_workbench::fault::Fault;

/// Source of the section. Read before training, so that a wrong file is reported at once.
pub(super) enum Source {
    Kept(Cow<'static, [u8]>),
    /// Trained; with the 3D shape of the actor of these tracks, or of a rendered one.
    Learned(Option<Tracks>),
}

impl Source {
    pub(super) fn read(args: &TrainArgs) -> Result<Self, Fault> {
        if let Some(path) = &args.paper_of {
            return Ok(Self::Kept(FaceModel::read(&model_bytes(path)?)?.paper_aam));
        }
        let tracks = args.tracks.as_deref().map(Tracks::read).transpose()?;
        Ok(Self::Learned(tracks))
    }

    /// The bytes of the section.
    pub(super) fn section(
        &self,
        args: &TrainArgs,
        shape: &ShapeModel,
        say: &mut dyn FnMut(&str),
    ) -> Result<Cow<'static, [u8]>, Fault> {
        let tracks = match self {
            Self::Kept(bytes) => return Ok(bytes.clone()),
            Self::Learned(tracks) => tracks.as_ref(),
        };
        let block = paper_aam_block(&args.data.data, shape, tracks, args.seed, say)?;
        let bytes = block.len();
        say(&format!(
            "the paper's active appearance model: {bytes} bytes"
        ));
        Ok(block.into())
    }
}

/// Trains the section alone, of everybody or of the person of a recording (tracked by the default pipeline), and
/// writes the model of `args.paper_into`, by default the shipped one, with it.
///
/// # Errors
/// If the model, the data or the recording cannot be read or show too little, or the result cannot be written.
pub(super) fn replace(args: &TrainArgs, say: &mut dyn FnMut(&str)) -> Result<(), Fault> {
    let bytes = match &args.paper_into {
        Some(path) => model_bytes(path)?,
        None => SHIPPED.to_vec(),
    };
    let model = FaceModel::read(&bytes)?;
    let block = match &args.person {
        Some(session) => {
            let mut recording = source::recording(session)?;
            let camera = recording.camera().clone();
            let mut next = |frame: &mut Frame| recording.next_frame(frame).unwrap_or(false);
            learn_frames(&mut next, &camera, &model, args.seed, say)?.into()
        }
        None => Source::read(args)?.section(args, &model.shape, say)?,
    };
    let grafted = file::with_section(&bytes, *b"PAAM", &block)?;
    write_out(&args.out, &grafted)?;
    let both = file::sections(&bytes)?.zip(file::sections(&grafted)?);
    let kept = both.filter(|(before, after)| before == after).count();
    say(&format!(
        "wrote {}: {} bytes; {kept} other sections unchanged, byte for byte",
        args.out.display(),
        grafted.len()
    ));
    Ok(())
}

pub(super) fn model_bytes(path: &Path) -> Result<Vec<u8>, Fault> {
    let advice = "; expected a face model, such as config/face.model";
    std::fs::read(path).map_err(Fault::cannot("read", path, advice))
}
