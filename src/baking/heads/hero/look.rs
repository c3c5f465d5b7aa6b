//! Indices of a head's looks.

pub(super) const SKIN: usize = 0;
/// Skin outside the image: back of head and neck.
pub(super) const BEHIND: usize = 1;
pub(super) const MOUTH: usize = 2;
pub(super) const GUMS: usize = 3;
pub(super) const TEETH: usize = 4;
pub(super) const EYES: usize = 5;
pub(super) const SOCKETS: usize = 6;
pub(super) const LASHES: usize = 7;
pub(super) const HAIR: usize = 8;
pub(super) const SHIRT: usize = 9;
