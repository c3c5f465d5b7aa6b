//! What figures are drawn of, the two systems that look at it, and where pictures go.

use std::path::Path;

use image::RgbImage;

use super::error::FiguresError;
use crate::appliance::settings::Settings;
use crate::face_model::FaceModel;
use crate::pipeline::Pipeline;
use crate::simulator::virtual_head::Simulator;
use crate::studio::heads::PersonHead;

/// What figures are drawn of.
pub(super) struct Studio<'a> {
    pub(super) data: &'a Path,
    pub(super) out: &'a Path,
    pub(super) heads: Vec<PersonHead>,
    pub(super) model: &'a FaceModel,
    /// The paper's system and the default.
    pub(super) settings: [(&'static str, Settings); 2],
    pub(super) seconds: f64,
}

impl Studio<'_> {
    /// The system of the paper and the default before the same sensor.
    pub(super) fn pipelines(
        &self,
        simulator: &Simulator,
    ) -> Result<Vec<(&'static str, Pipeline)>, FiguresError> {
        let of = |(name, settings): &(&'static str, Settings)| {
            Ok((
                *name,
                Pipeline::new(&settings.stages(), simulator.camera(), self.model)?,
            ))
        };
        self.settings.iter().map(of).collect()
    }

    /// Writes a picture, as small as PNG gets where noise is nothing to keep: the two lowest bits go.
    pub(super) fn save(&self, name: &str, picture: &RgbImage) -> Result<String, FiguresError> {
        use image::codecs::png::{CompressionType, FilterType, PngEncoder};
        let path = self.out.join(name).with_extension("png");
        let unwritable = |source| FiguresError::Unwritable {
            path: path.clone(),
            source,
        };
        let mut picture = picture.clone();
        picture.iter_mut().for_each(|v| *v = *v & 0xfc | *v >> 6);
        let file = std::fs::File::create(&path).map_err(|error| unwritable(error.into()))?;
        let encoder =
            PngEncoder::new_with_quality(file, CompressionType::Best, FilterType::Adaptive);
        picture.write_with_encoder(encoder).map_err(unwritable)?;
        Ok(format!("wrote {}", path.display()))
    }
}
