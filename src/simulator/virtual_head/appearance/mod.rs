//! What a person wears and what stands around them, in depth and in colour: hair, clothes, things, a room.
//!
//! An [`Outfit`] is one mesh with procedural texture, made from a head once. Its vertices are points of the head frame, or
//! stand off a vertex of the face and move with it (a beard); each stays with the shoulders by its own share (the ends of
//! long hair, a scarf). Strands are cut out of surfaces pixel by pixel, by value noise over texture coordinates, so that
//! edges are ragged in both cameras alike. Units and frames: metres, head frame; texture coordinates in cells of noise.

mod hair;
#[cfg(feature = "studio")]
mod held;
mod look;
mod outfit;
mod painter;
mod room;
mod skull;
mod stuff;
#[cfg(feature = "studio")]
mod things;
mod torso;

pub use look::{Beard, HairStyle, Headgear, Held, Look, Neck};
pub(crate) use outfit::Outfit;
pub(crate) use painter::OutfitPainter;
pub(crate) use room::room;
pub(crate) use stuff::Stuff;

impl Outfit {
    /// Everything a person of this look wears, for this head.
    pub(crate) fn worn(asset: &super::asset::HeadAsset, look: &Look) -> Self {
        let mut outfit = Self::default();
        let skull = skull::Skull::from_asset(asset);
        outfit.torso(look);
        outfit.hair(&skull, look);
        #[cfg(feature = "studio")]
        outfit.things(asset, &skull, look);
        outfit.round_coordinates();
        outfit
    }

    /// Whole tenths of a millimetre, so that the last digit of a sine cannot show in a picture.
    fn round_coordinates(&mut self) {
        for knot in &mut self.knots {
            knot.offset = knot.offset.map(|c| (c * 1e4).round() * 1e-4);
            knot.weave = knot.weave.map(|c| (c * 64.0).round() / 64.0);
        }
    }
}
