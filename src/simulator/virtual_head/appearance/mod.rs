//! Hair, clothes, things and a room, in depth and in colour.
//!
//! An [`Outfit`] is one mesh with procedural texture, made once per head. Its vertices are points of the head frame, or offsets from
//! a vertex of the face, with which they move (a beard). A vertex follows the torso instead of the head by a share of its own (the
//! ends of long hair, a scarf). Strands are cut out of surfaces per pixel by value noise over texture coordinates, so that both
//! cameras see the same ragged edges. Units: metres, head frame; texture coordinates in cells of noise.

mod hair;
#[cfg(feature = "studio")]
mod held;
mod material;
mod options;
mod outfit;
mod painter;
mod room;
mod skull;
#[cfg(feature = "studio")]
mod things;
mod torso;

pub(crate) use material::Material;
pub use options::{Appearance, Beard, HairStyle, Headgear, Held, Neck};
pub(crate) use outfit::Outfit;
pub(crate) use painter::OutfitPainter;
pub(crate) use room::room;

impl Outfit {
    /// Hair, clothes and things for this head.
    pub(crate) fn worn(asset: &super::asset::HeadAsset, appearance: &Appearance) -> Self {
        let mut outfit = Self::default();
        let skull = skull::Skull::from_asset(asset);
        outfit.torso(appearance);
        outfit.hair(&skull, appearance);
        #[cfg(feature = "studio")]
        outfit.things(asset, &skull, appearance);
        outfit.round_coordinates();
        outfit
    }

    /// Rounds to tenths of a millimetre, so that pictures do not depend on the last digit of a platform's sine.
    fn round_coordinates(&mut self) {
        for vertex in &mut self.vertices {
            vertex.offset = vertex.offset.map(|c| (c * 1e4).round() * 1e-4);
            vertex.uv = vertex.uv.map(|c| (c * 64.0).round() / 64.0);
        }
    }
}
